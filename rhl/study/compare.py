"""One unknown plant under several control methods, compared by the same numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike

from rhl._checks import Array, choice, integer, reason
from rhl.controller import Controller
from rhl.disturbances import Saturation
from rhl.errors import DivergedError, InputError
from rhl.estimator import ProximalEstimator
from rhl.lifting import DelayLifting
from rhl.model import SignalModel
from rhl.plants.linear import LinearPlant
from rhl.schedules import PowerDecay
from rhl.scheme import Scheme, default_scheme, window_scheme
from rhl.simulation import simulate
from rhl.study.adaptive import adaptive_lq
from rhl.study.deepc import deepc
from rhl.study.rivals import Run, Task, excite_identify_regulate, known_plant, pose

# Outputs are at rest if they are below this share of the largest of y(0) in the last steps of a run.
_REST, _LAST = 0.05, 20
# They are settled from the step on after which they stay below this share.
_SETTLED = 0.01
# With sensor errors, both shares are larger by this many of their standard deviations.
_DEVIATIONS = 3.0


def paper_scheme(p: int, q: int, order: int) -> Scheme:
    r"""Return a scheme with the settings of the paper's linear example, for any number of outputs and inputs.

    The settings of ``rhl.paper.published.linear_example`` are: Q = QN = 100, R = 10000, :math:`\epsilon(k) =
    1/(1+100k)`, squares with weight 1 for loss and generator, no mixing, the estimate of the step before, and the
    initial model with ones above the diagonal and in the last row. Sizes follow the example's pattern: :math:`N_y =
    N_v` = order (4 there), a window of twice that (8), and a horizon of 20 or, where it is larger, the size of the
    augmented state (7), as the theory requires. For one input, one output and order 4 it is the paper's scheme.
    """
    for name, value in (("p", p), ("q", q), ("order", order)):
        integer(name, value, 1)
    n = p * order
    return Scheme(
        lifting=DelayLifting(order, order),
        estimator=ProximalEstimator(2 * order),
        controller=Controller(100.0, 10000.0, 100.0, max(20, n + (order - 1) * q), PowerDecay(100), model_delay=1),
        initial_model=SignalModel.companion_of_ones(n, q * order),
    )


def our_scheme(p: int, q: int, order: int, bound: Array | None = None, noise: Array | float = 0.0) -> Scheme:
    """Return the default scheme for outputs of size p and inputs of size q with the settings used here.

    Its plans keep the bound of each input, shape (q,), and it knows the standard deviation of the outputs' errors, a
    number or shape (p,).

    Examples
    --------
    >>> our_scheme(1, 1, 2, bound=np.array([0.5])).controller.bounds.high
    array([0.5])
    """
    bounds = None if bound is None else Saturation(-bound, bound)
    return default_scheme(p, q, order, noise=noise, bounds=bounds)


# From p, q, order, bound and noise.
_SCHEMES: dict[str, Callable[[int, int, int, Array | None, Array | float], Scheme]] = {
    "paper": lambda p, q, order, bound, noise: paper_scheme(p, q, order),
    "window_scheme": lambda p, q, order, bound, noise: window_scheme(p, q, order),
    "default_scheme": our_scheme,
}


def _one_by_one(run: Callable[[Task], Run]) -> Callable[[Sequence[Task]], list[Run]]:
    return lambda tasks: [run(task) for task in tasks]


def _of_scheme(name: str) -> Callable[[Sequence[Task]], list[Run]]:
    def run(tasks: Sequence[Task]) -> list[Run]:
        of = tasks[0]
        scheme = _SCHEMES[name](of.plant.p, of.plant.q, of.order, of.bound, of.noise * of.output_sizes)
        return _simulated(scheme, tasks)

    return run


# Each takes tasks that differ only in seeds.
_RUN: dict[str, Callable[[Sequence[Task]], list[Run]]] = {
    "known-plant": _one_by_one(known_plant),
    "excite-identify": _one_by_one(excite_identify_regulate),
    "adaptive-lq": adaptive_lq,
    "deepc": _one_by_one(deepc),
    **{name: _of_scheme(name) for name in _SCHEMES},
}
METHODS = tuple(_RUN)
# These methods are random even without noise; known-plant measures the state and is never random.
_RANDOM = ("excite-identify", "adaptive-lq", "deepc")


@dataclass(frozen=True)
class Score:
    """The result of one run of one method on one plant; outputs are relative to the largest entry of y(0).

    All numbers refer to the true outputs, not to the measured ones. s is the noise's relative standard deviation.

    Attributes
    ----------
    method : str
        One of ``METHODS``.
    at_rest : bool
        Whether the last twenty outputs are below 0.05 + 3 s.
    peak : float
        Largest output; infinite if the run left the range of floating-point numbers.
    cost : float
        Cost of the run relative to the least cost without noise and bounds (``known_plant``); infinite if it diverged.
        It includes the cost of excitation.
    largest_input : float
        In the plant's own units.
    settled_at : int or None
        The first k from which on outputs stay below 0.01 + 3 s; None if there is none.
    step_time : float
        Seconds of computation per step, including identification, over all seeds that ran together.
    seed : int
    noise : float
        Standard deviation s of the measurement errors, relative to the first outputs.
    bounded : float or None
        The bound of inputs, see ``rivals.pose``.
    failure : str
        The error of the method, on one line; "" if there was none.

    Examples
    --------
    >>> (score,) = compare(LinearPlant([[1.2]], [[1.0]], [[1.0]]), [1.0], 1, 60, methods=["known-plant"])
    >>> score.at_rest, score.cost, score.failure
    (True, 1.0, '')
    """

    method: str
    at_rest: bool
    peak: float
    cost: float
    largest_input: float
    settled_at: int | None
    step_time: float = 0.0
    seed: int = 0
    noise: float = 0.0
    bounded: float | None = None
    failure: str = ""


def compare(
    plant: LinearPlant,
    z0: ArrayLike,
    order: int,
    steps: int = 400,
    *,
    seed: int = 0,
    seeds: int = 1,
    noise: float = 0.0,
    bounded: float | None = None,
    methods: Sequence[str] = METHODS,
) -> tuple[Score, ...]:
    """Run a plant under each method and score the runs.

    ``METHODS``: the regulator that knows the plant and its state (the least cost without noise and bounds),
    three rivals that know neither, the settings of the paper's linear example, ``window_scheme`` and
    ``default_scheme``. All but the first know the sizes of y and v and ``order``; the rivals also know the cost
    function of the comparison, the noise and the bounds.

    Parameters
    ----------
    plant : LinearPlant
    z0 : array_like, shape (n,)
        Initial state.
    order : int
        An upper bound on the observability index.
    steps : int
        At least 20.
    seed : int
        The first seed.
    seeds : int
        The number of seeds for methods that are random; a deterministic run is done once.
    noise, bounded
        See ``rivals.pose``.
    methods : sequence of str
        The methods to run.

    Returns
    -------
    tuple of Score
        In the order of ``methods``, then of seeds. A failed run has a score too, which holds its error.

    Raises
    ------
    InputError
        If z0 does not fit the plant, y(0) is zero, or numbers or names are out of range.

    Examples
    --------
    >>> scores = compare(LinearPlant([[1.2]], [[1.0]], [[1.0]]), [1.0], order=1, steps=60)
    >>> [(score.method, score.at_rest) for score in scores][-1]
    ('default_scheme', True)
    """
    integer("steps", steps, _LAST)
    integer("seeds", seeds, 1)
    if isinstance(methods, str):
        raise InputError(f"methods must be a sequence of names, got the string {methods!r}; put it in a list")
    for method in methods:
        choice("method", method, METHODS)
    first = pose(plant, z0, order, steps, noise=noise, bounded=bounded, seed=seed)
    tasks = [
        first,
        *(pose(plant, z0, order, steps, noise=noise, bounded=bounded, seed=seed + i) for i in range(1, seeds)),
    ]
    least = _cost(known_plant(pose(plant, z0, order, steps)), first)
    scores: list[Score] = []
    for method in methods:
        draws = method in _RANDOM or (noise > 0 and method != "known-plant")
        scores += _scores(method, tasks if draws else tasks[:1], least, bounded)
    return tuple(scores)


def _scores(method: str, tasks: Sequence[Task], least: float, bounded: float | None) -> list[Score]:
    begun = perf_counter()
    try:
        runs, failures = _RUN[method](tasks), [""] * len(tasks)
    except Exception as error:
        if len(tasks) > 1:  # one failing run must not fail the others
            return [score for task in tasks for score in _scores(method, [task], least, bounded)]
        runs, failures = [_nothing(tasks[0])], [reason(error)]
    seconds = (perf_counter() - begun) / max(1, sum(len(run.y) for run in runs))
    return [
        _judged(method, run, task, _cost(run, task) / least, seconds, bounded, failure)
        for run, task, failure in zip(runs, tasks, failures, strict=True)
    ]


def _nothing(task: Task) -> Run:
    return Run(np.empty((0, task.plant.p)), np.empty((0, task.plant.q)), task.steps)


def _simulated(scheme: Scheme, tasks: Sequence[Task]) -> list[Run]:
    first = tasks[0]
    errors = np.stack([task.errors for task in tasks], axis=1)
    sensor = (lambda k, y: y + errors[k]) if first.noise else None
    actuator = None if first.bound is None else Saturation(-first.bound, first.bound)
    z0 = np.tile(first.z0, (len(tasks), 1))
    try:
        trace = simulate(scheme, first.plant, z0, first.steps, record="signals", sensor=sensor, actuator=actuator)
    except DivergedError as error:
        if error.trace is None:
            return [_nothing(task) for task in tasks]
        trace = error.trace
    ends = np.where(trace.diverged_at < 0, len(trace), trace.diverged_at)
    y = trace.z @ first.plant.H.T
    return [Run(y[:end, i], trace.v[:end, i], first.steps) for i, end in enumerate(ends)]


def _cost(run: Run, task: Task) -> float:
    if len(run.y) < run.wanted:
        return np.inf
    with np.errstate(over="ignore"):
        return float(np.einsum("ki,ij,kj", run.y, task.W, run.y) + np.einsum("ki,ij,kj", run.v, task.R, run.v))


def _judged(
    method: str, run: Run, task: Task, cost: float, seconds: float, bounded: float | None, failure: str
) -> Score:
    about = (seconds, task.seed, task.noise, bounded, failure)
    if len(run.y) < run.wanted:
        return Score(method, False, np.inf, np.inf, np.inf, None, *about)
    sizes = np.max(np.abs(run.y), axis=1) / np.max(np.abs(run.y[0]))
    allowed = _DEVIATIONS * task.noise
    late = np.flatnonzero(sizes >= _SETTLED + allowed)
    settled = int(late[-1]) + 1 if len(late) else 0
    return Score(
        method,
        bool(np.all(sizes[-_LAST:] < _REST + allowed)),
        float(sizes.max()),
        cost,
        float(np.max(np.abs(run.v))),
        settled if settled < run.wanted else None,
        *about,
    )


@dataclass(frozen=True)
class Summary:
    """The results of a method over several runs.

    ``at_rest`` counts the runs at rest, ``low_peak`` those of them with a peak below 100. ``peak``, ``cost`` and
    ``step_time`` are medians over all runs, infinite if half of them diverged.

    Examples
    --------
    >>> scores = compare(LinearPlant([[1.2]], [[1.0]], [[1.0]]), [1.0], 1, 60, methods=["known-plant"])
    >>> summaries(scores)[0].runs
    1
    """

    method: str
    noise: float
    bounded: float | None
    runs: int
    at_rest: int
    low_peak: int
    peak: float
    cost: float
    step_time: float


def summaries(scores: Iterable[Score]) -> list[Summary]:
    """Summarise scores by noise, bound and method, in the order of appearance.

    Examples
    --------
    >>> plant = LinearPlant([[1.2]], [[1.0]], [[1.0]])
    >>> for row in summaries(compare(plant, [1.0], 1, 120, methods=["known-plant", "deepc"], seeds=3)):
    ...     print(row.method, row.runs, row.at_rest)
    known-plant 1 1
    deepc 3 3
    """
    groups: dict[tuple[float, float | None, str], list[Score]] = {}
    for score in scores:
        groups.setdefault((score.noise, score.bounded, score.method), []).append(score)
    return [
        Summary(
            method,
            noise,
            bounded,
            len(of),
            sum(score.at_rest for score in of),
            sum(score.at_rest and score.peak < 100 for score in of),
            *(float(np.median([getattr(score, name) for score in of])) for name in ("peak", "cost", "step_time")),
        )
        for (noise, bounded, method), of in groups.items()
    ]
