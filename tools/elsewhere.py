"""Compute the book's numbers in other environments, and compare them with those of this one.

The others are: one thread of OpenBLAS, other kernels of it, the oldest supported version of every direct dependency,
and newer versions of Python. In each, the runs of both examples are compared with the published data, every claim is
checked, and each number is compared with that of the reference, relative to the tolerance of its check.

    python tools/elsewhere.py [--tests] [VARIANT ...]
"""

import argparse
import json
import os
import platform
import shutil
import subprocess
import sys
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / "build/elsewhere"
EXTRAS = ("app", "plot", "paper", "study", "test", "dev")
# The tests of numbers; the others concern the book, its lock and its pages.
NUMERIC = ("tests/paper", "tests/plants", "tests/study", "rhl")
NOT_NUMERIC = ("tests/paper/test_pages.py", "tests/paper/test_first_page.py")
CASES = 10


@dataclass(frozen=True)
class Variant:
    """An environment: settings of OpenBLAS, and whose packages and Python it has.

    `kernel` needs the processor's `flag`; `packages` are "locked" or "oldest"; `python` is empty for this one.
    """

    name: str
    kernel: str = ""
    flag: str = ""
    threads: int = 2
    packages: str = "locked"
    python: str = ""

    @property
    def here(self) -> bool:
        """Whether this Python and its packages serve."""
        return not self.python and self.packages == "locked"


REFERENCE = Variant("reference")
VARIANTS = (
    Variant("one-thread", threads=1),
    Variant("skylake", kernel="SkylakeX", flag="avx512f"),
    Variant("haswell", kernel="Haswell", flag="avx2"),
    Variant("nehalem", kernel="Nehalem", flag="sse4_2"),
    Variant("prescott", kernel="Prescott", flag="sse2"),
    Variant("oldest", packages="oldest", python="3.11"),
    *(Variant(f"python-{version}", python=version) for version in ("3.12", "3.13", "3.14")),
)


class NotHereError(Exception):
    """A variant cannot run on this machine; the message says why in one sentence."""


# ---------------------------------------------------------------- in the environment


def measured() -> dict[str, Any]:
    """What one environment computes: numbers with their tolerances and verdicts, and what it consists of."""
    import numba
    import numpy
    import scipy

    from rhl.paper import environment, published
    from rhl.paper.claims import ledger
    from rhl.paper.claims.claim import Effort

    numbers: dict[str, Any] = {}
    compared = {
        "linear": published.compare_linear(published.linear_example().run()),
        "robot": published.compare_robot(published.robot_arm().run()),
    }
    for example, rows in compared.items():
        for row in rows:
            right = row.verdict in ("within", "unexplained")
            numbers[f"{example}: {row.signal}"] = {"value": row.largest, "tolerance": row.tolerance, "right": right}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what a claim warns of, its tests check
        for judged in ledger.run(ledger.CLAIMS, Effort(cases=CASES)):
            found = judged.evidence
            numbers[judged.claim.id] = {
                "value": found.worst if found else None,
                "tolerance": found.tolerance if found else None,
                "right": judged.as_recorded,
            }
    kernels = sorted({f"{library['kernel']}, {library['threads']}" for library in environment.libraries()})
    versions = [platform.python_version(), numpy.__version__, scipy.__version__, numba.__version__]
    return {"versions": versions, "kernels": kernels, "numbers": numbers}


# ---------------------------------------------------------------- outside


def differences(found: dict[str, Any], reference: dict[str, Any]) -> dict[str, float]:
    """Differences of the numbers from the reference's, relative to their tolerances.

    Only numbers within their tolerance have one: those beyond it belong to statements that are refuted, and exact ones
    have tolerance 0.
    """
    return {
        name: abs(number["value"] - reference[name]["value"]) / number["tolerance"]
        for name, number in found.items()
        if name in reference
        and number["tolerance"]
        and number["value"] is not None
        and max(number["value"], reference[name]["value"]) <= number["tolerance"]
    }


def faults(found: dict[str, Any], reference: dict[str, Any]) -> list[str]:
    """Numbers that are not as they must be: missing, or of a wrong verdict."""
    missing = [f"{name} is missing" for name in reference if name not in found]
    return missing + [f"{name} is not as recorded" for name, number in found.items() if not number["right"]]


def flags() -> set[str]:
    """What the processor can do; empty where Linux does not say it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return set()
    return {flag for line in lines if line.startswith("flags") for flag in line.partition(":")[2].split()}


def settings(variant: Variant, folder: Path) -> dict[str, str]:
    """The variables of a variant's processes."""
    own = {"OPENBLAS_NUM_THREADS": str(variant.threads), "PYTHONWARNINGS": "default"}
    if variant.kernel:
        own["OPENBLAS_CORETYPE"] = variant.kernel
    if not variant.here:
        own["NUMBA_CACHE_DIR"] = str(folder / "compiled")  # numba keeps one version's code next to the sources
    return {name: value for name, value in os.environ.items() if not name.startswith("OPENBLAS_")} | own


def call(command: Sequence[str | Path], **options: Any) -> None:
    """Run a command; what it complains of is the reason why a variant cannot run."""
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, **options)
    if done.returncode:
        last = next((line for line in reversed(done.stderr.splitlines()) if line.strip()), "it gave no reason")
        raise NotHereError(f"{Path(command[0]).name} {command[1]} failed: {last.strip()}")


def prepared(variant: Variant, folder: Path) -> Path:
    """The Python of a variant; if it is not this one, in an environment of its own."""
    if variant.kernel and variant.flag not in flags():
        raise NotHereError(f"the processor must have {variant.flag} for the kernel {variant.kernel}, but has not")
    if variant.here:
        return Path(sys.executable)
    uv = shutil.which("uv", path=str(Path(sys.executable).parent))
    if uv is None:
        raise NotHereError("uv, which makes environments, is missing from this one; run 'make env'")
    python, venv = folder / "venv/bin/python", folder / "venv"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    call([uv, "venv", "--quiet", "--python", variant.python, venv])
    install: list[str | Path] = [uv, "pip", "install", "--quiet", "--python", python]
    if variant.packages == "oldest":
        needed = folder / "requirements.txt"
        extras = [word for extra in EXTRAS for word in ("--extra", extra)]
        resolve = ["--resolution", "lowest-direct", "--python-version", variant.python]
        call([uv, "pip", "compile", "--quiet", *resolve, *extras, "pyproject.toml", "--output-file", needed])
        call([*install, "--requirement", needed])
    else:
        call([*install, "--require-hashes", "--requirement", "environment.lock"])
    call([*install, "--no-deps", "--no-build-isolation", "--editable", "."])
    return python


def tested(python: Path, environment: dict[str, str]) -> str:
    """The last line of pytest on the tests of numbers."""
    left_out = [f"--ignore={name}" for name in NOT_NUMERIC]
    files = [str(path) for path in sorted((ROOT / "tests").glob("test_*.py")) if numeric(path)]
    command: list[str | Path] = [
        python,
        "-m",
        "pytest",
        "-q",
        "-n",
        "2",
        "-p",
        "no:cacheprovider",
        *left_out,
        *NUMERIC,
        *files,
    ]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, env=environment)
    (FOLDER / "tests.log").write_text(done.stdout + done.stderr, encoding="utf-8")
    return (done.stdout.strip().splitlines() or ["pytest printed nothing"])[-1] + ("" if done.returncode == 0 else " !")


def numeric(path: Path) -> bool:
    """Whether a file of tests concerns numbers of the library: it has the name of one of its modules."""
    name = path.stem.removeprefix("test_")
    return any((ROOT / "rhl" / where).exists() for where in (f"{name}.py", f"_{name}.py", name))


def run(variant: Variant, tests: bool) -> dict[str, Any]:
    """Compute the numbers of a variant in a process of its own; NotHereError if that is not possible."""
    folder = FOLDER / variant.name
    python = prepared(variant, folder)
    environment = settings(variant, folder)
    done = subprocess.run(
        [python, __file__, "--measure"], cwd=ROOT, capture_output=True, text=True, check=False, env=environment
    )
    if done.returncode:
        raise RuntimeError(f"the variant {variant.name} failed: {done.stderr.strip()[-2000:]}")
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    if tests and not variant.here:
        found["tests"] = tested(python, environment)
    (FOLDER / f"{variant.name}.json").write_text(json.dumps(found, indent=1), encoding="utf-8")
    return found


def line(*cells: str) -> str:
    """One row of the table."""
    return "  ".join(cell.ljust(width) for cell, width in zip(cells, (12, 30, 16, 16, 0), strict=False)).rstrip()


def report(name: str, found: dict[str, Any], reference: dict[str, Any]) -> tuple[str, bool]:
    """A variant's row, and whether all is as it must be."""
    wrong = faults(found["numbers"], reference["numbers"])
    ratios = differences(found["numbers"], reference["numbers"])
    farthest = max(ratios, key=lambda name: ratios[name])
    apart = sum(ratio > 0 for ratio in ratios.values())
    says = f"{len(found['numbers']) - len(wrong)} of {len(found['numbers'])} right"
    rest = f"{apart} differ, at most by {ratios[farthest]:.1g} of the tolerance ({farthest})"
    if "tests" in found:
        rest += f"; tests: {found['tests']}"
    row = line(name, ", ".join(found["versions"]), "; ".join(found["kernels"]), says, rest)
    right = not wrong and ratios[farthest] <= 1 and not found.get("tests", "").endswith("!")
    return "\n".join([row, *(f"{'':14}{fault}" for fault in wrong)]), right


def main(names: Sequence[str], tests: bool) -> int:
    """Run the variants of these names, all without any; 1 if one differs, or cannot run in continuous integration."""
    chosen = [variant for variant in VARIANTS if not names or variant.name in names]
    unknown = sorted(set(names) - {variant.name for variant in VARIANTS})
    if unknown:
        known = ", ".join(variant.name for variant in VARIANTS)
        print(f"VARIANT must be one of {known}, got {', '.join(unknown)}", file=sys.stderr)
        return 2
    FOLDER.mkdir(parents=True, exist_ok=True)
    reference = run(REFERENCE, tests=False)
    print(line("variant", "Python, numpy, scipy, numba", "kernel, threads", "numbers", "from the reference"))
    row, fine = report(REFERENCE.name, reference, reference)
    print(row, flush=True)
    for variant in chosen:
        try:
            row, right = report(variant.name, run(variant, tests), reference)
        except NotHereError as error:
            row, right = line(variant.name, f"not run: {error}"), os.environ.get("CI") != "true"
        fine = fine and right
        print(row, flush=True)
    return 0 if fine else 1


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="compute the numbers in other environments")
    parser.add_argument("variants", nargs="*", metavar="VARIANT", help="by default all")
    parser.add_argument("--tests", action="store_true", help="run the tests of numbers in new environments too")
    parser.add_argument("--measure", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure:
        print(json.dumps(measured()))
        sys.exit(0)
    sys.exit(main(options.variants, options.tests))
