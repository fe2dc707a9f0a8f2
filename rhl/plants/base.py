"""The protocol of a plant, and the checks that every plant shares."""

from __future__ import annotations

from typing import Any, Protocol

from numpy.typing import ArrayLike

from rhl._checks import Array, members, real_array
from rhl.errors import InputError


class Plant(Protocol):
    """A discrete-time system z(k+1) = step(z, v), y = output(z) with sizes n, q, p."""

    @property
    def n(self) -> int:
        """Size of the state z."""

    @property
    def q(self) -> int:
        """Size of the input v."""

    @property
    def p(self) -> int:
        """Size of the output y."""

    def step(self, z: Array, v: Array) -> Array:
        """Return the next state, shape (..., n)."""

    def output(self, z: Array) -> Array:
        """Return the output, shape (..., p)."""


def check_lengths(**vectors: tuple[ArrayLike, int]) -> list[Array]:
    """Return finite vectors as arrays; refuse those whose last axis does not have the given length.

    Examples
    --------
    >>> check_lengths(z=([1.0, 2.0], 3))
    Traceback (most recent call last):
    rhl.errors.InputError: z must have shape (..., 3) for this plant, got (2,)
    """
    arrays = []
    for name, (vector, length) in vectors.items():
        array = real_array(name, vector)
        if array.shape[-1:] != (length,):
            raise InputError(f"{name} must have shape (..., {length}) for this plant, got {array.shape}")
        arrays.append(array)
    return arrays


def check_plant(value: Any) -> None:
    """Refuse a value that is not a plant.

    Examples
    --------
    >>> check_plant([[1.0]])
    Traceback (most recent call last):
    rhl.errors.InputError: plant must be a plant (LinearPlant, ...
    """
    kind = "a plant (LinearPlant, FunctionPlant, or your own class with n, q, p, step and output)"
    members("plant", value, kind, "n", "q", "p", "step", "output")
