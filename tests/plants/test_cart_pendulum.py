"""The pendulum on a cart: against printed numbers, conserved energy, and what it refuses."""

import numpy as np
import pytest

from rhl.errors import InputError
from rhl.plants.analysis import linearise
from rhl.plants.cart_pendulum import CartPendulum


def rates(plant):
    """A and B of the pendulum's differential equation at the upright, by central differences."""
    step = 1e-6
    A = np.stack([(plant.rate(step * e, 0.0) - plant.rate(-step * e, 0.0)) / (2 * step) for e in np.eye(4)], axis=1)
    return A, (plant.rate(np.zeros(4), step) - plant.rate(np.zeros(4), -step)) / (2 * step)


# As printed by the Control Tutorials for MATLAB and Simulink.
CTMS_A = np.array([[0, 1, 0, 0], [0, -0.1818, 2.6727, 0], [0, 0, 0, 1], [0, -0.4545, 31.1818, 0]])
CTMS_B = np.array([0, 1.8182, 0, 4.5455])
CTMS_POLES = [-5.6041, -0.1428, 0, 5.5651]


def test_pendulum_linearises_to_the_published_matrices():
    A, B = rates(CartPendulum())
    np.testing.assert_allclose(A, CTMS_A, atol=6e-5)
    np.testing.assert_allclose(B, CTMS_B, atol=6e-5)
    np.testing.assert_allclose(np.sort(np.linalg.eigvals(A)), CTMS_POLES, atol=6e-5)


@pytest.mark.parametrize("name", ["cart_mass", "pendulum_mass", "friction", "length", "inertia", "gravity"])
def test_every_parameter_of_the_pendulum_counts(name):
    A, B = rates(CartPendulum(**{name: 1.01 * getattr(CartPendulum(), name)}))
    assert max(np.abs(A - CTMS_A).max(), np.abs(B - CTMS_B).max()) > 5e-4


def test_sampled_pendulum_has_the_published_poles():
    plant = CartPendulum(h=0.01)
    poles = np.sort(np.log(np.linalg.eigvals(linearise(plant).F)) / plant.h)
    np.testing.assert_allclose(poles, CTMS_POLES, atol=1e-4)


def energy(plant, z, sign=1.0):
    """Kinetic energy of cart and pendulum and the height of its centre; sign -1 couples the velocities wrongly."""
    M, m, l = plant.cart_mass, plant.pendulum_mass, plant.length
    _, speed, phi, turn = z
    kinetic = (M + m) * speed**2 / 2 - sign * m * l * speed * turn * np.cos(phi)
    return kinetic + (plant.inertia + m * l**2) * turn**2 / 2 + m * plant.gravity * l * np.cos(phi)


def drift(plant, sign=1.0, force=0.0):
    """Largest change of energy over two seconds of a fall through the bottom, relative to its height."""
    z = np.array([0.0, 0.4, 0.5, -0.3])
    start, worst = energy(plant, z, sign), 0.0
    for _ in range(round(2 / plant.h)):
        z = plant.step(z, np.array([force]))
        worst = max(worst, abs(energy(plant, z, sign) - start))
    return worst / (plant.pendulum_mass * plant.gravity * plant.length)


def test_frictionless_pendulum_conserves_energy():
    coarse, fine = (drift(CartPendulum(friction=0.0, h=h)) for h in (0.02, 0.01))
    assert fine < 1e-5
    assert coarse / fine > 12  # fourth order: halving the step leaves a sixteenth or less
    assert drift(CartPendulum(friction=0.0, h=0.01), sign=-1.0) > 0.1
    assert drift(CartPendulum(friction=0.1, h=0.01)) > 0.01
    assert drift(CartPendulum(friction=0.0, h=0.01), force=0.1) > 0.01


def test_pendulum_rests_upright_and_falls_from_anywhere_else():
    plant = CartPendulum(h=0.02)
    assert not np.any(plant.step(np.zeros(4), np.zeros(1)))
    z = np.array([[0.0, 0.0, 1e-3, 0.0], [0.0, 0.0, -1e-3, 0.0]])
    for _ in range(50):
        z = plant.step(z, np.zeros(1))
    assert z[0, 2] > 0.05
    np.testing.assert_allclose(z[0], -z[1], rtol=1e-12)
    assert np.array_equal(plant.output(z), z[:, [0, 2]])


def test_the_fall_grows_by_what_the_docstring_says():
    assert np.abs(np.linalg.eigvals(linearise(CartPendulum()).F)).max() == pytest.approx(1.32, abs=5e-3)


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"friction": -0.1}, "friction must be a finite number of at least 0, got -0.1"),
        ({"friction": [0.1]}, r"friction must be a finite number of at least 0, got \[0.1\]"),
        ({"friction": float("nan")}, "friction must be finite, got nan"),
        ({"length": 0.0}, "length must be a positive finite number, got 0.0"),
        ({"h": -1}, "h must be a positive finite number, got -1"),
    ],
)
def test_pendulum_refuses(wrong, sentence):
    with pytest.raises(InputError, match=sentence):
        CartPendulum(**wrong)


def test_pendulum_refuses_wrong_lengths():
    with pytest.raises(InputError, match=r"z must have shape \(\.\.\., 4\) for this plant, got \(3,\)"):
        CartPendulum().step(np.zeros(3), np.zeros(1))
    with pytest.raises(InputError, match=r"v must have shape \(\.\.\., 1\) for this plant, got \(2,\)"):
        CartPendulum().step(np.zeros(4), np.zeros(2))
    with pytest.raises(InputError, match=r"z must have shape \(\.\.\., 4\) for this plant, got \(5,\)"):
        CartPendulum().output(np.zeros(5))
