"""The built book in Debian's Chromium: what each check has against a page, as sentences.

A page is loaded once for each theme and then seen at three widths. axe-core looks at everything in the light theme; in
the dark one, where colours are all that differs, at contrast, at the widest and the narrowest. `one_look` is what a
page needs whose template has been judged on another page: itself, and whether it fits the narrowest width.
"""

import functools
import gzip
import http.server
import importlib.resources
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import unquote, urlsplit

from playwright.sync_api import Browser, Page, sync_playwright

from tools.print import chromium

WIDTHS = (1440, 800, 360)
THEMES = ("light", "dark")
# What a page may weigh on its way to the reader, from a server that compresses, as those that publish books do.
BUDGET = 1_500_000
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
AXE = (importlib.resources.files("axe_playwright_python") / "axe.min.js").read_text(encoding="utf-8")

READY = "() => (window.MathJax?.startup?.promise ?? Promise.resolve()).then(() => document.fonts.ready).then(() => 1)"
TWO_FRAMES = "() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done(1))))"
OVERFLOW = "() => document.documentElement.scrollWidth - document.documentElement.clientWidth"
REPEATED_IDS = """() => {
  const ids = [...document.querySelectorAll("[id]")].map((element) => element.id);
  return [...new Set(ids.filter((id, i) => ids.indexOf(id) !== i))];
}"""
BROKEN_IMAGES = """async () => {
  const images = [...document.images];
  for (const image of images) image.loading = "eager";
  await Promise.all(images.map((image) => image.complete || new Promise((done) => {
    image.onload = image.onerror = done;
  })));
  return images.filter((image) => !image.naturalWidth).map((image) => image.getAttribute("src").slice(0, 80));
}"""
ALTERNATIVE_TEXTS = "() => [...document.images].map((image) => image.alt)"
RAW_TEX = r"""() => {
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  const found = [...document.querySelectorAll("mjx-merror, [data-mjx-error]")].map((error) => error.textContent);
  for (let text; (text = walker.nextNode()); ) {
    if (text.parentElement.closest("pre, code, script, style, mjx-container, .take-away")) continue;
    found.push(...(text.data.match(/\$\$|\$[^$\n]{1,80}\$|\\begin\{\w+|\\\(|\\\[|\\(?:frac|sum|text)\b/g) ?? []));
  }
  return found;
}"""
# axe-core's time goes with the number of elements. What it has no rule for is taken out before it looks: the strokes of
# formulas and the elements of their MathML (the text stays), and of words in code all but the first of each colour.
SHRINK = """() => {
  for (const strokes of document.querySelectorAll("mjx-container > svg")) strokes.replaceChildren();
  for (const spoken of document.querySelectorAll("mjx-assistive-mml")) spoken.textContent = spoken.textContent.trim();
  const seen = new Set();
  for (const word of document.querySelectorAll(".highlight pre span:not([id], :has(a, [id]))")) {
    const key = `${word.className} in ${word.closest(".highlight").className}`;
    if (word.closest("a")) continue;
    if (seen.has(key)) word.replaceWith(...word.childNodes);
    seen.add(key);
  }
  for (const code of document.querySelectorAll(".highlight pre")) code.normalize();
}"""
# Letters that look alike are judged once: of the texts with the same colours, size and weight, the first two.
ALIKE = """() => {
  const seen = new Map();
  const grounds = new Map();
  const ground = (element) => {
    if (!element) return "";
    if (!grounds.has(element)) {
      const { backgroundColor, backgroundImage, opacity } = getComputedStyle(element);
      const [own, below] = [`${backgroundColor} ${backgroundImage} ${opacity}`, ground(element.parentElement)];
      grounds.set(element, below.includes(own) ? below : `${own} ${below}`);
    }
    return grounds.get(element);
  };
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let text; (text = walker.nextNode()); ) {
    const element = text.parentElement;
    if (!text.data.trim() || element.closest("mjx-container, script, style, [data-alike]")) continue;
    if (!element.getClientRects().length) continue;
    const { color, fontSize, fontWeight, textDecorationLine } = getComputedStyle(element);
    const key = [element.tagName, color, fontSize, fontWeight, textDecorationLine, ground(element)].join();
    const count = seen.get(key) ?? 0;
    seen.set(key, count + 1);
    if (count < 2) element.dataset.alike = "";
  }
}"""
VIOLATIONS = """([where, options]) => axe.run(where ?? document, options).then(({ violations }) => violations
  .filter(({ impact }) => ["serious", "critical"].includes(impact))
  .flatMap(({ id, nodes }) => nodes.map(({ target }) => `${id}: ${target.join(" ")}`)))"""
COLOURS = ("color-contrast", "link-in-text-block")
QUICK = {"resultTypes": ["violations"], "preload": False}
OF_COLOUR = [{"include": [["[data-alike]"]]}, QUICK | {"runOnly": list(COLOURS)}]
ALL_ELSE = [None, QUICK | {"rules": {rule: {"enabled": False} for rule in COLOURS}}]


class _Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:
        """Say nothing."""


class _Server(http.server.ThreadingHTTPServer):
    daemon_threads = True

    def handle_error(self, request: object, client_address: object) -> None:
        """Say nothing: a browser may hang up before it has read everything."""


@contextmanager
def serve(folder: Path) -> Iterator[str]:
    """Serve a folder from a free local port; gives its address, which ends in a slash."""
    handler = functools.partial(_Quiet, directory=folder)
    with _Server(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_port}/"
        finally:
            server.shutdown()
            thread.join()


@contextmanager
def launch() -> Iterator[Browser]:
    """Start Chromium."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium(), args=FLAGS)
        try:
            yield browser
        finally:
            browser.close()


@contextmanager
def visit(browser: Browser, site: str, name: str, theme: str) -> Iterator[tuple[Page, list[str]]]:
    """Load a page and wait until it is typeset; gives it with what went wrong on the way.

    Requests to other hosts are noted and go nowhere.
    """
    found: list[str] = []
    with browser.new_context(viewport={"width": WIDTHS[0], "height": 900}) as context:
        context.add_init_script(f"for (const key of ['mode', 'theme']) localStorage.setItem(key, '{theme}');")

        def outside(url: str) -> bool:
            return not url.startswith((site, "data:", "blob:"))

        def refuse(route) -> None:
            found.append(f"asks another host: {route.request.url}")
            route.abort()

        context.route(outside, refuse)
        page = context.new_page()
        page.on("console", lambda said: said.type == "error" and found.append(f"the console says: {said.text}"))
        page.on("pageerror", lambda error: found.append(f"a script fails: {error.message}"))
        page.on("response", lambda got: got.status >= 400 and found.append(f"status {got.status}: {got.url}"))
        page.goto(site + name)
        page.evaluate(READY)
        yield page, found


def weight(page: Page, site: str, folder: Path) -> int:
    """Bytes of the page with everything that it fetched, each file compressed."""
    names = page.evaluate("() => [location.href, ...performance.getEntriesByType('resource').map(({ name }) => name)]")
    return sum(_compressed(folder / unquote(urlsplit(name).path[1:])) for name in names if name.startswith(site))


@functools.cache
def _compressed(path: Path) -> int:
    # Fonts and pictures are compressed already; gzip adds to them next to nothing.
    return len(gzip.compress(path.read_bytes(), compresslevel=6)) if path.is_file() else 0


def content_faults(page: Page) -> list[str]:
    """What is amiss in the page itself, at any width and in any theme."""
    found = [f"the id {id} is given twice" for id in page.evaluate(REPEATED_IDS)]
    found += [f"broken image: {source}" for source in page.evaluate(BROKEN_IMAGES)]
    found += [
        f"alternative text is no sentence: {text}"
        for text in page.evaluate(ALTERNATIVE_TEXTS)
        if len(text.split()) < 4 or not text.rstrip().endswith((".", "?", "!"))
    ]
    return found + [f"TeX as text: {tex}" for tex in page.evaluate(RAW_TEX)]


def resized(page: Page, widths: tuple[int, ...] = WIDTHS) -> Iterator[int]:
    """Give the page one width after the other."""
    for width in widths:
        page.set_viewport_size({"width": width, "height": 900})
        page.evaluate(TWO_FRAMES)
        yield width


def too_wide(page: Page, widths: tuple[int, ...] = WIDTHS) -> list[str]:
    """At which widths the page itself scrolls sideways."""
    beyond = {width: page.evaluate(OVERFLOW) for width in resized(page, widths)}
    return [f"at {width} px the page is {pixels} px too wide" for width, pixels in beyond.items() if pixels > 0]


def violations(page: Page, theme: str) -> list[str]:
    """What axe-core finds serious or critical; the page is not to be used after it."""
    found = []
    page.evaluate(AXE)
    page.evaluate(SHRINK)
    for width in resized(page, WIDTHS if theme == THEMES[0] else (WIDTHS[0], WIDTHS[-1])):
        if theme == THEMES[0]:
            found += [f"at {width} px {violation}" for violation in page.evaluate(VIOLATIONS, ALL_ELSE)]
        page.evaluate(ALIKE)
        found += [f"at {width} px, {theme}: {violation}" for violation in page.evaluate(VIOLATIONS, OF_COLOUR)]
    return found


def one_look(browser: Browser, site: str, name: str, folder: Path) -> list[str]:
    """What the checks have against the page itself, without the ones that judge its template."""
    with visit(browser, site, name, THEMES[0]) as (page, found):
        heavy = weight(page, site, folder)
        found += [f"weighs {heavy} bytes compressed"] if heavy > BUDGET else []
        return found + content_faults(page) + too_wide(page, WIDTHS[-1:])


def faults(browser: Browser, site: str, name: str, theme: str, folder: Path) -> list[str]:
    """Everything that the checks have against one page in one theme."""
    with visit(browser, site, name, theme) as (page, found):
        heavy = weight(page, site, folder)
        if theme == THEMES[0]:
            found += [f"weighs {heavy} bytes compressed"] if heavy > BUDGET else []
            found += content_faults(page)
        return found + too_wide(page) + violations(page, theme)
