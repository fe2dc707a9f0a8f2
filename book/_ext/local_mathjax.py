"""Serve MathJax from the book itself: one file out of the pinned wheel, no request to any other host."""

import shutil
from importlib.metadata import distribution
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

# All of TeX input and the SVG output with its glyphs in one file, so that nothing is loaded after it.
SCRIPT = "mathjax/tex-svg-full.js"


def place_script(app: Sphinx) -> None:
    """Copy the script to where the pages look for it."""
    source = distribution("sphinx-mathjax-offline").locate_file(f"sphinx-mathjax-offline/static/{SCRIPT}")
    target = Path(app.outdir, "_static", SCRIPT)
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(str(source), target)


def spare_pages(app: Sphinx, page: str, template: str, context: dict[str, Any], doctree: Any) -> None:
    """Take the script from pages without formulas: Sphinx gives it to the first page for the sake of those below it."""
    if not app.env.get_domain("math").data["has_equations"].get(page):
        scripts = context["script_files"]
        scripts[:] = [script for script in scripts if not str(getattr(script, "filename", "")).endswith(SCRIPT)]


def setup(app: Sphinx) -> dict[str, bool]:
    """Register with Sphinx."""
    app.setup_extension("sphinx.ext.mathjax")
    app.config.mathjax_path = SCRIPT
    app.connect("builder-inited", place_script)
    app.connect("html-page-context", spare_pages, priority=900)  # after Sphinx's own, which has 500
    return {"parallel_read_safe": True, "parallel_write_safe": True}
