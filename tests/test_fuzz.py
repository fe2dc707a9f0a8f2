"""Fuzzing: objects through the API, configurations through a run, bytes through the command line."""

import contextlib
import copy
import datetime
import decimal
import fractions
import io
import re
import tempfile
import tomllib
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from rhl.app import cli
from rhl.app._templates import template
from rhl.app.config import keys, parse
from rhl.app.diagnosis import Finding, diagnose
from rhl.basis import Features, Polynomials, Terms
from rhl.constraints import LinearConstraints
from rhl.controllability import ConstantMixing, LambdaSearch
from rhl.disturbances import GaussianNoise, Outliers, Saturation
from rhl.errors import AssumptionWarning, DivergedError, InputError, LostControllabilityError, NotSolvedError
from rhl.estimator import ProximalEstimator
from rhl.horizon import solve
from rhl.lifting import DelayLifting
from rhl.losses import CustomLoss, Entropy, LogCosh, PseudoHuber, Varying, WeightedSquares, divergence
from rhl.model import PredictorMaps, SignalModel
from rhl.paper.published import compare_robot, curve, linear_example
from rhl.plants import FunctionPlant, LinearPlant, RobotArm
from rhl.plants.analysis import linearise, rough_model, stabilizability
from rhl.plants.cart_pendulum import CartPendulum
from rhl.plants.examples import example, flexible_shaft
from rhl.problems import V1
from rhl.schedules import Constant, ExponentialDecay, PowerDecay, epsilon_at
from rhl.trace import Trace
from tests.app.test_config import ARM, LINEAR
from tests.bad_input import faults, listing
from tests.sizes import size
from tests.test_bad_input import (
    ESTIMATOR,
    KNOWN,
    LIFTING,
    ONE,
    PLANT,
    PROBLEM,
    SCHEME,
    TRACE,
    controller,
    masked,
    plant,
    run,
    scheme,
)

# Fuzzing: whatever object stands where a number, an array or a part belongs, it is taken or refused in one sentence.


class Mute:
    """Says nothing about itself, and is no array."""

    def __repr__(self):
        raise RuntimeError("no repr")

    def __array__(self, *_, **__):
        raise RuntimeError("no array")

    def __eq__(self, other):
        raise RuntimeError("no comparison")

    __hash__ = None


ODD = [
    *(None, True, 10**30, 10**400, 5e-324, 1e300, np.nan, np.inf, 1j, "", "a\nb", "\x1b[31m", "\ud800", b"x", "y1"),
    *([], [[]], [[1], [1, 2]], {}, {"a": 1}, set(), object(), int, lambda *_: None, lambda *_: 1.0, range(3), Mute()),
    *(np.eye(2), np.eye(2) * np.nan, np.eye(2) * 1e300, np.zeros((0, 2)), np.ones((3, 3, 3)), np.array(["a"])),
    *(np.array([1j]), np.array([np.datetime64("NaT")]), masked(), np.matrix([[1.0]]), np.longdouble("1e4000")),
    *(pd.Series([1.0]), pd.DataFrame([[1.0, 2.0], [3.0, 4.0]]), pd.NA, datetime.date(2020, 1, 1)),
    *(decimal.Decimal("NaN"), fractions.Fraction(1, 2), Ellipsis, NotImplemented, "x" * 9999, iter([1])),
    *(ONE, WeightedSquares(), LogCosh(), PLANT, SCHEME, TRACE, PROBLEM, KNOWN),
]
SCALARS = st.one_of(
    st.none(), st.booleans(), st.integers(-3, 12), st.floats(), st.complex_numbers(), st.text(max_size=5), st.binary()
)
ANYTHING = st.one_of(
    st.sampled_from(ODD),
    SCALARS,
    st.recursive(SCALARS, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=2), inner)),
    st.lists(st.floats(), max_size=4),
    st.lists(st.lists(st.floats(), min_size=2, max_size=2), min_size=2, max_size=2),
)
CALLS = {
    "Polynomials": Polynomials,
    "Terms": Terms,
    "term": lambda v: Terms((v,)),
    "Features": lambda v: Features(v, 1),
    "features' size": lambda v: Features(lambda w: w, v),
    "WeightedSquares": WeightedSquares,
    "LogCosh": LogCosh,
    "PseudoHuber": lambda v: PseudoHuber(1.0, v),
    "Entropy": Entropy,
    "CustomLoss": lambda v: CustomLoss(v, v, v),
    "lower": lambda v: CustomLoss(abs, abs, lower=v),
    "Varying": Varying,
    "divergence": lambda v: divergence(v, [1.0], [1.0]),
    "points": lambda v: divergence(WeightedSquares(), v, [1.0]),
    "LinearConstraints": lambda v: LinearConstraints(v, [1.0]),
    "b": lambda v: LinearConstraints([[1.0]], v),
    "entries": lambda v: LinearConstraints.entries(v, [[1.0]]),
    "&": lambda v: KNOWN & v,
    "nearest": KNOWN.nearest,
    "estimator": ProximalEstimator,
    "loss": lambda v: ProximalEstimator(2, v),
    "knows": lambda v: replace(ESTIMATOR, constraints=v),
    "generator": lambda v: ProximalEstimator(2, generator=v),
    "x": lambda v: ESTIMATOR.minimise(ONE, v, np.ones((2, 1))),
    "ConstantMixing": ConstantMixing,
    "LambdaSearch": LambdaSearch,
    "rule": lambda v: LambdaSearch(rule=v),
    "SignalModel": lambda v: SignalModel(v, [[1.0]]),
    "both": lambda v: SignalModel(v, v),
    "mix": lambda v: ONE.mix(ONE, v),
    "PredictorMaps": lambda v: PredictorMaps(v, [[[1.0]]]),
    "LinearPlant": lambda v: LinearPlant(v, v, v),
    "FunctionPlant": lambda v: FunctionPlant(v, v, 1, 1),
    "returns": lambda v: plant(lambda z, w: v),
    "step": lambda v: PLANT.step(v, v),
    "RobotArm": RobotArm,
    "arm": lambda v: RobotArm().step(v, [1.0]),
    "from_control": LinearPlant.from_control,
    "example": example,
    "CartPendulum": CartPendulum,
    "h": flexible_shaft,
    "linearise": linearise,
    "rough": lambda v: rough_model(v, 1, 1),
    "stabilizable": lambda v: stabilizability(v, [[1.0]]),
    "DelayLifting": lambda v: DelayLifting(v, 1),
    "basis": lambda v: DelayLifting(1, 1, v),
    "augment": LIFTING.augment,
    "window": lambda v: LIFTING.window(np.ones((3, 1)), 1, 1, v),
    "lift": lambda v: LIFTING.lift(v, 1),
    "Saturation": lambda v: Saturation(v, 1.0),
    "GaussianNoise": lambda v: GaussianNoise(v, 0),
    "Outliers": lambda v: Outliers(v, 1.0, 0),
    "rate of PowerDecay": PowerDecay,
    "PowerDecay": lambda v: PowerDecay(1.0, v),
    "ExponentialDecay": ExponentialDecay,
    "Constant": Constant,
    "epsilon": lambda v: epsilon_at(lambda k: v, 1),
    "schedule": lambda v: epsilon_at(v, 1),
    "Q": lambda v: scheme(controller=controller(Q=v)),
    "horizon": lambda v: controller(horizon=v),
    "delay": lambda v: controller(model_delay=v),
    "Scheme": lambda v: scheme(estimator=v),
    "mixing": lambda v: scheme(mixing=v),
    "initial": lambda v: scheme(initial_model=v),
    "V1": lambda v: V1(v, 1.0, 1.0, 1.0, 1.0, 2),
    "R": lambda v: V1(ONE, 1.0, v, 1.0, 1.0, 2),
    "solve": lambda v: solve(v, [1.0]),
    "z0": lambda v: run(z0=v),
    "sensor": lambda v: run(sensor=v),
    "measured": lambda v: run(sensor=lambda k, y: v),
    "Trace": lambda v: Trace(SCHEME, v, v),
    "curve": curve,
    "diagnose": lambda v: diagnose(v, SCHEME),
    "parse": parse,
    "Finding": lambda v: Finding("a", v, "b"),
    "compare": compare_robot,
    "plan": TRACE.plan,
}


def finite(found):
    """Whether no array that an answer holds, nor the answer itself, has a NaN in it."""
    parts = [found, *(vars(found).values() if hasattr(found, "__dict__") else ())]
    return not any(isinstance(part, (float, np.ndarray)) and np.any(np.isnan(part)) for part in parts)


@pytest.mark.parametrize("name", CALLS)
def test_odd_objects_are_taken_or_refused(name):
    for value in ODD:
        taken_or_refused(name, value)


@settings(max_examples=size(300, 1500), suppress_health_check=list(HealthCheck))
@given(st.sampled_from(sorted(CALLS)), ANYTHING)
def test_any_object_is_taken_or_refused(name, value):
    taken_or_refused(name, value)


def taken_or_refused(name, value):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AssumptionWarning)
        refused = diverged = None
        try:
            assert finite(CALLS[name](value)), f"NaN came out of {name}"
        except InputError as error:
            refused = str(error)
        except DivergedError as error:
            diverged = str(error)
        except Exception as error:
            # What a function that the caller gave raises itself is let through, with a note.
            if not any(note.startswith("rhl called ") for note in getattr(error, "__notes__", ())):
                raise
    assert refused is None or faults(refused, "") == []
    assert diverged is None or re.search(r"at k = \d+: ", diverged)


def test_the_fuzzers_own_check_sees_nan():
    assert finite(ONE)
    assert not finite(np.nan)
    assert not finite(replace(linear_example(), z0=np.array([np.nan])))


WORDS = [
    *("run", "check", "new", "schema", "reproduce", "robot", "--list", "--fast", "--force", "--help", "run.toml"),
    *("--output", "--plot", "--json", "--seed", "--cases", "--version", "--printed", "--run", "there.csv", "f.svg"),
    *("nan", "", ".", "/", "no/such", "\x00", "a\nb", "\ud800", "eq-1", "--output=", "x" * 300, "--", "-", "-1"),
]

# Configurations: a valid one with values replaced, deleted and put in, then a few steps of it.

SECTIONS = """
[knowledge]
shift_rows = true
[simulation]
v_min = -5.0
v_max = 5.0
noise = 0.1
outlier_rate = 0.1
"""
BASES = [
    tomllib.loads(text)
    for text in (
        LINEAR,
        ARM,
        LINEAR.replace("mixing = 0.0", 'mixing = "search"').replace("inputs = 4", 'inputs = 4\nterms = ["y1*y1(k-1)"]'),
        LINEAR.replace('"companion-of-ones"', '"shift-of-ones"').replace('"last-row-of-ones"', '"shift-of-ones"')
        + SECTIONS,
        template("new"),
    )
] + [
    tomllib.loads(LINEAR)
    | {"plant": {"kind": "transfer-function", "num": [1.0], "den": [1.0, -1.1, 0.5], "z0": [1.0, 0.0]}},
    tomllib.loads(ARM) | {"plant": {"kind": "ready", "name": "slow-mode"}},
]
# None larger than a run of a few steps can bear; those that no key takes may be as large as they like.
TOML = st.one_of(
    st.sampled_from(
        [
            *(True, False, 0, 1, -1, 2, 3, 5, 101, 2**63, 10**30, 0.0, -0.0, 1.0, 0.5, 5e-324, 1e-300, 1e300, 1.7e308),
            *(float("nan"), float("inf"), "", "?", "search", "none", "rough", "entropy", "exponential", "constant"),
            *("a\nb", "\x1b", "y1", [], [[]], [1.0], [[1.0]], [["?"]], [[1.0], [1.0, 2.0]], {}, {"a": {"b": [1]}}),
            *("power", "pseudo-huber", "log-cosh", "shift-of-ones", "linear", "y1^2", ["y1^2"], ["v1"], ["y1^99"]),
            *([[5e-324]], [[1e300]], [1e300, 1e300, 1e300], [5e-324, 0.0, 0.0], np.eye(4).tolist(), np.eye(7).tolist()),
            *(datetime.date(1979, 5, 27), datetime.time(7, 32), datetime.datetime(1979, 5, 27, tzinfo=datetime.UTC)),
        ]
    ),
    st.integers(-2, 6),
    st.floats(),
    st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=3, max_size=3),
    st.text(max_size=3),
)
PLACES = sorted({tuple(key.split(".")) for key, _ in keys() if key not in ("lifting.degree", "plant.file")})
PLACES += [("lifting",), ("unknown",), ("controller", "a\nb")]
WILD = [("anywhere", None), ("anywhere", None)]


POSITIVE = st.sampled_from([5e-324, 1e-300, 1e-9, 0.1, 3.0, 1e9, 1e300, 1.7e308]) | st.floats(
    min_value=0, exclude_min=True, allow_infinity=False
)
FINITE = st.sampled_from([0.0, 5e-324, 1e150, -1e300, 1.7e308]) | st.floats(-2, 2)
ENTRIES = st.lists(FINITE, min_size=3, max_size=3)
# What a key may hold, so that a part of the files is run. Not losses and generators that scipy has to solve for: at the
# ends of the range each of their steps takes seconds.
NEAR = {
    ("lifting", "outputs"): st.integers(1, 4),
    ("lifting", "inputs"): st.integers(1, 4),
    ("lifting", "degree"): st.integers(1, 3),
    ("lifting", "terms"): st.sampled_from([["y1^2"], ["sin(y1)", "y1*exp(y1)"], ["y1^99"], ["y1*y1(k-1)"]]),
    ("estimator", "window"): st.integers(1, 6),
    ("estimator", "mixing"): st.sampled_from([0.5, "none", "search", 0.0]),
    ("controller", "horizon"): st.integers(1, 8),
    ("controller", "model_delay"): st.integers(0, 1),
    ("controller", "adaptive"): st.booleans(),
    ("controller", "eps"): st.sampled_from(["power", "exponential", "constant", "harmonic"]),
    ("controller", "eps_factor"): st.sampled_from([5e-324, 0.5, 1 - 1e-16]),
    ("plant", "z0"): ENTRIES,
    ("plant", "F"): st.lists(ENTRIES, min_size=3, max_size=3),
    ("plant", "G"): st.lists(FINITE.map(lambda entry: [entry]), min_size=3, max_size=3),
    ("simulation", "noise"): POSITIVE,
    ("simulation", "outlier_rate"): st.sampled_from([0.0, 0.5, 0.999]),
    ("simulation", "applied_known"): st.booleans(),
} | {
    (table, key): POSITIVE
    for table, names in {
        "estimator": ("weight", "least_margin"),
        "controller": ("Q", "R", "QN", "alpha", "eps_rate", "eps_power", "eps_value"),
        "simulation": ("outlier_size", "v_max"),
    }.items()
    for key in names
}


@st.composite
def configurations(draw):
    data = copy.deepcopy(draw(st.sampled_from(BASES)))
    near = draw(st.lists(st.sampled_from(sorted(NEAR)), max_size=4))
    places = [(table, key, NEAR[table, key]) for table, key in near if table != "plant" or key in data["plant"]]
    for *tables, key, values in [*places, *draw(st.sampled_from([[], [], WILD]))]:
        if values is None:
            *tables, key = draw(st.sampled_from(PLACES))
        table = data
        for name in tables:
            found = table.setdefault(name, {})
            table = found if isinstance(found, dict) else data
        if values is None and key in table and draw(st.booleans()):
            del table[key]
        else:
            table[key] = draw(TOML if values is None else values)
    return data


@settings(max_examples=size(30, 120), suppress_health_check=list(HealthCheck))
@given(configurations())
def test_any_configuration_is_refused_or_runs_without_nan(data):
    refused = None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AssumptionWarning)
        try:
            experiment = parse(data).experiment()
            assume(experiment.scheme.lifting.augment(experiment.scheme.initial_model).n <= 60)
            columns = replace(experiment, steps=min(experiment.steps, 3)).run().columns()
            assert all(np.all(np.isfinite(column)) for column in columns.values())
        except InputError as error:
            refused = str(error)
        except (DivergedError, LostControllabilityError, NotSolvedError):
            pass
    assert refused is None or faults(refused, "") == []


@st.composite
def texts(draw):
    """A valid file with pieces cut out, put in, and moved."""
    text = draw(st.sampled_from([LINEAR, ARM])).replace("steps = 42", "steps = 3").replace("steps = 62", "steps = 3")
    for _ in range(draw(st.integers(1, 3))):
        at, length = draw(st.integers(0, len(text))), draw(st.integers(0, 12))
        piece = draw(st.sampled_from(["", "[", "]", '"', "\n", "=", "{", ".", "e", "-", "nan", "\x00", "\u202e", "#"]))
        text = text[:at] + piece + text[at + length :]
    return text.encode()


@settings(max_examples=size(40, 150), suppress_health_check=list(HealthCheck))
@given(texts() | st.binary(max_size=60), st.sampled_from(["run", "check"]))
def test_any_file_is_answered_on_the_command_line(content, command):
    with tempfile.TemporaryDirectory() as folder:
        path, table = Path(folder, "run.toml"), Path(folder, "t.csv")
        path.write_bytes(content)
        out, err = io.StringIO(), io.StringIO()
        more = ["--output", str(table)] if command == "run" else []
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            status = cli.main([command, str(path), *more])
        said = err.getvalue().splitlines()
        assert status in (0, 1, 2, 3)
        assert all(line.startswith("rhl: ") and line.isprintable() for line in said)
        if status == 2:
            assert len(said) == 1
            assert faults(said[0], "") == []
            assert set(listing(folder)) == {"run.toml"}
        if command == "run" and status in (0, 3):
            assert "nan" not in table.read_text(encoding="utf-8")


@settings(max_examples=size(30, 80), suppress_health_check=list(HealthCheck))
@given(st.lists(st.sampled_from(WORDS) | st.text(max_size=3), max_size=5))
def test_any_call_is_answered(arguments):
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        Path("there.csv").write_text("mine", encoding="utf-8")
        Path("run.toml").write_text(LINEAR.replace("steps = 42", "steps = 3"), encoding="utf-8")
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            try:
                status = cli.main(arguments)
            except SystemExit as error:  # argparse, after --help and --version
                status = error.code
        if status == 2:
            assert faults(err.getvalue().rstrip("\n"), "^rhl: ") == []
        assert status in (0, 1, 2, 3)
        assert "--force" in arguments or Path("there.csv").read_text(encoding="utf-8") == "mine"
