"""The paper's examples as figures: our runs on its published curves."""

from __future__ import annotations

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
    """Draw a run of one of the paper's examples on the published curves, and how far apart they are.

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


def opening(trace: Trace) -> str:
    """Draw the linear example's output on the published one as HTML for the first page, whose style lets it move.

    The figure has an inline SVG: one circle for each published sample, one path for the trace of
    ``published.linear_example()``.

    Examples
    --------
    >>> from rhl.paper.published import linear_example
    >>> opening(linear_example().run()).count("<circle")
    41
    """
    published = curve("linear_y")
    ours = trace.y[: len(published), 0]
    top, width, height = float(np.ceil(np.max(np.abs([ours, published])) / 10) * 10), 640.0, 210.0
    x = 50 + (width - 70) * np.arange(len(published)) / (len(published) - 1)

    def up(values: Array) -> Array:
        return np.asarray(height / 2 - 10 - (height / 2 - 22) * values / top)

    path = f"M{x[0]:.1f} {up(ours)[0]:.1f}" + "".join(
        f"H{at:.1f}V{level:.1f}" for at, level in zip(x[1:], up(ours)[1:], strict=True)
    )
    circles = "".join(
        f'<circle style="--k:{k}" cx="{at:.1f}" cy="{level:.1f}" r="4.5"/>'
        for k, (at, level) in enumerate(zip(x, up(published), strict=True))
    )
    axes = "".join(
        f'<line class="axis" x1="{x[0]:.1f}" x2="{x[-1]:.1f}" y1="{level:.1f}" y2="{level:.1f}"/>'
        f'<text x="42" y="{level + 5:.1f}" text-anchor="end">{str(round(value)).replace("-", "−")}</text>'
        for value, level in zip((-top, 0.0, top), up(np.array([-top, 0.0, top])), strict=True)
    )
    marks = "".join(
        f'<text x="{x[k]:.1f}" y="{height - 2:.1f}" text-anchor="middle">{k}</text>' for k in range(0, len(x), 10)
    )
    return (
        f'<figure class="rhl-figure rhl-opening"><svg viewBox="0 0 {width:g} {height:g}" role="img" aria-label="The '
        "output of the paper's linear example swings and goes to zero; the published circles lie on the line that was "
        f'computed here.">{axes}{marks}{circles}<path class="ours" pathLength="1" d="{path}"/></svg>'
        "<figcaption>Output y of the paper's linear example over the step k: the circles are published, the line was "
        "computed while this page was built.</figcaption></figure>"
    )
