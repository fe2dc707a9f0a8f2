"""Theorem 4: the polynomials that a family of initial models must distinguish, and the proof that its grid does."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np

from rhl.family import ModelFamily
from rhl.paper.claims.claim import Effort, Evidence

SIZES = ((1, 1, 1), (1, 1, 2), (1, 1, 3), (2, 1, 1), (2, 2, 1))
"""Outputs, inputs and m of the claims' plants, which have order p m, so that their augmented pair is controllable."""


def arx_pair(a: Any, b: Any) -> Any:
    """Return the augmented pair's controllability matrix of y(k+1) = sum a_i y(k+1-i) + sum b_i v(k+1-i), in sympy."""
    import sympy as sp

    n = len(a)
    size = 2 * n - 1
    A, B = sp.zeros(size, size), sp.zeros(size, 1)
    A[0, :n] = sp.Matrix([a])
    A[0, n:] = sp.Matrix([b[1:]]) if n > 1 else sp.zeros(1, 0)
    for i in range(1, n):
        A[i, i - 1] = 1
    for i in range(n + 1, size):
        A[i, i - 1] = 1
    B[0, 0] = b[0]
    if n > 1:
        B[n, 0] = 1
    return sp.Matrix.hstack(*[A**i * B for i in range(size)])


def check_resultant(effort: Effort, other: bool = False) -> Evidence:
    """Compare the determinant with the resultant of numerator and denominator, with symbols, for n = 1, 2, 3.

    ``effort`` is not used, since nothing is random. ``other``: use the denominator with the opposite signs.
    """
    import sympy as sp

    s, faults = sp.Symbol("s"), 0
    for n in (1, 2, 3):
        a, b = sp.symbols(f"a1:{n + 1}"), sp.symbols(f"b1:{n + 1}")
        sign = 1 if other else -1
        below = s**n + sign * sum(a[i] * s ** (n - 1 - i) for i in range(n))
        above = sum(b[i] * s ** (n - 1 - i) for i in range(n))
        resultant = sp.expand(sp.resultant(below, above, s)) if n > 1 else b[0]
        determinant = sp.expand(arx_pair(list(a), list(b)).det(method="berkowitz"))
        faults += sp.expand(determinant - resultant) != 0 and sp.expand(determinant + resultant) != 0
    return Evidence(3, float(faults))


def monomials(variables: int, degree: int) -> list[tuple[int, ...]]:
    """Return the exponents of all monomials of total degree at most ``degree``."""
    if variables == 0:
        return [()]
    return [(i, *rest) for i in range(degree + 1) for rest in monomials(variables - 1, degree - i)]


def determined(p: int, q: int, m: int) -> list[tuple[int, ...]]:
    """Return the monomials that the grid for these sizes must distinguish, as exponents of the entries of E.

    M mixes the entries of each row of E, so the total degree in all entries matters.
    """
    n = p * m + q * (m - 1)
    degree = 2 * m - 1 if p == q == 1 else sum(n - i // q for i in range(n))
    return monomials(p * (p * m + q * m), degree)


def check_grid(effort: Effort, drop: bool = False) -> Evidence:
    """Find exactly, modulo a prime, the shortfall of the rank of the grid's monomials from their number.

    ``effort`` is not used, since nothing is random. ``drop``: leave the last point of each grid out.
    """
    prime, short = 2_147_483_629, 0
    for p, q, m in SIZES:
        shifts, wanted = ModelFamily.grid(p, m, q, m).shifts, determined(p, q, m)
        points = shifts.reshape(len(shifts), -1)
        rows = []
        for point in points[: len(points) - drop]:
            exact = [Fraction(value) for value in point]
            values = [entry.numerator * pow(entry.denominator, -1, prime) % prime for entry in exact]
            powers = [[pow(value, i, prime) for i in range(max(map(sum, wanted)) + 1)] for value in values]
            row = []
            for exponents in wanted:
                term = 1
                for i, e in enumerate(exponents):
                    term = term * powers[i][e] % prime
                row.append(term)
            rows.append(row)
        short += len(wanted) - _rank(rows, prime)
    return Evidence(len(SIZES), float(short), 0.0, "a rank modulo a prime is at most the rank")


def _rank(rows: list[list[int]], prime: int) -> int:
    """Return the rank of a matrix of integers modulo a prime below 2^31."""
    M, rank = np.array(rows, dtype=np.int64), 0
    for column in range(M.shape[1]):
        pivots = np.flatnonzero(M[rank:, column])
        if len(pivots) == 0:
            continue
        M[[rank, rank + pivots[0]]] = M[[rank + pivots[0], rank]]
        M[rank] = M[rank] * pow(int(M[rank, column]), -1, prime) % prime
        below = M[rank + 1 :, column].copy()
        M[rank + 1 :] = (M[rank + 1 :] - below[:, None] * M[rank] % prime) % prime
        rank += 1
        if rank == len(M):
            break
    return rank
