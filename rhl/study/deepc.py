"""Data-enabled predictive control: inputs planned on a matrix of measured trajectories, without a model."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rhl._checks import Array
from rhl.lifting import remember
from rhl.study.rivals import Run, Task, closed

# A direction of the past inputs counts where its singular value exceeds this share of the largest.
_RANK_RTOL = 1e-12
# How far it looks ahead.
_AHEAD = 20
# The slack of the measured past costs so much, in the outputs' units: much more than any output.
_SLACK = 1e8
# The least regularisation of g; below, rounding decides which of many equal combinations is taken.
_LEAST = 1e-8
# Noise counts so many times more than what it adds to predicted outputs; with 1 or 100, fewer plants come to rest.
_CAUTION = 10.0


@dataclass(frozen=True, eq=False)
class Predictor:
    r"""The problem that is solved at every step, in g and for measured trajectories as columns of [U_p; Y_p; U_f; Y_f].

    .. math::
        \min_g\; |Y_f g|_W^2 + |U_f g|_R^2 + \lambda_g |g|^2 + \lambda_y |Y_p g - y_{ini}|^2
        \quad\text{subject to}\quad U_p g = u_{ini},\; |U_f g| \le b

    Attributes
    ----------
    Up, Yp, Uf, Yf : array, shapes (T_ini q, M), (T_ini p, M), (N q, M), (N p, M)
        Block Hankel matrices of the inputs and outputs measured, oldest block first.
    W, R : array, shapes (p, p) and (q, q)
    of_g, of_slack : float
        lambda_g and lambda_y.
    bound : array, shape (q,), or None
        b, for each input; None: inputs are free.
    """

    Up: Array
    Yp: Array
    Uf: Array
    Yf: Array
    W: Array
    R: Array
    of_g: float
    of_slack: float
    bound: Array | None = None

    @cached_property
    def _past(self) -> tuple[Array, Array]:
        """The shortest g with U_p g = u_ini as a map of u_ini, and a basis of what g may do beside."""
        left, size, right = np.linalg.svd(self.Up)
        rank = int(np.sum(size > _RANK_RTOL * size[0]))
        return right[:rank].T @ (left[:, :rank].T / size[:rank, None]), right[rank:].T

    @cached_property
    def _free(self) -> Array:
        """The map from [u_ini; y_ini] to the best g without bounds."""
        shortest, beside = self._past
        given, measured = len(self.Up), len(self.Yp)
        base = np.concatenate([shortest, np.zeros((len(shortest), measured))], axis=1)
        wanted = np.zeros((len(self._stack), given + measured))
        wanted[-measured:, given:] = np.sqrt(self.of_slack) * np.eye(measured)
        move = np.linalg.lstsq(self._stack @ beside, wanted - self._stack @ base, rcond=None)[0]
        return np.asarray(base + beside @ move)

    @cached_property
    def _reach(self) -> Array:
        """How the inputs planned follow a change of g that costs its square, shape (N q, M - rank of U_p)."""
        from scipy.linalg import solve_triangular  # here, because most runs need neither

        beside = self._past[1]
        triangle = np.asarray(np.linalg.qr(self._stack @ beside, mode="r"))
        return np.asarray(solve_triangular(triangle, (self.Uf @ beside).T, trans="T").T)

    @cached_property
    def _stack(self) -> Array:
        """What is squared and summed, before [0; ...; y_ini] is taken off."""
        p, q = len(self.W), len(self.R)
        factors = np.linalg.cholesky(self.W).T, np.linalg.cholesky(self.R).T
        outputs, inputs = (
            np.einsum("ij,njm->nim", factor, block.reshape(-1, size, block.shape[1])).reshape(block.shape)
            for factor, block, size in zip(factors, (self.Yf, self.Uf), (p, q), strict=True)
        )
        return np.concatenate(
            [outputs, inputs, np.sqrt(self.of_g) * np.eye(self.Up.shape[1]), np.sqrt(self.of_slack) * self.Yp]
        )

    def plan(self, u: Array, y: Array) -> Array:
        """Return the inputs planned, shape (N, q), after inputs u and outputs y, shapes (T_ini, q) and (T_ini, p).

        Where the solver fails to find those within the bounds, they are those without bounds, clipped.
        """
        ini = np.concatenate([u.ravel(), y.ravel()])
        free = self._free @ ini
        planned = (self.Uf @ free).reshape(-1, len(self.R))
        if self.bound is None or np.all(np.abs(planned) <= self.bound):
            return planned
        return self._bounded(free)

    def _bounded(self, free: Array) -> Array:
        """Return the inputs planned within the bounds: the nearest to the free ones, in the measure of the cost.

        Where the solver finds none, the free ones are clipped.
        """
        import piqp  # here, because most runs need neither

        assert self.bound is not None
        # |stack (free + beside w)|^2 is least at w = 0, so that only |t|^2 is left, t = triangle w.
        limit = np.tile(self.bound, len(self.Uf) // len(self.bound))
        reach, planned = self._reach / limit[:, None], (self.Uf @ free) / limit
        reach = reach / np.max(np.abs(reach))  # which only counts t in another unit
        solver = piqp.DenseSolver()
        n = reach.shape[1]
        solver.setup(np.eye(n, order="F"), np.zeros(n), None, None, np.asfortranarray(reach), -1 - planned, 1 - planned)
        if solver.solve() != piqp.Status.PIQP_SOLVED:
            # Far outside the bounds, where the plant has run away, solvers give up.
            return (np.clip(planned, -1.0, 1.0) * limit).reshape(-1, len(self.R))
        found = planned + reach @ solver.result.x
        return (np.clip(found, -1.0, 1.0) * limit).reshape(-1, len(self.R))


def hankel(signal: Array, length: int) -> Array:
    """Return the block Hankel matrix of a signal, shape (T, size): (length size, T - length + 1)."""
    columns = len(signal) - length + 1
    return np.stack([signal[i : i + length].ravel() for i in range(columns)], axis=1)


def excitation_length(task: Task) -> int:
    """Return how many steps ``deepc`` excites, the least that persistency of excitation asks for."""
    return (task.plant.q + 1) * (task.stacked + _AHEAD + task.plant.p * task.order) - 1


def deepc(task: Task) -> Run:
    r"""Excite, then plan every input on the trajectories measured meanwhile.

    Inputs that excite are normal with standard deviation ``task.size`` and are T steps long, the least that persistency
    of excitation asks for: :math:`T = (q+1)(T_{ini} + N + p\,m) - 1`, with m the order told, N = 20 steps ahead, and
    :math:`T_{ini} = m` or, with noise, 3m. Outputs count in their first sizes and inputs in ``task.size``. There
    :math:`\lambda_y = 10^8`, and :math:`\lambda_g` is ten times what the noise adds to predicted outputs,
    :math:`10 N p\,\sigma^2`, at least 1e-8: without noise the past must be met, as in the problem without slack. Where
    T reaches the number of steps, the run consists of excitation. Longer data make matters worse here, since an
    unstable plant runs away meanwhile.

    References
    ----------
    J. Coulson, J. Lygeros and F. Dörfler, Data-enabled predictive control: in the shallows of the DeePC, European
    Control Conference 2019, with the squares for regularisation of E. Elokda, J. Coulson, P. N. Beuchat, J. Lygeros and
    F. Dörfler, Data-enabled predictive control for quadcopters, International Journal of Robust and Nonlinear Control
    31(18), 2021, so that without active bounds a plan is linear in what was measured.
    """
    p, q, m = task.plant.p, task.plant.q, task.stacked
    length = excitation_length(task)
    rng, ys, vs = task.rng(), [np.zeros((m, p))], [np.zeros((m, q))]
    made: list[Predictor] = []
    seen: tuple[list[Array], list[Array]] = ([], [])

    def choose(k: int, y: Array, before: Array, z: Array) -> Array:
        if k:
            vs[0] = remember(vs[0], before / task.size)
        if k < length:
            v = task.size * rng.standard_normal(q)
        else:
            if not made:
                made.append(_predictor(task, *(np.array(of) for of in seen)))
            v = task.size * made[0].plan(vs[0][::-1], ys[0][::-1])[0]
        ys[0] = remember(ys[0], y / task.output_sizes)
        if k < length:
            seen[0].append(task.within(v) / task.size)
            seen[1].append(y / task.output_sizes)
        return v

    return closed(task, choose)


def _predictor(task: Task, v: Array, y: Array) -> Predictor:
    p, q, m = task.plant.p, task.plant.q, task.stacked
    U, Y = hankel(v, m + _AHEAD), hankel(y, m + _AHEAD)
    return Predictor(
        U[: m * q],
        Y[: m * p],
        U[m * q :],
        Y[m * p :],
        np.eye(p),
        task.R * task.size**2,
        max(_LEAST, _CAUTION * _AHEAD * p * task.noise**2),
        _SLACK,
        None if task.bound is None else task.bound / task.size,
    )
