"""Disturbances between scheme and plant in a simulation: saturating actuators, sensor errors and loads."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from rhl._checks import Array, describe, fraction, integer, positive, real_array
from rhl.errors import InputError

# k and the signal, shape (..., size) -> the disturbed signal, of the same shape.
Disturbance = Callable[[int, Array], ArrayLike]
# One disturbance, or several in series.
Disturbances = Disturbance | tuple[Disturbance, ...]


@dataclass(frozen=True, eq=False)
class Saturation:
    """An actuator that clips the input to a box, InputError if low is not below high.

    Outside the theory: the paper does not claim convergence under saturation. No controller with bounded inputs
    stabilises an unstable plant from every state.

    Parameters
    ----------
    low, high : float or array_like, shape (q,)
        Bounds, finite, in the units of the input.

    Examples
    --------
    >>> Saturation(-1.0, 1.0)(0, np.array([3.0, -0.5]))
    array([ 1. , -0.5])
    """

    low: Array | float
    high: Array | float

    def __post_init__(self) -> None:
        for name in ("low", "high"):
            bound = real_array(name, getattr(self, name))
            if bound.ndim > 1 or bound.size == 0:
                raise InputError(f"{name} must be a number or one number for each input, got shape {bound.shape}")
            object.__setattr__(self, name, bound)
        try:
            ordered = bool(np.all(np.asarray(self.low) < np.asarray(self.high)))
        except ValueError:
            ordered = False
        if not ordered:
            raise InputError(f"low must be below high for each input, got low {self.low} and high {self.high}")

    def __call__(self, k: int, v: Array) -> Array:
        """Return the input within the bounds, shape (..., q)."""
        low, high = (_one_each(name, getattr(self, name), v, "input") for name in ("low", "high"))
        return np.clip(v, low, high)


@dataclass(frozen=True, eq=False)
class GaussianNoise:
    """A sensor with independent normal errors, the same in every run with the same seed.

    Parameters
    ----------
    std : float or array_like, shape (p,)
        Standard deviation, in the units of the output; not negative.
    seed : int
        Seed of the errors, at least 0; those of step k depend on (seed, k) only.
    """

    std: Array | float
    seed: int

    def __post_init__(self) -> None:
        std = real_array("std", self.std)
        if std.ndim > 1 or std.size == 0 or np.any(std < 0):
            raise InputError(f"std must be a number, or one for each output, of at least 0, got {describe(self.std)}")
        object.__setattr__(self, "std", std)
        integer("seed", self.seed, 0)

    def __call__(self, k: int, y: Array) -> Array:
        """Return the output with its error, shape (..., p)."""
        return y + _one_each("std", self.std, y, "output") * np.random.default_rng([self.seed, k]).standard_normal(
            np.shape(y)
        )


@dataclass(frozen=True, eq=False)
class Outliers:
    """A sensor with outliers: at random, ``size`` or -``size`` is added to an entry of y.

    Parameters
    ----------
    rate : float
        Probability of an outlier in an entry at a step, in [0, 1).
    size : float
        Size of an outlier, in the units of the output.
    seed : int
        Seed of the outliers, at least 0; those of step k depend on (seed, k) only.
    """

    rate: float
    size: float
    seed: int

    def __post_init__(self) -> None:
        fraction("rate", self.rate)
        positive("size", self.size)
        integer("seed", self.seed, 0)

    def __call__(self, k: int, y: Array) -> Array:
        """Return the output with its outliers, shape (..., p)."""
        rng = np.random.default_rng([self.seed, k])
        hit, sign = rng.random(np.shape(y)) < self.rate, rng.choice([-1.0, 1.0], np.shape(y))
        return y + np.where(hit, sign * self.size, 0.0)


@dataclass(frozen=True, eq=False)
class Offset:
    """A constant that is added to a signal from a given step on: a load on the plant's input, a sensor's bias.

    Parameters
    ----------
    value : float or array_like, shape (size,)
        The constant, in the units of the signal.
    start : int
        The first k at which it acts, at least 0.

    Examples
    --------
    >>> Offset(0.5, start=10)(9, np.array([1.0])), Offset(0.5, start=10)(10, np.array([1.0]))
    (array([1.]), array([1.5]))
    """

    value: Array | float
    start: int = 0

    def __post_init__(self) -> None:
        value = real_array("value", self.value)
        if value.ndim > 1 or value.size == 0:
            raise InputError(f"value must be a number or one for each entry of the signal, got shape {value.shape}")
        object.__setattr__(self, "value", value)
        integer("start", self.start, 0)

    def __call__(self, k: int, signal: Array) -> Array:
        """Return the signal with the constant, shape (..., size)."""
        return signal + _one_each("value", self.value, signal, "entry") if k >= self.start else signal


def _one_each(name: str, value: Array | float, signal: Array, of: str) -> Array:
    found, size = np.asarray(value), np.shape(signal)[-1]
    if found.ndim and len(found) != size:
        raise InputError(f"{name} must be a number or have {size} entries, one for each {of}, got {len(found)}")
    return found


def through(name: str, disturbance: Disturbances | None, k: int, signal: Array) -> Array:
    """Pass y or v, shape (..., size), through a disturbance, possibly the user's own, and check the result.

    A tuple of disturbances acts in series; None leaves the signal unchanged. ``name`` is its name in messages,
    "sensor", "actuator" or "load". InputError if the shape changes or a number is not finite. Exceptions of the user's
    own disturbance pass through, with a note about the call.

    Examples
    --------
    >>> through("actuator", (Offset(0.5), Saturation(-1.0, 1.0)), 0, np.array([0.25, 3.0]))
    array([0.75, 1.  ])
    """
    if disturbance is None:
        return signal
    if isinstance(disturbance, tuple):
        for part in disturbance:
            signal = through(name, part, k, signal)
        return signal
    if not callable(cast(object, disturbance)):
        raise InputError(f"the {name} must be a function of (k, signal), got {describe(disturbance)}")
    try:
        found = disturbance(k, signal)
    except Exception as error:
        error.add_note(f"rhl called the {name} at k = {k} with a signal of shape {signal.shape}")
        raise
    array = real_array(f"what the {name} returns at k = {k}", found)
    if array.shape != signal.shape:
        raise InputError(f"the {name} must return the shape of its argument, {signal.shape}, got {array.shape}")
    return array
