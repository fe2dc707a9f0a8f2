"""Execute the book's notebooks with nbmake, side by side, and hand their outputs to the book's cache.

    python tools/execute.py [--processes N]

Jupyter Book executes one notebook after the other and keeps their outputs in a cache (jupyter-cache). This script runs
before it: nbmake executes the notebooks that are not in the cache, on copies in build/executed, and the outputs go into
the cache, where the book finds all of them. So each notebook is executed once for the book and for the tests, without
the packages that only the book brings (notebooks/conftest.py refuses them).
"""

import argparse
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import nbformat
from jupyter_cache import get_cache
from jupyter_cache.base import CacheBundleIn, JupyterCacheAbstract
from myst_nb.core.read import read_myst_markdown_notebook
from sqlalchemy.exc import DatabaseError

from tools.fresh import BUILT, read_record, state

ROOT = Path(__file__).resolve().parent.parent
CACHE = f"{BUILT}/.jupyter_cache"
COPIES = "build/executed"
BY = "nbmake"
# Pages that judge every claim or run many plants; they come first, so that no process is left with one of them.
LONG = ("ledger", "artifact", "chain", "19-plants-that-others-chose", "22-what-to-turn", "24-theorem-4")


def pages(root: Path) -> Iterator[tuple[Path, nbformat.NotebookNode]]:
    """All pages with code: notebooks, and prose pages with code cells."""
    for path in sorted((root / "notebooks").glob("*.ipynb")):
        yield path, nbformat.read(path, as_version=4)
    for path in sorted((root / "book").glob("*.md")):
        text = path.read_text(encoding="utf-8")
        if "```{code-cell}" in text:
            yield path, read_myst_markdown_notebook(text, path=path)


def opened(root: Path) -> JupyterCacheAbstract:
    """The book's cache; one that cannot be read is removed, and begins anew."""
    try:
        cache = get_cache(root / CACHE)
        cache.list_cache_records()
    except DatabaseError as error:
        print(f"the cache of outputs must be a database, got: {error.orig}; it begins anew", flush=True)
        shutil.rmtree(root / CACHE)
        cache = get_cache(root / CACHE)
    return cache


def cached(cache: JupyterCacheAbstract, notebook: nbformat.NotebookNode) -> bool:
    """Whether the cache holds outputs of exactly these cells."""
    try:
        return cache.match_cache_notebook(notebook).data.get("by") == BY
    except KeyError:
        return False


def executed_for_the_book(root: Path, notebook: Path) -> bool:
    """Whether nbmake executed this notebook, as it is now, with the library as it is now."""
    if read_record(root).get("outputs") != state(root)["outputs"] or not (root / CACHE).is_dir():
        return False
    return cached(get_cache(root / CACHE), nbformat.read(notebook, as_version=4))


def with_outputs(notebook: nbformat.NotebookNode, executed: nbformat.NotebookNode) -> nbformat.NotebookNode:
    """The notebook with the outputs and the language of its executed copy, without the times."""
    notebook.metadata["language_info"] = executed.metadata["language_info"]
    for cell, done in zip(notebook.cells, executed.cells, strict=True):
        if cell.cell_type == "code":
            cell.outputs, cell.execution_count = done.outputs, done.execution_count
    return notebook


def main(root: Path, processes: int) -> int:
    """Execute what the cache does not hold; returns the exit status of the last failure."""
    cache = opened(root)
    copies = root / COPIES
    shutil.rmtree(copies, ignore_errors=True)
    shutil.copytree(root / "notebooks", copies / "notebooks", ignore=shutil.ignore_patterns("*.ipynb", ".*", "__*"))
    todo = {}
    for path, notebook in pages(root):
        if not cached(cache, notebook):
            todo[path] = copy = (copies / path.relative_to(root)).with_suffix(".ipynb")
            copy.parent.mkdir(exist_ok=True)
            nbformat.write(notebook, copy)
    print(f"executing {len(todo)} pages", flush=True)
    if not todo:
        return 0
    order = sorted(todo, key=lambda path: (path.stem not in LONG, path.name))
    options = ["-q", "--durations=8", "-p", "no:cacheprovider", "--nbmake", "--overwrite"]
    side_by_side = ["-n", str(processes), "--maxschedchunk", "1"]
    pytest = [sys.executable, "-m", "pytest", *options, *side_by_side]
    done = subprocess.run([*pytest, *(str(todo[path]) for path in order)], cwd=root, check=False)
    for path, notebook in pages(root):
        if path in todo and todo[path].exists():
            executed = nbformat.read(todo[path], as_version=4)
            code = [cell for cell in executed.cells if cell.cell_type == "code"]
            failed = any(output.output_type == "error" for cell in code for output in cell.outputs)
            if not failed and all(cell.execution_count for cell in code):
                bundle = CacheBundleIn(with_outputs(notebook, executed), str(path), data={"by": BY})
                cache.cache_notebook_bundle(bundle, overwrite=True)
    return done.returncode


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="execute the book's notebooks, side by side")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    sys.exit(main(ROOT, parser.parse_args().processes))
