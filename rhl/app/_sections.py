"""The sections of a run's TOML file: every key, what it must be, and what is built of it."""

from __future__ import annotations

import os
import runpy
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rhl._checks import Array, describe, real_array, reason, shown
from rhl.app._keys import (
    FLAG,
    FRACTION,
    LENGTH,
    MATRIX,
    NOT_NEGATIVE,
    NUMBER,
    OPEN_FRACTION,
    PARTIAL,
    POSITIVE,
    SIZE,
    TEXT,
    VECTOR,
    WORDS,
    Section,
    integer,
    key,
    list_of,
)
from rhl.basis import Polynomials, Terms
from rhl.constraints import LinearConstraints
from rhl.controllability import ConstantMixing, LambdaSearch, Mixing
from rhl.disturbances import Disturbance, Disturbances, GaussianNoise, Outliers, Saturation
from rhl.errors import InputError, PlantError
from rhl.lifting import DelayLifting
from rhl.losses import GENERATORS, LOSSES, Convex
from rhl.model import SignalModel
from rhl.plants import FunctionPlant, LinearPlant, Plant, RobotArm
from rhl.plants.analysis import rough_model
from rhl.plants.examples import EXAMPLES, example
from rhl.schedules import Constant, ExponentialDecay, PowerDecay, Schedule
from rhl.scheme import Controller


class LinearSection(Section):
    """[plant] with kind = "linear": z+ = F z + G v, y = H z, equation (1)."""

    kind = key('"linear"')
    F = key("a square matrix of finite numbers, n rows", MATRIX)
    G = key("a matrix of finite numbers, n rows and a column for each input", MATRIX)
    H = key("a matrix of finite numbers, a row for each output and n columns", MATRIX)
    z0 = key("a list of n finite numbers, the initial state", VECTOR)

    def plant(self) -> tuple[Plant, ArrayLike]:
        return LinearPlant(self.F, self.G, self.H), self.z0


class TransferSection(Section):
    """[plant] with kind = "transfer-function": one input, one output, discrete time."""

    kind = key('"transfer-function"')
    num = key("a list of finite numbers, the numerator's coefficients, highest power of z first", VECTOR)
    den = key("a list of finite numbers, the denominator's coefficients, more of them than num has", VECTOR)
    z0 = key("a list of n finite numbers, the initial state in controllable canonical form", VECTOR)

    def plant(self) -> tuple[Plant, ArrayLike]:
        import control  # here, because it brings matplotlib along

        num, den = np.trim_zeros(self.num, "f"), np.trim_zeros(self.den, "f")
        if not num or len(den) <= len(num):
            raise InputError(
                "den must have a higher degree than num, and num must not be zero (a strictly proper plant), got "
                f"{len(den)} and {len(num)} coefficients; append a zero to den for one more step of delay"
            )
        return LinearPlant.from_control(control.TransferFunction(num, den, True)), self.z0


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
    """[plant] with kind = "python": two functions in a Python file of the user's, which is executed."""

    kind = key('"python"')
    file = key(
        "the path of a Python file, seen from the folder of this one, that defines step(z, v) and output(z); it is "
        "executed",
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


class LiftingSection(Section):
    """[lifting]: equations (14) and (22)."""

    outputs = key("{}, N_y, how many outputs x(k) stacks", SIZE)
    inputs = key("{}, N_v, how many inputs u(k) stacks", SIZE)
    degree = key(
        "{}; above 1, all monomials of the stacked outputs up to it are appended to x(k)", integer(1, 6), default=1
    )
    terms = key(
        'a list of products of outputs such as "y1*y2", "y1(k-1)^3", "sin(y1)", appended to x(k)',
        list_of(TEXT),
        default=[],
    )

    def lifting(self) -> DelayLifting:
        if self.terms and self.degree > 1:
            raise InputError("terms must be left out where degree is above 1, got both; choose one of them")
        terms = Terms(self.terms) if self.terms else None
        return DelayLifting(self.outputs, self.inputs, Polynomials(self.degree) if self.degree > 1 else terms)


def _others(offered: Mapping[str, type], between: str, quote: str = "") -> str:
    return between.join(f"{quote}{name}{quote}" for name in offered if name != "squares")


class EstimatorSection(Section):
    """[estimator]: equation (15)."""

    window = key("{}, N_bar, how many transitions are fitted", LENGTH)
    weight = key("{}, the weight of the Bregman distance", POSITIVE)
    mixing = key('{}, the constant lambda, "none", or "search" for Lemma 5\'s search', FRACTION, WORDS)
    A0 = key(
        '"companion-of-ones" (first superdiagonal and last row ones), "shift-of-ones" (rows that move outputs along, '
        'and ones), "rough" (from the section [rough]), or a matrix of the order of x(k), which is N_y p without basis '
        "functions",
        WORDS,
        MATRIX,
    )
    B0 = key(
        '"last-row-of-ones", "eye-last-row-of-ones", "shift-of-ones" or "rough" where A0 is, or a matrix, as many rows '
        "as A0 by (N_v q)",
        WORDS,
        MATRIX,
    )
    loss = key(f'"squares", or, where outliers shall count less, {_others(LOSSES, " or ", chr(34))}', default="squares")
    loss_scale = key(
        f"{{}}, the residual above which {_others(LOSSES, ' and ')} count an outlier", POSITIVE, default=1.0
    )
    generator = key(
        f'"squares", or {_others(GENERATORS, " or ", chr(34))} where every entry of A and B is known to be positive',
        default="squares",
    )
    mixing_pair = key('"lifted" or "augmented", the pair that the search keeps controllable', default="augmented")
    mixing_rule = key('"first" or "best", which candidate with enough margin the search takes', default="best")
    mixing_count = key('"lemma" (2 n^2 + 1 candidates) or "sharp" (n (n+1)/2)', default="lemma")
    lambda_max = key("{}, the upper end of the search", OPEN_FRACTION, default=0.9)
    least_margin = key("{}, what the search calls controllable", POSITIVE, default=1e-9)

    def convex_loss(self) -> Convex:
        kind: Any = LOSSES[self.loss]
        self.heeded("loss_scale", "scale" in kind.file_loss, f'where loss is "{self.loss}"')
        return kind(**{name: getattr(self, f"loss_{name}") for name in kind.file_loss})

    def convex_generator(self) -> Convex:
        kind: Any = GENERATORS[self.generator]
        return kind(**{name: getattr(self, name) for name in kind.file_generator})

    def mixed_by(self) -> Mixing:
        for name in ("mixing_pair", "mixing_rule", "mixing_count", "lambda_max", "least_margin"):
            self.heeded(name, self.mixing == "search", 'where mixing is not "search"')
        if self.mixing != "search":
            return ConstantMixing(0.0 if self.mixing == "none" else self.mixing)
        return LambdaSearch(self.mixing_pair, self.mixing_rule, self.lambda_max, self.least_margin, self.mixing_count)


class RoughSection(Section):
    """[rough]: a linear model of the plant, known beforehand and perhaps wrong, from which the estimator starts."""

    F = key("a square matrix of finite numbers, the rough model's state matrix", MATRIX)
    G = key("a matrix of finite numbers, its input matrix, a column for each input of the plant", MATRIX)
    H = key("a matrix of finite numbers, its output matrix, a row for each output of the plant", MATRIX)

    def model(self, outputs: int, inputs: int) -> SignalModel:
        return rough_model(LinearPlant(self.F, self.G, self.H), outputs, inputs)


class KnowledgeSection(Section):
    """[knowledge]: what every estimate must satisfy."""

    shift_rows = key("{}: that the rows of A and B which only move outputs along are known", FLAG, default=False)
    A = key('a matrix like A0 of known numbers and "?" where unknown; empty if nothing is known', PARTIAL, default=[])
    B = key('a matrix like B0 of known numbers and "?" where unknown; empty if nothing is known', PARTIAL, default=[])

    def constraints(self, lifting: DelayLifting, p: int, q: int) -> LinearConstraints | None:
        n, columns = lifting.size(p), q * lifting.inputs
        found = LinearConstraints.entries(_partial("A", self.A, (n, n)), _partial("B", self.B, (n, columns)))
        if self.shift_rows:
            if lifting.basis is not None:
                raise InputError(
                    "shift_rows must be false where x(k) has basis functions, got true; give A and B instead"
                )
            found = found & LinearConstraints.shift(p, lifting.outputs, q, lifting.inputs)
        return found if len(found.b) else None


_WEIGHT = "a positive number (times the identity) or a symmetric positive definite matrix"
_SCHEDULES: dict[str, tuple[Callable[..., Schedule], tuple[str, ...]]] = {
    "harmonic": (PowerDecay, ("eps_rate",)),
    "power": (PowerDecay, ("eps_rate", "eps_power")),
    "exponential": (ExponentialDecay, ("eps_factor",)),
    "constant": (Constant, ("eps_value",)),
}


class ControllerSection(Section):
    """[controller]: equation (3); sizes are those of Remark 4's augmented state, N_y p + (N_v - 1) q."""

    Q = key(f"{_WEIGHT}, (N_y p + (N_v-1) q) square", NUMBER, MATRIX)
    R = key(f"{_WEIGHT}, q square", NUMBER, MATRIX)
    QN = key(f"{_WEIGHT}, (N_y p + (N_v-1) q) square", NUMBER, MATRIX)
    horizon = key("{}, N", LENGTH)
    alpha = key("{}, Gamma(x) = alpha x'x", POSITIVE)
    model_delay = key("0 (control with the estimate of this step) or 1 (of the step before)", integer(0, 1))
    eps = key(
        '"harmonic" (eps(k) = 1/(1 + eps_rate k)), "power" (that to the power eps_power), "exponential" '
        '(eps_factor^k) or "constant" (eps_value, outside Theorem 1)',
        default="harmonic",
    )
    eps_rate = key("{}, for harmonic and power", POSITIVE, default=None)
    eps_power = key("{}, for power", POSITIVE, default=None)
    eps_factor = key("{}, for exponential", OPEN_FRACTION, default=None)
    eps_value = key("{}, for constant", POSITIVE, default=None)
    adaptive = key(
        "{}: that eps moves on only where the value function did not fall, instead of at every step",
        FLAG,
        default=False,
    )

    def controller(self) -> Controller:
        epsilon = self._epsilon()
        return Controller(self.Q, self.R, self.QN, self.horizon, epsilon, self.alpha, self.model_delay, self.adaptive)

    def _epsilon(self) -> Schedule:
        schedule, needed = _SCHEDULES[self.eps]
        for name in ("eps_rate", "eps_power", "eps_factor", "eps_value"):
            self.heeded(name, name in needed, f"where eps is {self.eps!r}")
        for name in needed:
            if name not in self.given:
                what = self.keys()[name]["description"]
                raise InputError(f"{name} must be {what}, got nothing where eps is {self.eps!r}; add the key")
        return schedule(*(getattr(self, name) for name in needed))


class SimulationSection(Section):
    """[simulation]: what errs between scheme and plant, outside the theory."""

    v_min = key("{}, or one for each input: where the actuator saturates", NUMBER, VECTOR, default=None)
    v_max = key("{}, or one for each input, above v_min", NUMBER, VECTOR, default=None)
    applied_known = key(
        "{}: that the scheme remembers the input that the actuator let through, not the one computed",
        FLAG,
        default=True,
    )
    noise = key(
        "{}, or one for each output: the standard deviation of the sensor's normal errors",
        NOT_NEGATIVE,
        list_of(NOT_NEGATIVE),
        default=0.0,
    )
    outlier_rate = key("{}, how probable an outlier is in an output at a step", FRACTION, default=0.0)
    outlier_size = key("{}, how far off an outlier is", POSITIVE, default=1.0)
    seed = key("{}, from which errors and outliers are drawn", integer(0, 2**32 - 1), default=0)

    def actuator(self, q: int) -> Disturbance | None:
        if self.v_min is None and self.v_max is None:
            return None
        for name in ("v_min", "v_max"):
            if name not in self.given:
                raise InputError(f"{name} must be a number where the other bound is given, got nothing; add the key")
        low, high = (_each(name, getattr(self, name), q, "input") for name in ("v_min", "v_max"))
        if np.any(low >= high):
            raise InputError(f"v_min must be below v_max for each input, got {describe(self.v_min)} and {self.v_max}")
        return Saturation(low, high)

    def sensor(self, p: int) -> Disturbances | None:
        std = _each("noise", self.noise, p, "output")
        self.heeded("outlier_size", self.outlier_rate > 0, "where outlier_rate is 0")
        noise = (GaussianNoise(std, self.seed),) if np.any(std > 0) else ()
        wrong = (Outliers(self.outlier_rate, self.outlier_size, self.seed),) if self.outlier_rate else ()
        return (*noise, *wrong) or None


def _each(name: str, value: Any, count: int, of: str) -> Array:
    if isinstance(value, list) and len(value) != count:
        raise InputError(f"{name} must be a number or have {count} entries, one for each {of}, got {len(value)}")
    return real_array(name, value)


def _partial(name: str, rows: list[list[Any]], shape: tuple[int, int]) -> Array:
    if not rows:
        return np.full(shape, np.nan)
    if len(rows) != shape[0] or any(len(row) != shape[1] for row in rows):
        raise InputError(
            f"{name} must have shape {shape}, got {len(rows)} rows of {sorted({len(row) for row in rows})}"
        )
    return np.array([[np.nan if entry == "?" else entry for entry in row] for row in rows], dtype=np.float64)


def _executed(file: str) -> dict[str, Any]:
    folder = os.getcwd()
    try:
        return runpy.run_path(file)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # whatever a user's file raises, sys.exit included
        raise InputError(f"file must be a Python file that runs, got {reason(error)}, from {shown(file)}") from error
    finally:
        os.chdir(folder)  # output is named from there, wherever the file went


def _told(name: str, function: Any, lengths: dict[str, str]) -> Any:
    """Say in one sentence what a file's function raises, which FunctionPlant would let through."""
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
            raise PlantError(f"{wanted}, got {reason(error)}; try it by hand at {where}") from error

    return call
