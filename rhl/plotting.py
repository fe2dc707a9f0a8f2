"""Traces as matplotlib figures, for light and dark pages; all settings of a figure's appearance."""

from __future__ import annotations

import base64
import html
import io
import os
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, cast

import matplotlib as mpl
import numpy as np
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import SymmetricalLogLocator

from rhl._checks import Array, instance
from rhl._files import write_whole
from rhl.errors import InputError
from rhl.trace import Trace

ThemeName = Literal["light", "dark"]

# Okabe and Ito's colours, distinguishable by the colour-blind, in shades with enough contrast for each page.
_COLOURS = {
    "light": {"text": "#222832", "grid": "#c9ccd1", "cycle": ["#0072b2", "#d55e00", "#009e73", "#aa4499"]},
    "dark": {"text": "#ced6dd", "grid": "#48566b", "cycle": ["#56b4e9", "#e69f00", "#3fc59d", "#e08ac8"]},
}


FORMATS = (".svg", ".pdf", ".png")
# Inches: the width of a phone, which therefore shows a figure and its type at their own size.
WIDTH = 4.2
# Points of type that a figure of that width must have for 11 pixels on a page 358 pixels wide.
_LEAST_TYPE = 11 * 72 * WIDTH / 358
# matplotlib's own arithmetic overflows beyond this.
_DRAWABLE = 1e100
# A logarithmic axis shows at most this range below its largest value.
_DECADES = 1e-20


def style(theme: ThemeName) -> dict[str, Any]:
    """Return matplotlib's settings for figures on a light or a dark page.

    Examples
    --------
    >>> style("light")["text.color"] != style("dark")["text.color"]
    True
    """
    colours = _COLOURS[theme]
    text = ("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color", "legend.labelcolor")
    return dict.fromkeys(text, colours["text"]) | {
        "figure.facecolor": "none",
        "axes.facecolor": "none",
        "savefig.facecolor": "none",
        "axes.grid": True,
        "grid.color": colours["grid"],
        "grid.linewidth": 0.5,
        "axes.axisbelow": True,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.prop_cycle": cycler(color=colours["cycle"]),
        "lines.linewidth": 1.4,
        "lines.markersize": 4,
        "font.size": 9.5,
        "legend.frameon": False,
        "legend.fontsize": 9.3,
        "figure.constrained_layout.use": True,
        "svg.hashsalt": "rhl",
    }


def css() -> str:
    """Return the colours of figures as custom properties for the book's pages: --rhl-text, --rhl-grid, --rhl-1, ...

    Examples
    --------
    >>> print(css().splitlines()[0])
    html { --rhl-text: #222832; --rhl-grid: #c9ccd1; --rhl-1: #0072b2; --rhl-2: #d55e00; --rhl-3: #009e73; ... }
    """
    rules = []
    for selector, colours in zip(("html", 'html[data-theme="dark"]'), _COLOURS.values(), strict=True):
        named = {"text": colours["text"], "grid": colours["grid"]}
        named |= {str(i): colour for i, colour in enumerate(colours["cycle"], start=1)}
        rules.append(f"{selector} {{ {' '.join(f'--rhl-{name}: {colour};' for name, colour in named.items())} }}")
    return "\n".join(rules) + "\n"


def panels(count: int, height: float = 2.1) -> tuple[Figure, list[Axes]]:
    """Make a figure of panels one below the other that share the step axis k, each ``height`` inches high.

    Examples
    --------
    >>> figure, axes = panels(2)
    >>> held(axes[0], np.array([1.0, 0.5, 0.25]), "$y$")
    >>> axes[1].get_xlabel()
    'step $k$'
    """
    figure = Figure(figsize=(WIDTH, height * count + 0.4))
    axes = list(np.atleast_1d(figure.subplots(count, 1, sharex=True)))
    axes[-1].set_xlabel("step $k$")
    return figure, axes


def held(ax: Axes, values: Array, label: str, **settings: Any) -> None:
    """Draw a signal over k that holds its value until the next step, as the paper's figures do."""
    values = np.where(np.abs(values) <= _DRAWABLE, values, np.nan)
    if np.nanmax(np.abs(values), initial=0.0) > 1e6 and ax.get_yscale() == "linear":
        ax.set_yscale("symlog")
        ax.yaxis.set_major_locator(SymmetricalLogLocator(base=10, linthresh=2.0))
        cast(SymmetricalLogLocator, ax.yaxis.get_major_locator()).set_params(numticks=7)
    ax.step(np.arange(len(values)), values, where="post", label=label, **settings)


def differences(ax: Axes, gaps: Mapping[str, Array], tolerance: float | None = None) -> None:
    """Draw absolute differences on a logarithmic axis; exact agreement is drawn at 10^-17."""
    for (label, gap), marker in zip(gaps.items(), "osv^", strict=False):
        ax.semilogy(np.arange(len(gap)), np.maximum(np.abs(gap), 1e-17), marker, label=label, ms=3.5)
    if tolerance is not None:
        digits, _, exponent = f"{tolerance:g}".partition("e")
        factor = "" if digits == "1" else rf"{digits} \cdot "
        power = f"{factor}10^{{{int(exponent)}}}" if exponent else digits
        ax.axhline(tolerance, color=mpl.rcParams["text.color"], ls="--", lw=1, label=f"tolerance ${power}$")
    ax.set_ylabel("|difference|")


def run(trace: Trace, title: str = "") -> Figure:
    """Draw outputs and their predictions, inputs, the terminal weight, and the controllability margins of one run.

    Examples
    --------
    >>> from rhl.paper.published import linear_example
    >>> [ax.get_ylabel() for ax in run(linear_example().run()).axes]
    ['output', 'input', 'terminal weight', 'controllability margin']
    """
    instance("trace", trace, Trace)
    if trace.y.ndim != 2:
        raise InputError(f"the trace must be of one run, got a batch of shape {trace.y.shape[1:-1]}; take one member")
    figure, axes = panels(4)
    for i in range(trace.y.shape[1]):
        held(axes[0], trace.y[:, i], f"$y_{i + 1}$", color=f"C{i}")
        if trace.set_point is not None:
            held(axes[0], trace.set_point[:, i], f"$r_{i + 1}$", color=f"C{i}", linestyle="--", linewidth=1)
        predicted = np.where(np.abs(trace.y_hat[:, i]) <= _DRAWABLE, trace.y_hat[:, i], np.nan)
        axes[0].plot(trace.k, predicted, "x", color=f"C{i}", label=rf"$\hat y_{i + 1}$", ms=3.5)
    for i in range(trace.v.shape[1]):
        held(axes[1], trace.v[:, i], f"$v_{i + 1}$", color=f"C{i}")
    (weight,), (lifted, augmented) = _levels(trace.weight), _levels(trace.margin_lifted, trace.margin_augmented)
    held(axes[2], weight, r"$\Gamma(X)/\epsilon$")
    held(axes[3], lifted, "lifted pair")
    held(axes[3], augmented, "augmented pair")
    for ax, label in zip(axes, ("output", "input", "terminal weight", "controllability margin"), strict=True):
        ax.set_ylabel(label)
        ax.legend(ncols=3)
    for ax in axes[2:]:
        drawn = np.concatenate([np.asarray(line.get_ydata(), dtype=np.float64) for line in ax.get_lines()])
        top = np.nanmax(drawn, initial=0.0)
        if top > 0:  # a logarithmic axis needs a positive number
            ax.set_yscale("log")
            # A weight that goes to zero with the state would leave the axis to numbers that are zero to the eye.
            if np.nanmin(drawn) < _DECADES * top:
                ax.set_ylim(bottom=_DECADES * top)
    if title:
        # The title is plain text, not a formula, even if it contains a dollar sign.
        axes[0].set_title(title[:60].replace("$", r"\$"), fontsize=10, parse_math=False)
    return figure


def _levels(*signals: Array) -> list[Array]:
    """Return signals with gaps for zeros, for a logarithmic axis; unchanged if all are zero, for a linear one."""
    if not any(np.any(signal > 0) for signal in signals):
        return list(signals)
    return [np.where(signal > 0, signal, np.nan) for signal in signals]


@dataclass(frozen=True)
class Picture:
    """A figure drawn twice, for light and for dark pages, that a notebook shows with its alternative text.

    Examples
    --------
    >>> Picture("<svg/>", "<svg/>", "A line falls to zero.")
    A line falls to zero.
    """

    light: str
    dark: str
    alt: str
    caption: str = ""

    def __repr__(self) -> str:
        return self.alt

    def _repr_html_(self) -> str:
        def image(theme: ThemeName, svg: str) -> str:
            data = base64.b64encode(svg.encode()).decode()
            return (
                f'<img class="only-{theme} rhl-{theme}" style="width:100%;max-width:34rem;height:auto" '
                f'src="data:image/svg+xml;base64,{data}" alt="{html.escape(self.alt)}">'
            )

        # A page without the book's theme switch, such as a notebook outside the book, shows the light image only.
        alone = "html:not([data-theme])"
        rule = f"<style>{alone} .rhl-dark{{display:none}}{alone} .rhl-light{{background:#fff}}</style>"
        images = f"{rule}{image('light', self.light)}{image('dark', self.dark)}"
        caption = f"<figcaption>{html.escape(self.caption)}</figcaption>" if self.caption else ""
        # Images have their own div: the theme hides a caption that follows an image of the other theme.
        return f'<figure class="rhl-figure"><div>{images}</div>{caption}</figure>'


def show(draw: Callable[[], Figure], alt: str, caption: str = "") -> Picture:
    """Draw a figure for both themes; the last line of a notebook's cell shows it.

    Parameters
    ----------
    draw : callable
        Makes the figure; called once for each theme with its settings in force.
    alt : str
        The content of the figure in a sentence, for readers who cannot see it; InputError if it is not a sentence.
    caption : str
        The caption, also a sentence; every figure of the book has one.

    InputError also if the figure's type is too small to be read on a phone.

    Examples
    --------
    >>> from rhl.paper.published import linear_example
    >>> trace = linear_example().run()
    >>> show(lambda: run(trace), alt="Output and input of the linear example go to zero.")
    Output and input of the linear example go to zero.
    """
    for name, text in (("alt", alt), ("caption", caption)):
        if (text or name == "alt") and (len(text.split()) < 4 or not text.rstrip().endswith(".")):
            raise InputError(f"{name} must be a sentence that says what the figure shows, got {text!r}")
    return Picture(_svg(draw, "light"), _svg(draw, "dark"), alt, caption)


def save(draw: Callable[[], Figure], path: str | os.PathLike[str], theme: ThemeName = "light") -> None:
    """Draw a figure into an .svg, .pdf or .png file, on a white or a dark ground; the file appears whole.

    InputError if the file has another ending or cannot be written, or the theme is not known.

    Examples
    --------
    >>> from rhl.paper.published import linear_example
    >>> from tempfile import TemporaryDirectory
    >>> trace = linear_example().run()
    >>> with TemporaryDirectory() as folder:
    ...     save(lambda: run(trace), Path(folder, "trace.svg"), theme="dark")
    ...     Path(folder, "trace.svg").stat().st_size > 1000
    True
    """
    write_whole(path, render(draw, path, theme))


def render(draw: Callable[[], Figure], path: str | os.PathLike[str], theme: ThemeName = "light") -> bytes:
    """Return what ``save`` writes to the path, without writing it.

    Examples
    --------
    >>> render(lambda: panels(1)[0], "empty.pdf")[:4]
    b'%PDF'
    """
    target = Path(path)
    if target.suffix not in FORMATS:
        raise InputError(f"path must end in one of {', '.join(FORMATS)}, got {target.name!r}")
    if theme not in _COLOURS:
        raise InputError(f"theme must be one of {', '.join(_COLOURS)}, got {theme!r}")
    ground = "#ffffff" if theme == "light" else "#14181e"
    metadata = {} if target.suffix == ".png" else {"Date" if target.suffix == ".svg" else "CreationDate": None}
    buffer = io.BytesIO()
    with _themed(theme):
        draw().savefig(buffer, format=target.suffix[1:], facecolor=ground, dpi=150, metadata=metadata)
    return buffer.getvalue()


def _svg(draw: Callable[[], Figure], theme: ThemeName) -> str:
    buffer = io.StringIO()
    with _themed(theme):
        figure = draw()
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    _readable(figure)
    return buffer.getvalue()


def _readable(figure: Figure) -> None:
    scale = WIDTH / figure.get_figwidth()
    sizes = {
        float(text.get_fontsize()) * scale: text.get_text()
        for text in cast("list[Text]", figure.findobj(Text))
        if text.get_visible() and text.get_text().strip()
    }
    if sizes and min(sizes) < _LEAST_TYPE:
        raise InputError(
            f"type in a figure {WIDTH} inches wide must have {_LEAST_TYPE:.3g} points to be read on a phone, "
            f"got {min(sizes):.3g} for {sizes[min(sizes)]!r}; enlarge it, or make the figure less wide"
        )


def _themed(theme: ThemeName) -> AbstractContextManager[None]:
    # matplotlib's stubs list every key, but it accepts a plain dictionary.
    return mpl.rc_context(cast(Any, style(theme)))
