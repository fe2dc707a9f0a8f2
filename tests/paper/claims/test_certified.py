"""Certified claims as recorded, and what is proved of limits against floating point and other parameters."""

from fractions import Fraction
from itertools import pairwise

import flint
import numpy as np
import pytest

from rhl.horizon import solve
from rhl.model import SignalModel
from rhl.paper.certified import ball
from rhl.paper.certified_samples import bounds, digits
from rhl.paper.claims.certified import CLAIMS, INPUT_12, LIMIT, check_digits, linear_run
from rhl.paper.claims.certified_limits import blended, growth, settling, shrinking_limit, vanishing
from rhl.paper.claims.claim import Effort, judge
from rhl.paper.claims.proximal import shrinking_limit as shrinking_limit_in_fractions
from rhl.paper.claims.theorem_1 import change
from rhl.paper.claims.theorem_1 import vanishing as vanishing_in_float64
from rhl.problems import V1
from tests.evidence import EFFORT, drift


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: claim.id)
def test_as_recorded(claim):
    judgement = judge(claim, EFFORT)
    assert judgement.as_recorded, judgement
    assert drift(judgement, EFFORT) == ""


def test_statements_say_the_numbers_that_are_checked():
    said = {claim.id: claim.statement for claim in CLAIMS}
    assert INPUT_12[:20] in said["certified.linear.input-12"]
    assert LIMIT[:20] in said["certified.lemma-4"]
    assert digits(linear_run().u[12]) > 800


def test_digits_that_are_missing_are_counted():
    assert not check_digits(Effort(), robot_bits=5000).passes


def test_product_is_the_one_in_fractions():
    low, high = shrinking_limit_in_fractions(Fraction(1, 2), 60)
    with flint.ctx.workprec(300):
        limit = shrinking_limit(Fraction(1, 2), 200, 300)
        assert limit > ball(low)
        assert limit < ball(high)
        assert digits(limit) > 55


def test_product_whose_factors_stay_is_not_told_from_zero():
    assert shrinking_limit(Fraction(1), 200, 300).contains(0)
    # Weights that fall so slowly that their sum from there on is above one.
    assert shrinking_limit(Fraction(99, 100), 20, 300).contains(0)


def test_scalar_loop_is_the_one_in_float64():
    run = growth(Fraction(6, 5), Fraction(1, 2), vanishing, 60, 300)
    found = change(np.array([1.2]), np.array([0.5]), vanishing_in_float64, steps=60).x[:, 0]
    np.testing.assert_allclose([float(x.mid()) for x in run.x], found, rtol=1e-9)
    assert run.kept == run.steps


def test_the_factor_by_hand():
    """From x(0) = 1, s(1) = 4; from step 2 on the denominator grows by a share of at most 3/(2 * 4)."""
    factor = growth(Fraction(2), Fraction(1), vanishing, 1, 300).factor
    assert factor.overlaps(ball(Fraction(32, 11)))
    assert not factor.overlaps(ball(Fraction(32, 11) + Fraction(1, 10**9)))


@pytest.mark.parametrize("x0", [Fraction(1, 10**6), Fraction(-1), Fraction(10**6)])
def test_scalar_loop_grows_from_everywhere(x0):
    run = growth(Fraction(11, 10), x0, vanishing, 400, 600)
    assert run.kept == run.steps
    assert run.factor > 1
    assert abs(run.x[400]) > abs(run.x[399])


def test_scalar_loop_that_comes_to_rest_is_not_said_to_grow():
    run = growth(Fraction(11, 10), Fraction(1), settling, 150, 400)
    assert run.kept < run.steps
    assert abs(run.x[-1]) < 0.01


def test_forgetting_loop_is_the_one_in_float64():
    """The library loses the second input gain beside the terminal weight some time, but not at the first steps."""
    run, x, A = blended(12, 600), np.array([1.0, 1.0]), np.diag([1.2, 0.5])
    for k in range(12):
        model = SignalModel(A, np.array([[1.0], [0.5**k]]))
        plan = solve(V1(model, 1.0, 1.0, 1.0, float(x @ x) * 50.0**k, 2), x)
        low, high = bounds(run.plan[k])
        assert low - 1e-6 < np.linalg.norm(plan.u) / np.linalg.norm(x) < high + 1e-6
        x = A @ x + np.array([1.0, 0.0]) * plan.u[0, 0]
        assert abs(float(run.x1[k + 1].mid()) - x[0]) < 1e-6
        assert x[1] == 0.5 ** (k + 1)


def test_forgetting_loop_tends_to_its_limit_from_both_sides():
    run = blended(240, 1500)
    with flint.ctx.workprec(1500):
        off = [x - ball(Fraction(5, 26)) for x in run.x1]
        assert all(a * b < 0 for a, b in pairwise(off[60:]))
        assert run.rest < ball(Fraction(1, 10**15))
        assert abs(off[-1]) < run.rest
    assert bounds(run.later)[1] < 1.25


def test_model_that_does_not_forget_goes_to_zero():
    run = blended(240, 1500, Fraction(1))
    assert abs(run.x1[-1]) < 1e-15
    assert not run.rest < 0.1
