"""Serve MathJax from the book itself: one file of the pinned wheel, without requests to other hosts.

Without scripts, a page shows each formula as MathML; the EPUB contains only MathML.
"""

import html
import re
import shutil
from collections.abc import Callable, Mapping
from functools import cache, partial
from importlib.metadata import distribution
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError

# TeX input and SVG output with glyphs in one file, so that nothing else is loaded.
SCRIPT = "mathjax/tex-svg-full.js"
# Without scripts the raw TeX would be shown.
WITHOUT_SCRIPTS = "<noscript><style>.math .tex { display: none; }</style></noscript>"
# Environments of several lines; the converter supports only arrays, with alternating columns as in amsmath.
_LINES = r"split|aligned|align\*?|gathered|gather\*?"
_WRAPPED = re.compile(r"\\(begin|end)\{equation\*?\}")
_TAG = re.compile(r"\\tag\{([^{}]*)\}")
# What has a fixed number of parts in MathML.
_PARTS = {"msup": 2, "msub": 2, "msubsup": 3, "mover": 2, "munder": 2, "munderover": 3, "mfrac": 2, "mroot": 2}
_DELIMITED = re.compile(r"\\\((.*?)\\\)|\\\[(.*)\\\]|(\\begin\{.*\\end\{[a-z]+\*?\})", flags=re.DOTALL)


def place_script(app: Sphinx) -> None:
    """Copy the script to the place from which pages load it."""
    source = distribution("sphinx-mathjax-offline").locate_file(f"sphinx-mathjax-offline/static/{SCRIPT}")
    target = Path(app.outdir, "_static", SCRIPT)
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(str(source), target)


def spare_pages(app: Sphinx, page: str, template: str, context: dict[str, Any], doctree: Any) -> None:
    """Remove the script from pages without formulas: Sphinx adds it to the first page because of later ones."""
    if app.builder.name == "epub":
        return
    if not app.env.get_domain("math").data["has_equations"].get(page):
        scripts = context["script_files"]
        scripts[:] = [script for script in scripts if not str(getattr(script, "filename", "")).endswith(SCRIPT)]
    else:
        context["metatags"] = context.get("metatags", "") + WITHOUT_SCRIPTS


def plain(tex: str, macros: Mapping[str, str]) -> tuple[str, str]:
    """Return a formula in TeX that the converter supports, and its number, empty if there is none."""
    known = "|".join(macros)
    tex = re.sub(rf"\\({known})(?![A-Za-z])", lambda found: macros[found[1]], tex)
    tex = _WRAPPED.sub("", tex)
    # An operator's name is upright, with its limits below it.
    tex = re.sub(r"\\operatorname\*?\{arg\\,(min|max)\}|\\arg\s*\\(min|max)", r"\\mathrm{arg\\,\1\2}", tex)
    numbers = _TAG.findall(tex)
    tex = _TAG.sub("", tex)
    tex = re.sub(rf"\\begin\{{(?:{_LINES})\}}", lambda _: r"\begin{array}{rlrlrl}", tex)
    tex = re.sub(rf"\\end\{{(?:{_LINES})\}}", lambda _: r"\end{array}", tex)
    # The converter drops a last row that ends in an empty cell.
    tex = re.sub(r"&\s*(?=\\\\|\\end\{)", "&{}", tex)
    # A power of a matrix would become one of its bracket.
    tex = re.sub(r"(\\begin\{([bpvBV]?matrix)\}.*?\\end\{\2\})(?=[\^_])", r"{\1}", tex, flags=re.DOTALL)
    return tex.strip(), ", ".join(numbers)


@cache
def _converted(tex: str, block: bool) -> str:
    return convert(tex, display="block" if block else "inline")


def mathml(tex: str, block: bool, macros: Mapping[str, str]) -> tuple[str, str]:
    """Return a formula as MathML, and its number; ExtensionError if it still contains TeX."""
    known, number = plain(tex, macros)
    made = _converted(known, block)
    try:
        tree = ElementTree.fromstring(made)
    except ElementTree.ParseError as error:
        raise ExtensionError(f"the MathML of a formula is not well formed ({error}): {tex}") from error
    for script in tree.iter():
        parts = _PARTS.get(script.tag.rpartition("}")[2], len(script))
        if len(script) != parts:
            raise ExtensionError(
                f"a script of the MathML of a formula must have {parts} parts, found {len(script)}: {tex}"
            )
    rows = len(re.findall(r"\\\\(?!\s*\\end)|\\begin\{(?:array|cases|[bpvBV]?matrix)\}", known))
    if made.count("<mtr>") != rows:
        raise ExtensionError(f"the MathML of a formula must have {rows} rows, found {made.count('<mtr>')}: {tex}")
    if left := re.findall(r"\\[A-Za-z]+|&", "".join(tree.itertext())):
        raise ExtensionError(f"a formula cannot be written as MathML for {', '.join(left)}: {tex}")
    return made, number


def beside(markup: str, macros: Mapping[str, str], instead: bool) -> str:
    """Return a formula's HTML with MathML for readers without scripts; with `instead`, with MathML alone."""

    def both(found: re.Match[str]) -> str:
        tex = next(part for part in found.groups() if part is not None)
        made, number = mathml(html.unescape(tex), not found[0].startswith(r"\("), macros)
        plainly = f'<span class="eqno">({html.escape(number)})</span>{made}' if number else made
        if instead:
            return plainly
        # If the formula is wider than a phone, book.js shows its number next to it.
        numbered = f' data-number="({html.escape(number)})"' if number else ""
        return f'<span class="tex"{numbered}>{found[0]}</span><noscript>{plainly}</noscript>'

    return _DELIMITED.sub(both, markup, count=1)


def with_mathml(visit: Callable[[Any, Any], None], translator: Any, node: nodes.Element) -> None:
    """Write a formula like Sphinx's own visitor, and add its MathML."""
    written = translator.body
    begin = len(written)
    try:
        visit(translator, node)
    except nodes.SkipNode:  # the visitor's signal that it wrote the children too
        macros = translator.config.mathjax3_config["tex"]["macros"]
        markup = beside("".join(written[begin:]), macros, instead=translator.builder.name == "epub")
        written[begin:] = [markup]
        raise


def wrap_renderers(app: Sphinx) -> None:
    """Write MathML with every formula."""
    # The registry accepts no second renderer with the name for which Sphinx adds the script.
    for renderers in (app.registry.html_inline_math_renderers, app.registry.html_block_math_renderers):
        visit, leave = renderers["mathjax"]
        renderers["mathjax"] = (partial(with_mathml, visit), leave)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register with Sphinx."""
    app.setup_extension("sphinx.ext.mathjax")
    app.config.mathjax_path = SCRIPT
    app.connect("builder-inited", place_script)
    app.connect("builder-inited", wrap_renderers, priority=900)  # after MyST, which sets its own renderer
    app.connect("html-page-context", spare_pages, priority=900)  # after Sphinx's own handler, which has 500
    return {"parallel_read_safe": True, "parallel_write_safe": True}
