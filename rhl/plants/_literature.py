"""Plants of textbooks and papers, each with its source; constants are listed if matrices follow from them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from rhl.plants._benchmark import Benchmark

_CTMS = "B. Messner and D. Tilbury, Control Tutorials for MATLAB and Simulink, ctms.engin.umich.edu"


def _aircraft_pitch() -> Benchmark:
    return Benchmark(
        "aircraft-pitch",
        "aircraft",
        np.array([[-0.313, 56.7, 0.0], [-0.0139, -0.426, 0.0], [0.0, 56.7, 0.0]]),
        np.array([[0.232], [0.0203], [0.0]]),
        np.array([[0.0, 0.0, 1.0]]),
        h=0.2,
        title="pitch of an airliner",
        origin=f"{_CTMS}, 'Aircraft Pitch: System Modeling', after data of one of Boeing's aircraft",
        states=("angle of attack (rad)", "pitch rate, scaled", "pitch (rad)"),
        inputs=("elevator (rad)",),
        outputs=("pitch (rad)",),
        start=np.array([0.0, 0.0, 0.2]),
    )


def _ball_on_beam() -> Benchmark:
    mass, radius, gravity, inertia = 0.11, 0.015, 9.8, 9.99e-6
    A = np.eye(4, k=1)
    A[1, 2] = mass * gravity / (inertia / radius**2 + mass)
    return Benchmark(
        "ball-on-beam",
        "mechanics",
        A,
        np.array([[0.0], [0.0], [0.0], [1.0]]),
        np.array([[1.0, 0.0, 0.0, 0.0]]),
        h=0.05,
        title="ball on a beam whose angular acceleration is the input",
        origin=f"{_CTMS}, 'Ball & Beam: System Modeling', second state-space model",
        states=("position (m)", "velocity (m/s)", "angle of the beam (rad)", "angular velocity (rad/s)"),
        inputs=("angular acceleration of the beam (rad/s^2)",),
        outputs=("position (m)",),
        start=np.array([0.1, 0.0, 0.0, 0.0]),
    )


def _boeing_747() -> Benchmark:
    return Benchmark(
        "boeing-747",
        "aircraft",
        np.array(
            [
                [-0.0558, -0.9968, 0.0802, 0.0415],
                [0.598, -0.115, -0.0318, 0.0],
                [-3.05, 0.388, -0.465, 0.0],
                [0.0, 0.0805, 1.0, 0.0],
            ]
        ),
        np.array([[0.00729, 0.0], [-0.475, 0.00775], [0.153, 0.143], [0.0, 0.0]]),
        np.array([[0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]),
        h=0.2,
        title="lateral motion of a Boeing 747 at 40,000 ft and Mach 0.8",
        origin="G. F. Franklin, J. D. Powell and A. Emami-Naeini, Feedback Control of Dynamic Systems, section "
        "'Lateral and Longitudinal Control of a Boeing 747' (rudder); the aileron's column and the outputs are those "
        "of 'Yaw Damper Design for a 747 Jet Aircraft', Control System Toolbox",
        states=("sideslip (rad)", "yaw rate (rad/s)", "roll rate (rad/s)", "bank angle (rad)"),
        inputs=("rudder (rad)", "aileron (rad)"),
        outputs=("yaw rate (rad/s)", "bank angle (rad)"),
        start=np.array([0.1, 0.0, 0.0, 0.1]),
    )


def _buck_converter() -> Benchmark:
    source, inductance, capacitance, load = 28.0, 50e-6, 500e-6, 3.0
    return Benchmark(
        "buck-converter",
        "power converter",
        np.array([[0.0, -1 / inductance], [1 / capacitance, -1 / (load * capacitance)]]),
        np.array([[source / inductance], [0.0]]),
        np.array([[0.0, 1.0]]),
        h=1e-4,
        title="buck converter, 28 V to 15 V, averaged over a period of its switch",
        origin="R. W. Erickson and D. Maksimovic, Fundamentals of Power Electronics, design example of chapter "
        "'Controller Design' (L = 50 uH, C = 500 uF, R = 3 ohm, Vg = 28 V, switched at 100 kHz); small-signal model",
        states=("inductor current (A)", "output voltage (V)"),
        inputs=("duty ratio",),
        outputs=("output voltage (V)",),
        start=np.array([0.0, 1.0]),
    )


def _cstr() -> Benchmark:
    flow, volume, feed, temperature, concentration = 100.0, 100.0, 1.0, 350.0, 0.5
    density, heat_capacity, heat_of_reaction, activation, transfer = 1000.0, 0.239, 5e4, 8750.0, 5e4
    # At rest the reaction consumes the inflow; the published 7.2e10 exp(-8750/350) agrees to four digits.
    rate = flow / volume * (feed - concentration) / concentration
    slope = rate * concentration * activation / temperature**2
    heat, cooling = heat_of_reaction / (density * heat_capacity), transfer / (volume * density * heat_capacity)
    return Benchmark(
        "cstr",
        "chemical reactor",
        np.array([[-flow / volume - rate, -slope], [heat * rate, -flow / volume + heat * slope - cooling]]),
        np.array([[0.0], [cooling]]),
        np.array([[0.0, 1.0]]),
        h=0.1,
        title="stirred-tank reactor at its unstable equilibrium, 350 K",
        origin="D. E. Seborg, T. F. Edgar, D. A. Mellichamp and F. J. Doyle, Process Dynamics and Control, example of "
        "section 'Continuous Stirred-Tank Reactor' in chapter 2 (q = 100 L/min, V = 100 L, E/R = 8750 K, k0 = 7.2e10 "
        "1/min, UA = 5e4 J/(min K), Tc = 300 K), linearised here",
        states=("concentration (mol/L)", "temperature (K)"),
        inputs=("coolant temperature (K)",),
        outputs=("temperature (K)",),
        time_unit="min",
        start=np.array([0.02, 3.0]),
    )


def _dc_motor() -> Benchmark:
    inertia, friction, constant, resistance, inductance = 0.01, 0.1, 0.01, 1.0, 0.5
    return Benchmark(
        "dc-motor",
        "electric drive",
        np.array([[-friction / inertia, constant / inertia], [-constant / inductance, -resistance / inductance]]),
        np.array([[0.0], [1 / inductance]]),
        np.array([[1.0, 0.0]]),
        h=0.05,
        title="speed of a DC motor",
        origin=f"{_CTMS}, 'DC Motor Speed: System Modeling'; sampled as in 'Digital Controller Design'",
        states=("speed (rad/s)", "current (A)"),
        inputs=("voltage (V)",),
        outputs=("speed (rad/s)",),
        start=np.array([1.0, 0.0]),
    )


def _distillation_lv() -> Benchmark:
    return Benchmark(
        "distillation-lv",
        "distillation tower",
        -np.eye(2) / 75.0,
        np.array([[0.878, -0.864], [1.082, -1.096]]) / 75.0,
        np.eye(2),
        h=5.0,
        title="high-purity distillation column, LV configuration",
        origin="S. Skogestad, M. Morari and J. C. Doyle, Robust control of ill-conditioned plants: high-purity "
        "distillation, IEEE Transactions on Automatic Control 33(12), 1988: one time constant of 75 min",
        states=("top composition, scaled", "bottom composition, scaled"),
        inputs=("reflux L, scaled", "boilup V, scaled"),
        outputs=("top composition, scaled", "bottom composition, scaled"),
        time_unit="min",
    )


def _double_integrator() -> Benchmark:
    return Benchmark(
        "double-integrator",
        "mechanics",
        np.eye(2, k=1),
        np.array([[0.0], [1.0]]),
        np.array([[1.0, 0.0]]),
        h=0.1,
        title="double integrator",
        origin="V. G. Rao and D. S. Bernstein, Naive control of the double integrator, IEEE Control Systems Magazine "
        "21(5), 2001; with a unit mass",
        states=("position", "velocity"),
        inputs=("force",),
        outputs=("position",),
        time_unit="",
        start=np.array([1.0, 0.0]),
    )


def _doyle() -> Benchmark:
    return Benchmark(
        "doyle",
        "counterexample",
        np.array([[1.0, 1.0], [0.0, 1.0]]),
        np.array([[0.0], [1.0]]),
        np.array([[1.0, 0.0]]),
        h=0.1,
        title="Doyle's plant on which LQG regulators have no guaranteed margins",
        origin="J. C. Doyle, Guaranteed margins for LQG regulators, IEEE Transactions on Automatic Control 23(4), 1978",
        time_unit="",
    )


def _maglev() -> Benchmark:
    return Benchmark(
        "maglev",
        "mechanics",
        np.array([[0.0, 1.0, 0.0], [980.0, 0.0, -2.8], [0.0, 0.0, -100.0]]),
        np.array([[0.0], [0.0], [100.0]]),
        np.array([[1.0, 0.0, 0.0]]),
        h=0.01,
        title="magnetically suspended ball",
        origin=f"{_CTMS}, 'Introduction: State-Space Methods for Controller Design'; the initial state is theirs",
        states=("position (m)", "velocity (m/s)", "current (A)"),
        inputs=("voltage (V)",),
        outputs=("position (m)",),
        start=np.array([0.01, 0.0, 0.0]),
    )


def _pendulum() -> Benchmark:
    cart, bob, length, gravity = 2.0, 0.1, 0.5, 9.81
    A, B = np.zeros((4, 4)), np.zeros((4, 1))
    A[0, 1] = A[2, 3] = 1.0
    A[1, 0], A[3, 0] = (cart + bob) * gravity / (cart * length), -bob * gravity / cart
    B[1], B[3] = -1 / (cart * length), 1 / cart
    return Benchmark(
        "ogata-pendulum",
        "mechanics",
        A,
        B,
        np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]),
        h=0.05,
        title="inverted pendulum on a cart",
        origin="K. Ogata, Modern Control Engineering, 5th edition, 2010, examples 3-6 and 10-5 (M = 2 kg, m = 0.1 kg, "
        "l = 0.5 m)",
        states=("angle (rad)", "angular velocity (rad/s)", "position (m)", "velocity (m/s)"),
        inputs=("force (N)",),
        outputs=("angle (rad)", "position (m)"),
        start=np.array([0.1, 0.0, 0.1, 0.0]),
    )


def _rohrs() -> Benchmark:
    # 2/(s+1) behind 229/(s^2 + 30 s + 229)
    return Benchmark(
        "rohrs",
        "counterexample",
        np.array([[-1.0, 2.0, 0.0], [0.0, 0.0, 1.0], [0.0, -229.0, -30.0]]),
        np.array([[0.0], [0.0], [229.0]]),
        np.array([[1.0, 0.0, 0.0]]),
        h=0.1,
        title="the plant with unmodelled dynamics of Rohrs and others",
        origin="C. E. Rohrs, L. Valavani, M. Athans and G. Stein, Robustness of continuous-time adaptive control "
        "algorithms in the presence of unmodeled dynamics, IEEE Transactions on Automatic Control 30(9), 1985",
        start=np.array([1.0, 0.0, 0.0]),
    )


def _rosenbrock() -> Benchmark:
    # [1/(s+1), 2/(s+3); 1/(s+1), 1/(s+1)]; both outputs share the state of the first column.
    return Benchmark(
        "rosenbrock",
        "counterexample",
        np.diag([-1.0, -3.0, -1.0]),
        np.array([[1.0, 0.0], [0.0, 2.0], [0.0, 1.0]]),
        np.array([[1.0, 1.0, 0.0], [1.0, 0.0, 1.0]]),
        h=0.2,
        title="Rosenbrock's plant with a transmission zero in the right half plane",
        origin="H. H. Rosenbrock, State-space and Multivariable Theory, Nelson, 1970: [1/(s+1), 2/(s+3); 1/(s+1), "
        "1/(s+1)]",
        time_unit="",
    )


def _spinning_satellite() -> Benchmark:
    a = 10.0
    return Benchmark(
        "spinning-satellite",
        "spacecraft",
        np.array([[0.0, a], [-a, 0.0]]),
        np.eye(2),
        np.array([[1.0, a], [-a, 1.0]]),
        h=0.05,
        title="angular velocities of a spinning satellite",
        origin="S. Skogestad and I. Postlethwaite, Multivariable Feedback Control, section 'Motivating robustness "
        "example no. 1: Spinning satellite', a = 10, after J. C. Doyle, 1986",
        time_unit="",
    )


def _two_mass_spring() -> Benchmark:
    first, second, stiffness = 1.0, 1.0, 1.0
    A = np.zeros((4, 4))
    A[0, 2] = A[1, 3] = 1.0
    A[2, :2] = np.array([-1.0, 1.0]) * stiffness / first
    A[3, :2] = np.array([1.0, -1.0]) * stiffness / second
    return Benchmark(
        "two-mass-spring",
        "mechanics",
        A,
        np.array([[0.0], [0.0], [1 / first], [0.0]]),
        np.array([[0.0, 1.0, 0.0, 0.0]]),
        h=0.3,
        title="two masses and a spring, force and sensor on different ones",
        origin="B. Wie and D. S. Bernstein, Benchmark problems for robust control design, Journal of Guidance, "
        "Control, and Dynamics 15(5), 1992, with m1 = m2 = k = 1",
        states=("position of body 1", "position of body 2", "velocity of body 1", "velocity of body 2"),
        inputs=("force on body 1",),
        outputs=("position of body 2",),
        time_unit="",
        start=np.array([1.0, 1.0, 0.0, 0.0]),
    )


def _vehicle_lateral() -> Benchmark:
    mass, inertia, front, rear, stiffness, speed = 1573.0, 2873.0, 1.1, 1.58, 80000.0, 30.0
    A, B = np.zeros((4, 4)), np.zeros((4, 1))
    A[0, 1] = A[2, 3] = 1.0
    sum_, moment = 4 * stiffness, 2 * stiffness * (rear - front)
    A[1, 1:] = -sum_ / (mass * speed), sum_ / mass, moment / (mass * speed)
    A[3, 1:] = (
        moment / (inertia * speed),
        -moment / inertia,
        -2 * stiffness * (front**2 + rear**2) / (inertia * speed),
    )
    B[1], B[3] = 2 * stiffness / mass, 2 * stiffness * front / inertia
    return Benchmark(
        "vehicle-lateral",
        "vehicle",
        A,
        B,
        np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]),
        h=0.05,
        title="a car off its lane at 30 m/s (bicycle model)",
        origin="R. Rajamani, Vehicle Dynamics and Control, 2nd edition, Springer, 2012, section 2.5 (model in terms of "
        "the error with respect to the road), with the passenger car of its examples (m = 1573 kg, Iz = 2873 kg m^2, "
        "1.1 m, 1.58 m, 80000 N/rad)",
        states=("lateral error (m)", "its rate (m/s)", "yaw error (rad)", "its rate (rad/s)"),
        inputs=("steering angle (rad)",),
        outputs=("lateral error (m)", "yaw error (rad)"),
        start=np.array([0.5, 0.0, 0.02, 0.0]),
    )


def _wood_berry() -> Benchmark:
    gains = np.array([[12.8, -18.9], [6.6, -19.4]])
    lags = np.array([[16.7, 21.0], [10.9, 14.4]])
    delays = np.array([[1, 3], [7, 3]])
    # A lag for each channel, then the past inputs of each, newest first: v(k-1), v(k-2), ... With delays of whole
    # sampling periods this is the plant, not an approximation.
    kept = delays.max(axis=0)
    n = 4 + int(kept.sum())
    F, G, H = np.zeros((n, n)), np.zeros((n, 2)), np.zeros((2, n))
    first = np.array([4, 4 + kept[0]])
    for j in range(2):
        G[first[j], j] = 1.0
        for i in range(1, kept[j]):
            F[first[j] + i, first[j] + i - 1] = 1.0
        for i in range(2):
            at = 2 * i + j
            decay = np.exp(-1.0 / lags[i, j])
            F[at, at], F[at, first[j] + delays[i, j] - 1] = decay, gains[i, j] * (1 - decay)
            H[i, at] = 1.0
    return Benchmark(
        "wood-berry",
        "distillation tower",
        F,
        G,
        H,
        h=1.0,
        title="Wood and Berry's distillation column",
        origin="R. K. Wood and M. W. Berry, Terminal composition control of a binary distillation column, Chemical "
        "Engineering Science 28(9), 1973; sampled here every minute, which divides its delays of 1, 3 and 7 min",
        inputs=("reflux (lb/min)", "steam (lb/min)"),
        outputs=("top composition (wt%)", "bottom composition (wt%)"),
        time_unit="min",
        discrete=True,
        start=np.concatenate([[0.5, 0.5, 0.5, 0.5], np.zeros(n - 4)]),
    )


_MAKERS: tuple[Callable[[], Benchmark], ...] = (
    _aircraft_pitch,
    _ball_on_beam,
    _boeing_747,
    _buck_converter,
    _cstr,
    _dc_motor,
    _distillation_lv,
    _double_integrator,
    _doyle,
    _maglev,
    _pendulum,
    _rohrs,
    _rosenbrock,
    _spinning_satellite,
    _two_mass_spring,
    _vehicle_lateral,
    _wood_berry,
)


def literature() -> dict[str, Benchmark]:
    """Return the plants by name, sorted."""
    made = (make() for make in _MAKERS)
    return dict(sorted((plant.name, plant) for plant in made))
