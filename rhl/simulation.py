"""A run, collected: arrays over k for plots, tables and files."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rhl._checks import Array, describe, instance, integer
from rhl._files import header, write_whole
from rhl.closed_loop import Step, closed_loop
from rhl.controllability import controllability_margin
from rhl.disturbances import Disturbances
from rhl.errors import DivergedError, InputError
from rhl.horizon import Plan
from rhl.plants.base import Plant
from rhl.scheme import Scheme


@dataclass(frozen=True, eq=False)
class Trace:
    """The steps of a run as arrays whose first axis is k.

    Attributes
    ----------
    scheme : Scheme
        What ran.
    steps : tuple of Step
        Every k, in order.

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
    steps: tuple[Step, ...]

    def __post_init__(self) -> None:
        instance("scheme", self.scheme, Scheme)
        steps: Any = self.steps
        if not isinstance(steps, (tuple, list)) or not all(isinstance(done, Step) for done in steps):
            raise InputError(f"steps must be a tuple of Step, got {describe(steps)}")
        object.__setattr__(self, "steps", tuple(steps))
        if not self.steps:
            raise InputError("a trace must have at least one step, got none")

    def __len__(self) -> int:
        return len(self.steps)

    @cached_property
    def k(self) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
        """Step numbers, shape (steps,)."""
        return np.array([done.k for done in self.steps])

    @cached_property
    def y(self) -> Array:
        """Outputs y(k), shape (steps, ..., p)."""
        return np.stack([done.y for done in self.steps])

    @cached_property
    def v(self) -> Array:
        """Inputs v(k), shape (steps, ..., q)."""
        return np.stack([done.v for done in self.steps])

    @cached_property
    def y_hat(self) -> Array:
        """Predictions of y(k) made at k-1 (y(0) at k = 0), shape (steps, ..., p)."""
        return np.stack([done.y_hat for done in self.steps])

    @cached_property
    def z(self) -> Array:
        """The plant's states z(k), shape (steps, ..., n)."""
        if any(done.z is None for done in self.steps):
            raise InputError("a trace of recorded data has no plant state; run the scheme on a plant to have one")
        return np.stack([done.z for done in self.steps if done.z is not None])

    @cached_property
    def theta(self) -> Array:
        """Estimates theta~(k) = [vec(A); vec(B)], shape (steps, ..., n(n+q))."""
        return np.stack([done.model.theta for done in self.steps])

    @cached_property
    def lam(self) -> Array:
        """Mixing weights lambda_k, shape (steps, ...)."""
        return np.stack([done.lam for done in self.steps])

    @cached_property
    def weight(self) -> Array:
        """The controller's Gamma(x)/eps(k), shape (steps, ...)."""
        return np.stack([np.asarray(done.problem.weight) for done in self.steps])

    @cached_property
    def newton_decrement(self) -> Array:
        """Certificates of the estimates theta*(k): how far they are from the minimiser of (15), shape (steps, ...)."""
        estimator, lifting = self.scheme.estimator, self.scheme.lifting
        rows = []
        for done in self.steps:
            memory = done.memory
            x = lifting.lift(memory.y, estimator.window + 1)
            u = lifting.window(memory.v, lifting.inputs, estimator.window)
            rows.append(estimator.newton_decrement(done.estimate, memory.model, x, u, done.k))
        return np.stack(rows)

    @cached_property
    def margin_lifted(self) -> Array:
        """Smallest singular value of the lifted pair's controllability matrix, shape (steps, ...)."""
        return np.stack([controllability_margin(done.model) for done in self.steps])

    @cached_property
    def margin_augmented(self) -> Array:
        """The same for Remark 4's augmented pair, which is the one the controller uses, shape (steps, ...)."""
        return np.stack([controllability_margin(self.scheme.lifting.augment(done.model)) for done in self.steps])

    def plan(self, k: int) -> Plan:
        """Return what was planned at step k: inputs, predicted signals, certificate."""
        if integer("k", k, 0) >= len(self):
            raise InputError(f"k must be below the number of steps, {len(self)}, got {k}")
        return self.steps[k].plan

    def columns(self) -> dict[str, Array]:
        """Return the columns k, y1.., v1.., yhat1.., z1.., weight, lambda of one run, each of shape (steps,)."""
        if self.y.ndim != 2:
            raise InputError(f"a table holds one run, got a batch of shape {self.y.shape[1:-1]}; take one member")
        z = np.empty((len(self), 0)) if self.steps[0].z is None else self.z
        names = header(self.y.shape[1], self.v.shape[1], z.shape[1])
        values = (self.k, *self.y.T, *self.v.T, *self.y_hat.T, *z.T, self.weight, self.lam)
        return dict(zip(names, values, strict=True))

    def to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write ``columns`` with 17 significant digits; the file appears whole or not at all."""
        columns = self.columns()
        rows = (
            ",".join(
                str(entry) if name == "k" else format(entry, ".17g") for name, entry in zip(columns, row, strict=True)
            )
            for row in zip(*columns.values(), strict=True)
        )
        write_whole(path, "\n".join([",".join(columns), *rows]) + "\n")


def simulate(
    scheme: Scheme,
    plant: Plant,
    z0: ArrayLike,
    steps: int,
    progress: Callable[[Step], None] | None = None,
    *,
    sensor: Disturbances | None = None,
    actuator: Disturbances | None = None,
    applied_known: bool = True,
) -> Trace:
    """Run the scheme on a plant and collect what happened.

    Parameters
    ----------
    scheme : Scheme
        What was chosen beforehand.
    plant : Plant
        The plant.
    z0 : array_like, shape (..., n)
        Initial state.
    steps : int
        Number of rows, k = 0 ... steps-1.
    progress : callable, optional
        Called with each finished step.
    sensor, actuator, applied_known
        What errs between scheme and plant, as in ``closed_loop``.

    Returns
    -------
    Trace

    Raises
    ------
    DivergedError
        If the run overflows; its ``steps`` are those before.
    InputError
        If z0 or the plant do not fit, or steps is below 1.

    Examples
    --------
    >>> from rhl.paper.published import linear_example
    >>> example = linear_example()
    >>> trace = simulate(example.scheme, example.plant, example.z0, steps=42)
    >>> bool(abs(trace.z[-1]).max() < 1)
    True
    """
    integer("steps", steps, 1)
    if progress is not None and not callable(progress):
        raise InputError(f"progress must be a function of a step, got {describe(progress)}")
    collected: list[Step] = []
    loop = closed_loop(scheme, plant, z0, sensor=sensor, actuator=actuator, applied_known=applied_known)
    try:
        for done in islice(loop, steps):
            collected.append(done)
            if progress is not None:
                progress(done)
    except DivergedError as error:
        raise DivergedError(error.k, error.what, tuple(collected)) from error
    return Trace(scheme, tuple(collected))
