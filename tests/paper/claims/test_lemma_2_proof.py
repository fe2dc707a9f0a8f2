"""The proof of Lemma 2: its terms against closed forms and sums, its constants, and the claims as recorded."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from rhl.horizon import solve
from rhl.model import SignalModel
from rhl.paper.claims import lemma_2_proof
from rhl.paper.claims import lyapunov_inequalities as steps
from rhl.paper.claims.claim import Effort, judge
from rhl.paper.claims.lyapunov_terms import SIZES, Setting, bounds, draw, follow, square, written_out
from rhl.paper.claims.rotating_models import rotation, turning
from tests.evidence import drift
from tests.sizes import SEEDS

ROUNDING = 1e-9  # relative to V3; gains are below a few hundred


def exact_model(A, B, r, x0, horizon):
    """A loop whose predictor is the plant, one run."""
    A, B, r = np.asarray(A, float), np.asarray(B, float), np.asarray(r, float)
    models = SignalModel(*(np.broadcast_to(M, (1, len(r), *M.shape)) for M in (A, B)))
    return Setting(
        SignalModel(A[None], B[None]), models, r[None], np.array([x0], float), np.zeros((1, len(r) - 1, 3)), horizon
    )


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("claim", lemma_2_proof.CLAIMS, ids=lambda claim: claim.id)
def test_as_recorded(claim, seed):
    judgement = judge(claim, effort := Effort(seed, 10))
    assert judgement.as_recorded, judgement
    assert drift(judgement, effort) == ""


@given(st.floats(-3, 3), st.floats(0.2, 3), st.floats(-3, 3), arrays(float, (4, 1), elements=st.floats(-2, 2)))
def test_scalar_loop_with_horizon_one_by_hand(a, b, x0, r):
    """nu = (r - a x)/b, so x(k+1) = r(k), V3 = x^2 + nu^2, and r~+ = a r(k)."""
    t = follow(exact_model([[a]], [[b]], r, [x0], 1))
    x = np.concatenate([[[x0]], r[:-1]])
    assert t.x_next[0] == pytest.approx(x[1:], abs=1e-9)
    assert t.plan.value[0] == pytest.approx((x[:-1] ** 2 + ((r[:-1] - a * x[:-1]) / b) ** 2)[:, 0], rel=1e-9, abs=1e-9)
    assert t.xi_tilde[0, :, 1] == pytest.approx(a * r[:-1], abs=1e-8)
    assert np.abs(t.w).max() < 1e-8


@pytest.mark.parametrize("sizes", SIZES)
def test_gains_and_value_matrices_are_those_of_the_solver(sizes):
    rng = np.random.default_rng(3)
    setting = draw(rng, 3, sizes, 6, weighted=True)
    t = follow(setting)
    n, N = sizes[0], sizes[2]
    x, inputs = rng.normal(size=n), rng.normal(size=(N, sizes[1]))
    models = SignalModel(setting.models.A[:, 1:], setting.models.B[:, 1:])
    r = models.predictor(N).predict(x, inputs)[..., -1, :]  # within reach, whatever the inputs do not move
    plan = solve(setting.problem(models, r), x)
    both = np.concatenate([np.broadcast_to(x, r.shape), r], axis=-1)
    K, L = setting.gains
    assert np.einsum("...iab,...b->...ia", K[:, 1:], both) == pytest.approx(plan.x, abs=ROUNDING)
    assert np.einsum("...iab,...b->...ia", L[:, 1:], both) == pytest.approx(plan.u, abs=ROUNDING)
    assert np.einsum("...a,...ab,...b->...", both, t.S, both) == pytest.approx(plan.value, rel=ROUNDING)


def test_hidden_states_are_out_of_every_models_reach_and_asked_for_where_they_go():
    setting = draw(np.random.default_rng(8), 4, (3, 1, 3, 1), 12, weighted=True)
    BB = np.concatenate(list(np.moveaxis(setting.models.predictor(3).B, -3, 0)), axis=-1)
    assert np.all(np.linalg.matrix_rank(BB, tol=1e-9) == 2)
    t = follow(setting)  # V3 is feasible at every step, or this raises
    assert np.abs(t.r).max() > 0.1
    assert np.abs(t.plan.x[..., -1, :] - t.r).max() < ROUNDING
    assert np.abs(setting.weights[0] - np.eye(3)).max() > 0.1


@pytest.mark.parametrize("sizes", SIZES)
def test_sums_of_28_against_loops(sizes):
    t = follow(draw(np.random.default_rng(4), 2, sizes, 5))
    N = sizes[2]
    for case in range(2):
        for k in range(5):
            dA, dB = (then[case, k] - now[case, k] for then, now in ((t.then.A, t.now.A), (t.then.B, t.now.B)))
            nu = np.concatenate([t.plan.u[case, k], np.zeros((1, sizes[1]))])
            for i in range(N + 1):
                w = -t.then.A[case, k, i] @ t.e1[case, k] + dA[i] @ t.plan.x[case, k, 1]
                w = w + sum((dB[i - l] @ nu[l] for l in range(1, i + 1)), np.zeros(sizes[0]))
                assert w == pytest.approx(t.w[case, k, i], abs=ROUNDING)
                assert w == pytest.approx(written_out(t, t.e1)[case, k, i], abs=ROUNDING)


def test_states_follow_the_plant_under_the_plans():
    t = follow(draw(np.random.default_rng(5), 4, (2, 1, 3), 10))
    applied = t.setting.plant.A[:, None] @ t.x[..., None] + t.setting.plant.B[:, None] @ t.plan.u[..., 0, :, None]
    assert t.x_next == pytest.approx(applied[..., 0], abs=ROUNDING)


@pytest.mark.parametrize(
    "violation",
    [
        steps.split,
        steps.shifted_end,
        steps.shifted_states,
        steps.written_w,
        steps.shifted_cost,
        steps.first_bound,
        steps.end_with_w,
        steps.bounded_end,
        steps.same_state,
        steps.second_bound,
        steps.second_step,
        steps.decrease,
    ],
    ids=lambda function: function.__name__,
)
def test_the_proof_goes_through_for_a_model_that_turns_for_ever(violation):
    """Not one of the equations needs that the maps converge; omega_1 is not zero here."""
    k = np.arange(81.0)
    t = follow(turning(np.sqrt(k), 0.9 ** k[:, None] * [1.0, -1.0], np.eye(2)))
    assert np.max(violation(t, bounds(t))) < ROUNDING


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_decrease_whatever_the_units(scale):
    rng = np.random.default_rng(6)
    setting = draw(rng, 3, (2, 1, 3), 30)
    scaled = Setting(
        setting.plant, setting.models, scale * setting.r, scale * setting.x0, setting.omegas, setting.horizon
    )
    t = follow(scaled)
    assert np.max(steps.decrease(t, bounds(t))) < ROUNDING
    assert np.max(steps.first_step(t, bounds(t))) < ROUNDING


def test_nothing_moves_from_zero():
    t = follow(exact_model(np.eye(2), np.eye(2), np.zeros((5, 2)), [0.0, 0.0], 2))
    assert np.abs(t.x).max() == np.abs(t.plan.value).max() == 0
    assert np.max(steps.decrease(t, bounds(t), constant=False)) <= 0


def test_gamma_needs_its_constant():
    """x(k) = r(k) = 0 and r(k+1) = 1: V3 rises by r'S_5 r, whatever multiplies x'x and r'r."""
    t = follow(exact_model([[1.0]], [[1.0]], [[0.0], [1.0]], [0.0], 1))
    assert t.after.value[0, 0] - t.plan.value[0, 0] == pytest.approx(1.0)
    assert np.max(steps.decrease(t, bounds(t), constant=False)) > 0.1
    assert np.max(steps.decrease(t, bounds(t))) <= 0


def test_r_tilde_has_the_factor_a1():
    """x+ = 2x + u, N = 1, r(0) = 1: r~+ is 2, not 1."""
    t = follow(exact_model([[2.0]], [[1.0]], [[1.0], [1.0]], [0.0], 1))
    assert t.xi_tilde[0, 0, 1] == pytest.approx([2.0])


def test_rotations():
    assert rotation(np.array(np.pi / 2)) @ [1.0, 0.0] == pytest.approx([0.0, 1.0])


def test_vanishing_is_looked_at():
    """Coefficients that stay are a violation even where the inequality holds with room to spare."""
    t = follow(draw(np.random.default_rng(7), 3, (1, 1, 1), 40, error_decay=1.0))
    b = bounds(t)
    x2, r2 = square(t.x)[..., None], square(t.r)[..., None]
    assert np.all(square(t.w) <= b.alpha[..., 0] * x2 + b.alpha[..., 1] * r2 + b.alpha[..., 2] + 1e-12)
    assert np.max(steps.bounded_w(t, b)) > 0.1
