"""The data of Explore beside the paper's simulations: the pace of the terminal weight, and plants that others chose."""

import json

import numpy as np
import pytest

from rhl.horizon import solve
from rhl.model import SignalModel
from rhl.paper import explored
from rhl.plants.benchmarks import benchmark
from rhl.problems import V1
from rhl.scheme import default_scheme
from rhl.simulation import simulate


@pytest.fixture(scope="module")
def pace():
    return explored.pace()


def planned(growth, horizon, weight):
    """What the first planned input leaves of x = 1."""
    model = SignalModel([[growth]], [[1.0]])
    return float(solve(V1(model, 0.02, 1.0, 1.0, weight, horizon), [1.0]).x[1, 0])


def test_the_level_is_where_the_plan_keeps_the_size():
    for growth in explored.GROWTHS:
        for horizon in explored.HORIZONS:
            level = explored.level(growth, horizon)
            if level is None:
                # However small the terminal weight is, the plan brings the state down.
                assert planned(growth, horizon, 1e-9) < 1
            else:
                assert abs(planned(growth, horizon, level) - 1) < 1e-9
                assert planned(growth, horizon, 1.01 * level) < 1 < planned(growth, horizon, 0.99 * level)


def test_the_state_follows_the_root_of_epsilon(pace):
    held = [
        (i, n) for i, levels in enumerate(pace["level"]) for n, level in enumerate(levels) if level and level > 0.01
    ]
    assert len(held) >= 12
    for i, n in held:
        for j, epsilon in enumerate(pace["epsilon"]):
            assert 0.99 < pace["size"][i][j][n][-1] / np.sqrt(pace["level"][i][n] * epsilon[-1]) < 1.1
    # The control: it does not follow the root of another schedule.
    assert pace["size"][0][0][0][-1] / np.sqrt(pace["level"][0][0] * pace["epsilon"][2][-1]) > 10
    # Where the stage costs hold the plant, the state is far below.
    free = [(i, n) for i, levels in enumerate(pace["level"]) for n, level in enumerate(levels) if level is None]
    assert free
    assert all(pace["size"][i][2][n][-1] < pace["size"][i][2][0][-1] / 10 for i, n in free)


def test_a_plant_s_data_are_runs():
    data = explored.plant("ogata-pendulum")
    chosen = benchmark("ogata-pendulum")
    plant = chosen.sampled()
    y = simulate(default_scheme(plant.p, plant.q, chosen.order()), plant, chosen.z0, 100).y
    sizes = np.abs(y[0])
    assert np.allclose(data["default"][0], np.max(np.abs(y) / sizes, axis=1), rtol=1e-5)
    assert not np.allclose(data["default"][1], data["default"][0], rtol=1e-2)
    assert len(data["known"]) == len(data["window"]) == len(explored.NOISES)
    # None that knows less costs less, in the sum of squares of outputs, than the one that knows all; see rivals.
    assert np.sum(np.square(data["known"][0])) < np.sum(np.square(data["default"][0]))


def test_no_plant_breaks_the_page():
    assert len(explored.plant_names()) == 35
    data = explored.plant("rea")  # no input holds it
    assert all(max(runs[0]) > 10 for runs in (data["default"], data["window"]))
    assert json.loads(json.dumps(data, allow_nan=False)) == data
