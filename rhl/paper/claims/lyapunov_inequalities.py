"""Equations (25)-(38), each as a function that returns its violation along closed loops, relative to V3.

Each takes the terms of a loop and the constants of the bounds, and returns violations of any shape. A switch violates
it, or uses its printed form.
"""

from __future__ import annotations

import numpy as np

from rhl._checks import Array
from rhl.horizon import Plan, solve
from rhl.model import SignalModel
from rhl.paper.claims.lyapunov_terms import Bounds, Terms, apply, size, square, written_out

# A coefficient with limit zero must have decreased to this share of its largest value; its decay is geometric.
_VANISHED = 1e-3


def below_state(t: Terms, b: Bounds, share: float = 1.0) -> Array:
    """Check V3(x, p) >= lambda_min(Q) x'x, the first sentence of the proof. ``share``: factor on that constant."""
    least = np.linalg.eigvalsh(t.setting.weights[0])[..., 0]
    return np.asarray((share * least * square(t.x) - t.plan.value) / t.scale)


def split(t: Terms, b: Bounds, stale: bool = False) -> Array:
    """Check equation (25): each value is that of V3 at its time, from its state to its end.

    The sum of the two parts needs no check. The values are compared with the forms of ``Setting.forms``, which share no
    code with the solver, and each plan must reach its end.
    ``stale``: the second of the middle terms uses the maps of time k.
    """
    models, forms, N = t.setting.models, t.setting.forms, t.setting.horizon
    middle, r_new = t.shifted.value, t.xi_tilde[..., -1, :]
    if stale:
        here = SignalModel(models.A[..., :-1, :, :], models.B[..., :-1, :, :])
        end = here.predictor(N).predict(t.x_next, t.tail)[..., -1, :]
        middle = solve(t.setting.problem(here, end), t.x_next).value
    gaps = [
        t.after.value - _value(forms[..., 1:, :, :], t.x_next, t.r_next),
        middle - _value(forms[..., 1:, :, :], t.x_next, r_new),
        t.plan.value - _value(forms[..., :-1, :, :], t.x, t.r),
    ]
    ends = [(t.after, t.r_next), (t.shifted, r_new), (t.plan, t.r)]
    missed = [_relative(plan.x[..., -1, :] - end, t.scale) for plan, end in ends]
    return np.max([np.abs(gap) / t.scale for gap in gaps] + missed, axis=0)


def shifted_end(t: Terms, b: Bounds, last: float = 0.0) -> Array:
    """Check equation (26): r~+ ends the shifted plan under the new maps. ``last``: its last input."""
    N = t.setting.horizon
    inputs = t.tail + last * (np.arange(N) == N - 1)[:, None]
    end = apply(t.then.A[..., N, :, :], t.x_next)
    for l in range(N):
        end = end + apply(t.then.B[..., N - 1 - l, :, :], inputs[..., l, :])
    return _relative(end - t.shifted.x[..., N, :], t.scale)


def shifted_states(t: Terms, b: Bounds, printed: bool = False) -> Array:
    """Check equation (27): the new prediction is the old one plus w. ``printed``: with e_0 (zero) instead of e_1."""
    e = (0.0 if printed else 1.0) * t.e1
    first = t.plan.x[..., 1, :]
    through = t.now.predict(first, t.tail)
    w = t.then.predict(-e, 0 * t.tail) + t.then.predict(first, t.tail) - through
    ahead = np.concatenate([t.plan.x[..., 1:, :], apply(t.now.A[..., 1, :, :], t.r)[..., None, :]], axis=-2)
    scale = t.scale[..., None]
    return np.maximum(_relative(through - ahead, scale), _relative(t.xi_tilde - (ahead + w), scale))


def written_w(t: Terms, b: Bounds, printed: bool = False) -> Array:
    """Check equation (28): w_i written out. ``printed``: with e_0 (zero) instead of e_1."""
    return _relative(written_out(t, (0.0 if printed else 1.0) * t.e1) - t.w, t.scale[..., None])


def bounded_w(t: Terms, b: Bounds) -> Array:
    """Check equation (30): ``|w_i|^2`` is below its bound, i = 0 ... N, whose coefficients go to zero."""
    x2, r2 = square(t.x)[..., None], square(t.r)[..., None]
    excess = square(t.w) - (b.alpha[..., 0] * x2 + b.alpha[..., 1] * r2 + b.alpha[..., 2])
    return np.maximum(excess / t.scale[..., None], _still_there(b.alpha))


def shifted_cost(t: Terms, b: Bounds, with_w: bool = True) -> Array:
    """Check equation (31): the cost of the shifted plan, in terms of the old plan and of w."""
    w = (1.0 if with_w else 0.0) * written_out(t, t.e1)[..., :-1, :]
    inputs = np.sum(t.priced(t.tail, inputs=True), axis=-1)
    cost = Plan(t.shifted.problem, t.tail, t.xi_tilde).value
    again = np.sum(t.priced(t.plan.x[..., 1:, :] + w), axis=-1) + inputs
    return np.asarray(np.abs(cost - again) / t.scale)


def first_bound(t: Terms, b: Bounds, cross: bool = True) -> Array:
    """Check equation (32): by optimality the shifted problem costs no more than the shifted plan."""
    w = t.w[..., :-1, :]
    right = -_first_stage(t) + t.priced(t.r + w[..., -1, :])
    right = right + np.sum(t.priced(w[..., :-1, :]), axis=-1)
    if cross:
        right = right + 2 * np.sum(t.priced(t.plan.x[..., 1:-1, :], w[..., :-1, :]), axis=-1)
    return np.asarray((t.shifted.value - t.plan.value - right) / t.scale)


def first_step(t: Terms, b: Bounds, counted: bool = True) -> Array:
    """Check equation (33), and that beta_1, beta_2, beta_3 go to zero. ``counted``: r'Qr is part of beta_3."""
    x2, r2 = square(t.x), square(t.r)
    right = -_first_stage(t) + (b.beta[..., 0] + b.beta4) * x2
    right = right + (b.beta[..., 1] + b.beta4) * r2 + b.beta[..., 2] - (0 if counted else 2) * b.top * r2
    return np.maximum((t.shifted.value - t.plan.value - right) / t.scale, _still_there(b.beta))


def end_with_w(t: Terms, b: Bounds, printed: bool = False) -> Array:
    """Check r~+ = A_1(k) r + w_N. ``printed``: r + w_N."""
    r = t.r if printed else apply(t.now.A[..., 1, :, :], t.r)
    return _relative(t.xi_tilde[..., -1, :] - r - written_out(t, t.e1)[..., -1, :], t.scale)


def bounded_end(t: Terms, b: Bounds, with_r: bool = True) -> Array:
    """Check equation (34): ``|r~+|^2`` is below a bound with the constant ``2 |A_1(k) r(k)|^2 + 2 alpha_{N,3}(k)``."""
    last = 2 * b.alpha[..., -1, :]
    constant = last[..., 2] + (2 * square(apply(t.now.A[..., 1, :, :], t.r)) if with_r else 0)
    return np.asarray(
        (square(t.xi_tilde[..., -1, :]) - last[..., 0] * square(t.x) - last[..., 1] * square(t.r) - constant) / t.scale
    )


def same_state(t: Terms, b: Bounds, halved: bool = False) -> Array:
    """Check equation (35): two values from the same state. ``halved``: with S_4/2 as the cross term's matrix."""
    return np.asarray(np.abs(t.after.value - t.shifted.value - _change(t, 0.5 if halved else 1.0)) / t.scale)


def second_bound(t: Terms, b: Bounds, share: float = 1.0) -> Array:
    """Check equation (36): Young's inequality on (35). ``share``: factor on the term in Ax + Bu."""
    gap = t.after.value - t.shifted.value - share * b.rho_bar / 2 * square(t.x_next) - gamma(t, b.rho_bar)
    return np.asarray(gap / t.scale)


def bounded_gamma(t: Terms, b: Bounds, constant: bool = True) -> Array:
    """Check below (36) that gamma is below a bound whose coefficients go to zero. ``constant``: with gamma_3."""
    right = b.gamma[..., 0] * square(t.x) + b.gamma[..., 1] * square(t.r) + (b.gamma[..., 2] if constant else 0)
    return np.maximum((gamma(t, b.rho_bar) - right) / t.scale, _still_there(b.gamma))


def second_step(t: Terms, b: Bounds, constant: bool = True) -> Array:
    """Check equation (37). ``constant``: with gamma_3."""
    x2, r2 = square(t.x), square(t.r)
    right = b.rho_bar * b.c * (x2 + square(t.plan.u[..., 0, :])) + b.gamma[..., 0] * x2 + b.gamma[..., 1] * r2
    right = right + (b.gamma[..., 2] if constant else 0)
    return np.asarray((t.after.value - t.shifted.value - right) / t.scale)


def decrease(t: Terms, b: Bounds, constant: bool = True) -> Array:
    """Check equation (38). ``constant``: with gamma_3."""
    x2, r2 = square(t.x), square(t.r)
    right = -b.mu / 2 * (x2 + square(t.plan.u[..., 0, :])) + (b.beta[..., 0] + b.beta4 + b.gamma[..., 0]) * x2
    right = right + (b.beta[..., 1] + b.beta4 + b.gamma[..., 1]) * r2 + b.beta[..., 2]
    right = right + (b.gamma[..., 2] if constant else 0)
    return np.asarray((t.after.value - t.plan.value - right) / t.scale)


def contracts_up_to_delta(t: Terms, b: Bounds, with_delta: bool = True, falling: bool = False) -> Array:
    """Check V3+ <= (1 - kappa/s) V3 + delta(k) once kappa > 0, with delta -> 0 and s a bound of the value matrices.

    ``falling``: as printed, V3 decreases at every step of the second half of the run unless x = 0.
    """
    if falling:
        rise = np.where(square(t.x) > 0, (t.after.value - t.plan.value) / t.scale, 0.0)
        return rise[..., rise.shape[-1] // 2 :]
    kappa, delta = contraction(t, b)
    right = (1 - kappa / b.value) * t.plan.value + (delta if with_delta else 0)
    excess = np.where(kappa > 0, (t.after.value - right) / t.scale, 0.0)
    reached = np.where(kappa[..., -1:] > 0, 0.0, 1.0)
    return np.maximum(np.maximum(excess, reached), _still_there(delta[..., None]))


def contraction(t: Terms, b: Bounds) -> tuple[Array, Array]:
    """Return kappa(k) and delta(k) of the last step of the proof, shapes (..., T)."""
    kappa = b.mu / 2 - b.beta4 - b.beta[..., 0] - b.gamma[..., 0]
    delta = (np.abs(kappa) + b.beta[..., 1] + b.beta4 + b.gamma[..., 1]) * square(t.r)
    return np.asarray(kappa), np.asarray(delta + b.beta[..., 2] + b.gamma[..., 2])


def value_at_rest(t: Terms, b: Bounds) -> Array:
    """Return V3(0, p) as a share of V3: zero only if r is zero."""
    n = t.x.shape[-1]
    return np.asarray(np.einsum("...a,...ab,...b->...", t.r_next, t.S[..., n:, n:], t.r_next) / t.scale)


def input_by_gains(t: Terms, b: Bounds, with_r: bool = True) -> Array:
    """Check ``|u(k)| <= |K_3| |x(k)| + |K_4| |r(k)|``, with the gains of nu_0."""
    n, first = t.x.shape[-1], t.setting.gains[1][..., :-1, 0, :, :]
    limit = size(first[..., :n]) * np.sqrt(square(t.x))
    limit = limit + (size(first[..., n:]) * np.sqrt(square(t.r)) if with_r else 0)
    return np.asarray((np.sqrt(square(t.plan.u[..., 0, :])) - limit) / np.sqrt(t.scale))


def gamma(t: Terms, rho_bar: Array) -> Array:
    """Return gamma of (36), shape (..., T)."""
    n, r_new = t.x.shape[-1], t.xi_tilde[..., -1, :]
    S4, S5 = 2 * t.S[..., :n, n:], t.S[..., n:, n:]
    ends = _form(t.r_next, S5, t.r_next) - _form(r_new, S5, r_new)
    return np.asarray(ends + square(apply(S4, t.r_next - r_new)) / (2 * rho_bar))


def _first_stage(t: Terms) -> Array:
    """Return x'Qx + nu_0'R nu_0."""
    return t.priced(t.x) + t.priced(t.plan.u[..., 0, :], inputs=True)


def _value(S: Array, x: Array, r: Array) -> Array:
    both = np.concatenate([x, r], axis=-1)
    return _form(both, S, both)


def _change(t: Terms, share: float) -> Array:
    n, r_new = t.x.shape[-1], t.xi_tilde[..., -1, :]
    S4, S5 = 2 * t.S[..., :n, n:], t.S[..., n:, n:]
    ends = _form(t.r_next, S5, t.r_next) - _form(r_new, S5, r_new)
    return np.asarray(share * _form(t.x_next, S4, t.r_next - r_new) + ends)


def _form(x: Array, M: Array, y: Array) -> Array:
    return np.asarray(np.einsum("...a,...ab,...b->...", x, M, y))


def _still_there(coefficients: Array) -> Array:
    """Return the excess of a coefficient's last value over its share of the largest; a number."""
    steps = np.moveaxis(coefficients, 1, 0)
    return np.asarray(np.max(steps[-1] - _VANISHED * np.max(steps, axis=0)))


def _relative(gap: Array, scale: Array) -> Array:
    return np.asarray(np.sqrt(square(gap) / scale))
