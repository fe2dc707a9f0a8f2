"""Plants in the block form of equation (52), and stacks of their outputs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rhl._checks import Array
from rhl.lifting import DelayLifting
from rhl.plants import LinearPlant
from rhl.plants.analysis import observability, pbh, spectral_radius


@dataclass(frozen=True, eq=False)
class KalmanForm:
    """A plant in the block form of equation (52), before a change of coordinates.

    ``F``, ``G``, ``H``: z = [z_1; z_2; z_3]: controllable and observable; observable, stable, not controllable; stable,
    not observable.
    ``sizes``: of the three blocks.
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
    """Draw plants of the form (52) until the observability matrix of (53) is well conditioned.

    ``sizes`` are those of the blocks z_1, z_2, z_3; the first may be unstable, the others are stable.
    ``hidden_radius``: spectral radius of the unobservable block F_6; 1 or more makes the plant undetectable.
    """
    n1, n2, _ = sizes
    n = sum(sizes)
    blocks = [(slice(0, n1), 1.2), (slice(n1, n1 + n2), 0.8), (slice(n1 + n2, n), hidden_radius)]
    blocks = [(at, radius) for at, radius in blocks if at.stop > at.start]
    while True:
        F = rng.normal(size=(n, n)) / np.sqrt(n)
        radii = [spectral_radius(F[at, at]) for at, _ in blocks]
        if min(radii) < 0.1:
            continue  # nearly nilpotent; scaled to its radius it would be far from normal
        for (at, wanted), radius in zip(blocks, radii, strict=True):
            F[at, at] *= wanted / radius
        F[n1 : n1 + n2, :n1] = 0
        F[: n1 + n2, n1 + n2 :] = 0
        G, H = rng.normal(size=(n, q)), rng.normal(size=(p, n))
        G[n1 : n1 + n2] = 0
        H[:, n1 + n2 :] = 0
        form = KalmanForm(F, G, H, sizes)
        Fs, _, Hs = form.observable
        if np.linalg.cond(observability(Fs, Hs, n1 + n2)) < 1e3 and pbh(F[:n1, :n1], G[:n1]) > 1e-2:
            return form


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


def draw_plant(rng: np.random.Generator, hidden_radius: float = 0.8) -> tuple[KalmanForm, LinearPlant]:
    """Draw sizes, a plant of the form (52), and coordinates that hide its blocks."""
    p, q = (int(size) for size in rng.integers(1, 4, 2))
    sizes = (int(rng.integers(1, 4)), int(rng.integers(0, 3)), int(rng.integers(0, 3)))
    form = kalman_form(rng, p, q, sizes, hidden_radius)
    T = np.linalg.qr(rng.normal(size=form.F.shape))[0]
    return form, form.plant(T)
