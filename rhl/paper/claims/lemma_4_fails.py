"""Counterexamples to Lemma 4 as stated: iterates that converge outside X, and iterates that do not converge."""

from __future__ import annotations

import math
from fractions import Fraction
from functools import partial

import numpy as np

from rhl._checks import Array
from rhl.paper.claims.claim import Claim, Control, Effort, Evidence, worst_of
from rhl.paper.claims.proximal import (
    Ridge,
    Run,
    Squares,
    iterate,
    shrinking_limit,
    spiral,
    tangential_turns,
    turn_identity,
)

_claim = partial(Claim, page="notebooks/09-lemma-4.ipynb", test="tests/paper/claims/test_lemma_4.py")

# Convergence to X means this distance.
_ARRIVED = 1e-6


def path_growth(points: Array) -> float:
    """Return the length of a path's second half relative to the quarter before it, minus one; points (K+1, d).

    If it is always shorter, the path has a finite length and the points converge. A path that rotates for ever has
    growing halves. The value is -1 for a constant path.
    """
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    half, quarter = len(steps) // 2, len(steps) // 4
    last, before = float(np.sum(steps[half:])), float(np.sum(steps[quarter:half]))
    resting = 1e-12 * float(np.max(np.abs(points)))
    return -1.0 if last <= resting else last / before - 1


def check_limit_outside(effort: Effort, ratio: Fraction = Fraction(1, 2)) -> Evidence:
    """Enclose the limit and compare it with 0.069, where zero is the only common minimiser.

    No evidence if the enclosure is too wide to decide.
    """
    low, high = shrinking_limit(ratio, 60)
    wanted = Fraction(69, 1000)
    if low < wanted <= high:
        return Evidence(1, math.nan)
    return Evidence(1, float(max(Fraction(0), wanted - high)))


def check_no_limit(effort: Effort, exponent: float = 0.75) -> Evidence:
    """Verify the spiral's step symbolically, and its bounds of the norm and of the angle, 0.84 (K^(1/4) - 1)."""
    norm, angle = tangential_turns(1_000_000, exponent)
    checkpoints = 10 ** np.arange(7)
    violations = [0.0 if turn_identity() else 1.0, float(np.sqrt(7 / 16) - norm[-1])]
    violations += [float(0.84 * (K**0.25 - 1) - angle[K]) for K in checkpoints]
    return Evidence(len(violations), worst_of([0.0, *violations]))


def returning_runs() -> list[tuple[Run, float]]:
    """Return runs for which Lemma 4 holds: recurring lines, and functions that decay slowly enough."""
    lines = [Ridge(np.eye(2)[k % 2], 0.0) for k in range(100)]
    slow = [Ridge(np.ones(1), 0.0, weight=1 / (k + 1)) for k in range(3000)]
    return [
        (iterate(lines, Squares(), np.ones(2), np.full(100, 0.3)), math.inf),
        (iterate(slow, Squares(0.5), np.ones(1), np.zeros(3000)), math.inf),
    ]


def failing_runs() -> list[tuple[Run, float]]:
    """Return the two counterexamples, each with the summed shares by which later steps reduce the norm."""
    fading = [Ridge(np.ones(1), 0.0, weight=0.5**k) for k in range(100)]
    # 1/(1+t) is at least 1 - t, and the root of 1 - 3 delta^2 / 4 at least 1 - 3 delta^2 / 4, delta^2 = k^(-3/2) / 4.
    return [
        (iterate(fading, Squares(0.5), np.ones(1), np.zeros(100)), 4 * 0.5**100),
        (spiral(2000), 3 / 16 * 2 / math.sqrt(2000)),
    ]


def parted_run() -> Run:
    """Return a run on four lines, two and two parallel at the distance one, which have no point in common."""
    lines = [Ridge(np.eye(2)[k % 2], float(k // 2 % 2)) for k in range(100)]
    return iterate(lines, Squares(), np.ones(2), np.full(100, 0.3))


def check_convergence(effort: Effort, failing: bool = True, consistent: bool = True) -> Evidence:
    """Check Lemma 4 as stated on sequences with X = {0}: bound the limit of the distance from zero.

    The distance never grows, so its last value bounds all later ones; the largest total decrease in later steps gives a
    lower bound. A run that these bounds do not decide is no evidence. ``failing`` False: without the two
    counterexamples. ``consistent`` False: with lines without a common point, the distance of the farthest one.
    """
    found = []
    for run, later in [*returning_runs(), *(failing_runs() if failing else [])]:
        high = float(np.linalg.norm(run.centres[-1]))
        low = high * max(0.0, 1 - later)
        found.append(low if low > _ARRIVED else 0.0 if high <= _ARRIVED else math.nan)
    if not consistent:
        run = parted_run()
        found.append(max(abs(float(f.a @ run.centres[-1]) - f.b) for f in run.functions))
    return Evidence(len(found), worst_of(found), _ARRIVED, "the distance that counts as convergence")


CLAIMS: tuple[Claim, ...] = (
    _claim(
        "lemma-4",
        "Lemma 4",
        "timevaryingmin",
        "Proximal iterations for convex functions with a common minimiser converge to a point of the set X of all of "
        "them.",
        "simulation",
        "refuted",
        stated=check_convergence,
        control=Control(
            "minimisers that differ from step to step", partial(check_convergence, failing=False, consistent=False)
        ),
        instance=Control(
            "functions that are used again, or whose weights decrease no faster than 1/k",
            partial(check_convergence, failing=False),
        ),
        reason="The proof goes from 'the steps tend to zero' to 'the sequence converges', and from there to 'the "
        "limit is in X'; both can fail: for f = 2^-k x^2 the limit is outside X (lemma-4.limit-outside), for "
        "f = (d_k'x)^2 with nearly tangential d_k there is none (lemma-4.no-limit). Claim lemma-4.weak holds; with "
        "one more hypothesis, so do lemma-4.growing, lemma-4.summable, lemma-4.interior, lemma-4.recurrent.",
        uses=("eq-46",),
    ),
    _claim(
        "lemma-4.limit-outside",
        "Lemma 4",
        "timevaryingmin",
        "For f(x,k) = 2^-k x^2 and D = |x-y|^2/2 the iterates from x = 1 converge to a number above 0.069, although "
        "zero is the only common minimiser: functions may decay too fast.",
        "exact arithmetic",
        "holds",
        stated=check_limit_outside,
        control=Control("f(x,k) = x^2, which does not depend on k", partial(check_limit_outside, ratio=Fraction(1))),
        proof="notebooks/09-lemma-4.ipynb#proof-limit-outside",
        formal="lemma_4.bounded_away",
    ),
    _claim(
        "lemma-4.no-limit",
        "Lemma 4",
        "timevaryingmin",
        "For f(x,k) = (d_k'x)^2 in the plane, d_k'x_k = k^(-3/4) |x_k| / 2, the steps tend to zero, the norm stays "
        "above 0.66, and the iterates rotate around zero, the only common minimiser, for ever.",
        "symbolic identity",
        "holds",
        stated=check_no_limit,
        control=Control("d_k'x_k = k^(-3/2) |x_k| / 2, which has a finite sum", partial(check_no_limit, exponent=1.5)),
        proof="notebooks/09-lemma-4.ipynb#proof-no-limit",
    ),
)
