"""Print the built book as one PDF: a title page, contents with page numbers, every page in order, bookmarks.

All pages are put into one document, so that links between them become links inside the PDF, and Chromium prints it
twice: once to find the sheet of each heading, once with these numbers in the contents. Nothing is fetched from other
hosts; the browser gets the book's own files on request.

    python tools/print.py build/rhl.pdf
"""

import html
import io
import posixpath
import shutil
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote, urlsplit

import yaml
from bs4 import BeautifulSoup, Tag
from playwright.sync_api import Page, Route, sync_playwright
from pypdf import PdfReader

HOST = "http://book.invalid/"
# Elements without use on paper.
CLUTTER = ".headerlink, .prev-next-footer, .take-away, .only-dark, .viewcode-link, script, button, .copybtn"
COLUMN = 660  # pixels between the margins of A4 as set in print.css
FOOTER = (
    '<div style="width:100%;font:8pt sans-serif;text-align:center;color:#555"><span class="pageNumber"></span></div>'
)


def chromium() -> str | None:
    """The path of Chromium; None if there is none."""
    return next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


@dataclass(frozen=True)
class Entry:
    """A line of the contents: its target's anchor, its words as HTML, and 0 for a part, 1 for a page, 2 below."""

    anchor: str
    words: str
    depth: int


def anchor(name: str, fragment: str = "") -> str:
    """The id in the printed document of a page and an anchor on it."""
    return f"{name}--{fragment}".replace("/", "-").removesuffix("--")


def article(name: str, page: str, printed: set[str]) -> Tag:
    """The article of a built page, prepared for one document with the articles of all `printed` pages."""
    soup = BeautifulSoup(page, "html.parser")
    found = soup.select_one("article.bd-article")
    if found is None:
        raise ValueError(f"{name}.html must have an article, found none")
    for tag in found.select(CLUTTER):
        tag.decompose()
    for tag in found.select("details"):
        tag["open"] = ""
    for tag in found.select("[id]"):
        tag["id"] = anchor(name, str(tag["id"]))
    for tag in found.select("a[href]"):
        parts = urlsplit(str(tag["href"]))
        if parts.scheme or parts.netloc:
            continue
        target = (
            posixpath.normpath(posixpath.join(posixpath.dirname(name), unquote(parts.path))) if parts.path else name
        )
        target = target.removesuffix(".html")
        if target in printed:
            tag["href"] = "#" + anchor(target, parts.fragment)
        else:  # source code, downloads: not on paper
            tag.unwrap()
    found["id"] = anchor(name)
    found["class"] = "sheet bd-article"
    return found


def contents(toc: dict, articles: dict[str, Tag]) -> list[Entry]:
    """The lines of the contents, in order."""
    parts = [("", [toc["root"]])]
    parts += [(part["caption"], [chapter["file"] for chapter in part["chapters"]]) for part in toc["parts"]]
    entries = []
    for caption, names in parts:
        if caption:
            entries.append(Entry(anchor(names[0]), html.escape(caption), 0))
        for name in names:
            for heading in articles[name].select("h1, h2"):
                at = heading.find_parent("section")
                words = heading.decode_contents()
                depth = int(heading.name[1])
                entries.append(Entry(anchor(name) if depth == 1 or at is None else str(at["id"]), words, depth))
    return entries


def contents_page(entries: Iterable[Entry], sheets: dict[str, int]) -> str:
    """The contents as HTML; unknown numbers take as much space as known ones."""
    lines = [
        f'<li class="depth-{entry.depth}"><a href="#{entry.anchor}"><span>{entry.words}</span>'
        + ("" if entry.depth == 0 else f"<b>{sheets.get(entry.anchor, 000)}</b>")
        + "</a></li>"
        for entry in entries
    ]
    return f'<nav class="sheet printed-contents"><h1>Contents</h1><ol>{"".join(lines)}</ol></nav>'


def title_page(config: dict) -> str:
    """The first sheet, from the book's configuration."""
    title, _, subtitle = config["title"].partition(": ")
    return (
        f'<header class="sheet title"><p class="name">{html.escape(title)}</p><p>{html.escape(subtitle)}</p>'
        f"<p>{html.escape(config['author'])}, {html.escape(str(config['copyright']))}</p></header>"
    )


def head_of(texts: Mapping[str, str]) -> Tag:
    """The head of the document: that of the first page that loads MathJax, since pages without formulas do not."""
    heads = {name: BeautifulSoup(text, "html.parser").head for name, text in texts.items()}
    if missing := [name for name, head in heads.items() if head is None]:
        raise ValueError(f"{missing[0]}.html must have a head, found none")
    found = [head for head in heads.values() if head is not None]
    return next((head for head in found if head.select("script[src*=mathjax]")), found[0])


def document(head: str, body: Iterable[str]) -> str:
    """One page of HTML; `head` is that of a built page, with its styles and its MathJax."""
    return (
        f'<!doctype html><html lang="en" data-theme="light" data-mode="light">{head}<body>{"".join(body)}</body></html>'
    )


def hand_over(folder: Path, text: str, asked: Route, refused: list[str]) -> None:
    """Answer the browser's requests for the document or a file of the book; others are refused and recorded."""
    name = unquote(urlsplit(asked.request.url).path[1:])
    if name == "book/print.html":
        asked.fulfill(body=text, content_type="text/html; charset=utf-8")
    elif asked.request.url.startswith(HOST) and (folder / name).is_file():
        asked.fulfill(path=folder / name)
    else:
        refused.append(asked.request.url)
        asked.abort()


FIT = """(column) => {
  for (const drawing of document.querySelectorAll("mjx-container[display] > svg")) {
    const room = drawing.closest("div.math, div.output, td, dd, li, .statement")?.clientWidth ?? column;
    if (drawing.getBoundingClientRect().width > room) {
      drawing.style.width = "100%";
      drawing.style.height = "auto";
    }
  }
}"""


def sheets_of(page: Page, folder: Path, text: str) -> bytes:
    """Print the document; returns the PDF."""
    page.unroute_all()
    refused: list[str] = []
    page.route("**/*", lambda route: hand_over(folder, text, route, refused))
    page.goto(HOST + "book/print.html", timeout=120_000)
    if refused:
        raise ValueError(f"the printed book must need its own files only, got requests for {', '.join(refused)}")
    page.evaluate("() => window.MathJax?.startup?.promise.then(() => 1)")
    page.evaluate(FIT, COLUMN)
    return page.pdf(
        prefer_css_page_size=True,
        print_background=True,
        display_header_footer=True,
        header_template="<span></span>",
        footer_template=FOOTER,
        outline=True,
        tagged=True,
    )


def sheet_numbers(reader: PdfReader) -> dict[str, int]:
    """The sheet of each link target."""
    return {
        unquote(name.lstrip("/")): number + 1
        for name, place in reader.named_destinations.items()
        if (number := reader.get_destination_page_number(place)) is not None
    }


def main(target: Path, root: Path) -> None:
    """Print the book built below `root` into `target`."""
    folder = root / "build/_build/html"
    toc = yaml.safe_load((root / "_toc.yml").read_text(encoding="utf-8"))
    if not (folder / f"{toc['root']}.html").is_file():
        sys.exit("there is no book yet; run 'make book' first")
    browser_at = chromium()
    if browser_at is None:
        sys.exit("printing needs Chromium, got none; `apt-get install chromium` installs it")
    names = [toc["root"], *(chapter["file"] for part in toc["parts"] for chapter in part["chapters"])]
    texts = {name: (folder / f"{name}.html").read_text(encoding="utf-8") for name in names}
    articles = {name: article(name, text, set(names)) for name, text in texts.items()}
    entries = contents(toc, articles)
    config = yaml.safe_load((root / "_config.yml").read_text(encoding="utf-8"))
    head = head_of(texts)
    for script in head.select("script[src]"):
        if "mathjax" not in str(script["src"]):
            script.decompose()
    head.append(BeautifulSoup('<link rel="stylesheet" href="../_static/print.css">', "html.parser"))
    pages = [str(tag) for tag in articles.values()]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=browser_at, args=["--headless", "--no-sandbox"])
        page = browser.new_page(viewport={"width": COLUMN, "height": 1000})
        page.emulate_media(media="print")
        page.set_default_timeout(120_000)
        sheets: dict[str, int] = {}
        for _ in range(2):
            text = document(str(head), [title_page(config), contents_page(entries, sheets), *pages])
            pdf = sheets_of(page, folder, text)
            reader = PdfReader(io.BytesIO(pdf))
            sheets = sheet_numbers(reader)
        browser.close()
    if missing := [entry.anchor for entry in entries if entry.anchor not in sheets]:
        raise ValueError(f"every line of the contents must have a sheet, got none for: {', '.join(missing)}")
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(pdf)
    print(f"{target}: {len(reader.pages)} pages, {target.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(__file__).resolve().parent.parent)
