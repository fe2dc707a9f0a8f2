"""Plants: linear ones, also from python-control, and the robot arm in both variants."""

import control
import numpy as np
import pytest

from rhl._checks import InputError
from rhl.plants import LinearPlant, RobotArm

SEED = 2010_05891
# A handful of products of order one.
ROUNDING = 1e-13


@pytest.fixture
def plant():
    rng = np.random.default_rng(SEED)
    return LinearPlant(rng.standard_normal((3, 3)), rng.standard_normal((3, 2)), rng.standard_normal((1, 3)))


def test_linear_plant(plant):
    z, v = np.array([1.0, -2.0, 0.5]), np.array([3.0, -1.0])
    assert (plant.n, plant.q, plant.p) == (3, 2, 1)
    np.testing.assert_allclose(plant.step(z, v), plant.F @ z + plant.G @ v, rtol=ROUNDING)
    np.testing.assert_allclose(plant.output(z), plant.H @ z, rtol=ROUNDING)
    with pytest.raises(ValueError, match="read-only"):
        plant.F[0, 0] = 1


def test_from_statespace_follows_control(plant):
    system = control.StateSpace(plant.F, plant.G, plant.H, np.zeros((1, 2)), 0.1)
    taken = LinearPlant.from_statespace(system)
    inputs = np.random.default_rng(SEED).standard_normal((2, 8))
    response = control.forced_response(system, U=inputs, X0=[1.0, 2.0, 3.0])
    z = np.array([1.0, 2.0, 3.0])
    for k in range(8):
        np.testing.assert_allclose(taken.output(z), response.outputs[:, k], rtol=1e-11)
        z = taken.step(z, inputs[:, k])


def test_dt_true_is_discrete(plant):
    assert LinearPlant.from_statespace(control.StateSpace(plant.F, plant.G, plant.H, 0, True)).n == 3


@pytest.mark.parametrize(
    ("system", "sentence"),
    [
        (control.tf([1], [1, 1], 0.1), "system must be a control.StateSpace, got TransferFunction"),
        (control.ss([[1.0]], [[1.0]], [[1.0]], [[0.0]], 0), "system must be in discrete time .* got dt=0; discretise"),
        (control.ss([[1.0]], [[1.0]], [[1.0]], [[0.0]], None), "system must be in discrete time .* got dt=None"),
        (control.ss([[1.0]], [[1.0]], [[1.0]], [[2.0]], 1), "system must have D = 0 .* got a feedthrough"),
    ],
)
def test_from_statespace_refuses(system, sentence):
    with pytest.raises(InputError, match=sentence):
        LinearPlant.from_statespace(system)


@pytest.mark.parametrize(
    ("F", "G", "H", "sentence"),
    [
        (np.ones((2, 3)), np.ones((2, 1)), np.ones((1, 2)), r"F must be square, got shape \(2, 3\)"),
        (np.eye(2), np.ones((3, 1)), np.ones((1, 2)), r"G must have shape \(2, at least 1\), got \(3, 1\)"),
        (np.eye(2), np.ones((2, 1)), np.ones((1, 3)), r"H must have shape \(at least 1, 2\), got \(1, 3\)"),
        (np.eye(2), np.ones((2, 1)), [[np.nan, 0.0]], "H must be finite, got nan"),
    ],
)
def test_linear_plant_refuses(F, G, H, sentence):
    with pytest.raises(InputError, match=sentence):
        LinearPlant(F, G, H)


# Equation (24), as printed and as the published curves obey it, entry by entry.
@pytest.mark.parametrize(
    ("variant", "accelerate", "charge"),
    [
        (
            "data",
            lambda x, u: 400 / 11 * x[2] - 19.12 / 11 * x[1] - 1000 / 11 * np.sin(x[0]),
            lambda x, u: -86.04 * x[2] - 3.64 * x[1] + 100 * u,
        ),
        (
            "printed",
            lambda x, u: 36.4 * x[2] - 1.7 * x[1] - 1309 * np.sin(x[0]),
            lambda x, u: -1000 * x[2] - 3.6 * x[1] + 100 * u,
        ),
    ],
)
def test_robot_arm(variant, accelerate, charge):
    arm, x, u = RobotArm(variant), np.array([0.7, -2.0, 3.0]), 1.5
    expected = x + 0.01 * np.array([x[1], accelerate(x, u), charge(x, u)])
    np.testing.assert_allclose(arm.step(x, np.array([u])), expected, rtol=ROUNDING)
    assert np.array_equal(arm.output(x), x)
    assert (arm.n, arm.q, arm.p) == (3, 1, 3)


def test_variants_differ():
    x, v = np.array([0.7, -2.0, 3.0]), np.array([1.5])
    assert np.max(np.abs(RobotArm("data").step(x, v) - RobotArm("printed").step(x, v))) > 1


def test_robot_arm_rests():
    assert not np.any(RobotArm().step(np.zeros(3), np.zeros(1)))


def test_robot_arm_refuses():
    with pytest.raises(InputError, match="variant must be one of data, printed, got 'paper'"):
        RobotArm("paper")


@pytest.mark.parametrize("kind", ["linear", "arm"])
def test_batches_agree_with_members(kind, plant):
    plant = plant if kind == "linear" else RobotArm()
    rng = np.random.default_rng(SEED)
    z, v = rng.standard_normal((4, 5, 3)), rng.standard_normal((4, 5, plant.q))
    together, outputs = plant.step(z, v), plant.output(z)
    for i, j in np.ndindex(4, 5):
        np.testing.assert_allclose(together[i, j], plant.step(z[i, j], v[i, j]), rtol=ROUNDING, atol=ROUNDING)
        np.testing.assert_allclose(outputs[i, j], plant.output(z[i, j]), rtol=ROUNDING, atol=ROUNDING)
