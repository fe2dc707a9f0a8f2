"""Lemma 5's adversary: pairs whose mixtures are not controllable at any of the given candidates."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import sympy as sp


def spoiling_pairs(n: int, candidates: Sequence[Fraction]) -> tuple[tuple[Any, Any], tuple[Any, Any]]:
    r"""Build pairs (A_u, b_u) and (A_c, b_c), the second controllable, for which n(n+1)/2 - 1 given candidates are bad.

    ``candidates``: different from each other, from 0 and from 1. With A(lambda), b(lambda) the mixture of order s, and
    C(lambda) its controllability matrix, a state :math:`x^+ = c x_{old} + \alpha x + \beta u` multiplies det C by

    .. math:: h = c\,\mathrm{adj}(\alpha I - A)\,b + \beta \det(\alpha I - A),

    of degree s + 1 in lambda if c, alpha and beta are linear in lambda. For a steep alpha, c and beta can be chosen
    such that h is any such polynomial, here the one that vanishes at the next s + 1 candidates. A and b are lists of
    lists of Fraction.
    """
    import sympy as sp

    roots = [sp.Rational(of.numerator, of.denominator) for of in candidates]
    if len(set(roots) - {sp.S.Zero, sp.S.One}) != n * (n + 1) // 2 - 1 or len(roots) != n * (n + 1) // 2 - 1:
        raise ValueError(f"{n * (n + 1) // 2 - 1} candidates are required, all different, none of them 0 or 1")
    x = sp.Symbol("lambda")
    A, b = sp.Matrix([[sp.S.Zero]]), sp.Matrix([x])  # order one: bad at 0 only
    for s in range(1, n):
        wanted = sp.Poly(sp.prod([x - root for root in roots[: s + 1]]), x)
        roots = roots[s + 1 :]
        row, gain, slope = _last_state(A, b, wanted, x)
        A = sp.Matrix.vstack(A.row_join(sp.zeros(s, 1)), row.row_join(sp.Matrix([slope])))
        b = sp.Matrix.vstack(b, sp.Matrix([gain]))
    return (_at(A, x, 0), _at(b, x, 0)), (_at(A, x, 1), _at(b, x, 1))


def _last_state(A: sp.Matrix, b: sp.Matrix, wanted: sp.Poly, x: sp.Symbol) -> tuple[sp.Matrix, Any, Any]:
    """Return c, beta and alpha, linear in x, for which h is the wanted polynomial."""
    import sympy as sp

    s, steep = A.rows, 1
    while True:
        alpha = steep * (x - 1)  # near 1, where the pair is controllable
        shifted = alpha * sp.eye(s) - A
        free = [*(shifted.adjugate() * b), shifted.det()]
        free = [sp.Poly(p, x) for p in (*free, *(x * p for p in free))]
        columns = sp.Matrix([[p.coeff_monomial(x**i) for p in free] for i in range(s + 2)])
        if columns.rank() == s + 2:
            break
        steep *= 2
    # The least-squares solution would have long fractions; the pivot solution has short ones.
    pivots = columns.rref()[1]
    some = columns[:, list(pivots)].LUsolve(sp.Matrix([wanted.coeff_monomial(x**i) for i in range(s + 2)]))
    found = [sp.S.Zero] * len(free)
    for i, value in zip(pivots, some, strict=True):
        found[i] = value
    lines = [found[i] + x * found[s + 1 + i] for i in range(s + 1)]
    return sp.Matrix([lines[:s]]), lines[s], alpha


def _at(matrix: sp.Matrix, x: sp.Symbol, value: int) -> list[list[Fraction]]:
    of = matrix.subs(x, value)
    return [[Fraction(int(of[i, j].p), int(of[i, j].q)) for j in range(of.cols)] for i in range(of.rows)]
