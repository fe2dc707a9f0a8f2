"""Plants with settings, as text fields, for the page on which a reader runs the scheme in the browser."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from rhl._checks import Array
from rhl.paper.published import linear_example
from rhl.plants._realisation import held
from rhl.plants.analysis import observability_index
from rhl.plants.benchmarks import benchmark
from rhl.plants.linear import LinearPlant
from rhl.scheme import Scheme, window_scheme

# Benchmark plants of at most five states with different difficulties; the scheme fails with the last one.
_BENCHMARKS = (
    "double-integrator",
    "dc-motor",
    "cstr",
    "maglev",
    "doyle",
    "buck-converter",
    "rosenbrock",
    "spinning-satellite",
    "vehicle-lateral",
    "ogata-pendulum",
)
_STEPS = 60


@dataclass(frozen=True)
class Preset:
    """A plant that the page offers: its name, its description, and the text of every field."""

    name: str
    title: str
    fields: Mapping[str, str]


def presets() -> tuple[Preset, ...]:
    """Return the plants that the page offers, the linear example first.

    Examples
    --------
    >>> presets()[0].fields["z0"]
    '0.1 0.1 -10'
    """
    example = linear_example()
    assert isinstance(example.plant, LinearPlant)
    found = [Preset("linear-example", "the paper's linear example", fields(example.plant, example.scheme, example.z0))]
    for name, title, plant, z0 in (
        (
            "scalar",
            "one state that grows by a fifth each step",
            LinearPlant(np.full((1, 1), 1.2), np.eye(1), np.eye(1)),
            np.ones(1),
        ),
        ("pendulum", "inverted pendulum, a metre long, driven by a torque", *_pendulum()),
    ):
        found.append(Preset(name, title, _fields_to_begin_with(plant, z0)))
    for name in _BENCHMARKS:
        known = benchmark(name)
        found.append(Preset(name, known.title, _fields_to_begin_with(known.sampled(), known.z0)))
    return tuple(found)


def _pendulum() -> tuple[LinearPlant, Array]:
    """Return a massless rod with a ball on top, near the upright, sampled ten times a second; the angle is measured."""
    gravity, length = 9.81, 1.0
    F, G = held(np.array([[0.0, 1.0], [gravity / length, 0.0]]), np.array([[0.0], [1.0]]), 0.1)
    return LinearPlant(F, G, np.eye(1, 2)), np.array([0.1, 0.0])


def _fields_to_begin_with(plant: LinearPlant, z0: Array) -> Mapping[str, str]:
    order = observability_index(plant.F, plant.H)
    return fields(plant, window_scheme(plant.p, plant.q, order), z0)


def fields(plant: LinearPlant, scheme: Scheme, z0: Array) -> Mapping[str, str]:
    """Return the page's fields for a plant and a scheme of the form that the paper simulates."""
    controller, estimator = scheme.controller, scheme.estimator
    generator: Any = estimator.generator
    epsilon: Any = controller.epsilon
    mixing: Any = scheme.mixing
    found = {
        "F": written(plant.F),
        "G": written(plant.G),
        "H": written(plant.H),
        "z0": written(z0[None, :]),
        "m": str(scheme.lifting.outputs),
        "window": str(estimator.window),
        "rho": f"{float(generator.weight):g}",
        "Q": f"{controller.Q:g}",
        "R": f"{controller.R:g}",
        "QN": f"{controller.QN:g}",
        "N": str(controller.horizon),
        "eta": f"{epsilon.rate:g}",
        "lambda": f"{mixing.lam:g}",
        "delay": str(controller.model_delay),
        "steps": str(_STEPS),
        "push_step": "30",
        "push_size": "0",
    }
    return MappingProxyType(found)


def written(matrix: Array) -> str:
    """Return a matrix as a reader would type it, each number with all its digits.

    Examples
    --------
    >>> written(np.array([[1.0, 0.1], [0.0, -2.0]]))
    '1 0.1; 0 -2'
    """
    return "; ".join(" ".join(repr(float(entry)).removesuffix(".0") for entry in row) for row in matrix)
