"""What `from rhl import ...` offers is exactly this."""

import rhl

NAMES = [
    "AssumptionWarning",
    "ConstantMixing",
    "Controller",
    "DelayLifting",
    "DivergedError",
    "FunctionPlant",
    "GaussianNoise",
    "InfeasibleError",
    "InputError",
    "LinearConstraints",
    "LambdaSearch",
    "LinearPlant",
    "LostControllabilityError",
    "ControllerState",
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
    "V1",
    "V2",
    "V3",
    "advance",
    "closed_loop",
    "default_scheme",
    "replay",
    "simulate",
    "solve",
    "start",
    "step",
]


def test_names_are_these():
    assert sorted(rhl.__all__) == sorted(NAMES)
    assert len(set(rhl.__all__)) == len(rhl.__all__)


def test_each_is_there():
    assert [name for name in NAMES if not hasattr(rhl, name)] == []


def test_errors_lie_below_one():
    errors = [vars(rhl)[name] for name in NAMES if name.endswith("Error")]
    assert len(errors) == 6
    assert all(issubclass(error, rhl.RHLError) for error in errors)
