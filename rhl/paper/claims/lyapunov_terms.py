"""Closed loops with V3, every term of (25)-(38) along them, and explicit constants of the bounds."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rhl._checks import Array
from rhl.controllability import controllability_margin
from rhl.horizon import Plan, solve
from rhl.model import PredictorMaps, SignalModel
from rhl.problems import V3

# Singular values of [B_0 ... B_{N-1}] below this share of the largest are rounding.
_UNREACHED = 1e-10

# Models with a smaller margin are redrawn, since their gains would only magnify rounding.
_LEAST_MARGIN = 0.2

# Avoids a division of zero by zero.
_TINY = 1e-200

SIZES = ((1, 1, 1, 0), (1, 2, 2, 0), (2, 1, 3, 0), (2, 2, 2, 0), (3, 2, 4, 0), (2, 1, 2, 1), (3, 1, 3, 1))
"""The sizes n, q, N, with N >= n as in Assumption 3, and the number of uncontrollable states."""


@dataclass(frozen=True, eq=False)
class Setting:
    """A system (2), signal models whose powers predict it, and terminal states r(k): a closed loop with V3.

    ``plant``: A, B of equation (2), shapes (..., n, n), (..., n, q).
    ``models``: one for each k = 0 ... T, shapes (..., T+1, n, n), (..., T+1, n, q); their powers (21) are the predictor
    maps.
    ``r`` (..., T+1, n): required terminal states.
    ``x0`` (..., n): initial state.
    ``horizon``: N.
    ``Q`` (..., n, n), ``R`` (..., q, q): weights of V3 with the axes of ``x0``; None for the identity.
    """

    plant: SignalModel
    models: SignalModel
    r: Array
    x0: Array
    omegas: Array
    horizon: int
    Q: Array | None = None
    R: Array | None = None

    @property
    def weights(self) -> tuple[Array, Array]:
        """Q and R with an axis for the steps, shapes (..., 1, n, n) and (..., 1, q, q)."""
        Q = np.eye(self.plant.n) if self.Q is None else self.Q
        R = np.eye(self.plant.q) if self.R is None else self.R
        return Q[..., None, :, :], R[..., None, :, :]

    @cached_property
    def gains(self) -> tuple[Array, Array]:
        """The gains of Lemma 1(a), [K_1 K_2] and [K_3 K_4], shapes (..., T+1, N+1, n, 2n) and (..., T+1, N, q, 2n).

        In closed form, without the library's recursion: the least-norm inputs that end in r, plus the optimal change
        along directions that keep the end. If (x, r) is not feasible, the end is as near to r as possible.
        """
        n, q, N = self.plant.n, self.plant.q, self.horizon
        maps = self.models.predictor(N)
        Q, R = self.weights
        effect = np.zeros((*maps.A.shape[:-3], N + 1, n, N, q))
        for i in range(1, N + 1):
            for l in range(i):
                effect[..., i, :, l, :] = maps.B[..., i - 1 - l, :, :]
        effect = effect.reshape(*effect.shape[:-2], N * q)
        free = np.concatenate([maps.A, np.zeros_like(maps.A)], axis=-1)
        wanted = np.concatenate(
            [-maps.A[..., N, :, :], np.broadcast_to(np.eye(n), maps.A[..., N, :, :].shape)], axis=-1
        )
        back = np.linalg.pinv(effect[..., N, :, :], rcond=_UNREACHED)
        shortest = back @ wanted
        stay = np.eye(N * q) - back @ effect[..., N, :, :]
        inputs = np.kron(np.eye(N), np.ones((q, q))) * np.tile(R, (N, N))
        H = inputs + np.einsum("...iab,...ac,...icd->...bd", effect[..., :N, :, :], Q, effect[..., :N, :, :])
        slope = H @ shortest + np.einsum("...iab,...ac,...icd->...bd", effect[..., :N, :, :], Q, free[..., :N, :, :])
        # Along the other directions any positive number keeps the matrix regular; the projection removes it.
        along = np.linalg.solve(stay @ H @ stay + np.eye(N * q) - stay, stay)
        u = shortest - stay @ along @ slope
        x = free + effect @ u[..., None, :, :]
        return x, u.reshape(*u.shape[:-2], N, q, 2 * n)

    @cached_property
    def forms(self) -> Array:
        """The value matrices, V3(x, r) = [x; r]' S [x; r], so S = [S_3, S_4/2; S_4'/2, S_5], (..., T+1, 2n, 2n)."""
        (K, L), (Q, R) = self.gains, self.weights
        stages = np.einsum("...iab,...ac,...icd->...bd", K[..., :-1, :, :], Q, K[..., :-1, :, :])
        return np.asarray(stages + np.einsum("...iab,...ac,...icd->...bd", L, R, L))

    def problem(self, models: SignalModel, r: Array) -> V3:
        """V3 at some steps: models and r with an axis for these."""
        Q, R = self.weights
        return V3(models, Q, R, r, self.horizon)

    @cached_property
    def states(self) -> Array:
        """The states x(0) ... x(T) of the closed loop, shape (..., T+1, n)."""
        first = self.gains[1][..., 0, :, :]
        x = [self.x0]
        for k in range(self.r.shape[-2] - 1):
            both = np.concatenate([x[-1], self.r[..., k, :]], axis=-1)
            u = np.einsum("...ab,...b->...a", first[..., k, :, :], both)
            x.append(self.plant.step(x[-1], u))
        return np.stack(x, axis=-2)


@dataclass(frozen=True, eq=False)
class Terms:
    """The quantities in the proof of Lemma 2, at k = 0 ... T-1 of a closed loop.

    ``now``, ``then``: the maps at k and at k+1, shapes (..., T, N+1, n, n), (..., T, N, n, q).
    ``plan``, ``after``, ``shifted``: V3's solutions from x(k) to r(k); from x(k+1) to r(k+1); from x(k+1) to r~+.
    ``e1`` (..., T, n): the one-step error of (8).
    ``tail`` (..., T, N, q): the old plan without its first input: nu_1 ... nu_{N-1}, 0.
    ``xi_tilde`` (..., T, N+1, n): the new prediction under it; the last one is r~+ of (26).
    ``w`` (..., T, N+1, n): its difference to the old one: xi~_i - xi_{i+1}, and for i = N r~+ - A_1(k) r.
    """

    setting: Setting
    now: PredictorMaps
    then: PredictorMaps
    plan: Plan
    after: Plan
    shifted: Plan
    e1: Array
    tail: Array
    xi_tilde: Array
    w: Array

    @property
    def x(self) -> Array:
        """x(k), shape (..., T, n)."""
        return self.setting.states[..., :-1, :]

    @property
    def x_next(self) -> Array:
        """x(k+1), shape (..., T, n)."""
        return self.setting.states[..., 1:, :]

    @property
    def r(self) -> Array:
        """r(k), shape (..., T, n)."""
        return self.setting.r[..., :-1, :]

    @property
    def r_next(self) -> Array:
        """r(k+1), shape (..., T, n)."""
        return self.setting.r[..., 1:, :]

    @property
    def S(self) -> Array:
        """The value matrix at k+1, shape (..., T, 2n, 2n)."""
        return self.setting.forms[..., 1:, :, :]

    def priced(self, v: Array, other: Array | None = None, *, inputs: bool = False) -> Array:
        """Return v'Qw, or v'Rw for ``inputs``; w is v by default; v of shape (..., T, n) or (..., T, i, n)."""
        M = self.setting.weights[inputs]
        M = M if v.ndim == self.r.ndim else M[..., None, :, :]
        return np.asarray(np.einsum("...a,...ab,...b->...", v, M, v if other is None else other))

    @cached_property
    def scale(self) -> Array:
        """The scale for rounding errors, shape (..., T)."""
        return np.asarray(self.plan.value + self.after.value + self.shifted.value + _TINY)


def follow(setting: Setting) -> Terms:
    """Compute the terms of (25)-(38) along the closed loop of ``setting``."""
    N = setting.horizon
    x, models = setting.states, setting.models
    here = SignalModel(models.A[..., :-1, :, :], models.B[..., :-1, :, :])
    there = SignalModel(models.A[..., 1:, :, :], models.B[..., 1:, :, :])
    now, then = here.predictor(N), there.predictor(N)
    plan = solve(setting.problem(here, setting.r[..., :-1, :]), x[..., :-1, :])
    after = solve(setting.problem(there, setting.r[..., 1:, :]), x[..., 1:, :])
    tail = np.concatenate([plan.u[..., 1:, :], np.zeros_like(plan.u[..., :1, :])], axis=-2)
    xi_tilde = then.predict(x[..., 1:, :], tail)
    shifted = solve(setting.problem(there, xi_tilde[..., -1, :]), x[..., 1:, :])
    beyond = apply(now.A[..., 1, :, :], setting.r[..., :-1, :])
    w = xi_tilde - np.concatenate([plan.x[..., 1:, :], beyond[..., None, :]], axis=-2)
    return Terms(setting, now, then, plan, after, shifted, plan.x[..., 1, :] - x[..., 1:, :], tail, xi_tilde, w)


@dataclass(frozen=True, eq=False)
class Bounds:
    """Explicit constants of the bounds in the proof.

    ``alpha`` (..., T, N+1, 3): alpha_{i,1}, alpha_{i,2}, alpha_{i,3} of (30), and for i = N of the bound above (34).
    ``mu``, ``top`` (..., 1): the smallest eigenvalue of Q and R, the largest of Q.
    ``beta`` (..., T, 3): beta_1, beta_2, beta_3 of (33); 2 top r'r is part of beta_3.
    ``beta4`` (..., 1): beta_4 = beta_5 of (33), the arbitrarily small one.
    ``gamma`` (..., T, 3): gamma_1, gamma_2 of (36), and the constant term gamma_3.
    ``c`` (..., 1): with ``|Ax + Bu|^2 <= 2c (|x|^2 + |u|^2)``, above (37).
    ``rho_bar`` (..., 1): Young's constant in (36): mu / (2c).
    ``gain`` (..., 1): M of Assumption 5(a). ``value`` (..., 1): a bound of the value matrix S(k).
    """

    mu: Array
    top: Array
    alpha: Array
    beta: Array
    beta4: Array
    gamma: Array
    c: Array
    rho_bar: Array
    gain: Array
    value: Array


def bounds(t: Terms) -> Bounds:
    """Compute the constants of (30), (33), (34), (36) and (37) from the maps, the gains and the omegas alone."""
    setting, n, N = t.setting, t.setting.plant.n, t.setting.horizon
    K, L = setting.gains
    parts = [half[..., columns] for half in (K, L) for columns in (slice(None, n), slice(n, None))]
    gain = _sup(np.max([np.max(size(part), axis=-1) for part in parts], axis=0))
    a = np.max(size(setting.models.predictor(N).A), axis=(-1, -2))[..., None]
    dA2 = size(t.then.A - t.now.A) ** 2
    dB2 = np.cumsum(size(t.then.B - t.now.B) ** 2, axis=-1)
    dB2 = np.concatenate([np.zeros_like(dA2[..., :1]), dB2], axis=-1)
    o1, o2, o3 = (setting.omegas[..., None, j] for j in range(3))
    M2, a2 = gain[..., None] ** 2, a[..., None] ** 2
    drift = 6 * M2 * (dA2 + np.arange(N + 1) * dB2)
    alpha = np.stack([3 * a2 * (o2 + 2 * M2 * o3) + drift, 6 * a2 * M2 * o3 + drift, 3 * a2 * o1 + 0 * drift], axis=-1)
    of_Q, of_R = (np.linalg.eigvalsh(weight) for weight in setting.weights)
    mu, top = np.minimum(of_Q[..., 0], of_R[..., 0]), of_Q[..., -1]
    # (33): the cross terms 2 xi'Qw <= top (eta |xi|^2 + |w|^2 / eta), |xi|^2 <= 2 M^2 (|x|^2 + |r|^2).
    beta4 = mu / 4 + 0 * gain if N > 1 else 0 * gain
    eta = mu / (8 * top * gain**2 * max(N - 1, 1))
    earlier = np.sum(alpha[..., : N - 1, :], axis=-2)
    beta = top[..., None] * (2 * alpha[..., N - 1, :] + (1 + 1 / eta[..., None]) * earlier)
    r2, r2_next = square(t.r), square(t.r_next)
    beta[..., 2] += 2 * top * r2
    c = size(np.concatenate([setting.plant.A, setting.plant.B], axis=-1))[..., None] ** 2 / 2
    rho_bar = mu / (2 * c)
    s4, s5 = _sup(2 * size(t.S[..., :n, n:])), _sup(size(t.S[..., n:, n:]))
    young = s4**2 / rho_bar
    last = alpha[..., N, :]
    constant = (s5 + young) * r2_next + 2 * young * (a**2 * r2 + last[..., 2])
    gamma = np.stack([2 * young * last[..., 0], 2 * young * last[..., 1], constant], axis=-1)
    return Bounds(
        np.asarray(mu), np.asarray(top), alpha, beta, beta4, gamma, c, rho_bar, gain, _sup(size(setting.forms))
    )


def draw(
    rng: np.random.Generator,
    count: int,
    sizes: tuple[int, ...],
    steps: int,
    error_decay: float = 0.6,
    weighted: bool = False,
) -> Setting:
    """Draw closed loops whose models approach the plant and whose r(k) goes to zero.

    ``count``: their number; every third has a nonzero r only at some steps, every third starts with x(0) = r(0) = 0.
    ``sizes``: n, q, N and optionally the number of uncontrollable states, of the plant and of all its models; they
    decay, and r(k) is their prediction by the model of step k.
    ``steps``: T. ``error_decay``: the factor on the models' errors at each step.
    ``weighted``: draw Q and R too.
    """
    n, q, N = sizes[:3]
    m = n - sum(sizes[3:])
    fade = error_decay ** np.arange(steps + 1)[:, None, None]
    plants: list[tuple[Array, Array]] = []
    models: list[SignalModel] = []
    errors: list[tuple[Array, Array]] = []
    while len(plants) < count:
        A, B = rng.normal(size=(n, n)), rng.normal(size=(n, q))
        A *= rng.uniform(0.5, 1.3) / max(float(np.max(np.abs(np.linalg.eigvals(A)))), 0.1)
        DA, DB = 0.3 * rng.normal(size=(n, n)), 0.3 * rng.normal(size=(n, q))
        if m < n:
            A[m:, :m], B[m:], DA[m:, :m], DB[m:] = 0.0, 0.0, 0.0, 0.0
            A[m:, m:] = np.diag(rng.uniform(-0.8, 0.8, n - m))
            DA[m:, m:] *= 0.3
        model = SignalModel(A + fade * DA, B + fade * DB)
        reached = SignalModel(model.A[:, :m, :m], model.B[:, :m])
        if np.min(controllability_margin(reached)) > _LEAST_MARGIN:
            plants.append((A, B))
            models.append(model)
            errors.append((2 * size(DA) ** 2, 2 * size(DB) ** 2))
    k = np.arange(steps + 1)
    kind = np.arange(count)[:, None] % 3
    asked = np.where(kind == 0, True, k % 4 == kind - 1)
    r = rng.normal(size=(count, 1, n)) * (0.8**k)[:, None] * asked[..., None]
    omegas = np.zeros((count, steps, 3))
    omegas[..., 1:] = np.array(errors)[:, None, :] * fade[:-1, 0] ** 2
    x0 = rng.normal(size=(count, n)) * (kind != 2)
    A, B = np.stack([A for A, _ in plants]), np.stack([B for _, B in plants])
    stacked = SignalModel(np.stack([M.A for M in models]), np.stack([M.B for M in models]))
    if m < n:
        left = x0[:, m:]
        for i in range(steps + 1):
            goes_to = np.linalg.matrix_power(stacked.A[:, i, m:, m:], N)
            r[:, i, m:] = apply(goes_to, left)
            left = apply(A[:, m:, m:], left)
        # In coordinates that hide this.
        turn = np.linalg.qr(rng.normal(size=(n, n)))[0]
        A, B, r, x0 = turn @ A @ turn.T, turn @ B, r @ turn.T, x0 @ turn.T
        stacked = SignalModel(turn @ stacked.A @ turn.T, turn @ stacked.B)
    setting = Setting(SignalModel(A, B), stacked, r, x0, omegas, N)
    if not weighted:
        return setting
    return replace(setting, Q=_weights(rng, count, n), R=_weights(rng, count, q))


def _weights(rng: np.random.Generator, count: int, n: int) -> Array:
    """Draw symmetric matrices with eigenvalues from a third to three."""
    turn = np.linalg.qr(rng.normal(size=(count, n, n)))[0]
    return np.asarray((turn * 3.0 ** rng.uniform(-1, 1, (count, 1, n))) @ turn.swapaxes(-1, -2))


def written_out(t: Terms, e: Array) -> Array:
    """Return w_0 ... w_N by the formula (28) with the one-step error ``e``, shape (..., T, N+1, n)."""
    dA, dB = t.then.A - t.now.A, t.then.B - t.now.B
    # From zero, a prediction is the sum over the inputs alone, for every A_i.
    forced = PredictorMaps(t.now.A, dB).predict(np.zeros_like(t.x), t.tail)
    through = np.einsum("...iab,...b->...ia", t.then.A, e)
    return np.asarray(forced - through + np.einsum("...iab,...b->...ia", dA, t.plan.x[..., 1, :]))


def at_the_end(setting: Setting) -> Array:
    """Return the size of state and input in the last tenth of a run over their largest size, shape (...)."""
    t = follow(setting)
    both = np.sqrt(square(t.x) + square(t.plan.u[..., 0, :]))
    return np.asarray(np.max(both[..., -(both.shape[-1] // 10) :], axis=-1) / np.max(both, axis=-1))


def apply(M: Array, v: Array) -> Array:
    """Return M v over leading axes."""
    return np.asarray(np.einsum("...ab,...b->...a", M, v))


def square(v: Array) -> Array:
    """Return the squared norm over the last axis."""
    return np.asarray(np.sum(v**2, axis=-1))


def size(M: Array) -> Array:
    """Return the spectral norm over the last two axes."""
    return np.asarray(np.linalg.norm(M, 2, axis=(-2, -1)))


def _sup(sizes: Array) -> Array:
    """Return the largest over the steps, shape (..., 1)."""
    return np.asarray(np.max(sizes, axis=-1, keepdims=True))
