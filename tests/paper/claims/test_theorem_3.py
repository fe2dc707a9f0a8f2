"""Theorem 3: claims as recorded, and that their quantities mean what they say."""

from dataclasses import replace

import numpy as np
import pytest

from rhl.controller import Controller
from rhl.estimator import ProximalEstimator
from rhl.losses import WeightedSquares
from rhl.model import SignalModel
from rhl.paper.claims import theorem_3
from rhl.paper.claims.claim import Effort, judge
from rhl.plants import LinearPlant
from rhl.simulation import simulate
from tests.evidence import drift
from tests.sizes import SEEDS


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("claim", theorem_3.CLAIMS, ids=lambda claim: claim.id)
def test_as_recorded(claim, seed):
    judgement = judge(claim, effort := Effort(seed, 10))
    assert judgement.as_recorded, judgement
    assert drift(judgement, effort) == ""


def test_a_batch_is_its_members():
    plant, z0 = theorem_3.random_plants(np.random.default_rng(0), 3)
    together = simulate(theorem_3.scheme_for(3), plant, z0, 10)
    for i in range(3):
        one = theorem_3.LinearPlant(plant.F[i], plant.G[i], plant.H[i])
        alone = simulate(theorem_3.scheme_for(3), one, z0[i], 10)
        assert np.allclose(together.v[:, i], alone.v, rtol=1e-6, atol=1e-9)


def test_plants_are_what_they_are_drawn_as():
    plant, z0 = theorem_3.random_plants(np.random.default_rng(0), 20)
    largest = np.sort(np.abs(np.linalg.eigvals(plant.F)), axis=1)
    assert np.allclose(largest[:, -1], 1.2)
    assert np.allclose(np.linalg.norm(z0, axis=1), 1)
    assert np.all(theorem_3.random_plants(np.random.default_rng(0), 2, reachable=False)[0].G == 0)


def test_end_over_peak_is_one_for_a_run_that_grows():
    class Grown:
        z = np.cumsum(np.ones((5, 2, 3)), axis=0)
        v = np.zeros((5, 2, 1))

    assert np.array_equal(theorem_3.end_over_peak(Grown()), [1.0, 1.0])


def test_factor_and_radius_of_loops_that_are_known():
    """With its own pair as model, z+ = a z + v without terminal weight is the linear-quadratic regulator's loop."""
    a = np.array([1.2, 0.5])
    plant = LinearPlant(a[:, None, None], np.ones((2, 1, 1)), np.ones((2, 1, 1)))
    scheme = replace(
        theorem_3.scheme_for(1, SignalModel(a[:, None, None], np.ones((2, 1, 1)))),
        estimator=ProximalEstimator(2, generator=WeightedSquares(1e15)),
        controller=Controller(Q=1.0, R=3.0, QN=1.0, horizon=30, epsilon=lambda k: 1.0),
    )
    trace = simulate(scheme, plant, np.ones((2, 1)), 60)
    # P solves the scalar Riccati equation; the loop has the pole a R / (R + P).
    half = 3.0 * (a**2 - 1) + 1.0
    P = (half + np.sqrt(half**2 + 12.0)) / 2
    expected = a * 3.0 / (3.0 + P)
    assert np.allclose(theorem_3.radius_without_weight(trace, plant), expected, rtol=1e-6)
    assert np.allclose(theorem_3.late_factor(trace, 20), expected, rtol=1e-6)
    shorter = replace(scheme, controller=replace(scheme.controller, horizon=1))
    other = simulate(shorter, plant, np.ones((2, 1)), 60)
    # A horizon of one step and no terminal weight plans no input.
    assert np.allclose(theorem_3.radius_without_weight(other, plant), a, rtol=1e-9)
