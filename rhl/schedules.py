"""Schedules epsilon(k) by which the terminal weight Gamma(x)/epsilon(k) grows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from rhl._checks import Array, describe, fraction, integer, numbers, positive, reason
from rhl.errors import InputError

Schedule = Callable[[int], float]

# A smaller epsilon would make 1/epsilon leave the range of float64.
_LEAST = 1e-300


@dataclass(frozen=True)
class PowerDecay:
    r"""The schedule :math:`\epsilon(k) = (1 + \eta k)^{-p}`; p = 1 is the harmonic one of Section VI.

    It stops falling at 1e-300, where 1/epsilon would leave the range of float64. Theorem 1 asks of a schedule only
    that it is positive and tends to zero.

    Parameters
    ----------
    rate : float
        :math:`\eta`, positive. The text has 1000 (linear) and 10 (robot arm); the linear data were made with 100.
    power : float
        p, positive.

    Examples
    --------
    >>> PowerDecay(100)(10)
    0.000999000999000999
    """

    rate: float
    power: float = 1.0
    vanishes = True

    def __post_init__(self) -> None:
        positive("rate", self.rate)
        positive("power", self.power)

    def __call__(self, k: int) -> float:
        """Return epsilon(k), at least 1e-300."""
        try:
            return max(float(1.0 / (1.0 + self.rate * k) ** self.power), _LEAST)
        except OverflowError:  # the power leaves the range of float64
            return _LEAST


@dataclass(frozen=True)
class ExponentialDecay:
    r"""The schedule :math:`\epsilon(k) = \rho^k` with ``factor`` :math:`\rho` in (0, 1).

    It stops falling at 1e-300, where 1/epsilon would leave the range of float64. Theorem 1 asks of a schedule only
    that it is positive and tends to zero; with a fast one the terminal weight grows too soon, see the book.
    """

    factor: float
    vanishes = True

    def __post_init__(self) -> None:
        positive("factor", self.factor)
        fraction("factor", self.factor)

    def __call__(self, k: int) -> float:
        """Return epsilon(k), at least 1e-300."""
        return max(float(np.exp(k * np.log(self.factor))), _LEAST)


@dataclass(frozen=True)
class Constant:
    """The constant schedule ``value`` > 0: ordinary receding horizon control with a fixed terminal weight.

    Theorem 1 asks that epsilon(k) tends to zero; this one does not, and a controller with it warns.
    """

    value: float
    vanishes = False

    def __post_init__(self) -> None:
        positive("value", self.value)

    def __call__(self, k: int) -> float:
        """Return epsilon."""
        return float(self.value)


def epsilon_at(schedule: Schedule, k: int) -> float:
    """Return epsilon(k) of a schedule, possibly the user's own, and check it.

    InputError if it is not positive and finite at k, or is larger there than at k - 1. Exceptions of the user's
    own schedule pass through, with a note about the call.

    Examples
    --------
    >>> epsilon_at(lambda k: 0.5**k, 3)
    0.125
    """
    k = integer("k", k, 0)
    now = _value(schedule, k)
    if k > 0:
        before = _value(schedule, k - 1)
        if now > before:
            raise InputError(
                f"epsilon must not rise (Theorem 1 asks that it tends to zero), got {now:g} at k = {k} after {before:g}"
            )
    return now


def epsilons(schedule: Schedule, first: int, stop: int) -> Array:
    """Return epsilon at first, ..., stop - 1, checked as by :func:`epsilon_at`, with one evaluation at each."""
    start = max(first - 1, 0)
    found = np.array([_value(schedule, k) for k in range(start, stop)])
    rises = np.flatnonzero(np.diff(found) > 0)
    if len(rises):
        epsilon_at(schedule, start + int(rises[0]) + 1)
    return found[first - start :]


def _value(schedule: Schedule, k: int) -> float:
    if not callable(cast(object, schedule)):
        raise InputError(f"epsilon must be a function of k, got {describe(schedule)}")
    try:
        found: Any = schedule(k)
    except Exception as error:
        error.add_note(f"rhl called epsilon at k = {k}")
        raise
    try:
        value = float(numbers(found))
    except Exception as error:  # any error of the object's own conversion
        raise InputError(f"epsilon must return a number at k = {k}, got {reason(error)}") from error
    if not 0 < value < np.inf:
        raise InputError(f"epsilon must be positive and finite at every k, got {describe(found)} at k = {k}")
    return value
