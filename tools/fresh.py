"""Run the book's builder without stale results of an older library or page.

The book has two caches: jupyter-cache (outputs of notebooks) and Sphinx's doctrees (pages). Neither notices a change in
`rhl/`, pages do not notice a changed number that is glued from another page, and doctrees of a failed build hide its
warnings from the next one. So outputs and pages are kept only while their dependencies are unchanged, and pages only
after a successful build. A build during which a dependency was changed fails, and the next one keeps nothing: its
numbers may be those of a library that was there for some seconds only.

    python tools/fresh.py jupyter-book build ...
"""

import fcntl
import hashlib
import json
import platform
import shutil
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from importlib.metadata import distributions
from pathlib import Path

OUTPUTS_NEED = (
    *("rhl", "environment.lock", "pyproject.toml", "_config.yml"),
    *("tools/fresh.py", "tools/execute.py", "notebooks/conftest.py"),
)
PAGES_NEED = ("_toc.yml", "CITATION.cff", "book", "notebooks", "proofs", "build/pyodide")
BUILT = "build/_build"
RECORD = "build/fresh.json"
LOCK = "build/fresh.lock"


def files(root: Path, names: Iterable[str]) -> Iterator[tuple[str, Path]]:
    """All files that `names` (files or folders below `root`) hold, with their names below `root`, sorted by name."""
    for name in names:
        found = [root / name] if (root / name).is_file() else (root / name).rglob("*")
        for where, path in sorted((path.relative_to(root).as_posix(), path) for path in found if path.is_file()):
            # Caches of tools next to the files (.ruff_cache, .ipynb_checkpoints, __pycache__) are irrelevant.
            if not any(part.startswith((".", "__pycache__")) for part in Path(where).parts):
                yield where, path


def digest(root: Path, names: Iterable[str]) -> str:
    """Sha256 over the names and bytes of all files that `names` (files or folders below `root`) hold."""
    sha = hashlib.sha256()
    for where, path in files(root, names):
        content = path.read_bytes()
        sha.update(f"{where}\0{len(content)}\0".encode() + content)
    return sha.hexdigest()


def installed() -> str:
    """The interpreter and every installed package, by version: what the lock says need not be what is there."""
    packages = sorted({f"{one.name}=={one.version}" for one in distributions()})
    return f"{sys.version} {platform.machine()} {packages}"


def state(root: Path) -> dict[str, str]:
    """What the outputs of notebooks and the pages depend on, as it is now."""
    outputs = hashlib.sha256(f"{digest(root, OUTPUTS_NEED)} {installed()}".encode()).hexdigest()
    return {"outputs": outputs, "pages": digest(root, PAGES_NEED)}


def site(root: Path) -> str:
    """Sha256 over the names of the site's files."""
    names = sorted(path.relative_to(root).as_posix() for path in (root / BUILT / "html").rglob("*") if path.is_file())
    return hashlib.sha256("\0".join(names).encode()).hexdigest()


def changed_since(root: Path, moment: float) -> list[str]:
    """The dependencies that were written, or replaced, after a moment of `time.time`."""
    found = files(root, (*OUTPUTS_NEED, *PAGES_NEED))
    return sorted({where for where, path in found if max((stat := path.stat()).st_ctime, stat.st_mtime) > moment})


def read_record(root: Path) -> dict[str, str]:
    """The record of the last build; empty if it is not readable."""
    try:
        record = json.loads((root / RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return record if isinstance(record, dict) else {}


def write_record(root: Path, record: dict[str, str]) -> None:
    """Record the dependencies of the outputs and, after a success, of the pages, and the names of the site's files."""
    (root / RECORD).parent.mkdir(parents=True, exist_ok=True)
    (root / RECORD).write_text(json.dumps(record), encoding="utf-8")


def is_current(root: Path) -> bool:
    """Whether the last build succeeded, with the files that are there now."""
    return read_record(root) == state(root) | {"site": site(root)}


def drop_stale(root: Path) -> tuple[str, dict[str, str]]:
    """Remove stale files; returns a description of the kept ones, and the record to write after a success."""
    now, last = state(root), read_record(root)
    if last.get("outputs") != now["outputs"]:
        stale, kept = [root / BUILT], "nothing"
    elif last.get("pages") != now["pages"] or last.get("site") != site(root):
        stale, kept = [root / BUILT / ".doctrees", root / BUILT / "html"], "outputs of notebooks"
    else:
        stale, kept = [], "everything"
    for folder in stale:
        if folder.exists():
            shutil.rmtree(folder)
    write_record(root, {"outputs": now["outputs"]})
    return kept, now


def main(command: Sequence[str], root: Path) -> int:
    """Remove stale files, run `command` in `root` and record whether it succeeded; returns its exit status."""
    (root / LOCK).parent.mkdir(parents=True, exist_ok=True)
    with (root / LOCK).open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            print(f"the book must be built once at a time, got another build in {root}; wait for its end")
            return 1
        begin = time.time()
        kept, record = drop_stale(root)
        print(f"kept from the last build: {kept}", flush=True)
        status = subprocess.run(command, cwd=root, check=False).returncode
        if changed := changed_since(root, begin):
            write_record(root, {})
            print(
                f"the sources must not change while the book is built, got a change of {', '.join(changed[:3])}"
                f"{' and others' if changed[3:] else ''}; build it again"
            )
            return status or 1
        if status == 0:
            write_record(root, record | {"site": site(root)})
        return status


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit("a command must be given, got none; type 'make book'")
    sys.exit(main(sys.argv[1:], Path(__file__).resolve().parent.parent))
