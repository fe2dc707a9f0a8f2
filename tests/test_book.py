"""The book as configured, and the book as built: each check is a function, and each is seen to find its fault."""

import json
import posixpath
import re
from itertools import pairwise
from urllib.parse import unquote, urlsplit

import pytest
import yaml
from bs4 import BeautifulSoup

from tests.conftest import HTML, ROOT, current_book

# ---------------------------------------------------------------- as configured


def entries(toc):
    """Every page of a table of contents in jb-book form."""
    chapters = [chapter for part in toc["parts"] for chapter in part["chapters"]]
    return [toc["root"], *(chapter["file"] for chapter in chapters)]


def toc_faults(toc, files):
    """Entries without a file, files without an entry, entries named twice; `files` are paths below the root."""
    named = entries(toc)
    pages = {posixpath.splitext(file)[0] for file in files}
    found = [f"{name} is in the table of contents and does not exist" for name in named if name not in pages]
    found += [f"{page} is not in the table of contents" for page in sorted(pages - set(named))]
    return found + [f"{a} is in the table of contents twice" for a, b in pairwise(sorted(named)) if a == b]


def config_faults(config):
    """Settings that would let a failure pass or a page ask another host."""
    execute, sphinx = config["execute"], config["sphinx"]["config"]
    demands = {
        "an error in a notebook must fail the build": execute["raise_on_error"] and not execute["allow_errors"],
        "notebooks must be executed": execute["execute_notebooks"] in ("cache", "force"),
        "MathJax must be local": "local_mathjax" in sphinx["extensions"] and "mathjax_path" not in sphinx,
        "sphinx_thebe loads a script from another host": "sphinx_thebe" not in sphinx["extensions"],
        "widget scripts come from other hosts": sphinx["nb_ipywidgets_js"] == {},
    }
    return [demand for demand, met in demands.items() if not met]


def notebook_faults(notebook):
    """What must not be committed: outputs, execution counts, a notebook that asserts nothing."""
    code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    found = ["has outputs" for cell in code if cell["outputs"]]
    found += ["has execution counts" for cell in code if cell["execution_count"] is not None]
    if not any(re.search(r"^\s*assert\b", "".join(cell["source"]), flags=re.MULTILINE) for cell in code):
        found.append("asserts nothing")
    return sorted(set(found))


def read_yaml(name):
    return yaml.safe_load((ROOT / name).read_text(encoding="utf-8"))


def test_toc():
    pages = [*ROOT.glob("book/**/*.md"), *ROOT.glob("notebooks/*.ipynb")]
    assert toc_faults(read_yaml("_toc.yml"), [page.relative_to(ROOT).as_posix() for page in pages]) == []


def test_toc_faults_are_found():
    toc = {"root": "index", "parts": [{"chapters": [{"file": "a"}, {"file": "b"}, {"file": "a"}]}]}
    assert toc_faults(toc, ["index.md", "a.md", "c.ipynb"]) == [
        "b is in the table of contents and does not exist",
        "c is not in the table of contents",
        "a is in the table of contents twice",
    ]


def test_config():
    assert config_faults(read_yaml("_config.yml")) == []


def test_config_faults_are_found():
    config = read_yaml("_config.yml")
    config["execute"] = {"execute_notebooks": "off", "raise_on_error": False, "allow_errors": True}
    config["sphinx"]["config"] |= {"extensions": ["sphinx_thebe"], "nb_ipywidgets_js": {"a.js": {}}}
    assert len(config_faults(config)) == 5


def test_no_folder_that_is_injected_into_every_page():
    assert not (ROOT / "_static").exists()


def test_notebooks():
    notebooks = {path.name: json.loads(path.read_text(encoding="utf-8")) for path in ROOT.glob("notebooks/*.ipynb")}
    assert {name: notebook_faults(notebook) for name, notebook in notebooks.items()} == {key: [] for key in notebooks}


def test_notebook_faults_are_found():
    cell = {"cell_type": "code", "source": ["# assert nothing\n"], "outputs": [{}], "execution_count": 3}
    assert notebook_faults({"cells": [cell]}) == ["asserts nothing", "has execution counts", "has outputs"]


# ---------------------------------------------------------------- as built

FETCHED = {  # what a browser fetches by itself, by tag
    "script": ("src",),
    "img": ("src", "srcset"),
    "iframe": ("src",),
    "source": ("src", "srcset"),
    "video": ("src", "poster"),
    "audio": ("src",),
    "embed": ("src",),
    "object": ("data",),
    "image": ("href", "xlink:href"),
    "use": ("href", "xlink:href"),
}
ELSEWHERE = re.compile(r"^\s*(https?:)?//", flags=re.IGNORECASE)
STYLE_FETCH = re.compile(r"""(?:@import\s*|url\(\s*)["']?\s*((?:https?:)?//[^"')\s]+)""", flags=re.IGNORECASE)


def outside_requests(page):
    """Addresses on other hosts that the page fetches, or that a script in it names."""
    found = [tag[key] for name, keys in FETCHED.items() for tag in page.find_all(name) for key in keys if tag.get(key)]
    found += [tag["href"] for tag in page.find_all("link", href=True) if "canonical" not in tag.get("rel", [])]
    found += [
        tag["content"].partition("=")[2]
        for tag in page.find_all("meta", attrs={"http-equiv": re.compile("(?i)refresh")})
    ]
    found = [address for address in found if ELSEWHERE.match(address)]
    for style in [
        *(tag.string or "" for tag in page.find_all("style")),
        *(tag["style"] for tag in page.select("[style]")),
    ]:
        found += STYLE_FETCH.findall(style)
    for script in page.find_all("script", src=False):
        found += re.findall(r"""["'`](?:https?:)?//[\w.-]+\.\w+[^"'`\s]*""", script.string or "")
    return found


def missing_alt(page):
    """Images in the article with no alternative text, or with a file name for one."""
    named = re.compile(r"\.(png|svg|jpe?g|gif|webp)\s*$|/|^[\w-]{20,}$", flags=re.IGNORECASE)
    images = [*page.select("article img"), *page.select("article svg[role=img]:not([aria-label])")]
    texts = [(str(image)[:120], (image.get("alt") or "").strip()) for image in images]
    return [image for image, alt in texts if not alt or named.search(alt)]


def raw_math(page):
    """TeX that reached the reader: outside code and outside what MathJax typesets."""
    article = page.find("article")
    if article is None:
        return []
    apart = {id(tag) for tag in article.select("pre, code, script, style, .math")}
    texts = [text for text in article.strings if not any(id(parent) in apart for parent in text.parents)]
    return re.findall(r"\$\$|\$[^$\n]{1,80}\$|\\begin\{\w+|\\\(|\\\[|Math input error", " ".join(texts))


def search_bars(page, name):
    """Search fields beyond the hidden one that the search button opens (and the one of the search page)."""
    fields = [form for form in page.select("form.bd-search") if not form.find_parent(class_="search-button__wrapper")]
    buttons = page.select(".bd-sidebar-primary .search-button-field")
    buttons += re.findall(
        "search-button-field", "".join(tag.string or "" for tag in page.select(".bd-sidebar-primary script"))
    )
    found = [f"{len(fields)} search fields"] if len(fields) > (name == "search.html") else []
    return found + ([f"{len(buttons)} search buttons"] if len(buttons) > 1 else [])


def not_executed(page, name):
    """A notebook's page without a single output, or one that shows a traceback."""
    found = []
    if name.startswith("notebooks/") and not page.select(".cell_output"):
        found.append("no output")
    # An example in a docstring may show the error that it raises.
    shown = (block.get_text() for block in page.select("pre") if not block.find_parent(class_="doctest"))
    if page.select(".output.traceback") or any(re.search(r"^Traceback \(most recent", text, re.M) for text in shown):
        found.append("a traceback")
    return found


def broken_links(pages, files):
    """Links inside the book whose page or anchor is not there; `pages` by name, `files` all names in the book."""
    anchors = {
        name: {tag["id"] for tag in page.select("[id]")} | {tag["name"] for tag in page.select("a[name]")}
        for name, page in pages.items()
    }
    found = []
    for name, page in pages.items():
        for tag in page.select("a[href], link[href], img[src], script[src]"):
            address = urlsplit(tag.get("href") or tag.get("src"))
            if address.scheme or address.netloc:
                continue
            target = (
                posixpath.normpath(posixpath.join(posixpath.dirname(name), unquote(address.path)))
                if address.path
                else name
            )
            if target not in files:
                found.append(f"{name}: {target} does not exist")
            elif address.fragment and target in anchors and unquote(address.fragment) not in anchors[target]:
                found.append(f"{name}: {target} has no #{address.fragment}")
    return found


def dead_names(page):
    """Names that were meant to be links and lead nowhere."""
    return [code.get_text() for code in page.select("article code.xref.py") if not code.find_parent("a")]


def trail_faults(pages):
    """Pages about a result whose statement, proof, source code or tests lead nowhere; `pages` by name."""
    found = []
    for name, page in pages.items():
        block = page.select_one(".statement[id^=stated-]")
        if block is None or not name.startswith("notebooks/"):
            continue
        words = [link.text.partition(" ")[0] for link in block.select(".trail a")]
        proof = page.select_one("section[id^=the-proof]")
        wanted = [*(["Proof"] if proof else []), "Checks", "Code", "Tests"]
        if words != wanted:
            found.append(f"{name}: the statement leads to {words}, not {wanted}")
        back = f"{name.rpartition('/')[2]}#{block['id']}"
        for link in block.select(".trail a"):
            target = link["href"].rpartition("../")[2].partition("#")[0]
            if link.text in ("Code", "Tests") and not pages[target].select(f".trail a[href$='{back}']"):
                found.append(f"{name}: {target} does not lead back")
        if proof and not proof.select(f":is(h2, h3) + .trail a[href$='#{block['id']}']"):
            found.append(f"{name}: the proof does not lead back")
    return found


def take_away_faults(pages, files):
    """Pages that were written, without a foot that gives their source, or their executed notebook, and BibTeX."""
    found = []
    for name, page in pages.items():
        stem = name.removesuffix(".html")
        if not any((ROOT / f"{stem}{ending}").exists() for ending in (".md", ".ipynb")):
            continue
        foot = page.select_one(".take-away")
        if foot is None or foot.a is None or foot.pre is None:
            found.append(f"{name}: it cannot be taken away")
            continue
        source = posixpath.normpath(posixpath.join(posixpath.dirname(name), foot.a["href"]))
        if source not in files:
            found.append(f"{name}: {source} does not exist")
        if source.endswith(".ipynb") != bool(page.select(".cell")):
            found.append(f"{name}: {source} is not what was executed")
        if "@software{rhl" not in foot.pre.text:
            found.append(f"{name}: it gives no BibTeX")
    return found


def faults(pages, files, toc):
    """Everything the checks find, as sentences that begin with the page."""
    found = [f"{page}.html is not built" for page in toc if f"{page}.html" not in files]
    for name, page in pages.items():
        found += [f"{name}: asks another host: {address}" for address in outside_requests(page)]
        found += [f"{name}: no alternative text: {image}" for image in missing_alt(page)]
        found += [f"{name}: TeX as text: {tex}" for tex in raw_math(page)]
        found += [f"{name}: {what}" for what in search_bars(page, name) + not_executed(page, name)]
        found += [f"{name}: {dead} is meant as a link and leads nowhere" for dead in dead_names(page)]
    return found + trail_faults(pages) + take_away_faults(pages, files) + broken_links(pages, files)


@pytest.fixture(scope="module")
def built():
    """(pages, files) of the built book; without an up-to-date one, skips, and in continuous integration fails."""
    current_book()
    files = {path.relative_to(HTML).as_posix(): path for path in HTML.rglob("*") if path.is_file()}
    pages = {
        name: BeautifulSoup(path.read_text(encoding="utf-8"), "html.parser")
        for name, path in files.items()
        if name.endswith(".html") and not name.startswith("_static/")
    }
    return pages, files


def test_built_book(built):
    pages, files = built
    assert sum(page.select_one(".statement[id^=stated-]") is not None for page in pages.values()) > 8
    assert sum(page.select_one(".take-away") is not None for page in pages.values()) > 20
    assert "\n".join(faults(pages, set(files), entries(read_yaml("_toc.yml")))) == ""


def test_built_styles_ask_no_other_host(built):
    styles = {name: path.read_text(encoding="utf-8") for name, path in built[1].items() if name.endswith(".css")}
    assert len(styles) > 3
    assert {name: STYLE_FETCH.findall(text) for name, text in styles.items()} == {key: [] for key in styles}


def test_built_book_brings_its_mathjax(built):
    pages, files = built
    typeset = [page for page in pages.values() if page.select(".math")]
    assert typeset
    assert all("_static/mathjax/" in str(page.find_all("script", src=True)) for page in typeset)
    assert sum(path.stat().st_size for name, path in files.items() if name.startswith("_static/mathjax/")) < 3e6


FAULTY = """
<link rel="stylesheet" href="//fonts.example.org/a.css"><link rel="canonical" href="https://book.example.org/">
<script src="https://cdn.example.org/a.js"></script><script>import("https://cdn.example.org/b.js")</script>
<style>@import "https://example.org/c.css"; p { background: url(//example.org/d.png) }</style>
<div class="bd-sidebar-primary"><p class="search-button-field"></p><script>"search-button-field"</script></div>
<div class="search-button__wrapper"><form class="bd-search"></form></div><form class="bd-search"></form>
<a href="b.html">b</a><a href="#nowhere">c</a><a href="#here">d</a><a href="https://example.org">e</a>
<article id="here"><img src="a.png"><img src="a.png" alt=""><img src="a.png" alt="_images/a.png">
<img src="a.png" alt="cbd69c2d1f9a6cf094aebd71f6fbe57f"><img src="a.png" alt="Two curves that coincide.">
<p>$$ x $x$ <code>$y$ \\(</code> \\begin{align}</p><span class="math">\\(z\\)</span>
<pre>Traceback (most recent call last):</pre></article>
"""


def test_faults_of_a_page_are_found():
    page = BeautifulSoup(FAULTY, "html.parser")
    assert len(outside_requests(page)) == 5
    assert len(missing_alt(page)) == 4
    assert raw_math(page) == ["$$", "$x$", "\\begin{align"]
    assert search_bars(page, "a.html") == ["1 search fields", "2 search buttons"]
    assert search_bars(page, "search.html") == ["2 search buttons"]
    assert not_executed(page, "notebooks/a.html") == ["no output", "a traceback"]
    assert broken_links({"a.html": page}, {"a.html", "a.png"}) == [
        "a.html: b.html does not exist",
        "a.html: a.html has no #nowhere",
    ]
    found = faults({"a.html": page}, {"a.html", "a.png"}, ["a", "missing"])
    assert found[0] == "missing.html is not built"
    assert len(found) == 1 + 5 + 4 + 3 + 2 + 1 + 2


def test_ways_that_lead_nowhere_are_found():
    here = """<div class="statement" id="stated-a">
    <p class="trail"><a href="../book/checks.html#test-a">Tests</a></p></div>
    <section id="the-proof"><h2>Proof</h2></section>"""
    pages = {
        "notebooks/a.html": BeautifulSoup(here, "html.parser"),
        "book/checks.html": BeautifulSoup("<p></p>", "html.parser"),
    }
    assert trail_faults(pages) == [
        "notebooks/a.html: the statement leads to ['Tests'], not ['Proof', 'Checks', 'Code', 'Tests']",
        "notebooks/a.html: book/checks.html does not lead back",
        "notebooks/a.html: the proof does not lead back",
    ]


def test_a_page_that_cannot_be_taken_away_is_found():
    foot = '<p class="take-away"><a href="{}">source</a></p><p class="take-away"></p>'
    whole = '<div class="take-away"><a href="{}">source</a><pre>{}</pre></div>{}'
    pages = {
        "book/cli.html": whole.format("../_sources/cli.md", "@software{rhl,", ""),
        "book/api.html": foot.format("../_sources/api.md"),
        "book/ledger.html": whole.format("../_sources/ledger.md", "@software{rhl,", '<div class="cell"></div>'),
        "notebooks/10-lemma-5.html": whole.format("../_sources/missing.md", "", ""),
        "genindex.html": "",
    }
    parsed = {name: BeautifulSoup(text, "html.parser") for name, text in pages.items()}
    assert take_away_faults(parsed, {"_sources/cli.md", "_sources/api.md", "_sources/ledger.md"}) == [
        "book/api.html: it cannot be taken away",
        "book/ledger.html: _sources/ledger.md is not what was executed",
        "notebooks/10-lemma-5.html: _sources/missing.md does not exist",
        "notebooks/10-lemma-5.html: it gives no BibTeX",
    ]


def test_a_name_that_leads_nowhere_is_found():
    page = '<article><code class="xref py">a</code><a><code class="xref py">b</code></a><code>c</code></article>'
    assert dead_names(BeautifulSoup(page, "html.parser")) == ["a"]


def test_faults_of_a_style_are_found():
    text = "@import url('https://a.example.org/x.css'); p { background: url(b.png), url(data:image/png;base64,//8=) }"
    assert STYLE_FETCH.findall(text) == ["https://a.example.org/x.css"]


def test_book_without_faults():
    page = BeautifulSoup(
        '<article><img src="a.png" alt="Two curves."><span class="math">\\(x\\)</span></article>', "html.parser"
    )
    assert faults({"a.html": page}, {"a.html", "a.png"}, ["a"]) == []
