"""The form of a run's TOML file: reading, checking, and the experiment that it describes."""

from __future__ import annotations

import json
import os
import textwrap
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

from pydantic import ValidationError

from rhl._checks import Array, describe, real_array, shown
from rhl.app._sections import (
    PLANTS,
    ControllerSection,
    Count,
    EstimatorSection,
    ExampleSection,
    KnowledgeSection,
    LiftingSection,
    Matrix,
    PlantSection,
    RoughSection,
    Section,
    SimulationSection,
    Text,
    key,
)
from rhl.constraints import LinearConstraints
from rhl.errors import InputError
from rhl.estimator import ProximalEstimator
from rhl.lifting import DelayLifting
from rhl.model import SignalModel
from rhl.paper.published import Experiment
from rhl.plants import Plant
from rhl.plants.examples import example
from rhl.scheme import Scheme

# Of the file, in bytes: room for matrices of a few hundred rows.
_LARGEST = 5_000_000

_SECTIONS: dict[str, tuple[type[Section], ...]] = {
    "plant": PLANTS,
    "lifting": (LiftingSection,),
    "estimator": (EstimatorSection,),
    "controller": (ControllerSection,),
    "knowledge": (KnowledgeSection,),
    "rough": (RoughSection,),
    "simulation": (SimulationSection,),
}


class Config(Section):
    """A whole file."""

    name: Text = key("a string, what the run is called")
    steps: Count = key("an integer from 1 to 100000, the number of rows k = 0 .. steps-1")
    plant: PlantSection = key("a section")
    lifting: LiftingSection = key("a section")
    estimator: EstimatorSection = key("a section")
    controller: ControllerSection = key("a section")
    knowledge: KnowledgeSection | None = key("a section", default=None)
    rough: RoughSection | None = key("a section", default=None)
    simulation: SimulationSection | None = key("a section", default=None)

    def experiment(self) -> Experiment:
        """Build what the file describes.

        Returns
        -------
        Experiment

        Raises
        ------
        InputError
            If sizes do not fit each other; the message begins with the key.
        """
        with _under("plant"):
            plant, z0 = self._plant()
        with _under("lifting"):
            lifting = self.lifting.lifting()
            n, q = lifting.size(plant.p), plant.q * self.lifting.inputs
        with _under("estimator"):
            initial_model = self._initial_model(plant, lifting, n, q)
        with _under("knowledge"):
            constraints = None if self.knowledge is None else self.knowledge.constraints(lifting, plant.p, plant.q)
            if constraints is not None and self.estimator.A0 == "rough":
                # A rough model gives way to what is known for certain.
                initial_model = constraints.nearest(initial_model)
        with _under("controller"):
            controller = self.controller.controller()
        with _under("estimator"):
            mixing = self.estimator.mixed_by()
            estimator = ProximalEstimator(
                self.estimator.window, self.estimator.convex_loss(), self.estimator.convex_generator(), constraints
            )
        with _under("estimator"):
            if constraints is not None:
                _check_start(constraints, initial_model)
        with _under("controller", otherwise="estimator"):
            scheme = Scheme(lifting, estimator, controller, initial_model, mixing)
        simulation = self.simulation or SimulationSection()
        with _under("simulation"):
            sensor, actuator = simulation.sensor(plant.p), simulation.actuator(plant.q)
        return Experiment(self.name, plant, z0, scheme, self.steps, sensor, actuator, simulation.applied_known)

    def _plant(self) -> tuple[Plant, Array]:
        plant = self.plant.plant()
        own = self.plant.z0 is None and isinstance(self.plant, ExampleSection)
        z0 = example(self.plant.name).z0 if own and isinstance(self.plant, ExampleSection) else self.plant.z0
        z0 = real_array("z0", z0 if z0 is not None else [])
        if z0.shape != (plant.n,):
            raise InputError(f"z0 must have {plant.n} entries, one for each state of the plant, got {len(z0)}")
        return plant, z0

    def _initial_model(self, plant: Plant, lifting: DelayLifting, n: int, q: int) -> SignalModel:
        A0, B0 = self.estimator.A0, self.estimator.B0
        for whole in ("rough", "shift-of-ones"):
            if whole in (A0, B0):
                if A0 != B0:
                    raise InputError(f'A0 and B0 must both be "{whole}" or neither, got one of them; it gives both')
                if lifting.basis is not None:
                    raise InputError(
                        f'A0 must not be "{whole}" where x(k) has basis functions, got both; give matrices'
                    )
                return (
                    self._rough_model(plant)
                    if whole == "rough"
                    else SignalModel.shift_of_ones(plant.p, lifting.outputs, plant.q, lifting.inputs)
                )
        if self.rough is not None:
            raise InputError(
                'A0 must be "rough" where there is a section [rough], got another; set it and B0, or drop the section'
            )
        eye = B0 == "eye-last-row-of-ones"
        named = SignalModel.companion_of_ones(n, q, "eye-last-row-of-ones" if eye else "last-row-of-ones")
        A = named.A if isinstance(A0, str) else _fit("A0", A0, (n, n), "the order of x(k), square")
        B = named.B if isinstance(B0, str) else _fit("B0", B0, (n, q), "the order of x(k) by N_v q")
        return SignalModel(A, B)

    def _rough_model(self, plant: Plant) -> SignalModel:
        if self.rough is None:
            raise InputError('A0 must be "rough" only with a section [rough], got none; add it with F, G and H')
        with _under("rough"):
            model = self.rough.model(self.lifting.outputs, self.lifting.inputs)
            p, q = model.n // self.lifting.outputs, model.q // self.lifting.inputs
            if (p, q) != (plant.p, plant.q):
                raise InputError(
                    f"H and G must have {plant.p} rows and {plant.q} columns, as many as the plant has outputs and "
                    f"inputs, got {p} and {q}"
                )
            return model


def load(path: str | os.PathLike[str]) -> Config:
    """Read a run's TOML file.

    Parameters
    ----------
    path : path-like
        The file.

    Returns
    -------
    Config

    Raises
    ------
    InputError
        If the file is missing or not TOML, or a key is missing, unknown or not what it must be.
    """
    name = shown(path)
    try:
        with Path(path).open("rb") as file:
            content = file.read(_LARGEST + 1)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f"{name} must be a readable TOML file, got: {getattr(error, 'strerror', error)}") from error
    if len(content) > _LARGEST:
        raise InputError(f"{name} must be a TOML file of at most {_LARGEST} bytes, got more")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{name} must be a TOML file in UTF-8, got other bytes at position {error.start}") from error
    try:
        data = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # the parser's own error is a ValueError, and so is a huge number's
        detail = "too deeply nested" if isinstance(error, RecursionError) else " ".join(str(error).split())
        raise InputError(f"{name} must be valid TOML, got: {detail}") from error
    plant = data.get("plant")
    if isinstance(plant, dict) and isinstance(plant.get("file"), str):
        plant["file"] = str(Path(path).parent / plant["file"])
    return parse(data)


def parse(data: dict[str, Any]) -> Config:
    """Check a run's description, already read into a dictionary.

    Raises
    ------
    InputError
        With one sentence about the first key that does not fit.
    """
    given: Any = data
    if not isinstance(given, dict) or not all(isinstance(key, str) for key in given):
        raise InputError(f"a run must be described by a dictionary of keys, got {describe(data)}")
    try:
        return Config.model_validate(data)
    except ValidationError as error:
        raise InputError(_sentence(error, data)) from None


def keys() -> Iterator[tuple[str, str]]:
    """Yield every key with what it must be, in the order of the file; the book's reference is made of this.

    A key of some kinds of plant only says so, and so does one that may be left out.
    """
    for name in ("name", "steps"):
        yield name, Config.model_fields[name].description or ""
    for table, kinds in _SECTIONS.items():
        described: dict[str, dict[str, list[str]]] = {}
        for kind in kinds:
            for name, info in kind.model_fields.items():
                what = info.description or ""
                if not info.is_required():
                    what += "; may be left out" if info.default is None else f"; {_toml(info.default)} if left out"
                tag = kind.model_fields["kind"].description or "" if len(kinds) > 1 else ""
                described.setdefault(name, {}).setdefault(what, []).append(tag)
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
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **Config.model_json_schema(), "title": "rhl run"}


_EXAMPLE: dict[str, dict[str, str]] = {
    "plant": {
        "kind": '"linear"',
        "F": "[[1.1, 1.0], [0.0, 0.9]]",
        "G": "[[0.0], [1.0]]",
        "H": "[[1.0, 0.0]]",
        "z0": "[1.0, -1.0]",
    },
    "lifting": {"outputs": "2", "inputs": "2"},
    "estimator": {
        "window": "4",
        "weight": "0.01",
        "mixing": '"none"',
        "A0": '"companion-of-ones"',
        "B0": '"last-row-of-ones"',
    },
    "controller": {
        "Q": "1.0",
        "R": "1.0",
        "QN": "1.0",
        "horizon": "30",
        "alpha": "1.0",
        "model_delay": "0",
        "eps_rate": "10.0",
    },
}


def template(name: str) -> str:
    """Return a file that runs as it is, with a comment for each key; keys that may be left out stand commented out.

    Parameters
    ----------
    name : str
        What the run is called.

    Returns
    -------
    str
        TOML.
    """
    if not isinstance(cast(object, name), str):
        raise InputError(f"name must be a string, got {describe(name)}")
    kinds = " or ".join(str(kind.model_fields["kind"].description) for kind in PLANTS)
    lines = ["# A run of the scheme: rhl check FILE, then rhl run FILE --output trace.csv --plot trace.svg", ""]
    lines += [
        *_comment("name", Config.model_fields["name"].description),
        f"name = {json.dumps(name, ensure_ascii=False)}",
    ]
    lines += [*_comment("steps", Config.model_fields["steps"].description), "steps = 60"]
    for table, (section, *_) in _SECTIONS.items():
        given = _EXAMPLE.get(table, {})
        lines += ["", f"# {' '.join((section.__doc__ or '').split())}", f"[{table}]" if given else f"# [{table}]"]
        for name, info in section.model_fields.items():
            lines += _comment(name, kinds if name == "kind" else info.description)
            if name in given:
                lines.append(f"{name} = {given[name]}")
            else:
                lines.append(
                    f"# {name} = {'...' if info.is_required() or info.default is None else _toml(info.default)}"
                )
    return "\n".join(lines) + "\n"


def _comment(name: str, what: str | None) -> list[str]:
    return textwrap.wrap(f"{name}: {what}", 100, initial_indent="# ", subsequent_indent="#   ")


def _toml(value: object) -> str:
    return json.dumps(value)


def _sentence(error: ValidationError, data: dict[str, Any]) -> str:
    # An unknown key is often the misspelt twin of a missing one, so it is the more helpful of the two.
    first = min(error.errors(), key=lambda entry: entry["type"] != "extra_forbidden")
    kind, (path, fields, found) = first["type"], _locate(first["loc"], data)
    # A key may be any text; what is no plain word is shown quoted, so that it stays on its line.
    key = ".".join(
        part if part.replace("-", "_").isidentifier() and len(part) <= 60 else describe(part) for part in path
    )
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        got = describe(found["kind"]) if kind == "union_tag_invalid" else "no such key"
        *others, last = (section.model_fields["kind"].description for section in PLANTS)
        return f"plant.kind must be {', '.join(map(str, others))} or {last}, got {got}"
    if kind == "extra_forbidden":
        return f"{key} is not a known key; expected one of {', '.join(fields)}, got {key}"
    wanted = fields[path[-1]].description if path[-1] in fields else "a section"
    if kind == "missing":
        return f"{key} must be {wanted}, got nothing; add the {'section' if wanted == 'a section' else 'key'}"
    return f"{key} must be {wanted}, got {describe(found)}"


def _locate(loc: tuple[int | str, ...], data: dict[str, Any]) -> tuple[list[str], dict[str, Any], Any]:
    """Reduce pydantic's location to the file's own keys: the path, the fields known there, and what was found."""
    first = str(loc[0])
    found = data.get(first)
    if first == "plant":
        # The second part is the tag of the union, not a key.
        tag, loc = f'"{loc[1]}"' if len(loc) > 1 else "", loc[1:]
        named = [kind for kind in PLANTS if kind.model_fields["kind"].description == tag]
        section: type[Section] | None = named[0] if named else None
    else:
        section = _SECTIONS[first][0] if first in _SECTIONS else None
    if len(loc) < 2 or section is None or not isinstance(found, dict):
        return [first], dict(Config.model_fields), found
    name = str(loc[1])
    return [first, name], dict(section.model_fields), found.get(name)


def _check_start(constraints: LinearConstraints, initial_model: SignalModel) -> None:
    try:
        constraints.check("A0 with B0", initial_model)
    except InputError as error:
        what = str(error).partition(";")[0]
        raise InputError(f'{what}; "shift-of-ones" satisfies shift_rows, "rough" gives way to what is known') from None


def _fit(name: str, rows: Matrix, shape: tuple[int, int], why: str) -> Array:
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
        key = str(error).split()[0]
        own = any(key in kind.model_fields for kind in _SECTIONS[section])
        raise InputError(f"{section}.{error}" if own else f"[{otherwise or section}] {error}") from None
