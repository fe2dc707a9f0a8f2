"""The kinds of plant in a run's TOML file: their keys, the allowed values and the plants built from them."""

from __future__ import annotations

import os
import runpy
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rhl._checks import Array, describe, reason, shown
from rhl.app._keys import MATRIX, POSITIVE, SIZE, TEXT, VECTOR, Section, key, list_of
from rhl.app._limits import ENTRIES
from rhl.errors import InputError, PlantError
from rhl.plants import FunctionPlant, LinearPlant, Plant, RobotArm
from rhl.plants.examples import EXAMPLES, example


class LinearSection(Section):
    """[plant] with kind = "linear": z+ = F z + G v, y = H z, equation (1)."""

    kind = key('"linear"')
    F = key("a square matrix of finite numbers, n rows", MATRIX)
    G = key("a matrix of finite numbers, n rows and a column for each input", MATRIX)
    H = key("a matrix of finite numbers, a row for each output and n columns", MATRIX)
    z0 = key("a list of n finite numbers, the initial state", VECTOR)

    def plant(self) -> tuple[Plant, ArrayLike]:
        return LinearPlant(self.F, self.G, self.H), self.z0


# Coefficients of each channel: a row for each output, with a list for each input.
_CHANNELS = list_of(list_of(VECTOR))


class TransferSection(Section):
    """[plant] with kind = "transfer-function": any number of inputs and outputs, in discrete or continuous time."""

    kind = key('"transfer-function"')
    num = key(
        "a list of finite numbers, the numerator's coefficients, highest power of z first; for several inputs and "
        "outputs a row for each output, with such a list for each input",
        VECTOR,
        _CHANNELS,
    )
    den = key(
        "a list of finite numbers, the denominator's coefficients, more of them than num has; for several inputs and "
        "outputs like num, or one list for all; at most 1000 coefficients in all channels",
        VECTOR,
        _CHANNELS,
    )
    sampling = key(
        "{}, the seconds between samples where num and den are in continuous time, in powers of s; inputs are held "
        "between samples",
        POSITIVE,
        default=None,
    )
    z0 = key(
        "a list of n finite numbers, the initial state in controllable canonical form; for several inputs a block for "
        "each, reduced to the observable part",
        VECTOR,
    )

    def plant(self) -> tuple[Plant, ArrayLike]:
        import control  # imported here, because it loads matplotlib

        num, den = self._channels()
        time: Any = True if self.sampling is None else 0
        return LinearPlant.from_control(control.TransferFunction(num, den, time), self.sampling), self.z0

    def _channels(self) -> tuple[list[list[list[float]]], list[list[list[float]]]]:
        single = not (self.num and isinstance(self.num[0], list))
        num = [[self.num]] if single else self.num
        p, q = len(num), len(num[0])
        if not q or any(len(row) != q for row in num):
            raise InputError(
                f"num must have as many lists of coefficients in every row, one for each input, got "
                f"{sorted({len(row) for row in num})}"
            )
        one = not (self.den and isinstance(self.den[0], list))
        den = [[self.den] * q] * p if one else self.den
        if [len(row) for row in den] != [q] * p:
            raise InputError(
                f"den must have {p} rows of {q} lists, as num has, or be one list, got {describe(self.den)}"
            )
        states = sum(len(part) for row in den for part in row)
        if states > ENTRIES:
            raise InputError(
                f"den must have at most {ENTRIES} coefficients in all channels together, got {states}; give a plant of "
                "a lower order"
            )
        num, den = ([[np.trim_zeros(part, "f") for part in row] for row in rows] for rows in (num, den))
        for i, j in np.ndindex(p, q):
            over, under = len(num[i][j]), len(den[i][j])
            if under <= over or (single and not over):
                where = "" if single else f" from input {j + 1} to output {i + 1}"
                remedy = "append a zero to den for one more step of delay"
                raise InputError(
                    "den must have a higher degree than num, and num must not be zero (a strictly proper plant), got "
                    f"{under} and {over} coefficients{where}; "
                    + (remedy if self.sampling is None else "model the lag of a sensor or an actuator")
                )
        return [[part or [0.0] for part in row] for row in num], den


class ArmSection(Section):
    """[plant] with kind = "robot-arm": equation (24)."""

    kind = key('"robot-arm"')
    variant = key('"data" (the coefficients behind the published curves) or "printed" (those in the text)')
    z0 = key("a list of 3 finite numbers, the initial state", VECTOR)

    def plant(self) -> tuple[Plant, ArrayLike]:
        return RobotArm(self.variant), self.z0


class ExampleSection(Section):
    """[plant] with kind = "ready": one of the plants that come with the library."""

    kind = key('"ready"')
    name = key(f"one of {', '.join(EXAMPLES)}", TEXT)
    z0 = key("a list of n finite numbers, the initial state; the plant's own if left out", VECTOR, default=None)

    def plant(self) -> tuple[Plant, ArrayLike]:
        found = example(self.name)
        return found.plant, found.z0 if self.z0 is None else self.z0


class PythonSection(Section):
    """[plant] with kind = "python": two functions in the user's Python file, which is executed if that is allowed."""

    kind = key('"python"')
    file = key(
        "the path of a Python file, relative to the folder of this one, that defines step(z, v) and output(z); it is "
        "executed, which --allow-python must allow",
        TEXT,
    )
    n = key("{}, the size of the state", SIZE)
    q = key("{}, the size of the input", SIZE)
    z0 = key("a list of n finite numbers, the initial state", VECTOR)

    def plant(self) -> tuple[Plant, ArrayLike]:
        names, lengths = _executed(self.file), {"step(z, v)": str(self.n), "output(z)": "p"}
        for name in ("step", "output"):
            if name not in names:
                raise InputError(f"file must define a function {name}, got a file without it: {shown(self.file)}")
        step, output = (
            _told(f"{name}({arguments})", names[name], lengths)
            for name, arguments in (("step", "z, v"), ("output", "z"))
        )
        plant = FunctionPlant(step, output, n=self.n, q=self.q, names=("step", "output"))
        lengths["output(z)"] = str(plant.p)
        return plant, self.z0


PLANTS = (LinearSection, TransferSection, ExampleSection, ArmSection, PythonSection)


def _executed(file: str) -> dict[str, Any]:
    folder = os.getcwd()
    try:
        return runpy.run_path(file)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # whatever a user's file raises, sys.exit included
        raise InputError(f"file must be a Python file that runs, got {reason(error)}, from {shown(file)}") from error
    finally:
        os.chdir(folder)  # output paths are relative to this folder, even if the file changed it


def _told(name: str, function: Any, lengths: dict[str, str]) -> Any:
    """Report an error of a file's function in one sentence, since FunctionPlant passes it through."""
    if not callable(function):
        return function

    def call(*arguments: Array) -> Any:
        try:
            return function(*arguments)
        except (KeyboardInterrupt, OverflowError):  # a plant that overflows has diverged
            raise
        except BaseException as error:  # whatever a user's function raises, sys.exit included
            wanted = f"{name} must return an array of shape ({lengths[name]},)"
            if isinstance(error, ValueError) and "read-only" in str(error):
                raise PlantError(
                    f"{wanted} and leave its arguments alone, got an attempt to write into them; it must return a new "
                    "array, so begin with z = z.copy()"
                ) from error
            where = ", ".join(f"{symbol} = {describe(value)}" for symbol, value in zip("zv", arguments, strict=False))
            raise PlantError(f"{wanted}, got {reason(error)}; try it yourself at {where}") from error

    return call
