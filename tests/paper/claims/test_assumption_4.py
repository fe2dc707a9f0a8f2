"""Assumption 4, equations (5)-(9): exact small cases, properties, and the claims as recorded."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from rhl.horizon import solve
from rhl.model import SignalModel
from rhl.paper.claims import assumption_4, predictors
from rhl.paper.claims.claim import Effort, judge
from rhl.paper.claims.rotating_models import PLANE, consistent_model, rotation
from rhl.problems import V3
from tests.evidence import drift
from tests.sizes import SEEDS

small = st.integers(-3, 3)


def exact(M):
    return np.array([[Fraction(int(entry)) for entry in row] for row in M])


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("claim", assumption_4.CLAIMS, ids=lambda claim: claim.id)
def test_as_recorded(claim, seed):
    judgement = judge(claim, effort := Effort(seed, 10))
    assert judgement.as_recorded, judgement
    assert drift(judgement, effort) == ""


@given(arrays(int, (2, 2), elements=small), arrays(int, (2, 2), elements=small), arrays(int, (5, 2), elements=small))
def test_powers_commute_whatever_the_model(A, B, s):
    """Nilpotent, singular, zero, repeated eigenvalues, q = n: (7) is exact for all of them."""
    maps = predictors.powers(exact(A), exact(B), 4)
    assert max(predictors.commutation_gaps(maps, np.array([Fraction(1), Fraction(-2)]), exact(s))) == 0


@given(arrays(int, (2, 2), elements=small), arrays(int, (2, 1), elements=small), arrays(int, (3, 1), elements=small))
def test_the_library_predicts_what_exact_arithmetic_does(A, B, s):
    x = np.array([2, -1])
    library = SignalModel(A.astype(float), B.astype(float)).predictor(3).predict(x, s)
    maps = predictors.powers(exact(A), exact(B), 3)
    for i in range(4):
        assert np.array_equal(library[i], predictors.predict(maps, i, x, exact(s)).astype(float))


@given(arrays(int, (2, 2), elements=small), arrays(int, (2, 1), elements=small))
def test_predictions_are_steps_of_the_model(A, B):
    """P_i by (5) against i steps of x+ = Ax + Bu."""
    maps = predictors.powers(exact(A), exact(B), 4)
    s = exact([[1], [-2], [3], [0]])
    x = start = np.array([Fraction(1), Fraction(3)])
    for i in range(4):
        assert np.array_equal(predictors.predict(maps, i, start, s), x)
        x = exact(A) @ x + exact(B) @ s[i]


def test_range_of_seven_as_printed_names_a_map_that_is_not_there():
    maps = predictors.powers(exact([[2]]), exact([[1]]), 2)
    x, s = np.array([Fraction(1)]), exact([[1], [1], [1]])
    assert max(predictors.commutation_gaps(maps, x, s)) == 0
    assert predictors.commutation_gaps(maps, x, s, printed=True).count(1) == 4  # (i, j) with i + j = 3


def test_seven_as_printed_holds_where_that_map_is_there(monkeypatch):
    right = predictors.powers
    monkeypatch.setattr(assumption_4, "powers", lambda A, B, N: right(A, B, N + 1))
    assert assumption_4.check_commuting(Effort(0, 8), printed=True).passes


def test_error_of_no_step_is_zero_for_any_predictor():
    """e_0 = A_0 x - x = 0: the proof of Lemma 2 cannot mean e_0."""
    wrong = predictors.powers(exact([[5]]), exact([[7]]), 1)
    assert predictors.predict(wrong, 0, np.array([Fraction(3)]), exact([[1]])) == 3


def test_consistent_model_is_right_about_its_own_first_step_at_every_angle():
    model = consistent_model()
    assert np.abs(model.A - PLANE * np.eye(2)).max() > 0.3
    for angle in (0.0, 1.0, -2.5):
        T = rotation(np.array(angle))
        turned = SignalModel(T @ model.A @ T.T, T @ model.B @ T.T)
        for x in np.eye(2):
            plan = solve(V3(turned, 1.0, 1.0, np.zeros(2), 2), x)
            assert plan.x[1] == pytest.approx(PLANE * x + plan.u[0], abs=1e-12)
