"""Example plants: against the numbers their sources print, conserved energy, and what each is there to show."""

from dataclasses import FrozenInstanceError

import control
import numpy as np
import pytest
from scipy.linalg import eigvals, logm

from rhl.errors import InputError
from rhl.plants.analysis import detectability, linearise, pbh, stabilizability
from rhl.plants.cart_pendulum import CartPendulum
from rhl.plants.examples import (
    EXAMPLES,
    example,
    flexible_shaft,
    held_pump,
    quadruple_tank,
    reversing_vehicle,
)

# exp and log of a matrix of norm below ten.
ROUNDING = 1e-9


def continuous(plant, h):
    """A and B of dz/dt = A z + B v from the sampled plant, where that has no eigenvalue at zero or below."""
    n = plant.n
    block = np.block([[plant.F, plant.G], [np.zeros((plant.q, n)), np.eye(plant.q)]])
    rates = np.real(logm(block)) / h
    return rates[:n, :n], rates[:n, n:]


def zeros(A, B, C):
    """Finite invariant zeros of a square system."""
    n, q = B.shape
    left = np.block([[A, B], [C, np.zeros((len(C), q))]])
    right = np.zeros_like(left)
    right[:n, :n] = np.eye(n)
    found = eigvals(left, right)
    return np.sort_complex(found[np.isfinite(found) & (np.abs(found) < 1e6)])


# ---------------------------------------------------------------- quadruple tank

# Johansson 2000 prints T1 to T4 in whole seconds, and the parameters behind them.
TANKS = {
    "minimum-phase": ([62, 90, 23, 30], (3.33, 3.35), (0.70, 0.60)),
    "nonminimum-phase": ([63, 91, 39, 56], (3.14, 3.29), (0.43, 0.34)),
}


@pytest.mark.parametrize("valves", TANKS)
def test_tanks_have_the_published_time_constants(valves):
    A, _ = continuous(quadruple_tank(valves), 5.0)
    constants = -1 / np.diag(A)
    assert np.abs(constants - TANKS[valves][0]).max() < 1
    other = next(name for name in TANKS if name != valves)
    assert np.abs(constants - TANKS[other][0]).max() > 10


@pytest.mark.parametrize("valves", TANKS)
def test_tanks_have_the_transfer_matrix_of_the_paper(valves):
    """Its four entries, c1 gamma1 / (1 + s T1) and so on with c_i = T_i k_c k_j / A_i, at s = 0 and elsewhere."""
    plant = quadruple_tank(valves)
    A, B = continuous(plant, 5.0)
    T1, T2, T3, T4 = -1 / np.diag(A)
    (k1, k2), (g1, g2) = TANKS[valves][1:]
    for s in (0.0, 0.03 + 0.1j):
        entries = [
            [T1 * k1 / 28 * g1 / (1 + s * T1), T1 * k2 / 28 * (1 - g2) / ((1 + s * T3) * (1 + s * T1))],
            [T2 * k1 / 32 * (1 - g1) / ((1 + s * T4) * (1 + s * T2)), T2 * k2 / 32 * g2 / (1 + s * T2)],
        ]
        found = plant.H @ np.linalg.solve(s * np.eye(4) - A, B)
        np.testing.assert_allclose(found, 0.5 * np.array(entries), rtol=ROUNDING)
        assert not np.allclose(found, 0.5 * np.array(entries).T, rtol=1e-3)
    # Sampling with constant inputs keeps the gain at rest.
    np.testing.assert_allclose(
        plant.H @ np.linalg.solve(np.eye(4) - plant.F, plant.G), -plant.H @ np.linalg.solve(A, B), rtol=ROUNDING
    )


@pytest.mark.parametrize("valves", TANKS)
def test_zeros_of_the_tanks(valves):
    """They solve (1 + s T3)(1 + s T4) = (1-g1)(1-g2)/(g1 g2): one is positive just where g1 + g2 < 1."""
    plant = quadruple_tank(valves)
    A, B = continuous(plant, 5.0)
    _, _, T3, T4 = -1 / np.diag(A)
    g1, g2 = TANKS[valves][2]
    expected = np.roots([T3 * T4, T3 + T4, 1 - (1 - g1) * (1 - g2) / (g1 * g2)])
    np.testing.assert_allclose(zeros(A, B, plant.H), np.sort_complex(expected), rtol=1e-6)
    assert np.sum(expected > 0) == (g1 + g2 < 1) == (valves == "nonminimum-phase")
    assert np.sum(np.abs(zeros(plant.F, plant.G, plant.H)) > 1) == np.sum(expected > 0)


def test_tanks_refuse():
    with pytest.raises(InputError, match="valves must be one of minimum-phase, nonminimum-phase, got 'P-'"):
        quadruple_tank("P-")
    with pytest.raises(InputError, match="h must be a positive finite number, got 0"):
        quadruple_tank(h=0)


# ---------------------------------------------------------------- flexible shaft


def test_shaft_has_the_published_poles():
    A, B = continuous(flexible_shaft(), 0.1)
    poles = np.sort_complex(np.linalg.eigvals(A))
    np.testing.assert_allclose(poles, [-9.79, -0.705 - 7.31j, -0.705 + 7.31j, 0], atol=6e-3)
    pair = poles[1]
    assert abs(pair) == pytest.approx(7.35, abs=5e-3)
    assert -pair.real / abs(pair) == pytest.approx(0.0959, abs=5e-5)
    # The rows of A and B as the example prints them, with its constants.
    rows = [[0, 1, 0, 0], [-51.208, -1, 2.5604, 0], [0, 0, 0, 1], [128.02, 0, -6.401, -10.2]]
    np.testing.assert_allclose(A, rows, atol=1e-8)
    np.testing.assert_allclose(B, [[0], [0], [0], [1]], atol=1e-8)
    softer = np.array(rows)
    softer[1:, [0, 2]] *= 0.99
    assert np.abs(np.sort_complex(np.linalg.eigvals(softer)) - poles).max() > 2e-2


def test_shaft_turns_as_one():
    """Without friction in sight the angle of both ends is free: load angle 1, motor angle 20 stays."""
    z = np.array([1.0, 0.0, 20.0, 0.0])
    np.testing.assert_allclose(flexible_shaft().step(z, np.zeros(1)), z, atol=1e-12)
    assert np.abs(flexible_shaft().step(z + np.eye(4)[2], np.zeros(1)) - z).max() > 0.1


# ---------------------------------------------------------------- reversing vehicle


def test_vehicle_has_the_published_transfer_function():
    """(-s + 4/3)/s^2 at 2 m/s in reverse: numerator a v/b and v^2/b with a = 1.5, b = 3, v = -2."""
    plant = reversing_vehicle()
    A, B = np.array([[0.0, -2.0], [0.0, 0.0]]), np.array([[-1.0], [-2 / 3]])
    theirs = control.sample_system(control.tf([-1.0, 4 / 3], [1.0, 0.0, 0.0]), 0.1)
    for point in (1.5, 0.3 + 1j):
        ours = (plant.H @ np.linalg.solve(point * np.eye(2) - plant.F, plant.G)).item()
        assert ours == pytest.approx(theirs(point), rel=ROUNDING)
        forward = control.sample_system(control.tf([1.0, 4 / 3], [1.0, 0.0, 0.0]), 0.1)
        assert abs(ours - forward(point)) > 1e-3
    np.testing.assert_allclose(zeros(A, B, plant.H), [4 / 3])
    # Sampled: (a - |v| h/2) over (a + |v| h/2), inverted, by hand.
    np.testing.assert_allclose(zeros(plant.F, plant.G, plant.H), [1.6 / 1.4], rtol=ROUNDING)


def test_vehicle_first_moves_the_wrong_way():
    plant, z, y = reversing_vehicle(), np.zeros(2), []
    for _ in range(40):
        z = plant.step(z, np.array([0.1]))
        y.append(plant.output(z)[0])
    assert y[0] < 0 < y[-1]


# ---------------------------------------------------------------- slow mode


def test_slow_mode_cannot_be_reached():
    plant = held_pump()
    slow = np.exp(-5.0 / 56.11172974)  # T4 from the published parameters
    np.testing.assert_allclose(np.sort(np.linalg.eigvals(plant.F)), [slow, np.exp(-5.0 / 91.39602188)], rtol=1e-8)
    hautus = np.concatenate([slow * np.eye(2) - plant.F, plant.G], axis=1)
    assert np.linalg.svd(hautus, compute_uv=False)[-1] < 1e-8
    assert pbh(plant.F, plant.G) < 1e-12  # not controllable
    assert stabilizability(plant.F, plant.G).holds
    assert pbh(plant.F.T, plant.H.T) > 0.05  # but seen
    # With both pumps free the same tank is reached.
    assert pbh(quadruple_tank("nonminimum-phase").F, quadruple_tank("nonminimum-phase").G) > 0.05


def test_slow_mode_is_half_of_the_rig():
    """With pump 1 held, tanks 2 and 4 of the whole do what the plant of two does."""
    whole, half = quadruple_tank("nonminimum-phase"), held_pump()
    z, part = np.array([1.0, 2.0, 3.0, 4.0]), np.array([2.0, 4.0])
    for v in (1.0, -0.5, 2.0):
        z, part = whole.step(z, np.array([0.0, v])), half.step(part, np.array([v]))
        np.testing.assert_allclose(part, z[[1, 3]], rtol=1e-12)
        np.testing.assert_allclose(half.output(part), whole.output(z)[1:], rtol=1e-12)
    assert not np.allclose(half.step(part, np.zeros(1)), whole.step(z, np.array([1.0, 0.0]))[[1, 3]], rtol=1e-2)


# ---------------------------------------------------------------- the registry


@pytest.mark.parametrize("name", EXAMPLES)
def test_every_ready_plant(name):
    found = example(name)
    plant = found.plant
    assert (len(found.states), len(found.inputs), len(found.outputs)) == (plant.n, plant.q, plant.p)
    assert all(label.endswith(")") for label in (*found.states, *found.inputs, *found.outputs))
    assert found.z0.shape == (plant.n,)
    assert not found.z0.flags.writeable
    assert np.any(found.z0)
    assert "\n" not in found.what
    assert not np.any(plant.step(np.zeros(plant.n), np.zeros(plant.q)))
    # The scheme asks for these two (Assumption 1).
    linear = linearise(plant)
    assert stabilizability(linear.F, linear.G).holds
    assert detectability(linear.F, linear.H).holds


# The largest entry of A in dz/dt = A z + B v, from the sources: 1/s, for the vehicle m/s.
FASTEST = {
    "cart-pendulum": 31.1818,
    "quadruple-tank": 1 / 23.89,
    "quadruple-tank-nonminimum": 1 / 39.01,
    "flexible-shaft": 128.02,
    "reversing-vehicle": 2.0,
    "slow-mode": 1 / 56.11,
}


@pytest.mark.parametrize("name", FASTEST)
def test_the_sampling_time_told_is_the_one_used(name):
    found = example(name)
    linear = linearise(found.plant)
    A, B = continuous(linear, found.h)
    assert np.abs(A).max() == pytest.approx(FASTEST[name], rel=1e-3)
    assert np.abs(continuous(linear, 1.01 * found.h)[0]).max() != pytest.approx(FASTEST[name], rel=1e-3)
    theirs = control.sample_system(control.ss(A, B, linear.H, 0), found.h)
    np.testing.assert_allclose(linear.F, theirs.A, atol=1e-7)
    np.testing.assert_allclose(linear.G, theirs.B, atol=1e-7)


@pytest.mark.parametrize("name", ["pendulum", "", None, ["slow-mode"]])
def test_unknown_names_list_the_known(name):
    with pytest.raises(InputError, match=r"name must be one of cart-pendulum, quadruple-tank, .*slow-mode, got "):
        example(name)


def test_parameters_cannot_be_changed():
    with pytest.raises(FrozenInstanceError):
        CartPendulum().length = 2.0
