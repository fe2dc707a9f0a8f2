r"""Theorem 1*: closed loops of V1 with changing maps, and all quantities of the contraction proof.

The proof bounds :math:`S(k) = \sqrt{V_3(x(k), r(k))}`, with r(k) the end of V1's plan, by

.. math::
    S(k+1) \le \sqrt{q_k^2 S(k)^2 + c_r^2 |r(k)|^2} + \sqrt{\lambda_{\max}(Q)}\,|w(k)|
        + \sqrt{\Lambda}\, M_{k+1} |r(k+1) - \tilde r(k+1)|, \qquad q_k^2 = 1 - \frac{\lambda_{\min}(Q)}{\Lambda M_k^2}.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rhl._checks import Array
from rhl.controllability import s_plus
from rhl.horizon import solve
from rhl.model import PredictorMaps, SignalModel
from rhl.problems import V1, V2

Models = Callable[[int], SignalModel]

# States may underflow at the end of a run.
_TINY = np.finfo(np.float64).tiny


@dataclass(frozen=True, eq=False)
class Loops:
    """The data of closed loops of V1, many at once.

    ``plant``: x+ = Ax + Bu, shapes (loops, n, n), (loops, n, q). ``models``: k -> the model whose powers are the maps.
    ``Q``, ``R``, ``QN``: weights, shapes (loops, n, n), (loops, q, q), (loops, n, n). ``epsilon``: k -> eps(k).
    ``x0`` (loops, n): initial states. ``horizon``: N. ``alpha``: Gamma is alpha x'x.
    """

    plant: SignalModel
    models: Models
    Q: Array
    R: Array
    QN: Array
    epsilon: Callable[[int], float]
    x0: Array
    horizon: int
    alpha: float = 1.0


@dataclass(frozen=True, eq=False)
class Run:
    """Simulated loops, over k = 0 ... T-1 (states also at T).

    ``x`` (T+1, loops, n), ``u`` (T, loops, q): states and inputs.
    ``A`` (T, loops, N+1, n, n), ``B`` (T, loops, N, n, q): the maps of (5).
    ``xi`` (T, loops, N+1, n), ``nu`` (T, loops, N, q): plans.
    ``best`` (T, loops): V2(x(k)). ``steer`` (T, loops): the root of the sum of |xi_i|^2 + |nu_i|^2, i < N, of V2's
    least-norm solution. ``stages`` (T, loops): V3(x(k), r(k)), the stage costs of the plan.
    """

    loops: Loops
    x: Array
    u: Array
    A: Array
    B: Array
    xi: Array
    nu: Array
    best: Array
    steer: Array
    stages: Array

    @property
    def r(self) -> Array:
        """The planned terminal states r(k), shape (T, loops, n)."""
        return self.xi[..., -1, :]

    @property
    def error(self) -> Array:
        """The errors e_1(k) of (8): first planned state minus the plant's next state, shape (T, loops, n)."""
        return self.xi[..., 1, :] - self.x[1:]


def run(loops: Loops, steps: int) -> Run:
    """Close the loops of V1 for some steps."""
    x, rows = loops.x0, []
    for k in range(steps):
        maps = loops.models(k).predictor(loops.horizon)
        weight = loops.alpha * np.sum(x**2, axis=-1) / loops.epsilon(k)
        plan = solve(V1(maps, loops.Q, loops.R, loops.QN, weight, loops.horizon), x)
        least = solve(V2(maps, loops.QN, loops.horizon), x)
        steer = np.sum(least.x[..., :-1, :] ** 2, axis=(-1, -2)) + np.sum(least.u**2, axis=(-1, -2))
        stages = np.sum(_forms(plan.x[..., :-1, :], loops.Q[:, None]), axis=-1)
        stages = stages + np.sum(_forms(plan.u, loops.R[:, None]), axis=-1)
        rows.append((x, plan.u[..., 0, :], maps.A, maps.B, plan.x, plan.u, least.value, np.sqrt(steer), stages))
        x = loops.plant.step(x, plan.u[..., 0, :])
    columns = [np.stack(column) for column in zip(*rows, strict=True)]
    columns[0] = np.concatenate([columns[0], x[None]])
    return Run(loops, *columns)


@dataclass(frozen=True, eq=False)
class Constants:
    r"""The constants of the proof, shape (...), for maps, weights and s+; see ``constants``.

    ``M``: :math:`V_3(x, r) \le \Lambda M^2 (|x|^2 + |r|^2)` for all feasible (x, r).
    ``C2``: some solution of V2 has :math:`\sum_{i<N} |\xi_i|^2 + |\nu_i|^2 \le C_2^2 |x|^2`.
    ``top``: :math:`\Lambda = \max(\lambda_{\max}(Q), \lambda_{\max}(R))`. ``low``, ``high``: smallest and largest
    eigenvalue of Q.
    """

    M: Array
    C2: Array
    top: Array
    low: Array
    high: Array

    @property
    def rate(self) -> Array:
        r"""The contraction factor :math:`q = \sqrt{1 - \lambda_{\min}(Q)/(\Lambda M^2)}`, below one."""
        return np.sqrt(np.maximum(1 - self.low / (self.top * self.M**2), 0.0))


def constants(A: Array, B: Array, Q: Array, R: Array, QN: Array, s: Array | None = None) -> Constants:
    r"""Return the constants of Theorem 1* for maps A, shape (..., N+1, n, n), and B, shape (..., N, n, q).

    With :math:`\alpha = |[A_0; \dots; A_{N-1}]|`, :math:`\beta` the norm of the map from the inputs to
    :math:`\xi_0 \dots \xi_{N-1}`, and s+ the smallest nonzero singular value of :math:`[B_{N-1} \dots B_0]`:

    .. math::
        M^2 = \Bigl(\alpha + \frac{(1+\beta)|A_N|}{s_+}\Bigr)^2 + \Bigl(\frac{1+\beta}{s_+}\Bigr)^2, \qquad
        C_2 = \alpha + \frac{(1+\beta)|A_N|}{s_+}\bigl(1 + \sqrt{\operatorname{cond} Q_N}\bigr).

    ``s``, shape (...), replaces s+ if given.
    """
    N, n, q = B.shape[-3:]
    free = np.linalg.norm(A[..., :N, :, :].reshape(*A.shape[:-3], N * n, n), 2, axis=(-1, -2))
    forced = np.zeros((*B.shape[:-3], N, n, N, q))
    for i in range(1, N):
        for j in range(i):
            forced[..., i, :, j, :] = B[..., i - 1 - j, :, :]
    beta = np.linalg.norm(forced.reshape(*B.shape[:-3], N * n, N * q), 2, axis=(-1, -2))
    last = np.linalg.norm(A[..., N, :, :], 2, axis=(-1, -2))
    reach = (1 + beta) / (s_plus(PredictorMaps(A, B)) if s is None else s)
    of_Q, of_R, of_QN = (np.linalg.eigvalsh(weight) for weight in (Q, R, QN))
    M = np.hypot(free + reach * last, reach)
    C2 = free + reach * last * (1 + np.sqrt(of_QN[..., -1] / of_QN[..., 0]))
    low, high = (np.asarray(of_Q[..., i], dtype=np.float64) for i in (0, -1))
    return Constants(M, C2, np.maximum(high, of_R[..., -1]), low, high)


def ends_excess(run: Run, share: float = 1.0) -> Array:
    r"""Return the relative violation of the two bounds of step 1, shape (2, T, loops).

    The first is the size of V2's least-norm solution, at most :math:`C_2 |x|`; the second is (12) with
    :math:`\rho = \Lambda C_2^2 / \alpha`; ``share``: of epsilon, as used in its bound.
    """
    at, loops = constants(run.A, run.B, run.loops.Q, run.loops.R, run.loops.QN), run.loops
    epsilon = share * np.array([loops.epsilon(k) for k in range(len(run.r))])[:, None]
    reached = _forms(run.r, loops.QN)
    allowed = run.best + epsilon * at.top * at.C2**2 / loops.alpha
    steer = at.C2 * np.linalg.norm(run.x[:-1], axis=-1)
    return np.stack([(run.steer - steer) / (steer + _TINY), (reached - allowed) / (reached + allowed + _TINY)])


@dataclass(frozen=True, eq=False)
class Shifted:
    """The shifted plan of k under the maps of k+1; over k = 0 ... T-2.

    ``w`` (T-1, loops, N+1, n): the difference of the new predictions by (28), from e_1 and the maps' differences.
    ``found`` (T-1, loops, N+1, n): the new predictions minus the old ones one step later; the last is r~+ - A_1 r.
    ``states`` (T-1, loops, N+1, n): the new predictions, ending in r~+, the end of the shifted plan.
    """

    w: Array
    found: Array
    states: Array


def shifted(run: Run) -> Shifted:
    """Return the shifted plans with their differences by (28)."""
    A, B, next_A, next_B = run.A[:-1], run.B[:-1], run.A[1:], run.B[1:]
    N, q = B.shape[-3], B.shape[-1]
    inputs = np.concatenate([run.nu[:-1, :, 1:], np.zeros((*run.nu[:-1].shape[:2], 1, q))], axis=-2)
    new = PredictorMaps(next_A, next_B).predict(run.x[1:-1], inputs)
    after = np.einsum("...ab,...b->...a", A[..., 1, :, :], run.r[:-1])
    old = np.concatenate([run.xi[:-1, :, 1:], after[..., None, :]], axis=-2)
    moved = np.einsum("...iab,...b->...ia", next_A - A, run.xi[:-1, :, 1])
    w = moved - np.einsum("...iab,...b->...ia", next_A, run.error[:-1])
    for i in range(1, N + 1):
        change = (next_B - B)[..., :i, :, :][..., ::-1, :, :]  # i - 1 - l for the input l
        w[..., i, :] += np.einsum("...lab,...lb->...a", change, inputs[..., :i, :])
    return Shifted(w, new - old, new)


def step_excess(run: Run, share: float = 1.0, moved_end: bool = True) -> Array:
    """Return the relative violation of the two parts of the bound of S(k+1), shape (2, T-1, loops).

    The first bounds the root of the shifted plan's cost by S(k), r(k) and w; the second bounds S(k+1) by that root and
    the change of the end. If S(k) is below 1e-12 of its largest value, it is rounding, and the violation is -1.
    ``share``: of q_k, as used in the first part. ``moved_end``: whether the second part includes the change of the end.
    """
    loops, r, moved = run.loops, run.r, shifted(run)
    at = constants(run.A, run.B, loops.Q, loops.R, loops.QN)
    S = np.sqrt(run.stages)
    kept = (share * at.rate[:-1] * S[:-1]) ** 2 + (at.low + at.high) * np.sum(r[:-1] ** 2, axis=-1)
    w = np.sqrt(at.high) * np.sqrt(np.sum(moved.w[..., :-1, :] ** 2, axis=(-1, -2)))
    cost = np.sum(_forms(moved.states[..., :-1, :], loops.Q[:, None]), axis=-1)
    cost = np.sqrt(cost + np.sum(_forms(run.nu[:-1, :, 1:], loops.R[:, None]), axis=-1))
    ends = np.sqrt(at.top) * at.M[1:] * np.linalg.norm(r[1:] - moved.states[..., -1, :], axis=-1)
    left, right = np.stack([cost, S[1:]]), np.stack([np.sqrt(kept) + w, cost + (ends if moved_end else 0.0)])
    counted = S[:-1] > 1e-12 * np.max(S, axis=0)
    return np.asarray(np.where(counted, left / np.where(counted, right, 1.0) - 1, -1.0))


def _forms(rows: Array, weight: Array) -> Array:
    """Return x'Wx for rows x, shape (..., n)."""
    return np.asarray(np.einsum("...a,...ab,...b->...", rows, weight, rows))
