"""Data-enabled predictive control: inputs planned with a matrix of measured trajectories, without a model."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rhl._checks import Array
from rhl.lifting import remember
from rhl.study.rivals import Run, Task, closed

# A direction of the past inputs counts if its singular value exceeds this share of the largest.
_RANK_RTOL = 1e-12
# The horizon.
_AHEAD = 20
# The weight of the slack in the measured past, in the outputs' units: much larger than that of an output.
_SLACK = 1e8
# The least regularisation of g; below, rounding decides between equivalent combinations.
_LEAST = 1e-8
# The weight of noise relative to its contribution to predicted outputs; with 1 or 100, fewer plants come to rest.
_CAUTION = 10.0


@dataclass(frozen=True, eq=False)
class Predictor:
    r"""The problem of every step in the variable g, with measured trajectories as columns of [U_p; Y_p; U_f; Y_f].

    .. math::
        \min_g\; |Y_f g|_W^2 + |U_f g|_R^2 + \lambda_g |g|^2 + \lambda_y |Y_p g - y_{ini}|^2
        \quad\text{subject to}\quad U_p g = u_{ini},\; |U_f g| \le b

    Attributes
    ----------
    Up, Yp, Uf, Yf : array, shapes (T_ini q, M), (T_ini p, M), (N q, M), (N p, M)
        Block Hankel matrices of the measured inputs and outputs, oldest block first.
    W, R : array, shapes (p, p) and (q, q)
    of_g, of_slack : float
        lambda_g and lambda_y.
    bound : array, shape (q,), or None
        b, for each input; None: inputs are free.

    Examples
    --------
    >>> u, y, one = np.random.default_rng(0).standard_normal((12, 1)), np.zeros((12, 1)), np.eye(1)
    >>> for k in range(11):
    ...     y[k + 1] = 1.2 * y[k] + u[k]
    >>> (Up, Uf), (Yp, Yf) = (np.split(hankel(signal, 4), [1]) for signal in (u, y))
    >>> plan = Predictor(Up, Yp, Uf, Yf, one, one, 1e-8, 1e8).plan(u=0 * one, y=one)
    >>> plan.shape, bool(plan[0, 0] < -0.5)  # the next output is 1.2 without an input
    ((3, 1), True)
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
        """The least-norm g with U_p g = u_ini as a map of u_ini, and a basis of the null space of U_p."""
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
        """The map to planned inputs from a change of g, scaled to cost its square, shape (N q, M - rank of U_p)."""
        from scipy.linalg import solve_triangular  # imported here, because most runs need neither

        beside = self._past[1]
        triangle = np.asarray(np.linalg.qr(self._stack @ beside, mode="r"))
        return np.asarray(solve_triangular(triangle, (self.Uf @ beside).T, trans="T").T)

    @cached_property
    def _stack(self) -> Array:
        """The matrix of the sum of squares, before [0; ...; y_ini] is subtracted."""
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
        """Return the planned inputs, shape (N, q), after inputs u and outputs y, shapes (T_ini, q) and (T_ini, p).

        If the solver fails within the bounds, they are those without bounds, clipped.
        """
        ini = np.concatenate([u.ravel(), y.ravel()])
        free = self._free @ ini
        planned = (self.Uf @ free).reshape(-1, len(self.R))
        if self.bound is None or np.all(np.abs(planned) <= self.bound):
            return planned
        return self._bounded(free)

    def _bounded(self, free: Array) -> Array:
        """Return the planned inputs within the bounds: those of least additional cost over the free ones.

        If the solver finds none, the free ones are clipped.
        """
        import piqp  # imported here, because most runs need neither

        assert self.bound is not None
        # |stack (free + beside w)|^2 is least at w = 0, so only |t|^2 remains, t = triangle w.
        limit = np.tile(self.bound, len(self.Uf) // len(self.bound))
        reach, planned = self._reach / limit[:, None], (self.Uf @ free) / limit
        reach = reach / np.max(np.abs(reach))  # this only rescales t
        solver = piqp.DenseSolver()
        n = reach.shape[1]
        solver.setup(np.eye(n, order="F"), np.zeros(n), None, None, np.asfortranarray(reach), -1 - planned, 1 - planned)
        if solver.solve() != piqp.Status.PIQP_SOLVED:
            # Far outside the bounds, after the plant has diverged, solvers fail.
            return (np.clip(planned, -1.0, 1.0) * limit).reshape(-1, len(self.R))
        found = planned + reach @ solver.result.x
        return (np.clip(found, -1.0, 1.0) * limit).reshape(-1, len(self.R))


def hankel(signal: Array, length: int) -> Array:
    """Return the block Hankel matrix of a signal, shape (T, size): (length size, T - length + 1).

    Examples
    --------
    >>> hankel(np.arange(4.0)[:, None], 2)
    array([[0., 1., 2.],
           [1., 2., 3.]])
    """
    columns = len(signal) - length + 1
    return np.stack([signal[i : i + length].ravel() for i in range(columns)], axis=1)


def excitation_length(task: Task) -> int:
    """Return the number of excitation steps of ``deepc``, the least for persistency of excitation."""
    return (task.plant.q + 1) * (task.stacked + _AHEAD + task.plant.p * task.order) - 1


def deepc(task: Task) -> Run:
    r"""Excite the plant, then plan every input with the measured trajectories.

    The exciting inputs are normal with standard deviation ``task.size`` and last T steps, the least for persistency of
    excitation: :math:`T = (q+1)(T_{ini} + N + p\,m) - 1`, with the given order m, N = 20 steps ahead, and
    :math:`T_{ini} = m` or, with noise, 3m. Outputs are scaled by their first sizes and inputs by ``task.size``. In this
    scale :math:`\lambda_y = 10^8`, and :math:`\lambda_g` is ten times what the noise adds to predicted outputs,
    :math:`10 N p\,\sigma^2`, at least 1e-8: without noise the past holds exactly, as in the problem without slack. If T
    reaches the number of steps, the whole run is excitation. Longer excitation is worse here, since an unstable plant
    diverges meanwhile.

    References
    ----------
    J. Coulson, J. Lygeros and F. Dörfler, Data-enabled predictive control: in the shallows of the DeePC, European
    Control Conference 2019, with the squares for regularisation of E. Elokda, J. Coulson, P. N. Beuchat, J. Lygeros and
    F. Dörfler, Data-enabled predictive control for quadcopters, International Journal of Robust and Nonlinear Control
    31(18), 2021, so that without active bounds a plan is linear in the measurements.
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
