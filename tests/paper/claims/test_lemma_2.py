"""Lemma 2: loops that need its assumptions end where the algebra says, and the claims as recorded."""

import numpy as np
import pytest

from rhl.paper.claims import lemma_2
from rhl.paper.claims.claim import Effort, judge
from rhl.paper.claims.lyapunov_terms import at_the_end, follow, square
from rhl.paper.claims.rotating_models import losing, turning
from tests.evidence import drift
from tests.sizes import SEEDS


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("claim", lemma_2.CLAIMS, ids=lambda claim: claim.id)
def test_as_recorded(claim, seed):
    judgement = judge(claim, effort := Effort(seed, 10))
    assert judgement.as_recorded, judgement
    assert drift(judgement, effort) == ""


def test_losing_controllability_ends_where_the_algebra_says():
    """With r_2 = reach: 0.7 nu_0 = -1.44 x_1 - 1, so x_1 tends to -10/13 and the input to 2/13."""
    setting = losing(300)
    t = follow(setting)
    assert t.x[0, -1, 0] == pytest.approx(-10 / 13, abs=1e-9)
    assert t.plan.u[0, -1, 0] == pytest.approx([2 / 13], abs=1e-9)
    excess = square(t.e1) - setting.omegas[..., 2] * square(t.plan.u[..., 0, :])
    assert excess.max() < 1e-12
    assert np.abs(setting.gains[1][0, -1]).max() > 100


def test_turning_fast_diverges_and_slowly_rests():
    k = np.arange(121.0)
    x0 = np.eye(2)
    r = np.zeros((121, 2))
    assert at_the_end(turning(np.sqrt(k), r, x0)).max() < 1e-3
    assert at_the_end(turning(0.5 * k, r, x0)).max() == 1.0
