"""Your own losses and generators, and losses that change with k."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from rhl._checks import Array, describe, numbers, reason
from rhl.errors import InputError
from rhl.losses._convex import Convex, convex

Found = TypeVar("Found")


@dataclass(frozen=True, eq=False, init=False)
class CustomLoss:
    """Your own loss or generator, from its value and its gradient.

    InputError if an argument is of the wrong kind; later, when a function returns another shape, or NaN. Exceptions of
    the functions pass through, with a note about the call.

    Parameters
    ----------
    value : callable
        x, shape (d,) -> c(x) or g(x), a number. Entries are in the order of ``WeightedSquares``.
    gradient : callable
        x, shape (d,) -> the gradient, shape (d,).
    hessian : callable, optional
        x, shape (d,) -> second derivatives, shape (d,) if the matrix is diagonal, else (d, d). By default forward
        differences of the gradient, which are slower but give solutions as accurate.
    lower : float
        The domain consists of the vectors whose entries are above this.
    assumption_6, convex_in_second : bool, optional
        Known properties, see ``Convex``; by default they are unknown, and the estimator warns.
    name : str
        Its name in messages.
    separable : bool
        Whether it is a sum of functions of single entries. The shape of ``hessian`` states this; without one, True
        needs only one difference of the gradient, and equation (15) is solved row by row.
    """

    _value: Callable[[Array], float]
    _gradient: Callable[[Array], ArrayLike]
    _hessian: Callable[[Array], ArrayLike] | None
    lower: float
    assumption_6: bool | None
    convex_in_second: bool | None
    name: str
    separable: bool

    def __init__(
        self,
        value: Callable[[Array], float],
        gradient: Callable[[Array], ArrayLike],
        hessian: Callable[[Array], ArrayLike] | None = None,
        lower: float = -np.inf,
        assumption_6: bool | None = None,
        convex_in_second: bool | None = None,
        name: str = "CustomLoss",
        separable: bool = False,
    ) -> None:
        functions: dict[str, object] = {"value": value, "gradient": gradient, "hessian": hessian}
        for role, found in functions.items():
            if not callable(found) and not (role == "hessian" and found is None):
                raise InputError(f"{role} must be a function of x, got {describe(found)}")
        bound: object = lower
        if isinstance(bound, bool) or not isinstance(bound, (int, float)) or not bound < np.inf:
            raise InputError(f"lower must be a number or -inf, got {describe(lower)}")
        facts: dict[str, object] = {"assumption_6": assumption_6, "convex_in_second": convex_in_second}
        for known, fact in facts.items():
            if not isinstance(fact, bool | None):
                raise InputError(f"{known} must be True, False or None, got {describe(fact)}")
        called_so: object = name
        if not isinstance(called_so, str):
            raise InputError(f"name must be a string, got {describe(name)}")
        apart: object = separable
        if not isinstance(apart, bool):
            raise InputError(f"separable must be True or False, got {describe(separable)}")
        settings = {f"_{role}": found for role, found in functions.items()} | {"lower": lower, **facts}
        settings |= {"name": name, "separable": separable}
        for setting, chosen in settings.items():
            object.__setattr__(self, setting, chosen)

    def value(self, x: Array) -> Array:
        """Return the value, shape (...); infinite outside the domain."""
        return _each(lambda point: self._at(point), x, ())

    def gradient(self, x: Array) -> Array:
        """Return the gradient, shape (..., d)."""
        return _each(lambda point: self._call("gradient", self._gradient, point, [point.shape]), x, x.shape[-1:])

    def hessian(self, x: Array) -> Array:
        """Return the second derivatives, shape (..., d) or (..., d, d)."""
        d = x.shape[-1]
        if self._hessian is not None:
            known = self._hessian
            rows = [self._call("hessian", known, point, [(d,), (d, d)]) for point in x.reshape(-1, d)]
            return np.reshape(rows, (*x.shape[:-1], *rows[0].shape))
        return _each(self._differences, x, (d,) if self.separable else (d, d))

    def _at(self, point: Array) -> Array:
        # A user's function need not be defined outside its domain.
        return self._call("value", self._value, point, [()]) if np.all(point > self.lower) else np.asarray(np.inf)

    def _differences(self, point: Array) -> Array:
        # Forward differences, because the domain is bounded only from below.
        widths = np.sqrt(np.finfo(float).eps) * np.maximum(np.abs(point), 1e-3)
        if self.separable:
            moved = point + widths
            return (self.gradient(moved) - self.gradient(point)) / (moved - point)
        moved = point + np.diag(widths)
        slopes = (self.gradient(moved) - self.gradient(point)) / np.diagonal(moved - point)[:, None]
        return np.asarray((slopes + slopes.T) / 2)

    def _call(
        self, role: str, function: Callable[[Array], ArrayLike], point: Array, shapes: list[tuple[int, ...]]
    ) -> Array:
        returned = _theirs(function, point, f"{self.name}'s function {role!r} raised this at x of shape {point.shape}")
        try:
            found = numbers(returned)
        except Exception as error:  # ragged, complex, strings, or any error of the object's own conversion
            raise InputError(
                f"{self.name}'s function {role!r} must return real numbers, got {reason(error)}"
            ) from error
        if found.shape not in shapes:
            wanted = " or ".join(str(shape) for shape in shapes)
            raise InputError(f"{self.name}'s function {role!r} must return shape {wanted}, got {found.shape}")
        if np.any(np.isnan(found)) or (role != "value" and np.any(np.isinf(found))):
            raise InputError(
                f"{self.name}'s function {role!r} must return finite numbers in its domain, got {found.ravel()[:3]} "
                f"at x with entries from {point.min():.3g} to {point.max():.3g}; set lower where the domain is bounded"
            )
        return found


@dataclass(frozen=True, eq=False)
class Varying:
    """A loss that changes with k, equation (15)'s c(e, k).

    ``at`` returns the loss of step k: ``WeightedSquares``, ``LogCosh``, ``PseudoHuber`` or ``CustomLoss``. InputError
    if it is not a function; later, if it returns something else than a loss.
    """

    at: Callable[[int], Convex]

    def __post_init__(self) -> None:
        if not callable(self.at):
            raise InputError(f"at must be a function of k that returns a loss, got {describe(self.at)}")

    def loss(self, k: int) -> Convex:
        """Return c(., k)."""
        return convex("at(k)", _theirs(self.at, k, f"the function of a Varying loss raised this at k = {k}"))


def _theirs(function: Callable[..., Found], argument: object, note: str) -> Found:
    """Call a user's function; its exceptions pass through, with a note about the call."""
    try:
        return function(argument)
    except Exception as error:
        error.add_note(note)
        raise


def _each(function: Callable[[Array], ArrayLike], x: Array, core: tuple[int, ...]) -> Array:
    """Call a function of single vectors for every member of a batch."""
    found = [np.asarray(function(point)) for point in x.reshape(-1, x.shape[-1])]
    return np.reshape(found, (*x.shape[:-1], *core))
