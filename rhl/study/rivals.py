"""Alternatives to the scheme: a regulator that knows the plant, and one that excites, identifies and regulates."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from rhl._checks import Array, describe, fraction, instance, integer, positive, read_only, real_array
from rhl._riccati import gains
from rhl.errors import InputError
from rhl.lifting import DelayLifting, remember
from rhl.model import SignalModel
from rhl.plants.linear import LinearPlant

# A direction of the data counts if its singular value exceeds this share of the largest.
_RANK_RTOL = 1e-9
# The horizon of the identified regulator; for slower modes it makes no relevant difference here.
_AHEAD = 300
# With noise, predictors use this many times more past data, so that errors average out.
_FURTHER_BACK = 3
# With noise a model is fitted to this many equations for each of its unknowns.
_EQUATIONS = 10


@dataclass(frozen=True, eq=False)
class Task:
    r"""A plant to be brought to rest, what a method knows about it, and its errors.

    A method knows the sizes of y and v, ``order``, the weights, ``size``, ``noise`` and ``bound``. It measures
    y + ``errors`` and knows the input after the actuator. Only ``known_plant`` uses the plant.

    Attributes
    ----------
    plant : LinearPlant
    z0 : array, shape (n,)
    order : int
        An upper bound on the observability index.
    steps : int
    W, R : array, shapes (p, p) and (q, q)
        The weights of the cost for all methods, :math:`\sum_k |y(k)|_W^2 + |v(k)|_R^2`, see ``weights``.
    noise : float
        Standard deviation of the errors, relative to the sizes in which W counts outputs.
    errors : array, shape (steps, p)
        Errors of the sensor.
    bound : array, shape (q,), or None
        The largest absolute value of each input.
    seed : int
        The seed of a method's random numbers; the errors use another stream of the same seed.
    size : float
        The standard deviation of exciting inputs.
    """

    plant: LinearPlant
    z0: Array
    order: int
    steps: int
    W: Array
    R: Array
    noise: float
    errors: Array
    bound: Array | None
    seed: int
    size: float = 0.1

    @property
    def output_sizes(self) -> Array:
        """The sizes by which outputs are scaled, shape (p,)."""
        return np.diag(self.W) ** -0.5

    @property
    def stacked(self) -> int:
        """The number of outputs and inputs in a predictor: ``order``, with noise three times that to average."""
        return _FURTHER_BACK * self.order if self.noise else self.order

    def rng(self) -> np.random.Generator:
        """Return the generator of a method's random numbers."""
        return np.random.default_rng(np.random.SeedSequence([self.seed, 1]))

    def within(self, v: Array) -> Array:
        """Return the input after the actuator."""
        return v if self.bound is None else np.clip(v, -self.bound, self.bound)


@dataclass(frozen=True, eq=False)
class Run:
    """A run: outputs y without the sensor's errors, shape (steps, p), and applied inputs v, shape (steps, q).

    ``wanted`` is the requested number of steps; fewer rows mean that an output exceeded 1e100.

    Examples
    --------
    >>> run = known_plant(pose(LinearPlant([[1.2]], [[1.0]], [[1.0]]), [1.0], order=1, steps=30))
    >>> run.y.shape, run.v.shape, run.wanted, bool(abs(run.y[-1, 0]) < 1e-6)
    ((30, 1), (30, 1), 30, True)
    """

    y: Array
    v: Array
    wanted: int


def pose(
    plant: LinearPlant,
    z0: ArrayLike,
    order: int,
    steps: int,
    *,
    noise: float = 0.0,
    bounded: float | None = None,
    seed: int = 0,
) -> Task:
    """Return the task of bringing a plant to rest.

    Parameters
    ----------
    plant : LinearPlant
        A single plant, not a batch.
    z0 : array_like, shape (n,)
        Initial state with nonzero y(0).
    order : int
        An upper bound on the observability index.
    steps : int
    noise : float
        Standard deviation of normal errors of each output, relative to that output's first size or, if
        that is zero, to the largest of the others. In [0, 1).
    bounded : float, optional
        The bound on each input, as a multiple of the largest one of the regulator that knows the plant; for
        inputs that it does not use, of the largest of the others. None: no bounds.
    seed : int
        The seed of the errors and of a method's random numbers.

    Raises
    ------
    InputError
        If z0 does not fit the plant, y(0) is zero, or a number is out of range.
    """
    instance("plant", plant, LinearPlant)
    z, m = real_array("z0", z0, (plant.n,)), integer("order", order, 1)
    if z.ndim > 1 or plant.F.ndim > 2:
        raise InputError(f"plant and z0 must be of one run, got a batch of shape {plant.batch(z)}; take one member")
    integer("steps", steps, 1)
    noise = fraction("noise", noise)
    W, R = weights(plant, plant.H @ z, m)
    rng = np.random.default_rng(np.random.SeedSequence([integer("seed", seed, 0), 0]))
    errors = noise * np.diag(W) ** -0.5 * rng.standard_normal((steps, plant.p))
    free = Task(plant, z, m, steps, W, R, noise, read_only(errors), None, seed)
    if bounded is None:
        return free
    largest = np.max(np.abs(known_plant(free).v), axis=0) * positive("bounded", bounded)
    bound = np.where(largest > 0, largest, np.max(largest))
    if not np.all(bound > 0):
        raise InputError(
            f"bounded must be None where the regulator that knows the plant uses no input, got {describe(bounded)}"
        )
    return Task(plant, z, m, steps, W, R, noise, free.errors, read_only(bound), seed)


def weights(plant: LinearPlant, y0: Array, order: int) -> tuple[Array, Array]:
    r"""Return the cost of all methods, :math:`\sum_k |y(k)|_W^2 + |v(k)|_R^2`, as W (p, p) and R (q, q).

    Outputs are scaled by their first sizes or, if these are zero, by the largest of the others. The weight of an input
    is 1e-4 of its scaled effect on outputs within ``order`` steps.
    """
    size = np.where(np.abs(y0) > 0, np.abs(y0), np.max(np.abs(y0)))
    if not np.all((size > 1e-100) & (size < 1e100)):
        raise InputError(
            "y(0) must be nonzero and between 1e-100 and 1e100, since outputs are scaled by its sizes, got "
            f"{np.max(np.abs(y0)):.3g}; choose another z0"
        )
    effect, moved = np.zeros((plant.p, plant.q)), plant.G
    for _ in range(order):
        effect += np.abs(plant.H @ moved) / size[:, None]
        moved = plant.F @ moved
    gain = np.max(effect, axis=0)
    return np.diag(size**-2.0), 1e-4 * np.diag(np.where(gain > 0, gain, 1.0) ** 2)


def known_plant(task: Task) -> Run:
    """Run the regulator that knows plant, state and number of steps: without bounds its cost is the least.

    Under bounds its inputs are clipped, and its cost is no longer the least.
    """
    plant = task.plant
    K = regulator(plant.F, plant.G, np.sqrt(task.W) @ plant.H, task.R, task.steps)
    return closed(task, lambda k, y, before, z: -K[k] @ z)


def excite_identify_regulate(task: Task) -> Run:
    """Excite at random until the data suffice, fit a model of the lifted signals, and regulate with it.

    It uses the same information as the scheme: outputs, inputs and ``order``, the number of each that is stacked.
    Exciting inputs are normal with standard deviation ``task.size``. Data suffice if their rank no longer increases and
    there are more rows than that; with noise, if there are ten rows for each unknown of a row of the model.

    Examples
    --------
    >>> run = excite_identify_regulate(pose(LinearPlant([[1.2]], [[1.0]], [[1.0]]), [1.0], order=1, steps=30))
    >>> bool(abs(run.y[-1, 0]) < 1e-6)
    True
    """
    m, rng = task.order, task.rng()
    p, q, W, R = task.plant.p, task.plant.q, task.W, task.R
    lifting, scale = (
        DelayLifting(m, m),
        np.concatenate([np.tile(np.sqrt(np.diag(W)), m), np.full(q * m, 1 / task.size)]),
    )
    n = p * m
    past: list[Array] = [np.zeros((m + 1, p)), np.zeros((m + 1, q))]
    rows: list[Array] = []
    found: list[Array] = []
    ranks = [0, 0]

    def enough(known: Array) -> bool:
        if task.noise:
            return len(known) >= _EQUATIONS * len(scale)
        ranks.append(int(np.linalg.matrix_rank(known, rtol=_RANK_RTOL)))
        return ranks[-1] == ranks[-3] and len(known) > ranks[-1]

    def choose(k: int, y: Array, before: Array, z: Array) -> Array:
        past[1] = remember(past[1], before)
        past[0] = remember(past[0], y)
        if k >= m and not found:
            rows.append(np.concatenate([past[0][1:].ravel(), past[1][:m].ravel(), past[0][:m].ravel()]))
            data = np.array(rows)
            known, target = data[:, : len(scale)] * scale, data[:, len(scale) :]
            if enough(known):
                theta = (np.linalg.lstsq(known, target, rcond=_RANK_RTOL)[0] * scale[:, None]).T
                model = lifting.augment(SignalModel(theta[:, :n], theta[:, n:]))
                seen = np.concatenate([np.sqrt(W), np.zeros((p, model.n - p))], axis=1)
                found.append(regulator(model.A, model.B, seen, R, _AHEAD)[0])
        return -found[0] @ lifting.augmented_state(*past) if found else task.size * rng.standard_normal(q)

    return closed(task, choose)


def regulator(A: Array, B: Array, seen: Array, R: Array, steps: int) -> Array:
    """Return the gains that minimise the sum of |seen z|^2 + |v|_R^2 over the steps, shape (..., steps, q, n).

    Examples
    --------
    >>> one = np.eye(1)
    >>> regulator(1.2 * one, one, one, one, steps=50)[0].round(3)
    array([[0.794]])
    """
    n = A.shape[-1]
    triangle = np.zeros((n, n))
    factored = np.linalg.qr(seen, mode="r")
    triangle[: len(factored)] = factored
    return gains(np.zeros((n, n)), A, B, triangle, np.sqrt(R), steps)[0]


def closed(task: Task, choose: Callable[[int, Array, Array, Array], Array]) -> Run:
    """Close the loop with ``choose(k, y, before, z)``: the measured y, the previous applied input, and the state.

    The run ends before an output exceeds 1e100 or an input leaves the range of floating-point numbers.
    """
    plant, z, outputs, inputs = task.plant, task.z0, [], []
    v = np.zeros(plant.q)
    for k in range(task.steps):
        y = plant.H @ z
        if not np.max(np.abs(y)) < 1e100:
            break
        v = task.within(choose(k, y + task.errors[k], v, z))
        if not np.all(np.isfinite(v)):
            break
        outputs.append(y)
        inputs.append(v)
        z = plant.F @ z + plant.G @ v
    return Run(np.array(outputs).reshape(-1, plant.p), np.array(inputs).reshape(-1, plant.q), task.steps)
