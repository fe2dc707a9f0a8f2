"""Convexity of a Bregman distance in its second argument, and Assumption 6 on loss and generator."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from rhl._checks import Array
from rhl.losses import Generator, WeightedSquares, divergence
from rhl.paper.claims.claim import Effort, Evidence, worst_of

# D is a difference of terms of the size of g; a hundred roundings of them, relative to their size.
ROUNDING = 1e-12
WHY = "rounding relative to the terms of D, which have the size of g"


def convexity_excess(g: Generator, x: Array, a: Array, b: Array, lam: Array) -> Array:
    """Return D(x, (1-lam) a + lam b) - (1-lam) D(x, a) - lam D(x, b), relative, shape (cases,)."""
    middle = (1 - lam)[:, None] * a + lam[:, None] * b
    Da, Db, Dm = divergence(g, x, a), divergence(g, x, b), divergence(g, x, middle)
    terms = [np.abs(g.value(p)) + np.sum(np.abs(g.gradient(p)) * (1 + np.abs(p) + np.abs(x)), axis=-1) for p in (a, b)]
    return (Dm - (1 - lam) * Da - lam * Db) / (1 + terms[0] + terms[1])


def check_convexity(effort: Effort, g: Generator) -> Evidence:
    """Sample the convexity of D in its second argument at positive points of very different sizes."""
    rng = effort.rng("bregman-convexity")
    x, a, b = 10.0 ** rng.uniform(-3, 1, (3, 20 * effort.cases, 3))
    excess = convexity_excess(g, x, a, b, rng.uniform(0, 1, len(x)))
    return Evidence(len(x), worst_of([0.0, float(np.max(excess))]), ROUNDING, WHY)


def concave_witness(expression: Any, y: Any, at: Any) -> Any:
    """Return the x at which D(x, .), for a generator in one variable, has curvature -g''(at) < 0 at ``at``.

    The curvature of D(x, .) at y is g''(y) + (y - x) g'''(y): affine in x. It is negative for some real x as soon as
    g'''(y) is not zero; so on the whole line only quadratics give a D that is convex in its second argument.
    """
    import sympy as sp

    second, third = sp.diff(expression, y, 2).subs(y, at), sp.diff(expression, y, 3).subs(y, at)
    return sp.simplify(at + 2 * second / third)


def middle_excess(expression: Any, y: Any, x: Any, at: Any, h: Any) -> float:
    """Return D(x, at) less the mean of D(x, at - h) and D(x, at + h), in thirty digits; positive is not convex."""
    import sympy as sp

    slope = sp.diff(expression, y)

    def D(of: Any) -> Any:
        return expression.subs(y, x) - expression.subs(y, of) - (x - of) * slope.subs(y, of)

    return float(sp.N(D(at) - (D(at - h) + D(at + h)) / 2, 30))


def check_only_quadratics(effort: Effort, positive: bool = False) -> Evidence:
    """Check that D(x, .) lies above its chord at the x of the proof, for generators that are not quadratic.

    ``positive``: test the entropy on positive numbers instead, whose D is convex although it is not quadratic: the
    proof's x is outside its domain, and the nearest point inside is no counterexample.
    """
    import sympy as sp

    y = sp.Symbol("y", real=True)
    whole = [y**2 + y**4 / 12, sp.exp(y) + sp.exp(-y), sp.exp(y), sp.log(1 + sp.exp(y)), sp.sqrt(1 + y**2)]
    found, at, h = [], sp.Rational(3, 2), sp.Rational(1, 10)
    for expression in [y * sp.log(y)] if positive else whole:
        x = concave_witness(expression, y, at)
        x = sp.Max(x, sp.Rational(1, 1000)) if positive else x
        found.append(0.0 if middle_excess(expression, y, x, at, h) > 0 else 1.0)
    return Evidence(len(found), worst_of(found), 0.0, "thirty digits")


def check_assumption_6(effort: Effort, value: Callable[[Array], Array] | None = None) -> Evidence:
    """Sample strict convexity, c(e) > c(0) and the gradient of the library's loss, or of another function.

    ``value``: another loss, (..., d) to (...), tested with the gradient of the library's.
    """
    rng, squares = effort.rng("assumption-6"), WeightedSquares(np.array([0.5, 1.0, 3.0]))
    loss = value or squares.value
    a, b = rng.standard_normal((2, effort.cases, 3))
    middle, h = (a + b) / 2, 1e-5
    gap = (loss(a) + loss(b)) / 2 - loss(middle)
    slopes = np.stack([(loss(a + h * e) - loss(a - h * e)) / (2 * h) for e in np.eye(3)], axis=-1)
    not_strict = np.where((gap > 0) & (loss(a) > loss(np.zeros(3))), 0.0, 1.0)
    worst = max(float(np.max(not_strict)), float(np.max(np.abs(slopes - squares.gradient(a)))))
    return Evidence(effort.cases, worst, 1e-8, "central differences of step 1e-5: rounding over the step")
