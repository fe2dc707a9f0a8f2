"""Theorem 2(i), (ii): estimates against closed forms, the spiral, prediction bounds, the ledger's lines."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rhl.basis import Terms
from rhl.memory import GrowingMemory
from rhl.model import SignalModel
from rhl.paper.claims import estimator_setup, theorem_2, window_proof
from rhl.paper.claims.claim import Effort, judge
from rhl.paper.claims.estimation import (
    draw_model,
    estimate,
    omega_sums,
    omegas,
    prediction_errors,
    regressor_matrix,
    spiral_estimates,
    stacked_signals,
    theta_matrix,
    trajectory,
)
from rhl.paper.claims.proximal import tangential_turns
from rhl.paper.claims.theorem_2 import CLAIMS, check_prehistory, example_record, example_transitions
from rhl.paper.claims.window_proof import check_window, window_gap
from rhl.paper.published import linear_example
from rhl.simulation import simulate
from tests.evidence import drift
from tests.sizes import SEEDS

ROUNDING = 1e-10


@pytest.fixture(scope="module")
def example():
    example = linear_example()
    return simulate(example.scheme, example.plant, example.z0, 40)


def test_regressor_matrix_written_out():
    x, u = np.array([[9.0, 9.0], [1.0, 2.0]]), np.array([[3.0]])
    expected = [[1, 0, 2, 0, 3, 0], [0, 1, 0, 2, 0, 3]]
    np.testing.assert_array_equal(regressor_matrix(x, u), expected)
    np.testing.assert_array_equal(stacked_signals(x), [9, 9])


def test_scalar_estimate_has_its_closed_form():
    # One transition 2 -> 3 with u = 1: theta moves along the regressor by error / (1 + |regressor|^2).
    initial = SignalModel([[0.5]], [[0.0]])
    record = estimate(np.array([[2.0], [3.0]]), np.array([[1.0]]), initial, 1, np.zeros(1))
    np.testing.assert_allclose(record.models[1].theta, np.array([0.5, 0.0]) + np.array([2.0, 1.0]) * 2.0 / 6.0)
    np.testing.assert_allclose(record.residuals(1, record.best[0]), [[2.0 / 6.0]])


def test_mixing_takes_its_share_of_the_old_model():
    initial = SignalModel([[0.5]], [[0.0]])
    record = estimate(np.array([[2.0], [3.0]]), np.array([[1.0]]), initial, 1, np.array([0.25]))
    np.testing.assert_allclose(record.models[1].theta, 0.75 * record.best[0].theta + 0.25 * initial.theta)


def test_zero_data_leave_the_model_alone():
    initial = SignalModel([[0.5]], [[2.0]])
    record = estimate(np.zeros((6, 1)), np.zeros((5, 1)), initial, 3, np.zeros(5))
    assert all(np.array_equal(model.theta, initial.theta) for model in record.models)


def test_data_before_zero_are_zero():
    record = estimate(np.ones((3, 1)), np.ones((2, 1)), SignalModel([[1.0]], [[0.0]]), 4, np.zeros(2))
    x, u = record.data(2)
    np.testing.assert_array_equal(x[:, 0], [1, 1, 1, 0, 0])
    np.testing.assert_array_equal(u[:, 0], [1, 1, 0, 0])


def test_estimates_are_those_of_the_closed_loop(example):
    record, _ = example_record(example)
    again = estimate(record.x, record.u, record.models[0], record.window, np.zeros(len(record.u)))
    for ours, theirs in zip(again.models, record.models, strict=True):
        np.testing.assert_allclose(ours.theta, theirs.theta, atol=1e-9)


def test_spiral_through_the_estimator_is_the_spiral_by_formula():
    record = spiral_estimates(300)
    norm, angle = tangential_turns(300)
    b = np.array([model.B[0] for model in record.models])
    np.testing.assert_allclose(np.hypot(*b.T), norm, rtol=1e-11)
    np.testing.assert_allclose(np.unwrap(np.arctan2(*b.T[::-1])), angle, atol=1e-10)
    assert not record.x.any()
    np.testing.assert_allclose(np.hypot(*record.u.T), 1)


@pytest.mark.parametrize("window", [1, 3, 8])
def test_spiral_turns_with_longer_windows_too(window):
    b = np.array([model.B[0] for model in spiral_estimates(1000, window).models])
    angle = np.unwrap(np.arctan2(*b.T[::-1]))
    assert np.hypot(*b[-1]) > 0.4
    assert angle[1000] - angle[500] > 0.3 > 10 * (angle[1000] - angle[998])


def test_exact_model_predicts_exactly():
    rng = np.random.default_rng(0)
    truth, u = draw_model(rng, 3, 2), rng.standard_normal((12, 2))
    record = estimate(trajectory(truth, np.ones(3), u), u, truth, 2, np.zeros(12), first=2)
    assert np.abs(prediction_errors(record, 4, u[4:9], truth)).max() < ROUNDING
    assert omegas(record, 4, 5, truth).max() < ROUNDING


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.integers(1, 3), st.integers(1, 3), st.floats(0, 0.9), st.floats(0.1, 1.1))
def test_bound_of_the_prediction_error(seed, n, q, lam, radius):
    rng = np.random.default_rng(seed)
    truth, u = draw_model(rng, n, q, radius), rng.standard_normal((14, q))
    record = estimate(trajectory(truth, np.ones(n), u), u, draw_model(rng, n, q), 2, np.full(14, lam), first=2)
    for k in (2, 6):
        error = np.linalg.norm(prediction_errors(record, k, u[k : k + 6], truth), axis=1).max()
        bound = np.sqrt(omegas(record, k, 6, truth) @ [1, np.sum(record.x[k] ** 2), np.sum(u[k : k + 6] ** 2)])
        assert error <= bound * (1 + 1e-9) + ROUNDING * (1 + np.abs(record.x).max())


def test_first_error_is_made_of_one_residual_and_one_move():
    rng = np.random.default_rng(5)
    truth, u = draw_model(rng, 2, 1), rng.standard_normal((8, 1))
    record = estimate(trajectory(truth, np.ones(2), u), u, draw_model(rng, 2, 1), 2, np.full(8, 0.4), first=2)
    best, model = record.best[4], record.models[4]  # theta*(5), theta~(4)
    move = theta_matrix(best) - theta_matrix(model)
    expected = -record.residuals(5, best)[0] - move @ np.concatenate([record.x[4], record.u[4]])
    np.testing.assert_allclose(prediction_errors(record, 4, u[4:5], truth)[0], expected, atol=ROUNDING)


def test_index_slip_can_also_be_mended_by_starting_one_step_earlier():
    # x(k-N+j) = A_j x(k-N) + ... + sum of A^(j-1-l) e_{l+1}, j up to N: one step more than the proof has.
    rng = np.random.default_rng(8)
    truth, u, N = draw_model(rng, 2, 1), rng.standard_normal((9, 1)), 4
    record = estimate(trajectory(truth, np.ones(2), u), u, draw_model(rng, 2, 1), N, np.full(9, 0.5), first=N)
    model = record.models[8]
    errors = record.residuals(8, model)[::-1]
    x = record.x[4]
    for j in range(N):
        x = model.step(x, u[4 + j]) + errors[j]
        np.testing.assert_allclose(x, record.x[5 + j], atol=ROUNDING)
    assert window_gap(record, 8, 48, printed=True) > 1e-3
    assert window_gap(record, 8, 48, printed=False) < ROUNDING


def test_printed_residuals_are_right_without_mixing():
    rng = np.random.default_rng(9)
    truth, u = draw_model(rng, 2, 1), rng.standard_normal((9, 1))
    record = estimate(trajectory(truth, np.ones(2), u), u, draw_model(rng, 2, 1), 3, np.zeros(9), first=3)
    assert window_gap(record, 8, 47, printed=True) < ROUNDING


def test_first_transitions_of_the_linear_example(example):
    left = [check_prehistory(Effort(), first).worst for first in (0, 1, 2, 3)]
    assert left[:3] == pytest.approx([9.9, 0.909, 0.0779], rel=1e-3)
    assert left[3] < 1e-12
    regressors, successors = example_transitions(example, 0)
    assert not regressors[0].any()
    assert successors[0] == pytest.approx([-9.9, 0, 0, 0])


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: claim.id)
def test_claim_comes_out_as_recorded(claim, seed):
    judgement = judge(claim, effort := Effort(seed, 10))
    assert judgement.as_recorded, judgement
    assert drift(judgement, effort) == ""


# ---------------------------------------------------------------- what the checks are seen to reject


def test_a_wrong_mixture_is_noticed_in_47(monkeypatch):
    """The shares of old and new exchanged: the residuals that were read off theta~(k) itself could not show it."""
    mix = SignalModel.mix
    monkeypatch.setattr(SignalModel, "mix", lambda self, other, lam: mix(self, other, 1 - lam))
    assert not check_window(Effort(0, 10), equation=47).passes


def test_an_estimator_that_does_not_fit_is_noticed_in_47(monkeypatch):
    """Then (47) still holds as an identity, but its residuals do not tend to zero."""
    stuck = lambda x, u, initial, window, mixing, first: estimate(  # noqa: E731
        x, u, initial, window, mixing, first=len(u) + 1
    )
    assert check_window(Effort(0, 10), equation=47).passes
    monkeypatch.setattr(window_proof, "estimate", stuck)
    assert not check_window(Effort(0, 10), equation=47).passes


def test_bounds_that_do_not_vanish_are_noticed_in_8(monkeypatch):
    """A bound with something added holds all the more; it does not tend to zero."""
    for module in (theorem_2, theorem_2.omega_sums.__globals__["__name__"]):
        target = module if isinstance(module, str) else module.__name__
        monkeypatch.setattr(f"{target}.omegas", lambda *given: omegas(*given) + 20.0)
    assert not theorem_2.check_prediction(Effort(0, 10)).passes
    assert not theorem_2.check_one_step(Effort(0, 10)).passes


def test_sums_of_the_omegas_by_hand():
    """Truth zero, one transition 1 -> 0 with u = 0 from the model 1: the estimate halves its error with every step."""
    truth, start = SignalModel([[1.0]], [[0.0]]), SignalModel([[0.0]], [[0.0]])
    record = estimate(np.ones((5, 1)), np.zeros((4, 1)), start, 1, np.zeros(4))
    sums, bounds = omega_sums(record, 1, truth, 0.0)
    # Steps and residuals at k = 2, 3, 4 are 1/4, 1/8, 1/16.
    squares = 1 / 16 + 1 / 64 + 1 / 256
    np.testing.assert_allclose(sums, [2 * squares, 4 * squares, 2 * squares])
    np.testing.assert_allclose(bounds, [2, 4, 2])


def test_models_that_are_not_the_mixtures_of_the_estimates_are_noticed(monkeypatch):
    """Whichever sign the difference has."""
    for shift in (-1.0, 1.0):

        def shifted(*given, shift=shift):
            steps = simulate(*given).steps
            models = [SignalModel(step.model.A + shift, step.model.B + shift) for step in steps]
            return SimpleNamespace(
                steps=[replace(step, model=model) for step, model in zip(steps, models, strict=True)]
            )

        monkeypatch.setattr(estimator_setup, "simulate", shifted)
        assert estimator_setup.check_estimator(Effort(0, 10)).worst == pytest.approx(1.0)


def test_bounds_of_longer_sums_by_hand():
    """The truth's powers have norm one, and no estimate has an input gain: f = 1, b = 0, S = 1 + 4 + 9 for N = 3."""
    truth, start = SignalModel([[1.0]], [[0.0]]), SignalModel([[0.0]], [[0.0]])
    record = estimate(np.ones((7, 1)), np.zeros((6, 1)), start, 1, np.zeros(6))
    _, bounds = omega_sums(record, 3, truth, 0.0)
    np.testing.assert_allclose(bounds / bounds[0], [1.0, 4 * 3 * 14 / 18, 2 * 3 * 14 / 18])


@pytest.mark.parametrize("exponent", [1.25, 1.5, 2.0])
def test_a_spiral_that_stops_is_told_from_one_that_does_not(exponent):
    """Its last steps are far above any rounding, so that a threshold alone would refute it."""
    b = np.array([model.B[0] for model in spiral_estimates(1500, 1, exponent).models])
    assert np.ptp(b[750:], axis=0).max() > 1e-6
    assert theorem_2.check_settles(Effort(), exponent=exponent).passes
    assert not theorem_2.check_settles(Effort(), exponent=0.75).passes


def test_the_growing_memory_settles_at_a_model_that_fits(monkeypatch):
    """The control of the example is another run of the library; one that forgets fails it no longer."""
    assert not theorem_2.check_settles_outside(Effort(), growing=True).passes
    remember = GrowingMemory.remember
    monkeypatch.setattr(GrowingMemory, "remember", lambda self, data, x, u: remember(self, 0.01 * data, x, u))
    assert theorem_2.check_settles_outside(Effort(), growing=True).worst < 0.1


def test_a_term_that_the_library_leaves_out_is_noticed(monkeypatch):
    features = Terms.features
    monkeypatch.setattr(Terms, "features", lambda self, stack, p: features(self, stack, p)[..., :2])
    monkeypatch.setattr(Terms, "count", lambda self, p, outputs: 2)
    assert not estimator_setup.check_lifting_example(Effort()).passes


def test_a_term_that_the_library_gets_wrong_is_noticed(monkeypatch):
    features = Terms.features
    monkeypatch.setattr(Terms, "features", lambda self, stack, p: 1.01 * features(self, stack, p))
    assert not estimator_setup.check_lifting_example(Effort()).passes
