"""Lemma 5, the search for lambda, in exact arithmetic."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from functools import partial
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from rhl.controllability import Count, LambdaSearch, candidates, controllability_margin
from rhl.model import SignalModel
from rhl.paper.claims.claim import Claim, Control, Effort, Evidence
from rhl.paper.claims.spoiling import spoiling_pairs

if TYPE_CHECKING:
    import sympy as sp

_claim = partial(Claim, page="notebooks/10-lemma-5.ipynb", test="tests/paper/claims/test_lemma_5.py")

Integers = np.ndarray[tuple[int, ...], np.dtype[np.int64]]
Pair = tuple[Integers, Integers]
Draw = Callable[[np.random.Generator, int, int, int], Iterator[tuple[Pair, Pair]]]

_EXACT = "exact: rational numbers"


def is_controllable(A: Any, B: Any) -> bool:
    """Decide controllability of a pair of integers or fractions exactly, by the rank of [B, AB, ...]."""
    import sympy as sp  # imported here, because loading it takes long

    A, block = sp.Matrix(A), sp.Matrix(B)
    C = block
    for _ in range(A.rows - 1):
        block = A * block
        C = C.row_join(block)
    return bool(C.rank() == A.rows)


def random_pairs(rng: np.random.Generator, n: int, q: int, count: int) -> Iterator[tuple[Pair, Pair]]:
    """Yield integer pairs (A_u, B_u), not controllable, and (A_c, B_c), controllable."""
    made = 0
    while made < count:
        unseen, seen = hidden_modes(rng, n, q), (rng.integers(-3, 4, (n, n)), rng.integers(-3, 4, (n, q)))
        if is_controllable(*unseen) or not is_controllable(*seen):
            continue
        made += 1
        yield unseen, seen


def hidden_modes(rng: np.random.Generator, n: int, q: int) -> Pair:
    """Draw an integer pair with modes that no input reaches, in random integer coordinates of determinant one."""
    return next(_hidden_together(rng, n, q, 1))


def pairs_deaf_together(rng: np.random.Generator, n: int, q: int, count: int) -> Iterator[tuple[Pair, Pair]]:
    """Yield two different integer pairs, neither of them controllable, with the same uncontrollable directions.

    So no mixture of them is controllable, and Lemma 5's conclusion fails.
    """
    made = 0
    while made < count:
        first, second = _hidden_together(rng, n, q, 2)
        if all(np.array_equal(one, other) for one, other in zip(first, second, strict=True)):
            continue
        made += 1
        yield first, second


def _hidden_together(rng: np.random.Generator, n: int, q: int, count: int) -> Iterator[Pair]:
    dead, shears = int(rng.integers(1, n + 1)), []
    for _ in range(n):  # shears keep all entries integer
        i, j = rng.choice(n, 2, replace=False) if n > 1 else (0, 0)
        shears += [(i, j)] if i != j else []
    for _ in range(count):
        A, B = rng.integers(-3, 4, (n, n)), rng.integers(-3, 4, (n, q))
        A[n - dead :, : n - dead] = 0
        B[n - dead :] = 0
        for i, j in shears:
            A[i] += A[j]
            A[:, j] -= A[:, i]
            B[i] += B[j]
        yield A, B


def crossing_pairs(n: int, roots: Sequence[Fraction]) -> tuple[tuple[Any, Any], tuple[Any, Any]]:
    """Build diagonal pairs with the largest possible number of bad lambdas.

    With A(lambda) = diag(alpha_i(lambda)) and B(lambda) = (beta_i(lambda)), all linear in lambda, the determinant of
    the controllability matrix is the product of all beta_i and of all alpha_j - alpha_i: n(n+1)/2 linear factors.
    ``roots`` are where beta_1, ..., beta_n vanish; one of them at 0. The lines alpha_i cross pairwise inside (0, 1), at
    different points. A and B are lists of lists of Fraction.
    """
    # Squares break the symmetry that would let three lines cross in one point.
    start = [Fraction(i * i + i, n * n) for i in range(n)]
    end = [Fraction(n - i, 1) + Fraction(i**3, 7 * n**3) for i in range(n)]
    A_u = [[start[i] if i == j else Fraction(0) for j in range(n)] for i in range(n)]
    A_c = [[end[i] if i == j else Fraction(0) for j in range(n)] for i in range(n)]
    return (A_u, [[-root] for root in roots]), (A_c, [[1 - root] for root in roots])


def polynomial(first: tuple[Any, Any], second: tuple[Any, Any], columns: Sequence[int] | None = None) -> sp.Poly:
    """Return p(lambda) = det(C C'), or the minor of C on some columns, over the mixture, exactly.

    ``first``, ``second``: at lambda = 0 and at lambda = 1.
    ``columns``: n columns of [B, AB, ..., A^(n-1) B]; by default all, with their Gram determinant.
    """
    import sympy as sp
    from sympy.polys.matrices import DomainMatrix

    x = sp.Symbol("lambda")
    A, block = ((1 - x) * sp.Matrix(u) + x * sp.Matrix(c) for u, c in zip(first, second, strict=True))
    n = A.rows
    A, block = (DomainMatrix.from_Matrix(M).convert_to(sp.QQ[x]) for M in (A, block))
    blocks = [block]
    for _ in range(n - 1):
        blocks.append(A * blocks[-1])
    C = blocks[0].hstack(*blocks[1:]) if n > 1 else blocks[0]
    square = C * C.transpose() if columns is None else C.extract(list(range(n)), list(columns))
    # The last coefficient of the characteristic polynomial is (-1)^n det, and needs no division.
    return sp.Poly((-1) ** n * square.charpoly()[-1].as_expr(), x)


def nice_columns(A: Any, B: Any) -> list[int]:
    """Return the independent columns of [B, AB, ...] in a scan from the left.

    If a column A^k b_j is skipped, so are all A^l b_j with l > k; so the kept ones are b_j, ..., A^(mu_j - 1) b_j with
    mu_1 + ... + mu_q = n for a controllable pair.
    """
    import sympy as sp

    A, B = sp.Matrix(A), sp.Matrix(B)
    n, q = B.rows, B.cols
    C, block = B, B
    for _ in range(n - 1):
        block = A * block
        C = C.row_join(block)
    return list(C.rref()[1])[:n] if q else []


def degree_bound(n: int) -> int:
    """Return n(n+1)/2, which bounds the degree of the minor on the nice columns for any number of inputs."""
    return n * (n + 1) // 2


def degree_bound_any_minor(n: int, q: int) -> int:
    """Return the sum of n - floor((i-1)/q) over i = 1..n, which bounds the degree of every n-minor."""
    return sum(n - i // q for i in range(n))


_SIZES = ((1, 1), (2, 1), (2, 2), (3, 1), (3, 2), (4, 1), (4, 2))


def check_lemma(effort: Effort, draw: Draw = random_pairs) -> Evidence:
    """Count integer pairs for which all of 2n^2 + 1 candidates are bad, or more than the degree of p.

    ``draw``: the pairs that are mixed.
    """
    import sympy as sp

    rng, faults, cases = effort.rng("lemma-5"), 0, 0
    for n, q in _SIZES:
        for first, second in draw(rng, n, q, max(1, effort.cases // 50)):
            p = polynomial(first, second)
            grid = [sp.Rational(9 * i, 10 * (2 * n * n + 2)) for i in range(1, 2 * n * n + 2)]
            good = sum(p.eval(x) != 0 for x in grid)
            faults, cases = faults + (good == 0 or p.degree() > 2 * n * n), cases + 1
    return Evidence(cases, float(faults), 0.0, _EXACT)


def check_count(effort: Effort, fewer: int = 0) -> Evidence:
    """Count pairs, including an adversary's, for which n(n+1)/2 - ``fewer`` nonzero candidates are all bad.

    The candidates are the first ones of the library; the adversary knows them. ``fewer``: reduction of their number.
    """
    rng, faults, cases = effort.rng("lemma-5.count"), 0, 0
    for n, q in (*_SIZES, (5, 1)):
        if degree_bound(n) <= fewer:
            continue  # no candidate, no check
        tried = library_grid(n, "sharp")[: degree_bound(n) - fewer]
        drawn = random_pairs(rng, n, q, max(1, effort.cases // 25)) if n < 5 else iter(())
        spoiled = [spoiling_pairs(n, library_grid(n, "sharp")[:-1])] if q == 1 else []
        for first, second in (*drawn, *spoiled):
            minor = polynomial(first, second, nice_columns(*second))
            right = minor.degree() <= degree_bound(n) and minor.eval(0) == 0 and minor.eval(1) != 0
            right = right and any(minor.eval(_sympy(x)) != 0 for x in tried)
            faults, cases = faults + (not right), cases + 1
    return Evidence(cases, float(faults), 0.0, _EXACT)


def library_grid(n: int, count: Count) -> list[Fraction]:
    """Return the library's candidates for order n as exact fractions of their floating-point values."""
    return [Fraction(float(x)) for x in candidates(n, 0.9, count)]


def check_sharp(effort: Effort, more: int = 0) -> Evidence:
    """Check that all of n(n+1)/2 - 1 given candidates can be made bad, for n = 2, ..., 5.

    They are the first ones of the paper's grid, and random ones. ``more``: additional candidates.
    """
    rng, faults, cases = effort.rng("lemma-5.sharp"), 0, 0
    for n in range(2, 6):
        wanted, grid = degree_bound(n) - 1, library_grid(n, "lemma")
        for drawn in range(max(2, effort.cases // 25)):
            at = rng.permutation(len(grid)) if drawn else np.arange(len(grid))
            given = [grid[i] for i in at[: wanted + more]]
            if drawn > 1:
                given = [Fraction(int(i), 997) for i in rng.choice(np.arange(1, 897), wanted + more, replace=False)]
            first, second = spoiling_pairs(n, given[:wanted])
            p = polynomial(first, second, columns=list(range(n)))
            right = is_controllable(*second) and not is_controllable(*first)
            right = right and all(p.eval(_sympy(x)) == 0 for x in given)
            faults, cases = faults + (not right), cases + 1
    return Evidence(cases, float(faults), 0.0, _EXACT)


def _sympy(x: Fraction) -> sp.Rational:
    import sympy as sp

    return sp.Rational(x.numerator, x.denominator)


def check_any_minor(effort: Effort, lower: int = 0) -> Evidence:
    """Find the excess of the degree of any n-minor over its bound, over random pairs and all minors.

    ``lower``: decrease of the bound.
    """
    rng, excess = effort.rng("lemma-5.minors"), []
    for n, q in ((1, 1), (2, 1), (2, 2), (2, 3), (3, 1), (3, 2)):
        for first, second in random_pairs(rng, n, q, max(1, effort.cases // 50)):
            for columns in combinations(range(n * q), n):
                excess.append(polynomial(first, second, columns).degree() - degree_bound_any_minor(n, q) + lower)
    return Evidence(len(excess), float(max(excess)), 0.0, _EXACT)


def check_search(effort: Effort, *, mix: bool = True) -> Evidence:
    """Run the library's search on random pairs that are not controllable, and find the shortfall of the margin.

    ``mix`` False: keep the estimate.
    """
    rng, short = effort.rng("lemma-5.search"), []
    for n, q in _SIZES:
        for first, second in random_pairs(rng, n, q, max(1, effort.cases // 25)):
            unseen, seen = (SignalModel(A.astype(float), B.astype(float)) for A, B in (first, second))
            for rule in ("first", "best"):
                search = LambdaSearch("lifted", rule, 0.9, 1e-9)
                lam = search.choose(unseen, seen, lambda model: model) if mix else np.zeros(())
                short.append(1e-9 - float(controllability_margin(unseen.mix(seen, lam))))
    return Evidence(len(short), max(short), 0.0, "the margin that the search promises")


CLAIMS: tuple[Claim, ...] = (
    _claim(
        "lemma-5",
        "Lemma 5",
        "staycontrollable",
        "Of 2n^2 + 1 mixtures with a controllable pair at least one is controllable.",
        method="exact arithmetic",
        recorded="holds",
        stated=check_lemma,
        control=Control(
            "a second pair with the same uncontrollable directions",
            partial(check_lemma, draw=pairs_deaf_together),
        ),
        proof="notebooks/10-lemma-5.ipynb#proof-lemma-5",
        formal="lemma_5.weights_of_the_paper",
    ),
    _claim(
        "lemma-5.count",
        "Lemma 5",
        "staycontrollable",
        "n(n+1)/2 different nonzero candidates are enough, for any number of inputs.",
        method="exact arithmetic",
        recorded="holds",
        stated=check_count,
        control=Control("one candidate fewer, against an adversary", partial(check_count, fewer=1)),
        proof="notebooks/10-lemma-5.ipynb#proof-count",
        formal="lemma_5.enough_nonzero_weights",
    ),
    _claim(
        "lemma-5.sharp",
        "Lemma 5",
        "staycontrollable",
        "That count is sharp: for any n(n+1)/2 - 1 nonzero candidates chosen beforehand, there are pairs, with the "
        "one mixed in controllable, for which all of them are bad.",
        method="exact arithmetic",
        recorded="holds",
        stated=check_sharp,
        control=Control("one candidate more", partial(check_sharp, more=1)),
        proof="notebooks/10-lemma-5.ipynb#proof-sharp",
    ),
    _claim(
        "lemma-5.minors",
        "Lemma 5",
        "staycontrollable",
        "No n-minor of the controllability matrix has a degree above the sum of n - floor((i-1)/q).",
        method="exact arithmetic",
        recorded="holds",
        stated=check_any_minor,
        control=Control("a bound lower by one", partial(check_any_minor, lower=1)),
        proof="notebooks/10-lemma-5.ipynb#proof-any-minor",
    ),
    _claim(
        "lemma-5.search",
        "Lemma 5",
        "staycontrollable",
        "In floating point the search finds a mixture with the required margin.",
        method="numerical sampling",
        recorded="holds",
        stated=check_search,
        control=Control("no mixing", partial(check_search, mix=False)),
        uses=("lemma-5",),
    ),
)
