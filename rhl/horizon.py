"""One accurate solver for the finite-horizon problems V1, V2 and V3."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from rhl._bounded import inputs_within
from rhl._checks import Array, common_batch, instance, positive, read_only, real_array
from rhl._riccati import gains, rollout, truncated_min_norm
from rhl.errors import InfeasibleError, NotFiniteError
from rhl.model import PredictorMaps, SignalModel
from rhl.problems import V1, V2, V3, InputBounds, Predictor, Problem

# V3 is infeasible if the terminal state misses r by more than this share of max(|x|, |r|) and of the largest |x_i|.
_FEASIBLE_RTOL = 1e-9

# An input counts as at its bound within this share of the bounds' width, the root of the solver's tolerance.
_AT_BOUND = 1e-5

# Terminal rows whose singular value is below this share of the largest are rounding.
_HELD_RTOL = 1e-13


@dataclass(frozen=True, eq=False)
class Plan:
    """A solution of V1, V2 or V3: inputs and predicted signals, with a certificate.

    Attributes
    ----------
    problem : V1, V2 or V3
        The problem that was solved.
    u : array, shape (..., N, q)
        Optimal inputs u_0 ... u_{N-1}; the scheme applies the first.
    x : array, shape (..., N+1, n)
        Predicted signals x_0 ... x_N.
    """

    problem: Problem
    u: Array
    x: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "u", read_only(self.u))
        object.__setattr__(self, "x", read_only(self.x))

    @property
    def value(self) -> Array:
        """The objective at this plan, recomputed from the problem, shape (...)."""
        problem, end = self.problem, self.x[..., -1, :]
        if isinstance(problem, V2):
            return _quadratic(end, problem.QN)
        stages = _quadratic(self.x[..., :-1, :], problem.Q, along=True) + _quadratic(self.u, problem.R, along=True)
        total = np.sum(stages, axis=-1)
        return total + problem.weight * _quadratic(end, problem.QN) if isinstance(problem, V1) else total

    def is_optimal(self, tol: float = 1e-9) -> bool:
        """Whether :meth:`residual` is at most ``tol``, in every member of a batch."""
        return bool(np.all(self.residual() <= positive("tol", tol)))

    def residual(self) -> Array:
        """Recompute the optimality conditions from the problem; return their largest relative violation, shape (...).

        The largest of: how far x is from the prediction (5) under u; how far the gradient of the objective along
        feasible directions is from zero; in V3, how far x_N is from r; with bounds, how far the inputs are outside of
        them, relative to their width. Each of the others is relative to the sum of the absolute values of the terms
        that cancel in it, so the best attainable value is about 1e-15. With an active bound it is about 1e-7, the root
        of the tolerance of the quadratic programme. If an unstable model grows along the horizon, the terms that cancel
        are large, and a small residual means little.
        """
        problem = self.problem
        maps = problem.model if isinstance(problem.model, PredictorMaps) else problem.model.predictor(problem.horizon)
        start, end, effect = self.x[..., 0, :], self.x[..., -1, :], _effect(maps)
        predicted = maps.predict(start, self.u)
        reach = PredictorMaps(np.abs(maps.A), np.abs(maps.B)).predict(np.abs(start), np.abs(self.u))
        gaps = [_relative(predicted - self.x, reach)]
        if isinstance(problem, V3):
            gaps.append(_relative((end - problem.r)[..., None, :], reach[..., -1:, :]))

        # The gradient with respect to x, then u; and the same sums with absolute values throughout.
        pull, pull_size = np.zeros_like(self.x), np.zeros_like(reach)
        push, push_size = np.zeros_like(self.u), np.zeros_like(self.u)
        if not isinstance(problem, V2):
            pull[..., :-1, :] = _rows(problem.Q, self.x[..., :-1, :])
            pull_size[..., :-1, :] = _rows(np.abs(problem.Q), reach[..., :-1, :])
            push, push_size = _rows(problem.R, self.u), _rows(np.abs(problem.R), np.abs(self.u))
        if not isinstance(problem, V3):
            weight = np.asarray(problem.weight if isinstance(problem, V1) else 1.0)[..., None, None]
            pull[..., -1:, :] = weight * _rows(problem.QN, self.x[..., -1:, :])
            pull_size[..., -1:, :] = weight * _rows(np.abs(problem.QN), reach[..., -1:, :])
        gradient = push + np.einsum("...iajb,...ia->...jb", effect, pull)
        size = push_size + np.einsum("...iajb,...ia->...jb", np.abs(effect), pull_size)
        if isinstance(problem, V1) and problem.bounds is not None:
            outside, gradient, size = _held(problem.bounds, self.u, gradient, size)
            gaps.append(outside)
        if isinstance(problem, V3):
            # The multiplier of r accounts for the part of the gradient in the span of the terminal rows.
            rows = effect[..., -1, :, :, :].reshape(*effect.shape[:-4], maps.n, -1)
            flat = gradient.reshape(*gradient.shape[:-2], -1, 1)
            basis, strength, _ = np.linalg.svd(rows.swapaxes(-1, -2), full_matrices=False)
            basis = basis * (strength > _HELD_RTOL * strength[..., :1])[..., None, :]
            gradient = (flat - basis @ (basis.swapaxes(-1, -2) @ flat)).reshape(gradient.shape)
        gaps.append(_relative(gradient, size))
        return np.asarray(np.max(np.stack(np.broadcast_arrays(*gaps)), axis=0))


def solve(problem: Problem, x: ArrayLike) -> Plan:
    r"""Solve V1, V2 or V3, equations (3), (10), (11), from the signal x.

    Parameters
    ----------
    problem : V1, V2 or V3
        The problem.
    x : array_like, shape (..., n)
        Present signal; leading axes broadcast with those of the model and the weights.

    Raises
    ------
    InfeasibleError
        If V3's terminal state cannot be reached.
    NotSolvedError
        If the quadratic programme with bounds is not solved to its tolerance.
    InputError
        If x has another size or is not finite, batch axes do not broadcast, or the plan overflows (NotFiniteError).

    Notes
    -----
    The solver is a Riccati recursion in square-root form. It carries the cost to go as a triangular factor S with
    P = S'S, and each stage is one sweep of orthogonal rotations. P is never formed, so no condition number is squared
    and no symmetry lost.

    V2 and V3 are solved without a terminal cost first. Their objective (for V2 the norm that selects among
    minimisers) is then that of the solution plus :math:`\sum_i |w_i|^2`, where :math:`w_i = V_i (u_i + K_i x_i)`, and
    the terminal state is linear in w: the least-norm w for the required terminal state remains to be found. If an
    uncontrollable part of the signal grows along the horizon by a factor g, the rounding of V2 and V3 grows to about g
    / 1e16; do not trust either for g above 1e10.

    V1 with bounds is V1 if its plan keeps them. Otherwise PIQP or scipy finds the least-norm w within the bounds, a
    quadratic programme whose condition number does not depend on that of the weights.

    Examples
    --------
    >>> plan = solve(V1(SignalModel([[1.2]], [[1.0]]), Q=1.0, R=1.0, QN=1.0, weight=10.0, horizon=5), [1.0])
    >>> plan.u.shape, plan.is_optimal(1e-12)  # the plan certifies itself
    ((5, 1), True)
    """
    instance("problem", problem, V1, V2, V3)
    x = real_array("x", x, (problem.model.n,))
    _check_batch(problem, x)
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            plan = _solve(problem, x)
    except np.linalg.LinAlgError as error:
        raise NotFiniteError(f"the plan must stay in the range of floating-point numbers: {error}") from error
    if not (np.all(np.isfinite(plan.u)) and np.all(np.isfinite(plan.x))):
        raise NotFiniteError("the plan must stay in the range of floating-point numbers, got NaN or infinity in it")
    return plan


def first_input(
    model: SignalModel, factors: tuple[Array, Array, Array], horizon: int, weight: Array, x: Array
) -> Array:
    """Return the first input of V1's solution, shape (..., q), given upper factors of Q, R and QN.

    Examples
    --------
    >>> model, one, x = SignalModel([[1.0]], [[1.0]]), np.eye(1), np.array([1.0])
    >>> plan = solve(V1(model, 1.0, 1.0, 1.0, 4.0, 5), x)
    >>> bool(np.isclose(first_input(model, (one, one, one), 5, np.array(4.0), x), plan.u[0])[0])
    True
    """
    Q, R, QN = factors
    K, _, _ = gains(*_scaled(weight, QN, model.A, model.B, Q, R), horizon)
    u, _ = rollout(model.A, model.B, K[..., :1, :, :], np.zeros((1, model.q)), x)
    return real_array("the first planned input", u[..., 0, :])


def _scaled(
    weight: Array, QN: Array, A: Array, B: Array, Q: Array, R: Array
) -> tuple[Array, Array, Array, Array, Array]:
    """Return the recursion's data, divided by a weight above one, so that no square leaves the range of float64."""
    root = np.sqrt(np.asarray(weight))[..., None, None]
    up, down = np.minimum(root, 1.0), np.maximum(root, 1.0)
    return QN * up, A, B, Q / down, R / down


def _solve(problem: Problem, x: Array) -> Plan:
    n, q = problem.model.n, problem.model.q
    start, A, B = _chain(problem.model)
    Q, R = (np.eye(n), np.eye(q)) if isinstance(problem, V2) else (problem.Q, problem.R)
    Q_factor, R_factor = factor(np.asarray(Q)), factor(np.asarray(R))
    S = np.zeros((A.shape[-1], A.shape[-1]))
    if isinstance(problem, V1):
        QN_factor = factor(np.asarray(problem.QN))
        S = np.zeros((*QN_factor.shape[:-2], *S.shape))
        S[..., :n, :n] = QN_factor
    weight = np.asarray(problem.weight if isinstance(problem, V1) else 1.0)
    data = _scaled(weight, S, A, B, Q_factor, R_factor)
    K, V, _ = gains(*data, problem.horizon)
    state = np.einsum("...ab,...b->...a", start, x)
    push = np.zeros((problem.horizon, q)) if isinstance(problem, V1) else _pushes(problem, A, B, K, V, state)
    u, states = rollout(A, B, K, push, state)
    if isinstance(problem, V1) and problem.bounds is not None and np.any(_outside(problem.bounds, u) > 0):
        u = _within(problem.bounds, A, B, K, V, state, u)
        # Another rollout would cancel the feedback of a growing state against the correction that keeps inputs in
        # bounds.
        u, states = rollout(A, B, np.zeros_like(K), u, state)
    return Plan(problem, u, states[..., :n])


def condensed_hessian(problem: V1) -> Array:
    r"""Return the Hessian of V1 once the predicted signals are eliminated, shape (..., N q, N q).

    .. math:: H = \bar R + \Psi^\top \bar Q \Psi, \qquad (x_1, \dots, x_N) = \Phi x_0 + \Psi (u_0, \dots, u_{N-1})

    ``solve`` does not use it. Its condition number gives the accuracy lost by the common method for V1, a Cholesky
    factorisation of H.

    Examples
    --------
    >>> condensed_hessian(V1(SignalModel([[1.0]], [[1.0]]), Q=1.0, R=1.0, QN=1.0, weight=1.0, horizon=2))
    array([[3., 1.],
           [1., 2.]])
    """
    instance("problem", problem, V1)
    maps = problem.model if isinstance(problem.model, PredictorMaps) else problem.model.predictor(problem.horizon)
    effect, size = _effect(maps), maps.horizon * maps.q
    push = effect.reshape(*effect.shape[:-2], size)
    stages, end = push[..., :-1, :, :], push[..., -1, :, :]
    weight = np.asarray(problem.weight)[..., None, None]
    H = np.einsum("...iaj,...ab,...ibk->...jk", stages, np.asarray(problem.Q), stages)
    H = H + weight * (end.swapaxes(-1, -2) @ np.asarray(problem.QN) @ end)
    return np.asarray(H + np.kron(np.eye(maps.horizon), np.asarray(problem.R)))


def _pushes(problem: V2 | V3, A: Array, B: Array, K: Array, V: Array, state: Array) -> Array:
    """Return the inputs of V2 and V3 in addition to -K x, shape (..., N, q)."""
    n, q = problem.model.n, problem.model.q
    # Loop invariant: L maps the state at a stage to the terminal state (in V2's norm) under -K x alone.
    end = factor(np.asarray(problem.QN)) if isinstance(problem, V2) else np.eye(n)
    L = np.concatenate([end, np.zeros((*end.shape[:-1], A.shape[-1] - n))], axis=-1)
    columns: list[Array] = []
    sizes: list[Array] = []
    for i in reversed(range(problem.horizon)):
        BV = B @ np.linalg.inv(V[..., i, :, :])  # V'V = R + B'PB; its condition is R's and that of the step
        columns.append(L @ BV)
        # Predictions beyond the horizon do not enter L, so they add no rounding.
        seen = np.any(L != 0, axis=-2)[..., None]
        sizes.append(_norm(L)[..., None] * np.linalg.norm(BV * seen, axis=-2))
        L = np.asarray(L @ (A - B @ K[..., i, :, :]))
    drift = np.einsum("...ab,...b->...a", L, state)
    wanted = problem.r - drift if isinstance(problem, V3) else -drift
    steering = np.concatenate(np.broadcast_arrays(*columns), axis=-1)
    w = truncated_min_norm(steering, wanted, np.concatenate(np.broadcast_arrays(*sizes), axis=-1))
    if isinstance(problem, V3):
        miss = np.linalg.norm(wanted - np.einsum("...ab,...b->...a", steering, w), axis=-1)
        start = np.linalg.norm(state[..., :n], axis=-1)
        scale = np.maximum(np.linalg.norm(problem.r, axis=-1), start * np.maximum(1.0, _norm(L)))
        if np.any(miss > _FEASIBLE_RTOL * scale):
            raise InfeasibleError(
                f"no input sequence of {problem.horizon} steps steers x to r: every terminal state misses r by "
                f"at least {np.max(miss):.3g}; choose r within reach (V2's terminal state is), or a controllable model"
            )
    parts = w.reshape(*w.shape[:-1], problem.horizon, q)[..., ::-1, :]
    return np.asarray(np.linalg.solve(V, parts[..., None])[..., 0])


def _outside(bounds: InputBounds, u: Array) -> Array:
    """Return how far inputs, shape (..., N, q), are outside of their bounds, relative to the width, shape (...)."""
    low, high = bounds.low[..., None, :], bounds.high[..., None, :]
    v = np.cumsum(u, axis=-2) if bounds.summed else u
    return np.max(np.maximum(np.maximum(low - v, v - high) / (high - low), 0.0), axis=(-1, -2))


def _within(bounds: InputBounds, A: Array, B: Array, K: Array, V: Array, x: Array, u: Array) -> Array:
    """Return the inputs u of a batch, with plans outside the bounds replaced, shape (..., N, q)."""
    leaves = _outside(bounds, u) > 0
    lead = leaves.shape
    parts = ((A, 2), (B, 2), (K, 3), (V, 3), (x, 1), (bounds.low, 1), (bounds.high, 1))
    A, B, K, V, x, low, high = (np.broadcast_to(M, (*lead, *M.shape[M.ndim - core :])) for M, core in parts)
    kept = np.array(np.broadcast_to(u, (*lead, *u.shape[-2:])))
    for at in zip(*np.nonzero(leaves), strict=True) if lead else [()]:
        kept[at] = inputs_within(A[at], B[at], K[at], V[at], x[at], low[at], high[at], bounds.summed)
    return kept


def _held(bounds: InputBounds, u: Array, gradient: Array, size: Array) -> tuple[Array, Array, Array]:
    """Return the violation of bounds, and the gradient without the part that active bounds balance, with its size.

    The gradient is with respect to the bounded quantities; at a bound only its part that points inside counts.
    """
    outside = _outside(bounds, u)
    if bounds.summed:
        u = np.cumsum(u, axis=-2)
        gradient, size = gradient.copy(), size.copy()
        size[..., :-1, :] += size[..., 1:, :]
        gradient[..., :-1, :] -= gradient[..., 1:, :]
    low, high = bounds.low[..., None, :], bounds.high[..., None, :]
    near = _AT_BOUND * (high - low)
    gradient = np.where(u <= low + near, np.minimum(gradient, 0.0), gradient)
    gradient = np.where(u >= high - near, np.maximum(gradient, 0.0), gradient)
    return outside, gradient, size


def _chain(model: Predictor) -> tuple[Array, Array, Array]:
    """Write the prediction as a linear system: initial state, A and B; the first entries of the state are x_i.

    A signal model is one. General maps become one with the free response as state: the state at stage i holds the
    predictions of x_i, x_{i+1}, ... under the inputs before i, and u_i shifts them by 0, B_0, B_1, ...
    """
    if isinstance(model, SignalModel):
        return np.eye(model.n), model.A, model.B
    n, size = model.n, model.n * (model.horizon + 1)
    lead = np.broadcast_shapes(model.A.shape[:-3], model.B.shape[:-3])
    start = np.broadcast_to(model.A, (*lead, *model.A.shape[-3:])).reshape(*lead, size, n)
    B = np.zeros((*lead, size, model.q))
    B[..., : size - n, :] = np.broadcast_to(model.B, (*lead, *model.B.shape[-3:])).reshape(*lead, -1, model.q)
    return start, np.eye(size, k=n), B


def factor(M: Array) -> Array:
    """Return the upper triangular factor S of a definite M = S'S, shape (..., n, n)."""
    return np.asarray(np.linalg.cholesky(M).swapaxes(-1, -2))


def _norm(M: Array) -> Array:
    return np.asarray(np.linalg.norm(M, axis=(-1, -2)), dtype=np.float64)


def _quadratic(v: Array, M: Array | float, *, along: bool = False) -> Array:
    return np.asarray(np.einsum("...ia,...ab,...ib->...i" if along else "...a,...ab,...b->...", v, np.asarray(M), v))


def _rows(M: Array | float, v: Array) -> Array:
    return np.asarray(np.einsum("...ab,...ib->...ia", np.asarray(M), v))


def _effect(maps: PredictorMaps) -> Array:
    """Return the derivatives of x_i with respect to u_j, shape (..., N+1, n, N, q)."""
    N = maps.horizon
    effect = np.zeros((*maps.B.shape[:-3], N + 1, maps.n, N, maps.q))
    for i in range(N):
        for j in range(i + 1):
            effect[..., i + 1, :, j, :] = maps.B[..., i - j, :, :]
    return effect


def _relative(gap: Array, size: Array) -> Array:
    largest = np.max(size, axis=(-1, -2))
    return np.max(np.abs(gap), axis=(-1, -2)) / np.where(largest > 0, largest, 1.0)


def _check_batch(problem: Problem, x: Array) -> None:
    core = 3 if isinstance(problem.model, PredictorMaps) else 2
    parts = {"A": (problem.model.A, core), "B": (problem.model.B, core), "x": (x, 1)}
    for name, size in (("Q", 2), ("R", 2), ("QN", 2), ("weight", 0), ("r", 1)):
        if hasattr(problem, name):
            parts[name] = (getattr(problem, name), size)
    if isinstance(problem, V1) and problem.bounds is not None:
        parts["bounds"] = (problem.bounds.low + problem.bounds.high, 1)
    common_batch(**parts)
