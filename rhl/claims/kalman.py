"""Plants in the block form of equation (52), and the signal models (55) that they give."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rhl._checks import Array
from rhl.lifting import DelayLifting
from rhl.model import SignalModel
from rhl.plants import LinearPlant


@dataclass(frozen=True, eq=False)
class KalmanForm:
    """A plant in the block form of equation (52), before a change of coordinates hides it.

    Attributes
    ----------
    F, G, H : array
        z = [z_1; z_2; z_3]: controllable and observable; observable, stable, not controllable; stable, not
        observable.
    sizes : tuple of int
        Of the three blocks.
    """

    F: Array
    G: Array
    H: Array
    sizes: tuple[int, int, int]

    @property
    def observable(self) -> tuple[Array, Array, Array]:
        """The subsystem (F_s, G_s, H_s) of equation (53)."""
        n = self.sizes[0] + self.sizes[1]
        return self.F[:n, :n], self.G[:n], self.H[:, :n]

    def plant(self, T: Array) -> LinearPlant:
        """Return the plant in the coordinates T z."""
        return LinearPlant(T @ self.F @ np.linalg.inv(T), T @ self.G, self.H @ np.linalg.inv(T))


def kalman_form(
    rng: np.random.Generator, p: int, q: int, sizes: tuple[int, int, int], hidden_radius: float = 0.8
) -> KalmanForm:
    """Draw a plant of the form (52).

    Parameters
    ----------
    rng : Generator
    p, q : int
        Numbers of outputs and inputs.
    sizes : tuple of int
        Of the blocks z_1, z_2, z_3; the first may be unstable, the others are stable.
    hidden_radius : float
        Spectral radius of the unobservable block F_6; 1 or more makes the plant undetectable.

    Returns
    -------
    KalmanForm
        Redrawn until the observability matrix of (53) is well conditioned.
    """
    n1, n2, _ = sizes
    n = sum(sizes)
    while True:
        F = rng.normal(size=(n, n)) / np.sqrt(n)
        F[:n1, :n1] *= 1.2 / max(spectral_radius(F[:n1, :n1]), 0.1)
        F[n1 : n1 + n2, n1 : n1 + n2] *= 0.8 / max(spectral_radius(F[n1 : n1 + n2, n1 : n1 + n2]), 0.1)
        F[n1 + n2 :, n1 + n2 :] *= hidden_radius / max(spectral_radius(F[n1 + n2 :, n1 + n2 :]), 0.1)
        F[n1 : n1 + n2, :n1] = 0
        F[: n1 + n2, n1 + n2 :] = 0
        G, H = rng.normal(size=(n, q)), rng.normal(size=(p, n))
        G[n1 : n1 + n2] = 0
        H[:, n1 + n2 :] = 0
        form = KalmanForm(F, G, H, sizes)
        Fs, _, Hs = form.observable
        if np.linalg.cond(observability(Fs, Hs, n1 + n2)) < 1e3 and pbh(F[:n1, :n1], G[:n1]) > 1e-2:
            return form


def spectral_radius(F: Array) -> float:
    """Return the largest modulus of an eigenvalue; 0 for an empty matrix."""
    return float(np.max(np.abs(np.linalg.eigvals(F)), initial=0.0))


def observability(F: Array, H: Array, m: int) -> Array:
    """Return O = [H F^(m-1); ...; H F; H], newest output first as in equation (54), shape (m p, n)."""
    return np.concatenate([H @ np.linalg.matrix_power(F, m - 1 - i) for i in range(m)])


def inputs_to_stack(F: Array, G: Array, H: Array, m: int) -> Array:
    """Return the matrix R of x(k) = O z_s(k-m+1) + R u(k-1), equation (54), shape (m p, m q).

    Its last block column, that of v(k-m), is zero.
    """
    p, q = H.shape[0], G.shape[1]
    R = np.zeros((m * p, m * q))
    for row in range(m):
        # Row `row` holds y(k - row), which v(k-1-j) reaches through H F^(j-row) G for j >= row.
        for j in range(row, m - 1):
            R[row * p : (row + 1) * p, j * q : (j + 1) * q] = H @ np.linalg.matrix_power(F, j - row) @ G
    return R


def signal_model(F: Array, G: Array, H: Array, m: int) -> SignalModel:
    """Return the pair (A, B) of equation (55) for an observable (F, H).

    Parameters
    ----------
    F, G, H : array
        The subsystem (53).
    m : int
        How many outputs and inputs are stacked; at least the observability index.

    Returns
    -------
    SignalModel
        Of sizes m p and m q.
    """
    q = G.shape[1]
    O, R = observability(F, H, m), inputs_to_stack(F, G, H, m)
    A = O @ F @ np.linalg.pinv(O)
    B = R.copy()
    B[:, q:] -= (A @ R)[:, :-q]
    B[:, -q:] += O @ G
    return SignalModel(A, B)


def pbh(A: Array, B: Array, least_modulus: float = 0.0) -> float:
    """Return the smallest singular value of [lambda I - A, B] over the eigenvalues with |lambda| >= least_modulus.

    Positive with ``least_modulus`` 0: (A, B) is controllable; with 1: stabilizable (Popov, Belevitch, Hautus). Infinite
    where no eigenvalue is so large.
    """
    values = [value for value in np.linalg.eigvals(A) if abs(value) >= least_modulus]
    matrices = [np.concatenate([value * np.eye(len(A)) - A, B], axis=1) for value in values]
    return min((float(np.linalg.svd(M, compute_uv=False)[-1]) for M in matrices), default=np.inf)


def run_open_loop(plant: LinearPlant, z: Array, v: Array) -> Array:
    """Return y(0), ..., y(T-1) under the inputs v, shape (T, p)."""
    out = []
    for row in v:
        out.append(plant.output(z))
        z = plant.step(z, row)
    return np.array(out)


def stacked(signal: Array, m: int) -> Array:
    """Stack the last m rows at every instant, newest first; rows before the first are zero, shape (T, m d)."""
    history = np.concatenate([np.zeros((m - 1, signal.shape[1])), signal])[::-1]
    return DelayLifting(m, m).window(history, m, len(signal))[::-1]


def observability_index(F: Array, H: Array) -> int:
    """Return the least m for which the observability matrix has full column rank."""
    return next(m for m in range(1, len(F) + 1) if np.linalg.matrix_rank(observability(F, H, m)) == len(F))
