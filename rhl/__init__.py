"""Receding horizon learning: the executable companion of Ebenbauer, Pfitz and Yu, arXiv 2010.05891."""

from rhl.closed_loop import ControllerState, Step, advance, closed_loop, replay, start, step
from rhl.constraints import LinearConstraints
from rhl.controllability import ConstantMixing, LambdaSearch
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
from rhl.horizon import V1, V2, V3, Plan, solve
from rhl.lifting import DelayLifting
from rhl.model import PredictorMaps, SignalModel
from rhl.plants import FunctionPlant, LinearPlant
from rhl.schedules import PowerDecay
from rhl.scheme import Controller, Scheme, default_scheme
from rhl.simulation import simulate
from rhl.trace import Trace

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
    "InfeasibleError",
    "InputError",
    "LambdaSearch",
    "LinearConstraints",
    "LinearPlant",
    "LostControllabilityError",
    "NotSolvedError",
    "Plan",
    "PowerDecay",
    "PredictorMaps",
    "ProximalEstimator",
    "RHLError",
    "Saturation",
    "Scheme",
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
]
__version__ = "0.1.0"
