"""What generality costs: the closed form against scipy on one window; groups are to be compared side by side."""

import numpy as np
import pytest

from rhl.constraints import LinearConstraints
from rhl.estimator import ProximalEstimator
from rhl.losses import CustomLoss, Entropy, LogCosh, WeightedSquares
from rhl.model import SignalModel

SEED = 2010_05891
SQUARES = CustomLoss(
    lambda x: x @ x,
    lambda x: 2 * x,
    lambda x: np.full(len(x), 2.0),
    assumption_6=True,
    convex_in_second=True,
)
WAYS = {
    "squares, closed form": ProximalEstimator(8),
    "squares, closed form, shift rows known": ProximalEstimator(8, constraints=LinearConstraints.shift(1, 4, 1, 4)),
    "squares, by the solver": ProximalEstimator(8, SQUARES, SQUARES),
    "log-cosh": ProximalEstimator(8, LogCosh(0.1)),
    "log-cosh, data a thousand times its scale": ProximalEstimator(8, LogCosh(1e-3)),
    "entropy": ProximalEstimator(8, WeightedSquares(), Entropy()),
}


@pytest.mark.parametrize("way", WAYS)
def test_one_window(benchmark, way):
    benchmark.group = "one window of the linear example's size"
    rng = np.random.default_rng(SEED)
    x, u = rng.standard_normal((9, 4)), rng.standard_normal((8, 4))
    centre = SignalModel.shift_of_ones(1, 4, 1, 4)
    if way == "entropy":
        centre = SignalModel(np.full((4, 4), 0.2), np.full((4, 4), 0.2))
    found = benchmark(lambda: WAYS[way].minimise(centre, x, u))
    assert WAYS[way].newton_decrement(found, centre, x, u) < 1e-9
