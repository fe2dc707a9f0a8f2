"""Lifted signals x, u from past outputs and inputs, and Remark 4's augmentation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rhl._checks import Array, describe, instance, integer, real_array
from rhl.basis import Basis
from rhl.errors import InputError
from rhl.model import SignalModel


def remember(history: Array, newest: Array) -> Array:
    """Push ``newest`` (..., p) onto ``history`` (..., T, p), newest first, and drop the oldest row. Batches broadcast.

    Examples
    --------
    >>> remember(np.array([[2.0], [1.0]]), np.array([3.0])).ravel()
    array([3., 2.])
    """
    lead = np.broadcast_shapes(newest.shape[:-1], history.shape[:-2])
    kept = np.broadcast_to(history[..., :-1, :], (*lead, history.shape[-2] - 1, history.shape[-1]))
    return np.concatenate([np.broadcast_to(newest, (*lead, newest.shape[-1]))[..., None, :], kept], axis=-2)


@dataclass(frozen=True)
class DelayLifting:
    r"""Stack the last outputs and inputs, equations (14) and (22), and append optional functions of the outputs.

    .. math::
        w(k) = [y(k); \dots; y(k-N_y+1)], \qquad x(k) = [w(k); \varphi(w(k))], \qquad u(k) = [v(k); \dots; v(k-N_v+1)]

    Signals before k = 0 are zero, as in the paper (after equation (17)). u(k) holds stacked inputs only, so
    that v(k) can be read off it.

    Parameters
    ----------
    outputs, inputs : int
        :math:`\bar N_y` and :math:`\bar N_v`, at least 1.
    basis : Polynomials, Terms, Features or None
        :math:`\varphi`, functions of the stacked outputs that are zero at zero; None for none.

    Examples
    --------
    >>> lifting = DelayLifting(outputs=2, inputs=2)
    >>> y, v = np.array([[3.0], [2.0], [1.0]]), np.array([[30.0], [20.0], [10.0]])  # newest first
    >>> lifting.lift(y, count=2)  # x(k), x(k-1)
    array([[3., 2.],
           [2., 1.]])
    >>> lifting.augmented_state(y, v)
    array([ 3.,  2., 30.])
    """

    outputs: int
    inputs: int
    basis: Basis | None = None

    def __post_init__(self) -> None:
        integer("outputs", self.outputs, 1)
        integer("inputs", self.inputs, 1)
        if self.basis is not None and not (hasattr(self.basis, "count") and hasattr(self.basis, "features")):
            raise InputError(f"basis must be Polynomials, Terms, Features or None, got {describe(self.basis)}")

    def size(self, p: int) -> int:
        """Return n, the size of x(k), for outputs of size p."""
        integer("p", p, 1)
        return self.outputs * p + (0 if self.basis is None else self.basis.count(p, self.outputs))

    def output_size(self, n: int) -> int:
        """Return p, the size of the output, for which x(k) has n entries; InputError if there is none."""
        integer("n", n, 1)
        if self.basis is None:
            p = max(n // self.outputs, 1)
        else:
            # Terms refuse sizes without an output that they name, so sizes are tried from the largest down.
            fitting = [p for p in range(n // self.outputs, 0, -1) if self._is_size(p, n)]
            p = fitting[0] if fitting else 0
        if p == 0 or self.size(p) != n:
            raise InputError(
                f"the model's A must have an order that is a multiple of outputs = {self.outputs}"
                f"{'' if self.basis is None else ' plus the number of basis functions'}, got {n}"
            )
        return p

    def _is_size(self, p: int, n: int) -> bool:
        try:
            return self.size(p) == n
        except InputError:
            return False

    def lift(self, y_history: Array, count: int) -> Array:
        """Return x(k), x(k-1), ..., shape (..., count, n), of y(k), y(k-1), ...: count + outputs - 1 at least."""
        y_history = real_array("y_history", y_history, (None, None))
        stack = self.window(y_history, self.outputs, count)
        if self.basis is None:
            return stack
        return np.concatenate([stack, self.basis.features(stack, y_history.shape[-1])], axis=-1)

    def window(self, history: Array, depth: int, count: int, start: int = 0) -> Array:
        r"""Stack ``depth`` (:math:`\bar N_y` or :math:`\bar N_v`) consecutive rows, shape (..., count, depth * p).

        Each of the ``count`` stacks is one instant older than the one before; row ``start`` is the newest entry of the
        first. The history, shape (..., T, p), is newest first; InputError if it has fewer rows than that takes.
        """
        history = real_array("history", history, (None, None))
        needed = integer("start", start, 0) + integer("count", count, 1) + integer("depth", depth, 1) - 1
        if history.shape[-2] < needed:
            raise InputError(
                f"history must have at least {describe(needed)} rows for {describe(count)} stacks of {describe(depth)} "
                f"from row {describe(start)}, got {history.shape[-2]}"
            )
        rows = start + np.arange(count)[:, None] + np.arange(depth)[None, :]
        stacked = history[..., rows, :]
        return stacked.reshape(*stacked.shape[:-2], -1)

    def augmented_state(self, y_history: Array, v_history: Array) -> Array:
        """Return X(k) = [x(k); v(k-1);...;v(k-N_v+1)] of Remark 4, from y(k), y(k-1), ... and v(k-1), v(k-2), ..."""
        return self.with_past_inputs(self.lift(y_history, 1)[..., 0, :], v_history)

    def with_past_inputs(self, x: Array, v_history: Array) -> Array:
        """Return X(k) of Remark 4 from x(k), shape (..., n), already lifted, and v(k-1), v(k-2), ..."""
        if self.inputs == 1:
            return x
        past = self.window(v_history, self.inputs - 1, 1)[..., 0, :]
        return np.concatenate([x, np.broadcast_to(past, (*x.shape[:-1], past.shape[-1]))], axis=-1)

    def augment(self, model: SignalModel) -> SignalModel:
        r"""Give the lifted model the single input v(k) by carrying past inputs as states, Remark 4.

        .. math::
            X(k) = [x(k); v(k-1); \dots; v(k-N_v+1)], \qquad X(k+1) = A_a X(k) + B_a v(k)

        The map is affine in (A, B), so mixing commutes with it. B has shape (..., n, N_v q), newest input first;
        InputError if its columns are not a multiple of N_v.

        Examples
        --------
        >>> augmented = DelayLifting(outputs=1, inputs=2).augment(SignalModel([[0.5]], [[1.0, 2.0]]))
        >>> augmented.A
        array([[0.5, 2. ],
               [0. , 0. ]])
        >>> augmented.B.ravel()
        array([1., 1.])
        """
        instance("model", model, SignalModel)
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
