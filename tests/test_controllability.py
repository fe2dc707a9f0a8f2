"""Margins against exact rational arithmetic, and Lemma 5's search on pairs made to defeat it."""

from fractions import Fraction

import numpy as np
import pytest
import sympy
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as st_numpy

from rhl.controllability import (
    ConstantMixing,
    LambdaSearch,
    candidates,
    controllability_margin,
    controllability_matrix,
    s_plus,
)
from rhl.errors import InputError, LostControllabilityError
from rhl.lifting import DelayLifting
from rhl.model import PredictorMaps, SignalModel
from rhl.paper.claims.lemma_5 import crossing_pairs

SEED = 2010_05891
# Entries of the controllability matrices here are integers below 1e3, exact in float64; the singular values
# then carry rounding of the largest, 1e-16 times 1e3.
ROUNDING = 1e-11


def identity(model):
    return model


def whole(low, high):
    return st.integers(low, high).map(float)


@st.composite
def pairs(draw):
    n, q = draw(st.integers(1, 3)), draw(st.integers(1, 2))
    A = draw(st_numpy.arrays(np.float64, (n, n), elements=whole(-2, 2)))
    return A, draw(st_numpy.arrays(np.float64, (n, q), elements=whole(-2, 2)))


@settings(max_examples=60)
@given(pairs())
def test_margin_is_exact(pair):
    A, B = pair
    exact_A, exact_B = (sympy.Matrix(M.astype(int).tolist()) for M in pair)
    C = sympy.Matrix.hstack(*(exact_A**i * exact_B for i in range(len(A))))
    found = controllability_margin(SignalModel(A, B))
    assert np.array_equal(controllability_matrix(SignalModel(A, B)), np.array(C.tolist(), dtype=float))
    if C.rank() < len(A):
        assert found < ROUNDING
    else:
        squares = sympy.Poly((C * C.T).charpoly().as_expr()).sqf_part().nroots(n=40, maxsteps=500)
        assert found == pytest.approx(float(sympy.sqrt(min(sympy.re(root) for root in squares))), abs=ROUNDING)
        assert found > ROUNDING


def test_margins_of_a_batch():
    rng = np.random.default_rng(SEED)
    A, B = rng.standard_normal((4, 5, 3, 3)), rng.standard_normal((4, 5, 3, 2))
    together = controllability_margin(SignalModel(A, B))
    assert together.shape == (4, 5)
    for index in np.ndindex(4, 5):
        assert together[index] == pytest.approx(controllability_margin(SignalModel(A[index], B[index])), abs=ROUNDING)


# Finding of this project: y(k+1) = a y(k) + b v(k) - a b v(k-1) is controllable as a lifted pair only.
LIFTING = DelayLifting(outputs=1, inputs=2)
ONLY_LIFTED = SignalModel([[0.5]], [[2.0, -1.0]])
BOTH = SignalModel([[0.5]], [[2.0, 1.0]])


def test_lifted_pair_does_not_give_the_augmented_pair():
    assert controllability_margin(ONLY_LIFTED) > 1
    assert controllability_margin(LIFTING.augment(ONLY_LIFTED)) < ROUNDING
    assert controllability_margin(LIFTING.augment(BOTH)) > 0.1
    exact = sympy.Matrix([[sympy.Rational(1, 2), -1], [0, 0]])
    b = sympy.Matrix([2, 1])
    assert sympy.Matrix.hstack(b, exact * b).det() == 0


@pytest.mark.parametrize("rule", ["first", "best"])
@pytest.mark.parametrize("pair", ["lifted", "augmented"])
def test_search_keeps_the_pair_it_is_asked_for(pair, rule):
    search = LambdaSearch(pair=pair, rule=rule)
    lam = search.choose(ONLY_LIFTED, BOTH, LIFTING.augment)
    mixed = ONLY_LIFTED.mix(BOTH, lam)
    if pair == "lifted":
        assert lam == 0
        assert controllability_margin(LIFTING.augment(mixed)) < ROUNDING
    else:
        assert 0 < lam < 0.9
        assert controllability_margin(LIFTING.augment(mixed)) >= search.least_margin


@pytest.mark.parametrize("rule", ["first", "best"])
def test_controllable_estimate_is_left_alone(rule):
    assert LambdaSearch(rule=rule).choose(BOTH, ONLY_LIFTED, LIFTING.augment) == 0


def test_rules_differ():
    # The margin is lam, so the first candidate is the smallest and the best the largest.
    lost, good = SignalModel([[0.0]], [[0.0]]), SignalModel([[0.0]], [[1.0]])
    weights = candidates(1, 0.9)
    assert LambdaSearch("lifted", "first").choose(lost, good, identity) == weights[0]
    assert LambdaSearch("lifted", "best").choose(lost, good, identity) == weights[-1]


@pytest.mark.parametrize("n", [1, 2, 7])
def test_candidates(n):
    weights = candidates(n, 0.9)
    assert len(weights) == 2 * n**2 + 1
    assert weights[0] > 0
    assert weights[-1] < 0.9
    np.testing.assert_allclose(np.diff(weights), weights[0], rtol=ROUNDING)


@pytest.mark.parametrize("n", [1, 2, 3, 7])
def test_sharp_count(n):
    weights = candidates(n, 0.9, "sharp")
    assert len(weights) == n * (n + 1) // 2
    assert 0 < weights[0] <= weights[-1] < 0.9
    np.testing.assert_allclose(np.diff(weights), weights[0], rtol=ROUNDING)
    assert len(weights) < len(candidates(n, 0.9))


def adversarial(bad):
    """A diagonal pair of order 2, not controllable at lambda = 0 and at two lambdas more, and nowhere else in (0, 1).

    Its inputs vanish at 0 and at the first, its two modes cross at the second.
    """
    (A_u, B_u), (A_c, B_c) = crossing_pairs(2, [Fraction(0), Fraction(float(bad[0]))])
    cross = Fraction(float(bad[1]))
    A_u[1][1], A_c[1][1] = A_u[0][0] - cross, A_c[0][0] + 1 - cross
    return [SignalModel(np.array(A, dtype=float), np.array(B, dtype=float)) for A, B in ((A_u, B_u), (A_c, B_c))]


@pytest.mark.parametrize("rule", ["first", "best"])
def test_sharp_search_finds_the_one_good_candidate(rule):
    """Two of the three candidates are bad, whichever two; the third is found."""
    weights = candidates(2, 0.9, "sharp")
    for good in range(3):
        estimate, previous = adversarial(np.delete(weights, good))
        assert controllability_margin(estimate) < ROUNDING
        assert controllability_margin(previous) > 1e-3
        margins = controllability_margin(SignalModel(estimate.A[None], estimate.B[None]).mix(previous, weights))
        assert np.count_nonzero(margins < ROUNDING) == 2
        search = LambdaSearch("lifted", rule, count="sharp")
        assert search.choose(estimate, previous, identity) == weights[good]


@pytest.mark.parametrize("rule", ["first", "best"])
def test_one_candidate_fewer_can_all_be_bad(rule, monkeypatch):
    fewer = candidates(2, 0.9, "sharp")[:-1]
    estimate, previous = adversarial(fewer)
    search = LambdaSearch("lifted", rule, count="sharp")
    assert search.choose(estimate, previous, identity) > 0
    monkeypatch.setattr("rhl.controllability.candidates", lambda n, lambda_max, count: fewer)
    with pytest.raises(LostControllabilityError, match=r"no lambda in \(0, 0\.9\)"):
        search.choose(estimate, previous, identity)


@pytest.mark.parametrize("n", [2, 3, 4])
def test_sharp_search_passes_crossing_pairs(n):
    """Of order n, with n(n+1)/2 - 1 bad lambdas inside (0, 1); B vanishes on the first candidates."""
    weights = candidates(n, 0.9, "sharp")
    pairs = crossing_pairs(n, [Fraction(0), *(Fraction(float(weight)) for weight in weights[: n - 1])])
    estimate, previous = (SignalModel(np.array(A, dtype=float), np.array(B, dtype=float)) for A, B in pairs)
    search = LambdaSearch("lifted", "first", count="sharp", least_margin=1e-12)
    lam = search.choose(estimate, previous, identity)
    assert lam >= weights[n - 1]
    assert controllability_margin(estimate.mix(previous, lam)) >= 1e-12


def test_counts_differ_in_what_is_tried():
    """The margin is lam: best is the last candidate, which lies nearer to lambda_max the more there are."""
    lost, good = SignalModel([[0.0]], [[0.0]]), SignalModel([[0.0]], [[1.0]])
    assert LambdaSearch("lifted", count="sharp").choose(lost, good, identity) == 0.45
    assert LambdaSearch("lifted", count="lemma").choose(lost, good, identity) == pytest.approx(0.675)


def test_no_candidate_is_looked_at_where_nothing_is_lost(monkeypatch):
    def never(*_):
        raise AssertionError

    monkeypatch.setattr("rhl.controllability.candidates", never)
    batch = SignalModel(np.zeros((2, 3, 1, 1)), np.ones((2, 3, 1, 1)))
    assert np.array_equal(LambdaSearch("lifted").choose(batch, batch, identity), np.zeros((2, 3)))
    with pytest.raises(AssertionError):
        LambdaSearch("lifted").choose(SignalModel([[0.0]], [[0.0]]), SignalModel([[0.0]], [[1.0]]), identity)


def chain(links):
    """A chain of integrators, controllable from its first link exactly if no link is zero."""
    return SignalModel(np.diag(links, k=-1), np.eye(len(links) + 1, 1))


@pytest.mark.parametrize("count", [1, 3, 5])
def test_roots_on_the_first_candidates(count):
    """The mixture is lost at lambda = 0 and on the first candidates, and nowhere else; the search passes over them."""
    weights = candidates(count + 2, 0.9)
    # Mixed by lambda, the links are 1 - lambda / root and, for the last, lambda.
    estimate = chain([*np.ones(count), 0.0])
    previous = chain([*(1 - 1 / weights[:count]), 1.0])
    margins = controllability_margin(SignalModel(estimate.A[None], estimate.B[None]).mix(previous, weights))
    assert np.max(margins[:count]) < ROUNDING
    assert controllability_margin(estimate) == 0
    least = margins[count]
    assert least > 1e-6
    first = LambdaSearch("lifted", "first", least_margin=least).choose(estimate, previous, identity)
    assert first == weights[count]
    best = LambdaSearch("lifted", "best", least_margin=least).choose(estimate, previous, identity)
    assert best == weights[np.argmax(margins)] != first
    with pytest.raises(LostControllabilityError):
        LambdaSearch("lifted", least_margin=2 * np.max(margins)).choose(estimate, previous, identity)


@pytest.mark.parametrize("rule", ["first", "best"])
@pytest.mark.parametrize("pair", ["lifted", "augmented"])
def test_search_that_finds_nothing_says_so(pair, rule):
    zero = SignalModel([[0.0]], [[0.0, 0.0]])
    with pytest.raises(
        LostControllabilityError, match=rf"no lambda in \(0, 0\.9\) keeps the {pair} pair's margin above 1e-09"
    ):
        LambdaSearch(pair, rule).choose(zero, zero, LIFTING.augment)


def test_message_tells_the_largest_margin_found():
    lost, weak = SignalModel([[0.0]], [[0.0]]), SignalModel([[0.0]], [[1e-3]])
    with pytest.raises(LostControllabilityError, match=r"above 0\.5 \(largest found 0\.000675\); widen lambda_max"):
        LambdaSearch("lifted", least_margin=0.5).choose(lost, weak, identity)


def test_one_lost_member_of_a_batch_is_enough_to_fail():
    batch = SignalModel(np.zeros((2, 1, 1)), np.array([[[1.0]], [[0.0]]]))
    with pytest.raises(LostControllabilityError):
        LambdaSearch("lifted").choose(batch, batch, identity)


@pytest.mark.parametrize("rule", ["first", "best"])
def test_batches_agree_with_members(rule):
    rng = np.random.default_rng(SEED)
    A, B = rng.standard_normal((6, 2, 2)), rng.standard_normal((6, 2, 1))
    A[::2, 1, 0] = B[::2, 1] = 0.0
    estimates = SignalModel(A, B)
    previous = SignalModel(rng.standard_normal((6, 2, 2)), rng.standard_normal((6, 2, 1)))
    search = LambdaSearch("lifted", rule)
    together = search.choose(estimates, previous, identity)
    assert np.all(together[::2] > 0)
    assert not np.any(together[1::2])
    for i in range(6):
        alone = search.choose(SignalModel(A[i], B[i]), SignalModel(previous.A[i], previous.B[i]), identity)
        assert together[i] == alone


@pytest.mark.parametrize("pair", ["lifted", "augmented"])
@pytest.mark.parametrize("rule", ["first", "best"])
def test_only_members_that_have_lost_it_are_searched(pair, rule, monkeypatch):
    rng = np.random.default_rng(SEED)
    A, B = rng.standard_normal((2, 3, 2, 2)), rng.standard_normal((2, 3, 2, 2))
    A[1, 1, 1, 0] = B[1, 1, 1] = 0.0
    estimates = SignalModel(A, B)
    previous = SignalModel(rng.standard_normal((2, 3, 2, 2)), rng.standard_normal((2, 3, 2, 2)))
    search, lifting = LambdaSearch(pair, rule), DelayLifting(2, 2)
    alone = {
        at: search.choose(SignalModel(A[at], B[at]), SignalModel(previous.A[at], previous.B[at]), lifting.augment)
        for at in np.ndindex(2, 3)
    }
    examined = []

    def spy(model):
        examined.append(model.A.shape[:-2])
        return controllability_margin(model)

    monkeypatch.setattr("rhl.controllability.controllability_margin", spy)
    together = search.choose(estimates, previous, lifting.augment)
    order = 2 if pair == "lifted" else 3
    # Each estimate once, and the candidates of one member.
    assert examined == [(2, 3), (1, 2 * order**2 + 1)]
    assert all(together[at] == lam for at, lam in alone.items())
    assert np.argwhere(together).tolist() == [[1, 1]]


def test_one_previous_model_for_a_batch():
    lost, good = SignalModel(np.zeros((2, 1, 1)), np.array([[[0.0]], [[1.0]]])), SignalModel([[0.0]], [[1.0]])
    assert np.array_equal(LambdaSearch("lifted", "first").choose(lost, good, identity), [candidates(1, 0.9)[0], 0])
    # One estimate, lost, beside a batch of models before it.
    batch = SignalModel(np.zeros((3, 1, 1)), np.ones((3, 1, 1)))
    found = LambdaSearch("lifted", "first").choose(SignalModel([[0.0]], [[0.0]]), batch, identity)
    assert np.array_equal(found, np.full(3, candidates(1, 0.9)[0]))


def test_constant_mixing():
    batch = SignalModel(np.zeros((4, 1, 1)), np.zeros((4, 1, 1)))
    assert np.array_equal(ConstantMixing(0.5).choose(batch, batch, identity), np.full(4, 0.5))
    assert ConstantMixing().choose(BOTH, BOTH, identity) == 0


@pytest.mark.parametrize(
    ("build", "sentence"),
    [
        (lambda: ConstantMixing(1.0), r"lam must be a number in \[0, 1\), got 1\.0"),
        (lambda: ConstantMixing(-0.1), r"lam must be a number in \[0, 1\), got -0\.1"),
        (lambda: LambdaSearch(pair="both"), "pair must be one of lifted, augmented, got 'both'"),
        (lambda: LambdaSearch(count="few"), "count must be one of lemma, sharp, got 'few'"),
        (lambda: candidates(2, 0.9, "all"), "count must be one of lemma, sharp, got 'all'"),
        (lambda: LambdaSearch(rule="last"), "rule must be one of first, best, got 'last'"),
        (lambda: LambdaSearch(lambda_max=1.0), r"lambda_max must be a number in \[0, 1\), got 1\.0"),
        (lambda: LambdaSearch(lambda_max=0.0), r"lambda_max must be a positive finite number, got 0\.0"),
        (lambda: LambdaSearch(least_margin=0), "least_margin must be a positive finite number, got 0"),
        (lambda: candidates(0, 0.9), "n must be an integer of at least 1, got 0"),
    ],
)
def test_refused(build, sentence):
    with pytest.raises(InputError, match=sentence):
        build()


def test_s_plus_of_a_model_that_reaches_a_plane_only():
    """[B, AB] = [[1, 2], [0, 0]] has the singular values sqrt(5) and 0, of which the second does not count."""
    model = SignalModel([[2.0, 1.0], [0.0, 0.5]], [[1.0], [0.0]])
    assert float(s_plus(model, horizon=2)) == pytest.approx(np.sqrt(5), rel=1e-14)
    assert float(controllability_margin(model)) == 0


@pytest.mark.parametrize("horizon", [1, 2, 5])
def test_s_plus_of_maps_and_of_their_model(horizon):
    rng = np.random.default_rng(horizon)
    model = SignalModel(rng.normal(size=(4, 3, 3)), rng.normal(size=(4, 3, 2)))
    assert np.allclose(s_plus(model.predictor(horizon)), s_plus(model, horizon), rtol=1e-12)


def test_s_plus_of_full_rank_is_the_margin_and_grows_with_the_horizon():
    rng = np.random.default_rng(0)
    model = SignalModel(rng.normal(size=(10, 3, 3)), rng.normal(size=(10, 3, 1)))
    found = [s_plus(model, horizon) for horizon in (3, 4, 6)]
    assert np.allclose(found[0], controllability_margin(model), rtol=1e-9)
    assert np.all(np.diff(found, axis=0) >= -1e-12)


def test_s_plus_where_no_input_acts_and_where_a_power_overflows():
    assert float(s_plus(SignalModel(np.eye(2), np.zeros((2, 1))), 3)) == np.inf
    assert np.isnan(s_plus(SignalModel([[1e200]], [[1e200]]), 3))
    maps = PredictorMaps(np.stack([np.eye(1), np.eye(1)]), np.zeros((1, 1, 1)))
    assert float(s_plus(maps)) == np.inf


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: s_plus(np.eye(2)), "maps must be a PredictorMaps"),
        (lambda: s_plus(SignalModel([[1.0]], [[1.0]])), "horizon must be an integer"),
        (lambda: s_plus(SignalModel([[1.0]], [[1.0]]), 0), "horizon must be an integer"),
    ],
)
def test_s_plus_refuses(call, sentence):
    with pytest.raises(InputError, match=sentence):
        call()


@pytest.mark.parametrize("seed", range(5))
def test_what_the_search_holds_is_a_lower_bound_of_s_plus(seed):
    """The augmented pair that Lemma 5 keeps above a margin has an s+ above it over any longer horizon."""
    rng, lifting = np.random.default_rng(seed), DelayLifting(2, 2)
    previous = SignalModel(rng.normal(size=(2, 2)), rng.normal(size=(2, 2)))
    lost = SignalModel(rng.normal(size=(2, 2)), np.zeros((2, 2)))
    least = 0.5 * float(controllability_margin(lifting.augment(previous)))
    search = LambdaSearch(least_margin=1e-3 * least)
    kept = lifting.augment(lost.mix(previous, search.choose(lost, previous, lifting.augment)))
    for horizon in (3, 6, 12):
        assert float(s_plus(kept, horizon)) >= search.least_margin
