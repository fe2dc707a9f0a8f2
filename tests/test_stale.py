"""A built book never shows what is out of date, and nothing faulty gets into it: seen on a small book.

The small book has the project's library, extensions, configuration and builder, and three pages of its own. It is built
by the command that the Makefile runs.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import ROOT

COPIED = ("rhl", "tools", "book/_ext", "book/_static", "book/references.bib", "_config.yml", "environment.lock")
COPIED = (*COPIED, "CITATION.cff")
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

    def write_notebook(self, code, text=TEXT):
        cells = [
            {"cell_type": "markdown", "id": "text", "metadata": {}, "source": text},
            {
                "cell_type": "code",
                "id": "code",
                "metadata": {},
                "source": code,
                "outputs": [],
                "execution_count": None,
            },
        ]
        kernel = {"kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"}}
        path = self.root / "notebooks/01-number.ipynb"
        path.parent.mkdir(exist_ok=True)
        path.write_text(json.dumps({"cells": cells, "metadata": kernel, "nbformat": 4, "nbformat_minor": 5}), "utf-8")

    def edit(self, name, change):
        path = self.root / name
        before = path.read_text(encoding="utf-8")
        after = change(before)
        assert after != before
        path.write_text(after, encoding="utf-8")

    def build(self):
        """Build it; returns the exit status and what was printed, without colours."""
        environment = os.environ | {
            "PATH": os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]),
            "PYTHONPATH": str(self.root),
            "EXECUTED": str(self.root.parent / f"{self.root.name}-executed"),
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

    def built(self):
        """Build it with success; returns how often the notebook was executed."""
        before = self.executions()
        status, said = self.build()
        assert status == 0, said
        return self.executions() - before

    def shows(self, page):
        return re.sub("<[^>]+>", "", (self.root / "build/_build/html" / page).read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def book(tmp_path_factory):
    """A small book that has been built, which the tests go on to edit."""
    small = Book(tmp_path_factory.mktemp("stale") / "book")
    assert small.built() == 1
    return small


def test_a_number_is_never_older_than_the_library_and_the_data(book):
    number, first = "notebooks/01-number.html", "book/index.html"
    assert "computes 0.143, and the sample is -9.900" in book.shows(number)
    assert "0.1428" in book.shows(first)

    assert book.built() == 0  # nothing has changed

    book.edit(
        "rhl/schedules.py", lambda text: text.replace("1.0 / (1.0 + self.rate * k)", "9.0 / (1.0 + self.rate * k)")
    )
    assert book.built() == 1
    assert "computes 1.286," in book.shows(number)
    assert "1.2857" in book.shows(first)

    book.edit("rhl/paper/data/linear_y.csv", lambda text: text.replace("0,-9.9", "0,-8.8"))
    assert book.built() == 1
    assert "sample is -8.800" in book.shows(number)

    book.edit("book/index.md", lambda text: text.replace("Words of", "Other words of"))
    assert book.built() == 0
    assert "Other words of the first page." in book.shows(first)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("name", "old", "new", "executions", "page"),
    [
        ("_config.yml", "search_bar_text: Search this book", "search_bar_text: Other words", 1, "book/index.html"),
        ("environment.lock", "# Everything the project runs on", "# Other words", 1, ""),
        ("_toc.yml", "caption: Numbers", "caption: Other words", 0, "book/index.html"),
        ("notebooks/01-number.ipynb", "# A number", "# Other words", 0, "notebooks/01-number.html"),
        ("notebooks/01-number.ipynb", "rate=2.0", "rate=4.0", 1, ""),
        ("book/_static/book.css", "", "/* Other words */", 0, "_static/book.css"),
        ("book/references.bib", "@", "@misc{other, title = {Other words}}\n\n@", 0, "book/index.html"),
        ("CITATION.cff", "version: ", "version: 9.9.9 # ", 0, "book/index.html"),
    ],
)
def test_an_edit_is_seen(book, name, old, new, executions, page):
    book.edit(name, lambda text: text.replace(old, new, 1))
    assert book.built() == executions
    if page:
        assert ("9.9.9" if name == "CITATION.cff" else "Other words") in book.shows(page)
    assert book.built() == 0


WRONG_CELL = "raise ValueError('this cell fails')"
WARNING_CELL = "import sys\n\nprint('a warning', file=sys.stderr)"
# By what is wrong: words for the first page, and what the build says of it.
WRONG_PAGE = {
    "a reference": ("See {ref}`no-such-label`.", "book/index.md:11: WARNING: undefined label: 'no-such-label'"),
    "a page": ("See [there](nowhere.md).", "book/index.md:11: WARNING: 'myst' cross-reference target not found"),
    "an anchor": ("See [there](api.md#no-such-part).", "book/index.md:11: WARNING: local id not found"),
    "a citation": ("See {cite:t}`nobody1900`.", 'book/index.md:11: WARNING: could not find bibtex key "nobody1900"'),
    "a picture": ("![A picture](nothing.svg)", "book/index.md:11: WARNING: image file not readable: book/nothing.svg"),
    "a role": ("$x$, $y({glue:text}`library:d`)$", "book/index shows {glue:text}`library:d`"),
}


def test_a_faulty_cell_fails_the_build(tmp_path):
    small = Book(tmp_path / "book")
    small.write_notebook(WRONG_CELL)
    status, said = small.build()
    assert status != 0
    assert "notebooks/01-number.ipynb" in said
    assert "this cell fails" in said
    small.write_notebook(f"{CODE}\n{WARNING_CELL}")
    status, said = small.build()
    assert status != 0
    assert "notebooks/01-number.ipynb" in said
    assert "stderr" in said


def test_faulty_words_fail_the_build(tmp_path):
    small = Book(tmp_path / "book")
    small.edit("book/index.md", lambda text: text + "\n" + " ".join(words for words, _ in WRONG_PAGE.values()) + "\n")
    status, said = small.build()
    assert status != 0
    assert [what for what, (_, message) in WRONG_PAGE.items() if message not in said] == [], said


@pytest.mark.nightly
@pytest.mark.parametrize("what", WRONG_PAGE)
def test_one_faulty_word_fails_the_build(tmp_path, what):
    words, message = WRONG_PAGE[what]
    small = Book(tmp_path / "book")
    small.edit("book/index.md", lambda text: f"{text}\n{words}\n")
    status, said = small.build()
    assert status != 0
    assert message in said
