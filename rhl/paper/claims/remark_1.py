"""Remark 1: a predictor has to be accurate along the closed loop only, and under the planned inputs."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from rhl.model import PredictorMaps, SignalModel
from rhl.paper.claims.claim import Claim, Control, Effort, Evidence, worst_of
from rhl.paper.claims.lyapunov_terms import draw, follow
from rhl.paper.claims.predictors import half_blind, prediction_errors, stepped
from rhl.paper.claims.rotating_models import turning

_claim = partial(Claim, page="notebooks/04-assumption-4.ipynb", test="tests/paper/claims/test_remark_1.py")

# Prediction errors over a horizon, relative to the initial state, for an exact predictor: rounding.
_RIGHT = 1e-9


def check_right_where_it_matters(effort: Effort, third: float = 0.0) -> Evidence:
    """Check errors of predictors along their own closed loops that are wrong elsewhere.

    ``third``: initial value of the state for which the predictor is wrong.
    """
    rng = effort.rng("remark-1")
    plant, predictor = half_blind(rng, effort.cases)
    x0 = rng.normal(size=(effort.cases, 3))
    x0[:, 2] = third
    errors, states = prediction_errors(plant, predictor, x0, 25)
    largest = np.max(np.linalg.norm(states, axis=-1), axis=0)
    elsewhere = np.linalg.norm(plant.step(np.eye(3)[2], [0.0, 1.0]) - predictor.step(np.eye(3)[2], [0.0, 1.0]), axis=-1)
    unseen = np.max(errors, axis=(0, -1)) / largest
    return Evidence(
        effort.cases, float(np.max(np.where(elsewhere > 0.1, unseen, np.inf))), _RIGHT, "rounding of four steps"
    )


def check_bounded_signals(effort: Effort, growing: bool = False) -> Evidence:
    """Compare late with early prediction errors under the planned inputs, along closed loops that never come to rest.

    The loops are those of Lemma 2, with models that approach the plant and terminal states that keep their size.

    ``growing``: let the signals grow as fast as the models improve.
    """
    rng = effort.rng("remark-1.bounded")
    left: list[float] = []
    for sizes in ((1, 1, 1), (2, 1, 3), (2, 2, 2)):
        setting = draw(rng, max(1, effort.cases // 3), sizes, 60, 0.7, weighted=True)
        asked = (
            rng.choice([-1.0, 1.0], setting.r.shape) * (0.7 ** -np.arange(61.0) if growing else np.ones(61))[:, None]
        )
        setting = replace(setting, r=asked)
        t = follow(setting)
        plan, plant = t.plan, SignalModel(setting.plant.A[:, None], setting.plant.B[:, None])
        true = stepped(plant, t.x, plan.u)
        errors = np.max(np.abs([plan.x - true, t.now.predict(t.x, plan.u) - true]), axis=(0, -2, -1))
        if np.min(np.linalg.norm(plan.x[:, -10:, 0], axis=-1)) < 1e-3:
            return Evidence(0, np.nan)  # decaying signals would hide the behaviour of the errors
        left += (np.max(errors[:, -10:], axis=1) / np.max(errors[:, :10], axis=1)).tolist()
    return Evidence(len(left), worst_of(left), 1e-5, "the models' errors decrease by the factor 0.7^40")


def check_planned(effort: Effort, right: bool = False) -> Evidence:
    """Two-step predictions of a fixed model: exact under the applied inputs, wrong under the planned ones.

    ``right``: take the plant itself as the model, which is exact under all inputs.
    """
    x0 = effort.rng("remark-1.planned").normal(size=(max(2, effort.cases // 10), 2))
    setting = turning(np.zeros(41), np.zeros((41, 2)), x0)
    if right:
        models = SignalModel(setting.plant.A + 0 * setting.models.A, setting.plant.B + 0 * setting.models.B)
        setting = replace(setting, models=models)
    t = follow(setting)
    x, u = t.x, t.plan.u[..., 0, :]
    inputs = np.stack([u[:, :-1], u[:, 1:]], axis=-2)
    maps = PredictorMaps(t.now.A[:, :-1], t.now.B[:, :-1])
    length = np.linalg.norm(x, axis=-1)
    applied = np.linalg.norm(maps.predict(x[:, :-1], inputs)[:, :-1, 2] - x[:, 2:], axis=-1) / length[:, :-2]
    true_end = setting.plant.step(setting.plant.step(x, u), t.plan.u[..., 1, :])
    planned = np.linalg.norm(t.plan.x[..., 2, :] - true_end, axis=-1) / length
    # Along some directions of x even a wrong plan is accurate, so the largest error of each run counts.
    violation = max(float(np.max(applied)), 0.1 - float(np.min(np.max(planned, axis=1))))
    return Evidence(len(x0), violation, _RIGHT, "rounding of two steps")


CLAIMS: tuple[Claim, ...] = (
    _claim(
        "remark-1",
        "Remark 1",
        "rk0",
        "Prediction is not identification: predictors that are exact along their closed loop may be wrong elsewhere.",
        method="simulation",
        recorded="holds",
        stated=check_right_where_it_matters,
        control=Control(
            "a start where the predictor is wrong", lambda effort: check_right_where_it_matters(effort, third=0.1)
        ),
    ),
    _claim(
        "remark-1.bounded",
        "Remark 1",
        "rk0",
        "If state and inputs stay bounded, the errors e_i(k) go to zero.",
        method="simulation",
        recorded="holds",
        stated=check_bounded_signals,
        control=Control(
            "signals that grow as fast as the maps improve", lambda effort: check_bounded_signals(effort, growing=True)
        ),
        uses=("assumption-4b",),
        proof="notebooks/04-assumption-4.ipynb#bounded-signals",
    ),
    _claim(
        "remark-1.planned",
        "Remark 1",
        "rk0",
        "(8) requires accuracy under the planned inputs, which is stronger than accuracy along the closed loop: a "
        "model may predict every applied step and be wrong along its own plan.",
        method="simulation",
        recorded="holds",
        stated=check_planned,
        control=Control("the plant itself as the model", lambda effort: check_planned(effort, right=True)),
    ),
)
