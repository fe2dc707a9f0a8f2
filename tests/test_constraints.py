"""What is known beforehand: entries, shifts, contradictions; estimates against the saddle-point equations."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rhl.constraints import LinearConstraints
from rhl.errors import InputError
from rhl.estimator import ProximalEstimator
from rhl.lifting import DelayLifting
from rhl.losses import LogCosh, WeightedSquares
from rhl.model import SignalModel
from tests import oracle

SEED = 2010_05891
NAN = np.nan
# What is left of M theta - b, of order one, is the rounding of a dozen products.
ROUNDING = 1e-13


def left_over(constraints, model):
    return float(np.max(np.abs(model.theta @ constraints.M.T - constraints.b)))


def draw(rng, n, q, lead=()):
    return SignalModel(rng.standard_normal((*lead, n, n)), rng.standard_normal((*lead, n, q)))


# Which equalities


def test_entries_by_hand():
    known = LinearConstraints.entries([[0.5, NAN], [NAN, 2.0]], [[NAN], [3.0]])
    # theta = [a11, a21, a12, a22, b1, b2], column by column.
    assert np.array_equal(known.M, np.eye(6)[[0, 3, 5]])
    assert np.array_equal(known.b, [0.5, 2.0, 3.0])
    known.check("this", SignalModel([[0.5, 9.0], [8.0, 2.0]], [[7.0], [3.0]]))
    with pytest.raises(InputError, match="this must satisfy the equalities"):
        known.check("this", SignalModel([[0.5, 9.0], [8.0, 2.0]], [[3.0], [7.0]]))


@pytest.mark.parametrize("sizes", [(1, 2, 1, 1), (2, 3, 1, 2), (1, 1, 1, 1), (2, 2, 3, 1)])
def test_shift_is_what_delays_do(sizes):
    """Any signals, lifted: the known rows of x(k+1) = A x(k) + B u(k) hold whatever the plant."""
    p, outputs, q, inputs = sizes
    known, lifting = LinearConstraints.shift(*sizes), DelayLifting(outputs, inputs)
    rng = np.random.default_rng(SEED)
    n, width = p * outputs, q * inputs
    assert known.M.shape == ((n - p) * (n + width), n * (n + width))
    model = known.nearest(draw(rng, n, width))
    x = lifting.lift(rng.standard_normal((outputs + 1, p)), 2)
    after = model.step(x[1], rng.standard_normal(width))
    assert np.array_equal(after[p:], x[0, p:])
    assert np.array_equal(model.A[p:], np.eye(n)[: n - p])
    assert not np.any(model.B[p:])
    # The control: rows that are not known are free.
    assert np.min(np.abs(model.A[:p])) > 0


def test_no_equality_at_all():
    known = LinearConstraints.shift(2, 1, 1, 1)
    assert (known.M.shape, known.b.shape) == ((0, 6), (0,))
    assert np.array_equal(known.null_space, np.eye(6))
    assert not known.null_space.flags.writeable
    model = draw(np.random.default_rng(SEED), 2, 1)
    known.check("it", model)
    assert known.nearest(model) is model
    x, u = np.random.default_rng(0).standard_normal((3, 2)), np.ones((2, 1))
    found = ProximalEstimator(2, constraints=known).minimise(model, x, u).theta
    np.testing.assert_allclose(found, ProximalEstimator(2).minimise(model, x, u).theta, rtol=ROUNDING)


def test_both():
    first, second = LinearConstraints([[1.0, 0.0]], [2.0]), LinearConstraints([[1.0, 1.0]], [5.0])
    both = first & second
    assert np.array_equal(both.M, [[1.0, 0.0], [1.0, 1.0]])
    assert np.array_equal(both.b, [2.0, 5.0])
    assert both.null_space.shape == (2, 0)
    np.testing.assert_allclose(both.nearest(SignalModel([[9.0]], [[9.0]])).theta, [2.0, 3.0], rtol=ROUNDING)


def test_what_is_said_twice_is_accepted():
    once = LinearConstraints([[1.0, 2.0, 0.0, 0.0, 0.0, 1.0]], [0.3])
    twice = once & once & LinearConstraints(3 * once.M, 3 * once.b) & LinearConstraints(np.zeros((1, 6)), [0.0])
    assert twice.null_space.shape == once.null_space.shape == (6, 5)
    model = draw(np.random.default_rng(SEED), 2, 1)
    np.testing.assert_allclose(twice.nearest(model).theta, once.nearest(model).theta, rtol=1e-12, atol=ROUNDING)


@settings(max_examples=40)
@given(st.integers(1, 3), st.integers(1, 2), st.integers(0, 6), st.floats(-6, 6), st.integers(0, 10_000))
def test_nearest_satisfies_and_is_nearest(n, q, rows, exponent, seed):
    """Over ranks and scales; an equality may be hidden in others, may have a zero on its right, may be said twice."""
    rng = np.random.default_rng(seed)
    d = n * (n + q)
    M = rng.integers(-2, 3, (min(rows, d), d)).astype(float)
    known = LinearConstraints(M, M @ (10.0**exponent * rng.standard_normal(d)))
    model = SignalModel.from_theta(10.0**exponent * rng.standard_normal(d), n, q)
    nearest = known.nearest(model)
    known.check("the nearest", nearest)
    # The way there is at right angles to all that is free.
    way = known.null_space.T @ (nearest.theta - model.theta)
    assert np.max(np.abs(way), initial=0) < 1e-12 * np.linalg.norm(model.theta)
    np.testing.assert_allclose(known.null_space.T @ known.null_space, np.eye(known.null_space.shape[1]), atol=ROUNDING)
    assert known.null_space.shape[1] == d - (np.linalg.matrix_rank(M) if len(M) else 0)


def test_an_entry_known_to_be_zero_among_other_equalities():
    """It is zero but for the rounding of the other entries, which is not a violation."""
    rng = np.random.default_rng(SEED)
    for _ in range(20):
        M, b = rng.standard_normal((3, 6)), rng.standard_normal(3)
        M[2], b[2] = np.eye(6)[1], 0.0
        known = LinearConstraints(M, b)
        model = known.nearest(draw(rng, 2, 1))
        known.check("the nearest", model)
        off = model.theta + 1e-6 * np.eye(6)[1]
        with pytest.raises(InputError, match="the nearest must satisfy"):
            known.check("the nearest", SignalModel.from_theta(off, 2, 1))


def test_batches_are_checked_member_by_member():
    known = LinearConstraints.entries([[NAN]], [[2.0]])
    good = SignalModel(np.ones((3, 1, 1)), np.full((3, 1, 1), 2.0))
    known.check("all", good)
    with pytest.raises(InputError, match=r"all must satisfy .* got a violation of 1; start"):
        known.check("all", SignalModel(good.A, np.array([[[2.0]], [[3.0]], [[2.0]]])))
    assert np.array_equal(known.nearest(SignalModel(good.A, 7 * good.B)).B, good.B)


def test_frozen():
    known = LinearConstraints([[1.0, 0.0]], [2.0])
    with pytest.raises(ValueError, match="read-only"):
        known.M[0, 0] = 2.0
    with pytest.raises(AttributeError):
        known.b = np.zeros(1)


# In the estimator


def saddle_point(s, R, C, G, centre, M, b):
    """The minimiser of |s - R theta|_C^2 + |theta - centre|_G^2 on M theta = b with its multipliers, in 80 digits."""
    s, R, C, G, centre, M, b = map(oracle.exact, (s, R, C, G, centre, M, b))
    d, rows = R.shape[1], len(M)
    K = oracle.exact(np.zeros((d + rows, d + rows)))
    K[:d, :d], K[d:, :d], K[:d, d:] = R.T @ C @ R + G, M, M.T
    return oracle.solve(K, np.concatenate([R.T @ C @ s + G @ centre, b]))[:d]


@pytest.mark.parametrize("weights", ["one", "entries", "matrices"])
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_estimate_solves_the_saddle_point_equations(scale, weights):
    rng = np.random.default_rng([SEED, len(weights)])
    n, q, window = 2, 1, 3
    d, m = n * (n + q), window * n
    if weights == "matrices":
        C, G = (np.eye(k) + (lambda r: r @ r.T)(rng.standard_normal((k, k))) for k in (m, d))
        c, g = C, G
    else:
        c, g = (10 ** rng.uniform(-1, 1, k) if weights == "entries" else np.ones(k) for k in (m, d))
        C, G = np.diag(c), np.diag(g)
    M = rng.standard_normal((2, d))
    known = LinearConstraints(M, rng.standard_normal(2))
    centre = known.nearest(draw(rng, n, q))
    x, u = scale * rng.standard_normal((window + 1, n)), scale * rng.standard_normal((window, q))
    s = x[:-1].ravel()
    R = np.concatenate([np.kron(np.concatenate([x[j + 1], u[j]]), np.eye(n)) for j in range(window)])
    exact = saddle_point(s, R, C, G, centre.theta, M, known.b)
    made = ProximalEstimator(window, WeightedSquares(c), WeightedSquares(g), known)
    found = made.minimise(centre, x, u)
    assert oracle.relative_error(found.theta, exact) < 1e-11
    assert left_over(known, found) < ROUNDING * 10
    if scale >= 1:
        # The control: without it the estimate goes elsewhere, and so do the saddle-point equations.
        free = ProximalEstimator(window, WeightedSquares(c), WeightedSquares(g)).minimise(centre, x, u)
        assert left_over(known, free) > 1e-3
        assert oracle.relative_error(free.theta, exact) > 1e-3


@pytest.mark.parametrize("loss", [WeightedSquares(), LogCosh(0.3)], ids=["closed form", "general"])
def test_many_steps_and_mixing_keep_what_is_known(loss):
    rng = np.random.default_rng(SEED)
    M = rng.standard_normal((2, 6))
    known = LinearConstraints(M, rng.standard_normal(2)) & LinearConstraints.entries(
        [[NAN, NAN], [NAN, NAN]], [[0.0], [NAN]]
    )
    made, free = ProximalEstimator(3, loss, constraints=known), ProximalEstimator(3, loss)
    model = known.nearest(draw(rng, 2, 1))
    for _ in range(10):
        x, u = rng.standard_normal((4, 2)), rng.standard_normal((3, 1))
        assert left_over(known, free.minimise(model, x, u)) > 1e-4
        model = made.minimise(model, x, u).mix(model, 0.3)
        assert left_over(known, model) < 1e-11


@pytest.mark.parametrize("loss", [WeightedSquares(), LogCosh(0.3)], ids=["closed form", "general"])
def test_nothing_is_estimated_where_everything_is_known(loss):
    model = SignalModel([[1.0, 2.0], [3.0, 4.0]], [[5.0], [6.0]])
    known = LinearConstraints.entries(model.A, model.B)
    x, u = np.random.default_rng(SEED).standard_normal((4, 2)), np.ones((3, 1))
    assert np.array_equal(ProximalEstimator(3, loss, constraints=known).minimise(model, x, u).theta, model.theta)


def test_batches_agree_with_members():
    rng = np.random.default_rng(SEED)
    known = LinearConstraints.shift(1, 2, 1, 2)
    centre = known.nearest(draw(rng, 2, 2, (2, 3)))
    x, u = rng.standard_normal((2, 3, 5, 2)), rng.standard_normal((2, 3, 4, 2))
    made = ProximalEstimator(4, constraints=known)
    together = made.minimise(centre, x, u).theta
    for index in np.ndindex(2, 3):
        alone = made.minimise(SignalModel(centre.A[index], centre.B[index]), x[index], u[index]).theta
        np.testing.assert_allclose(together[index], alone, rtol=1e-12, atol=ROUNDING)


@pytest.mark.parametrize("known", [LinearConstraints.shift(1, 2, 1, 2), LinearConstraints(np.ones((1, 8)), [1.0])])
def test_one_window_for_a_batch_of_centres(known):
    rng = np.random.default_rng(SEED)
    centre = known.nearest(draw(rng, 2, 2, (3,)))
    x, u, made = rng.standard_normal((5, 2)), rng.standard_normal((4, 2)), ProximalEstimator(4, constraints=known)
    together = made.minimise(centre, x, u).theta
    for i in range(3):
        alone = made.minimise(SignalModel(centre.A[i], centre.B[i]), x, u).theta
        np.testing.assert_allclose(together[i], alone, rtol=1e-12, atol=ROUNDING)


# What is refused


@pytest.mark.parametrize(
    ("build", "sentence"),
    [
        (
            lambda: LinearConstraints([1.0, 2.0], [1.0]),
            r"M and b must have shapes \(rows, .* got \(2,\) and \(1,\); give one",
        ),
        (lambda: LinearConstraints(np.eye(2), [1.0]), r"M and b must have shapes .* got \(2, 2\) and \(1,\)"),
        (lambda: LinearConstraints(np.eye(2), 1.0), r"got \(2, 2\) and \(\)"),
        (lambda: LinearConstraints(np.ones((1, 0)), [1.0]), r"got \(1, 0\) and \(1,\)"),
        (lambda: LinearConstraints([[1.0, NAN]], [1.0]), "M must be finite, got nan"),
        (lambda: LinearConstraints([[1.0, 0.0]], [np.inf]), "b must be finite, got inf"),
        (lambda: LinearConstraints([["a", "b"]], [1.0]), "M must hold real numbers"),
        (
            lambda: LinearConstraints([[1.0, 0.0], [2.0, 0.0]], [1.0, 3.0]),
            r"the equalities must not contradict each other, got row \d, which misses by 0\.\d",
        ),
        (
            lambda: LinearConstraints([[0.0, 0.0]], [1.0]),
            "must not contradict each other, got row 0, .* by 1, given the others; remove one",
        ),
        (
            lambda: LinearConstraints([[0.0, 0.0], [1.0, 0.0]], [1e-300, 1.0]),
            "must not contradict each other, got row 0",
        ),
        (
            lambda: LinearConstraints.entries([[1.0]], [[NAN]]) & LinearConstraints.entries([[2.0]], [[NAN]]),
            "must not contradict each other",
        ),
        (
            lambda: LinearConstraints(np.eye(2), np.ones(2)) & LinearConstraints(np.eye(6), np.ones(6)),
            "both must constrain models of the same size, got 2 and 6 parameters",
        ),
        (
            lambda: LinearConstraints.entries([[1.0, 2.0]], [[1.0]]),
            r"A and B must have shapes .* got \(1, 2\) and \(1, 1\)",
        ),
        (lambda: LinearConstraints.entries([[1.0]], [1.0]), r"got \(1, 1\) and \(1,\)"),
        (lambda: LinearConstraints.entries(np.eye(2), np.ones((2, 0))), r"got \(2, 2\) and \(2, 0\)"),
        (lambda: LinearConstraints.entries([["?"]], [[1.0]]), "A and B must hold numbers, NaN where unknown, got"),
        (lambda: LinearConstraints.entries([[np.inf]], [[1.0]]), "b must be finite, got inf"),
        (lambda: LinearConstraints.shift(0, 1, 1, 1), "p must be an integer of at least 1, got 0"),
        (lambda: LinearConstraints.shift(1, 1.5, 1, 1), "outputs must be an integer of at least 1, got 1.5"),
        (
            lambda: LinearConstraints(np.eye(6), np.ones(6)).nearest(SignalModel([[1.0]], [[1.0]])),
            "the model must have 6 parameters, got 2",
        ),
        (
            lambda: LinearConstraints(np.eye(6), np.ones(6)).check("the plan", SignalModel([[1.0]], [[1.0]])),
            "the constraints must have columns for the 2 parameters of the plan, got 6 columns",
        ),
    ],
)
def test_refused(build, sentence):
    with pytest.raises(InputError, match=sentence):
        build()


def test_rounding_is_no_violation_whatever_the_sign():
    assert 3 * -0.3 != -0.9
    LinearConstraints([[3.0, 0.0]], [-0.9]).check("it", SignalModel([[-0.3]], [[0.0]]))
