"""Lemma 1: V3 and V2 are quadratic with linear solutions; and the plans for V1, V2 and V3 are optimal."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from rhl._checks import Array
from rhl.horizon import Plan, solve
from rhl.model import PredictorMaps
from rhl.paper.claims.claim import Claim, Control, Effort, Evidence, worst_of
from rhl.problems import V1, V2, V3, Problem

_claim = partial(Claim, page="notebooks/05-lemma-1.ipynb", test="tests/paper/claims/test_lemma_1.py")

_PROOF = "notebooks/05-lemma-1.ipynb#the-proof-step-by-step"

# Entries of order one; the smallest terminal singular value is at least a hundredth.
_ROUNDING = 1e-9


def random_maps(rng: np.random.Generator, n: int, q: int, horizon: int) -> PredictorMaps:
    """Draw general predictor maps (5), not powers of one matrix, with well conditioned [B_0, ..., B_{N-1}]."""
    while True:
        A = rng.normal(size=(horizon + 1, n, n)) / np.sqrt(n)
        A[0] = np.eye(n)
        B = rng.normal(size=(horizon, n, q))
        if np.linalg.cond(np.concatenate(list(B), axis=1)) < 100:
            return PredictorMaps(A, B)


def random_weight(rng: np.random.Generator, n: int) -> Array:
    """Draw a symmetric positive definite matrix of condition at most 100."""
    Q = np.linalg.qr(rng.normal(size=(n, n)))[0]
    return np.asarray(Q @ np.diag(10.0 ** rng.uniform(-1, 1, n)) @ Q.T)


def stacked_form(maps: PredictorMaps, Q: Array, R: Array) -> tuple[Array, Array, Array]:
    """Return H, C and B of V3 as in the paper's proof: minimise w'Hw subject to C w = B [x; r].

    w = [nu_0; xi_0; ...; nu_{N-1}; xi_{N-1}; xi_N]. The rows of C state xi_0 = x, the predictions of xi_1 ... xi_N,
    and xi_N = r.
    """
    N, n, q = maps.horizon, maps.n, maps.q
    width = n + q
    size = N * width + n
    H = np.zeros((size, size))
    for i in range(N):
        H[i * width : i * width + q, i * width : i * width + q] = R
        H[i * width + q : (i + 1) * width, i * width + q : (i + 1) * width] = Q

    def at(i: int) -> slice:
        return slice(i * width + q, i * width + width) if i < N else slice(N * width, size)

    C, B = np.zeros(((N + 2) * n, size)), np.zeros(((N + 2) * n, 2 * n))
    for i in range(N + 1):
        rows = slice(i * n, (i + 1) * n)
        C[rows, at(i)] = np.eye(n)
        B[rows, :n] = maps.A[i]
        for j in range(i):
            C[rows, j * width : j * width + q] = -maps.B[i - 1 - j]
    C[(N + 1) * n :, at(N)] = np.eye(n)
    B[(N + 1) * n :, n:] = np.eye(n)
    return H, C, B


def independent_solution(maps: PredictorMaps, Q: Array, R: Array, x: Array, r: Array) -> tuple[Array, Array]:
    """Solve V3 by its KKT system, without the library's recursion; returns nu, shape (N, q), and its gain."""
    H, C, B = stacked_form(maps, Q, R)
    n, q, N = maps.n, maps.q, maps.horizon
    # xi_N has no weight; the constraint fixes it, so any weight gives the same solution.
    H = H + np.diag(np.r_[np.zeros(len(H) - n), np.ones(n)])
    kkt = np.block([[2 * H, C.T], [C, np.zeros((len(C), len(C)))]])
    gain = np.linalg.lstsq(kkt, np.concatenate([np.zeros((len(H), 2 * n)), B]), rcond=None)[0][: len(H)]
    w = gain @ np.concatenate([x, r])
    return np.stack([w[i * (n + q) : i * (n + q) + q] for i in range(N)]), gain


def partly_steered(rng: np.random.Generator, maps: PredictorMaps, least: int = 0) -> tuple[PredictorMaps, Array]:
    """Return maps whose terminal state is not controllable along some directions, and the projection onto the others.

    ``maps``: with [B_0, ..., B_{N-1}] of rank n. ``least``: the least number of controllable directions.
    """
    n = maps.n
    basis = np.linalg.qr(rng.normal(size=(n, n)))[0][:, : int(rng.integers(least, n + 1))]
    onto = np.asarray(basis @ basis.T)
    return PredictorMaps(maps.A, onto @ maps.B), onto


def random_case(rng: np.random.Generator) -> tuple[PredictorMaps, Array, Array]:
    """Draw general predictor maps of up to three states and inputs, and weights Q and R for them."""
    n, q = (int(size) for size in rng.integers(1, 4, 2))
    maps = random_maps(rng, n, q, int(rng.integers(n, 7)))
    return maps, random_weight(rng, n), random_weight(rng, q)


def check_linear(effort: Effort, bend: float = 0.0) -> Evidence:
    """Superpose solutions of V3 and compare with an independent solver, also where some r are not reachable.

    ``bend``: multiple of |x| added to r, so that the right side is not linear in (x, r).
    """
    rng, gaps = effort.rng("lemma-1.a"), []
    for _ in range(effort.cases):
        maps, Q, R = random_case(rng)
        maps, onto = partly_steered(rng, maps)
        x, r = rng.normal(size=(2, 3, maps.n))
        x[2], r[2] = x[0] + 2 * x[1], r[0] + 2 * r[1]
        r = (r + bend * np.linalg.norm(x, axis=1, keepdims=True)) @ onto
        # The part that inputs do not move is the maps' image of x.
        r += x @ ((np.eye(maps.n) - onto) @ maps.A[-1]).T
        u = np.stack([solve(V3(maps, Q, R, r[i], maps.horizon), x[i]).u for i in range(3)])
        scale = 1 + np.max(np.abs(u))
        other, _ = independent_solution(maps, Q, R, x[0], r[0])
        gaps.append(float(np.max(np.abs(u[2] - u[0] - 2 * u[1])) / scale))
        gaps.append(float(np.max(np.abs(u[0] - other)) / scale))
    return Evidence(len(gaps), worst_of(gaps), _ROUNDING, "rounding through a well conditioned KKT system")


def polarise(value: Callable[[Array], float], size: int) -> Array:
    """Return the symmetric S with value(p) = p'Sp, from values alone: S_ab = (value(a + b) - value(a - b)) / 4.

    S has shape (size, size). ``value`` takes arrays of shape (size,); callers check its results.
    """
    eye = np.eye(size)
    S = np.array([[(value(a + b) - value(a - b)) / 4 for b in eye] for a in eye])
    return np.asarray((S + S.T) / 2)


def check_quadratic(effort: Effort, cubic: float = 0.0) -> Evidence:
    """Recover S_3, S_4, S_5 of V_3 = x'S_3x + x'S_4r + r'S_5r by probing, and predict values elsewhere.

    Where inputs do not move all of the terminal state, r prescribes the part that they move; x determines the rest.

    ``cubic``: multiple of |x|^3 added to the values, which no quadratic form reproduces.
    """
    rng, gaps = effort.rng("lemma-1.a.value"), []
    for _ in range(max(1, effort.cases // 4)):
        maps, Q, R = random_case(rng)
        maps, onto = partly_steered(rng, maps)
        n, reached = maps.n, np.hstack([(np.eye(maps.n) - onto) @ maps.A[-1], onto])

        def value(
            point: Array, maps: PredictorMaps = maps, Q: Array = Q, R: Array = R, reached: Array = reached
        ) -> float:
            x = point[: maps.n]
            plan = solve(V3(maps, Q, R, reached @ point, maps.horizon), x)
            return float(plan.value) + cubic * float(np.linalg.norm(x) ** 3)

        S = polarise(value, 2 * n)
        for point in rng.normal(size=(3, 2 * n)):
            found = value(point)
            gaps.append(abs(float(point @ S @ point) - found) / (1 + found))
            gaps.append(-min(found, 0.0))
    return Evidence(len(gaps), worst_of(gaps), _ROUNDING, "rounding of sums of squares")


def symbolic_solution(R_sign: int = 1) -> tuple[list[dict[Any, Any]], Any]:
    """Solve the KKT system of (11) for n = q = 1, N = 2 with symbols x, r, a1, a2, b0, b1, Q, R.

    Returns the solutions, for v0, v1 and the multiplier mu, and the objective's second derivative along (1, -b1/b0),
    the only direction that keeps xi_2. ``R_sign``: 0 takes R = 0 and the stage weight Q = 0.
    """
    import sympy as sp  # imported here, because loading it takes long

    x, r, a1, a2 = sp.symbols("x r a1 a2", real=True)
    b0, b1, Q, R = sp.symbols("b0 b1 Q R", positive=True)
    v0, v1, mu = sp.symbols("v0 v1 mu")
    xi1, xi2 = a1 * x + b0 * v0, a2 * x + b1 * v0 + b0 * v1
    cost = Q * R_sign * (x**2 + xi1**2) + R * R_sign * (v0**2 + v1**2)
    lagrangian = cost + mu * (xi2 - r)
    solutions = sp.solve([sp.diff(lagrangian, symbol) for symbol in (v0, v1, mu)], [v0, v1, mu], dict=True)
    free = sp.Matrix([1, -b1 / b0])
    return solutions, sp.expand((free.T * sp.hessian(cost, (v0, v1)) * free)[0])


def check_symbolic(effort: Effort, R_sign: int = 1) -> Evidence:
    """Solve the KKT system of (11) for n = q = 1, N = 2 with symbols: one solution, linear in x and r.

    ``effort`` is not used, since nothing is random.
    ``R_sign``: 0 sets R = 0 and the stage weight Q = 0, so the solution is not unique.
    """
    import sympy as sp  # imported here, because loading it takes long

    x, r = sp.symbols("x r", real=True)
    v0, v1 = sp.symbols("v0 v1")
    solutions, curvature = symbolic_solution(R_sign)
    if len(solutions) != 1 or not {v0, v1} <= set(solutions[0]):
        return Evidence(1, 1.0)
    faults = 0
    for unknown in (v0, v1):
        solution = solutions[0][unknown]
        linear = sp.diff(solution, x) * x + sp.diff(solution, r) * r
        faults += sp.simplify(solution - linear) != 0 or bool(linear.diff(x, 2) != 0)
    # Positive along the only free direction, so the solution is the minimiser.
    faults += not curvature.is_positive
    return Evidence(3, float(faults))


def check_v2(effort: Effort, sample: bool = False) -> Evidence:
    """Superpose least-norm solutions of V2, and recover its value as a positive semidefinite form.

    ``sample``: use another minimiser of V2, chosen differently for each x.
    """
    rng, gaps = effort.rng("lemma-1.b"), []
    for _ in range(effort.cases):
        n, q = int(rng.integers(2, 4)), int(rng.integers(1, 3))
        # The horizon is longer than needed, so that there is always another minimiser.
        maps, onto = partly_steered(rng, random_maps(rng, n, q, n + 1), 1)
        QN, N = random_weight(rng, n), n + 1
        x = rng.normal(size=(3, n))
        x[2] = x[0] + 2 * x[1]
        plans = [solve(V2(maps, QN, N), each) for each in x]
        u = np.stack([plan.u for plan in plans])
        # The end is a minimiser if the gradient there is zero along all controllable directions.
        scale = 1 + np.max(np.abs(u))
        gaps.append(max(float(np.max(np.abs(onto @ QN @ plan.x[-1]))) for plan in plans) / scale)
        gaps.append(float(np.max(np.abs(u[0] - _shortest(maps, plans[0].x[-1], x[0])))) / scale)
        if sample:
            push = np.linalg.svd(np.concatenate(list(maps.B[::-1]), axis=1))[2][-1].reshape(N, q)
            u = u + np.abs(rng.normal(size=3))[:, None, None] * push
        gaps.append(float(np.max(np.abs(u[2] - u[0] - 2 * u[1])) / scale))

        def value(point: Array, maps: PredictorMaps = maps, QN: Array = QN, N: int = N) -> float:
            return float(solve(V2(maps, QN, N), point).value)

        S = polarise(value, n)
        gaps.append(-float(np.min(np.linalg.eigvalsh(S))))
        gaps.append(abs(float(x[0] @ S @ x[0] - plans[0].value)))
    return Evidence(len(gaps), worst_of(gaps), _ROUNDING, "rounding through a well conditioned terminal map")


def _shortest(maps: PredictorMaps, end: Array, x: Array) -> Array:
    """Return the inputs, shape (N, q), of the plan from x to end with the least sum of |xi_i|^2 + |nu_i|^2."""
    return independent_solution(maps, np.eye(maps.n), np.eye(maps.q), x, end)[0]


def check_optimality(effort: Effort, which: str, nudge: float = 0.0) -> Evidence:
    """Recompute the certificate of the library's plan for a problem. ``nudge``: change of the plan's inputs."""
    rng, worst = effort.rng(which), []
    for _ in range(effort.cases):
        maps, Q, R = random_case(rng)
        x, N = rng.normal(size=maps.n), maps.horizon
        problem: Problem
        if which == "V1":
            problem = V1(maps, Q, R, Q, 10.0 ** rng.uniform(-2, 6), N)
        elif which == "V2":
            maps = PredictorMaps(maps.A, maps.B * (np.arange(maps.n)[:, None] > 0))
            problem = V2(maps, Q, N)
        else:
            problem = V3(maps, Q, R, rng.normal(size=maps.n), N)
        u = solve(problem, x).u
        u = u + nudge * rng.normal(size=u.shape)
        end = maps.predict(x, u)
        worst.append(float(Plan(problem, u, end).residual()))
        if isinstance(problem, V3):
            worst.append(float(np.max(np.abs(end[-1] - problem.r)) / (1 + np.max(np.abs(end)))))
    return Evidence(len(worst), worst_of(worst), 1e-12, "rounding, relative to the terms that cancel")


CLAIMS: tuple[Claim, ...] = (
    _claim(
        "lemma-1.a",
        "Lemma 1(a)",
        "mp",
        "The solution of V3 is unique and linear in (x, r), for general predictor maps.",
        method="numerical sampling",
        recorded="holds",
        stated=check_linear,
        control=Control("a terminal state that depends on |x|", lambda effort: check_linear(effort, bend=0.1)),
        uses=("assumption-3", "eq-5", "eq-11"),
        proof=_PROOF,
    ),
    _claim(
        "lemma-1.a.symbolic",
        "Lemma 1(a)",
        "mp",
        "For n = q = 1, N = 2 the KKT system of V3 has one solution, linear in (x, r).",
        method="symbolic identity",
        recorded="holds",
        stated=check_symbolic,
        control=Control("Q = R = 0", lambda effort: check_symbolic(effort, R_sign=0)),
        uses=("assumption-3", "eq-11"),
    ),
    _claim(
        "lemma-1.a.value",
        "Lemma 1(a)",
        "mp",
        "V3 is the nonnegative quadratic form x'S_3x + x'S_4r + r'S_5r.",
        method="numerical sampling",
        recorded="holds",
        stated=check_quadratic,
        control=Control("a cubic term in the value", lambda effort: check_quadratic(effort, cubic=0.1)),
        uses=("lemma-1.a",),
        proof=_PROOF,
    ),
    _claim(
        "lemma-1.b",
        "Lemma 1(b)",
        "mp",
        "V2 is a positive semidefinite form x'S_6x, and its least-norm solution is linear in x.",
        method="numerical sampling",
        recorded="holds",
        stated=check_v2,
        control=Control("another minimiser than the one of least norm", lambda effort: check_v2(effort, sample=True)),
        uses=("lemma-1.a", "eq-10"),
        proof=_PROOF,
    ),
    _claim(
        "eq-3",
        "Equation 3",
        "mpc1",
        "The library's plans for V1 satisfy the optimality conditions.",
        method="numerical sampling",
        recorded="holds",
        stated=lambda effort: check_optimality(effort, "V1"),
        control=Control("inputs moved by 1e-6", lambda effort: check_optimality(effort, "V1", 1e-6)),
        kind="definition",
    ),
    _claim(
        "eq-10",
        "Equation 10",
        "mpc2",
        "The library's plans for V2 satisfy the optimality conditions.",
        method="numerical sampling",
        recorded="holds",
        stated=lambda effort: check_optimality(effort, "V2"),
        control=Control("inputs moved by 1e-6", lambda effort: check_optimality(effort, "V2", 1e-6)),
        kind="definition",
    ),
    _claim(
        "eq-11",
        "Equation 11",
        "mpc3",
        "The library's plans for V3 satisfy the optimality conditions and end in r.",
        method="numerical sampling",
        recorded="holds",
        stated=lambda effort: check_optimality(effort, "V3"),
        control=Control("inputs moved by 1e-6", lambda effort: check_optimality(effort, "V3", 1e-6)),
        kind="definition",
    ),
)
