"""Equation (15) beyond squares: the general solver beside the closed form, 50 digits, the L1 limit, its certificate."""

import re
import tracemalloc
import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from rhl.constraints import LinearConstraints
from rhl.errors import AssumptionWarning, InputError, NotSolvedError
from rhl.estimator import ProximalEstimator
from rhl.losses import (
    CustomLoss,
    Entropy,
    LogCosh,
    PseudoHuber,
    Varying,
    WeightedSquares,
    _descent,
    _proximal,
    divergence,
)
from rhl.losses._descent import solve
from rhl.losses._proximal import Proximal, quadratic, regression
from rhl.model import SignalModel
from tests import oracle

SEED = 2010_05891
# Both take an orthogonal factorisation of the same rows, so neither squares the data; the largest difference seen is
# 5e-15 of the model, over sixteen orders of magnitude of the data.
LOCKSTEP = 1e-13
# Newton's method in 80 digits beside float64: conditions of these problems are below 1e3; 6e-16 is the most seen.
AGREES = 1e-13
SIZES = [(1, 1, 1), (2, 1, 3), (3, 2, 4), (2, 3, 1)]
SCALES = [1e-160, 1e-50, 1e-8, 1e-4, 1.0, 1e4, 1e8]


def squares(weight=1.0):
    """Weighted squares that the estimator does not know to be squares."""
    g = WeightedSquares(weight)
    return CustomLoss(g.value, g.gradient, g.hessian, -np.inf, True, True, "squares")


def case(rng, n, q, window, scale=1.0, lead=()):
    centre = SignalModel(rng.standard_normal((*lead, n, n)), rng.standard_normal((*lead, n, q)))
    return centre, scale * rng.standard_normal((*lead, window + 1, n)), scale * rng.standard_normal((*lead, window, q))


def apart(found, expected):
    return np.linalg.norm(found - expected) / np.linalg.norm(expected)


def spd(rng, size):
    # Well conditioned: of gradients that are taken apart, rounding is multiplied by the generator's condition.
    root = rng.standard_normal((size, size))
    return np.eye(size) + root @ root.T / size


def some_constraints(rng, n, q):
    rows = max(1, n * (n + q) // 3)
    return LinearConstraints(rng.standard_normal((rows, n * (n + q))), rng.standard_normal(rows))


# In lockstep with the closed form


@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("weights", ["one", "entries", "matrices"])
@pytest.mark.parametrize("scale", SCALES)
def test_general_solver_is_the_closed_form(scale, weights, known):
    worst = 0.0
    for n, q, window in SIZES:
        rng = np.random.default_rng([SEED, n, q, window])
        centre, x, u = case(rng, n, q, window, scale)
        draw = {
            "one": lambda size: 1.5,
            "entries": lambda size: 10 ** rng.uniform(-1, 1, size),  # noqa: B023
            "matrices": lambda size: spd(rng, size),  # noqa: B023
        }[weights]
        c, g = draw(window * n), draw(n * (n + q))
        constraints = some_constraints(rng, n, q) if known else None
        centre = constraints.nearest(centre) if constraints else centre
        closed = ProximalEstimator(window, WeightedSquares(c), WeightedSquares(g), constraints)
        general = ProximalEstimator(window, squares(c), squares(g), constraints)
        expected = closed.minimise(centre, x, u).theta
        worst = max(worst, apart(general.minimise(centre, x, u).theta, expected))
        if scale > 1e-3:
            # The control: the weights, and the constraints, make a difference.
            other = ProximalEstimator(window, WeightedSquares(3 * np.asarray(c)), WeightedSquares(g), constraints)
            assert scale > 1 or apart(other.minimise(centre, x, u).theta, expected) > 1e-4
            if constraints:
                free = ProximalEstimator(window, WeightedSquares(c), WeightedSquares(g))
                assert apart(free.minimise(centre, x, u).theta, expected) > 1e-4
    assert worst < LOCKSTEP


@settings(max_examples=15)
@given(
    st.tuples(st.integers(1, 3), st.integers(1, 2), st.integers(1, 4)),
    st.floats(-8, 8),
    st.integers(0, 3),
    st.integers(0, 10_000),
)
def test_lockstep_on_degenerate_data(sizes, exponent, repeated, seed):
    """Windows with rows repeated or zero, at any scale."""
    rng = np.random.default_rng(seed)
    centre, x, u = case(rng, *sizes, 10.0**exponent)
    x[:repeated], u[:repeated] = x[0], 0.0
    closed = ProximalEstimator(sizes[2]).minimise(centre, x, u).theta
    general = ProximalEstimator(sizes[2], squares(), squares()).minimise(centre, x, u).theta
    assert apart(general, closed) < LOCKSTEP


def test_hessians_by_differences_give_the_same_answer():
    """The differences are wrong in the eighth digit; the answer is as good as the gradient."""
    rng = np.random.default_rng(SEED)
    centre, x, u = case(rng, 2, 1, 3)
    g = WeightedSquares()
    own = CustomLoss(g.value, g.gradient, assumption_6=True, convex_in_second=True)
    found = ProximalEstimator(3, own, own).minimise(centre, x, u).theta
    assert apart(found, ProximalEstimator(3).minimise(centre, x, u).theta) < 1e-12


def test_regression_is_the_papers_kronecker_form():
    rng = np.random.default_rng(SEED)
    x, u = rng.standard_normal((5, 4, 2)), rng.standard_normal((5, 3, 1))
    s, R = regression(x, u)
    assert (s.shape, R.shape) == ((5, 6), (5, 6, 6))
    for i in range(5):
        rows = [np.kron(np.concatenate([x[i, j + 1], u[i, j]]), np.eye(2)) for j in range(3)]
        assert np.array_equal(R[i], np.concatenate(rows))
        assert np.array_equal(s[i], x[i, :3].ravel())


def test_closed_form_solves_the_normal_equations():
    """Exactly: in 80 digits, weighted by matrices, over a subspace."""
    rng = np.random.default_rng(SEED)
    s, R, centre = rng.standard_normal(6), rng.standard_normal((6, 5)), rng.standard_normal(5)
    C, G, free = spd(rng, 6), spd(rng, 5), np.linalg.qr(rng.standard_normal((5, 3)))[0]
    found = quadratic(s, R, C, G, centre, free)
    C, G, R, free, s, centre = map(oracle.exact, (C, G, R, free, s, centre))
    xi = oracle.solve(free.T @ (R.T @ C @ R + G) @ free, free.T @ R.T @ C @ (s - R @ centre))
    assert oracle.relative_error(found, centre + free @ xi) < AGREES
    assert oracle.relative_error(found * (1 + 1e-9), centre + free @ xi) > AGREES


# Against Newton's method in 80 digits

tanh = np.frompyfunc(oracle.mpmath.tanh, 1, 1)
sqrt = np.frompyfunc(oracle.mpmath.sqrt, 1, 1)
log = np.frompyfunc(oracle.mpmath.log, 1, 1)

# Slope and bend of each function, from its definition.
EXACT = {
    WeightedSquares: (lambda x, f: 2 * x, lambda x, f: 2 + 0 * x),
    LogCosh: (lambda x, f: 2 * f.scale * tanh(x / f.scale), lambda x, f: 2 * (1 - tanh(x / f.scale) ** 2)),
    PseudoHuber: (
        lambda x, f: 2 * x / sqrt(1 + (x / f.scale) ** 2),
        lambda x, f: 2 / sqrt(1 + (x / f.scale) ** 2) ** 3,
    ),
    Entropy: (lambda x, f: 1 + log(x), lambda x, f: 1 / x),
}


def newton(c, g, centre, x, u):
    """The zero of the gradient, by damped Newton steps in 80 digits."""
    s, R = map(oracle.exact, regression(x, u))
    centre = oracle.exact(centre.theta)
    (pull, bend), (hold, stiff) = EXACT[type(c)], EXACT[type(g)]

    def F(theta):
        return hold(theta, g) - hold(centre, g) - R.T @ pull(s - R @ theta, c)

    theta = centre
    for _ in range(200):
        H = R.T @ (bend(s - R @ theta, c)[:, None] * R) + np.diag(stiff(theta, g))
        step, share = oracle.solve(H, -F(theta)), oracle.mpmath.mpf(1)
        size = np.sum(F(theta) ** 2)
        if size < oracle.mpmath.mpf(10) ** -60:
            return theta
        while np.any(theta + share * step <= g.lower) or np.sum(F(theta + share * step) ** 2) > size:
            share /= 2
        theta = theta + share * step
    raise AssertionError("the oracle did not converge")


PAIRS = [
    (LogCosh(1.0), WeightedSquares()),
    (PseudoHuber(1.0), WeightedSquares()),
    (LogCosh(0.05), WeightedSquares()),
    (PseudoHuber(0.05), WeightedSquares()),
    (WeightedSquares(), Entropy()),
    (LogCosh(0.2), Entropy()),
    (WeightedSquares(), LogCosh(2.0)),
    (PseudoHuber(1.0), PseudoHuber(2.0)),
]


def estimator(window, c, g, constraints=None):
    if g.convex_in_second:
        return ProximalEstimator(window, c, g, constraints)
    with pytest.warns(AssumptionWarning, match="Lemma 4"):
        return ProximalEstimator(window, c, g, constraints)


def inside(g, centre):
    """A centre in the generator's domain, and where a robust generator still has curvature."""
    of = np.exp if g.lower == 0 else lambda M: M
    return SignalModel(of(centre.A), of(centre.B))


def name(pair):
    return "-".join(type(f).__name__ + str(getattr(f, "scale", "")) for f in pair)


@pytest.mark.parametrize("pair", PAIRS, ids=name)
def test_against_many_digits(pair):
    c, g = pair
    for n, q, window in ((1, 1, 2), (2, 1, 3)):
        centre, x, u = case(np.random.default_rng([SEED, n]), n, q, window)
        centre = inside(g, centre)
        exact, made = newton(c, g, centre, x, u), estimator(window, c, g)
        found = made.minimise(centre, x, u)
        assert oracle.relative_error(found.theta, exact) < AGREES
        assert made.newton_decrement(found, centre, x, u) < 1e-13
        # The control: the squares' answer is another.
        other = ProximalEstimator(window).minimise(centre, x, u).theta
        assert oracle.relative_error(other, exact) > 1e-4


@pytest.mark.parametrize("pair", PAIRS, ids=name)
def test_general_solver_keeps_what_is_known(pair):
    """Optimal on M theta = b: no direction that may be moved in lowers the objective, in first order or by trial."""
    c, g = pair
    rng = np.random.default_rng(SEED)
    centre, x, u = case(rng, 2, 1, 3)
    centre = inside(g, centre)
    M = rng.standard_normal((2, 6))
    constraints = LinearConstraints(M, M @ centre.theta)
    made = estimator(3, c, g, constraints)
    found = made.minimise(centre, x, u)
    assert np.max(np.abs(M @ found.theta - constraints.b)) < 1e-13
    s, R = regression(x, u)
    problem = Proximal(s, R, c, g, centre.theta, [constraints.null_space])
    assert np.max(np.abs(constraints.null_space.T @ problem.gradient(found.theta))) < 1e-12
    assert np.max(np.abs(problem.gradient(found.theta))) > 1e-3
    for direction in constraints.null_space.T:
        for way in (-1e-3, 1e-3):
            assert problem.value(found.theta + way * direction) > problem.value(found.theta)
    assert np.max(np.abs(M @ estimator(3, c, g).minimise(centre, x, u).theta - constraints.b)) > 1e-3


# Far beyond the loss's scale


def least_absolute(s, R, centre, pull):
    """Minimise pull |s - R theta|_1 + |theta - centre|^2 through its dual, a least-squares problem in a box."""
    residual = s - R @ centre
    target = np.linalg.lstsq(R, residual, rcond=None)[0]
    y = lsq_linear(R.T / 2, target, (-pull, pull), tol=1e-14, max_iter=1000).x
    return centre + R.T @ y / 2


@pytest.mark.parametrize("kind", [LogCosh, PseudoHuber])
@pytest.mark.parametrize(("data", "scale"), [(1e6, 1.0), (1.0, 1e-6)])
@pytest.mark.parametrize("seed", range(2))
def test_sharp_valleys(kind, data, scale, seed):
    """Residuals 1e6 times the scale: the smooth loss is 1e-6 from the absolute value, and so is its answer."""
    centre, x, u = case(np.random.default_rng(seed), 2, 1, 2, data)
    made = ProximalEstimator(2, kind(scale, 1 / (2 * scale * data)))  # pulls by 1 / data at most
    s, R = regression(x, u)
    expected = least_absolute(s, R, centre.theta, 1 / data)
    found = made.minimise(centre, x, u)
    assert apart(found.theta, expected) < 1e-4
    assert made.newton_decrement(found, centre, x, u) < 1e-12
    assert apart(centre.theta, expected) > 0.1
    assert apart(ProximalEstimator(2).minimise(centre, x, u).theta, expected) > 1e-3


@pytest.fixture
def softened(monkeypatch):
    """Every t at which the solver looks at c(t e) / t^2."""
    seen, plain = [], _descent._Scaled

    def counted(c, t):
        seen.append(float(t))
        return plain(c, t)

    monkeypatch.setattr(_descent, "_Scaled", counted)
    return seen


def test_softened_losses_lead_into_the_valley(softened):
    centre, x, u = case(np.random.default_rng(SEED), 2, 1, 3, 1e6)
    sharp = ProximalEstimator(3, counted(LogCosh(1.0, 1e-3))[0])
    found = sharp.minimise(centre, x, u)
    assert len(softened) > 10
    assert softened[-1] == 1
    assert softened == sorted(softened)
    assert sharp.newton_decrement(found, centre, x, u) < 1e-12
    softened.clear()
    ProximalEstimator(3, LogCosh(1e6)).minimise(centre, x, u)
    assert not softened


def test_softened_loss_is_the_loss_at_another_scale():
    """c(t e) / t^2 of log cosh with scale s is log cosh with scale s / t."""
    e, soft, wide = np.array([0.3, -5.0, 40.0]), _descent._Scaled(LogCosh(0.5), 0.125), LogCosh(4.0)
    for found, expected in ((soft.value, wide.value), (soft.gradient, wide.gradient), (soft.hessian, wide.hessian)):
        np.testing.assert_allclose(found(e), expected(e), rtol=1e-14)
    assert (soft.lower, soft.assumption_6, soft.convex_in_second) == (-np.inf, True, False)


# The certificate


@pytest.mark.parametrize("share", [1e-12, 1e-6, 1e-2, 1.0, 1e3])
def test_certificate_is_the_distance_where_everything_is_quadratic(share):
    rng = np.random.default_rng(SEED)
    centre, x, u = case(rng, 2, 1, 3)
    G = spd(rng, 6)
    made = ProximalEstimator(3, WeightedSquares(spd(rng, 6)), WeightedSquares(G))
    theta = made.minimise(centre, x, u).theta
    off = theta + share * rng.standard_normal(6)
    true = np.sqrt((off - theta) @ G @ (off - theta) / (off @ G @ off))
    assert made.newton_decrement(SignalModel.from_theta(off, 2, 1), centre, x, u) == pytest.approx(true, rel=1e-3)
    assert made.newton_decrement(SignalModel.from_theta(theta, 2, 1), centre, x, u) < 1e-14


@pytest.mark.parametrize("pair", PAIRS, ids=name)
def test_certificate_of_answers_and_of_others(pair):
    c, g = pair
    centre, x, u = case(np.random.default_rng(SEED), 2, 1, 3)
    centre, made = inside(g, centre), estimator(3, c, g)
    theta = made.minimise(centre, x, u).theta
    assert made.newton_decrement(SignalModel.from_theta(theta, 2, 1), centre, x, u) < 1e-13
    for share in (1e-9, 1e-6, 1e-3):
        off = SignalModel.from_theta(theta * (1 + share), 2, 1)
        assert 0.2 * share < made.newton_decrement(off, centre, x, u) < 5 * share


def test_certificate_is_not_deceived_by_a_kink():
    """On the kink of a sharp loss Newton's step is short, though the pull of the centre outweighs the loss's by far."""
    sharp, R = LogCosh(1e-9, 1e9), np.array([[1.0, 0.0]])
    problem = Proximal(np.array([10.0]), R, sharp, WeightedSquares(), np.zeros(2))
    kink = np.array([10.0, 0.0])
    assert problem.newton(kink)[0] < 1e-7
    assert problem.newton_decrement(kink) > 0.05
    # The loss pulls with 2, the generator with 2 theta.
    np.testing.assert_allclose(solve(problem), [1.0, 0.0], atol=1e-9)


def test_an_answer_that_misses_the_certificate_is_not_given(monkeypatch):
    centre, x, u = case(np.random.default_rng(SEED), 2, 1, 3, 1e3)
    made = ProximalEstimator(3, counted(LogCosh(1.0))[0])
    assert made.newton_decrement(made.minimise(centre, x, u), centre, x, u) < 1e-12
    monkeypatch.setattr(_descent, "_ITERATIONS", 1)
    monkeypatch.setattr(_descent, "_STEPS", 1)
    monkeypatch.setattr(_descent, "_POLISHES", 0)
    monkeypatch.setattr(_descent, "_MOST_HALVINGS", 0)
    with pytest.raises(NotSolvedError, match=r"a relative distance of 1e-07 from its minimiser, got .* a larger scale"):
        made.minimise(centre, x, u)


def test_a_loss_that_is_not_convex_is_not_solved():
    """Its curvature is negative everywhere near, so that no answer can be certified."""
    c = CustomLoss(lambda e: -50 * e @ e, lambda e: -100 * e, lambda e: -100 + 0 * e, assumption_6=True)
    centre, x, u = case(np.random.default_rng(SEED), 1, 1, 2)
    with pytest.raises(NotSolvedError, match="CustomLoss has negative curvature, so it is not convex"):
        ProximalEstimator(2, c).minimise(centre, x, u)


# Row by row, and all at once


def within_rows(rng, n, q):
    """Equalities that act within rows: of three kinds, so that rows differ in how free they are."""
    return [
        None,
        LinearConstraints.shift(1, n, 1, q),
        LinearConstraints.entries(np.where(rng.random((n, n)) < 0.4, 0.3, np.nan), np.full((n, q), np.nan)),
        LinearConstraints(np.kron(rng.standard_normal((1, n + q)), np.eye(n)[:1]), [0.2]),
    ]


ROWS = [
    (WeightedSquares(), WeightedSquares()),
    (WeightedSquares(np.arange(1.0, 10.0)), WeightedSquares(np.arange(1.0, 16.0))),
    (LogCosh(0.3, np.arange(1.0, 10.0)), WeightedSquares()),
    (PseudoHuber(0.3), WeightedSquares(np.arange(1.0, 16.0))),
    (WeightedSquares(), Entropy(np.arange(1.0, 16.0))),
    (LogCosh(0.05), Entropy()),
    (CustomLoss(LogCosh().value, LogCosh().gradient, LogCosh().hessian, assumption_6=True), Entropy()),
]


@pytest.mark.parametrize("kind", range(4))
@pytest.mark.parametrize("pair", ROWS, ids=name)
def test_row_by_row_is_all_at_once(pair, kind, monkeypatch):
    """Newton's steps, certificates and answers; rows are freed from each other by the shape of a hessian alone."""
    c, g = pair
    n, q, window = 3, 2, 3
    rng = np.random.default_rng([SEED, kind])
    known = within_rows(rng, n, q)[kind]
    centre, x, u = case(rng, n, q, window)
    centre = inside(g, centre)
    if known is not None:
        centre = known.nearest(centre)
        if g.lower == 0 and not np.all(centre.theta > 0):
            known = LinearConstraints(known.M, known.M @ inside(g, centre).theta)
            centre = inside(g, centre)
    made = ProximalEstimator(window, c, g, known)
    rows = made._problems(c, centre, x, u)[1][0]
    assert rows.blocks == n
    s, R = regression(x, u)
    whole = Proximal(s, R, c, g, centre.theta, None if known is None else [known.null_space])
    assert whole.blocks == 1
    answer = solve(rows)
    for theta in (centre.theta, answer, answer * (1 + 1e-5)):
        (length, step), (expected, other) = rows.newton(theta), whole.newton(theta)
        assert length == pytest.approx(expected, rel=1e-9, abs=1e-14)
        np.testing.assert_allclose(step, other, rtol=1e-9, atol=1e-13)
        np.testing.assert_allclose(rows.gradient(theta), whole.gradient(theta), rtol=1e-12, atol=1e-12)
        assert rows.value(theta) == pytest.approx(whole.value(theta), rel=1e-12, abs=1e-12)
        with monkeypatch.context() as without:
            without.setattr(_proximal, "_COMPILES", False)
            assert rows.newton(theta)[0] == pytest.approx(expected, rel=1e-9, abs=1e-14)
            np.testing.assert_allclose(rows.newton(theta)[1], other, rtol=1e-9, atol=1e-13)
        assert rows.newton_decrement(theta) == pytest.approx(whole.newton_decrement(theta), rel=1e-6, abs=1e-14)
    assert apart(made.minimise(centre, x, u).theta, solve(whole)) < AGREES
    if known is not None:
        assert np.max(np.abs(known.M @ answer - known.b)) < 1e-12
        # The control: it matters what is known.
        assert kind == 1 or apart(ProximalEstimator(window, c, g).minimise(centre, x, u).theta, answer) > 1e-4


def test_scipy_gives_the_same_answer():
    """The fallback works on the problem as a whole, whatever the blocks."""
    rng = np.random.default_rng(SEED)
    known = LinearConstraints.shift(1, 3, 1, 2)
    centre, x, u = case(rng, 3, 2, 4)
    centre, made = known.nearest(centre), ProximalEstimator(4, LogCosh(0.1), constraints=known)
    problem = made._problems(LogCosh(0.1), centre, x, u)[1][0]
    theta, distance, _ = _descent.by_newton(problem, centre.theta)
    other, also, _ = _descent._by_scipy(problem, centre.theta)
    assert max(distance, also) < 1e-12
    assert apart(theta, other) < 1e-12


@pytest.mark.parametrize(
    ("changes", "blocks"),
    [
        ({}, 2),
        ({"constraints": LinearConstraints.entries([[np.nan, 1.0], [0.0, np.nan]], [[np.nan], [2.0]])}, 2),
        ({"constraints": LinearConstraints([[1.0, 1.0, 0.0, 0.0, 0.0, 0.0]], [0.2])}, 1),
    ],
)
def test_only_equalities_that_couple_rows_are_dense(changes, blocks):
    rng = np.random.default_rng(SEED)
    centre, x, u = case(rng, 2, 1, 3)
    made = ProximalEstimator(3, LogCosh(), **changes)
    centre = made.constraints.nearest(centre) if made.constraints else centre
    problem = made._problems(made.loss, centre, x, u)[1][0]
    assert problem.blocks == blocks
    # A matrix of weights couples rows too: it shows when it is asked for its second derivatives.
    coupled = ProximalEstimator(3, LogCosh(), WeightedSquares(spd(rng, 6)))
    found = coupled.minimise(centre, x, u)
    assert coupled.newton_decrement(found, centre, x, u) < 1e-13


def test_certificates_of_large_models_need_no_large_matrix():
    """3200 parameters, 3200 residuals: a matrix of that many rows and columns takes 82 MB, and minutes to solve."""
    rng = np.random.default_rng(SEED)
    centre, x, u = case(rng, 40, 40, 80)
    for weight in (1.0, rng.uniform(0.5, 2, 3200)):
        made = ProximalEstimator(80, WeightedSquares(weight))
        found = made.minimise(centre, x, u)
        tracemalloc.start()
        assert made.newton_decrement(found, centre, x, u) < 1e-12
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 20e6
        assert made.newton_decrement(centre, centre, x, u) > 0.1


# Where it starts, and how much work it is


def counted(function):
    calls = []
    own = CustomLoss(
        function.value,
        lambda x: calls.append(1) or function.gradient(x),
        function.hessian,
        assumption_6=True,
        convex_in_second=True,
    )
    return own, calls


def test_fewer_steps_from_nearby():
    centre, x, u = case(np.random.default_rng(SEED), 2, 1, 3)
    s, R = regression(x, u)
    c, calls = counted(LogCosh(0.5))
    problem = Proximal(s, R, c, WeightedSquares(), centre.theta)
    answer = solve(problem)
    work = []
    for start in (answer * (1 + 1e-6), answer + 300.0):
        calls.clear()
        found, distance, _ = _descent.by_newton(problem, start)
        assert distance < 1e-12
        assert apart(found, answer) < 1e-11
        work.append(len(calls))
    assert work[0] < work[1] / 2
    assert work[0] > 0


def test_data_that_fit_leave_the_centre_without_a_step():
    c, calls = counted(LogCosh(0.5))
    centre = SignalModel([[0.5, 0.25], [0.0, 0.5]], [[1.0], [0.5]])
    x = np.array([[0.0, 0.0], [1.0, 2.0]])
    u = np.array([[-1.0]])
    x[0] = centre.step(x[1], u[0])
    assert np.array_equal(ProximalEstimator(1, c).minimise(centre, x, u).theta, centre.theta)
    assert len(calls) <= 3  # for the certificate


# Batches, steps, warnings, refusals


@pytest.mark.parametrize("pair", PAIRS[::4], ids=name)
def test_batches_agree_with_members(pair):
    c, g = pair
    centre, x, u = case(np.random.default_rng(SEED), 2, 1, 3, lead=(2, 3))
    centre, made = inside(g, centre), estimator(3, c, g)
    together = made.minimise(centre, x, u)
    certified = made.newton_decrement(together, centre, x, u)
    assert (together.A.shape, certified.shape) == ((2, 3, 2, 2), (2, 3))
    for index in np.ndindex(2, 3):
        alone = made.minimise(SignalModel(centre.A[index], centre.B[index]), x[index], u[index])
        assert np.array_equal(together.theta[index], alone.theta)
    # One centre for a batch of windows.
    shared = SignalModel(centre.A[0, 0], centre.B[0, 0])
    assert np.array_equal(made.minimise(shared, x, u).theta[1, 2], made.minimise(shared, x[1, 2], u[1, 2]).theta)


def test_varying_losses_are_those_of_each_step():
    centre, x, u = case(np.random.default_rng(SEED), 2, 1, 3)
    kinds = [WeightedSquares(), LogCosh(0.1), WeightedSquares(9.0)]
    varying = ProximalEstimator(3, Varying(kinds.__getitem__))
    found = [varying.minimise(centre, x, u, k).theta for k in range(3)]
    for k, c in enumerate(kinds):
        alone = ProximalEstimator(3, c)
        assert np.array_equal(found[k], alone.minimise(centre, x, u).theta)
        model = SignalModel.from_theta(found[k], 2, 1)
        assert (
            varying.newton_decrement(model, centre, x, u, k)
            < 1e-13
            < varying.newton_decrement(model, centre, x, u, (k + 1) % 3)
        )


def unknown(**facts):
    return CustomLoss(lambda x: x @ x, lambda x: 2 * x, **facts, name="mine")


@pytest.mark.parametrize(
    ("arguments", "sentences"),
    [
        ({}, []),
        ({"generator": Entropy()}, []),
        ({"loss": LogCosh()}, []),
        ({"loss": Varying(lambda k: unknown())}, []),
        ({"loss": unknown()}, ["Assumption 6 asks for a loss that is .* minimum at zero: mine is not known to be"]),
        (
            {"loss": unknown(assumption_6=False)},
            ["Assumption 6 asks for a loss that is .* minimum at zero: mine is not$"],
        ),
        (
            {"generator": unknown()},
            [
                "a generator that is continuously differentiable and strictly convex: mine is not known to be",
                "Lemma 4 and Theorem 2 ask for .* that of the generator mine is not known to be, so the estimates",
            ],
        ),
        ({"generator": unknown(assumption_6=True, convex_in_second=True)}, []),
        ({"generator": PseudoHuber()}, ["that of the generator PseudoHuber is not, so the estimates need not"]),
    ],
)
def test_assumptions_are_named_once(arguments, sentences):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        made = ProximalEstimator(1, **arguments)
        assert len(caught) == len(sentences)
        for warning, sentence in zip(caught, sentences, strict=True):
            assert warning.category is AssumptionWarning
            assert re.search(sentence, str(warning.message))
            assert warning.filename == __file__
        centre = SignalModel([[0.5]], [[1.0]])
        made.minimise(centre, np.ones((2, 1)), np.ones((1, 1)))
        assert len(caught) == len(sentences)


@pytest.mark.parametrize("kind", [KeyError, ValueError, np.linalg.LinAlgError, ZeroDivisionError])
@pytest.mark.parametrize("role", ["value", "gradient", "hessian"])
@pytest.mark.parametrize("by_scipy", [False, True])
def test_what_a_users_function_raises_is_no_failure_to_solve(kind, role, by_scipy, monkeypatch):
    """Not even where it is of a kind that scipy and numpy raise for numbers that they cannot use."""
    if by_scipy:
        monkeypatch.setattr(_descent, "_STEPS", 0)
    elif role == "value":
        return  # Newton's method asks for slopes only
    c, count = LogCosh(0.1), []

    def fails(at):
        def function(x):
            count.append(1)
            if len(count) > 3:
                raise kind("mine")
            return getattr(c, at)(x)

        return function

    functions = {at: fails(at) if at == role else getattr(c, at) for at in ("value", "gradient", "hessian")}
    centre, x, u = case(np.random.default_rng(SEED), 2, 1, 3)
    made = ProximalEstimator(3, CustomLoss(**functions, assumption_6=True))
    with pytest.raises(kind, match="mine"):
        made.minimise(centre, x, u)


class Half:
    """A loss that lacks a member."""

    lower, assumption_6, convex_in_second = -np.inf, True, True
    value = gradient = staticmethod(lambda x: x)


@pytest.mark.parametrize(
    ("act", "sentence"),
    [
        (
            lambda c, x, u: ProximalEstimator(3, Entropy()),
            "must take every real residual, got Entropy, .* above 0",
        ),
        (
            lambda c, x, u: ProximalEstimator(3, Varying(lambda k: Entropy())).minimise(c, x, u),
            "loss must take every real residual, got Entropy",
        ),
        (lambda c, x, u: ProximalEstimator(3, Half()), "loss must be a loss or generator .* without hessian"),
        (lambda c, x, u: ProximalEstimator(3, generator=2.0), "generator must be a loss .* got 2.0 without value"),
        (lambda c, x, u: ProximalEstimator(3, generator=Varying(lambda k: 1)), "generator must be .* without value"),
        (
            lambda c, x, u: ProximalEstimator(3, constraints=np.eye(6)),
            "constraints must be a LinearConstraints or None, got array",
        ),
        (
            lambda c, x, u: ProximalEstimator(3, constraints=LinearConstraints(np.eye(6)[:1], [7.0])).minimise(c, x, u),
            r"the centre must satisfy the equalities \(M theta = b\), got a violation of 5\.25",
        ),
        (
            lambda c, x, u: ProximalEstimator(3, constraints=LinearConstraints(np.eye(5), np.ones(5))).minimise(
                c, x, u
            ),
            "the constraints must have columns for the 6 parameters of the centre, got 5 columns",
        ),
        (
            lambda c, x, u: ProximalEstimator(3, generator=Entropy()).minimise(c, x, u),
            r"proximal centre must lie in the domain of Entropy, above 0, got -\d.*; choose an initial",
        ),
        (
            lambda c, x, u: ProximalEstimator(3, LogCosh(1.0, np.ones(5))).minimise(c, x, u),
            r"loss weights must be one number or have shape \(6,\) or \(6, 6\), got \(5,\)",
        ),
        (
            lambda c, x, u: ProximalEstimator(3, generator=WeightedSquares(np.eye(5))).minimise(c, x, u),
            r"generator weights must be .* got \(5, 5\)",
        ),
    ],
)
def test_refused(act, sentence):
    with pytest.raises(InputError, match=sentence):
        act(*case(np.random.default_rng(SEED), 2, 1, 3))


def test_the_objective_is_loss_plus_divergence():
    rng = np.random.default_rng(SEED)
    s, R, centre, theta = rng.normal(size=6), rng.normal(size=(3, 2)), rng.normal(size=4), rng.normal(size=4)
    for c, g in ((LogCosh(0.5), WeightedSquares(2.0)), (PseudoHuber(1.0), LogCosh(2.0))):
        wanted = c.value(s - (R @ theta.reshape(2, 2)).ravel()) + divergence(g, theta, centre)
        assert Proximal(s, R, c, g, centre).value(theta) == pytest.approx(float(wanted), rel=1e-12)


def test_negative_curvature_of_rounding_is_none():
    """A loss that is flat in one direction may return a second derivative of -1e-20 there."""

    class Flat(WeightedSquares):
        def hessian(self, x):
            return np.where(np.arange(x.shape[-1]) == 0, -1e-20, 2.0) * np.ones_like(x)

    problem = Proximal(np.array([0.0, 1.0]), np.eye(2), Flat(), WeightedSquares(), np.zeros(2))
    assert np.all(np.isfinite(problem.newton(np.zeros(2))[1]))
