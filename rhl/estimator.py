"""The proximal (Bregman) estimator of the signal model, equation (15)."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from typing import cast

import numpy as np

from rhl._checks import Array, describe, instance, integer, real_array
from rhl._lanes import blocks, from_lanes, to_lanes
from rhl.constraints import LinearConstraints
from rhl.errors import AssumptionWarning, InputError
from rhl.losses import Convex, Varying, WeightedSquares, called, convex
from rhl.losses._descent import solve
from rhl.losses._proximal import Proximal, quadratic, regression, regression_of_rows
from rhl.model import SignalModel


@dataclass(frozen=True, eq=False)
class ProximalEstimator:
    r"""One proximal step towards the data of a short window, equation (15).

    .. math::
        \theta^*(k) = \arg\min_\theta\; c(s(k) - R(k)\theta, k) + D(\theta, \tilde\theta(k-1))
        \quad\text{s.t. } M \theta = b

    Parameters
    ----------
    window : int
        :math:`\bar N`, at least 1: the number of transitions x(j-1), u(j-1) -> x(j) that are fitted.
    loss : Convex or Varying
        c, of ``rhl.losses`` or of your own; weights: one number, or one for each of the window n residuals, newest
        transition first.
    generator : Convex
        g, which induces D, likewise; weights: one number, or one for each of the n (n + q) parameters, column by
        column.
    constraints : LinearConstraints, optional
        M and b, prior knowledge of the model.

    Warns
    -----
    AssumptionWarning
        Once for each new estimator, if Assumption 6 fails or is not known for the loss or the generator, or if the
        generator's distance is not known to be convex in its second argument (Lemma 4).

    Notes
    -----
    Source: equations (15) to (17). If loss and generator are sums over entries and no equality couples rows of [A B],
    the problem splits into one for each row (Remark 2), which are solved and certified separately. With weighted
    squares each is a regularised least-squares problem, solved by an orthogonal factorisation without squaring the
    data. Newton's method solves the problem for every other loss and generator, and scipy's trust-region method if
    Newton's fails; the result must pass the certificate ``newton_decrement``.
    """

    window: int
    loss: Convex | Varying = field(default_factory=WeightedSquares)
    generator: Convex = field(default_factory=WeightedSquares)
    constraints: LinearConstraints | None = None

    def __post_init__(self) -> None:
        integer("window", self.window, 1)
        if not isinstance(self.loss, Varying):
            _for_residuals(convex("loss", self.loss))
            _warn_of_assumption_6("loss", self.loss)
        convex("generator", self.generator)
        _warn_of_assumption_6("generator", self.generator)
        known = self.generator.convex_in_second
        if not known:
            warnings.warn(
                f"Lemma 4 and Theorem 2 ask for a Bregman distance that is convex in its second argument: that of the "
                f"generator {called(self.generator)} is not{' known to be' if known is None else ''}, so the estimates "
                "need not converge",
                AssumptionWarning,
                stacklevel=3,
            )
        if not (self.constraints is None or isinstance(self.constraints, LinearConstraints)):
            raise InputError(f"constraints must be a LinearConstraints or None, got {describe(self.constraints)}")

    def minimise(self, centre: SignalModel, x: Array, u: Array, k: int = 0, size: Array | None = None) -> SignalModel:
        r"""Return :math:`\theta^*(k)`, the minimiser of equation (15), as a signal model.

        Parameters
        ----------
        centre : SignalModel
            The proximal centre :math:`\tilde\theta(k-1)`; must satisfy the constraints and lie in the generator's
            domain.
        x : array, shape (..., window + 1, n)
            x(k), x(k-1), ..., x(k - window).
        u : array, shape (..., window, q)
            u(k-1), ..., u(k - window).
        k : int
            The step, for a loss that varies.
        size : array, shape (..., n + q), optional
            Scales of [x; u] for loss and generator; one if left out.

        Raises
        ------
        InputError
            If shapes or weights do not fit, the centre is invalid, or a user's function returns an invalid value.
        NotSolvedError
            If the solution of a problem that is not quadratic fails its certificate.
        """
        if size is not None:
            of_x, of_u = size[..., : centre.n], size[..., centre.n :]
            x, u = x / of_x[..., None, :], u / of_u[..., None, :]
            return self.minimise(centre.counted(1.0 / of_x, 1.0 / of_u), x, u, k).counted(of_x, of_u)
        loss, x, u = self._problem(centre, x, u, k)
        if isinstance(loss, WeightedSquares) and isinstance(self.generator, WeightedSquares):
            return self._squares(loss, self.generator, centre, x, u, k)
        lead, problems = self._problems(loss, centre, x, u)
        theta = np.reshape([solve(problem) for problem in problems], (*lead, centre.theta.shape[-1]))
        return SignalModel.from_theta(theta, centre.n, centre.q)

    def newton_decrement(
        self, model: SignalModel, centre: SignalModel, x: Array, u: Array, k: int = 0, size: Array | None = None
    ) -> Array:
        r"""Certify a solution: the distance of a model from the minimiser of (15), recomputed from the problem.

        The problem is given as in ``minimise``. Returns :math:`\|\delta\|/\|\theta\|`, shape (...), with Newton's step
        :math:`\delta` and the metric :math:`\nabla^2 g(\theta)`: the relative distance, exact if c and g are
        quadratic and otherwise up to terms of second order. The best attainable value is about 1e-16.
        """
        instance("model", model, SignalModel)
        if size is not None:
            of_x, of_u = size[..., : centre.n], size[..., centre.n :]
            x, u = x / of_x[..., None, :], u / of_u[..., None, :]
            model, centre = (of.counted(1.0 / of_x, 1.0 / of_u) for of in (model, centre))
        loss, x, u = self._problem(centre, x, u, k)
        if (model.n, model.q) != (centre.n, centre.q):
            raise InputError(
                f"model must have sizes n = {centre.n}, q = {centre.q}, as the centre has, got {model.n} and {model.q}"
            )
        lead, problems = self._problems(loss, centre, x, u)
        theta = np.broadcast_to(model.theta, (*lead, centre.theta.shape[-1])).reshape(len(problems), -1)
        return np.reshape([problem.newton_decrement(of) for problem, of in zip(problems, theta, strict=True)], lead)

    def _problem(self, centre: SignalModel, x: Array, u: Array, k: int) -> tuple[Convex, Array, Array]:
        """Check centre, x and u, and return the loss of step k with x and u."""
        instance("centre", centre, SignalModel)
        x, u, n, q = real_array("x", x), real_array("u", u), centre.n, centre.q
        if x.shape[-2:] != (self.window + 1, n) or u.shape[-2:] != (self.window, q):
            raise InputError(
                f"x and u must have shapes ({self.window + 1}, {n}) and ({self.window}, {q}), "
                f"got {x.shape[-2:]} and {u.shape[-2:]}"
            )
        loss = self.loss.loss(k) if isinstance(self.loss, Varying) else self.loss
        if isinstance(self.loss, Varying):
            _for_residuals(loss)
        for name, function, size in (("loss", loss, self.window * n), ("generator", self.generator, n * (n + q))):
            shape = np.shape(getattr(function, "weight", 1.0))
            if shape not in ((), (size,), (size, size)):
                raise InputError(
                    f"{name} weights must be one number or have shape ({size},) or ({size}, {size}), got {shape}"
                )
        return loss, x, u

    def _free(self, centre: SignalModel) -> list[Array] | None:
        """Return the directions in which each row of [A B] may move, if no equality couples rows, else None."""
        if self.constraints is None:
            return [np.eye(centre.n + centre.q)] * centre.n
        self.constraints.check("the centre", centre)
        return self.constraints.within_rows(centre.n)

    def _squares(
        self, c: WeightedSquares, g: WeightedSquares, centre: SignalModel, x: Array, u: Array, k: int
    ) -> SignalModel:
        entrywise = _entrywise(c) and _entrywise(g)
        if self.constraints is None and entrywise:
            return self._row_by_row(centre, x, u, k)
        free = self._free(centre)
        if free is None or not entrywise:
            known = self.constraints
            directions = np.eye(centre.theta.shape[-1]) if known is None else known.null_space
            theta = quadratic(*regression(x, u), c.weight, g.weight, centre.theta, directions)
            return SignalModel.from_theta(theta, centre.n, centre.q)
        trust, hold = self._weights(centre.n, centre.q, k)
        R, rows = regression_of_rows(x, u)[1], np.concatenate([centre.A, centre.B], axis=-1)
        lead = np.broadcast_shapes(R.shape[:-2], rows.shape[:-2])
        found = np.array(np.broadcast_to(rows, (*lead, *rows.shape[-2:])))
        for i in range(centre.n):
            if free[i].shape[1]:
                found[..., i, :] = quadratic(x[..., :-1, i], R, trust[i], hold[i], rows[..., i, :], free[i])
        return SignalModel(found[..., : centre.n], found[..., centre.n :])

    def _problems(
        self, loss: Convex, centre: SignalModel, x: Array, u: Array
    ) -> tuple[tuple[int, ...], list[Proximal]]:
        """Return the batch axes and one problem for each member."""
        free: list[Array] | None = self._free(centre)
        if free is None:
            assert self.constraints is not None
            (s, R), free = regression(x, u), [self.constraints.null_space]
        else:
            (s, R), free = regression_of_rows(x, u), None if self.constraints is None else free
        lead = np.broadcast_shapes(s.shape[:-1], centre.theta.shape[:-1])
        s, R = np.broadcast_to(s, (*lead, *s.shape[-1:])), np.broadcast_to(R, (*lead, *R.shape[-2:]))
        theta = np.broadcast_to(centre.theta, (*lead, centre.theta.shape[-1]))
        return lead, [Proximal(s[at], R[at], loss, self.generator, theta[at], free) for at in np.ndindex(*lead)]

    @property
    def by_rows(self) -> bool:
        """Whether each row of [A B] is a separate least-squares problem: weighted squares and no constraints."""
        return self.constraints is None and _entrywise(self.loss) and _entrywise(self.generator)

    def roots_of_weights(self, n: int, q: int, k: int = 0) -> tuple[Array, Array]:
        """Return the roots of the weights by rows of [A B], shapes (rows, window) and (rows, n + q).

        Rows with the same weights share one factorisation; usually all rows do, and then there is one row.
        """
        trust, hold = (np.sqrt(weight) for weight in self._weights(n, q, k))
        rows = 1 if np.all(trust == trust[0]) and np.all(hold == hold[0]) else n
        return np.ascontiguousarray(trust[:rows]), np.ascontiguousarray(hold[:rows])

    def _weights(self, n: int, q: int, k: int) -> tuple[Array, Array]:
        """Return the weights of squares, row by row of [A B], shapes (n, window) and (n, n + q)."""
        loss = self.loss.loss(k) if isinstance(self.loss, Varying) else self.loss
        trust, hold = (np.asarray(cast(WeightedSquares, of).weight) for of in (loss, self.generator))
        trust = np.broadcast_to(trust, self.window * n).reshape(self.window, n).T
        return trust, np.broadcast_to(hold, n * (n + q)).reshape(n + q, n).T

    def _row_by_row(self, centre: SignalModel, x: Array, u: Array, k: int) -> SignalModel:
        from rhl.kernels import loops  # imported here, because loading the compiler takes longer than the rest

        lead = np.broadcast_shapes(x.shape[:-2], u.shape[:-2], centre.A.shape[:-2])
        given = [to_lanes(M, lead, 2) for M in (x, u, np.concatenate([centre.A, centre.B], axis=-1))]
        weights, theta = self.roots_of_weights(centre.n, centre.q, k), np.empty_like(given[-1])
        for part in blocks(theta.shape[-1]):
            fitted = np.empty((*theta.shape[:-1], part.stop - part.start))
            x_part, u_part, held = (np.ascontiguousarray(M[..., part]) for M in given)
            loops.fit(x_part, u_part, held, *weights, fitted)
            theta[..., part] = fitted
        found = from_lanes(theta, lead)
        return SignalModel(found[..., : centre.n], found[..., centre.n :])


def _entrywise(function: Convex | Varying) -> bool:
    return isinstance(function, WeightedSquares) and np.ndim(function.weight) < 2


def _for_residuals(loss: Convex) -> None:
    if loss.lower > -np.inf:
        raise InputError(
            f"loss must take every real residual, got {called(loss)}, which is defined above {loss.lower:g} only"
        )


def _warn_of_assumption_6(role: str, function: object) -> None:
    known = cast(Convex, function).assumption_6
    if not known:
        asked = "continuously differentiable and strictly convex" + (
            ", with its minimum at zero" if role == "loss" else ""
        )
        warnings.warn(
            f"Assumption 6 asks for a {role} that is {asked}: {called(function)} is not"
            f"{' known to be' if known is None else ''}",
            AssumptionWarning,
            stacklevel=4,
        )
