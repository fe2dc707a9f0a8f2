"""Enclosed runs compared with published samples and with float64: proved digits, and proved bounds of distances."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

from rhl._checks import instance
from rhl.errors import InputError
from rhl.paper.certified import Enclosure, ball, decimal, flint
from rhl.paper.published import CURVES, curve
from rhl.trace import Trace

if TYPE_CHECKING:
    from flint import arb

# A decimal digit is 3.32193 bits, rounded so that no unproved digit is counted.
_DIGITS_PER_BIT = Fraction(30102, 100000)
# The tolerance of `published`: fifteen digits, of which transients and the unstable pole cost six.
MET = Fraction(1, 10**9)


def digits(enclosed: arb) -> int:
    """Return the number of proved decimal digits: the largest N with a relative error below 10^-N.

    Zero if none is proved, or the ball contains zero; all digits of the precision for an exact number.
    """
    bits = flint().ctx.prec if enclosed.is_exact() else enclosed.rel_accuracy_bits()
    return max(0, math.floor(int(bits) * _DIGITS_PER_BIT))


def bounds(enclosed: arb) -> tuple[float, float]:
    """Return float64 bounds of a number, rounded outwards; -inf and inf for an unknown number."""
    if not enclosed.is_finite():
        return -math.inf, math.inf
    low, high = (_rational(end) for end in (enclosed.lower(), enclosed.upper()))
    return math.nextafter(float(low), -math.inf), math.nextafter(float(high), math.inf)


def _rational(end: arb) -> Fraction:
    exact = end.fmpq()
    return Fraction(int(exact.p), int(exact.q))


@dataclass(frozen=True, eq=False)
class Sample:
    """A published sample and its enclosed value.

    Attributes
    ----------
    signal, k : str, int
        One of ``published.CURVES`` without its example name, and the step.
    value : arb
        The enclosed value.
    distance : arb
        The distance from the published one, absolute, or relative to it for the weight of figure 6.
    digits : int
        The number of proved digits of ``value``.
    met : bool or None
        Whether the distance is proved to be at most ``MET``, or proved to be larger; None if neither is.
    """

    signal: str
    k: int
    value: arb
    distance: arb
    digits: int
    met: bool | None


def signals(run: Enclosure, example: str) -> dict[str, tuple[arb, ...]]:
    """Return the signals of a run whose curves are published, by the name of the curve.

    ``example`` {"linear", "robot"}: the example of the run.
    """
    if example == "robot":
        return {f"x{i + 1}": tuple(z[i] for z in run.z) for i in range(3)}
    if example != "linear":
        raise InputError(f"example must be 'linear' or 'robot', got {example!r}")
    return {
        "y": tuple(y[0] for y in run.y),
        "y_hat": tuple(y[0] for y in run.y_hat),
        "u": run.u,
        "x1": tuple(z[0] for z in run.z),
        "gamma_over_eps": run.gamma_over_eps,
    }


def beside_published(run: Enclosure, example: str, only: Iterable[str] | None = None) -> list[Sample]:
    """Compare an enclosed run with every published sample of its example, or of the signals in ``only``."""
    found = []
    wanted = set(only) if only is not None else None
    with flint().ctx.workprec(run.bits):
        for signal, values in signals(run, example).items():
            if wanted is None or signal in wanted:
                assert f"{example}_{signal}" in CURVES
                samples = [decimal(value) for value in curve(f"{example}_{signal}")]
                for k, (value, sample) in enumerate(zip(values, samples, strict=False)):
                    found.append(_sample(signal, k, value, sample))
    return found


def _sample(signal: str, k: int, value: arb, sample: Fraction) -> Sample:
    distance = abs(value - ball(sample))
    if signal == "gamma_over_eps":
        distance = distance / abs(ball(sample))
    # A comparison of balls is true only if it is true for all numbers in them.
    met = True if distance <= ball(MET) else False if distance > ball(MET) else None
    return Sample(signal, k, value, distance, digits(value), met)


def unlike(one: Sequence[arb], other: Sequence[arb]) -> list[int]:
    """Return the k at which two enclosed signals provably differ."""
    return [k for k, (a, b) in enumerate(zip(one, other, strict=True)) if not a.overlaps(b)]


@dataclass(frozen=True, eq=False)
class FloatError:
    """The largest |error| of a signal in float64 is between ``low`` and ``high``, and at step ``k``."""

    signal: str
    low: float
    high: float
    k: int


def errors_of(trace: Trace, run: Enclosure) -> list[FloatError]:
    """Enclose the errors of a run of the library: the largest ones of outputs, inputs and predictions.

    The trace's floats count as their exact values, so the rounding of the library's settings (0.1 is not a float64) is
    part of the error.
    """
    instance("trace", trace, Trace)
    steps, p = trace.y.shape
    if (steps, p) != (len(run.y), len(run.y[0])):
        raise InputError(f"trace must have {len(run.y)} steps with {len(run.y[0])} outputs, got {steps} with {p}")
    computed = {f"y{i + 1}" if p > 1 else "y": (trace.y[:, i], [y[i] for y in run.y]) for i in range(p)}
    computed["u"] = (trace.v[:, 0], list(run.u))
    computed |= {
        f"y_hat{i + 1}" if p > 1 else "y_hat": (trace.y_hat[:, i], [y[i] for y in run.y_hat]) for i in range(p)
    }
    with flint().ctx.workprec(run.bits):
        return [_worst(signal, floats, balls) for signal, (floats, balls) in computed.items()]


def _worst(signal: str, floats: Iterable[float], balls: Sequence[arb]) -> FloatError:
    errors = [bounds(abs(value - ball(float(found)))) for found, value in zip(floats, balls, strict=True)]
    k = max(range(len(errors)), key=lambda at: errors[at][1])
    return FloatError(signal, max(low for low, _ in errors), errors[k][1], k)
