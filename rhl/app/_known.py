"""What a known plant and known disturbances say about a run: the cause of a failure that no run can show, and its cure.

With a set point the scheme controls the plant by increments of the input, so the plant that it sees has the last input
as a further state (``rhl.tracking``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rhl._checks import Array
from rhl.disturbances import Disturbance, Disturbances, Offset, Saturation
from rhl.errors import InputError
from rhl.plants import LinearPlant, Plant
from rhl.plants.analysis import Modes, detectability, linearise, observability_index, stabilizability
from rhl.scheme import Scheme

# A model that misses more than this share of a run's signals does not reproduce them.
FITS = 1e-6
# Remedies that helped on plants not used to choose the rule; the book's page on symptoms has the shares.
_ROUGH = "begin from a [rough] model that is right to a tenth"
LESS_PEAK = f"lower order if it is above the observability index, or {_ROUGH}"


@dataclass(frozen=True)
class Known:
    """What is known about a run besides its signals; by default nothing.

    Attributes
    ----------
    remedy : str
        The cause of a failure that follows from the plant's modes or from ``short``, with what to change; empty if
        there is none.
    short : str
        What to raise where fewer values are stacked than the observability index; empty if there are enough.
    unheld : str
        Why no input holds the set point, with what to change; empty if one does.
    less_peak : str
        What lowers the peak of a plant that grows while it is learned.
    told : bool
        Whether plant and disturbances are known.
    linear : bool
        Whether the plant is known to be linear.
    disturbed : tuple of str
        What acts on the run and leaves its signals without a linear model.
    asks : tuple of str
        Keys of the file that the scheme lacks, given what acts on the run.
    """

    remedy: str = ""
    short: str = ""
    unheld: str = ""
    less_peak: str = LESS_PEAK
    told: bool = False
    linear: bool = False
    disturbed: tuple[str, ...] = ()
    asks: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Holding:
    """The constant inputs that hold a set point, and the bound that one of them exceeds, if one does."""

    inputs: Array
    exceeds: str = ""


def known(
    plant: Plant,
    scheme: Scheme,
    steps: int,
    sensor: Disturbances | None = None,
    actuator: Disturbances | None = None,
    load: Disturbances | None = None,
    *,
    applied_known: bool = True,
) -> Known:
    """Return what plant and disturbances say about a run of so many steps."""
    tracks, given = scheme.set_point is not None, isinstance(plant, LinearPlant)
    acting = [("the sensor errors", sensor), ("the load", load)]
    if not applied_known:
        acting.append(("the actuator, whose inputs the scheme does not know", actuator))
    asks = []
    if scheme.units is not None and not np.any(scheme.units.noise) and not _constant(sensor):
        asks.append("set noise to the standard deviation of the sensor errors")
    if not tracks and any(isinstance(part, Offset) for part in in_series(sensor) + in_series(load)):
        asks.append("give set_point, with which constant disturbances leave no error")
    # Increments and distances from a set point do not see a constant.
    disturbed = tuple(name for name, part in acting if in_series(part) and not (tracks and _constant(part)))
    found = Known(told=True, linear=given, disturbed=disturbed, asks=tuple(asks))
    try:
        linear = linearise(plant)
    except InputError:
        return found
    short = f"too few values are stacked: {lengthen(linear, scheme)}" if too_short(linear, scheme) else ""
    return replace(
        found,
        remedy=_of_modes(linear, given) or short,
        short=short,
        unheld=_unheld_at(linear, scheme, steps - 1, actuator, load) if given else "",
        less_peak=less_peak(linear, scheme) if given else LESS_PEAK,
    )


def _of_modes(linear: LinearPlant, given: bool) -> str:
    for modes, what, others in (
        (stabilizability(linear.F, linear.G), "the input does not reach", "actuators"),
        (detectability(linear.F, linear.H), "the outputs do not see", "sensors"),
    ):
        if not modes.holds:
            where = f"{what} the mode {mode_of(modes)}, which does not decay"
            if given:
                return f"{where}, so no setting can help: only other {others} can"
            return (
                f"in the linearisation at zero {where}, so near zero only the nonlinearity or other {others} can help"
            )
    return ""


def _unheld_at(
    plant: LinearPlant, scheme: Scheme, k: int, actuator: Disturbances | None, load: Disturbances | None
) -> str:
    if scheme.set_point is None:
        return ""
    held = holding(plant, scheme.set_point.at(k, plant.p), bounds_of(scheme, actuator), load)
    return unheld(held) if held is None or held.exceeds else ""


def mode_of(modes: Modes) -> str:
    """Return the mode with the smallest margin, in words."""
    assert modes.worst is not None
    value = modes.worst[0]
    return f"{value.real:.4g}" if abs(value.imag) < 1e-12 else f"{value.real:.4g}{value.imag:+.4g}j"


def stacked(scheme: Scheme) -> int:
    """Return m, the smaller of N_y and N_v."""
    return min(scheme.lifting.outputs, scheme.lifting.inputs)


def seen_by(plant: LinearPlant, scheme: Scheme) -> LinearPlant:
    """Return the plant that the scheme sees: with a set point, the last input is a further state."""
    if scheme.set_point is None:
        return plant
    n, p, q = plant.n, plant.p, plant.q
    return LinearPlant(
        np.block([[plant.F, plant.G], [np.zeros((q, n)), np.eye(q)]]),
        np.concatenate([plant.G, np.eye(q)]),
        np.concatenate([plant.H, np.zeros((p, q))], axis=1),
    )


def index_needed(plant: LinearPlant, scheme: Scheme) -> int:
    """Return how many values have to be stacked: the observability index of the plant that the scheme sees."""
    # Increments reach an input through z/(z - 1), which cancels a delay of the plant, so that one value less is needed.
    delayed = np.linalg.matrix_rank(plant.F) < plant.n
    of = plant if delayed else seen_by(plant, scheme)
    return observability_index(of.F, of.H)


def too_short(plant: LinearPlant, scheme: Scheme) -> bool:
    """Whether fewer values are stacked than the observability index."""
    return stacked(scheme) < index_needed(plant, scheme)


def _order_needed(plant: LinearPlant, scheme: Scheme) -> int:
    # With a set point, order already stacks one value more.
    return max(1, index_needed(plant, scheme) - (scheme.set_point is not None))


def lengthen(plant: LinearPlant, scheme: Scheme) -> str:
    """Say which keys to raise where too few outputs or inputs are stacked."""
    index, order = index_needed(plant, scheme), _order_needed(plant, scheme)
    if scheme.units is None:
        return f"raise outputs and inputs of [lifting] to {index}, the observability index"
    to = f"{order}, the observability index" if order == index else f"{order}, with which {index} values are stacked"
    return f"raise order to {to} (where [lifting] gives outputs and inputs, raise these to {index})"


def less_peak(plant: LinearPlant, scheme: Scheme) -> str:
    """Say what lowers the peak; a lower order only where it is above the observability index."""
    if stacked(scheme) <= _order_needed(plant, scheme) + (scheme.set_point is not None):
        return _ROUGH
    return f"lower order to {_order_needed(plant, scheme)}, which the observability index allows, or {_ROUGH}"


def bounds_of(scheme: Scheme, actuator: Disturbances | None) -> Saturation | None:
    """Return the bounds that plans keep, or else those of the actuator."""
    if scheme.controller.bounds is not None:
        return scheme.controller.bounds
    return next((part for part in in_series(actuator) if isinstance(part, Saturation)), None)


def holding(
    plant: LinearPlant, r: Array, bounds: Saturation | None = None, load: Disturbances | None = None
) -> Holding | None:
    """Return constant inputs that hold the outputs at r under constant loads, within the bounds if any can.

    None if no constant input holds them.
    """
    n, q = plant.n, plant.q
    held = np.block([[np.eye(n) - plant.F, -plant.G], [plant.H, np.zeros((plant.p, q))]])
    wanted = np.concatenate([np.zeros(n), r])
    sizes = np.max(np.abs(held), axis=1, keepdims=True)
    held, wanted = held / np.where(sizes > 0, sizes, 1.0), wanted / np.where(sizes > 0, sizes, 1.0)[:, 0]
    found = np.linalg.lstsq(held, wanted)[0]
    if np.max(np.abs(held @ found - wanted)) > FITS * np.max(np.abs(wanted)):
        return None
    # The load is added to what the actuator applies.
    v = np.asarray(found[n:] - constant_load(load, q), dtype=np.float64)
    if bounds is None:
        return Holding(v)
    bounds(0, v)  # their number must be that of the inputs
    low, high = np.broadcast_to(bounds.low, q), np.broadcast_to(bounds.high, q)
    if not _exceeds(v, low, high):
        return Holding(v)
    v = _nearest(v, held, n, low, high)
    return Holding(v, _exceeds(v, low, high))


def constant_load(load: Disturbances | None, q: int) -> Array:
    """Return what constants add to the inputs, shape (q,); other loads are not counted."""
    constants = [Offset(part.value)(0, np.zeros(q)) for part in in_series(load) if isinstance(part, Offset)]
    return np.sum([np.zeros(q), *constants], axis=0)


def _nearest(v: Array, held: Array, n: int, low: Array, high: Array) -> Array:
    """Return the inputs that exceed their bounds least, among those that hold the same outputs."""
    from scipy.linalg import null_space
    from scipy.optimize import linprog

    free, sizes = null_space(held)[n:], np.maximum(np.abs(low), np.abs(high))
    if free.shape[1] == 0:
        return v
    # Minimise t with (v + free a - high) / sizes <= t and (low - v - free a) / sizes <= t.
    rows = np.concatenate([free, -free]) / np.tile(sizes, 2)[:, None]
    limits = np.concatenate([high - v, v - low]) / np.tile(sizes, 2)
    cost = np.append(np.zeros(free.shape[1]), 1.0)
    limited = np.concatenate([rows, -np.ones((len(rows), 1))], axis=1)
    done = linprog(cost, limited, limits, bounds=[*[(None, None)] * free.shape[1], (0, None)])
    return v + free @ done.x[:-1] if done.success else v


def _exceeds(v: Array, low: Array, high: Array) -> str:
    """Name the input that exceeds its bound most; empty if none does, up to rounding."""
    over = np.maximum(v - high, low - v) / np.maximum(np.abs(low), np.abs(high))
    at = int(np.argmax(over))
    if over[at] <= FITS:
        return ""
    side, bound = ("above v_max", high) if v[at] > high[at] else ("below v_min", low)
    return f"input {at + 1} would have to stay at {v[at]:.4g}, {side} = {bound[at]:.4g}"


def unheld(held: Holding | None) -> str:
    """Say why a set point is not an equilibrium, and what to change."""
    if held is None:
        return (
            "no constant input holds the outputs at it: there are more outputs than inputs that move them at rest; "
            "choose another set point, or leave outputs out"
        )
    return (
        f"no input within the bounds holds the outputs at it: {held.exceeds}; choose a set point within reach, or "
        "widen v_min and v_max"
    )


def in_series(disturbance: Disturbances | None) -> tuple[Disturbance, ...]:
    """Return the disturbances that act in series."""
    if disturbance is None:
        return ()
    return disturbance if isinstance(disturbance, tuple) else (disturbance,)


def _constant(disturbance: Disturbances | None) -> bool:
    """Whether nothing but constants acts, from the beginning on."""
    return all(isinstance(part, Offset) and part.start == 0 for part in in_series(disturbance))
