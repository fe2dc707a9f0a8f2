"""The sections of a run's TOML file except its plant: keys, allowed values and the objects built from them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import astuple, replace
from typing import Any

import numpy as np

from rhl._checks import Array, describe, real_array
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
from rhl.controller import Controller
from rhl.disturbances import Disturbance, Disturbances, GaussianNoise, Offset, Outliers, Saturation
from rhl.errors import InputError
from rhl.estimator import ProximalEstimator
from rhl.lifting import DelayLifting
from rhl.losses import GENERATORS, LOSSES, Convex, WeightedSquares
from rhl.memory import GrowingMemory
from rhl.model import SignalModel
from rhl.plants import LinearPlant
from rhl.plants.analysis import rough_model
from rhl.schedules import Constant, ExponentialDecay, PowerDecay, Schedule
from rhl.scheme import Scheme


class LiftingSection(Section):
    """[lifting]: equations (14) and (22)."""

    overrides = True
    outputs = key("{}, N_y, how many outputs x(k) stacks, at most 1000 numbers", SIZE)
    inputs = key("{}, N_v, how many inputs u(k) stacks, at most 1000 numbers", SIZE)
    degree = key(
        "{}; above 1, all monomials of the stacked outputs up to it are appended to x(k)", integer(1, 6), default=1
    )
    terms = key(
        'a list of products of outputs such as "y1*y2", "y1(k-1)^3", "sin(y1)", appended to x(k)',
        list_of(TEXT),
        default=[],
    )

    def lifting(self, chosen: DelayLifting | None) -> DelayLifting:
        if self.terms and self.degree > 1:
            raise InputError("terms must be left out where degree is above 1, got both; choose one of them")
        terms = Terms(self.terms) if self.terms else None
        outputs, inputs = (int(self.given.get(name, getattr(chosen, name, 0))) for name in ("outputs", "inputs"))
        return DelayLifting(outputs, inputs, Polynomials(self.degree) if self.degree > 1 else terms)


def _others(offered: Mapping[str, type], between: str, quote: str = "") -> str:
    return between.join(f"{quote}{name}{quote}" for name in offered if name != "squares")


class EstimatorSection(Section):
    """[estimator]: equation (15)."""

    overrides = True
    window = key("{}, N_bar, how many transitions are fitted; all, if left out where order is given", LENGTH)
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
    loss = key(
        f'"squares", or, to reduce the effect of outliers, {_others(LOSSES, " or ", chr(34))}', default="squares"
    )
    loss_scale = key(
        f"{{}}, the residual above which {_others(LOSSES, ' and ')} treat a datum as an outlier", POSITIVE, default=1.0
    )
    generator = key(
        f'"squares", or {_others(GENERATORS, " or ", chr(34))} where every entry of A and B is known to be positive',
        default="squares",
    )
    mixing_pair = key('"lifted" or "augmented", the pair that the search keeps controllable', default="augmented")
    mixing_rule = key('"first" or "best", which of the candidates with enough margin the search takes', default="best")
    mixing_count = key('"lemma" (2 n^2 + 1 candidates) or "sharp" (n (n+1)/2)', default="lemma")
    lambda_max = key("{}, the upper end of the search", OPEN_FRACTION, default=0.9)
    least_margin = key("{}, the smallest margin that the search accepts", POSITIVE, default=1e-9)

    def convex_loss(self) -> Convex:
        kind: Any = LOSSES[self.loss]
        self.heeded("loss_scale", "scale" in kind.file_loss, f'where loss is "{self.loss}"')
        return kind(**{name: getattr(self, f"loss_{name}") for name in kind.file_loss})

    def convex_generator(self) -> Convex:
        kind: Any = GENERATORS[self.generator]
        return kind(**{name: getattr(self, name) for name in kind.file_generator})

    def estimator(
        self, chosen: Scheme | None, constraints: LinearConstraints | None
    ) -> ProximalEstimator | GrowingMemory:
        if self.window is not None:
            loss = self.convex_loss()
            memory = None if chosen is None else chosen.estimator
            if self.weight is None and self.generator != "squares":
                raise InputError(
                    f'weight must be given where generator is "{self.generator}", got nothing; add the key'
                )
            if self.weight is None and isinstance(memory, GrowingMemory):
                return ProximalEstimator(self.window, loss, WeightedSquares(memory.weight), constraints)
            return ProximalEstimator(self.window, loss, self.convex_generator(), constraints)
        assert chosen is not None
        for name in ("loss", "loss_scale", "generator"):
            self.heeded(name, getattr(self, name) == "squares", "where window is, since all transitions are squares")
        if constraints is not None:
            raise InputError("window must be given where [knowledge] is, got nothing; add the key")
        return chosen.estimator if self.weight is None else GrowingMemory(self.weight)

    def mixed_by(self, chosen: Scheme | None) -> Mixing:
        for name in ("mixing_pair", "mixing_rule", "mixing_count", "lambda_max", "least_margin"):
            self.heeded(name, self.mixing == "search", 'where mixing is not "search"')
        if self.mixing is None and chosen is not None:
            return chosen.mixing
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

    shift_rows = key("{}: whether the rows of A and B that only shift outputs are known", FLAG, default=False)
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

    overrides = True
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
    bounded = key(
        "{}: whether plans keep v_min and v_max of [simulation] instead of being clipped there; true with order",
        FLAG,
        default=False,
    )
    adaptive = key(
        "{}: whether eps decreases only where the value function did not fall, instead of at every step",
        FLAG,
        default=False,
    )

    def controller(self, chosen: Controller | None, actuator: Saturation | None) -> Controller:
        if self.bounded and actuator is None:
            raise InputError("bounded must be false where [simulation] has no v_min and v_max, got true; add them")
        bounds = actuator if self.bounded or (chosen is not None and "bounded" not in self.given) else None
        if chosen is None:
            whole = self.Q, self.R, self.QN, self.horizon, self._epsilon(), self.alpha, self.model_delay, self.adaptive
            return Controller(*whole, bounds)
        names = ("Q", "R", "QN", "horizon", "alpha", "model_delay", "adaptive")
        changes = {name: self.given[name] for name in names if name in self.given}
        known = chosen.epsilon
        if "eps" not in self.given and isinstance(known, PowerDecay):
            rate, power = (
                self.given.get(name, default)
                for name, default in zip(("eps_rate", "eps_power"), astuple(known), strict=True)
            )
            for name in ("eps_factor", "eps_value"):
                self.heeded(name, False, "where eps is")
            changes["epsilon"] = PowerDecay(rate, power)
        elif any(name.startswith("eps") for name in self.given):
            changes["epsilon"] = self._epsilon()
        return replace(chosen, bounds=bounds, **changes)

    def _epsilon(self) -> Schedule:
        schedule, needed = _SCHEDULES[self.eps]
        for name in ("eps_rate", "eps_power", "eps_factor", "eps_value"):
            self.heeded(name, name in needed, f"where eps is {self.eps!r}")
        for name in needed:
            if name not in self.given:
                what = self.keys()[name]["description"]
                raise InputError(f"{name} must be {what}, got nothing where eps is {self.eps!r}; add the key")
        return schedule(*(getattr(self, name) for name in needed))


def too_heavy(controller: Controller, k: int) -> str:
    """Say which key makes the weight alpha x'x / eps(k) leave the range of float64; "" if the state does."""
    schedule: Any = controller.epsilon
    names = next(names for kind, names in _SCHEDULES.values() if kind is type(schedule))
    if isinstance(schedule, PowerDecay) and schedule.power != 1:
        names = _SCHEDULES["power"][1]
    # In powers of ten: if the file's factors use less than half of the range, the state is the cause.
    by_alpha, by_eps = math.log10(controller.alpha), -math.log10(schedule(k))
    if by_alpha + by_eps < 154:
        return ""
    if by_alpha > by_eps:
        return f"controller.alpha must be smaller, got {controller.alpha:g}"
    keys = " or ".join(f"controller.{name}" for name in names)
    got = " and ".join(f"{value:g}" for value in astuple(schedule)[: len(names)])
    size = "smaller" if isinstance(schedule, PowerDecay) else "larger"
    return f"{keys} must be {size}, got {got}, which makes eps({k}) {schedule(k):.3g}"


class SimulationSection(Section):
    """[simulation]: limits, errors and disturbances between scheme and plant, outside the theory."""

    v_min = key("{}, or one for each input: where the actuator saturates", NUMBER, VECTOR, default=None)
    v_max = key("{}, or one for each input, above v_min", NUMBER, VECTOR, default=None)
    load = key(
        "{}, or one for each input: a constant that is added to the plant's input, unknown to the scheme",
        NUMBER,
        VECTOR,
        default=0.0,
    )
    load_start = key("{}, the first k at which the load acts", integer(0, 100_000), default=0)
    applied_known = key(
        "{}: whether the scheme records the input after the actuator, not the computed one",
        FLAG,
        default=True,
    )
    noise = key(
        "{}, or one for each output: the standard deviation of the sensor's normal errors",
        NOT_NEGATIVE,
        list_of(NOT_NEGATIVE),
        default=0.0,
    )
    outlier_rate = key("{}, the probability of an outlier in an output at a step", FRACTION, default=0.0)
    outlier_size = key("{}, the size of an outlier", POSITIVE, default=1.0)
    seed = key("{}, the seed of errors and outliers", integer(0, 2**32 - 1), default=0)

    def actuator(self, q: int) -> Saturation | None:
        if self.v_min is None and self.v_max is None:
            return None
        for name in ("v_min", "v_max"):
            if name not in self.given:
                raise InputError(f"{name} must be a number where the other bound is given, got nothing; add the key")
        low, high = (_each(name, getattr(self, name), q, "input") for name in ("v_min", "v_max"))
        if np.any(low >= high):
            raise InputError(f"v_min must be below v_max for each input, got {describe(self.v_min)} and {self.v_max}")
        return Saturation(low, high)

    def disturbance(self, q: int) -> Disturbance | None:
        value = _each("load", self.load, q, "input")
        self.heeded("load_start", bool(np.any(value != 0)), "where load is 0")
        return Offset(value, self.load_start) if np.any(value != 0) else None

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
