"""The minimiser of equation (15): Newton's method, and scipy's trust-region method if Newton's fails."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from rhl._checks import Array
from rhl.errors import InputError, NotSolvedError
from rhl.losses._convex import Convex, called
from rhl.losses._proximal import TOLERANCE, Flat, Proximal

# The result of a method: the solution, its certified distance from the minimiser, and a message.
Answer = tuple[Array, float, str]

# Newton's method converges within a few steps or not at all.
_STEPS = 40
# A Newton step may pass the minimum along its direction until the slope is this share of the initial one, rising.
_PAST = 0.1
# How often a step is shortened.
_SHORTER = 30
# Steps below this length, relative to the model, are full steps.
_NEAR = 1e-4
_ITERATIONS = 60
# Newton steps that refine scipy's solution, whose accuracy is limited by squaring the data; the last ones change
# nothing.
_POLISHES = 3
# Residuals of 1e30 times the loss's scale cannot be resolved with sixteen digits.
_MOST_HALVINGS = 100
# A step this short, relative to the model, is below rounding, and the solver's problem would underflow.
_NO_STEP = 1e-16


class _Theirs(Exception):
    """Carries an exception of a user's function past scipy and past handlers of numerical failures."""

    def __init__(self, error: Exception) -> None:
        self.error = error


def solve(problem: Proximal) -> Array:
    """Return the certified minimiser from Newton's method, or from scipy's trust-region method if Newton's fails.

    InputError if the centre is not in the generator's domain, NotSolvedError if the certificate is missed.
    """
    if not np.all(problem.centre > problem.g.lower):
        raise InputError(
            f"the proximal centre must lie in the domain of {called(problem.g)}, above {problem.g.lower:g}, got "
            f"{problem.centre.min():.3g}; choose an initial model inside"
        )
    for theta, distance, message in _attempts(problem):  # noqa: B007  # the error reports the last message
        if distance <= TOLERANCE:
            return theta
    raise NotSolvedError(
        f"the estimator's problem must be solved to a relative distance of {TOLERANCE:g} from its minimiser, "
        f"got {distance:.3g} ({message}); give the loss a larger scale, or the generator more weight"
    )


def _attempts(problem: Proximal) -> Iterator[Answer]:
    """Yield solutions, their distances and messages, from faster to slower methods."""
    yield by_newton(problem, _start(problem))
    yield _followed(problem, by_newton)
    yield _by_scipy(problem, problem.centre)
    yield _followed(problem, _by_scipy)


def _start(problem: Proximal) -> Array:
    """Return the centre, or the solution for squares if its objective is lower."""
    squares: Callable[[], Convex] | None = getattr(problem.c, "squares", None)
    if squares is not None:
        try:
            there = problem.centre + replace(problem, c=squares()).newton(problem.centre)[1]
        except Flat:
            return problem.centre
        if np.all(there > problem.g.lower) and problem.value(there) < problem.value(problem.centre):
            return there
    return problem.centre


def _followed(problem: Proximal, way: Callable[[Proximal, Array], Answer]) -> Answer:
    """Follow the minimiser for the loss c(t e) / t^2 as t grows to 1.

    Far beyond its scale a robust loss is a sharp valley. These losses have scales larger by 1/t, and their minimiser
    depends continuously on t, so it can be followed from a t at which the loss is nearly a square.
    """
    answer = problem.centre, np.inf, ""
    for t in 0.5 ** np.arange(_halvings(problem), -1, -1.0):
        answer = way(replace(problem, c=_Scaled(problem.c, t)), answer[0])
    return answer


def _halvings(problem: Proximal) -> int:
    """Return how often the residuals at the centre must be halved until the loss is nearly a square there."""
    e, count = problem.residual(problem.centre), 0

    def bend(at: Array) -> Array:
        found = problem.c.hessian(at)
        return np.diagonal(found) if found.ndim == 2 else found

    while count < _MOST_HALVINGS and np.any(bend(0.5**count * e) < bend(0 * e) / 2):
        count += 1
    return count + 4


def by_newton(problem: Proximal, theta: Array) -> Answer:
    """Return the result of Newton's method, its distance, and a message."""
    try:
        length, step = problem.newton(theta)
        for _ in range(_STEPS):
            # If the objective falls by less than its rounding, the Newton step itself must become shorter.
            if length <= _NEAR and np.all(theta + step > problem.g.lower):
                further = problem.newton(theta + step)
                if further[0] < length / 2:
                    theta, (length, step) = theta + step, further
                    continue
            if length <= TOLERANCE:
                break
            share = _share(problem, theta, step)
            if share is None:
                break
            theta = theta + share * step
            length, step = problem.newton(theta)
        return theta, problem.certified(theta, length, step), "Newton's method makes no progress"
    except Flat as error:
        return theta, np.inf, str(error)


def _share(problem: Proximal, theta: Array, step: Array) -> float | None:
    """Return a share of a Newton step that stays in the domain and ends before the objective rises steeply, or None.

    The search uses slopes, not values: slopes stay accurate where differences of values are rounding, and for a convex
    function they contain the same information.
    """
    begin, share = float(problem.gradient(theta) @ step), 1.0
    if not begin < 0:
        return None
    for _ in range(_SHORTER):
        further = theta + share * step
        if not np.all(further > problem.g.lower):
            share /= 2
            continue
        end = float(problem.gradient(further) @ step)
        if end <= _PAST * abs(begin):
            return share
        # The zero of the line through both slopes.
        share *= min(max(begin / (begin - end), 0.1), 0.5)
    return None


def _by_scipy(problem: Proximal, start: Array) -> Answer:
    """Return scipy's solution from a starting point, its distance, and the solver's message."""
    try:
        length, step = problem.newton(start)
        if length < _NO_STEP:
            return start, problem.certified(start, length, step), ""
        try:
            theta, message = _trust(problem.whole, start, step)
        except _Theirs as error:
            raise error.error from None
        except (Flat, np.linalg.LinAlgError, ValueError) as error:
            # Squares of data of 1e8 and more give the solver a singular matrix or infinite entries, which scipy
            # refuses; Newton's step needs no squares.
            theta, message = start, str(error)
        theta = _polish(problem, theta)
        return theta, problem.newton_decrement(theta), message
    except Flat as error:
        return start, np.inf, str(error)


def _trust(problem: Proximal, start: Array, step: Array) -> tuple[Array, str]:
    from scipy.optimize import minimize  # imported here, because it takes long to load and is rarely needed

    hold = _called_for(problem.g.hessian, start)
    hold = np.diag(hold) if hold.ndim == 1 else hold
    free = np.eye(len(start)) if problem.free is None else problem.free[0]
    # In eta the proximal term is |eta|^2 / 2 to second order, for every generator.
    directions = np.linalg.solve(np.linalg.cholesky(free.T @ hold @ free), free.T).T
    reach = float(np.sqrt(step @ hold @ step))
    # scipy's inner iteration does not end if a number is not finite or the radius is not a number.
    _within_range(np.asarray([reach, 1e6 * reach, 1 / reach**2 if reach > 0 else np.inf]))

    def bends(theta: Array) -> Array:
        bend, stiff = problem.c.hessian(problem.residual(theta)), problem.g.hessian(theta)
        data = problem.R.T @ (bend[:, None] * problem.R if bend.ndim == 1 else bend @ problem.R)
        return data + (np.diag(stiff) if stiff.ndim == 1 else stiff)

    def of(function: Callable[[Array], Array | float]) -> Callable[[Array], Array]:
        return lambda eta: np.asarray(_called_for(function, start + directions @ eta)) / reach**2

    value, slope, hessian = of(problem.value), of(problem.gradient), of(bends)
    found = minimize(
        lambda eta: float(value(eta)),
        np.zeros(directions.shape[1]),
        jac=lambda eta: _within_range(directions.T @ slope(eta)),
        hess=lambda eta: _within_range(directions.T @ hessian(eta) @ directions),
        method="trust-exact",
        options={
            "initial_trust_radius": reach,
            "max_trust_radius": 1e6 * reach,
            "gtol": 1e-10 / reach,
            "maxiter": _ITERATIONS,
        },
    )
    theta = start + directions @ found.x
    return theta, found.message


def _polish(problem: Proximal, theta: Array) -> Array:
    length, step = problem.newton(theta)
    for _ in range(_POLISHES):
        if not np.all(theta + step > problem.g.lower):
            break
        shorter, further = problem.newton(theta + step)
        if not shorter < length:
            break
        theta, length, step = theta + step, shorter, further
    return theta


def _called_for(function: Callable[[Array], Array | float], at: Array) -> Array:
    try:
        return np.asarray(function(at))
    except Exception as error:
        raise _Theirs(error) from error


def _within_range(array: Array) -> Array:
    if not np.all(np.isfinite(array)):
        raise np.linalg.LinAlgError("the problem leaves the range of floating-point numbers")
    return array


@dataclass(frozen=True, eq=False)
class _Scaled:
    """The loss c(t e) / t^2."""

    c: Convex
    t: float

    @property
    def name(self) -> str:
        return called(self.c)

    @property
    def lower(self) -> float:
        return self.c.lower

    @property
    def assumption_6(self) -> bool | None:
        return self.c.assumption_6

    @property
    def convex_in_second(self) -> bool | None:
        return self.c.convex_in_second

    def value(self, x: Array) -> Array:
        return self.c.value(self.t * x) / self.t**2

    def gradient(self, x: Array) -> Array:
        return self.c.gradient(self.t * x) / self.t

    def hessian(self, x: Array) -> Array:
        return self.c.hessian(self.t * x)
