"""Notebooks run here as for a reader: with what `pip install '.[paper]'` and Jupyter bring, and nothing of the book."""

import os
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from tools.execute import ROOT, executed_for_the_book

# What only the extras `book` and `test` bring, by the names under which it is imported.
REFUSED = frozenset(
    (
        *(
            "docutils",
            "jupyter_book",
            "jupyter_cache",
            "myst_nb",
            "myst_parser",
            "pydata_sphinx_theme",
            "sphinx",
        ),
        *(
            "sphinx_book_theme",
            "sphinx_mathjax_offline",
            "latex2mathml",
            "playwright",
            "axe_playwright_python",
            "pypdf",
            "bs4",
        ),
        *(
            "hypothesis",
            "_hypothesis_pytestplugin",
            "_hypothesis_ftz_detector",
            "mypy",
            "mypyc",
            "nbmake",
        ),
        *(
            "pytest",
            "_pytest",
            "py",
            "pytest_benchmark",
            "xdist",
            "ruff",
            "yaml",
            "_yaml",
        ),
    )
)

# Python runs a module of this name, where it finds one, before anything else.
SITECUSTOMIZE = f"""\
import sys


class Refuse:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name.partition(".")[0] in {sorted(REFUSED)}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)


sys.meta_path.insert(0, Refuse)
"""


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item):
    """Have the kernels that nbmake starts for these notebooks, and no other process, refuse those packages.

    A notebook that nbmake has executed for the book, as it is and with the library as it is, is not executed again.
    """
    if not item.config.option.overwrite and executed_for_the_book(ROOT, item.path):
        item.runtest = lambda: None
    with TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        Path(folder, "sitecustomize.py").write_text(SITECUSTOMIZE, encoding="utf-8")
        patch.setenv("PYTHONPATH", folder, prepend=os.pathsep)
        return (yield)
