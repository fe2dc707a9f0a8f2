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

import pytest

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
    """In the book itself what shows them must be there."""
    (tmp_path / "sitecustomize.py").write_text(refusing().SITECUSTOMIZE, encoding="utf-8")
    environment = {name: value for name, value in os.environ.items() if name != "RHL_BOOK"}
    environment |= {"PYTHONPATH": os.pathsep.join([str(tmp_path), str(ROOT)])} | ({"RHL_BOOK": "1"} if book else {})
    code = "from rhl.paper.pages import tell\ntell(largest=0.25, name='x')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, env=environment)
    if book:
        assert done.returncode == 1
        assert done.stderr.endswith("ModuleNotFoundError: No module named 'myst_nb'\n")
    else:
        assert (done.stderr, done.stdout) == ("", "largest = 0.25\nname = x\n")
