"""Make an EPUB of the built book, from the outputs and pages that the build has kept; nothing is executed again.

Sphinx writes the pages. What holds them together (package, contents) is written here, because Sphinx's own expects the
first page in the root folder, and does not declare that pages hold MathML.

    python tools/epub.py build/rhl-book.epub
"""

import datetime
import html
import os
import re
import shutil
import subprocess
import sys
import uuid
import zipfile
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parent.parent
BUILT = ROOT / "build/_build"
WORK = ROOT / "build/epub"
TYPES = {
    ".xhtml": "application/xhtml+xml",
    ".css": "text/css",
    ".svg": "image/svg+xml",
    ".png": "image/png",
    ".jpg": "image/jpeg",
}
CONTAINER = """<?xml version="1.0" encoding="UTF-8"?>
<container version="1.0" xmlns="urn:oasis:names:tc:opendocument:xmlns:container"><rootfiles>
<rootfile full-path="content.opf" media-type="application/oebps-package+xml"/></rootfiles></container>
"""


def title_of(page: str) -> str:
    """The title of a page, as XML."""
    found = re.search(r"<title>(.*?)</title>", page, flags=re.DOTALL)
    if found is None:
        raise ValueError("a page must have a title, found none")
    return found[1].strip()


def left_out() -> set[str]:
    """The pages that the configuration keeps out of the EPUB."""
    config = yaml.safe_load((ROOT / "_config.yml").read_text(encoding="utf-8"))
    return {name.removesuffix(".xhtml") for name in config["sphinx"]["config"]["epub_exclude_files"]}


def kept(toc: dict, without: set[str]) -> dict:
    """The contents of the book without some pages."""
    parts = [
        part | {"chapters": [chapter for chapter in part["chapters"] if chapter["file"] not in without]}
        for part in toc["parts"]
    ]
    return toc | {"parts": parts}


def contents(toc: dict, titles: dict[str, str]) -> str:
    """The contents as XHTML: the parts of the book and their pages, in order."""

    def entry(name: str) -> str:
        return f'<li><a href="{name}.xhtml">{titles[name]}</a></li>'

    parts = "".join(
        f"<li><span>{html.escape(part['caption'])}</span>"
        f"<ol>{''.join(entry(chapter['file']) for chapter in part['chapters'])}</ol></li>"
        for part in toc["parts"]
    )
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n<!DOCTYPE html>\n'
        '<html xmlns="http://www.w3.org/1999/xhtml" xmlns:epub="http://www.idpf.org/2007/ops" lang="en" xml:lang="en">'
        "<head><title>Contents</title></head><body>"
        f'<nav epub:type="toc"><h1>Contents</h1><ol>{entry(toc["root"])}{parts}</ol></nav></body></html>\n'
    )


def package(about: dict, files: dict[str, str], order: list[str], when: datetime.datetime) -> str:
    """The package as XML: `files` by name with what their pages hold ("mathml svg"), `order` the pages to be read."""
    ids = {name: f"file-{i}" for i, name in enumerate(files)}
    items = "".join(
        f'<item id="{ids[name]}" href="{name}" media-type="{TYPES[Path(name).suffix]}"'
        + (f' properties="{holds}"' if holds else "")
        + "/>"
        for name, holds in files.items()
    )
    spine = "".join(f'<itemref idref="{ids[name]}"/>' for name in order)
    key = uuid.uuid5(uuid.NAMESPACE_URL, f"{about['title']} {about['version']}")
    authors = "".join(f"<dc:creator>{html.escape(author['name'])}</dc:creator>" for author in about["authors"])
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        '<package xmlns="http://www.idpf.org/2007/opf" version="3.0" xml:lang="en" unique-identifier="key">'
        '<metadata xmlns:dc="http://purl.org/dc/elements/1.1/">'
        f'<dc:identifier id="key">urn:uuid:{key}</dc:identifier><dc:title>{html.escape(about["title"])}</dc:title>'
        f'<dc:language>en</dc:language>{authors}<meta property="dcterms:modified">{when:%Y-%m-%dT%H:%M:%SZ}</meta>'
        f"</metadata><manifest>{items}</manifest>"
        f"<spine>{spine}</spine></package>\n"
    )


def bind(pages: Path, toc: dict, about: dict, target: Path, when: datetime.datetime) -> None:
    """Put the pages that the contents name, and what they show, into one file."""
    names = [toc["root"], *(chapter["file"] for part in toc["parts"] for chapter in part["chapters"])]
    texts = {name: (pages / f"{name}.xhtml").read_text(encoding="utf-8") for name in names}
    # One of the style sheets of the pages imports another.
    used = {name for text in texts.values() for name in re.findall(r"[\w.-]+\.css", text)} | {"basic.css"}
    shown = sorted(
        path.relative_to(pages).as_posix()
        for path in pages.rglob("*")
        if path.suffix in TYPES
        and path.suffix != ".xhtml"
        and path.parent.name in ("_images", "_static")
        and (path.suffix != ".css" or path.name in used)
    )
    files = {"nav.xhtml": "nav"} | {
        f"{name}.xhtml": " ".join(kind for kind, mark in (("mathml", "<math"), ("svg", "<svg")) if mark in text)
        for name, text in texts.items()
    }
    files |= dict.fromkeys(shown, "")
    target.parent.mkdir(parents=True, exist_ok=True)
    begun = target.with_suffix(".begun")
    with zipfile.ZipFile(begun, "w", zipfile.ZIP_DEFLATED) as book:
        book.writestr(zipfile.ZipInfo("mimetype"), "application/epub+zip", zipfile.ZIP_STORED)

        def add(name: str, content: str | bytes) -> None:
            book.writestr(zipfile.ZipInfo(name), content, zipfile.ZIP_DEFLATED)  # no date, so that builds agree

        add("META-INF/container.xml", CONTAINER)
        add("content.opf", package(about, files, [f"{name}.xhtml" for name in names], when))
        add("nav.xhtml", contents(toc, {name: title_of(text) for name, text in texts.items()}))
        for name, text in texts.items():
            add(f"{name}.xhtml", text)
        for name in shown:
            add(name, (pages / name).read_bytes())
    begun.rename(target)


def main(target: Path) -> int:
    """Build in a separate folder, so that the site and what is kept of it do not change; returns an exit status."""
    if not (BUILT / "html/index.html").is_file():
        print("there is no book yet: type 'make book' first", file=sys.stderr)
        return 1
    shutil.rmtree(WORK, ignore_errors=True)
    for part in (".doctrees", ".jupyter_cache", "jupyter_execute"):
        if (BUILT / part).exists():
            shutil.copytree(BUILT / part, WORK / "_build" / part)
    options = ["--builder", "custom", "--custom-builder", "epub", "-W", "--keep-going"]
    command = ["jupyter-book", "build", ".", "--path-output", str(WORK), *options]
    done = subprocess.run(command, cwd=ROOT, check=False, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    if done.returncode:
        print(done.stdout, file=sys.stderr)
        return 1
    about = yaml.load((ROOT / "CITATION.cff").read_text(encoding="utf-8"), Loader=yaml.BaseLoader)
    toc = kept(yaml.safe_load((ROOT / "_toc.yml").read_text(encoding="utf-8")), left_out())
    seconds = os.environ.get("SOURCE_DATE_EPOCH") or (BUILT / "html/index.html").stat().st_mtime
    when = datetime.datetime.fromtimestamp(float(seconds), datetime.UTC)
    bind(WORK / "_build/epub", toc, about, target, when)
    shutil.rmtree(WORK)
    print(f"{target.stat().st_size / 1e6:.1f} MB {target}")
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
