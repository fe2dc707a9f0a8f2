"""Prior knowledge of the signal model: linear equalities that every estimate must satisfy."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from rhl._checks import Array, describe, instance, integer, locked, numbers, real_array
from rhl.errors import InputError
from rhl.model import SignalModel

# Equalities with a larger relative residual contradict each other or the model; numbers written with 12 digits or
# more pass.
_MET_RTOL = 1e-10


@dataclass(frozen=True, eq=False)
class LinearConstraints:
    r"""Linear equalities :math:`M \theta = b` of the signal model, :math:`\theta = [\mathrm{vec} A; \mathrm{vec} B]`.

    Source: the last remark of Section V, that a priori knowledge enters as constraints of the estimator. Mixing keeps
    the equalities, since it takes convex combinations of two models that satisfy them. InputError if shapes do not fit
    each other, or the equalities contradict each other.

    Parameters
    ----------
    M : array_like, shape (rows, n (n + q))
        One row for each equality, in the order of ``SignalModel.theta``.
    b : array_like, shape (rows,)
        Right-hand sides.

    Examples
    --------
    The upper row of A is known, the rest is not:

    >>> known = LinearConstraints.entries([[0.0, 1.0], [np.nan, np.nan]], [[np.nan], [np.nan]])
    >>> known.M.shape
    (2, 6)
    """

    M: Array
    b: Array

    def __post_init__(self) -> None:
        M = real_array("M", self.M)
        b = real_array("b", self.b)
        if M.ndim != 2 or M.shape[1] == 0 or b.shape != M.shape[:1]:
            raise InputError(
                f"M and b must have shapes (rows, n (n + q)) and (rows,), got {M.shape} and {b.shape}; "
                "give one row of M and one entry of b for each equality"
            )
        object.__setattr__(self, "M", M)
        object.__setattr__(self, "b", b)
        if len(b):
            left = np.abs(M @ _least_norm(M, b) - b)
            size = np.abs(M).max(axis=1) + np.abs(b)
            worst = int(np.argmax(left / np.where(size > 0, size, 1)))
            if left[worst] > _MET_RTOL * size[worst] or size[worst] == 0 < left[worst]:
                raise InputError(
                    f"the equalities must not contradict each other, got row {worst}, which misses by "
                    f"{left[worst]:.3g}, given the others; remove one of them"
                )

    @classmethod
    def entries(cls, A: ArrayLike, B: ArrayLike) -> LinearConstraints:
        """Fix single entries of A, shape (n, n), and B, shape (n, q); NaN if unknown, InputError if infinite."""
        try:
            found = A
            A = numbers(found)
            found = B
            B = numbers(found)
        except Exception as error:  # a ragged list, or any error of the object's own conversion
            raise InputError(f"A and B must hold numbers, NaN where unknown, got {describe(found)}") from error
        if A.ndim != 2 or A.shape[0] != A.shape[1] or B.ndim != 2 or len(B) != len(A) or 0 in B.shape:
            raise InputError(f"A and B must have shapes (n, n) and (n, q), got {A.shape} and {B.shape}")
        theta = np.concatenate([A.T.ravel(), B.T.ravel()])
        known = ~np.isnan(theta)
        return cls(np.eye(len(theta))[known], theta[known])

    @classmethod
    def shift(cls, p: int, outputs: int, q: int, inputs: int) -> LinearConstraints:
        r"""Fix the rows of a delay-lifted model that only shift outputs.

        Of :math:`x(k+1) = [y(k+1); y(k); \dots; y(k-N_y+2)]` all but the first p entries are entries of x(k): these
        rows of [A B] hold zeros and ones. y has size p and v size q, ``outputs`` is :math:`N_y` and ``inputs`` is
        :math:`N_v`; for :math:`N_y = 1` there is no equality.
        """
        for name, value in (("p", p), ("outputs", outputs), ("q", q), ("inputs", inputs)):
            integer(name, value, 1)
        n = p * outputs
        A, B = np.full((n, n), np.nan), np.full((n, q * inputs), np.nan)
        A[p:], B[p:] = np.eye(n)[: n - p], 0.0
        return cls.entries(A, B)

    def __and__(self, other: LinearConstraints) -> LinearConstraints:
        """Return the equalities of both."""
        instance("the right operand of &", other, LinearConstraints)
        if self.M.shape[1] != other.M.shape[1]:
            raise InputError(
                f"both must constrain models of the same size, got {self.M.shape[1]} and {other.M.shape[1]} parameters"
            )
        return LinearConstraints(np.concatenate([self.M, other.M]), np.concatenate([self.b, other.b]))

    @cached_property
    def null_space(self) -> Array:
        """An orthonormal basis of the directions in which theta may move, shape (n (n + q), freedom)."""
        return locked(_null_space(self.M))

    @cached_property
    def _within_rows(self) -> dict[int, list[Array] | None]:
        return {}

    def within_rows(self, n: int) -> list[Array] | None:
        """Return orthonormal bases, shapes (n + q, freedom), of the directions in which each row of [A B] may move.

        None if an equality couples two of the n rows.
        """
        if n not in self._within_rows:
            by_row = self.M.reshape(len(self.M), self.M.shape[1] // n, n)
            touched = np.any(by_row, axis=1)
            apart = bool(np.all(np.sum(touched, axis=1) <= 1))
            rows = [by_row[touched[:, i], :, i] for i in range(n)]
            self._within_rows[n] = [_null_space(M) for M in rows] if apart else None
        return self._within_rows[n]

    def check(self, name: str, model: SignalModel) -> None:
        """Raise InputError, with the largest violation, if a model has another size or violates the equalities."""
        instance(name, model, SignalModel)
        theta = model.theta
        if theta.shape[-1] != self.M.shape[1]:
            raise InputError(
                f"the constraints must have columns for the {theta.shape[-1]} parameters of {name}, "
                f"got {self.M.shape[1]} columns"
            )
        left = np.abs(theta @ self.M.T - self.b)
        # Rounding leaves a known zero at the error of the other entries, so the largest entry sets the scale.
        size = np.max(np.abs(theta), axis=-1, keepdims=True) * np.sum(np.abs(self.M), axis=1) + np.abs(self.b)
        if np.any(left > _MET_RTOL * size):
            raise InputError(
                f"{name} must satisfy the equalities (M theta = b), got a violation of {left.max():.3g}; "
                "start from constraints.nearest(model)"
            )

    def nearest(self, model: SignalModel) -> SignalModel:
        """Return the model that satisfies the equalities and is nearest to this one in the sum of squares."""
        instance("model", model, SignalModel)
        theta = model.theta
        if theta.shape[-1] != self.M.shape[1]:
            raise InputError(f"the model must have {self.M.shape[1]} parameters, got {theta.shape[-1]}")
        if not len(self.b):
            return model
        known = _least_norm(self.M, self.b)
        return SignalModel.from_theta(known + (theta @ self.null_space) @ self.null_space.T, model.n, model.q)


def _least_norm(M: Array, b: Array) -> Array:
    from scipy.linalg import lstsq  # imported here, because loading it takes long

    return np.asarray(lstsq(M, b)[0])


def _null_space(M: Array) -> Array:
    from scipy.linalg import null_space  # likewise

    return np.asarray(null_space(M)) if len(M) else np.eye(M.shape[1])
