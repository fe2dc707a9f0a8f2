"""The losses and generators that come with the library, and the Bregman distance that a generator induces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from rhl._checks import Array, common_batch, members, positive, real_array, weight_matrix
from rhl.errors import InputError
from rhl.losses._convex import KNOWN, Generator, called, registered


@registered
@dataclass(frozen=True, eq=False)
class WeightedSquares:
    r"""The weighted square :math:`x^\top W x`, as loss c or as generator g.

    Source: Remark 2 (:math:`c(e)=\|e\|^2`, :math:`g(\theta)=\|\theta\|^2`) with weights. Its domain is all of R^d,
    Assumption 6 holds, and the distance it induces is convex in both arguments, as Lemma 4 asks.

    Parameters
    ----------
    weight : float or array_like, shape (d,) or (d, d)
        One number, a positive number for each entry, or a symmetric positive definite matrix W. The order is the
        paper's: of the residuals :math:`s(k) - R(k)\theta`, newest transition first, as a loss; of
        :math:`\theta = [\mathrm{vec} A; \mathrm{vec} B]`, column by column, as a generator
        (``SignalModel(A, B).theta`` puts weights given entry by entry into that order).
    """

    weight: Array | float = 1.0

    lower = -np.inf
    assumption_6 = True
    convex_in_second = True
    file_name = "squares"
    file_loss = ()
    file_generator = ("weight",)

    def __post_init__(self) -> None:
        weight = real_array("weight", self.weight)
        if weight.ndim == 2:
            weight = weight_matrix("weight", weight, weight.shape[-1])
        elif weight.ndim > 2 or weight.size == 0 or np.any(weight <= 0):
            found = f"shape {weight.shape}" if weight.ndim > 2 else weight.min() if weight.size else "no entry"
            raise InputError(f"weight must be positive, one number or shape (d,) or (d, d), got {found}")
        object.__setattr__(self, "weight", weight)

    def value(self, x: Array) -> Array:
        """Return the weighted square, shape (...)."""
        return np.asarray(np.sum(x * self._times(x), axis=-1))

    def gradient(self, x: Array) -> Array:
        """Return 2 W x, shape (..., d)."""
        return 2 * self._times(x)

    def hessian(self, x: Array) -> Array:
        """Return 2 W, shape (..., d) or (..., d, d)."""
        matrix = np.ndim(self.weight) == 2
        return np.broadcast_to(2 * np.asarray(self.weight), (*x.shape, x.shape[-1]) if matrix else x.shape)

    def _times(self, x: Array) -> Array:
        return x @ self.weight if np.ndim(self.weight) == 2 else np.asarray(self.weight * x)


@dataclass(frozen=True, eq=False)
class _Robust:
    """What losses for outliers share: squares of residuals below a scale, a slope that stays bounded above it."""

    scale: float = 1.0
    weight: Array | float = 1.0

    lower = -np.inf
    assumption_6 = True
    convex_in_second = False
    file_loss = ("scale",)
    file_generator = None

    def __post_init__(self) -> None:
        positive("scale", self.scale)
        object.__setattr__(self, "weight", _entrywise(self.weight))

    def squares(self) -> WeightedSquares:
        """Return its limit for small residuals, weighted squares, whose solution is a good starting point."""
        return WeightedSquares(self.weight)


@registered
@dataclass(frozen=True, eq=False)
class LogCosh(_Robust):
    r"""The loss :math:`c(e) = \sum_i 2 w_i s^2 \log\cosh(e_i / s)`: small residuals squared, large ones linear.

    Source: Remark 2 names outliers as a reason for another loss than squares; the function is standard in robust
    statistics. Its domain is all of R^d and Assumption 6 holds. As a generator its distance is not convex in the
    second argument.

    Parameters
    ----------
    scale : float
        s, positive: the size above which a residual counts as an outlier, in the units of the residual.
    weight : float or array_like, shape (d,)
        :math:`w_i`, positive; as the scale grows, c tends to the weighted squares of the same weights.
    """

    file_name = "log-cosh"

    def value(self, x: Array) -> Array:
        """Return c(x), shape (...)."""
        t = np.abs(x) / self.scale
        # Near zero the second form would cancel, far from it the first would overflow, and below 1e-8 log cosh t is
        # t^2 / 2. Dividing by t avoids s^2 and t^2, which may leave the range.
        near = np.clip(t, 1e-8, 1)
        small = np.where(t < 1e-8, t / 2, np.log1p(2 * np.sinh(near / 2) ** 2) / near)
        far = np.maximum(t, 1)
        large = 1 + (np.log1p(np.exp(-2 * far)) - np.log(2)) / far
        share = np.where(t < 1, small, large)
        return np.asarray(np.sum(2 * self.weight * np.abs(x) * (self.scale * share), axis=-1))

    def gradient(self, x: Array) -> Array:
        """Return the entries 2 w s tanh(x / s), shape (..., d)."""
        return np.asarray(2 * self.weight * self.scale * np.tanh(x / self.scale))

    def hessian(self, x: Array) -> Array:
        """Return the entries 2 w / cosh(x / s)^2, shape (..., d)."""
        decay = np.exp(-np.abs(x) / self.scale)
        return np.asarray(2 * self.weight * (2 * decay / (1 + decay**2)) ** 2)


@registered
@dataclass(frozen=True, eq=False)
class PseudoHuber(_Robust):
    r"""The loss :math:`c(e) = \sum_i 2 w_i \delta^2 (\sqrt{1 + (e_i/\delta)^2} - 1)`, a smooth version of Huber's.

    Source: Charbonnier et al., Deterministic edge-preserving regularization in computed imaging, IEEE Trans. Image
    Process. 6 (1997). Its domain is all of R^d and Assumption 6 holds. As a generator its distance is not convex in
    the second argument.

    Parameters
    ----------
    scale : float
        :math:`\delta`, positive: the size above which a residual counts as an outlier, in the units of the residual.
    weight : float or array_like, shape (d,)
        :math:`w_i`, positive; as the scale grows, c tends to the weighted squares of the same weights.
    """

    file_name = "pseudo-huber"

    def value(self, x: Array) -> Array:
        """Return c(x), shape (...)."""
        # |x| / (sqrt(1 + t^2) + 1) times |x|: sqrt(1 + t^2) - 1 without cancellation, and without overflow.
        root = np.hypot(1, x / self.scale)
        return np.asarray(np.sum(2 * self.weight * np.abs(x) * (np.abs(x) / (root + 1)), axis=-1))

    def gradient(self, x: Array) -> Array:
        """Return the entries 2 w x / sqrt(1 + (x/delta)^2), shape (..., d)."""
        return np.asarray(2 * self.weight * x / np.hypot(1, x / self.scale))

    def hessian(self, x: Array) -> Array:
        """Return the entries 2 w (1 + (x/delta)^2)^(-3/2), shape (..., d)."""
        return np.asarray(2 * self.weight * np.hypot(1, x / self.scale) ** -3.0)


@registered
@dataclass(frozen=True, eq=False)
class Entropy:
    r"""The generator :math:`g(\theta) = \sum_i w_i\, \theta_i \log\theta_i` on positive parameters.

    ``weight``, :math:`w_i`, is one positive number or one for each entry of :math:`\theta`, in its order. The distance
    is the Kullback-Leibler divergence, which is jointly convex, so Lemma 4 applies; Assumption 6 holds
    on its domain, the positive numbers. Every entry of A and B must be positive, also in the initial model, so it suits
    only positive systems (flows, stocks, populations).
    """

    weight: Array | float = 1.0

    lower = 0.0
    assumption_6 = True
    convex_in_second = True
    file_name = "entropy"
    file_loss = None
    file_generator = ("weight",)

    def __post_init__(self) -> None:
        object.__setattr__(self, "weight", _entrywise(self.weight))

    def value(self, x: Array) -> Array:
        """Return g(x), shape (...); infinite outside the domain."""
        inside = np.where(x > 0, x, 1.0)
        terms = np.where(x < 0, np.inf, self.weight * inside * np.log(inside))
        return np.asarray(np.sum(np.where(x == 0, 0.0, terms), axis=-1))

    def gradient(self, x: Array) -> Array:
        """Return the entries w (1 + log x), shape (..., d)."""
        return np.asarray(self.weight * (1 + np.log(x)))

    def hessian(self, x: Array) -> Array:
        """Return the entries w / x, shape (..., d)."""
        return np.asarray(self.weight / x)


def divergence(g: Generator, x: ArrayLike, y: ArrayLike) -> Array:
    r"""Bregman distance :math:`D(x,y) = g(x) - g(y) - (x-y)^\top \nabla g(y)`, shape (...), for x and y of (..., d).

    Nonnegative, zero only for x = y, since g is strictly convex; the definition follows equation (15). InputError if a
    point lies outside the domain.

    Examples
    --------
    >>> float(divergence(WeightedSquares(), [3.0, 0.0], [0.0, 4.0]))
    25.0
    """
    members("g", g, f"a generator ({', '.join(KNOWN)}, or CustomLoss)", "value", "gradient")
    x, y = real_array("x", x, (None,)), real_array("y", y, (None,))
    d, weights = x.shape[-1], np.shape(getattr(g, "weight", 1.0))
    if y.shape[-1] != d:
        raise InputError(f"x and y must have the same number of entries, got {d} and {y.shape[-1]}")
    common_batch(x=(x, 1), y=(y, 1))
    if weights not in ((), (d,), (d, d)):
        raise InputError(
            f"the weights of {called(g)} must be one number or have shape ({d},) or ({d}, {d}), as x has {d} entries, "
            f"got {weights}"
        )
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        found = g.value(x) - g.value(y) - np.sum((x - y) * g.gradient(y), axis=-1)
    if not np.all(np.isfinite(found)):
        raise InputError(
            f"x and y must lie in the domain of {called(g)}, where the distance is finite, got entries from "
            f"{min(x.min(), y.min()):.3g} to {max(x.max(), y.max()):.3g}"
        )
    return np.asarray(found)


def _entrywise(weight: ArrayLike) -> Array:
    array = real_array("weight", weight)
    if array.ndim > 1 or array.size == 0 or np.any(array <= 0):
        found = array.min() if array.size and array.ndim < 2 else f"shape {array.shape}"
        raise InputError(f"weight must be positive, one number or shape (d,), got {found}")
    return array
