"""What the EPUB needs and the site does not: pages of well-formed XML, one picture where the site has two."""

import posixpath
import re
from collections.abc import Collection
from typing import Any

from bs4 import BeautifulSoup
from sphinx.application import Sphinx

# For the dark theme, for scripts, or for a pointer; an EPUB has none of them.
ONLY_ON_THE_SITE = (
    ".only-dark, script, noscript, style, button, .rhl-explore, .rhl-live, .rhl-filter, .chain-choice, .headerlink, "
    "animatetransform, .viewcode-link, .viewcode-back, .sd-octicon, .sd-summary-state-marker"
)
# HTML does not tell small letters from capitals in names of attributes and elements, and XML does.
CAPITALS = ("viewBox", "markerWidth", "markerHeight", "refX", "refY", "patternUnits", "patternTransform", "clipPath")


def well_formed(body: str, page: str, pages: Collection[str]) -> str:
    """Return the body of a page as XML, without what only the site can show; parts that fold are open.

    `pages` are those of the EPUB; what leads elsewhere, such as to source code, is no link there.
    """
    soup = BeautifulSoup(body, "html.parser")
    for tag in soup.select(ONLY_ON_THE_SITE):
        tag.decompose()
    for tag in soup.select("details"):
        tag["open"] = "open"
    for tag in soup.select("summary p"):
        tag.unwrap()
    for tag in soup.select("details.hide > summary"):
        tag.string = "Code"
    for tag in soup.select("svg"):
        tag["xmlns"] = "http://www.w3.org/2000/svg"
        tag["role"] = "img"
    for tag in soup.select("a[href]"):
        address, _, anchor = str(tag["href"]).partition("#")
        if not address or ":" in address:
            continue
        name, suffix = posixpath.splitext(posixpath.normpath(posixpath.join(posixpath.dirname(page), address)))
        if suffix in (".html", ".xhtml") and name in pages:
            seen = posixpath.relpath(name, posixpath.dirname(page))
            tag["href"] = f"{seen}.xhtml" + (f"#{anchor}" if anchor else "")
        else:
            tag.unwrap()
    made = soup.decode(formatter="minimal")
    for name in CAPITALS:
        made = re.sub(rf"(?<=\s){name.lower()}(?==)|(?<=<){name.lower()}\b|(?<=</){name.lower()}\b", name, made)
    return made


def prepare(app: Sphinx, page: str, template: str, context: dict[str, Any], doctree: Any) -> None:
    """Make every page of the EPUB so, and load no other style sheets than the EPUB's."""
    if app.builder.name != "epub":
        return
    left_out = {name.removesuffix(".xhtml") for name in app.config.epub_exclude_files}
    if "body" in context:
        context["body"] = well_formed(context["body"], page, app.env.found_docs - left_out)
    own = ("epub.css", "pygments.css", "book-epub.css")
    context["css_files"] = [file for file in context["css_files"] if str(file.filename).rpartition("/")[2] in own]
    context["script_files"] = []


def leave_out(app: Sphinx) -> None:
    """Take along a style sheet of the EPUB's own, and nothing else of what the site's pages load."""
    if app.builder.name == "epub":
        app.config.html_static_path = ["book/_epub"]
        app.config.html_copy_source = False


def setup(app: Sphinx) -> dict[str, bool]:
    """Register with Sphinx; last, since other extensions add to the body."""
    app.connect("builder-inited", leave_out)
    app.connect("html-page-context", prepare, priority=950)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
