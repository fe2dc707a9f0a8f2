"""Pictures of the ideas behind the results, drawn from runs: window and plan, arm, plans that add up, projections."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rhl._checks import Array, integer
from rhl.errors import InputError
from rhl.horizon import Plan
from rhl.plotting import WIDTH, held, panels
from rhl.trace import Trace


def window_and_plan(trace: Trace, k: int) -> Figure:
    """Draw the estimator's window and the plan at step k of a run.

    The first output and the first input of the run are drawn, with the plan of step k and, fainter, that of step k+1.

    Examples
    --------
    >>> from rhl.paper.published import linear_example
    >>> [ax.get_ylabel() for ax in window_and_plan(linear_example().run(), 8).axes]
    ['output $y$', 'input $v$']
    """
    window, horizon = trace.scheme.estimator.window, trace.scheme.controller.horizon
    if not window <= integer("k", k, 0) < len(trace) - 1:
        raise InputError(f"k must be from {window} to {len(trace) - 2} for a full window and a next plan, got {k}")
    figure, (above, below) = panels(2, height=2.8)
    last = min(len(trace), k + horizon + 2)
    above.plot(np.arange(k + 1), trace.y[: k + 1, 0], "o", color="C0", label="measured up to $k$")
    above.plot(np.arange(k + 1, last), trace.y[k + 1 : last, 0], "o", mfc="none", color="C0", label="measured later")
    held(below, trace.v[: k + 1, 0], "applied up to $k$", color="C0")
    for start, alpha in ((k, 1.0), (k + 1, 0.4)):
        plan = trace.steps[start].plan
        ahead = np.arange(start, start + horizon + 1)
        label = "plan of $k$" if start == k else "plan of $k+1$"
        above.plot(ahead, plan.x[:, 0], ".-", color="C1", alpha=alpha, label=label)
        planned = np.append(plan.u[:, 0], plan.u[-1, 0])
        below.step(ahead, planned, where="post", color="C1", alpha=alpha, label=label)
    below.plot([k], [trace.v[k, 0]], "o", color="C1", label="the input that is applied")
    for ax, label in ((above, "output $y$"), (below, "input $v$")):
        ax.axvspan(k - window, k, color="C2", alpha=0.18, lw=0, label="window of $k$")
        ax.axvspan(k + 1 - window, k + 1, fill=False, ec="C2", ls="--", lw=1, label="window of $k+1$")
        ax.set_ylabel(label)
    handles, labels = above.get_legend_handles_labels()
    mine, names = below.get_legend_handles_labels()
    figure.legend([*handles, mine[0], mine[3]], [*labels, names[0], names[3]], loc="outside lower center", ncols=2)
    return figure


def arm_positions(angles: Array, every: int = 3) -> Figure:
    """Draw the link of an arm at every few steps, its angle measured from the hanging position; later ones are darker.

    Examples
    --------
    >>> len(arm_positions(np.linspace(5.0, 0.0, 7)).axes[0].lines)
    4
    """
    figure = Figure(figsize=(WIDTH, 4.2))
    ax = figure.subplots()
    tip = np.stack([np.sin(angles), -np.cos(angles)], axis=-1)
    shown = range(0, len(angles), every)
    for k in shown:
        ax.plot([0, tip[k, 0]], [0, tip[k, 1]], color="C0", lw=2, alpha=0.15 + 0.85 * k / max(len(angles) - 1, 1))
    ax.plot(*tip.T, ".-", color="C1", lw=0.8, ms=3, label="tip at every step")
    marked = dict.fromkeys((0, *range(20, len(angles) - 1, 4), len(angles) - 1))
    for k in (k for k in marked if k < 36 or k == len(angles) - 1):
        ax.annotate(f"$k={k}$", 1.16 * tip[k], ha="center", va="center")
    ax.set(aspect="equal", xlim=(-1.45, 1.45), ylim=(-1.35, 1.35), xlabel="horizontal", ylabel="vertical")
    ax.legend(loc="upper right")
    return figure


def superposed(parts: Mapping[str, Plan], total: tuple[str, Plan]) -> Figure:
    """Draw plans over their own steps, their sum as crosses, and the plan that the sum should equal.

    The first state and the first input are drawn.
    """
    figure, (above, below) = panels(2, height=2.2)
    plans = {**parts, total[0]: total[1]}
    summed = sum(plan.x for plan in parts.values()), sum(plan.u for plan in parts.values())
    for i, (name, plan) in enumerate(plans.items()):
        _over_steps((above, below), 0, plan.x, plan.u, name, color=f"C{i}", ls="-" if name == total[0] else "--")
    above.plot(np.asarray(summed[0])[:, 0], "x", color=f"C{len(parts)}", ms=7, label="sum of the two")
    below.plot(np.asarray(summed[1])[:, 0], "x", color=f"C{len(parts)}", ms=7, label="sum of the two")
    above.set_ylabel(r"first state $\xi_i$")
    below.set_ylabel(r"first input $\nu_i$")
    below.set_xlabel("step $i$ of the plan")
    above.legend()
    return figure


def shifted_plan(now: tuple[Array, Array], shifted: tuple[Array, Array], then: tuple[Array, Array]) -> Figure:
    r"""Draw a plan of step k, the same plan shifted to step k+1 under the next model, and the plan of step k+1.

    Each is a pair of predicted states (N+1, n) and inputs (N, q); the last input of ``shifted`` is zero, and its end is
    :math:`\tilde r^+` of (26). The first state and the first input are drawn.
    """
    figure, (above, below) = panels(2, height=2.4)
    axes = (above, below)
    _over_steps(axes, 0, *now, "plan of $k$", color="C0")
    _over_steps(axes, 1, *shifted, "shifted plan, with 0 appended", color="C1", ls="--")
    _over_steps(axes, 1, *then, "plan of $k+1$", color="C2", ls=":")
    last = len(now[1])
    for at, x, name, colour in (
        (last, now[0], "$r$", "C0"),
        (last + 1, shifted[0], r"$\tilde r^+$", "C1"),
        (last + 1, then[0], "$r^+$", "C2"),
    ):
        above.annotate(name, (at, x[-1, 0]), (5, 0), textcoords="offset points", color=colour, va="center")
    below.plot([last], [shifted[1][-1, 0]], "s", color="C1", ms=7, mfc="none", label="the appended input")
    above.set_ylabel("first state")
    below.set_ylabel("input")
    below.set_xlabel("step after $k$")
    above.legend()
    below.legend()
    return figure


def projections(normals: Array, levels: Array, centres: Array, minimisers: Array, common: Array) -> Figure:
    r"""Draw proximal steps in the plane towards lines :math:`a_k^\top x = b_k`, the sets of points that fit.

    ``normals`` (K, 2), ``levels`` (K,): a_k and b_k. ``centres`` (K+1, 2), ``minimisers`` (K, 2): the iterates of (20).
    ``common`` (2,): the point on all lines. Dotted: from each centre to its projection onto the line of its step.

    Examples
    --------
    >>> ax = projections(np.eye(2), np.zeros(2), np.ones((3, 2)), np.ones((2, 2)), np.zeros(2)).axes[0]
    >>> [text.get_text() for text in ax.figure.legends[0].get_texts()][-1]
    'common point of all sets'
    """
    figure = Figure(figsize=(WIDTH, 4.6))
    ax = figure.subplots()
    reach = 1.25 * float(np.max(np.linalg.norm(centres - common, axis=1)))
    for k, (a, b) in enumerate(zip(normals, levels, strict=True)):
        along = np.array([-a[1], a[0]]) / np.hypot(*a)
        ends = np.stack([common - 2 * reach * along, common + 2 * reach * along])
        ax.plot(*ends.T, color=f"C{k % 4}", lw=1, alpha=0.8)
        foot = centres[k] - a * (a @ centres[k] - b) / (a @ a)
        ax.plot(*np.stack([centres[k], foot]).T, ":", color=f"C{k % 4}", lw=1.2)
        ax.plot(*foot, "o", mfc="none", color=f"C{k % 4}", ms=6, label="projection onto the set" if k == 0 else None)
        ax.annotate("", minimisers[k], centres[k], arrowprops={"arrowstyle": "->", "color": f"C{k % 4}", "lw": 1.6})
        ax.annotate(f"$X_{k}$", common + 0.93 * reach * along * np.sign(along[1]), ha="left")
    turn = np.linspace(0, 2 * np.pi, 200)
    radius = np.linalg.norm(centres[0] - common)
    ax.plot(common[0] + radius * np.cos(turn), common[1] + radius * np.sin(turn), "--", color="C7", lw=0.8)
    ax.plot(*centres.T, "o", color=mpl.rcParams["text.color"], ms=5, label=r"iterates $\tilde x_k$")
    for k, centre in enumerate(centres):
        ax.annotate(str(k), centre, (5, 5), textcoords="offset points")
    ax.plot(*common, "*", color="C2", ms=13, label="common point of all sets")
    ax.set(
        aspect="equal",
        xlim=(common[0] - reach, common[0] + reach),
        ylim=(common[1] - reach, common[1] + reach),
        xlabel="first entry",
        ylabel="second entry",
    )
    figure.legend(loc="outside lower center", ncols=2)
    return figure


def _over_steps(axes: tuple[Axes, Axes], start: int, x: Array, u: Array, name: str, **settings: Any) -> None:
    """Draw the first state of a plan above and its first input below, from a step on."""
    axes[0].plot(start + np.arange(len(x)), x[:, 0], marker="o", ms=3.5, label=name, **settings)
    axes[1].plot(start + np.arange(len(u)), u[:, 0], marker="o", ms=3.5, label=name, **settings)
