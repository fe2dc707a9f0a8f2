"""A small book with the project's library, extensions, configuration and builder, and pages of its own."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

from tests.conftest import ROOT

COPIED = (
    "rhl",
    "tools",
    "book/_ext",
    "book/_static",
    "book/references.bib",
    "_config.yml",
    "environment.lock",
    "pyproject.toml",
    "CITATION.cff",
)
# What the page to explore needs takes long to compute, and the small book has no such page.
LONG = ("sweeps", "watch", "explored")
TOC = """format: jb-book
root: book/index
parts:
  - caption: Numbers
    chapters:
      - file: notebooks/01-number
      - file: book/api
"""
FIRST = """# A small book

[The number](../notebooks/01-number.ipynb) is:

```{glue} library
:doc: ../notebooks/01-number.ipynb
```

Words of the first page.
"""
LIBRARY = """# The library

```{eval-rst}
.. automodule:: rhl.plants.base
   :members:
```
"""
TEXT = "# A number\n\nThe library computes {glue:text}`library:.3f`, and the sample is {glue:text}`sample:.3f`."
CODE = """import os

from rhl.paper.pages import tell
from rhl.paper.published import curve
from rhl.schedules import PowerDecay

with open(os.environ["EXECUTED"], "a") as file:
    file.write("x")
tell(library=PowerDecay(rate=2.0)(3), sample=curve("linear_y")[0])
"""


def command():
    """What `make book` runs, without fetching the engine of the live page, which the small book does not have."""
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    recipe = re.search(r"^book:.*\n((?:\t.*\n)+)", makefile, flags=re.MULTILINE)[1]
    lines = [line.strip() for line in recipe.splitlines()]
    assert any("tools/fresh.py" in line for line in lines)
    return "\n".join(line for line in lines if "tools/engine.py" not in line)


class Book:
    """A small book in a folder of its own."""

    def __init__(self, root):
        self.root = root
        for name in COPIED:
            source, target = ROOT / name, root / name
            target.parent.mkdir(parents=True, exist_ok=True)
            (shutil.copytree if source.is_dir() else shutil.copy2)(source, target)
        for name in LONG:
            self.edit(f"rhl/paper/{name}.py", lambda text: text + "\n\ndef files():\n    return iter(())\n")
        for name, text in (("_toc.yml", TOC), ("book/index.md", FIRST), ("book/api.md", LIBRARY)):
            (root / name).write_text(text, encoding="utf-8")
        self.write_notebook(CODE)

    def write_notebook(self, code, text=TEXT, name="01-number"):
        code_cell = {"cell_type": "code", "id": "code", "metadata": {}, "source": code}
        notebook = {
            "cells": [
                {"cell_type": "markdown", "id": "text", "metadata": {}, "source": text},
                code_cell | {"outputs": [], "execution_count": None},
            ],
            "metadata": {"kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"}},
            "nbformat": 4,
            "nbformat_minor": 5,
        }
        path = self.root / f"notebooks/{name}.ipynb"
        path.parent.mkdir(exist_ok=True)
        path.write_text(json.dumps(notebook), encoding="utf-8")

    def edit(self, name, change):
        path = self.root / name
        before = path.read_text(encoding="utf-8")
        after = change(before)
        assert after != before
        path.write_text(after, encoding="utf-8")

    def build(self, **own):
        """Build it, with variables of its own; returns the exit status and what was printed, without colours."""
        environment = os.environ | {
            "PATH": os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]),
            "PYTHONPATH": str(self.root),
            "EXECUTED": str(self.root.parent / f"{self.root.name}-executed"),
            **own,
        }
        done = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", command()],
            cwd=self.root,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
            env=environment,
        )
        return done.returncode, re.sub(r"\x1b\[[0-9;]*m", "", done.stdout)

    def executions(self):
        counted = self.root.parent / f"{self.root.name}-executed"
        return len(counted.read_text()) if counted.exists() else 0

    def built(self, **own):
        """Build it with success; returns how often the notebook was executed."""
        before = self.executions()
        status, said = self.build(**own)
        assert status == 0, said
        return self.executions() - before

    def html(self, page):
        return (self.root / "build/_build/html" / page).read_text(encoding="utf-8")

    def shows(self, page):
        return re.sub("<[^>]+>", "", self.html(page))
