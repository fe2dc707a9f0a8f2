"""What `from rhl import ...` offers is exactly this."""

import subprocess
import sys

import pytest

import rhl

NAMES = [
    "AssumptionWarning",
    "ConstantMixing",
    "Controller",
    "DelayLifting",
    "DivergedError",
    "FunctionPlant",
    "GaussianNoise",
    "GrowingMemory",
    "InfeasibleError",
    "InputError",
    "LinearConstraints",
    "LambdaSearch",
    "LinearPlant",
    "LiveController",
    "LostControllabilityError",
    "ControllerState",
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
    "V1",
    "V2",
    "V3",
    "advance",
    "closed_loop",
    "window_scheme",
    "replay",
    "simulate",
    "solve",
    "start",
    "step",
    "default_scheme",
]


def test_names_are_these():
    assert sorted(rhl.__all__) == sorted(NAMES)
    assert len(set(rhl.__all__)) == len(rhl.__all__)


def test_each_is_there():
    assert [name for name in NAMES if not hasattr(rhl, name)] == []


def test_errors_lie_below_one():
    errors = [getattr(rhl, name) for name in NAMES if name.endswith("Error")]
    assert len(errors) == 6
    assert all(issubclass(error, rhl.RHLError) for error in errors)


@pytest.mark.parametrize(
    "before",
    [
        "",
        "import rhl.closed_loop",
        "import rhl.simulation",
        "import rhl; rhl.Trace",
        "from rhl import *",
        "import rhl.app.cli",
    ],
)
def test_a_function_is_not_hidden_by_its_module(before):
    """Names are loaded when the first is asked for, in whatever order modules are."""
    code = f"{before}\nfrom rhl import closed_loop\nimport rhl, sys\n" + (
        "assert closed_loop is rhl.closed_loop is sys.modules['rhl.closed_loop'].closed_loop, closed_loop\n"
        "assert set(rhl.__all__) <= set(dir(rhl))\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_other_names_are_refused():
    with pytest.raises(AttributeError, match="module 'rhl' has no attribute 'simulat'"):
        _ = rhl.simulat
