"""Signal models, their parameter vector and their predictor maps."""

from dataclasses import FrozenInstanceError

import numpy as np
import pytest

from rhl.errors import InputError
from rhl.model import PredictorMaps, SignalModel

SEED = 2010_05891
# Sums of at most a few dozen products of order one.
ROUNDING = 1e-13


@pytest.fixture
def rng():
    return np.random.default_rng(SEED)


@pytest.fixture
def model(rng):
    return SignalModel(rng.standard_normal((3, 3)), rng.standard_normal((3, 2)))


def test_theta_is_column_wise():
    model = SignalModel([[1, 3], [2, 4]], [[5, 7], [6, 8]])
    assert np.array_equal(model.theta, np.arange(1, 9))
    row_wise = np.concatenate([model.A.reshape(-1), model.B.reshape(-1)])
    assert not np.array_equal(model.theta, row_wise)


@pytest.mark.parametrize("lead", [(), (4,), (2, 3)])
@pytest.mark.parametrize(("n", "q"), [(1, 1), (3, 2), (2, 5)])
def test_theta_there_and_back(n, q, lead, rng):
    model = SignalModel(rng.standard_normal((*lead, n, n)), rng.standard_normal((*lead, n, q)))
    back = SignalModel.from_theta(model.theta, n, q)
    assert model.theta.shape == (*lead, n * (n + q))
    assert np.array_equal(back.A, model.A)
    assert np.array_equal(back.B, model.B)


def test_batch_axes_broadcast(rng):
    model = SignalModel(rng.standard_normal((4, 1, 2, 2)), rng.standard_normal((3, 2, 1)))
    assert model.A.shape == (4, 3, 2, 2)
    assert model.B.shape == (4, 3, 2, 1)
    assert model.theta.shape == (4, 3, 6)


def test_immutable(model):
    source = np.eye(2)
    made = SignalModel(source, np.ones((2, 1)))
    source[0, 0] = 7
    assert made.A[0, 0] == 1
    with pytest.raises(ValueError, match="read-only"):
        model.A[0, 0] = 0
    with pytest.raises(ValueError, match="read-only"):
        model.predictor(2).B[0, 0, 0] = 0
    with pytest.raises(FrozenInstanceError):
        model.A = np.eye(3)


@pytest.mark.parametrize(
    ("inputs", "B"),
    [
        ("last-row-of-ones", [[0, 0], [0, 0], [1, 1]]),
        ("eye-last-row-of-ones", [[1, 0], [0, 1], [1, 1]]),
    ],
)
def test_companion_of_ones(inputs, B):
    model = SignalModel.companion_of_ones(3, 2, inputs)
    assert np.array_equal(model.A, [[0, 1, 0], [0, 0, 1], [1, 1, 1]])
    assert np.array_equal(model.B, B)


def test_step_is_the_first_prediction(model, rng):
    x, u = rng.standard_normal(3), rng.standard_normal(2)
    np.testing.assert_allclose(model.step(x, u), model.A @ x + model.B @ u, rtol=ROUNDING)
    np.testing.assert_allclose(model.predictor(1).predict(x, u[None])[1], model.step(x, u), rtol=ROUNDING)


def test_predictor_is_the_recursion(model, rng):
    x, u = rng.standard_normal(3), rng.standard_normal((6, 2))
    walked = [x]
    for push in u:
        walked.append(model.step(walked[-1], push))
    maps = model.predictor(6)
    assert (maps.n, maps.q, maps.horizon) == (3, 2, 6)
    np.testing.assert_allclose(maps.predict(x, u), walked, rtol=ROUNDING, atol=ROUNDING)
    # The order of the inputs matters.
    assert np.max(np.abs(maps.predict(x, u[::-1])[-1] - walked[-1])) > 0.1


def test_general_maps_are_equation_5(rng):
    A = np.concatenate([np.eye(2)[None], rng.standard_normal((4, 2, 2))])
    B, x, u = rng.standard_normal((4, 2, 3)), rng.standard_normal(2), rng.standard_normal((4, 3))
    by_hand = [A[i] @ x + sum((B[i - 1 - j] @ u[j] for j in range(i)), np.zeros(2)) for i in range(5)]
    np.testing.assert_allclose(PredictorMaps(A, B).predict(x, u), by_hand, rtol=ROUNDING, atol=ROUNDING)


def test_batches_agree_with_members(rng):
    A, B = rng.standard_normal((5, 3, 3)), rng.standard_normal((5, 3, 2))
    x, u = rng.standard_normal((5, 3)), rng.standard_normal((5, 4, 2))
    together = SignalModel(A, B).predictor(4).predict(x, u)
    for i in range(5):
        alone = SignalModel(A[i], B[i]).predictor(4).predict(x[i], u[i])
        np.testing.assert_allclose(together[i], alone, rtol=ROUNDING, atol=ROUNDING)


def test_mix(model, rng):
    other = SignalModel(rng.standard_normal((3, 3)), rng.standard_normal((3, 2)))
    assert np.array_equal(model.mix(other, 0).theta, model.theta)
    assert np.array_equal(model.mix(other, 1).theta, other.theta)
    np.testing.assert_allclose(model.mix(other, 0.25).theta, 0.75 * model.theta + 0.25 * other.theta, rtol=ROUNDING)
    assert model.mix(other, np.array([0.0, 0.5, 1.0])).A.shape == (3, 3, 3)


@pytest.mark.parametrize(
    ("build", "sentence"),
    [
        (lambda: SignalModel(np.ones((2, 3)), np.ones((2, 1))), r"A must be square, got shape \(2, 3\)"),
        (lambda: SignalModel(np.eye(2), np.ones((3, 1))), r"B must have shape \(2, at least 1\), got \(3, 1\)"),
        (lambda: SignalModel(np.eye(2), np.ones((2, 0))), r"B must have shape \(2, at least 1\), got \(2, 0\)"),
        (lambda: SignalModel(np.eye(2) * np.nan, np.ones((2, 1))), "A must be finite, got nan"),
        (lambda: SignalModel(np.ones((3, 2, 2)), np.ones((4, 2, 1))), "leading batch axes must broadcast together"),
        (lambda: SignalModel.from_theta(np.ones(5), 2, 1), r"theta must have shape \(6,\), got \(5,\)"),
        (lambda: SignalModel.from_theta(np.ones(6), 0, 1), "n must be an integer of at least 1, got 0"),
        (lambda: SignalModel.companion_of_ones(2, 1, "zeros"), "inputs must be one of last-row-of-ones, eye-last"),
        (lambda: SignalModel(np.eye(2), np.ones((2, 1))).predictor(0), "horizon must be an integer of at least 1"),
        (lambda: SignalModel(1e200 * np.eye(2), np.ones((2, 1))).predictor(2), "A must be finite, got inf"),
        (
            lambda: PredictorMaps(np.ones((1, 2, 2)), np.ones((1, 2, 1))),
            r"A must have shape \(N\+1, n, n\) with N at least",
        ),
        (lambda: PredictorMaps(np.ones((3, 2, 2)), np.ones((2, 2, 1))), r"A\[0\] must be the identity"),
        (
            lambda: PredictorMaps(np.ones((3, 2, 2)), np.ones((3, 2, 1))),
            r"B must have shape \(2, 2, at least 1\), got \(3, 2, 1\)",
        ),
        (
            lambda: SignalModel(np.eye(2), np.ones((2, 1))).predictor(2).predict([1], [[1], [1]]),
            r"x0 must have shape \(2,\)",
        ),
        (
            lambda: SignalModel(np.eye(2), np.ones((2, 1))).predictor(2).predict([1, 1], [[1]]),
            r"u must have shape \(2, 1\)",
        ),
    ],
)
def test_refused(build, sentence):
    with pytest.raises(InputError, match=sentence):
        build()
