"""The printed book: what becomes of a page, and a whole small book through Chromium."""

import shutil
import subprocess
import sys

import pytest
from bs4 import BeautifulSoup
from pypdf import PdfReader

from tests.conftest import ROOT, needed
from tools import print as printing

PAGE = """<html lang="en"><head><title>A</title></head><body><article class="bd-article"><section id="top">
<h1>Title {name}<a class="headerlink" href="#top">#</a></h1>
<p id="here"><a href="#here">here</a> <a href="b.html#there">there</a> <a href="../_modules/x.html">code</a>
<a href="https://example.org/">out</a></p>
<details><summary>Fold</summary><p>Folded words.</p></details><div class="prev-next-footer">next</div>
<section id="there"><h2>Section of {name}</h2></section></section></article></body></html>"""


def test_article_stands_in_one_document_with_others():
    found = printing.article("book/a", PAGE.format(name="a"), {"book/a", "book/b"})
    assert found["id"] == "book-a"
    assert found.select_one("p")["id"] == "book-a--here"
    assert [link["href"] for link in found.select("a")] == ["#book-a--here", "#book-b--there", "https://example.org/"]
    assert "code" in found.text
    assert found.details.has_attr("open")
    assert not found.select(".headerlink, .prev-next-footer")


def test_a_page_without_an_article_is_refused():
    with pytest.raises(ValueError, match=r"^book/a\.html must have an article, found none$"):
        printing.article("book/a", "<p>", set())


def test_the_head_is_of_a_page_with_formulas():
    plain = PAGE.format(name="a")
    formulas = plain.replace("</head>", '<script src="../_static/mathjax/tex.js"></script></head>')
    assert printing.head_of({"a": plain, "b": formulas}).script["src"].endswith("tex.js")
    assert printing.head_of({"a": plain, "b": plain}).script is None
    with pytest.raises(ValueError, match=r"^b\.html must have a head, found none$"):
        printing.head_of({"a": plain, "b": "<p>"})


def test_contents():
    toc = {"root": "book/a", "parts": [{"caption": "Part", "chapters": [{"file": "book/b"}]}]}
    articles = {name: printing.article(name, PAGE.format(name=name), set()) for name in ("book/a", "book/b")}
    entries = printing.contents(toc, articles)
    assert [(entry.anchor, entry.depth) for entry in entries] == [
        ("book-a", 1),
        ("book-a--there", 2),
        ("book-b", 0),
        ("book-b", 1),
        ("book-b--there", 2),
    ]
    page = BeautifulSoup(printing.contents_page(entries, {"book-b": 7}), "html.parser")
    assert [number.text for number in page.select("b")] == ["0", "0", "7", "0"]


@pytest.fixture
def small(tmp_path):
    """A built book of two pages, with the tool that prints it."""
    shutil.copytree(ROOT / "tools", tmp_path / "tools", ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "_toc.yml").write_text("root: book/a\nparts: [{caption: P, chapters: [{file: book/b}]}]\n")
    (tmp_path / "_config.yml").write_text("title: 'Small: a book'\nauthor: A. Uthor\ncopyright: '2026'\n")
    html = tmp_path / "build/_build/html"
    (html / "book").mkdir(parents=True)
    shutil.copytree(ROOT / "book/_static", html / "_static")
    for name in "ab":
        (html / f"book/{name}.html").write_text(PAGE.format(name=name))
    return tmp_path


def run(root):
    """Print the book below `root`."""
    command = [sys.executable, "tools/print.py", "build/small.pdf"]
    return subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)


def test_a_small_book_in_chromium(small):
    if printing.chromium() is None:
        needed("no Chromium; `apt-get install chromium` brings one")
    done = run(small)
    assert done.returncode == 0, done.stderr
    reader = PdfReader(small / "build/small.pdf")
    texts = [page.extract_text() for page in reader.pages]
    assert len(texts) == 4
    assert "Small" in texts[0]
    assert "Title b" in texts[1]
    assert [line.split()[-1] for line in texts[1].splitlines() if "Title" in line] == ["3", "4"]
    assert "Folded words." in texts[2]
    assert texts[3].split()[-1] == "4"
    titles = [entry["/Title"] for entry in reader.outline if not isinstance(entry, list)]
    assert titles[-2:] == ["Title a", "Title b"]


def test_a_printed_book_asks_no_other_host(small):
    if printing.chromium() is None:
        needed("no Chromium; `apt-get install chromium` brings one")
    page = small / "build/_build/html/book/b.html"
    page.write_text(page.read_text().replace("<details>", '<img src="https://example.invalid/a.png"><details>'))
    done = run(small)
    assert done.returncode != 0
    assert "must need its own files only, got requests for https://example.invalid/a.png" in done.stderr


def test_without_a_book_it_says_so(small):
    shutil.rmtree(small / "build")
    done = run(small)
    assert (done.returncode, done.stderr.strip()) == (1, "there is no book yet; run 'make book' first")
