"""A family of initial models: its estimates, its choice, its grid, and the loop that uses it."""

from dataclasses import replace

import numpy as np
import pytest

from rhl.closed_loop import advance, start, step
from rhl.controllability import ConstantMixing, controllability_margin
from rhl.errors import InputError
from rhl.estimator import ProximalEstimator
from rhl.family import ModelFamily
from rhl.lifting import DelayLifting
from rhl.live import LiveController
from rhl.memory import GrowingMemory
from rhl.model import SignalModel
from rhl.paper.claims.theorem_4 import family_scheme, silent_model
from rhl.plants import LinearPlant
from rhl.scheme import default_scheme
from rhl.simulation import simulate
from rhl.tracking import SetPoint

UNSTABLE = LinearPlant(2 * np.eye(1), np.eye(1), np.eye(1))


def scalar_margin(model):
    return np.abs(model.B[..., 0, 0])


def test_members_are_estimates_from_their_initial_models():
    rng, memory = np.random.default_rng(0), GrowingMemory(0.1)
    family = ModelFamily(np.concatenate([np.zeros((1, 1, 4)), rng.normal(size=(3, 1, 4))]))
    initial, data = SignalModel(rng.normal(size=(2, 2)), rng.normal(size=(2, 2))), memory.begin(2, 2)
    for _ in range(5):
        data = memory.remember(data, rng.normal(size=(2, 2)), rng.normal(size=(1, 2)))
    members = family.members(memory.minimise(initial, data), memory.spread(data))
    for i, shift in enumerate(family.shifts):
        A, B = np.array(initial.A), np.array(initial.B)
        A[:1] += shift[:, :2]
        B[:1] += shift[:, 2:]
        alone = memory.minimise(SignalModel(A, B), data)
        assert np.allclose(members.A[i], alone.A, atol=1e-12)
        assert np.allclose(members.B[i], alone.B, atol=1e-12)
        one = SignalModel(members.A[i], members.B[i])
        assert family.nearest(one, memory.minimise(initial, data), memory.spread(data)) == i


def test_spread_is_the_identity_without_data_and_its_diagonal_is_what_is_unknown():
    memory, rng = GrowingMemory(0.3), np.random.default_rng(1)
    data = memory.begin(1, 2)
    assert np.allclose(memory.spread(data), np.eye(3), atol=1e-15)
    for _ in range(2):
        data = memory.remember(data, rng.normal(size=(2, 1)), rng.normal(size=(1, 2)))
    spread = memory.spread(data)
    assert np.allclose(np.diag(spread), memory.unknown(data), rtol=1e-12)
    assert np.all(np.linalg.eigvalsh(spread) > 0)
    assert np.max(np.linalg.eigvalsh(spread)) <= 1 + 1e-12


@pytest.mark.parametrize(("own", "kept"), [(0.02, True), (0.005, False)])
def test_a_member_is_changed_only_below_the_share(own, kept):
    family = ModelFamily(np.array([[[0.0, 0.0]], [[0.0, 1.0]]]), hysteresis=0.01)
    estimate = SignalModel(np.eye(1), np.array([[own]]))  # margins own and own + 1
    chosen = family.choose(np.array(0), estimate, np.eye(2), lambda model: model)
    assert (float(scalar_margin(chosen)) == own) is kept


def test_what_is_no_estimate_is_refused():
    with pytest.raises(InputError, match="estimate must be a SignalModel, got"):
        ModelFamily.grid(1, 1, 1, 1).choose(np.array(0), [[1.0]], np.eye(2), lambda model: model)


def test_a_batch_is_its_members():
    rng, family = np.random.default_rng(2), ModelFamily.grid(1, 1, 1, 1)
    estimate = SignalModel(rng.normal(size=(4, 1, 1)), rng.normal(size=(4, 1, 1)) * [[[1e-3]], [[1]], [[1]], [[0]]])
    spread, at = np.stack([np.diag(rng.uniform(0.1, 1, 2)) for _ in range(4)]), np.array([0, 1, 0, 1])
    together = family.choose(at, estimate, spread, lambda model: model)
    for i in range(4):
        one = SignalModel(estimate.A[i], estimate.B[i])
        alone = family.choose(at[i], one, spread[i], lambda model: model)
        assert np.array_equal(alone.A, together.A[i])
        assert np.array_equal(alone.B, together.B[i])


def test_a_silent_model_never_acts_alone_and_does_with_a_family():
    alone = simulate(family_scheme(1, 1, 1, alone=True), UNSTABLE, [1.0], 30)
    assert np.all(alone.v == 0)
    assert alone.z[-1, 0] == 2.0**29
    helped = simulate(family_scheme(1, 1, 1), UNSTABLE, [1.0], 60)
    assert np.max(np.abs(helped.z)) < 20
    assert np.abs(helped.z[-1, 0]) < 1e-6
    assert np.min(helped.s_plus[1:]) > 0


def test_a_trace_takes_its_steps_again():
    scheme = family_scheme(1, 1, 2)
    plant = LinearPlant(np.array([[1.2, 1.0], [0.0, 0.7]]), np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]]))
    trace = simulate(scheme, plant, [1.0, -1.0], 25)
    assert np.max(trace.newton_decrement) < 1e-12
    for k in (0, 3, 11, 24):
        again = trace.steps[k]
        redone = step(scheme, again.state, again.y)
        assert np.array_equal(redone.model.A, trace.model(k).A)
        assert np.array_equal(redone.v_computed, trace.v[k])
        assert again.plan.residual() < 1e-9
    state = start(scheme)
    for k in range(25):
        done = step(scheme, state, trace.y[k])
        assert np.array_equal(done.v_computed, trace.v[k])
        state = advance(scheme, done)


def test_a_saved_controller_goes_on(tmp_path):
    scheme, rng = family_scheme(1, 1, 2), np.random.default_rng(3)
    measured = rng.normal(size=(20, 1))
    one = LiveController(scheme)
    inputs = [one.step(y) for y in measured[:10]]
    one.save(tmp_path / "state.npz")
    other = LiveController.restore(scheme, tmp_path / "state.npz")
    for y in measured[10:]:
        assert np.array_equal(one.step(y), other.step(y))
    assert len(inputs) == 10


def test_a_batch_of_loops_is_its_loops():
    F = np.array([[[2.0]], [[0.5]], [[1.3]]])
    plant = LinearPlant(F, np.ones((3, 1, 1)), np.ones((3, 1, 1)))
    together = simulate(family_scheme(1, 1, 1), plant, np.ones((3, 1)), 20)
    for i in range(3):
        alone = simulate(family_scheme(1, 1, 1), LinearPlant(F[i], np.eye(1), np.eye(1)), [1.0], 20)
        assert np.allclose(together.z[:, i], alone.z, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("p", "outputs", "q", "inputs", "count"),
    [(1, 1, 1, 1, 3), (1, 2, 1, 2, 35), (1, 3, 1, 3, 462), (2, 1, 1, 1, 84), (1, 1, 2, 1, 4), (2, 1, 2, 1, 495)],
)
def test_grid_sizes(p, outputs, q, inputs, count):
    shifts = ModelFamily.grid(p, outputs, q, inputs, size=0.5).shifts
    assert shifts.shape == (count, p, p * outputs + q * inputs)
    assert np.all(shifts[0] == 0)
    assert np.max(np.abs(shifts)) == 0.5
    assert len(np.unique(shifts.reshape(count, -1), axis=0)) == count


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: ModelFamily(np.zeros((2, 3))), "shifts must have shape"),
        (lambda: ModelFamily(np.ones((2, 1, 2))), "with one that is zero, got shape"),
        (lambda: ModelFamily(np.zeros((1, 1, 2)), hysteresis=0.0), "hysteresis must be a positive"),
        (lambda: ModelFamily(np.zeros((1, 1, 2)), hysteresis=1.0), "hysteresis must be"),
        (lambda: ModelFamily.grid(3, 2, 2, 2), "the grid must have at most 50000 members, got"),
        (lambda: ModelFamily.grid(0, 1, 1, 1), "p must be an integer"),
        (
            lambda: replace(family_scheme(1, 1, 1), estimator=ProximalEstimator(2)),
            "a family of initial models must come with a GrowingMemory, no mixing and no units",
        ),
        (lambda: replace(family_scheme(1, 1, 1), mixing=ConstantMixing(0.5)), "no mixing"),
        (lambda: replace(default_scheme(1, 1, 1), family=ModelFamily.grid(1, 1, 1, 1)), "and no units"),
        (lambda: replace(family_scheme(1, 1, 1), family=ModelFamily.grid(1, 2, 1, 2)), "the family's shifts must have"),
        (
            lambda: family_scheme(1, 1, 2, SignalModel.companion_of_ones(2, 2)),
            "the initial model of a family must shift stacked outputs",
        ),
    ],
)
def test_bad_families_are_refused(call, sentence):
    with pytest.raises(InputError, match=sentence):
        call()


def test_the_silent_model_is_not_controllable():
    scheme = family_scheme(1, 1, 2)
    assert float(controllability_margin(scheme.lifting.augment(silent_model(1, 1, 2)))) == 0


@pytest.mark.parametrize("initial", [None, SignalModel.shift_of_ones(1, 2, 1, 2)])
def test_the_model_in_use_is_the_estimate_from_one_of_the_initial_models(initial):
    """From all transitions, the newest too, with the centre that it had at k = 0."""
    scheme = family_scheme(1, 1, 2, initial)
    plant = LinearPlant(np.array([[1.2, 1.0], [0.0, 0.7]]), np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]]))
    trace = simulate(scheme, plant, [1.0, -1.0], 15)
    memory, (x, u) = scheme.estimator, trace.lifted
    data = memory.begin(2, 2)
    for k, done in enumerate(trace.steps):
        if k >= scheme.first_measured:
            data = memory.remember(data, x[[k, k - 1]], u[[k]])
        ends = []
        for shift in scheme.family.shifts:
            A, B = np.array(scheme.initial_model.A), np.array(scheme.initial_model.B)
            A[:1] += shift[:, :2]
            B[:1] += shift[:, 2:]
            alone = memory.minimise(SignalModel(A, B), data)
            ends.append(max(np.max(np.abs(alone.A - done.model.A)), np.max(np.abs(alone.B - done.model.B))))
        assert min(ends) < 1e-9


@pytest.mark.parametrize(
    ("sizes", "sentence"),
    [
        ((1, 10**12, 1, 10**12), "must have at most 50000 members, got 2000000000000 entries of a shift alone"),
        ((1, 1, 40_000, 1), "must have at most 50000000 numbers, got 16"),
        ((2, 3, 2, 3), "must have at most 50000 members, got "),
    ],
)
def test_grids_that_would_fill_the_memory(sizes, sentence):
    with pytest.raises(InputError, match=sentence):
        ModelFamily.grid(*sizes)


def test_a_family_with_a_set_point_says_how_many_signals_are_stacked():
    scheme = family_scheme(1, 1, 2)
    larger = SignalModel.shift_of_ones(1, 3, 1, 3)
    for goal, told in ((SetPoint([1.0]), True), (None, False)):
        with pytest.raises(InputError, match="shifts must have shape") as caught:
            replace(scheme, lifting=DelayLifting(3, 3), initial_model=larger, set_point=goal)
        assert ("with a set point a scheme stacks one output and input more" in str(caught.value)) is told
