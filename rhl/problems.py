"""The finite-horizon problems V1, V2 and V3, as data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rhl._checks import Array, describe, instance, integer, read_only, real_array, weight_matrix
from rhl.errors import InputError
from rhl.model import PredictorMaps, SignalModel

Predictor = SignalModel | PredictorMaps


@dataclass(frozen=True, eq=False)
class InputBounds:
    r"""Bounds on the inputs of a plan: low <= u_i <= high, entry by entry.

    The paper names bounds in its outlook (Section VII); its theory does not cover them.

    Parameters
    ----------
    low, high : array_like, shape (..., q)
        InputError if low is not below high throughout.
    summed : bool
        Whether they apply to u_0 + ... + u_i instead, as for increments u of the input.
    """

    low: Array
    high: Array
    summed: bool = False

    def __post_init__(self) -> None:
        for name in ("low", "high"):
            object.__setattr__(self, name, read_only(real_array(name, getattr(self, name), (None,))))
        if self.low.shape[-1] != self.high.shape[-1] or not np.all(self.low < self.high):
            raise InputError(
                f"low must be below high for each input, got low {describe(self.low)} and high {describe(self.high)}"
            )


@dataclass(frozen=True, eq=False)
class V1:
    r"""The problem that the scheme solves at every step, equation (3).

    .. math::
        V_1 = \min \sum_{i=0}^{N-1} x_i^\top Q x_i + u_i^\top R u_i + \frac{\Gamma(x)}{\epsilon} x_N^\top Q_N x_N

    Parameters
    ----------
    model : SignalModel or PredictorMaps
        Predictor; a signal model stands for its powers, equation (21).
    Q, QN : float or array_like, shape (n, n)
        Stage and terminal weight, symmetric positive definite (Assumption 3); a number stands for that multiple of the
        identity.
    R : float or array_like, shape (q, q)
        Input weight, symmetric positive definite.
    weight : array_like, shape (...)
        Gamma(x)/eps(k), nonnegative.
    horizon : int
        N, at least 1.
    bounds : InputBounds, optional
        Bounds on the inputs; not in equation (3).

    Examples
    --------
    >>> from rhl.horizon import solve
    >>> plan = solve(V1(SignalModel([[1.0]], [[1.0]]), Q=1.0, R=1.0, QN=1.0, weight=1e9, horizon=2), [1.0])
    >>> bool(abs(plan.x[-1, 0]) < 1e-8)  # the terminal state is expensive
    True
    """

    model: Predictor
    Q: Array | float
    R: Array | float
    QN: Array | float
    weight: Array | float
    horizon: int
    bounds: InputBounds | None = None

    def __post_init__(self) -> None:
        _check_horizon(self.model, self.horizon)
        for name, size in (("Q", self.model.n), ("R", self.model.q), ("QN", self.model.n)):
            object.__setattr__(self, name, weight_matrix(name, getattr(self, name), size))
        weight = real_array("weight", self.weight)
        if np.any(weight < 0):
            raise InputError(f"weight must be nonnegative, got {weight.min()}")
        object.__setattr__(self, "weight", weight)
        if self.bounds is not None:
            instance("bounds", self.bounds, InputBounds)
            if self.bounds.low.shape[-1] != self.model.q:
                raise InputError(f"bounds must be of {self.model.q} inputs, got {self.bounds.low.shape[-1]}")


@dataclass(frozen=True, eq=False)
class V2:
    r"""The problem of least terminal cost, equation (10).

    .. math:: V_2 = \min\; \xi_N^\top Q_N \xi_N

    Its solution is not unique; ``solve`` returns the one of least :math:`\sum_i |\xi_i|^2 + |\nu_i|^2`
    (proof of Lemma 1(b)). The parameters are those of :class:`V1`.

    Examples
    --------
    >>> from rhl.horizon import solve
    >>> half_reached = SignalModel([[1.0, 0.0], [0.0, 1.0]], [[1.0], [0.0]])
    >>> float(solve(V2(half_reached, QN=1.0, horizon=2), [5.0, 3.0]).value.round(12))  # the 3 stays, whatever u
    9.0
    """

    model: Predictor
    QN: Array | float
    horizon: int

    def __post_init__(self) -> None:
        _check_horizon(self.model, self.horizon)
        object.__setattr__(self, "QN", weight_matrix("QN", self.QN, self.model.n))


@dataclass(frozen=True, eq=False)
class V3:
    r"""The problem with a terminal equality, equation (11).

    .. math:: V_3 = \min \sum_{i=0}^{N-1} \xi_i^\top Q \xi_i + \nu_i^\top R \nu_i \quad\text{s.t. } \xi_N = r

    The parameters are those of :class:`V1`, and r, shape (..., n), the required terminal state.

    Examples
    --------
    >>> from rhl.horizon import solve
    >>> plan = solve(V3(SignalModel([[1.0]], [[1.0]]), Q=1.0, R=1.0, r=[2.0], horizon=3), [0.0])
    >>> bool(abs(plan.x[-1, 0] - 2.0) < 1e-12)
    True
    """

    model: Predictor
    Q: Array | float
    R: Array | float
    r: Array
    horizon: int

    def __post_init__(self) -> None:
        _check_horizon(self.model, self.horizon)
        object.__setattr__(self, "Q", weight_matrix("Q", self.Q, self.model.n))
        object.__setattr__(self, "R", weight_matrix("R", self.R, self.model.q))
        object.__setattr__(self, "r", real_array("r", self.r, (self.model.n,)))


Problem = V1 | V2 | V3


def _check_horizon(model: Predictor, horizon: int) -> None:
    instance("model", model, SignalModel, PredictorMaps)
    integer("horizon", horizon, 1)
    if isinstance(model, PredictorMaps) and model.horizon != horizon:
        raise InputError(f"horizon must be that of the predictor maps, {model.horizon}, got {horizon}")
