"""The sections of a run's TOML file: every key, what it must be, and what is built of it."""

from __future__ import annotations

import os
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from rhl._checks import Array, describe, real_array, reason, shown
from rhl.basis import Basis, Polynomials, Terms
from rhl.constraints import LinearConstraints
from rhl.controllability import ConstantMixing, LambdaSearch, Mixing
from rhl.disturbances import Disturbance, Disturbances, GaussianNoise, Outliers, Saturation
from rhl.errors import InputError
from rhl.lifting import DelayLifting
from rhl.losses import Convex, Entropy, LogCosh, PseudoHuber, WeightedSquares
from rhl.model import SignalModel
from rhl.plants import FunctionPlant, LinearPlant, Plant, RobotArm
from rhl.plants.analysis import rough_model
from rhl.plants.examples import EXAMPLES, example
from rhl.schedules import Constant, ExponentialDecay, PowerDecay, Schedule
from rhl.scheme import Controller

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
# The upper ends are far above any use; they keep a slip of the keyboard from taking all memory.
Size = Annotated[int, Field(strict=True, ge=1, le=100)]
Length = Annotated[int, Field(strict=True, ge=1, le=10_000)]
Count = Annotated[int, Field(strict=True, ge=1, le=100_000)]
Seed = Annotated[int, Field(strict=True, ge=0, le=2**32 - 1)]
Positive = Annotated[float, Field(strict=True, gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(strict=True, ge=0, allow_inf_nan=False)]
Fraction = Annotated[float, Field(strict=True, ge=0, lt=1)]
OpenFraction = Annotated[float, Field(strict=True, gt=0, lt=1)]
Flag = Annotated[bool, Field(strict=True)]
Text = Annotated[str, Field(strict=True)]
Vector = list[Number]
Matrix = list[list[Number]]
Partial = list[list[Number | Literal["?"]]]


def key(what: str, **settings: Any) -> Any:
    """Describe a key: the text completes the sentence "KEY must be ..." and is the key's documentation."""
    return Field(description=what, **settings)


class Section(BaseModel):
    """A table of the file."""

    model_config = ConfigDict(extra="forbid", frozen=True, hide_input_in_errors=True)

    def heeded(self, name: str, heeded: bool, where: str) -> None:
        """Refuse a key that is given and would not be heeded.

        Raises
        ------
        InputError
            With the reason.
        """
        if name in self.model_fields_set and not heeded:
            raise InputError(f"{name} must be left out {where}, got {describe(getattr(self, name))}; it has no effect")


class LinearSection(Section):
    """[plant] with kind = "linear": z+ = F z + G v, y = H z, equation (1)."""

    kind: Literal["linear"] = key('"linear"')
    F: Matrix = key("a square matrix of finite numbers, n rows")
    G: Matrix = key("a matrix of finite numbers, n rows and a column for each input")
    H: Matrix = key("a matrix of finite numbers, a row for each output and n columns")
    z0: Vector = key("a list of n finite numbers, the initial state")

    def plant(self) -> Plant:
        """Build the plant."""
        return LinearPlant(_matrix("F", self.F), _matrix("G", self.G), _matrix("H", self.H))


class TransferSection(Section):
    """[plant] with kind = "transfer-function": one input, one output, discrete time."""

    kind: Literal["transfer-function"] = key('"transfer-function"')
    num: Vector = key("a list of finite numbers, the numerator's coefficients, highest power of z first")
    den: Vector = key("a list of finite numbers, the denominator's coefficients, more of them than num has")
    z0: Vector = key("a list of n finite numbers, the initial state in controllable canonical form")

    def plant(self) -> Plant:
        """Build the plant."""
        import control  # here, because it brings matplotlib along

        num, den = np.trim_zeros(self.num, "f"), np.trim_zeros(self.den, "f")
        if not num or len(den) <= len(num):
            raise InputError(
                "den must have a higher degree than num, and num must not be zero (a strictly proper plant), got "
                f"{len(den)} and {len(num)} coefficients; append a zero to den for one more step of delay"
            )
        return LinearPlant.from_control(control.TransferFunction(num, den, True))


class ArmSection(Section):
    """[plant] with kind = "robot-arm": equation (24)."""

    kind: Literal["robot-arm"] = key('"robot-arm"')
    variant: Literal["data", "printed"] = key(
        '"data" (the coefficients behind the published curves) or "printed" (those in the text)'
    )
    z0: Vector = key("a list of 3 finite numbers, the initial state")

    def plant(self) -> Plant:
        """Build the plant."""
        return RobotArm(self.variant)


class ExampleSection(Section):
    """[plant] with kind = "ready": one of the plants that come with the library."""

    kind: Literal["ready"] = key('"ready"')
    name: Text = key(f"one of {', '.join(EXAMPLES)}")
    z0: Vector | None = key("a list of n finite numbers, the initial state; the plant's own if left out", default=None)

    def plant(self) -> Plant:
        """Build the plant."""
        return example(self.name).plant


class PythonSection(Section):
    """[plant] with kind = "python": two functions in a Python file of the user's, which is executed."""

    kind: Literal["python"] = key('"python"')
    file: Text = key(
        "the path of a Python file, seen from the folder of this one, that defines step(z, v) and output(z); it is "
        "executed"
    )
    n: Size = key("an integer from 1 to 100, the size of the state")
    q: Size = key("an integer from 1 to 100, the size of the input")
    z0: Vector = key("a list of n finite numbers, the initial state")

    def plant(self) -> Plant:
        """Execute the file and build the plant from its functions."""
        names = _executed(self.file)
        for name in ("step", "output"):
            if name not in names:
                raise InputError(f"file must define a function {name}, got a file without it: {shown(self.file)}")
        return FunctionPlant(names["step"], names["output"], n=self.n, q=self.q, names=("step", "output"))


PLANTS = (LinearSection, TransferSection, ExampleSection, ArmSection, PythonSection)
PlantSection = Annotated[
    LinearSection | TransferSection | ExampleSection | ArmSection | PythonSection, Field(discriminator="kind")
]


class LiftingSection(Section):
    """[lifting]: equations (14) and (22)."""

    outputs: Size = key("an integer from 1 to 100, N_y, how many outputs x(k) stacks")
    inputs: Size = key("an integer from 1 to 100, N_v, how many inputs u(k) stacks")
    degree: Annotated[int, Field(strict=True, ge=1, le=6)] = key(
        "an integer from 1 to 6; above 1, all monomials of the stacked outputs up to it are appended to x(k)",
        default=1,
    )
    terms: list[Text] = key(
        'a list of products of outputs such as "y1*y2", "y1(k-1)^3", "sin(y1)", appended to x(k)', default=[]
    )

    def lifting(self) -> DelayLifting:
        """Build the lifting."""
        if self.terms and self.degree > 1:
            raise InputError("terms must be left out where degree is above 1, got both; choose one of them")
        basis: Basis | None = Terms(self.terms) if self.terms else None
        return DelayLifting(self.outputs, self.inputs, Polynomials(self.degree) if self.degree > 1 else basis)


class EstimatorSection(Section):
    """[estimator]: equation (15)."""

    window: Length = key("an integer from 1 to 10000, N_bar, how many transitions are fitted")
    weight: Positive = key("a positive number, the weight of the Bregman distance")
    mixing: Fraction | Literal["search", "none"] = key(
        'a number in [0, 1), the constant lambda, "none", or "search" for Lemma 5\'s search'
    )
    A0: Matrix | Literal["companion-of-ones", "shift-of-ones", "rough"] = key(
        '"companion-of-ones" (first superdiagonal and last row ones), "shift-of-ones" (rows that move outputs along, '
        'and ones), "rough" (from the section [rough]), or a matrix of the order of x(k), which is N_y p without basis '
        "functions"
    )
    B0: Matrix | Literal["last-row-of-ones", "eye-last-row-of-ones", "shift-of-ones", "rough"] = key(
        '"last-row-of-ones", "eye-last-row-of-ones", "shift-of-ones" or "rough" where A0 is, or a matrix, as many rows '
        "as A0 by (N_v q)"
    )
    loss: Literal["squares", "log-cosh", "pseudo-huber"] = key(
        '"squares", or, where outliers shall count less, "log-cosh" or "pseudo-huber"', default="squares"
    )
    loss_scale: Positive = key(
        "a positive number, the residual above which log-cosh and pseudo-huber count an outlier", default=1.0
    )
    generator: Literal["squares", "entropy"] = key(
        '"squares", or "entropy" where every entry of A and B is known to be positive', default="squares"
    )
    mixing_pair: Literal["lifted", "augmented"] = key(
        '"lifted" or "augmented", the pair that the search keeps controllable', default="augmented"
    )
    mixing_rule: Literal["first", "best"] = key(
        '"first" or "best", which candidate with enough margin the search takes', default="best"
    )
    mixing_count: Literal["lemma", "sharp"] = key(
        '"lemma" (2 n^2 + 1 candidates) or "sharp" (n (n+1)/2)', default="lemma"
    )
    lambda_max: OpenFraction = key("a number in (0, 1), the upper end of the search", default=0.9)
    least_margin: Positive = key("a positive number, what the search calls controllable", default=1e-9)

    def convex_loss(self) -> Convex:
        """Build the loss."""
        self.heeded("loss_scale", self.loss != "squares", 'where loss is "squares"')
        if self.loss == "squares":
            return WeightedSquares()
        return LogCosh(self.loss_scale) if self.loss == "log-cosh" else PseudoHuber(self.loss_scale)

    def convex_generator(self) -> Convex:
        """Build the generator."""
        return WeightedSquares(self.weight) if self.generator == "squares" else Entropy(self.weight)

    def mixed_by(self) -> Mixing:
        """Build the rule of mixing."""
        for name in ("mixing_pair", "mixing_rule", "mixing_count", "lambda_max", "least_margin"):
            self.heeded(name, self.mixing == "search", 'where mixing is not "search"')
        if self.mixing == "search":
            return LambdaSearch(
                self.mixing_pair, self.mixing_rule, self.lambda_max, self.least_margin, self.mixing_count
            )
        return ConstantMixing(0.0 if self.mixing == "none" else self.mixing)


class RoughSection(Section):
    """[rough]: a linear model of the plant, known beforehand and perhaps wrong, from which the estimator starts."""

    F: Matrix = key("a square matrix of finite numbers, the rough model's state matrix")
    G: Matrix = key("a matrix of finite numbers, its input matrix, a column for each input of the plant")
    H: Matrix = key("a matrix of finite numbers, its output matrix, a row for each output of the plant")

    def model(self, outputs: int, inputs: int) -> SignalModel:
        """Build the lifted model that it makes."""
        plant = LinearPlant(_matrix("F", self.F), _matrix("G", self.G), _matrix("H", self.H))
        return rough_model(plant, outputs, inputs)


class KnowledgeSection(Section):
    """[knowledge]: what every estimate must satisfy."""

    shift_rows: Flag = key(
        "true or false: that the rows of A and B which only move outputs along are known", default=False
    )
    A: Partial = key('a matrix like A0 of known numbers and "?" where unknown; empty if nothing is known', default=[])
    B: Partial = key('a matrix like B0 of known numbers and "?" where unknown; empty if nothing is known', default=[])

    def constraints(self, lifting: DelayLifting, p: int, q: int) -> LinearConstraints | None:
        """Build the equalities; None where there are none."""
        n, columns = lifting.size(p), q * lifting.inputs
        A, B = _partial("A", self.A, (n, n)), _partial("B", self.B, (n, columns))
        found = LinearConstraints.entries(A, B)
        if self.shift_rows:
            if lifting.basis is not None:
                raise InputError(
                    "shift_rows must be false where x(k) has basis functions, got true; give A and B instead"
                )
            found = found & LinearConstraints.shift(p, lifting.outputs, q, lifting.inputs)
        return found if len(found.b) else None


class ControllerSection(Section):
    """[controller]: equation (3); sizes are those of Remark 4's augmented state, N_y p + (N_v - 1) q."""

    Q: Number | Matrix = key(
        "a positive number (times the identity) or a symmetric positive definite matrix, (N_y p + (N_v-1) q) square"
    )
    R: Number | Matrix = key("a positive number (times the identity) or a symmetric positive definite matrix, q square")
    QN: Number | Matrix = key(
        "a positive number (times the identity) or a symmetric positive definite matrix, (N_y p + (N_v-1) q) square"
    )
    horizon: Length = key("an integer from 1 to 10000, N")
    alpha: Positive = key("a positive number, Gamma(x) = alpha x'x")
    model_delay: Annotated[int, Field(strict=True, ge=0, le=1)] = key(
        "0 (control with the estimate of this step) or 1 (of the step before)"
    )
    eps: Literal["harmonic", "power", "exponential", "constant"] = key(
        '"harmonic" (eps(k) = 1/(1 + eps_rate k)), "power" (that to the power eps_power), "exponential" '
        '(eps_factor^k) or "constant" (eps_value, outside Theorem 1)',
        default="harmonic",
    )
    eps_rate: Positive | None = key("a positive number, for harmonic and power", default=None)
    eps_power: Positive | None = key("a positive number, for power", default=None)
    eps_factor: OpenFraction | None = key("a number in (0, 1), for exponential", default=None)
    eps_value: Positive | None = key("a positive number, for constant", default=None)
    adaptive: Flag = key(
        "true or false: that eps moves on only where the value function did not fall, instead of at every step",
        default=False,
    )

    def controller(self) -> Controller:
        """Build the controller."""
        return Controller(
            Q=_weight("Q", self.Q),
            R=_weight("R", self.R),
            QN=_weight("QN", self.QN),
            horizon=self.horizon,
            epsilon=self._epsilon(),
            alpha=self.alpha,
            model_delay=self.model_delay,
            adaptive=self.adaptive,
        )

    def _epsilon(self) -> Schedule:
        for name, schedules in (
            ("eps_rate", ("harmonic", "power")),
            ("eps_power", ("power",)),
            ("eps_factor", ("exponential",)),
            ("eps_value", ("constant",)),
        ):
            self.heeded(name, self.eps in schedules, f"where eps is {self.eps!r}")
        if self.eps == "harmonic":
            return PowerDecay(self._needed("eps_rate"))
        if self.eps == "power":
            return PowerDecay(self._needed("eps_rate"), self._needed("eps_power"))
        return (
            ExponentialDecay(self._needed("eps_factor"))
            if self.eps == "exponential"
            else Constant(self._needed("eps_value"))
        )

    def _needed(self, name: str) -> float:
        value: float | None = getattr(self, name)
        if value is None:
            what = type(self).model_fields[name].description
            raise InputError(f"{name} must be {what}, got nothing where eps is {self.eps!r}; add the key")
        return value


class SimulationSection(Section):
    """[simulation]: what errs between scheme and plant, outside the theory."""

    v_min: Number | Vector | None = key("a number, or one for each input: where the actuator saturates", default=None)
    v_max: Number | Vector | None = key("a number, or one for each input, above v_min", default=None)
    applied_known: Flag = key(
        "true or false: that the scheme remembers the input that the actuator let through, not the one computed",
        default=True,
    )
    noise: NotNegative | list[NotNegative] = key(
        "a number of at least 0, or one for each output: the standard deviation of the sensor's normal errors",
        default=0.0,
    )
    outlier_rate: Fraction = key("a number in [0, 1), how probable an outlier is in an output at a step", default=0.0)
    outlier_size: Positive = key("a positive number, how far off an outlier is", default=1.0)
    seed: Seed = key("an integer from 0 to 4294967295, from which errors and outliers are drawn", default=0)

    def actuator(self, q: int) -> Disturbance | None:
        """Build the actuator; None where it lets everything through."""
        if self.v_min is None and self.v_max is None:
            return None
        for name in ("v_min", "v_max"):
            value = getattr(self, name)
            if value is None:
                raise InputError(f"{name} must be a number where the other bound is given, got nothing; add the key")
            if isinstance(value, list) and len(value) != q:
                raise InputError(f"{name} must be a number or have {q} entries, one for each input, got {len(value)}")
        assert self.v_min is not None
        assert self.v_max is not None
        low, high = real_array("v_min", self.v_min), real_array("v_max", self.v_max)
        if np.any(low >= high):
            raise InputError(f"v_min must be below v_max for each input, got {describe(self.v_min)} and {self.v_max}")
        return Saturation(low, high)

    def sensor(self, p: int) -> Disturbances | None:
        """Build the sensor; None where it is exact."""
        if isinstance(self.noise, list) and len(self.noise) != p:
            raise InputError(f"noise must be a number or have {p} entries, one for each output, got {len(self.noise)}")
        noisy = (
            GaussianNoise(real_array("noise", self.noise), self.seed) if np.any(np.asarray(self.noise) > 0) else None
        )
        self.heeded("outlier_size", self.outlier_rate > 0, "where outlier_rate is 0")
        if not self.outlier_rate:
            return noisy
        wrong = Outliers(self.outlier_rate, self.outlier_size, self.seed)
        return wrong if noisy is None else (noisy, wrong)


def _matrix(name: str, rows: Matrix) -> Array:
    return real_array(name, rows, (None, None))


def _weight(name: str, value: float | Matrix) -> Array | float:
    return value if isinstance(value, float) else _matrix(name, value)


def _partial(name: str, rows: Partial, shape: tuple[int, int]) -> Array:
    if not rows:
        return np.full(shape, np.nan)
    if len(rows) != shape[0] or any(len(row) != shape[1] for row in rows):
        raise InputError(
            f"{name} must have shape {shape}, got {len(rows)} rows of {sorted({len(row) for row in rows})}"
        )
    return np.array([[np.nan if entry == "?" else entry for entry in row] for row in rows], dtype=np.float64)


def _executed(file: str) -> dict[str, Any]:
    import runpy

    folder = os.getcwd()
    try:
        return runpy.run_path(file)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # whatever a user's file raises, sys.exit included
        raise InputError(f"file must be a Python file that runs, got {reason(error)}, from {shown(file)}") from error
    finally:
        os.chdir(folder)  # output is named from there, wherever the file went
