"""Assumptions 2 and 4: linear predictor maps that commute and are accurate along the closed loop."""

from __future__ import annotations

from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np

from rhl.controllability import controllability_margin
from rhl.horizon import solve
from rhl.model import PredictorMaps, SignalModel
from rhl.paper.claims.claim import Claim, Control, Effort, Evidence, worst_of
from rhl.paper.claims.lemma_1 import random_maps, random_weight
from rhl.paper.claims.predictors import (
    commutation_gaps,
    general_maps,
    powers,
    predict,
    rational,
    stepped,
)
from rhl.problems import V1, V2, Predictor

_claim = partial(Claim, page="notebooks/04-assumption-4.ipynb", test="tests/paper/claims/test_assumption_4.py")

# Prediction errors over a horizon, relative to the initial state, for an exact predictor: rounding.
_RIGHT = 1e-9


def _exact(gaps: list[Any], cases: int) -> Evidence:
    return Evidence(cases, float(max(gaps)))


def check_arguments(effort: Effort, extra: int, swapped: bool = False) -> Evidence:
    """Compare the library's equation (5) with (5) written out, in integers; and check the last argument of P_i.

    ``extra``: the last argument is u_{i-1+extra}: 1 as printed, 0 as intended.
    ``swapped``: write it out with B_l in place of B_{i-1-l}.
    """
    rng = effort.rng("eq-5")
    gaps = []
    for _ in range(effort.cases):
        n, q, N = (int(size) for size in rng.integers((1, 1, 2), (4, 4, 6)))
        A = np.concatenate([np.eye(n)[None], rng.integers(-9, 10, (N, n, n))])
        B = rng.integers(1, 10, (N, n, q))
        x, u = rng.integers(-9, 10, n), rng.integers(-9, 10, (N + 1, q))
        maps = PredictorMaps(A, B.astype(np.float64))
        there = maps.predict(x, u[:N])
        for i in range(1, N + 1):
            written = A[i] @ x + sum(B[l if swapped else i - 1 - l] @ u[l] for l in range(i))
            gaps.append(float(np.max(np.abs(there[i] - written))))
            moved = u.copy()
            moved[i - 1 + extra] += 1
            gaps.append(float(np.array_equal(maps.predict(x, moved[:N])[i], there[i])))
    return _exact(gaps, effort.cases)


def check_commuting(effort: Effort, printed: bool = False, nudge: int = 0) -> Evidence:
    """Check equation (7) for powers, in rational numbers.

    ``printed``: include P_{N+1} too. ``nudge``: change of one entry of A_2, so that the maps are not powers.
    """
    rng = effort.rng("eq-7")
    gaps: list[Fraction | int] = []
    for _ in range(max(1, effort.cases // 4)):
        n, q, N = (int(size) for size in rng.integers((1, 1, 2), (4, 3, 5)))
        maps = powers(rational(rng, n, n), rational(rng, n, q), N)
        maps[0][2][0, 0] += nudge
        gaps.extend(commutation_gaps(maps, rational(rng, n), rational(rng, N + 1, q), printed))
    return _exact(gaps, max(1, effort.cases // 4))


def check_powers(effort: Effort, everywhere: bool = True) -> Evidence:
    """Change one entry of a family of powers and count the families for which (7) still holds.

    The models have a last state that nothing moves from zero.

    ``everywhere``: change any entry of any map, and test (7) from all states; otherwise change the column of the last
    state, and test from states whose last entry is zero.
    """
    rng = effort.rng("eq-7.powers")
    unseen = []
    for _ in range(max(1, effort.cases // 4)):
        A, B, N = rational(rng, 3, 3), rational(rng, 3, 2), 3
        A[2, :2] = 0
        B[2] = 0
        maps = powers(A, B, N)
        row, i = int(rng.integers(3)), int(rng.integers(2, N + 1))
        if everywhere and rng.integers(2):
            maps[1][i - 1][row, int(rng.integers(2))] += 1
        else:
            maps[0][i][row, int(rng.integers(3)) if everywhere else 2] += 1
        unit = powers(A, B, 1)[0][0]
        # Linear in x and in each input, so it is enough to test at these.
        inputs = [np.eye(2 * N, dtype=int)[j].reshape(N, 2) for j in range(2 * N)]
        inputs = [np.concatenate([s, np.zeros((1, 2), dtype=int)]) for s in [*inputs, np.zeros((N, 2), dtype=int)]]
        states = [*(unit if everywhere else unit[:2]), 0 * unit[0]]
        unseen.append(0 if any(max(commutation_gaps(maps, x, s)) > 0 for x in states for s in inputs) else 1)
    return _exact(unseen, len(unseen))


def check_accurate(effort: Effort, last: int, nudge: int = 0) -> Evidence:
    """Check equation (8) for the powers of (A, B) itself, in rational numbers: every e_i must be zero.

    ``last``: the sum on the right ends at l = i - 1 + last: 1 as printed, which needs A^-1, 0 as intended.
    ``nudge``: change of one entry of the predictor's A.
    """
    rng = effort.rng("eq-8")
    gaps: list[Fraction | int] = []
    for _ in range(max(1, effort.cases // 4)):
        n, N = int(rng.integers(1, 4)), 4
        lower = np.tril(rng.integers(-3, 4, (n, n)), -1) + np.eye(n, dtype=int)
        upper = np.triu(rng.integers(-3, 4, (n, n)), 1) + np.eye(n, dtype=int)
        # The determinant is one, so the inverse has integer entries and rounding finds it.
        inverse = np.rint(np.linalg.inv(lower @ upper)).astype(int)
        A, back = ((lower @ upper) + 0 * rational(rng, n, n), inverse + 0 * rational(rng, n, n))
        B, x, s = rational(rng, n, 2), rational(rng, n), rational(rng, N + 1, 2)
        x[0], B[0, 0], s[:, 0], s[:, 1] = Fraction(1), Fraction(1), Fraction(1), Fraction(0)
        truth = powers(A, B, N)
        wrong = A.copy()
        wrong[0, 0] += nudge
        for i in range(N + 1):
            right = predict(truth, i, x, s) + last * (back @ B @ s[i])
            gaps.extend(np.abs(predict(powers(wrong, B, N), i, x, s) - right))
    return _exact(gaps, max(1, effort.cases // 4))


def check_error_bound(effort: Effort, approaching: bool = True) -> Evidence:
    """Compare the errors of maps A_i(k) = A^i + D_i/(k+1) with (8), where omega_1 = 0 and omega_2, omega_3 -> 0.

    ``approaching`` False: the errors D_i stay.
    """
    rng = effort.rng("assumption-4b")
    excess = []
    for _ in range(effort.cases):
        plant, D = general_maps(rng)
        N, k = D.horizon, np.arange(50)
        powers_of = plant.predictor(N)
        fade = 1 / (k + 1)[:, None, None, None]
        held = fade if approaching else np.ones_like(fade)
        maps = PredictorMaps(powers_of.A + held * D.A * (np.arange(N + 1) > 0)[:, None, None], powers_of.B + held * D.B)
        x, s = rng.normal(size=(50, plant.n)), rng.normal(size=(50, N, plant.q)) * 10.0 ** rng.uniform(-3, 3)
        e2 = np.sum((maps.predict(x, s) - stepped(plant, x, s)) ** 2, axis=-1)
        omega2 = 2 * np.max(np.linalg.norm(D.A, 2, axis=(-2, -1))) ** 2 / (k + 1) ** 2
        omega3 = 2 * N * np.max(np.linalg.norm(D.B, 2, axis=(-2, -1))) ** 2 / (k + 1) ** 2
        inputs = np.concatenate([np.zeros((50, 1)), np.cumsum(np.sum(s**2, axis=-1), axis=-1)], axis=-1)
        bound = omega2[:, None] * np.sum(x**2, axis=-1)[:, None] + omega3[:, None] * inputs
        excess.append(float(np.max((e2 - bound) / bound)))
    return Evidence(len(excess), worst_of(excess), 1e-12, "rounding of a few products")


def check_steering(effort: Effort, short: bool = False) -> Evidence:
    """Check that V2 is zero for general maps of full rank, and for controllable models with N >= n.

    ``short``: lower the rank, by maps that miss one direction, and by a short horizon.
    """
    rng = effort.rng("assumption-4c")
    left: list[float] = []
    while len(left) < effort.cases:
        n, q = int(rng.integers(2, 5)), int(rng.integers(1, 4))
        QN, x = random_weight(rng, n), rng.normal(size=n)
        maps: Predictor
        if len(left) % 2:
            maps = random_maps(rng, n, q, int(rng.integers(n, n + 3)))
            if short:
                maps = PredictorMaps(maps.A, maps.B * (np.arange(n) > 0)[:, None])
            horizon = maps.horizon
        else:
            maps, horizon = SignalModel(rng.normal(size=(n, n)), rng.normal(size=(n, q))), n - short
            if controllability_margin(maps) < 0.1 or (short and q * horizon >= n):
                continue
        left.append(float(np.sqrt(solve(V2(maps, QN, horizon), x).value) / np.linalg.norm(x)))
    return Evidence(len(left), worst_of(left), _RIGHT, "rounding through maps of condition at most a hundred")


def check_reachable_end(effort: Effort, mode: float = 0.8) -> Evidence:
    """Compare the last with the first V2 along loops of V1 whose exact predictor is only stabilizable.

    ``mode``: eigenvalue of the state that no input reaches.
    """
    rng = effort.rng("eq-9")
    A, B = rng.normal(size=(effort.cases, 3, 3)), rng.normal(size=(effort.cases, 3, 1))
    A[:, 2], B[:, 2] = [0.0, 0.0, mode], 0.0
    model = SignalModel(A, B)
    x = rng.normal(size=(effort.cases, 3))
    x[:, 2] = 1.0
    values = []
    for k in range(80):
        values.append(solve(V2(model, 1.0, 4), x).value)
        x = model.step(x, solve(V1(model, 1.0, 1.0, 1.0, (1 + k) * np.sum(x**2, axis=-1), 4), x).u[..., 0, :])
    return Evidence(effort.cases, float(np.max(values[-1] / values[0])), 1e-12, f"{mode:g}^158 and rounding")


def check_out_of_reach(effort: Effort, reached: bool = False) -> Evidence:
    """Check exactly that, without Assumption 2, no input acts along an unstable left eigenvector w with w'B = 0.

    ``reached``: let the input reach it.
    """
    rng = effort.rng("assumption-2")
    gaps: list[Fraction | int] = []
    for _ in range(effort.cases):
        A, B, x = rational(rng, 3, 3), rational(rng, 3, 2), rational(rng, 3)
        mode = Fraction(*((5, 4), (1, 1), (-1, 1), (-3, 2))[int(rng.integers(4))])
        A[2], x[2] = [Fraction(0), Fraction(0), mode], Fraction(1 + int(rng.integers(9)), 7)
        B[2] = Fraction(int(reached))
        # Other coordinates T x, in which the left eigenvector is the last row w of T^-1.
        T, back = np.array([[1, 0, 0], [3, 1, 0], [2, -1, 1]]), np.array([[1, 0, 0], [-3, 1, 0], [-5, 1, 1]])
        A, B, x, w = T @ A @ back, T @ B, T @ x, back[2]
        start = w @ x
        for k in range(1, 6):
            x = A @ x + B @ (1 + rational(rng, 2) ** 2)
            gaps += [abs(w @ x - mode**k * start), max(abs(start) - abs(w @ x), Fraction(0))]
    return _exact(gaps, effort.cases)


CLAIMS: tuple[Claim, ...] = (
    _claim(
        "assumption-2",
        "Assumption 2",
        "ass1",
        "If (A, B) is not stabilizable, there are states that no inputs bring to zero: the assumption is needed.",
        method="exact arithmetic",
        recorded="holds",
        stated=check_out_of_reach,
        control=Control("an input that reaches the unstable mode", lambda e: check_out_of_reach(e, reached=True)),
        kind="hypothesis",
    ),
    _claim(
        "assumption-4a",
        "Assumption 4(a)",
        "ass0",
        "The predictor maps are linear and converge.",
        reason="A hypothesis. Its linear form is checked by eq-5. The proofs do not need convergence, by "
        "lemma-2.differences.",
        kind="hypothesis",
    ),
    _claim(
        "eq-5",
        "Equation 5",
        "predictor",
        "P_i is linear in x_0 and in the inputs before step i, with A_i and B_{i-1-l} as coefficients.",
        method="exact arithmetic",
        recorded="holds-corrected",
        stated=lambda effort: check_arguments(effort, 1),
        corrected=lambda effort: check_arguments(effort, 0),
        control=Control("B_l in place of B_{i-1-l}", lambda effort: check_arguments(effort, 0, swapped=True)),
        reason="P_i is printed with u_i as its last argument, but it does not depend on u_i; the last one is u_{i-1}, "
        "as in (3).",
        kind="definition",
    ),
    _claim(
        "eq-6",
        "Equation 6",
        "p2",
        "The maps A_i(k), B_i(k) have limits.",
        reason="A hypothesis, and a limit without a rate. Claim theorem-2.i checks whether the estimator satisfies it; "
        "lemma-2.differences is what the proof of Lemma 2 needs instead.",
        kind="hypothesis",
    ),
    _claim(
        "assumption-4b",
        "Assumption 4(b)",
        "ass0",
        "Maps that approach the plant's own satisfy the error bound of (8), with explicit omegas that go to zero.",
        method="numerical sampling",
        recorded="holds",
        stated=check_error_bound,
        control=Control(
            "errors of the maps that do not decay", lambda effort: check_error_bound(effort, approaching=False)
        ),
        kind="hypothesis",
    ),
    _claim(
        "eq-7",
        "Equation 7",
        "p4",
        "Maps that are powers of one model commute, and two of them in sequence give the map for all their steps.",
        method="exact arithmetic",
        recorded="holds-corrected",
        stated=lambda effort: check_commuting(effort, printed=True),
        corrected=check_commuting,
        control=Control("one entry of A_2 changed", lambda effort: check_commuting(effort, nudge=1)),
        reason="The range 0 <= i + j <= N + 1 includes P_{N+1}, for which there are no maps, and s_N, which is not "
        "part of the plan. Three equal members up to i + j = N, and the first two up to N + 1 with s_N = 0, are what "
        "the proof of Lemma 2 uses.",
        kind="hypothesis",
    ),
    _claim(
        "eq-7.powers",
        "Equation 7",
        "p4",
        "Maps that satisfy (7) from all states and for all inputs are powers of one model.",
        method="exact arithmetic",
        recorded="holds",
        stated=check_powers,
        control=Control(
            "(7) only from states that a closed loop may visit", lambda effort: check_powers(effort, everywhere=False)
        ),
        proof="notebooks/04-assumption-4.ipynb#only-powers-commute",
    ),
    _claim(
        "eq-8",
        "Equation 8",
        "p3",
        "The error e_i compares P_i with the system's own i steps; it is zero for the system's own maps.",
        method="exact arithmetic",
        recorded="holds-corrected",
        stated=lambda effort: check_accurate(effort, 1),
        corrected=lambda effort: check_accurate(effort, 0),
        control=Control("a predictor of another system", lambda effort: check_accurate(effort, 0, nudge=1)),
        reason="The sum on the right should end at i - 1: the term l = i would be A^-1 B s_i, which need not exist and "
        "is itself an error. The sum of |s_l|^2 in the bound should end there too: s_i is harmless, but s_N is not "
        "part of the plan.",
        kind="hypothesis",
    ),
    _claim(
        "assumption-4c",
        "Assumption 4(c)",
        "ass0",
        "If rank [B_0 ... B_{N-1}] = n, as for a controllable model with N >= n, every terminal state can be zero.",
        method="numerical sampling",
        recorded="holds",
        stated=check_steering,
        control=Control("a rank below n", lambda effort: check_steering(effort, short=True)),
        kind="hypothesis",
    ),
    _claim(
        "eq-9",
        "Equation 9",
        "stabilizability",
        "For an exact and stabilizable predictor, the least terminal value goes to zero along the closed loop.",
        method="simulation",
        recorded="holds",
        stated=check_reachable_end,
        control=Control("a mode at 1 that no input reaches", lambda effort: check_reachable_end(effort, mode=1.0)),
        kind="hypothesis",
    ),
)
