"""What the scheme keeps from one step to the next, the record of a step, and the estimates of many."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import cast

import numpy as np

from rhl._checks import Array, locked
from rhl.horizon import Plan, solve
from rhl.lifting import remember
from rhl.memory import GrowingMemory
from rhl.model import SignalModel
from rhl.problems import V1
from rhl.scheme import Scheme
from rhl.tracking import seen

# A first output that is this much smaller than the next was small by chance, and is not used as a scale.
_CHANCE = 1e-3


@dataclass(frozen=True, eq=False)
class ControllerState:
    """The state of the scheme between two steps, made by ``start`` and ``advance``.

    Attributes
    ----------
    k : int
        The next step.
    y, v : array, shapes (..., T, p) and (..., T, q)
        y(k-1), y(k-2), ... and v(k-1), v(k-2), ..., as applied; zero before k = 0.
    model : SignalModel
        theta~(k-1).
    stage : array of int, shape (...), or None
        The stage j(k-1) of an adaptive terminal weight.
    value : array, shape (...), or None
        V1 at k-1, where the weight is adaptive.
    size : array, shape (..., p), or None
        The largest absolute value of each output, or of its distance from a set point, before k, with running units.
    data : array, shape (..., n + N_v q, 2 n + N_v q), or None
        The memory of ``GrowingMemory`` before k.

    Examples
    --------
    >>> from rhl.closed_loop import advance, start, step
    >>> from rhl.scheme import window_scheme
    >>> scheme = window_scheme(p=1, q=1, order=2)
    >>> state = advance(scheme, step(scheme, start(scheme), [0.5]), [0.25])
    >>> state.k, state.y[0], state.v[0]
    (1, array([0.5]), array([0.25]))
    """

    k: int
    y: Array
    v: Array
    model: SignalModel
    stage: np.ndarray | None = None
    value: Array | None = None
    size: Array | None = None
    data: Array | None = None

    def __post_init__(self) -> None:
        _freeze(self, "y", "v", "value", "size", "data")
        _freeze(self, "stage", kind=np.int64)


@dataclass(frozen=True, eq=False)
class Step:
    """Everything that happened at one k, made by ``step``.

    Attributes
    ----------
    scheme : Scheme
        The scheme.
    state : ControllerState
        The state before the step; ``step(scheme, state, y)`` repeats it.
    y : array, shape (..., p)
        Measured output.
    v_computed : array, shape (..., q)
        Computed input, ``plan.u[..., 0, :]``; with a set point that is its increment.
    v_applied : array, shape (..., q)
        Applied input: the computed one, unless an actuator changed it.
    estimate : SignalModel
        theta*(k), the minimiser of equation (15).
    model : SignalModel
        theta~(k), after mixing.
    lam : array, shape (...)
        lambda_k.
    stage : array of int, shape (...)
        The argument of epsilon: k, or the stage j(k) of an adaptive weight.
    z : array, shape (..., n), or None
        The plant's state z(k), if there is a plant.
    size, data : array or None
        Those of ``ControllerState`` with y(k) and the transition to k.

    Examples
    --------
    >>> from rhl.closed_loop import start, step
    >>> from rhl.scheme import window_scheme
    >>> scheme = window_scheme(p=1, q=1, order=2)
    >>> done = step(scheme, start(scheme), [0.5])
    >>> done.plan.u.shape, bool(done.plan.u[0] == done.v_computed)
    ((30, 1), True)
    """

    scheme: Scheme
    state: ControllerState
    y: Array
    v_computed: Array
    v_applied: Array
    estimate: SignalModel
    model: SignalModel
    lam: Array
    stage: np.ndarray
    z: Array | None = None
    size: Array | None = None
    data: Array | None = None

    def __post_init__(self) -> None:
        _freeze(self, "y", "v_computed", "v_applied", "lam", "z", "size", "data")
        _freeze(self, "stage", kind=np.int64)

    @property
    def k(self) -> int:
        """The step."""
        return self.state.k

    @cached_property
    def y_hat(self) -> Array:
        """The prediction of y(k) made at k-1: the first entries of A x(k-1) + B u(k-1); y(0) at k = 0."""
        if self.k == 0:
            return self.y
        scheme, lifting, state = self.scheme, self.scheme.lifting, self.state
        y, v = seen(scheme.set_point, self.k - 1, state.y, state.v)
        x, u = lifting.lift(y, 1)[..., 0, :], lifting.window(v, lifting.inputs, 1)[..., 0, :]
        with np.errstate(over="ignore", invalid="ignore"):
            predicted = state.model.step(x, u)[..., : scheme.p]
            if scheme.set_point is not None:
                predicted = predicted + scheme.set_point.at(self.k - 1, scheme.p)
        return locked(predicted)

    @property
    def used(self) -> SignalModel:
        """The model that the controller used: theta~(k), or theta~(k-1) with model_delay = 1."""
        return self.centre if self.scheme.controller.model_delay else self.model

    @property
    def centre(self) -> SignalModel:
        """The proximal centre theta~(k-1); the initial model at k = 0 and where an output is first nonzero."""
        return centre_of(self.scheme, self.k, self.state.model, self.state.size, self.size)

    @property
    def _sizes(self) -> tuple[Array, Array] | None:
        return sizes_of(self.scheme, self.used, self.size, self.data)

    @cached_property
    def problem(self) -> V1:
        """The problem solved at k, equation (3) for the augmented model."""
        scheme = self.scheme
        before = None if scheme.set_point is None else self.state.v[..., 0, :]
        model = scheme.lifting.augment(self.used)
        return scheme.controller.problem(model, self._augmented_state, self.stage, self._sizes, before)

    @property
    def _augmented_state(self) -> Array:
        y, v = seen(self.scheme.set_point, self.k, remember(self.state.y, self.y), self.state.v)
        return self.scheme.lifting.augmented_state(y, v)

    @cached_property
    def plan(self) -> Plan:
        """The solution of that problem, computed on access; ``plan.x[..., 0, :]`` is the augmented state X(k).

        With a set point, ``plan.u`` are increments of the input, and outputs in ``plan.x`` are distances from it.
        """
        return solve(self.problem, self._augmented_state)


@dataclass(frozen=True, eq=False)
class Models:
    """The estimates of a run: theta = [A B] with n rows, before and after mixing.

    Attributes
    ----------
    estimate, model : array, shape (steps, ..., n, n + q)
        theta*(k) and theta~(k).
    lam : array, shape (steps, ...)
        lambda_k.
    stage : array of int, shape (steps, ...), or None
        The stages j(k) of an adaptive terminal weight.

    Examples
    --------
    >>> from rhl.paper.published import linear_example
    >>> linear_example().run().models.model.shape  # [A B] has 4 rows and 8 columns
    (42, 4, 8)
    """

    estimate: Array
    model: Array
    lam: Array
    stage: np.ndarray | None = None

    def __post_init__(self) -> None:
        for name in ("estimate", "model", "lam", "stage"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, locked(getattr(self, name)))

    @classmethod
    def of_steps(cls, steps: Iterable[Step]) -> Models:
        """Collect the estimates of steps."""
        steps = tuple(steps)
        both = [[np.concatenate([of.A, of.B], axis=-1) for of in (done.estimate, done.model)] for done in steps]
        stage = np.stack([done.stage for done in steps]) if steps[0].scheme.controller.adaptive else None
        estimate, model = np.stack(both, axis=1)
        return cls(estimate, model, np.stack([done.lam for done in steps]), stage)


def _freeze(record: ControllerState | Step, *names: str, kind: type = np.float64) -> None:
    for name in names:
        if getattr(record, name) is not None:
            copy: np.ndarray = np.array(getattr(record, name), dtype=kind)
            copy.flags.writeable = False
            object.__setattr__(record, name, copy)


def centre_of(scheme: Scheme, k: int, model: SignalModel, before: Array | None, size: Array | None) -> SignalModel:
    """Return the proximal centre at k: theta~(k-1), or the initial model scaled by the sizes at k.

    The latter applies if an output is nonzero for the first time and had no size before, or if its size was small by
    chance while the memory was empty. ``before`` and ``size``, shape (..., p), are the sizes before k and at k.

    Examples
    --------
    >>> from rhl.scheme import default_scheme
    >>> scheme = default_scheme(p=1, q=1, order=1)
    >>> model = SignalModel([[0.5]], [[2.0]])
    >>> centre_of(scheme, 5, model, np.array([3.0]), np.array([4.0])) is model
    True
    >>> centre_of(scheme, 5, model, np.array([0.0]), np.array([4.0])).B  # an input moves the output by its size
    array([[40.]])
    """
    units = scheme.units
    if units is None or size is None or not units.model_in_sizes:
        return model
    if k == 0:
        return units.initial(scheme.initial_model, scheme.lifting, size, scheme.q)
    least = _CHANCE if isinstance(scheme.estimator, GrowingMemory) and k < scheme.first_measured else 0.0
    fresh = (cast(Array, before) <= least * size) & (size > 0)
    if not np.any(fresh):
        return model
    begun = units.initial(scheme.initial_model, scheme.lifting, size, scheme.q)
    rows = np.tile(fresh, scheme.lifting.outputs)[..., None]
    return SignalModel(np.where(rows, begun.A, model.A), np.where(rows, begun.B, model.B))


def sizes_of(scheme: Scheme, used: SignalModel, size: Array | None, data: Array | None) -> tuple[Array, Array] | None:
    """Return ``RunningUnits.weights`` for the used model and the sizes at k, None without running units.

    Examples
    --------
    >>> from rhl.scheme import window_scheme
    >>> sizes_of(window_scheme(1, 1, 1), SignalModel([[0.5]], [[2.0]]), None, None) is None
    True
    """
    units, lifting, q = scheme.units, scheme.lifting, scheme.q
    if units is None:
        return None
    found, estimator, unknown = cast(Array, size), scheme.estimator, None
    if isinstance(estimator, GrowingMemory) and units.caution > 0:
        unknown = estimator.unknown(cast(Array, data), units.parameters(lifting, found, q))
    return units.weights(used, lifting, found, q, unknown)
