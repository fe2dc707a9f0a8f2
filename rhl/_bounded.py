"""V1 with bounds on the inputs: the quadratic programme to solve where the free plan violates them."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from rhl._checks import Array
from rhl.errors import NotFiniteError, NotSolvedError

# The tolerance set for the interior-point method, and the one required: the violation of bounds relative to their
# width, and the error in the cost of w relative to the cost of clipping. The dual residual is less informative, since
# it grows with the condition number of the weights.
_ASKED, _ACCEPTED, _ITERATIONS = 1e-10, 1e-7, 60
# The active-set method stops if a step lowers the cost by less than this share; its steps per input of the plan.
_LOWERED, _STEPS = 1e-12, 20


def inputs_within(A: Array, B: Array, K: Array, V: Array, x: Array, low: Array, high: Array, summed: bool) -> Array:
    r"""Return the inputs of the optimal plan within the bounds, shape (N, q).

    With :math:`w_i = V_i (u_i + K_i x_i)` the cost is that of the free plan plus :math:`\sum_i |w_i|^2`, so that the
    programme is to minimise the norm of w within the bounds. The recursion's K and V have shapes (N, q, n) and (N, q,
    q), x is the state at its start, and the bounds of u_i, or of u_0 + ... + u_i where ``summed``, have shape (q,).

    An interior-point method (PIQP) solves most problems in a millisecond. If it misses its
    tolerance, or its solution has another cost than reported, an active-set method (scipy's BVLS) solves the same least
    squares too. This happens with widely different weights, or when the state grows so far that -K x and its correction
    cancel. The clipped feedback -K x is another candidate; the plan of least cost is returned.
    """
    N, q = K.shape[:2]
    clipped = _clipped(A, B, K, x, low, high, summed)
    length = float(np.sqrt(_cost(A, B, K, V, x, clipped)))
    if not np.isfinite(length):
        raise NotFiniteError("the plan must stay in the range of floating-point numbers, got infinity in it")
    if length == 0:
        return clipped
    found = [(length**2, clipped)]
    inverse = np.linalg.inv(V)
    effect, free = np.empty((N, q, N * q)), np.empty((N, q))
    states, start = np.zeros((len(x), N * q)), x
    for i in range(N):
        effect[i], free[i] = -K[i] @ states, -K[i] @ start
        effect[i][:, q * i : q * (i + 1)] += inverse[i]
        states, start = A @ states + B @ effect[i], A @ start + B @ free[i]
    if summed:
        effect, free = np.cumsum(effect, axis=0), np.cumsum(free, axis=0)
    width = high - low
    G = (effect / width[:, None]).reshape(N * q, N * q)
    below, above = (((edge - free) / width).ravel() for edge in (low, high))
    w: Array | None = np.zeros(N * q)
    # Scaled by its own norm, the solution is as accurate as the solver; the first norm may be far too large.
    while length > 0 and w is not None and np.all(np.isfinite(length * G)):
        before, w = length, _interior(np.asfortranarray(length * G), below, above)
        if w is not None:
            w = before * w
            length = float(np.linalg.norm(w))
            if length > 0.1 * before:
                break
    trusted = False
    if w is not None and length > 0:
        u = _kept(free + (effect.reshape(N * q, N * q) @ w).reshape(N, q), low, high, summed)
        cost = _cost(A, B, K, V, x, u)
        found.append((cost, u))
        trusted = abs(cost - length**2) <= _ACCEPTED**0.5 * length**2
    if not trusted:
        u = _active_set(A, B, K, V, x, low, high, summed)
        found.append((_cost(A, B, K, V, x, u), u))
    return min(found, key=lambda one: one[0] if np.isfinite(one[0]) else np.inf)[1]


def _cost(A: Array, B: Array, K: Array, V: Array, x: Array, u: Array) -> float:
    """Return the cost of inputs above that of the free plan, |w|^2."""
    total = 0.0
    with np.errstate(over="ignore", invalid="ignore"):
        for gain, root, one in zip(K, V, u, strict=True):
            total += float(np.sum((root @ (one + gain @ x)) ** 2))
            x = A @ x + B @ one
    return total


def _kept(v: Array, low: Array, high: Array, summed: bool) -> Array:
    """Clip the bounded quantities exactly, and return the inputs."""
    v = np.clip(v, low, high)
    return np.diff(v, axis=0, prepend=0.0) if summed else v


def _clipped(A: Array, B: Array, K: Array, x: Array, low: Array, high: Array, summed: bool) -> Array:
    """Return the clipped feedback -K x, which keeps the bounds."""
    total, u = np.zeros(len(low)), np.empty(K.shape[:2])
    with np.errstate(over="ignore", invalid="ignore"):
        for i, gain in enumerate(K):
            u[i] = np.clip(total - gain @ x, low, high) - total
            x, total = A @ x + B @ u[i], total + u[i] if summed else total
    return u


def _interior(G: Array, below: Array, above: Array) -> Array | None:
    """Return the shortest w with below <= G w <= above, or None if the tolerance was not reached."""
    solver = _piqp().DenseSolver()
    settings, size = solver.settings, G.shape[1]
    for name in ("eps_abs", "eps_rel", "eps_duality_gap_abs", "eps_duality_gap_rel"):
        setattr(settings, name, _ASKED)
    settings.max_iter = _ITERATIONS
    solver.setup(np.eye(size, order="F"), np.zeros(size), None, None, G, below, above)
    solver.solve()
    info, w = solver.result.info, np.asarray(solver.result.x)
    reached = max(info.primal_res, info.duality_gap) <= _ACCEPTED and np.all(np.isfinite(w))
    return w if reached else None


def _active_set(A: Array, B: Array, K: Array, V: Array, x: Array, low: Array, high: Array, summed: bool) -> Array:
    """Return the same inputs by an active-set method, with w as a function of the bounded quantities."""
    from scipy.optimize import lsq_linear  # imported here, because few plans need it

    N, q = K.shape[:2]
    of, offset = np.empty((N, q, N * q)), np.empty((N, q))
    states, start = np.zeros((len(x), N * q)), x
    inputs = np.eye(N * q) - (np.eye(N * q, k=-q) if summed else 0.0)
    for i in range(N):
        u = inputs[q * i : q * (i + 1)]
        of[i], offset[i] = V[i] @ (u + K[i] @ states), V[i] @ (K[i] @ start)
        states, start = A @ states + B @ u, A @ start
    bounds, steps = (np.tile(low, N), np.tile(high, N)), max(1, _STEPS * N * q)
    matrix, target = of.reshape(N * q, N * q), -offset.ravel()
    found = lsq_linear(matrix, target, bounds, method="bvls", tol=_LOWERED, max_iter=steps)
    if found.status == 0:
        raise NotSolvedError(
            f"the plan within the input bounds must be found in {steps} active-set steps, got none; "
            "shorten the horizon, or leave the bounds to the actuator"
        )
    return _kept(found.x.reshape(N, q), low, high, summed)


@cache
def _piqp() -> Any:
    import piqp  # imported here, because it is needed only if a bound is active

    return piqp
