"""The scheme as an iterator of immutable steps: consistent, batched, and loud when it leaves the range of numbers."""

from dataclasses import FrozenInstanceError, fields, is_dataclass, replace
from itertools import islice, pairwise

import numpy as np
import pytest

from rhl.closed_loop import advance, closed_loop, replay, start, step
from rhl.controllability import ConstantMixing, LambdaSearch
from rhl.controller import Controller
from rhl.disturbances import GaussianNoise, Outliers, Saturation
from rhl.errors import DivergedError, InputError
from rhl.estimator import ProximalEstimator
from rhl.horizon import solve
from rhl.lifting import DelayLifting
from rhl.model import SignalModel
from rhl.plants import LinearPlant, RobotArm
from rhl.schedules import PowerDecay
from rhl.scheme import Scheme
from rhl.simulation import simulate
from rhl.state import Step

SEED = 2010_05891
STEPS = 12
# Batched and single runs take the same operations, but sums may be blocked otherwise. Their roundings grow along the
# transients of these loops by less than 1e4.
SAME_RTOL = 1e-10

PLANT = LinearPlant([[1.1, 0.3], [0.0, 0.8]], [[0.5], [1.0]], [[1.0, 0.5]])
Z0 = np.array([1.0, -2.0])


def controller(**changes):
    settings = {"Q": 1.0, "R": 1.0, "QN": 1.0, "horizon": 6, "epsilon": PowerDecay(10.0)}
    return Controller(**settings | changes)


def scheme(*, p=1, q=1, outputs=2, inputs=2, mixing=None, **changes):
    return Scheme(
        lifting=DelayLifting(outputs, inputs),
        estimator=ProximalEstimator(4),
        controller=controller(**changes),
        initial_model=SignalModel.companion_of_ones(outputs * p, inputs * q, "eye-last-row-of-ones"),
        mixing=mixing or ConstantMixing(),
    )


def run(made, plant=PLANT, z0=Z0, steps=STEPS):
    return list(islice(closed_loop(made, plant, z0), steps))


def close(found, expected):
    np.testing.assert_allclose(found, expected, rtol=SAME_RTOL, atol=SAME_RTOL * max(1.0, np.max(np.abs(expected))))


SCHEMES = {
    "plain": scheme(),
    "delayed": scheme(model_delay=1),
    "mixed": scheme(mixing=ConstantMixing(0.5)),
    "searching": scheme(mixing=LambdaSearch()),
    "no-past-inputs": scheme(inputs=1),
    "deep": scheme(outputs=3, inputs=4),
}


@pytest.fixture(params=SCHEMES)
def made(request):
    """A scheme of every kind."""
    return SCHEMES[request.param]


# The loop against the paper's recursion, written out


def test_signals_are_lifted_as_the_paper_says(made):
    steps, (N_y, N_v) = run(made), (made.lifting.outputs, made.lifting.inputs)
    y = {done.k: done.y for done in steps}
    v = {done.k: done.v_applied for done in steps}
    for done in steps:
        past_y = [y.get(done.k - i, np.zeros(1)) for i in range(N_y)]
        past_v = [v.get(done.k - i, np.zeros(1)) for i in range(1, N_v)]
        assert np.array_equal(done.plan.x[0], np.concatenate([*past_y, *past_v]))
        gamma = np.sum(done.plan.x[0] ** 2)
        assert done.problem.weight == pytest.approx(gamma * (1 + 10 * done.k), rel=1e-14)


def test_prediction_is_the_model_of_the_step_before(made):
    steps, (N_y, N_v) = run(made), (made.lifting.outputs, made.lifting.inputs)
    assert np.array_equal(steps[0].y_hat, steps[0].y)
    v = {done.k: done.v_applied for done in steps}
    y = {done.k: done.y for done in steps}
    for before, done in pairwise(steps):
        x = np.concatenate([y.get(before.k - i, np.zeros(1)) for i in range(N_y)])
        u = np.concatenate([v.get(before.k - i, np.zeros(1)) for i in range(N_v)])
        close(done.y_hat, before.model.step(x, u)[:1])


def test_estimate_is_a_proximal_step_from_the_mixed_model(made):
    previous = made.initial_model
    for done in run(made):
        close(done.model.theta, (1 - done.lam) * done.estimate.theta + done.lam * previous.theta)
        assert np.array_equal(done.state.model.theta, previous.theta)
        previous = done.model


def test_first_step_leaves_the_model(made):
    assert np.array_equal(run(made, steps=1)[0].estimate.theta, made.initial_model.theta)


@pytest.mark.parametrize("delay", [0, 1])
def test_model_delay(delay):
    made = scheme(model_delay=delay)
    for done in run(made):
        used = done.state.model if delay else done.model
        assert np.array_equal(done.problem.model.theta, made.lifting.augment(used).theta)
    others = run(scheme(model_delay=1 - delay))
    assert np.max(np.abs(others[2].v_applied - run(made)[2].v_applied)) > 1e-3


def test_every_plan_certifies_itself(made):
    assert max(done.plan.residual() for done in run(made)) < 1e-12


def test_the_plant_is_driven_by_the_first_inputs(made):
    steps = run(made)
    assert np.array_equal(steps[0].z, Z0)
    for done, after in pairwise(steps):
        assert np.array_equal(done.v_applied, done.plan.u[0])
        assert np.array_equal(after.z, PLANT.step(done.z, done.v_applied))
        assert np.array_equal(done.y, PLANT.output(done.z))


def test_a_loop_that_works_brings_the_state_down():
    steps = run(SCHEMES["plain"], steps=60)
    assert np.linalg.norm(steps[-1].z) < 1e-3 * np.linalg.norm(Z0)
    uncontrolled = np.linalg.matrix_power(PLANT.F, 60) @ Z0
    assert np.linalg.norm(uncontrolled) > 10 * np.linalg.norm(Z0)


# Ways to run it


def test_step_and_advance_by_hand_are_the_loop(made):
    state, z = start(made), Z0
    for done in run(made):
        by_hand = step(made, state, PLANT.output(z))
        assert np.array_equal(by_hand.v_applied, done.v_applied)
        assert by_hand.z is None
        state, z = advance(made, by_hand), PLANT.step(z, by_hand.v_applied)
        assert state.k == done.k + 1


def test_replay_of_a_run_gives_its_inputs(made):
    steps = run(made)
    again = list(replay(made, [done.y for done in steps], [done.v_applied for done in steps]))
    for done, replayed in zip(steps, again, strict=True):
        assert np.array_equal(replayed.v_computed, done.v_applied)
        assert np.array_equal(replayed.y_hat, done.y_hat)
        assert np.array_equal(replayed.model.theta, done.model.theta)
        assert replayed.z is None


def test_replay_of_other_inputs_gives_other_answers():
    steps = run(SCHEMES["plain"])
    v = np.stack([done.v_applied for done in steps])
    v[3] += 1.0
    again = list(replay(SCHEMES["plain"], [done.y for done in steps], v))
    # What is applied at k = 3 is seen from k = 4 on.
    assert all(np.array_equal(again[k].v_computed, steps[k].v_applied) for k in range(4))
    assert np.max(np.abs(again[4].v_computed - steps[4].v_applied)) > 1e-3


def test_runs_repeat_to_the_bit(made):
    for one, other in zip(run(made), run(made), strict=True):
        assert np.array_equal(one.v_applied, other.v_applied)
        assert np.array_equal(one.model.theta, other.model.theta)


@pytest.mark.parametrize("lead", [(3,), (2, 2)])
def test_batch_of_starts_is_that_many_loops(made, lead):
    starts = np.random.default_rng(SEED).standard_normal((*lead, 2))
    together = run(made, z0=starts)
    assert together[0].v_applied.shape == (*lead, 1)
    for index in np.ndindex(lead):
        for done, alone in zip(together, run(made, z0=starts[index]), strict=True):
            close(done.v_applied[index], alone.v_applied)
            close(done.model.theta[index], alone.model.theta)
            close(done.z[index], alone.z)


def test_batch_of_plants_is_that_many_loops():
    F = np.array([[[1.1, 0.3], [0.0, 0.8]], [[0.9, 0.1], [0.2, 0.7]], [[0.5, 1.0], [0.0, 1.05]]])
    together = run(SCHEMES["plain"], plant=LinearPlant(F, PLANT.G, PLANT.H), z0=np.tile(Z0, (3, 1)))
    for i in range(3):
        for done, alone in zip(together, run(SCHEMES["plain"], plant=LinearPlant(F[i], PLANT.G, PLANT.H)), strict=True):
            close(done.v_applied[i], alone.v_applied)


def test_several_inputs_and_outputs():
    plant = LinearPlant(np.diag([1.1, 0.9, 0.5]), [[1.0, 0.0], [0.5, 1.0], [0.0, 1.0]], [[1.0, 0, 0], [0, 1.0, 1.0]])
    made = scheme(p=2, q=2, outputs=2, inputs=3)
    steps = run(made, plant=plant, z0=[1.0, 1.0, -1.0], steps=40)
    assert (made.p, made.q) == (2, 2)
    assert steps[0].plan.x.shape == (7, 4 + 4)
    assert np.linalg.norm(steps[-1].z) < 1e-2


def test_a_plant_may_have_state_and_output_alike():
    made = scheme(p=3, outputs=2, inputs=2)
    assert run(made, plant=RobotArm(), z0=[0.1, 0.0, 0.0], steps=3)[2].y.shape == (3,)


# Disturbances between scheme and plant


def run_with(made, steps=STEPS, z0=Z0, **disturbances):
    return list(islice(closed_loop(made, PLANT, z0, **disturbances), steps))


def test_without_disturbances_nothing_is_changed(made):
    passing = {"sensor": lambda k, y: y, "actuator": lambda k, v: v}
    for known in (True, False):
        for one, other in zip(run(made), run_with(made, applied_known=known, **passing), strict=True):
            assert np.array_equal(one.v_applied, other.v_applied)
            assert np.array_equal(one.model.theta, other.model.theta)
            assert np.array_equal(one.z, other.z)


def test_a_sensor_stands_before_the_scheme():
    sensor = GaussianNoise(0.1, SEED)
    steps = run_with(SCHEMES["plain"], sensor=sensor)
    for done, after in pairwise(steps):
        assert np.array_equal(done.y, sensor(done.k, PLANT.output(done.z)))
        assert np.array_equal(after.state.y[0], done.y)  # what is remembered is what was measured
        assert np.array_equal(after.z, PLANT.step(done.z, done.v_applied))
        assert not np.array_equal(done.y, PLANT.output(done.z))


def test_sensors_in_a_tuple_are_one_after_the_other():
    noisy, wrong = GaussianNoise(0.1, SEED), Outliers(0.5, 3.0, SEED)
    together = run_with(SCHEMES["plain"], sensor=(noisy, wrong))
    nested = run_with(SCHEMES["plain"], sensor=lambda k, y: wrong(k, noisy(k, y)))
    assert all(np.array_equal(one.v_applied, other.v_applied) for one, other in zip(together, nested, strict=True))


@pytest.mark.parametrize("known", [True, False])
def test_an_actuator_stands_before_the_plant(known):
    """The plant gets the clipped input; the scheme remembers it, or the one that it had computed."""
    box = Saturation(-0.1, 0.1)
    steps = run_with(SCHEMES["plain"], actuator=box, applied_known=known)
    clipped = 0
    for done, after in pairwise(steps):
        computed = done.plan.u[..., 0, :]
        assert np.array_equal(done.v_applied, box(done.k, computed))
        assert np.array_equal(after.z, PLANT.step(done.z, done.v_applied))
        assert np.array_equal(after.state.v[0], done.v_applied if known else computed)
        clipped += not np.array_equal(done.v_applied, computed)
    assert clipped > 0


def test_what_is_known_of_the_actuator_matters():
    known, unknown = (
        run_with(SCHEMES["plain"], actuator=Saturation(-0.1, 0.1), applied_known=known) for known in (True, False)
    )
    assert np.max(np.abs(known[-1].model.theta - unknown[-1].model.theta)) > 1e-3


def test_a_saturated_replay_is_the_run():
    """Replayed with the inputs that were applied, the scheme computes what it did with the actuator known."""
    steps = run_with(SCHEMES["plain"], sensor=Outliers(0.2, 3.0, SEED), actuator=Saturation(-0.1, 0.1))
    again = replay(SCHEMES["plain"], [done.y for done in steps], [done.v_applied for done in steps])
    for done, replayed in zip(steps, again, strict=True):
        assert np.array_equal(replayed.v_computed, done.plan.u[..., 0, :])
        assert np.array_equal(replayed.model.theta, done.model.theta)


@pytest.mark.parametrize(
    ("disturbances", "sentence"),
    [
        ({"sensor": lambda k, y: y[:0]}, r"the sensor must return the shape of its argument, \(1,\), got \(0,\)"),
        ({"actuator": lambda k, v: v * np.nan if k == 2 else v}, "what the actuator returns at k = 2 must be finite"),
        ({"sensor": 3}, r"the sensor must be a function of \(k, signal\), got 3"),
    ],
)
def test_disturbances_refused(disturbances, sentence):
    with pytest.raises(InputError, match=sentence):
        run_with(SCHEMES["plain"], **disturbances)


# The adaptive terminal weight


def test_without_adaption_the_stage_is_the_step(made):
    for done in run(made):
        assert np.array_equal(done.stage, done.k)
        assert done.state.stage is None
        assert done.state.value is None


@pytest.mark.parametrize("delay", [0, 1])
def test_stage_moves_only_where_the_value_did_not_fall(delay):
    made = scheme(adaptive=True, model_delay=delay)
    starts = np.random.default_rng(SEED).standard_normal((8, 2))
    steps = run(made, z0=starts, steps=30)
    assert np.array_equal(steps[0].stage, np.zeros(8))
    moved = np.zeros(8, dtype=int)
    for before, done in pairwise(steps):
        assert np.array_equal(done.stage - before.stage, (done.stage > before.stage))
        used = made.lifting.augment(done.state.model if delay else done.model)
        kept = solve(made.controller.problem(used, done.plan.x[..., 0, :], before.stage), done.plan.x[..., 0, :])
        assert np.array_equal(done.stage > before.stage, (kept.value >= before.plan.value) & (kept.value > 0))
        gamma = np.sum(done.plan.x[..., 0, :] ** 2, axis=-1)
        np.testing.assert_allclose(done.problem.weight, gamma * (1 + 10 * done.stage), rtol=1e-14)
        moved += done.stage > before.stage
    # Some move and some do not, or this says nothing.
    assert 0 < np.sum(moved) < 8 * 29


def test_adaptive_batches_agree_with_members():
    made = scheme(adaptive=True)
    starts = np.random.default_rng(SEED).standard_normal((2, 3, 2))
    together = run(made, z0=starts)
    for index in np.ndindex(2, 3):
        for done, alone in zip(together, run(made, z0=starts[index]), strict=True):
            assert done.stage[index] == alone.stage
            close(done.v_applied[index], alone.v_applied)
            close(done.model.theta[index], alone.model.theta)


def test_adaption_makes_a_difference_and_still_brings_the_state_down():
    plain, adaptive = run(scheme(), steps=60), run(scheme(adaptive=True), steps=60)
    # By far more than two runs that take the same operations differ.
    assert np.max(np.abs(plain[5].v_applied - adaptive[5].v_applied)) > 1e-8
    assert adaptive[-1].stage < 59
    assert np.linalg.norm(adaptive[-1].z) < 1e-3 * np.linalg.norm(Z0)


def test_at_rest_the_stage_stays():
    """V1 is zero and cannot fall; that is no reason to press harder."""
    steps = run(scheme(adaptive=True), z0=np.zeros(2))
    assert not any(np.any(done.stage) or np.any(done.v_applied) for done in steps)


# Immutability


def arrays_in(value):
    """Every array reachable from a step."""
    if isinstance(value, np.ndarray):
        yield value
    elif is_dataclass(value):
        for entry in fields(value):
            yield from arrays_in(getattr(value, entry.name))


@pytest.mark.parametrize("name", ["v_applied", "state", "model"])
def test_steps_are_frozen(name):
    done = run(SCHEMES["plain"], steps=1)[0]
    with pytest.raises(FrozenInstanceError):
        setattr(done, name, None)


def test_no_array_of_a_step_can_be_changed(made):
    for done in run(made, steps=3):
        found = list(arrays_in(done))
        assert len(found) > 10
        for array in found:
            with pytest.raises(ValueError, match="read-only"):
                array[...] = 0


def test_what_the_caller_passed_may_change_afterwards():
    z0 = Z0.copy()
    steps = closed_loop(SCHEMES["plain"], PLANT, z0)
    first = next(steps)
    z0[:] = 100.0
    second = next(steps)
    assert np.array_equal(first.z, Z0)
    assert np.array_equal(second.z, run(SCHEMES["plain"], steps=2)[1].z)


# Out of range


def test_divergence_tells_when():
    """Data of 1e200 have squares beyond float64, so Gamma has no value."""
    with pytest.raises(DivergedError, match="left the range of floating-point numbers at k = 0: weight") as caught:
        run(SCHEMES["plain"], z0=[1e200, 0.0])
    assert caught.value.k == 0


def test_divergence_after_some_steps():
    # The input cannot reach the unstable part, so nothing holds it: 1e30 ** k overflows.
    plant = LinearPlant([[1e30, 0.0], [0.0, 0.5]], [[0.0], [1.0]], [[1.0, 1.0]])
    taken: list[Step] = []
    with pytest.raises(DivergedError) as caught:
        taken.extend(closed_loop(SCHEMES["plain"], plant, Z0))
    assert 2 <= caught.value.k <= 12
    assert [done.k for done in taken] == list(range(caught.value.k))


def test_divergence_of_the_plant_alone():
    plant = LinearPlant([[1e300]], [[0.0]], [[1e-300]])
    with pytest.raises(DivergedError, match="at k = 2: the plant's state is no longer finite") as caught:
        run(scheme(outputs=1, inputs=1), plant=plant, z0=[1.0])
    assert caught.value.k == 2


def test_one_state_that_overflows_is_enough():
    plant = LinearPlant([[1e300, 0.0], [0.0, 0.5]], [[0.0], [0.0]], [[0.0, 1.0]])
    with pytest.raises(DivergedError, match="at k = 2: the plant's state is no longer finite"):
        run(scheme(outputs=1, inputs=1), plant=plant, z0=[1.0, 1.0])


def test_an_output_that_is_no_number_is_the_callers_mistake():
    with pytest.raises(InputError, match="y must be finite, got nan"):
        step(SCHEMES["plain"], start(SCHEMES["plain"]), [np.nan])


def test_a_batch_of_plants_may_start_from_one_state():
    one = LinearPlant(np.array([[0.5]]), np.array([[1.0]]), np.array([[1.0]]))
    several = LinearPlant(np.full((3, 1, 1), 0.5), one.G, one.H)
    scheme_ = SCHEMES["plain"]
    together, alone = simulate(scheme_, several, [1.0], 4), simulate(scheme_, one, [1.0], 4)
    assert together.v.shape == (4, 3, 1)
    assert np.array_equal(together.v[:, 1], alone.v)


# What is refused


@pytest.mark.parametrize(
    ("build", "sentence"),
    [
        (lambda: run(scheme(), z0=[1.0]), r"z0 must have shape \(2,\), got \(1,\)"),
        (lambda: run(scheme(), z0=[np.inf, 0.0]), "z0 must be finite, got inf"),
        (lambda: run(scheme(p=2)), "the plant must have 2 outputs, for which the initial model is made, got 1"),
        (lambda: run(scheme(q=2)), "the plant must have 2 inputs, for which the initial model is made, got 1"),
        (
            lambda: next(replay(scheme(), np.ones((3, 2)), np.ones((3, 1)))),
            r"y must have shape \(at least 1, 1\), got \(3, 2\)",
        ),
        (lambda: next(replay(scheme(), np.ones((3, 1)), np.ones((2, 1)))), "the same number of rows, got 3 and 2"),
        (lambda: step(scheme(), start(scheme()), [1.0, 2.0]), r"y must have shape \(1,\), got \(2,\)"),
        (lambda: advance(scheme(), run(scheme(), steps=1)[0], [1.0, 2.0]), r"v must have shape \(1,\), got \(2,\)"),
        (lambda: scheme(Q=np.eye(2)), r"Q must be a number or a matrix of shape \(3, 3\), got shape \(2, 2\)"),
        (lambda: scheme(R=-1.0), "R must be positive definite, got smallest eigenvalue -1"),
        (lambda: scheme(QN=0.0), "QN must be positive definite, got smallest eigenvalue 0"),
        (lambda: scheme(horizon=0), "horizon must be an integer of at least 1, got 0"),
        (lambda: scheme(alpha=0.0), r"alpha must be a positive finite number, got 0\.0"),
        (lambda: scheme(model_delay=2), "model_delay must be 0 or 1, got 2"),
        (lambda: PowerDecay(0.0), r"rate must be a positive finite number, got 0\.0"),
        (lambda: run(scheme(epsilon=lambda k: 1.0 - k)), "epsilon must be positive and finite .* got 0.0 at k = 1"),
        (
            lambda: replace(scheme(), initial_model=SignalModel(np.eye(3), np.ones((3, 2)))),
            "A must have an order that is a multiple of outputs = 2, got 3",
        ),
        (
            lambda: replace(scheme(), initial_model=SignalModel(np.eye(2), np.ones((2, 3)))),
            "the model's input size must be a multiple of inputs = 2, which u stacks, got 3",
        ),
        (
            lambda: replace(scheme(mixing=LambdaSearch()), initial_model=SignalModel(np.eye(2), np.ones((2, 2)))),
            "the initial model must be controllable for a lambda-search: its augmented pair must have a margin of",
        ),
    ],
)
def test_refused(build, sentence):
    with pytest.raises(InputError, match=sentence):
        build()


def test_uncontrollable_initial_model_is_allowed_without_a_search():
    made = replace(scheme(), initial_model=SignalModel(np.eye(2), np.ones((2, 2))))
    assert made.q == 1


def test_harmonic_decay():
    assert [PowerDecay(100.0)(k) for k in (0, 1, 10)] == [1.0, 1 / 101, 1 / 1001]


@pytest.mark.parametrize("pair", ["lifted", "augmented"])
def test_the_search_looks_at_the_pair_it_is_told_to(pair):
    """y+ = a y + b v - a b v(k-1): controllable as a lifted pair, not as an augmented one."""
    initial = SignalModel(np.array([[1.5]]), np.array([[1.0, -1.5]]))
    controller = Controller(Q=1.0, R=1.0, QN=1.0, horizon=3, epsilon=PowerDecay(1.0))
    parts = (DelayLifting(1, 2), ProximalEstimator(2), controller, initial)
    if pair == "lifted":
        assert Scheme(*parts, LambdaSearch("lifted")).mixing.pair == "lifted"
    else:
        with pytest.raises(InputError, match="its augmented pair must have a margin"):
            Scheme(*parts, LambdaSearch("augmented"))


def test_what_a_disturbance_raises_is_let_through():
    with pytest.raises(ZeroDivisionError) as caught:
        run_with(SCHEMES["plain"], actuator=lambda k, v: [1 / (2 - k)])
    assert any("actuator" in note for note in caught.value.__notes__)


def test_a_batch_of_initial_models_runs_from_one_initial_state():
    one = SCHEMES["plain"]
    A, B = one.initial_model.A, one.initial_model.B
    models = replace(one, initial_model=SignalModel(np.stack([A, 1.1 * A]), np.stack([B, B])))
    plant = LinearPlant([[1.1, 1.0], [0.0, 0.9]], [[0.0], [1.0]], [[1.0, 0.0]])
    steps = list(islice(closed_loop(models, plant, [1.0, -1.0]), 5))
    for i in range(2):
        alone = replace(one, initial_model=SignalModel(models.initial_model.A[i], models.initial_model.B[i]))
        for both, single in zip(steps, closed_loop(alone, plant, [1.0, -1.0]), strict=False):
            assert np.array_equal(both.v_applied[i], single.v_applied)
    assert np.array_equal([done.v_applied for done in steps], simulate(models, plant, [1.0, -1.0], 5).v)
    other = np.ones((3, 2))
    for run in (lambda: closed_loop(models, plant, other), lambda: simulate(models, plant, other, 5)):
        with pytest.raises(InputError, match=r"batch axes must broadcast together, got shapes z0 \(3, 2\), initial"):
            run()
