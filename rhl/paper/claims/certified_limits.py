"""Counterexamples with enclosed limits: finitely many steps in ball arithmetic, and bounds for all later ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

from rhl.paper.certified import ball, flint

if TYPE_CHECKING:
    from flint import arb

Gain = Callable[[int, "arb"], "arb"]


def between(low: arb, high: arb) -> arb:
    """Return the smallest ball that contains both."""
    return low.union(high)


def shrinking_limit(ratio: Fraction, steps: int, bits: int) -> arb:
    r"""Enclose the limit of (20) for :math:`f(x,k) = \rho^k x^2`, :math:`D = |x-y|^2/2`, from x = 1, in balls.

    The limit is the product of all :math:`1/(1+2\rho^k)`. The factors from K = ``steps`` on multiply to at most one,
    and to at least one minus the sum of :math:`2\rho^k`; if that sum is infinite (``ratio`` 1), to at least zero.
    """
    with flint().ctx.workprec(bits):
        x, weight, rho = ball(1), ball(2), ball(ratio)
        for _ in range(steps):
            x, weight = x / (1 + weight), weight * rho
        tail = weight / (1 - rho) if ratio < 1 else ball(1)
        return x * between(ball(1) - tail if tail < 1 else ball(0), ball(1))


@dataclass(frozen=True, eq=False)
class Growth:
    """Theorem 1's scalar loop in balls: states, and proved facts about them.

    ``x`` (steps + 1): the states. ``kept``: the number of the ``steps`` with a proof that x(k)^2 is at least
    a^2k / (s(1) + 3 (1/2 + ... + 1/k)), for k = 1 equal to it.
    ``factor``: the least growth of that bound from the last step to the next, and from all later ones.
    """

    x: tuple[arb, ...]
    kept: int
    steps: int
    factor: arb


def vanishing(k: int, a: arb) -> arb:
    """Return b(k) = exp(-k/10) a^-2k / (k+1), as ``theorem_1.vanishing``."""
    return ball(Fraction(-k, 10)).exp() / (a ** (2 * k) * (k + 1))


def settling(k: int, a: arb) -> arb:
    """Return b(k) = 1 - 0.9^k / 2, as ``theorem_1.settling``."""
    return 1 - ball(Fraction(9, 10)) ** k / 2


def growth(a: Fraction, x0: Fraction, gain: Gain, steps: int, bits: int) -> Growth:
    r"""Close the loop of V1, N = 1, unit weights, eps(k) = exp(-k/10), and x+ = a x + u with predictor a x + b(k) u.

    V1's input is :math:`u = -w b a x/(1 + w b^2)` with :math:`w = x^2/\epsilon(k)`. Write :math:`x(k)^2 = a^{2k}/s(k)`;
    with ``gain`` = ``vanishing``, :math:`w b = 1/(s(k)(k+1)) = t`, so that

    .. math:: s(k+1) = s(k) \Bigl(1 - \frac{t}{1+tb}\Bigr)^{-2} \le s(k)(1-t)^{-2} \le s(k)(1+3t) = s(k) + \frac3{k+1}

    as long as :math:`t \le 1/8`; s grows, and :math:`s(1) = (s(0)+1)^2/s(0) \ge 4`, so this holds for k = 1, 2, ... and
    every nonzero x(0). So x(k)^2 is at least a^2k over a sum that grows like log k: it diverges for every a > 1.
    """
    with flint().ctx.workprec(bits):
        slope, x = ball(a), ball(x0)
        states, kept, first = [x], 0, (1 / x0**2 + 1) ** 2 * x0**2
        bound = ball(first)
        for k in range(steps):
            b, weight = gain(k, slope), x**2 / ball(Fraction(-k, 10)).exp()
            x = slope * x * (1 - weight * b / (1 + weight * b**2))
            states.append(x)
            if k == 0:
                kept += first >= 4 and bool((x**2 * bound).overlaps(slope**2))  # so that t(1) <= 1/8
            else:
                bound += ball(Fraction(3, k + 1))
                kept += bool(x**2 * bound >= slope ** (2 * (k + 1)))
        # From one step to the next the bound's denominator grows by a share of at most 3 / ((k+1) s(1)).
        return Growth(tuple(states), kept, steps, slope**2 / (1 + 3 / ((steps + 1) * ball(first))))


@dataclass(frozen=True, eq=False)
class Blended:
    """The loop whose predictor's second input gain decays, in balls.

    ``x1`` (steps + 1): the first state. ``gap`` (steps): |x1(k+1) - 5/26 + (6/7)(x1(k) - 5/26)|.
    ``bound`` (steps): a bound of ``gap`` while |x1| <= 2. ``plan``, ``least`` (steps): the sizes of V1's and of
    V2's solution, over |x|. ``rest``, ``later``: bounds for all later k, of |x1 - 5/26| and of both those sizes.
    """

    x1: tuple[arb, ...]
    gap: tuple[arb, ...]
    bound: tuple[arb, ...]
    plan: tuple[arb, ...]
    least: tuple[arb, ...]
    rest: arb
    later: arb


def blended(steps: int, bits: int, ratio: Fraction = Fraction(1, 2)) -> Blended:
    r"""Close the loop of V1 with A = diag(1.2, 0.5), B = (1, 0) and models of input gain :math:`(1, \beta)`.

    :math:`\beta = \rho^k` with ``ratio`` :math:`\rho`, N = 2, unit weights, :math:`\epsilon(k) = 0.02^k`, x(0) = (1,1).
    Then :math:`x_2(k) = 2^{-k}`, and with :math:`\rho = 1/2` it is :math:`\beta` itself.

    V1 minimises :math:`|A x + B u_0|^2 + |u|^2 + W|Mu + f|^2` over u, with :math:`M = [AB, B]`, :math:`f = A^2x`,
    :math:`W = |x|^2/\epsilon`. V2's solution is :math:`\bar u = -M^{-1}f`, and with it
    :math:`x_1^+ - 5/26 = -(6/7)(x_1 - 5/26)`. V1's differs from it by :math:`(W M^\top M + H)^{-1}(H\bar u + g)`, with
    :math:`H = \operatorname{diag}(1+|B|^2, 1)` and :math:`g = (B^\top Ax, 0)`; so by at most
    :math:`|H\bar u + g| / (W\sigma^2)`, where :math:`\sigma^2 \ge \det(M)^2/\|M\|^2 \ge 0.49\beta^2/3.69` is the least
    eigenvalue of :math:`M^\top M`. As :math:`W \ge x_2^2/\epsilon = 12.5^k`, this is a constant times
    :math:`3.125^{-k}`: the deviations can be summed, and :math:`x_1` tends to 5/26.
    """
    with flint().ctx.workprec(bits):
        x1, x2, limit = ball(1), ball(1), ball(Fraction(5, 26))
        a1, a2, shrink = ball(Fraction(6, 5)), ball(Fraction(1, 2)), ball(ratio)
        # |H u + g|, with |x1| <= 2, and x2 and beta the same number in [0, 1].
        signs = flint().arb(0, 1)
        far, some = 2 * signs, between(ball(0), ball(1))
        u0, u1 = _least(far, ball(1), ball(1))
        size = ((2 + some**2) * u0 + a1 * far + some * a2 * some) ** 2 + u1**2
        constant = size.abs_upper().sqrt() * ball(Fraction(369, 49))
        states, gap, bound, plan, least = [x1], [], [], [], []
        beta, inverse_epsilon = ball(1), ball(1)
        for k in range(steps):
            weight = (x1**2 + x2**2) * inverse_epsilon
            u0, u1 = _least(x1, x2, beta)
            v0, v1 = _planned(x1, x2, beta, weight)
            length = (x1**2 + x2**2).sqrt()
            plan.append((v0**2 + v1**2).sqrt() / length)
            least.append((u0**2 + u1**2).sqrt() / length)
            bound.append(constant / ball(Fraction(25, 8)) ** k)
            after = a1 * x1 + v0
            gap.append(abs(after - limit + ball(Fraction(6, 7)) * (x1 - limit)))
            x1, x2, beta, inverse_epsilon = after, a2 * x2, shrink * beta, inverse_epsilon * 50
            states.append(x1)
        tail = constant / ball(Fraction(25, 8)) ** steps / (1 - ball(Fraction(8, 25)))
        # Later |x1 - 5/26| is at most its present value plus the sum of later bounds, and so is the distance of V1's
        # plan to V2's.
        rest = abs(x1 - limit) + tail
        x1, off = limit + rest * signs, tail * signs
        u0, u1 = _least(x1, ball(1), ball(1))
        later = ((u0 + off) ** 2 + (u1 + off) ** 2).sqrt() / abs(x1)
        return Blended(tuple(states), tuple(gap), tuple(bound), tuple(plan), tuple(least), rest, later)


def _least(x1: arb, x2: arb, beta: arb) -> tuple[arb, arb]:
    """Return V2's solution -M^-1 A^2 x, M = [[1.2, 1], [beta/2, beta]]."""
    u0 = (x2 / beta / 4 - ball(Fraction(36, 25)) * x1) / ball(Fraction(7, 10))
    return u0, -ball(Fraction(36, 25)) * x1 - ball(Fraction(6, 5)) * u0


def _planned(x1: arb, x2: arb, beta: arb, weight: arb) -> tuple[arb, arb]:
    """Return V1's solution as V2's less (W M'M + H)^-1 (H u + g), a form that hardly enlarges the ball of x1."""
    a1, a2 = ball(Fraction(6, 5)), ball(Fraction(1, 2))
    u0, u1 = _least(x1, x2, beta)
    r0, r1 = (2 + beta**2) * u0 + a1 * x1 + beta * a2 * x2, u1
    h00 = weight * (a1**2 + (a2 * beta) ** 2) + 2 + beta**2
    h01 = weight * (a1 + a2 * beta**2)
    h11 = weight * (1 + beta**2) + 1
    det = h00 * h11 - h01**2
    return u0 - (r0 * h11 - h01 * r1) / det, u1 - (h00 * r1 - h01 * r0) / det
