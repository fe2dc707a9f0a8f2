"""The recursion behind V1, V2 and V3 for batches of any shape, and the least-norm input to a terminal state."""

from __future__ import annotations

import numpy as np

from rhl._checks import Array
from rhl._lanes import blocks, from_lanes, to_lanes

# A direction is controllable if its gain exceeds this share of the numbers it was computed from; 1e3 roundings.
_RANK_RTOL = 1e-13
_EPS = np.finfo(np.float64).eps


def gains(S: Array, A: Array, B: Array, Q_factor: Array, R_factor: Array, horizon: int) -> tuple[Array, Array, Array]:
    r"""Run the Riccati recursion backwards over a horizon N, in square-root form.

    .. math:: |S' x|^2 = \min_u |Q^{1/2} x|^2 + |R^{1/2} u|^2 + |S (A x + B u)|^2

    A and B, shapes (..., n, n) and (..., n, q), are one stage's step. S, (..., n, n), is the upper factor of the cost
    to go after the last stage; those of Q = Q_factor' Q_factor and R have shapes (..., c, c) and (..., q, q), and Q
    acts on the first c entries of the state.

    Returns
    -------
    K : array, shape (..., N, q, n)
        The minimiser at stage i is u = -K_i x.
    V : array, shape (..., N, q, q)
        Another input increases the cost by |V_i (u + K_i x)|^2.
    S : array, shape (..., n, n)
        Upper factor of the cost to go before the first stage.
    """
    from rhl.kernels import loops  # imported here, because loading the compiler takes longer than the rest

    arrays = (S, A, B, Q_factor, R_factor)
    lead = np.broadcast_shapes(*(M.shape[:-2] for M in arrays))
    S, A, B, Q_factor, R_factor = (to_lanes(M, lead, 2) for M in arrays)
    M = np.concatenate([B, A], axis=1)
    (n, q), members = B.shape[:2], B.shape[2]
    K, V = np.empty((horizon, q, n, members)), np.empty((horizon, q, q, members))
    for part in blocks(members):
        k, w = np.empty((horizon, q, n, part.stop - part.start)), np.empty((horizon, q, q, part.stop - part.start))
        s, m, stage_Q, stage_R = (np.ascontiguousarray(array[..., part]) for array in (S, M, Q_factor, R_factor))
        loops.recursion(s, m, stage_Q, stage_R, k, w)
        K[..., part], V[..., part], S[..., part] = k, w, s
    return from_lanes(K, lead), from_lanes(V, lead), from_lanes(S, lead)


def rollout(A: Array, B: Array, K: Array, push: Array, x: Array) -> tuple[Array, Array]:
    """Simulate u_i = push_i - K_i x_i from x; return u, shape (..., N, q), and x_0 ... x_N, shape (..., N+1, n).

    A and B, shapes (..., n, n) and (..., n, q), are one stage's step; K has shape (..., N, q, n), push (..., N, q), and
    x, the start, (..., n).
    """
    from rhl.kernels import loops

    lead = np.broadcast_shapes(A.shape[:-2], B.shape[:-2], K.shape[:-3], push.shape[:-2], x.shape[:-1])
    M = np.concatenate([to_lanes(B, lead, 2), to_lanes(A, lead, 2)], axis=1)
    states = np.empty((K.shape[-3] + 1, *M.shape[::2]))
    states[0] = to_lanes(x, lead, 1)
    u = to_lanes(push, lead, 2)
    loops.rollout(M, to_lanes(K, lead, 3), states, u)
    return from_lanes(u, lead), from_lanes(states, lead)


def truncated_min_norm(steering: Array, wanted: Array, noise: Array) -> Array:
    """Return the least-norm w that minimises |``steering`` @ w - ``wanted``|, shape (..., columns).

    ``steering``, shape (..., rows, columns), maps w to the terminal state, ``wanted``, shape (..., rows), is its
    target, and ``noise``, shape (..., columns), is the size of the products that each column was computed from. A
    direction counts as controllable if its singular value exceeds the rounding of the columns that it uses and that of
    the decomposition. A column of zeros has no rounding error.
    """
    left, size, right = np.linalg.svd(steering, full_matrices=False)
    of_columns = _RANK_RTOL * np.linalg.norm(noise[..., None, :] * right, axis=-1)
    kept = size > np.maximum(of_columns, max(steering.shape[-2:]) * _EPS * size[..., :1])
    inverse = np.where(kept, 1 / np.where(kept, size, 1.0), 0.0)
    return np.einsum("...ba,...b->...a", right, inverse * np.einsum("...ab,...a->...b", left, wanted))
