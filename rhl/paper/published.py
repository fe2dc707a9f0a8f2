"""The paper's figure data, the experiments behind them, and their comparison."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import resources

import numpy as np

from rhl._checks import Array, choice, instance, real_array
from rhl.closed_loop import replay
from rhl.controllability import ConstantMixing
from rhl.controller import Controller
from rhl.disturbances import Disturbances
from rhl.errors import InputError
from rhl.estimator import ProximalEstimator
from rhl.lifting import DelayLifting
from rhl.model import SignalModel
from rhl.plants import LinearPlant, Plant, RobotArm
from rhl.schedules import PowerDecay
from rhl.scheme import Scheme
from rhl.simulation import simulate
from rhl.trace import Trace

CURVES = {
    "linear_y": "figure 2",
    "linear_y_hat": "figure 2",
    "linear_u": "figure 4",
    "linear_x1": "figure 5",
    "linear_gamma_over_eps": "figure 6",
    "robot_x1": "figure 7",
    "robot_x2": "figure 8",
    "robot_x3": "figure 9",
}


def curve(name: str) -> Array:
    """Return a published curve, one of ``CURVES``, sample by sample from k = 0, shape (samples,).

    Source: the plotted tables in the paper's LaTeX source, digit for digit. The source lacks figure 3's (theta).

    Examples
    --------
    >>> curve("linear_y").shape, float(curve("linear_y")[0])
    ((41,), -9.9)
    """
    choice("name", name, tuple(CURVES))
    with resources.files("rhl.paper").joinpath("data", f"{name}.csv").open(encoding="utf-8") as file:
        table = np.loadtxt(file, delimiter=",", skiprows=1)
    return real_array(name, table[:, 1])


@dataclass(frozen=True, eq=False)
class Experiment:
    """A plant, its initial state z0, shape (n,), the scheme that runs on it, and the number of steps.

    An experiment of the paper has as many steps as its longest published curve has samples. ``sensor``, ``actuator``
    and ``load`` are disturbances between scheme and plant, see ``rhl.disturbances``, none in the paper's;
    ``applied_known`` says whether the scheme records the input after the actuator.
    """

    name: str
    plant: Plant
    z0: Array
    scheme: Scheme
    steps: int
    sensor: Disturbances | None = None
    actuator: Disturbances | None = None
    applied_known: bool = True
    load: Disturbances | None = None

    def run(self, progress: Callable[[Trace], None] | None = None) -> Trace:
        """Simulate it; ``progress`` is called from time to time with the trace so far."""
        return simulate(
            self.scheme,
            self.plant,
            self.z0,
            self.steps,
            progress=progress,
            sensor=self.sensor,
            actuator=self.actuator,
            load=self.load,
            applied_known=self.applied_known,
        )


def linear_example(*, printed: bool = False) -> Experiment:
    """Return the linear example, equation (23), figures 2 to 6; the paper's source has no samples of figure 3.

    By default it has the settings behind the published curves, eps(k) = 1/(1+100k); ``printed`` uses the text's
    1/(1+1000k). Settings that the text does not specify (initial model, one step of delay between estimate and control)
    are the same in both.

    Examples
    --------
    >>> trace = linear_example().run()
    >>> bool(np.abs(trace.y[:14, 0] - curve("linear_y")[:14]).max() < 1e-9)
    True
    """
    plant = LinearPlant(
        F=np.array([[0, 1, 0.1], [0, 1.02, 0], [0, 0, 0.92]]), G=np.array([[0], [1], [0]]), H=np.array([[1, 0, 1]])
    )
    scheme = Scheme(
        lifting=DelayLifting(outputs=4, inputs=4),
        estimator=ProximalEstimator(window=8),
        controller=Controller(
            Q=100.0, R=10000.0, QN=100.0, horizon=20, epsilon=PowerDecay(1000 if printed else 100), model_delay=1
        ),
        initial_model=SignalModel.companion_of_ones(4, 4),
    )
    return Experiment("linear example", plant, np.array([0.1, 0.1, -10.0]), scheme, steps=42)


def robot_arm(*, printed: bool = False) -> Experiment:
    """Return the robot arm, equation (24), figures 7 to 9.

    The coefficients are those of the published curves or, ``printed``, those in the text. The scheme is the
    same, with the constant mixing lambda = 0.5 that the text does not mention.

    Examples
    --------
    >>> trace = robot_arm().run()
    >>> bool(np.abs(trace.z[:, 0] - curve("robot_x1")).max() < 1e-9)
    True
    """
    scheme = Scheme(
        lifting=DelayLifting(outputs=2, inputs=2),
        estimator=ProximalEstimator(window=10),
        controller=Controller(Q=10.0, R=100.0, QN=10.0, horizon=15, epsilon=PowerDecay(10), model_delay=1),
        initial_model=SignalModel.companion_of_ones(6, 2, "eye-last-row-of-ones"),
        mixing=ConstantMixing(0.5),
    )
    plant = RobotArm("printed" if printed else "data")
    return Experiment("robot arm", plant, np.array([5.0, -5.0, 1.0]), scheme, steps=62)


def replay_published(*, printed: bool = False) -> Trace:
    """Run the linear example's scheme on the published outputs and inputs instead of on a plant.

    Examples
    --------
    >>> bool(np.abs(replay_published().y_hat[:, 0] - curve("linear_y_hat")).max() < 1e-10)
    True
    """
    scheme = linear_example(printed=printed).scheme
    y, v = curve("linear_y"), curve("linear_u")
    return Trace.of_steps(scheme, replay(scheme, y[:, None], v[:, None]))


@dataclass(frozen=True)
class Comparison:
    """The distance of one signal from its published curve over some samples.

    ``largest`` is the largest absolute difference, relative for Gamma/eps, and ``at`` the k where it is. ``tolerance``
    is None if the difference is known and unexplained.
    """

    signal: str
    samples: int
    largest: float
    at: int
    tolerance: float | None

    @property
    def verdict(self) -> str:
        """Return "within", "missed" or "unexplained"."""
        if self.tolerance is None:
            return "unexplained"
        return "within" if self.largest <= self.tolerance else "missed"


# Published numbers have 15 digits; the unstable pole and the estimator's transients enlarge their rounding.
_FREE_RUN = 1e-9
# Two digits above the effect of the three unexplained inputs of k = 12, 13, 14.
_AFTER_THE_UNEXPLAINED = 0.11
_FED_BACK = 1e-10
_RELATIVE = 1e-12
UNEXPLAINED = (12, 13, 14)


def compare_linear(trace: Trace, *, printed: bool = False) -> list[Comparison]:
    """Compare a free run of the linear example, and its scheme with published data fed back, with figures 2, 4, 5, 6.

    Examples
    --------
    >>> {row.verdict for row in compare_linear(linear_example().run())} == {"within", "unexplained"}
    True
    """
    check_length(trace, 42, 3)
    back = replay_published(printed=printed)
    rows = []
    for signal, found, name, last in (
        ("y", trace.y[:, 0], "linear_y", 13),
        ("y_hat", trace.y_hat[:, 0], "linear_y_hat", 12),
        ("v", trace.v_computed[:, 0], "linear_u", 11),
        ("x1", trace.z[:, 0], "linear_x1", 13),
    ):
        gap = np.abs(found[: len(curve(name))] - curve(name))
        rows.append(_largest(f"{signal}, k <= {last}", gap, np.arange(last + 1), _FREE_RUN))
        rows.append(_largest(f"{signal}, k > {last}", gap, np.arange(last + 1, len(gap)), _AFTER_THE_UNEXPLAINED))
    gap = np.abs(gamma_over_eps(printed=printed) / curve("linear_gamma_over_eps") - 1)
    rows.append(_largest("Gamma/eps from published y, v", gap, np.arange(len(gap)), _RELATIVE))
    gap = np.abs(back.y_hat[:, 0] - curve("linear_y_hat"))
    rows.append(_largest("y_hat, published data fed back", gap, np.arange(len(gap)), _FED_BACK))
    gap = np.abs(back.v_computed[:, 0] - curve("linear_u"))
    if printed:
        rows.append(_largest("v, published data fed back", gap, np.arange(len(gap)), _FED_BACK))
    else:
        others = np.setdiff1d(np.arange(len(gap)), UNEXPLAINED)
        rows.append(_largest("v, fed back, but k = 12, 13, 14", gap, others, _FED_BACK))
        rows.append(_largest("v, fed back, k = 12, 13, 14", gap, np.array(UNEXPLAINED), None))
    return rows


def compare_robot(trace: Trace) -> list[Comparison]:
    """Compare a free run of the robot arm with figures 7 to 9, all samples.

    Examples
    --------
    >>> [row.verdict for row in compare_robot(robot_arm().run())]
    ['within', 'within', 'within']
    """
    check_length(trace, 62, 3)
    gaps = [np.abs(trace.z[:, i] - curve(f"robot_x{i + 1}")) for i in range(3)]
    return [_largest(f"x{i + 1}", gap, np.arange(len(gap)), _FREE_RUN) for i, gap in enumerate(gaps)]


def check_length(trace: Trace, steps: int, n: int) -> None:
    """Refuse a trace with another number of steps or states."""
    instance("trace", trace, Trace)
    if len(trace) != steps or trace.z.shape != (steps, n):
        raise InputError(f"trace must be a run of {steps} steps with {n} states, got {len(trace)} steps")


def gamma_over_eps(*, printed: bool = False) -> Array:
    r"""Compute figure 6, shape (41,), from the published outputs and inputs.

    In the figure, Gamma uses the inputs one step later than in the controller:
    :math:`(|y(k)|^2 + \dots + |y(k-3)|^2 + |v(k)|^2 + |v(k-1)|^2 + |v(k-2)|^2) / \epsilon(k)`.
    ``printed``: take the text's eps rate, 1000, instead of the data's, 100.

    Examples
    --------
    >>> bool(np.abs(gamma_over_eps() / curve("linear_gamma_over_eps") - 1).max() < 1e-12)
    True
    """
    y, v = curve("linear_y"), curve("linear_u")
    epsilon = linear_example(printed=printed).scheme.controller.epsilon
    squares = sum(np.concatenate([np.zeros(i), (s**2)[: len(s) - i]]) for s, n in ((y, 4), (v, 3)) for i in range(n))
    return np.asarray(squares) / np.array([epsilon(k) for k in range(len(y))])


def _largest(
    signal: str, gap: Array, at: np.ndarray[tuple[int], np.dtype[np.int64]], tolerance: float | None
) -> Comparison:
    # NaN is larger than anything here, and argmax finds it first.
    k = int(at[np.argmax(gap[at])])
    return Comparison(signal, len(at), float(gap[k]), k, tolerance)
