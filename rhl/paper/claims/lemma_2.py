"""Lemma 2: a closed loop with V3 and r(k) -> 0 converges to zero; which of its assumptions are needed."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from rhl.paper.claims.claim import Claim, Control, Effort, Evidence, worst_of
from rhl.paper.claims.lyapunov_terms import SIZES, at_the_end, draw, follow, square
from rhl.paper.claims.rotating_models import PLANE, losing, turning

_claim = partial(
    Claim,
    method="numerical sampling",
    recorded="holds",
    page="notebooks/06-lemma-2.ipynb",
    proof="notebooks/06-lemma-2.ipynb#the-proof-step-by-step",
    test="tests/paper/claims/test_lemma_2.py",
)

_STEPS = 40
# A loop has converged if its last state and input are below this share of the largest.
_AT_REST = 1e-5


def check_rest(effort: Effort, floor: float = 0.0) -> Evidence:
    """Run closed loops with V3, models that approach the plant, and r(k) -> 0.

    ``floor``: keep r(k) at least this large instead.
    """
    rng = effort.rng("lemma-2.rest")
    found: list[float] = []
    for sizes in SIZES:
        if floor and sizes[3]:
            continue  # such an r is not reachable
        setting = draw(rng, -(-effort.cases // len(SIZES)), sizes, 2 * _STEPS, 0.9, weighted=True)
        found.extend(float(end) for end in at_the_end(replace(setting, r=setting.r + floor)))
    return Evidence(len(found), worst_of(found), _AT_REST, "r(k) has decreased to 1e-8, the slowest loop less")


def check_gains(effort: Effort, floor: float = 0.1) -> Evidence:
    """Run a model that approaches the plant and, with floor 0, loses controllability: its gains are unbounded.

    ``effort`` is not used, since nothing is random.
    ``floor``: lower bound of the input gain of the model's second state. A positive one bounds the gains, and e_1 still
    decays because x and u do.
    """
    last = float(at_the_end(losing(4000, floor))[0])
    return Evidence(1, last, 5e-3, "r(k) = 1/(k+1) has decreased to 3e-4, times the gain 1/floor")


def check_turning(effort: Effort, spin: float | None = None, growth: float = PLANE) -> Evidence:
    """Run a model that rotates for ever in ever smaller steps, exact for the applied step and for little else.

    ``spin``: rotate by this angle at every step instead.
    ``growth``: that of the plant; with another one the model is wrong about the applied step too.
    """
    k = np.arange(161.0)
    phase = np.sqrt(k) if spin is None else spin * k
    r = 0.9 ** k[:, None] * effort.rng("lemma-2.turning").normal(size=2)
    x0 = effort.rng("lemma-2.turning.start").normal(size=(max(2, effort.cases // 10), 2))
    setting = turning(phase, r, x0, growth)
    last = phase[80:]
    if last[-1] - last[0] < np.pi / 2:
        return Evidence(0, np.nan)
    return Evidence(len(x0), float(np.max(at_the_end(setting))), _AT_REST, "r(k) has decreased to 5e-8")


def check_second_step(effort: Effort, growth: float = PLANE) -> Evidence:
    """Check that the model's two-step errors stay at least a tenth of the state while its one-step errors vanish.

    ``growth`` is the plant's; the model is made for the default.
    """
    k = np.arange(41.0)
    x0 = effort.rng("lemma-2.one-step").normal(size=(max(2, effort.cases // 10), 2))
    setting = turning(0 * k, np.zeros((41, 2)), x0, growth)
    t = follow(setting)
    two = setting.plant.step(setting.plant.step(t.x, t.plan.u[..., 0, :]), t.plan.u[..., 1, :])
    one_step = np.sqrt(square(t.e1) / square(t.x))
    two_steps = np.sqrt(square(t.plan.x[..., 2, :] - two) / square(t.x))
    still = 0.1 - float(np.min(np.max(two_steps[:, 20:], axis=1)))
    violation = max(float(np.max(one_step)), still, float(np.max(at_the_end(setting))) - 0.1)
    return Evidence(len(x0), violation, 1e-9, "rounding of one step")


CLAIMS: tuple[Claim, ...] = (
    _claim(
        "lemma-2",
        "Lemma 2",
        "convergenceMPC3",
        "The closed loop with V3, accurate predictor maps, bounded gains and r(k) -> 0 brings state and input to zero.",
        method="simulation",
        stated=check_rest,
        control=Control("r(k) that does not tend to zero", lambda effort: check_rest(effort, floor=0.1)),
        uses=("assumption-4a", "lemma-2.differences"),
    ),
    _claim(
        "lemma-2.gains",
        "Lemma 2",
        "convergenceMPC3",
        "Assumption 5(a) is needed: with it the loop converges to zero, and a model that loses controllability in the "
        "limit can prevent this although r(k) -> 0 and every other assumption holds.",
        method="simulation",
        stated=check_gains,
        control=Control("unbounded gains", lambda effort: check_gains(effort, floor=0.0)),
        uses=("lemma-2",),
        proof="",
    ),
    _claim(
        "lemma-2.differences",
        "Lemma 2",
        "convergenceMPC3",
        "The maps need not converge: with the other assumptions, bounded maps whose steps go to zero are enough.",
        method="simulation",
        stated=check_turning,
        control=Control("a model that rotates by half a radian at every step", partial(check_turning, spin=0.5)),
        uses=("assumption-3", "assumption-4b", "assumption-5", "lemma-2.conclusion", "lemma-2.input"),
    ),
    _claim(
        "lemma-2.one-step",
        "Lemma 2",
        "convergenceMPC3",
        "Only i = 1 of (8) is used: the loop converges to zero although two-step predictions keep an error of a share "
        "of x.",
        method="simulation",
        stated=check_second_step,
        control=Control(
            "a plant for which the one-step prediction is wrong too", partial(check_second_step, growth=3.0)
        ),
        uses=("assumption-3", "assumption-5", "lemma-2.conclusion", "lemma-2.input"),
    ),
)
