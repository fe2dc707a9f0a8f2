"""Remark 1: predictors that are right along a loop and wrong elsewhere, and the claims as recorded."""

from dataclasses import replace

import numpy as np
import pytest

from rhl.horizon import solve
from rhl.paper.claims import predictors, remark_1
from rhl.paper.claims.claim import Effort, judge
from rhl.paper.claims.lyapunov_terms import follow
from rhl.paper.claims.rotating_models import turning
from rhl.problems import V1
from tests.evidence import drift
from tests.sizes import SEEDS


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("claim", remark_1.CLAIMS, ids=lambda claim: claim.id)
def test_as_recorded(claim, seed):
    judgement = judge(claim, effort := Effort(seed, 10))
    assert judgement.as_recorded, judgement
    assert drift(judgement, effort) == ""


def test_half_blind_plans_never_touch_what_they_are_wrong_about():
    plant, predictor = predictors.half_blind(np.random.default_rng(0), 5)
    x0 = np.array([1.0, -1.0, 0.0])
    errors, states = predictors.prediction_errors(plant, predictor, np.broadcast_to(x0, (5, 3)), 20)
    assert np.all(states[..., 2] == 0)
    assert errors.max() < 1e-9 * np.abs(states).max()
    plan = solve(V1(predictor, 1.0, 1.0, 1.0, 1.0, 4), x0)
    assert np.abs(plan.u[..., 1]).max() < 1e-12
    assert np.abs(plant.A - predictor.A).max() >= 1
    assert np.abs(plant.B - predictor.B).max() > 0.1


def test_right_along_the_loop_and_wrong_about_the_plan():
    setting = turning(np.zeros(11), np.zeros((11, 2)), np.eye(2))
    t = follow(setting)
    assert np.abs(t.e1).max() < 1e-12
    two = setting.plant.step(setting.plant.step(t.x, t.plan.u[..., 0, :]), t.plan.u[..., 1, :])
    assert np.abs(two[:, 0] - t.plan.x[:, 0, 2]).max() > 0.1
    assert follow(replace(setting, x0=0 * setting.x0)).x.max() == 0


def test_no_evidence_from_a_predictor_that_is_not_wrong(monkeypatch):
    """The check of Remark 1 must not pass on a predictor that is right everywhere."""

    def honest(rng, count):
        plant, _ = predictors.half_blind(rng, count)
        return plant, plant

    monkeypatch.setattr(remark_1, "half_blind", honest)
    assert not remark_1.check_right_where_it_matters(Effort(0, 5)).passes
