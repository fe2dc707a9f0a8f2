"""Batches in the layout of the kernels: batch axes flattened into lanes, which come last."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from rhl._checks import Array

# Enough lanes to fill a processor's registers, few enough for a stage to stay in its cache; measured in benchmarks/.
LANES = 64


def to_lanes(array: Array, lead: tuple[int, ...], core: int) -> Array:
    """Copy an array whose last ``core`` axes are not batch axes, broadcast to the batch ``lead``, into lanes."""
    shape = array.shape[array.ndim - core :]
    flat = np.broadcast_to(array, (*lead, *shape)).reshape(-1, *shape)
    return np.array(np.moveaxis(flat, 0, -1), order="C")


def from_lanes(lanes: Array, lead: tuple[int, ...]) -> Array:
    """Return lanes as the batch ``lead``, whose axes come first again.

    Examples
    --------
    >>> batch = np.arange(12.0).reshape(3, 2, 2)
    >>> np.array_equal(from_lanes(to_lanes(batch, (3,), 2), (3,)), batch)
    True
    """
    return np.moveaxis(lanes, -1, 0).reshape(*lead, *lanes.shape[:-1])


def blocks(members: int) -> Iterator[slice]:
    """Yield slices of at most ``LANES`` members that cover a batch."""
    for first in range(0, members, LANES):
        yield slice(first, min(first + LANES, members))
