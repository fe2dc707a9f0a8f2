"""A built book never shows what is out of date, and nothing faulty gets into it: seen on a small book."""

import pytest

from tests.small_book import CODE, Book


@pytest.fixture(scope="module")
def book(tmp_path_factory):
    """A small book that has been built, which the tests go on to edit."""
    small = Book(tmp_path_factory.mktemp("stale") / "book")
    assert small.built() == 1
    return small


NUMBER, FIRST = "notebooks/01-number.html", "book/index.html"


def test_a_number_is_never_older_than_the_library(book):
    assert "computes 0.143, and the sample is -9.900" in book.shows(NUMBER)
    assert "0.1428" in book.shows(FIRST)
    book.edit(
        "rhl/schedules.py", lambda text: text.replace("1.0 / (1.0 + self.rate * k)", "9.0 / (1.0 + self.rate * k)")
    )
    assert book.built() == 1
    assert "computes 1.286," in book.shows(NUMBER)
    assert "1.2857" in book.shows(FIRST)


@pytest.mark.nightly
def test_a_number_is_never_older_than_the_data(book):
    assert book.built() == 0  # nothing has changed

    book.edit("rhl/paper/data/linear_y.csv", lambda text: text.replace("0,-9.9", "0,-8.8"))
    assert book.built() == 1
    assert "sample is -8.800" in book.shows(NUMBER)

    book.edit("book/index.md", lambda text: text.replace("Words of", "Other words of"))
    assert book.built() == 0
    assert "Other words of the first page." in book.shows(FIRST)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("name", "old", "new", "executions", "page"),
    [
        ("_config.yml", "search_bar_text: Search this book", "search_bar_text: Other words", 1, "book/index.html"),
        ("environment.lock", "# Everything the project runs on", "# Other words", 1, ""),
        ("pyproject.toml", "[project]", "# Other words\n[project]", 1, ""),
        ("tools/execute.py", "ROOT = ", "# Other words\nROOT = ", 1, ""),
        ("_toc.yml", "caption: Numbers", "caption: Other words", 0, "book/index.html"),
        ("notebooks/01-number.ipynb", "# A number", "# Other words", 0, "notebooks/01-number.html"),
        ("notebooks/01-number.ipynb", "rate=2.0", "rate=4.0", 1, ""),
        ("book/_static/book.css", "", "/* Other words */", 0, "_static/book.css"),
        ("book/references.bib", "@", "@misc{other, title = {Other words}}\n\n@", 0, "book/index.html"),
        ("CITATION.cff", "\nversion: ", "\nversion: 9.9.9 # ", 0, "book/index.html"),
    ],
)
def test_an_edit_is_seen(book, name, old, new, executions, page):
    book.edit(name, lambda text: text.replace(old, new, 1))
    assert book.built() == executions
    if page:
        assert ("9.9.9" if name == "CITATION.cff" else "Other words") in book.html(page)
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


def test_faulty_cells_fail_the_build(tmp_path):
    small = Book(tmp_path / "book")
    small.edit("_toc.yml", lambda text: text + "      - file: notebooks/02-number\n")
    small.write_notebook(WRONG_CELL)
    small.write_notebook(f"{CODE}\n{WARNING_CELL}", name="02-number")
    status, said = small.build()
    assert status != 0
    assert "this cell fails" in said
    assert "stderr" in said
    assert [f"notebooks/{name}.ipynb" in said for name in ("01-number", "02-number")] == [True, True]


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("code", "says"), [(WRONG_CELL, "this cell fails"), (f"{CODE}\n{WARNING_CELL}", "stderr")], ids=["error", "warning"]
)
def test_one_faulty_cell_fails_the_build(tmp_path, code, says):
    small = Book(tmp_path / "book")
    small.write_notebook(code)
    status, said = small.build()
    assert status != 0
    assert "notebooks/01-number.ipynb" in said
    assert says in said


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
