"""Plain data for the page to explore, in addition to the simulations: convergence rates and benchmark plants."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from rhl._checks import Array
from rhl.disturbances import Disturbances
from rhl.errors import DivergedError
from rhl.horizon import solve
from rhl.model import SignalModel
from rhl.paper.sweeps import plain, to_json
from rhl.plants.benchmarks import benchmark, names
from rhl.problems import V1
from rhl.schedules import PowerDecay
from rhl.scheme import Scheme, default_scheme, window_scheme
from rhl.simulation import simulate
from rhl.study.rivals import known_plant, pose

# The rate: x+ = a x + u with a known model, and Q small so that the stage costs of a short horizon do not stabilise it.
GROWTHS = (1.1, 1.2, 1.4, 1.8)
HORIZONS = (1, 2, 3, 4, 6, 9)
SCHEDULES = (PowerDecay(10, 0.5), PowerDecay(10, 1), PowerDecay(10, 2), PowerDecay(1000, 1))
_Q, _R, _QN = 0.02, 1.0, 1.0
_PACED = 400

NOISES = (0.0, 0.01, 0.05)
_RUN = 100
_LARGEST = 10


def pace() -> dict[str, Any]:
    r"""Return the size of the state over k, for scalar plants x+ = ax + u whose model is known.

    Keys: ``growths`` a, ``horizons`` N, ``schedules`` in words, ``k`` (not all of them), ``epsilon``, one list over k
    for each schedule; ``size``, |x(k)| by a, schedule and N; ``level``, by a and N: the terminal weight
    :math:`\Gamma/\epsilon` at which |x| stays constant, so that |x(k)| tends to the root of level times epsilon(k);
    None if the stage costs alone stabilise the plant.

    Examples
    --------
    >>> data = pace()
    >>> [level is None for level in data["level"][0]]
    [False, False, False, False, True, True]
    """
    kept = np.unique(np.geomspace(1, _PACED, 60).round().astype(int)) - 1
    a = np.array(GROWTHS)[:, None, None, None]
    model = SignalModel(a, np.ones_like(a))
    sizes = np.empty((_PACED, len(GROWTHS), len(SCHEDULES), len(HORIZONS)))
    for i, horizon in enumerate(HORIZONS):
        x = np.ones((len(GROWTHS), len(SCHEDULES)))
        for k in range(_PACED):
            sizes[k, :, :, i] = np.abs(x)
            epsilon = np.array([schedule(k) for schedule in SCHEDULES])
            plan = solve(V1(model, _Q, _R, _QN, x**2 / epsilon, horizon), x[..., None])
            x = a[..., 0, 0] * x + plan.u[..., 0, 0]
    return {
        "growths": list(GROWTHS),
        "horizons": list(HORIZONS),
        "schedules": [_in_words(schedule) for schedule in SCHEDULES],
        "k": kept.tolist(),
        "epsilon": [plain(np.array([schedule(int(k)) for k in kept])) for schedule in SCHEDULES],
        "size": [
            [[plain(sizes[kept, i, j, n]) for n in range(len(HORIZONS))] for j in range(len(SCHEDULES))]
            for i in range(len(GROWTHS))
        ],
        "level": [[level(growth, horizon) for horizon in HORIZONS] for growth in GROWTHS],
    }


def level(growth: float, horizon: int) -> float | None:
    """Return the terminal weight at which the plan keeps the size of x in x+ = ax + u, None if there is none.

    The first input leaves aR/(R + P) of x, where P is the weight of x(k+1) in the cost to go; that is one where
    P = R (a - 1). Each earlier stage of the Riccati recursion is then inverted.

    Examples
    --------
    >>> round(level(1.2, 1), 12)  # R (a - 1) / QN
    0.2
    """
    P = _R * (growth - 1)
    for _ in range(horizon - 1):
        P = (P - _Q) * _R / (growth**2 * _R - (P - _Q))
        if P <= 0:
            return None
    return P / _QN


def _in_words(schedule: PowerDecay) -> str:
    power = "" if schedule.power == 1 else f" to the power {schedule.power:g}"
    return f"1/(1 + {schedule.rate:g}k){power}"


def plant_names() -> tuple[str, ...]:
    """Return the benchmark plants of the book's comparison page, up to order ten."""
    return names(_LARGEST)


def plant(name: str) -> dict[str, Any]:
    """Return runs on a benchmark plant: the largest output at every k, each output relative to its first size.

    Keys: ``title``, ``order``, ``radius`` (the spectral radius); ``known`` (the regulator that knows the plant),
    ``default`` and ``window`` (the schemes), each one list over k for each of ``NOISES``, the standard deviation of the
    sensor's errors relative to the first outputs. A list ends when the run leaves the range of float64.

    Examples
    --------
    >>> run = plant("maglev")
    >>> len(run["default"]), run["default"][0][0], run["default"][0][-1] < 1e-10
    (3, 1.0, True)
    """
    chosen = benchmark(name)
    sampled, order = chosen.sampled(), chosen.order()
    found: dict[str, list[list[float | None]]] = {"known": [], "default": [], "window": []}
    for noise in NOISES:
        task = pose(sampled, chosen.z0, order, _RUN, noise=noise)
        sizes, errors = task.output_sizes, task.errors

        def sensor(k: int, y: Array, errors: Array = errors) -> Array:
            return np.asarray(y + errors[k])

        def outputs(scheme: Scheme, sensor: Disturbances = sensor) -> Array:
            try:
                trace = simulate(scheme, sampled, chosen.z0, _RUN, sensor=sensor)
            except DivergedError as error:
                if error.trace is None:
                    return sampled.output(chosen.z0[None])
                trace = error.trace
            return sampled.output(trace.z)

        runs = {
            "known": known_plant(task).y,
            "default": outputs(default_scheme(sampled.p, sampled.q, order, noise=noise * sizes)),
            "window": outputs(window_scheme(sampled.p, sampled.q, order)),
        }
        for key, y in runs.items():
            with np.errstate(over="ignore"):
                found[key].append(plain(np.max(np.abs(y) / sizes, axis=1)))
    radius = float(np.max(np.abs(np.linalg.eigvals(sampled.F))))
    assert math.isfinite(radius)
    return {
        "title": chosen.title,
        "order": sampled.n,
        "radius": float(f"{radius:.4g}"),
        "noises": list(NOISES),
        **found,
    }


def files() -> Iterator[tuple[str, str]]:
    """Yield the name, without its ending, and the JSON of every file."""
    yield "pace", to_json(pace())
    yield (
        "plants",
        to_json(
            {"names": {name: benchmark(name).title for name in plant_names()}, "steps": _RUN, "noises": list(NOISES)}
        ),
    )
    for name in plant_names():
        yield f"plant-{name}", to_json(plant(name))
