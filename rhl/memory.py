"""An estimator that uses every measured transition, with memory of constant size."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rhl._checks import Array, instance, positive
from rhl._lanes import from_lanes, to_lanes
from rhl.errors import InputError
from rhl.losses import WeightedSquares
from rhl.model import SignalModel


@dataclass(frozen=True, eq=False)
class GrowingMemory:
    r"""One proximal step towards all transitions since the window was first full of measurements.

    .. math::
        \theta^*(k) = \arg\min_\theta \sum_{j=m}^{k} |x(j) - A x(j-1) - B u(j-1)|^2
            + \rho |\theta - \tilde\theta(k-1)|^2

    This is equation (15) with squares and a growing window. The window starts at m = max(N_y, N_v), the first
    transition without zeros from before k = 0. The loss never decreases in k, so the iterates of Lemma 4 converge into
    X as printed. The transitions are stored as the triangle of their orthogonal factorisation, so memory and time of a
    step are constant. No data are discarded, so changes of the plant and outliers affect all later estimates.

    Parameters
    ----------
    weight : float
        :math:`\rho`, positive. With ``RunningUnits`` it is relative to the sizes of signals; otherwise it has the unit
        of squares of x and u.

    Examples
    --------
    >>> memory = GrowingMemory(1e-12)
    >>> data = memory.remember(memory.begin(1, 1), np.array([[1.5], [1.0]]), np.array([[0.0]]))
    >>> memory.minimise(SignalModel([[0.0]], [[1.0]]), data).A.round(9)  # the input was zero: B stays
    array([[1.5]])
    """

    weight: float = 1e-10

    # Attributes that other parts expect of every estimator.
    window = 1
    by_rows = False
    constraints = None
    loss = WeightedSquares()
    generator = WeightedSquares()

    def __post_init__(self) -> None:
        positive("weight", self.weight)

    def begin(self, n: int, q: int) -> Array:
        """Return the memory without transitions, shape (n + q, 2 n + q), for x of size n and u of size q."""
        return np.zeros((n + q, 2 * n + q))

    def remember(self, data: Array, x: Array, u: Array) -> Array:
        r"""Return the memory with one more transition, from x and u as ``ProximalEstimator.minimise`` takes them.

        x holds x(k), x(k-1), shape (..., 2, n), u holds u(k-1), shape (..., 1, q). The memory [T, Z], shape
        (..., n + q, 2 n + q), has T upper triangular, and the sum of squares is \|T theta' - Z\|^2 plus a constant.
        """
        from rhl.kernels import loops  # imported here, because loading the compiler takes longer than the rest

        row = np.concatenate([x[..., 1:2, :], u[..., :1, :], x[..., :1, :]], axis=-1)
        lead, d = np.broadcast_shapes(data.shape[:-2], row.shape[:-2]), data.shape[-2]
        triangle = to_lanes(data, lead, 2)
        loops.rotate(triangle, to_lanes(row, lead, 2), d)
        return from_lanes(triangle, lead)

    def minimise(self, centre: SignalModel, data: Array, size: Array | None = None) -> SignalModel:
        """Return theta*(k) for the memory; ``size``, (..., n + q), are the sizes of [x; u], one if left out."""
        from rhl.kernels import loops

        instance("centre", centre, SignalModel)
        n, d = centre.n, centre.n + centre.q
        if data.shape[-2:] != (d, d + n):
            raise InputError(f"data must have shape ({d}, {d + n}), as begin returns it, got {data.shape[-2:]}")
        theta = np.concatenate([centre.A, centre.B], axis=-1)
        T, Z = data[..., :d], data[..., d:]
        # Copies, because some versions of numpy sum in an order that depends on the layout, and a run must have equal
        # bits alone and in a batch.
        off = Z - np.ascontiguousarray(T) @ np.ascontiguousarray(theta.swapaxes(-1, -2))
        rows = np.concatenate([np.broadcast_to(T, (*off.shape[:-2], d, d)), off], axis=-1)
        triangle, lead = self._held(rows, size)
        loops.back_substitute(triangle, d)
        found = theta + from_lanes(triangle[:, d:], lead).swapaxes(-1, -2)
        return SignalModel(found[..., :n], found[..., n:])

    def unknown(self, data: Array, size: Array | None = None) -> Array:
        r"""Return the posterior share of the prior variance of each column of theta, shape (..., n + q).

        .. math:: \rho s_i^2 \, \big[(T^\top T + \rho \, \mathrm{diag}(s)^2)^{-1}\big]_{ii}

        This is the posterior over the prior variance of a Bayesian linear regression with the prior variance
        :math:`s_i^{-2}` and errors of variance :math:`\rho`: one for an empty memory, and near zero once the
        data determine the column. ``data`` and ``size``, s, are as ``minimise`` takes them.
        """
        root = self._root_of_spread(data, size)
        return np.asarray(np.sum(np.square(root), axis=-1))

    def spread(self, data: Array) -> Array:
        r"""Return the factor by which the memory reduces a distance to the centre, shape (..., n + q, n + q).

        .. math:: M = \rho \, (T^\top T + \rho I)^{-1}

        If the transitions obey a signal model theta, as rows [A B], then ``minimise`` with the centre theta_0 returns
        theta - (theta - theta_0) M.
        """
        root = self._root_of_spread(data, None)
        return np.asarray(root @ root.swapaxes(-1, -2))

    def _root_of_spread(self, data: Array, size: Array | None) -> Array:
        from rhl.kernels import loops

        d = data.shape[-2]
        triangle, lead = self._held(data[..., :d], size)
        inverse = np.concatenate([triangle, np.broadcast_to(np.eye(d)[..., None], triangle.shape)], axis=1)
        loops.back_substitute(inverse, d)
        roots = np.sqrt(self.weight) * (np.ones(d) if size is None else size)
        return np.asarray(roots[..., None] * from_lanes(inverse[:, d:], lead))

    def _held(self, rows: Array, size: Array | None) -> tuple[Array, tuple[int, ...]]:
        """Return, in lanes, the triangle of the rows below the roots of the generator's weights; and the batch."""
        from rhl.kernels import loops

        d = rows.shape[-2]
        roots = np.sqrt(self.weight) * (np.ones(d) if size is None else size)
        lead = np.broadcast_shapes(rows.shape[:-2], roots.shape[:-1])
        held = np.concatenate([roots[..., None] * np.eye(d), np.zeros((*roots.shape[:-1], d, rows.shape[-1] - d))], -1)
        triangle = to_lanes(held, lead, 2)
        loops.rotate(triangle, to_lanes(rows, lead, 2), d)
        return triangle, lead

    def newton_decrement(
        self, model: SignalModel, centre: SignalModel, after: Array, before: Array, u: Array, size: Array | None = None
    ) -> Array:
        """Certify a solution from the transitions themselves: the distance of a model from the minimiser, shape (...).

        ``after`` and ``before``, shape (..., T, n), hold x(j) and x(j-1) of T transitions, ``u``, shape (..., T, q),
        holds u(j-1); ``size`` is that of ``minimise``. Returns Newton's step relative to the model, as
        ``ProximalEstimator.newton_decrement`` does; both are in the metric of the weight.
        """
        theta, held = (np.concatenate([of.A, of.B], axis=-1) for of in (model, centre))
        known, d = np.concatenate([before, u], axis=-1), theta.shape[-1]
        roots = np.sqrt(self.weight) * (np.ones(d) if size is None else size)
        hold = roots[..., None] * np.eye(d)
        misfit = after - known @ theta.swapaxes(-1, -2), hold @ (held - theta).swapaxes(-1, -2)
        lead = np.broadcast_shapes(known.shape[:-2], misfit[0].shape[:-2], misfit[1].shape[:-2], hold.shape[:-2])
        rows, off = (
            np.concatenate([np.broadcast_to(part, (*lead, *part.shape[-2:])) for part in parts], axis=-2)
            for parts in ((known, hold), misfit)
        )
        Q, R = np.linalg.qr(rows)
        newton = np.linalg.solve(R, Q.swapaxes(-1, -2) @ off).swapaxes(-1, -2)
        length, whole = (np.linalg.norm(roots[..., None, :] * of, axis=(-1, -2)) for of in (newton, theta))
        return np.asarray(length / np.where(whole > 0, whole, 1.0))
