"""Campaigns: schemes on many plants, in tasks that any executor can run in any order with the same result."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.random import default_rng

from rhl._checks import Array, describe, instance, integer, positive
from rhl.disturbances import Saturation
from rhl.errors import InputError, RHLError
from rhl.plants.analysis import Modes, detectability, spectral_radius, stabilizability
from rhl.plants.linear import LinearPlant
from rhl.scheme import Scheme
from rhl.simulation import simulate
from rhl.study.choices import Choice
from rhl.study.ensembles import Drawn, Ensemble
from rhl.trace import Trace

# As in `rhl.study.compare`, which a test compares with this: outputs are at rest if the last twenty are below this
# share of the largest of y(0), and settled from the step on after which they stay below the other share.
_REST, _LAST, _SETTLED = 0.05, 20, 0.01


@dataclass(frozen=True)
class Variable:
    """A variable of a campaign's results: type and unit of its entries, and its description.

    Examples
    --------
    >>> RUN_VARIABLES["settled_at"].units
    'step'
    """

    dtype: str
    units: str
    description: str


# For each run; the dimensions are scheme and plant.
RUN_VARIABLES = {
    "at_rest": Variable("bool", "1", "whether the last 20 outputs are below 0.05 of the largest of y(0)"),
    "peak": Variable("f8", "largest |y(0)|", "largest output of the run; infinite where it diverged"),
    "settled_at": Variable("i4", "step", "first k from which outputs stay below 0.01 of the largest of y(0); -1: none"),
    "largest_input": Variable("f8", "the plant's own", "largest applied input; infinite where the run diverged"),
    "diverged_at": Variable("i4", "step", "k at which the run left the range of float64; -1: it did not"),
    "final_size": Variable("f8", "largest |y(0)|", "largest of the last 20 outputs; infinite where the run diverged"),
}
# For each plant.
PLANT_VARIABLES = {
    "n": Variable("i4", "1", "order of the plant"),
    "p": Variable("i4", "1", "number of outputs"),
    "q": Variable("i4", "1", "number of inputs"),
    "bound": Variable("i4", "1", "bound on the observability index given to schemes, before order_factor"),
    "sampling": Variable("f8", "s", "time from sample to sample; 0: the plant was drawn in discrete time"),
    "spectral_radius": Variable("f8", "1", "largest modulus of an eigenvalue of F"),
    "stabilizability_margin": Variable(
        "f8",
        "norm of [F, G]",
        "least singular value of [lambda I - F, G] where |lambda| >= 1; infinite where there is no such lambda",
    ),
    "detectability_margin": Variable(
        "f8",
        "norm of [F; H]",
        "least singular value of [lambda I - F; H] where |lambda| >= 1; infinite where there is no such lambda",
    ),
}


class LostWorkersError(RHLError):
    """Workers of a campaign were lost repeatedly.

    Examples
    --------
    >>> issubclass(LostWorkersError, RHLError)
    True
    """


@dataclass(frozen=True)
class Task:
    """One piece of a campaign: a scheme, or None for the facts about plants, on the plants first to stop-1."""

    scheme: int | None
    first: int
    stop: int

    @property
    def name(self) -> str:
        """The name of its marker."""
        return f"{'plants' if self.scheme is None else self.scheme}-{self.first}"


@dataclass(frozen=True)
class Campaign:
    """Schemes on many plants.

    Parameters
    ----------
    plants : Ensemble
        The plants.
    schemes : tuple of Choice
        The schemes, with distinct labels.
    steps : int
        Of each run, at least 20.
    noise : float
        Standard deviation of normal errors of the outputs, relative to the plant's largest |y(0)|. Each plant has
        its own errors, which do not depend on the scheme. Scores refer to the measured outputs.
    input_bound : float, optional
        The saturation of the actuators, the same for every input; no bound by default.
    chunk : int
        The number of plants in a task.

    Raises
    ------
    InputError
        If a number is out of range, labels are not distinct, or a scheme cannot be built for a size of the plants.
    """

    plants: Ensemble
    schemes: tuple[Choice, ...]
    steps: int = 200
    noise: float = 0.0
    input_bound: float | None = None
    chunk: int = 250

    def __post_init__(self) -> None:
        integer("steps", self.steps, _LAST)
        integer("chunk", self.chunk, 1)
        if not 0 <= self.noise < np.inf:
            raise InputError(f"noise must be a number of at least 0, got {describe(self.noise)}")
        if self.input_bound is not None:
            positive("input_bound", self.input_bound)
        if not self.schemes:
            raise InputError("schemes must have at least one entry, got none")
        labels, sizes = [], sorted(self.plants.sizes())
        for one in self.schemes:
            instance("schemes", one, Choice)
            if one.label in labels:
                raise InputError(f"schemes must have distinct labels, got {describe(one.label)} twice")
            labels.append(one.label)
            for size in sizes:
                one.scheme(*size)

    def tasks(self) -> Iterator[Task]:
        """Yield every task; those of the plants come first."""
        for scheme in (None, *range(len(self.schemes))):
            for first in range(0, len(self.plants), self.chunk):
                yield Task(scheme, first, min(first + self.chunk, len(self.plants)))

    def evaluate(self, task: Task) -> dict[str, np.ndarray]:
        """Run a task; return each of ``PLANT_VARIABLES`` or ``RUN_VARIABLES``, shape (stop - first,).

        Plants of one size run in one batch.
        """
        numbers = range(task.first, task.stop)
        if task.scheme is None:
            return _facts([self.plants.draw(i) for i in numbers])
        return self.runs(task.scheme, numbers)

    def runs(self, scheme: int, numbers: Sequence[int]) -> dict[str, np.ndarray]:
        """Run one scheme on the plants in ``numbers``; return ``RUN_VARIABLES``, shape (len(numbers),)."""
        drawn = [self.plants.draw(i) for i in numbers]
        found = {name: np.empty(len(drawn), about.dtype) for name, about in RUN_VARIABLES.items()}
        groups: dict[tuple[int, int, int, int], list[int]] = defaultdict(list)
        for at, one in enumerate(drawn):
            groups[one.size].append(at)
        for size, members in groups.items():
            chosen = self.schemes[scheme].scheme(*size[1:])
            trace = self._run(chosen, [drawn[at] for at in members], [numbers[at] for at in members])
            for name, values in _scores(trace).items():
                found[name][members] = values
        return found

    def _run(self, scheme: Scheme, drawn: list[Drawn], numbers: list[int]) -> Trace:
        F, G, H, z0 = (np.stack([getattr(one, name) for one in drawn]) for name in ("F", "G", "H", "z0"))
        sensor = None
        if self.noise:
            size = np.max(np.abs(H @ z0[..., None]), axis=-2)
            drawings = [default_rng(self.plants.errors(i)).standard_normal((self.steps, H.shape[-2])) for i in numbers]
            sensor = _Errors(self.noise * size * np.stack(drawings, axis=1))
        bound = self.input_bound
        actuator = None if bound is None else Saturation(-bound, bound)
        plant = LinearPlant(F, G, H)
        return simulate(scheme, plant, z0, self.steps, record="signals", sensor=sensor, actuator=actuator)


@dataclass(frozen=True, eq=False)
class _Errors:
    """A sensor with given errors, shape (steps, plants, p)."""

    errors: Array

    def __call__(self, k: int, y: Array) -> Array:
        return y + self.errors[k]


def _facts(drawn: list[Drawn]) -> dict[str, np.ndarray]:
    rows = []
    for one in drawn:
        with np.errstate(over="ignore"):
            reach, sight = stabilizability(one.F, one.G), detectability(one.F, one.H)
        rows.append((*one.size, one.sampling, spectral_radius(one.F), _margin(reach), _margin(sight)))
    columns = zip(*rows, strict=True)
    return {
        name: np.array(column, about.dtype)
        for (name, about), column in zip(PLANT_VARIABLES.items(), columns, strict=True)
    }


def _margin(modes: Modes) -> float:
    worst = modes.worst
    return np.inf if worst is None else worst[1] / modes.scale


def _scores(trace: Trace) -> dict[str, np.ndarray]:
    first = np.max(np.abs(trace.y[0]), axis=-1)
    first = np.where(first > 0, first, 1.0)
    with np.errstate(over="ignore"):
        sizes = np.max(np.abs(trace.y), axis=-1) / first
    diverged, steps = trace.diverged_at >= 0, len(trace)
    late = sizes >= _SETTLED
    settled = np.where(np.any(late, axis=0), steps - np.argmax(late[::-1], axis=0), 0)
    last = np.max(sizes[-_LAST:], axis=0)
    return {
        "at_rest": (last < _REST) & ~diverged,
        "peak": np.where(diverged, np.inf, np.max(sizes, axis=0)),
        "settled_at": np.where(diverged | (settled >= steps), -1, settled),
        "largest_input": np.where(diverged, np.inf, np.max(np.abs(trace.v), axis=(0, -1))),
        "diverged_at": trace.diverged_at,
        "final_size": np.where(diverged, np.inf, last),
    }


class Results(Protocol):
    """The storage of a campaign's results.

    Examples
    --------
    >>> from rhl.study.backends import in_process
    >>> from rhl.study.ensembles import RandomPlants
    >>> class InMemory(dict):
    ...     def done(self):
    ...         return set(self)
    ...
    ...     def write(self, task, found):
    ...         self[task] = found
    >>> results = InMemory()
    >>> run(Campaign(RandomPlants(seed=1, count=2), (Choice("default"),), steps=40), results, in_process())
    >>> [task.name for task in results]
    ['plants-0', '0-0']
    """

    def done(self) -> set[Task]:
        """Return the names of the completed tasks."""

    def write(self, task: Task, found: dict[str, np.ndarray]) -> None:
        """Store the results of a task."""


@dataclass(frozen=True)
class Backend:
    """The executor of a campaign's tasks.

    Parameters
    ----------
    executor : callable
        Returns a context with an executor; called again after workers were lost.
    ahead : int
        The number of tasks submitted at once.
    lost : tuple of exception types
        The exceptions raised when workers are lost.
    check : callable, optional
        Called every few seconds while no task completes; raises if none will.

    Examples
    --------
    >>> from concurrent.futures import ThreadPoolExecutor
    >>> Backend(lambda: ThreadPoolExecutor(2), ahead=4).ahead
    4
    """

    executor: Callable[[], AbstractContextManager[Executor]]
    ahead: int = 1
    lost: tuple[type[BaseException], ...] = ()
    check: Callable[[], None] = lambda: None


def run(
    campaign: Campaign,
    results: Results,
    backend: Backend,
    *,
    retries: int = 3,
    progress: Callable[[int], None] = lambda done: None,
) -> None:
    """Run all remaining tasks, in any order.

    Parameters
    ----------
    campaign : Campaign
    results : Results
        Only this process stores results, so there are no concurrent writes.
    backend : Backend
    retries : int
        The number of times that submitted tasks are repeated after workers were lost.
    progress : callable
        Called with the number of tasks done.

    Raises
    ------
    LostWorkersError
        If workers are lost after the last retry.
    StoreError
        If the store cannot be written.
    """
    before = results.done()
    tasks = list(campaign.tasks())
    waiting = deque(task for task in tasks if task not in before)
    losses = 0
    progress(len(tasks) - len(waiting))
    while waiting:
        try:
            with backend.executor() as executor:
                _drain(campaign, results, backend, executor, waiting, lambda left: progress(len(tasks) - left))
        except backend.lost as error:
            losses += 1
            if losses > retries:
                raise LostWorkersError(
                    f"workers must stay until their tasks are done, got {losses} losses of one or more "
                    f"({type(error).__name__}); if memory is short, use a smaller chunk or fewer workers"
                ) from error


def _drain(
    campaign: Campaign,
    results: Results,
    backend: Backend,
    executor: Executor,
    waiting: deque[Task],
    tell: Callable[[int], None],
) -> None:
    """Empty the queue; after an early end, submitted tasks without a result are in it again."""
    handed: dict[Future[dict[str, np.ndarray]], Task] = {}
    try:
        while waiting or handed:
            while waiting and len(handed) < backend.ahead:
                handed[executor.submit(campaign.evaluate, waiting[0])] = waiting[0]
                waiting.popleft()
            finished, _ = wait(handed, timeout=5, return_when=FIRST_COMPLETED)
            if not finished:
                backend.check()
            for future in finished:
                results.write(handed[future], future.result())
                del handed[future]
                tell(len(waiting) + len(handed))
    finally:
        waiting.extendleft(handed.values())


def summary(results: Any) -> list[dict[str, Any]]:
    """Return the share at rest, quantiles of the peak, and the share diverged of each scheme of a campaign's Dataset.

    Parameters
    ----------
    results : xarray.Dataset
        With the ``RUN_VARIABLES``; a part of a campaign's is allowed, with both dimensions.

    Returns
    -------
    list of dict
        A row for each scheme: scheme, plants, at_rest, peak_50, peak_90, peak_99, diverged. A quantile is an observed
        peak: the least one that this share of the runs does not exceed.
    """
    rows = []
    for scheme in results.scheme.values:
        of = results.sel(scheme=scheme)
        peaks = np.quantile(of.peak.values, (0.5, 0.9, 0.99), method="inverted_cdf")
        rows.append(
            {
                "scheme": str(scheme),
                "plants": int(of.sizes["plant"]),
                "at_rest": float(np.mean(of.at_rest.values)),
                **{f"peak_{at}": float(peak) for at, peak in zip((50, 90, 99), peaks, strict=True)},
                "diverged": float(np.mean(of.diverged_at.values >= 0)),
            }
        )
    return rows
