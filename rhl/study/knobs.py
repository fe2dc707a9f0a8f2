"""Remedies for symptoms of a run: each one is tested on many plants that show the symptom."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rhl._checks import Array, instance, integer
from rhl.disturbances import GaussianNoise
from rhl.model import SignalModel
from rhl.plants.analysis import rough_model
from rhl.plants.linear import LinearPlant
from rhl.scheme import Scheme, default_scheme, window_scheme
from rhl.simulation import simulate
from rhl.study.ensembles import RandomPlants

# Outputs are at rest if the last twenty are below this share of the largest of y(0), or three deviations of noise.
_REST, _LAST, _DEVIATIONS = 0.05, 20, 3.0
# The sensor errors relative to y(0), for remedies against noise.
_NOISE = 0.01


@dataclass(frozen=True, eq=False)
class Plants:
    """Plants of one size, as a batch: ``plant``, their initial states z0, and a bound on their observability index.

    The largest entry of each y(0) is one.
    """

    plant: LinearPlant
    z0: Array
    order: int

    @classmethod
    def drawn(cls, ensemble: RandomPlants) -> Plants:
        """Collect all plants of an ensemble, which must have one size."""
        every = [ensemble.draw(i) for i in range(len(ensemble))]
        F, G, H, z0 = (np.stack([getattr(one, name) for one in every]) for name in ("F", "G", "H", "z0"))
        first = np.max(np.abs(np.einsum("...pn,...n->...p", H, z0)), axis=-1)
        return cls(LinearPlant(F, G, H / first[:, None, None]), z0, every[0].bound)

    def some(self, which: np.ndarray) -> Plants:
        """Return the members that a mask marks."""
        plant = LinearPlant(*(M[which] for M in (self.plant.F, self.plant.G, self.plant.H)))
        return Plants(plant, self.z0[which], self.order)


@dataclass(frozen=True, eq=False)
class Outcome:
    """The outcome of runs: the largest output relative to y(0), and whether they ended at rest.

    Examples
    --------
    >>> plants = Plants.drawn(RandomPlants(seed=1, count=3))
    >>> outcome(plants, KNOBS[0].turned, steps=40).peak.shape
    (3,)
    """

    peak: Array
    at_rest: np.ndarray


# A scheme, and the disturbances between it and the plants.
Setting = Callable[[Plants], tuple[Scheme, dict[str, Any]]]


@dataclass(frozen=True)
class Knob:
    """A remedy: its symptom, the setting of the runs, and the changed setting.

    Attributes
    ----------
    symptom, turn : str
        Descriptions; ``turn`` names the changed key of the file.
    start, turned : callable
        Functions from plants to a scheme and the keywords of ``simulate``.
    shows : callable
        From an outcome, the members that show the symptom; those that no longer do count as improved.
    longer : int
        The factor by which the second run is longer.

    Examples
    --------
    >>> KNOBS[0].symptom, KNOBS[0].turn
    ('sections without order: not at rest', 'order in their place')
    """

    symptom: str
    turn: str
    start: Setting
    turned: Setting
    shows: Callable[[Outcome], np.ndarray]
    longer: int = 1


@dataclass(frozen=True)
class Tried:
    """The effect of a remedy: the number of plants, of those with the symptom, and of those without it afterwards.

    ``lower`` counts lower peaks; ``ratio`` is the geometric mean of the peaks after the change over those before.

    Examples
    --------
    >>> found = tried(KNOBS[0], Plants.drawn(RandomPlants(seed=1, count=3)), steps=40)
    >>> found.plants, found.mended <= found.shown
    (3, True)
    """

    plants: int
    shown: int
    mended: int
    lower: int
    ratio: float


def outcome(plants: Plants, setting: Setting, steps: int) -> Outcome:
    """Run plants and evaluate them; a member that diverges has an infinite peak."""
    scheme, errs = setting(plants)
    trace = simulate(scheme, plants.plant, plants.z0, steps, record="signals", **errs)
    size = np.max(np.abs(trace.y), axis=-1)
    lost = trace.diverged_at >= 0
    limit = _REST + (_DEVIATIONS * _NOISE if "sensor" in errs else 0.0)
    end = np.where(lost, np.inf, np.max(size[-_LAST:], axis=0))
    return Outcome(np.where(lost, np.inf, np.max(size, axis=0)), end < limit)


def tried(knob: Knob, plants: Plants, steps: int = 200) -> Tried:
    """Run plants, and rerun those with the symptom under the changed setting."""
    instance("knob", knob, Knob)
    integer("steps", steps, _LAST)
    before = outcome(plants, knob.start, steps)
    shown = knob.shows(before)
    count = int(np.sum(shown))
    if count == 0:
        return Tried(len(plants.z0), 0, 0, 0, 1.0)
    after = outcome(plants.some(shown), knob.turned, knob.longer * steps)
    peaks = np.minimum(before.peak[shown], 1e12), np.minimum(after.peak, 1e12)
    ratio = float(np.exp(np.mean(np.log(peaks[1] / peaks[0]))))
    return Tried(
        len(plants.z0), count, int(np.sum(~knob.shows(after))), int(np.sum(after.peak < before.peak[shown])), ratio
    )


def _default(plants: Plants, more: int = 0, **settings: Any) -> Scheme:
    return default_scheme(plants.plant.p, plants.plant.q, plants.order + more, **settings)


def rough(error: float, seed: int = 0) -> Setting:
    """Return the setting that starts from a model with a relative error ``error`` in each entry of its matrices."""

    def begin(plants: Plants) -> tuple[Scheme, dict[str, Any]]:
        rng, models = np.random.default_rng(seed), []
        for parts in zip(plants.plant.F, plants.plant.G, plants.plant.H, strict=True):
            believed = LinearPlant(*(M * (1 + error * rng.standard_normal(M.shape)) for M in parts))
            models.append(rough_model(believed, plants.order, plants.order))
        model = SignalModel(np.stack([of.A for of in models]), np.stack([of.B for of in models]))
        scheme = _default(plants)
        assert scheme.units is not None
        return replace(scheme, initial_model=model, units=replace(scheme.units, model_in_sizes=False, caution=0.0)), {}

    return begin


def _noisy(told: bool) -> Setting:
    def begin(plants: Plants) -> tuple[Scheme, dict[str, Any]]:
        return _default(plants, noise=_NOISE if told else 0.0), {"sensor": GaussianNoise(_NOISE, seed=1)}

    return begin


def _plain(plants: Plants) -> tuple[Scheme, dict[str, Any]]:
    return _default(plants), {}


def _high(of: Outcome) -> np.ndarray:
    return of.peak > 100.0


def _restless(of: Outcome) -> np.ndarray:
    return ~of.at_rest


def _window(plants: Plants) -> tuple[Scheme, dict[str, Any]]:
    return window_scheme(plants.plant.p, plants.plant.q, plants.order), {}


def _longer(plants: Plants) -> tuple[Scheme, dict[str, Any]]:
    scheme = _default(plants)
    return replace(scheme, controller=replace(scheme.controller, horizon=2 * scheme.controller.horizon)), {}


KNOBS = (
    Knob("sections without order: not at rest", "order in their place", _window, _plain, _restless),
    Knob("sections without order: peak above 100", "order in their place", _window, _plain, _high),
    Knob("peak above 100", "a [rough] model, right to a tenth", _plain, rough(0.1), _high),
    Knob("peak above 100", "a [rough] model, wrong by half", _plain, rough(0.5), _high),
    Knob("peak above 100", "input_size = 0.01", _plain, lambda of: (_default(of, inputs=0.01), {}), _high),
    Knob(
        "peak above 100, order two above the index",
        "order = the index",
        lambda of: (_default(of, 2), {}),
        _plain,
        _high,
    ),
    Knob("not at rest yet", "three times the steps", _plain, _plain, _restless, longer=3),
    Knob("not at rest yet", "twice the horizon", _plain, _longer, _restless),
    Knob("sensors err by 1 %: not at rest", "noise = 0.01", _noisy(False), _noisy(True), _restless),
)
