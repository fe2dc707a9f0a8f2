"""The diagnosis: each assumption broken by one plant or one setting, and named then, and only then."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from rhl.app import _after, diagnosis
from rhl.app._known import less_peak
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
from rhl.trace import Trace
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
    assert found == "the last N_y = 2 values of the output and N_v = 2 of the input are stacked, n = 2"


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
        (lambda: diagnose_run(simulate(SCHEME, PLANT, np.ones(2), 5), 3), "^plant must be a plant"),
        (
            lambda: diagnose_run(simulate(SCHEME, PLANT, np.ones(2), 5), example("quadruple-tank").plant),
            "the plant must have 1 outputs.* got 2",
        ),
        (lambda: diagnose(TANK, TRACKS, load=Offset([0.1, 0.2])), "value must be a number or have 1 entries.* got 2"),
        (lambda: diagnose(TANK, TRACKS, actuator=Saturation([-1, -1], [1, 1])), "low must be a number or have 1 ent"),
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


def test_where_a_peak_is_not_predicted_the_finding_says_why():
    scheme = default_scheme(1, 1, 2)
    told = replace(scheme, units=replace(scheme.units, model_in_sizes=False))
    start = [1.0, 0.5]
    for of, z0, why in (
        (told, start, "the scheme begins from a given model, not without one"),
        (SCHEME, start, "the scheme has no running units, which the key order chooses"),
        (default_scheme(1, 1, 2, set_point=SetPoint(0.0)), start, "with a set point the outputs have to move"),
        (scheme, [0.0, 0.0], "the run begins at rest"),
        (scheme, [0.0, 1.0], "a peak is relative to the first outputs, and these are zero"),
    ):
        (found,) = (one for one in diagnose(FAST, of, z0=z0).findings if one.subject == "Peak to expect")
        assert (found.verdict, found.says) == ("note", f"not predicted, since {why}")
    assert "not predicted" not in says(diagnose(FAST, scheme, z0=start), "Peak to expect")
    assert "Peak to expect" not in verdicts(diagnose(FAST, scheme))
    with pytest.raises(InputError, match=r"z0 must have shape \(2,\)"):
        diagnose(FAST, scheme, z0=[1.0])


def test_a_predicted_peak_says_what_it_leaves_out():
    for plant in (FAST, PLANT):
        found = says(diagnose(plant, default_scheme(1, 1, 2), z0=[1.0, 0.5]), "Peak to expect")
        assert "the growth that the inputs cause is not counted, so the peak may be higher" in found


@pytest.mark.parametrize(("growth", "verdict"), [(0.999, "note"), (1.001, "suspect")])
def test_from_which_growth_on_a_peak_is_predicted_to_be_large(growth, verdict):
    plant = LinearPlant([[(30.0 * growth) ** (1 / 3)]], [[1.0]], [[1.0]])  # three steps: m + n + m q
    assert verdicts(diagnose(plant, default_scheme(1, 1, 1), z0=[2.0]))["Peak to expect"] == verdict


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


# 0.5 / (z^5 - 1.1 z^4), an unstable mode behind four delays; its observability index is 5.
LATE = LinearPlant(
    np.eye(5, k=1) + np.diag([0.0, 0.0, 0.0, 0.0, 1.1]), [[0.0], [0.0], [0.0], [0.0], [1.0]], [[0.5, 0, 0, 0, 0]]
)
DEAF = LinearPlant([[1.2, 0.0], [0.0, 0.5]], [[0.0], [1.0]], [[1.0, 1.0]])
BLIND = LinearPlant([[1.2, 0.0], [0.0, 0.5]], [[1.0], [1.0]], [[0.0, 1.0]])
GOES = "State and input go to zero in this run"
ONLY = "a linear model of the run's signals exists"
TANK = LinearPlant([[0.9]], [[0.5]], [[1.0]])  # an input v holds it at 5 v
TRACKS = default_scheme(1, 1, 1, set_point=SetPoint(1.0))


def test_a_run_with_too_low_an_order_asks_for_the_observability_index():
    raised = "raise order to 5, the observability index"
    run = simulate(default_scheme(1, 1, 2), LATE, np.ones(5), 80)
    found = diagnose_run(run, LATE)
    for subject in (GOES, "Peak of the outputs", f"Assumption 7, {ONLY}"):
        assert raised in says(found, subject)
        assert "lower order" not in says(found, subject)
    before = diagnose(LATE, run.scheme, z0=np.ones(5))
    assert raised in says(before, "Assumption 1, m >= n")
    assert says(before, "Peak to expect") == "not predicted, since Assumption 1, m >= n is violated"
    # The controls: it comes to rest with that order, and without the plant the advice is general.
    enough = diagnose_run(simulate(default_scheme(1, 1, 5), LATE, np.ones(5), 80), LATE)
    assert verdicts(enough)[GOES] == "met"
    assert "lower order if it is above" in says(diagnose_run(run), "Peak of the outputs")


def test_which_keys_to_raise_follows_from_the_scheme():
    target = SetPoint(0.0)
    for plant, scheme, raised in (
        (LATE, window_scheme(1, 1, 2), "raise outputs and inputs of [lifting] to 5, the observability index"),
        (LATE, default_scheme(1, 1, 3), "raise order to 5, the observability index (where [lifting]"),
        (LATE, default_scheme(1, 1, 3, set_point=target), "raise order to 4, with which 5 values are stacked"),
        (PLANT, default_scheme(1, 1, 1, set_point=target), "raise order to 2, with which 3 values are stacked"),
    ):
        assert raised in says(diagnose(plant, scheme), "Assumption 1, m >= n")
    for plant, scheme in (
        (LATE, window_scheme(1, 1, 5)),
        (LATE, default_scheme(1, 1, 5)),
        (LATE, default_scheme(1, 1, 4, set_point=target)),
        (PLANT, default_scheme(1, 1, 2, set_point=target)),
    ):
        assert verdicts(diagnose(plant, scheme))["Assumption 1, m >= n"] == "met"


@pytest.mark.parametrize(("plant", "order"), [(LATE, 4), (PLANT, 2)], ids=["delays", "no delay"])
def test_a_set_point_needs_the_last_input_as_a_state(plant, order):
    """With the advised order a run reaches the set point, and with one less it does not."""
    low, enough = (
        simulate(default_scheme(1, 1, of, set_point=SetPoint(1.0)), plant, np.zeros(plant.n), 100)
        for of in (order - 1, order)
    )
    assert verdicts(diagnose_run(enough, plant))["Set point"] == "met"
    assert f"raise order to {order}" in says(diagnose_run(low, plant), "Set point")
    assert "order stacks one more value" in says(diagnose(plant, enough.scheme), "Assumption 1, m >= n")
    assert "order stacks" not in says(diagnose(plant, default_scheme(1, 1, order)), "Assumption 1, m >= n")


@pytest.mark.parametrize(
    ("plant", "words"),
    [
        (DEAF, "the input does not reach the mode 1.2, which does not decay, so no setting can help: only other act"),
        (BLIND, "the outputs do not see the mode 1.2, which does not decay, so no setting can help: only other sens"),
    ],
    ids=["unstabilizable", "undetectable"],
)
def test_no_setting_helps_where_assumption_1_fails(plant, words):
    for scheme in (default_scheme(1, 1, 2), SCHEME):
        run = simulate(scheme, plant, [1.0, 0.5], 60)
        found = diagnose_run(run, plant)
        assert words in says(found, GOES)
        if plant is DEAF:
            assert words in says(found, "Peak of the outputs")
        for finding in found.findings:
            assert "lower order" not in finding.says
            assert "[rough]" not in finding.says
            assert "give order" not in finding.says
        assert words not in says(diagnose_run(run), GOES)
    before = says(diagnose(plant, default_scheme(1, 1, 2), z0=[1.0, 0.5]), "Peak to expect")
    assert before.startswith("not predicted, since Assumption 1, ")


def test_the_advice_for_a_nonlinear_plant_is_about_its_linearisation():
    plant = FunctionPlant(lambda z, v: DEAF.step(z, v), DEAF.output, n=2, q=1)
    run = simulate(default_scheme(1, 1, 2), plant, [1.0, 0.5], 60)
    assert "in the linearisation at zero the input does not reach the mode 1.2" in says(diagnose_run(run, plant), GOES)
    nowhere = FunctionPlant(lambda z, v: [z[0] + 1.0 + v[0], 0.0], lambda z: z[:1], n=2, q=1)
    assert "linearisation" not in says(diagnose_run(run, nowhere), GOES)


def test_a_lower_order_is_advised_where_it_is_above_the_index():
    start, lower = [1.0, 0.5], "lower order to 2, which the observability index allows, or begin from a [rough]"
    high, right = (simulate(default_scheme(1, 1, order), FAST, start, 80) for order in (4, 2))
    peak = "Peak of the outputs"
    assert lower in says(diagnose_run(high, FAST), peak)
    assert lower in says(diagnose(FAST, high.scheme, z0=start), "Peak to expect")
    for found in (
        says(diagnose(FAST, right.scheme, z0=start), "Peak to expect"),
        says(diagnose_run(replace(right, y=right.y * np.where(right.k == 3, 1e3, 1.0)[:, None]), FAST), peak),
    ):
        assert "lower order" not in found
        assert "begin from a [rough] model" in found


def test_a_set_point_out_of_reach_of_the_bounds_is_violated():
    subject, plans = "Set point, an equilibrium", Saturation(-1.0, 1.0)
    for target, verdict in (
        (4.9, "met"),
        (5.0, "met"),
        (5.0 * (1 + 1e-9), "met"),
        (5.01, "violated"),
        (-7.5, "violated"),
    ):
        kept = default_scheme(1, 1, 1, set_point=SetPoint(target), bounds=plans)
        free = default_scheme(1, 1, 1, set_point=SetPoint(target))
        assert verdicts(diagnose(TANK, kept))[subject] == verdict
        assert verdicts(diagnose(TANK, free, actuator=plans))[subject] == verdict
        assert verdicts(diagnose(TANK, free, actuator=(GaussianNoise(0.1, 0), plans)))[subject] == verdict
        assert verdicts(diagnose(TANK, free))[subject] == "met"
    over, under = (default_scheme(1, 1, 1, set_point=SetPoint(of), bounds=plans) for of in (7.5, -7.5))
    words = (
        "input 1 would have to stay at 1.5, above v_max = 1; choose a set point within reach, or widen v_min and v_max"
    )
    assert words in says(diagnose(TANK, over), subject)
    assert "input 1 would have to stay at -1.5, below v_min = -1" in says(diagnose(TANK, under), subject)
    run = simulate(over, TANK, [0.0], 100, actuator=plans)
    assert words in says(diagnose_run(run, TANK, actuator=plans), "Set point")
    assert words not in says(diagnose_run(run), "Set point")


def test_a_load_moves_the_input_that_holds_a_set_point():
    scheme = default_scheme(1, 1, 1, set_point=SetPoint(5.5), bounds=Saturation(-1.0, 1.0))
    subject = "Set point, an equilibrium"
    assert verdicts(diagnose(TANK, scheme))[subject] == "violated"
    helped = diagnose(TANK, scheme, load=Offset(0.2))
    assert says(helped, subject) == "the inputs 0.9 hold the outputs at it under the load"
    assert verdicts(diagnose(TANK, scheme, load=Offset(-0.2)))[subject] == "violated"
    # A load that is not a constant is not counted.
    own = diagnose(TANK, default_scheme(1, 1, 1, set_point=SetPoint(4.5)), load=lambda k, v: v + 0.2)
    assert says(own, subject) == "the inputs 0.9 hold the outputs at it"


def test_of_several_inputs_others_may_hold_a_set_point():
    """The least inputs are 1.2 and 0.4, so the first is too large; with the first at 1, the second has to be 1."""
    subject, plant = "Set point, an equilibrium", LinearPlant([[0.5]], [[0.75, 0.25]], [[1.0]])
    for high, verdict in ((1.0, "met"), (0.99, "violated")):
        scheme = default_scheme(1, 2, 1, set_point=SetPoint(2.0), bounds=Saturation([-1.0, -1.0], [1.0, high]))
        found = diagnose(plant, scheme)
        assert verdicts(found)[subject] == verdict
    assert says(diagnose(plant, default_scheme(1, 2, 1, set_point=SetPoint(2.0))), subject).startswith(
        "the inputs 1.2, 0.4"
    )


def test_what_is_stacked_agrees_with_the_numbers_of_the_state():
    tank = example("quadruple-tank").plant
    found = diagnose(tank, default_scheme(2, 2, 3))
    assert "the last N_y = 3 values of the output vector and N_v = 3 of the input vector are stacked" in says(
        found, "Assumption 1, m >= n"
    )
    assert "x(k) has 6 numbers, N_y = 3 values of 2 outputs, and the plant has order 4" in says(found, "Augmented pair")
    # With a set point the plant has two states more, its inputs, so that six numbers do not exceed its order.
    tracks = default_scheme(2, 2, 2, set_point=SetPoint(0.5))
    assert "Augmented pair" not in verdicts(diagnose(tank, tracks))


def test_a_run_that_began_at_rest_says_nothing():
    for scheme, z0, target in (
        (default_scheme(1, 1, 1), [0.0], ""),
        (default_scheme(1, 1, 1, set_point=SetPoint(0.0)), [0.0], " at its set point"),
    ):
        (only,) = diagnose_run(simulate(scheme, TANK, z0, 40), TANK).findings
        assert only.verdict == "note"
        assert f"the run began at rest{target} and nothing disturbed it, so nothing was excited" in only.says
    moved = [
        simulate(default_scheme(1, 1, 1), TANK, [1e-9], 40),
        simulate(default_scheme(1, 1, 1), TANK, [0.0], 40, sensor=GaussianNoise(0.1, 0)),
        simulate(default_scheme(1, 1, 1, set_point=SetPoint(1.0)), TANK, [0.0], 40),
        simulate(default_scheme(1, 1, 2), BLIND, [1.0, 0.0], 40),  # a state that the outputs do not see
    ]
    for run in moved:
        assert len(diagnose_run(run).findings) > 1


def test_bounds_are_a_suggestion_where_there_are_none():
    free = simulate(default_scheme(1, 1, 1), TANK, [1.0], 40)
    assert says(diagnose_run(free), "Peak").endswith("; to keep inputs within a range, set v_min and v_max")
    kept = simulate(default_scheme(1, 1, 1, bounds=Saturation(-1.0, 1.0)), TANK, [1.0], 40)
    assert "v_min" not in says(diagnose_run(kept), "Peak")


def test_disturbances_that_are_known_explain_a_run():
    subject, noise, load = f"Assumption 7, {ONLY}", GaussianNoise(0.02, 1), Offset(0.2)
    both = {"sensor": noise, "load": load}
    plain = default_scheme(1, 1, 2)
    run = simulate(plain, PLANT, [1.0, -1.0], 80, **both)
    assert "the sensor errors and the load of this run explain it" in says(diagnose_run(run, PLANT, **both), subject)
    assert "look for noise and loads" in says(diagnose_run(run), subject)
    hint = says(diagnose_run(run, PLANT, **both), GOES)
    assert "set noise to the standard deviation of the sensor errors; give set_point" in hint
    assert "if " not in hint
    # Increments do not see a constant load, unless it begins later.
    tracks = default_scheme(1, 1, 2, set_point=SetPoint(1.0))
    for start, named in ((0, "the sensor errors of this run"), (40, "the sensor errors and the load of this run")):
        acting = {"sensor": noise, "load": Offset(0.2, start)}
        run = simulate(tracks, PLANT, [1.0, -1.0], 80, **acting)
        found = diagnose_run(run, PLANT, **acting)
        assert f"; {named} explain it" in says(found, subject)
        assert "; set noise to the standard deviation of the sensor errors, and read" in says(found, "Set point")
    later = simulate(tracks, PLANT, [1.0, -1.0], 80, sensor=noise)
    assert "give set_point" not in says(diagnose_run(later), "Set point")
    unknown = replace(run, applied_known=False)
    assert "the actuator, whose inputs the scheme does not know" in says(
        diagnose_run(unknown, PLANT, actuator=Saturation(-1.0, 1.0)), subject
    )
    short = simulate(default_scheme(1, 1, 2), LATE, np.ones(5), 40, sensor=noise)
    assert "the sensor errors and too few stacked values explain it" in says(
        diagnose_run(short, LATE, sensor=noise), subject
    )
    arm = robot_arm()
    assert "the plant is nonlinear" in says(diagnose_run(arm.run(), arm.plant), subject)
    shaken = replace(arm, sensor=noise).run()
    assert "the sensor errors of this run explain all or a part of it" in says(
        diagnose_run(shaken, arm.plant, sensor=noise), subject
    )


def test_only_what_acts_is_asked_for():
    scheme = default_scheme(1, 1, 2)
    loaded = simulate(scheme, PLANT, [1.0, -1.0], 80, load=Offset(0.4))
    hint = says(diagnose_run(loaded, PLANT, load=Offset(0.4)), GOES)
    assert "; give set_point, with which" in hint
    assert "set noise" not in hint
    # What acts after the end of a run does not explain it.
    late = Offset(0.4, 1000)
    short = simulate(scheme, PLANT, [1.0, -1.0], 12, load=late)
    assert "not converged yet: run more steps" in says(diagnose_run(short, PLANT, load=late), GOES)


def test_a_known_cause_needs_no_pointer_to_other_findings():
    run = simulate(default_scheme(1, 1, 2), LATE, np.ones(5), 80)
    pointer = "read the suspect findings below"
    assert pointer in says(diagnose_run(run), GOES)
    assert pointer not in says(diagnose_run(run, LATE), GOES)


def test_a_lower_order_is_not_advised_from_a_linearisation():
    """A nonlinear plant may need more values than its linearisation."""
    plant = FunctionPlant(lambda z, v: FAST.step(z, v), FAST.output, n=2, q=1)
    run = simulate(default_scheme(1, 1, 4), plant, [1.0, 0.5], 80)
    for found, subject in (
        (diagnose_run(run, plant), "Peak of the outputs"),
        (diagnose(plant, run.scheme, z0=[1.0, 0.5]), "Peak to expect"),
    ):
        assert "lower order if it is above the observability index" in says(found, subject)


@pytest.mark.parametrize(("order", "advice"), [(1, "begin"), (2, "lower order to 1")])
def test_the_least_order_is_one(order, advice):
    """With a set point and a delay one value suffices, but order = 1 stacks two."""
    delay = LinearPlant([[0.0]], [[1.0]], [[1.0]])
    assert less_peak(delay, default_scheme(1, 1, order, set_point=SetPoint(1.0))).startswith(advice)


def test_a_set_point_that_moves_is_judged_at_the_end_of_the_run():
    words, plans = "no input within the bounds holds", Saturation(-1.0, 1.0)
    for late, said in ((7.5, True), (2.5, False)):
        target = SetPoint(lambda k, late=late: [10.0 - late if k < 97 else late])
        run = simulate(default_scheme(1, 1, 1, set_point=target, bounds=plans), TANK, [0.0], 100, actuator=plans)
        found = diagnose_run(run, TANK, actuator=plans)
        assert verdicts(found)["Set point"] == "suspect"
        assert (words in says(found, "Set point")) == said
        # The bounds on a linearisation decide nothing far from zero.
        nonlinear = FunctionPlant(lambda z, v: TANK.step(z, v), TANK.output, n=1, q=1)
        assert words not in says(diagnose_run(run, nonlinear, actuator=plans), "Set point")


def signals(y, v=0.0, scheme=None):
    """A trace of one output and one input, without a plant."""
    y = np.asarray(y, dtype=np.float64)
    return Trace(scheme or default_scheme(1, 1, 1), y[:, None], np.broadcast_to(np.float64(v), y.shape)[:, None])


def test_what_remains_is_compared_with_the_noise_that_the_scheme_expects():
    for times, said in ((9.9, True), (10.1, False), (6.93, True)):
        run = signals([1.0] + 19 * [0.01 * times], scheme=default_scheme(1, 1, 1, noise=0.01))
        words = f"what remains is up to {times:.2g} times the noise that the scheme expects; up to 10 times counts"
        assert (words in says(diagnose_run(run), GOES)) == said


@pytest.mark.parametrize(("times", "suspect"), [(99.9, False), (100.1, True)])
def test_from_which_size_on_a_peak_is_suspect(times, suspect):
    run = signals([0.5, 0.5 * times, *np.zeros(20)])
    assert ("Peak of the outputs" in unmet(diagnose_run(run))) == suspect


@pytest.mark.parametrize(("left", "verdict"), [(0.99e-3, "met"), (1.01e-3, "suspect")])
def test_how_small_the_end_of_a_run_has_to_be(left, verdict):
    """The end is the last tenth, two steps of twenty: what was larger before them does not count."""
    run = signals([2.0, *np.full(17, 1.0), 2.0 * left, 0.0])
    assert verdicts(diagnose_run(run))[GOES] == verdict


@pytest.mark.parametrize(("gain", "verdict"), [(0.99e4, "met"), (1.01e4, "suspect")])
def test_from_which_gain_on_the_plans_are_suspect(gain, verdict):
    """One step from the initial model x+ = x + u / gain, whose plan takes x to zero at once."""
    scheme = window_scheme(1, 1, 1)
    scheme = replace(
        scheme,
        initial_model=SignalModel([[1.0]], [[1.0 / gain]]),
        controller=replace(scheme.controller, R=1e-20, epsilon=lambda k: 1e-18),
    )
    found = diagnose_run(signals([1.0], scheme=scheme))
    assert verdicts(found)["Assumption 5(b), bounded gains of V1"] == verdict


@pytest.mark.parametrize(("share", "verdict"), [(0.99e-6, "met"), (1.01e-6, "suspect")])
def test_which_share_of_the_signals_a_model_may_miss(monkeypatch, share, verdict):
    monkeypatch.setattr(_after, "_misfit", lambda trace: share)
    found = diagnose_run(signals(0.5 ** np.arange(20)))
    assert verdicts(found)[f"Assumption 7, {ONLY}"] == verdict


@pytest.mark.parametrize(("margin", "lost"), [(1.01e-9, False), (0.99e-9, True)])
def test_from_which_margin_on_a_pair_counts_as_lost(margin, lost):
    """One step with the initial model x+ = u of that effect, which is the margin of the pair."""
    scheme = replace(window_scheme(1, 1, 1), initial_model=SignalModel([[0.0]], [[margin]]))
    found = verdicts(diagnose_run(signals([1.0], scheme=scheme)))
    assert (found["Theorem 2(iii), lifted pair stays controllable"] == "suspect") == lost


def test_the_time_of_a_step_is_a_median(monkeypatch):
    """Steps of 50, 3, 3, 70, 3, ... ms: one that loads code and one that the machine delays do not count."""
    took = [0.050, 0.003, 0.003, 0.070, *[0.003] * 6]
    times = iter(np.cumsum([0.0, *(part for each in took for part in (each, 1.0))]))
    monkeypatch.setattr(diagnosis, "perf_counter", lambda: float(next(times)))
    assert says(diagnose(PLANT, SCHEME), "Size").endswith("about 3.0 ms a step here")
    assert len(list(times)) == 1  # every step was timed


def test_slow_steps_are_timed_three_times_only(monkeypatch):
    times = iter(np.arange(100.0))
    monkeypatch.setattr(diagnosis, "perf_counter", lambda: float(next(times)))
    assert says(diagnose(PLANT, SCHEME), "Size").endswith("about 1000.0 ms a step here")
    assert len(list(times)) == 100 - 2 * 3
