"""A stand-in for numpy: as much of it as rhl needs to check its input, set a scheme up and run its loops on small arrays.

No build of numpy for the browser can be had without another host, and the loops need nothing of it but an array that
they read and write entry by entry. An array is a dictionary from an entry's indices to the entry, because that lookup
is the quickest that the interpreter has for a[i, j, l]; its order is that of the indices. Where an array has four axes
or more, it holds one array for each value of the first, so that a[i] is a part of a and no copy.

What is not here is missing loudly (AttributeError or NotImplementedError), never approximated.
"""

import math
import operator
import sys
from contextlib import nullcontext
from itertools import product
from types import ModuleType, SimpleNamespace

inf, nan, pi, newaxis = math.inf, math.nan, math.pi, None
float64, int64, bool_ = float, int, bool


class integer:
    """No integer is one of numpy's own."""


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

    def __format__(self, how):
        return format(self.item(), how)

    def __repr__(self):
        return f"array({self.tolist()})"

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
        keys[at : at + 1] = [slice(None)] * (self.ndim - sum(part is not None and part is not Ellipsis for part in keys))
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
        return _max(self)

    def min(self):
        return _min(self)

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
    found = {type(entry) for entry in entries}
    for kind, types in (("b", {bool}), ("i", {bool, int}), ("f", {bool, int, float}), ("c", {bool, int, float, complex})):
        if entries and found <= types:
            return kind
    return "f" if not entries else "U" if found <= {bool, int, float, complex, str} else "O"


def array(value, dtype=None, order=None, subok=None):
    shape, entries = _nested(value)
    if dtype is float:
        return made(shape, [_as_float(entry) for entry in entries])
    return made(shape, entries, _kind(entries))


def _as_float(entry):
    try:
        return float(entry)
    except OverflowError:
        return math.copysign(inf, entry)


def asarray(value, dtype=None):
    return value if isinstance(value, ndarray) and (dtype is None or value.dtype.kind == "f") else array(value, dtype)


def ascontiguousarray(value):
    return array(value)


def zeros(shape, dtype=float):
    return ndarray(shape, dtype(0))


empty = zeros


def ones(shape):
    return ndarray(shape, 1.0)


def full(shape, value):
    return ndarray(shape, value, _kind([value]))


def zeros_like(value):
    return ndarray(value.shape)


empty_like = zeros_like


def eye(n, m=None, k=0):
    found = ndarray((n, n if m is None else m))
    for i in range(max(0, -k), min(n, found.shape[1] - k)):
        found[i, i + k] = 1.0
    return found


def arange(*limits):
    return array(list(range(*limits)))


# Shapes


def shape(value):
    return _nested(value)[0]


def ndim(value):
    return len(shape(value))


def broadcast_shapes(*shapes):
    most = max(map(len, shapes), default=0)
    columns = [{length for length in column if length != 1} for column in zip(*((1,) * (most - len(s)) + s for s in shapes))]
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


def _each(function, *values, kind="f"):
    shape = broadcast_shapes(*(asarray(value).shape for value in values))
    columns = (flat(broadcast_to(value, shape)) for value in values)
    return made(shape, [function(*entries) for entries in zip(*columns, strict=True)], kind)


def _divided(a, b):
    if b:
        return a / b
    return nan if a == 0 or a != a else math.copysign(inf, a) * math.copysign(1, b)


def _attach(name, function, kind="f"):
    setattr(ndarray, f"__{name}__", lambda self, other: _each(function, self, other, kind=kind))
    setattr(ndarray, f"__r{name}__", lambda self, other: _each(function, other, self, kind=kind))


for _name in ("add", "sub", "mul"):
    _attach(_name, getattr(operator, _name))
_attach("truediv", _divided)
_attach("pow", operator.pow)
for _name in ("lt", "le", "gt", "ge", "eq", "ne"):
    _attach(_name, getattr(operator, _name), "b")
_attach("and", lambda a, b: a and b, "b")
_attach("or", lambda a, b: a or b, "b")
ndarray.__neg__ = lambda self: _each(operator.neg, self)
ndarray.__abs__ = lambda self: _each(abs, self)
ndarray.__invert__ = lambda self: _each(operator.not_, self, kind="b")


def sqrt(value):
    return _each(math.sqrt, value)


def _abs(value):
    return _each(abs, value)


def _function(name):
    return lambda value: _each(getattr(math, name), value)


sin, cos, tanh, exp = map(_function, ("sin", "cos", "tanh", "exp"))


def isfinite(value):
    return _each(math.isfinite, value, kind="b")


def where(condition, yes, no):
    return _each(lambda c, a, b: a if c else b, condition, yes, no)


def array_equal(one, other):
    return shape(one) == shape(other) and flat(asarray(one)) == flat(asarray(other))


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
    return array([after - before for before, after in zip(entries, entries[1:])])


def unique(value, return_inverse):
    entries = flat(value)
    found = sorted(set(entries))
    return array(found), array([found.index(entry) for entry in entries])


def flatnonzero(value):
    return array([at for at, entry in enumerate(flat(value)) if entry])


# Linear algebra of small matrices


class LinAlgError(ValueError):
    """A matrix is not what a factorisation needs."""


def cholesky(M):
    """Return the lower triangular factor of a positive definite matrix."""
    n = len(M)
    L = zeros((n, n))
    for j in range(n):
        pivot = M[j, j] - sum(L[j, k] ** 2 for k in range(j))
        if not pivot > 0:
            raise LinAlgError("the matrix is not positive definite")
        L[j, j] = math.sqrt(pivot)
        for i in range(j + 1, n):
            L[i, j] = (M[i, j] - sum(L[i, k] * L[j, k] for k in range(j))) / L[j, j]
    return L


def svd(M, compute_uv=True):
    """Return the singular values, largest first, by Jacobi's rotations of the shorter side's vectors."""
    if compute_uv or M.ndim != 2:
        raise NotImplementedError("only the singular values of one matrix")
    rows = M.tolist() if M.shape[0] <= M.shape[1] else M.T.tolist()
    for _ in range(60):
        turned = False
        for i in range(len(rows)):
            for j in range(i + 1, len(rows)):
                a, b = rows[i], rows[j]
                aa, bb, ab = (sum(map(operator.mul, s, t)) for s, t in ((a, a), (b, b), (a, b)))
                if abs(ab) <= 1e-16 * math.sqrt(aa) * math.sqrt(bb):
                    continue
                turned = True
                zeta = (bb - aa) / (2 * ab)
                t = math.copysign(1.0, zeta) / (abs(zeta) + math.hypot(1.0, zeta))
                c = 1 / math.hypot(1.0, t)
                rows[i] = [c * (x - t * y) for x, y in zip(a, b, strict=True)]
                rows[j] = [c * (t * x + y) for x, y in zip(a, b, strict=True)]
        if not turned:
            break
    return array(sorted((math.hypot(*row) for row in rows), reverse=True))


def eigvalsh(M):
    """Return the eigenvalues of a symmetric matrix, least first, by Jacobi's rotations."""
    A, n = M.tolist(), len(M)
    for _ in range(60):
        for p in range(n):
            for q in range(p + 1, n):
                if A[p][q] == 0:
                    continue
                zeta = (A[q][q] - A[p][p]) / (2 * A[p][q])
                t = math.copysign(1.0, zeta) / (abs(zeta) + math.hypot(1.0, zeta))
                c = 1 / math.hypot(1.0, t)
                for k in range(n):
                    x, y = A[k][p], A[k][q]
                    A[k][p], A[k][q] = c * (x - t * y), c * (t * x + y)
                for k in range(n):
                    x, y = A[p][k], A[q][k]
                    A[p][k], A[q][k] = c * (x - t * y), c * (t * x + y)
    return array(sorted(A[i][i] for i in range(n)))


def errstate(**_):
    return nullcontext()


class _Sub:
    """What stands in annotations, which nobody reads."""

    def __class_getitem__(cls, _):
        return cls


def finfo(_):
    return SimpleNamespace(eps=sys.float_info.epsilon, max=sys.float_info.max, tiny=sys.float_info.min)


linalg = SimpleNamespace(LinAlgError=LinAlgError, cholesky=cholesky, svd=svd, eigvalsh=eigvalsh)
ma = SimpleNamespace(is_masked=lambda value: False)
typing = ModuleType("numpy.typing")
typing.NDArray = typing.ArrayLike = _Sub
sys.modules["numpy.typing"] = typing
# As the loops see it: arrays without slices, which are quicker to write into.
loops = SimpleNamespace(empty=Grid, zeros=Grid, empty_like=lambda value: Grid(value.shape))

# Under these names they would hide Python's own from this file.
_HIDING = {"max": _max, "min": _min, "all": _all, "any": _any, "abs": _abs}


def __getattr__(name):
    if name in _HIDING:
        return _HIDING[name]
    raise AttributeError(f"the stand-in for numpy has no {name}")
