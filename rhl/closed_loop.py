"""The overall scheme (figure 1): lift, estimate, mix, augment, solve, apply the first input, repeat."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from rhl._checks import Array, describe, instance, real_array
from rhl.disturbances import Disturbances, through
from rhl.errors import DivergedError, InputError, NotFiniteError
from rhl.horizon import V1, Plan, solve
from rhl.lifting import remember
from rhl.model import SignalModel
from rhl.plants.base import Plant, check_plant
from rhl.scheme import Scheme


@dataclass(frozen=True, eq=False)
class ControllerState:
    """What the scheme carries from one step to the next.

    Attributes
    ----------
    k : int
        The step about to be taken.
    y : array, shape (..., T, p)
        y(k-1), y(k-2), ...; zero before k = 0.
    v : array, shape (..., T, q)
        v(k-1), v(k-2), ...; zero before k = 0.
    model : SignalModel
        theta~(k-1).
    y_hat : array, shape (..., p), or None
        The prediction of y(k) made at k-1.
    stage : array of int, shape (...), or None
        The stage j(k-1) of an adaptive terminal weight.
    value : array, shape (...), or None
        V1 at k-1, where the weight is adaptive.
    """

    k: int
    y: Array
    v: Array
    model: SignalModel
    y_hat: Array | None = None
    stage: np.ndarray | None = None
    value: Array | None = None

    def __post_init__(self) -> None:
        _freeze(self, "y", "v", "y_hat", "value")
        _freeze(self, "stage", kind=np.int64)


@dataclass(frozen=True, eq=False)
class Step:
    """Everything that happened at one k.

    Attributes
    ----------
    k : int
        The step.
    y : array, shape (..., p)
        Output measured.
    v : array, shape (..., q)
        Input applied: the one computed, ``plan.u[..., 0, :]``, unless an actuator changed it.
    y_hat : array, shape (..., p)
        Prediction of y(k) made at k-1; y(0) at k = 0.
    estimate : SignalModel
        theta*(k), the minimiser of equation (15).
    model : SignalModel
        theta~(k), after mixing.
    lam : array, shape (...)
        lambda_k.
    problem : V1
        What was solved at k.
    plan : Plan
        Its solution; ``plan.x[..., 0, :]`` is the augmented state X(k).
    memory : ControllerState
        What the step started from, y(k) included.
    stage : array of int, shape (...)
        What epsilon was taken at: k, or the stage j(k) of an adaptive weight.
    z : array, shape (..., n), or None
        The plant's state z(k), where there is a plant.
    """

    k: int
    y: Array
    v: Array
    y_hat: Array
    estimate: SignalModel
    model: SignalModel
    lam: Array
    problem: V1
    plan: Plan
    memory: ControllerState
    stage: np.ndarray
    z: Array | None = None

    def __post_init__(self) -> None:
        _freeze(self, "y", "v", "y_hat", "lam", "z")
        _freeze(self, "stage", kind=np.int64)


def _freeze(record: ControllerState | Step, *names: str, kind: type = np.float64) -> None:
    for name in names:
        if getattr(record, name) is not None:
            copy: np.ndarray = np.array(getattr(record, name), dtype=kind)
            copy.flags.writeable = False
            object.__setattr__(record, name, copy)


def start(scheme: Scheme) -> ControllerState:
    """Return the memory before k = 0: all signals zero, the initial model."""
    instance("scheme", scheme, Scheme)
    depth = scheme.estimator.window + 1 + max(scheme.lifting.outputs, scheme.lifting.inputs)
    return ControllerState(0, np.zeros((depth, scheme.p)), np.zeros((depth, scheme.q)), scheme.initial_model)


def step(scheme: Scheme, memory: ControllerState, y: ArrayLike) -> Step:
    """Take one step of the scheme: from y(k) to v(k).

    Parameters
    ----------
    scheme : Scheme
        What was chosen beforehand.
    memory : ControllerState
        What the step before left, from ``start`` or ``advance``.
    y : array_like, shape (..., p)
        The output measured at k.

    Returns
    -------
    Step

    Raises
    ------
    DivergedError
        If a number leaves the range of float64.
    LostControllabilityError
        If the lambda-search finds no candidate.
    NotSolvedError
        If the estimator's problem is not quadratic and its answer misses the certificate.
    InputError
        If y has another size, or a function of the user's own misbehaves.
    """
    instance("scheme", scheme, Scheme)
    instance("memory", memory, ControllerState)
    y = real_array("y", y, (scheme.p,))
    try:
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            return _step(scheme, memory, y)
    except (NotFiniteError, np.linalg.LinAlgError) as error:
        raise DivergedError(memory.k, str(error)) from error


def _step(scheme: Scheme, memory: ControllerState, y: Array) -> Step:
    lifting, estimator, controller = scheme.lifting, scheme.estimator, scheme.controller
    lead = np.broadcast_shapes(y.shape[:-1], memory.y.shape[:-2], memory.v.shape[:-2])
    y_history = remember(
        np.broadcast_to(memory.y, (*lead, *memory.y.shape[-2:])), np.broadcast_to(y, (*lead, scheme.p))
    )
    v_history = np.broadcast_to(memory.v, (*lead, *memory.v.shape[-2:]))
    x = lifting.lift(y_history, estimator.window + 1)
    u = lifting.window(v_history, lifting.inputs, estimator.window)
    estimate = estimator.minimise(memory.model, x, u, memory.k)
    lam = scheme.mixing.choose(estimate, memory.model, lifting.augment)
    model = estimate.mix(memory.model, lam)
    used = memory.model if controller.model_delay else model
    state = lifting.augmented_state(y_history, v_history)
    stage = np.full(lead, memory.k) if memory.stage is None else memory.stage
    problem = controller.problem(lifting.augment(used), state, stage)
    plan = solve(problem, state)
    if controller.adaptive and memory.value is not None:
        value = plan.value
        stuck = (value >= memory.value) & (value > 0)
        if np.any(stuck):
            stage = stage + stuck
            problem = controller.problem(lifting.augment(used), state, stage)
            plan = solve(problem, state)
    v = real_array("v", plan.u[..., 0, :])
    y_hat = y if memory.y_hat is None else memory.y_hat
    seen = ControllerState(memory.k, y_history, v_history, memory.model, memory.y_hat)
    return Step(memory.k, y, v, y_hat, estimate, model, lam, problem, plan, seen, stage)


def advance(scheme: Scheme, done: Step, v: ArrayLike | None = None) -> ControllerState:
    """Return the memory for k+1, given the input that was really applied at k.

    Parameters
    ----------
    scheme : Scheme
        What was chosen beforehand.
    done : Step
        The step at k.
    v : array_like, shape (..., q), optional
        The input that the scheme takes for the applied one; ``done.v`` where omitted.

    Returns
    -------
    ControllerState
    """
    instance("scheme", scheme, Scheme)
    instance("done", done, Step)
    applied = done.v if v is None else real_array("v", v, (scheme.q,))
    if applied.ndim > done.v.ndim:
        raise InputError(f"v must have the batch axes of the step, shape {done.v.shape}, got {applied.shape}")
    v_history = remember(done.memory.v, np.broadcast_to(applied, (*done.memory.v.shape[:-2], scheme.q)))
    lifting = scheme.lifting
    x = lifting.lift(done.memory.y, 1)[..., 0, :]
    u = lifting.window(v_history, lifting.inputs, 1)[..., 0, :]
    with np.errstate(over="ignore", invalid="ignore"):
        predicted = np.einsum("...ab,...b->...a", done.model.A, x) + np.einsum("...ab,...b->...a", done.model.B, u)
    adaptive = scheme.controller.adaptive
    stage, value = (done.stage, done.plan.value) if adaptive else (None, None)
    return ControllerState(done.k + 1, done.memory.y, v_history, done.model, predicted[..., : scheme.p], stage, value)


def closed_loop(
    scheme: Scheme,
    plant: Plant,
    z0: ArrayLike,
    *,
    sensor: Disturbances | None = None,
    actuator: Disturbances | None = None,
    applied_known: bool = True,
) -> Iterator[Step]:
    """Run the scheme on a plant for as long as the caller asks for steps.

    Parameters
    ----------
    scheme : Scheme
        What was chosen beforehand.
    plant : Plant
        Unknown to the scheme but for the sizes of y and v.
    z0 : array_like, shape (..., n)
        Initial state z(0); leading axes run that many loops at once.
    sensor : callable or tuple of callables, optional
        (k, y) -> the output as it is measured, see ``rhl.disturbances``; those of a tuple are applied in order.
    actuator : callable or tuple of callables, optional
        (k, v) -> the input as it is applied.
    applied_known : bool
        Whether the scheme remembers the input that was applied (as whoever knows the actuator can), or the one that it
        computed.

    Yields
    ------
    Step
        One for each k = 0, 1, ...

    Raises
    ------
    InputError
        If z0 does not fit the plant, the plant's sizes do not fit the scheme, or a disturbance misbehaves.
    DivergedError
        If a number leaves the range of float64.
    """
    instance("scheme", scheme, Scheme)
    check_plant(plant)
    if not isinstance(applied_known, bool):
        raise InputError(f"applied_known must be True or False, got {describe(applied_known)}")
    z = real_array("z0", z0, (plant.n,))
    for name, found, wanted in (("outputs", plant.p, scheme.p), ("inputs", plant.q, scheme.q)):
        if found != wanted:
            raise InputError(f"the plant must have {wanted} {name}, for which the initial model is made, got {found}")
    # One step without input shows the batch axes that the plant itself brings.
    with np.errstate(over="ignore", invalid="ignore"):
        z = np.broadcast_to(z, np.shape(plant.step(z, np.zeros(plant.q))))
    return _run(scheme, plant, z, sensor, actuator, applied_known)


def _run(
    scheme: Scheme,
    plant: Plant,
    z: Array,
    sensor: Disturbances | None,
    actuator: Disturbances | None,
    applied_known: bool,
) -> Iterator[Step]:
    memory = start(scheme)
    while True:
        y = np.asarray(plant.output(z), dtype=np.float64)
        if not np.all(np.isfinite(y)):
            raise DivergedError(memory.k, "the plant's output is no longer finite")
        computed = step(scheme, memory, through("sensor", sensor, memory.k, y))
        done = replace(computed, z=z, v=through("actuator", actuator, memory.k, computed.v))
        yield done
        with np.errstate(over="ignore", invalid="ignore"):
            moved = np.asarray(plant.step(z, done.v), dtype=np.float64)
        if moved.shape != z.shape:
            raise InputError(f"the plant's step must return a state of shape {z.shape}, got {moved.shape}")
        if not np.all(np.isfinite(moved)):
            raise DivergedError(done.k + 1, "the plant's state is no longer finite")
        z, memory = moved, advance(scheme, done, done.v if applied_known else computed.v)


def replay(scheme: Scheme, y: ArrayLike, v: ArrayLike) -> Iterator[Step]:
    """Feed recorded outputs and inputs to the scheme; each step tells what it would have done.

    Parameters
    ----------
    scheme : Scheme
        What was chosen beforehand.
    y : array_like, shape (steps, p)
        Recorded outputs y(0), y(1), ...
    v : array_like, shape (steps, q)
        Recorded inputs, which are taken as applied, whatever the scheme computes.

    Yields
    ------
    Step
        ``v`` is what the scheme computes from the record up to k.
    """
    instance("scheme", scheme, Scheme)
    y, v = real_array("y", y, (None, scheme.p)), real_array("v", v, (None, scheme.q))
    if len(y) != len(v):
        raise InputError(f"y and v must have as many rows as each other, got {len(y)} and {len(v)}")
    memory = start(scheme)
    for output, applied in zip(y, v, strict=True):
        done = step(scheme, memory, output)
        yield done
        memory = advance(scheme, done, applied)
