"""Set points against the same scheme on the plant that increments and errors see, and under constant disturbances."""

from dataclasses import replace

import numpy as np
import pytest

from rhl import (
    InputError,
    LinearPlant,
    LiveController,
    Saturation,
    Trace,
    closed_loop,
    default_scheme,
    simulate,
    window_scheme,
)
from rhl.basis import Polynomials
from rhl.disturbances import GaussianNoise, Offset
from rhl.lifting import DelayLifting
from rhl.plants.analysis import observability_index
from rhl.tracking import SetPoint, seen

PLANT = LinearPlant([[1.1, 0.4], [0.0, 0.7]], [[0.0], [1.0]], [[1.0, 0.0]])


def random_plant(seed, n, p, q):
    rng = np.random.default_rng(seed)
    F = rng.standard_normal((n, n))
    F *= rng.uniform(0.8, 1.15) / np.abs(np.linalg.eigvals(F)).max()
    return LinearPlant(F, rng.standard_normal((n, q)), rng.standard_normal((p, n))), rng


@pytest.mark.parametrize("seed", range(6))
def test_is_the_scheme_on_the_plant_of_increments(seed):
    q = 1 + seed % 2
    plant, rng = random_plant(seed, 3, q, q)
    held, r = rng.standard_normal(q), None
    z_held = np.linalg.solve(np.eye(3) - plant.F, plant.G @ held)
    r = plant.H @ z_held
    order = observability_index(plant.F, plant.H)
    run = simulate(default_scheme(q, q, order, set_point=SetPoint(r)), plant, np.zeros(3), 250)
    of_increments = LinearPlant(
        np.block([[plant.F, plant.G], [np.zeros((q, 3)), np.eye(q)]]),
        np.concatenate([plant.G, np.eye(q)]),
        np.concatenate([plant.H, np.zeros((q, q))], axis=1),
    )
    scheme = replace(default_scheme(q, q, order, set_point=SetPoint(r)), set_point=None)
    plain = simulate(scheme, of_increments, np.concatenate([-z_held, -held]), 250)
    size = np.abs(plain.y).max()
    # Rounding of y - r grows along the transient of an unstable plant.
    assert np.abs(run.error - plain.y)[:15].max() < 1e-7 * size
    assert np.abs(np.diff(run.v, axis=0, prepend=0.0) - plain.v)[:15].max() < 1e-6 * np.abs(plain.v).max()
    assert np.abs(run.error[-1]).max() < 1e-6 * size
    assert np.allclose(run.v[-1], held, rtol=1e-5)


def test_constant_disturbances_do_not_matter():
    for load, bias in ((0.7, 0.0), (-2.0, 0.3)):
        errs = {"load": Offset(load), "sensor": Offset(bias)}
        run = simulate(default_scheme(1, 1, 2, set_point=SetPoint(1.0)), PLANT, [0.0, 0.0], 150, **errs)
        assert np.abs(run.y[-20:] - 1.0).max() < 1e-8
        assert np.abs(np.diff(run.v[-20:], axis=0)).max() < 1e-8
        without = simulate(default_scheme(1, 1, 2), PLANT, [0.0, 0.1], 150, **errs)
        assert np.abs(without.y[-20:]).max() > 1e-3


def test_a_load_in_mid_run_is_rejected():
    run = simulate(
        default_scheme(1, 1, 2, set_point=SetPoint(0.0)), PLANT, [1.0, 0.0], 300, load=Offset(0.5, start=100)
    )
    assert np.abs(run.y[80:100]).max() < 1e-6
    assert np.abs(run.y[100:120]).max() > 1e-2
    assert np.abs(run.y[-20:]).max() < 1e-3


def test_a_set_point_that_changes():
    def staircase(k):
        return [0.0, 1.0, -0.5][min(k // 60, 2)]

    run = simulate(default_scheme(1, 1, 2, set_point=SetPoint(staircase)), PLANT, [0.3, 0.0], 200)
    for k in (55, 115, 195):
        assert abs(run.y[k, 0] - staircase(k)) < 1e-6
    assert np.all(run.newton_decrement < 1e-6)
    late = np.abs(run.error)[60:].max()
    assert late < 3.0


@pytest.mark.parametrize("make", [default_scheme, window_scheme])
def test_a_trace_rebuilds_every_step(make):
    def ramp(k):
        return 0.1 * min(k, 10)

    scheme = replace(make(1, 1, 3), set_point=SetPoint(ramp))
    run = simulate(scheme, PLANT, [0.1, 0.0], 40, sensor=GaussianNoise(1e-3, 0))
    steps = []
    for done, _ in zip(closed_loop(scheme, PLANT, [0.1, 0.0], sensor=GaussianNoise(1e-3, 0)), range(40), strict=False):
        steps.append(done)
    assert np.array_equal(Trace.of_steps(scheme, steps).v, run.v)
    for done, again in zip(steps, run.steps, strict=True):
        for name in ("y", "v_computed", "size", "data", "y_hat"):
            one, two = getattr(done, name), getattr(again, name)
            assert (one is None) == (two is None)
            assert one is None or np.allclose(one, two, rtol=1e-12, atol=1e-14), (name, done.k)
        before = done.state.v[0] if done.k else 0.0
        assert np.allclose(before + done.plan.u[0], done.v_computed, rtol=1e-9, atol=1e-12)
        assert np.allclose(done.plan.u, again.plan.u, rtol=1e-9, atol=1e-12)
    assert np.all(run.newton_decrement < 1e-7)


def test_bounds_hold_for_the_input_not_for_its_increments():
    actuator = Saturation(-0.4, 0.6)
    scheme = default_scheme(1, 1, 2, bounds=actuator, set_point=SetPoint(0.5))
    stable = LinearPlant([[0.9, 0.4], [0.0, 0.7]], [[0.0], [0.3]], [[1.0, 0.0]])
    run = simulate(scheme, stable, [0.0, 0.0], 150, actuator=actuator)
    assert np.all((run.v >= -0.4) & (run.v <= 0.6))
    assert np.any(run.v > 0.6 - 1e-6)
    assert np.abs(run.y[-1] - 0.5).max() < 1e-6


def test_a_batch_is_its_members():
    scheme, starts = default_scheme(1, 1, 2, set_point=SetPoint(1.0)), np.array([[0.0, 0.0], [1.0, -1.0]])
    together = simulate(scheme, PLANT, starts, 40, record="models")
    for i, z0 in enumerate(starts):
        alone = simulate(scheme, PLANT, z0, 40)
        assert np.allclose(together.v[:, i], alone.v, rtol=1e-9, atol=1e-12)
        assert np.allclose(together.y_hat[:, i], alone.y_hat, rtol=1e-9, atol=1e-12)


def test_a_live_controller_takes_another_set_point_in_mid_run():
    z, controller = np.zeros(2), LiveController(default_scheme(1, 1, 2, set_point=SetPoint(1.0)))
    for r in (1.0, -2.0):
        controller = LiveController(replace(controller.scheme, set_point=SetPoint(r)), controller.state)
        for _ in range(80):
            z = PLANT.step(z, controller.step(PLANT.output(z)))
        assert abs(PLANT.output(z)[0] - r) < 1e-6


def test_without_a_set_point_signals_are_seen_as_they_are():
    y, v = np.ones((3, 1)), np.ones((4, 1))
    assert seen(None, 5, y, v) == (y, v)
    e, d = seen(SetPoint(3.0), 1, y, v)
    assert e.ravel().tolist() == [-2.0, -2.0, 0.0]  # the last is from before k = 0
    assert d.ravel().tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("value", "sentence"),
    [
        (np.nan, "value must be finite"),
        ([[1.0]], "value must be a number or one for each output"),
        ([], "value must be a number or one for each output"),
        ("a", "value must hold real numbers"),
    ],
)
def test_bad_set_points(value, sentence):
    with pytest.raises(InputError, match=sentence):
        SetPoint(value)


def test_set_points_of_another_size():
    with pytest.raises(InputError, match="the set point must be a number or have 2 entries, one for each output, got"):
        default_scheme(2, 1, 1, set_point=SetPoint([1.0, 2.0, 3.0]))
    with pytest.raises(InputError, match="the set point at k = 0 must be finite"):
        default_scheme(2, 1, 1, set_point=SetPoint(lambda k: [np.nan, 1.0]))
    with pytest.raises(InputError, match="set_point must be a SetPoint, got 1"):
        default_scheme(1, 1, 1, set_point=1.0)
    scheme = window_scheme(1, 1, 2)
    lifted = DelayLifting(2, 2, Polynomials(2))
    n = lifted.size(1)
    model = type(scheme.initial_model)(np.eye(n), np.ones((n, 2)))
    with pytest.raises(InputError, match="set_point must be None where a lifting appends basis functions"):
        replace(scheme, lifting=lifted, initial_model=model, set_point=SetPoint(0.0), controller=scheme.controller)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [((np.inf,), "value must be finite"), ((1.0, -1), "start must be an integer"), (([[1.0]],), "value must be a num")],
)
def test_bad_offsets(arguments, sentence):
    with pytest.raises(InputError, match=sentence):
        Offset(*arguments)
    with pytest.raises(InputError, match="value must be a number or have 2 entries"):
        Offset([1.0, 2.0, 3.0])(0, np.zeros(2))


def test_the_room_for_increments_is_what_the_input_has_left():
    made = default_scheme(1, 1, 2, bounds=Saturation(-0.4, 0.6), set_point=SetPoint(0.5))
    left = made.controller._bounds(1, np.array([0.5]))
    assert np.allclose([left.low, left.high], [[-0.9], [0.1]])
    assert left.summed
