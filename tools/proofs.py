"""Check the theorems of `proofs/` with Coq, print their axioms, and check that false ones are rejected.

`make proofs` calls this. It needs only Coq with Mathematical Components, and no package of `.venv`. The results are
written to `rhl/paper/data/proofs.json` for the book and the ledger, which do not need Coq; a hash of each file detects
an outdated record.
"""

import hashlib
import json
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
PROOFS = ROOT / "proofs"
RECORD = ROOT / "rhl/paper/data/proofs.json"
CLOSED = "Closed under the global context"  # Coq's words for a theorem without axioms
MISSING = (
    "the proofs need Coq 8.16 with Mathematical Components 1.15, got no coqc; on Debian: "
    "apt-get install --no-install-recommends coq libcoq-mathcomp-algebra"
)
# Mathematical Components itself causes these two warnings.
QUIET = ("-q", "-w", "-notation-overridden,-ambiguous-paths")


@dataclass(frozen=True)
class FalseTheorem:
    """A false variant of a statement: Coq must stop at the line `at` of a proof, with an error that contains `says`."""

    file: str
    what: str
    old: str
    new: str
    at: str
    says: str


FALSE = (
    FalseTheorem(
        "lemma_5.v",
        "n (n + 1) / 2 weights that may be zero",
        "  uniq weights -> ((n * n.+1)./2 < size weights)%N ->",
        "  uniq weights -> ((n * n.+1)./2 <= size weights)%N ->",
        "p_neq0 (size_columns early) (fun=> erefl) different many.",
        'The term "many" has type "is_true ((n * n.+1)./2 <= size weights)%N"',
    ),
    FalseTheorem(
        "lemma_5.v",
        "entries of A^k B of degree k",
        "(size (block (line A A1) (line B B1) k i j) <= k.+2)%N.",
        "(size (block (line A A1) (line B B1) k i j) <= k.+1)%N.",
        "elim: k i => [|k IH] i; first exact: size_line.",
        "Cannot apply lemma size_line",
    ),
    FalseTheorem(
        "lemma_4.v",
        "iterates above 29/405 = 0.0716, where the limit is 0.0699",
        "Theorem bounded_away k : 28 / 405 <= iterate k.",
        "Theorem bounded_away k : 29 / 405 <= iterate k.",
        "rewrite mulrDr -natrM ler_addl mulrA -natrM.",
        "The LHS of ler_addl (_ <= _ + _) does not match",
    ),
    FalseTheorem(
        "lemma_4.v",
        "a step that is not the proximal one",
        "Definition step k x : R := x / (1 + 2 * weight k).",
        "Definition step k x : R := x / (1 + weight k).",
        "by rewrite mulrC divfK // gt_eqF // divisor_gt0.",
        "The LHS of divfK (_ / _ * _) does not match",
    ),
    FalseTheorem(
        "equation_44.v",
        "the gradient at another point than the centre, as printed",
        "Theorem three_point g slope a b c :\n  dot (slope c - slope b) (a - b)",
        "Theorem three_point g slope a b c d :\n  dot (slope d - slope b) (a - b)",
        "exact: (cancelled theory).",
        "Cannot apply lemma (cancelled theory)",
    ),
)


def coqc() -> str:
    """The path of Coq's compiler; FileNotFoundError, in one sentence, if there is none."""
    found = shutil.which("coqc")
    if found is None:
        raise FileNotFoundError(MISSING)
    return found


def compile_text(text: str, name: str = "proof.v") -> subprocess.CompletedProcess[str]:
    """Compile a source in a temporary folder, so that no files are left next to it."""
    compiler = coqc()
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, name).write_text(text, encoding="utf-8")
        return subprocess.run([compiler, *QUIET, name], cwd=folder, capture_output=True, text=True, check=False)


def asked(text: str) -> list[str]:
    """The theorems whose axioms a source has printed, in order."""
    return re.findall(r"^Print Assumptions (\w+)\.$", text, flags=re.MULTILINE)


def axioms(said: str, theorems: Sequence[str]) -> dict[str, str]:
    """The axioms of each theorem according to Coq; ValueError if the number of answers is wrong."""
    answers = [answer.strip() for answer in re.split(rf"^(?={CLOSED}|Axioms:)", said, flags=re.MULTILINE)]
    answers = [answer for answer in answers if answer]
    if len(answers) != len(theorems):
        raise ValueError(f"Coq must answer for {len(theorems)} theorems, got {len(answers)} answers")
    return dict(zip(theorems, answers, strict=True))


def check(file: Path) -> dict[str, str]:
    """Compile a file of proofs, and return the axioms of its theorems; SystemExit if Coq rejects it."""
    text = file.read_text(encoding="utf-8")
    done = compile_text(text, file.name)
    if done.returncode:
        raise SystemExit(f"Coq rejects {file.name}:\n{done.stdout}{done.stderr}")
    return axioms(done.stdout, asked(text))


def altered(false: FalseTheorem) -> str:
    """The source with its theorem changed; ValueError if the part to change does not occur exactly once."""
    text = (PROOFS / false.file).read_text(encoding="utf-8")
    if text.count(false.old) != 1:
        raise ValueError(f"{false.file} must contain exactly once the part to change for '{false.what}'")
    return text.replace(false.old, false.new)


def rejection(false: FalseTheorem) -> str:
    """Coq's rejection of a false theorem, as 'line N: error'; ValueError if it accepts it, or stops elsewhere."""
    text = altered(false)
    done = compile_text(text, false.file)
    if not done.returncode:
        raise ValueError(f"Coq must reject {false.file} with {false.what}, and accepts it")
    place = re.search(r'File "[^"]*", line (\d+), characters [^\n]*:\nError:(.*)', done.stderr, flags=re.DOTALL)
    if place is None:
        raise ValueError(f"Coq must stop at an error in {false.file} with {false.what}, got: {done.stderr}")
    line, error = int(place[1]), " ".join(f"Error:{place[2]}".split())
    if false.at not in text.splitlines()[line - 1] or false.says not in error:
        raise ValueError(f"Coq must stop at '{false.at}' with '{false.says}', got line {line}: {error}")
    return f"line {line}: {false.at}"


def version() -> str:
    """Coq's version."""
    return subprocess.run([coqc(), "-print-version"], capture_output=True, text=True, check=True).stdout.split()[0]


def hashes() -> dict[str, str]:
    """Sha256 of each source."""
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in sorted(PROOFS.glob("*.v"))}


def record() -> dict[str, Any]:
    """Coq's results for the proofs and the false theorems, in the form of the record."""
    theorems = {}
    for file in sorted(PROOFS.glob("*.v")):
        for theorem, rests in check(file).items():
            theorems[f"{file.stem}.{theorem}"] = rests
    rejected = [{"file": of.file, "what": of.what, "stops": rejection(of)} for of in FALSE]
    return {"coq": version(), "sources": hashes(), "theorems": theorems, "rejected": rejected}


def main() -> int:
    """Check everything, print and record it; returns the exit status."""
    try:
        found = record()
    except (FileNotFoundError, ValueError) as error:
        print(error, file=sys.stderr)
        return 1
    for theorem, rests in found["theorems"].items():
        print(f"{theorem}: {rests}")
    for of in found["rejected"]:
        print(f"rejected, as it must be: {of['file']} with {of['what']} ({of['stops']})")
    RECORD.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
    resting = [theorem for theorem, rests in found["theorems"].items() if rests != CLOSED]
    if resting:
        print(f"these theorems use axioms: {', '.join(resting)}", file=sys.stderr)
    return 1 if resting else 0


if __name__ == "__main__":
    sys.exit(main())
