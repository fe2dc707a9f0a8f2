"""The form of a run's TOML file: reading, checking, and the experiment that it describes."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from rhl._checks import Array, describe, real_array, shown
from rhl.app import _limits
from rhl.app._keys import (
    COUNT,
    LINE,
    NOT_NEGATIVE,
    NUMBER,
    POSITIVE,
    SIZE,
    VECTOR,
    Section,
    key,
    list_of,
    read_toml,
    table_of,
)
from rhl.app._plants import PLANTS, PythonSection
from rhl.app._sections import (
    ControllerSection,
    EstimatorSection,
    KnowledgeSection,
    LiftingSection,
    RoughSection,
    SimulationSection,
)
from rhl.constraints import LinearConstraints
from rhl.disturbances import Saturation
from rhl.errors import InputError
from rhl.lifting import DelayLifting
from rhl.model import SignalModel
from rhl.paper.published import Experiment
from rhl.plants import Plant
from rhl.scheme import Scheme, default_scheme, scheme_for
from rhl.tracking import SetPoint

# Sections that a file without the key order needs; where order is given, they change the chosen scheme.
_NEEDED = ("lifting", "estimator", "controller")


class Config(Section):
    """A whole file."""

    name = key("{}, the name of the run, without control characters", LINE)
    steps = key(
        "{}, the number of rows k = 0 .. steps-1; a run is refused if it needs more than 2 GB for the estimates of all "
        "steps, for the table, for a window or for a plan",
        COUNT,
    )
    order = key(
        "{}, an upper bound of the plant's observability index, from which the scheme is chosen, for signals of any "
        "size; each given key of [lifting], [estimator] and [controller] changes that setting only. A scheme stacks at "
        "most 1000 numbers",
        SIZE,
        default=None,
    )
    input_size = key(
        "{}, or one for each input: the size of the first inputs where order is given; if left out, 0.1, or a "
        "hundredth of the range from v_min to v_max",
        POSITIVE,
        list_of(POSITIVE),
        default=None,
    )
    noise = key(
        "{}, or one for each output: the standard deviation of the sensor errors that the scheme expects "
        "where order is given; noise in [simulation] sets the errors of the run",
        NOT_NEGATIVE,
        list_of(NOT_NEGATIVE),
        default=0.0,
    )
    set_point = key(
        "{}, or one for each output: the target of the outputs under any constant disturbance; if left out, "
        "outputs and inputs go to zero",
        NUMBER,
        VECTOR,
        default=None,
    )
    plant = key("{}", table_of(*PLANTS))
    lifting = key("{}", table_of(LiftingSection), default=None)
    estimator = key("{}", table_of(EstimatorSection), default=None)
    controller = key("{}", table_of(ControllerSection), default=None)
    knowledge = key("{}", table_of(KnowledgeSection), default=None)
    rough = key("{}", table_of(RoughSection), default=None)
    simulation = key("{}", table_of(SimulationSection), default=None)

    def experiment(self, *, allow_python: bool = False) -> Experiment:
        """Build the experiment; InputError, which begins with the key, if sizes do not fit each other.

        ``allow_python``: whether a plant's Python file may be executed; otherwise such a plant is an InputError.
        """
        with _under("plant"):
            # A configuration may come from a stranger, so the file that it names is not even opened.
            if isinstance(self.plant, PythonSection) and not allow_python:
                raise InputError(
                    f'kind must not be "python" unless --allow-python is given, got {shown(self.plant.file)}, which '
                    "would be executed; read that file, then add --allow-python"
                )
            plant, z0 = self._plant()
        simulation = self.simulation or SimulationSection({})
        with _under("simulation"):
            sensor, actuator = simulation.sensor(plant.p), simulation.actuator(plant.q)
            load = simulation.disturbance(plant.q)
        scheme = self._scheme(plant, actuator)
        _limits.fits(scheme, self.steps, plant.n)
        return Experiment(
            self.name, plant, z0, scheme, self.steps, sensor, actuator, simulation.applied_known, load=load
        )

    def _sized(self, name: str, count: int, of: str) -> Any:
        given = getattr(self, name)
        if isinstance(given, list) and len(given) != count:
            raise InputError(f"{name} must be a number or have {count} entries, one for each {of}, got {len(given)}")
        return given

    def _scheme(self, plant: Plant, actuator: Saturation | None) -> Scheme:
        goal, size = self._sized("set_point", plant.p, "output"), self._sized("input_size", plant.q, "input")
        set_point, noise = None if goal is None else SetPoint(goal), self._sized("noise", plant.p, "output")
        chosen = None
        lifting_, estimator_, controller_ = self._sections()
        outputs, inputs = (lifting_.given.get(name, self.order) for name in ("outputs", "inputs"))
        _limits.stacked("order or [lifting]", plant.p, plant.q, outputs, inputs)
        if self.order is not None:
            chosen = default_scheme(plant.p, plant.q, self.order, size, noise, bounds=actuator, set_point=set_point)
        with _under("lifting"):
            lifting = lifting_.lifting(None if chosen is None else chosen.lifting)
            lifting.size(plant.p)
            if chosen is not None and lifting != chosen.lifting:
                chosen = scheme_for(lifting, plant.p, plant.q, size, noise, bounds=actuator, set_point=set_point)
        with _under("knowledge"):
            constraints = None if self.knowledge is None else self.knowledge.constraints(lifting, plant.p, plant.q)
        with _under("controller"):
            controller = controller_.controller(None if chosen is None else chosen.controller, actuator)
        with _under("estimator"):
            initial_model, own = self._initial_model(estimator_, plant, lifting, chosen)
            if constraints is not None:
                initial_model = self._reconciled(estimator_, initial_model, constraints)
            mixing, estimator = estimator_.mixed_by(chosen), estimator_.estimator(chosen, constraints)
        units = None if chosen is None or constraints is not None else chosen.units
        if units is None:
            for name in ("input_size", "noise"):
                self.heeded(name, False, "where [knowledge] or basis functions leave the scheme without running units")
        if units is not None and own:
            # The given model states the effect of inputs, so the first inputs need no caution.
            units = replace(units, model_in_sizes=False, caution=0.0)
        with _under("controller", otherwise="estimator"):
            return Scheme(lifting, estimator, controller, initial_model, mixing, units, set_point)

    def _sections(self) -> tuple[LiftingSection, EstimatorSection, ControllerSection]:
        """Return the three sections; where order is given, one that is left out changes nothing."""
        return (
            self.lifting or LiftingSection({}),
            self.estimator or EstimatorSection({}),
            self.controller or ControllerSection({}),
        )

    def _plant(self) -> tuple[Plant, Array]:
        plant, z0 = self.plant.plant()
        z0 = real_array("z0", z0)
        if z0.shape != (plant.n,):
            raise InputError(f"z0 must have {plant.n} entries, one for each state of the plant, got {len(z0)}")
        return plant, z0

    def _initial_model(
        self, section: EstimatorSection, plant: Plant, lifting: DelayLifting, chosen: Scheme | None
    ) -> tuple[SignalModel, bool]:
        """Return theta~(0), and whether the file gives it, which means in the units of the signals."""
        A0, B0 = section.A0, section.B0
        if chosen is not None and A0 is None and B0 is None:
            if self.rough is None:
                return chosen.initial_model, False
            A0 = B0 = "rough"
        n, q = lifting.size(plant.p), plant.q * lifting.inputs
        for whole in ("rough", "shift-of-ones"):
            if whole in (A0, B0):
                if A0 != B0:
                    raise InputError(f'A0 and B0 must both be "{whole}" or neither, got one of them; give both')
                if lifting.basis is not None:
                    raise InputError(
                        f'A0 must not be "{whole}" where x(k) has basis functions, got both; give matrices'
                    )
                if whole == "rough":
                    return self._rough_model(plant, lifting), True
                return SignalModel.shift_of_ones(plant.p, lifting.outputs, plant.q, lifting.inputs), True
        if self.rough is not None:
            raise InputError(
                'A0 must be "rough" where there is a section [rough], got another value; '
                "set A0 and B0 to it, or remove the section"
            )
        for name, given, other in (("A0", A0, "B0"), ("B0", B0, "A0")):
            if given is None:
                raise InputError(f"{name} must be given where {other} is, got nothing; add the key")
        named = SignalModel.companion_of_ones(n, q, "last-row-of-ones" if isinstance(B0, list) else B0)
        A = named.A if isinstance(A0, str) else _fit("A0", A0, (n, n), "the order of x(k), square")
        B = named.B if isinstance(B0, str) else _fit("B0", B0, (n, q), "the order of x(k) by N_v q")
        return SignalModel(A, B), True

    def _reconciled(
        self, section: EstimatorSection, initial_model: SignalModel, constraints: LinearConstraints
    ) -> SignalModel:
        if section.A0 in ("rough", None):  # the knowledge takes precedence over it
            return constraints.nearest(initial_model)
        try:
            constraints.check("A0 with B0", initial_model)
        except InputError as error:
            what = str(error).partition(";")[0]
            raise InputError(
                f'{what}; "shift-of-ones" satisfies shift_rows, known entries replace those of "rough"'
            ) from None
        return initial_model

    def _rough_model(self, plant: Plant, lifting: DelayLifting) -> SignalModel:
        if self.rough is None:
            raise InputError('A0 must be "rough" only with a section [rough], got none; add it with F, G and H')
        with _under("rough"):
            model = self.rough.model(lifting.outputs, lifting.inputs)
            p, q = model.n // lifting.outputs, model.q // lifting.inputs
            if (p, q) != (plant.p, plant.q):
                raise InputError(
                    f"H and G must have {plant.p} rows and {plant.q} columns, as many as the plant has outputs and "
                    f"inputs, got {p} and {q}"
                )
            return model


def load(path: str | os.PathLike[str]) -> Config:
    """Read a run's TOML file.

    InputError if the file is missing or not TOML, or a key is missing, unknown or has a wrong value.
    """
    _, data = read_toml(path)
    plant = data.get("plant")
    if isinstance(plant, dict) and isinstance(plant.get("file"), str):
        plant["file"] = str(Path(path).parent / plant["file"])
    return parse(data)


def parse(data: dict[str, Any]) -> Config:
    """Check a run's description as a dictionary; InputError names the first key that does not fit."""
    given: Any = data
    if not isinstance(given, dict) or not all(isinstance(name, str) for name in given):
        raise InputError(f"a run must be described by a dictionary of keys, got {describe(data)}")
    wrong: list[tuple[bool, str]] = []
    config = Config.read("", data, wrong, changes="order" in given)
    for section in _NEEDED:
        if "order" not in given and section not in given:
            wrong.append((False, f"{section} must be a section, got nothing; add the section, or order in its place"))
    # An unknown key is often a misspelt required key, so its message is the more helpful one.
    for _, sentence in sorted(wrong, key=lambda entry: not entry[0]):
        raise InputError(sentence)
    for name in ("input_size", "noise"):
        config.heeded(name, "order" in given, "where order is left out")
    return config


def keys() -> Iterator[tuple[str, str]]:
    """Yield every key with its description, in the order of the file, for the book's reference.

    The description names the kinds of plant that have the key, and the value of a key that is left out.
    """
    for table, about in Config.keys().items():
        kinds = about.get("sections", ())
        if not kinds:
            yield table, about["description"]
        described: dict[str, dict[str, list[str]]] = {}
        for kind in kinds:
            for name, one in kind.keys().items():
                what = one["description"]
                if "default" in one:
                    what += (
                        "; may be left out"
                        if one["default"] is None
                        else f"; {json.dumps(one['default'], ensure_ascii=False)} if left out"
                    )
                described.setdefault(name, {}).setdefault(what, []).append(kind.tag())
        for name, texts in described.items():
            everywhere = name == "kind" or list(map(len, texts.values())) == [len(kinds)]
            yield (
                f"{table}.{name}",
                "; or ".join(
                    what if everywhere else f"{what} (with kind = {' or '.join(tags)})" for what, tags in texts.items()
                ),
            )


def schema() -> dict[str, Any]:
    """Return the file's form as a JSON schema, for editors that complete and check TOML."""
    needed = {section.__name__: section.needed() for section in (LiftingSection, EstimatorSection, ControllerSection)}
    whole = dict(zip(_NEEDED, ({"required": names} for names in needed.values()), strict=True))
    chosen = [{"required": [name]} for name in ("input_size", "noise")]
    either = {
        "if": {"required": ["order"]},
        "else": {"required": list(_NEEDED), "properties": whole, "not": {"anyOf": chosen}},
    }
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "rhl run", **Config.schema(), **either}


def _fit(name: str, rows: Any, shape: tuple[int, int], why: str) -> Array:
    array = real_array(name, rows, (None, None))
    if array.shape != shape:
        raise InputError(f"{name} must have shape {shape} ({why}), got {array.shape}")
    return array


@contextmanager
def _under(section: str, otherwise: str = "") -> Iterator[None]:
    """Put the section's name before the key that a message begins with; other messages name ``otherwise``."""
    try:
        yield
    except InputError as error:
        first = str(error).split()[0]
        own = any(hasattr(kind, first) for kind in Config.keys()[section]["sections"])
        raise InputError(f"{section}.{error}" if own else f"[{otherwise or section}] {error}") from None
