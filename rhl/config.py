"""The form of a run's TOML file: every key, what it must be, and the experiment that it describes."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from rhl._checks import Array, InputError, describe, real_array, shown
from rhl.bregman import WeightedSquares
from rhl.closed_loop import Controller, HarmonicDecay, Scheme
from rhl.controllability import ConstantMixing, LambdaSearch
from rhl.estimator import ProximalEstimator
from rhl.lifting import DelayLifting
from rhl.model import SignalModel
from rhl.plants import LinearPlant, Plant, RobotArm
from rhl.published import Experiment

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
# The upper ends are far above any use; they keep a slip of the keyboard from taking all memory.
Size = Annotated[int, Field(strict=True, ge=1, le=100)]
Length = Annotated[int, Field(strict=True, ge=1, le=10_000)]
Count = Annotated[int, Field(strict=True, ge=1, le=100_000)]
Positive = Annotated[float, Field(strict=True, gt=0, allow_inf_nan=False)]
# Of the file, in bytes: room for matrices of a few hundred rows.
_LARGEST = 5_000_000
Vector = list[Number]
Matrix = list[list[Number]]


def _key(what: str) -> Any:
    # The description completes the sentence "KEY must be ..." and is the key's documentation.
    return Field(description=what)


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, hide_input_in_errors=True)


class LinearSection(_Section):
    """[plant] with kind = "linear": z+ = F z + G v, y = H z, equation (1)."""

    kind: Literal["linear"] = _key('"linear"')
    F: Matrix = _key("a square matrix of finite numbers, n rows")
    G: Matrix = _key("a matrix of finite numbers, n rows and a column for each input")
    H: Matrix = _key("a matrix of finite numbers, a row for each output and n columns")
    z0: Vector = _key("a list of n finite numbers, the initial state")


class ArmSection(_Section):
    """[plant] with kind = "robot-arm": equation (24)."""

    kind: Literal["robot-arm"] = _key('"robot-arm"')
    variant: Literal["data", "printed"] = _key(
        '"data" (the coefficients behind the published curves) or "printed" (those in the text)'
    )
    z0: Vector = _key("a list of 3 finite numbers, the initial state")


class LiftingSection(_Section):
    """[lifting]: equations (14) and (22)."""

    outputs: Size = _key("a whole number from 1 to 100, N_y, how many outputs x(k) stacks")
    inputs: Size = _key("a whole number from 1 to 100, N_v, how many inputs u(k) stacks")


class EstimatorSection(_Section):
    """[estimator]: equation (15)."""

    window: Length = _key("a whole number from 1 to 10000, N_bar, how many transitions are fitted")
    weight: Positive = _key("a positive number, the weight of the Bregman distance")
    mixing: Annotated[float, Field(strict=True, ge=0, lt=1)] | Literal["search"] = _key(
        'a number in [0, 1), the constant lambda, or "search" for Lemma 5\'s search on the augmented pair'
    )
    A0: Matrix | Literal["companion-of-ones"] = _key(
        '"companion-of-ones" (first superdiagonal and last row ones) or a matrix, (N_y p) by (N_y p)'
    )
    B0: Matrix | Literal["last-row-of-ones", "eye-last-row-of-ones"] = _key(
        '"last-row-of-ones", "eye-last-row-of-ones" or a matrix, (N_y p) by (N_v q)'
    )


class ControllerSection(_Section):
    """[controller]: equation (3); sizes are those of Remark 4's augmented state, N_y p + (N_v - 1) q."""

    Q: Number | Matrix = _key(
        "a positive number (times the identity) or a symmetric positive definite matrix, (N_y p + (N_v-1) q) square"
    )
    R: Number | Matrix = _key(
        "a positive number (times the identity) or a symmetric positive definite matrix, q square"
    )
    QN: Number | Matrix = _key(
        "a positive number (times the identity) or a symmetric positive definite matrix, (N_y p + (N_v-1) q) square"
    )
    horizon: Length = _key("a whole number from 1 to 10000, N")
    alpha: Positive = _key("a positive number, Gamma(x) = alpha x'x")
    eps_rate: Positive = _key("a positive number, eps(k) = 1/(1 + eps_rate k)")
    model_delay: Annotated[int, Field(strict=True, ge=0, le=1)] = _key(
        "0 (control with the estimate of this step) or 1 (of the step before)"
    )


_SECTIONS: dict[str, tuple[type[_Section], ...]] = {
    "plant": (LinearSection, ArmSection),
    "lifting": (LiftingSection,),
    "estimator": (EstimatorSection,),
    "controller": (ControllerSection,),
}


class Config(_Section):
    """A whole file."""

    name: Annotated[str, Field(strict=True)] = _key("a text, what the run is called")
    steps: Count = _key("a whole number from 1 to 100000, the number of rows k = 0 .. steps-1")
    plant: Annotated[LinearSection | ArmSection, Field(discriminator="kind")] = _key("a section")
    lifting: LiftingSection = _key("a section")
    estimator: EstimatorSection = _key("a section")
    controller: ControllerSection = _key("a section")

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
            plant: Plant
            if isinstance(self.plant, LinearSection):
                plant = LinearPlant(_matrix("F", self.plant.F), _matrix("G", self.plant.G), _matrix("H", self.plant.H))
            else:
                plant = RobotArm(self.plant.variant)
            z0 = real_array("z0", self.plant.z0)
            if z0.shape != (plant.n,):
                raise InputError(f"z0 must have {plant.n} entries, one for each state of the plant, got {len(z0)}")
        n, q = plant.p * self.lifting.outputs, plant.q * self.lifting.inputs
        with _under("estimator"):
            initial_model = self._initial_model(n, q)
        mixing = self.estimator.mixing
        section = self.controller
        with _under("controller", otherwise="estimator"):
            scheme = Scheme(
                lifting=DelayLifting(self.lifting.outputs, self.lifting.inputs),
                estimator=ProximalEstimator(self.estimator.window, generator=WeightedSquares(self.estimator.weight)),
                controller=Controller(
                    Q=_weight("Q", section.Q),
                    R=_weight("R", section.R),
                    QN=_weight("QN", section.QN),
                    horizon=section.horizon,
                    epsilon=HarmonicDecay(section.eps_rate),
                    alpha=section.alpha,
                    model_delay=section.model_delay,
                ),
                initial_model=initial_model,
                mixing=LambdaSearch() if mixing == "search" else ConstantMixing(mixing),
            )
        return Experiment(self.name, plant, z0, scheme, self.steps)

    def _initial_model(self, n: int, q: int) -> SignalModel:
        A0, B0 = self.estimator.A0, self.estimator.B0
        named = SignalModel.companion_of_ones(n, q, B0 if isinstance(B0, str) else "last-row-of-ones")
        A = named.A if isinstance(A0, str) else _fit("A0", A0, (n, n), "outputs of the plant times lifting.outputs")
        B = named.B if isinstance(B0, str) else _fit("B0", B0, (n, q), "outputs and inputs, each times its lifting")
        return SignalModel(A, B)


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
    except (OSError, ValueError) as error:
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
    return parse(data)


def parse(data: dict[str, Any]) -> Config:
    """Check a run's description, already read into a dictionary.

    Raises
    ------
    InputError
        With one sentence about the first key that does not fit.
    """
    if not isinstance(data, dict):
        raise InputError(f"a run must be described by a dictionary of keys, got {describe(data)}")
    try:
        return Config.model_validate(data)
    except ValidationError as error:
        raise InputError(_sentence(error, data)) from None


def keys() -> Iterator[tuple[str, str]]:
    """Yield every key with what it must be, in the order of the file; the book's reference is made of this.

    A key of one kind of plant alone says so.
    """
    for name in ("name", "steps"):
        yield name, Config.model_fields[name].description or ""
    for table, kinds in _SECTIONS.items():
        described: dict[str, list[str]] = {}
        for kind in kinds:
            for name, info in kind.model_fields.items():
                described.setdefault(name, []).append(info.description or "")
        for name, texts in described.items():
            only = "" if len(texts) == len(kinds) else "; in one kind of plant only"
            yield f"{table}.{name}", " or ".join(dict.fromkeys(texts)) + only


def _sentence(error: ValidationError, data: dict[str, Any]) -> str:
    # An unknown key is often the misspelt twin of a missing one, so it is the more helpful of the two.
    first = min(error.errors(), key=lambda entry: entry["type"] != "extra_forbidden")
    kind, (path, fields, found) = first["type"], _locate(first["loc"], data)
    # A key may be any text; what is no plain word is shown quoted, so that it stays on its line.
    key = ".".join(part if part.replace("-", "_").isidentifier() else describe(part) for part in path)
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        got = describe(found["kind"]) if kind == "union_tag_invalid" else "no such key"
        return f'plant.kind must be "linear" or "robot-arm", got {got}'
    if kind == "extra_forbidden":
        return f"{key} is not a known key; expected one of {', '.join(fields)}, got {key}"
    wanted = fields[path[-1]].description if path[-1] in fields else "a section"
    if kind == "missing":
        return f"{key} must be {wanted}, got nothing; add the {'section' if wanted == 'a section' else 'key'}"
    return f"{key} must be {wanted}, got {describe(found)}"


def _locate(loc: tuple[int | str, ...], data: dict[str, Any]) -> tuple[list[str], dict[str, Any], Any]:
    """Reduce pydantic's location to the file's own keys: the path, the fields known there, and what was found."""
    first = str(loc[0])
    section = Config.model_fields[first].annotation if first in Config.model_fields else None
    found = data.get(first)
    if len(loc) == 1 or section in (str, int) or not isinstance(found, dict):
        return [first], dict(Config.model_fields), found
    if first == "plant":
        section = LinearSection if loc[1] == "linear" else ArmSection
        loc = loc[1:]
        if len(loc) == 1:
            return [first], dict(Config.model_fields), found
    assert isinstance(section, type)
    assert issubclass(section, _Section)
    key = str(loc[1])
    return [first, key], dict(section.model_fields), found.get(key)


def _matrix(name: str, rows: Matrix) -> Array:
    return real_array(name, rows, (None, None))


def _weight(name: str, value: float | Matrix) -> Array | float:
    return value if isinstance(value, float) else _matrix(name, value)


def _fit(name: str, rows: Matrix, shape: tuple[int, int], why: str) -> Array:
    array = _matrix(name, rows)
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
