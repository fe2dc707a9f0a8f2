"""Equation (15) in the paper's vectors: the quadratic case by one factorisation, every other case by scipy."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import minimize

from rhl._checks import Array
from rhl.errors import InputError, NotSolvedError
from rhl.losses import Convex, WeightedSquares, called

# The relative distance to the minimiser that an answer may have. The solver reaches 1e-12 on most problems; residuals
# of a diverging run, 1e8 and more, leave it with what their squares leave of sixteen digits.
_TOLERANCE = 1e-7
_ITERATIONS = 60
# A residual counts as far out on a loss where its pull is this many times what the curvature there would give.
_STRAIGHT = 100.0
# Newton steps after the solver, which stops at what the squares of the data leave; the last ones change nothing.
_POLISHES = 3
# Residuals that are 1e30 times the loss's scale are beyond what sixteen digits can tell apart.
_MOST_HALVINGS = 100
# Differences of a user's gradient show curvatures that are zero as this share of the others, above or below.
_FLAT = 1e-6
# A step this short, relative to the model, is below rounding, and what the solver is given would underflow.
_NO_STEP = 1e-16


def regression(x: Array, u: Array) -> tuple[Array, Array]:
    """Return s(k) and R(k) of equations (16) and (17), shapes (..., window n) and (..., window n, n (n + q))."""
    n = x.shape[-1]
    regressors = np.concatenate([x[..., 1:, :], u], axis=-1)
    R = np.einsum("...ja,bc->...jbac", regressors, np.eye(n))
    lead, (window, size) = regressors.shape[:-2], regressors.shape[-2:]
    return x[..., :-1, :].reshape(*lead, window * n), R.reshape(*lead, window * n, size * n)


def quadratic(s: Array, R: Array, c: WeightedSquares, g: WeightedSquares, centre: Array, free: Array) -> Array:
    """Minimise over centre + range(free) where c and g are weighted squares; any batch axes lead."""
    trust, hold = _root(c.weight, s.shape[-1]), _root(g.weight, centre.shape[-1])
    # In eta = hold free xi, orthogonalised, the proximal term is |eta|^2, whatever the weights.
    directions = free @ np.linalg.inv(np.linalg.qr(hold @ free, mode="r"))
    target = ((s - np.einsum("...ab,...b->...a", R, centre)) @ trust.T)[..., None]
    rows = trust @ R @ directions
    eye = np.broadcast_to(np.eye(rows.shape[-1]), (*rows.shape[:-2], rows.shape[-1], rows.shape[-1]))
    target = np.concatenate([target, np.zeros((*rows.shape[:-2], rows.shape[-1], 1))], axis=-2)
    orthogonal, upper = np.linalg.qr(np.concatenate([rows, eye], axis=-2))
    eta = np.linalg.solve(upper, orthogonal.swapaxes(-1, -2) @ target)[..., 0]
    return centre + eta @ directions.T


def _root(weight: Array | float, size: int) -> Array:
    weight = np.asarray(weight, dtype=np.float64)
    root = np.linalg.cholesky(weight).T if weight.ndim == 2 else np.diag(np.broadcast_to(np.sqrt(weight), size))
    return np.asarray(root)


@dataclass(frozen=True, eq=False)
class Proximal:
    """Equation (15) for one window: minimise c(s - R theta) + D(theta, centre) over centre + range(free).

    Attributes
    ----------
    s, R : array, shapes (m,) and (m, d)
        Equations (16) and (17).
    c, g : Convex
        Loss and generator.
    centre : array, shape (d,)
        The proximal centre.
    free : array, shape (d, freedom)
        Directions in which theta may move.
    """

    s: Array
    R: Array
    c: Convex
    g: Convex
    centre: Array
    free: Array

    def value(self, theta: Array) -> float:
        """Return the objective; infinite outside the generator's domain."""
        with np.errstate(all="ignore"):
            D = self.g.value(theta) - self.g.value(self.centre) - (theta - self.centre) @ self.g.gradient(self.centre)
            total = float(self.c.value(self.s - self.R @ theta) + D)
        return np.inf if np.isnan(total) else total

    def gradient(self, theta: Array) -> Array:
        """Return the gradient with respect to theta, shape (d,)."""
        return (
            self.g.gradient(theta) - self.g.gradient(self.centre) - self.R.T @ self.c.gradient(self.s - self.R @ theta)
        )

    def hessian(self, theta: Array) -> Array:
        """Return the second derivatives, shape (d, d)."""
        bend, hold = self.c.hessian(self.s - self.R @ theta), self.g.hessian(theta)
        data = self.R.T @ (bend[:, None] * self.R if bend.ndim == 1 else bend @ self.R)
        return data + (np.diag(hold) if hold.ndim == 1 else hold)

    def newton_decrement(self, theta: Array) -> float:
        """Return how far theta is from the minimiser: the length of Newton's step, relative to theta's.

        Where c and g are quadratic this is the distance itself, elsewhere the distance but for terms of second order.
        """
        try:
            length, step = self.newton(theta)
            # On the kink of a sharp valley the step is short, wherever the minimiser is: so is the next only near it.
            if length <= _TOLERANCE and np.all(theta + step > self.g.lower):
                length = max(length, self.newton(theta + step)[0])
        except np.linalg.LinAlgError:
            return np.inf
        return length

    def newton(self, theta: Array) -> tuple[float, Array]:
        """Return the length of Newton's step, in the generator's metric and relative to theta's, and the step.

        Raises
        ------
        LinAlgError
            If the loss bends down, or the generator does not bend up.
        """
        e, R, hold = self.s - self.R @ theta, self.R, self.g.hessian(theta)
        bend, slope = self.c.hessian(e), self.c.gradient(e)
        if bend.ndim == 2:
            bend, axes = np.linalg.eigh(bend)
            e, slope, R = axes.T @ e, axes.T @ slope, axes.T @ R
        if np.any(bend < -_FLAT * np.max(np.abs(bend), initial=0.0)):
            raise np.linalg.LinAlgError(f"{called(self.c)} has negative curvature, so it is not convex")
        upper = np.linalg.cholesky(hold if hold.ndim == 2 else np.diag(hold)).T
        # Newton's step solves a least-squares problem in eta = upper step; its normal equations would square the data.
        directions = self.free @ np.linalg.inv(np.linalg.qr(upper @ self.free, mode="r"))
        root = np.sqrt(np.maximum(bend, 0))
        pulled = R @ directions
        orthogonal, triangular = np.linalg.qr(
            np.concatenate([root[:, None] * pulled, np.eye(directions.shape[1])]),
        )
        # Only where the loss has hardly any curvature left, its pull cannot be written as root times a target.
        bent = (bend > 0) & (np.abs(slope) <= _STRAIGHT * bend * np.abs(e))
        target = np.where(bent, slope / np.where(bent, root, 1), 0)
        hold_back = directions.T @ (self.g.gradient(self.centre) - self.g.gradient(theta))
        eta = orthogonal.T @ np.concatenate([target, hold_back])
        eta = eta + np.linalg.solve(triangular.T, pulled[~bent].T @ slope[~bent])
        step = directions @ np.linalg.solve(triangular, eta)
        size = float(np.linalg.norm(upper @ theta))
        return float(np.linalg.norm(upper @ step)) / size if size > 0 else float(np.linalg.norm(step)), step

    def solve(self) -> Array:
        """Return the minimiser, found by scipy's trust-region method from the centre, and certified.

        Raises
        ------
        InputError
            If the centre is not in the generator's domain.
        NotSolvedError
            If the certificate is missed.
        """
        if not np.all(self.centre > self.g.lower):
            raise InputError(
                f"the proximal centre must lie in the domain of {called(self.g)}, above {self.g.lower:g}, got "
                f"{self.centre.min():.3g}; choose an initial model inside"
            )
        theta, distance, message = self._descend(self.centre)
        if not distance <= _TOLERANCE:
            # Far beyond its scale a robust loss is a sharp valley. Along c(t e) / t^2, whose scale is larger by 1/t,
            # the minimiser moves continuously; followed from a t at which the loss is nearly a square, it is found.
            theta = self.centre
            for t in 0.5 ** np.arange(self._halvings(), -1, -1.0):
                theta, distance, message = replace(self, c=_Scaled(self.c, t))._descend(theta)
        if not distance <= _TOLERANCE:
            raise NotSolvedError(
                f"the estimator's problem must be solved to a relative distance of {_TOLERANCE:g} from its minimiser, "
                f"got {distance:.3g} ({message}); give the loss a larger scale, or the generator more weight"
            )
        return theta

    def _halvings(self) -> int:
        """Return how often the residuals at the centre must be halved until the loss is nearly a square there."""
        e, count = self.s - self.R @ self.centre, 0

        def bend(at: Array) -> Array:
            found = self.c.hessian(at)
            return np.diagonal(found) if found.ndim == 2 else found

        while count < _MOST_HALVINGS and np.any(bend(0.5**count * e) < bend(0 * e) / 2):
            count += 1
        return count + 4

    def _descend(self, start: Array) -> tuple[Array, float, str]:
        """Return scipy's answer from a starting point, its distance, and the solver's words."""
        try:
            distance, (_, step) = self.newton_decrement(start), self.newton(start)
            if distance < _NO_STEP:
                return start + step if np.all(start + step > self.g.lower) else start, distance, ""
            try:
                theta, message = self._trust(start, step)
            except InputError:
                raise
            except (np.linalg.LinAlgError, ValueError) as error:
                # The squares of data of 1e8 and more leave the solver a singular matrix, or one with infinite entries,
                # which scipy refuses; Newton's step needs none.
                theta, message = start, str(error)
            theta = self._polish(theta)
            return theta, self.newton_decrement(theta), message
        except InputError:
            raise
        except (np.linalg.LinAlgError, ValueError) as error:
            return start, np.inf, str(error)

    def _trust(self, start: Array, step: Array) -> tuple[Array, str]:
        hold = self.g.hessian(start)
        hold = np.diag(hold) if hold.ndim == 1 else hold
        # In eta the proximal term is |eta|^2 / 2 to second order, whatever the generator.
        factor = np.linalg.cholesky(self.free.T @ hold @ self.free)
        directions = solve_triangular(factor, self.free.T, lower=True).T
        reach = float(np.sqrt(step @ hold @ step))
        # scipy's inner iteration does not end where a number is not finite, or where the radius is none.
        _within_range(np.asarray([reach, 1e6 * reach, 1 / reach**2 if reach > 0 else np.inf]))
        found = minimize(
            lambda eta: self.value(start + directions @ eta) / reach**2,
            np.zeros(directions.shape[1]),
            jac=lambda eta: _within_range(directions.T @ self.gradient(start + directions @ eta) / reach**2),
            hess=lambda eta: _within_range(
                directions.T @ self.hessian(start + directions @ eta) @ directions / reach**2
            ),
            method="trust-exact",
            options={
                "initial_trust_radius": reach,
                "max_trust_radius": 1e6 * reach,
                "gtol": 1e-10 / reach,
                "maxiter": _ITERATIONS,
            },
        )
        theta = start + directions @ found.x
        return theta, found.message

    def _polish(self, theta: Array) -> Array:
        length, step = self.newton(theta)
        for _ in range(_POLISHES):
            if not np.all(theta + step > self.g.lower):
                break
            shorter, further = self.newton(theta + step)
            if not shorter < length:
                break
            theta, length, step = theta + step, shorter, further
        return theta


def _within_range(array: Array) -> Array:
    if not np.all(np.isfinite(array)):
        raise np.linalg.LinAlgError("the problem leaves the range of floating-point numbers")
    return array


@dataclass(frozen=True, eq=False)
class _Scaled:
    """The loss c(t e) / t^2."""

    c: Convex
    t: float

    @property
    def name(self) -> str:
        return called(self.c)

    @property
    def lower(self) -> float:
        return self.c.lower

    @property
    def assumption_6(self) -> bool | None:
        return self.c.assumption_6

    @property
    def convex_in_second(self) -> bool | None:
        return self.c.convex_in_second

    def value(self, x: Array) -> Array:
        return self.c.value(self.t * x) / self.t**2

    def gradient(self, x: Array) -> Array:
        return self.c.gradient(self.t * x) / self.t

    def hessian(self, x: Array) -> Array:
        return self.c.hessian(self.t * x)
