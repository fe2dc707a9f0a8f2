"""The array: a dictionary from an entry's indices to the entry, with numpy's shapes, slices and arithmetic.

That lookup is the quickest that the interpreter has for a[i, j, l]. The order of the dictionary is that of the indices.
Where an array has four axes or more, it holds one array for each value of the first, so that a[i] is a part of a and no
copy.
"""

import math
import operator
from itertools import product
from types import SimpleNamespace


class _Kind:
    """What is left of a dtype: its kind."""

    def __init__(self, kind):
        self.kind = kind


class Grid(dict):
    """An array with its entries' indices checked by nobody: what the loops work on."""

    def __init__(self, shape, fill=0.0):
        shape = self.shape = (shape,) if isinstance(shape, int) else tuple(shape)
        self.ndim = len(shape)
        if len(shape) > 3:
            super().__init__((i, type(self)(shape[1:], fill)) for i in range(shape[0]))
        else:
            super().__init__(dict.fromkeys(_places(shape), fill))

    def __missing__(self, key):
        if self.ndim > 3 and isinstance(key, tuple) and isinstance(key[0], int):
            return self[key[0]][key[1:]]
        raise KeyError(key)


def _places(shape):
    return range(shape[0]) if len(shape) == 1 else product(*map(range, shape))


class ndarray(Grid):
    """An array as the rest of the library uses it: with slices, masks, broadcasting and arithmetic."""

    __hash__ = None

    def __init__(self, shape, fill=0.0, kind="f"):
        super().__init__(shape, fill)
        self.dtype, self.flags = _Kind(kind), SimpleNamespace(writeable=True)

    @property
    def size(self):
        return math.prod(self.shape)

    @property
    def T(self):
        return transposed(self, range(self.ndim)[::-1])

    def __len__(self):
        return self.shape[0]

    def __iter__(self):
        return (self[i] for i in range(self.shape[0]))

    def __bool__(self):
        return bool(self.item())

    def __float__(self):
        return float(self.item())

    def view(self):
        return self

    def item(self):
        (only,) = flat(self)
        return only

    def tolist(self):
        return [row.tolist() if isinstance(row, ndarray) else row for row in self] if self.ndim else self.item()

    def __getitem__(self, key):
        try:
            return dict.__getitem__(self, key)
        except (KeyError, TypeError):
            return self._part(key)

    def __setitem__(self, key, value):
        try:
            plain = self.ndim < 4 and key in self
        except TypeError:  # a slice, in Pythons that cannot hash one
            plain = False
        if plain:
            dict.__setitem__(self, key, value.item() if isinstance(value, ndarray) else value)
            return
        shape, places = self._selected(key)
        for place, entry in zip(places, flat(broadcast_to(value, shape)), strict=True):
            at = self
            while at.ndim > 3:
                at, place = at[place[0]], place[1:]
            dict.__setitem__(at, place[0] if at.ndim == 1 else place, entry)

    def _part(self, key):
        if isinstance(key, ndarray) and key.dtype.kind == "b":
            if key.shape != self.shape:
                raise NotImplementedError("a mask has the shape of what it selects from")
            kept = [entry for entry, wanted in zip(flat(self), flat(key), strict=True) if wanted]
            return made((len(kept),), kept, self.dtype.kind)
        if isinstance(key, ndarray) and self.ndim == 1:
            return made(key.shape, [self[at] for at in flat(key)], self.dtype.kind)
        shape, places = self._selected(key)
        found = [self[place[0] if self.ndim == 1 else place] for place in places]
        whole = key is Ellipsis or (isinstance(key, tuple) and any(part is Ellipsis for part in key))
        return made(shape, found, self.dtype.kind) if shape or whole else found[0]

    def _selected(self, key):
        """Return the shape of what a key of integers, slices, None and an ellipsis selects, and the places in it."""
        keys = list(key) if isinstance(key, tuple) else [key]
        at = next((i for i, part in enumerate(keys) if part is Ellipsis), len(keys))
        given = sum(part is not None and part is not Ellipsis for part in keys)
        keys[at : at + 1] = [slice(None)] * (self.ndim - given)
        shape, axes = [], []
        for part in keys:
            if part is None:
                shape.append(1)
                continue
            length = self.shape[len(axes)]
            if isinstance(part, slice):
                axes.append(range(length)[part])
                shape.append(len(axes[-1]))
            elif isinstance(part, int):
                axes.append((range(length)[part],))
            else:
                raise NotImplementedError(f"an index like {part!r}")
        return tuple(shape), product(*axes)

    def reshape(self, *shape):
        shape = list(shape[0] if isinstance(shape[0], tuple) else shape)
        if -1 in shape:
            shape[shape.index(-1)] = self.size // -math.prod(shape)
        return made(tuple(shape), flat(self), self.dtype.kind)

    def swapaxes(self, one, other):
        axes = list(range(self.ndim))
        axes[one], axes[other] = axes[other], axes[one]
        return transposed(self, axes)

    def max(self):
        return max(flat(self))

    def min(self):
        return min(flat(self))

    def __matmul__(self, other):
        if self.ndim != 2 or other.ndim != 2:
            raise NotImplementedError("only matrices are multiplied")
        (rows, inner), columns = self.shape, other.shape[1]
        found = [sum(self[i, k] * other[k, j] for k in range(inner)) for i in range(rows) for j in range(columns)]
        return made((rows, columns), found)


def flat(value):
    """Return the entries of an array, or the number that stands for one, in the order of their indices."""
    if not isinstance(value, Grid):
        return [value]
    if value.ndim > 3:
        return [entry for part in value.values() for entry in flat(part)]
    return list(value.values())


def made(shape, entries, kind="f"):
    """Return the array of that shape with these entries."""
    array = ndarray(shape, 0.0, kind)
    if array.ndim > 3:
        size = math.prod(shape[1:])
        for i in range(shape[0]):
            dict.__setitem__(array, i, made(shape[1:], entries[i * size : (i + 1) * size], kind))
    else:
        array.update(zip(_places(shape), entries, strict=True))
    return array


def transposed(array, axes):
    """Return the array with its axes in that order."""
    axes = list(axes)
    shape = tuple(array.shape[axis] for axis in axes)
    back = [axes.index(axis) for axis in range(array.ndim)]
    entries = [array._part(tuple(place[axis] for axis in back)) for place in product(*map(range, shape))]
    return made(shape, entries, array.dtype.kind)


# Making arrays


def _nested(value):
    """Return shape and entries of nested sequences; ValueError where they are ragged."""
    if isinstance(value, Grid):
        return value.shape, flat(value)
    if not isinstance(value, list | tuple):
        return (), [value]
    parts = [_nested(part) for part in value]
    if any(shape != parts[0][0] for shape, _ in parts):
        raise ValueError("the rows differ in length")
    return (len(parts), *(parts[0][0] if parts else ())), [entry for _, entries in parts for entry in entries]


def _kind(entries):
    """Return the kind that holds all entries, as numpy chooses it."""
    found = {object if type(entry) is int and not -(2**63) <= entry < 2**64 else type(entry) for entry in entries}
    if not entries:
        return "f"
    known = (("b", bool), ("i", int), ("f", float), ("c", complex), ("U", str))
    return next((kind for i, (kind, _) in enumerate(known) if found <= {of for _, of in known[: i + 1]}), "O")


def array(value, dtype=None, order=None, subok=None):
    shape, entries = _nested(value)
    if dtype is float:
        return made(shape, [float(entry) for entry in entries])
    return made(shape, entries, _kind(entries))


def asarray(value, dtype=None):
    return value if isinstance(value, ndarray) and (dtype is None or value.dtype.kind == "f") else array(value, dtype)


def ascontiguousarray(value):
    return array(value)


def zeros(shape, dtype=float):
    return ndarray(shape, dtype(0))


empty = zeros


def full(shape, value):
    return ndarray(shape, value, _kind([value]))


def eye(n, m=None, k=0):
    found = ndarray((n, n if m is None else m))
    for i in range(max(0, -k), min(n, found.shape[1] - k)):
        found[i, i + k] = 1.0
    return found


# Shapes


def shape(value):
    return _nested(value)[0]


def broadcast_shapes(*shapes):
    most = max(map(len, shapes), default=0)
    padded = ((1,) * (most - len(shape)) + shape for shape in shapes)
    columns = [set(column) - {1} for column in zip(*padded, strict=True)]
    if any(len(lengths) > 1 for lengths in columns):
        raise ValueError("shapes do not broadcast together")
    return tuple(lengths.pop() if lengths else 1 for lengths in columns)


def broadcast_to(value, shape):
    array, shape = asarray(value), (shape,) if isinstance(shape, int) else tuple(shape)
    if array.shape == shape:
        return array
    if broadcast_shapes(array.shape, shape) != shape:
        raise ValueError("shapes do not broadcast together")
    own = (1,) * (len(shape) - array.ndim) + array.shape
    steps = [0 if own[i] == 1 else math.prod(own[i + 1 :]) for i in range(len(shape))]
    entries = flat(array)
    found = [entries[sum(map(operator.mul, place, steps))] for place in product(*map(range, shape))]
    return made(shape, found, array.dtype.kind)


def moveaxis(array, source, target):
    axes = list(range(array.ndim))
    axes.insert(target % array.ndim, axes.pop(source))
    return transposed(array, axes)


def concatenate(arrays, axis=0):
    arrays = [asarray(part) for part in arrays]
    axis %= arrays[0].ndim
    lengths = [part.shape[axis] for part in arrays]
    found = ndarray((*arrays[0].shape[:axis], sum(lengths), *arrays[0].shape[axis + 1 :]))
    first = 0
    for part, length in zip(arrays, lengths, strict=True):
        found[(*[slice(None)] * axis, slice(first, first + length))] = part
        first += length
    return found


# Entry by entry


def each(function, *values, kind="f"):
    shape = broadcast_shapes(*(asarray(value).shape for value in values))
    columns = (flat(broadcast_to(value, shape)) for value in values)
    return made(shape, [function(*entries) for entries in zip(*columns, strict=True)], kind)


def _divided(a, b):
    if b:
        return a / b
    return math.nan if a == 0 or a != a else math.copysign(math.inf, a) * math.copysign(1, b)


def _power(a, b):
    try:
        return a**b
    except OverflowError:
        return math.inf


def _attach(name, function, kind="f"):
    setattr(ndarray, f"__{name}__", lambda self, other: each(function, self, other, kind=kind))
    setattr(ndarray, f"__r{name}__", lambda self, other: each(function, other, self, kind=kind))


for _name in ("add", "sub", "mul"):
    _attach(_name, getattr(operator, _name))
_attach("truediv", _divided)
_attach("pow", _power)
for _name in ("lt", "le", "gt", "ge", "eq", "ne"):
    _attach(_name, getattr(operator, _name), "b")
_attach("and", lambda a, b: a and b, "b")
_attach("or", lambda a, b: a or b, "b")
ndarray.__neg__ = lambda self: each(operator.neg, self)
ndarray.__abs__ = lambda self: each(abs, self)
ndarray.__invert__ = lambda self: each(operator.not_, self, kind="b")
