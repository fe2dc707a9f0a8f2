"""Fix defects of the theme's templates in the text of every written page.

Each fix has a name; a fix that applies to no page fails the build, so that obsolete ones are removed.
"""

import re
from collections.abc import Collection
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx
from sphinx.errors import ExtensionError

MENDINGS = {
    # The icons come as fonts and, once more, as 1.5 MB of script; the fonts are enough.
    "icons as a script": (re.compile(r'\s*<script src="[^"]*vendor/fontawesome/[^"]*\.js[^"]*"></script>'), ""),
    # Brand icons are preloaded on every page, and the book shows none.
    "fonts preloaded and not used": (
        re.compile(r'\s*<link rel="preload"[^>]*fa-(?:brands|regular)-400\.woff2" ?/>'),
        "",
    ),
    # The index of modules folds its packages with a picture with the text "-".
    "a picture without words": (
        re.compile(r'(<img [^>]*class="toggler"[^>]*alt=)"-"'),
        r'\1"Fold or unfold this package."',
    ),
    # The search page has a second field with the id of the search button's field.
    "one id for two search fields": (
        re.compile(r'(<form class="bd-search[^>]*>(?:(?!</form>).)*id=")search-input(".*id="search-input")', re.DOTALL),
        r"\1search-input-hidden\2",
    ),
}


def mend(text: str) -> tuple[str, set[str]]:
    """The fixed page, and the names of the fixes that applied."""
    found = set()
    for name, (pattern, replacement) in MENDINGS.items():
        text, count = pattern.subn(replacement, text)
        if count:
            found.add(name)
    return text, found


def mend_pages(app: Sphinx, exception: Exception | None, written: Collection[str]) -> None:
    """Fix every page of the book, unless Sphinx has written none, because the last build's are current."""
    if exception or app.builder.name != "html" or not written:
        return
    found = set()
    for path in Path(app.outdir).rglob("*.html"):
        before = path.read_text(encoding="utf-8")
        after, names = mend(before)
        found |= names
        if after != before:
            path.write_text(after, encoding="utf-8")
    if missing := sorted(MENDINGS.keys() - found):
        raise ExtensionError(
            f"every fix must apply to a page, got none for these; remove them from lean_pages: {', '.join(missing)}"
        )


def setup(app: Sphinx) -> dict[str, bool]:
    """Register with Sphinx."""
    written: set[str] = set()

    def note(app: Sphinx, page: str, template: str, context: dict[str, Any], doctree: Any) -> None:
        written.add(page)

    app.connect("html-page-context", note)
    app.connect("build-finished", lambda app, exception: mend_pages(app, exception, written))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
