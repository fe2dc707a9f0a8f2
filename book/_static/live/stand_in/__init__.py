"""A stand-in for numpy: as much as rhl needs to check input, to set a scheme up and to run its loops on small arrays.

No build of numpy for the browser can be had without another host. The loops need nothing of it but an array that they
read and write entry by entry, and what prepares them needs little more. What is not here is missing loudly
(AttributeError or NotImplementedError), never approximated.
"""

import math
import sys
from contextlib import nullcontext
from itertools import pairwise, product
from types import SimpleNamespace

from . import linalg
from .arrays import (
    Grid,
    array,
    asarray,
    ascontiguousarray,
    broadcast_shapes,
    broadcast_to,
    concatenate,
    each,
    empty,
    eye,
    flat,
    full,
    made,
    moveaxis,
    ndarray,
    shape,
    zeros,
)

__all__ = [
    "array",
    "asarray",
    "ascontiguousarray",
    "broadcast_shapes",
    "broadcast_to",
    "concatenate",
    "empty",
    "eye",
    "full",
    "linalg",
    "moveaxis",
    "ndarray",
    "shape",
    "zeros",
]

inf, nan = math.inf, math.nan
float64, int64 = float, int


class integer:
    """No integer is one of numpy's own."""


def sqrt(value):
    return each(math.sqrt, value)


def _abs(value):
    return each(abs, value)


def _function(name):
    return lambda value: each(getattr(math, name), value)


sin, cos, tanh, exp = map(_function, ("sin", "cos", "tanh", "exp"))


def isfinite(value):
    return each(math.isfinite, value, kind="b")


def where(condition, yes, no):
    return each(lambda c, a, b: a if c else b, condition, yes, no)


# Over axes


def _over(function, value, axis, keepdims, kind):
    value = asarray(value)
    if axis is None:
        return function(flat(value))
    gone = {one % value.ndim for one in (axis if isinstance(axis, tuple) else (axis,))}
    kept = [slice(None) if at in gone else range(length) for at, length in enumerate(value.shape)]
    entries = []
    for place in product(*((part,) if isinstance(part, slice) else part for part in kept)):
        entries.append(function(flat(value._part((*place, Ellipsis)))))
    lengths = [1 if at in gone else length for at, length in enumerate(value.shape) if keepdims or at not in gone]
    return made(tuple(lengths), entries, kind)


def _greatest(entries):
    return nan if any(entry != entry for entry in entries) else max(entries)


def _least(entries):
    return nan if any(entry != entry for entry in entries) else min(entries)


def _max(value, axis=None, keepdims=False):
    return _over(_greatest, value, axis, keepdims, "f")


def _min(value, axis=None, keepdims=False):
    return _over(_least, value, axis, keepdims, "f")


def _all(value, axis=None):
    return _over(all, value, axis, False, "b")


def _any(value, axis=None):
    return _over(any, value, axis, False, "b")


def diff(value):
    entries = flat(value)
    return array([after - before for before, after in pairwise(entries)])


def unique(value, return_inverse):
    entries = flat(value)
    found = sorted(set(entries))
    return array(found), array([found.index(entry) for entry in entries])


def flatnonzero(value):
    return array([at for at, entry in enumerate(flat(value)) if entry])


def errstate(**_):
    return nullcontext()


def finfo(_):
    return SimpleNamespace(eps=sys.float_info.epsilon, max=sys.float_info.max, tiny=sys.float_info.min)


ma = SimpleNamespace(is_masked=lambda value: False)
# As the loops see it: arrays without slices, which are quicker to write into.
loops = SimpleNamespace(empty=Grid, zeros=Grid, empty_like=lambda value: Grid(value.shape))

# Under these names they would hide Python's own from this file.
_HIDING = {"max": _max, "min": _min, "all": _all, "any": _any, "abs": _abs}


def __getattr__(name):
    if name in _HIDING:
        return _HIDING[name]
    raise AttributeError(f"the stand-in for numpy has no {name}")
