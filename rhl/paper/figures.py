"""The paper's examples as figures: our runs on its published curves."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rhl._checks import Array, choice
from rhl.paper.published import check_length, curve
from rhl.plotting import differences, held, panels
from rhl.trace import Trace


def against_published(ax: Axes, values: Array, name: str, label: str, colour: str = "C0") -> None:
    """Draw our samples as a line and the published curve ``name`` as circles around its samples."""
    held(ax, values[: len(curve(name))], f"{label}, reproduced", color=colour)
    samples = np.arange(len(curve(name)))
    ax.plot(samples, curve(name), "o", mfc="none", color=colour, alpha=0.7, label=f"{label}, published")


def reproduction(trace: Trace, experiment: Literal["linear", "robot"]) -> Figure:
    """Draw a run of one of the paper's examples with the published curves, and their difference.

    The run is of ``published.linear_example()`` ("linear") or ``published.robot_arm()`` ("robot").

    Examples
    --------
    >>> from rhl.paper.published import linear_example
    >>> [ax.get_ylabel() for ax in reproduction(linear_example().run(), "linear").axes]
    ['output $y$', 'input $v$', '|difference|']
    """
    choice("experiment", experiment, ("linear", "robot"))
    ours: dict[str, tuple[str, str, Array]]
    check_length(trace, *((42, 3) if experiment == "linear" else (62, 3)))
    if experiment == "linear":
        ours = {"y": ("linear_y", "output $y$", trace.y[:, 0]), "v": ("linear_u", "input $v$", trace.v[:, 0])}
    else:
        labels = ("angle $x_1$ (rad)", "velocity $x_2$ (rad/s)", "current $x_3$ (A)")
        ours = {f"x{i + 1}": (f"robot_x{i + 1}", label, trace.z[:, i]) for i, label in enumerate(labels)}
    figure, axes = panels(len(ours) + 1)
    gaps = {}
    for i, (ax, (name, (published, label, values))) in enumerate(zip(axes[:-1], ours.items(), strict=True)):
        symbol = f"${name[0]}_{name[1]}$" if name[1:] else f"${name}$"
        against_published(ax, values, published, symbol, f"C{i}")
        ax.set_ylabel(label)
        ax.legend()
        gaps[symbol] = values[: len(curve(published))] - curve(published)
        if np.max(np.abs(values)) > 100 * np.max(np.abs(curve(published))):
            ax.set_yscale("symlog")
    differences(axes[-1], gaps, 1e-9)
    axes[-1].legend(loc="lower right", ncols=2)
    return figure


def opening(curves: Mapping[str, Array], steps: int = 25) -> str:
    """Draw the first page's picture as HTML: a plant without control, with a known model, and under the scheme.

    ``curves`` are those of ``watch.contrast()``, in metres; they are drawn in centimetres, for ``steps`` steps. The
    figure is a complete inline SVG; the page's script animates it, unless reduced motion is preferred.

    Examples
    --------
    >>> from rhl.paper.watch import contrast
    >>> picture = opening(contrast())
    >>> picture.count("<path")
    3
    """
    width, height, left, right, top, bottom = 640.0, 232.0, 44.0, 616.0, 12.0, 186.0
    low, high = -3.0, 12.0
    x = left + (right - left) * np.arange(steps) / (steps - 1)

    def up(values: Array) -> Array:
        return np.asarray(bottom - (bottom - top) * (values - low) / (high - low))

    def path(name: str, values: Array) -> str:
        # Points far outside the picture only need to leave it in the right direction.
        inside = np.clip(100 * values[:steps], -1e3, 1e3)
        points = "L".join(f"{at:.2f} {level:.2f}" for at, level in zip(x, up(inside), strict=True))
        return f'<path class="{name.replace(" ", "-")}" d="M{points}"/>'

    grid = "".join(
        f'<line class="axis" x1="{left:g}" x2="{right:g}" y1="{level:.1f}" y2="{level:.1f}"/>'
        f'<text x="{left - 7:g}" y="{level + 5:.1f}" text-anchor="end">{value:g}</text>'
        for value, level in zip((0.0, 4.0, 8.0, 12.0), up(np.array([0.0, 4.0, 8.0, 12.0])), strict=True)
    )
    marks = "".join(
        f'<text x="{x[k]:.1f}" y="{bottom + 20:g}" text-anchor="middle">{k}</text>' for k in range(0, steps, 4)
    )
    alone = 100 * curves["left alone"][:steps]
    leaves = float(np.interp(high, alone, x))
    note = f'<text class="note" x="{leaves + 12:.1f}" y="{top + 24:g}">runs away</text>'
    lines = "".join(path(name, values) for name, values in reversed(list(curves.items())))
    keys = "".join(f'<span class="key {name.replace(" ", "-")}">{name}</span>' for name in curves)
    return (
        f'<figure class="rhl-figure rhl-opening"><svg viewBox="0 0 {width:g} {height:g}" role="img" aria-label="The '
        "same unstable plant three times. Left alone it runs off the picture. With a known model it comes to rest at "
        f'once. Under this scheme it swings while it is being learned, and then comes to rest.">'
        f'<defs><clipPath id="rhl-opening-frame"><rect x="{left - 4:g}" y="{top - 4:g}" '
        f'width="{right - left + 8:g}" height="{bottom - top + 8:g}"/></clipPath></defs>{grid}{marks}{note}'
        f'<text class="name" x="{right:g}" y="{height - 4:g}" text-anchor="end">step k</text>'
        f'<g class="curves" clip-path="url(#rhl-opening-frame)">{lines}</g></svg>'
        f'<figcaption><span class="keys">{keys}</span> Position of a ball below an electromagnet, in cm, over the step '
        "k. All three runs start from the same state.</figcaption></figure>"
    )
