"""The scheme in the loop with hardware: measured outputs to inputs, with save and restore during a run."""

from __future__ import annotations

import io
import os
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any
from zipfile import BadZipFile, ZipFile

import numpy as np
from numpy.typing import ArrayLike

from rhl._checks import Array, instance, real_array, shown
from rhl._files import write_whole
from rhl.closed_loop import advance, start, step
from rhl.errors import InputError
from rhl.model import SignalModel
from rhl.scheme import Scheme
from rhl.state import ControllerState

_ARRAYS = ("y", "v", "stage", "value", "size", "data")
# The largest saved state, in bytes, unpacked.
_LARGEST = 500_000_000


class LiveController:
    """A running scheme, the only mutable object of the library.

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

        InputError if the file cannot be read, is not a saved state, or was saved with a scheme of other sizes or with
        another family. The next inputs equal those of the saved run exactly.
        """
        instance("scheme", scheme, Scheme)
        try:
            # Without pickle a file cannot run code.
            content = io.BytesIO(Path(path).read_bytes())
            # A compressed file of a few bytes may unpack to any size.
            if sum(entry.file_size for entry in ZipFile(content).infolist()) > _LARGEST:
                raise ValueError
            with np.load(content, allow_pickle=False) as file:
                found: dict[str, Any] = dict(file)
            k, family = found["k"], found["family"]
            if k.shape != () or k.dtype.kind not in "iu" or k < 0 or family.dtype.kind != "U" or family.shape != ():
                raise ValueError
            model = SignalModel(found["A"], found["B"])
            arrays = {name: real_array(name, found[name]) for name in _ARRAYS if name in found}
            state = ControllerState(int(k), model=model, **arrays)
        except (OSError, ValueError, KeyError, TypeError, EOFError, BadZipFile) as error:
            reason = getattr(error, "strerror", None) or "a file that LiveController.save did not write"
            raise InputError(f"{shown(path)} must be a saved state, got: {reason}") from error
        if str(family) != _family(scheme):
            raise InputError(
                f"{shown(path)} must be saved with the scheme's family of initial models, got another; give the scheme "
                "that was running then"
            )
        return cls(scheme, state)


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
    begun = start(scheme)
    for name in ("y", "v", "size", "data"):
        found, wanted = getattr(state, name), getattr(begun, name)
        if np.shape(found) != np.shape(wanted) or (found is None) != (wanted is None):
            raise InputError(
                f"state must belong to the scheme, whose {name} has shape {np.shape(wanted)}, got {np.shape(found)}; "
                "give the scheme that was running then"
            )
    if (state.model.A.shape, state.model.B.shape) != (begun.model.A.shape, begun.model.B.shape):
        raise InputError(
            f"state must belong to the scheme, whose A has shape {begun.model.A.shape}, got {state.model.A.shape}; "
            "give the scheme that was running then"
        )
    if scheme.controller.adaptive and state.k > 0 and state.stage is None:
        raise InputError("state must belong to the scheme, whose weight is adaptive, got a state without a stage")
    return state
