"""The proximal step against the paper's vec form, its optimality condition, and another optimiser."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize
from hypothesis import given
from hypothesis import strategies as st

from rhl.errors import InputError
from rhl.estimator import ProximalEstimator
from rhl.losses import WeightedSquares, divergence
from rhl.model import SignalModel

SEED = 2010_05891
# Well conditioned systems of a few dozen unknowns, data of order one.
ROUNDING = 1e-12
# BFGS stops at a gradient of 1e-8 or where differences of the objective are rounding, 1e-16 ** 0.5.
OTHER_OPTIMISER = 1e-6

SIZES = [(1, 1, 1), (2, 1, 3), (3, 2, 5), (2, 3, 1), (4, 4, 8)]


def case(n, q, window, weighted=False, lead=()):
    """An estimator, a centre and data of these sizes."""
    rng = np.random.default_rng([SEED, n, q, window])
    estimator = ProximalEstimator(window)
    if weighted:
        estimator = ProximalEstimator(
            window,
            WeightedSquares(10 ** rng.uniform(-1, 1, window * n)),
            WeightedSquares(10 ** rng.uniform(-1, 1, n * (n + q))),
        )
    centre = SignalModel(rng.standard_normal((*lead, n, n)), rng.standard_normal((*lead, n, q)))
    return estimator, centre, rng.standard_normal((*lead, window + 1, n)), rng.standard_normal((*lead, window, q))


def vec_form(estimator, x, u):
    """s(k), R(k) of equations (16), (17) as in Remark 2, and the weights of c and g, in the order of s and theta."""
    n, q = x.shape[1], u.shape[1]
    s = x[:-1].reshape(-1)
    R = np.concatenate(
        [np.concatenate([np.kron(x[j + 1], np.eye(n)), np.kron(u[j], np.eye(n))], axis=1) for j in range(len(u))]
    )
    loss = np.broadcast_to(estimator.loss.weight, len(u) * n)
    generator = np.broadcast_to(estimator.generator.weight, n * (n + q))
    return s, R, loss, generator


@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize("sizes", SIZES, ids=str)
def test_closed_form_is_the_vec_form(sizes, weighted):
    estimator, centre, x, u = case(*sizes, weighted)
    s, R, loss, generator = vec_form(estimator, x, u)
    # Remark 2: (G + R'WR) (theta - centre) = R'W (s - R centre).
    hessian = np.diag(generator) + R.T @ (loss[:, None] * R)
    expected = centre.theta + np.linalg.solve(hessian, R.T @ (loss * (s - R @ centre.theta)))
    found = estimator.minimise(centre, x, u)
    np.testing.assert_allclose(found.theta, expected, rtol=ROUNDING, atol=ROUNDING)
    if weighted:
        unweighted = ProximalEstimator(estimator.window).minimise(centre, x, u)
        assert np.max(np.abs(unweighted.theta - expected)) > 1e-3


def test_residuals_of_the_vec_form_are_those_of_the_model():
    estimator, centre, x, u = case(3, 2, 5)
    s, R, *_ = vec_form(estimator, x, u)
    one_step = np.stack([x[j] - centre.step(x[j + 1], u[j]) for j in range(5)])
    np.testing.assert_allclose((s - R @ centre.theta).reshape(5, 3), one_step, rtol=ROUNDING, atol=ROUNDING)


def slope(estimator, centre, x, u, theta):
    """The gradient of c(s - R theta) + D(theta, centre), relative to the terms that cancel in it."""
    s, R, loss, generator = vec_form(estimator, x, u)
    pull, hold = R.T @ (loss * (R @ theta - s)), generator * (theta - centre.theta)
    size = np.abs(R).T @ (loss * (np.abs(R) @ np.abs(theta) + np.abs(s))) + np.abs(hold)
    return np.max(np.abs(pull + hold)) / np.max(size)


@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize("sizes", SIZES, ids=str)
def test_optimality(sizes, weighted):
    estimator, centre, x, u = case(*sizes, weighted)
    theta = estimator.minimise(centre, x, u).theta
    assert slope(estimator, centre, x, u, theta) < 1e-15 * 10
    assert slope(estimator, centre, x, u, theta * (1 + 1e-6)) > 1e-9


@pytest.mark.parametrize("weighted", [False, True])
def test_against_another_optimiser(weighted):
    estimator, centre, x, u = case(2, 1, 4, weighted)
    s, R, loss, generator = vec_form(estimator, x, u)
    g, c = WeightedSquares(generator), WeightedSquares(loss)

    def objective(theta):
        return float(c.value(s - R @ theta) + divergence(g, theta, centre.theta))

    found = scipy.optimize.minimize(objective, centre.theta, method="BFGS", options={"gtol": 1e-8})
    theta = estimator.minimise(centre, x, u).theta
    np.testing.assert_allclose(found.x, theta, rtol=OTHER_OPTIMISER, atol=OTHER_OPTIMISER)
    assert objective(theta) <= found.fun * (1 + ROUNDING)


@pytest.mark.parametrize("sizes", SIZES, ids=str)
def test_no_data_no_change(sizes):
    estimator, centre, x, u = case(*sizes)
    assert np.array_equal(estimator.minimise(centre, 0 * x, 0 * u).theta, centre.theta)


@pytest.mark.parametrize("sizes", SIZES, ids=str)
def test_data_that_fit_change_nothing(sizes):
    estimator, centre, x, u = case(*sizes)
    fitting = [x[-1]]
    for push in u[::-1]:
        fitting.insert(0, centre.step(fitting[0], push))
    found = estimator.minimise(centre, np.stack(fitting), u)
    np.testing.assert_allclose(found.theta, centre.theta, rtol=ROUNDING, atol=ROUNDING)


@pytest.mark.parametrize("scale", [1e-150, 1e-8, 1e8, 1e140])
def test_huge_and_tiny_data(scale):
    """Tiny data leave the centre, huge data are fitted; on neither way is anything squared out of range."""
    estimator, centre, x, u = case(3, 2, 3)
    found = estimator.minimise(centre, scale * x, scale * u)
    assert np.all(np.isfinite(found.theta))
    residual = np.max(np.abs(x[:-1] - found.step(x[1:], u)))
    if scale < 1:
        np.testing.assert_allclose(found.theta, centre.theta, rtol=1e-10)
        assert residual > 0.1
    else:
        assert residual < 1e-10


def test_units_of_the_data_do_not_matter_to_the_accuracy():
    """One signal in units 1e9 times smaller, its generator's weights following: the same model in other units."""
    estimator, centre, x, u = case(2, 1, 4)
    scale = np.array([1.0, 1e9])
    full = np.concatenate([scale, [1.0]])
    weighted = replace(
        estimator,
        loss=WeightedSquares(np.tile(scale**-2.0, 4)),
        generator=WeightedSquares((full[None, :] ** 2 / scale[:, None] ** 2).T.ravel()),
    )
    there = SignalModel(centre.A * scale[:, None] / scale, centre.B * scale[:, None])
    found = weighted.minimise(there, x * scale, u)
    plain = estimator.minimise(centre, x, u)
    np.testing.assert_allclose(found.A / scale[:, None] * scale, plain.A, rtol=1e-9)
    np.testing.assert_allclose(found.B / scale[:, None], plain.B, rtol=1e-9)


@given(st.integers(0, 3), st.sampled_from([0.0, 1e-12, 1.0, 1e12]))
def test_repeated_and_vanishing_data(rows, scale):
    """Windows with equal rows, rows of zero, or one signal that never moves are no trouble."""
    estimator, centre, x, u = case(2, 1, 4)
    x, u = x.copy(), u.copy()
    x[:rows], u[:rows] = x[0], u[0]
    x[:, 1] *= scale
    found = estimator.minimise(centre, x, u)
    assert slope(estimator, centre, x, u, found.theta) < 1e-14


def test_a_small_generator_fits_and_a_large_one_holds():
    _, centre, x, u = case(3, 2, 3)
    fit = ProximalEstimator(3, generator=WeightedSquares(1e-12)).minimise(centre, x, u)
    held = ProximalEstimator(3, generator=WeightedSquares(1e12)).minimise(centre, x, u)
    assert np.max(np.abs(x[:-1] - fit.step(x[1:], u))) < 1e-9
    assert np.max(np.abs(held.theta - centre.theta)) < 1e-9


@pytest.mark.parametrize("weighted", [False, True])
def test_batches_agree_with_members(weighted):
    estimator, centre, x, u = case(3, 2, 5, weighted, lead=(2, 4))
    together = estimator.minimise(centre, x, u)
    for index in np.ndindex(2, 4):
        alone = estimator.minimise(SignalModel(centre.A[index], centre.B[index]), x[index], u[index])
        np.testing.assert_allclose(together.theta[index], alone.theta, rtol=ROUNDING, atol=ROUNDING)


@pytest.mark.parametrize(
    ("act", "sentence"),
    [
        (lambda e, c, x, u: ProximalEstimator(0), "window must be an integer of at least 1, got 0"),
        (lambda e, c, x, u: e.minimise(c, x[:-1], u), r"x and u must have shapes \(6, 3\) and \(5, 2\), got \(5, 3\)"),
        (lambda e, c, x, u: e.minimise(c, x, u[:, :1]), r"got \(6, 3\) and \(5, 1\)"),
        (
            lambda e, c, x, u: replace(e, loss=WeightedSquares([1.0, 2.0])).minimise(c, x, u),
            r"loss weights must be one number or have shape \(15,\) or \(15, 15\), got \(2,\)",
        ),
        (
            lambda e, c, x, u: replace(e, generator=WeightedSquares(np.ones(5))).minimise(c, x, u),
            r"generator weights must be one number or have shape \(15,\) or \(15, 15\), got \(5,\)",
        ),
    ],
)
def test_refused(act, sentence):
    with pytest.raises(InputError, match=sentence):
        act(*case(3, 2, 5))
