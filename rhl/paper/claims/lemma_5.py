"""Lemma 5, the search for lambda, in exact arithmetic; and what it gives Theorem 2(iii)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction
from functools import partial
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from rhl.controllability import LambdaSearch, controllability_margin
from rhl.lifting import DelayLifting
from rhl.model import SignalModel
from rhl.paper.claims.claim import Claim, Control, Effort, Evidence

if TYPE_CHECKING:
    import sympy as sp

_claim = partial(Claim, page="notebooks/10-lemma-5.ipynb", test="tests/paper/claims/test_lemma_5.py")

Integers = np.ndarray[tuple[int, ...], np.dtype[np.int64]]
Pair = tuple[Integers, Integers]


def is_controllable(A: Any, B: Any) -> bool:
    """Decide controllability of a pair of integers or fractions exactly, by the rank of [B, AB, ...]."""
    import sympy as sp  # here, because it takes a while to load

    A, block = sp.Matrix(A), sp.Matrix(B)
    C = block
    for _ in range(A.rows - 1):
        block = A * block
        C = C.row_join(block)
    return bool(C.rank() == A.rows)


def random_pairs(
    rng: np.random.Generator, n: int, q: int, count: int, controllable: bool = True
) -> Iterator[tuple[Pair, Pair]]:
    """Yield integer pairs (A_u, B_u), not controllable, and (A_c, B_c), ``controllable`` or not (for the control).

    The uncontrollable modes sit in random integer coordinates of determinant one.
    """
    made = 0
    while made < count:
        unseen, seen = _hidden_modes(rng, n, q), (rng.integers(-3, 4, (n, n)), rng.integers(-3, 4, (n, q)))
        if not controllable:
            seen = unseen  # every mixture is then the same uncontrollable pair
        if is_controllable(*unseen) or is_controllable(*seen) != controllable:
            continue
        made += 1
        yield unseen, seen


def _hidden_modes(rng: np.random.Generator, n: int, q: int) -> Pair:
    dead = int(rng.integers(1, n + 1))
    A, B = rng.integers(-3, 4, (n, n)), rng.integers(-3, 4, (n, q))
    A[n - dead :, : n - dead] = 0
    B[n - dead :] = 0
    for _ in range(n):  # shears keep everything an integer
        i, j = rng.choice(n, 2, replace=False) if n > 1 else (0, 0)
        if i != j:
            A[i] += A[j]
            A[:, j] -= A[:, i]
            B[i] += B[j]
    return A, B


def crossing_pairs(n: int, roots: Sequence[Fraction]) -> tuple[tuple[Any, Any], tuple[Any, Any]]:
    """Build the pairs that show the count to be sharp: diagonal, with every mixture that can fail failing.

    With A(lambda) = diag(alpha_i(lambda)) and B(lambda) = (beta_i(lambda)), all straight lines, the determinant of
    the controllability matrix is the product of all beta_i and of all alpha_j - alpha_i: n(n+1)/2 linear factors.
    ``roots`` are where beta_1, ..., beta_n vanish; one of them at 0. The lines alpha_i cross pairwise inside (0, 1), at
    different places. A and B are lists of lists of Fraction.
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
    ``columns``: n columns of [B, AB, ..., A^(n-1) B]; all and their Gram determinant where omitted.
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
    # The last coefficient of the characteristic polynomial is (-1)^n det, and comes without division.
    return sp.Poly((-1) ** n * square.charpoly()[-1].as_expr(), x)


def nice_columns(A: Any, B: Any) -> list[int]:
    """Return the columns of [B, AB, ...] that a scan from the left finds independent.

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


def check_lemma(effort: Effort, controllable: bool = True) -> Evidence:
    """Count faults of the lemma over integer pairs: degree, p(0), p(1), roots, and one good candidate in 2n^2+1.

    ``controllable``: whether (A_c, B_c) is.
    """
    import sympy as sp

    rng, faults, cases = effort.rng("lemma-5"), 0, 0
    for n, q in _SIZES:
        for first, second in random_pairs(rng, n, q, max(1, effort.cases // 50), controllable):
            p = polynomial(first, second)
            grid = [sp.Rational(9 * i, 10 * (2 * n * n + 2)) for i in range(1, 2 * n * n + 2)]
            right = p.degree() <= 2 * n * n and p.eval(0) == 0 and p.eval(1) > 0
            right = right and p.count_roots(0, 1) <= 2 * n * n
            # The control looks at what the lemma says alone: one good candidate.
            right = (right or not controllable) and any(p.eval(x) != 0 for x in grid)
            faults, cases = faults + (not right), cases + 1
    return Evidence(cases, float(faults), 0.0, "exact: rational numbers")


def check_count(effort: Effort, fewer: int = 0) -> Evidence:
    """Count pairs for which n(n+1)/2 - fewer nonzero candidates are all bad, adversarial pairs among them.

    ``fewer``: give the search that many candidates fewer; the adversary puts its roots on them.
    """
    import sympy as sp

    rng, faults, cases = effort.rng("lemma-5.count"), 0, 0
    for n, q in _SIZES:
        wanted = degree_bound(n) - fewer
        for first, second in random_pairs(rng, n, q, max(1, effort.cases // 25)):
            columns = nice_columns(*second)
            minor = polynomial(first, second, columns)
            right = minor.degree() <= degree_bound(n) and minor.eval(0) == 0 and minor.eval(1) != 0
            right = right and any(minor.eval(sp.Rational(i, 10 * n * n)) != 0 for i in range(1, wanted + 1))
            faults, cases = faults + (not right), cases + 1
    for n in (2, 3, 4):
        pairs = crossing_pairs(n, [Fraction(0), *(Fraction(1, 20 + i) for i in range(n - 1))])
        p = polynomial(*pairs, columns=list(range(n)))
        bad = sorted(root for root in sp.roots(p) if root != 0)
        spare = [sp.Rational(1, 3 + i) for i in range(degree_bound(n))]
        offered = (bad + [x for x in spare if x not in bad])[: degree_bound(n) - fewer]
        faults, cases = faults + all(p.eval(x) == 0 for x in offered), cases + 1
    return Evidence(cases, float(faults), 0.0, "exact: rational numbers")


def check_sharp(effort: Effort, roots: int = 0) -> Evidence:
    """See whether the crossing lines have n(n+1)/2 - 1 different bad lambdas inside (0, 1), for n = 2, ..., 5.

    ``effort`` is not used: nothing is drawn. ``roots``: ask for that many more, which no pair can have.
    """
    import sympy as sp

    missing = []
    for n in range(2, 6):
        pairs = crossing_pairs(n, [Fraction(0), *(Fraction(1, 20 + i) for i in range(n - 1))])
        p = polynomial(*pairs, columns=list(range(n)))
        inside = {root for root in sp.roots(p) if 0 < root < 1}
        good = is_controllable(*pairs[1]) and not is_controllable(*pairs[0])
        missing.append(degree_bound(n) - 1 + roots - len(inside) if good else n * n)
    return Evidence(len(missing), float(max(missing)), 0.0, "exact: rational numbers")


def check_any_minor(effort: Effort, lower: int = 0) -> Evidence:
    """Find by how much the degree of any n-minor exceeds its bound, over random pairs and all minors.

    ``lower``: lower the bound by that much.
    """
    rng, excess = effort.rng("lemma-5.minors"), []
    for n, q in ((1, 1), (2, 1), (2, 2), (2, 3), (3, 1), (3, 2)):
        for first, second in random_pairs(rng, n, q, max(1, effort.cases // 50)):
            for columns in combinations(range(n * q), n):
                excess.append(polynomial(first, second, columns).degree() - degree_bound_any_minor(n, q) + lower)
    return Evidence(len(excess), float(max(excess)), 0.0, "exact: rational numbers")


def check_search(effort: Effort, *, mix: bool = True) -> Evidence:
    """Run the library's search on random pairs that are not controllable, and see by how much it misses the margin.

    ``mix`` False leaves the estimate as it is.
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


def check_lifted_is_enough(effort: Effort, on: str) -> Evidence:
    """Count pairs y+ = a y + b v - a b v(k-1) whose mixture the controller cannot use; all are controllable as lifted.

    ``on`` {"lifted", "augmented"}: which pair the search keeps controllable.
    """
    rng, faults, cases = effort.rng("theorem-2.iii"), 0, 0
    lifting = DelayLifting(1, 2)
    for _ in range(effort.cases):
        a, b = (int(x) for x in rng.integers(1, 5, 2) * rng.choice([-1, 1], 2))
        estimate = SignalModel(np.array([[float(a)]]), np.array([[float(b), float(-a * b)]]))
        previous = SignalModel(np.array([[1.0]]), np.array([[1.0, 1.0]]))
        lam = LambdaSearch(on, "best", 0.9, 1e-9).choose(estimate, previous, lifting.augment)  # type: ignore[arg-type]
        share = Fraction(float(lam))
        A = [[(1 - share) * a + share, (1 - share) * (-a * b) + share], [0, 0]]
        B = [[(1 - share) * b + share], [1]]
        faults, cases = faults + (not is_controllable(A, B)), cases + 1
    return Evidence(cases, float(faults), 0.0, "exact: rational numbers")


def check_affine(effort: Effort, power: int = 1) -> Evidence:
    """Compare the augmentation of a mixture with the mixture of the augmentations, on integers.

    ``power``: mix the entries' powers instead, which is no longer affine.
    """
    rng, gaps = effort.rng("theorem-2.iii.affine"), []
    for _ in range(effort.cases):
        m, q, n = (int(size) for size in rng.integers(1, 4, 3))
        first, second = (
            SignalModel(rng.integers(-3, 4, (n, n)).astype(float), rng.integers(-3, 4, (n, m * q)).astype(float))
            for _ in range(2)
        )
        lifting = DelayLifting(1, m)
        mixed = first.mix(second, 0.25)
        one = lifting.augment(SignalModel(mixed.A**power, mixed.B**power))
        other = lifting.augment(first).mix(lifting.augment(second), 0.25)
        gaps.append(float(max(np.max(np.abs(one.A - other.A)), np.max(np.abs(one.B - other.B)))))
    return Evidence(len(gaps), max(gaps), 0.0, "quarters of small integers are exact")


CLAIMS: tuple[Claim, ...] = (
    _claim(
        "lemma-5",
        "Lemma 5",
        "staycontrollable",
        "Of 2n^2 + 1 mixtures with a controllable pair at least one is controllable.",
        method="exact arithmetic",
        recorded="holds",
        stated=check_lemma,
        control=Control("a pair mixed in that is not controllable", lambda effort: check_lemma(effort, False)),
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
        control=Control("one candidate fewer, against an adversary", lambda effort: check_count(effort, fewer=1)),
        formal="lemma_5.enough_nonzero_weights",
    ),
    _claim(
        "lemma-5.sharp",
        "Lemma 5",
        "staycontrollable",
        "That count is sharp: there are pairs with n(n+1)/2 - 1 different bad lambdas inside (0, 1).",
        method="exact arithmetic",
        recorded="holds",
        stated=check_sharp,
        control=Control("one bad lambda more asked for", lambda effort: check_sharp(effort, roots=1)),
    ),
    _claim(
        "lemma-5.minors",
        "Lemma 5",
        "staycontrollable",
        "No n-minor of the controllability matrix has a degree above the sum of n - floor((i-1)/q).",
        method="exact arithmetic",
        recorded="holds",
        stated=check_any_minor,
        control=Control("a bound lower by one", lambda effort: check_any_minor(effort, lower=1)),
    ),
    _claim(
        "lemma-5.search",
        "Lemma 5",
        "staycontrollable",
        "In floating point the search finds a mixture whose margin reaches what is asked.",
        method="numerical sampling",
        recorded="holds",
        stated=check_search,
        control=Control("no mixing", lambda effort: check_search(effort, mix=False)),
    ),
    _claim(
        "theorem-2.iii",
        "Theorem 2(iii)",
        "xxx",
        "Mixing by Lemma 5 keeps controllable the pair that the controller plans with.",
        method="exact arithmetic",
        recorded="holds-corrected",
        stated=lambda effort: check_lifted_is_enough(effort, "lifted"),
        corrected=lambda effort: check_lifted_is_enough(effort, "augmented"),
        control=Control("the lifted pair searched", lambda effort: check_lifted_is_enough(effort, "lifted")),
        reason="A controllable lifted pair, which counts past inputs as free, may have an uncontrollable augmented "
        "pair, as y+ = a y + b v - a b v(k-1) has; the search has to look at the augmented pair, and may, for "
        "augmentation is affine.",
    ),
    _claim(
        "theorem-2.iii.affine",
        "Theorem 2(iii)",
        "xxx",
        "Augmenting commutes with mixing, so that Lemma 5 applies to the augmented pair as it stands.",
        method="exact arithmetic",
        recorded="holds",
        stated=check_affine,
        control=Control("entries squared before augmenting", lambda effort: check_affine(effort, power=2)),
    ),
)
