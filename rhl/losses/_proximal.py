"""Equation (15) for one window: squares in closed form; Newton's step and the certificate, row by row of [A B]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib.util import find_spec

import numpy as np

from rhl._checks import Array
from rhl.losses._convex import Convex, called

# The largest accepted relative distance from the minimiser. Newton's method reaches 1e-12 on most problems; with the
# residuals of a diverging run, 1e8 and more, squaring them limits its accuracy.
TOLERANCE = 1e-7
# A residual counts as far out on a loss if the gradient is this many times the curvature times the residual.
_STRAIGHT = 100.0
# Finite differences of a user's gradient give zero curvatures up to this share of the others, of either sign.
_FLAT = 1e-6
# With more parameters LAPACK's factorisations are faster than compiled rotations; they are always faster than
# interpreted ones.
_FEW = 500
_COMPILES = find_spec("numba") is not None


def regression_of_rows(x: Array, u: Array) -> tuple[Array, Array]:
    """Return s(k) and the regressor that all rows of [A B] share, shapes (..., window n) and (..., window, n + q)."""
    regressors = np.concatenate([x[..., 1:, :], u], axis=-1)
    return x[..., :-1, :].reshape(*x.shape[:-2], -1), regressors


def regression(x: Array, u: Array) -> tuple[Array, Array]:
    """Return s(k) and R(k) of equations (16) and (17), shapes (..., window n) and (..., window n, n (n + q))."""
    n, (s, regressors) = x.shape[-1], regression_of_rows(x, u)
    R = np.einsum("...ja,bc->...jbac", regressors, np.eye(n))
    lead, (window, size) = regressors.shape[:-2], regressors.shape[-2:]
    return s, R.reshape(*lead, window * n, size * n)


def quadratic(s: Array, R: Array, c: Array | float, g: Array | float, centre: Array, free: Array) -> Array:
    """Minimise over centre + range(free) for squares with weights c and g; any batch axes lead."""
    trust, hold = _root(c, s.shape[-1]), _root(g, centre.shape[-1])
    # In eta = hold free xi, orthogonalised, the proximal term is |eta|^2 for all weights.
    directions = free @ np.linalg.inv(np.linalg.qr(hold @ free, mode="r"))
    target = ((s - np.einsum("...ab,...b->...a", R, centre)) @ trust.T)[..., None]
    rows = trust @ R @ directions
    eye = np.broadcast_to(np.eye(rows.shape[-1]), (*rows.shape[:-2], rows.shape[-1], rows.shape[-1]))
    target = np.concatenate([target, np.zeros((*target.shape[:-2], rows.shape[-1], 1))], axis=-2)
    orthogonal, upper = np.linalg.qr(np.concatenate([rows, eye], axis=-2))
    eta = np.linalg.solve(upper, orthogonal.swapaxes(-1, -2) @ target)[..., 0]
    return centre + eta @ directions.T


def _root(weight: Array | float, size: int) -> Array:
    weight = np.asarray(weight, dtype=np.float64)
    root = np.linalg.cholesky(weight).T if weight.ndim == 2 else np.diag(np.broadcast_to(np.sqrt(weight), size))
    return np.asarray(root)


class Flat(Exception):
    """There is no Newton step, for lack of curvature or range; a user's function never raises this."""


@dataclass(frozen=True, eq=False)
class Proximal:
    """Equation (15) for one window: minimise c(s - R theta) + D(theta, centre) over centre + range(free).

    With as many blocks as rows of [A B], all blocks share one regressor: the residuals are S - R Theta, where
    S, (m, blocks), and Theta, (d, blocks), hold s and theta row by row. The problem then splits into one for each
    block, unless a second derivative of c or g is a full matrix. A single block covers the general problem.

    s, shape (m blocks,), and R, shape (m, d), are those of equations (16) and (17); c is the loss and g the generator;
    the proximal centre has shape (d blocks,). ``free`` holds the directions in which the parameters of each block may
    move, shapes (d, freedom); None: any.
    """

    s: Array
    R: Array
    c: Convex
    g: Convex
    centre: Array
    free: Sequence[Array] | None = None

    @property
    def blocks(self) -> int:
        """The number of separate problems."""
        return len(self.s) // len(self.R)

    def residual(self, theta: Array) -> Array:
        """Return s - R theta, newest transition first."""
        return self.s - (self.R @ theta.reshape(-1, self.blocks)).ravel()

    def value(self, theta: Array) -> float:
        """Return the objective; infinite outside the generator's domain."""
        with np.errstate(all="ignore"):
            D = self.g.value(theta) - self.g.value(self.centre) - (theta - self.centre) @ self._from_centre
            total = float(self.c.value(self.residual(theta)) + D)
        return np.inf if np.isnan(total) else total

    def gradient(self, theta: Array) -> Array:
        """Return the gradient with respect to theta, shape (d blocks,)."""
        pull = self.R.T @ self.c.gradient(self.residual(theta)).reshape(-1, self.blocks)
        return self.g.gradient(theta) - self._from_centre - pull.ravel()

    @cached_property
    def _from_centre(self) -> Array:
        return self.g.gradient(self.centre)

    @cached_property
    def whole(self) -> Proximal:
        """The same problem as a single block."""
        if self.blocks == 1:
            return self
        eye = np.eye(self.blocks)
        free = None
        if self.free is not None:
            free = [
                np.concatenate([np.kron(basis, row[:, None]) for basis, row in zip(self.free, eye, strict=True)], 1)
            ]
        return replace(self, R=np.asarray(np.kron(self.R, eye), dtype=np.float64), free=free)

    @cached_property
    def _moving(self) -> tuple[np.ndarray, Array | None]:
        """The blocks that may move, and their directions, padded with zeros to equal number."""
        if self.free is None:
            return np.arange(self.blocks), None
        rows = np.array([i for i, basis in enumerate(self.free) if basis.shape[1]], dtype=int)
        bases = np.zeros((len(rows), self.R.shape[1], max((self.free[i].shape[1] for i in rows), default=0)))
        for at, i in enumerate(rows):
            bases[at, :, : self.free[i].shape[1]] = self.free[i]
        return rows, bases

    def newton_decrement(self, theta: Array) -> float:
        """Return the distance of theta from the minimiser: the norm of Newton's step, relative to theta's.

        This is exact if c and g are quadratic, and otherwise correct up to terms of second order.
        """
        try:
            return self.certified(theta, *self.newton(theta))
        except Flat:
            return np.inf

    def certified(self, theta: Array, length: float, step: Array) -> float:
        """Return the distance, given Newton's step from there."""
        # On the kink of a sharp valley the step is short anywhere; the next step is short only near the minimiser.
        if length <= TOLERANCE and np.all(theta + step > self.g.lower):
            length = max(length, self.newton(theta + step)[0])
        return length if np.isfinite(length) else np.inf

    def newton(self, theta: Array) -> tuple[float, Array]:
        """Return the norm of Newton's step, in the generator's metric and relative to theta's, and the step.

        Flat if the loss has negative curvature, or the generator no positive one.
        """
        e = self.residual(theta)
        slope, bend = self.c.gradient(e), self.c.hessian(e)
        hold, back = self.g.hessian(theta), self._from_centre - self.g.gradient(theta)
        of = self if bend.ndim == hold.ndim == 1 else self.whole
        try:
            return of._newton(theta, e, slope, bend, hold, back)
        except np.linalg.LinAlgError as error:
            raise Flat(str(error)) from error

    def _newton(
        self, theta: Array, e: Array, slope: Array, bend: Array, hold: Array, back: Array
    ) -> tuple[float, Array]:
        R, free = self.R, self.free
        if bend.ndim == 2:
            bend, axes = np.linalg.eigh(bend)
            e, slope, R = axes.T @ e, axes.T @ slope, axes.T @ R
        if np.any(bend < -_FLAT * np.max(np.abs(bend), initial=0.0)):
            raise np.linalg.LinAlgError(f"{called(self.c)} has negative curvature, so it is not convex")
        if hold.ndim == 1 and not np.all(hold > 0):
            raise np.linalg.LinAlgError(f"{called(self.g)} has no curvature, so it is not strictly convex")
        if hold.ndim == 1 and free is None and self._for_kernel:
            steps = self._compiled(e, slope, bend, hold, back)
        else:
            steps = self._factorised(R, e, slope, bend, hold, back)
        step: Array = steps.ravel()
        if hold.ndim == 1:
            upper = np.sqrt(hold)
            length, size = np.linalg.norm(upper * step), np.linalg.norm(upper * theta)
        else:
            upper = np.linalg.cholesky(hold).T
            length, size = np.linalg.norm(upper @ step), np.linalg.norm(upper @ theta)
        return float(length / size) if size > 0 else float(np.linalg.norm(step)), step

    @property
    def _for_kernel(self) -> bool:
        """Whether to use the compiled rotations: with a compiler and few parameters."""
        return self.blocks > 1 and len(self.centre) <= _FEW and _COMPILES

    def _compiled(self, e: Array, slope: Array, bend: Array, hold: Array, back: Array) -> Array:
        from rhl.kernels import loops  # imported here, because loading the compiler takes longer than the rest

        e, slope, bend, hold, back = (of.reshape(-1, self.blocks) for of in (e, slope, bend, hold, back))
        root, bent = _roots(e, slope, bend)
        upper, steps = np.sqrt(hold), np.empty(hold.shape)
        given = root, np.where(bent, slope / np.where(bent, root, 1), 0), np.where(bent, 0, slope), upper, back / upper
        loops.newton_step(np.ascontiguousarray(self.R), *given, steps)
        return steps

    def _factorised(self, R: Array, e: Array, slope: Array, bend: Array, hold: Array, back: Array) -> Array:
        rows, free = self._moving
        bends, holds = bend.reshape(-1, self.blocks), hold if hold.ndim == 2 else hold.reshape(-1, self.blocks)
        # Blocks that differ only in their targets share one factorisation, with a column for each.
        shared = free is None and hold.ndim == 1 and _same(bends) and _same(holds)

        def columns(of: Array) -> Array:
            of = of.reshape(-1, self.blocks)
            return of[None] if shared else of[:, rows].T[..., None]

        e, slope, back, bend = (columns(of) for of in (e, slope, back, bend))
        root, bent = _roots(e, slope, bend)
        directions = self._directions(holds[:, :1] if shared else holds, rows, free)
        pulled = R @ directions
        # Newton's step solves a least-squares problem in eta = upper step; its normal equations would square the data.
        (m, f), count = pulled.shape[-2:], e.shape[-1]
        tableau = np.zeros((len(pulled), m + f, f + count))
        tableau[:, :m, :f], tableau[:, :m, f:] = root[..., :1] * pulled, slope / np.where(bent, root, np.inf)
        tableau[:, range(m, m + f), range(f)], tableau[:, m:, f:] = 1.0, directions.swapaxes(-1, -2) @ back
        rotated = np.asarray(np.linalg.qr(tableau, mode="r"))
        triangular, eta = rotated[:, :f, :f], rotated[:, :f, f:]
        if not np.all(bent):
            straight = pulled.swapaxes(-1, -2) @ np.where(bent, 0, slope)
            eta = eta + np.linalg.solve(triangular.swapaxes(-1, -2), straight)
        moved = directions @ np.linalg.solve(triangular, eta)
        steps = np.zeros((len(hold) // self.blocks, self.blocks))
        steps[:, rows] = moved[0] if shared else moved[..., 0].T
        return steps

    def _directions(self, hold: Array, rows: np.ndarray, free: Array | None) -> Array:
        """Return directions in which the proximal term is |eta|^2 / 2, to second order."""
        if self.blocks == 1 and hold.shape[1] > 1:
            upper = np.linalg.cholesky(hold).T[None]
            weighed = upper if free is None else upper @ free
        else:
            root = np.sqrt(hold.T)
            if free is None:
                return np.eye(root.shape[1]) / root[..., None]
            weighed = root[rows][..., None] * free
        if free is None:
            return np.linalg.inv(weighed)
        # A padding direction gets an arbitrary norm, orthogonal to all others.
        filling = np.zeros((len(weighed), *[weighed.shape[-1]] * 2))
        at = np.arange(weighed.shape[-1])
        filling[:, at, at] = ~np.any(weighed, axis=-2)
        return free @ np.linalg.inv(np.linalg.qr(np.concatenate([weighed, filling], axis=-2), mode="r"))


def _roots(e: Array, slope: Array, bend: Array) -> tuple[Array, np.ndarray]:
    """Return the roots of a loss's curvature, and where the gradient is a root times a finite target.

    It is not if the loss has almost no curvature there.
    """
    return np.sqrt(np.maximum(bend, 0)), (bend > 0) & (np.abs(slope) <= _STRAIGHT * bend * np.abs(e))


def _same(columns: Array) -> bool:
    return bool(np.all(columns == columns[:, :1]))
