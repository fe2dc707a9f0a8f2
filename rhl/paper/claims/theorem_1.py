"""Theorem 1: receding horizon control with a terminal weight that grows for any fixed state."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from rhl._checks import Array
from rhl.horizon import solve
from rhl.model import SignalModel
from rhl.paper.claims.claim import Claim, Control, Effort, Evidence, worst_of
from rhl.paper.claims.lemma_1 import random_maps, random_weight
from rhl.problems import V1, V2, V3

_claim = partial(Claim, page="notebooks/08-theorem-1.ipynb", test="tests/paper/claims/test_theorem_1.py")
_STEPS = 600
# The weight that stabilises an unstable mode fixes |x|^2 / eps; over the run eps decreases to a millionth.
_SETTLED = 1e-2


@dataclass(frozen=True, eq=False)
class Loop:
    """A closed loop of V1 and x+ = Ax + Bu, many systems at once.

    ``x`` (steps + 1, systems, n), ``u`` (steps, systems, q): states and inputs.
    ``r`` (steps, systems, n): the planned terminal states x_N(k).
    ``best`` (steps, systems): V2(x(k)), the least terminal value of a plan.
    """

    x: Array
    u: Array
    r: Array
    best: Array


def close(
    model: SignalModel, x0: Array, epsilon: Callable[[int], float], steps: int = _STEPS, horizon: int | None = None
) -> Loop:
    """Close the loop of V1 and its exact predictor, equations (2) to (4), with Gamma = x'x.

    ``model`` is a batch of systems, x0, shape (systems, n), their states; Q = Q_N = I and R = 100 I for all of them.
    ``horizon``: N; by default the order n, the least that Assumption 3 allows.
    """
    N = model.n if horizon is None else horizon
    x, states, inputs, ends, best = x0, [x0], [], [], []
    for k in range(steps):
        weight = np.sum(x**2, axis=-1) / epsilon(k)
        plan = solve(V1(model, 1.0, 100.0, 1.0, weight, N), x)
        if k % 50 == 0:
            best.append(solve(V2(model, 1.0, N), x).value)
        x = model.step(x, plan.u[..., 0, :])
        states.append(x)
        inputs.append(plan.u[..., 0, :])
        ends.append(plan.x[..., -1, :])
    return Loop(np.stack(states), np.stack(inputs), np.stack(ends), np.stack(best))


def systems(rng: np.random.Generator, count: int, radius: float = 1.3) -> tuple[SignalModel, Array]:
    """Draw stabilizable systems of order 3: a controllable block of that radius and a stable uncontrollable mode."""
    A, B = np.zeros((count, 3, 3)), np.zeros((count, 3, 1))
    for i in range(count):
        block = rng.normal(size=(2, 2))
        A[i, :2, :2] = block * radius / np.max(np.abs(np.linalg.eigvals(block)))
        A[i, :2, 2] = rng.normal(size=2)
        A[i, 2, 2] = rng.uniform(0.3, 0.9)
        B[i, :2, 0] = rng.normal(size=2)
    x0 = rng.normal(size=(count, 3))
    return SignalModel(A, B), x0 / np.linalg.norm(x0, axis=1, keepdims=True)


def falling(k: int) -> float:
    """Return epsilon(k) = exp(-k / 30), which decreases to 2e-9 over a run."""
    return float(np.exp(-k / 30))


def well_conditioned(model: SignalModel) -> Array:
    """Return which systems have a well controllable block; the peaks of the others are too high for float64."""
    A, B = model.A[:, :2, :2], model.B[:, :2]
    return np.asarray(np.linalg.cond(np.concatenate([B, A @ B], axis=-1)) < 20)


def check_rest(effort: Effort, of: str, epsilon: Callable[[int], float] = falling) -> Evidence:
    """Run the loop on random stabilizable systems and compare its end with its peak.

    ``of`` {"x", "r"}: the state, or the planned terminal states r(k) = x_N(k), which tend to zero in the proof.
    """
    model, x0 = systems(effort.rng("theorem-1"), 3 * effort.cases)
    chosen = np.flatnonzero(well_conditioned(model))[: effort.cases]
    loop = close(SignalModel(model.A[chosen], model.B[chosen]), x0[chosen], epsilon)
    size = np.linalg.norm(loop.x if of == "x" else loop.r, axis=-1)
    return Evidence(len(chosen), float(np.max(size[-1] / np.max(size, axis=0))), _SETTLED, "the rest of slow modes")


def check_same_problem(effort: Effort, shift: float = 0.0) -> Evidence:
    """Compare V1's solution with V3's for r = x_N, equation (40). ``shift``: change of r."""
    rng, gaps = effort.rng("eq-40"), []
    for _ in range(effort.cases):
        n, q = (int(size) for size in rng.integers(1, 4, 2))
        maps = random_maps(rng, n, q, n + 2)
        Q, R, QN, x = random_weight(rng, n), random_weight(rng, q), random_weight(rng, n), rng.normal(size=n)
        one = solve(V1(maps, Q, R, QN, 10.0 ** rng.uniform(-3, 6), n + 2), x)
        other = solve(V3(maps, Q, R, one.x[-1] + shift, n + 2), x)
        gaps.append(float(np.max(np.abs(one.u - other.u)) / (1 + np.max(np.abs(one.u)))))
    return Evidence(len(gaps), worst_of(gaps), 1e-9, "rounding through well conditioned terminal maps")


@dataclass(frozen=True, eq=False)
class Changing:
    """A closed loop of V1 with N = 1 and x+ = a x + u, whose predictor a x + b(k) u changes; many systems at once.

    ``x`` (steps + 1, systems): states.
    ``plan_gain`` (steps, systems): largest gain of V1's plan, which is bounded in Assumption 5(b).
    ``error`` (steps, systems): |e_1(k)| / |x(k)| of (8), which vanishes in Assumption 4(b).
    ``least`` (steps, systems): V2(x(k)) / x(k)^2, zero up to rounding; Assumption 4(c) requires that V2 vanishes.
    ``least_gain`` (steps, systems): gain of V2's least-norm solution, which Assumption 5 does not bound.
    """

    x: Array
    plan_gain: Array
    error: Array
    least: Array
    least_gain: Array


def vanishing(k: int, a: Array) -> Array:
    """Return b(k) = eps(k) a^-2k / (k+1), too small for the weight to compensate."""
    return np.asarray(quick(k) * a ** (-2.0 * k) / (k + 1))


def settling(k: int, a: Array) -> Array:
    """Return b(k) = 1 - 0.9^k / 2, which tends to the true 1."""
    return np.full_like(a, 1 - 0.9**k / 2)


def quick(k: int) -> float:
    """Return epsilon(k) = exp(-k / 10)."""
    return float(np.exp(-k / 10))


def change(
    a: Array,
    x0: Array,
    b: Callable[[int, Array], Array],
    epsilon: Callable[[int], float] = quick,
    steps: int = 150,
) -> Changing:
    """Close the loop of V1, N = 1 and all weights one, with x+ = a x + u and the changing predictor a x + b(k) u.

    ``b``: (k, a) -> b(k), shape (systems,). The ratios are defined while x is not zero.
    """
    x, states, rows = np.asarray(x0, dtype=np.float64), [np.asarray(x0, dtype=np.float64)], []
    for k in range(steps):
        model = SignalModel(a[:, None, None], b(k, a)[:, None, None])
        plan = solve(V1(model, 1.0, 1.0, 1.0, x**2 / epsilon(k), 1), x[:, None])
        least = solve(V2(model, 1.0, 1), x[:, None])
        u, scale = plan.u[:, 0, 0], np.abs(x)
        gain = np.maximum(np.abs(u), np.max(np.abs(plan.x[..., 0]), axis=-1)) / scale
        rows.append((gain, np.abs((b(k, a) - 1) * u) / scale, least.value / x**2, np.abs(least.u[:, 0, 0]) / scale))
        x = a * x + u
        states.append(x)
    return Changing(np.stack(states), *(np.stack(column) for column in zip(*rows, strict=True)))


def check_changing(
    effort: Effort, b: Callable[[int, Array], Array], epsilon: Callable[[int], float] = quick
) -> Evidence:
    """Run unstable scalar systems whose predictor changes with k, and compare the last state with the peak.

    ``b``: the predictor's input gain, ``vanishing`` or ``settling``.
    """
    rng = effort.rng("theorem-1.changing")
    a, x0 = rng.uniform(1.1, 1.5, effort.cases), rng.uniform(0.1, 1.0, effort.cases)
    run = change(a, x0, b, epsilon)
    size = np.abs(run.x)
    # Whether 5(b), (8) and (9) hold; V2 is zero up to rounding.
    holds = (
        np.all(run.plan_gain <= np.maximum(1.0, a) + 1e-9),
        np.all(run.error[-1] <= a / 20),
        np.all(run.least < 1e-20),
    )
    if not all(holds):
        return Evidence(0, np.nan, why="a hypothesis does not hold on this run")
    return Evidence(effort.cases, float(np.max(size[-1] / np.max(size, axis=0))), _SETTLED, "the rest of slow modes")


def check_pace(effort: Effort, epsilon: Callable[[int], float] = lambda k: 1 / (1 + 10 * k)) -> Evidence:
    r"""Compare :math:`x(k)^2/\epsilon(k)` of unstable scalar loops with N = 1 with :math:`R(a-1)/Q_N`.

    With N = 1 and Gamma = x^2 the closed loop is x(k+1) = a R x(k) / (R + Q_N x(k)^2 / epsilon(k)), whose factor is one
    at the terminal weight R (a - 1) / Q_N; below that weight the state grows, above it decreases.

    ``epsilon``: the schedule; slow, so that epsilon(k+1)/epsilon(k) tends to one.
    """
    rng = effort.rng("theorem-1.pace")
    a = rng.uniform(1.1, 2.0, effort.cases)
    R, QN = 10.0 ** rng.uniform(-1, 1, (2, effort.cases, 1, 1))
    model = SignalModel(a[:, None, None], np.ones((effort.cases, 1, 1)))
    x = rng.uniform(0.1, 1.0, effort.cases)
    for k in range(_STEPS):
        plan = solve(V1(model, 1.0, R, QN, x**2 / epsilon(k), 1), x[:, None])
        x = a * x + plan.u[:, 0, 0]
    expected = R[:, 0, 0] * (a - 1) / QN[:, 0, 0]
    gap = np.abs(x**2 / epsilon(_STEPS) / expected - 1)
    return Evidence(effort.cases, float(np.max(gap)), 0.05, "epsilon still decreases by a share of 1/k at every step")


CLAIMS: tuple[Claim, ...] = (
    _claim(
        "eq-2",
        "Equation 2",
        "sysmpc",
        "The system x+ = Ax + Bu.",
        reason="A definition.",
        kind="definition",
    ),
    _claim(
        "eq-4",
        "Equation 4",
        "",
        "The receding horizon policy applies the first input of the plan.",
        reason="A definition; the library's loop follows it.",
        kind="definition",
    ),
    _claim(
        "assumption-3",
        "Assumption 3",
        "ass1a",
        "N >= n; Q, R, Q_N and Gamma are positive definite.",
        reason="A hypothesis; the library refuses weights that are not definite. With Remark 4, n is the augmented "
        "state's.",
        kind="hypothesis",
    ),
    _claim(
        "theorem-1",
        "Theorem 1",
        "MPC1vsMPC3",
        "With V1, Gamma = alpha x'x and eps(k) -> 0, Assumptions 2 to 4 and 5(b) bring the state to zero, though the "
        "predictor maps change with k.",
        method="simulation",
        recorded="refuted",
        stated=lambda effort: check_changing(effort, vanishing),
        control=Control("eps constant too", lambda effort: check_changing(effort, vanishing, lambda k: 1.0)),
        instance=Control("b(k) that tends to one, so that V2's gains are bounded", partial(check_changing, b=settling)),
        reason="Step 2 of the proof uses that the gains of V2's least-norm solution are bounded over k; Assumption 5 "
        "bounds other gains. For x+ = ax + u, a > 1, N = 1 and the predictor ax + b(k)u with "
        "b(k) = eps(k) a^-2k / (k+1), 2 to 4 and 5(b) hold and x diverges from every nonzero x(0). Claim "
        "theorem-1.star is the theorem that holds.",
        uses=(
            "assumption-2",
            "assumption-3",
            "assumption-4a",
            "assumption-4b",
            "assumption-4c",
            "assumption-5",
            "lemma-1.b",
            "lemma-2",
            "lemma-3",
            "eq-40",
        ),
    ),
    _claim(
        "theorem-1.fixed",
        "Theorem 1",
        "MPC1vsMPC3",
        "With V1, Gamma = alpha x'x and eps(k) -> 0, the loop of a stabilizable system with its exact predictor "
        "converges to zero.",
        method="simulation",
        recorded="holds",
        stated=lambda effort: check_rest(effort, "x"),
        control=Control("eps constant", lambda effort: check_rest(effort, "x", lambda k: 1.0)),
        uses=("theorem-1.star", "assumption-2", "eq-9"),
        proof="notebooks/08-theorem-1.ipynb#proof-theorem-1-star",
    ),
    _claim(
        "theorem-1.ends",
        "Theorem 1",
        "MPC1vsMPC3",
        "Along that loop the planned terminal states r(k) = x_N(k) go to zero.",
        method="simulation",
        recorded="holds",
        stated=lambda effort: check_rest(effort, "r"),
        control=Control("eps constant", lambda effort: check_rest(effort, "r", lambda k: 1.0)),
        uses=("theorem-1.star.ends", "eq-9"),
        proof="notebooks/08-theorem-1.ipynb#proof-theorem-1-star",
    ),
    _claim(
        "theorem-1.pace",
        "Theorem 1",
        "MPC1vsMPC3",
        "If the horizon is too short to stabilise the system, the state goes to zero no faster than the root of "
        "eps(k).",
        method="simulation",
        recorded="observed",
        stated=check_pace,
        control=Control("eps halved at every step", lambda effort: check_pace(effort, lambda k: 0.5**k)),
    ),
    _claim(
        "eq-40",
        "Equation 40",
        "mpc1a",
        "V1's solution is V3's with r = x_N.",
        method="numerical sampling",
        recorded="holds",
        stated=check_same_problem,
        uses=("lemma-1.a",),
        proof="notebooks/08-theorem-1.ipynb#proof-eq-40",
        control=Control("r changed by 1e-3", lambda effort: check_same_problem(effort, 1e-3)),
    ),
)
