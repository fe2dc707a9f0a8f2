"""The diagnosis: each assumption broken by one plant or one setting, and named then, and only then."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from rhl.app.diagnosis import Diagnosis, Finding, diagnose, diagnose_run
from rhl.basis import Polynomials
from rhl.controllability import LambdaSearch
from rhl.disturbances import GaussianNoise, Offset, Saturation
from rhl.errors import AssumptionWarning, DivergedError, InputError
from rhl.estimator import ProximalEstimator
from rhl.lifting import DelayLifting
from rhl.losses import CustomLoss, LogCosh, Varying, WeightedSquares
from rhl.model import SignalModel
from rhl.paper.claims.theorem_4 import family_scheme
from rhl.paper.published import linear_example, robot_arm
from rhl.plants import FunctionPlant, LinearPlant, RobotArm
from rhl.plants.examples import example
from rhl.schedules import Constant
from rhl.scheme import default_scheme, window_scheme
from rhl.simulation import simulate
from rhl.tracking import SetPoint

PLANT = LinearPlant([[1.1, 1.0], [0.0, 0.9]], [[0.0], [1.0]], [[1.0, 0.0]])
SCHEME = window_scheme(1, 1, 2)


def verdicts(diagnosis):
    return {finding.subject: finding.verdict for finding in diagnosis.findings}


def unmet(diagnosis):
    return [finding.subject for finding in diagnosis.findings if finding.verdict in ("violated", "suspect")]


def says(diagnosis, subject):
    return next(finding.says for finding in diagnosis.findings if finding.subject == subject)


def quietly(make):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AssumptionWarning)
        return make()


def shortened(scheme):
    return replace(scheme, controller=replace(scheme.controller, horizon=2))


def dead(scheme):
    return replace(scheme, initial_model=SignalModel(scheme.initial_model.A, 0 * scheme.initial_model.B))


def with_estimator(**settings):
    return lambda scheme: quietly(lambda: replace(scheme, estimator=ProximalEstimator(4, **settings)))


def constant(scheme):
    return quietly(lambda: replace(scheme, controller=replace(scheme.controller, epsilon=Constant(0.1))))


def test_a_sound_plant_and_scheme():
    found = diagnose(PLANT, SCHEME)
    assert found.sound
    assert unmet(found) == []
    assert len(found.findings) >= 10


@pytest.mark.parametrize(
    ("plant", "subject", "words"),
    [
        (
            LinearPlant([[1.1, 0.0], [0.0, 0.5]], [[0.0], [1.0]], [[1.0, 1.0]]),
            "Assumption 1, stabilizable",
            "the input does not reach the mode 1.1",
        ),
        (
            LinearPlant([[1.1, 0.0], [0.0, 0.5]], [[1.0], [1.0]], [[0.0, 1.0]]),
            "Assumption 1, detectable",
            "the outputs do not see the mode 1.1",
        ),
        (
            LinearPlant(np.eye(3, k=1) + 0.5 * np.eye(3), [[0.0], [0.0], [1.0]], [[1.0, 0.0, 0.0]]),
            "Assumption 1, m >= n",
            "the observability index is 3",
        ),
        (
            FunctionPlant(lambda z, v: [z[0] + 1.0 + v[0], 0.0], lambda z: z[:1], n=2, q=1),
            "Plant",
            "it cannot be linearised at zero: z = 0 with v = 0 must be an equilibrium, where a step leaves z "
            "unchanged, got a step that moves z by 1; solve step(z, v) = z for one first",
        ),
    ],
    ids=["unstabilizable", "undetectable", "too-short", "no-equilibrium"],
)
def test_a_plant_that_breaks_one_assumption(plant, subject, words):
    found = diagnose(plant, SCHEME)
    assert unmet(found) == [subject]
    assert words in says(found, subject)


@pytest.mark.parametrize(
    ("change", "subject"),
    [
        (shortened, "Assumption 3, N >= n"),
        (dead, "Theorem 2(iii), initial model controllable"),
        (constant, "Theorem 1, epsilon(k) -> 0"),
        (with_estimator(generator=LogCosh()), "Lemma 4, D convex in its second argument"),
    ],
)
def test_settings_that_break_one_assumption(change, subject):
    assert unmet(diagnose(PLANT, change(SCHEME))) == [subject]


def test_a_function_of_the_users_is_suspect_until_they_say_more():
    def own(**facts):
        return with_estimator(generator=CustomLoss(lambda x: x @ x, lambda x: 2 * x, **facts))(SCHEME)

    assert unmet(diagnose(PLANT, own())) == ["Assumption 6, generator", "Lemma 4, D convex in its second argument"]
    assert diagnose(PLANT, own(assumption_6=True, convex_in_second=True)).sound


def test_as_many_delays_as_states_need_no_index():
    plant = LinearPlant([[1.1, 1.0], [0.0, 0.5]], [[0.0], [1.0]], [[1.0, 0.0]])
    found = says(diagnose(plant, window_scheme(1, 1, 2)), "Assumption 1, m >= n")
    assert found == "N_y = 2 outputs and N_v = 2 inputs are stacked, n = 2"


def test_the_observability_index_is_enough():
    found = diagnose(RobotArm(), robot_arm().scheme)
    assert verdicts(found)["Assumption 1, m >= n"] == "met"
    assert "m reaches the observability index 1" in says(found, "Assumption 1, m >= n")
    assert "linearisation" in says(found, "Plant")


def test_what_the_theory_does_not_treat_is_outside():
    scheme = replace(SCHEME, controller=replace(SCHEME.controller, adaptive=True))
    found = diagnose(PLANT, scheme, sensor=GaussianNoise(0.1, 0), actuator=Saturation(-1.0, 1.0))
    outside = [finding.subject for finding in found.findings if finding.verdict == "outside"]
    assert outside == ["Adaptive weight", "Sensor", "Actuator"]
    lifting = DelayLifting(2, 2, Polynomials(2))
    wide = replace(
        scheme,
        lifting=lifting,
        initial_model=SignalModel.companion_of_ones(5, 2),
        controller=replace(SCHEME.controller, horizon=20),
    )
    assert "Basis functions" in unmet_or_outside(diagnose(PLANT, wide))
    varying = replace(SCHEME, estimator=ProximalEstimator(4, Varying(lambda k: WeightedSquares(0.9**k))))
    assert verdicts(diagnose(PLANT, varying))["Assumption 6, loss"] == "note"


def unmet_or_outside(diagnosis):
    return [finding.subject for finding in diagnosis.findings if finding.verdict not in ("met", "note")]


def test_a_run_that_went_well():
    found = diagnose_run(simulate(SCHEME, PLANT, [1.0, -1.0], 60))
    assert found.sound
    assert "every estimate within" in says(found, "Certificates")


def test_a_run_that_needs_longer():
    assert unmet(diagnose_run(simulate(SCHEME, PLANT, [1.0, -1.0], 12)))[0] == "State and input go to zero in this run"


def test_what_is_suspect_below_is_pointed_at_where_there_is_any():
    goes = "State and input go to zero in this run"
    seen = set()
    for steps in (6, 12):
        found = diagnose_run(simulate(SCHEME, PLANT, [1.0, -1.0], steps))
        below = unmet(found)[1:]
        assert unmet(found)[0] == goes
        assert ("read the suspect findings below" in says(found, goes)) == bool(below)
        seen.add(bool(below))
    assert seen == {True, False}


def test_a_run_under_noise_has_no_linear_model():
    trace = simulate(SCHEME, PLANT, [1.0, -1.0], 60, sensor=GaussianNoise(0.05, 1))
    assert "Assumption 7, a linear model of the run's signals exists" in unmet(diagnose_run(trace))


def test_a_nonlinear_run_has_no_linear_model():
    assert "Assumption 7, a linear model of the run's signals exists" in unmet(diagnose_run(robot_arm().run()))
    assert verdicts(diagnose_run(linear_example().run()))[
        "Assumption 7, a linear model of the run's signals exists"
    ] == ("met")


def test_lost_margins_are_named_with_their_step():
    trace = simulate(dead(SCHEME), PLANT, [1.0, -1.0], 20)
    found = diagnose_run(trace)
    lost = trace.k[trace.margin_lifted < 1e-9]
    assert lost[0] == 0
    assert f"at {len(lost)} of 20 steps, first at k = 0" in says(
        found, "Theorem 2(iii), lifted pair stays controllable"
    )


def test_a_run_that_stopped_early_can_be_looked_at():
    far = LinearPlant([[1e40]], [[0.0]], [[1.0]])
    with pytest.raises(DivergedError) as caught:
        simulate(window_scheme(1, 1, 1), far, [1.0], 50)
    found = diagnose_run(caught.value.trace)
    assert "State and input go to zero in this run" in unmet(found)


def test_large_gains_are_suspect():
    scheme = replace(
        SCHEME,
        initial_model=SignalModel([[0.0, 1.0], [1.0, 1.0]], [[0.0, 0.0], [1e-7, 0.0]]),
        controller=replace(SCHEME.controller, R=1e-20, epsilon=lambda k: 1e-18),
    )
    assert "Assumption 5(b), bounded gains of V1" in unmet(diagnose_run(simulate(scheme, PLANT, [1.0, -1.0], 3)))


def test_the_search_has_its_own_idea_of_controllable():
    searching = replace(SCHEME, mixing=LambdaSearch(least_margin=0.1))
    assert "lambda is searched" in says(diagnose(PLANT, searching), "Theorem 2(iii), initial model controllable")
    assert "not enforced" in says(diagnose(PLANT, SCHEME), "Theorem 2(iii), initial model controllable")


def test_disturbances_are_named_in_order():
    both = (GaussianNoise(0.1, 0), Saturation(-1.0, 1.0))
    (found,) = (finding for finding in diagnose(PLANT, SCHEME, sensor=both).findings if finding.subject == "Sensor")
    assert found.says == "GaussianNoise and Saturation acts between scheme and plant; the theory has none"


def test_it_prints_a_line_for_each_finding():
    found = diagnose(PLANT, SCHEME)
    assert len(str(found).splitlines()) == len(found.findings)


@pytest.mark.parametrize(
    ("act", "sentence"),
    [
        (lambda: diagnose(example("quadruple-tank").plant, SCHEME), "the plant must have 1 outputs.* got 2"),
        (
            lambda: diagnose_run(simulate(SCHEME, PLANT, np.ones((3, 2)), 5)),
            r"must be of one run, got a batch of shape",
        ),
        (lambda: Diagnosis((Finding("x", "fine", "y"),)), "verdict must be one of met, .* got 'fine'"),
    ],
)
def test_refused(act, sentence):
    with pytest.raises(InputError, match=sentence):
        act()


FAST = LinearPlant([[2.0, 1.0], [0.0, 1.8]], [[0.0], [1.0]], [[1.0, 0.0]])


def test_a_peak_is_predicted_from_the_plant_left_alone():
    scheme, z0 = default_scheme(1, 1, 2), np.array([1.0, 0.5])
    found = {of.subject: of for of in diagnose(FAST, scheme, z0=z0).findings}["Peak to expect"]
    z, growth = z0, []
    for _ in range(6):  # m + n + m q
        z = FAST.F @ z
        growth.append(abs(z[0]))
    assert found.verdict == "suspect"
    assert f"the outputs grow {max(growth):.3g} times in the 6 steps" in found.says
    peak = np.abs(simulate(scheme, FAST, z0, 60).y).max()
    assert max(growth) / 10 < peak < 10 * max(growth)
    assert "sample faster" in found.says
    slow = verdicts(diagnose(PLANT, scheme, z0=[1.0, -1.0]))
    assert slow["Peak to expect"] == "note"


def test_a_peak_is_not_predicted_where_the_scheme_knows_something():
    scheme = default_scheme(1, 1, 2)
    told = replace(scheme, units=replace(scheme.units, model_in_sizes=False))
    for other in (told, SCHEME, replace(scheme, set_point=SetPoint(0.0))):
        assert "Peak to expect" not in verdicts(diagnose(FAST, other, z0=[1.0, 0.5]))
    for z0 in (None, [0.0, 0.0]):
        assert "Peak to expect" not in verdicts(diagnose(FAST, scheme, z0=z0))
    with pytest.raises(InputError, match=r"z0 must have shape \(2,\)"):
        diagnose(FAST, scheme, z0=[1.0])


def test_a_set_point_that_no_input_holds():
    tank = example("quadruple-tank").plant
    for plant, q, verdict in ((tank, 2, "met"), (LinearPlant(tank.F, tank.G[:, :1], tank.H), 1, "violated")):
        found = diagnose(plant, default_scheme(2, q, 2, set_point=SetPoint([0.5, -0.25])))
        assert verdicts(found)["Set point, an equilibrium"] == verdict
    with_one = default_scheme(2, 2, 2, set_point=SetPoint([0.5, -0.25]))
    assert "hold the outputs at it" in says(diagnose(tank, with_one), "Set point, an equilibrium")


def test_a_run_with_a_set_point_is_judged_by_outputs_and_increments():
    tank = example("quadruple-tank").plant
    scheme = default_scheme(2, 2, 2, set_point=SetPoint([0.5, -0.25]))
    run = simulate(scheme, tank, np.zeros(4), 100)
    found = diagnose_run(run)
    assert verdicts(found)["Set point"] == "met"
    moves = np.abs(np.diff(run.v, axis=0)).max(axis=1)
    assert f"|v(k) - v(k-1)| there {moves[-10:].max():.3g}" in says(found, "Set point")
    assert "|y - r|" in says(found, "Set point")
    plain = diagnose_run(simulate(default_scheme(2, 2, 2), tank, np.ones(4), 100, load=Offset(0.4)))
    assert verdicts(plain)["State and input go to zero in this run"] == "suspect"


def test_steps_at_a_bound_are_counted():
    actuator = Saturation(-0.5, 0.5)
    planned = simulate(default_scheme(1, 1, 2, bounds=actuator), PLANT, [1.0, -1.0], 60, actuator=actuator)
    count = np.sum(np.abs(planned.v[:, 0]) > 0.5 - 1e-6)
    assert count > 0
    assert f"at a bound of the actuator in {count} of 60 steps" in says(diagnose_run(planned), "Input bounds")
    clipped = simulate(default_scheme(1, 1, 2), PLANT, [1.0, -1.0], 60, actuator=actuator)
    changed = np.sum(clipped.v != clipped.v_computed)
    assert f"changed by the actuator in {changed} of 60 steps" in says(diagnose_run(clipped), "Input bounds")
    assert "Input bounds" not in verdicts(diagnose_run(simulate(default_scheme(1, 1, 2), PLANT, [1.0, -1.0], 60)))


def test_a_high_peak_is_suspect_and_names_what_to_turn():
    start = [1.0, 0.5]
    blind = diagnose_run(simulate(default_scheme(1, 1, 4), FAST, start, 80))
    assert verdicts(blind)["Peak of the outputs"] == "suspect"
    assert "lower order if it is above the observability index, or begin from a [rough]" in says(
        blind, "Peak of the outputs"
    )
    window = diagnose_run(simulate(SCHEME, FAST, start, 80))
    assert "give order in place of [lifting]" in says(window, "Peak of the outputs")
    quiet = diagnose_run(simulate(default_scheme(1, 1, 2), PLANT, [1.0, -1.0], 80))
    assert "Peak of the outputs" not in verdicts(quiet)


def test_hints_where_a_run_did_not_end_at_rest():
    subject = "State and input go to zero in this run"
    short = simulate(default_scheme(1, 1, 2), PLANT, [1.0, -1.0], 8)
    assert "not converged yet: run more steps" in says(diagnose_run(short), subject)
    noisy = simulate(default_scheme(1, 1, 2), PLANT, [1.0, -1.0], 80, sensor=GaussianNoise(0.02, 1))
    assert "set noise to their standard deviation" in says(diagnose_run(noisy), subject)
    told = simulate(default_scheme(1, 1, 2, noise=0.02), PLANT, [1.0, -1.0], 80, sensor=GaussianNoise(0.02, 1))
    assert "standard deviation" not in says(diagnose_run(told), subject)
    deaf = LinearPlant([[1.2, 0.0], [0.0, 0.5]], [[0.0], [1.0]], [[1.0, 1.0]])
    assert "it grew: lower order" in says(
        diagnose_run(simulate(default_scheme(1, 1, 2), deaf, [1.0, 0.5], 60)), subject
    )
    window = simulate(SCHEME, deaf, [1.0, 0.5], 60)
    assert "it grew: give order in place of" in says(diagnose_run(window), subject)


def test_s_plus_is_reported_and_suspect_where_it_is_lost():
    example = linear_example()
    run = simulate(example.scheme, example.plant, example.z0, 40)
    (found,) = (one for one in diagnose_run(run).findings if one.subject == "Theorem 1*, inf s+ > 0")
    assert found.verdict == "met"
    assert f"{np.min(run.s_plus):.3g} over the run" in found.says
    lost = replace(run.models, model=run.models.model * np.where(np.arange(8) < 4, 1.0, 1e-10))
    run = replace(run, models=lost)
    (found,) = (one for one in diagnose_run(run).findings if one.subject == "Theorem 1*, inf s+ > 0")
    assert found.verdict == "suspect"


def test_s_plus_that_is_infinite_or_unknown_is_said_so():
    silent = simulate(family_scheme(1, 1, 1, alone=True), LinearPlant([[0.5]], [[1.0]], [[1.0]]), [1.0], 12)
    (found,) = (one for one in diagnose_run(silent).findings if one.subject == "Theorem 1*, inf s+ > 0")
    assert found.verdict == "met"
    assert "none was planned" in found.says
    example = linear_example()
    run = simulate(example.scheme, example.plant, example.z0, 20)
    lost = np.array(run.models.model)
    lost[7:] *= 1e300
    with np.errstate(over="ignore", invalid="ignore"):
        findings = diagnose_run(replace(run, models=replace(run.models, model=lost))).findings
    (found,) = (one for one in findings if one.subject == "Theorem 1*, inf s+ > 0")
    assert found.verdict == "suspect"
    assert "left the range" in found.says


def test_a_run_of_zeros_is_diagnosed_without_a_division_by_zero():
    """At rest every transition is zero; the share that a linear model does not explain is then not computed."""
    plant = LinearPlant([[0.5]], [[1.0]], [[1.0]])
    with np.errstate(all="raise"):
        found = diagnose_run(simulate(default_scheme(1, 1, 1), plant, [0.0], 40))
    assert not any("Assumption 7" in finding.subject for finding in found.findings)
    moving = diagnose_run(simulate(default_scheme(1, 1, 1), plant, [1.0], 40))
    assert any("Assumption 7" in finding.subject for finding in moving.findings)


def test_a_set_point_is_judged_by_its_size():
    tank = example("quadruple-tank").plant
    unheld = replace(tank, G=tank.G[:, :1])
    for size in (1e-12, 1e-6, 1.0, 1e9, 1e12):
        for plant, q, verdict in ((tank, 2, "met"), (unheld, 1, "violated")):
            found = diagnose(plant, default_scheme(2, q, 2, set_point=SetPoint([0.5 * size, -0.25 * size])))
            assert verdicts(found)["Set point, an equilibrium"] == verdict, (size, q)
