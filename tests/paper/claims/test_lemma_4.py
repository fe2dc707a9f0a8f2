"""Lemma 4: the iteration against closed forms and an independent minimiser, the counterexamples, the ledger's lines."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from rhl.losses import divergence
from rhl.paper.claims import convexity, lemma_4_fails
from rhl.paper.claims.claim import Effort, judge
from rhl.paper.claims.convexity import concave_witness, convexity_excess, middle_excess
from rhl.paper.claims.lemma_4 import CLAIMS
from rhl.paper.claims.lemma_4_fails import check_convergence, check_limit_outside, path_growth
from rhl.paper.claims.proximal import (
    SHAPES,
    Cosh,
    Entropy,
    Ridge,
    Run,
    Squares,
    decrease_excess,
    draw_run,
    iterate,
    proximal_step,
    recurrent_run,
    shrinking_limit,
    spiral,
    sum_excess,
    tangential_turns,
    three_point_gap,
    turn_identity,
)
from tests.evidence import drift
from tests.sizes import SEEDS

# A dozen roundings of numbers of size one to ten.
ROUNDING = 1e-12

numbers = st.floats(-100, 100)


@given(numbers, numbers, st.floats(1e-6, 1e6), st.floats(1e-3, 1e3))
def test_square_in_one_dimension_has_its_closed_form(x, b, weight, mu):
    got = proximal_step(Ridge(np.ones(1), b, weight=weight), Squares(mu), np.array([x]))[0]
    np.testing.assert_allclose(got, (mu * x + weight * b) / (mu + weight), rtol=1e-9, atol=1e-9)


@given(numbers, numbers)
def test_hinge_leaves_alone_what_satisfies_it_and_moves_the_rest_towards_it(x, b):
    got = proximal_step(Ridge(np.ones(1), b, "hinge"), Squares(), np.array([x]))[0]
    assert got == x if x <= b else b <= got <= x


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("g", [Squares(0.7), Entropy(), Cosh()])
def test_step_is_what_a_general_minimiser_finds(shape, g):
    f, centre = Ridge(np.array([1.0, -0.5, 0.3]), 0.4, shape, 1.5), np.array([0.9, 0.2, 1.4])
    # The entropy's points stay positive when written as exponentials.
    into = np.exp if isinstance(g, Entropy) else np.asarray
    out = np.log if isinstance(g, Entropy) else np.asarray

    def objective(y):
        return f.value(into(y)) + float(divergence(g, into(y), centre))

    found = minimize(objective, out(centre), method="BFGS", options={"gtol": 1e-9})
    np.testing.assert_allclose(proximal_step(f, g, centre), into(found.x), atol=1e-6)


@pytest.mark.parametrize("g", [Squares(2.0), Entropy(), Cosh()])
def test_inverse_undoes_gradient(g):
    x = np.array([0.2, 1.0, 3.0])
    np.testing.assert_allclose(g.inverse(g.gradient(x)), x, rtol=1e-14)


@pytest.mark.parametrize("shape", SHAPES)
def test_ridge_gradient_is_its_slope(shape):
    f, x, h = Ridge(np.array([1.0, -2.0]), 0.3, shape, 2.0), np.array([1.2, 0.1]), 1e-6
    slopes = [(f.value(x + h * e) - f.value(x - h * e)) / (2 * h) for e in np.eye(2)]
    np.testing.assert_allclose(f.gradient(x), slopes, atol=1e-8)
    assert f.at(0.0) == 0


def test_ridge_without_cancellation_near_its_minimum():
    assert Ridge(np.ones(1), 0.0, "huber").at(1e-10) == pytest.approx(5e-21, rel=1e-12)


def test_start_in_the_common_set_never_moves():
    target = np.array([1.0, 2.0])
    run = iterate([Ridge(a, float(a @ target)) for a in np.eye(2)], Squares(), target, np.array([0.5, 0.0]))
    assert run.length == 0


def test_mixing_takes_its_share_of_the_old_centre():
    run = iterate([Ridge(np.ones(1), 0.0)], Squares(), np.array([3.0]), np.array([0.25]))
    np.testing.assert_allclose(run.minimisers[0], 1.5)
    np.testing.assert_allclose(run.centres[1], 0.75 * 1.5 + 0.25 * 3.0)


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1))
def test_distance_never_grows_and_sums_are_bounded(seed):
    run, targets = draw_run(np.random.default_rng(seed), Squares())
    for target in targets:
        assert all(f.value(target) < ROUNDING for f in run.functions)
        assert decrease_excess(run, target).max() < 1e-10
        assert sum_excess(run, target).max() < 1e-10


def test_decrease_sees_a_mixing_larger_than_allowed():
    run = iterate([Ridge(np.ones(1), 0.0)], Squares(), np.array([3.0]), np.array([0.99]))
    assert decrease_excess(run, np.zeros(1), lambda_max=0.5).max() > 0.1


def test_printed_three_point_formula_is_right_without_mixing():
    run, targets = draw_run(np.random.default_rng(3), Squares())
    plain = iterate(run.functions, run.generator, run.centres[0], np.zeros(len(run.functions)))
    assert three_point_gap(plain, targets[0], printed=True).max() < ROUNDING
    assert three_point_gap(run, targets[0], printed=True).max() > 1e-3


def test_shrinking_limit_is_the_infinite_product():
    low, high = shrinking_limit(Fraction(1, 2), 45)
    product = np.prod([1 / (1 + 2.0 ** (1 - k)) for k in range(200)])
    assert 0 < high - low < Fraction(1, 10**12)
    assert float(low) == pytest.approx(product, rel=1e-11)
    assert float(low) == pytest.approx(0.0699033, rel=1e-5)


def test_shrinking_functions_that_do_not_shrink_leave_no_bound():
    assert shrinking_limit(Fraction(1), 20)[0] == 0


def test_spiral_by_iteration_is_the_spiral_by_formula():
    run = spiral(400)
    norm, angle = tangential_turns(400)
    np.testing.assert_allclose(np.hypot(*run.centres.T), norm, rtol=1e-11)
    np.testing.assert_allclose(np.unwrap(np.arctan2(*run.centres.T[::-1])), angle, atol=1e-10)
    assert turn_identity()


def test_spiral_turns_as_often_as_was_found():
    norm, angle = tangential_turns(1_000_000)
    assert norm[-1] == pytest.approx(0.774, abs=1e-3)
    assert angle[10_000] / (2 * np.pi) == pytest.approx(1.45, abs=0.01)
    assert angle[1_000_000] / (2 * np.pi) == pytest.approx(4.89, abs=0.01)


def test_spiral_has_zero_as_its_only_common_minimiser():
    directions = np.array([f.a for f in spiral(5).functions])
    assert np.linalg.svd(directions, compute_uv=False)[-1] > 0.1


@pytest.mark.parametrize("forgotten", [False, True])
def test_a_function_that_is_forgotten_is_missed(forgotten):
    run, target, family = recurrent_run(np.random.default_rng(0), forgotten)
    left = max(abs(float(f.a @ run.centres[-1]) - f.b) for f in family)
    assert (left > 1e-3) == forgotten
    assert all(abs(float(f.a @ target) - f.b) < ROUNDING for f in family)


def test_kullback_leibler_is_convex_where_cosh_is_not():
    x, a, b = np.full((1, 1), 4.0), np.zeros((1, 1)), np.full((1, 1), 2.0)
    assert convexity_excess(Cosh(), x, a, b, np.array([0.5]))[0] > 0.01
    assert convexity_excess(Entropy(), x, a + 0.1, b, np.array([0.5]))[0] < 0


def test_quadratics_have_no_concave_witness():
    import sympy as sp

    y = sp.Symbol("y", real=True)
    assert not sp.sympify(3 * y**2 + y).diff(y, 3)
    assert concave_witness(sp.exp(y), y, sp.Integer(0)) == 2


def test_run_measures_its_path():
    points = np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 5.0]])
    assert Run([], Squares(), points, points[1:], np.zeros(2)).length == 6


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: claim.id)
def test_claim_comes_out_as_recorded(claim, seed):
    judgement = judge(claim, effort := Effort(seed, 10))
    assert judgement.as_recorded, judgement
    assert drift(judgement, effort) == ""


# ---------------------------------------------------------------- what the checks are seen to reject


def test_paths_that_shrink_and_paths_that_do_not():
    k = np.arange(1, 4097)
    for power, grows in ((0.75, True), (1.25, False), (2.0, False)):
        points = np.cumsum(k**-power)[:, None]
        assert (path_growth(points) > 0) == grows
    assert path_growth(np.ones((100, 2))) == -1
    assert path_growth(0.5 ** k[:200, None]) == -1


def test_a_limit_in_x_is_not_called_outside(monkeypatch):
    """Functions that fade by a tenth only: the limit is another, below 0.069, and the enclosure says so."""
    assert check_limit_outside(Effort(), Fraction(9, 10)).worst > 0.06
    assert shrinking_limit(Fraction(9, 10), 60)[1] < Fraction(1, 1000)
    # An enclosure that is too wide was taken for a failure of the control; it is no evidence.
    monkeypatch.setattr(lemma_4_fails, "shrinking_limit", lambda ratio, steps: (Fraction(0), Fraction(1)))
    assert not check_limit_outside(Effort(), Fraction(1)).conclusive


def test_slow_convergence_is_not_taken_for_none():
    """x^2 / (k + 1) brings the iterate to zero as 2 / k^2: far from rounding after a hundred steps, and yet to X."""
    run, later = lemma_4_fails.returning_runs()[1]
    assert np.linalg.norm(run.centres[100]) > 1e-4
    assert later == np.inf
    assert check_convergence(Effort(), failing=False).passes


def test_a_run_that_is_too_short_to_tell_is_no_evidence(monkeypatch):
    short = iterate(
        [Ridge(np.ones(1), 0.0, weight=1 / (k + 1)) for k in range(50)], Squares(0.5), np.ones(1), np.zeros(50)
    )
    monkeypatch.setattr(lemma_4_fails, "returning_runs", lambda: [(short, np.inf)])
    assert not check_convergence(Effort(), failing=False).conclusive


def test_what_later_steps_take_is_a_bound():
    """The limits of both counterexamples from runs that are much longer."""
    (fading, rest), (turning, later) = lemma_4_fails.failing_runs()
    limit = float(shrinking_limit(Fraction(1, 2), 200)[0])
    assert fading.centres[-1, 0] * (1 - rest) <= limit * (1 + 1e-12)
    end = tangential_turns(1_000_000)[0][-1]
    assert np.linalg.norm(turning.centres[-1]) * (1 - later) < end < np.linalg.norm(turning.centres[-1])


def test_parted_lines_are_never_all_near():
    points = np.random.default_rng(0).uniform(-2, 2, (200, 2))
    lines = lemma_4_fails.parted_run().functions
    assert min(max(abs(float(f.a @ x) - f.b) for f in lines) for x in points) >= 0.5


def test_a_wrong_distance_is_noticed(monkeypatch):
    """D with its arguments exchanged is convex in its second for every g: the witness then finds nothing."""

    def exchanged(expression, y, x, at, h):
        slope = expression.diff(y).subs(y, x)

        def D(of):
            return expression.subs(y, of) - expression.subs(y, x) - (of - x) * slope

        return float((D(at) - (D(at - h) + D(at + h)) / 2).evalf(30))

    assert convexity.check_only_quadratics(Effort()).passes
    monkeypatch.setattr(convexity, "middle_excess", exchanged)
    assert not convexity.check_only_quadratics(Effort()).passes


def test_a_witness_elsewhere_shows_nothing():
    import sympy as sp

    y, at, h = sp.Symbol("y", real=True), sp.Rational(3, 2), sp.Rational(1, 10)
    assert middle_excess(sp.exp(y), y, sp.Integer(4), at, h) > 0
    assert middle_excess(sp.exp(y), y, sp.Integer(1), at, h) < 0
    assert middle_excess(y**2, y, sp.Integer(100), at, h) < 0
