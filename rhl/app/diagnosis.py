"""Diagnosis of a plant and a scheme: which assumptions hold, before a run and after it."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike

from rhl._checks import Array, instance, real_array, reason
from rhl.app._after import LOST, of_models, of_rest, of_signals
from rhl.app._finding import Diagnosis, Finding, Verdict
from rhl.app._known import (
    LESS_PEAK,
    Known,
    bounds_of,
    constant_load,
    holding,
    in_series,
    index_needed,
    known,
    lengthen,
    less_peak,
    mode_of,
    seen_by,
    stacked,
    unheld,
)
from rhl.closed_loop import advance, start, step
from rhl.controllability import LambdaSearch, controllability_margin
from rhl.disturbances import Disturbance, Disturbances, Saturation
from rhl.errors import InputError
from rhl.losses import Convex, Varying, called
from rhl.memory import GrowingMemory
from rhl.plants import LinearPlant, Plant
from rhl.plants.analysis import (
    Modes,
    detectability,
    growth_alone,
    linearise,
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
# The time of a step is the median of this many; fewer, if they take longer than this many seconds.
_TIMED, _PATIENCE = 9, 0.5


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
    and scheme. With the initial state z0, shape (n,), the peak of the outputs is predicted, or the finding says why it
    cannot be. InputError if the plant's sizes do not fit the scheme, z0 does not fit the
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
    _check_sizes(plant, scheme)
    start = None if z0 is None else real_array("z0", z0, (plant.n,))
    return Diagnosis(
        (
            *_of_plant(plant, scheme, start, actuator, load),
            *_of_scheme(scheme),
            *_of_disturbances(scheme, sensor, actuator, load),
        )
    )


def diagnose_run(
    trace: Trace,
    plant: Plant | None = None,
    *,
    sensor: Disturbances | None = None,
    actuator: Disturbances | None = None,
    load: Disturbances | None = None,
) -> Diagnosis:
    """Report whether a run converged, and which assumption is suspect if it did not.

    Given the plant and the disturbances of the run, the advice follows from them too: no setting helps if an input does
    not reach an unstable mode. The trace may be that of a run that stopped early, its error's ``trace``. InputError if
    the trace is a batch, or the plant does not fit its scheme.

    Examples
    --------
    >>> from rhl.scheme import default_scheme
    >>> from rhl.simulation import simulate
    >>> plant = LinearPlant([[1.1, 0.0], [0.0, 0.5]], [[0.0], [1.0]], [[1.0, 1.0]])
    >>> run = simulate(default_scheme(1, 1, 2), plant, [1.0, 1.0], steps=40)
    >>> print(diagnose_run(run, plant).findings[0].says.rpartition("; ")[2])
    the input does not reach the mode 1.1, which does not decay, so no setting can help: only other actuators can
    """
    instance("trace", trace, Trace)
    if trace.y.ndim != 2:
        raise InputError(f"the trace must be of one run, got a batch of shape {trace.y.shape[1:-1]}; take one member")
    told = Known()
    if plant is not None:
        check_plant(plant)
        _check_sizes(plant, trace.scheme)
        acting = {"sensor": sensor, "actuator": actuator, "load": load}
        told = known(plant, trace.scheme, len(trace), **acting, applied_known=trace.applied_known)
    rest = of_rest(trace)
    if rest is not None:
        return Diagnosis((rest,))
    models = tuple(of_models(trace, told))
    below = any(finding.verdict == "suspect" for finding in models)
    return Diagnosis((*of_signals(trace, below, told), *models))


def _check_sizes(plant: Plant, scheme: Scheme) -> None:
    for name, found, wanted in (("outputs", plant.p, scheme.p), ("inputs", plant.q, scheme.q)):
        if found != wanted:
            raise InputError(f"the plant must have {wanted} {name}, for which the initial model is made, got {found}")


def _of_plant(
    plant: Plant, scheme: Scheme, z0: Array | None, actuator: Disturbances | None, load: Disturbances | None
) -> Iterator[Finding]:
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
        yield _of_set_point(linear, scheme.set_point.at(0, plant.p), bounds_of(scheme, actuator), load)
    basic = [
        _of_modes(f"Assumption 1, {subject}", modes, what, matrix)
        for subject, modes, what, matrix in (
            ("stabilizable", stabilizability(linear.F, linear.G), "the input does not reach", "[lambda I - F, G]"),
            ("detectable", detectability(linear.F, linear.H), "the outputs do not see", "[lambda I - F; H]"),
        )
    ]
    basic.append(_of_lengths(linear, scheme))
    yield from basic
    if z0 is not None:
        lower = less_peak(linear, scheme) if linear is plant else LESS_PEAK
        yield _of_peak(
            linear, scheme, z0, lower, [finding.subject for finding in basic if finding.verdict == "violated"]
        )
    n, values = seen_by(linear, scheme).n, scheme.lifting.outputs
    if values * scheme.p > n:
        yield Finding(
            "Augmented pair",
            "note",
            f"x(k) has {values * scheme.p} numbers, N_y = {values} values of {_count(scheme.p, 'output')}, and the "
            f"plant{'' if scheme.set_point is None else ' with the last input as a state'} has order {n}: a model that "
            "is exact on the data then has no controllable augmented pair, so its margin is expected to shrink as the "
            "estimate improves",
        )


def _of_set_point(plant: LinearPlant, r: Array, bounds: Saturation | None, load: Disturbances | None) -> Finding:
    subject, held = "Set point, an equilibrium", holding(plant, r, bounds, load)
    if held is None or held.exceeds:
        return Finding(subject, "violated", unheld(held))
    inputs = ", ".join(f"{value:.3g}" for value in held.inputs)
    under = " under the load" if np.any(constant_load(load, plant.q)) else ""
    return Finding(subject, "met", f"the inputs {inputs} hold the outputs at it{under}")


def _of_peak(plant: LinearPlant, scheme: Scheme, z0: Array, lower: str, violated: list[str]) -> Finding:
    """Predict the peak from the growth of the plant without control while the scheme learns it.

    Until m + n + m q steps have passed, the data do not distinguish the n + m q directions of past outputs and inputs.
    On the ensembles of the book's page on symptoms this is within a factor of two of the peak in most runs.
    """
    subject, m = "Peak to expect", stacked(scheme)
    why = _unpredicted(plant, scheme, z0, violated)
    if why:
        return Finding(subject, "note", f"not predicted, since {why}")
    steps = m + plant.n + m * plant.q
    largest = float(growth_alone(plant, z0, steps))
    says = (
        f"without control, the outputs grow {largest:.3g} times in the {steps} steps that learning takes; the growth "
        "that the inputs cause is not counted, so the peak may be higher"
    )
    if largest > _PREDICTED:
        return Finding(subject, "suspect", f"{says}; {lower}, or sample faster")
    return Finding(subject, "note", says)


def _unpredicted(plant: LinearPlant, scheme: Scheme, z0: Array, violated: list[str]) -> str:
    """Return why the peak cannot be predicted; empty if it can be."""
    if violated:
        return f"{' and '.join(violated)} {'is' if len(violated) == 1 else 'are'} violated"
    if scheme.set_point is not None:
        return "with a set point the outputs have to move"
    if scheme.units is None:
        return "the scheme has no running units, which the key order chooses"
    if not scheme.units.model_in_sizes:
        return "the scheme begins from a given model, not without one"
    if not np.any(z0):
        return "the run begins at rest"
    if not np.any(plant.H @ z0):
        return "a peak is relative to the first outputs, and these are zero"
    return ""


def _of_modes(subject: str, modes: Modes, what: str, matrix: str) -> Finding:
    if modes.worst is None:
        return Finding(subject, "met", "every mode decays without control")
    worst, mode = modes.worst[1], mode_of(modes)
    if modes.holds:
        return Finding(subject, "met", f"smallest margin {worst:.3g}, at the mode {mode}")
    return Finding(
        subject,
        "violated",
        f"{what} the mode {mode}, which does not decay: the smallest singular value of {matrix} is {worst:.3g}",
    )


def _of_lengths(plant: LinearPlant, scheme: Scheme) -> Finding:
    subject, lifting, tracks = "Assumption 1, m >= n", scheme.lifting, scheme.set_point is not None
    m, index = stacked(scheme), index_needed(plant, scheme)
    lengths = (
        f"the last N_y = {_count(lifting.outputs, 'value')} of {_vector('output', plant.p)} and "
        f"N_v = {lifting.inputs} of {_vector('input', plant.q)} are stacked, n = {plant.n}"
    )
    if tracks:
        more = "one more value may be needed" if scheme.units is None else "order stacks one more value"
        lengths += f"; with a set point {more}, since the last input is then a state of the plant, too"
    if m >= plant.n + tracks:  # the index of the plant with its last input is at most one higher
        return Finding(subject, "met", lengths)
    if m >= index:
        return Finding(subject, "met", f"{lengths}; m reaches the observability index {index}, which is enough")
    return Finding(
        subject,
        "violated",
        f"{lengths}; the observability index is {index}: with fewer, a linear model of the signals need not exist; "
        f"{lengthen(plant, scheme)}",
    )


def _vector(name: str, size: int) -> str:
    return f"the {name}" if size == 1 else f"the {name} vector"


def _count(number: int, name: str) -> str:
    return f"{number} {name}{'' if number == 1 else 's'}"


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
    memory, y = start(scheme), np.ones(scheme.p)
    took: list[float] = []
    while len(took) <= _TIMED and (len(took) < 3 or sum(took) < _PATIENCE):
        began = perf_counter()
        try:
            done = step(scheme, memory, y)
            took.append(perf_counter() - began)
            memory = advance(scheme, done)
        except ArithmeticError as error:
            if not took:
                return f"a step from outputs of 1 fails: {reason(error)}"
            break
    # The first step may load code, and a machine with other work delays some.
    return f"about {1e3 * float(np.median(took[1:] or took)):.1f} ms a step here"


def _of_disturbances(
    scheme: Scheme, sensor: Disturbances | None, actuator: Disturbances | None, load: Disturbances | None
) -> Iterator[Finding]:
    untold = scheme.units is not None and not np.any(scheme.units.noise)
    for name, part in (("Sensor", sensor), ("Actuator", actuator), ("Load", load)):
        if in_series(part):
            what = " and ".join(map(_named, in_series(part)))
            says = f"{what} acts between scheme and plant; the theory has none"
            if untold and part is not actuator:
                says += "; the scheme expects no errors: set noise to their standard deviation"
            yield Finding(name, "outside", says)


def _named(part: Disturbance) -> str:
    return "a function of your own" if inspect.isfunction(part) else called(part)
