"""Signal models x(k+1) = A x(k) + B u(k), their parameter vector and their predictor maps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from rhl._checks import Array, choice, common_batch, instance, integer, real_array, square
from rhl.errors import InputError

InputMatrix = Literal["last-row-of-ones", "eye-last-row-of-ones"]


@dataclass(frozen=True, eq=False)
class PredictorMaps:
    r"""Linear predictor maps of general form, equation (5).

    .. math:: P_i(x_0, u_0, \dots, u_{i-1}) = A_i x_0 + \sum_{l=0}^{i-1} B_{i-1-l} u_l

    They need not be powers of one matrix (Assumption 4(a)). InputError if shapes do not fit or :math:`A_0` is not I.

    Parameters
    ----------
    A, B : array_like, shapes (..., N+1, n, n) and (..., N, n, q)
        The maps :math:`A_0 = I, A_1, \dots, A_N` and :math:`B_0, \dots, B_{N-1}`.

    Examples
    --------
    >>> maps = PredictorMaps(A=[[[1.0]], [[2.0]], [[4.0]]], B=[[[1.0]], [[2.0]]])
    >>> maps.predict([3.0], [[0.0], [1.0]]).ravel()
    array([ 3.,  6., 13.])
    """

    A: Array
    B: Array

    def __post_init__(self) -> None:
        A = real_array("A", self.A, (None, None, None))
        n, count = A.shape[-1], A.shape[-3]
        if A.shape[-2] != n or count < 2:
            raise InputError(f"A must have shape (N+1, n, n) with N at least 1, got {A.shape}")
        B = real_array("B", self.B, (count - 1, n, None))
        common_batch(A=(A, 3), B=(B, 3))
        if not np.array_equal(A[..., 0, :, :], np.broadcast_to(np.eye(n), (*A.shape[:-3], n, n))):
            raise InputError(
                "A[0] must be the identity (a prediction over no step is the state itself), got another matrix"
            )
        object.__setattr__(self, "A", A)
        object.__setattr__(self, "B", B)

    @property
    def n(self) -> int:
        """Size of the signal x."""
        return int(self.A.shape[-1])

    @property
    def q(self) -> int:
        """Size of the input u."""
        return int(self.B.shape[-1])

    @property
    def horizon(self) -> int:
        """The last step N that the maps predict."""
        return int(self.B.shape[-3])

    def predict(self, x0: ArrayLike, u: ArrayLike) -> Array:
        """Predict x_0 ... x_N, shape (..., N+1, n), from x_0 and u, shape (..., N, q), by equation (5)."""
        x0 = real_array("x0", x0, (self.n,))
        u = real_array("u", u, (self.horizon, self.q))
        common_batch(A=(self.A, 3), B=(self.B, 3), x0=(x0, 1), u=(u, 2))
        free = np.einsum("...iab,...b->...ia", self.A, x0)
        forced = [np.zeros_like(free[..., 0, :])]
        for i in range(1, self.horizon + 1):
            forced.append(np.einsum("...lab,...lb->...a", self.B[..., i - 1 :: -1, :, :], u[..., :i, :]))
        return free + np.stack(np.broadcast_arrays(*forced), axis=-2)


@dataclass(frozen=True, eq=False)
class SignalModel:
    """The signal model :math:`x(k+1) = A x(k) + B u(k)`, equation (18).

    It reproduces one trajectory (Assumption 7) and need not be a model of the plant (Remark 3).

    Parameters
    ----------
    A, B : array_like, shapes (..., n, n) and (..., n, q)
        Signal and input matrix; InputError if A is not square, the shapes do not fit, or an entry is not finite.

    Examples
    --------
    >>> model = SignalModel([[0.0, 1.0], [1.0, 1.0]], [[0.0], [1.0]])
    >>> model.theta
    array([0., 1., 1., 1., 0., 1.])
    """

    A: Array
    B: Array

    def __post_init__(self) -> None:
        A = square("A", self.A)
        B = real_array("B", self.B, (A.shape[-1], None))
        lead = common_batch(A=(A, 2), B=(B, 2))
        object.__setattr__(self, "A", np.broadcast_to(A, (*lead, *A.shape[-2:])))
        object.__setattr__(self, "B", np.broadcast_to(B, (*lead, *B.shape[-2:])))

    @property
    def n(self) -> int:
        """Size of the signal x."""
        return int(self.A.shape[-1])

    @property
    def q(self) -> int:
        """Size of the input u."""
        return int(self.B.shape[-1])

    @property
    def theta(self) -> Array:
        """The parameter vector [vec(A); vec(B)], column by column, shape (..., n(n+q)) (Remark 2)."""
        return np.concatenate([M.swapaxes(-1, -2).reshape(*M.shape[:-2], -1) for M in (self.A, self.B)], axis=-1)

    @classmethod
    def from_theta(cls, theta: ArrayLike, n: int, q: int) -> SignalModel:
        """Unpack theta = [vec(A); vec(B)], shape (..., n(n+q)), column by column (Theorem 2(ii)).

        Examples
        --------
        >>> SignalModel.from_theta([1.0, 2.0, 3.0, 4.0, 5.0, 6.0], n=2, q=1).A
        array([[1., 3.],
               [2., 4.]])
        """
        n, q = integer("n", n, 1), integer("q", q, 1)
        theta = real_array("theta", theta, (n * (n + q),))
        lead = theta.shape[:-1]
        A = theta[..., : n * n].reshape(*lead, n, n).swapaxes(-1, -2)
        B = theta[..., n * n :].reshape(*lead, q, n).swapaxes(-1, -2)
        return cls(A, B)

    @classmethod
    def companion_of_ones(cls, n: int, q: int, inputs: InputMatrix = "last-row-of-ones") -> SignalModel:
        """Build the controllable initial model behind the paper's data.

        A(0) has ones above the diagonal and in the last row. The paper only says "a controllable signal model" (Section
        VI); this one was inferred from the published curves. B(0) is zero except for a last row of ones
        ("last-row-of-ones", linear example), or the first q columns of the identity with their last row set to ones
        ("eye-last-row-of-ones", robot arm).

        Examples
        --------
        >>> SignalModel.companion_of_ones(2, 1).A
        array([[0., 1.],
               [1., 1.]])
        """
        n, q = integer("n", n, 1), integer("q", q, 1)
        choice("inputs", inputs, get_args(InputMatrix))
        A = np.eye(n, k=1)
        A[-1] = 1.0
        B = np.zeros((n, q)) if inputs == "last-row-of-ones" else np.eye(n, q)
        B[-1] = 1.0
        return cls(A, B)

    @classmethod
    def shift_of_ones(cls, p: int, outputs: int, q: int, inputs: int) -> SignalModel:
        """Build an initial model that shifts stacked outputs and contains no other knowledge.

        The first p rows of A and B, which predict y(k+1), are ones; the others are those of a delay lifting of that
        many outputs and inputs, which ``LinearConstraints.shift`` holds fixed.

        Examples
        --------
        >>> SignalModel.shift_of_ones(1, 2, 1, 1).A
        array([[1., 1.],
               [1., 0.]])
        """
        for name, value in (("p", p), ("outputs", outputs), ("q", q), ("inputs", inputs)):
            integer(name, value, 1)
        n = p * outputs
        A, B = np.eye(n, k=-p), np.zeros((n, q * inputs))
        A[:p], B[:p] = 1.0, 1.0
        return cls(A, B)

    def step(self, x: ArrayLike, u: ArrayLike) -> Array:
        """Return A x + B u, shape (..., n), equation (18).

        Examples
        --------
        >>> SignalModel([[0.5]], [[1.0]]).step([2.0], [1.0])
        array([2.])
        """
        x = real_array("x", x, (self.n,))
        u = real_array("u", u, (self.q,))
        common_batch(A=(self.A, 2), x=(x, 1), u=(u, 1))
        return np.einsum("...ab,...b->...a", self.A, x) + np.einsum("...ab,...b->...a", self.B, u)

    def predictor(self, horizon: int) -> PredictorMaps:
        r"""Return the predictor maps :math:`A_i = A^i`, :math:`B_i = A^i B` up to the horizon, equation (21).

        Examples
        --------
        >>> SignalModel([[2.0]], [[1.0]]).predictor(3).A.ravel()
        array([1., 2., 4., 8.])
        """
        horizon = integer("horizon", horizon, 1)
        powers = [np.broadcast_to(np.eye(self.n), self.A.shape)]
        with np.errstate(over="ignore", invalid="ignore"):
            for _ in range(horizon):
                powers.append(self.A @ powers[-1])
            A = np.stack(powers, axis=-3)
            return PredictorMaps(A, A[..., :-1, :, :] @ self.B[..., None, :, :])

    def counted(self, of_x: Array, of_u: Array) -> SignalModel:
        """Return the model of the rescaled signals: x times of_x, shape (..., n), and u times of_u, (..., q).

        Examples
        --------
        >>> metres = SignalModel([[0.5]], [[2.0]])
        >>> metres.counted(np.array([1000.0]), np.array([1.0])).B  # x in millimetres
        array([[2000.]])
        """
        rows = of_x[..., :, None]
        return SignalModel(rows * self.A / of_x[..., None, :], rows * self.B / of_u[..., None, :])

    def mix(self, other: SignalModel, lam: ArrayLike) -> SignalModel:
        """Return (1 - lam) * self + lam * other with lam in [0, 1], shape (...), as in equation (15) and Lemma 5.

        Examples
        --------
        >>> SignalModel([[1.0]], [[0.0]]).mix(SignalModel([[0.0]], [[1.0]]), 0.25).theta
        array([0.75, 0.25])
        """
        instance("other", other, SignalModel)
        if (self.n, self.q) != (other.n, other.q):
            raise InputError(f"other must have sizes n = {self.n}, q = {self.q}, got {other.n} and {other.q}")
        lam = real_array("lam", lam)
        if np.any((lam < 0) | (lam > 1)):
            raise InputError(f"lam must be in [0, 1], got {lam.min() if np.any(lam < 0) else lam.max()}")
        common_batch(A=(self.A, 2), other=(other.A, 2), lam=(lam, 0))
        share = lam[..., None, None]
        return SignalModel((1 - share) * self.A + share * other.A, (1 - share) * self.B + share * other.B)
