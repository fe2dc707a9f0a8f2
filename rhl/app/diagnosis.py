"""Which assumptions a plant and a scheme meet, before a run and after it: in words, with numbers."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from dataclasses import dataclass
from time import perf_counter
from typing import Literal, get_args

import numpy as np

from rhl._checks import Array, choice, instance, reason
from rhl.closed_loop import Step, start, step
from rhl.controllability import LambdaSearch, controllability_margin
from rhl.disturbances import Disturbance, Disturbances
from rhl.errors import InputError
from rhl.losses import Convex, Varying, called
from rhl.memory import GrowingMemory
from rhl.plants import LinearPlant, Plant
from rhl.plants.analysis import (
    Modes,
    detectability,
    linearise,
    observability_index,
    spectral_radius,
    stabilizability,
)
from rhl.plants.base import check_plant
from rhl.scheme import Scheme
from rhl.trace import Trace

Verdict = Literal["met", "violated", "suspect", "outside", "note"]

# A margin below this is lost: what LambdaSearch calls controllable by default.
_LOST = 1e-9
# The last tenth of a run is taken for its end; there a signal is gone if it is this much smaller than it was.
_END, _GONE = 10, 1e-3
# A model that misses more than this share of a run's signals does not reproduce them.
_FITS = 1e-6
# Gains of the plans above this are not what Assumption 5 hopes for.
_GAIN = 1e4


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Attributes
    ----------
    subject : str
        What, with the paper's name for it.
    verdict : {"met", "violated", "suspect", "outside", "note"}
        suspect: cannot be decided, but the numbers speak against it. outside: the theory does not treat it. note: a
        number to know.
    says : str
        A sentence or two, with numbers.
    """

    subject: str
    verdict: Verdict
    says: str

    def __post_init__(self) -> None:
        choice("verdict", self.verdict, get_args(Verdict))


@dataclass(frozen=True)
class Diagnosis:
    """What was found, in the order in which one would ask."""

    findings: tuple[Finding, ...]

    @property
    def sound(self) -> bool:
        """Whether nothing is violated or suspect."""
        return not any(finding.verdict in ("violated", "suspect") for finding in self.findings)

    def __str__(self) -> str:
        return "\n".join(f"{finding.verdict:9} {finding.subject}: {finding.says}" for finding in self.findings)


def diagnose(
    plant: Plant, scheme: Scheme, *, sensor: Disturbances | None = None, actuator: Disturbances | None = None
) -> Diagnosis:
    """Check the assumptions of the paper for a plant and a scheme, before anything runs.

    A plant that is not linear is judged by its linearisation at zero; ``sensor`` and ``actuator`` are what would stand
    between plant and scheme. InputError if the plant's sizes do not fit the scheme, or its functions misbehave.

    Examples
    --------
    >>> from rhl.scheme import default_scheme
    >>> deaf = LinearPlant([[1.1, 0.0], [0.0, 0.5]], [[0.0], [1.0]], [[1.0, 1.0]])
    >>> print(diagnose(deaf, default_scheme(1, 1, 2)).findings[1].says)
    the input does not reach the mode 1.1, which does not decay: the smallest singular value of [lambda I - F, G] is 0
    """
    check_plant(plant)
    instance("scheme", scheme, Scheme)
    for name, found, wanted in (("outputs", plant.p, scheme.p), ("inputs", plant.q, scheme.q)):
        if found != wanted:
            raise InputError(f"the plant must have {wanted} {name}, for which the initial model is made, got {found}")
    return Diagnosis((*_of_plant(plant, scheme), *_of_scheme(scheme), *_of_disturbances(sensor, actuator)))


def diagnose_run(trace: Trace) -> Diagnosis:
    """Say how a run went, and which assumption is suspect where it did not go well.

    The trace is of one run, InputError if it is a batch; one that stopped early too, its error's ``trace``.
    """
    instance("trace", trace, Trace)
    if trace.y.ndim != 2:
        raise InputError(f"the trace must be of one run, got a batch of shape {trace.y.shape[1:-1]}; take one member")
    models = tuple(_of_models(trace))
    return Diagnosis((*_of_signals(trace, any(finding.verdict == "suspect" for finding in models)), *models))


def _of_plant(plant: Plant, scheme: Scheme) -> Iterator[Finding]:
    if isinstance(plant, LinearPlant):
        linear, name = plant, f"linear of order {plant.n}"
    else:
        try:
            linear = linearise(plant)
        except InputError as error:
            yield Finding("Plant", "violated", f"it cannot be linearised at zero: {error}")
            return
        name = f"of order {plant.n}, not linear as given: what follows is about its linearisation at zero"
    yield Finding(
        "Plant", "note", f"{name}; q = {plant.q}, p = {plant.p}, spectral radius {spectral_radius(linear.F):.4g}"
    )
    for subject, modes, what, matrix in (
        ("stabilizable", stabilizability(linear.F, linear.G), "the input does not reach", "[lambda I - F, G]"),
        ("detectable", detectability(linear.F, linear.H), "the outputs do not see", "[lambda I - F; H]"),
    ):
        yield _of_modes(f"Assumption 1, {subject}", modes, what, matrix)
    yield _of_lengths(linear, scheme)
    n, mp = linear.n, scheme.lifting.outputs * scheme.p
    if mp > n:
        yield Finding(
            "Augmented pair",
            "note",
            f"x(k) stacks {mp} outputs of a plant of order {n}: a model that is exact on the data has no controllable "
            "augmented pair then, so its margin must be expected to shrink as the estimate improves",
        )


def _of_modes(subject: str, modes: Modes, what: str, matrix: str) -> Finding:
    if modes.worst is None:
        return Finding(subject, "met", "every mode decays by itself")
    value, worst = modes.worst
    mode = f"{value.real:.4g}" if abs(value.imag) < 1e-12 else f"{value.real:.4g}{value.imag:+.4g}j"
    if modes.holds:
        return Finding(subject, "met", f"smallest margin {worst:.3g}, at the mode {mode}")
    return Finding(
        subject,
        "violated",
        f"{what} the mode {mode}, which does not decay: the smallest singular value of {matrix} is {worst:.3g}",
    )


def _of_lengths(plant: LinearPlant, scheme: Scheme) -> Finding:
    subject, lifting = "Assumption 1, m >= n", scheme.lifting
    m, index = min(lifting.outputs, lifting.inputs), observability_index(plant.F, plant.H)
    lengths = f"N_y = {lifting.outputs} outputs and N_v = {lifting.inputs} inputs are stacked, n = {plant.n}"
    if m >= plant.n:
        return Finding(subject, "met", lengths)
    if m >= index:
        return Finding(
            subject, "met", f"{lengths}; not n, but the observability index {index} is reached, which is enough"
        )
    return Finding(
        subject,
        "violated",
        f"{lengths}, and the observability index is {index}: with fewer no linear model of the signals need exist",
    )


def _of_scheme(scheme: Scheme) -> Iterator[Finding]:
    lifting, estimator, controller = scheme.lifting, scheme.estimator, scheme.controller
    augmented = lifting.augment(scheme.initial_model)
    size, horizon = augmented.n, controller.horizon
    yield Finding(
        "Assumption 3, N >= n",
        "met" if horizon >= size else "violated",
        f"the horizon is {horizon}, the augmented state has {size} entries",
    )
    yield from _of_convexity(estimator.loss, estimator.generator)
    vanishes = getattr(controller.epsilon, "vanishes", None)
    yield Finding(
        "Theorem 1, epsilon(k) -> 0",
        "violated" if vanishes is False else "met" if vanishes else "note",
        f"{called(controller.epsilon)}: epsilon(0) = {controller.epsilon(0):.3g}, "
        f"epsilon(100) = {controller.epsilon(100):.3g}"
        + ("" if vanishes is not None else "; whether it tends to zero, only its author knows"),
    )
    if controller.adaptive:
        yield Finding(
            "Adaptive weight", "outside", "Theorem 1 lets epsilon fall at every step, not only where V1 is stuck"
        )
    lifted, of_pair = float(controllability_margin(scheme.initial_model)), float(controllability_margin(augmented))
    kept = isinstance(scheme.mixing, LambdaSearch)
    asked = scheme.mixing.least_margin if isinstance(scheme.mixing, LambdaSearch) else _LOST
    # With running units the first model is only a place to learn from, and no theorem of the paper treats them.
    lacking: Verdict = "violated" if scheme.units is None else "outside"
    yield Finding(
        "Theorem 2(iii), initial model controllable",
        "met" if min(lifted, of_pair) >= asked else lacking,
        f"smallest singular value of the controllability matrix {lifted:.3g} (lifted pair), {of_pair:.3g} (augmented "
        f"pair); {'lambda is searched' if kept else 'lambda is not searched'}, so controllability is "
        f"{'kept' if kept else 'not watched'}",
    )
    if lifting.basis is not None:
        yield Finding(
            "Basis functions",
            "outside",
            f"x(k) has {scheme.initial_model.n} entries; that a linear model of them exists (Assumption 7) is a hope, "
            "look at it after a run",
        )
    if scheme.units is not None:
        yield Finding(
            "Running units",
            "outside",
            "weights count signals in sizes that the run shows; Theorem 1 is stated for weights that do not change",
        )
    n, q = scheme.initial_model.n, scheme.initial_model.q
    whole = isinstance(estimator, GrowingMemory)
    data = "every transition measured" if whole else f"{estimator.window} transitions of {n} numbers"
    yield Finding(
        "Size",
        "note",
        f"A is {n} by {n}, B {n} by {q}: {n * (n + q)} parameters from {data}; "
        f"augmented model of order {size}; {_pace(scheme)}",
    )


def _of_convexity(loss: Convex | Varying, generator: Convex) -> Iterator[Finding]:
    parts = [("generator", generator)] + ([] if isinstance(loss, Varying) else [("loss", loss)])
    for role, part in parts:
        verdict, words = _known(part.assumption_6)
        yield Finding(f"Assumption 6, {role}", verdict, f"{called(part)}: {words}")
    if isinstance(loss, Varying):
        yield Finding("Assumption 6, loss", "note", "varies with k; each must be strictly convex and least at zero")
    verdict, words = _known(generator.convex_in_second)
    yield Finding("Lemma 4, D convex in its second argument", verdict, f"that of {called(generator)}: {words}")


def _known(holds: bool | None) -> tuple[Verdict, str]:
    if holds is None:
        return "suspect", "not known"
    return ("met", "holds") if holds else ("violated", "does not hold")


def _pace(scheme: Scheme) -> str:
    # The second of two steps: the first may load code.
    memory, y = start(scheme), np.ones(scheme.p)
    try:
        step(scheme, memory, y)
        began = perf_counter()
        step(scheme, memory, y)
    except ArithmeticError as error:
        return f"a step from outputs of 1 fails: {reason(error)}"
    return f"about {1e3 * (perf_counter() - began):.1f} ms a step here"


def _of_disturbances(sensor: Disturbances | None, actuator: Disturbances | None) -> Iterator[Finding]:
    for name, part in (("Sensor", sensor), ("Actuator", actuator)):
        if part is not None and part != ():
            what = " and ".join(map(_named, part if isinstance(part, tuple) else (part,)))
            yield Finding(name, "outside", f"{what} stands between scheme and plant; the theory knows none")


def _named(part: Disturbance) -> str:
    return "a function of your own" if inspect.isfunction(part) else called(part)


def _size(rows: Array) -> Array:
    return np.max(np.abs(rows), axis=-1)


def _of_signals(trace: Trace, suspect_below: bool) -> Iterator[Finding]:
    hidden = trace.plant_state is None
    z, v = _size(trace.y if hidden else trace.z), _size(trace.v)
    name, end = "y" if hidden else "z", max(1, len(trace) // _END)
    first, last = float(np.max(z[:end])), float(np.max(z[-end:]))
    ends = (
        f"largest |{name}| {first:.3g} in the first {end} steps, {last:.3g} in the last; |v| there {v[-end:].max():.3g}"
    )
    converged = last <= _GONE * first
    verdict: Verdict = "met" if converged else "suspect"
    hint = "it grew: try a longer horizon, or begin from a rough model" if last > first else "not gone yet: run on"
    reason = "" if converged else f"; {hint}" + (", and read what is suspect below" if suspect_below else "")
    yield Finding("Theorem 3, state and input go to zero", verdict, ends + reason)
    at = int(np.argmax(z))
    yield Finding(
        "Peak",
        "note",
        f"largest |{name}| {z[at]:.3g} at k = {at}, {z[at] / max(float(z[0]), 1e-300):.3g} times that at k = 0; "
        f"largest |v| {v.max():.3g} at k = {int(np.argmax(v))}",
    )


def _of_models(trace: Trace) -> Iterator[Finding]:
    scheme = trace.scheme
    for name, margins in (("lifted", trace.margin_lifted), ("augmented", trace.margin_augmented)):
        lost = trace.k[~(margins >= _LOST)]
        least = float(np.nanmin(margins)) if np.any(np.isfinite(margins)) else 0.0
        says = f"smallest margin {least:.3g}"
        if len(lost):
            says += f", below {_LOST:g} at {len(lost)} of {len(trace)} steps, first at k = {lost[0]}"
        lacking: Verdict = "suspect" if scheme.units is None else "outside"
        yield Finding(f"Theorem 2(iii), {name} pair stays controllable", lacking if len(lost) else "met", says)
    misfit = _misfit(trace)
    if misfit is not None:
        yield Finding(
            "Assumption 7, a linear model of the run's signals exists",
            "met" if misfit <= _FITS else "suspect",
            f"the best one leaves a share of {misfit:.2g} of them unexplained"
            + ("" if misfit <= _FITS else "; stack more, append basis functions, or look for noise"),
        )
    gains = np.array([_gain(done) for done in trace.steps])
    at = int(np.argmax(gains))
    yield Finding(
        "Assumption 5(b), bounded gains of V1",
        "met" if gains[at] <= _GAIN else "suspect",
        f"inputs and states planned at k = {at} are up to {gains[at]:.3g} times the state there",
    )
    moved = np.linalg.norm(np.diff(trace.theta, axis=0), axis=-1)
    if len(moved):
        end = max(1, len(moved) // _END)
        yield Finding(
            "Theorem 2(i), the estimates converge",
            "met" if moved[-end:].max() <= _GONE * max(moved.max(), 1e-300) else "suspect",
            f"largest move of theta {moved.max():.3g}, in the last {end} steps {moved[-end:].max():.3g}",
        )
    yield Finding(
        "Certificates", "note", f"every estimate within {float(np.max(trace.newton_decrement)):.1g} of its minimiser"
    )
    if scheme.controller.adaptive:
        yield Finding("Adaptive weight", "note", f"epsilon was let fall {int(trace.steps[-1].stage)} times")


def _gain(done: Step) -> float:
    """Return how many times the state the largest number planned is; infinite where the plan leaves float64."""
    try:
        plan = done.plan
    except (InputError, ArithmeticError):
        return np.inf
    size = float(np.max(np.abs(plan.x[0])))
    return max(float(np.max(np.abs(plan.u))), float(np.max(np.abs(plan.x)))) / size if size > 0 else 0.0


def _misfit(trace: Trace) -> float | None:
    """Return the part of x(k+1) that no linear function of x(k), u(k) gives, relative; None where the run is short."""
    lifting = trace.scheme.lifting
    begin = max(lifting.outputs, lifting.inputs)
    y, v = trace.y[::-1], trace.v[::-1]
    count = len(y) - begin
    if count < 1:
        return None
    x, u = lifting.lift(y, count), lifting.window(v, lifting.inputs, count)
    known, next_ = np.concatenate([x[1:], u[1:]], axis=1), x[:-1]
    if len(known) < 2 * known.shape[1] or not np.all(np.isfinite(trace.y[-1])):
        return None
    # Each transition by its own size, so that a run's beginning does not hide its end; but not what is nearly zero.
    size = np.max(np.abs(known), axis=1, keepdims=True)
    heavy = size[:, 0] > 1e-9 * size.max()
    if np.sum(heavy) < 2 * known.shape[1]:
        return None
    known, next_ = (known / size)[heavy], (next_ / size)[heavy]
    residual = next_ - known @ np.linalg.lstsq(known, next_)[0]
    return float(np.linalg.norm(residual) / max(float(np.linalg.norm(next_)), 1e-300))
