"""Add the prose of every page to the search page, in addition to Sphinx's index, for snippets and ranking.

Sphinx fetches each found page to show an excerpt. That needs a server, and the excerpt may be code.
"""

import json
from pathlib import Path
from typing import Any

from bs4 import BeautifulSoup, Tag
from sphinx.application import Sphinx

TEXTS = "search-texts.js"
# Elements of a page that are not prose.
NOT_PROSE = "pre, script, style, table, div.math, svg, figure, button, summary, .headerlink, .take-away, .trail, .tex"


def prose(page: str) -> dict[str, str]:
    """The prose of a page by the id of the section that holds it; the first, with the page's title, under ''."""
    article = BeautifulSoup(page, "html.parser").select_one("article.bd-article")
    if article is None:
        return {}
    for tag in article.select(NOT_PROSE):
        tag.decompose()
    found = {}
    # Innermost first, so that each section keeps only its own words.
    for section in reversed(article.select("section[id]")):
        found[str(section["id"])] = words(section)
        section.decompose()
    *below, top = found or {"": ""}
    return {"": found.get(top, words(article)), **{id: found[id] for id in reversed(below)}}


def words(tag: Tag) -> str:
    """The words of an element, with single blanks between its blocks and none inside a word."""
    for block in tag.select("p, li, h1, h2, h3, div, dd, dt"):
        block.insert_after(" ")
    return " ".join(tag.get_text().split())


def write_texts(app: Sphinx, exception: Exception | None) -> None:
    """Write the prose of all pages as a script: a book opened from a folder may load scripts, but not fetch files."""
    if exception or app.builder.name != "html":
        return
    texts = {
        docname: prose(Path(app.outdir, f"{docname}.html").read_text(encoding="utf-8"))
        for docname in sorted(app.env.found_docs)
    }
    written = f"const rhlTexts = {json.dumps(texts, ensure_ascii=False)};\n"
    Path(app.outdir, "_static", TEXTS).write_text(written, encoding="utf-8")


def add_scripts(app: Sphinx, page: str, template: str, context: dict[str, Any], doctree: Any) -> None:
    """Add the scripts to the head of the search page; they run before Sphinx's search."""
    if page == "search":
        app.add_js_file(TEXTS, loading_method="defer")
        app.add_js_file("search.js", loading_method="defer")


def setup(app: Sphinx) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("html-page-context", add_scripts)
    app.connect("build-finished", write_texts)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
