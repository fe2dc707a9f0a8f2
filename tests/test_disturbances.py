"""Actuators that saturate, sensors that err: reproducible, with the statistics that they state."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rhl.disturbances import GaussianNoise, Outliers, Saturation, through
from rhl.errors import InputError

SEED = 2010_05891
DRAWS = 40_000
# Five standard deviations of a mean of that many draws: the seed is fixed, so nothing is left to chance.
CHANCE = 5 / DRAWS**0.5


@given(st.lists(st.floats(-1e9, 1e9), min_size=2, max_size=2), st.floats(-10, 0), st.floats(0.1, 10))
def test_saturation_is_the_nearest_point_of_the_box(v, low, high):
    found = Saturation(low, high)(0, np.array(v))
    assert np.array_equal(found, [min(max(entry, low), high) for entry in v])


def test_saturation_of_each_input_by_itself():
    box = Saturation([-1.0, 0.0], 2.0)
    assert np.array_equal(box(3, np.array([[5.0, -5.0], [-5.0, 1.0]])), [[2.0, 0.0], [-1.0, 1.0]])
    inside = np.array([0.5, 0.5])
    assert np.array_equal(box(0, inside), inside)


NOISES = [GaussianNoise(0.5, SEED), Outliers(0.1, 7.0, SEED)]
noisy = pytest.mark.parametrize("sensor", NOISES, ids=lambda sensor: type(sensor).__name__)


@noisy
def test_errors_depend_on_seed_and_step_only(sensor):
    y = np.ones((200, 2))
    other = type(sensor)(**{**vars(sensor), "seed": SEED + 1})
    again = type(sensor)(**vars(sensor))
    assert np.array_equal(sensor(4, y), again(4, y))
    assert np.array_equal(sensor(4, y) - y, sensor(4, y + 1.0) - (y + 1.0)) or np.allclose(
        sensor(4, y) - y, sensor(4, y + 1) - (y + 1), rtol=0, atol=1e-14
    )
    assert not np.array_equal(sensor(4, y), sensor(5, y))
    assert not np.array_equal(sensor(4, y), other(4, y))
    # Steps are independent of the order in which they are asked for.
    late = sensor(9, y)
    sensor(0, y)
    assert np.array_equal(sensor(9, y), late)


def test_no_seed_repeats_another_ones_steps():
    y = np.zeros(3)
    found = {tuple(GaussianNoise(1.0, seed)(k, y)) for seed in range(10) for k in range(10)}
    assert len(found) == 100


def test_statistics_of_gaussian_noise():
    errors = GaussianNoise([0.5, 2.0], SEED)(0, np.full((DRAWS, 2), 3.0)) - 3.0
    np.testing.assert_array_less(np.abs(np.mean(errors, axis=0)), CHANCE * np.array([0.5, 2.0]))
    np.testing.assert_allclose(np.std(errors, axis=0), [0.5, 2.0], rtol=CHANCE)
    assert abs(np.corrcoef(errors.T)[0, 1]) < CHANCE
    steps = np.stack([GaussianNoise(1.0, SEED)(k, np.zeros(1)) for k in range(2000)])[:, 0]
    assert abs(np.corrcoef(steps[:-1], steps[1:])[0, 1]) < 5 / 2000**0.5
    assert np.array_equal(GaussianNoise(0.0, 0)(0, np.ones(2)), np.ones(2))


def test_statistics_of_outliers():
    errors = Outliers(0.1, 7.0, SEED)(0, np.zeros((DRAWS, 1)))[:, 0]
    assert set(np.unique(errors)) == {-7.0, 0.0, 7.0}
    assert abs(np.mean(errors != 0) - 0.1) < CHANCE * 0.3
    assert abs(np.mean(np.sign(errors))) < CHANCE * 0.1**0.5
    assert not np.any(Outliers(0.0, 7.0, SEED)(0, np.zeros((DRAWS, 1))))


@noisy
def test_signals_are_left_alone(sensor):
    y = np.ones((4, 2))
    y.flags.writeable = False
    sensor(0, y)
    assert np.array_equal(y, np.ones((4, 2)))


# Through a disturbance of the user's own


def test_through():
    signal = np.array([[1.0, 2.0]])
    assert through("sensor", None, 0, signal) is signal
    assert np.array_equal(through("sensor", lambda k, y: (k * y).tolist(), 3, signal), 3 * signal)


def test_through_a_tuple_in_order():
    signal, twice, less = np.array([1.0, 2.0]), lambda k, y: 2 * y, lambda k, y: y - k
    assert through("sensor", (), 3, signal) is signal
    assert np.array_equal(through("sensor", (twice, less), 3, signal), 2 * signal - 3)
    assert np.array_equal(through("sensor", (less, twice), 3, signal), 2 * (signal - 3))


def fails(k, y):
    raise KeyError("drift")


@pytest.mark.parametrize(
    ("disturbance", "sentence"),
    [
        (3.0, r"the sensor must be a function of \(k, signal\), got 3.0"),
        ((Saturation(-1.0, 1.0), 3.0), r"the sensor must be a function of \(k, signal\), got 3.0"),
        (lambda k, y: y[:1], r"the sensor must return the shape of its argument, \(2,\), got \(1,\)"),
        (lambda k, y: 1.0, r"the sensor must return the shape of its argument, \(2,\), got \(\)"),
        (lambda k, y: y * np.nan, "what the sensor returns at k = 5 must be finite, got nan"),
        (lambda k, y: [np.inf, 0.0], "what the sensor returns at k = 5 must be finite, got inf"),
        (lambda k, y: None, "what the sensor returns at k = 5 must hold real numbers, got None"),
        (lambda k, y: y * 1j, "what the sensor returns at k = 5 must hold real numbers, got complex numbers"),
        (lambda k, y: "fine", "what the sensor returns at k = 5 must hold real numbers, got 'fine'"),
        (Saturation([0.0] * 3, 1.0), "low must be a number or have 2 entries, one for each input, got 3"),
        (GaussianNoise([1.0] * 3, 0), "std must be a number or have 2 entries, one for each output, got 3"),
    ],
)
def test_own_disturbances_refused(disturbance, sentence):
    with pytest.raises(InputError, match=sentence):
        through("sensor", disturbance, 5, np.ones(2))


@pytest.mark.parametrize("disturbance", [fails, (Saturation(-1.0, 1.0), fails)])
def test_what_a_disturbance_raises_is_let_through(disturbance):
    with pytest.raises(KeyError, match="drift") as caught:
        through("sensor", disturbance, 5, np.ones(2))
    assert caught.value.__notes__ == ["rhl called the sensor at k = 5 with a signal of shape (2,)"]
    with pytest.raises(TypeError, match="takes 1 positional argument"):
        through("sensor", lambda y: y, 5, np.ones(2))


def test_noise_for_other_outputs_is_refused():
    with pytest.raises(InputError, match="std must be a number or have 1 entries, one for each output, got 2"):
        through("sensor", GaussianNoise([1.0, 2.0], 0), 0, np.ones(1))


@pytest.mark.parametrize(
    ("build", "sentence"),
    [
        (lambda: Saturation(1.0, 1.0), "low must be below high for each input, got low 1.0 and high 1.0"),
        (lambda: Saturation([0.0, 2.0], 1.0), "low must be below high for each input"),
        (lambda: Saturation([0.0, 0.0], [1.0, 1.0, 1.0]), "low must be below high for each input"),
        (lambda: Saturation(-np.inf, 1.0), "low must be finite, got -inf"),
        (lambda: Saturation(0.0, [[1.0]]), r"high must be a number or one number for each input, got shape \(1, 1\)"),
        (lambda: Saturation([], 1.0), r"low must be a number or one number for each input, got shape \(0,\)"),
        (lambda: GaussianNoise(-1.0, 0), "std must be a number, or one for each output, of at least 0, got -1.0"),
        (lambda: GaussianNoise([[1.0]], 0), "std must be a number, or one for each output"),
        (lambda: GaussianNoise(np.nan, 0), "std must be finite, got nan"),
        (lambda: GaussianNoise(1.0, -1), "seed must be an integer of at least 0, got -1"),
        (lambda: GaussianNoise(1.0, 1.5), "seed must be an integer of at least 0, got 1.5"),
        (lambda: Outliers(1.0, 1.0, 0), r"rate must be a number in \[0, 1\), got 1.0"),
        (lambda: Outliers(-0.1, 1.0, 0), r"rate must be a number in \[0, 1\), got -0.1"),
        (lambda: Outliers(0.1, 0.0, 0), "size must be a positive finite number, got 0.0"),
        (lambda: Outliers(0.1, 1.0, None), "seed must be an integer of at least 0, got None"),
    ],
)
def test_refused(build, sentence):
    with pytest.raises(InputError, match=sentence):
        build()
