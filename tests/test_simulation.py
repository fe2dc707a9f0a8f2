"""Whole runs: the compiled loop against the scheme taken step by step, batches against their members, what is kept."""

import pickle
import subprocess
import sys
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from rhl import _engine, simulation
from rhl._lanes import LANES
from rhl.closed_loop import advance, closed_loop, start, step
from rhl.controllability import ConstantMixing, LambdaSearch
from rhl.controller import Controller
from rhl.disturbances import GaussianNoise, Saturation
from rhl.errors import DivergedError, InputError
from rhl.estimator import ProximalEstimator
from rhl.lifting import DelayLifting
from rhl.losses import WeightedSquares
from rhl.model import SignalModel
from rhl.paper.published import linear_example, robot_arm
from rhl.plants import FunctionPlant, LinearPlant
from rhl.schedules import PowerDecay
from rhl.scheme import Scheme, window_scheme
from rhl.simulation import simulate

SEED = 2010_05891
LINEAR, ROBOT = linear_example(), robot_arm()


def scheme(*, p=1, q=1, outputs=2, inputs=2, window=4, weight=1.0, loss=1.0, mixing=None, **changes):
    settings = {"Q": 1.0, "R": 1.0, "QN": 1.0, "horizon": 6, "epsilon": PowerDecay(10.0)} | changes
    return Scheme(
        DelayLifting(outputs, inputs),
        ProximalEstimator(window, WeightedSquares(loss), WeightedSquares(weight)),
        Controller(**settings),
        SignalModel.companion_of_ones(outputs * p, inputs * q, "eye-last-row-of-ones"),
        mixing or ConstantMixing(),
    )


PLANT, Z0 = LinearPlant([[1.1, 0.3], [0.0, 0.8]], [[0.5], [1.0]], [[1.0, 0.5]]), np.array([1.0, -2.0])
WIDE = LinearPlant(np.diag([1.1, 0.9, 0.5]), [[1.0, 0.0], [0.5, 1.0], [0.0, 1.0]], [[1.0, 0, 0], [0, 1.0, 1.0]])
# The compiled loop's own: every size, delay, mixing and kind of weight that it serves.
COMPILED = {
    "plain": (scheme(), PLANT),
    "delayed": (scheme(model_delay=1), PLANT),
    "mixed": (scheme(mixing=ConstantMixing(0.5)), PLANT),
    "no past inputs": (scheme(inputs=1), PLANT),
    "deep": (scheme(outputs=3, inputs=4), PLANT),
    "weights of every entry": (
        scheme(weight=np.linspace(0.1, 2.0, 8), loss=np.linspace(0.5, 1.5, 8)),
        PLANT,
    ),
    "weights that are matrices": (scheme(Q=np.array([[2.0, 1, 0], [1, 2, 0], [0, 0, 1]]), R=np.eye(1)), PLANT),
    "several inputs and outputs": (scheme(p=2, q=2, outputs=2, inputs=3), WIDE),
}
GENERAL = {
    "search": (scheme(mixing=LambdaSearch()), PLANT),
    "adaptive": (scheme(adaptive=True), PLANT),
}


def starts(plant, count):
    return np.random.default_rng(SEED).standard_normal((count, plant.n))


@pytest.mark.parametrize("name", [*COMPILED, *GENERAL])
def test_a_run_is_the_scheme_step_by_step_to_the_last_bit(name):
    made, plant = (COMPILED | GENERAL)[name]
    assert _engine.serves(made) == (name in COMPILED)
    z0 = starts(plant, 1)[0]
    trace = simulate(made, plant, z0, 30)
    steps = list(islice(closed_loop(made, plant, z0), 30))
    # The plant's own sums are taken in another order, so states and outputs are compared from the same data.
    assert np.allclose(trace.z, np.stack([done.z for done in steps]), rtol=1e-9, atol=1e-9)
    state = start(made)
    for k in range(30):
        done = step(made, state, trace.y[k])
        assert np.array_equal(done.v_computed, trace.v[k])
        assert np.array_equal(done.model.theta, trace.theta[k])
        assert np.array_equal(done.estimate.theta, trace.steps[k].estimate.theta)
        state = advance(made, done)


def test_the_comparison_to_the_last_bit_can_fail():
    """Another order of the products than the compiled loop's shows."""
    trace = simulate(*COMPILED["deep"], Z0, 30)
    plans = np.stack([trace.plan(k).u[0] for k in range(30)])
    assert np.array_equal(plans, trace.v)
    turned = np.stack([trace.plan(k).u[0] * (1 + 2e-16) for k in range(30)])
    assert not np.array_equal(turned, trace.v)


@pytest.mark.parametrize("name", COMPILED)
def test_models_that_are_not_recorded_are_those_that_would_have_been(name):
    made, plant = COMPILED[name]
    with_models = simulate(made, plant, Z0 if plant is PLANT else np.ones(3), 20, record="models")
    without = simulate(made, plant, Z0 if plant is PLANT else np.ones(3), 20, record="signals")
    assert with_models.models is not None
    assert without.models is None
    for quantity in ("theta", "lam", "y_hat", "weight", "margin_augmented"):
        assert np.array_equal(getattr(with_models, quantity), getattr(without, quantity))
    assert np.array_equal(with_models.plan(7).u, without.plan(7).u)


def random_plants(count, n=3):
    rng = np.random.default_rng(SEED)
    F = rng.standard_normal((count, n, n))
    F *= (rng.uniform(0.5, 1.2, count) / np.max(np.abs(np.linalg.eigvals(F)), axis=-1))[:, None, None]
    return LinearPlant(F, rng.standard_normal((count, n, 1)), rng.standard_normal((count, 1, n)))


def member(plant, i):
    return LinearPlant(plant.F[i], plant.G[i], plant.H[i])


def test_two_hundred_random_plants_in_a_batch_are_two_hundred_runs():
    plants, made = random_plants(200), window_scheme(1, 1, 3)
    z0 = starts(plants, 200)
    together = simulate(made, plants, z0, 40)
    assert together.models is None
    assert np.all(together.diverged_at == -1)
    for i in range(200):
        alone = simulate(made, member(plants, i), z0[i], 40)
        for name in ("y", "v", "z"):
            assert np.array_equal(getattr(together, name)[:, i], getattr(alone, name))


@pytest.mark.parametrize("count", [1, LANES - 1, LANES, LANES + 1, 3 * LANES + 5])
def test_a_batch_of_any_size(count):
    made, z0 = COMPILED["delayed"][0], starts(PLANT, count)
    together = simulate(made, PLANT, z0, 8)
    for i in {0, count // 2, count - 1}:
        assert np.array_equal(together.v[:, i], simulate(made, PLANT, z0[i], 8).v)


def test_batches_have_any_axes():
    made, z0 = COMPILED["mixed"][0], starts(PLANT, 6).reshape(2, 3, 2)
    together = simulate(made, PLANT, z0, 8)
    assert together.v.shape == (8, 2, 3, 1)
    assert together.diverged_at.shape == (2, 3)
    assert np.array_equal(together.v[:, 1, 2], simulate(made, PLANT, z0[1, 2], 8).v)
    assert together.theta.shape == (8, 2, 3, 8)


def test_other_parts_give_the_same_run(monkeypatch):
    made, plant = COMPILED["plain"]
    whole = simulate(made, plant, Z0, 23)
    seen = []
    monkeypatch.setattr(simulation, "_PART", 5)
    parts = simulate(made, plant, Z0, 23, progress=lambda trace: seen.append(trace))
    assert [len(trace) for trace in seen] == [5, 10, 15, 20, 23]
    for name in ("y", "v", "z", "theta"):
        assert np.array_equal(getattr(parts, name), getattr(whole, name))
    assert np.array_equal(seen[1].theta, whole.theta[:10])


# A plant of the caller's, and what stands between it and the scheme


def as_functions(plant):
    return FunctionPlant(lambda z, v: plant.F @ z + plant.G @ v, lambda z: plant.H @ z, plant.n, plant.q)


@pytest.mark.parametrize("name", [*COMPILED, *GENERAL])
def test_a_plant_of_functions_runs_as_the_linear_one(name):
    made, plant = (COMPILED | GENERAL)[name]
    z0 = starts(plant, 3)
    linear, own = simulate(made, plant, z0, 12), simulate(made, as_functions(plant), z0, 12)
    np.testing.assert_allclose(own.v, linear.v, rtol=1e-9, atol=1e-9 * np.max(np.abs(linear.v)))
    again = simulate(made, as_functions(plant), z0[1], 12)
    assert np.array_equal(again.v, own.v[:, 1])


def test_a_plant_derived_from_the_linear_one_keeps_its_own_step():
    class Stuck(LinearPlant):
        def step(self, z, v):
            return super().step(z, np.clip(v, -0.1, 0.1))

    stuck = simulate(COMPILED["plain"][0], Stuck(PLANT.F, PLANT.G, PLANT.H), Z0, 10)
    by_hand = list(islice(closed_loop(COMPILED["plain"][0], Stuck(PLANT.F, PLANT.G, PLANT.H), Z0), 10))
    assert np.array_equal(stuck.z, np.stack([done.z for done in by_hand]))
    assert not np.array_equal(stuck.z, simulate(COMPILED["plain"][0], PLANT, Z0, 10).z)


def test_a_mixing_derived_from_the_constant_one_keeps_its_own_choice():
    class Late(ConstantMixing):
        def choose(self, estimate, previous, augment):
            return super().choose(estimate, previous, augment) / 2

    late = simulate(scheme(mixing=Late(0.8)), PLANT, Z0, 10)
    assert np.all(late.lam == 0.4)
    assert np.allclose(late.v, simulate(scheme(mixing=ConstantMixing(0.4)), PLANT, Z0, 10).v, rtol=1e-12)


class Counting:
    """A plant with a state of its own, such as a machine that moves when it is told to."""

    n, q, p = 1, 1, 1

    def __init__(self):
        self.moved = 0

    def step(self, z, v):
        self.moved += 1
        return 0.5 * z + v

    def output(self, z):
        return z


def test_a_plant_moves_once_a_step_and_not_before():
    plant = Counting()
    simulate(window_scheme(1, 1, 1), plant, [1.0], 7)
    assert plant.moved == 6
    plant = Counting()
    next(closed_loop(window_scheme(1, 1, 1), plant, [1.0]))
    assert plant.moved == 0


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("name", ["plain", "search"])
def test_disturbances_are_those_of_the_closed_loop(name, known):
    made, plant = (COMPILED | GENERAL)[name]
    between = {"sensor": GaussianNoise(0.05, SEED), "actuator": Saturation(-0.3, 0.3), "applied_known": known}
    trace = simulate(made, plant, Z0, 15, **between)
    for k, done in enumerate(islice(closed_loop(made, plant, Z0, **between), 15)):
        assert np.array_equal(trace.y[k], done.y)
        assert np.array_equal(trace.v[k], done.v_applied)
        assert np.array_equal(trace.v_computed[k], done.v_computed)
        assert np.array_equal(trace.steps[k].plan.u, done.plan.u)
        assert np.array_equal(trace.steps[k].state.v, done.state.v)
    assert not np.array_equal(trace.v, trace.v_computed)


def test_a_recorded_step_can_be_taken_again():
    """A step's state is the one it started from, whatever came of it."""
    for made, plant in (COMPILED["delayed"], GENERAL["adaptive"]):
        for done in simulate(made, plant, Z0, 12).steps:
            again = step(made, done.state, done.y)
            assert np.array_equal(again.v_computed, done.v_computed)
            assert np.array_equal(again.stage, done.stage)
            assert np.array_equal(again.model.theta, done.model.theta)


# Members that diverge


def doomed(count, which):
    """Plants of which some have a mode that the input does not reach and that overflows."""
    F = np.tile(PLANT.F, (count, 1, 1))
    G, H = np.tile(PLANT.G, (count, 1, 1)), np.tile(PLANT.H, (count, 1, 1))
    for i in which:
        F[i], G[i], H[i] = [[1e30, 0.0], [0.0, 0.5]], [[0.0], [1.0]], [[1.0, 1.0]]
    return LinearPlant(F, G, H)


@pytest.mark.parametrize("how", ["compiled", "of functions", "adaptive", "noisy"])
def test_members_that_diverge_are_frozen_and_the_others_go_on(how):
    count, which = 70, [3, 66]
    plants, z0 = doomed(count, which), starts(PLANT, 70)
    made = scheme(adaptive=how == "adaptive")
    more = {"sensor": GaussianNoise(0.0, SEED)} if how == "noisy" else {}

    class Several:
        n, q, p = 2, 1, 1
        step, output = staticmethod(plants.step), staticmethod(plants.output)

    batch = simulate(made, Several() if how == "of functions" else plants, z0, 20, **more)
    assert np.flatnonzero(batch.diverged_at >= 0).tolist() == which
    for i in (0, 3, 20, 66, 69):
        if i in which:
            with pytest.raises(DivergedError) as caught:
                simulate(made, member(plants, i), z0[i], 20, **more)
            k = caught.value.k
            assert batch.diverged_at[i] == k
            assert 0 < k < 20
            assert len(caught.value.trace) == k
            for name in ("y", "v", "z"):
                rows = getattr(batch, name)[:, i]
                assert np.allclose(rows[:k], getattr(caught.value.trace, name), rtol=1e-9)
                assert np.all(rows[k:] == rows[k - 1])
        else:
            alone = simulate(made, member(plants, i), z0[i], 20, **more)
            assert np.allclose(batch.z[:, i], alone.z, rtol=1e-9, atol=1e-12)
    for name in ("y", "v", "z"):
        assert np.all(np.isfinite(getattr(batch, name)))


def test_a_member_that_diverges_at_once():
    z0 = np.array([[1.0, -2.0], [1e200, 0.0]])
    batch = simulate(scheme(), PLANT, z0, 5)
    assert batch.diverged_at.tolist() == [-1, 0]
    assert not np.any(batch.v[:, 1])
    with pytest.raises(DivergedError, match="at k = 0: weight must be finite") as caught:
        simulate(scheme(), PLANT, z0[1], 5)
    assert caught.value.trace is None


@pytest.mark.parametrize("made", [scheme(), scheme(mixing=LambdaSearch())], ids=["compiled", "general"])
def test_divergence_keeps_the_rows_before(made):
    plant = LinearPlant([[1e30, 0.0], [0.0, 0.5]], [[0.0], [1.0]], [[1.0, 1.0]])
    seen = []
    with pytest.raises(DivergedError, match=r"at k = \d+") as caught:
        simulate(made, plant, [1.0, 1.0], 50, progress=seen.append)
    trace = caught.value.trace
    assert len(trace) == caught.value.k > 0
    assert np.all(np.isfinite(trace.v))
    assert len(seen[-1]) == caught.value.k


def test_one_state_that_overflows_is_enough():
    """No output and no input shows it."""
    plant = LinearPlant([[1e300, 0.0], [0.0, 0.5]], [[0.0], [0.0]], [[0.0, 1.0]])
    for of in (plant, as_functions(plant)):
        with pytest.raises(DivergedError, match="at k = 2: the plant's state is no longer finite"):
            simulate(scheme(outputs=1, inputs=1), of, [1.0, 1.0], 5)


def test_a_step_beyond_the_last_row_is_not_taken():
    plant = LinearPlant([[1e300]], [[0.0]], [[1e-300]])
    made = scheme(outputs=1, inputs=1)
    with pytest.raises(DivergedError, match="at k = 2: the plant's state is no longer finite"):
        simulate(made, plant, [1.0], 3)
    for of in (plant, as_functions(plant)):
        assert len(simulate(made, of, [1.0], 2)) == 2


# What is kept


def test_a_batch_keeps_at_most_a_hundred_bytes_a_plant_and_step():
    trace = simulate(LINEAR.scheme, LINEAR.plant, np.tile(LINEAR.z0, (500, 1)), 40)
    kept = {id(array.base): array.base.nbytes for array in (trace.y, trace.v, trace.z)}
    assert trace.models is None
    assert trace.computed is None
    assert sum(kept.values()) == 40 * 40 * 500
    with_models = simulate(LINEAR.scheme, LINEAR.plant, np.tile(LINEAR.z0, (500, 1)), 4, record="models")
    assert with_models.models.model.nbytes == 4 * 500 * 32 * 8


def test_a_trace_cannot_be_written_into():
    trace = simulate(*COMPILED["plain"], Z0, 3)
    for array in (trace.y, trace.v, trace.z):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"steps": 0}, "steps must be an integer of at least 1, got 0"),
        ({"steps": 2.5}, r"steps must be an integer of at least 1, got 2\.5"),
        ({"record": "plans"}, "record must be one of signals, models, got 'plans'"),
        ({"progress": 3}, "progress must be a function of a trace, got 3"),
        ({"z0": [1.0]}, r"z0 must have shape \(3,\), got \(1,\)"),
        ({"applied_known": 1}, "applied_known must be True or False, got 1"),
    ],
)
def test_refused(change, sentence):
    given = {"scheme": LINEAR.scheme, "plant": LINEAR.plant, "z0": LINEAR.z0, "steps": 3} | change
    with pytest.raises(InputError, match=sentence):
        simulate(**given)


def test_a_plant_that_brings_another_shape_is_refused():
    class Growing(Counting):
        def step(self, z, v):
            return np.broadcast_to(0.5 * z + v, (2, 1))

    with pytest.raises(
        InputError, match=r"the plant's step must return a state of shape \(1,\), as z0 has, got \(2, 1\)"
    ):
        simulate(window_scheme(1, 1, 1), Growing(), [1.0], 3)


@pytest.mark.parametrize(
    ("found", "sentence"),
    [
        ([1.0, 2.0], r"the plant's output must have shape \(\.\.\., 1\) for states .*, got \(2,\)"),
        ([1j], "the plant's output must return real numbers, got"),
        (None, "the plant's output must return real numbers, got None"),
    ],
)
@pytest.mark.parametrize("lead", [(), (2,)])
def test_an_output_of_another_kind_is_refused(found, sentence, lead):
    class Odd(Counting):
        def output(self, z):
            return found if found is None or not lead else [found, found]

    with pytest.raises(InputError, match=sentence.replace("(2,", "(2, 2" if lead else "(2,")):
        simulate(window_scheme(1, 1, 1), Odd(), np.ones((*lead, 1)), 3)


def test_a_batch_of_nothing_is_refused():
    with pytest.raises(InputError, match=r"z0 must hold at least one member of the batch, got shape \(0, 2\)"):
        simulate(scheme(), PLANT, np.ones((0, 2)), 3)


def test_an_epsilon_that_rises_is_refused_where_it_does():
    made = replace(scheme(), controller=Controller(1.0, 1.0, 1.0, 4, lambda k: 1.0 if k != 3 else 2.0))
    with pytest.raises(InputError, match=r"epsilon must not rise .*, got 2 at k = 3 after 1"):
        simulate(made, PLANT, Z0, 10)


# Where there is no compiler


INTERPRETED = """
import sys
sys.modules["numba"] = None
import numpy as np
from rhl.paper.published import linear_example
example = linear_example()
from rhl import simulate
print(*(float(v).hex() for v in simulate(example.scheme, example.plant, example.z0, 2).v[:, 0]))
"""


def test_the_loops_also_run_interpreted():
    done = subprocess.run([sys.executable, "-c", INTERPRETED], capture_output=True, text=True, check=True)
    compiled = simulate(LINEAR.scheme, LINEAR.plant, LINEAR.z0, 2).v[:, 0]
    found = [float.fromhex(word) for word in done.stdout.split()]
    np.testing.assert_allclose(found, compiled, rtol=1e-12)


def test_the_paper_runs():
    assert np.max(np.abs(LINEAR.run().z[-1])) < 1
    assert np.max(np.abs(ROBOT.run().z[-1])) < 1


def test_every_loop_that_python_calls_is_compiled_beforehand(monkeypatch):
    """What `make env` runs leaves nothing to compile, so that no notice appears in a notebook."""
    import runpy

    from rhl.kernels import loops

    called = set()
    for name in ("recursion", "rollout", "fit", "newton_step", "run"):
        real = getattr(loops, name)
        monkeypatch.setattr(loops, name, lambda *given, name=name, real=real: (called.add(name), real(*given)))
    runpy.run_module("rhl.kernels.__main__")
    assert called == {"recursion", "rollout", "fit", "newton_step", "run"}


def test_a_diverged_run_comes_through_a_pool_of_processes():
    with pytest.raises(DivergedError) as caught:
        simulate(scheme(), member(doomed(1, [0]), 0), [1.0, 1.0], 50)
    again = pickle.loads(pickle.dumps(caught.value))
    assert (again.k, str(again)) == (caught.value.k, str(caught.value))
    assert np.array_equal(again.trace.y, caught.value.trace.y)


@pytest.mark.parametrize("how", ["compiled", "adaptive"])
def test_a_batch_of_which_nothing_is_left(how):
    batch = simulate(scheme(adaptive=how == "adaptive"), doomed(3, [0, 1, 2]), np.ones((3, 2)), 40)
    assert np.all(batch.diverged_at > 0)
    assert np.all(np.isfinite(batch.z))


def test_an_actuator_cannot_write_into_what_was_computed():
    with pytest.raises(ValueError, match="read-only"):
        simulate(scheme(), PLANT, Z0, 5, actuator=lambda k, v: np.multiply(v, 0.5, out=v))


@pytest.mark.parametrize("record", ["signals", "models"])
@pytest.mark.parametrize("steps", [10**18, 2**62, 2**63, 10**30])
def test_more_steps_than_memory_are_an_input_error(steps, record):
    example = linear_example()
    wanted = rf"^steps must be such that the signals of all steps fit into memory, got {steps} for a batch of 1 \(\w+: "
    with pytest.raises(InputError, match=wanted):
        simulate(example.scheme, example.plant, example.z0, steps, record=record)
    with pytest.raises(InputError, match=wanted):
        simulate(example.scheme, example.plant, example.z0, steps, record=record, actuator=Saturation(-1.0, 1.0))
    assert len(simulate(example.scheme, example.plant, example.z0, 3, record=record)) == 3
