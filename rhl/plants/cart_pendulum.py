"""An inverted pendulum on a cart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rhl._checks import Array, common_batch, describe, positive, real_array
from rhl.errors import InputError
from rhl.plants.base import check_lengths


@dataclass(frozen=True)
class CartPendulum:
    r"""An inverted pendulum on a cart, nonlinear, sampled by one Runge-Kutta step of fourth order.

    .. math::
        (M + m)\ddot x + b \dot x - m l \ddot\phi \cos\phi + m l \dot\phi^2 \sin\phi &= v \\
        (I + m l^2)\ddot\phi - m g l \sin\phi &= m l \ddot x \cos\phi

    The force v is constant over a sampling interval. All parameters are positive; the friction may be zero.

    Parameters
    ----------
    cart_mass, pendulum_mass : float
        M and m, kg.
    friction : float
        b of the cart, N s/m.
    length : float
        l from the pivot to the centre of mass, m.
    inertia : float
        I of the pendulum about its centre of mass, kg m^2.
    gravity : float
        g, m/s^2.
    h : float
        Sampling time, s.

    Notes
    -----
    State z: position x of the cart (m), its velocity (m/s), angle phi of the pendulum from the upright (rad), its
    angular velocity (rad/s). Input v: force on the cart (N). Output y: x (m) and phi (rad). Everything at zero is the
    upright equilibrium, which is unstable.

    Source: Control Tutorials for MATLAB and Simulink, "Inverted Pendulum: System Modeling" (ctms.engin.umich.edu),
    equations and all parameters but h; there theta = pi + phi. The linearisation quoted there has the poles 0, -0.1428,
    5.5651 and -5.6041 1/s. The sampling time is ours; the unstable mode grows by a factor of 1.32 over it.
    """

    cart_mass: float = 0.5
    pendulum_mass: float = 0.2
    friction: float = 0.1
    length: float = 0.3
    inertia: float = 0.006
    gravity: float = 9.8
    h: float = 0.05

    def __post_init__(self) -> None:
        for name in ("cart_mass", "pendulum_mass", "length", "inertia", "gravity", "h"):
            positive(name, getattr(self, name))
        friction = real_array("friction", self.friction)
        if friction.ndim or friction < 0:
            raise InputError(f"friction must be a finite number of at least 0, got {describe(self.friction)}")

    @property
    def n(self) -> int:
        """Size of the state, 4."""
        return 4

    @property
    def q(self) -> int:
        """Size of the input, 1."""
        return 1

    @property
    def p(self) -> int:
        """Size of the output, 2."""
        return 2

    def rate(self, z: Array, force: Array) -> Array:
        """Return dz/dt, shape (..., 4), under a force of shape (...)."""
        M, m, b, l = self.cart_mass, self.pendulum_mass, self.friction, self.length
        speed, phi, turn = z[..., 1], z[..., 2], z[..., 3]
        sin, cos = np.sin(phi), np.cos(phi)
        # Two equations, linear in both accelerations; their determinant is positive at every angle.
        about_pivot = self.inertia + m * l**2
        push = force - b * speed - m * l * turn**2 * sin
        fall = m * self.gravity * l * sin
        determinant = (M + m) * about_pivot - (m * l * cos) ** 2
        acceleration = (about_pivot * push + m * l * cos * fall) / determinant
        turning = (m * l * cos * push + (M + m) * fall) / determinant
        return np.stack(np.broadcast_arrays(speed, acceleration, turn, turning), axis=-1)

    def step(self, z: Array, v: Array) -> Array:
        """Return the state one sampling time later, shape (..., 4); InputError if z or v has another length."""
        z, v = check_lengths(z=(z, 4), v=(v, 1))
        common_batch(z=(z, 1), v=(v, 1))
        force, h = v[..., 0], self.h
        k1 = self.rate(z, force)
        k2 = self.rate(z + h / 2 * k1, force)
        k3 = self.rate(z + h / 2 * k2, force)
        k4 = self.rate(z + h * k3, force)
        return z + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

    def output(self, z: Array) -> Array:
        """Return position and angle, shape (..., 2); InputError if z has another length."""
        (z,) = check_lengths(z=(z, 4))
        return z[..., [0, 2]]
