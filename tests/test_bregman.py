"""The Bregman distance: closed form, gradient, and the inequalities that make it a distance."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as st_numpy

from rhl._checks import InputError
from rhl.bregman import WeightedSquares, divergence

# Three terms of the size of |x|^2 + |y|^2 cancel.
ROUNDING = 1e-14

entries = st.floats(-1e6, 1e6)
vectors = st_numpy.arrays(np.float64, 3, elements=entries)
weights = st_numpy.arrays(np.float64, 3, elements=st.floats(1e-3, 1e3))


class Entropy:
    """The generator sum x log x on positive x, whose distance is not symmetric."""

    def value(self, x):
        return np.sum(x * np.log(x), axis=-1)

    def gradient(self, x):
        return 1 + np.log(x)


@given(weights, vectors, vectors)
def test_distance_of_weighted_squares(weight, x, y):
    expected = np.sum(weight * (x - y) ** 2)
    scale = np.sum(weight * (x**2 + y**2)) + 1
    np.testing.assert_allclose(divergence(WeightedSquares(weight), x, y), expected, atol=ROUNDING * scale)


@given(vectors)
def test_distance_to_itself_is_zero(x):
    assert divergence(WeightedSquares(), x, x) == 0


@pytest.mark.parametrize("g", [WeightedSquares([1.0, 2.0, 0.5]), Entropy()])
def test_distance_is_positive_between_different_points(g):
    x, y = np.array([1.0, 2.0, 3.0]), np.array([2.0, 2.0, 1.0])
    assert divergence(g, x, y) > 0.1
    assert divergence(g, y, x) > 0.1


def test_distance_follows_its_definition_for_other_generators():
    x, y = np.array([1.0, 2.0, 3.0]), np.array([2.0, 2.0, 1.0])
    kullback_leibler = np.sum(x * np.log(x / y) - x + y)
    np.testing.assert_allclose(divergence(Entropy(), x, y), kullback_leibler, rtol=ROUNDING)
    # It is not symmetric, so the order of the arguments is tested too.
    assert abs(divergence(Entropy(), y, x) - kullback_leibler) > 0.1


@pytest.mark.parametrize("weight", [1.0, 2.5, [1.0, 2.0, 0.5]])
def test_gradient_is_the_slope_of_value(weight):
    g, x = WeightedSquares(weight), np.array([1.0, -2.0, 3.0])
    h = 1e-5  # a quadratic's central difference is exact but for rounding, 1e-16 / h
    slopes = [(g.value(x + h * e) - g.value(x - h * e)) / (2 * h) for e in np.eye(3)]
    np.testing.assert_allclose(g.gradient(x), slopes, rtol=1e-9)


def test_batches_agree_with_members():
    rng = np.random.default_rng(2010_05891)
    x, y, g = rng.standard_normal((4, 5, 3)), rng.standard_normal((4, 5, 3)), WeightedSquares([1.0, 2.0, 0.5])
    together = divergence(g, x, y)
    assert together.shape == (4, 5)
    for i, j in np.ndindex(4, 5):
        np.testing.assert_allclose(together[i, j], divergence(g, x[i, j], y[i, j]), rtol=ROUNDING)


def test_weights_are_read_only():
    with pytest.raises(ValueError, match="read-only"):
        WeightedSquares([1.0, 2.0]).weight[0] = 3.0


@pytest.mark.parametrize(
    ("weight", "sentence"),
    [
        (0.0, r"weight must be positive, .* got 0.0"),
        ([1.0, -2.0], r"weight must be positive, .* got -2.0"),
        ([], "weight must be positive, .* got no entry"),
        (np.inf, "weight must be finite, got inf"),
        ("one", "weight must hold real numbers, got 'one'"),
    ],
)
def test_refused(weight, sentence):
    with pytest.raises(InputError, match=sentence):
        WeightedSquares(weight)
