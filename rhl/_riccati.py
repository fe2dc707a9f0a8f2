"""One step back of the Riccati recursion, in square-root form, and the least steering of a terminal state."""

from __future__ import annotations

import numpy as np

from rhl._checks import Array

# A direction counts as steerable if its gain exceeds this share of what it was computed from; 1e3 roundings.
_RANK_RTOL = 1e-13


def cost_step(S: Array, A: Array, B: Array, Q_factor: Array, R_factor: Array) -> tuple[Array, Array, Array]:
    r"""Take the Riccati recursion one step back, in square-root form.

    .. math:: |S' x|^2 = \min_u |Q^{1/2} x|^2 + |R^{1/2} u|^2 + |S (A x + B u)|^2

    Parameters
    ----------
    S : array, shape (..., rows, n')
        Factor of the cost to go after the step.
    A, B : array, shapes (..., n', n) and (..., n', q)
        The step.
    Q_factor, R_factor : array, shapes (..., c, c) and (..., q, q)
        Upper factors with Q = Q_factor' Q_factor; Q acts on the first c entries of the state.

    Returns
    -------
    K : array, shape (..., q, n)
        The minimiser is u = -K x.
    V : array, shape (..., q, q)
        What another input costs: |V (u + K x)|^2 more.
    S : array, shape (..., n, n)
        Upper factor of the cost to go before the step.
    """
    n, q, c = A.shape[-1], B.shape[-1], Q_factor.shape[-1]
    SB, SA = S @ B, S @ A
    lead = np.broadcast_shapes(SB.shape[:-2], SA.shape[:-2], Q_factor.shape[:-2], R_factor.shape[:-2])
    rows = SB.shape[-2]
    stack = np.zeros((*lead, q + rows + c, q + n))
    stack[..., :q, :q] = R_factor
    stack[..., q : q + rows, :q] = SB
    stack[..., q : q + rows, q:] = SA
    stack[..., q + rows :, q : q + c] = Q_factor
    # A reflection rounds every row to the size of those above it, so small rows must not stand above large ones.
    order = np.argsort(-np.max(np.abs(stack), axis=-1), axis=-1)
    upper = np.asarray(np.linalg.qr(np.take_along_axis(stack, order[..., None], axis=-2), mode="r"))
    V = upper[..., :q, :q]
    return np.linalg.solve(V, upper[..., :q, q:]), V, upper[..., q:, q:]


def truncated_min_norm(steering: Array, wanted: Array, noise: Array) -> Array:
    """Return the shortest w that brings ``steering`` @ w as near to ``wanted`` as it can be, shape (..., columns).

    Parameters
    ----------
    steering : array, shape (..., rows, columns)
        How the terminal state follows w.
    wanted : array, shape (..., rows)
        What it is to be.
    noise : array, shape (..., columns)
        For each column, the size of the products it was computed from. A direction counts as steerable if its singular
        value exceeds their rounding, which reaches it through the columns that it uses.
    """
    left, size, right = np.linalg.svd(steering, full_matrices=False)
    kept = size > _RANK_RTOL * np.linalg.norm(noise[..., None, :] * right, axis=-1)
    inverse = np.where(kept, 1 / np.where(kept, size, 1.0), 0.0)
    return np.einsum("...ba,...b->...a", right, inverse * np.einsum("...ab,...a->...b", left, wanted))
