"""Lemma 6 and Remark 4: the pair (55) against python-control, exact small cases, and the claims as recorded."""

from fractions import Fraction

import control
import numpy as np
import pytest
import sympy as sp
from hypothesis import given
from hypothesis import strategies as st

from rhl.lifting import DelayLifting
from rhl.paper.claims import kalman, lemma_6, remark_4
from rhl.paper.claims.claim import Effort, judge
from rhl.plants import analysis
from tests.evidence import drift
from tests.sizes import SEEDS

ROUNDING = 1e-9  # through O and its pseudo-inverse, of condition at most 1e3


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("claim", lemma_6.CLAIMS, ids=lambda claim: claim.id)
def test_as_recorded(claim, seed):
    judgement = judge(claim, effort := Effort(seed, 10))
    assert judgement.as_recorded, judgement
    assert drift(judgement, effort) == ""


@given(st.floats(-2, 2), st.floats(0.1, 2), st.integers(1, 4))
def test_scalar_plants_by_hand(a, b, m):
    """For z+ = az + bv, y = z the first row of (55) must reproduce y(k+1) = a y(k) + b v(k) on every trajectory."""
    F, G, H = np.array([[a]]), np.array([[b]]), np.array([[1.0]])
    model = analysis.signal_model(F, G, H, m)
    v = np.sin(np.arange(m + 6.0))[:, None]
    y = [0.7]
    for row in v[:-1, 0]:
        y.append(a * y[-1] + b * row)
    misfits = lemma_6.transition_misfits(model, np.array(y)[:, None], v, m)
    assert misfits[m - 1 :].max() < ROUNDING


def test_integrator_exactly():
    model = analysis.signal_model(np.array([[1.0]]), np.array([[1.0]]), np.array([[1.0]]), 1)
    assert np.allclose(model.A, [[1.0]], atol=1e-15)
    assert np.allclose(model.B, [[1.0]], atol=1e-15)


def test_observability_matrix_is_that_of_python_control():
    form = kalman.kalman_form(np.random.default_rng(0), 2, 1, (2, 1, 0))
    F, _, H = form.observable
    ours = analysis.observability(F, H, 3).reshape(3, 2, 3)[::-1].reshape(6, 3)
    assert np.allclose(ours, control.obsv(F, H))


@pytest.mark.parametrize(
    ("A", "B", "least", "controllable"),
    [
        (np.diag([2.0, 0.5]), [[1.0], [0.0]], 1.0, True),
        (np.diag([2.0, 0.5]), [[1.0], [0.0]], 0.0, False),
        (np.diag([2.0, 0.5]), [[0.0], [1.0]], 1.0, False),
        (np.eye(2), [[1.0], [1.0]], 0.0, False),  # a repeated eigenvalue needs two inputs
        (np.eye(2), np.eye(2), 0.0, True),
    ],
)
def test_pbh_on_cases_that_can_be_seen(A, B, least, controllable):
    assert (analysis.pbh(A, np.array(B), least) > 1e-12) == controllable


def test_pbh_without_unstable_modes():
    assert analysis.pbh(np.array([[0.5]]), np.array([[0.0]]), 1.0) == np.inf


def test_drawn_plants_have_the_form():
    form = kalman.kalman_form(np.random.default_rng(1), 2, 2, (2, 2, 2))
    assert np.all(form.F[2:4, :2] == 0)
    assert np.all(form.F[:4, 4:] == 0)
    assert np.all(form.G[2:4] == 0)
    assert np.all(form.H[:, 4:] == 0)
    assert analysis.spectral_radius(form.F[:2, :2]) == pytest.approx(1.2)
    assert analysis.spectral_radius(form.F[4:, 4:]) == pytest.approx(0.8)


def test_another_pair_of_the_same_plant_may_not_be_stabilizable_once_augmented():
    """Exercise 2 of the notebook: y+ = (a-c) y + c a y(k-1) + v + c v(k-1) has the unreachable mode -c."""
    a, c = 1.1, 1.5
    lifted = lemma_6.SignalModel(np.array([[a - c, c * a], [1.0, 0.0]]), np.array([[1.0, c], [0.0, 0.0]]))
    augmented = DelayLifting(2, 2).augment(lifted)
    assert analysis.pbh(lifted.A, lifted.B, 1.0) > 0.1
    assert analysis.pbh(augmented.A, augmented.B, 1.0) < 1e-12


def test_first_transitions_fit_no_pair_at_all():
    """Not only (55): least squares over all pairs fails on the first m-1 transitions too."""
    rng = np.random.default_rng(3)
    form = kalman.kalman_form(rng, 1, 1, (2, 0, 0))
    v = rng.normal(size=(40, 1))
    y = kalman.run_open_loop(form.plant(np.eye(2)), rng.normal(size=2), v)
    x, u = kalman.stacked(y, 3), kalman.stacked(v, 3)
    rows = np.hstack([x, u])

    def misfit(first):
        left = x[first + 1 :] - rows[first:-1] @ np.linalg.lstsq(rows[first:-1], x[first + 1 :], rcond=None)[0]
        return np.abs(left).max() / np.abs(x).max()

    assert misfit(2) < ROUNDING
    assert misfit(0) > 1e-6


def test_latest_pair_by_hand():
    """z+ = a z + b v, y = z: index one; y(k+1) from the latest alone, whatever is stacked."""
    model = lemma_6.latest_pair(np.array([[0.5]]), np.array([[2.0]]), np.array([[1.0]]), 1, 3)
    np.testing.assert_allclose(model.A, [[0.5, 0, 0], [1, 0, 0], [0, 1, 0]])
    np.testing.assert_allclose(model.B, [[2, 0, 0], [0, 0, 0], [0, 0, 0]], atol=1e-15)


def test_the_pair_of_55_breaks_more_of_the_first_transitions_than_it_must():
    rng = np.random.default_rng(2)
    form = kalman.kalman_form(rng, 2, 1, (4, 0, 1))
    (F, G, H), m = form.observable, 5
    v = rng.normal(size=(20, 1))
    y = kalman.run_open_loop(form.plant(np.eye(5)), rng.normal(size=5), v)
    misfits = [
        lemma_6.transition_misfits(model, y, v, m)
        for model in (analysis.signal_model(F, G, H, m), lemma_6.latest_pair(F, G, H, 2, m))
    ]
    assert [int(np.flatnonzero(of > 1e-6)[-1]) for of in misfits] == [3, 0]


@pytest.mark.parametrize(
    ("A", "B", "stabilizable"),
    [
        ([[2, 0], [0, Fraction(1, 2)]], [[1], [0]], True),
        ([[2, 0], [0, 1]], [[1], [0]], False),
        ([[Fraction(1, 2)]], [[0]], True),
    ],
)
def test_stabilizable_exactly(A, B, stabilizable):
    assert remark_4.stabilizable_exactly(sp.Matrix(A), sp.Matrix(B)) == stabilizable


def test_stabilizable_exactly_wants_rational_eigenvalues():
    with pytest.raises(ValueError, match="rational"):
        remark_4.stabilizable_exactly(sp.Matrix([[0, 2], [1, 0]]), sp.Matrix([[0], [0]]))


def test_numbers_of_the_second_reading():
    """(1.2, [1, -1.2]): 1.56 for the lifted pair and rounding for the augmented one, at the mode 1.2."""
    lifted = lemma_6.SignalModel(np.array([[1.2]]), np.array([[1.0, -1.2]]))
    augmented = DelayLifting(1, 2).augment(lifted)
    assert analysis.pbh(lifted.A, lifted.B, 1.0) == pytest.approx(1.562, abs=1e-3)
    assert analysis.pbh(augmented.A, augmented.B, 1.0) < 1e-15


def test_a_case_that_says_nothing_of_augmentation_is_no_evidence(monkeypatch):
    monkeypatch.setattr(remark_4, "stabilizable_exactly", lambda A, B: False)
    assert not remark_4.check_every_pair(Effort()).conclusive


def test_hidden_blocks_have_the_radius_that_is_asked_for():
    """Blocks drawn nearly nilpotent were left stable, and then the control of the converse did not fail."""
    rng = np.random.default_rng(0)
    for _ in range(200):
        form = kalman.kalman_form(rng, 1, 2, (2, 1, 1), 1.05)
        assert abs(form.F[3, 3]) == pytest.approx(1.05)
