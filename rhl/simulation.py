"""Whole runs of one loop or a batch, compiled if the scheme allows it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import prod
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from rhl import _engine
from rhl._checks import Array, choice, describe, integer, reason
from rhl.closed_loop import advance, check_loop, measured, moved, output, start, step
from rhl.disturbances import Disturbances, through
from rhl.errors import DivergedError, InputError
from rhl.lifting import remember
from rhl.model import SignalModel
from rhl.plants.base import Plant
from rhl.plants.linear import LinearPlant
from rhl.schedules import epsilons
from rhl.scheme import Scheme
from rhl.state import ControllerState, Models, Step
from rhl.trace import Trace

Record = Literal["signals", "models"]

# Steps that the compiled loop takes between checks for progress and Ctrl-C.
_PART = 256


def simulate(
    scheme: Scheme,
    plant: Plant,
    z0: ArrayLike,
    steps: int,
    *,
    record: Record | None = None,
    progress: Callable[[Trace], None] | None = None,
    sensor: Disturbances | None = None,
    actuator: Disturbances | None = None,
    load: Disturbances | None = None,
    applied_known: bool = True,
) -> Trace:
    """Run the scheme on a plant and record the run, k = 0 ... steps-1.

    Members of a batch that leave the range of float64 keep their last values; ``diverged_at`` holds their steps.

    Parameters
    ----------
    scheme : Scheme
        The scheme.
    plant : Plant
        The plant; a linear one may hold another F, G, H for each member of a batch.
    z0 : array_like, shape (..., n)
        Initial state; leading axes run that many loops at once.
    steps : int
        At least 1.
    record : {"signals", "models"}, optional
        "signals": y, v and z; the trace computes everything else on access. "models": also the estimates, which makes
        this access faster, at 16 n (n + q) bytes a step and member. By default "models" for one loop and "signals" for
        a batch.
    progress : callable, optional
        Called from time to time with the trace so far.
    sensor, actuator, load, applied_known
        Disturbances between scheme and plant, as in ``closed_loop``.

    Raises
    ------
    DivergedError
        If a single run leaves the range of float64; its ``trace`` holds the steps before.
    InputError
        If z0 or the plant do not fit, or steps is below 1 or so large that the signals do not fit into memory.

    Examples
    --------
    >>> from rhl.paper.published import linear_example
    >>> example = linear_example()
    >>> trace = simulate(example.scheme, example.plant, example.z0, steps=42)
    >>> bool(abs(trace.z[-1]).max() < 1)
    True
    """
    integer("steps", steps, 1)
    if record is not None:
        choice("record", record, get_args(Record))
    if progress is not None and not callable(progress):
        raise InputError(f"progress must be a function of a trace, got {describe(progress)}")
    z = check_loop(scheme, plant, z0, applied_known)
    disturbed = sensor is not None or actuator is not None
    alone = not disturbed and load is None
    if type(plant) is LinearPlant and _engine.serves(scheme) and scheme.lifting.basis is None and alone:
        rows = _Rows.empty(scheme, plant, z.shape[:-1], steps, record, disturbed, applied_known)
        parts = _compiled(scheme, plant, z, rows)
    else:
        y = output(plant, z, 0)
        lead = np.broadcast_shapes(y.shape[:-1], z.shape[:-1])
        rows = _Rows.empty(scheme, plant, lead, steps, record, disturbed, applied_known)
        parts = _stepwise(scheme, plant, np.broadcast_to(z, (*rows.lead, plant.n)), y, rows, sensor, actuator, load)
    done = 0
    try:
        for done in parts:
            if progress is not None:
                progress(rows.trace(done))
    except DivergedError as error:
        raise DivergedError(error.k, error.what, rows.trace(error.k) if error.k else None) from error
    return rows.trace(done)


@dataclass(frozen=True, eq=False)
class _Rows:
    """The record of a run, row by row; members of the batch lie along the second axis."""

    scheme: Scheme
    lead: tuple[int, ...]
    y: Array
    v: Array
    z: Array
    computed: Array | None
    estimate: Array
    model: Array
    lam: Array
    stage: np.ndarray | None
    diverged_at: np.ndarray
    applied_known: bool

    @classmethod
    def empty(
        cls,
        scheme: Scheme,
        plant: Plant,
        lead: tuple[int, ...],
        steps: int,
        record: Record | None,
        disturbed: bool,
        applied_known: bool,
    ) -> _Rows:
        """Make room for a run."""
        start, n, q = scheme.initial_model, scheme.initial_model.n, scheme.initial_model.q
        lead = np.broadcast_shapes(lead, start.A.shape[:-2], *(factor.shape[:-2] for factor in scheme.factors))
        members = prod(lead)
        kept = steps if record == "models" or (record is None and not lead) else 0
        try:
            return cls(
                scheme,
                lead,
                np.empty((steps, members, scheme.p)),
                np.empty((steps, members, scheme.q)),
                np.empty((steps, members, plant.n)),
                np.empty((steps, members, scheme.q)) if disturbed else None,
                np.zeros((kept, members, n, n + q)),
                np.zeros((kept, members, n, n + q)),
                np.zeros((kept, members)),
                np.zeros((kept, members), dtype=np.int64) if scheme.controller.adaptive else None,
                np.full(members, -1),
                applied_known,
            )
        # Too many bytes for the memory, or for any address.
        except (MemoryError, ValueError, OverflowError) as error:
            raise InputError(
                f"steps must be such that the signals of all steps fit into memory, got {steps} for a batch "
                f"of {members} ({reason(error)}); run fewer steps"
            ) from error

    @property
    def keeps_models(self) -> bool:
        """Whether estimates are recorded."""
        return len(self.model) > 0

    def freeze(self, first: int, stop: int) -> None:
        """Repeat the last rows of members that have diverged."""
        for member in np.flatnonzero((self.diverged_at >= 0) & (self.diverged_at < stop)):
            k = max(first, self.diverged_at[member])
            for rows in (self.y, self.v, self.z, self.computed):
                if rows is not None:
                    rows[k:stop, member] = rows[k - 1, member] if k else 0.0

    def checked(self, found: ArrayLike, k: int, instead: Array) -> Array:
        """Return a signal with ``instead`` for members that are not finite, which have diverged."""
        signal = np.asarray(found, dtype=np.float64)
        fine = np.all(np.isfinite(signal), axis=-1) & (self.diverged_at < 0).reshape(self.lead)
        self.diverged_at[(~fine).reshape(-1) & (self.diverged_at < 0)] = k
        return signal if np.all(fine) else np.where(fine[..., None], signal, instead)

    def trace(self, count: int) -> Trace:
        """Return the first rows as a trace, without copying them."""

        def shaped(rows: np.ndarray) -> np.ndarray:
            return rows[:count].reshape(min(count, len(rows)), *self.lead, *rows.shape[2:])

        models = None
        if self.keeps_models:
            stage = None if self.stage is None else shaped(self.stage)
            models = Models(shaped(self.estimate), shaped(self.model), shaped(self.lam), stage)
        diverged = np.where(self.diverged_at < count, self.diverged_at, -1).reshape(self.lead)
        computed = None if self.computed is None else shaped(self.computed)
        y, v, z = shaped(self.y), shaped(self.v), shaped(self.z)
        return Trace(self.scheme, y, v, z, computed, self.applied_known, models, diverged)


def _compiled(scheme: Scheme, plant: LinearPlant, z: Array, rows: _Rows) -> Iterator[int]:
    """Run a linear plant in the compiled loop; yield how many rows are done."""
    blocks = _engine.begin(scheme, rows.lead, (plant.F, plant.G, plant.H), z)
    rows.lam[:] = blocks[0].estimator[2]
    for first in range(0, len(rows.y), _PART):
        stop = min(first + _PART, len(rows.y))
        epsilon = epsilons(scheme.controller.epsilon, first, stop)
        for block in blocks:
            at = slice(first, stop), block.members
            signals, models = _engine.run(block, first, epsilon, None, rows.keeps_models)
            for kept, found in zip((rows.y, rows.v, rows.z), signals, strict=True):
                kept[at] = np.moveaxis(found, -1, 1)
            if rows.keeps_models:
                rows.estimate[at], rows.model[at] = (np.moveaxis(found, -1, 1) for found in models)
            rows.diverged_at[block.members] = block.diverged_at
        if not rows.lead and 0 <= rows.diverged_at[0] <= stop:
            yield from _diverged(scheme, plant, rows)
        rows.freeze(first, stop)
        yield stop


def _diverged(scheme: Scheme, plant: Plant, rows: _Rows) -> Iterator[int]:
    """Yield the rows before a single run left the range of float64, then repeat that step to raise its error."""
    k = int(rows.diverged_at[0])
    if k:
        yield k
    if k < len(rows.y):
        if k and not np.all(np.isfinite(moved(plant, rows.z[k - 1, 0], rows.v[k - 1, 0]))):
            raise DivergedError(k, "the plant's state is no longer finite")
        _taken_again(scheme, rows, k, output(plant, rows.z[k, 0], k))


def _taken_again(scheme: Scheme, rows: _Rows, k: int, y: Array) -> None:
    """Repeat the step at which a single run left the range of float64; it raises the error that names the number."""
    step(scheme, advance(scheme, rows.trace(k).steps[-1]) if k else start(scheme), y)
    raise DivergedError(k, "the input is no longer finite")


def _stepwise(
    scheme: Scheme,
    plant: Plant,
    z: Array,
    y: Array,
    rows: _Rows,
    sensor: Disturbances | None,
    actuator: Disturbances | None,
    load: Disturbances | None,
) -> Iterator[int]:
    """Run any scheme on any plant, step by step; yield how many rows are done."""
    controller = (_Compiled if _engine.serves(scheme) else _General)(scheme, rows)
    for k in range(len(rows.y)):
        if k:
            y = output(plant, z, k) if not rows.lead else rows.checked(measured(plant, z), k, np.zeros(scheme.p))
        seen = through("sensor", sensor, k, np.broadcast_to(y, (*rows.lead, scheme.p)))
        computed = controller.step(k, seen.reshape(-1, scheme.p)).reshape(*rows.lead, scheme.q)
        computed.flags.writeable = False
        applied = through("actuator", actuator, k, computed)
        for kept, found in ((rows.y, seen), (rows.v, applied), (rows.z, z), (rows.computed, computed)):
            if kept is not None:
                kept[k] = np.reshape(found, kept.shape[1:])
        rows.freeze(k, k + 1)
        yield k + 1
        if k + 1 == len(rows.y):
            return
        after = moved(plant, z, through("load", load, k, applied))
        if not rows.lead and not np.all(np.isfinite(after)):
            raise DivergedError(k + 1, "the plant's state is no longer finite")
        z = rows.checked(after, k + 1, z)
        controller.remember((applied if rows.applied_known else computed).reshape(-1, scheme.q))


class _Compiled:
    """The scheme's steps in the compiled loop, for the caller's own plant."""

    def __init__(self, scheme: Scheme, rows: _Rows) -> None:
        self.scheme, self.rows = scheme, rows
        self.blocks = _engine.begin(scheme, rows.lead, None, np.empty(0))
        self.history = np.zeros((len(rows.diverged_at), scheme.lifting.outputs, scheme.p))
        rows.lam[:] = self.blocks[0].estimator[2]

    def step(self, k: int, y: Array) -> Array:
        rows, lifting = self.rows, self.scheme.lifting
        self.history = remember(self.history, y)
        with np.errstate(over="ignore", invalid="ignore"):
            x = lifting.lift(self.history, 1)[:, 0]
        epsilon, v = epsilons(self.scheme.controller.epsilon, k, k + 1), np.empty((len(y), self.scheme.q))
        for block in self.blocks:
            at, lifted = block.members, np.ascontiguousarray(x[block.members].T)[None]
            block.diverged_at[:] = rows.diverged_at[at]
            (_, found, _), models = _engine.run(block, k, epsilon, lifted, rows.keeps_models)
            v[at] = found[0].T
            if rows.keeps_models:
                rows.estimate[k, at], rows.model[k, at] = (np.moveaxis(found[0], -1, 0) for found in models)
            rows.diverged_at[at] = block.diverged_at
        if not rows.lead and rows.diverged_at[0] >= 0:
            _taken_again(self.scheme, rows, k, y[0])
        v[rows.diverged_at >= 0] = 0.0
        return v

    def remember(self, v: Array) -> None:
        for block in self.blocks:
            block.state[2][:] = v[block.members].T


class _General:
    """The steps of any scheme, for the members of a batch that have not diverged."""

    def __init__(self, scheme: Scheme, rows: _Rows) -> None:
        self.scheme, self.rows = scheme, rows
        begun, members = start(scheme), len(rows.diverged_at)
        model = scheme.initial_model
        A, B = (np.broadcast_to(M, (*rows.lead, *M.shape[-2:])).reshape(-1, *M.shape[-2:]) for M in (model.A, model.B))
        y, v = (np.broadcast_to(past, (members, *past.shape)) for past in (begun.y, begun.v))
        size, data = (
            None if of is None else np.broadcast_to(of, (members, *of.shape)) for of in (begun.size, begun.data)
        )
        self.active = np.arange(members)
        self.state = ControllerState(0, y, v, SignalModel(A, B), size=size, data=data)
        self.done: Step | None = None

    def step(self, k: int, y: Array) -> Array:
        rows = self.rows
        self._keep(rows.diverged_at[self.active] < 0)
        if len(self.active) == 0:
            return np.zeros((len(y), self.scheme.q))
        try:
            done = step(self.scheme, self.state, y[self.active])
        except DivergedError:
            if not rows.lead:
                raise
            lost = [self._diverges(i, y) for i in range(len(self.active))]
            rows.diverged_at[self.active[lost]] = k
            self._keep(~np.array(lost))
            if len(self.active) == 0:
                return np.zeros((len(y), self.scheme.q))
            done = step(self.scheme, self.state, y[self.active])
        self.done, v = done, np.zeros((len(y), self.scheme.q))
        v[self.active] = done.v_computed
        if rows.keeps_models:
            for kept, found in ((rows.estimate, done.estimate), (rows.model, done.model)):
                kept[k, self.active] = np.concatenate([found.A, found.B], axis=-1)
            rows.lam[k, self.active] = done.lam
            if rows.stage is not None:
                rows.stage[k, self.active] = done.stage
        return v

    def remember(self, v: Array) -> None:
        if len(self.active) == 0:
            return
        assert self.done is not None
        self.state = advance(self.scheme, self.done, v[self.active])

    def _diverges(self, i: int, y: Array) -> bool:
        try:
            step(self.scheme, _members(self.state, np.array([i])), y[self.active[[i]]])
        except DivergedError:
            return True
        return False

    def _keep(self, those: np.ndarray) -> None:
        if not np.all(those):
            self.active, self.state = self.active[those], _members(self.state, np.flatnonzero(those))


def _members(state: ControllerState, which: np.ndarray) -> ControllerState:
    model = SignalModel(state.model.A[which], state.model.B[which])
    stage, value, size, data = (
        None if of is None else of[which] for of in (state.stage, state.value, state.size, state.data)
    )
    return ControllerState(state.k, state.y[which], state.v[which], model, stage, value, size, data)
