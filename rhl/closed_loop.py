"""The overall scheme (figure 1): lift, estimate, mix, augment, solve, apply the first input, repeat."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from rhl._checks import Array, common_batch, describe, instance, numbers, real_array
from rhl.controllability import chosen
from rhl.disturbances import Disturbances, through
from rhl.errors import DivergedError, InputError, NotFiniteError
from rhl.horizon import first_input, solve
from rhl.lifting import remember
from rhl.memory import GrowingMemory
from rhl.model import SignalModel
from rhl.plants.base import Plant, check_plant
from rhl.plants.linear import LinearPlant
from rhl.scheme import Scheme
from rhl.state import ControllerState, Step, centre_of, sizes_of
from rhl.tracking import seen


def start(scheme: Scheme) -> ControllerState:
    """Return the state before k = 0: all signals zero, the initial model.

    Examples
    --------
    >>> from rhl.scheme import default_scheme
    >>> state = start(default_scheme(p=1, q=1, order=2))
    >>> state.k, state.y.shape, state.v.shape
    (0, (4, 1), (4, 1))
    """
    instance("scheme", scheme, Scheme)
    depth, model, estimator = scheme.depth, scheme.initial_model, scheme.estimator
    return ControllerState(
        0,
        np.zeros((depth, scheme.p)),
        np.zeros((depth, scheme.q)),
        model,
        size=None if scheme.units is None else np.zeros(scheme.p),
        data=estimator.begin(model.n, model.q) if isinstance(estimator, GrowingMemory) else None,
    )


def remembered(scheme: Scheme, state: ControllerState, x: Array, u: Array) -> Array:
    """Return the memory of ``GrowingMemory`` at k; it stays empty while zeros from before k = 0 are lifted.

    Examples
    --------
    >>> from rhl.scheme import default_scheme
    >>> scheme = default_scheme(1, 1, 2)
    >>> state = start(scheme)
    >>> remembered(scheme, state, np.ones((2, 2)), np.ones((1, 2))) is state.data
    True
    """
    estimator = scheme.estimator
    assert isinstance(estimator, GrowingMemory)
    assert state.data is not None
    if state.k < scheme.first_measured:
        return state.data
    return estimator.remember(state.data, x, u)


def proximal_centre(scheme: Scheme, previous: SignalModel) -> SignalModel:
    """Return the centre of the estimator's step: theta~(k-1), or the initial model if there is a family.

    Examples
    --------
    >>> from rhl.scheme import default_scheme
    >>> before = SignalModel([[0.5]], [[2.0]])
    >>> proximal_centre(default_scheme(1, 1, 1), before) is before
    True
    """
    return previous if scheme.family is None else scheme.initial_model


def _member(scheme: Scheme, state: ControllerState, estimate: SignalModel, data: Array) -> SignalModel:
    """Return the member of the family that is used at k, given the estimate from the initial model."""
    family, estimator, before = scheme.family, scheme.estimator, state.data
    assert family is not None
    assert isinstance(estimator, GrowingMemory)
    assert before is not None
    # The member used at k-1 follows from the memory at that step.
    earlier = estimator.minimise(scheme.initial_model, before)
    current = family.nearest(state.model, earlier, estimator.spread(before))
    current = np.broadcast_to(current, estimate.A.shape[:-2])
    return family.choose(current, estimate, estimator.spread(data), scheme.lifting.augment)


def step(scheme: Scheme, state: ControllerState, y: ArrayLike) -> Step:
    """Take one step of the scheme, from the measured y(k), shape (..., p), to v(k).

    Examples
    --------
    >>> from rhl.scheme import default_scheme
    >>> scheme = default_scheme(p=1, q=1, order=2)
    >>> done = step(scheme, start(scheme), [0.5])
    >>> done.k, done.v_computed.shape, advance(scheme, done).k
    (0, (1,), 1)

    The state is from ``start`` or ``advance``. InputError if y has another size, or a user's function returns
    an invalid value.

    Raises
    ------
    DivergedError
        If a number leaves the range of float64.
    LostControllabilityError
        If the lambda-search finds no candidate.
    NotSolvedError
        If the estimator's problem is not quadratic and its answer misses the certificate.
    """
    instance("scheme", scheme, Scheme)
    instance("state", state, ControllerState)
    y = real_array("y", y, (scheme.p,))
    try:
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            return _step(scheme, state, y)
    except (NotFiniteError, np.linalg.LinAlgError) as error:
        raise DivergedError(state.k, str(error)) from error


def _step(scheme: Scheme, state: ControllerState, y: Array) -> Step:
    lifting, estimator, controller = scheme.lifting, scheme.estimator, scheme.controller
    lead = np.broadcast_shapes(y.shape[:-1], state.y.shape[:-2], state.v.shape[:-2])
    y_history = remember(state.y, np.broadcast_to(y, (*lead, scheme.p)))
    applied = np.broadcast_to(state.v, (*lead, *state.v.shape[-2:]))
    y_history, v_history = seen(scheme.set_point, state.k, y_history, applied)
    x = lifting.lift(y_history, estimator.window + 1)
    u = lifting.window(v_history, lifting.inputs, estimator.window)
    size = None if state.size is None else np.maximum(state.size, np.abs(y_history[..., 0, :]))
    centre, data = centre_of(scheme, state.k, state.model, state.size, size), state.data
    counted = None if scheme.units is None else scheme.units.parameters(lifting, cast(Array, size), scheme.q)
    if isinstance(estimator, GrowingMemory):
        data = remembered(scheme, state, x, u)
        estimate = estimator.minimise(proximal_centre(scheme, centre), data, counted)
    else:
        estimate = estimator.minimise(centre, x, u, state.k, counted)
    if estimate.A.shape[:-2] != lead:  # the memory is empty, so all members agree
        estimate = SignalModel(*(np.broadcast_to(M, (*lead, *M.shape[-2:])) for M in (estimate.A, estimate.B)))
    lam = chosen(scheme.mixing, estimate, centre, lifting.augment)
    model = estimate.mix(centre, lam) if scheme.family is None else _member(scheme, state, estimate, cast(Array, data))
    stage = np.full(lead, state.k) if state.stage is None else state.stage
    X = lifting.with_past_inputs(x[..., 0, :], v_history)
    lifted = centre if controller.model_delay else model
    used, sizes, factors, counts = lifting.augment(lifted), sizes_of(scheme, lifted, size, data), scheme.factors, X
    if sizes is not None:
        (of_x, of_v), (Q, R, QN) = sizes, factors
        factors = Q * of_x[..., None, :], R * of_v[..., None, :], QN * of_x[..., None, :]
        counts = of_x * X
    before = None if scheme.set_point is None else applied[..., 0, :]

    def planned(stage: np.ndarray) -> Array:
        if controller.bounds is not None:
            v = solve(controller.problem(used, X, stage, sizes, before), X).u[..., 0, :]
        else:
            weight = real_array("weight", controller.weight(counts, stage))
            v = first_input(used, factors, controller.horizon, weight, X)
        v = v if before is None else before + v
        # The solver keeps bounds up to its tolerance, an actuator exactly.
        return v if controller.bounds is None else controller.bounds(state.k, v)

    v = planned(stage)
    taken = Step(scheme, state, y, v, v, estimate, model, lam, stage, size=size, data=data)
    if controller.adaptive and state.value is not None:
        value = taken.plan.value
        stuck = (value >= state.value) & (value > 0)
        if np.any(stuck):
            v = planned(stage + stuck)
            taken = replace(taken, v_computed=v, v_applied=v, stage=stage + stuck)
    return taken


def advance(scheme: Scheme, done: Step, v: ArrayLike | None = None) -> ControllerState:
    """Return the state for k+1, given the step at k and the applied input, ``done.v_applied`` or v."""
    instance("scheme", scheme, Scheme)
    instance("done", done, Step)
    applied = done.v_applied if v is None else real_array("v", v, (scheme.q,))
    if applied.ndim > done.v_computed.ndim:
        raise InputError(f"v must have the batch axes of the step, shape {done.v_computed.shape}, got {applied.shape}")
    adaptive = scheme.controller.adaptive
    with np.errstate(over="ignore", invalid="ignore"):
        stage, value = (done.stage, done.plan.value) if adaptive else (None, None)
    y, u = remember(done.state.y, done.y), remember(done.state.v, np.broadcast_to(applied, done.v_computed.shape))
    return ControllerState(done.k + 1, y, u, done.model, stage, value, done.size, done.data)


def closed_loop(
    scheme: Scheme,
    plant: Plant,
    z0: ArrayLike,
    *,
    sensor: Disturbances | None = None,
    actuator: Disturbances | None = None,
    load: Disturbances | None = None,
    applied_known: bool = True,
) -> Iterator[Step]:
    """Run the scheme on a plant and yield a step for each k = 0, 1, ..., without end.

    ``rhl.simulate`` is faster for many steps.

    Examples
    --------
    >>> from itertools import islice
    >>> from rhl.plants import LinearPlant
    >>> from rhl.scheme import default_scheme
    >>> plant = LinearPlant(F=[[1.1, 1.0], [0.0, 0.9]], G=[[0.0], [1.0]], H=[[1.0, 0.0]])
    >>> steps = islice(closed_loop(default_scheme(p=1, q=1, order=2), plant, [1.0, -1.0]), 40)
    >>> [bool(abs(done.z[0]) < 1e-2) for done in steps][::39]
    [False, True]

    Parameters
    ----------
    scheme : Scheme
    plant : Plant
        Unknown to the scheme, except for the sizes of y and v.
    z0 : array_like, shape (..., n)
        Initial state z(0); leading axes run that many loops at once.
    sensor, actuator : callable or tuple of callables, optional
        (k, y) -> the measured output, and (k, v) -> the applied input, see ``rhl.disturbances``.
    load : callable or tuple of callables, optional
        (k, v) -> the input that reaches the plant, given the applied input; unknown to the scheme.
    applied_known : bool
        Whether the scheme records the applied input, which a known actuator permits, or the computed one.

    Raises
    ------
    InputError
        If z0 does not fit the plant, the plant does not fit the scheme, or a disturbance returns an invalid value.
    DivergedError
        If a number leaves the range of float64, in any member of a batch.
    """
    z = check_loop(scheme, plant, z0, applied_known)
    return _run(scheme, plant, z, sensor, actuator, load, applied_known)


def check_loop(scheme: Scheme, plant: Plant, z0: ArrayLike, applied_known: bool) -> Array:
    """Check the parts of a loop; return z(0) with the batch axes of a linear plant.

    Examples
    --------
    >>> from rhl.scheme import default_scheme
    >>> plant = LinearPlant([[[1.1]], [[1.2]]], [[1.0]], [[1.0]])
    >>> check_loop(default_scheme(1, 1, 1), plant, [1.0], True).shape
    (2, 1)
    """
    instance("scheme", scheme, Scheme)
    check_plant(plant)
    if not isinstance(applied_known, bool):
        raise InputError(f"applied_known must be True or False, got {describe(applied_known)}")
    z = real_array("z0", z0, (plant.n,))
    for name, found, wanted in (("outputs", plant.p, scheme.p), ("inputs", plant.q, scheme.q)):
        if found != wanted:
            raise InputError(f"the plant must have {wanted} {name}, for which the initial model is made, got {found}")
    z = np.broadcast_to(z, (*plant.batch(z), plant.n)) if isinstance(plant, LinearPlant) else z
    z = np.broadcast_to(z, (*common_batch(z0=(z, 1), initial_model=(scheme.initial_model.A, 2)), plant.n))
    if z.size == 0:
        raise InputError(f"z0 must hold at least one member of the batch, got shape {z.shape}")
    return z


def output(plant: Plant, z: Array, k: int) -> Array:
    """Return the plant's output, which must be finite; DivergedError if it is not."""
    y = measured(plant, z)
    if not np.all(np.isfinite(y)):
        raise DivergedError(k, "the plant's output is no longer finite")
    return y


def measured(plant: Plant, z: Array) -> Array:
    """Return the plant's output, finite or not; InputError if it is not p real numbers."""
    y = _real("output", plant.output(z))
    if y.shape[-1:] != (plant.p,) or y.ndim < z.ndim:
        raise InputError(f"the plant's output must have shape (..., {plant.p}) for states {z.shape}, got {y.shape}")
    return y


def moved(plant: Plant, z: Array, v: Array) -> Array:
    """Return the plant's next state, finite or not; InputError if its shape is not that of the state."""
    with np.errstate(over="ignore", invalid="ignore"):
        after = _real("step", plant.step(z, v))
    if after.shape != z.shape:
        raise InputError(f"the plant's step must return a state of shape {z.shape}, as z0 has, got {after.shape}")
    return after


def _real(name: str, found: object) -> Array:
    try:
        return numbers(found)
    except (TypeError, ValueError):
        raise InputError(f"the plant's {name} must return real numbers, got {describe(found)}") from None


def _run(
    scheme: Scheme,
    plant: Plant,
    z: Array,
    sensor: Disturbances | None,
    actuator: Disturbances | None,
    load: Disturbances | None,
    applied_known: bool,
) -> Iterator[Step]:
    state = start(scheme)
    while True:
        computed = step(scheme, state, through("sensor", sensor, state.k, output(plant, z, state.k)))
        done = replace(computed, z=z, v_applied=through("actuator", actuator, state.k, computed.v_computed))
        yield done
        z = moved(plant, z, through("load", load, state.k, done.v_applied))
        if not np.all(np.isfinite(z)):
            raise DivergedError(done.k + 1, "the plant's state is no longer finite")
        state = advance(scheme, done, done.v_applied if applied_known else done.v_computed)


def replay(scheme: Scheme, y: ArrayLike, v: ArrayLike) -> Iterator[Step]:
    """Feed recorded y, shape (steps, ..., p), and v, shape (steps, ..., q), to the scheme; yield its steps.

    The recorded inputs count as applied. In each step, ``v_computed`` is the scheme's input for the record up to k,
    and ``v_applied`` is the recorded input.
    """
    instance("scheme", scheme, Scheme)
    y, v = real_array("y", y, (None, scheme.p)), real_array("v", v, (None, scheme.q))
    if y.shape[:-1] != v.shape[:-1]:
        raise InputError(f"y and v must have the same number of rows, got {len(y)} and {len(v)}")
    state = start(scheme)
    for measured, applied in zip(y, v, strict=True):
        done = replace(step(scheme, state, measured), v_applied=applied)
        yield done
        state = advance(scheme, done)
