"""Mutation testing: change one place of the library, run the tests that execute it, and see whether one fails.

    python -m tools.mutants tests        # does `make test` notice?
    python -m tools.mutants verify       # does `rhl verify --fast` notice, without the tests?
    python -m tools.mutants notebooks    # does a notebook notice a changed assertion, or a changed result?

A seeded sample over the syntax trees, for two reasons: mutmut puts several versions of a function side by side, which
numba cannot compile and doctests see; cosmic-ray runs one command for every mutant, which takes seven minutes each
here. The sample is chosen by the hashes of the changes, not by positions, so that it stays the same when other lines
change. `tools/equivalent.toml` lists changes that no test can notice, each with the reason.

Everything runs in a copy of the tree. Results are appended to build/mutants/<what>.jsonl after each mutant, so that an
interrupted run goes on where it ended. They are of one state of library, tests and notebooks: after a change of these
every mutant is judged anew, first by the test that noticed it before.
"""

import argparse
import contextlib
import json
import multiprocessing
import os
import resource
import shutil
import subprocess
import sys
import time
import tomllib
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, replace
from multiprocessing.context import ForkServerProcess
from pathlib import Path
from typing import Any

from tools.fresh import digest
from tools.mutations import Mutant, notebook_sample, sample

ROOT = Path(__file__).resolve().parent.parent
OUTPUT = ROOT / "build/mutants"
EQUIVALENT = ROOT / "tools/equivalent.toml"

# Compiled code is invisible to a tracer: its tests are those that execute what calls it.
CALLERS = {"rhl/kernels/": ("rhl/_engine.py", "rhl/_lanes.py", "rhl/_riccati.py", "rhl/estimator.py")}
# Modules that take long to import, loaded once before the processes that each test one mutant.
PRELOADED = [
    *("numpy", "scipy.linalg", "scipy.optimize", "numba", "sympy", "control", "pandas", "matplotlib.pyplot"),
    *("pytest", "rich", "flint"),
]
# No claim is about files, plots, messages, comparisons, other plants.
NO_CLAIM = (
    *("rhl/app/", "rhl/paper/", "rhl/study/", "rhl/plants/", "rhl/plotting.py", "rhl/live.py"),
    *("rhl/_checks.py", "rhl/_files.py", "rhl/errors.py", "rhl/__init__.py"),
)
# A Dask cluster cannot be started in a process that was forked.
NOT_FORKED = ("tests/study/test_backends.py",)
# Tests that read the library's text, or look at every module, without executing its lines.
OF_ALL = ("tests/test_sources.py", "tests/test_imports.py", "tests/test_public_names.py")
SECONDS = 100  # of tests for one mutant, in the order of `tests_of`
NOTICED_BY = "noticed-by"  # the file to which the process of a mutant writes the test or claim that failed
MEMORY = 6 * 2**30  # bytes of address space beyond which a mutant counts as noticed


def _process(work: Callable[..., None], *arguments: object) -> ForkServerProcess:
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(PRELOADED)
    return context.Process(target=work, args=arguments)


def copy_tree(root: Path, tree: Path) -> None:
    """Every file that belongs to the project, with its times, so that compiled code stays valid."""
    if tree.exists():
        shutil.rmtree(tree)
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=root,
        check=True,
        capture_output=True,
    )
    for name in filter(None, listed.stdout.decode().split("\0")):
        if (root / name).is_file():
            (tree / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(root / name, tree / name)
    for cache in (root / "rhl/kernels").glob("__pycache__"):
        shutil.copytree(cache, tree / cache.relative_to(root))


def covered(tree: Path, folder: Path) -> dict[str, dict]:
    """For each test its seconds and lines, measured now unless they were measured before, to the end."""
    complete = folder / "complete"
    if not complete.exists():
        shutil.rmtree(folder, ignore_errors=True)
        print("running the tests once to see which lines each of them executes", flush=True)
        pytest = [sys.executable, "-m", "pytest", "-q", "-n", "2", "-p", "tools.covered", "tests", "rhl", "README.md"]
        done = subprocess.run(pytest, cwd=tree, env=_environment(tree) | {"RHL_COVERED": str(folder)}, check=False)
        if done.returncode not in (0, 1):  # tests that fail here, for want of a repository, count for nothing
            raise SystemExit("the tests must run before mutants can be judged")
        complete.touch()
    tests: dict[str, dict] = {}
    for file in sorted(folder.glob("*.json")):
        tests |= json.loads(file.read_text(encoding="utf-8"))
    return tests


def _trace_notebook(tree: Path, notebook: str, output: Path) -> None:
    """Run the cells of a notebook in this process and write its seconds and lines, like those of a test."""
    _enter(tree, "")
    os.chdir(tree / "notebooks")
    import coverage
    from IPython.core.interactiveshell import InteractiveShell

    tracer = coverage.Coverage(data_file=None, source=[str(tree / "rhl")], config_file=False, messages=False)
    begin = time.monotonic()
    tracer.start()
    shell = InteractiveShell.instance()
    for cell in json.loads((tree / notebook).read_text(encoding="utf-8"))["cells"]:
        if cell["cell_type"] == "code":
            shell.run_cell("".join(cell["source"])).raise_error()
    tracer.stop()
    data = tracer.get_data()
    lines = {Path(file).relative_to(tree).as_posix(): data.lines(file) for file in data.measured_files()}
    record = {notebook: {"seconds": time.monotonic() - begin + 3, "lines": lines}}
    part = output.with_suffix(".part")
    part.write_text(json.dumps(record), encoding="utf-8")
    part.rename(output)


def covered_by_notebooks(tree: Path, folder: Path) -> dict[str, dict]:
    """For each notebook its seconds and lines."""
    folder.mkdir(parents=True, exist_ok=True)
    for path in sorted((tree / "notebooks").glob("*.ipynb")):
        output = folder / f"{path.stem}.json"
        if not output.exists():
            process = _process(_trace_notebook, tree, path.relative_to(tree).as_posix(), output)
            process.start()
            process.join()
            if not output.exists():
                raise SystemExit(f"{path.name} must pass before mutants can be judged")
    records = (json.loads(file.read_text(encoding="utf-8")) for file in sorted(folder.glob("*.json")))
    return {name: record for each in records for name, record in each.items()}


def tests_of(mutant: Mutant, tests: dict[str, dict], noticed_by: str) -> list[str]:
    """The tests that may notice a mutant: the one that did before, then from likely to unlikely, from short to long."""
    callers = next((files for start, files in CALLERS.items() if mutant.file.startswith(start)), ())
    own = f"test_{Path(mutant.file).stem.lstrip('_')}.py"
    folder = str(Path("tests") / Path(mutant.file).parent.relative_to("rhl"))

    def likely(test: str, record: dict[str, Any]) -> int | None:
        """How likely a test is to notice, from 0; None if it cannot. Every line of a test may have been run before it.

        A test without lines may run the library in another process. One of the same folder may use what another one
        has computed or imported.
        """
        lines = record["lines"]
        if mutant.line in lines.get(mutant.file, ()) or any(file in lines for file in callers):
            return 0 if own in test else 1
        if own in test or mutant.file in lines or (not lines and test.startswith(OF_ALL)):
            return 2
        return 3 if test.startswith(f"{folder}/test_") else None

    left = {test: record for test, record in tests.items() if not test.startswith(NOT_FORKED)}
    ranks = {test: rank for test, record in left.items() if (rank := likely(test, record)) is not None}
    ranked = sorted(ranks, key=lambda test: (test != noticed_by, ranks[test], tests[test]["seconds"]))
    total = 0.0
    kept: list[str] = []
    for test in (test for test in ranked if not test.startswith("notebooks/")):
        total += tests[test]["seconds"]
        if total > SECONDS and kept:
            break
        kept.append(test)
    # A notebook takes a kernel, so one of them is enough, after the tests.
    return kept + [test for test in ranked if test.startswith("notebooks/")][:1]


def _environment(tree: Path) -> dict[str, str]:
    return os.environ | {"PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1", "OPENBLAS_NUM_THREADS": "1"}


def _enter(tree: Path, cache: str) -> None:
    """Make this process one of the changed tree."""
    os.environ.update(_environment(tree))
    if cache:
        os.environ["NUMBA_CACHE_DIR"] = cache
        from numba.core import config

        config.CACHE_DIR = cache  # type: ignore[attr-defined]
    os.chdir(tree)
    sys.path.insert(0, str(tree))
    sys.dont_write_bytecode = True
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    said = os.open(tree.parent / "said.txt", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(said, 1)
    os.dup2(said, 2)


def _run_tests(tree: Path, cache: str, tests: list[str]) -> None:
    _enter(tree, cache)
    import pytest

    class First:
        @staticmethod
        def pytest_runtest_logreport(report: pytest.TestReport) -> None:
            if report.failed:
                (tree.parent / NOTICED_BY).write_text(report.nodeid, encoding="utf-8")

        @staticmethod
        def pytest_collectreport(report: pytest.CollectReport) -> None:
            if report.failed:
                (tree.parent / NOTICED_BY).write_text(f"collecting {report.nodeid}", encoding="utf-8")

    # numpy asks for this warning to be ignored when it is imported, which here is before pytest sets its filters.
    options = ["-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", "-W", "ignore:the matrix subclass"]
    os._exit(1 if pytest.main([*options, *tests], [First]) else 0)


def _run_claims(tree: Path, cache: str, claims: list[str]) -> None:
    _enter(tree, cache)
    from rhl.paper.claims import ledger
    from rhl.paper.claims.claim import Effort, judge

    by_id = {claim.id: claim for claim in ledger.CLAIMS}
    for id in claims:
        if not judge(by_id[id], Effort(0, 10)).as_recorded:
            (tree.parent / NOTICED_BY).write_text(id, encoding="utf-8")
            os._exit(1)
    os._exit(0)


def judged(tree: Path, mutant: Mutant, work: Callable[..., None], what: list[str], limit: float) -> dict[str, Any]:
    """Run one mutant in a process of its own; returns the verdict, the seconds, and the test or claim that failed."""
    path = tree / mutant.file
    kept, stat = path.read_bytes(), path.stat()
    cache = str(tree.parent / f"{tree.name}-compiled") if mutant.file.startswith("rhl/kernels/") else ""
    noticed_by = tree.parent / NOTICED_BY
    noticed_by.unlink(missing_ok=True)
    begin = time.monotonic()
    path.write_text(mutant.content, encoding="utf-8")
    try:
        process = _process(work, tree, cache, what)
        process.start()
        process.join(limit)
        if process.is_alive():
            process.kill()
            process.join()
            verdict = "too long"
        else:
            # Without a failed test or claim it is the process that failed: by a signal, or for want of memory.
            verdict = "survived" if process.exitcode == 0 else "noticed"
    finally:
        path.write_bytes(kept)
        os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))
        if cache:
            shutil.rmtree(cache, ignore_errors=True)
    by = noticed_by.read_text(encoding="utf-8") if noticed_by.exists() else ""
    return {"verdict": verdict, "seconds": time.monotonic() - begin, "by": by}


def _control(tree: Path, mutant: Mutant, what: list[str], limit: float) -> None:
    """Without a change the same tests must pass: otherwise every mutant would seem to be noticed."""
    unchanged = replace(mutant, content=(tree / mutant.file).read_text(encoding="utf-8"))
    row = judged(tree, unchanged, _run_tests, what, limit)
    if row["verdict"] != "survived":
        said = (tree.parent / "said.txt").read_text(encoding="utf-8", errors="replace")[-2000:]
        raise SystemExit(f"without any change the tests of {mutant.file} fail, by {row['by'] or 'themselves'}:\n{said}")


def known_equivalent() -> dict[tuple[str, str, str], str]:
    """The listed changes that no test can notice: (function, line before, line after) to the reason."""
    if not EQUIVALENT.is_file():
        return {}
    rows = tomllib.loads(EQUIVALENT.read_text(encoding="utf-8"))["mutant"]
    return {(row["function"], row["before"], row["after"]): row["reason"] for row in rows}


def table(results: list[dict]) -> str:
    """One row for each room: mutants, noticed, equivalent, survived, and the share of the others that was noticed."""
    rows = [("room", "mutants", "noticed", "equivalent", "survived", "share noticed")]
    rooms = sorted({row["room"] for row in results})
    for room in [*rooms, "all"]:
        count = Counter(row["verdict"] for row in results if room in ("all", row["room"]))
        noticed, total = count["noticed"] + count["too long"], count.total()
        share = f"{noticed / max(1, total - count['equivalent']):.1%}"
        rows.append((room, str(total), str(noticed), str(count["equivalent"]), str(count["survived"]), share))
    return "\n".join("  ".join(f"{cell:>13}" if i else f"{cell:18}" for i, cell in enumerate(row)) for row in rows)


def kept(record: Path) -> list[dict[str, Any]]:
    """The results on record; a last line that was not written to its end is left out."""
    rows = []
    for line in record.read_text(encoding="utf-8").splitlines() if record.exists() else ():
        with contextlib.suppress(json.JSONDecodeError):
            rows.append(json.loads(line))
    return rows


def claims_by_seconds(tree: Path) -> list[str]:
    """Ids of all claims, those that are checked fastest first."""
    code = (
        "import json; from rhl.paper.claims import ledger; from rhl.paper.claims.claim import Effort\n"
        "print(json.dumps([[row.seconds, row.claim.id] for row in ledger.run(ledger.CLAIMS, Effort(0, 10))]))"
    )
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=tree, env=_environment(tree), check=True, capture_output=True, text=True)
    return [id for _, id in sorted(json.loads(done.stdout))]


def main() -> int:
    """Judge the sample, print each result and a table; exit status 1 if fewer are noticed than asked for."""
    parser = argparse.ArgumentParser(description="change the library in one place and see what notices")
    parser.add_argument("what", choices=("tests", "verify", "notebooks"))
    parser.add_argument("--size", type=int, default=300, help="about as many mutants (default: 300)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--room", default="rhl", help="a file or folder of rhl/ (default: all)")
    parser.add_argument("--at-least", type=float, default=0.0, help="share that has to be noticed, from 0 to 1")
    parser.add_argument("--root", type=Path, default=ROOT, help="another checkout of the project")
    parser.add_argument("--output", type=Path, default=OUTPUT)
    parser.add_argument("--before", type=Path, help="results of an earlier run, whose failing tests are tried first")
    parser.add_argument("--again", action="store_true", help="judge those anew that survived")
    options = parser.parse_args()
    if options.size < 1:
        parser.error(f"--size must be an integer of at least 1, got {options.size}")
    if not 0 <= options.at_least <= 1:
        parser.error(f"--at-least must be a number from 0 to 1, got {options.at_least}")
    if not (options.root / "rhl").is_dir():
        parser.error(f"--root must be a checkout of the project, got {options.root} without rhl/")
    if options.before and not options.before.is_file():
        parser.error(f"--before must be results of an earlier run, found no file {options.before}")
    tree, record = options.output / f"{options.what}-tree", options.output / f"{options.what}.jsonl"
    options.output.mkdir(parents=True, exist_ok=True)
    copy_tree(options.root, tree)

    of = digest(tree, ("rhl", "tests", "notebooks", "README.md", "environment.lock"))[:16]
    by_notebook = {} if options.what == "verify" else covered_by_notebooks(tree, options.output / f"notebooks-{of}")
    if options.what == "notebooks":
        lines = {name: record["lines"] for name, record in by_notebook.items()}
        pairs = notebook_sample(tree, lines, options.seed)
    else:
        pairs = [("", each) for each in sample(tree, options.size, options.seed) if each.file.startswith(options.room)]
    if options.what == "verify":  # what the claims are about, not the claims
        pairs = [(name, mutant) for name, mutant in pairs if not mutant.file.startswith(NO_CLAIM)]
    if not pairs:
        parser.error(f"--room must be a file or folder of rhl/ with members of the sample, got {options.room!r}")
    if options.what == "tests":
        tests = covered(tree, options.output / f"covered-{of}") | by_notebook
    claims = claims_by_seconds(tree) if options.what == "verify" else []

    rows = kept(record)
    done = {
        row["id"]: row for row in rows if row.get("of") == of and not (options.again and row["verdict"] == "survived")
    }
    before = {row["id"]: row.get("by", "") for row in (*rows, *(kept(options.before) if options.before else ()))}
    reasons = known_equivalent()
    controlled: set[str] = set()
    results = []

    def verdict(notebook: str, mutant: Mutant) -> dict[str, Any]:
        if (mutant.function, mutant.before, mutant.after) in reasons:
            return {"verdict": "equivalent", "seconds": 0.0}
        if options.what == "notebooks":
            return judged(tree, mutant, _run_tests, [notebook], 300)
        if options.what == "verify":
            return judged(tree, mutant, _run_claims, claims, 600)
        what = tests_of(mutant, tests, before.get(mutant.id, ""))
        if not what:
            return {"verdict": "survived", "seconds": 0.0, "tests": 0}
        limit = 60 + 2 * sum(tests[test]["seconds"] for test in what)
        if mutant.room not in controlled:
            _control(tree, mutant, what, limit)
            controlled.add(mutant.room)
        return {"tests": len(what)} | judged(tree, mutant, _run_tests, what, limit)

    for number, (notebook, mutant) in enumerate(pairs, 1):
        row = done.get(notebook + mutant.id)
        if row is None or (row["verdict"] == "equivalent") != (
            (mutant.function, mutant.before, mutant.after) in reasons
        ):
            row = {"id": notebook + mutant.id, "room": mutant.room, "of": of}
            row |= asdict(mutant) | verdict(notebook, mutant)
            del row["content"]
            with record.open("a", encoding="utf-8") as file:
                file.write(f"\n{json.dumps(row)}")
        results.append(row)
        print(
            f"{number}/{len(pairs)} {row['verdict']:10} {row['seconds']:5.0f} s  {mutant.file}:{mutant.line}",
            flush=True,
        )
    print(table(results))
    for row in results:
        if row["verdict"] == "survived":
            print(f"{row['file']}:{row['line']} {row['function']}\n  - {row['before']}\n  + {row['after']}")
    score = Counter(row["verdict"] for row in results)
    judged_at_all = max(1, len(results) - score["equivalent"])
    return int((score["noticed"] + score["too long"]) / judged_at_all < options.at_least)


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        sys.exit(main())
    sys.exit(130)
