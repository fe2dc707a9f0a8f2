"""The paper's simulations in ball arithmetic: every number with a proved bound of its error.

A ball is a midpoint and a radius. Arithmetic on balls (``arb``, of the package python-flint) rounds the midpoint and
enlarges the radius accordingly, so the ball always contains the true number. A result is therefore a theorem about the
scheme with exact numbers, not a measurement of a program. The recipe is implemented again with other formulas than the
library's: normal equations and the textbook Riccati recursion, which need many digits.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from importlib import import_module
from typing import TYPE_CHECKING, Any, Protocol, cast

import numpy as np

from rhl.controllability import ConstantMixing
from rhl.errors import InputError
from rhl.estimator import ProximalEstimator
from rhl.losses import WeightedSquares
from rhl.paper import published
from rhl.paper.published import Experiment
from rhl.plants import LinearPlant, RobotArm
from rhl.schedules import PowerDecay

if TYPE_CHECKING:
    from flint import arb, arb_mat

Exact = tuple[Fraction, ...]

# The loss of bits grows with the length of a run; with these the last samples still have some hundred digits.
LINEAR_BITS = 4000
ROBOT_BITS = 6000


def flint() -> Any:
    """Return the package python-flint; ModuleNotFoundError, in one sentence that names the extra, if it is missing.

    It is loaded on first use, so that everything else works without it.
    """
    try:
        return import_module("flint")
    except ModuleNotFoundError as error:
        sentence = "certified numbers need the package python-flint, got none installed; pip install 'rhl[paper]'"
        raise ModuleNotFoundError(sentence, name="flint") from error


def ball(number: Fraction | int | float) -> arb:
    """Enclose an exact number in the current precision; a float counts as its exact value."""
    exact, package = Fraction(number), flint()
    return cast("arb", package.arb(package.fmpq(exact.numerator, exact.denominator)))


def whole_line() -> arb:
    """Return the ball that contains every real number, for an unknown number."""
    return cast("arb", flint().arb(0, "inf"))


def decimal(number: float) -> Fraction:
    """Return the decimal fraction printed for a float64: 0.1 is a tenth, not the nearest float64.

    Examples
    --------
    >>> decimal(0.1)
    Fraction(1, 10)
    """
    return Fraction(repr(float(number)))


class ExactPlant(Protocol):
    """A plant with one input, in balls."""

    def step(self, z: Sequence[arb], v: arb) -> list[arb]:
        """Return z(k+1)."""

    def output(self, z: Sequence[arb]) -> list[arb]:
        """Return y(k)."""


@dataclass(frozen=True)
class ExactLinear:
    """z+ = F z + G v, y = H z with fractions: F (n, n), G (n), H (p, n), row by row."""

    F: tuple[Exact, ...]
    G: Exact
    H: tuple[Exact, ...]

    def step(self, z: Sequence[arb], v: arb) -> list[arb]:
        """Return F z + G v."""
        return [_dot(row, z) + ball(g) * v for row, g in zip(self.F, self.G, strict=True)]

    def output(self, z: Sequence[arb]) -> list[arb]:
        """Return H z."""
        return [_dot(row, z) for row in self.H]


# The fractions for the floats of `rhl.plants.robot_arm`, row by row of (24); a test compares the two.
ARM: dict[str, Exact] = {
    "data": tuple(map(Fraction, ("400/11", "478/275", "1000/11", "86.04", "3.64", "100"))),
    "printed": tuple(map(Fraction, ("36.4", "1.7", "1309", "1000", "3.6", "100"))),
}


@dataclass(frozen=True)
class ExactArm:
    """The robot arm (24), Euler-discretised with step ``h``; ``coefficients`` are a, ..., f as in ``RobotArm``."""

    coefficients: Exact
    h: Fraction

    def step(self, z: Sequence[arb], v: arb) -> list[arb]:
        """Return z + h f(z, v); the sine is enclosed too."""
        a, b, c, d, e, f = map(ball, self.coefficients)
        (x1, x2, x3), h = z, ball(self.h)
        return [x1 + h * x2, x2 + h * (a * x3 - b * x2 - c * x1.sin()), x3 + h * (f * v - d * x3 - e * x2)]

    def output(self, z: Sequence[arb]) -> list[arb]:
        """Return the state itself."""
        return list(z)


@dataclass(frozen=True, eq=False)
class Recipe:
    """An experiment in exact numbers: squares, one input, multiples of the identity as weights, the estimate of k-1.

    Attributes
    ----------
    name, plant, z0 : str, ExactPlant, tuple of Fraction
        The plant and its initial state.
    outputs, inputs, window, horizon, steps : int
        The numbers of stacked y(k) and v(k), of fitted transitions, N, and the number of steps.
    theta : tuple of tuples of Fraction, shape (n, n + inputs)
        The initial model [A(0) B(0)].
    Q, R, QN, rate, mixing : Fraction
        Q I, R I, Q_N I; eps(k) = 1/(1 + rate k); lambda of theta~(k) = (1 - lambda) theta*(k) + lambda theta~(k-1).
    """

    name: str
    plant: ExactPlant
    z0: Exact
    outputs: int
    inputs: int
    window: int
    horizon: int
    steps: int
    theta: tuple[Exact, ...]
    Q: Fraction
    R: Fraction
    QN: Fraction
    rate: Fraction
    mixing: Fraction


def recipe_of(experiment: Experiment) -> Recipe:
    """Return an experiment in exact numbers, the decimal fractions of its floats.

    InputError if ``Recipe`` does not cover its settings.
    """
    scheme, plant = experiment.scheme, experiment.plant
    estimator, controller, lifting, mixing = scheme.estimator, scheme.controller, scheme.lifting, scheme.mixing
    squares = (estimator.loss, estimator.generator)
    simple = (
        isinstance(estimator, ProximalEstimator)
        and isinstance(controller.epsilon, PowerDecay)
        and controller.epsilon.power == 1
        and isinstance(mixing, ConstantMixing)
        and all(isinstance(weight, float) for weight in (controller.Q, controller.R, controller.QN))
        and (controller.alpha, controller.model_delay, scheme.q, lifting.basis) == (1.0, 1, 1, None)
        and all(isinstance(of, WeightedSquares) and np.all(of.weight == 1) for of in squares)
        and not controller.adaptive
        and all(of is None for of in (estimator.constraints, controller.bounds))
        and all(of is None for of in (scheme.units, scheme.set_point, scheme.family))
        and all(of is None for of in (experiment.sensor, experiment.actuator, experiment.load))
        and isinstance(plant, LinearPlant | RobotArm)
    )
    if not simple:
        raise InputError(f"{experiment.name} must be one of the paper's experiments, with settings of the same kind")
    exact: ExactPlant
    if isinstance(plant, LinearPlant):
        exact = ExactLinear(_decimals(plant.F), tuple(decimal(g) for g in plant.G[:, 0]), _decimals(plant.H))
    else:
        arm = cast(RobotArm, plant)
        exact = ExactArm(ARM[arm.variant], decimal(arm.h))
    model = scheme.initial_model
    fitted, schedule, mixed = (cast(Any, of) for of in (estimator, controller.epsilon, mixing))
    return Recipe(
        experiment.name,
        exact,
        tuple(decimal(z) for z in experiment.z0),
        lifting.outputs,
        lifting.inputs,
        fitted.window,
        controller.horizon,
        experiment.steps,
        tuple(a + b for a, b in zip(_decimals(model.A), _decimals(model.B), strict=True)),
        decimal(cast(float, controller.Q)),
        decimal(cast(float, controller.R)),
        decimal(cast(float, controller.QN)),
        decimal(schedule.rate),
        decimal(mixed.lam),
    )


def linear_recipe(*, printed: bool = False) -> Recipe:
    """Return the linear example, (23), in exact numbers; ``printed`` as in ``published.linear_example``."""
    return recipe_of(published.linear_example(printed=printed))


def robot_recipe(*, printed: bool = False) -> Recipe:
    """Return the robot arm, (24), in exact numbers; ``printed`` as in ``published.robot_arm``."""
    return recipe_of(published.robot_arm(printed=printed))


@dataclass(frozen=True, eq=False)
class Enclosure:
    """A run in balls; if the precision did not suffice, balls are the whole line, which contains any run.

    Attributes
    ----------
    recipe, bits : Recipe, int
        The recipe, and the precision in bits.
    z, y, y_hat : tuples of tuples of arb, shapes (steps, n), (steps, p), (steps, p)
        States, outputs, and the outputs predicted at k-1 (y(0) at k = 0).
    u : tuple of arb, shape (steps)
        Inputs.
    """

    recipe: Recipe
    bits: int
    z: tuple[tuple[arb, ...], ...]
    y: tuple[tuple[arb, ...], ...]
    y_hat: tuple[tuple[arb, ...], ...]
    u: tuple[arb, ...]

    @property
    def gamma_over_eps(self) -> tuple[arb, ...]:
        """Figure 6's weight, (|y(k)|^2 + ... + |y(k-N_y+1)|^2 + |v(k)|^2 + ... + |v(k-N_v+2)|^2) / eps(k)."""
        recipe, found = self.recipe, []
        with flint().ctx.workprec(self.bits):
            for k in range(len(self.u)):
                stacked = [e for y in self.y[max(0, k - recipe.outputs + 1) : k + 1] for e in y]
                stacked += self.u[max(0, k - recipe.inputs + 2) : k + 1]
                found.append(_squares(stacked) * ball(1 + recipe.rate * k))
        return tuple(found)


def enclose(recipe: Recipe, bits: int, data: tuple[Sequence[Fraction], Sequence[Fraction]] | None = None) -> Enclosure:
    """Run a recipe in balls with the given precision.

    ``data``: outputs y(k), of a plant with one output, and inputs v(k), that the scheme gets instead of its own;
    ``u`` are then its inputs for them, and the states are the whole line. Otherwise the states follow from its own
    inputs.
    """
    with flint().ctx.workprec(bits):
        return _enclose(recipe, bits, data)


def _enclose(recipe: Recipe, bits: int, data: tuple[Sequence[Fraction], Sequence[Fraction]] | None) -> Enclosure:
    matrix, zero = flint().arb_mat, ball(0)
    plant, z = recipe.plant, [ball(value) for value in recipe.z0]
    theta = matrix([[ball(entry) for entry in row] for row in recipe.theta])
    p, depth = theta.nrows() // recipe.outputs, recipe.window + max(recipe.outputs, recipe.inputs) + 1
    past_y, past_v = [[zero] * p] * depth, [zero] * depth  # newest first
    rows = []

    def x(age: int) -> list[arb]:
        return [entry for y in past_y[age : age + recipe.outputs] for entry in y]

    def u(age: int) -> list[arb]:
        return past_v[age : age + recipe.inputs]

    for k in range(recipe.steps if data is None else len(data[0])):
        y = plant.output(z) if data is None else [ball(data[0][k])]
        past_y = [y, *past_y[:-1]]
        X = x(0) + past_v[: recipe.inputs - 1]
        y_hat = y if k == 0 else _column(theta * _as_column(x(1) + u(0)))[:p]
        try:
            after = theta if k == 0 else _fit(theta, [x(j) for j in range(recipe.window + 1)], u, recipe.mixing)
            v = _first_input(recipe, _augment(recipe, theta), X, _squares(X) * ball(1 + recipe.rate * k))
        except ZeroDivisionError:  # the balls are so wide that they contain a singular matrix
            break
        rows.append((z, y, y_hat, v))
        theta = after
        if data is None:
            past_v, z = [v, *past_v[:-1]], plant.step(z, v)
        else:
            past_v, z = [ball(data[1][k]), *past_v[:-1]], [whole_line()] * len(z)
    unknown = ([whole_line()] * len(z), [whole_line()] * p, [whole_line()] * p, whole_line())
    rows += [unknown] * ((recipe.steps if data is None else len(data[0])) - len(rows))
    states, outputs, predicted, inputs = zip(*rows, strict=True)
    return Enclosure(
        recipe, bits, tuple(map(tuple, states)), tuple(map(tuple, outputs)), tuple(map(tuple, predicted)), inputs
    )


def _fit(theta: arb_mat, x: list[list[arb]], u: Any, mixing: Fraction) -> arb_mat:
    """Return theta~(k): theta~ + (1 - lambda) (S - R theta~')'(I + R R')^-1 R, the minimiser of (15), mixed."""
    matrix = flint().arb_mat
    R = matrix([x[j + 1] + u(j) for j in range(len(x) - 1)])
    weighed = R * R.transpose()
    for j in range(len(x) - 1):
        weighed[j, j] = weighed[j, j] + 1
    missed = matrix(x[:-1]) - R * theta.transpose()
    return theta + (R.transpose() * weighed.solve(missed)).transpose() * ball(1 - mixing)


def _augment(recipe: Recipe, theta: arb_mat) -> tuple[arb_mat, arb_mat]:
    """Return Remark 4's pair."""
    matrix, n, past = flint().arb_mat, theta.nrows(), recipe.inputs - 1
    A, B = matrix(n + past, n + past), matrix(n + past, 1)
    for i in range(n):
        for j in range(n):
            A[i, j] = theta[i, j]
        for j in range(past):
            A[i, n + j] = theta[i, n + 1 + j]
        B[i, 0] = theta[i, n]
    for j in range(past - 1):
        A[n + 1 + j, n + j] = 1
    if past:
        B[n, 0] = 1
    return A, B


def _first_input(recipe: Recipe, pair: tuple[arb_mat, arb_mat], X: list[arb], weight: arb) -> arb:
    """Return the first input of V1's solution by the Riccati recursion, with ``weight`` Gamma/eps."""
    A, B = pair
    P, K = _diagonal(len(X), weight * ball(recipe.QN)), B.transpose()
    half = ball(Fraction(1, 2))
    for _ in range(recipe.horizon):
        PB = P * B
        K = PB.transpose() * A * (1 / (ball(recipe.R) + (B.transpose() * PB)[0, 0]))
        P = A.transpose() * (P * (A - B * K))
        P = (P + P.transpose()) * half + _diagonal(len(X), ball(recipe.Q))
    return -(K * _as_column(X))[0, 0]


def _diagonal(n: int, entry: arb) -> arb_mat:
    found = flint().arb_mat(n, n)
    for i in range(n):
        found[i, i] = entry
    return found


def _as_column(entries: Sequence[arb]) -> arb_mat:
    return flint().arb_mat([[entry] for entry in entries])


def _column(found: arb_mat) -> list[arb]:
    return [found[i, 0] for i in range(found.nrows())]


def _squares(entries: Iterable[arb]) -> arb:
    # `e * e` of a ball that contains zero would extend below zero.
    return sum((entry**2 for entry in entries), ball(0))


def _dot(row: Exact, z: Sequence[arb]) -> arb:
    return sum((ball(a) * b for a, b in zip(row, z, strict=True) if a), ball(0))


def _decimals(matrix: Any) -> tuple[Exact, ...]:
    return tuple(tuple(decimal(entry) for entry in row) for row in matrix)
