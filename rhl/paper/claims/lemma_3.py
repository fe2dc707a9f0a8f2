"""Lemma 3: the distance of V1's terminal state from the best one, with an explicit constant."""

from __future__ import annotations

from functools import partial

import numpy as np

from rhl._checks import Array
from rhl.horizon import Plan, solve
from rhl.model import PredictorMaps
from rhl.paper.claims.claim import Claim, Control, Effort, Evidence, worst_of
from rhl.paper.claims.lemma_1 import random_maps, random_weight
from rhl.problems import V1, V2

_claim = partial(
    Claim,
    page="notebooks/07-lemma-3.ipynb",
    test="tests/paper/claims/test_lemma_3.py",
    proof="notebooks/07-lemma-3.ipynb#the-proof-step-by-step",
)
_ROUNDING = 1e-9


def size_of(plan: Plan) -> float:
    """Return the sum of |xi_i|^2 + |nu_i|^2 over i = 0 ... N-1, which Gamma must dominate."""
    return float(np.sum(plan.x[:-1] ** 2) + np.sum(plan.u**2))


def rho(Q: Array, R: Array, c: float) -> float:
    """Return max(lambda_max(Q), lambda_max(R)) / c: the constant of the lemma."""
    return float(max(np.linalg.eigvalsh(Q)[-1], np.linalg.eigvalsh(R)[-1]) / c)


def draw(rng: np.random.Generator) -> tuple[PredictorMaps, Array, Array, Array, Array]:
    """Draw maps that are not controllable, weights Q, R, Q_N and a state."""
    n, q = int(rng.integers(2, 4)), int(rng.integers(1, 3))
    maps = random_maps(rng, n, q, int(rng.integers(n, 6)))
    unsteered = float(rng.choice([0.0, 1e-3, 1.0]))
    maps = PredictorMaps(maps.A, maps.B * np.where(np.arange(n) == n - 1, unsteered, 1.0)[:, None])
    return maps, random_weight(rng, n), random_weight(rng, q), random_weight(rng, n), rng.normal(size=n)


def ratio(
    maps: PredictorMaps, Q: Array, R: Array, QN: Array, x: Array, epsilon: float, gamma_factor: float, c: float = 1.0
) -> tuple[float, float]:
    """Return (x_N'Q_N x_N - V2) / (epsilon rho), at most 1 by the lemma, and its rounding, from x, shape (n,).

    Gamma is gamma_factor times the size of V2's solution; c makes it the smallest that the lemma allows.
    """
    best = solve(V2(maps, QN, maps.horizon), x)
    gamma = gamma_factor * size_of(best)
    end = solve(V1(maps, Q, R, QN, gamma / epsilon, maps.horizon), x).x[-1]
    reached, least = float(end @ QN @ end), float(best.value)
    allowed = epsilon * rho(Q, R, c)
    return (reached - least) / allowed, 1e-13 * reached / allowed


def check_bound(effort: Effort, gamma_factor: float = 1.0) -> Evidence:
    """Find the violation of (12) with the explicit rho, over epsilon from 1e-10 to 1e3 and c from 0.01 to 100.

    Gamma is c times the size of V2's solution, or up to a hundred times more.
    ``gamma_factor``: factor on Gamma; below 1, Gamma is smaller than the lemma requires.
    """
    rng, excess = effort.rng("lemma-3"), []
    for _ in range(effort.cases):
        case, c = draw(rng), float(10.0 ** rng.uniform(-2, 2))
        for more, epsilon in zip(
            (1.0, 1.0, *10.0 ** rng.uniform(0, 2, 2)), 10.0 ** rng.uniform(-10, 3, 4), strict=True
        ):
            found, rounding = ratio(*case, float(epsilon), gamma_factor * c * float(more), c)
            excess.append(found - 1 - rounding)
        # The extreme case, where terminal term and stages have about the same weight.
        excess.append(ratio(*scalar_case(100.0), c * (1 + 100.0**2), gamma_factor * c, c)[0] - 1)
    return Evidence(len(excess), worst_of(excess), _ROUNDING, "rounding; that of x_N is taken off at small epsilon")


def check_step(effort: Effort, gamma_factor: float = 1.0) -> Evidence:
    """Check the inequality behind (39): V1 is at most the cost of V2's solution, which is bounded by rho Gamma.

    ``gamma_factor``: factor on Gamma; below 1, Gamma is smaller than the lemma requires.
    """
    rng, excess = effort.rng("eq-39"), []
    for _ in range(effort.cases):
        maps, Q, R, QN, x = draw(rng)
        best, c = solve(V2(maps, QN, maps.horizon), x), float(10.0 ** rng.uniform(-2, 2))
        gamma = gamma_factor * c * size_of(best)
        problem = V1(maps, Q, R, QN, gamma / 10.0 ** rng.uniform(-4, 2), maps.horizon)
        at_best = float(Plan(problem, best.u, best.x).value)
        stages = float(
            np.einsum("ia,ab,ib->", best.x[:-1], Q, best.x[:-1]) + np.einsum("ia,ab,ib->", best.u, R, best.u)
        )
        excess.append(float(solve(problem, x).value) / at_best - 1)
        excess.append(stages / (rho(Q, R, c) * gamma) - 1)
    return Evidence(len(excess), worst_of(excess), _ROUNDING, "rounding of sums of squares")


def scalar_case(a: float) -> tuple[PredictorMaps, Array, Array, Array, Array]:
    """Return x+ = a x + u with N = 1 and weights one, where a quarter of rho is nearly attained for large a.

    There x_N'Q_N x_N - V2 = eps rho * s a^2 / ((1 + s)^2 (1 + a^2)) with the terminal weight s = Gamma/eps.
    """
    one = np.eye(1)
    return PredictorMaps(np.array([[[1.0]], [[a]]]), np.ones((1, 1, 1))), one, one, one, np.ones(1)


def check_quarter(effort: Effort, share: float = 0.25) -> Evidence:
    """Find the violation of (12) with that share of eps rho, over random maps and the scalar case.

    ``share``: a quarter, the smallest possible constant.
    """
    rng, excess = effort.rng("lemma-3.quarter"), []
    for _ in range(effort.cases):
        for case in (draw(rng), scalar_case(100.0)):
            best = size_of(solve(V2(case[0], case[3], case[0].horizon), case[4]))
            # The excess is largest if the terminal term has about the weight of the stages.
            for epsilon in best * 10.0 ** rng.uniform(-2, 2, 2):
                found, rounding = ratio(*case, epsilon, 1.0)
                excess.append(found - share - rounding)
        best = size_of(solve(V2(case[0], case[3], 1), case[4]))
        excess.append(ratio(*case, best, 1.0)[0] - share)
    return Evidence(len(excess), worst_of(excess), _ROUNDING, "rounding; that of x_N is taken off at small epsilon")


CLAIMS: tuple[Claim, ...] = (
    _claim(
        "lemma-3",
        "Lemma 3",
        "lem1a",
        "A plan of V1 ends with x_N'Q_N x_N <= V2 + eps rho; rho = max(lambda_max(Q), lambda_max(R)) / c is "
        "sufficient.",
        method="numerical sampling",
        recorded="holds",
        stated=check_bound,
        control=Control("Gamma a thousand times too small", lambda effort: check_bound(effort, 1e-3)),
        uses=("assumption-3", "eq-5", "eq-39"),
    ),
    _claim(
        "lemma-3.quarter",
        "Lemma 3",
        "lem1a",
        "A quarter of that rho, max(lambda_max(Q), lambda_max(R)) / (4c), is sufficient, and no smaller constant is.",
        method="numerical sampling",
        recorded="holds",
        stated=check_quarter,
        control=Control("a constant smaller by 1 in 25", lambda effort: check_quarter(effort, 0.24)),
        uses=("assumption-3", "eq-39"),
        proof="notebooks/07-lemma-3.ipynb#lemma-3-quarter",
    ),
    _claim(
        "eq-12",
        "Equation 12",
        "feasible",
        "The bound of Lemma 3, over eps from 1e-10 to 1e3.",
        method="numerical sampling",
        recorded="holds",
        stated=check_bound,
        control=Control("Gamma a thousand times too small", lambda effort: check_bound(effort, 1e-3)),
        uses=("lemma-3",),
    ),
    _claim(
        "eq-39",
        "Equation 39",
        "contra1",
        "V1 is at most the cost of V2's solution, whose stage costs are at most rho Gamma.",
        method="numerical sampling",
        recorded="holds",
        stated=check_step,
        control=Control("Gamma a thousand times too small", lambda effort: check_step(effort, 1e-3)),
        uses=("assumption-3", "eq-3", "eq-5", "eq-10"),
    ),
)
