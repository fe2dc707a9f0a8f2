"""Published benchmark plants by name: those of the COMPleib collection up to order 30, and some of textbooks."""

from __future__ import annotations

import json
from difflib import get_close_matches
from functools import cache
from importlib.resources import files
from typing import Literal, cast, get_args

import numpy as np

from rhl._checks import choice, describe, integer
from rhl.errors import InputError
from rhl.plants._benchmark import Benchmark
from rhl.plants._literature import literature

__all__ = ["Benchmark", "Collection", "benchmark", "names"]

Collection = Literal["compleib", "literature"]

_FAMILIES = {
    "ac": "aircraft",
    "bdt": "distillation tower",
    "cm": "cable and mass",
    "dis": "interconnected system",
    "he": "helicopter",
    "je": "jet engine",
    "rea": "chemical reactor",
}
# B belongs to the control input and C to the measured output. The entries were not checked against the report, since
# the data lack its units. Outputs of je2 with a zero row of C are always zero.
_COMPLEIB = (
    "F. Leibfritz, COMPleib: Constraint matrix-optimization problem library, University of Trier, 2004, as packaged by "
    "controlgym 1.0.0 (MIT)"
)


@cache
def _data() -> dict[str, Benchmark]:
    text = files("rhl").joinpath("plants", "data", "compleib.json").read_text(encoding="utf-8")
    found = cast(dict[str, dict[str, list[list[float]]]], json.loads(text))
    return {name: _of_compleib(name, parts) for name, parts in found.items()} | literature()


def _of_compleib(name: str, parts: dict[str, list[list[float]]]) -> Benchmark:
    family = _FAMILIES.get(name.rstrip("0123456789"), "")
    A, B, C = (np.array(parts[part], dtype=np.float64) for part in "ABC")
    title = f"COMPleib's {name}" + (f", {family}" if family else "")
    return Benchmark(name, family, A, B, C, title=title, origin=_COMPLEIB)


def names(largest: int = 30, collection: Collection | None = None) -> tuple[str, ...]:
    """Return the names of the plants of order up to ``largest``, of one collection or of all.

    "compleib" is the COMPleib collection, "literature" are plants of textbooks and papers. InputError if ``largest`` is
    below 1 or there is no such collection.

    Examples
    --------
    >>> names(largest=4, collection="compleib")
    ('ac3', 'ac8', 'dis2', 'he1', 'toy')
    >>> names(collection="literature")[:3]
    ('aircraft-pitch', 'ball-on-beam', 'boeing-747')
    """
    integer("largest", largest, 1)
    if collection is not None:
        choice("collection", collection, get_args(Collection))
    other = literature() if collection is not None else {}
    return tuple(
        name
        for name, found in _data().items()
        if len(found.A) <= largest and (collection is None or (name in other) == (collection == "literature"))
    )


def benchmark(name: str) -> Benchmark:
    """Return a benchmark plant by name; InputError, with the nearest names, if there is none of that name.

    Examples
    --------
    >>> plant = benchmark("ac1").sampled(h=0.1)
    >>> plant.n, plant.q, plant.p
    (5, 3, 3)
    >>> benchmark("wood-berry").title
    "Wood and Berry's distillation column"
    """
    if not isinstance(cast(object, name), str) or name not in _data():
        near = get_close_matches(name, _data(), n=3) if isinstance(cast(object, name), str) else []
        raise InputError(f"benchmark must be one of {', '.join(near or _data())}, got {describe(name)}")
    return _data()[name]
