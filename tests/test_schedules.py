"""Schedules: values, floors, that they fall, and what a function of the user's own may not do."""

import warnings
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rhl.controller import Controller
from rhl.errors import AssumptionWarning, InputError
from rhl.schedules import Constant, ExponentialDecay, PowerDecay, epsilon_at, epsilons

# Exponentials and logarithms of arguments up to 700 multiply rounding by as much.
ROUNDING = 1e-13

SCHEDULES = [PowerDecay(10.0), PowerDecay(10.0, 0.5), PowerDecay(0.1, 3.0), ExponentialDecay(0.9), Constant(0.3)]
each = pytest.mark.parametrize("schedule", SCHEDULES, ids=repr)


@pytest.mark.parametrize(
    ("schedule", "exact"),
    [
        (PowerDecay(10.0), lambda k: 1 / Fraction(1 + 10 * k)),
        (PowerDecay(Fraction(1, 2)), lambda k: 1 / (1 + Fraction(k, 2))),
        (PowerDecay(10.0, 3.0), lambda k: 1 / Fraction(1 + 10 * k) ** 3),
        (PowerDecay(2.0, 1.0), lambda k: 1 / Fraction(1 + 2 * k)),
        (ExponentialDecay(0.5), lambda k: Fraction(1, 2) ** k),
        (Constant(0.25), lambda k: Fraction(1, 4)),
    ],
)
def test_values_are_exact(schedule, exact):
    for k in (0, 1, 2, 10, 100, 900):
        assert schedule(k) == pytest.approx(float(exact(k)), rel=ROUNDING)


def test_power_one_is_harmonic_and_roots_are_slower():
    for k in range(0, 1000, 37):
        assert PowerDecay(7.0)(k) == PowerDecay(7.0, 1)(k) == 1.0 / (1.0 + 7.0 * k)  # to the bit
        assert PowerDecay(7.0, 0.5)(k) == pytest.approx(PowerDecay(7.0)(k) ** 0.5, rel=ROUNDING)
        assert k == 0 or PowerDecay(7.0, 0.5)(k) > PowerDecay(7.0)(k)


@each
def test_they_start_at_one_or_their_value_and_fall(schedule):
    values = np.array([epsilon_at(schedule, k) for k in range(200)])
    assert values[0] == (0.3 if isinstance(schedule, Constant) else 1.0)
    assert np.all(values > 0)
    assert np.all(np.diff(values) == 0) if isinstance(schedule, Constant) else np.all(np.diff(values) < 0)
    assert schedule.vanishes == (not isinstance(schedule, Constant))


@pytest.mark.parametrize(
    "schedule", [ExponentialDecay(0.5), ExponentialDecay(5e-324), PowerDecay(1e300, 50.0), PowerDecay(10.0, 400.0)]
)
def test_floor_keeps_the_weight_in_range(schedule):
    """Far out 1/epsilon would be infinite; at the floor it is not, and stays."""
    values = [epsilon_at(schedule, k) for k in (10_000, 10_001, 10**9)]
    assert values == [1e-300] * 3
    assert np.isfinite(1 / values[0])


@given(
    st.one_of(
        st.builds(PowerDecay, st.floats(1e-6, 1e6)),
        st.builds(PowerDecay, st.floats(1e-6, 1e6), st.floats(0.01, 100)),
        st.builds(ExponentialDecay, st.floats(1e-6, 1, exclude_max=True)),
    ),
    st.integers(1, 10**7),
)
def test_never_rising_at_any_step(schedule, k):
    assert 0 < epsilon_at(schedule, k) <= schedule(k - 1) <= 1


@pytest.mark.parametrize(
    ("schedule", "k", "sentence"),
    [
        (lambda k: "soon", 2, "epsilon must return a number at k = 2, got TypeError: .* not 'soon'"),
        (lambda k: "0.5", 0, "epsilon must return a number at k = 0, got TypeError: .* not '0.5'"),
        (lambda k: None, 0, "epsilon must return a number at k = 0, got TypeError"),
        (lambda k: 0.5 + 1j, 0, "epsilon must return a number at k = 0, got TypeError: .* complex numbers"),
        (lambda k: np.complex128(0.5), 0, "epsilon must return a number at k = 0, got TypeError: .* complex numbers"),
        (lambda k: [0.5, 0.4], 0, "epsilon must return a number at k = 0, got TypeError"),
        (0.5, 0, "epsilon must be a function of k, got 0.5"),
        (lambda k: 0.0, 5, "epsilon must be positive and finite at every k, got 0.0 at k = 5"),
        (lambda k: -0.1, 0, "epsilon must be positive and finite at every k, got -0.1 at k = 0"),
        (lambda k: float("nan"), 0, "epsilon must be positive and finite at every k, got nan at k = 0"),
        (lambda k: np.inf, 0, "epsilon must be positive and finite at every k, got inf at k = 0"),
        (lambda k: 1.0 if k < 3 else 1.5, 3, r"epsilon must not rise \(Theorem 1 .*, got 1.5 at k = 3 after 1$"),
        (lambda k: 1.0 if k == 1 else 0.0, 1, "got 0.0 at k = 0"),
    ],
)
def test_own_schedules_refused(schedule, k, sentence):
    with pytest.raises(InputError, match=sentence):
        epsilon_at(schedule, k)


def test_what_a_schedule_raises_is_let_through():
    for look in (lambda: epsilon_at(lambda k: 1 / k, 0), lambda: epsilons(lambda k: 1 / k, 0, 3)):
        with pytest.raises(ZeroDivisionError, match="division by zero") as caught:
            look()
        assert caught.value.__notes__ == ["rhl called epsilon at k = 0"]


@pytest.mark.parametrize("value", [0.5, np.float64(0.5), np.float32(0.5), Fraction(1, 2), np.array(0.5), 1])
def test_own_schedules_taken(value):
    for k in (0, 1, 100):
        found = epsilon_at(lambda k: value, k)
        assert (type(found), found) == (float, float(value))


@pytest.mark.parametrize(
    ("build", "sentence"),
    [
        (lambda: PowerDecay(-1.0), "rate must be a positive finite number, got -1.0"),
        (lambda: PowerDecay("10"), "rate must be a positive finite number, got '10'"),
        (lambda: PowerDecay(0.0, 1.0), "rate must be a positive finite number, got 0.0"),
        (lambda: PowerDecay(1.0, np.nan), "power must be a positive finite number, got nan"),
        (lambda: ExponentialDecay(1.0), r"factor must be a number in \[0, 1\), got 1.0"),
        (lambda: ExponentialDecay(0.0), "factor must be a positive finite number, got 0.0"),
        (lambda: Constant(np.inf), "value must be a positive finite number, got inf"),
        (lambda: Constant(0), "value must be a positive finite number, got 0"),
    ],
)
def test_refused(build, sentence):
    with pytest.raises(InputError, match=sentence):
        build()


@each
def test_a_constant_is_warned_of_once_and_by_name(schedule):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        Controller(1.0, 1.0, 1.0, 3, schedule)
    if isinstance(schedule, Constant):
        assert [warning.category for warning in caught] == [AssumptionWarning]
        assert "Theorem 1 asks for an epsilon(k) that tends to zero: Constant does not" in str(caught[0].message)
        assert caught[0].filename == __file__
    else:
        assert not caught
