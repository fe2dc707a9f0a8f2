"""Files to begin with: a commented one, and those of published plants."""

from __future__ import annotations

import json
import textwrap
from difflib import get_close_matches

from rhl._checks import describe
from rhl.app._keys import fitted
from rhl.app._plants import PLANTS
from rhl.app.config import Config
from rhl.errors import InputError
from rhl.plants import LinearPlant
from rhl.plants.analysis import linearise, observability_index
from rhl.plants.benchmarks import benchmark, names
from rhl.plants.examples import EXAMPLES, example

_EXAMPLE: dict[str, dict[str, object]] = {
    "plant": {
        "kind": "linear",
        "F": [[1.1, 1.0], [0.0, 0.9]],
        "G": [[0.0], [1.0]],
        "H": [[1.0, 0.0]],
        "z0": [1.0, -1.0],
    },
}


def template(name: str) -> str:
    """Return a TOML file for a run of that name that is ready to run, with a comment for each key.

    Optional keys are commented out, so its scheme is the default one.
    """
    try:
        fitted(Config.keys()["name"], name)
    except ValueError:
        raise InputError(f"name must be {Config.keys()['name']['description']}, got {describe(name)}") from None
    lines = ["# A run of the scheme: rhl check FILE, then rhl run FILE --output trace.csv --plot trace.svg", ""]
    example: dict[str, object] = {"name": name, "steps": 60, "order": 2}
    for table, about in Config.keys().items():
        if "sections" not in about:
            lines += _entry(table, about["description"], example.get(table), about.get("default"))
            continue
        section, given = about["sections"][0], _EXAMPLE.get(table, {})
        lines += ["", f"# {' '.join(section.__doc__.split())}", f"[{table}]" if given else f"# [{table}]"]
        for name, one in section.keys().items():
            what = " or ".join(kind.tag() for kind in PLANTS) if name == "kind" else one["description"]
            lines += _entry(name, what, given.get(name), one.get("default"))
    return "\n".join(lines) + "\n"


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
            *(f"{name} = {_toml(value)}" for name, value in head.items()),
            "",
            "[plant]",
            *(f"{name} = {_toml(value)}" for name, value in section.items()),
            "",
        ]
    )


def _entry(name: str, what: str, value: object, default: object = None) -> list[str]:
    comment = textwrap.wrap(f"{name}: {what}", 100, initial_indent="# ", subsequent_indent="#   ")
    if value is not None:
        return [*comment, f"{name} = {_toml(value)}"]
    return [*comment, f"# {name} = {'...' if default is None else _toml(default)}"]


def _toml(value: object) -> str:
    return json.dumps(value, ensure_ascii=False)
