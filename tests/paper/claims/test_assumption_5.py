"""Assumption 5: gains and bounds of small cases by hand, and the claims as recorded."""

import numpy as np
import pytest

from rhl.model import PredictorMaps
from rhl.paper.claims import assumption_5, lemma_1
from rhl.paper.claims.claim import Effort, judge
from tests.evidence import drift
from tests.sizes import SEEDS


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("claim", assumption_5.CLAIMS, ids=lambda claim: claim.id)
def test_as_recorded(claim, seed):
    judgement = judge(claim, effort := Effort(seed, 10))
    assert judgement.as_recorded, judgement
    assert drift(judgement, effort) == ""


def test_bound_is_met_with_equal_weights():
    """With Q = R = I the feasible gain is the optimal one, and the bound leaves out nothing but xi_N's rows."""
    maps = lemma_1.random_maps(np.random.default_rng(2), 2, 1, 3)
    gain, bound = assumption_5.gain_and_bound(maps, np.eye(2), np.eye(1))
    _, C, B = lemma_1.stacked_form(maps, np.eye(2), np.eye(1))
    assert bound == pytest.approx(np.linalg.norm(np.linalg.pinv(C) @ B, 2))
    assert gain == pytest.approx(np.linalg.norm((np.linalg.pinv(C) @ B)[:-2], 2))
    assert gain < bound


def test_the_least_gain_of_a_scalar_problem():
    """One step, one state: nu = (r - a x)/b, and the largest gain is that of (a, -1)/|b|, with xi_0 = x."""
    a, b = 1.5, 0.2
    maps = PredictorMaps(np.array([[[1.0]], [[a]]]), np.array([[[b]]]))
    gain = assumption_5.gain_of(maps, np.eye(1), np.eye(1))
    assert gain == pytest.approx(np.linalg.norm(np.array([[1.0, 0.0], [-a / b, 1 / b]]), 2), rel=1e-9)


def test_x_tends_to_five_twentysixths():
    of = assumption_5.fading_reach()
    assert of.x[-1, 0, 0] == pytest.approx(5 / 26, abs=1e-4)
    assert np.max(assumption_5.met_plans(of)) < 5
