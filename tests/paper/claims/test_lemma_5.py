"""Lemma 5 exactly: polynomials by hand, the count of candidates, the crossing lines, and the claims as recorded."""

from fractions import Fraction

import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from rhl.controllability import LambdaSearch, candidates
from rhl.errors import LostControllabilityError
from rhl.model import SignalModel
from rhl.paper.claims import lemma_5, spoiling
from rhl.paper.claims.claim import Effort, judge
from tests.evidence import drift
from tests.sizes import SEEDS

x = sp.Symbol("lambda")


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("claim", lemma_5.CLAIMS, ids=lambda claim: claim.id)
def test_as_recorded(claim, seed):
    judgement = judge(claim, effort := Effort(seed, 10))
    assert judgement.as_recorded, judgement
    assert drift(judgement, effort) == ""


def test_polynomial_by_hand():
    """n = 1: C = B(lambda) = 2 lambda, p = 4 lambda^2."""
    p = lemma_5.polynomial(([[5]], [[0]]), ([[1]], [[2]]))
    assert p == sp.Poly(4 * x**2, x)
    minor = lemma_5.polynomial(([[5]], [[0]]), ([[1]], [[2]]), [0])
    assert minor == sp.Poly(2 * x, x)


def test_polynomial_is_the_gram_determinant_of_the_mixture():
    rng = np.random.default_rng(0)
    first, second = next(lemma_5.random_pairs(rng, 3, 2, 1))
    p = lemma_5.polynomial(first, second)
    for share in (0.0, 0.3, 1.0):
        A, B = ((1 - share) * u + share * c for u, c in zip(first, second, strict=True))
        C = np.hstack([B, A @ B, A @ A @ B])
        assert float(p.eval(share)) == pytest.approx(np.linalg.det(C @ C.T), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(("n", "q"), [(1, 1), (2, 1), (2, 2), (3, 1), (3, 2), (3, 3), (4, 2)])
def test_pairs_are_what_they_are_drawn_as(n, q):
    for first, second in lemma_5.random_pairs(np.random.default_rng(n + q), n, q, 5):
        assert not lemma_5.is_controllable(*first)
        assert lemma_5.is_controllable(*second)


@settings(max_examples=40)
@given(st.integers(1, 3), st.integers(1, 3), st.integers(0, 1000))
def test_nice_columns_are_stairs_that_add_up_to_n(n, q, seed):
    rng = np.random.default_rng(seed)
    A, B = rng.integers(-2, 3, (n, n)), rng.integers(-2, 3, (n, q))
    columns = lemma_5.nice_columns(A, B)
    assert len(columns) == n or not lemma_5.is_controllable(A, B)
    for column in columns:
        assert column < q or column - q in columns  # A^k b_j is kept only if A^(k-1) b_j is


@pytest.mark.parametrize(("n", "q", "known"), [(4, 1, 10), (7, 1, 28), (3, 3, 9), (3, 5, 9)])
def test_bounds(n, q, known):
    assert lemma_5.degree_bound_any_minor(n, q) == known
    assert lemma_5.degree_bound(n) <= known


def test_crossing_lines_put_bad_lambdas_where_they_are_asked_for():
    asked = [Fraction(0), Fraction(1, 7), Fraction(2, 7), Fraction(3, 7)]
    pairs = lemma_5.crossing_pairs(4, asked)
    p = lemma_5.polynomial(*pairs, columns=list(range(4)))
    assert all(p.eval(sp.Rational(root.numerator, root.denominator)) == 0 for root in asked)
    assert p.degree() == 10


def test_the_papers_first_candidates_can_all_be_bad():
    """n = 2: two bad lambdas on the first two of nine candidates; the search goes on to the third."""
    grid = candidates(2, 0.9)
    (A_u, B_u), (A_c, B_c) = lemma_5.crossing_pairs(2, [Fraction(0), Fraction(float(grid[0]))])
    shift = Fraction(float(grid[1]))
    # Let the two lines alpha cross on the second candidate.
    A_u[1][1], A_c[1][1] = A_u[0][0] - shift, A_c[0][0] + 1 - shift
    pairs = [SignalModel(np.array(A, dtype=float), np.array(B, dtype=float)) for A, B in ((A_u, B_u), (A_c, B_c))]
    search = LambdaSearch("lifted", "first", 0.9, 1e-9)
    assert float(search.choose(pairs[0], pairs[1], lambda model: model)) == grid[2]


def test_search_without_a_controllable_partner_says_so():
    dead = SignalModel(np.eye(2), np.zeros((2, 1)))
    with pytest.raises(LostControllabilityError, match="no lambda in"):
        LambdaSearch("lifted").choose(dead, dead, lambda model: model)


@settings(max_examples=15)
@given(st.integers(1, 4), st.randoms(use_true_random=False))
def test_any_candidates_can_be_spoiled(n, random):
    """Positive ones, negative ones, beyond one: all but 0 and 1."""
    wanted = lemma_5.degree_bound(n) - 1
    given_ = [Fraction(k, 10) for k in random.sample([k for k in range(-20, 30) if k not in (0, 10)], wanted)]
    first, second = spoiling.spoiling_pairs(n, given_)
    p = lemma_5.polynomial(first, second, columns=list(range(n)))
    roots = {sp.Rational(root.numerator, root.denominator) for root in given_} | {sp.Integer(0)}
    assert {root for root in sp.roots(p)} == roots
    assert p.degree() == lemma_5.degree_bound(n)
    assert lemma_5.is_controllable(*second)


def test_spoiled_mixtures_are_not_controllable_by_rank():
    given_ = [Fraction(1, 5), Fraction(1, 3), Fraction(1, 2), Fraction(3, 5), Fraction(4, 5)]
    first, second = spoiling.spoiling_pairs(3, given_)
    for share in (*given_, Fraction(7, 10)):
        A, b = (
            [[(1 - share) * x + share * y for x, y in zip(*rows, strict=True)] for rows in zip(*of, strict=True)]
            for of in zip(first, second, strict=True)
        )
        assert lemma_5.is_controllable(A, b) == (share not in given_)


@pytest.mark.parametrize("given_", [[Fraction(1, 2)], [Fraction(1, 2)] * 2, [Fraction(1, 2), Fraction(1)]])
def test_candidates_that_cannot_be_spoiled_so(given_):
    with pytest.raises(ValueError, match="2 candidates are required, all different, none of them 0 or 1"):
        spoiling.spoiling_pairs(2, given_)


@pytest.mark.parametrize(("n", "q"), [(1, 1), (2, 1), (3, 2)])
def test_pairs_that_are_deaf_together_differ_and_stay_deaf(n, q):
    for first, second in lemma_5.pairs_deaf_together(np.random.default_rng(n), n, q, 5):
        assert any(not np.array_equal(one, other) for one, other in zip(first, second, strict=True))
        mixed = [one + 2 * other for one, other in zip(first, second, strict=True)]
        assert not any(lemma_5.is_controllable(*pair) for pair in (first, second, mixed))


def test_a_minor_of_another_pair_is_noticed(monkeypatch):
    """The determinant of a mixture with the shares squared: its degree doubles, and the adversary is met elsewhere."""
    polynomial = lemma_5.polynomial

    def squared(first, second, columns=None):
        p = polynomial(first, second, columns)
        return sp.Poly(p.as_expr().subs(x, x**2), x)

    monkeypatch.setattr(lemma_5, "polynomial", squared)
    assert not lemma_5.check_sharp(Effort(0, 10)).passes
    assert not lemma_5.check_count(Effort(0, 10)).passes


def test_an_adversary_that_offers_roots_of_its_own_is_noticed(monkeypatch):
    """Pairs with as many bad lambdas, but at places of their own: they spoil no grid that was chosen beforehand."""

    def elsewhere(n, given_):
        return lemma_5.crossing_pairs(n, [Fraction(0), *(Fraction(1, 20 + i) for i in range(n - 1))])

    monkeypatch.setattr(lemma_5, "spoiling_pairs", elsewhere)
    assert not lemma_5.check_sharp(Effort(0, 10)).passes
    assert lemma_5.check_count(Effort(0, 10), fewer=1).passes  # so the control would not trip
