"""Add data and scripts to the pages with sliders; the data are computed with `rhl` during the build."""

import shutil
from itertools import chain
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

from rhl import plotting
from rhl.paper import explored, sweeps, watch

# The scripts of book/_static/explore by page; other pages load none of them.
SCRIPTS = {
    "book/index": ("opening.js", "chart.js", "watch.js"),
    "book/explore": ("chart.js", "runs.js", "beside.js", "lemmas.js"),
    "book/chain": ("chain.js",),
    "book/ledger": ("ledger.js",),
}


def compute(folder: Path) -> None:
    """Fill the folder with the files of `rhl.paper.sweeps`, `watch` and `explored`; it appears whole or not at all."""
    begun = folder.with_name(f"{folder.name}.begun")
    shutil.rmtree(begun, ignore_errors=True)
    begun.mkdir(parents=True)
    for name, content in chain(sweeps.files(), watch.files(), explored.files()):
        # Scripts instead of JSON: a book opened from a folder may load scripts, but not fetch files.
        (begun / f"{name}.js").write_text(f'rhlExplore.take("{name}",{content})\n', encoding="utf-8")
    begun.rename(folder)


def place(app: Sphinx) -> None:
    """Copy data and colours to the place from which the pages load them.

    The data are cached next to the book; tools/fresh.py removes them, like outputs of notebooks, when `rhl/` changes.
    """
    if app.builder.name != "html":
        return
    kept = Path(app.outdir).parent / "explore"
    if not kept.exists():
        compute(kept)
    static = Path(app.outdir, "_static")
    shutil.copytree(kept, static / "explore" / "data", dirs_exist_ok=True)
    (static / "colours.css").write_text(plotting.css(), encoding="utf-8")


def add_scripts(app: Sphinx, page: str, template: str, context: dict[str, Any], doctree: Any) -> None:
    """Add a page's scripts to its head."""
    for script in SCRIPTS.get(page, ()):
        app.add_js_file(f"explore/{script}", loading_method="defer")


def setup(app: Sphinx) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("builder-inited", place)
    app.connect("html-page-context", add_scripts)
    app.add_css_file("colours.css")
    return {"parallel_read_safe": True, "parallel_write_safe": True}
