"""Add rhl's own files, an interpreter and plants to the page on which readers run the scheme."""

import io
import json
import shutil
import zipfile
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

from rhl.paper import playground

ROOT = Path(__file__).resolve().parent.parent.parent
# The library without plotting, studies, claims and command line, which the page does not use.
PARTS = ("rhl/*.py", "rhl/kernels/*.py", "rhl/losses/*.py", "rhl/plants/*.py")
PAGE = "book/live"
SCRIPTS = ("explore/chart.js", "live/build.js", "live/page.js")


def library(root: Path) -> bytes:
    """An archive from which Python imports: the library's files, the driver, and the stand-in for numpy."""
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
    """The data for the page: the engine's version, "" without one, the bytes that a run loads, and the plants."""
    note = engine / "version"
    version = note.read_text(encoding="utf-8") if note.is_file() else ""
    loaded = sum(path.stat().st_size for path in engine.glob("*") if path != note) + more if version else 0
    plants = [{"name": of.name, "title": of.title, "fields": dict(of.fields)} for of in playground.presets()]
    binary = engine / "pyodide.asm.wasm"
    size = binary.stat().st_size if binary.is_file() else 0
    return {"engine": version, "bytes": loaded, "binary": size, "presets": plants}


def place(app: Sphinx) -> None:
    """Copy library, engine and plants to the place from which the page loads them."""
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
    # A script instead of JSON: a book opened from a folder may load scripts, but not fetch files.
    (live / "build.js").write_text(f"window.rhlLive = {told};\n", encoding="utf-8")


def add_scripts(app: Sphinx, page: str, template: str, context: dict[str, Any], doctree: Any) -> None:
    """Add the page's scripts to its head; other pages load none of them."""
    for script in SCRIPTS if page == PAGE else ():
        app.add_js_file(script, loading_method="defer")


def setup(app: Sphinx) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("builder-inited", place)
    app.connect("html-page-context", add_scripts)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
