"""Run the book's builder without stale results of an older library or page.

The book has two caches: jupyter-cache (outputs of notebooks) and Sphinx's doctrees (pages). Neither notices a change in
`rhl/`, pages do not notice a changed number that is glued from another page, and doctrees of a failed build hide its
warnings from the next one. So outputs and pages are kept only while their dependencies are unchanged, and pages only
after a successful build.

    python tools/fresh.py jupyter-book build ...
"""

import hashlib
import json
import shutil
import subprocess
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

OUTPUTS_NEED = ("rhl", "environment.lock", "_config.yml")
PAGES_NEED = ("_toc.yml", "CITATION.cff", "book", "notebooks", "proofs", "build/pyodide")
BUILT = "build/_build"
RECORD = "build/fresh.json"


def digest(root: Path, names: Iterable[str]) -> str:
    """Sha256 over the names and bytes of all files that `names` (files or folders below `root`) hold."""
    sha = hashlib.sha256()
    for name in names:
        found = [root / name] if (root / name).is_file() else (root / name).rglob("*")
        files = {path.relative_to(root).as_posix(): path for path in found if path.is_file()}
        for where, path in sorted(files.items()):
            # Caches of tools next to the files (.ruff_cache, .ipynb_checkpoints, __pycache__) are irrelevant.
            if not any(part.startswith((".", "__pycache__")) for part in Path(where).parts):
                content = path.read_bytes()
                sha.update(f"{where}\0{len(content)}\0".encode() + content)
    return sha.hexdigest()


def read_record(root: Path) -> dict[str, str]:
    """The record of the last build; empty if it is not readable."""
    try:
        record = json.loads((root / RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return record if isinstance(record, dict) else {}


def write_record(root: Path, record: dict[str, str]) -> None:
    """Record the dependencies of the outputs and, after a success, of the pages."""
    (root / RECORD).parent.mkdir(parents=True, exist_ok=True)
    (root / RECORD).write_text(json.dumps(record), encoding="utf-8")


def drop_stale(root: Path) -> tuple[str, dict[str, str]]:
    """Remove stale files; returns a description of the kept ones, and the record to write after a success."""
    now = {"outputs": digest(root, OUTPUTS_NEED), "pages": digest(root, PAGES_NEED)}
    last = read_record(root)
    if last.get("outputs") != now["outputs"]:
        stale, kept = [root / BUILT], "nothing"
    elif last.get("pages") != now["pages"]:
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
    kept, record = drop_stale(root)
    print(f"kept from the last build: {kept}", flush=True)
    status = subprocess.run(command, cwd=root, check=False).returncode
    if status == 0:
        write_record(root, record)
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:], Path(__file__).resolve().parent.parent))
