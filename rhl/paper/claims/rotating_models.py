"""Two predictors that test Lemma 2's hypotheses: one rotates for ever, one loses controllability."""

from __future__ import annotations

from functools import cache

import numpy as np

from rhl._checks import Array
from rhl.horizon import solve
from rhl.model import SignalModel
from rhl.paper.claims.lyapunov_terms import Setting, size, square
from rhl.problems import V3

PLANE = 1.5
"""Growth factor of the plant x+ = 1.5 x + u in the plane."""

MISFIT = np.array([[-0.5, 0.0], [1.0, -0.75]])
"""E, the error of the rotating model's input matrix, found by trial; it makes the closed loop far from normal."""


def turning(phase: Array, r: Array, x0: Array, growth: float = PLANE) -> Setting:
    """Return a loop in the plane whose model rotates by the given angles.

    The plant is x+ = growth x + u. The model at angle 0 is exact only for the first step of its own plan from x to 0.
    This remains true under every rotation, since the plant is invariant under rotations.

    ``phase`` (T+1): angles of the model at k = 0 ... T.
    ``r`` (T+1, 2): terminal states. ``x0`` (runs, 2): initial states.
    ``growth``: that of the plant; the model is made for the default.
    """
    model = consistent_model()
    turn = rotation(phase)
    back = turn.swapaxes(-1, -2)
    runs = len(x0)
    turned = SignalModel(*(np.broadcast_to(turn @ M @ back, (runs, *turn.shape)) for M in (model.A, model.B)))
    to_r = solve(V3(model, 1.0, 1.0, np.eye(2), 2), np.zeros(2)).u[:, 0].T
    omegas = np.zeros((runs, len(phase) - 1, 3))
    omegas[..., 0] = size(MISFIT @ to_r) ** 2 * square(r[:-1])
    plant = SignalModel(growth * np.eye(2), np.eye(2))
    return Setting(plant, turned, np.broadcast_to(r, (runs, *r.shape)), x0, omegas, 2)


@cache
def consistent_model() -> SignalModel:
    """Return (a I - E K, I + E) with E = MISFIT, a = PLANE and K its own first gain under V3 with r = 0, N = 2."""
    K = -0.5 * PLANE * np.eye(2)
    for _ in range(200):
        model = SignalModel(PLANE * np.eye(2) - MISFIT @ K, np.eye(2) + MISFIT)
        K = 0.6 * K + 0.4 * solve(V3(model, 1.0, 1.0, np.zeros(2), 2), np.eye(2)).u[:, 0].T
    return model


def rotation(phase: Array) -> Array:
    """Return the rotations of the plane by these angles, shape (..., 2, 2)."""
    return np.stack(
        [np.stack([np.cos(phase), -np.sin(phase)], axis=-1), np.stack([np.sin(phase), np.cos(phase)], axis=-1)],
        axis=-2,
    )


def losing(steps: int, floor: float = 0.0) -> Setting:
    """Return a loop whose model approaches the plant and loses controllability in the limit.

    The plant's second state is stable and not controllable. The model has the input gain 1/(k+1) for it, and r(k)
    requires it to reach 1/(k+1).

    ``steps``: T. ``floor``: lower bound of the model's gain.
    """
    A, decay = np.diag([1.2, 0.5]), 1 / (np.arange(steps + 1) + 1)
    reach = np.maximum(decay, floor)
    B = np.stack([np.ones_like(reach), reach], axis=-1)[None, ..., None]
    r = np.stack([np.zeros_like(decay), decay], axis=-1)[None]
    omegas = np.zeros((1, steps, 3))
    omegas[..., 2] = reach[:-1] ** 2
    models = SignalModel(A, B)
    return Setting(SignalModel(A, np.array([[1.0], [0.0]])), models, r, np.array([[1.0, 1.0]]), omegas, 2)
