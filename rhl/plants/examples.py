"""Example plants in addition to the paper's, each with its published source, units and a moderate initial state."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, get_args

import numpy as np

from rhl._checks import Array, choice, positive, read_only
from rhl.errors import InputError
from rhl.plants.base import Plant
from rhl.plants.cart_pendulum import CartPendulum
from rhl.plants.linear import LinearPlant

Valves = Literal["minimum-phase", "nonminimum-phase"]


@dataclass(frozen=True, eq=False)
class ExamplePlant:
    """A plant with an initial state and the labels of its signals.

    Attributes
    ----------
    z0 : array, shape (n,)
        An initial state away from rest, within the range of validity of the model.
    what : str
        One line.
    states, inputs, outputs : tuple of str
        Name and unit of each entry of z, v and y.
    h : float
        Sampling time in seconds.

    Examples
    --------
    >>> tanks = example("quadruple-tank")
    >>> tanks.plant.n, tanks.h, tanks.inputs
    (4, 5.0, ('pump 1 (V)', 'pump 2 (V)'))
    """

    plant: Plant
    z0: Array
    what: str
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    h: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "z0", read_only(self.z0))


# K. H. Johansson, 2000: cross-sections of tanks and outlets (cm^2), gravity (cm/s^2), gain of
# the level sensors (V/cm).
_AREA = np.array([28.0, 32.0, 28.0, 32.0])
_OUTLET = np.array([0.071, 0.057, 0.071, 0.057])
_GRAVITY = 981.0
_SENSOR = 0.5
# Levels (cm), pump gains (cm^3/(V s)) and valve settings of the two operating points.
_TANKS: Mapping[Valves, tuple[tuple[float, ...], tuple[float, float], tuple[float, float]]] = {
    "minimum-phase": ((12.4, 12.7, 1.8, 1.4), (3.33, 3.35), (0.70, 0.60)),
    "nonminimum-phase": ((12.6, 13.0, 4.8, 4.9), (3.14, 3.29), (0.43, 0.34)),
}


def _tanks(valves: Valves) -> tuple[Array, Array, Array]:
    choice("valves", valves, get_args(Valves))
    levels, (k1, k2), (gamma1, gamma2) = _TANKS[valves]
    T1, T2, T3, T4 = _AREA / _OUTLET * np.sqrt(2 * np.array(levels) / _GRAVITY)
    A1, A2, A3, A4 = _AREA
    A = np.array(
        [[-1 / T1, 0, A3 / (A1 * T3), 0], [0, -1 / T2, 0, A4 / (A2 * T4)], [0, 0, -1 / T3, 0], [0, 0, 0, -1 / T4]]
    )
    B = np.array(
        [[gamma1 * k1 / A1, 0], [0, gamma2 * k2 / A2], [0, (1 - gamma2) * k2 / A3], [(1 - gamma1) * k1 / A4, 0]]
    )
    return A, B, _SENSOR * np.eye(2, 4)


def quadruple_tank(valves: Valves = "minimum-phase", h: float = 5.0) -> LinearPlant:
    r"""Four water tanks fed by two pumps, linearised about an operating point and sampled with constant inputs.

    .. math::
        \dot z_1 &= -z_1/T_1 + \tfrac{A_3}{A_1} z_3/T_3 + \gamma_1 k_1 v_1/A_1 &\qquad
        \dot z_3 &= -z_3/T_3 + (1-\gamma_2) k_2 v_2/A_3 \\
        \dot z_2 &= -z_2/T_2 + \tfrac{A_4}{A_2} z_4/T_4 + \gamma_2 k_2 v_2/A_2 &
        \dot z_4 &= -z_4/T_4 + (1-\gamma_1) k_1 v_1/A_4

    with :math:`T_i = (A_i/a_i)\sqrt{2 h_i/g}`; each lower tank (1, 2) is fed by one pump and by the tank above it (3,
    4), which the other pump feeds. n = 4, q = 2, p = 2.

    Parameters
    ----------
    valves : {"minimum-phase", "nonminimum-phase"}
        How the valves split the pumps' flows. If more flows to the upper tanks than to the lower ones
        (gamma_1 + gamma_2 < 1), there is a zero in the right half plane.
    h : float
        Sampling time, s, positive.

    Notes
    -----
    State z: deviations of the four levels from the operating point (cm). Input v: deviations of the two pump voltages
    (V). Output y: deviations of the voltages of the level sensors of the lower tanks (V), 0.5 V/cm.

    Source: K. H. Johansson, "The quadruple-tank process: a multivariable laboratory process with an adjustable zero",
    IEEE Transactions on Control Systems Technology 8(3), 2000, doi 10.1109/87.845876: equations, all parameters but h,
    and the two operating points, there P- and P+, with time constants of 62, 90, 23, 30 s and 63, 91, 39, 56 s.

    Examples
    --------
    >>> plant = quadruple_tank("nonminimum-phase")
    >>> plant.n, plant.q, plant.p
    (4, 2, 2)
    """
    return _sampled(*_tanks(valves), h)


def held_pump(h: float = 5.0) -> LinearPlant:
    """Return the right half of the quadruple tank with pump 1 held: a stable slow mode that the input cannot reach.

    Pump 1 runs at a constant voltage and so feeds tank 4 a constant flow; pump 2, the input, reaches tank 2 but not
    tank 4, whose level converges at its own rate and drains into tank 2, where it is measured.

    State z: deviations of the levels of tanks 2 and 4 (cm). Input v: deviation of the voltage of pump 2 (V). Output y:
    deviation of the voltage of the sensor in tank 2 (V). Modes exp(-h/T_2) and exp(-h/T_4), T_2 = 91 s and T_4 = 56 s,
    with the sampling time h (s), positive; the second is not controllable.

    Source: the rig of :func:`quadruple_tank` at its nonminimum-phase operating point, tanks 2 and 4 only.

    Examples
    --------
    >>> plant = held_pump()
    >>> plant.G[1], bool(plant.F[1, 1] < 1)  # no input reaches the second state, which decays
    (array([0.]), True)
    """
    A, B, C = _tanks("nonminimum-phase")
    return _sampled(A[np.ix_([1, 3], [1, 3])], B[[1, 3], 1:], C[1:, [1, 3]], h)


def flexible_shaft(h: float = 0.1) -> LinearPlant:
    r"""Return a DC motor that turns a load through a gearbox and a flexible shaft, sampled with constant inputs.

    .. math::
        J_L \dot\omega_L &= -k_\theta (\theta_L - \theta_M/\rho) - \beta_L \omega_L \\
        J_M \dot\omega_M &= k_T (v - k_T \omega_M)/R - \beta_M \omega_M + (k_\theta/\rho)(\theta_L - \theta_M/\rho)

    State z: angle (rad) and angular velocity (rad/s) of the load, then of the motor. Input v: armature voltage (V).
    Output y: angle of the load (rad). The sampling time h (s) is positive. The torsion of the shaft oscillates at 7.3
    rad/s with a damping ratio of 0.096, and the angle integrates.

    Source: A. Bemporad and E. Mosca, "Fulfilling hard constraints in uncertain linear systems by reference managing",
    Automatica 34(4), 1998, pages 451 to 461; all parameters and the sampling time as in the Model Predictive Control
    Toolbox's example of it, "Design MPC Controller for Position Servomechanism" (mathworks.com), whose companion "DC
    Servomotor with Constraint on Unmeasured Output" prints the poles 0, -9.79 and -0.705 +- 7.31i 1/s.

    Examples
    --------
    >>> eigenvalues = np.linalg.eigvals(flexible_shaft().F)
    >>> bool(np.isclose(np.max(np.abs(eigenvalues)), 1.0))  # the angle integrates
    True
    """
    stiffness, motor, resistance, ratio = 1280.2, 10.0, 20.0, 20.0  # N m/rad, N m/A, ohm, 1
    J_M, beta_M, beta_L = 0.5, 0.1, 25.0  # kg m^2, N m s/rad, N m s/rad
    J_L = 50 * J_M
    A = np.array(
        [
            [0, 1, 0, 0],
            [-stiffness / J_L, -beta_L / J_L, stiffness / (ratio * J_L), 0],
            [0, 0, 0, 1],
            [stiffness / (ratio * J_M), 0, -stiffness / (ratio**2 * J_M), -(beta_M + motor**2 / resistance) / J_M],
        ]
    )
    B = np.array([[0], [0], [0], [motor / (resistance * J_M)]])
    return _sampled(A, B, np.eye(1, 4), h)


def reversing_vehicle(h: float = 0.1) -> LinearPlant:
    r"""Return a car that reverses at 2 m/s, steered by its front wheels, linearised and sampled with constant inputs.

    .. math:: \dot y = s\,\theta + \frac{a s}{b} v, \qquad \dot\theta = \frac{s}{b} v, \qquad s = -2\,\text{m/s}

    State z: lateral deviation (m) of the reference point, a = 1.5 m ahead of the rear axle, and heading (rad);
    wheelbase b = 3 m. Input v: steering angle (rad). Output y: the lateral deviation (m). The sampling time h (s) is
    positive. From v to y the transfer function is (a s p + s^2)/(b p^2) in the Laplace variable p: a double integrator
    with a zero at -s/a, in the right half plane when reversing, so the car first moves in the opposite direction.

    Source: K. J. Astrom and R. M. Murray, Feedback Systems, 2nd edition, 2021, the running example of vehicle steering;
    a, b and s as in its companion notebook of python-control's examples ("Vehicle steering", example 10.11).

    Examples
    --------
    >>> plant, z, y = reversing_vehicle(), np.zeros(2), []
    >>> for _ in range(30):
    ...     z = plant.step(z, np.array([0.1]))
    ...     y.append(z[0])
    >>> bool(y[0] < 0 < y[-1])  # first in the opposite direction
    True
    """
    speed, offset, wheelbase = -2.0, 1.5, 3.0
    A = np.array([[0, speed], [0, 0]])
    B = np.array([[offset * speed / wheelbase], [speed / wheelbase]])
    return _sampled(A, B, np.eye(1, 2), h)


def _sampled(A: Array, B: Array, C: Array, h: float) -> LinearPlant:
    """Sample dz/dt = A z + B v, y = C z with v constant over each interval of length h: exact."""
    from scipy.linalg import expm  # imported here, because loading it takes long

    h = positive("h", h)
    n, q = B.shape
    block = np.zeros((n + q, n + q))
    block[:n, :n], block[:n, n:] = A, B
    with np.errstate(over="ignore", invalid="ignore"):
        both = expm(h * block) if np.all(np.isfinite(h * block)) else np.full_like(block, np.inf)
    if not np.all(np.isfinite(both)):
        raise InputError(f"h must be a sampling time over which the plant stays finite, got {h:g}; shorten it")
    return LinearPlant(both[:n, :n], both[:n, n:], C)


def _cart_pendulum() -> ExamplePlant:
    plant = CartPendulum()
    return ExamplePlant(
        plant,
        np.array([0.0, 0.0, 0.1, 0.0]),
        "inverted pendulum on a cart: nonlinear, unstable",
        ("cart position (m)", "cart velocity (m/s)", "angle from upright (rad)", "angular velocity (rad/s)"),
        ("force (N)",),
        ("cart position (m)", "angle from upright (rad)"),
        plant.h,
    )


def _quadruple_tank(valves: Valves) -> ExamplePlant:
    return ExamplePlant(
        quadruple_tank(valves),
        np.array([2.0, -2.0, 0.5, -0.5]),
        f"four water tanks, two pumps: two inputs, two outputs, {valves}",
        tuple(f"level {i} (cm)" for i in (1, 2, 3, 4)),
        ("pump 1 (V)", "pump 2 (V)"),
        ("sensor 1 (V)", "sensor 2 (V)"),
        5.0,
    )


def _flexible_shaft() -> ExamplePlant:
    return ExamplePlant(
        flexible_shaft(),
        np.array([1.0, 0.0, 20.0, 0.0]),  # rotated by one radian, without torsion at a gear ratio of 20
        "DC motor with a flexible shaft: an integrator and a lightly damped pair",
        ("load angle (rad)", "load velocity (rad/s)", "motor angle (rad)", "motor velocity (rad/s)"),
        ("armature voltage (V)",),
        ("load angle (rad)",),
        0.1,
    )


def _reversing_vehicle() -> ExamplePlant:
    return ExamplePlant(
        reversing_vehicle(),
        np.array([0.5, 0.0]),
        "car in reverse: a double integrator with a zero outside the unit circle",
        ("lateral deviation (m)", "heading (rad)"),
        ("steering angle (rad)",),
        ("lateral deviation (m)",),
        0.1,
    )


def _slow_mode() -> ExamplePlant:
    return ExamplePlant(
        held_pump(),
        np.array([2.0, 2.0]),
        "two water tanks, one of them not fed by the pump: a stable mode that is not controllable",
        ("level 2 (cm)", "level 4 (cm)"),
        ("pump 2 (V)",),
        ("sensor 2 (V)",),
        5.0,
    )


EXAMPLES: Mapping[str, Callable[[], ExamplePlant]] = MappingProxyType(
    {
        "cart-pendulum": _cart_pendulum,
        "quadruple-tank": lambda: _quadruple_tank("minimum-phase"),
        "quadruple-tank-nonminimum": lambda: _quadruple_tank("nonminimum-phase"),
        "flexible-shaft": _flexible_shaft,
        "reversing-vehicle": _reversing_vehicle,
        "slow-mode": _slow_mode,
    }
)


def example(name: str) -> ExamplePlant:
    """Return an example plant by its name, a key of ``EXAMPLES``; the InputError for any other name lists them.

    Examples
    --------
    >>> example("slow-mode").outputs
    ('sensor 2 (V)',)
    """
    choice("name", name, tuple(EXAMPLES))
    return EXAMPLES[name]()
