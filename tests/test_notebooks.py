"""Notebooks are executed without what only the book brings, and what refuses it is seen to do so."""

import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import nbformat
import pytest
from jupyter_cache import get_cache
from myst_nb.ext.glue import extract_glue_data_cell

from tools import execute, fresh

ROOT = Path(__file__).resolve().parent.parent
CONFTEST = ROOT / "notebooks/conftest.py"
# Of the extras `book` and `test`, what Jupyter, matplotlib or sympy bring too.
OTHERS_BRING = {"ipykernel", "ipykernel_launcher", "jsonschema", "mpmath", "packaging"}


def refusing():
    spec = importlib.util.spec_from_file_location("notebooks_conftest", CONFTEST)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def notebook(path, code):
    cell = {"cell_type": "code", "id": "a", "metadata": {}, "source": code, "outputs": [], "execution_count": None}
    kernel = {"kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"}}
    path.write_text(json.dumps({"cells": [cell], "metadata": kernel, "nbformat": 4, "nbformat_minor": 5}), "utf-8")


def test_all_that_the_extras_bring_is_refused():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    asked = {re.split(r"[<>=\[]", line)[0] for extra in ("book", "test") for line in extras[extra]} - {"rhl"}
    modules = {
        module
        for module, brought_by in packages_distributions().items()
        if {name.lower().replace("_", "-") for name in brought_by} & asked and re.fullmatch("[a-z]\\w*", module)
    }
    assert {"myst_nb", "pytest", "ipykernel", "yaml"} <= modules
    assert modules - OTHERS_BRING - refusing().REFUSED == set()
    assert not refusing().REFUSED & OTHERS_BRING


def executed(folder):
    """What pytest says of the notebooks of a folder, where they would be part of the book."""
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "--nbmake", "-p", "no:cacheprovider", "-rA", f"--rootdir={folder}", folder],
        capture_output=True,
        text=True,
        check=False,
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT), "RHL_BOOK": "1"},
    )
    return done.stdout


def test_a_notebook_that_needs_the_book_fails(tmp_path):
    shutil.copy(CONFTEST, tmp_path)
    notebook(tmp_path / "needs.ipynb", "import myst_nb")
    notebook(tmp_path / "tells.ipynb", "from rhl.paper.pages import tell\ntell(a=1)")
    said = executed(tmp_path)
    assert "1 failed, 1 passed" in said
    assert "No module named 'myst_nb'" in said


@pytest.mark.parametrize("book", [False, True])
def test_numbers_are_told_without_the_book(tmp_path, book):
    """Python alone prints them; the page that is executed for the book hands them to its prose, without myst_nb."""
    shutil.copy(CONFTEST, tmp_path)
    environment = {name: value for name, value in os.environ.items() if name != "RHL_BOOK"}
    environment |= {"PYTHONPATH": str(ROOT)} | ({"RHL_BOOK": "1"} if book else {})
    notebook(tmp_path / "tells.ipynb", "from rhl.paper.pages import tell\ntell(largest=0.25, name='x')")
    options = ["--nbmake", "--overwrite", "-q", "-p", "no:cacheprovider", f"--rootdir={tmp_path}"]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *options, tmp_path], capture_output=True, check=False, env=environment
    )
    assert done.returncode == 0
    executed = nbformat.read(tmp_path / "tells.ipynb", as_version=4)
    (cell,) = executed.cells
    if book:
        values = {name: output["data"]["text/plain"] for name, output in extract_glue_data_cell(cell)}
        assert values == {"largest": "0.25", "name": "'x'"}
    else:
        assert [output.text for output in cell.outputs] == ["largest = 0.25\nname = x\n"]


def test_a_notebook_is_executed_once_for_the_book_and_the_tests(tmp_path):
    """Its outputs are in the book's cache; a changed cell, or a changed library, has none there."""
    for name, text in (("rhl/a.py", "a = 1"), ("environment.lock", ""), ("_config.yml", "")):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    (tmp_path / "notebooks").mkdir()
    (tmp_path / "book").mkdir()
    path = tmp_path / "notebooks" / "one.ipynb"
    notebook(path, "print(1 + 1)")
    fresh.drop_stale(tmp_path)
    assert not execute.executed_for_the_book(tmp_path, path)
    assert execute.main(tmp_path, 1) == 0
    assert execute.executed_for_the_book(tmp_path, path)
    assert "2" in str(get_cache(tmp_path / execute.CACHE).merge_match_into_notebook(nbformat.read(path, 4))[1])
    (tmp_path / "rhl/a.py").write_text("a = 2")
    assert not execute.executed_for_the_book(tmp_path, path)
    (tmp_path / "rhl/a.py").write_text("a = 1")
    notebook(path, "print(1 + 2)")
    assert not execute.executed_for_the_book(tmp_path, path)


def test_a_cache_that_cannot_be_read_begins_anew(tmp_path, capsys):
    (tmp_path / execute.CACHE).mkdir(parents=True)
    (tmp_path / execute.CACHE / "global.db").write_bytes(b"no database" * 100)
    assert execute.opened(tmp_path).list_cache_records() == []
    assert "the cache of outputs must be a database, got: file is not a database" in capsys.readouterr().out


def test_a_failing_notebook_is_not_kept(tmp_path):
    for name in ("notebooks", "book"):
        (tmp_path / name).mkdir()
    path = tmp_path / "notebooks" / "fails.ipynb"
    notebook(path, "assert 1 + 1 == 3")
    fresh.drop_stale(tmp_path)
    assert execute.main(tmp_path, 1) != 0
    assert not execute.executed_for_the_book(tmp_path, path)
