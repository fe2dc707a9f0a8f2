"""One unknown plant under several ways of control, all judged by the same numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from rhl._checks import Array, instance, integer, real_array
from rhl.errors import DivergedError, InputError
from rhl.plants.linear import LinearPlant
from rhl.scheme import Scheme, default_scheme, window_scheme
from rhl.simulation import simulate
from rhl.study.rivals import Run, excite_identify_regulate, known_plant, weights

# At rest are outputs that end below this share of the largest of y(0), and stay there for the last steps of a run.
_REST, _LAST = 0.05, 20
# Settled are those that stay below this share from some step on.
_SETTLED = 0.01


METHODS = ("the plant known", "excite, identify, regulate", "window_scheme", "default_scheme")


@dataclass(frozen=True)
class Score:
    """How one way of control did on one plant; outputs count relative to the largest entry of y(0).

    Attributes
    ----------
    method : str
    at_rest : bool
        Whether the last twenty outputs are below 0.05.
    peak : float
        Largest output; infinite where the run left the range of floating-point numbers.
    cost : float
        What the run cost, over the least that any inputs cost (``known_plant``); infinite where it diverged.
    largest_input : float
        In the plant's own units.
    settled_at : int or None
        The first k from which on outputs stay below 0.01; None if there is none.
    """

    method: str
    at_rest: bool
    peak: float
    cost: float
    largest_input: float
    settled_at: int | None


def compare(plant: LinearPlant, z0: ArrayLike, order: int, steps: int = 400, *, seed: int = 0) -> tuple[Score, ...]:
    """Run a plant under each method and judge them.

    The ``METHODS``: the regulator that knows the plant (the least cost there is), a regulator that excites, identifies
    and regulates (inputs of size 0.1 at first, as the scheme's), ``window_scheme``, and ``default_scheme``. But for
    the first they are told the sizes of y and v and ``order``, an upper bound on the observability index. There is no
    noise. Inputs while exciting count as any others.

    Raises
    ------
    InputError
        If z0 does not fit the plant, y(0) is zero, or the numbers are out of range.

    Examples
    --------
    >>> scores = compare(LinearPlant([[1.2]], [[1.0]], [[1.0]]), [1.0], order=1, steps=60)
    >>> [(score.method, score.at_rest) for score in scores][-1]
    ('default_scheme', True)
    """
    instance("plant", plant, LinearPlant)
    z, m = real_array("z0", z0, (plant.n,)), integer("order", order, 1)
    if z.ndim > 1 or plant.F.ndim > 2:
        raise InputError(f"plant and z0 must be of one run, got a batch of shape {plant.batch(z)}; take one member")
    integer("steps", steps, _LAST)
    W, R = weights(plant, plant.H @ z, m)
    runs = (
        known_plant(plant, z, steps, W, R),
        excite_identify_regulate(plant, z, steps, m, W, R, size=0.1, seed=seed),
        _simulated(window_scheme(plant.p, plant.q, m), plant, z, steps),
        _simulated(default_scheme(plant.p, plant.q, m), plant, z, steps),
    )
    least = _cost(runs[0], W, R)
    return tuple(_judged(name, run, _cost(run, W, R) / least) for name, run in zip(METHODS, runs, strict=True))


def _simulated(scheme: Scheme, plant: LinearPlant, z: Array, steps: int) -> Run:
    try:
        trace = simulate(scheme, plant, z, steps, record="signals")
    except DivergedError as error:
        if error.trace is None:
            return Run(np.empty((0, plant.p)), np.empty((0, plant.q)), steps)
        trace = error.trace
    return Run(trace.y, trace.v, steps)


def _cost(run: Run, W: Array, R: Array) -> float:
    if len(run.y) < run.wanted:
        return np.inf
    with np.errstate(over="ignore"):
        return float(np.einsum("ki,ij,kj", run.y, W, run.y) + np.einsum("ki,ij,kj", run.v, R, run.v))


def _judged(method: str, run: Run, cost: float) -> Score:
    if len(run.y) < run.wanted:
        return Score(method, False, np.inf, np.inf, np.inf, None)
    sizes = np.max(np.abs(run.y), axis=1) / np.max(np.abs(run.y[0]))
    late = np.flatnonzero(sizes >= _SETTLED)
    settled = int(late[-1]) + 1 if len(late) else 0
    return Score(
        method,
        bool(np.all(sizes[-_LAST:] < _REST)),
        float(sizes.max()),
        cost,
        float(np.max(np.abs(run.v))),
        settled if settled < run.wanted else None,
    )
