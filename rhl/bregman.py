"""Losses c, generators g and the Bregman distance that a generator induces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from rhl._checks import Array, InputError, real_array


class Generator(Protocol):
    """A strictly convex, continuously differentiable function: value and gradient (Assumption 6)."""

    def value(self, x: Array) -> Array:
        """Return g(x), shape (...)."""

    def gradient(self, x: Array) -> Array:
        """Return the gradient at x, shape (..., d)."""


@dataclass(frozen=True, eq=False)
class WeightedSquares:
    r"""The weighted sum of squares :math:`g(x) = \sum_i w_i x_i^2`, as loss c or as generator g.

    Parameters
    ----------
    weight : float or array_like, shape (d,) or (rows, columns)
        Positive weights :math:`w_i`. As a loss in the estimator: one number, or one weight for each residual
        e_j(k), shape (window, n). As a generator: one number, or one weight for each entry of [A B], shape (n, n+q).

    Raises
    ------
    InputError
        If a weight is not positive and finite.

    Notes
    -----
    Source: Remark 2 (:math:`c(e)=\|e\|^2`, :math:`g(\theta)=\|\theta\|^2`) with weights.
    Its domain is all of R^d, Assumption 6 holds, and the
    distance it induces is convex in both arguments, as Lemma 4 asks.
    """

    weight: Array | float = 1.0

    def __post_init__(self) -> None:
        weight = real_array("weight", self.weight)
        if weight.size == 0 or np.any(weight <= 0):
            raise InputError(f"weight must be positive, got {weight.min() if weight.size else 'no entry'}")
        object.__setattr__(self, "weight", weight)

    def value(self, x: Array) -> Array:
        """Return the weighted sum of squares, shape (...)."""
        return np.asarray(np.sum(self.weight * x**2, axis=-1))

    def gradient(self, x: Array) -> Array:
        """Return 2 w x, shape (..., d)."""
        return np.asarray(2 * self.weight * x)


def divergence(g: Generator, x: ArrayLike, y: ArrayLike) -> Array:
    r"""Bregman distance :math:`D(x,y) = g(x) - g(y) - (x-y)^\top \nabla g(y)`.

    Parameters
    ----------
    g : Generator
        Strictly convex generator.
    x, y : array_like, shape (..., d)
        Points in its domain.

    Returns
    -------
    array, shape (...)
        Nonnegative, zero only for x = y.

    Notes
    -----
    Source: the definition after equation (15).
    """
    x, y = real_array("x", x, (None,)), real_array("y", y, (None,))
    return g.value(x) - g.value(y) - np.sum((x - y) * g.gradient(y), axis=-1)
