"""Lifted signals x, u from past outputs and inputs, and Remark 4's augmentation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rhl._checks import Array, InputError, integer
from rhl.model import SignalModel


def remember(history: Array, newest: Array) -> Array:
    """Push ``newest`` (..., p) onto ``history`` (..., T, p), newest first; the oldest row falls out.

    Examples
    --------
    >>> remember(np.array([[2.0], [1.0]]), np.array([3.0])).ravel()
    array([3., 2.])
    """
    return np.concatenate([newest[..., None, :], history[..., :-1, :]], axis=-2)


@dataclass(frozen=True)
class DelayLifting:
    r"""Stack the last outputs and inputs, equations (14) and (22).

    .. math::
        x(k) = [y(k); \dots; y(k-N_y+1)], \qquad u(k) = [v(k); \dots; v(k-N_v+1)]

    Parameters
    ----------
    outputs : int
        :math:`\bar N_y`, at least 1.
    inputs : int
        :math:`\bar N_v`, at least 1.

    Raises
    ------
    InputError
        If a length is not a whole number of at least 1.

    Notes
    -----
    Signals before k = 0 are zero, as in the paper (after equation (17)).

    Examples
    --------
    >>> lifting = DelayLifting(outputs=2, inputs=2)
    >>> y, v = np.array([[3.0], [2.0], [1.0]]), np.array([[30.0], [20.0], [10.0]])  # newest first
    >>> lifting.window(y, lifting.outputs, count=2)  # x(k), x(k-1)
    array([[3., 2.],
           [2., 1.]])
    >>> lifting.augmented_state(y, v)
    array([ 3.,  2., 30.])
    """

    outputs: int
    inputs: int

    def __post_init__(self) -> None:
        integer("outputs", self.outputs, 1)
        integer("inputs", self.inputs, 1)

    def window(self, history: Array, depth: int, count: int, start: int = 0) -> Array:
        r"""Stack ``depth`` consecutive rows, for ``count`` instants going back from row ``start``.

        Parameters
        ----------
        history : array, shape (..., T, p)
            Newest first.
        depth : int
            Rows in one stack (:math:`\bar N_y` or :math:`\bar N_v`).
        count : int
            Number of stacks.
        start : int
            Row of the newest entry of the first stack.

        Returns
        -------
        array, shape (..., count, depth * p)
        """
        rows = start + np.arange(count)[:, None] + np.arange(depth)[None, :]
        stacked = history[..., rows, :]
        return stacked.reshape(*stacked.shape[:-2], -1)

    def augmented_state(self, y_history: Array, v_history: Array) -> Array:
        """Return X(k) = [y(k);...;y(k-N_y+1); v(k-1);...;v(k-N_v+1)] of Remark 4.

        Parameters
        ----------
        y_history : array, shape (..., T, p)
            y(k), y(k-1), ...
        v_history : array, shape (..., T, q)
            v(k-1), v(k-2), ...

        Returns
        -------
        array, shape (..., N_y p + (N_v - 1) q)
        """
        x = self.window(y_history, self.outputs, 1)[..., 0, :]
        if self.inputs == 1:
            return x
        past = self.window(v_history, self.inputs - 1, 1)[..., 0, :]
        return np.concatenate([x, past], axis=-1)

    def augment(self, model: SignalModel) -> SignalModel:
        r"""Give the lifted model the single input v(k) by carrying past inputs as states, Remark 4.

        .. math::
            X(k) = [x(k); v(k-1); \dots; v(k-N_v+1)], \qquad X(k+1) = A_a X(k) + B_a v(k)

        Parameters
        ----------
        model : SignalModel
            Lifted model (A, B), B of shape (..., n, N_v q), newest input first.

        Returns
        -------
        SignalModel
            Of sizes n + (N_v - 1) q and q. The map is affine in (A, B), so mixing commutes with it.

        Raises
        ------
        InputError
            If the columns of B are not a multiple of N_v.

        Examples
        --------
        >>> augmented = DelayLifting(outputs=1, inputs=2).augment(SignalModel([[0.5]], [[1.0, 2.0]]))
        >>> augmented.A
        array([[0.5, 2. ],
               [0. , 0. ]])
        >>> augmented.B.ravel()
        array([1., 1.])
        """
        if model.q % self.inputs:
            raise InputError(
                f"the model's input size must be a multiple of inputs = {self.inputs}, which u stacks, got {model.q}"
            )
        n, q = model.n, model.q // self.inputs
        past = (self.inputs - 1) * q
        lead = model.A.shape[:-2]
        A = np.zeros((*lead, n + past, n + past))
        B = np.zeros((*lead, n + past, q))
        A[..., :n, :n] = model.A
        A[..., :n, n:] = model.B[..., q:]
        A[..., n + q :, n : n + past - q] = np.eye(max(past - q, 0))
        B[..., :n, :] = model.B[..., :q]
        B[..., n : n + q, :] = np.eye(q)[: min(q, past)]
        return SignalModel(A, B)
