"""A recorded run: its signals, and quantities that are computed from them on access."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from rhl._checks import Array, describe, instance, integer, locked
from rhl._files import header, table_text, write_whole
from rhl.closed_loop import proximal_centre, replay
from rhl.controllability import controllability_margin, s_plus
from rhl.errors import InputError
from rhl.horizon import Plan
from rhl.memory import GrowingMemory
from rhl.model import SignalModel
from rhl.scheme import Scheme
from rhl.state import ControllerState, Models, Step, centre_of
from rhl.tracking import seen


@dataclass(frozen=True, eq=False)
class Trace:
    """A run as arrays whose first axis is k; those that are kept are read-only.

    Attributes
    ----------
    scheme : Scheme
        The scheme of the run.
    y, v : array, shapes (steps, ..., p) and (steps, ..., q)
        Outputs y(k) as measured, inputs v(k) as applied.
    plant_state : array, shape (steps, ..., n), or None
        The plant's states z(k), if there was a plant.
    computed : array, shape (steps, ..., q), or None
        The computed inputs ``v_computed``, if they differ from the applied ones.
    applied_known : bool
        Whether the scheme recorded the applied inputs, or the computed ones.
    models : Models or None
        The estimates, if recorded; otherwise the scheme replays the signals on access.
    diverged : array of int, shape (...), or None
        ``diverged_at``, unless it is -1 for all members.

    Examples
    --------
    >>> from rhl.paper.published import linear_example
    >>> trace = linear_example().run()
    >>> len(trace), trace.y.shape, trace.margin_augmented.shape
    (42, (42, 1), (42,))
    >>> bool(trace.plan(7).residual() < 1e-9)
    True
    >>> list(trace.columns())
    ['k', 'y1', 'v1', 'yhat1', 'z1', 'z2', 'z3', 'weight', 'lambda']
    """

    scheme: Scheme
    y: Array
    v: Array
    plant_state: Array | None = None
    computed: Array | None = None
    applied_known: bool = True
    models: Models | None = None
    diverged: np.ndarray | None = None

    def __post_init__(self) -> None:
        instance("scheme", self.scheme, Scheme)
        for name in ("y", "v"):
            rows: object = getattr(self, name)
            # Not copied, since a batch may fill the memory.
            if type(rows) is not np.ndarray or rows.dtype != np.float64 or rows.ndim < 2:
                raise InputError(
                    f"{name} must be an array of float64 of shape (steps, ..., size), got {describe(rows)}"
                )
            if not np.all(np.isfinite(rows)):
                raise InputError(f"{name} must be finite, got {rows[~np.isfinite(rows)][0]} among its entries")
        if len(self.y) == 0:
            raise InputError("a trace must have at least one step, got none")
        for name in ("y", "v", "plant_state", "computed", "diverged"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, locked(getattr(self, name)))

    @classmethod
    def of_steps(cls, scheme: Scheme, steps: Iterable[Step], applied_known: bool = True) -> Trace:
        """Collect the steps of ``closed_loop`` or ``replay`` from k = 0 on; InputError if there is none."""
        unknown: Any = steps
        given: tuple[Any, ...] = tuple(unknown) if isinstance(unknown, Iterable) else (unknown,)
        if not all(isinstance(done, Step) for done in given):
            raise InputError(f"steps must be a tuple of Step, got {describe(given)}")
        if not given:
            raise InputError("a trace must have at least one step, got none")
        signals = ("y", "v_applied", "v_computed")
        y, v, computed = (np.stack([getattr(done, name) for done in given]) for name in signals)
        z = None if given[0].z is None else np.stack([done.z for done in given])
        return cls(scheme, y, v, z, computed, applied_known, Models.of_steps(given))

    def __repr__(self) -> str:
        return f"Trace({len(self)} steps, y {self.y.shape}, v {self.v.shape}, diverged {np.sum(self.diverged_at >= 0)})"

    def __len__(self) -> int:
        return len(self.y)

    @property
    def k(self) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
        """Step numbers, shape (steps,)."""
        return np.arange(len(self))

    @property
    def v_computed(self) -> Array:
        """The computed inputs, shape (steps, ..., q)."""
        return self.v if self.computed is None else self.computed

    @property
    def error(self) -> Array:
        """The distance of outputs from the set point, y(k) - r(k), shape (steps, ..., p); y(k) without set point."""
        if self.set_point is None:
            return self.y
        return self.y - self.set_point.reshape(len(self), *[1] * (self.y.ndim - 2), -1)

    @property
    def diverged_at(self) -> np.ndarray:
        """The k at which a member of a batch left the range of float64, -1 where it did not, shape (...).

        From there on its rows repeat the one at k - 1.
        """
        return np.full(self.y.shape[1:-1], -1) if self.diverged is None else self.diverged

    @property
    def z(self) -> Array:
        """The plant's states z(k), shape (steps, ..., n)."""
        if self.plant_state is None:
            raise InputError("a trace of recorded data has no plant state; run the scheme on a plant to have one")
        return self.plant_state

    @cached_property
    def _models(self) -> Models:
        if self.models is not None:
            return self.models
        return Models.of_steps(replay(self.scheme, self.y, self._known))

    @property
    def _known(self) -> Array:
        return self.v if self.applied_known else self.v_computed

    def _history(self, signal: Array, depth: int, k: int) -> Array:
        """Return the signal at k-1, k-2, ..., k-depth, zero before k = 0, shape (..., depth, size)."""
        rows = np.zeros((depth, *signal.shape[1:]))
        found = signal[max(k - depth, 0) : k][::-1]
        rows[: len(found)] = found
        return np.moveaxis(rows, 0, -2)

    @cached_property
    def lifted(self) -> tuple[Array, Array]:
        """x(k) and u(k-1) for every k, shapes (steps, ..., n) and (steps, ..., N_v q)."""
        lifting, steps, v = self.scheme.lifting, len(self), self._known
        if self.scheme.set_point is not None:
            v = np.diff(v, axis=0, prepend=np.zeros_like(v[:1]))
        x = lifting.lift(self._history(self.y, steps + lifting.outputs, steps), steps)
        u = lifting.window(self._history(v, steps + lifting.inputs, steps), lifting.inputs, steps + 1)
        x, u = np.moveaxis(x, -2, 0)[::-1], np.moveaxis(u, -2, 0)[::-1][:-1]
        return locked(x if self.set_point is None else x - self._held(self.set_point)), locked(u)

    @cached_property
    def set_point(self) -> Array | None:
        """The set points r(k), shape (steps, p); None if the scheme has none."""
        found, p = self.scheme.set_point, self.scheme.p
        return None if found is None else locked(np.stack([found.at(k, p) for k in range(len(self))]))

    def _held(self, r: Array) -> Array:
        """Return r(k) as subtracted in x(k), with zeros for outputs before k = 0, which count as r."""
        outputs = self.scheme.lifting.outputs
        measured = np.arange(len(r))[:, None] >= np.arange(outputs)
        held = np.where(np.repeat(measured, r.shape[1], axis=1), np.tile(r, outputs), 0.0)
        return held.reshape(len(r), *[1] * (self.y.ndim - 2), -1)

    @cached_property
    def y_hat(self) -> Array:
        """Predictions of y(k) made at k-1 (y(0) at k = 0), shape (steps, ..., p)."""
        x, u = self.lifted
        models = self._pair(self._models.model[:-1])
        with np.errstate(over="ignore", invalid="ignore"):
            predicted = models.step(x[:-1], u[1:])[..., : self.scheme.p] if len(self) > 1 else self.y[1:]
            if self.set_point is not None:
                predicted = predicted + self.set_point[:-1].reshape(-1, *[1] * (self.y.ndim - 2), self.y.shape[-1])
        return locked(np.concatenate([self.y[:1], predicted]))

    @property
    def theta(self) -> Array:
        """Estimates theta~(k) = [vec(A); vec(B)], shape (steps, ..., n(n+q))."""
        model = self._models.model
        return model.swapaxes(-1, -2).reshape(*model.shape[:-2], -1)

    @property
    def lam(self) -> Array:
        """Mixing weights lambda_k, shape (steps, ...)."""
        return self._models.lam

    @cached_property
    def weight(self) -> Array:
        """The controller's Gamma(x)/eps(k), shape (steps, ...)."""
        x, u = self.lifted
        past = (self.scheme.lifting.inputs - 1) * self.scheme.q
        state = np.concatenate([x, u[..., :past]], axis=-1)
        stages = self._models.stage
        if stages is None:
            stages = np.broadcast_to(self.k.reshape(-1, *[1] * (self.y.ndim - 2)), self.y.shape[:-1])
        units, size = self.scheme.units, self._size
        if units is not None and size is not None:
            used = self._pair(self._models.model)
            if self.scheme.controller.model_delay:
                theta = np.stack([np.concatenate([of.A, of.B], axis=-1) for of in map(self._centre, range(len(self)))])
                used = self._pair(theta)
            state = units.weights(used, self.scheme.lifting, size, self.scheme.q)[0] * state
        return locked(self.scheme.controller.weight(state, stages))

    @cached_property
    def _size(self) -> Array | None:
        """The largest of each output, or error, up to k, shape (steps, ..., p), where there are running units."""
        return None if self.scheme.units is None else np.maximum.accumulate(np.abs(self.error))

    @cached_property
    def _data(self) -> tuple[Array | None, ...]:
        """The memory of ``GrowingMemory`` before k = 0, and at every k."""
        estimator = self.scheme.estimator
        if not isinstance(estimator, GrowingMemory):
            return (None,) * (len(self) + 1)
        x, u = self.lifted
        data, first = estimator.begin(x.shape[-1], u.shape[-1]), self.scheme.first_measured
        found = [np.broadcast_to(data, (*x.shape[1:-1], *data.shape))]
        for k in range(len(self)):
            given = np.stack([x[k], self._before(k)], axis=-2), u[k][..., None, :]
            found.append(estimator.remember(found[-1], *given) if k >= first else found[-1])
        return tuple(found)

    def _before(self, k: int) -> Array:
        """Return x(k-1) as used in the transition to x(k), relative to the set point of k."""
        x = self.lifted[0][k - 1]
        if self.set_point is None:
            return x
        return x + np.tile(self.set_point[k - 1] - self.set_point[k], self.scheme.lifting.outputs)

    def _centre(self, k: int) -> SignalModel:
        if self._size is None:
            return self.model(k - 1)
        before = self._size[k - 1] if k else np.zeros_like(self._size[0])
        return centre_of(self.scheme, k, self.model(k - 1), before, self._size[k])

    @cached_property
    def newton_decrement(self) -> Array:
        """Certificates of the estimates theta*(k): distances from the minimiser of (15), shape (steps, ...)."""
        estimator, lifting = self.scheme.estimator, self.scheme.lifting
        if isinstance(estimator, GrowingMemory):
            return locked(np.stack([self._decrement(estimator, k) for k in range(len(self))]))
        rows = []
        for k in range(len(self)):
            y = self._history(self.y, estimator.window + 1 + lifting.outputs, k + 1)
            v = self._history(self._known, estimator.window + lifting.inputs + 1, k)
            y, v = seen(self.scheme.set_point, k, y, v)
            x = lifting.lift(y, estimator.window + 1)
            u = lifting.window(v, lifting.inputs, estimator.window)
            found, centre, counted = self._estimate(k), self._centre(k), self._counted(k)
            rows.append(estimator.newton_decrement(found, centre, x, u, k, counted))
        return locked(np.stack(rows))

    def _decrement(self, estimator: GrowingMemory, k: int) -> Array:
        if k < self.scheme.first_measured:
            return np.zeros(self.y.shape[1:-1])
        (x, u), since = self.lifted, range(self.scheme.first_measured, k + 1)
        after, before, inputs = (
            np.stack(rows, axis=-2) for rows in zip(*((x[j], self._before(j), u[j]) for j in since), strict=True)
        )
        found, centre = self._estimate(k), proximal_centre(self.scheme, self._centre(k))
        return estimator.newton_decrement(found, centre, after, before, inputs, self._counted(k))

    def _counted(self, k: int) -> Array | None:
        """Return the sizes of [x; u] at k, by which the estimator's weights scale them."""
        scheme, sizes = self.scheme, self._size
        if scheme.units is None or sizes is None:
            return None
        return scheme.units.parameters(scheme.lifting, sizes[k], scheme.q)

    @cached_property
    def margin_lifted(self) -> Array:
        """Smallest singular value of the lifted pair's controllability matrix, shape (steps, ...)."""
        return locked(np.stack([controllability_margin(self.model(k)) for k in range(len(self))]))

    @cached_property
    def margin_augmented(self) -> Array:
        """The same for Remark 4's augmented pair, which the controller uses, shape (steps, ...)."""
        augment = self.scheme.lifting.augment
        return locked(np.stack([controllability_margin(augment(self.model(k))) for k in range(len(self))]))

    @cached_property
    def s_plus(self) -> Array:
        """The smallest nonzero singular value of [B_{n'-1}(k) ... B_0(k)] of the planned maps, shape (steps, ...).

        Theorem 1* of the book requires a positive lower bound of it; see :func:`rhl.controllability.s_plus`. Only the
        first n' steps of the horizon count, with n' the size of the augmented state: later ones do not decrease the
        number, and in an unstable model rounding would hide it.
        """
        augment, controller = self.scheme.lifting.augment, self.scheme.controller
        used = (self._centre(k) if controller.model_delay else self.model(k) for k in range(len(self)))
        models = [augment(model) for model in used]
        found = [s_plus(model, min(controller.horizon, model.n)) for model in models]
        return locked(np.stack([np.broadcast_to(one, self.y.shape[1:-1]) for one in found]))

    def model(self, k: int) -> SignalModel:
        """Return theta~(k); the initial model for k = -1."""
        return self.scheme.initial_model if k < 0 else self._pair(self._models.model[k])

    def _estimate(self, k: int) -> SignalModel:
        return self._pair(self._models.estimate[k])

    def _pair(self, theta: Array) -> SignalModel:
        n = theta.shape[-2]
        return SignalModel(theta[..., :n], theta[..., n:])

    @cached_property
    def steps(self) -> tuple[Step, ...]:
        """Every step, in order; plans are computed on access."""
        return tuple(self._step(k) for k in range(len(self)))

    def _step(self, k: int, with_value: bool = True) -> Step:
        scheme, models, lead = self.scheme, self._models, self.y.shape[1:-1]
        y, v = self._history(self.y, scheme.depth, k), self._history(self._known, scheme.depth, k)
        stage, value, before = np.full(lead, k), None, None
        if models.stage is not None:
            stage = models.stage[k]
            if k > 0 and with_value:
                before, value = models.stage[k - 1], self._step(k - 1, with_value=False).plan.value
        size = None if self._size is None else self._size[k]
        earlier = None if self._size is None else self._size[k - 1] if k else np.zeros_like(self._size[0])
        state = ControllerState(k, y, v, self.model(k - 1), before, value, earlier, self._data[k])
        return Step(
            scheme,
            state,
            self.y[k],
            self.v_computed[k],
            self.v[k],
            self._estimate(k),
            self.model(k),
            models.lam[k],
            stage,
            None if self.plant_state is None else self.plant_state[k],
            size,
            self._data[k + 1],
        )

    def plan(self, k: int) -> Plan:
        """Return the plan of step k: inputs, predicted signals, certificate."""
        if integer("k", k, 0) >= len(self):
            raise InputError(f"k must be below the number of steps, {len(self)}, got {k}")
        return self.steps[k].plan if "steps" in self.__dict__ else self._step(k).plan

    def columns(self) -> dict[str, Array]:
        """Return the columns k, y1.., v1.., yhat1.., z1.., weight, lambda of one run, each of shape (steps,)."""
        if self.y.ndim != 2:
            raise InputError(f"a table holds one run, got a batch of shape {self.y.shape[1:-1]}; take one member")
        z = np.empty((len(self), 0)) if self.plant_state is None else self.plant_state
        names = header(self.y.shape[1], self.v.shape[1], z.shape[1])
        values = (self.k, *self.y.T, *self.v.T, *self.y_hat.T, *z.T, self.weight, self.lam)
        return dict(zip(names, values, strict=True))

    def to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write ``columns`` with 17 significant digits; the file appears whole or not at all.

        Examples
        --------
        >>> from pathlib import Path
        >>> from tempfile import TemporaryDirectory
        >>> from rhl.paper.published import linear_example
        >>> with TemporaryDirectory() as folder:
        ...     linear_example().run().to_csv(f"{folder}/run.csv")
        ...     print(Path(folder, "run.csv").read_text().splitlines()[0])
        k,y1,v1,yhat1,z1,z2,z3,weight,lambda
        """
        write_whole(path, table_text(self.columns()))
