"""The proximal (Bregman) estimator of the signal model, in its closed quadratic form."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from rhl._checks import Array, InputError, integer
from rhl.bregman import WeightedSquares
from rhl.model import SignalModel


@dataclass(frozen=True, eq=False)
class ProximalEstimator:
    r"""One proximal step towards the data of a short window, equation (15).

    .. math::
        \theta^*(k) = \arg\min_\theta\; c(s(k) - R(k)\theta) + D(\theta, \tilde\theta(k-1))

    Parameters
    ----------
    window : int
        :math:`\bar N`, the number of transitions x(j-1), u(j-1) -> x(j) that are fitted.
    loss : WeightedSquares
        c; weights: one number, or shape (window, n), newest transition first.
    generator : WeightedSquares
        g, which induces D; weights: one number, or shape (n, n+q) like [A B].

    Raises
    ------
    InputError
        If the window is not a whole number of at least 1.

    Notes
    -----
    Source: equations (15) to (17). With these weights the problem falls apart into one regularised least-squares
    problem for each row of [A B] (Remark 2); each is solved by an orthogonal factorisation, so that the data are never
    squared.
    """

    window: int
    loss: WeightedSquares = field(default_factory=WeightedSquares)
    generator: WeightedSquares = field(default_factory=WeightedSquares)

    def __post_init__(self) -> None:
        integer("window", self.window, 1)

    def minimise(self, centre: SignalModel, x: Array, u: Array) -> SignalModel:
        r"""Return :math:`\theta^*(k)`, the minimiser of equation (15), as a signal model.

        Parameters
        ----------
        centre : SignalModel
            The proximal centre :math:`\tilde\theta(k-1)`.
        x : array, shape (..., window + 1, n)
            x(k), x(k-1), ..., x(k - window).
        u : array, shape (..., window, q)
            u(k-1), ..., u(k - window).

        Returns
        -------
        SignalModel

        Raises
        ------
        InputError
            If shapes or weights do not fit the model and the window.
        """
        n, q = centre.n, centre.q
        if x.shape[-2:] != (self.window + 1, n) or u.shape[-2:] != (self.window, q):
            raise InputError(
                f"x and u must have shapes ({self.window + 1}, {n}) and ({self.window}, {q}), "
                f"got {x.shape[-2:]} and {u.shape[-2:]}"
            )
        trust = np.sqrt(self._weights("loss", self.loss, (self.window, n))).T
        hold = np.sqrt(self._weights("generator", self.generator, (n, n + q)))
        parameters = np.concatenate([centre.A, centre.B], axis=-1)
        regressors = np.concatenate([x[..., 1:, :], u], axis=-1)
        # Rows of [A B] with the same weights share one factorisation; mostly that is all of them.
        same = np.all(trust == trust[0]) and np.all(hold == hold[0])
        groups = 1 if same else n
        trust, hold = trust[:groups], hold[:groups]
        # In eta = hold * (theta - centre) the proximal term is |eta|^2, whatever the weights.
        residual = x[..., :-1, :] - regressors @ parameters.swapaxes(-1, -2)
        target = residual[..., None, :, :] if same else residual.swapaxes(-1, -2)[..., None]
        target = trust[..., None] * target
        rows = trust[..., None] * regressors[..., None, :, :] / hold[..., None, :]
        eye = np.broadcast_to(np.eye(n + q), (*rows.shape[:-2], n + q, n + q))
        target = np.concatenate([target, np.zeros((*target.shape[:-2], n + q, target.shape[-1]))], axis=-2)
        orthogonal, upper = np.linalg.qr(np.concatenate([rows, eye], axis=-2))
        eta = np.linalg.solve(upper, orthogonal.swapaxes(-1, -2) @ target) / hold[..., None]
        moved = eta[..., 0, :, :].swapaxes(-1, -2) if same else eta[..., 0]
        updated = parameters + moved
        return SignalModel(updated[..., :n], updated[..., n:])

    @staticmethod
    def _weights(name: str, squares: WeightedSquares, shape: tuple[int, int]) -> Array:
        weight = np.asarray(squares.weight)
        if weight.shape not in ((), shape):
            raise InputError(f"{name} weights must be one number or have shape {shape}, got {weight.shape}")
        return np.broadcast_to(weight, shape)
