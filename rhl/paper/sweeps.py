"""Sweeps of runs for the book's page to explore: precomputed plain data for its sliders."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import product
from typing import Any, Literal

import numpy as np

from rhl._checks import Array
from rhl.controllability import ConstantMixing, candidates, controllability_margin
from rhl.disturbances import GaussianNoise, Saturation
from rhl.errors import DivergedError, InputError
from rhl.model import SignalModel
from rhl.paper.claims.lemma_5 import crossing_pairs, degree_bound, polynomial
from rhl.paper.claims.proximal import tangential_turns
from rhl.paper.published import Experiment, curve, linear_example, robot_arm
from rhl.plants import LinearPlant
from rhl.schedules import PowerDecay

Name = Literal["linear", "robot", "printed"]
NAMES: tuple[Name, ...] = ("linear", "robot", "printed")

_DIGITS = 6
"""Significant digits of written numbers: more than a pixel shows, fewer than a run has."""


@dataclass(frozen=True)
class Setting:
    """Something that a slider changes: ``change`` maps (experiment, value) to the experiment with that value.

    ``key`` is its name in the data, ``words`` its description, ``symbol`` its symbol in the paper. ``values`` are the
    positions of the slider, in order; ``own``, the experiment's own value, is one of them, and ``note`` describes it.
    """

    key: str
    words: str
    symbol: str
    values: tuple[float, ...]
    own: float
    change: Callable[[Experiment, float], Experiment]
    note: str = "as published"

    def __post_init__(self) -> None:
        if self.own not in self.values:
            raise InputError(f"values of {self.key} must hold the experiment's own, {self.own:g}, got {self.values}")


def settings(name: Name) -> tuple[tuple[Setting, ...], ...]:
    """Return the settings in groups: those of one group are swept together, while the others keep their values.

    Examples
    --------
    >>> [[setting.key for setting in group] for group in settings("linear")]
    [['horizon', 'R', 'rate'], ['noise', 'bound'], ['window'], ['mixing'], ['z'], ['radius']]
    """
    if name == "linear":
        return (
            (
                _horizon((1, 2, 3, 4, 5, 7, 10, 15, 20, 30), 20),
                _input_weight(range(2, 9), 1e4),
                _rate(range(5), 100),
            ),
            (_noise((0.0, 0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0)), _bound((0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 40, 80))),
            # With as many transitions as steps, the window never drops data.
            (_window((*range(1, 17), 20, 24, 30, 42), 8),),
            (_mixing(0.0),),
            (_initial(2, "initial state", "z₃(0)", range(-20, 21, 2), -10),),
            (Setting("radius", "spectral radius", "ρ(F)", _steps(0.92, 1.52, 0.02), 1.02, _with_radius),),
        )
    if name == "robot":
        return (
            (_horizon((*range(1, 16), 20, 30, 40), 15),),
            (_input_weight(range(-1, 7), 1e2),),
            (_rate(range(-2, 6), 10),),
            (_window(range(1, 17), 10),),
            (_mixing(0.5),),
            (_initial(0, "initial angle (rad)", "x₁(0)", range(9), 5),),
        )
    if name == "printed":
        return (_mixing(0.0, "no mixing"),), (_horizon((*range(1, 16), 20, 30, 40), 15),)
    raise InputError(f"name must be one of {', '.join(NAMES)}, got {name!r}")


def experiment(name: Name) -> Experiment:
    """Return the experiment that the settings of this name change.

    "linear" and "robot" are those behind the published curves; "printed" is the robot arm as the text prints it, with
    its other coefficient and without mixing.
    """
    if name == "printed":
        arm = robot_arm(printed=True)
        return replace(arm, scheme=replace(arm.scheme, mixing=ConstantMixing(0.0)))
    return linear_example() if name == "linear" else robot_arm()


def signals(name: Name) -> tuple[dict[str, Any], ...]:
    """Return the panels to draw: title, whether the axis is logarithmic, and the curves with their published ones."""
    margins = {"margin_lifted": "lifted", "margin_augmented": "augmented"}
    last = (
        _panel("terminal weight Γ/ε", {"weight": "Γ/ε"}, log=True),
        _panel("controllability margin", margins, log=True),
    )
    if name == "linear":
        return (
            _panel("output y", {"y1": "y"}, {"y1": curve("linear_y")}),
            _panel("input v", {"v1": "v"}, {"v1": curve("linear_u")}),
            last[0] | {"published": {"weight": plain(curve("linear_gamma_over_eps"))}},
            last[1],
        )
    return (
        _panel("angle x₁ (rad)", {"y1": "x₁"}, {"y1": curve("robot_x1")}),
        _panel("velocity x₂ (rad/s)", {"y2": "x₂"}, {"y2": curve("robot_x2")}),
        _panel("current x₃ (A)", {"y3": "x₃"}, {"y3": curve("robot_x3")}),
        _panel("input v (V)", {"v1": "v"}),
        *last,
    )


def record(changed: Experiment) -> dict[str, Any]:
    """Run an experiment and return its curves, each a list over k; a run that diverges ends there.

    Keys: ``y1``, ..., ``v1``, ``weight``, ``margin_lifted``, ``margin_augmented``; and ``diverged``: None, or the k at
    which the run left the range of floating-point numbers.

    Examples
    --------
    >>> run = record(experiment("linear"))
    >>> len(run["y1"]), run["y1"][0], run["diverged"]
    (42, -9.9, None)
    """
    diverged = None
    try:
        trace = changed.run()
    except DivergedError as error:
        diverged = error.k
        if error.trace is None:
            return {"diverged": diverged}
        trace = error.trace
    columns = trace.columns()
    curves = {key: columns[key] for key in columns if key[:-1] in ("y", "v") or key == "weight"}
    curves |= {"margin_lifted": trace.margin_lifted, "margin_augmented": trace.margin_augmented}
    return {key: plain(values) for key, values in curves.items()} | {"diverged": diverged}


def sweep(name: Name, group: tuple[Setting, ...]) -> Iterator[dict[str, Any]]:
    """Yield ``record`` of the experiment at all combinations of a group's values, the last setting changing fastest.

    ``group`` is one of ``settings(name)``.
    """
    for values in product(*(setting.values for setting in group)):
        changed = experiment(name)
        for setting, value in zip(group, values, strict=True):
            changed = setting.change(changed, value)
        yield record(changed)


def spiral(steps: int = 1_000_000, points: int = 500) -> dict[str, Any]:
    """Return Lemma 4's spiral, K = ``steps``, for several rates at which its directions become tangential.

    Keys: ``k``, geometrically spaced and at most ``points`` of them, ``exponents`` e in delta_k = k^-e / 2, ``own``
    (the counterexample's exponent), and for each exponent ``norm`` and ``angle`` of the iterates at these k.

    Examples
    --------
    >>> data = spiral(steps=100, points=10)
    >>> data["k"][-1], data["norm"][0][0], len(data["angle"])
    (100, 1.0, 10)
    """
    k = np.unique(np.concatenate([[0], np.geomspace(1, steps, points)]).round().astype(int))
    exponents = [0.6, 0.65, 0.7, 0.75, 0.8, 0.9, 1.0, 1.1, 1.25, 1.5]
    paths = [tangential_turns(steps, exponent) for exponent in exponents]
    return {
        "k": k.tolist(),
        "exponents": exponents,
        "own": exponents.index(0.75),
        "norm": [plain(norm[k]) for norm, _ in paths],
        "angle": [plain(angle[k]) for _, angle in paths],
    }


def mixtures(orders: Iterable[int] = (2, 3, 4, 5)) -> dict[str, Any]:
    """Return the margin of Lemma 5's mixtures over lambda, for pairs with the largest number of bad lambdas.

    Keys: ``orders``, the n of each pair; and for each: ``lam`` (equidistant, the bad ones, and some next to them),
    ``margin``, ``bad`` (the positions of the roots in ``lam``, exact to float64), ``candidates`` (the paper's) with
    their ``found`` margins, ``enough``, n(n+1)/2.

    Examples
    --------
    >>> data = mixtures([2])
    >>> len(data["bad"][0]), data["enough"]
    (3, [3])
    """
    import sympy as sp  # imported here, because loading it takes long

    orders = list(orders)
    columns: dict[str, list[Any]] = {"lam": [], "margin": [], "bad": [], "candidates": [], "found": []}
    for n in orders:
        pairs = crossing_pairs(n, [Fraction(0), *(Fraction(1, 20 + i) for i in range(n - 1))])
        exact = sp.roots(polynomial(*pairs, columns=range(n)))
        bad = sorted(float(root) for root in exact if 0 <= root < 1)
        beside = [root + side * 10.0**power for root in bad for side in (-1, 1) for power in (-5, -4, -3)]
        lam = np.unique([*np.linspace(0, 1, 251), *bad, *(share for share in beside if 0 <= share <= 1)])
        unseen, seen = (SignalModel(np.array(A, dtype=float), np.array(B, dtype=float)) for A, B in pairs)
        columns["lam"].append([float(f"{share:.12g}") for share in lam])
        columns["margin"].append(plain(controllability_margin(unseen.mix(seen, lam))))
        columns["bad"].append(np.searchsorted(lam, bad).tolist())
        columns["candidates"].append(plain(candidates(n, 0.9)))
        columns["found"].append(plain(controllability_margin(unseen.mix(seen, candidates(n, 0.9)))))
    return {"orders": orders, "enough": [degree_bound(n) for n in orders], **columns}


def files() -> Iterator[tuple[str, str]]:
    """Yield the name, without its ending, and the JSON of every file that the page to explore loads.

    A sweep of several settings is split along the first of them, so that a page fetches only the runs that it shows.
    """
    for name in NAMES:
        example, groups = experiment(name), settings(name)
        about: dict[str, Any] = {
            "steps": example.steps,
            "groups": [[_described(setting) for setting in group] for group in groups],
            "panels": signals(name),
            "own": record(example),
        }
        for i, group in enumerate(groups):
            runs = list(sweep(name, group))
            if len(group) > 2:
                about["peaks"] = peaks(runs)
            parts = len(group[0].values) if len(group) > 1 else 1
            share = len(runs) // parts
            for part in range(parts):
                yield f"{name}-{i}-{part}", to_json({"runs": runs[part * share : (part + 1) * share]})
        yield name, to_json(about)
    yield "spiral", to_json(spiral())
    yield "mixtures", to_json(mixtures())


def peaks(runs: Iterable[Mapping[str, Any]]) -> list[float | None]:
    """Return the largest size of the first output of each run; None if the run diverged.

    Examples
    --------
    >>> peaks([{"y1": [1.0, -2.5], "diverged": None}, {"y1": [1.0], "diverged": 1}])
    [2.5, None]
    """
    return [max(map(abs, run["y1"])) if run["diverged"] is None else None for run in runs]


def _described(setting: Setting) -> dict[str, Any]:
    return {
        "key": setting.key,
        "words": setting.words,
        "symbol": setting.symbol,
        "values": list(setting.values),
        "own": setting.values.index(setting.own),
        "note": setting.note,
    }


def _panel(
    title: str, curves: Mapping[str, str], published: Mapping[str, Array] | None = None, log: bool = False
) -> dict[str, Any]:
    circles = {key: plain(values) for key, values in (published or {}).items()}
    return {"title": title, "curves": dict(curves), "published": circles, "log": log}


def plain(values: Array) -> list[float | None]:
    """Return numbers for JSON: rounded, and None for non-finite ones."""
    return [float(f"{value:.{_DIGITS}g}") if math.isfinite(value) else None for value in values.tolist()]


def to_json(data: Mapping[str, Any]) -> str:
    """Return data as JSON without spaces."""
    return json.dumps(data, ensure_ascii=False, allow_nan=False, separators=(",", ":"))


def _steps(first: float, last: float, width: float) -> tuple[float, ...]:
    return tuple(round(float(value), 10) for value in np.arange(first, last + width / 2, width))


def _horizon(values: Iterable[int], own: int) -> Setting:
    return Setting(
        "horizon", "horizon", "N", tuple(values), own, lambda e, value: _with_controller(e, horizon=int(value))
    )


def _input_weight(powers: Iterable[int], own: float) -> Setting:
    values = tuple(10.0**power for power in powers)
    return Setting("R", "input weight", "R", values, own, lambda e, value: _with_controller(e, R=value))


def _rate(powers: Iterable[int], own: float) -> Setting:
    values = tuple(10.0**power for power in powers)
    return Setting(
        "rate", "rate of ε", "η", values, own, lambda e, value: _with_controller(e, epsilon=PowerDecay(value))
    )


def _window(values: Iterable[int], own: int) -> Setting:
    def change(e: Experiment, value: float) -> Experiment:
        estimator: Any = e.scheme.estimator
        return replace(e, scheme=replace(e.scheme, estimator=replace(estimator, window=int(value))))

    return Setting("window", "estimator's window", "N̄", tuple(values), own, change)


def _noise(values: Iterable[float]) -> Setting:
    return Setting(
        "noise",
        "standard deviation of the sensor's errors",
        "σ",
        tuple(values),
        0.0,
        lambda e, value: replace(e, sensor=GaussianNoise(value, 0)),
        "none",
    )


def _bound(values: Iterable[float]) -> Setting:
    values = tuple(values)
    return Setting(
        "bound",
        "largest input of the actuator",
        "v̄",
        values,
        values[-1],
        lambda e, value: replace(e, actuator=Saturation(-value, value)),
        "never reached",
    )


def _mixing(own: float, note: str = "as published") -> Setting:
    def change(e: Experiment, value: float) -> Experiment:
        return replace(e, scheme=replace(e.scheme, mixing=ConstantMixing(value)))

    return Setting("mixing", "mixing", "λ", _steps(0.0, 0.95, 0.05), own, change, note)


def _initial(entry: int, words: str, symbol: str, values: Iterable[int], own: float) -> Setting:
    def change(e: Experiment, value: float) -> Experiment:
        z0 = e.z0.copy()
        z0[entry] = value
        return replace(e, z0=z0)

    return Setting("z", words, symbol, tuple(values), own, change)


def _with_controller(e: Experiment, **changes: Any) -> Experiment:
    return replace(e, scheme=replace(e.scheme, controller=replace(e.scheme.controller, **changes)))


def _with_radius(e: Experiment, value: float) -> Experiment:
    """Replace the largest eigenvalue of the linear example's plant by the value."""
    assert isinstance(e.plant, LinearPlant)
    F = e.plant.F.copy()
    F[1, 1] = value  # F is triangular
    return replace(e, plant=LinearPlant(F, e.plant.G, e.plant.H))
