"""Ensembles of plants for a scheme: random plants or benchmarks, accessed by number."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any, Protocol

import numpy as np
from numpy.random import Generator, SeedSequence, default_rng

from rhl._checks import Array, describe, integer, positive, read_only
from rhl.errors import InputError
from rhl.plants._realisation import held
from rhl.plants.analysis import spectral_radius
from rhl.plants.benchmarks import benchmark, names

# Hidden modes decay: their poles in discrete time, and their rates in 1/s in continuous time.
_HIDDEN_POLES, _HIDDEN_RATES = 0.95, (0.1, 2.0)


@dataclass(frozen=True, eq=False)
class Drawn:
    """One plant of an ensemble.

    Attributes
    ----------
    F, G, H : array, shapes (n, n), (n, q), (p, n)
    z0 : array, shape (n,)
        Its initial state, of norm one.
    bound : int
        A bound on its observability index, which a scheme may know.
    sampling : float
        Seconds between samples; 0 for a plant drawn in discrete time.

    Examples
    --------
    >>> drawn = RandomPlants(seed=1, count=1, n=(3,)).draw(0)
    >>> drawn.F.shape, drawn.size
    ((3, 3), (3, 1, 1, 3))
    """

    F: Array
    G: Array
    H: Array
    z0: Array
    bound: int
    sampling: float = 0.0

    def __post_init__(self) -> None:
        for name in ("F", "G", "H", "z0"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    @property
    def size(self) -> tuple[int, int, int, int]:
        """The numbers n, p, q and the bound; plants that share them can run in one batch."""
        return len(self.F), len(self.H), self.G.shape[1], self.bound


class Ensemble(Protocol):
    """Plants by number; each is independent of the order of access.

    Examples
    --------
    >>> plants: Ensemble = BenchmarkPlants(("toy", "ac1"))
    >>> len(plants), plants.labels()
    (2, ['toy', 'ac1'])
    """

    def __len__(self) -> int:
        """Return the number of plants."""

    def draw(self, i: int) -> Drawn:
        """Return plant i."""

    def errors(self, i: int) -> SeedSequence:
        """Return the seed of the errors of plant i's sensors."""

    def sizes(self) -> set[tuple[int, int, int]]:
        """Return p, q and the bound of every plant."""

    def labels(self) -> list[str]:
        """Return a name for each plant; none where they have only numbers."""


@dataclass(frozen=True)
class RandomPlants:
    r"""Random linear plants: ``count`` for each combination of sizes and sampling times.

    The part of a plant that is not hidden has matrices with standard normal entries. In discrete time its state matrix
    is scaled to a spectral radius that is uniform in ``radius``. In continuous time (``growth`` given) it is divided
    by the root of its order and shifted, so that the largest real part of its eigenvalues is uniform in ``growth``;
    it is then sampled with inputs held. Hidden modes are stable: each is at random either not controllable
    (it then drives the rest and is observable) or not observable. The states are transformed to coordinates
    T z, where T has random singular vectors and a condition number that is log-uniform up to ``conditioning``. The
    initial state is uniform on the unit sphere of these coordinates.

    Plant i has its own child of the seed, so it does not depend on which other plants are drawn. Plants that differ
    only in the sampling time are samplings of the same plant.

    Parameters
    ----------
    seed : int
        At least 0.
    count : int
        The number for each combination, at least 1.
    n, p, q : tuple of int
        Orders, numbers of outputs and numbers of inputs; every combination is drawn.
    radius : tuple of two floats
        Lowest and highest spectral radius of the part that is not hidden, in discrete time.
    growth : tuple of two floats, optional
        In place of radius: lowest and highest rate of growth, in 1/s, of plants in continuous time.
    sampling : tuple of float
        Seconds from sample to sample, each positive; needed with ``growth``, and empty without.
    hidden : int
        The number of hidden modes, fewer than the least n.
    conditioning : float
        Largest condition number of the coordinates, at least 1.
    output_decades, input_decades : float
        Each output and input has its own unit: its row of H or column of G is multiplied by ten to a power that is
        uniform between minus and plus this.

    Raises
    ------
    InputError
        If a number is out of range.

    Examples
    --------
    >>> plants = RandomPlants(seed=1, count=3, n=(2, 4))
    >>> len(plants), plants.draw(5).size
    (6, (4, 1, 1, 4))
    >>> round(spectral_radius(RandomPlants(1, 1, radius=(1.1, 1.1)).draw(0).F), 12)
    1.1
    """

    seed: int
    count: int
    n: tuple[int, ...] = (4,)
    p: tuple[int, ...] = (1,)
    q: tuple[int, ...] = (1,)
    radius: tuple[float, float] = (0.5, 1.2)
    growth: tuple[float, float] | None = None
    sampling: tuple[float, ...] = ()
    hidden: int = 0
    conditioning: float = 1.0
    output_decades: float = 0.0
    input_decades: float = 0.0

    def __post_init__(self) -> None:
        integer("seed", self.seed, 0)
        integer("count", self.count, 1)
        integer("hidden", self.hidden, 0)
        for name in ("n", "p", "q"):
            sizes = getattr(self, name)
            if not sizes:
                raise InputError(f"{name} must have at least one size, got none")
            for size in sizes:
                integer(name, size, 1)
            if len(set(sizes)) < len(sizes):
                raise InputError(f"{name} must have each size once, got {describe(list(sizes))}")
        if self.hidden >= min(self.n):
            raise InputError(f"hidden must be below the least n, {min(self.n)}, got {self.hidden}")
        name, (low, high) = ("radius", self.radius) if self.growth is None else ("growth", self.growth)
        if not (
            low <= high
            and (name == "growth" or low > 0)
            and np.isfinite(low)
            and np.isfinite(high)
            and high - low < np.inf
        ):
            at_least = "positive and " if name == "radius" else ""
            raise InputError(f"{name} must be two numbers, {at_least}in ascending order, got {describe([low, high])}")
        for time in self.sampling:
            positive("sampling", time)
        if bool(self.sampling) == (self.growth is None):
            raise InputError("sampling must be given with growth and left out without, got one of the two")
        for name, least in (("conditioning", 1.0), ("output_decades", 0.0), ("input_decades", 0.0)):
            if not least <= getattr(self, name) < np.inf:
                raise InputError(f"{name} must be a number of at least {least:g}, got {describe(getattr(self, name))}")

    def __len__(self) -> int:
        """Return the number of plants."""
        return self.count * len(self._combinations) * max(1, len(self.sampling))

    @cached_property
    def _combinations(self) -> tuple[tuple[int, int, int], ...]:
        return tuple(product(self.n, self.p, self.q))

    def _where(self, i: int) -> tuple[int, float, int]:
        """Return the number of plant i's combination, its sampling time, and its number among the count."""
        if not 0 <= i < len(self):
            raise InputError(f"i must be from 0 to {len(self) - 1}, got {i}")
        group, j = divmod(i, self.count)
        combination, time = divmod(group, max(1, len(self.sampling)))
        return combination, self.sampling[time] if self.sampling else 0.0, j

    def errors(self, i: int) -> SeedSequence:
        """Return the seed of the errors of plant i's sensors."""
        combination, _, j = self._where(i)
        return SeedSequence(self.seed, spawn_key=(combination, j, 0))

    def sizes(self) -> set[tuple[int, int, int]]:
        """Return p, q and the bound of every plant."""
        return {(p, q, _bound(n, p)) for n, p, q in self._combinations}

    def labels(self) -> list[str]:
        """Return no names: these plants have only numbers."""
        return []

    def draw(self, i: int) -> Drawn:
        """Return plant i; InputError if there is none, or it leaves the range of float64 within a sample."""
        combination, h, j = self._where(i)
        n, p, q = self._combinations[combination]
        # The combination's child of SeedSequence(seed).spawn, and the j-th child of that.
        rng = default_rng(SeedSequence(self.seed, spawn_key=(combination, j)))
        F, G, H = self._hiding(rng, *self._core(rng, n - self.hidden, p, q))
        F, G, H = _in_coordinates(rng, F, G, H, self.conditioning)
        z0 = rng.standard_normal(n)
        H = H * 10.0 ** rng.uniform(-self.output_decades, self.output_decades, (p, 1))
        G = G * 10.0 ** rng.uniform(-self.input_decades, self.input_decades, q)
        if self.growth is not None:
            F, G = held(F, G, h)
        return Drawn(F, G, H, z0 / np.linalg.norm(z0), _bound(n, p), h)

    def _core(self, rng: Generator, n: int, p: int, q: int) -> tuple[Array, Array, Array]:
        F, G, H = rng.standard_normal((n, n)), rng.standard_normal((n, q)), rng.standard_normal((p, n))
        if self.growth is None:
            return F * (rng.uniform(*self.radius) / spectral_radius(F)), G, H
        F = F / np.sqrt(n)
        fastest = float(np.max(np.linalg.eigvals(F).real))
        return F + (rng.uniform(*self.growth) - fastest) * np.eye(n), G, H

    def _hiding(self, rng: Generator, F: Array, G: Array, H: Array) -> tuple[Array, Array, Array]:
        """Add the hidden modes, one after the other."""
        for _ in range(self.hidden):
            n, unreached = len(F), rng.random() < 0.5
            drive, to_input, to_output = (
                rng.standard_normal(n),
                rng.standard_normal(G.shape[1]),
                rng.standard_normal(len(H)),
            )
            pole = rng.uniform(-_HIDDEN_POLES, _HIDDEN_POLES) if self.growth is None else -rng.uniform(*_HIDDEN_RATES)
            column, row = (drive, np.zeros(n)) if unreached else (np.zeros(n), drive)
            F = np.block([[F, column[:, None]], [row[None], np.array([[pole]])]])
            G = np.vstack([G, np.zeros_like(to_input) if unreached else to_input])
            H = np.column_stack([H, to_output if unreached else np.zeros_like(to_output)])
        return F, G, H


@dataclass(frozen=True)
class BenchmarkPlants:
    """The plants of ``rhl.plants.benchmarks``, by name, at each sampling time; InputError if a name is not known.

    Parameters
    ----------
    names : tuple of str
        The names; if empty, all up to order ten.
    sampling : tuple of float
        Seconds between samples; every plant is sampled with each.
    seed : int
        The seed of their sensors' errors.

    Examples
    --------
    >>> BenchmarkPlants(("toy", "ac1"), sampling=(0.1, 0.2)).labels()
    ['toy at 0.1 s', 'toy at 0.2 s', 'ac1 at 0.1 s', 'ac1 at 0.2 s']
    """

    names: tuple[str, ...] = ()
    sampling: tuple[float, ...] = (0.1,)
    seed: int = 0

    def __post_init__(self) -> None:
        for name in self.names:
            benchmark(name)
        if not self.sampling:
            raise InputError("sampling must have at least one time, got none")
        for time in self.sampling:
            positive("sampling", time)

    @property
    def _each(self) -> tuple[str, ...]:
        return self.names or names(10, "compleib")

    def __len__(self) -> int:
        """Return the number of plants."""
        return len(self._each) * len(self.sampling)

    def _where(self, i: int) -> tuple[str, float]:
        if not 0 <= i < len(self):
            raise InputError(f"i must be from 0 to {len(self) - 1}, got {i}")
        of, time = divmod(i, len(self.sampling))
        return self._each[of], self.sampling[time]

    def errors(self, i: int) -> SeedSequence:
        """Return the seed of the errors of plant i's sensors."""
        return SeedSequence(self.seed, spawn_key=(i // len(self.sampling), 0))

    def sizes(self) -> set[tuple[int, int, int]]:
        """Return p, q and the bound of every plant."""
        return {self.draw(i).size[1:] for i in range(len(self))}

    def labels(self) -> list[str]:
        """Return each plant's name, with its sampling time if there are several."""
        several = len(self.sampling) > 1
        return [f"{name} at {h:g} s" if several else name for name, h in map(self._where, range(len(self)))]

    def draw(self, i: int) -> Drawn:
        """Return plant i; InputError if there is none, or it does not stay finite between samples."""
        name, h = self._where(i)
        found = benchmark(name)
        try:
            plant = found.sampled(h)
        except InputError:
            raise InputError(
                f"sampling must be short enough for {name} to stay finite from sample to sample, got {h:g}"
            ) from None
        return Drawn(plant.F, plant.G, plant.H, found.z0, found.order(h), h)


def _bound(n: int, p: int) -> int:
    """Return the generic observability index of plants of order n with p outputs."""
    return -(-n // p)


def _in_coordinates(rng: Generator, F: Array, G: Array, H: Array, conditioning: float) -> tuple[Array, Array, Array]:
    n = len(F)
    (U, _), (V, _) = (np.linalg.qr(rng.standard_normal((n, n))) for _ in range(2))
    scale: Any = conditioning ** (rng.random() * np.linspace(-0.5, 0.5, n))
    T, inverse = U * scale @ V.T, V / scale @ U.T
    return T @ F @ inverse, T @ G, H @ inverse
