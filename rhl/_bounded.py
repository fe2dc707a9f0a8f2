"""V1 with bounds on the inputs: the quadratic programme that remains where the free plan leaves them."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from rhl._checks import Array
from rhl.errors import NotFiniteError, NotSolvedError

# What the solver is asked for, and what it must reach: bounds kept to that share of their width, and the cost of w to
# that share of what clipping costs. Its dual residual says less, since it grows with the condition of the weights.
_ASKED, _ACCEPTED, _ITERATIONS = 1e-10, 1e-7, 60


def pushes(A: Array, B: Array, K: Array, V: Array, x: Array, low: Array, high: Array, summed: bool) -> Array:
    r"""Return what is added to the inputs -K_i x_i so that they keep their bounds at the least cost, shape (N, q).

    With :math:`w_i = V_i (u_i + K_i x_i)` the cost is that of the free plan plus :math:`\sum_i |w_i|^2`, so that the
    programme is to find the shortest w within the bounds, whatever the condition of the weights. The recursion's K and
    V have shapes (N, q, n) and (N, q, q), x is the state at its start, and the bounds of u_i, or of u_0 + ... + u_i
    where ``summed``, have shape (q,).
    """
    N, q = K.shape[:2]
    inverse = np.linalg.inv(V)
    effect, free = np.empty((N, q, N * q)), np.empty((N, q))
    states, clipped, clipped_sum, squares = np.zeros((len(x), N * q)), x, np.zeros(q), 0.0
    for i in range(N):
        effect[i], free[i] = -K[i] @ states, -K[i] @ x
        effect[i][:, q * i : q * (i + 1)] += inverse[i]
        states, x = A @ states + B @ effect[i], A @ x + B @ free[i]
        # The feedback itself, clipped, is within the bounds: no longer than its is the shortest w.
        wanted = -K[i] @ clipped
        u = np.clip(clipped_sum + wanted, low, high) - clipped_sum
        clipped, squares = A @ clipped + B @ u, squares + float(np.sum((V[i] @ (u - wanted)) ** 2))
        clipped_sum = clipped_sum + u if summed else clipped_sum
    if summed:
        effect, free = np.cumsum(effect, axis=0), np.cumsum(free, axis=0)
    width, length = high - low, float(np.sqrt(squares))
    if not np.isfinite(length):
        raise NotFiniteError("the plan must stay in the range of floating-point numbers, got infinity in it")
    G = (effect / width[:, None]).reshape(N * q, N * q)
    below, above = (((edge - free) / width).ravel() for edge in (low, high))
    w = np.zeros(N * q)
    # Counted in its own length, the solution is as accurate as the solver; the first length may be far too long.
    while length > 0:
        w = length * _shortest(np.asfortranarray(length * G), below, above)
        before, length = length, float(np.linalg.norm(w))
        if length > 0.1 * before:
            break
    return np.asarray(np.einsum("iab,ib->ia", inverse, w.reshape(N, q)))


def _shortest(G: Array, below: Array, above: Array) -> Array:
    """Return the shortest w with below <= G w <= above."""
    solver = _piqp().DenseSolver()
    settings = solver.settings
    for name in ("eps_abs", "eps_rel", "eps_duality_gap_abs", "eps_duality_gap_rel"):
        setattr(settings, name, _ASKED)
    settings.max_iter = _ITERATIONS
    size = G.shape[1]
    solver.setup(np.eye(size, order="F"), np.zeros(size), None, None, G, below, above)
    status = solver.solve()
    info, w = solver.result.info, np.asarray(solver.result.x)
    if not (max(info.primal_res, info.duality_gap) <= _ACCEPTED and np.all(np.isfinite(w))):
        raise NotSolvedError(
            f"the plan within the bounds of the input must be found to {_ACCEPTED:g} of their width, got "
            f"{info.primal_res:.3g} ({status.name} by PIQP); shorten the horizon, or leave the bounds to the actuator"
        )
    return w


@cache
def _piqp() -> Any:
    import piqp  # here, because it is needed where a bound is active only

    return piqp
