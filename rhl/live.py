"""The scheme in the loop with hardware: measured outputs to inputs, with save and restore during a run."""

from __future__ import annotations

import io
import os
import re
import zlib
from dataclasses import replace
from hashlib import sha256
from math import prod
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZIP_STORED, BadZipFile, ZipFile

import numpy as np
from numpy.typing import ArrayLike

from rhl._checks import Array, describe, instance, integer, real_array, shown
from rhl._files import write_whole
from rhl.closed_loop import advance, start, step
from rhl.errors import InputError
from rhl.model import SignalModel
from rhl.scheme import Scheme
from rhl.state import ControllerState

_ARRAYS = ("y", "v", "stage", "value", "size", "data")
_NAMES = ("k", "A", "B", "family", *_ARRAYS)
# The most bytes of an array in a saved state besides its numbers: its own header, two of the archive, the digest.
_BESIDE = 1_000
# The largest step: beyond it not every integer is a float, of which the schedules are functions.
_LAST = 2**53
# What reading a damaged archive, or one with other contents, raises; an encrypted one is refused before.
_DAMAGED = (
    OSError,
    ValueError,
    KeyError,
    TypeError,
    OverflowError,
    EOFError,
    NotImplementedError,
    BadZipFile,
    zlib.error,
)
# What NumPy writes before the numbers of an array of floats, of integers, or of a string.
_HEADER = re.compile(
    rb"\x93NUMPY\x01\x00..\{'descr': '([<>](?:f8|[iu][1248]|U\d{1,3})|[|][iu]1)', 'fortran_order': (True|False), "
    rb"'shape': \(((?:\d{1,9}(?:, \d{1,9})*,?)?)\), \} *\n",
    re.DOTALL,
)


class LiveController:
    """A running scheme, the only mutable object of the library.

    A controller belongs to one thread: if several threads call ``step`` of the same one, updates are lost without an
    error. Controllers in different threads may share a scheme.

    Parameters
    ----------
    scheme : Scheme
        The scheme.
    state : ControllerState, optional
        The state to continue from; by default that before k = 0.

    Attributes
    ----------
    scheme : Scheme
    state : ControllerState
        The state before the next step. It holds the last computed input as the applied one.

    Examples
    --------
    >>> from rhl.scheme import default_scheme
    >>> controller, angle = LiveController(default_scheme(p=1, q=1, order=1)), 1.0
    >>> for _ in range(20):
    ...     angle = 1.2 * angle + 0.5 * controller.step([angle])[0]
    >>> controller.state.k, bool(abs(angle) < 1e-3)
    (20, True)
    """

    def __init__(self, scheme: Scheme, state: ControllerState | None = None) -> None:
        instance("scheme", scheme, Scheme)
        if scheme.initial_model.A.ndim > 2:
            batch = scheme.initial_model.A.shape[:-2]
            raise InputError(f"scheme must be of one loop, got a batch of initial models of shape {batch}")
        if state is not None:
            instance("state", state, ControllerState)
        self.scheme, self.state = scheme, start(scheme) if state is None else _fits(scheme, state)

    def __repr__(self) -> str:
        return f"LiveController(k = {self.state.k}, p = {self.scheme.p}, q = {self.scheme.q})"

    def step(self, y: ArrayLike, applied: ArrayLike | None = None) -> Array:
        """Return the input v(k), shape (q,), for the measured output y(k), shape (p,).

        ``applied`` is the input that the actuator applied since the previous step, if it differs from the returned one.
        After an exception the controller is unchanged, so the step can be repeated with another measurement.
        InputError, DivergedError and others as by ``rhl.step``.
        """
        state = self.state
        if applied is not None:
            if state.k == 0:
                raise InputError("applied must be left out at k = 0, before any input, got one")
            v = np.array(state.v)
            v[0] = real_array("applied", applied, (self.scheme.q,))
            state = replace(state, v=v)
        done = step(self.scheme, state, _vector(y, self.scheme.p))
        self.state = advance(self.scheme, done)
        return done.v_computed

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the state to a file (NumPy's .npz), which appears whole or not at all; the scheme is not in it."""
        state, buffer = self.state, io.BytesIO()
        kept = {name: getattr(state, name) for name in _ARRAYS if getattr(state, name) is not None}
        np.savez(buffer, k=state.k, A=state.model.A, B=state.model.B, family=_family(self.scheme), **kept)
        write_whole(path, buffer.getvalue())

    @classmethod
    def restore(cls, scheme: Scheme, path: str | os.PathLike[str]) -> LiveController:
        """Continue from a file that ``save`` wrote, with the scheme that wrote it.

        InputError if the file cannot be read, is not a saved state, is larger than one of this scheme, or was saved
        with a scheme of other sizes or with another family. The next inputs equal those of the saved run exactly.
        """
        instance("scheme", scheme, Scheme)
        family, state = _read(scheme, path)
        if family != _family(scheme):
            raise InputError(
                f"{shown(path)} must be saved with the scheme's family of initial models, got another; give the scheme "
                "that was running then"
            )
        return cls(scheme, state)


def _read(scheme: Scheme, path: str | os.PathLike[str]) -> tuple[str, ControllerState]:
    """Return the family and the state of a file, which is read and unpacked up to the size of a state of the scheme."""
    most = _most_bytes(scheme)
    try:
        with Path(path).open("rb") as file:
            content = file.read(most + 1)
        if len(content) <= most:
            return _state(_unpacked(content, most))
    except _DAMAGED as error:
        reason = getattr(error, "strerror", None) or "a file that LiveController.save did not write"
        raise InputError(f"{shown(path)} must be a saved state, got: {reason}") from error
    raise InputError(
        f"{shown(path)} must be a saved state of at most {most} bytes, as the scheme's is, got more; give the scheme "
        "that was running then"
    )


def _most_bytes(scheme: Scheme) -> int:
    """Return an upper bound of the size of a saved state, packed or not."""
    begun = start(scheme)
    arrays = begun.y, begun.v, begun.size, begun.data, begun.model.A, begun.model.B
    return len(_NAMES) * _BESIDE + 8 * sum(array.size for array in arrays if array is not None)


def _unpacked(content: bytes, most: int) -> dict[str, np.ndarray]:
    """Unpack the arrays of an archive as NumPy writes it; ValueError if it is another one, or larger than ``most``."""
    with ZipFile(io.BytesIO(content)) as archive:
        entries = {entry.filename.removesuffix(".npy"): entry for entry in archive.infolist()}
        plain = all(
            entry.compress_type in (ZIP_STORED, ZIP_DEFLATED) and not entry.flag_bits & 1 for entry in entries.values()
        )
        # A compressed file of a few bytes may unpack to any size.
        if not plain or not entries.keys() <= {*_NAMES} or sum(entry.file_size for entry in entries.values()) > most:
            raise ValueError
        found = {}
        for name, entry in entries.items():
            with archive.open(entry) as file:
                found[name] = _array(file.read(entry.file_size + 1))
        return found


def _array(content: bytes) -> np.ndarray:
    """Return the array of a file of NumPy; ValueError if it is of another kind, or its shape does not fit its size.

    The library's own reader makes room for any shape that the header promises, and raises many kinds of errors.
    """
    header = _HEADER.match(content)
    if header is None:
        raise ValueError
    kind, fortran, shape = (part.decode() for part in header.groups())
    lengths, numbers = [int(length) for length in re.findall(r"\d+", shape)], content[header.end() :]
    if prod(lengths) * np.dtype(kind).itemsize != len(numbers) or kind.endswith("U0"):
        raise ValueError
    return np.frombuffer(numbers, kind).reshape(lengths, order="F" if fortran == "True" else "C")


def _state(found: dict[str, np.ndarray]) -> tuple[str, ControllerState]:
    """Return the family and the state; KeyError or TypeError if an array is missing, ValueError if one is no such."""
    for name, kinds in (("k", "iu"), ("family", "U"), ("stage", "iu")):
        if name in found and (found[name].shape != () or found[name].dtype.kind not in kinds):
            raise ValueError
    if found["k"] < 0:
        raise ValueError
    arrays = {name: found[name] for name in _ARRAYS if name in found}
    arrays |= {name: real_array(name, array) for name, array in arrays.items() if name != "stage"}
    state = ControllerState(int(found["k"]), model=SignalModel(found["A"], found["B"]), **arrays)
    return str(found["family"]), state


def _family(scheme: Scheme) -> str:
    """Return what distinguishes the family of a scheme from others: a saved model may be a member of it."""
    family = scheme.family
    if family is None:
        return ""
    return sha256(family.shifts.tobytes() + np.float64(family.hysteresis).tobytes()).hexdigest()


def _vector(y: ArrayLike, p: int) -> Array:
    found = real_array("y", y)
    if found.shape != (p,):
        raise InputError(f"y must have shape ({p},), one measurement of each output, got {found.shape}")
    return found


def _fits(scheme: Scheme, state: ControllerState) -> ControllerState:
    """Return a state that ``start`` or ``advance`` may have made for the scheme; InputError if it is another one."""
    begun, k = start(scheme), integer("the state's k", state.k, 0)
    if k > _LAST:
        raise InputError(f"the state's k must be at most {_LAST}, got {k}; give a state that the scheme has made")
    number = np.zeros(()) if scheme.controller.adaptive and k > 0 else None
    wanted = {name: getattr(begun, name) for name in ("y", "v", "size", "data")} | {"stage": number, "value": number}
    pairs = [(name, getattr(state, name), array) for name, array in wanted.items()]
    pairs += [(name, getattr(state.model, name), getattr(begun.model, name)) for name in ("A", "B")]
    for name, found, array in pairs:
        if np.shape(found) != np.shape(array) or (found is None) != (array is None):
            raise InputError(
                f"state must belong to the scheme, whose {name} {_form(array)}, got one that {_form(found)}; "
                "give the scheme that was running then"
            )
        if found is not None and name != "value":  # a value may be beyond all range
            real_array(f"the state's {name}", found)
    _check_values(state)
    return state


def _form(array: np.ndarray | None) -> str:
    return "is None" if array is None else f"has shape {array.shape}"


def _check_values(state: ControllerState) -> None:
    """Refuse numbers that no step returns."""
    data = np.zeros((1, 1)) if state.data is None else state.data
    for name, wanted, fine in (
        ("stage", f"from 0 to {state.k - 1}", state.stage is None or 0 <= state.stage < state.k),
        ("size", "of at least 0", state.size is None or np.all(state.size >= 0)),
        (
            "data",
            "triangular, with a diagonal of at least 0",
            not np.tril(data, -1).any() and np.all(data.diagonal() >= 0),
        ),
    ):
        if not fine:
            raise InputError(
                f"the state's {name} must be {wanted}, got {describe(getattr(state, name))}; "
                "give a state that the scheme has made"
            )
