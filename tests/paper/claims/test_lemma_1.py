"""Lemma 1: closed forms of V3 and V2, the least-norm problem, hard cases, and the claims as recorded."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rhl.errors import InfeasibleError
from rhl.horizon import solve
from rhl.model import PredictorMaps, SignalModel
from rhl.paper.claims import lemma_1
from rhl.paper.claims.claim import Effort, judge
from rhl.problems import V2, V3
from tests.evidence import drift
from tests.sizes import SEEDS

ROUNDING = 1e-9  # well conditioned systems of at most twenty unknowns


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("claim", lemma_1.CLAIMS, ids=lambda claim: claim.id)
def test_as_recorded(claim, seed):
    judgement = judge(claim, effort := Effort(seed, 10))
    assert judgement.as_recorded, judgement
    assert drift(judgement, effort) == ""


@given(st.floats(-3, 3), st.floats(1e-6, 1e3), st.floats(-5, 5), st.floats(-5, 5))
def test_one_step_by_hand(a, b, x, r):
    """For n = q = N = 1 the constraint alone decides: u = (r - a x) / b, however small b is."""
    maps = PredictorMaps([[[1.0]], [[a]]], [[[b]]])
    u = solve(V3(maps, 2.0, 3.0, [r], 1), [x]).u
    assert u[0, 0] == pytest.approx((r - a * x) / b, rel=1e-12, abs=1e-12 / b)


def test_two_steps_by_hand():
    """x+ = x + u, N = 2, Q = R = 1, x = 1, r = 0: minimise (1 + u)^2 + u^2 + (1 + u)^2, so u = -2/3 and -1/3."""
    plan = solve(V3(SignalModel([[1.0]], [[1.0]]), 1.0, 1.0, [0.0], 2), [1.0])
    assert np.allclose(plan.u[:, 0], [-2 / 3, -1 / 3], atol=1e-15)
    assert float(plan.value) == pytest.approx(1 + 1 / 9 + 4 / 9 + 1 / 9, rel=1e-14)


@given(st.integers(1, 3), st.integers(1, 3), st.integers(0, 10_000))
def test_unit_weights_give_the_pseudo_inverse(n, q, seed):
    """With Q = R = I the objective is |w|^2 less a constant, so the solution is C'(CC')^-1 B [x; r]."""
    rng = np.random.default_rng(seed)
    maps = lemma_1.random_maps(rng, n, q, n + 1)
    _, C, B = lemma_1.stacked_form(maps, np.eye(n), np.eye(q))
    x, r = rng.normal(size=(2, n))
    w = C.T @ np.linalg.solve(C @ C.T, B @ np.concatenate([x, r]))
    plan = solve(V3(maps, 1.0, 1.0, r, n + 1), x)
    rows = np.concatenate([plan.u, plan.x[:-1]], axis=1)
    assert np.allclose(np.concatenate([rows.ravel(), plan.x[-1]]), w, atol=ROUNDING * (1 + np.abs(w).max()))


@given(st.integers(1, 3), st.integers(1, 3), st.integers(0, 10_000))
def test_predictions_satisfy_the_stacked_constraint(n, q, seed):
    rng = np.random.default_rng(seed)
    maps = lemma_1.random_maps(rng, n, q, n)
    x0, u = rng.normal(size=n), rng.normal(size=(n, q))
    x = maps.predict(x0, u)
    Q, R = lemma_1.random_weight(rng, n), lemma_1.random_weight(rng, q)
    H, C, B = lemma_1.stacked_form(maps, Q, R)
    w = np.concatenate([np.concatenate([u, x[:-1]], axis=1).ravel(), x[-1]])
    assert np.allclose(C @ w, B @ np.concatenate([x0, x[-1]]), atol=1e-12)
    assert w @ H @ w == pytest.approx(sum(s @ Q @ s for s in x[:-1]) + sum(v @ R @ v for v in u))


@given(st.floats(-5, 0), st.integers(0, 100))
def test_superposition_close_to_a_loss_of_rank(exponent, seed):
    """The gains grow like one over the lost direction, and so does rounding; linear in (x, r) the solution stays."""
    rng = np.random.default_rng(seed)
    maps = lemma_1.random_maps(rng, 2, 1, 3)
    maps = PredictorMaps(maps.A, maps.B * np.array([1.0, 10.0**exponent])[:, None])
    x, r = rng.normal(size=(2, 3, 2))
    x[2], r[2] = x[0] + x[1], r[0] + r[1]
    u = [solve(V3(maps, 1.0, 1.0, r[i], 3), x[i]).u for i in range(3)]
    assert np.abs(u[2] - u[0] - u[1]).max() <= ROUNDING * max(1.0, *(np.abs(each).max() for each in u))


def test_nothing_to_do_costs_nothing():
    maps = lemma_1.random_maps(np.random.default_rng(0), 3, 2, 4)
    plan = solve(V3(maps, 1.0, 1.0, np.zeros(3), 4), np.zeros(3))
    assert float(plan.value) == 0
    assert np.all(plan.u == 0)


def test_least_norm_solution_of_v2_is_a_solution_of_v3():
    """The step of the proof of part (b): Q = R = I and r = V2's terminal state."""
    rng = np.random.default_rng(1)
    maps = lemma_1.random_maps(rng, 3, 1, 3)
    maps = PredictorMaps(maps.A, maps.B * np.array([1.0, 1.0, 0.0])[:, None])
    x = rng.normal(size=3)
    best = solve(V2(maps, 2.0, 3), x)
    assert float(best.value) > 1e-3
    assert np.allclose(solve(V3(maps, 1.0, 1.0, best.x[-1], 3), x).u, best.u, atol=ROUNDING)


def test_out_of_reach_is_refused():
    maps = PredictorMaps(np.stack([np.eye(2)] * 3), np.array([[[1.0], [0.0]]] * 2))
    with pytest.raises(InfeasibleError, match="no input sequence of 2 steps"):
        solve(V3(maps, 1.0, 1.0, [0.0, 1.0], 2), [0.0, 0.0])
