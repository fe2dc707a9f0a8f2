"""Theorem 1: where a scalar loop settles, the loop by hand, the counterexample, and the claims as recorded."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rhl.horizon import solve
from rhl.model import SignalModel
from rhl.paper.claims import theorem_1
from rhl.paper.claims.claim import Effort, judge
from rhl.plants.analysis import pbh
from rhl.problems import V1
from tests.evidence import drift
from tests.sizes import SEEDS, size


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("claim", theorem_1.CLAIMS, ids=lambda claim: claim.id)
def test_as_recorded(claim, seed):
    judgement = judge(claim, effort := Effort(seed, 10))
    assert judgement.as_recorded, judgement
    assert drift(judgement, effort) == ""


@settings(max_examples=size(6, 20), deadline=None)
@given(st.floats(1.1, 2.5), st.floats(0.01, 10.0))
def test_constant_epsilon_settles_where_it_should(a, epsilon):
    """u = -w a x/(R + w) with w = x^2/eps keeps x where a R/(R + w) = 1, so x^2 = eps R (a - 1)."""
    loop = theorem_1.close(SignalModel([[[a]]], [[[1.0]]]), np.array([[1.0]]), lambda k: epsilon, 300, 1)
    assert loop.x[-1, 0, 0] ** 2 == pytest.approx(epsilon * 100.0 * (a - 1), rel=1e-6)


def test_the_loop_is_the_policy_and_the_system():
    model, x0 = theorem_1.systems(np.random.default_rng(0), 3)
    loop = theorem_1.close(model, x0, theorem_1.falling, 5, 4)
    for i in range(3):
        x = x0[i]
        for k in range(5):
            one = SignalModel(model.A[i], model.B[i])
            plan = solve(V1(one, 1.0, 100.0, 1.0, x @ x / theorem_1.falling(k), 4), x)
            assert float(plan.residual()) < 1e-12
            assert np.allclose(loop.x[k, i], x, rtol=1e-9, atol=1e-12)
            assert np.allclose(loop.u[k, i], plan.u[0], rtol=1e-9, atol=1e-12)
            assert np.allclose(loop.r[k, i], plan.x[-1], rtol=1e-9, atol=1e-12)
            x = model.A[i] @ x + model.B[i] @ plan.u[0]


@pytest.mark.parametrize("seed", range(5))
def test_systems_are_what_they_are_drawn_as(seed):
    model, x0 = theorem_1.systems(np.random.default_rng(seed), 1)
    A, B = model.A[0], model.B[0]
    assert np.linalg.matrix_rank(np.hstack([B, A @ B, A @ A @ B])) == 2
    assert pbh(A, B, 1.0) > 1e-6
    assert np.abs(np.linalg.eigvals(A)).max() == pytest.approx(1.3)
    assert np.linalg.norm(x0) == pytest.approx(1.0)


def test_a_system_without_inputs_that_is_stable_comes_to_rest():
    """Stabilizable with no help at all: B = 0, and the weight has nothing to act on."""
    loop = theorem_1.close(SignalModel(0.5 * np.eye(2)[None], np.zeros((1, 2, 1))), np.ones((1, 2)), lambda k: 1.0, 60)
    assert np.all(loop.u == 0)
    assert np.abs(loop.x[-1]).max() < 1e-15


def test_from_zero_nothing_moves():
    model, _ = theorem_1.systems(np.random.default_rng(1), 2)
    loop = theorem_1.close(model, np.zeros((2, 3)), theorem_1.falling, 5)
    assert not np.any(loop.x)
    assert not np.any(loop.u)


@settings(max_examples=size(6, 20), deadline=None)
@given(st.floats(1.1, 1.5), st.floats(-2, 3))
def test_counterexample_meets_the_assumptions_and_diverges(a, exponent):
    run = theorem_1.change(np.array([a]), np.array([10.0**exponent]), theorem_1.vanishing)
    k = np.arange(150)
    assert run.plan_gain.max() <= a * (1 + 1e-12)  # Assumption 5(b)
    assert np.all(
        run.error[:, 0] <= a / (k + 1) * (1 + 1e-12)
    )  # Assumption 4(b): |e_1|^2 <= omega_2 |x|^2, omega_2 -> 0
    assert run.least.max() < 1e-30  # Assumption 4(c): V2 = 0 up to the rounding of a x
    assert np.all(np.abs(run.x[1:, 0]) >= (a - a / (k + 1)) * np.abs(run.x[:-1, 0]) * (1 - 1e-12))
    assert np.all(np.abs(run.x[1:, 0]) <= a ** (k + 1.0) * (1 + 1e-12))
    assert abs(run.x[-1, 0]) >= a**149 / 150 * abs(run.x[1, 0]) * (1 - 1e-9)
    assert run.least_gain[-1, 0] > 1e15  # what the proof needs bounded


def test_counterexample_by_hand():
    """k = 0: b = 1, w = x^2 = 1, so u = -a/2 and x(1) = a/2."""
    run = theorem_1.change(np.array([1.2]), np.array([1.0]), theorem_1.vanishing, steps=1)
    assert run.x[1, 0] == pytest.approx(0.6)
    assert run.plan_gain[0, 0] == pytest.approx(1.0)  # x_0 itself
    assert run.least_gain[0, 0] == pytest.approx(1.2)


def test_with_bounded_gains_it_comes_to_rest():
    run = theorem_1.change(np.array([1.1, 1.5]), np.array([1.0, 0.3]), theorem_1.settling)
    assert run.least_gain.max() <= 3.0 + 1e-12
    assert np.abs(run.x[-1]).max() < 1e-3
