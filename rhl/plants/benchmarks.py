"""Benchmark plants that others chose: the COMPleib collection's, up to order 30, by name."""

from __future__ import annotations

import json
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cache
from importlib.resources import files
from typing import cast

import numpy as np

from rhl._checks import Array, describe, integer, positive, read_only
from rhl.errors import InputError
from rhl.plants.analysis import observability_index
from rhl.plants.linear import LinearPlant

_FAMILIES = {
    "ac": "aircraft",
    "bdt": "distillation tower",
    "cm": "cable and mass",
    "dis": "interconnected system",
    "he": "helicopter",
    "je": "jet engine",
    "rea": "chemical reactor",
}


@dataclass(frozen=True, eq=False)
class Benchmark:
    r"""A plant in continuous time, :math:`\dot x = A x + B u`, y = C x, as a collection publishes it.

    Attributes
    ----------
    name : str
    family : str
        What kind of plant it is, as far as its name tells; "" where it does not.
    A, B, C : array, shapes (n, n), (n, q), (p, n)
        Numbers only; the collection gives units in its report, not in its data.

    Notes
    -----
    Source: F. Leibfritz, COMPleib: Constraint matrix-optimization problem library, University of Trier, 2004, as
    packaged by controlgym 1.0.0 (MIT), which gives B for the control input and C for the measured output. The entries
    were not checked against the report. Outputs of ``je2`` whose row of C is zero measure nothing.
    """

    name: str
    family: str
    A: Array
    B: Array
    C: Array

    def __post_init__(self) -> None:
        for name in "ABC":
            object.__setattr__(self, name, read_only(getattr(self, name)))

    @property
    def z0(self) -> Array:
        """An initial state of length one, all of whose entries are equal, shape (n,)."""
        n = len(self.A)
        return np.full(n, n**-0.5)

    def sampled(self, h: float = 0.1) -> LinearPlant:
        """Return the plant sampled every h seconds with its inputs held in between (zero-order hold)."""
        from scipy.linalg import expm  # here, because names are listed without it

        n, q = self.B.shape
        whole = np.zeros((n + q, n + q))
        whole[:n, :n], whole[:n, n:] = self.A, self.B
        with np.errstate(over="ignore", invalid="ignore"):
            found = expm(positive("h", h) * whole)
        if not np.all(np.isfinite(found)):
            raise InputError(f"h must be short enough for {self.name} to stay finite from sample to sample, got {h:g}")
        return LinearPlant(found[:n, :n], found[:n, n:], self.C)

    def order(self, h: float = 0.1) -> int:
        """Return the observability index of the sampled plant, the least ``order`` that a scheme may be told."""
        plant = self.sampled(h)
        return observability_index(plant.F, plant.H)


@cache
def _data() -> dict[str, dict[str, list[list[float]]]]:
    text = files("rhl").joinpath("plants", "data", "compleib.json").read_text(encoding="utf-8")
    return cast(dict[str, dict[str, list[list[float]]]], json.loads(text))


def names(largest: int = 30) -> tuple[str, ...]:
    """Return the names of the plants of order up to ``largest``.

    Examples
    --------
    >>> names(largest=4)
    ('ac3', 'ac8', 'dis2', 'he1', 'toy')
    """
    integer("largest", largest, 1)
    return tuple(name for name, found in _data().items() if len(found["A"]) <= largest)


def benchmark(name: str) -> Benchmark:
    """Return a benchmark plant by name; InputError, with the nearest names, if there is none of that name.

    Examples
    --------
    >>> plant = benchmark("ac1").sampled(h=0.1)
    >>> plant.n, plant.q, plant.p
    (5, 3, 3)
    """
    if not isinstance(cast(object, name), str) or name not in _data():
        near = get_close_matches(name, _data(), n=3) if isinstance(cast(object, name), str) else []
        raise InputError(f"benchmark must be one of {', '.join(near or _data())}, got {describe(name)}")
    found = _data()[name]
    family = _FAMILIES.get(name.rstrip("0123456789"), "")
    return Benchmark(name, family, *(np.array(found[part], dtype=np.float64) for part in "ABC"))
