"""Which assumptions a plant and a scheme meet, before a run and after it: in words, with numbers."""

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

# Predicted is a large peak where the plant left alone passes this many times its first output while it is learned: of
# the plants that do, more than half pass a hundred times, and most of those that pass that are found so.
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

    A plant that is not linear is judged by its linearisation at zero; ``sensor``, ``actuator`` and ``load`` are what
    would stand between plant and scheme. With the initial state z0, shape (n,), the peak of the outputs is predicted
    where the scheme begins without a model. InputError if the plant's sizes do not fit the scheme, z0 does not fit the
    plant, or its functions misbehave.

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
    start = None if z0 is None else real_array("z0", z0, (plant.n,))
    return Diagnosis(
        (
            *_of_plant(plant, scheme, start),
            *_of_scheme(scheme),
            *_of_disturbances(scheme, sensor, actuator, load),
        )
    )


def diagnose_run(trace: Trace) -> Diagnosis:
    """Say how a run went, and which assumption is suspect where it did not go well.

    The trace is of one run, InputError if it is a batch; one that stopped early too, its error's ``trace``.
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
        name = f"of order {plant.n}, not linear as given: what follows is about its linearisation at zero"
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
            f"x(k) stacks {mp} outputs of a plant of order {n}: a model that is exact on the data has no controllable "
            "augmented pair then, so its margin must be expected to shrink as the estimate improves",
        )


def _of_set_point(plant: LinearPlant, r: Array) -> Finding:
    subject = "Set point, an equilibrium"
    held = np.block([[np.eye(plant.n) - plant.F, -plant.G], [plant.H, np.zeros((plant.p, plant.q))]])
    wanted = np.concatenate([np.zeros(plant.n), r])
    sizes = np.max(np.abs(held), axis=1, keepdims=True)
    held, wanted = held / np.where(sizes > 0, sizes, 1.0), wanted / np.where(sizes > 0, sizes, 1.0)[:, 0]
    found = np.linalg.lstsq(held, wanted)[0]
    if np.max(np.abs(held @ found - wanted)) <= FITS * max(1.0, float(np.max(np.abs(wanted)))):
        inputs = ", ".join(f"{value:.3g}" for value in found[plant.n :])
        return Finding(subject, "met", f"the inputs {inputs} hold the outputs at it")
    return Finding(
        subject,
        "violated",
        "no constant input holds the outputs at it: there are more outputs than inputs that move them at rest; choose "
        "another set point, or leave outputs out",
    )


def _of_peak(plant: LinearPlant, scheme: Scheme, z0: Array) -> Iterator[Finding]:
    """Predict the peak from how far the plant gets by itself while the scheme learns it.

    Until m + n + m q steps have passed, the data cannot tell the n + m q directions of past outputs and inputs apart.
    On the ensembles of the book's page on symptoms this is the peak to within a factor of two in most runs.
    """
    m = min(scheme.lifting.outputs, scheme.lifting.inputs)
    steps = m + plant.n + m * plant.q
    if not np.any(plant.H @ z0):
        return
    largest = float(growth_alone(plant, z0, steps))
    says = f"left alone, the outputs grow {largest:.3g} times in the {steps} steps that learning takes"
    if largest > _PREDICTED:
        says += f"; {LESS_PEAK}, or sample faster"
    yield Finding("Peak to expect", "suspect" if largest > _PREDICTED else "note", says)


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
    asked = scheme.mixing.least_margin if isinstance(scheme.mixing, LambdaSearch) else LOST
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


def _of_disturbances(
    scheme: Scheme, sensor: Disturbances | None, actuator: Disturbances | None, load: Disturbances | None
) -> Iterator[Finding]:
    untold = scheme.units is not None and not np.any(scheme.units.noise)
    for name, part in (("Sensor", sensor), ("Actuator", actuator), ("Load", load)):
        if part is not None and part != ():
            what = " and ".join(map(_named, part if isinstance(part, tuple) else (part,)))
            says = f"{what} stands between scheme and plant; the theory knows none"
            if untold and part is not actuator:
                says += "; the scheme expects no errors: say how large they are, noise"
            yield Finding(name, "outside", says)


def _named(part: Disturbance) -> str:
    return "a function of your own" if inspect.isfunction(part) else called(part)
