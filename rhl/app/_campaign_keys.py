"""The form of a campaign's TOML file: its keys, their allowed values and the campaign that they describe."""

from __future__ import annotations

import os
from collections.abc import Iterator
from itertools import product
from math import prod
from typing import Any, Self

from rhl.app import _limits
from rhl.app._keys import (
    FLAG,
    LINE,
    NOT_NEGATIVE,
    POSITIVE,
    SIZE,
    TEXT,
    Kind,
    Section,
    integer,
    key,
    list_of,
    read_toml,
    table_of,
)
from rhl.errors import InputError
from rhl.study.campaign import Campaign
from rhl.study.choices import LONGEST, Choice
from rhl.study.ensembles import BenchmarkPlants, Ensemble, RandomPlants

_SIZES = list_of(SIZE)
_NUMBER: dict[str, Any] = {"type": "number"}
_FACTOR = _NUMBER | {"minimum": 1, "maximum": 100}
# The upper limits are far above any use; they keep the entries of plants and signals in the range of float64.
_RADII = list_of({**POSITIVE, "maximum": 1e100})
_RATES = list_of(_NUMBER | {"minimum": -1e6, "maximum": 1e6})
_SECONDS: Kind = {**POSITIVE, "maximum": 1e9}
_CONDITION = _NUMBER | {"minimum": 1, "maximum": 1e100}
_DECADES: Kind = {**NOT_NEGATIVE, "maximum": 100}
_NOISE: Kind = {**NOT_NEGATIVE, "maximum": 1e100}
_WINDOW: Kind = {**POSITIVE, "maximum": LONGEST}
# With a growth of this many powers of e from sample to sample, entries reach about 1e100.
_GROWTH = 230
_LABEL: Kind = {**LINE, "maxLength": 200}


def _swept(what: str, kind: Any, default: Any = None) -> Any:
    """Declare a setting of a scheme that may also be a list; each entry of a list makes a scheme."""
    return key(f"{what}, or a list of such", kind, list_of(kind), default=default)


class RandomSection(Section):
    """[plants] with kind = "random": random linear plants in discrete time."""

    kind = key('"random"')
    count = key(
        "{}, how many plants for each combination of the sizes; there are at most 1000 schemes, and plants times "
        "schemes are at most 20 million",
        integer(1, 10_000_000),
    )
    n = key("{}, the order, or a list of such", SIZE, _SIZES, default=4)
    p = key("{}, the number of outputs, or a list of such", SIZE, _SIZES, default=1)
    q = key("{}, the number of inputs, or a list of such", SIZE, _SIZES, default=1)
    radius = key(
        "a list of two positive numbers of at most 1e100: the lowest and the highest spectral radius of the modes that "
        "are not hidden, uniform in between",
        _RADII,
        default=[0.5, 1.2],
    )
    hidden = key(
        "{}, how many of the n modes are hidden: stable, and either not reached by inputs or not seen by outputs",
        integer(0, 99),
        default=0,
    )
    conditioning = key(
        "a number from 1 to 1e100, the largest condition number of the states' coordinates, log-uniform up to it",
        _CONDITION,
        default=1.0,
    )
    output_decades = key(
        "a number from 0 to 100: each output is multiplied by ten to a power uniform between minus and plus this",
        _DECADES,
        default=0.0,
    )
    input_decades = key("a number from 0 to 100: the same for each input's effect", _DECADES, default=0.0)

    def plants(self, seed: int) -> Ensemble:
        return RandomPlants(seed, self.count, radius=_pair("radius", self.radius), **_shared(self))


def _shared(section: Any) -> dict[str, Any]:
    sizes = {name: tuple(_each(getattr(section, name))) for name in ("n", "p", "q")}
    named = ("hidden", "conditioning", "output_decades", "input_decades")
    return sizes | {name: getattr(section, name) for name in named}


class SampledSection(Section):
    """[plants] with kind = "random-continuous": random linear plants in continuous time, sampled."""

    kind = key('"random-continuous"')
    count = key("{}, how many plants for each combination of the sizes and sampling", integer(1, 10_000_000))
    n, p, q = (RandomSection.keys()[name] for name in ("n", "p", "q"))
    growth = key(
        "a list of two numbers from -1e6 to 1e6: the lowest and the highest rate of growth in 1/s, the largest real "
        "part of the eigenvalues that are not hidden, uniform in between",
        _RATES,
        default=[-0.5, 0.5],
    )
    sampling = key(
        "a positive number of at most 1e9, the seconds between samples, or a list of such",
        _SECONDS,
        list_of(_SECONDS),
        default=0.1,
    )
    hidden, conditioning, output_decades, input_decades = (
        RandomSection.keys()[name] for name in ("hidden", "conditioning", "output_decades", "input_decades")
    )

    def plants(self, seed: int) -> Ensemble:
        growth, sampling = _pair("growth", self.growth), tuple(_each(self.sampling))
        longest = max(sampling, default=0.0)
        if growth[1] * longest > _GROWTH:
            raise InputError(
                f"sampling must be at most {_GROWTH} / the highest growth, got {longest:g} and growth {growth[1]:g}; "
                "sample faster, or lower growth"
            )
        return RandomPlants(seed, self.count, growth=growth, sampling=sampling, **_shared(self))


class BenchmarkSection(Section):
    """[plants] with kind = "benchmarks": the COMPleib collection's."""

    kind = key('"benchmarks"')
    names = key("a list of names such as ac1; all up to order ten if left out", list_of(TEXT), default=[])
    sampling = key(
        "a positive number of at most 1e9, the seconds between samples, or a list of such",
        _SECONDS,
        list_of(_SECONDS),
        default=0.1,
    )

    def plants(self, seed: int) -> Ensemble:
        return BenchmarkPlants(tuple(self.names), tuple(_each(self.sampling)), seed)


class SchemeSection(Section):
    """[[schemes]], one for each scheme: where settings are lists, one for each combination of their entries."""

    base = key('"default" or "window": rhl.default_scheme or rhl.window_scheme')
    label = key(
        "{}, its name in the results; if left out, base and the given settings",
        _LABEL,
        default=None,
    )
    order_factor = _swept(
        "a number from 1 to 100: the scheme's order is the bound on the observability index times this, rounded up",
        _FACTOR,
        1.0,
    )
    inputs = _swept("{}, the size of the first inputs of the default scheme", POSITIVE)
    R = _swept("{}, the weight of inputs", POSITIVE)
    eps_rate = _swept("{}, in eps(k) = 1/(1 + eps_rate k)", POSITIVE)
    weight = _swept("{}, the weight that keeps the estimate near the previous one", POSITIVE)
    horizon = _swept("{}, N", integer(1, 10_000))
    model_delay = _swept("0 (control with the estimate of this step) or 1 (of the step before)", integer(0, 1))
    memory = key(
        '"growing" (every measured transition is fitted) or "window" (the last ones; with the default scheme, units '
        "must be false)",
        default=None,
    )
    window = _swept(
        f"a positive number of at most {LONGEST}, the transitions in a window in multiples of the scheme's order",
        _WINDOW,
    )
    units = key("{}: that the default scheme's weights count signals in running units", FLAG, default=None)

    def count(self) -> int:
        """Return the number of combinations."""
        return prod(len(value) for value in self.given.values() if isinstance(value, list))

    def choices(self) -> list[Choice]:
        """Return the schemes, one for each combination of the lists' entries."""
        swept = [name for name, value in self.given.items() if isinstance(value, list)]
        for name in swept:
            if not self.given[name]:
                raise InputError(f"{name} must have at least one entry, got an empty list")
        fixed = {name: value for name, value in self.given.items() if name not in swept and name != "label"}
        found = []
        for values in product(*(self.given[name] for name in swept)):
            varied = dict(zip(swept, values, strict=True))
            told = varied if self.label is not None else {**fixed, **varied}
            start = self.base if self.label is None else self.label
            settings = ", ".join(f"{name} = {_said(value)}" for name, value in told.items() if name != "base")
            found.append(Choice(f"{start}, {settings}" if settings else start, **fixed, **varied))
        return found


class CampaignFile(Section):
    """A whole file."""

    name = key("{}, the name of the campaign, without control characters", LINE)
    seed = key("{}, from which plants and errors are drawn", integer(0, 2**32 - 1))
    steps = key("{}, the number of rows k = 0 .. steps-1 of each run", integer(20, 100_000), default=200)
    noise = key(
        "a number from 0 to 1e100, the standard deviation of the sensors' normal errors, relative to the largest of "
        "y(0)",
        _NOISE,
        default=0.0,
    )
    input_bound = key("{}: inputs are clipped to plus and minus this; no bound if left out", POSITIVE, default=None)
    chunk = key(
        "{}, the number of plants in a task and in a chunk of the store; results do not depend on it; a task holds at "
        "most 2 GB, and there are at most 100000 tasks",
        integer(1, 1_000_000),
        default=250,
    )
    plants = key("{}", table_of(RandomSection, SampledSection, BenchmarkSection))
    schemes = key("a list of at least one section [[schemes]]", list_of({"type": "object"}))

    @classmethod
    def read(cls, at: str, table: dict[Any, Any], wrong: list[tuple[bool, str]], changes: bool = False) -> Self:
        """Read a file; ``schemes`` is the one key that is a list of sections."""
        given = table.get("schemes")
        sections = isinstance(given, list) and all(isinstance(one, dict) for one in given)
        # The check of the key refuses anything but a list of sections; the sections are read here.
        found = super().read(at, table | {"schemes": []} if sections else table, wrong, changes)
        if not sections:
            return found
        if not given:
            wrong.append((False, f"schemes must be {cls.keys()['schemes']['description']}, got []"))
        schemes = [SchemeSection.read(f"schemes[{i + 1}].", one, wrong) for i, one in enumerate(given or ())]
        return cls(found.given | {"schemes": schemes})

    def campaign(self) -> Campaign:
        """Build the campaign; InputError, which begins with the key, if numbers do not fit each other."""
        try:
            plants = self.plants.plants(self.seed)
        except InputError as error:
            raise InputError(f"plants.{error}") from None
        _limits.schemes([section.count() for section in self.schemes])
        choices: list[Choice] = []
        for i, section in enumerate(self.schemes):
            try:
                choices += section.choices()
            except InputError as error:
                raise InputError(f"schemes[{i + 1}].{error}") from None
        _limits.campaign(plants, choices, self.steps, self.chunk)
        return Campaign(plants, tuple(choices), self.steps, self.noise, self.input_bound, self.chunk)


def load(path: str | os.PathLike[str]) -> tuple[CampaignFile, str, dict[str, Any]]:
    """Read a campaign's TOML file; return its contents, its text and its settings as written.

    InputError if the file is missing or not TOML, or a key is missing, unknown or has a wrong value.
    """
    text, data = read_toml(path)
    return parse(data), text, data


def parse(data: dict[str, Any]) -> CampaignFile:
    """Check a campaign's description as a dictionary; InputError names the first key that does not fit."""
    wrong: list[tuple[bool, str]] = []
    found = CampaignFile.read("", data, wrong)
    # An unknown key is often a misspelt required key, so its message is the more helpful one.
    for _, sentence in sorted(wrong, key=lambda entry: not entry[0]):
        raise InputError(sentence)
    return found


def keys() -> Iterator[tuple[str, str]]:
    """Yield every key with its description, in the order of the file, for the help and the book's reference.

    The description of a key that only some kinds of plants have names these kinds.
    """
    for name, about in CampaignFile.keys().items():
        kinds = (SchemeSection,) if name == "schemes" else about.get("sections", ())
        if not kinds:
            yield name, _told(about)
        found: dict[tuple[str, str], list[str]] = {}
        for kind in kinds:
            for inner, one in kind.keys().items():
                found.setdefault((inner, "" if inner == "kind" else _told(one)), []).append(kind.tag())
        for (inner, what), tags in found.items():
            of = f" (kind = {' or '.join(tags)})" if len(tags) < len(kinds) else ""
            yield f"{name}.{inner}", f"{what}{of}" if what else " or ".join(tags)


def _told(about: Any) -> str:
    what = str(about["description"])
    if "default" not in about or "if left out" in what:
        return what
    default = about["default"]
    return f"{what}; may be left out" if default in (None, []) else f"{what}; {default} if left out"


def _each(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def _pair(name: str, value: list[float]) -> tuple[float, float]:
    if len(value) != 2:
        raise InputError(f"{name} must be a list of two numbers, got {len(value)}")
    return value[0], value[1]


def _said(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return f"{value:g}" if isinstance(value, float) else str(value)
