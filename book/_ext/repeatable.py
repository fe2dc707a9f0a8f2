"""Keep Sphinx's `.buildinfo` out of the site: it hashes paths of this machine, and builds in two folders would differ.

Sphinx compares it with the settings of the next build, so it is kept with the pages' sources and put back.
"""

from pathlib import Path

from sphinx.application import Sphinx

NAME = ".buildinfo"


def put_back(app: Sphinx) -> None:
    """Before Sphinx reads it."""
    kept = Path(app.doctreedir, NAME)
    if app.builder.name == "html" and kept.exists():
        kept.replace(Path(app.outdir, NAME))


def take_out(app: Sphinx, exception: Exception | None) -> None:
    """After everything else."""
    made = Path(app.outdir, NAME)
    if app.builder.name == "html" and made.exists():
        made.replace(Path(app.doctreedir, NAME))


def setup(app: Sphinx) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("builder-inited", put_back)
    app.connect("build-finished", take_out, priority=950)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
