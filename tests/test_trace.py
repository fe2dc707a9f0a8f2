"""A run as arrays, table and file."""

import os
from dataclasses import FrozenInstanceError, replace
from functools import cached_property
from itertools import islice

import numpy as np
import pytest

from rhl._checks import locked
from rhl._files import header, write_whole
from rhl.closed_loop import closed_loop, replay
from rhl.controllability import controllability_margin, s_plus
from rhl.disturbances import Saturation
from rhl.errors import InputError
from rhl.horizon import Plan
from rhl.model import SignalModel
from rhl.paper.published import linear_example, robot_arm
from rhl.plants import LinearPlant
from rhl.problems import V1
from rhl.scheme import Scheme, default_scheme, window_scheme
from rhl.simulation import simulate
from rhl.state import ControllerState, Models, Step
from rhl.trace import Trace
from rhl.tracking import SetPoint

STEPS = 8
LINEAR, ROBOT = linear_example(), robot_arm()


@pytest.fixture(scope="module")
def trace():
    return simulate(LINEAR.scheme, LINEAR.plant, LINEAR.z0, STEPS)


@pytest.fixture(scope="module")
def robot():
    return simulate(ROBOT.scheme, ROBOT.plant, ROBOT.z0, STEPS)


def test_it_is_the_closed_loop(trace):
    steps = list(islice(closed_loop(LINEAR.scheme, LINEAR.plant, LINEAR.z0), STEPS))
    assert len(trace) == STEPS
    assert trace.k.tolist() == list(range(STEPS))
    for name, of in (
        ("y", "y"),
        ("v", "v_applied"),
        ("v", "v_computed"),
        ("y_hat", "y_hat"),
        ("z", "z"),
        ("lam", "lam"),
    ):
        assert np.array_equal(getattr(trace, name), np.stack([getattr(done, of) for done in steps]))
    assert np.array_equal(trace.theta, np.stack([done.model.theta for done in steps]))
    assert np.array_equal(trace.weight, np.stack([done.problem.weight for done in steps]))


def test_shapes(trace, robot):
    assert [getattr(trace, name).shape[1:] for name in ("y", "v", "y_hat", "z", "theta")] == [
        (1,),
        (1,),
        (1,),
        (3,),
        (32,),
    ]
    assert [getattr(robot, name).shape[1:] for name in ("y", "v", "y_hat", "z", "theta")] == [
        (3,),
        (1,),
        (3,),
        (3,),
        (48,),
    ]
    assert trace.weight.shape == trace.lam.shape == trace.margin_lifted.shape == (STEPS,)


def test_lambda_and_weight(trace, robot):
    assert not np.any(trace.lam)
    assert np.all(robot.lam == 0.5)
    for k in range(STEPS):
        state = trace.plan(k).x[0]
        assert trace.weight[k] == pytest.approx(state @ state * (1 + 100 * k), rel=1e-14)


def test_margins(trace):
    for k, done in enumerate(trace.steps):
        assert trace.margin_lifted[k] == controllability_margin(done.model)
        assert trace.margin_augmented[k] == controllability_margin(LINEAR.scheme.lifting.augment(done.model))
    assert np.max(np.abs(trace.margin_lifted - trace.margin_augmented)) > 0.1


def test_s_plus_is_that_of_the_maps_that_plans_used(trace, robot):
    for run in (trace, robot):
        assert run.s_plus.shape == (len(run),)
        for k in (0, 2, len(run) - 1):
            problem = run.steps[k].problem
            assert run.s_plus[k] == pytest.approx(
                float(s_plus(problem.model, min(problem.horizon, problem.model.n))), rel=1e-9
            )


def test_plans_on_demand(trace):
    plan = trace.plan(3)
    assert np.array_equal(plan.u[0], trace.v[3])
    assert plan.x.shape == (21, 7)
    assert plan.residual() < 1e-12


@pytest.mark.parametrize(
    ("k", "sentence"),
    [
        (STEPS, f"k must be below the number of steps, {STEPS}, got {STEPS}"),
        (-1, "k must be an integer of at least 0, got -1"),
    ],
)
def test_no_plan_outside(trace, k, sentence):
    with pytest.raises(InputError, match=sentence):
        trace.plan(k)


def test_frozen(trace):
    with pytest.raises(FrozenInstanceError):
        trace.y = None


def test_no_steps_no_trace():
    with pytest.raises(InputError, match="a trace must have at least one step, got none"):
        Trace.of_steps(LINEAR.scheme, ())
    with pytest.raises(InputError, match="a trace must have at least one step, got none"):
        Trace(LINEAR.scheme, np.empty((0, 1)), np.empty((0, 1)))


# Tables and files


def test_columns(trace, robot):
    assert list(trace.columns()) == ["k", "y1", "v1", "yhat1", "z1", "z2", "z3", "weight", "lambda"]
    assert list(robot.columns()) == [
        "k", "y1", "y2", "y3", "v1", "yhat1", "yhat2", "yhat3", "z1", "z2", "z3", "weight", "lambda",
    ]  # fmt: skip
    assert np.array_equal(robot.columns()["yhat2"], robot.y_hat[:, 1])
    assert header(1, 2, 0) == ["k", "y1", "v1", "v2", "yhat1", "weight", "lambda"]


def test_recorded_data_have_no_plant_state(trace):
    recorded = Trace.of_steps(LINEAR.scheme, replay(LINEAR.scheme, trace.y, trace.v))
    assert list(recorded.columns()) == ["k", "y1", "v1", "yhat1", "weight", "lambda"]
    with pytest.raises(InputError, match="a trace of recorded data has no plant state"):
        _ = recorded.z


def test_a_batch_is_no_table():
    batch = simulate(LINEAR.scheme, LINEAR.plant, np.stack([LINEAR.z0, LINEAR.z0]), 2)
    assert batch.y.shape == (2, 2, 1)
    with pytest.raises(InputError, match=r"a table holds one run, got a batch of shape \(2,\); take one member"):
        batch.columns()


@pytest.mark.parametrize("which", ["trace", "robot"])
def test_csv_round_trip_is_exact_to_the_bit(which, request, tmp_path):
    run, path = request.getfixturevalue(which), tmp_path / "run.csv"
    run.to_csv(path)
    first, *rows = path.read_text(encoding="utf-8").splitlines()
    assert first == ",".join(run.columns())
    assert len(rows) == STEPS
    for text, row in zip(rows, zip(*run.columns().values(), strict=True), strict=True):
        k, *entries = text.split(",")
        assert k == str(row[0])
        assert [float(entry).hex() for entry in entries] == [float(entry).hex() for entry in row[1:]]


def test_fewer_digits_would_not_do(trace):
    sixteen = np.array([float(format(value, ".15g")) for value in trace.v[:, 0]])
    assert not np.array_equal(sixteen, trace.v[:, 0])


def test_a_file_is_whole_or_absent(trace, tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError(28, "No space left on device")

    target = tmp_path / "run.csv"
    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(InputError, match=r"run\.csv must be a writable file, got: No space left on device"):
        trace.to_csv(target)
    assert list(tmp_path.iterdir()) == []


def test_an_older_file_outlives_a_failure(trace, tmp_path, monkeypatch):
    target = tmp_path / "run.csv"
    target.write_text("older")

    def refuse(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(KeyboardInterrupt):
        trace.to_csv(target)
    assert target.read_text() == "older"
    assert list(tmp_path.iterdir()) == [target]


def test_a_file_is_replaced(tmp_path):
    target = tmp_path / "file"
    write_whole(target, "first\n")
    write_whole(target, b"second\r\n")
    assert target.read_bytes() == b"second\r\n"
    assert target.stat().st_mode & 0o777 == 0o644


def test_no_such_folder(tmp_path):
    with pytest.raises(InputError, match="must be a writable file, got: No such file or directory"):
        write_whole(tmp_path / "nowhere" / "file", "text")


def test_columns_keep_the_order_of_two_outputs():
    """The robot arm has three outputs; a column must be that output's, not another's."""
    run = robot_arm().run()
    columns = run.columns()
    for i in range(3):
        assert np.array_equal(columns[f"y{i + 1}"], run.y[:, i])
        assert np.array_equal(columns[f"yhat{i + 1}"], run.y_hat[:, i])
        assert np.array_equal(columns[f"z{i + 1}"], run.z[:, i])
    assert not np.array_equal(columns["yhat1"], columns["yhat3"])


def test_s_plus_of_a_batch_is_that_of_its_members():
    """With a model of the step before, which at k = 0 is one for all members."""
    example = linear_example()
    z0 = np.stack([example.z0, 2 * example.z0])
    together = simulate(example.scheme, example.plant, z0, 12).s_plus
    for i in range(2):
        assert np.allclose(together[:, i], simulate(example.scheme, example.plant, z0[i], 12).s_plus, rtol=1e-6)


def test_s_plus_is_not_lost_in_the_growth_of_a_model():
    """Where a mode doubles at every step, thirty steps hide a reach of 2^-20, and the first two show it."""
    model = SignalModel(np.diag([2.0, 0.5]), np.array([[1.0], [2.0**-20]]))
    assert float(s_plus(model, 2)) == pytest.approx(1.5 * 2.0**-20 / np.sqrt(5), rel=1e-5)
    scheme = replace(window_scheme(2, 1, 1), initial_model=model)
    first = simulate(scheme, LinearPlant(model.A, model.B, np.eye(2)), [0.0, 0.0], 1)
    assert first.s_plus[0] == pytest.approx(float(s_plus(model, 2)), rel=1e-12)


def test_steps_have_the_state_that_they_began_with():
    """Of an adaptive weight too, which compares V1 with its value one step before."""
    made = replace(LINEAR.scheme, controller=replace(LINEAR.scheme.controller, adaptive=True))
    run = simulate(made, LINEAR.plant, LINEAR.z0, STEPS)
    for kept, done in zip(run.steps, closed_loop(made, LINEAR.plant, LINEAR.z0), strict=False):
        assert kept.state.stage == done.state.stage
        assert (kept.state.value is None) == (done.state.value is None)
        assert kept.state.value is None or kept.state.value == pytest.approx(done.state.value, rel=1e-9)


def kept_arrays(record, path):
    """The arrays that a record keeps, by name, and those of the records in it: its fields and what it has computed."""
    names = {name for name, made in vars(type(record)).items() if isinstance(made, cached_property)} | {*vars(record)}
    for name in sorted(name for name in names if not name.startswith("_")):
        values = getattr(record, name)
        for value in values[:3] if isinstance(values, tuple) else (values,):
            if isinstance(value, np.ndarray):
                yield f"{path}.{name}", value
            elif isinstance(value, Trace | Models | Step | ControllerState | Plan | V1 | SignalModel | Scheme):
                yield from kept_arrays(value, f"{path}.{name}")


@pytest.mark.parametrize("record", ["signals", "models"])
@pytest.mark.parametrize(
    "scheme",
    [
        default_scheme(1, 1, 2),
        default_scheme(1, 1, 2, set_point=SetPoint(1.0), bounds=Saturation(-1.0, 1.0)),
        window_scheme(1, 1, 2),
        replace(window_scheme(1, 1, 2), controller=replace(window_scheme(1, 1, 2).controller, adaptive=True)),
    ],
)
def test_what_is_kept_is_read_only(scheme, record):
    """An edit of a returned array would change the table, or every later run of the scheme."""
    plant = LinearPlant([[1.1, 1.0], [0.0, 0.9]], [[0.0], [1.0]], [[1.0, 0.0]])
    found = dict(kept_arrays(simulate(scheme, plant, [1.0, -1.0], 4, record=record), "trace"))
    assert found.keys() >= {
        *(f"trace.{name}" for name in ("weight", "y_hat", "newton_decrement", "margin_lifted", "s_plus", "lifted")),
        *("trace.scheme.factors", "trace.steps.y_hat", "trace.steps.plan.u", "trace.steps.state.y"),
    }
    assert [name for name, array in found.items() if array.flags.writeable] == []
    # The control: a writable array is found.
    assert (
        dict(kept_arrays(Models(*np.ones((2, 1, 1, 2)), np.ones(1)), "models"))["models.lam"].flags.writeable is False
    )
    model = SignalModel([[1.0]], [[1.0]])
    object.__setattr__(model, "A", np.ones((1, 1)))
    assert [name for name, array in kept_arrays(model, "model") if array.flags.writeable] == ["model.A"]


def test_an_edit_of_a_result_is_refused_and_changes_no_run():
    scheme = window_scheme(1, 1, 2)
    plant = LinearPlant([[1.1, 1.0], [0.0, 0.9]], [[0.0], [1.0]], [[1.0, 0.0]])
    trace = simulate(scheme, plant, [1.0, -1.0], 8)
    before = trace.columns()["weight"].copy()
    for array in (trace.weight, trace.models.model, trace.steps[3].y_hat, scheme.factors[0]):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 9
    assert np.array_equal(trace.columns()["weight"], before)
    assert np.array_equal(simulate(scheme, plant, [1.0, -1.0], 8).v, trace.v)


def test_locked_does_not_copy():
    array = np.zeros(3)
    view = locked(array)
    array[0] = 1.0
    assert np.shares_memory(view, array)
    assert (view[0], view.flags.writeable, array.flags.writeable) == (1.0, False, True)
