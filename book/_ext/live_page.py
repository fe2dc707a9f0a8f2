"""Bring the page on which readers run the scheme what it runs: rhl's own files, an interpreter, plants."""

import io
import json
import shutil
import zipfile
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

from rhl.paper import playground

ROOT = Path(__file__).resolve().parent.parent.parent
# The library without what draws, studies, checks the paper or is a command line, none of which runs in the page.
PARTS = ("rhl/*.py", "rhl/kernels/*.py", "rhl/losses/*.py", "rhl/plants/*.py")
PAGE = "book/live"
SCRIPTS = ("explore/chart.js", "live/build.js", "live/page.js")


def library(root: Path) -> bytes:
    """An archive from which Python imports: the library's files as they are, the driver, and what stands for numpy."""
    live = root / "book/_static/live"
    files = {path.relative_to(root).as_posix(): path for part in PARTS for path in root.glob(part)}
    files |= {f"numpy/{path.name}": path for path in (live / "stand_in").glob("*.py")}
    files["driver.py"] = live / "driver.py"
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, path in sorted(files.items()):
            entry = zipfile.ZipInfo(name)  # without a date, so that builds agree
            archive.writestr(entry, path.read_bytes(), zipfile.ZIP_DEFLATED)
    return packed.getvalue()


def description(engine: Path, more: int) -> dict[str, Any]:
    """What the page is told: the engine's version, "" without one, all bytes that a run loads, and the plants."""
    note = engine / "version"
    version = note.read_text(encoding="utf-8") if note.is_file() else ""
    loaded = sum(path.stat().st_size for path in engine.glob("*") if path != note) + more if version else 0
    plants = [{"name": of.name, "title": of.title, "fields": dict(of.fields)} for of in playground.presets()]
    return {"engine": version, "bytes": loaded, "presets": plants}


def place(app: Sphinx) -> None:
    """Put library, engine and plants where the page looks for them."""
    if app.builder.name != "html":
        return
    live, engine = Path(app.outdir, "_static", "live"), ROOT / "build" / "pyodide"
    live.mkdir(parents=True, exist_ok=True)
    packed = library(ROOT)
    (live / "library.zip").write_bytes(packed)
    shutil.rmtree(live / "engine", ignore_errors=True)
    if engine.is_dir():
        shutil.copytree(engine, live / "engine")
    worker = ROOT / "book/_static/live/worker.js"
    told = json.dumps(description(engine, worker.stat().st_size + len(packed)))
    # A script and not bare JSON: a book opened from a folder may load scripts, but a browser lets it fetch nothing.
    (live / "build.js").write_text(f"window.rhlLive = {told};\n", encoding="utf-8")


def add_scripts(app: Sphinx, page: str, template: str, context: dict[str, Any], doctree: Any) -> None:
    """Name the page's scripts in its head; other pages load none of them."""
    for script in SCRIPTS if page == PAGE else ():
        app.add_js_file(script, loading_method="defer")


def setup(app: Sphinx) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("builder-inited", place)
    app.connect("html-page-context", add_scripts)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
