"""A run's TOML file for a plant that others published."""

from __future__ import annotations

from difflib import get_close_matches

from rhl._checks import describe
from rhl.app._keys import toml
from rhl.errors import InputError
from rhl.plants import LinearPlant
from rhl.plants.analysis import linearise, observability_index
from rhl.plants.benchmarks import benchmark, names
from rhl.plants.examples import EXAMPLES, example


def published(name: str, source: str) -> str:
    """Return a TOML file for a run of that name on a published plant: a benchmark or an example.

    The scheme is chosen from the plant's observability index. InputError, with the nearest names, where there is no
    plant of the name ``source``.
    """
    if source in EXAMPLES:
        found = example(source)
        plant = found.plant if isinstance(found.plant, LinearPlant) else linearise(found.plant)
        section: dict[str, object] = {"kind": "ready", "name": source}
        order, what = observability_index(plant.F, plant.H), found.what
    elif source in names():
        benched = benchmark(source)
        plant, order = benched.sampled(), benched.order()
        what = (
            benched.title if benched.discrete else f"{benched.title}, sampled every {benched.h:g} {benched.time_unit}"
        )
        matrices = {symbol: getattr(plant, symbol).tolist() for symbol in "FGH"}
        section = {"kind": "linear", **matrices, "z0": benched.z0.tolist()}
    else:
        known = (*EXAMPLES, *names())
        near = get_close_matches(source, known, n=3) or known
        raise InputError(
            f"--from must name a plant that comes with rhl, one of {', '.join(near)}, got {describe(source)}"
        )
    head = {"name": name, "steps": 400, "order": order}
    return "\n".join(
        [
            f"# {what}: rhl check FILE, then rhl run FILE --output trace.csv --plot trace.svg",
            *(f"{name} = {toml(value)}" for name, value in head.items()),
            "",
            "[plant]",
            *(f"{name} = {toml(value)}" for name, value in section.items()),
            "",
        ]
    )
