"""Both simulations of the paper against its figure data, and what is missed with other settings."""

from dataclasses import replace

import numpy as np
import pytest

from rhl.closed_loop import replay
from rhl.controllability import ConstantMixing
from rhl.errors import InputError
from rhl.estimator import ProximalEstimator
from rhl.horizon import solve
from rhl.model import SignalModel
from rhl.paper.published import (
    CURVES,
    UNEXPLAINED,
    Comparison,
    compare_linear,
    compare_robot,
    curve,
    gamma_over_eps,
    linear_example,
    replay_published,
    robot_arm,
)
from rhl.schedules import PowerDecay
from rhl.simulation import simulate
from rhl.trace import Trace
from tests import oracle

# Published digits end at the 15th; the unstable pole and the transients of the estimator enlarge what is missing.
FREE_RUN = 1e-9
# After the three unexplained inputs of k = 12, 13, 14 a free run is another run; the difference is shown and dies out.
AFTER_UNEXPLAINED = 0.11
# With the published data fed back, no error is carried from step to step.
FED_BACK = 1e-10
# Figure 6 is a sum of seven squares of 15-digit numbers.
RELATIVE = 1e-12
# What counts as a miss: a hundred thousand times the tolerance of fed-back data. A per cent of a weight does as much.
MISSED = 1e-5


def gap(found, name):
    published = curve(name)
    return np.abs(found[: len(published)] - published)


@pytest.fixture(scope="module")
def linear():
    return linear_example().run()


@pytest.fixture(scope="module")
def back():
    return replay_published()


@pytest.fixture(scope="module")
def robot():
    return robot_arm().run()


# The data

ROBOT = ["robot_x1", "robot_x2", "robot_x3"]


@pytest.mark.parametrize(
    ("name", "samples", "first", "last"),
    [
        ("linear_y", 41, -9.9, 0.000337892829416888),
        ("linear_y_hat", 41, -9.9, None),
        ("linear_u", 41, 3.80906716908506, None),
        ("linear_x1", 42, 0.1, None),
        ("linear_gamma_over_eps", 41, 112.518992698602, None),
        ("robot_x1", 62, 5.0, None),
        ("robot_x2", 62, -5.0, None),
        ("robot_x3", 62, 1.0, None),
    ],
)
def test_curves(name, samples, first, last):
    assert curve(name).shape == (samples,)
    assert curve(name)[0] == first
    assert np.all(np.isfinite(curve(name)))


def test_curves_are_those_named():
    assert list(CURVES) == [*(f"linear_{name}" for name in ("y", "y_hat", "u", "x1", "gamma_over_eps")), *ROBOT]
    with pytest.raises(InputError, match=r"name must be one of linear_y, .*, got 'linear_z'"):
        curve("linear_z")


def test_published_linear_curves_obey_the_plant():
    """The published u drives the plant of equation (23) along the published y and x1, so the curves belong together."""
    plant, z, u = linear_example().plant, linear_example().z0, curve("linear_u")
    for k in range(41):
        # x1 integrates, so that the roundings of 41 published inputs add up.
        assert z[0] == pytest.approx(curve("linear_x1")[k], abs=1e-11)
        assert plant.output(z)[0] == pytest.approx(curve("linear_y")[k], abs=1e-11)
        z = plant.step(z, u[k : k + 1])


# The linear example, free run


@pytest.mark.parametrize(
    ("signal", "name", "last"), [("y", "linear_y", 13), ("y_hat", "linear_y_hat", 12), ("v", "linear_u", 11)]
)
def test_linear_free_run(linear, signal, name, last):
    difference = gap(getattr(linear, signal)[:, 0], name)
    assert len(difference) == 41
    assert np.max(difference[: last + 1]) <= FREE_RUN
    assert np.max(difference[last + 1 :]) <= AFTER_UNEXPLAINED
    # One sample more is already missed: the bound on k is the right one.
    assert difference[last + 1] > 1000 * FREE_RUN
    assert np.max(difference[-3:]) < 1e-2


def test_linear_x1(linear):
    difference = gap(linear.z[:, 0], "linear_x1")
    assert np.max(difference[:14]) <= FREE_RUN
    assert np.max(difference[14:]) <= AFTER_UNEXPLAINED


def test_linear_state_is_brought_down(linear):
    assert np.linalg.norm(linear.z[-1]) < 1
    assert np.linalg.norm(linear.z[0]) > 10


# The linear example, published data fed back


def test_fed_back_predictions(back):
    assert len(back) == 41
    assert np.max(gap(back.y_hat[:, 0], "linear_y_hat")) <= FED_BACK


def test_fed_back_inputs(back):
    difference = gap(back.v_computed[:, 0], "linear_u")
    others = np.setdiff1d(np.arange(41), UNEXPLAINED)
    assert UNEXPLAINED == (12, 13, 14)
    assert len(others) == 38
    assert np.max(difference[others]) <= FED_BACK


# Recipe minus published, in extended precision too, as this project observed it; to the digits it was noted with.
@pytest.mark.parametrize(("k", "noted"), [(12, -0.0052466), (13, 0.0662656), (14, 0.0540794)])
def test_unexplained_inputs_are_no_rounding(back, k, noted):
    done, noted_digits = back.steps[k], 1e-7
    exact = oracle.first_input(done.problem, done.plan.x[0])
    assert back.v_computed[k, 0] - curve("linear_u")[k] == pytest.approx(noted, abs=noted_digits)
    assert float(exact[0]) - curve("linear_u")[k] == pytest.approx(noted, abs=noted_digits)


def test_figure_6():
    relative = np.abs(gamma_over_eps() / curve("linear_gamma_over_eps") - 1)
    assert len(relative) == 41
    assert np.max(relative) <= RELATIVE


def test_figure_6_takes_gamma_one_input_later_than_the_controller(back):
    """The controller's own weight, one input earlier, is not the published one."""
    assert np.max(np.abs(back.weight / curve("linear_gamma_over_eps") - 1)) > 0.1


def test_every_input_of_the_fed_back_run_certifies_itself(back):
    # 1e-16 times what a closed loop of twenty predicted steps lets it grow.
    assert max(done.plan.residual() for done in back.steps) < 1e-12


# What other settings do: the checks above can fail


def refeed(scheme):
    y, v = curve("linear_y"), curve("linear_u")
    return Trace.of_steps(scheme, replay(scheme, y[:, None], v[:, None]))


def control(**changes):
    scheme = linear_example().scheme
    return replace(scheme, controller=replace(scheme.controller, **changes))


OTHER_SETTINGS = {
    "eps as printed": lambda: linear_example(printed=True).scheme,
    "eps 99": lambda: control(epsilon=PowerDecay(99.0)),
    "no lag": lambda: control(model_delay=0),
    "horizon 19": lambda: control(horizon=19),
    "R 9999": lambda: control(R=9999.0),
    "QN 101": lambda: control(QN=101.0),
    "alpha 1.01": lambda: control(alpha=1.01),
    "lambda 0.01": lambda: replace(linear_example().scheme, mixing=ConstantMixing(0.01)),
    "window 7": lambda: replace(linear_example().scheme, estimator=ProximalEstimator(7)),
    "other B(0)": lambda: replace(
        linear_example().scheme, initial_model=SignalModel.companion_of_ones(4, 4, "eye-last-row-of-ones")
    ),
}


@pytest.mark.parametrize("name", OTHER_SETTINGS)
def test_other_settings_miss_the_published_inputs(name):
    difference = gap(refeed(OTHER_SETTINGS[name]()).v_computed[:, 0], "linear_u")
    assert np.max(np.delete(difference, UNEXPLAINED)) > MISSED


@pytest.mark.parametrize("name", ["lambda 0.01", "window 7", "other B(0)"])
def test_other_estimators_miss_the_published_predictions(name):
    assert np.max(gap(refeed(OTHER_SETTINGS[name]()).y_hat[:, 0], "linear_y_hat")) > MISSED


def test_without_the_lag_the_second_input_is_off_by_25():
    assert gap(refeed(OTHER_SETTINGS["no lag"]()).v_computed[:, 0], "linear_u")[1] == pytest.approx(25, abs=1)


def test_linear_as_printed():
    """With eps(k) = 1/(1+1000k) the inputs are off by half at k = 13, and figure 6 by a factor of ten."""
    back = replay_published(printed=True)
    assert gap(back.v_computed[:, 0], "linear_u")[13] == pytest.approx(0.5, abs=0.1)
    factor = gamma_over_eps(printed=True)[1:] / curve("linear_gamma_over_eps")[1:]
    assert np.all((factor > 9.9) & (factor < 10))
    # The estimator does not know eps.
    assert np.max(gap(back.y_hat[:, 0], "linear_y_hat")) <= FED_BACK
    free = linear_example(printed=True).run()
    assert np.max(gap(free.v[:, 0], "linear_u")[:12]) > 1e-3


# The robot arm


@pytest.mark.parametrize("i", [1, 2, 3])
def test_robot_free_run(robot, i):
    difference = gap(robot.z[:, i - 1], f"robot_x{i}")
    assert len(difference) == len(robot) == 62
    assert np.max(difference) <= FREE_RUN


def test_robot_inputs_are_as_noted(robot):
    """The input was not published; this is what the recipe gives."""
    noted = [0.493269682199, -1.393085710522, -0.567230026354, -0.869494697665, -1.590159035660]
    np.testing.assert_allclose(robot.v[:5, 0], noted, atol=1e-12)
    assert np.min(robot.v) == pytest.approx(-15.26, abs=0.005)
    assert np.max(robot.v) == pytest.approx(12.22, abs=0.005)


def robot_with(*, mixing=None, **changes):
    example = robot_arm()
    scheme = replace(example.scheme, controller=replace(example.scheme.controller, **changes))
    scheme = replace(scheme, mixing=mixing or scheme.mixing)
    return simulate(scheme, example.plant, example.z0, example.steps)


@pytest.mark.parametrize(
    "changes",
    [
        {"mixing": ConstantMixing(0.0)},
        {"mixing": ConstantMixing(0.49)},
        {"model_delay": 0},
        {"epsilon": PowerDecay(11.0)},
        {"R": 101.0},
        {"horizon": 14},
    ],
    ids=lambda changes: " ".join(changes),
)
def test_other_settings_miss_the_robot_curves(changes):
    run = robot_with(**changes)
    assert max(np.max(gap(run.z[:, i], f"robot_x{i + 1}")) for i in range(3)) > MISSED


def test_without_mixing_x2_is_missed_by_23():
    run = robot_with(mixing=ConstantMixing(0.0))
    assert np.max(gap(run.z[:, 1], "robot_x2")) == pytest.approx(23, abs=1)


def test_printed_coefficients_miss_at_once():
    """The published data's own second sample: gravity is 14.4 times smaller than printed, the current's decay 11.6."""
    example = robot_arm(printed=True)
    first = np.array([curve(f"robot_x{i}")[0] for i in (1, 2, 3)])
    second = np.array([curve(f"robot_x{i}")[1] for i in (1, 2, 3)])
    data = robot_arm().plant.step(first, np.array([0.493269682199]))
    printed = example.plant.step(first, np.array([0.493269682199]))
    np.testing.assert_allclose(data, second, atol=1e-11)  # the input has twelve digits
    assert np.abs(printed - second)[1] > 1
    assert np.abs(printed - second)[2] > 1
    run = example.run()
    assert max(np.max(gap(run.z[:, i], f"robot_x{i + 1}")) for i in range(3)) > 1


# The comparison that the command line prints


@pytest.fixture(scope="module")
def rows(linear):
    return compare_linear(linear)


def test_comparison_of_the_linear_example(rows):
    assert {row.verdict for row in rows} == {"within", "unexplained"}
    assert [row.verdict for row in rows].count("unexplained") == 1
    by_name = {row.signal: row for row in rows}
    assert (by_name["y, k <= 13"].samples, by_name["y, k <= 13"].tolerance) == (14, FREE_RUN)
    assert (by_name["y_hat, k <= 12"].samples, by_name["v, k <= 11"].samples) == (13, 12)
    assert by_name["v, k > 11"].tolerance == AFTER_UNEXPLAINED
    assert by_name["v, k > 11"].largest == pytest.approx(0.07, abs=0.01)
    assert by_name["y_hat, published data fed back"].samples == 41
    assert by_name["v, fed back, k = 12, 13, 14"].at == 13


def test_comparison_as_printed_misses():
    rows = compare_linear(linear_example(printed=True).run(), printed=True)
    missed = [row.signal for row in rows if row.verdict == "missed"]
    assert {"v, k <= 11", "Gamma/eps from published y, v", "v, published data fed back"} <= set(missed)


def test_comparison_of_the_robot_arm(robot):
    rows = compare_robot(robot)
    assert [row.verdict for row in rows] == ["within"] * 3
    assert [row.samples for row in rows] == [62] * 3
    printed = compare_robot(robot_arm(printed=True).run())
    assert "missed" in [row.verdict for row in printed]


@pytest.mark.parametrize(
    ("largest", "tolerance", "verdict"),
    [
        (1e-10, 1e-9, "within"),
        (1e-9, 1e-9, "within"),
        (2e-9, 1e-9, "missed"),
        (np.nan, 1e-9, "missed"),
        (1.0, None, "unexplained"),
    ],
)
def test_verdict(largest, tolerance, verdict):
    assert Comparison("y", 1, largest, 0, tolerance).verdict == verdict


def test_a_shifted_curve_is_missed(robot, monkeypatch):
    """One sample moved by ten times the tolerance is found, at its k."""
    moved = curve("robot_x2").copy()
    moved[17] += 10 * FREE_RUN
    monkeypatch.setattr("rhl.paper.published.curve", lambda name: moved if name == "robot_x2" else curve(name))
    rows = compare_robot(robot)
    assert [row.verdict for row in rows] == ["within", "missed", "within"]
    assert rows[1].at == 17


def test_solutions_do_not_depend_on_how_the_weight_is_spelt():
    """A number stands for that multiple of the identity."""
    done = replay_published().steps[7]
    spelt = replace(done.problem, Q=100 * np.eye(7), R=[[10000.0]], QN=100 * np.eye(7))
    assert np.array_equal(solve(spelt, done.plan.x[0]).u, done.plan.u)
