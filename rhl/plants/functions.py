"""Plants from two of your own functions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from rhl._checks import Array, common_batch, describe, integer, read_only
from rhl.errors import InputError, PlantError
from rhl.plants.base import check_lengths


@dataclass(frozen=True, eq=False)
class FunctionPlant:
    r"""Your own plant, :math:`z(k+1) = f(z(k), v(k)),\; y(k) = g(z(k))`, from two plain functions.

    The functions get one state at a time, also for a batch, as read-only arrays, and must return new ones. The scheme
    brings the outputs to zero, so put the wanted equilibrium there. The size p of the output is that of g(0).

    PlantError if a function does not return finite real numbers of the right shape at z = 0, v = 0; see :meth:`step`
    for later values. Exceptions of the functions pass through, with a note about the call. InputError if one is not
    callable.

    Parameters
    ----------
    transition : callable
        f, from z of shape (n,) and v of shape (q,) to the next state, shape (n,).
    measurement : callable
        g, from z of shape (n,) to y, shape (p,).
    n, q : int
        Sizes of state and input, at least 1.
    names : tuple of str
        The names of the two functions in messages.

    Examples
    --------
    >>> pendulum = FunctionPlant(
    ...     lambda z, v: [z[0] + 0.1 * z[1], z[1] + 0.1 * (np.sin(z[0]) + v[0])], lambda z: z[:1], n=2, q=1
    ... )
    >>> pendulum.p, pendulum.step(np.array([0.0, 1.0]), np.array([0.0]))
    (1, array([0.1, 1. ]))
    """

    transition: Callable[[Array, Array], ArrayLike]
    measurement: Callable[[Array], ArrayLike]
    n: int
    q: int
    names: tuple[str, str] = ("transition", "measurement")
    p: int = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "n", integer("n", self.n, 1))
        object.__setattr__(self, "q", integer("q", self.q, 1))
        functions: tuple[object, object] = (self.transition, self.measurement)
        for name, form, function in zip(self.names, ("(z, v)", "(z)"), functions, strict=True):
            if not callable(function):
                raise InputError(f"{name} must be a function {name}{form}, got {describe(function)}")
        z, v = read_only(np.zeros(self.n)), read_only(np.zeros(self.q))
        found = {
            self._output_name: _called(self._output_name, self.measurement, None, z),
            self._step_name: _called(self._step_name, self.transition, self.n, z, v),
        }
        for name, value in found.items():
            if not np.all(np.isfinite(value)):
                raise PlantError(
                    f"{name} must be finite at z = 0, v = 0, to which the scheme brings the plant, got "
                    f"{describe(value)}; shift the coordinates so that the wanted equilibrium is at zero"
                )
        object.__setattr__(self, "p", len(found[self._output_name]))

    @property
    def _step_name(self) -> str:
        return f"{self.names[0]}(z, v)"

    @property
    def _output_name(self) -> str:
        return f"{self.names[1]}(z)"

    def step(self, z: Array, v: Array) -> Array:
        """Return the next state, shape (..., n), member by member of the batch.

        Infinite and NaN entries of the function are kept, and an OverflowError gives an infinite entry; the closed loop
        then stops as diverged. InputError if z or v has another length or their batch
        axes do not fit, PlantError if the function returns something other than n real numbers.
        """
        z, v = check_lengths(z=(z, self.n), v=(v, self.q))
        lead = common_batch(z=(z, 1), v=(v, 1))
        z, v = np.broadcast_to(z, (*lead, self.n)), np.broadcast_to(v, (*lead, self.q))
        out = np.empty((*lead, self.n))
        for i in np.ndindex(lead):
            out[i] = _called(self._step_name, self.transition, self.n, read_only(z[i]), read_only(v[i]))
        return out

    def output(self, z: Array) -> Array:
        """Return the output, shape (..., p), member by member of the batch; errors as in :meth:`step`."""
        (z,) = check_lengths(z=(z, self.n))
        out = np.empty((*z.shape[:-1], self.p))
        for i in np.ndindex(z.shape[:-1]):
            out[i] = _called(self._output_name, self.measurement, self.p, read_only(z[i]))
        return out


def _called(name: str, function: Callable[..., ArrayLike], length: int | None, *arguments: Array) -> Array:
    """Call a user's function and check that it returns real numbers of shape (length,), finite or not."""
    wanted = f"an array of shape ({'p' if length is None else length},)"
    try:
        returned = function(*arguments)
    except OverflowError:
        return np.full(1 if length is None else length, np.inf)
    except Exception as error:
        where = ", ".join(f"{symbol} = {describe(value)}" for symbol, value in zip("zv", arguments, strict=False))
        error.add_note(f"rhl called {name} at {where}, read-only arrays: begin with z = z.copy() to write into one")
        raise
    try:
        raw = np.asarray(returned)
    except Exception as error:  # a ragged list, or any error of the object's own conversion
        raise PlantError(
            f"{name} must return {wanted}, got {describe(returned)}, which is not a rectangular array; "
            "return np.array([...]) with one number for each entry"
        ) from error
    if raw.dtype.kind not in "iuf":
        raise PlantError(
            f"{name} must return {wanted} of real numbers, got {describe(returned)}; return np.array([...]) of floats"
        )
    if raw.ndim != 1 or len(raw) == 0 or length not in (None, len(raw)):
        raise PlantError(
            f"{name} must return {wanted}, got shape {raw.shape}; return np.array([...]) with one number for each entry"
        )
    with np.errstate(over="ignore"):
        return np.asarray(raw, dtype=np.float64)
