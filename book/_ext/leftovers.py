"""Fail the build if a page shows a role of the sources unprocessed, such as {glue:text}`name`."""

import re
from pathlib import Path

from bs4 import BeautifulSoup
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError

ROLE = re.compile(r"\{[a-z:]+\}`[^`\n]{1,60}`|glue:[a-z]+")


def leftover_roles(page: str) -> list[str]:
    """The unprocessed roles in a page, outside of code and including formulas."""
    if not ROLE.search(page):
        return []
    article = BeautifulSoup(page, "html.parser").find("article")
    if article is None:
        return []
    for tag in article.select("pre, code, script, style"):
        tag.decompose()
    return ROLE.findall(article.get_text(" "))


def refuse(app: Sphinx, exception: Exception | None) -> None:
    """Check every page of the book."""
    if exception or app.builder.name != "html":
        return
    pages = {docname: Path(app.outdir, f"{docname}.html").read_text(encoding="utf-8") for docname in app.env.found_docs}
    found = [f"{docname} shows {role}" for docname in sorted(pages) for role in leftover_roles(pages[docname])]
    if found:
        raise ExtensionError(f"roles must be processed, but {'; '.join(found)}")


def setup(app: Sphinx) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("build-finished", refuse)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
