"""Limits of size: a file from a stranger is refused in one sentence before it can exhaust the memory."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil

from rhl._lanes import LANES
from rhl.controllability import LambdaSearch
from rhl.errors import InputError
from rhl.scheme import Scheme
from rhl.study.choices import Choice
from rhl.study.ensembles import Ensemble

# The most numbers of one kind in a run or a task, 2 GB; the most entries of x(k) and of u(k), whose controllability
# matrix then takes seconds; the most results of a campaign, about 1 GB, which are loaded at once; files in a folder.
NUMBERS, ENTRIES, RESULTS, TASKS, SCHEMES = 250_000_000, 1_000, 20_000_000, 100_000, 1_000
# A number of the table, with its text of up to 24 letters that is there three times, takes as much memory as ten.
_TEXT = 10


def stacked(keys: str, p: int, q: int, outputs: int, inputs: int) -> None:
    """Refuse x(k) or u(k) with too many entries; ``keys`` set how many outputs and inputs are stacked."""
    for name, size, count in (("outputs", p, outputs), ("inputs", q, inputs)):
        if size * count > ENTRIES:
            raise InputError(
                f"{keys} must stack at most {ENTRIES} numbers, got {count} {name} of size {size}; stack fewer"
            )


def fits(scheme: Scheme, steps: int, states: int) -> None:
    """Refuse a run that needs too much memory, for a plant of that many states.

    The sentence begins with the key to change.
    """
    model, controller, window = scheme.initial_model, scheme.controller, getattr(scheme.estimator, "window", 0)
    n, d, q, horizon = model.n, model.n + model.q, scheme.q, controller.horizon
    a = d - q  # the order of the augmented model
    parts = [
        ("steps", steps, "the estimates of all steps", 2 * steps * n * d),
        (
            "steps",
            steps,
            "the entries of the table, each with its text as ten numbers,",
            _TEXT * steps * (2 * scheme.p + q + states + 3),
        ),
        ("estimator.window", window, "the transitions of the window", 2 * window * d),
        ("controller.horizon", horizon, "the gains of a plan", horizon * q * (a + q)),
    ]
    if controller.bounds is not None:
        parts.append(("controller.horizon", horizon, "the bounded programme of a plan", 2 * (horizon * q) ** 2))
    if isinstance(scheme.mixing, LambdaSearch):
        tried = 2 * n**2 + 1 if scheme.mixing.count == "lemma" else n * (n + 1) // 2
        parts.append(("estimator.mixing", "search", "the candidates of the search", tried * a * (a * q + a)))
    for key, given, what, count in parts:
        if count > NUMBERS:
            raise InputError(
                f"{key} must be such that {what} are at most {NUMBERS} numbers, got {given} and {count} numbers; "
                "make it smaller, or stack less"
            )


def schemes(counts: list[int]) -> None:
    """Refuse too many schemes of a campaign: ``counts`` are those of each section's combinations."""
    if sum(counts) > SCHEMES:
        raise InputError(f"schemes must be at most {SCHEMES}, got {sum(counts)} combinations; shorten their lists")


def campaign(plants: Ensemble, choices: Sequence[Choice], steps: int, chunk: int) -> None:
    """Refuse a campaign with too many results or tasks, or with schemes or tasks that need too much memory."""
    chunk, columns = min(chunk, len(plants)), 1 + len(choices)
    for what, found, most, remedy in (
        ("results", len(plants) * columns, RESULTS, "give fewer plants or schemes"),
        ("tasks", -(-len(plants) // chunk) * columns, TASKS, "enlarge chunk, or give fewer plants or schemes"),
    ):
        if found > most:
            raise InputError(f"plants.count must be such that there are at most {most} {what}, got {found}; {remedy}")
    try:
        sizes = sorted(plants.sizes())
    except InputError as error:
        raise InputError(f"plants.{error}") from None
    factor = max(one.order_factor for one in choices)
    for p, q, bound in sizes:
        order = ceil(bound * factor)
        if order * max(p, q) > ENTRIES:
            raise InputError(
                f"schemes must stack at most {ENTRIES} numbers, got order {order} for p = {p} and q = {q}; lower "
                "order_factor, n, p or q"
            )
        # The signals of a task, with a state of at most bound p entries, and for each plant the triangle of its data.
        own = chunk * (steps * (2 * p + 2 * q + bound * p) + 2 * (order * (p + q)) ** 2)
        for one in _distinct(choices):
            _fits_task(one.scheme(p, q, bound), own, chunk)


def _distinct(choices: Sequence[Choice]) -> list[Choice]:
    """Return a choice of each kind that differs in the sizes of its scheme."""
    return list({(one.base, one.order_factor, one.memory, one.window, one.horizon): one for one in choices}.values())


def _fits_task(scheme: Scheme, own: int, chunk: int) -> None:
    """Refuse a task that needs too much memory, ``own`` numbers of which are not of windows and plans."""
    model, q, horizon = scheme.initial_model, scheme.q, scheme.controller.horizon
    window, d, lanes = getattr(scheme.estimator, "window", 0), model.n + model.q, min(chunk, LANES)
    parts = [
        (own, "chunk", f"{chunk} plants", "make it smaller, or run fewer steps"),
        # Each plant keeps its window; the rows to be fitted and the gains of plans are those of some plants at a time.
        (
            (chunk + 4 * lanes) * window * d,
            "schemes.window",
            f"{window} transitions for each of {chunk} plants",
            "make it or chunk smaller",
        ),
        (
            2 * lanes * horizon * (q + 1) * (d + q),
            "schemes.horizon",
            f"{horizon} steps for each of {lanes} plants",
            "make it, chunk or the schemes' order smaller",
        ),
    ]
    count = sum(part[0] for part in parts)
    if count > NUMBERS:
        _, key, given, remedy = max(parts)
        raise InputError(
            f"{key} must be such that a task holds at most {NUMBERS} numbers, got {given} and {count} numbers; {remedy}"
        )
