"""The protocol of losses and generators, and the register of their classes."""

from __future__ import annotations

from typing import Any, Protocol, TypeVar

from rhl._checks import Array, members


class Generator(Protocol):
    """A strictly convex, continuously differentiable function: value and gradient (Assumption 6)."""

    def value(self, x: Array) -> Array:
        """Return g(x), shape (...)."""

    def gradient(self, x: Array) -> Array:
        """Return the gradient at x, shape (..., d)."""


class Convex(Generator, Protocol):
    """A loss or a generator for the estimator: value, gradient, curvature, domain and known properties."""

    @property
    def lower(self) -> float:
        """Entries must lie above this; -inf if every number is in the domain."""

    @property
    def assumption_6(self) -> bool | None:
        """Whether it is continuously differentiable and strictly convex (a loss: least at zero); None: unknown."""

    @property
    def convex_in_second(self) -> bool | None:
        """Whether the Bregman distance that it induces is convex in its second argument (Lemma 4); None: unknown."""

    def hessian(self, x: Array) -> Array:
        """Return the second derivatives, shape (..., d) if the matrix is diagonal, else (..., d, d).

        A diagonal means that the function is a sum of functions of single entries. Equation (15) then splits into one
        problem for each row of [A B], which are solved and certified separately.
        """


KNOWN: list[str] = []
LOSSES: dict[str, type] = {}
GENERATORS: dict[str, type] = {}

Kind = TypeVar("Kind", bound=type)


def registered(kind: Kind) -> Kind:
    """Register a class of losses or generators.

    Messages then name it. A class with ``file_name``, its name in files, and with ``file_loss`` or ``file_generator``,
    its parameters in that role, is also available in files (``LOSSES``, ``GENERATORS``).

    Examples
    --------
    >>> from rhl.losses import LOSSES
    >>> LOSSES["log-cosh"](scale=0.1).scale
    0.1
    """
    KNOWN.append(kind.__name__)
    for offers, role in ((LOSSES, "file_loss"), (GENERATORS, "file_generator")):
        if getattr(kind, role, None) is not None:
            offers[kind.file_name] = kind  # type: ignore[attr-defined]
    return kind


def convex(name: str, value: Any) -> Convex:
    """Check that a value has the members of ``Convex``; InputError if it lacks one."""
    kind = f"a loss or generator ({', '.join(KNOWN)}, or CustomLoss for your own functions)"
    members(name, value, kind, "value", "gradient", "hessian", "lower", "assumption_6", "convex_in_second")
    checked: Convex = value
    return checked


def called(function: object) -> str:
    """Return the name of a loss or a generator in messages."""
    return str(getattr(function, "name", type(function).__name__))
