"""How the time of a step grows with the size of the scheme and of the batch; draws build/bench/growth.svg."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rhl.estimator import ProximalEstimator
from rhl.lifting import DelayLifting
from rhl.model import SignalModel
from rhl.paper.published import linear_example
from rhl.simulation import simulate

STEPS = 42
FIGURE = Path(__file__).parent.parent / "build" / "bench" / "growth.svg"
POINTS = {
    "n, outputs and inputs in the lifting": (2, 3, 4, 6, 8, 12),
    "N, horizon": (5, 10, 20, 40, 80),
    "window": (4, 8, 16, 32, 64),
    "batch": (1, 4, 16, 64, 256, 1024, 4096),
}
ROUNDS = 15
LAST = 3  # points at the right end, through which the slope is taken: the left end is what a run costs in any case


def run(axis, size):
    """A run of the linear example with one size changed; returns a function."""
    made = linear_example()
    scheme, z0 = made.scheme, made.z0
    if axis.startswith("n,"):
        scheme = replace(
            scheme, lifting=DelayLifting(size, size), initial_model=SignalModel.companion_of_ones(size, size)
        )
    elif axis.startswith("N,"):
        scheme = replace(scheme, controller=replace(scheme.controller, horizon=size))
    elif axis == "window":
        scheme = replace(scheme, estimator=ProximalEstimator(size))
    elif size > 1:
        z0 = z0 * np.linspace(0.5, 1.5, size)[:, None]
    return lambda: simulate(scheme, made.plant, z0, STEPS)


@pytest.fixture(scope="module")
def medians():
    """Seconds a step by axis and size; drawn when all are there."""
    found = {axis: {} for axis in POINTS}
    yield found
    if all(len(found[axis]) == len(POINTS[axis]) for axis in POINTS):
        draw(found)


@pytest.mark.parametrize(("axis", "size"), [(axis, size) for axis in POINTS for size in POINTS[axis]])
def test_growth(benchmark, medians, axis, size):
    benchmark.group = f"growth of a step: {axis}"
    rounds = ROUNDS if size < 1000 else 3
    trace = benchmark.pedantic(run(axis, size), rounds=rounds, warmup_rounds=size < 1000)
    assert len(trace) == STEPS
    benchmark.extra_info.update({"row": str(size), "steps": STEPS})
    if benchmark.stats:
        medians[axis][size] = benchmark.stats.stats.median / STEPS


def slope(sizes, times):
    """The exponent with which the time grows at the right end."""
    return np.polyfit(np.log(sizes[-LAST:]), np.log(times[-LAST:]), 1)[0]


def draw(found):
    """Four panels on logarithmic axes, with the slopes named below."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 7), layout="constrained")
    panels, named = figure.subplots(2, 2).flat, []
    for panel, (axis, of) in zip(panels, found.items(), strict=True):
        sizes, times = (np.array(list(values), dtype=float) for values in (of.keys(), of.values()))
        panel.loglog(sizes, times * 1e6, "o-", color="C0")
        panel.set_xticks(sizes, [f"{size:g}" for size in sizes])
        low, high = np.floor(np.log10(times.min() * 1e6)), np.ceil(np.log10(times.max() * 1e6))
        panel.set_ylim(10**low, 10**high)  # whole decades, so that what hardly grows is seen to
        panel.minorticks_off()
        panel.set(xlabel=axis, ylabel="a step, us" if axis != "batch" else "a step of the whole batch, us")
        panel.grid(alpha=0.3)
        named.append(f"{axis.partition(',')[0]} {slope(sizes, times):.2f}")
    figure.supxlabel(
        f"Median time of a step. Slopes through the last {LAST} points, time growing like size to the power of:\n"
        + "; ".join(named),
        fontsize="medium",
    )
    FIGURE.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(FIGURE)
