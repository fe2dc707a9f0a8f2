"""Predictor maps in exact arithmetic, and predictors that are exact only along their own closed loop."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from rhl._checks import Array
from rhl.horizon import solve
from rhl.model import PredictorMaps, SignalModel
from rhl.problems import V1

Exact = NDArray[np.object_]


def rational(rng: np.random.Generator, *shape: int) -> Exact:
    """Draw fractions of small numbers, as an array of exact objects."""
    above, below = rng.integers(-9, 10, shape), rng.integers(1, 8, shape)
    return np.array([Fraction(int(a), int(b)) for a, b in zip(above.flat, below.flat, strict=True)]).reshape(shape)


def powers(A: Exact, B: Exact, horizon: int) -> tuple[list[Exact], list[Exact]]:
    """Return A_0 ... A_N and B_0 ... B_{N-1} of equation (21), exactly."""
    maps = [np.array([[Fraction(i == j) for j in range(len(A))] for i in range(len(A))])]
    for _ in range(horizon):
        maps.append(A @ maps[-1])
    return maps, [M @ B for M in maps[:-1]]


def predict(maps: tuple[list[Exact], list[Exact]], i: int, x: Exact, inputs: Exact) -> Exact:
    """Return P_i(x, u_0, ..., u_{i-1}) by equation (5), exactly; further inputs are ignored."""
    A, B = maps
    total = A[i] @ x
    for l in range(i):
        total = total + B[i - 1 - l] @ inputs[l]
    return np.asarray(total)


def commutation_gaps(
    maps: tuple[list[Exact], list[Exact]], x: Exact, s: Exact, printed: bool = False
) -> list[Fraction | int]:
    """Return the differences of the three members of (7) for 0 <= i + j <= N + 1, at x of shape (n).

    ``maps``: A_0 ... A_N and B_0 ... B_{N-1}. ``s`` (N+1, q): inputs; s_N is used only for i + j = N + 1.
    ``printed``: a map in (7) that ``maps`` lacks counts as a difference of one.
    """
    N, there = len(s) - 1, len(maps[1])
    gaps: list[Fraction | int] = []
    for i in range(N + 2):
        for j in range(N + 2 - i):
            if printed and i + j > there:
                gaps.append(1)
            if max(i, j) <= there:
                after = predict(maps, j, predict(maps, i, x, s), s[i:])
                before = predict(maps, i, predict(maps, j, x, s), s[j:])
                gaps.extend(np.abs(after - before))
                if i + j <= there:
                    gaps.extend(np.abs(after - predict(maps, i + j, x, s)))
    return gaps


def half_blind(rng: np.random.Generator, count: int = 1) -> tuple[SignalModel, SignalModel]:
    """Draw plants with three states and two inputs, and predictors exact for a part of them, shapes (count, ...).

    The plant's third state is stable and stays at zero if it starts there. The predictor is wrong about the effect of
    that state, and has no effect of the second input, so its plans never use it.
    """
    A, B = rng.normal(size=(count, 3, 3)), rng.normal(size=(count, 3, 2))
    A[:, 2, :2], B[:, 2] = 0.0, 0.0
    A[:, 2, 2] = rng.uniform(-0.9, 0.9, count)
    wrong_A, wrong_B = A.copy(), B.copy()
    wrong_A[:, :, 2] += np.where(A[:, :, 2] > 0, 1.0, -1.0)
    wrong_B[:, :, 1] = 0.0
    return SignalModel(A, B), SignalModel(wrong_A, wrong_B)


def prediction_errors(plant: SignalModel, predictor: SignalModel, x0: Array, steps: int) -> tuple[Array, Array]:
    """Run the closed loop with V1 (Q = R = QN = 1, N = 4, Gamma/eps = (1+k) x'x).

    Returns the norms of e_i(k), i = 0 ... 4, of (8) with the planned inputs, shape (steps, ..., 5), and the states,
    shape (steps, ..., n).
    """
    truth, x = plant.predictor(4), x0
    errors, states = [], []
    for k in range(steps):
        plan = solve(V1(predictor, 1.0, 1.0, 1.0, (1 + k) * np.sum(x**2, axis=-1), 4), x)
        errors.append(np.linalg.norm(plan.x - truth.predict(x, plan.u), axis=-1))
        states.append(x)
        x = plant.step(x, plan.u[..., 0, :])
    return np.array(errors), np.array(states)


def general_maps(rng: np.random.Generator) -> tuple[SignalModel, PredictorMaps]:
    """Draw a plant, and maps of the same sizes (with A_0 the identity) to disturb its own."""
    n, q, N = (int(size) for size in rng.integers((1, 1, 1), (4, 3, 5)))
    plant = SignalModel(rng.normal(size=(n, n)) / np.sqrt(n), rng.normal(size=(n, q)))
    D = np.concatenate([np.eye(n)[None], rng.normal(size=(N, n, n))])
    return plant, PredictorMaps(D, rng.normal(size=(N, n, q)))


def stepped(plant: SignalModel, x: Array, inputs: Array) -> Array:
    """Return x and the states after each of the inputs, by steps of the plant, shape (..., N+1, n)."""
    states = [x]
    for l in range(inputs.shape[-2]):
        states.append(plant.step(states[-1], inputs[..., l, :]))
    return np.stack(states, axis=-2)
