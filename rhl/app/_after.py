"""Diagnosis of a run: whether its signals converge, and which assumption is suspect if they do not."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from rhl._checks import Array
from rhl.app._finding import Finding, Verdict
from rhl.app._known import FITS, Known
from rhl.errors import InputError
from rhl.state import Step
from rhl.trace import Trace

# A smaller margin counts as not controllable, as it does for LambdaSearch by default.
LOST = 1e-9
# The end of a run is its last tenth; a signal has converged if it is this much smaller there than at the beginning.
_END, _GONE = 10, 1e-3
# With sensor errors, outputs remain that are a few times as large as the errors.
_FLOOR = 10.0
# A peak above this many times the first output is suspect.
_PEAK = 100.0
_CHOSEN = "give order in place of [lifting], [estimator] and [controller]"
# Larger gains of the plans make Assumption 5 doubtful.
_GAIN = 1e4


def _size(rows: Array) -> Array:
    return np.max(np.abs(rows), axis=-1)


def of_rest(trace: Trace) -> Finding | None:
    """Say that nothing was excited, if outputs and inputs were zero throughout and the state did not move."""
    moved = trace.plant_state is not None and np.any(trace.z != trace.z[0])
    if moved or np.any(trace.error) or np.any(trace.v):
        return None
    tracks = trace.set_point is not None
    return Finding(
        _subject(trace),
        "note",
        f"the run began at rest{' at its set point' if tracks else ''} and nothing disturbed it, so nothing was "
        "excited: it says nothing about plant and scheme; begin from another z0"
        + (" or give another set_point" if tracks else ""),
    )


def _subject(trace: Trace) -> str:
    return "State and input go to zero in this run" if trace.set_point is None else "Set point"


def of_signals(trace: Trace, suspect_below: bool, known: Known) -> Iterator[Finding]:
    """Judge state and input, or outputs and increments with a set point, where the state has to move."""
    tracks, hidden = trace.set_point is not None, trace.plant_state is None
    v = _size(np.diff(trace.v, axis=0, prepend=0.0) if tracks else trace.v)
    z = _size(trace.error if tracks or hidden else trace.z)
    name, input_name = ("y - r", "v(k) - v(k-1)") if tracks else ("y" if hidden else "z", "v")
    end = max(1, len(trace) // _END)
    first, last = float(np.max(z[:end])), float(np.max(z[-end:]))
    ends = (
        f"largest |{name}| {first:.3g} in the first {end} steps, {last:.3g} in the last; |{input_name}| there "
        f"{v[-end:].max():.3g}"
    )
    converged = last <= _GONE * first
    verdict: Verdict = "met" if converged else "suspect"
    below = ", and read the suspect findings below" if suspect_below and not known.remedy else ""
    reason = "" if converged else f"; {_hint(trace, z, end, known)}{below}"
    yield Finding(_subject(trace), verdict, ends + reason)
    yield _of_sizes(trace, v, input_name)
    yield from _of_peak(trace, known)
    yield from _of_bounds(trace)


def _of_sizes(trace: Trace, v: Array, input_name: str) -> Finding:
    """Report the largest outputs, as the predicted peak counts them, and the largest state and input."""
    y = _size(trace.error)
    at, seen = int(np.argmax(y)), np.flatnonzero(y > 0)
    times = f", {y[at] / y[seen[0]]:.3g} times the first" if len(seen) else ""
    says = [f"largest |{'y' if trace.set_point is None else 'y - r'}| {y[at]:.3g} at k = {at}{times}"]
    if trace.plant_state is not None and trace.set_point is None:
        says.append(f"largest |z| {np.max(np.abs(trace.z)):.3g} (the state, in the plant's own coordinates)")
    says.append(f"largest |{input_name}| {v.max():.3g} at k = {int(np.argmax(v))}")
    free = trace.scheme.controller.bounds is None and trace.scheme.units is not None
    return Finding(
        "Peak", "note", "; ".join(says) + ("; to keep inputs within a range, set v_min and v_max" if free else "")
    )


def _hint(trace: Trace, z: Array, end: int, known: Known) -> str:
    """Return what to change if a run did not converge."""
    units, late = trace.scheme.units, slice(-end, None)
    if known.remedy or known.unheld:
        return known.remedy or known.unheld
    if units is None:
        found = "it grew" if np.max(z[late]) > np.max(z[:end]) else "not converged yet"
        return f"{found}: {_CHOSEN}, or run more steps"
    if np.mean(_limited(trace)[late]) > 0.5:
        return "the input is at its limit at the end: widen v_min and v_max, or begin from a [rough] model"
    if np.any(units.noise):
        times = float(np.max(np.abs(trace.error[late])) / np.max(units.noise))
        if times <= _FLOOR:
            return (
                f"what remains is up to {times:.2g} times the noise that the scheme expects; up to {_FLOOR:g} times "
                "counts as its effect, which more steps do not lower"
            )
    asked = _asked(trace, known)
    if asked:
        return asked
    if np.max(z[late]) < np.max(z):
        return "not converged yet: run more steps, or lengthen the horizon where the sampling is fast"
    return f"it grew: {known.less_peak}"


def _asked(trace: Trace, known: Known) -> str:
    """Return which keys a run asks for whose signals have no linear model: those of what acts, if that is known."""
    misfit = _misfit(trace)
    if misfit is None or misfit <= FITS:
        return ""
    if known.told:
        return "; ".join(known.asks)
    guesses = []
    if trace.scheme.units is not None and not np.any(trace.scheme.units.noise):
        guesses.append("if the sensors have errors, set noise to their standard deviation")
    if trace.set_point is None:
        guesses.append("if a constant disturbance acts, give set_point")
    return "; ".join(guesses)


def _of_peak(trace: Trace, known: Known) -> Iterator[Finding]:
    """Judge the largest output against the first one that is not zero."""
    sizes = _size(trace.error)
    seen = np.flatnonzero(sizes > 0)
    if len(seen) == 0 or sizes.max() <= _PEAK * sizes[seen[0]]:
        return
    says = f"the largest is {sizes.max() / sizes[seen[0]]:.3g} times the first, {sizes[seen[0]]:.3g}"
    if known.remedy:
        what = known.remedy
    elif trace.scheme.units is None:
        what = (
            f"the weights are in the units of the signals and suit outputs of size one: {_CHOSEN}, or scale the outputs"
        )
    else:
        what = f"the plant grew while it was learned: {known.less_peak}"
    yield Finding("Peak of the outputs", "suspect", f"{says}; {what}")


def _limited(trace: Trace) -> np.ndarray:
    """Mark steps whose input was at a bound that plans keep, or was changed by the actuator, shape (steps,)."""
    bounds, found = trace.scheme.controller.bounds, np.any(trace.v != trace.v_computed, axis=1)
    if bounds is not None:
        width = np.asarray(bounds.high) - bounds.low
        near = (trace.v <= bounds.low + 1e-6 * width) | (trace.v >= bounds.high - 1e-6 * width)
        found = found | np.any(near, axis=1)
    return np.asarray(found)


def _of_bounds(trace: Trace) -> Iterator[Finding]:
    """Say how often the input was at a bound."""
    bounds, limited = trace.scheme.controller.bounds, _limited(trace)
    if bounds is None and not np.any(limited):
        return
    how = "at a bound of the actuator" if bounds is not None else "changed by the actuator"
    share = f"{np.sum(limited)} of {len(trace)} steps"
    last = f", last at k = {trace.k[limited][-1]}" if np.any(limited) else ""
    yield Finding("Input bounds", "outside", f"the input was {how} in {share}{last}")


def of_models(trace: Trace, known: Known) -> Iterator[Finding]:
    """Judge the run's models, plans and estimates."""
    scheme = trace.scheme
    for name, margins in (("lifted", trace.margin_lifted), ("augmented", trace.margin_augmented)):
        lost = trace.k[~(margins >= LOST)]
        least = float(np.nanmin(margins)) if np.any(np.isfinite(margins)) else 0.0
        says = f"smallest margin {least:.3g}"
        if len(lost):
            says += f", below {LOST:g} at {len(lost)} of {len(trace)} steps, first at k = {lost[0]}"
        lacking: Verdict = "suspect" if scheme.units is None else "outside"
        yield Finding(f"Theorem 2(iii), {name} pair stays controllable", lacking if len(lost) else "met", says)
    yield _of_s_plus(trace)
    misfit = _misfit(trace)
    if misfit is not None:
        yield Finding(
            "Assumption 7, a linear model of the run's signals exists",
            "met" if misfit <= FITS else "suspect",
            f"the best one leaves a share of {misfit:.2g} of them unexplained"
            + ("" if misfit <= FITS else f"; {_unexplained(known)}"),
        )
    gains = np.array([_gain(done) for done in trace.steps])
    at = int(np.argmax(gains))
    yield Finding(
        "Assumption 5(b), bounded gains of V1",
        "met" if gains[at] <= _GAIN else "suspect",
        f"the inputs and states planned at k = {at} are up to {gains[at]:.3g} times the state there",
    )
    with np.errstate(over="ignore", invalid="ignore"):
        moved = np.linalg.norm(np.diff(trace.theta, axis=0), axis=-1)
    if len(moved):
        end = max(1, len(moved) // _END)
        yield Finding(
            "The estimates settle in this run (Theorem 2(i))",
            "met" if np.isfinite(moved).all() and moved[-end:].max() <= _GONE * max(moved.max(), 1e-300) else "suspect",
            f"largest move of theta {moved.max():.3g}, in the last {end} steps {moved[-end:].max():.3g}",
        )
    yield Finding(
        "Certificates", "note", f"every estimate within {float(np.max(trace.newton_decrement)):.1g} of its minimiser"
    )
    if scheme.controller.adaptive:
        yield Finding("Adaptive weight", "note", f"epsilon decreased {int(trace.steps[-1].stage)} times")


def _unexplained(known: Known) -> str:
    """Return why a run's signals have no linear model."""
    acting = " and ".join(known.disturbed)
    if known.short:
        return f"{acting} and too few stacked values explain it" if acting else known.short
    if acting:
        return f"{acting} of this run explain {'it' if known.linear else 'all or a part of it'}"
    if known.told and not known.linear:
        return "the plant is nonlinear: stack more, or append basis functions"
    return "stack more, append basis functions, or look for noise and loads"


def _of_s_plus(trace: Trace) -> Finding:
    """Report inf s+, which must be positive in Theorem 1* of the book, over the run and at its end."""
    subject, found, end = "Theorem 1*, inf s+ > 0", trace.s_plus, max(1, len(trace) // _END)
    lacking: Verdict = "suspect" if trace.scheme.units is None else "outside"
    if np.any(np.isnan(found)):
        at = int(trace.k[np.isnan(found)][0])
        return Finding(subject, lacking, f"the planned maps left the range of floating-point numbers at k = {at}")
    least = float(np.min(found))
    if np.isinf(least):
        return Finding(subject, "met", "no input has an effect in any model of the run, so none was planned")
    says = f"the smallest nonzero singular value of the planned maps is {least:.3g} over the run"
    late = float(np.min(found[-end:]))
    if np.isfinite(late):
        says += f", {late:.3g} in the last {end} steps"
    return Finding(subject, "met" if least >= LOST else lacking, says)


def _gain(done: Step) -> float:
    """Return the largest planned number relative to the state; infinite where the plan leaves float64."""
    try:
        plan = done.plan
    except (InputError, ArithmeticError):
        return np.inf
    size = float(np.max(np.abs(plan.x[0])))
    return max(float(np.max(np.abs(plan.u))), float(np.max(np.abs(plan.x)))) / size if size > 0 else 0.0


def _misfit(trace: Trace) -> float | None:
    """Return the share of x(k+1) that no linear function of x(k), u(k) explains; None if the run is too short."""
    begin, (x, u) = trace.scheme.first_measured, trace.lifted
    if len(trace) <= begin + 1 or not np.all(np.isfinite(trace.y[-1])):
        return None
    known, next_ = np.concatenate([x[begin:-1], u[begin + 1 :]], axis=1), x[begin + 1 :]
    if len(known) < 2 * known.shape[1]:
        return None
    # Scale each transition by its own size, or the beginning of a run hides its end; drop those that are nearly zero.
    size = np.max(np.abs(known), axis=1, keepdims=True)
    heavy = size[:, 0] > 1e-9 * size.max()
    if np.sum(heavy) < 2 * known.shape[1]:
        return None
    known, next_ = (rows[heavy] / size[heavy] for rows in (known, next_))
    residual = next_ - known @ np.linalg.lstsq(known, next_)[0]
    return float(np.linalg.norm(residual) / max(float(np.linalg.norm(next_)), 1e-300))
