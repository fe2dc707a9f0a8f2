"""Proximal iterations (20) for functions of one linear form each, used by the claims about Lemma 4."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from typing import Any, Protocol

import numpy as np
from scipy.optimize import brentq

from rhl import losses
from rhl._checks import Array
from rhl.losses import Generator, WeightedSquares, divergence


class Mirror(Generator, Protocol):
    """A generator whose gradient can be inverted."""

    def inverse(self, dual: Array) -> Array:
        """Return the x at which the gradient is ``dual``, shape (..., d)."""


@dataclass(frozen=True, eq=False)
class Squares(WeightedSquares):
    """Weighted squares; D(x, y) is the weighted square of x - y."""

    def inverse(self, dual: Array) -> Array:
        """Return dual / (2 w), shape (..., d)."""
        return np.asarray(dual / (2 * np.asarray(self.weight)))


@dataclass(frozen=True, eq=False)
class Entropy(losses.Entropy):
    """The weighted sum of x log x on positive x, with the inverse of its gradient."""

    def inverse(self, dual: Array) -> Array:
        """Return exp(dual / w - 1), shape (..., d)."""
        return np.asarray(np.exp(dual / self.weight - 1))


class Cosh:
    """The sum of cosh x on all of R^d: strictly convex and smooth, but D is not convex in its second argument."""

    def value(self, x: Array) -> Array:
        """Return the sum of cosh x, shape (...)."""
        return np.asarray(np.sum(np.cosh(x), axis=-1))

    def gradient(self, x: Array) -> Array:
        """Return sinh x, shape (..., d)."""
        return np.sinh(x)

    def inverse(self, dual: Array) -> Array:
        """Return arsinh of dual, shape (..., d)."""
        return np.arcsinh(dual)


# Random runs: number of steps, and the lambda_max of lambda_k.
_STEPS, _MIXING = 12, 0.9

SHAPES = ("square", "hinge", "huber", "quartic")


@dataclass(frozen=True, eq=False)
class Ridge:
    r"""A convex function :math:`f(x) = w\,\varphi(a^\top x - b)` whose minimum is zero.

    ``a`` (d,): direction; not zero. ``b``: the minimum is attained at all x with a'x = b (with a'x <= b for the hinge).
    ``shape``: phi(t) is t^2 (square), max(0, t)^2 (hinge), sqrt(1 + t^2) - 1 (huber) or t^4 (quartic).
    ``weight``: w, positive.
    """

    a: Array
    b: float
    shape: str = "square"
    weight: float = 1.0

    def at(self, t: float) -> float:
        """Return w phi(t)."""
        if self.shape == "huber":
            return self.weight * t**2 / (float(np.hypot(1.0, t)) + 1)  # sqrt(1 + t^2) - 1 without cancellation
        if self.shape == "quartic":
            return self.weight * t**4
        return self.weight * (t**2 if self.shape == "square" else max(0.0, t) ** 2)

    def slope(self, t: float) -> float:
        """Return w phi'(t)."""
        if self.shape == "huber":
            return self.weight * t / float(np.hypot(1.0, t))
        if self.shape == "quartic":
            return self.weight * 4 * t**3
        return self.weight * 2 * (t if self.shape == "square" else max(0.0, t))

    def value(self, x: Array) -> float:
        """Return f(x)."""
        return self.at(float(self.a @ x) - self.b)

    def gradient(self, x: Array) -> Array:
        """Return the gradient of f at x, shape (d,)."""
        return self.slope(float(self.a @ x) - self.b) * self.a


def proximal_step(f: Ridge, g: Mirror, centre: Array) -> Array:
    r"""Return the minimiser of :math:`f(x) + D(x, \tilde x_k)`, the first line of (20), shape (d,).

    By (41) the minimiser is ``g.inverse(grad g(centre) - w phi'(t) a)`` with t = a'x - b. One equation remains
    for the number t, with its root between 0 and the value of t at the centre; it is solved for their ratio.
    """
    dual, start = g.gradient(centre), float(f.a @ centre) - f.b

    def point(t: float) -> Array:
        return g.inverse(dual - f.slope(t) * f.a)

    def excess(share: float) -> float:
        return (float(f.a @ point(share * start)) - f.b) / start - share

    if f.slope(start) == 0:
        return centre
    if excess(1.0) >= 0:  # the step is below rounding
        return point(start)
    return point(start * brentq(excess, 0.0, 1.0, xtol=1e-25, rtol=1e-15))


@dataclass(frozen=True, eq=False)
class Run:
    """Iterates of (20).

    ``functions``: f(., 0), ..., f(., K-1). ``generator``: g.
    ``centres`` (K+1, d): the centres: x~_0, ..., x~_K.
    ``minimisers`` (K, d): x*_1, ..., x*_K. ``mixing`` (K,): lambda_1, ..., lambda_K.
    """

    functions: Sequence[Ridge]
    generator: Mirror
    centres: Array
    minimisers: Array
    mixing: Array

    @property
    def residuals(self) -> Array:
        """The values f(x*_{k+1}, k), shape (K,)."""
        return np.array([f.value(x) for f, x in zip(self.functions, self.minimisers, strict=True)])

    @property
    def moves(self) -> Array:
        """The distances D(x*_{k+1}, x~_k), shape (K,)."""
        return divergence(self.generator, self.minimisers, self.centres[:-1])

    @property
    def length(self) -> float:
        """The length of the path x~_0, ..., x~_K."""
        return float(np.sum(np.linalg.norm(np.diff(self.centres, axis=0), axis=1)))

    def distances(self, target: Array) -> Array:
        """Return D(x*, x~_0), ..., D(x*, x~_K) for x* = ``target``, shape (K+1,)."""
        return divergence(self.generator, np.broadcast_to(target, self.centres.shape), self.centres)


def iterate(functions: Sequence[Ridge], g: Mirror, start: Array, mixing: Array) -> Run:
    """Run the proximal iterations (20).

    ``functions``: f(., 0), f(., 1), ..., one for each step.
    ``start`` (d,): the first centre. ``mixing`` (K,): lambda_1, ..., lambda_K.
    """
    centres, minimisers = [np.asarray(start, dtype=np.float64)], []
    for f, lam in zip(functions, mixing, strict=True):
        minimisers.append(proximal_step(f, g, centres[-1]))
        centres.append((1 - lam) * minimisers[-1] + lam * centres[-1])
    return Run(functions, g, np.array(centres), np.array(minimisers), mixing)


def tangential_turns(steps: int, exponent: float = 0.75) -> tuple[Array, Array]:
    r"""Return norm and angle, shape (steps+1,), of the spiral's :math:`\tilde x_0, \tilde x_1, \dots` in closed form.

    With unit vectors :math:`d_k`, :math:`d_k^\top x = \delta_k |x|`, one step for :math:`(d_k^\top x)^2` with
    :math:`D = |x-y|^2` multiplies the squared norm by :math:`1 - 3\delta_k^2/4` and rotates x by the angle with tangent
    :math:`\delta_k\sqrt{1-\delta_k^2}/(2-\delta_k^2)`. ``exponent`` is the e of delta_k = k^-e / 2, k = 1, 2, ...
    """
    delta = 0.5 * np.arange(1, steps + 1, dtype=np.float64) ** -exponent
    norm = np.exp(0.5 * np.cumsum(np.log1p(-0.75 * delta**2)))
    angle = np.cumsum(np.arctan2(delta * np.sqrt(1 - delta**2), 2 - delta**2))
    return np.concatenate([[1.0], norm]), np.concatenate([[0.0], angle])


def spiral(steps: int, exponent: float = 0.75) -> Run:
    """Run (20) on the counterexample f(x, k) = (d_k'x)^2 in the plane, D the squared distance, from x = (1, 0)."""
    functions: list[Ridge] = []
    g, x = Squares(), np.array([1.0, 0.0])
    centres = [x]
    for k in range(1, steps + 1):
        delta = 0.5 * k**-exponent
        radial = x / np.hypot(*x)
        tangential = np.array([radial[1], -radial[0]])  # moves the iterate anticlockwise
        functions.append(Ridge(delta * radial + np.sqrt(1 - delta**2) * tangential, 0.0))
        x = proximal_step(functions[-1], g, x)
        centres.append(x)
    return Run(functions, g, np.array(centres), np.array(centres[1:]), np.zeros(steps))


def draw_run(
    rng: np.random.Generator,
    g: Mirror,
    steps: int = 25,
    mixing: float = 0.9,
    consistent: bool = True,
    scale: float = 1.0,
) -> tuple[Run, Array]:
    """Run (20) on random convex functions with a common minimiser; return the run and points of X, shape (3, d).

    The points are the common minimiser, if any, and two more, since the functions leave one direction free. They are
    positive, as the entropy requires, and of size ``scale``. ``consistent`` False: without a common minimiser.
    """
    d = int(rng.integers(2, 5))
    target, start, free = scale * rng.uniform(0.5, 2.0, (3, d))
    free -= free.mean()
    free *= 0.2 / np.abs(free).max()
    functions = []
    for _ in range(_STEPS):
        a = rng.standard_normal(d)
        a -= free * (a @ free) / (free @ free)
        b = float(a @ target) + (0.0 if consistent else float(rng.normal()))
        functions.append(Ridge(a, b, str(rng.choice(SHAPES)), float(rng.uniform(0.1, 2.0))))
    run = iterate(functions, g, start, rng.uniform(0, _MIXING, _STEPS))
    return run, np.array([target, target + free, target - free])


def size(run: Run, target: Array) -> float:
    """Return the size of D's terms along a run, at least one."""
    g, points = run.generator, np.concatenate([run.centres, target[None]])
    slopes = np.sum(np.abs(g.gradient(points)) * (1 + np.abs(points)), axis=1)
    return float(1 + np.max(np.abs(g.value(points)) + slopes))


def optimality_gap(run: Run, target: Array, mixed: bool = False) -> Array:
    """Return the violation of (41) at x*_{k+1} (at x~_{k+1} if ``mixed``), shape (K,)."""
    points, g = run.centres[1:] if mixed else run.minimisers, run.generator
    pull = np.array([f.gradient(x) for f, x in zip(run.functions, points, strict=True)])
    return np.linalg.norm(pull + g.gradient(points) - g.gradient(run.centres[:-1]), axis=1)


def tangent_excess(run: Run, target: Array) -> Array:
    """Return the violation of (42) at x = x~_k, x~_{k+1} and x*: right side minus left, shape (3 K,)."""
    found = []
    for f, best, *points in zip(run.functions, run.minimisers, run.centres[:-1], run.centres[1:], strict=True):
        found += [f.value(best) + f.gradient(best) @ (x - best) - f.value(x) for x in (*points, target)]
    return np.array(found)


def three_point_gap(run: Run, target: Array, printed: bool = False) -> Array:
    """Return the gap in the equality of (44), with grad g(x~_k), or grad g(x*_k) as printed, shape (K-1,)."""
    g, best = run.generator, run.minimisers[1:]
    centre = run.minimisers[:-1] if printed else run.centres[1:-1]
    left = np.sum((g.gradient(centre) - g.gradient(best)) * (target - best), axis=1)
    right = run.distances(target)[1:-1]
    return np.abs(left - divergence(g, np.broadcast_to(target, best.shape), best) - run.moves[1:] + right)


def pull_excess(run: Run, target: Array) -> Array:
    """Return the violation of (43), right side minus left, shape (K,)."""
    g, best = run.generator, run.minimisers
    slope = np.sum((g.gradient(best) - g.gradient(run.centres[:-1])) * (target - best), axis=1)
    at_target = np.array([f.value(target) for f in run.functions])
    return -slope - (at_target - run.residuals)


def mixing_excess(run: Run, target: Array) -> Array:
    """Return the violations of both inequalities of (45), shape (2 K,)."""
    lam, distances = run.mixing, run.distances(target)
    best = divergence(run.generator, np.broadcast_to(target, run.minimisers.shape), run.minimisers)
    middle = (1 - lam) * best + lam * distances[:-1]
    at_target = np.array([f.value(target) for f in run.functions])
    last = (1 - lam) * (distances[:-1] - run.moves + at_target - run.residuals) + lam * distances[:-1]
    return np.concatenate([distances[1:] - middle, middle - last])


def decrease_excess(run: Run, target: Array, lambda_max: float = _MIXING) -> Array:
    """Return the violation of (46), left side minus right, shape (K,)."""
    at_target = np.array([f.value(target) for f in run.functions])
    return np.diff(run.distances(target)) + (1 - lambda_max) * (run.moves + run.residuals - at_target)


def sum_excess(run: Run, target: Array, lambda_max: float = _MIXING) -> Array:
    """Return the growth of distances, and the excess of sums of steps and residuals over the bound, shape (K+1,)."""
    distances = run.distances(target)
    total = float(np.sum(run.moves) + np.sum(run.residuals))
    return np.concatenate([np.diff(distances), [(1 - lambda_max) * total - distances[0]]])


def shrinking_limit(ratio: Fraction, steps: int) -> tuple[Fraction, Fraction]:
    r"""Enclose the limit of (20) for :math:`f(x,k) = \rho^k x^2`, :math:`D = |x-y|^2/2`, from x = 1, in exact numbers.

    ``ratio`` is rho in (0, 1]. Returns x_K (1 - tail) and x_K with K = ``steps``; the tail is the sum of 2 rho^k from K
    on. Zero and x_K if that sum gives no bound.
    """
    x = Fraction(1)
    for k in range(steps):
        following = x / (1 + 2 * ratio**k)
        assert 2 * ratio**k * following + following - x == 0  # (41)
        x = following
    tail = 2 * ratio**steps / (1 - ratio) if ratio < 1 else Fraction(1)
    return x * max(Fraction(0), 1 - tail), x


@cache
def turn_identity() -> bool:
    """Verify one step of the spiral symbolically: optimality, norm and angle, for every delta and every x."""
    import sympy as sp

    t, x1, x2 = sp.symbols("t x1 x2", real=True)
    delta, s = 2 * t / (1 + t**2), (1 - t**2) / (1 + t**2)  # so that delta^2 + s^2 = 1
    x, across = sp.Matrix([x1, x2]), sp.Matrix([x2, -x1])
    d = delta * x + s * across  # |x| times the unit vector d_k
    step = x - delta * d / 2
    norm = x1**2 + x2**2
    terms = (
        *(2 * d * (d.T * step)[0] / norm + 2 * (step - x)),  # grad f + grad D
        (step.T * step)[0] - norm * (1 - sp.Rational(3, 4) * delta**2),
        (x.T * step)[0] - norm * (1 - delta**2 / 2),
        x1 * step[1] - x2 * step[0] - norm * delta * s / 2,
    )
    return all(sp.cancel(term) == 0 for term in terms)


def recurrent_run(rng: np.random.Generator, forgotten: bool = False) -> tuple[Run, Array, list[Ridge]]:
    """Run (20) on three functions, two of which recur after ever longer gaps (the last one thrice if ``forgotten``)."""
    directions = np.linalg.qr(rng.standard_normal((4, 4)))[0][:3] + 0.1 * rng.standard_normal((3, 4))
    target, start = rng.standard_normal((2, 4))
    family = [Ridge(a, float(a @ target), weight=30.0) for a in directions]
    order: list[int] = []
    for gap in range(1, 25):
        order += [0] * gap + ([1] if forgotten and gap > 2 else [1, 2])
    mixing = rng.uniform(0, 0.3, len(order))
    return iterate([family[i] for i in order], Squares(), start, mixing), target, family


@cache
def symbolic_three_point() -> bool:
    """Verify the three-point identity with values and gradients of g as free symbols: it holds for every g."""
    import sympy as sp

    d = 3
    (a, b, c), (_, db, dc) = ([sp.Matrix(sp.symbols(f"{n}{i}_:{d}")) for i in range(3)] for n in ("x", "s"))
    g = sp.symbols("g_:3")

    def D(x: Any, gx: Any, y: Any, gy: Any, slope: Any) -> Any:
        return gx - gy - ((x - y).T * slope)[0]

    # a is the common minimiser, b the new minimiser, c the centre.
    right = D(a, g[0], b, g[1], db) + D(b, g[1], c, g[2], dc) - D(a, g[0], c, g[2], dc)
    return bool(sp.expand(((dc - db).T * (a - b))[0] - right) == 0)
