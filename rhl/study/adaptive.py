"""Adaptive LQ control: recursive least squares, the regulator of the current model, and a decaying dither."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rhl._checks import Array
from rhl.lifting import DelayLifting, remember
from rhl.model import SignalModel
from rhl.study.rivals import Run, Task, regulator

# P(0) = 1e6 I, in the units of the signals, is large, as textbooks recommend, so the first model has little weight.
_PRIOR = 1e-3
# The regulator's horizon; on these plants a hundred steps are no better.
_AHEAD = 50
# The regulator is updated at every step at first, while estimates change fast, then at every tenth.
_ALWAYS, _EVERY = 50, 10


def adaptive_lq(tasks: Sequence[Task]) -> list[Run]:
    r"""Run certainty-equivalent LQ control on one plant, for all tasks at once, which differ only in seeds.

    The model :math:`y(k) = \theta\, [y(k-1); \dots; y(k-m); v(k-1); \dots; v(k-m)]` is fitted to all data by recursive
    least squares (in square-root form, P(0) = 1e6 I in the signals' units, no forgetting, first estimate zero); m is
    ``order`` or, with noise, three times that, since predictors from noisy outputs need more. The input is that of the
    LQ regulator for the estimate, with the task's weights, plus a dither with standard deviation
    :math:`\text{size}\,(k+1)^{-1/4}`: its variance falls as :math:`k^{-1/2}`.

    References
    ----------
    H. Mania, S. Tu and B. Recht, Certainty equivalence is efficient for linear quadratic control, NeurIPS 2019, and M.
    Simchowitz and D. Foster, Naive exploration is optimal for online LQR, ICML 2020, for the dither's decay. Both
    measure the state, start from a regulator that stabilises the plant, and update in epochs of doubling length; here
    outputs are lifted, there is no such regulator, and the estimate is used at once (every step up to k = 50, then
    every tenth), which suits an unstable plant better.
    """
    one, members = tasks[0], len(tasks)
    m, plant = one.stacked, one.plant
    p, q, n = plant.p, plant.q, plant.p * m
    lifting, shift = DelayLifting(m, m), np.eye(n, k=-p)
    scale = np.concatenate([np.tile(1 / one.output_sizes, m), np.full(q * m, 1 / one.size)])
    seen = np.zeros((p, n + (m - 1) * q))
    seen[:, :p] = np.sqrt(one.W)
    dither = np.stack([task.rng().standard_normal((task.steps, q)) for task in tasks])
    triangle = np.zeros((members, len(scale) + p, len(scale) + p))
    triangle[:, range(len(scale)), range(len(scale))] = _PRIOR
    K = np.zeros((members, q, seen.shape[1]))
    ys, vs = np.zeros((members, m + 1, p)), np.zeros((members, m + 1, q))
    z, v = np.tile(one.z0, (members, 1)), np.zeros((members, q))
    outputs, inputs = np.zeros((one.steps, members, p)), np.zeros((one.steps, members, q))
    ended = np.full(members, one.steps)
    for k in range(one.steps):
        y = z @ plant.H.T
        lost = ~(np.max(np.abs(y), axis=1) < 1e100) | ~np.all(np.isfinite(v), axis=1)
        ended[lost] = np.minimum(ended[lost], k)
        going = ended > k
        if not np.any(going):
            break
        # A member that diverged stays at zero from then on.
        z[~going], v[~going], y[~going], ys[~going], vs[~going] = 0.0, 0.0, 0.0, 0.0, 0.0
        vs = remember(vs, v)
        ys = remember(ys, y + np.stack([task.errors[k] for task in tasks]))
        if k >= m:
            known = np.concatenate([ys[:, 1:].reshape(members, -1), vs[:, :m].reshape(members, -1)], axis=1)
            row = np.concatenate([known * scale, ys[:, 0] / one.output_sizes], axis=1)
            triangle[going] = np.linalg.qr(np.concatenate([triangle, row[:, None]], axis=1)[going], mode="r")
        if k >= m and (k < _ALWAYS or k % _EVERY == 0):
            K = _gain(triangle, scale, one, shift, lifting, seen, K)
        x = lifting.augmented_state(ys, vs)
        v = -np.einsum("sij,sj->si", K, x) + one.size * (k + 1) ** -0.25 * dither[:, k]
        v = one.within(v)
        outputs[k], inputs[k] = y, v
        with np.errstate(over="ignore", invalid="ignore"):
            z = z @ plant.F.T + v @ plant.G.T
    return [Run(outputs[:end, i], inputs[:end, i], one.steps) for i, end in enumerate(ended)]


def _gain(
    triangle: Array, scale: Array, task: Task, shift: Array, lifting: DelayLifting, seen: Array, before: Array
) -> Array:
    """Return the regulators of the least-squares models; the previous one if the new one is not finite."""
    p, n, d = task.plant.p, len(shift), len(scale)
    theta = np.linalg.solve(triangle[:, :d, :d], triangle[:, :d, d:]).swapaxes(1, 2)
    theta = theta * task.output_sizes[:, None] * scale
    lifted = np.zeros((len(theta), n, d))
    lifted[:, :, :n] = shift
    lifted[:, :p] = theta
    fine = np.all(np.isfinite(lifted), axis=(1, 2))
    model = lifting.augment(SignalModel(np.where(fine[:, None, None], lifted, 0.0)[..., :n], lifted[..., n:]))
    with np.errstate(over="ignore", invalid="ignore"):
        K = regulator(model.A, model.B, seen, task.R, _AHEAD)[:, 0]
    fine &= np.all(np.isfinite(K), axis=(1, 2))
    return np.where(fine[:, None, None], K, before)
