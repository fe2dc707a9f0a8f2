"""Diagnosis of a plant and a scheme: which assumptions hold, before a run and after it."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike

from rhl._checks import Array, instance, real_array, reason
from rhl.app._after import FITS, LESS_PEAK, LOST, of_models, of_signals
from rhl.app._finding import Diagnosis, Finding, Verdict
from rhl.closed_loop import start, step
from rhl.controllability import LambdaSearch, controllability_margin
from rhl.disturbances import Disturbance, Disturbances
from rhl.errors import InputError
from rhl.losses import Convex, Varying, called
from rhl.memory import GrowingMemory
from rhl.plants import LinearPlant, Plant
from rhl.plants.analysis import (
    Modes,
    detectability,
    growth_alone,
    linearise,
    observability_index,
    spectral_radius,
    stabilizability,
)
from rhl.plants.base import check_plant
from rhl.scheme import Scheme
from rhl.trace import Trace

__all__ = ["Diagnosis", "Finding", "Verdict", "diagnose", "diagnose_run"]

# A large peak is predicted if, without control, the plant exceeds this many times its first output during learning.
# More than half of these plants exceed a hundred times in a run, and they are most of the plants that do.
_PREDICTED = 30.0


def diagnose(
    plant: Plant,
    scheme: Scheme,
    *,
    z0: ArrayLike | None = None,
    sensor: Disturbances | None = None,
    actuator: Disturbances | None = None,
    load: Disturbances | None = None,
) -> Diagnosis:
    """Check the assumptions of the paper for a plant and a scheme, before anything runs.

    A nonlinear plant is judged by its linearisation at zero. ``sensor``, ``actuator`` and ``load`` act between plant
    and scheme. With the initial state z0, shape (n,), the peak of the outputs is predicted if the scheme starts
    without a model. InputError if the plant's sizes do not fit the scheme, z0 does not fit the
    plant, or its functions misbehave.

    Examples
    --------
    >>> from rhl.scheme import default_scheme
    >>> plant = LinearPlant([[1.1, 0.0], [0.0, 0.5]], [[0.0], [1.0]], [[1.0, 1.0]])
    >>> print(diagnose(plant, default_scheme(1, 1, 2)).findings[1].says)
    the input does not reach the mode 1.1, which does not decay: the smallest singular value of [lambda I - F, G] is 0
    """
    check_plant(plant)
    instance("scheme", scheme, Scheme)
    for name, found, wanted in (("outputs", plant.p, scheme.p), ("inputs", plant.q, scheme.q)):
        if found != wanted:
            raise InputError(f"the plant must have {wanted} {name}, for which the initial model is made, got {found}")
    start = None if z0 is None else real_array("z0", z0, (plant.n,))
    return Diagnosis(
        (
            *_of_plant(plant, scheme, start),
            *_of_scheme(scheme),
            *_of_disturbances(scheme, sensor, actuator, load),
        )
    )


def diagnose_run(trace: Trace) -> Diagnosis:
    """Report whether a run converged, and which assumption is suspect if it did not.

    The trace may be that of a run that stopped early, its error's ``trace``. InputError if the trace is a batch.
    """
    instance("trace", trace, Trace)
    if trace.y.ndim != 2:
        raise InputError(f"the trace must be of one run, got a batch of shape {trace.y.shape[1:-1]}; take one member")
    models = tuple(of_models(trace))
    return Diagnosis((*of_signals(trace, any(finding.verdict == "suspect" for finding in models)), *models))


def _of_plant(plant: Plant, scheme: Scheme, z0: Array | None) -> Iterator[Finding]:
    if isinstance(plant, LinearPlant):
        linear, name = plant, f"linear of order {plant.n}"
    else:
        try:
            linear = linearise(plant)
        except InputError as error:
            yield Finding("Plant", "violated", f"it cannot be linearised at zero: {error}")
            return
        name = f"of order {plant.n}, nonlinear as given: the findings below are about its linearisation at zero"
    yield Finding(
        "Plant", "note", f"{name}; q = {plant.q}, p = {plant.p}, spectral radius {spectral_radius(linear.F):.4g}"
    )
    if scheme.set_point is not None:
        yield _of_set_point(linear, scheme.set_point.at(0, plant.p))
    for subject, modes, what, matrix in (
        ("stabilizable", stabilizability(linear.F, linear.G), "the input does not reach", "[lambda I - F, G]"),
        ("detectable", detectability(linear.F, linear.H), "the outputs do not see", "[lambda I - F; H]"),
    ):
        yield _of_modes(f"Assumption 1, {subject}", modes, what, matrix)
    yield _of_lengths(linear, scheme)
    if z0 is not None and scheme.set_point is None and scheme.units is not None and scheme.units.model_in_sizes:
        yield from _of_peak(linear, scheme, z0)
    n, mp = linear.n, scheme.lifting.outputs * scheme.p
    if mp > n:
        yield Finding(
            "Augmented pair",
            "note",
            f"x(k) stacks {mp} outputs of a plant of order {n}: a model that is exact on the data then has no "
            "controllable augmented pair, so its margin is expected to shrink as the estimate improves",
        )


def _of_set_point(plant: LinearPlant, r: Array) -> Finding:
    subject = "Set point, an equilibrium"
    held = np.block([[np.eye(plant.n) - plant.F, -plant.G], [plant.H, np.zeros((plant.p, plant.q))]])
    wanted = np.concatenate([np.zeros(plant.n), r])
    sizes = np.max(np.abs(held), axis=1, keepdims=True)
    held, wanted = held / np.where(sizes > 0, sizes, 1.0), wanted / np.where(sizes > 0, sizes, 1.0)[:, 0]
    found = np.linalg.lstsq(held, wanted)[0]
    if np.max(np.abs(held @ found - wanted)) <= FITS * np.max(np.abs(wanted)):
        inputs = ", ".join(f"{value:.3g}" for value in found[plant.n :])
        return Finding(subject, "met", f"the inputs {inputs} hold the outputs at it")
    return Finding(
        subject,
        "violated",
        "no constant input holds the outputs at it: there are more outputs than inputs that move them at rest; choose "
        "another set point, or leave outputs out",
    )


def _of_peak(plant: LinearPlant, scheme: Scheme, z0: Array) -> Iterator[Finding]:
    """Predict the peak from the growth of the plant without control while the scheme learns it.

    Until m + n + m q steps have passed, the data do not distinguish the n + m q directions of past outputs and inputs.
    On the ensembles of the book's page on symptoms this is within a factor of two of the peak in most runs.
    """
    m = min(scheme.lifting.outputs, scheme.lifting.inputs)
    steps = m + plant.n + m * plant.q
    if not np.any(plant.H @ z0):
        return
    largest = float(growth_alone(plant, z0, steps))
    says = f"without control, the outputs grow {largest:.3g} times in the {steps} steps that learning takes"
    if largest > _PREDICTED:
        says += f"; {LESS_PEAK}, or sample faster"
    else:
        says += "; most peaks are within a factor of three of this"
    yield Finding("Peak to expect", "suspect" if largest > _PREDICTED else "note", says)


def _of_modes(subject: str, modes: Modes, what: str, matrix: str) -> Finding:
    if modes.worst is None:
        return Finding(subject, "met", "every mode decays without control")
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
        return Finding(subject, "met", f"{lengths}; m reaches the observability index {index}, which is enough")
    return Finding(
        subject,
        "violated",
        f"{lengths}, and the observability index is {index}: with fewer, a linear model of the signals need not exist",
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
        + ("" if vanishes is not None else "; whether it tends to zero is not known"),
    )
    if controller.adaptive:
        yield Finding(
            "Adaptive weight", "outside", "Theorem 1 lets epsilon fall at every step, not only where V1 is stuck"
        )
    lifted, of_pair = float(controllability_margin(scheme.initial_model)), float(controllability_margin(augmented))
    kept = isinstance(scheme.mixing, LambdaSearch)
    asked = scheme.mixing.least_margin if isinstance(scheme.mixing, LambdaSearch) else LOST
    # With running units the first model is only a starting point, and no theorem of the paper covers them.
    lacking: Verdict = "violated" if scheme.units is None else "outside"
    yield Finding(
        "Theorem 2(iii), initial model controllable",
        "met" if min(lifted, of_pair) >= asked else lacking,
        f"smallest singular value of the controllability matrix {lifted:.3g} (lifted pair), {of_pair:.3g} (augmented "
        f"pair); {'lambda is searched' if kept else 'lambda is not searched'}, so controllability is "
        f"{'kept' if kept else 'not enforced'}",
    )
    if lifting.basis is not None:
        yield Finding(
            "Basis functions",
            "outside",
            f"x(k) has {scheme.initial_model.n} entries; whether a linear model of them exists (Assumption 7) "
            "is not known; check it after a run",
        )
    if scheme.units is not None:
        yield Finding(
            "Running units",
            "outside",
            "the weights scale signals by sizes observed in the run; Theorem 1 is stated for constant weights",
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
        yield Finding(
            "Assumption 6, loss", "note", "varies with k; each must be strictly convex with its minimum at zero"
        )
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


def _of_disturbances(
    scheme: Scheme, sensor: Disturbances | None, actuator: Disturbances | None, load: Disturbances | None
) -> Iterator[Finding]:
    untold = scheme.units is not None and not np.any(scheme.units.noise)
    for name, part in (("Sensor", sensor), ("Actuator", actuator), ("Load", load)):
        if part is not None and part != ():
            what = " and ".join(map(_named, part if isinstance(part, tuple) else (part,)))
            says = f"{what} acts between scheme and plant; the theory has none"
            if untold and part is not actuator:
                says += "; the scheme expects no errors: set noise to their standard deviation"
            yield Finding(name, "outside", says)


def _named(part: Disturbance) -> str:
    return "a function of your own" if inspect.isfunction(part) else called(part)
