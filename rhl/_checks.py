"""Checks of the values that callers pass, and the wording of their errors.

Every message is one sentence that names the argument, the expected value and the value found.
"""

from __future__ import annotations

from collections.abc import Sequence
from numbers import Integral, Real
from pathlib import PurePath
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rhl.errors import InputError, NotFiniteError

Array = NDArray[np.float64]

# A matrix read from text keeps 15 digits or more; an asymmetry above this is not rounding.
_SYMMETRY_RTOL = 1e-12


def real_array(name: str, value: ArrayLike, shape: tuple[int | None, ...] | None = None) -> Array:
    """Copy to a read-only float64 array; refuse ragged, complex and non-finite values and other trailing shapes.

    In the shape None stands for any length of at least one; further axes may lead. NotFiniteError if an
    entry is not finite, otherwise InputError.
    """
    try:
        raw = np.asarray(value)
    except Exception as error:  # a ragged list, or any error of the object's own conversion
        raise InputError(f"{name} must be a rectangular array of numbers, got {describe(value)}") from error
    if raw.dtype.kind not in "iuf":
        raise InputError(f"{name} must hold real numbers, got {_kind(raw, value)}")
    if np.ma.is_masked(value):
        raise InputError(f"{name} must hold a number in every entry, got masked entries; fill them in")
    with np.errstate(over="ignore"):  # values too large for float64 become infinite, and are refused below
        array = np.array(raw, dtype=np.float64, order="C", subok=False)
    if shape is not None:
        fits = array.ndim >= len(shape) and all(
            length >= 1 and want in (None, length)
            for length, want in zip(array.shape[array.ndim - len(shape) :], shape, strict=True)
        )
        if not fits:
            raise InputError(f"{name} must have shape {_shape(shape)}, got {_shape(array.shape)}")
    if not np.all(np.isfinite(array)):
        raise NotFiniteError(f"{name} must be finite, got {array[~np.isfinite(array)][0]} among its entries")
    array.flags.writeable = False
    return array


def numbers(value: Any) -> Array:
    """Return the result of a user's function as float64, including NaN and infinity.

    TypeError or ValueError for complex numbers, whose imaginary part numpy would drop, strings, which it would parse,
    and None.
    """
    raw = np.asarray(value)
    if raw.dtype.kind not in "iufO":
        raise TypeError(f"real numbers are needed, not {_kind(raw, value)}")
    # One by one, because numpy converts None to NaN.
    with np.errstate(over="ignore"):
        return np.asarray(raw if raw.dtype.kind != "O" else np.frompyfunc(float, 1, 1)(raw), dtype=np.float64)


def read_only(array: ArrayLike) -> Array:
    """Copy a result of the library to a read-only float64 array, without checks."""
    copy = np.array(array, dtype=np.float64)
    copy.flags.writeable = False
    return copy


def locked(array: np.ndarray) -> Any:
    """Return a read-only view, without a copy: a result that is kept must not change in a caller's hands."""
    view = array.view()
    view.flags.writeable = False
    return view


def square(name: str, value: ArrayLike) -> Array:
    """Check a square matrix, shape (..., n, n)."""
    array = real_array(name, value, (None, None))
    if array.shape[-1] != array.shape[-2]:
        raise InputError(f"{name} must be square, got shape {_shape(array.shape)}")
    return array


def weight_matrix(name: str, value: ArrayLike, n: int) -> Array:
    """Check a symmetric positive definite weight, shape (..., n, n); a number stands for that multiple of the identity.

    The result is exactly symmetric.
    """
    array = real_array(name, value)
    if array.ndim == 0:
        array = array * np.eye(n)
    if array.ndim < 2 or array.shape[-2:] != (n, n) or array.size == 0:
        raise InputError(f"{name} must be a number or a matrix of shape ({n}, {n}), got shape {_shape(array.shape)}")
    transposed = array.swapaxes(-1, -2)
    # Each member of a batch is checked relative to its own size.
    largest = np.max(np.abs(array), axis=(-1, -2), keepdims=True)
    scaled = array / np.where(largest > 0, largest, 1.0)
    if np.max(np.abs(scaled - scaled.swapaxes(-1, -2))) > _SYMMETRY_RTOL:
        gap = np.max(np.abs(scaled - scaled.swapaxes(-1, -2)) * largest)
        raise InputError(f"{name} must be symmetric, got entries that differ from their mirror by {gap:.3g}")
    # Half of the smallest positive number would round to zero.
    array = np.where(array == transposed, array, array / 2 + transposed / 2)
    try:
        np.linalg.cholesky(array)
    except np.linalg.LinAlgError:
        least = np.min(np.linalg.eigvalsh(scaled / 2 + scaled.swapaxes(-1, -2) / 2) * largest[..., 0])
        beside = "" if least <= 0 else f" with entries of {largest.max():.3g}"
        raise InputError(f"{name} must be positive definite, got smallest eigenvalue {least:.3g}{beside}") from None
    array.flags.writeable = False
    return array


def common_batch(**arrays: tuple[Array, int]) -> tuple[int, ...]:
    """Return the common batch axes of arrays, each given with the number of its other, trailing axes."""
    try:
        return np.broadcast_shapes(*(M.shape[: M.ndim - core] for M, core in arrays.values()))
    except ValueError:
        shapes = ", ".join(f"{name} {M.shape}" for name, (M, _) in arrays.items())
        raise InputError(f"leading batch axes must broadcast together, got shapes {shapes}") from None


def integer(name: str, value: Any, minimum: int) -> int:
    """Check an integer of at least ``minimum``."""
    if isinstance(value, bool) or not isinstance(value, Integral) or value < minimum:
        raise InputError(f"{name} must be an integer of at least {minimum}, got {describe(value)}")
    return int(value)


def positive(name: str, value: Any) -> float:
    """Check a positive finite number."""
    return _in_range(name, value, 0.0, np.inf, "a positive finite number", open_low=True)


def fraction(name: str, value: Any) -> float:
    """Check a number in [0, 1)."""
    return _in_range(name, value, 0.0, 1.0, "a number in [0, 1)", open_low=False)


def _in_range(name: str, value: Any, low: float, high: float, wanted: str, *, open_low: bool) -> float:
    number = isinstance(value, Real) and not isinstance(value, bool)
    # NaN fails every comparison, so this line refuses it too.
    if not number or not ((low < value if open_low else low <= value) and value < high):
        raise InputError(f"{name} must be {wanted}, got {describe(value)}")
    try:
        return float(value)
    except OverflowError:
        raise InputError(f"{name} must be {wanted} in the range of float64, got {describe(value)}") from None


def choice(name: str, value: Any, options: Sequence[str]) -> None:
    """Check that a value is one of the options."""
    if not (isinstance(value, str) and value in options):
        raise InputError(f"{name} must be one of {', '.join(options)}, got {describe(value)}")


def instance(name: str, value: Any, *kinds: type) -> None:
    """Check that a value is an instance of one of the classes."""
    if not isinstance(value, kinds):
        wanted = " or a ".join(kind.__name__ for kind in kinds)
        raise InputError(f"{name} must be a {wanted}, got {describe(value)}")


def members(name: str, value: Any, kind: str, *needed: str) -> None:
    """Check that a value has the required members."""
    missing = [member for member in needed if not hasattr(value, member)]
    if missing:
        raise InputError(f"{name} must be {kind}, got {describe(value)} without {missing[0]}")


def _shape(shape: tuple[int | None, ...]) -> str:
    inner = ", ".join("at least 1" if length is None else describe(length) for length in shape)
    return f"({inner},)" if len(shape) == 1 else f"({inner})"


def _kind(raw: NDArray[Any], value: Any) -> str:
    return "complex numbers" if raw.dtype.kind == "c" else describe(value)


def reason(error: BaseException) -> str:
    """Return an error of a user's function on one line of at most 200 characters, for a message."""
    try:
        said = " ".join(str(error).split())
    except Exception:  # a user's own exception may fail at this too
        said = ""
    said = said if said.isprintable() else ascii(said)
    text = f"{type(error).__name__}: {said}" if said else type(error).__name__
    return text if len(text) <= 200 else f"{text[:197]}..."


def shown(path: object) -> str:
    """Return a file's name for a message: quoted if it does not print on one line, at most 200 characters."""
    text = str(path) if isinstance(path, (str, PurePath)) else describe(path)
    text = text if text.isprintable() else ascii(text)
    return text if len(text) <= 200 else f"{text[:197]}..."


def describe(value: Any) -> str:
    """Return a value on one line of at most 60 characters, for a message."""
    try:
        text = " ".join(repr(value).split())
    except Exception:  # a user's own object, or an integer with too many digits
        text = f"a {type(value).__name__} that cannot be shown"
    text = text if text.isprintable() else ascii(text)
    return text if len(text) <= 60 else f"{text[:57]}..."
