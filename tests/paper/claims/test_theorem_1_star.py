"""Theorem 1*: claims as recorded, and that their quantities mean what they say."""

from dataclasses import replace

import numpy as np
import pytest

from rhl.horizon import solve
from rhl.model import SignalModel
from rhl.paper.claims import assumption_5, contraction, theorem_1_star
from rhl.paper.claims.claim import Effort, judge
from rhl.paper.claims.contraction import run
from rhl.problems import V1
from tests.evidence import drift
from tests.sizes import SEEDS


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("claim", theorem_1_star.CLAIMS, ids=lambda claim: claim.id)
def test_as_recorded(claim, seed):
    judgement = judge(claim, effort := Effort(seed, 10))
    assert judgement.as_recorded, judgement
    assert drift(judgement, effort) == ""


@pytest.mark.parametrize("seed", range(3))
def test_loops_are_loops_of_v1(seed):
    loops = theorem_1_star.draw(np.random.default_rng(seed), 2, (2, 1, 1, 3))
    of = run(loops, 6)
    for k in range(6):
        for i in range(2):
            model = SignalModel(loops.models(k).A[i], loops.models(k).B[i])
            problem = V1(model, loops.Q[i], loops.R[i], loops.QN[i], float(of.x[k, i] @ of.x[k, i]) / 0.9**k, 3)
            plan = solve(problem, of.x[k, i])
            assert np.allclose(plan.u[0], of.u[k, i], rtol=1e-9, atol=1e-12)
            stages = sum(x @ loops.Q[i] @ x for x in plan.x[:-1]) + sum(u @ loops.R[i] @ u for u in plan.u)
            assert of.stages[k, i] == pytest.approx(stages, rel=1e-9)
            assert np.allclose(loops.plant.A[i] @ of.x[k, i] + loops.plant.B[i] @ of.u[k, i], of.x[k + 1, i])


@pytest.mark.parametrize("seed", range(3))
def test_predictors_of_the_loops_are_what_is_said_of_them(seed):
    """Not controllable, and in every second loop not convergent."""
    loops = theorem_1_star.draw(np.random.default_rng(seed), 4, (2, 1, 1, 3))
    model = loops.models(400)
    rank = np.linalg.matrix_rank(np.concatenate(np.moveaxis(model.predictor(3).B, -3, 0), axis=-1), tol=1e-9)
    assert np.all(rank == 2)
    moved = [np.max(np.abs(loops.models(k).A - loops.models(2 * k).A), axis=(1, 2)) for k in (200, 230, 300)]
    assert np.all(np.max(moved, axis=0)[::2] > 0.05)


def test_a_hypothesis_that_fails_is_named():
    of = theorem_1_star.spinning(1.0, Effort(0, 10))
    assert "differences" in theorem_1_star.hypotheses(of)
    assert theorem_1_star.hypotheses(assumption_5.fading_reach()) != ""


def test_a_violation_is_relative_to_both_sides():
    """So it is between minus one and one, however large the loops' signals are."""
    loops = theorem_1_star.draw(np.random.default_rng(0), 4, (2, 1, 1, 3))
    found = contraction.ends_excess(run(replace(loops, x0=1e3 * loops.x0), 6))
    assert np.all(found[1] <= 0)
    assert -1 <= np.min(found[1]) < -0.1


def test_the_bound_of_the_last_state_grows_with_epsilon():
    """(12): what it allows beyond the best is epsilon(k) times a number that depends on the maps alone."""
    loops = theorem_1_star.draw(np.random.default_rng(0), 2, (2, 1, 1, 3))
    of = run(loops, 6)
    reached = np.einsum("kli,lij,klj->kl", of.r, loops.QN, of.r)
    excess = contraction.ends_excess(of, 2.0)[1]
    allowed = reached * (1 - excess) / (1 + excess)
    at = contraction.constants(of.A, of.B, loops.Q, loops.R, loops.QN)
    rho = (allowed - of.best) / (2 * np.array([loops.epsilon(k) for k in range(6)]))[:, None]
    np.testing.assert_allclose(rho, at.top * at.C2**2 / loops.alpha, rtol=1e-6)


@pytest.mark.parametrize("wrong", ["M", "C2"])
def test_the_constants_are_needed(wrong, monkeypatch):
    """A constant that is far too small breaks the inequality that it stands for."""
    real = contraction.constants
    small = {"M": 0.02, "C2": 1e-3}[wrong]
    changed = lambda *given: replace(real(*given), **{wrong: small * getattr(real(*given), wrong)})  # noqa: E731
    monkeypatch.setattr(contraction, "constants", changed)
    check = {"M": theorem_1_star.check_step, "C2": theorem_1_star.check_ends}[wrong]
    assert not check(Effort(0, 10)).passes
