"""What generality costs: every way through equation (15) beside the closed form, in one run."""

import time

import numpy as np
import pytest

from rhl.constraints import LinearConstraints
from rhl.estimator import ProximalEstimator
from rhl.losses import CustomLoss, Entropy, LogCosh, PseudoHuber, WeightedSquares, _descent
from rhl.model import SignalModel

SEED = 2010_05891
SHIFT = LinearConstraints.shift(1, 4, 1, 4)


def own(of, *more, **facts):
    return CustomLoss(of.value, of.gradient, *more, assumption_6=True, convex_in_second=True, **facts)


SQUARES = WeightedSquares()
WAYS = {
    "squares, closed form": ProximalEstimator(8),
    "squares, closed form, shift rows known": ProximalEstimator(8, constraints=SHIFT),
    "squares, by the solver": ProximalEstimator(8, own(SQUARES, SQUARES.hessian), own(SQUARES, SQUARES.hessian)),
    "log-cosh": ProximalEstimator(8, LogCosh(0.1)),
    "log-cosh, shift rows known": ProximalEstimator(8, LogCosh(0.1), constraints=SHIFT),
    "log-cosh, data a thousand times its scale": ProximalEstimator(8, LogCosh(1e-3)),
    "pseudo-Huber": ProximalEstimator(8, PseudoHuber(0.1)),
    "entropy": ProximalEstimator(8, SQUARES, Entropy()),
    "log-cosh of the user's own": ProximalEstimator(8, own(LogCosh(0.1), LogCosh(0.1).hessian)),
    "the same without second derivatives": ProximalEstimator(8, own(LogCosh(0.1))),
    "the same, said to be separable": ProximalEstimator(8, own(LogCosh(0.1), separable=True)),
    "log-cosh, a matrix as the generator's weight": ProximalEstimator(
        8, LogCosh(0.1), WeightedSquares(np.eye(32) + 0.1)
    ),
}


def window(way):
    rng = np.random.default_rng(SEED)
    x, u = rng.standard_normal((9, 4)), rng.standard_normal((8, 4))
    centre = SignalModel.shift_of_ones(1, 4, 1, 4)
    if way == "entropy":
        centre = SignalModel(np.full((4, 4), 0.2), np.full((4, 4), 0.2))
    return centre, x, u


@pytest.mark.parametrize("way", WAYS)
def test_one_window(benchmark, way):
    benchmark.group = "one window of the linear example's size"
    problem = window(way)
    found = benchmark(lambda: WAYS[way].minimise(*problem))
    assert WAYS[way].newton_decrement(found, *problem) < 1e-9


@pytest.mark.parametrize("way", WAYS)
def test_one_certificate(benchmark, way):
    benchmark.group = "one certificate"
    problem = window(way)
    found = WAYS[way].minimise(*problem)
    assert benchmark(lambda: WAYS[way].newton_decrement(found, *problem)) < 1e-9


@pytest.mark.parametrize("weight", [1.0, np.linspace(0.5, 2, 3200)], ids=["one weight", "weights by entry"])
def test_one_large_certificate(benchmark, weight):
    """Forty outputs and inputs of a plant with one of each: 3200 parameters."""
    benchmark.group = "one certificate, 3200 parameters"
    rng = np.random.default_rng(SEED)
    centre = SignalModel(rng.standard_normal((40, 40)), rng.standard_normal((40, 40)))
    x, u, made = (
        rng.standard_normal((81, 40)),
        rng.standard_normal((80, 40)),
        ProximalEstimator(80, WeightedSquares(weight)),
    )
    found = made.minimise(centre, x, u)
    assert benchmark(lambda: made.newton_decrement(found, centre, x, u)) < 1e-9


def seconds(function, count=20):
    function()
    begin = time.perf_counter()
    for _ in range(count):
        function()
    return (time.perf_counter() - begin) / count


@pytest.mark.parametrize("way", ["log-cosh", "pseudo-Huber", "entropy", "log-cosh of the user's own"])
def test_ratios(way, capsys):
    """Newton's method row by row beside scipy's on the whole, as it was, and beside the closed form."""
    centre, x, u = problem = window(way)
    made = WAYS[way]
    whole = made._problems(made.loss, centre, x, u)[1][0].whole
    ours, closed = seconds(lambda: made.minimise(*problem)), seconds(lambda: ProximalEstimator(8).minimise(*problem))
    scipys = seconds(lambda: _descent._by_scipy(whole, centre.theta))
    with capsys.disabled():
        print(f"\n{way}: {1e3 * ours:.2f} ms, {ours / closed:.0f} closed forms, 1/{scipys / ours:.1f} of scipy's time")
    assert ours < scipys
