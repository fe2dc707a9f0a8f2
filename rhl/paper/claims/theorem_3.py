"""Theorem 3: the overall scheme on unknown plants, and the peaking that comes with it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial

import numpy as np

from rhl._checks import Array
from rhl.controller import Controller
from rhl.estimator import ProximalEstimator
from rhl.horizon import solve
from rhl.lifting import DelayLifting
from rhl.losses import WeightedSquares
from rhl.model import SignalModel
from rhl.paper.claims.claim import Claim, Control, Effort, Evidence, worst_of
from rhl.paper.claims.kalman import kalman_form
from rhl.plants import LinearPlant
from rhl.plants.analysis import signal_model
from rhl.problems import V1
from rhl.schedules import PowerDecay
from rhl.scheme import Scheme
from rhl.simulation import simulate
from rhl.trace import Trace

_claim = partial(Claim, page="notebooks/13-theorem-3.ipynb", test="tests/paper/claims/test_theorem_3.py")

# Slow modes are still decaying when a run ends; a run that does not converge ends at its peak, which is 1.
_SETTLED = 0.1
_STEPS = 400


def random_plants(rng: np.random.Generator, count: int, reachable: bool = True) -> tuple[LinearPlant, Array]:
    """Draw plants of order 3, one input and one output, with initial states of norm one, shape (count, 3).

    Each has an unstable block of order 2 (spectral radius 1.2) and a stable mode that no input reaches. ``reachable``
    False: no input gain in the unstable block, so the plant is not stabilizable.
    """
    forms = [kalman_form(rng, 1, 1, (2, 1, 0)) for _ in range(count)]
    F, G, H = (np.stack([getattr(form, name) for form in forms]) for name in "FGH")
    z0 = rng.normal(size=(count, 3))
    return LinearPlant(F, G if reachable else np.zeros_like(G), H), z0 / np.linalg.norm(z0, axis=1, keepdims=True)


def scheme_for(m: int, initial_model: SignalModel | None = None) -> Scheme:
    """Return the linear example's tuning for single-input, single-output plants of order at most m."""
    return Scheme(
        lifting=DelayLifting(m, m),
        estimator=ProximalEstimator(2 * m),
        controller=Controller(Q=100.0, R=10000.0, QN=100.0, horizon=20, epsilon=PowerDecay(100)),
        initial_model=SignalModel.companion_of_ones(m, m) if initial_model is None else initial_model,
    )


@cache
def unknown_plants(seed: int, count: int, reachable: bool) -> Trace:
    """Run the scheme on a batch of unknown plants; cached, since several claims use it."""
    plant, z0 = random_plants(Effort(seed).rng("theorem-3"), count, reachable)
    return simulate(scheme_for(3), plant, z0, _STEPS)


def end_over_peak(trace: Trace) -> Array:
    """Return the size of (z, v) at the end of each run over its largest size, shape (...)."""
    size = np.sqrt(np.sum(trace.z**2, axis=-1) + np.sum(trace.v**2, axis=-1))
    return np.asarray(size[-1] / np.max(size, axis=0))


def late_factor(trace: Trace, steps: int = 100) -> Array:
    """Return the mean factor on each state per step over the last steps of its run, shape (...)."""
    size = np.linalg.norm(trace.z, axis=-1)
    return np.asarray((size[-1] / size[-1 - steps]) ** (1 / steps))


def radius_without_weight(trace: Trace, plant: LinearPlant) -> Array:
    """Return the spectral radius of each loop with its last model fixed and no terminal weight, shape (count,).

    ``trace``: a batch of runs of ``plant``, shape (count,), with m at least the observability index.
    """
    lifting, controller = trace.scheme.lifting, trace.scheme.controller
    pairs = [signal_model(F, G, H, lifting.outputs) for F, G, H in zip(plant.F, plant.G, plant.H, strict=True)]
    true = lifting.augment(SignalModel(np.stack([pair.A for pair in pairs]), np.stack([pair.B for pair in pairs])))
    held = lifting.augment(trace.steps[-1].model)
    problem = V1(held, controller.Q, controller.R, controller.QN, 0.0, controller.horizon)
    first = [solve(problem, np.broadcast_to(x, (len(pairs), held.n))).u[:, 0] for x in np.eye(held.n)]
    return np.asarray(np.max(np.abs(np.linalg.eigvals(true.A + true.B @ np.stack(first, axis=-1))), axis=-1))


def check_convergence(effort: Effort, reachable: bool = True) -> Evidence:
    """Compare state and input at the end of each run with their peak."""
    trace = unknown_plants(effort.seed, effort.cases, reachable)
    if np.any(trace.diverged_at >= 0):
        return Evidence(effort.cases, np.inf, _SETTLED, "a run left the range of floating-point numbers")
    ratios = end_over_peak(trace)
    return Evidence(len(ratios), float(np.max(ratios)), _SETTLED, "slow modes still decay when the runs end")


def never_acts(initial: SignalModel) -> Trace:
    """Run the scheme on z+ = 2z + v, y = z, z(0) = 1, with m = 1 and no mixing, 40 steps."""
    return simulate(scheme_for(1, initial), LinearPlant(2 * np.eye(1), np.eye(1), np.eye(1)), [1.0], 40)


def check_never_acts(effort: Effort, A: float = 0.0, B: float = 0.0) -> Evidence:
    """Run the scheme of Theorem 3 as printed on z+ = 2z + v from an initial model; it must go to zero.

    ``effort`` is not used, since nothing is random. ``A``, ``B``: the initial model; zero is not controllable. The
    gains of the plans, which Assumption 5(b) bounds, must stay bounded, or the run is no evidence.
    """
    trace = never_acts(SignalModel(np.array([[A]]), np.array([[B]])))
    gains = [float(np.max(np.abs(np.concatenate([done.plan.u, done.plan.x[:-1]], axis=1)))) for done in trace.steps]
    if not np.max(np.array(gains) / np.abs(trace.y[:, 0])) < 1e7:
        return Evidence(0, np.nan, why="the gains of the plans are not bounded")
    return Evidence(1, float(end_over_peak(trace)), _SETTLED, "slow modes still decay when the runs end")


def check_peaking(effort: Effort, known: bool = False) -> Evidence:
    """Check that the median run's state grows at least tenfold before it converges.

    ``known``: control the same plants with the exact, fixed model from the first step.
    """
    trace = known_plants(effort.seed, effort.cases) if known else unknown_plants(effort.seed, effort.cases, True)
    peak = np.max(np.linalg.norm(trace.z, axis=-1), axis=0)
    return Evidence(len(peak), 10.0 - float(np.median(peak)), 0.0, "ten times the initial state, by definition")


@cache
def known_plants(seed: int, count: int) -> Trace:
    """Run the controller on the same plants, each with its pair (55) as the model, fixed by a huge proximal weight."""
    plant, z0 = random_plants(Effort(seed).rng("theorem-3"), count)
    models = [signal_model(F, G, H, 3) for F, G, H in zip(plant.F, plant.G, plant.H, strict=True)]
    model = SignalModel(np.stack([each.A for each in models]), np.stack([each.B for each in models]))
    held = replace(scheme_for(3, model), estimator=ProximalEstimator(6, generator=WeightedSquares(1e15)))
    return simulate(held, plant, z0, _STEPS // 2)


def check_stacks(effort: Effort, oldest_first: bool = False) -> Evidence:
    """Compare the library's stacks with equation (22), entry by entry."""
    rng = effort.rng("eq-22")
    gaps = []
    for _ in range(effort.cases):
        m, p = (int(size) for size in rng.integers(1, 5, 2))
        y = rng.normal(size=(8, p))
        k = int(rng.integers(m - 1, 8))
        x = DelayLifting(m, m).window(y[::-1], m, 1, start=7 - k)[0]
        wanted = y[k - m + 1 : k + 1] if oldest_first else y[k - m + 1 : k + 1][::-1]
        gaps.append(float(np.max(np.abs(x - wanted.reshape(-1)))))
    return Evidence(len(gaps), worst_of(gaps), 0.0, "only copies are made")


CLAIMS: tuple[Claim, ...] = (
    _claim(
        "assumption-1",
        "Assumption 1",
        "ass1ground",
        "The plant is stabilizable and detectable, and a bound m on its order is known.",
        reason="A hypothesis. The controls of lemma-6.converse and theorem-3 show what happens without it.",
        kind="hypothesis",
    ),
    _claim(
        "theorem-3",
        "Theorem 3",
        "mainthm",
        "Under Assumptions 1, 3, 5(b) and 6 the scheme brings state and input of an unknown plant to zero.",
        method="simulation",
        recorded="refuted",
        stated=check_never_acts,
        control=Control("A(0) = 1 and B(0) = 0", lambda effort: check_never_acts(effort, A=1.0)),
        instance=Control(
            "the controllable initial model A(0) = B(0) = 1", lambda effort: check_never_acts(effort, 1.0, 1.0)
        ),
        reason="It must require a controllable initial model and mixing: for z+ = 2z + v, y = z, m = 1, "
        "A(0) = B(0) = 0 and lambda = 0, no input is ever applied, A(k) tends to 2, the gains are bounded, and "
        "z(k) = 2^k z(0). "
        "Also, the augmented pair must stay controllable (theorem-2.iii). Claim theorem-3.prime is the theorem that "
        "holds.",
        uses=(
            "assumption-1",
            "assumption-3",
            "assumption-5",
            "assumption-6",
            "lemma-6",
            "remark-4",
            "theorem-1",
            "theorem-2.i",
            "theorem-2.ii",
            "theorem-2.iii",
        ),
    ),
    _claim(
        "theorem-3.runs",
        "Theorem 3",
        "mainthm",
        "On a hundred random unknown plants state and input decrease to a tenth of their peak in 400 steps.",
        method="simulation",
        recorded="observed",
        stated=check_convergence,
        control=Control("no input into the unstable block", lambda effort: check_convergence(effort, False)),
    ),
    _claim(
        "text-peaking",
        "text",
        "",
        "The state of an unstable unknown plant peaks, as the paper says; here at least tenfold in the median run.",
        method="simulation",
        recorded="observed",
        stated=check_peaking,
        control=Control("the exact model from the first step", lambda effort: check_peaking(effort, known=True)),
    ),
    _claim(
        "eq-1",
        "Equation 1",
        "sys",
        "The plant: z+ = Fz + Gv, y = Hz.",
        reason="A definition.",
        kind="definition",
    ),
    _claim(
        "eq-22",
        "Equation 22",
        "arx",
        "The stacks x(k), u(k) hold the last m outputs and inputs, newest first.",
        method="exact arithmetic",
        recorded="holds",
        stated=check_stacks,
        control=Control("the oldest first", lambda effort: check_stacks(effort, oldest_first=True)),
        kind="definition",
    ),
)
