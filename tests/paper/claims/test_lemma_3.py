"""Lemma 3: the scalar case in closed form, how sharp the constant is, hard cases, and the claims as recorded."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rhl.horizon import solve
from rhl.model import PredictorMaps
from rhl.paper.claims import lemma_3
from rhl.paper.claims.claim import Effort, judge
from rhl.problems import V2
from tests.evidence import drift
from tests.sizes import SEEDS

ROUNDING = 1e-9


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("claim", lemma_3.CLAIMS, ids=lambda claim: claim.id)
def test_as_recorded(claim, seed):
    judgement = judge(claim, effort := Effort(seed, 10))
    assert judgement.as_recorded, judgement
    assert drift(judgement, effort) == ""


@given(st.floats(0.01, 100), st.floats(-4, 4))
def test_scalar_ratio_by_hand(a, exponent):
    """With s = Gamma/eps: x_1 = a/(1 + s), V2 = 0, Gamma = 1 + a^2."""
    s = 10.0**exponent
    found, rounding = lemma_3.ratio(*lemma_3.scalar_case(a), (1 + a**2) / s, 1.0)
    assert found == pytest.approx(s * a**2 / ((1 + s) ** 2 * (1 + a**2)), rel=1e-9, abs=1e-12)
    assert found <= 0.25 + rounding


def test_a_quarter_is_nearly_reached():
    found, _ = lemma_3.ratio(*lemma_3.scalar_case(1000.0), 1 + 1e6, 1.0)
    assert found == pytest.approx(0.25, rel=2e-6)


def test_size_by_hand():
    """x+ = 2x + u from x = 3: V2's solution is u = -6, and xi_1 = 0 is not counted."""
    maps = PredictorMaps([[[1.0]], [[2.0]]], [[[1.0]]])
    assert lemma_3.size_of(solve(V2(maps, 1.0, 1), [3.0])) == pytest.approx(9 + 36)


def test_rho_by_hand():
    assert lemma_3.rho(np.diag([1.0, 3.0]), np.array([[7.0]]), 2.0) == 3.5
    assert lemma_3.rho(np.diag([1.0, 8.0]), np.array([[7.0]]), 2.0) == 4.0


@given(st.integers(0, 10_000), st.floats(-8, 3), st.floats(-12, 0))
def test_a_quarter_for_maps_close_to_a_loss_of_rank(seed, exponent, lost):
    """V2's solution, and with it Gamma, grows like one over the lost direction."""
    maps, Q, R, QN, x = lemma_3.draw(np.random.default_rng(seed))
    maps = PredictorMaps(maps.A, maps.B * np.append(np.ones(maps.n - 1), 10.0**lost)[:, None])
    found, rounding = lemma_3.ratio(maps, Q, R, QN, x, 10.0**exponent, 1.0)
    assert found <= 0.25 + ROUNDING + 10 * rounding


@given(st.integers(0, 10_000), st.floats(-6, 2))
def test_never_below_the_least(seed, exponent):
    """V2 is a minimum: the left side of (12) is nonnegative but for rounding."""
    found, rounding = lemma_3.ratio(*lemma_3.draw(np.random.default_rng(seed)), 10.0**exponent, 1.0)
    assert found >= -10 * rounding


@given(st.integers(0, 1000), st.floats(1.0, 50.0))
def test_a_larger_gamma_makes_it_smaller(seed, factor):
    case = lemma_3.draw(np.random.default_rng(seed))
    once, rounding = lemma_3.ratio(*case, 1.0, 1.0)
    more, _ = lemma_3.ratio(*case, 1.0, factor)
    assert more <= once + 10 * rounding
