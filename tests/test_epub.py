"""The EPUB: what becomes of a page, how pages are bound, and the whole book."""

import datetime
import io
import os
import posixpath
import re
import subprocess
import sys
import zipfile
from xml.etree import ElementTree

import pytest
import yaml

from tests.conftest import ROOT, current_book
from tools import epub

sys.path.insert(0, str(ROOT / "book/_ext"))

import epub_pages

BODY = """<p>One<br>two &amp; three<img src="a.png" alt="A picture that is shown."></p>
<img class="only-dark" src="b.png"><script>x</script><a class="headerlink" href="#x">#</a>
<details class="hide"><summary><p class="collapsed">Show code</p></summary><pre>code</pre></details>
<a href="../notebooks/b.html#there">there</a> <a href="../_modules/c.html">code</a> <a href="https://a.org/">out</a>
<svg viewbox="0 0 1 1"><clippath id="c"></clippath></svg>"""
WHEN = datetime.datetime(2026, 1, 2, tzinfo=datetime.UTC)
TOC = {"root": "book/a", "parts": [{"caption": "A & B", "chapters": [{"file": "notebooks/b"}]}]}
ABOUT = {"title": "A title", "version": "1", "authors": [{"name": "Some one"}]}


def faults(content: bytes) -> list[str]:
    """What is wrong with an EPUB: parts that are no XML, raw TeX, links that lead nowhere, repeated ids."""
    found = []
    with zipfile.ZipFile(io.BytesIO(content)) as book:
        names = book.namelist()
        if names[0] != "mimetype" or book.read("mimetype") != b"application/epub+zip":
            found.append("the first part must be the mimetype")
        pages = {name: book.read(name).decode() for name in names if name.endswith((".xhtml", ".opf"))}
    ids = {}
    for name, text in pages.items():
        try:
            tree = ElementTree.fromstring(text)
        except ElementTree.ParseError as error:
            found.append(f"{name} is no XML: {error}")
            continue
        of_page = [element.get("id") for element in tree.iter() if element.get("id")]
        found += [f"{name} has two of #{id}" for id in sorted({id for id in of_page if of_page.count(id) > 1})]
        ids[name] = of_page
        found += [f"{name} shows TeX" for mark in (r"\(", r"\[") if mark in "".join(tree.itertext())]
    for name, text in pages.items():
        for _, address, anchor in re.findall(r'<(?:a|img|item) [^>]*?\b(href|src)="([^"#]*)#?([^"]*)"', text):
            if ":" in address:
                continue
            target = posixpath.normpath(posixpath.join(posixpath.dirname(name), address)) if address else name
            if target not in names or (anchor and anchor not in ids.get(target, [])):
                found.append(f"{name} leads to {address}#{anchor}")
    return found


def bound(tmp_path, **pages):
    """An EPUB of two small pages, whose bodies may be given by name."""
    for name in ("book/a", "notebooks/b"):
        body = pages.get(name[-1], f"<p>{name}</p>")
        path = tmp_path / "pages" / f"{name}.xhtml"
        path.parent.mkdir(parents=True, exist_ok=True)
        page = (
            f'<html xmlns="http://www.w3.org/1999/xhtml"><head><title>{name}</title></head><body>{body}</body></html>'
        )
        path.write_text(page, encoding="utf-8")
    epub.bind(tmp_path / "pages", TOC, ABOUT, tmp_path / "out/book.epub", WHEN)
    return (tmp_path / "out/book.epub").read_bytes()


def test_a_page_becomes_xml_without_what_only_the_site_can_show():
    made = epub_pages.well_formed(BODY, "book/a", {"book/a", "notebooks/b"})
    tree = ElementTree.fromstring(f"<body>{made}</body>")
    assert len(tree.findall(".//img")) == 1
    assert [link.get("href") for link in tree.iter("a")] == ["../notebooks/b.xhtml#there", "https://a.org/"]
    assert "Code" in "".join(tree.itertext())
    assert "Show code" not in "".join(tree.itertext())
    assert 'viewBox="0 0 1 1"' in made
    assert "<clipPath" in made


def test_pages_are_bound_in_order_with_contents(tmp_path):
    content = bound(tmp_path, a='<p><math xmlns="http://www.w3.org/1998/Math/MathML"><mi>x</mi></math></p>')
    assert faults(content) == []
    with zipfile.ZipFile(io.BytesIO(content)) as book:
        package, contents = (book.read(name).decode() for name in ("content.opf", "nav.xhtml"))
    assert 'href="book/a.xhtml" media-type="application/xhtml+xml" properties="mathml"' in package
    assert package.index("<spine><itemref idref=") < package.index("</spine>")
    assert [link[1] for link in re.finditer(r">([^<]*)</a>", contents)] == ["book/a", "notebooks/b"]
    assert "A &amp; B" in contents
    assert content == bound(tmp_path, a='<p><math xmlns="http://www.w3.org/1998/Math/MathML"><mi>x</mi></math></p>')


@pytest.mark.parametrize(
    ("body", "fault"),
    [
        ("<p>", "is no XML"),
        (r"<p>\(x\)</p>", "shows TeX"),
        ('<p><a href="c.xhtml">c</a></p>', "leads to c.xhtml#"),
        ('<p id="x"/><p id="x"/>', "has two of #x"),
    ],
)
def test_faults_of_an_epub_are_found(tmp_path, body, fault):
    (found,) = faults(bound(tmp_path, a=body))
    assert fault in found


@pytest.mark.nightly
def test_the_whole_book(tmp_path):
    current_book()
    done = subprocess.run(
        [sys.executable, "tools/epub.py", str(tmp_path / "book.epub")],
        cwd=ROOT,
        env=os.environ | {"RHL_BOOK": "1", "PATH": f"{ROOT / '.venv/bin'}:{os.environ['PATH']}"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    content = (tmp_path / "book.epub").read_bytes()
    assert faults(content) == []
    assert len(content) < 6_000_000
    with zipfile.ZipFile(io.BytesIO(content)) as book:
        names = set(book.namelist())
        page = book.read("notebooks/09-lemma-4.xhtml").decode()
    toc = yaml.safe_load((ROOT / "_toc.yml").read_text(encoding="utf-8"))
    pages = {chapter["file"] for part in toc["parts"] for chapter in part["chapters"]}
    assert epub.left_out() == {"book/explore", "book/live"} < pages
    assert {f"{name}.xhtml" for name in pages - epub.left_out()} < names
    assert not {f"{name}.xhtml" for name in epub.left_out()} & names
    assert page.count("<math") > 100
    assert "only-dark" not in page


def test_without_a_book_one_line_says_so(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(epub, "BUILT", tmp_path)
    assert epub.main(tmp_path / "book.epub") == 1
    assert capsys.readouterr().err == "there is no book yet: type 'make book' first\n"
