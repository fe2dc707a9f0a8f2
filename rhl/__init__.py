"""Receding horizon learning: the executable companion of Ebenbauer, Pfitz and Yu, arXiv 2010.05891."""

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rhl.closed_loop import advance, closed_loop, replay, start, step
    from rhl.constraints import LinearConstraints
    from rhl.controllability import ConstantMixing, LambdaSearch
    from rhl.controller import Controller
    from rhl.disturbances import GaussianNoise, Saturation
    from rhl.errors import (
        AssumptionWarning,
        DivergedError,
        InfeasibleError,
        InputError,
        LostControllabilityError,
        NotSolvedError,
        RHLError,
    )
    from rhl.estimator import ProximalEstimator
    from rhl.horizon import Plan, solve
    from rhl.lifting import DelayLifting
    from rhl.live import LiveController
    from rhl.memory import GrowingMemory
    from rhl.model import PredictorMaps, SignalModel
    from rhl.plants import FunctionPlant, LinearPlant
    from rhl.problems import V1, V2, V3
    from rhl.schedules import PowerDecay
    from rhl.scheme import Scheme, default_scheme, window_scheme
    from rhl.simulation import simulate
    from rhl.state import ControllerState, Step
    from rhl.trace import Trace
    from rhl.tracking import SetPoint
    from rhl.units import RunningUnits

__all__ = [
    "V1",
    "V2",
    "V3",
    "AssumptionWarning",
    "ConstantMixing",
    "Controller",
    "ControllerState",
    "DelayLifting",
    "DivergedError",
    "FunctionPlant",
    "GaussianNoise",
    "GrowingMemory",
    "InfeasibleError",
    "InputError",
    "LambdaSearch",
    "LinearConstraints",
    "LinearPlant",
    "LiveController",
    "LostControllabilityError",
    "NotSolvedError",
    "Plan",
    "PowerDecay",
    "PredictorMaps",
    "ProximalEstimator",
    "RHLError",
    "RunningUnits",
    "Saturation",
    "Scheme",
    "SetPoint",
    "SignalModel",
    "Step",
    "Trace",
    "advance",
    "closed_loop",
    "default_scheme",
    "replay",
    "simulate",
    "solve",
    "start",
    "step",
    "window_scheme",
]
__version__ = "0.1.0"

# The module of each name. Names are loaded on first use, so that `rhl --help` does not wait for numpy.
_HOMES = (
    *("closed_loop", "constraints", "controllability", "controller", "disturbances", "errors", "estimator", "horizon"),
    *("lifting", "live", "memory", "model", "plants", "problems", "schedules", "scheme", "simulation", "state"),
    *("trace", "tracking", "units"),
)


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module 'rhl' has no attribute {name!r}")
    for home in _HOMES:
        found = vars(import_module(f"rhl.{home}"))
        globals().update({offered: found[offered] for offered in __all__ if offered in found})
    return globals()[name]


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


class _Package(ModuleType):
    def __setattr__(self, name: str, value: object) -> None:
        # Importing the module closed_loop binds its name here, where the function of the same name belongs.
        is_module = name == "closed_loop" and isinstance(value, ModuleType)
        super().__setattr__(name, vars(value)[name] if is_module else value)


sys.modules[__name__].__class__ = _Package
