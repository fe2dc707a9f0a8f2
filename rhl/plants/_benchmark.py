"""The record of a benchmark plant, and properties that follow from its matrices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rhl._checks import Array, positive, read_only
from rhl.errors import InputError
from rhl.plants.analysis import detectability, observability_index, stabilizability
from rhl.plants.linear import LinearPlant


@dataclass(frozen=True, eq=False)
class Benchmark:
    r"""A plant as its source publishes it: :math:`\dot x = A x + B u`, y = C x in continuous time.

    Attributes
    ----------
    name : str
    family : str
        The kind of plant; "" if unknown.
    A, B, C : array, shapes (n, n), (n, q), (p, n)
    h : float
        A suitable sampling time, in ``time_unit``.
    title : str
        One line.
    origin : str
        The source of the numbers.
    states, inputs, outputs : tuple of str
        Name and unit of each entry of x, u and y; empty if the source gives none.
    time_unit : str
        "s", "min", or "" if the source gives time no unit.
    discrete : bool
        Whether A, B and C are those of :math:`x(k+1) = A x(k) + B u(k)`, sampled every ``h``.
    start : array, shape (n,), optional
        An initial state within the range of validity of the model, chosen here unless ``origin`` says otherwise.
    """

    name: str
    family: str
    A: Array
    B: Array
    C: Array
    h: float = 0.1
    title: str = ""
    origin: str = ""
    states: tuple[str, ...] = ()
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    time_unit: str = "s"
    discrete: bool = False
    start: Array | None = None

    def __post_init__(self) -> None:
        for name in "ABC":
            object.__setattr__(self, name, read_only(getattr(self, name)))
        if self.start is not None:
            object.__setattr__(self, "start", read_only(self.start))

    @property
    def z0(self) -> Array:
        """An initial state, shape (n,): ``start``, or a state of norm one with equal entries."""
        n = len(self.A)
        return np.full(n, n**-0.5) if self.start is None else self.start

    @property
    def poles(self) -> NDArray[np.complex128]:
        """The eigenvalues of A, shape (n,): in continuous time 1/``time_unit``, in discrete time without a unit."""
        return np.linalg.eigvals(self.A).astype(np.complex128)

    @property
    def stabilizable(self) -> bool:
        """Whether the inputs reach every mode of the sampled plant that does not decay, as Assumption 1 requires."""
        plant = self.sampled()
        # The test compares margins with the plant's size, and must not depend on the unit of the inputs.
        return stabilizability(plant.F, plant.G / np.max(np.abs(plant.G))).holds

    @property
    def detectable(self) -> bool:
        """Whether every mode of the sampled plant that does not decay is observable, as Assumption 1 requires."""
        plant = self.sampled()
        return detectability(plant.F, plant.H / np.max(np.abs(plant.H))).holds

    def sampled(self, h: float | None = None) -> LinearPlant:
        """Return the plant sampled every h, by default ``self.h``, with inputs held in between (zero-order hold).

        InputError if h is not positive, if the plant leaves the range of floating-point numbers within it, or if it is
        not that of a plant published in discrete time.
        """
        h = self.h if h is None else positive("h", h)
        if self.discrete:
            if h != self.h:
                raise InputError(
                    f"h must be {self.h:g} for {self.name}, which is in discrete time, got {h:g}; leave it out"
                )
            return LinearPlant(self.A, self.B, self.C)
        from scipy.linalg import expm  # imported here, because names are listed without it

        n, q = self.B.shape
        whole = np.zeros((n + q, n + q))
        whole[:n, :n], whole[:n, n:] = self.A, self.B
        with np.errstate(over="ignore", invalid="ignore"):
            found = expm(h * whole)
        if not np.all(np.isfinite(found)):
            raise InputError(f"h must be short enough for {self.name} to stay finite from sample to sample, got {h:g}")
        return LinearPlant(found[:n, :n], found[:n, n:], self.C)

    def order(self, h: float | None = None) -> int:
        """Return the observability index of the sampled plant, the least ``order`` of a scheme for it."""
        plant = self.sampled(h)
        return observability_index(plant.F, plant.H)
