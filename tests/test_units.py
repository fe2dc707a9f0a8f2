"""Running units: a plant in other units gives the same run; steps, plans and weights agree with the trace."""

from dataclasses import replace

import numpy as np
import pytest

from rhl import (
    GaussianNoise,
    GrowingMemory,
    InputError,
    LinearConstraints,
    LinearPlant,
    ProximalEstimator,
    RunningUnits,
    SignalModel,
    advance,
    closed_loop,
    default_scheme,
    simulate,
    start,
    step,
    window_scheme,
)
from rhl.basis import Polynomials
from rhl.lifting import DelayLifting
from rhl.losses import LogCosh, WeightedSquares
from rhl.plants.examples import example

STEPS = 60


def plant(seed, n=4, p=2, q=2, radius=1.15):
    rng = np.random.default_rng(seed)
    F = rng.standard_normal((n, n))
    F *= radius / np.abs(np.linalg.eigvals(F)).max()
    return LinearPlant(F, rng.standard_normal((n, q)), rng.standard_normal((p, n))), rng.standard_normal(n)


def gap(run, other, outputs, inputs=1.0):
    """The largest difference of two runs, each signal relative to its peak, once brought to the same units."""
    y, v = np.abs(run.y).max(axis=0), np.abs(run.v).max(axis=0)
    return max((np.abs(other.y / outputs - run.y) / y).max(), (np.abs(other.v / inputs - run.v) / v).max())


@pytest.mark.parametrize("seed", range(20))
def test_the_same_run_in_millimetres(seed):
    found, z0 = plant(seed)
    outputs = np.array([1e3, 2e-4])
    other = LinearPlant(found.F, found.G, outputs[:, None] * found.H)
    run, changed = (simulate(default_scheme(2, 2, 2), of, z0, STEPS) for of in (found, other))
    assert gap(run, changed, outputs) < 1e-6
    # The control: weights that count in the units of the signals give another run.
    run, changed = (simulate(window_scheme(2, 2, 2), of, z0, 12) for of in (found, other))
    assert gap(run, changed, outputs) > 1e-2


@pytest.mark.parametrize("seed", range(5))
def test_the_same_run_in_kilonewtons(seed):
    found, z0 = plant(seed)
    inputs = np.array([1e-3, 50.0])
    other = LinearPlant(found.F, found.G / inputs, found.H)
    run = simulate(default_scheme(2, 2, 2), found, z0, STEPS)
    changed = simulate(default_scheme(2, 2, 2, inputs=0.1 * inputs), other, z0, STEPS)
    assert gap(run, changed, 1.0, inputs) < 1e-6
    assert gap(run, simulate(default_scheme(2, 2, 2), other, z0, STEPS), 1.0, inputs) > 1e-2


@pytest.mark.parametrize("seed", range(5))
def test_the_same_run_in_millimetres_with_noise(seed):
    found, z0 = plant(seed)
    outputs, std = np.array([1e3, 2e-4]), np.array([0.01, 0.03])
    other = LinearPlant(found.F, found.G, outputs[:, None] * found.H)

    def noisy(of, units, expected):
        sensor = GaussianNoise(units * std, seed=seed)
        return simulate(default_scheme(2, 2, 2, noise=expected), of, z0, STEPS, sensor=sensor)

    run = noisy(found, 1.0, std)
    assert gap(run, noisy(other, outputs, outputs * std), outputs) < 1e-6
    # The control: noise has the unit of its output.
    assert gap(run, noisy(other, outputs, std), outputs) > 1e-2


def test_inputs_that_the_initial_model_cannot_tell_apart_are_parted_by_rounding():
    """Why no two columns of B(0) are equal: with equal ones the inputs stay equal, and a run is what rounding makes."""
    gaps = []
    for seed in range(6):
        found, z0 = plant(seed)
        scheme = default_scheme(2, 2, 2)
        alike = replace(scheme, initial_model=replace_B(scheme.initial_model, np.sign(scheme.initial_model.B)))
        other = LinearPlant(found.F, found.G, 1e3 * found.H)
        gaps.append(gap(*(simulate(alike, of, z0, STEPS) for of in (found, other)), 1e3))
    assert max(gaps) > 1e-3


def test_an_output_that_is_zero_at_first_has_no_unit_either():
    found = LinearPlant([[1.1, 0.3], [0.0, 0.9]], [[0.2], [1.0]], [[0.0, 1.0], [1.0, 0.0]])
    z0, outputs = [0.0, 1.0], np.array([1.0, 1e4])
    other = LinearPlant(found.F, found.G, outputs[:, None] * found.H)
    run, changed = (simulate(default_scheme(2, 1, 2), of, z0, STEPS) for of in (found, other))
    assert run.y[0, 1] == 0.0
    assert gap(run, changed, outputs) < 1e-6
    assert np.abs(run.z[-1]).max() < 1e-6


def test_a_plant_at_rest_stays_there():
    run = simulate(default_scheme(1, 1, 2), LinearPlant([[1.2]], [[1.0]], [[1.0]]), [0.0], 5)
    assert np.all(run.v == 0.0)


def test_steps_plans_and_weights_of_a_trace_are_those_taken():
    found, z0 = plant(3)
    first = default_scheme(2, 2, 2)
    noisy = default_scheme(2, 2, 2, noise=[1e-3, 0.1])
    for scheme in (first, replace(first, controller=replace(first.controller, model_delay=1)), noisy):
        run, loop = simulate(scheme, found, z0, 15), closed_loop(scheme, found, z0)
        state = start(scheme)
        for k, taken in zip(range(15), loop, strict=False):
            recorded = run.steps[k]
            assert np.array_equal(taken.v_computed, run.v[k])
            for before in (taken.state, recorded.state, state):
                again = step(scheme, before, run.y[k])
                assert np.array_equal(again.v_computed, run.v[k])
                assert np.array_equal(again.data, recorded.data)
                assert np.array_equal(again.size, recorded.size)
            state = advance(scheme, recorded)
            assert taken.plan.is_optimal(1e-9)
            assert np.allclose(taken.plan.u[0], run.v[k], rtol=1e-9, atol=1e-12 * np.abs(run.v).max())
            assert np.isclose(run.weight[k], taken.problem.weight, rtol=1e-12)
        assert np.all(run.newton_decrement < 1e-9)


def test_a_batch_is_its_members():
    plants = [plant(seed, radius=0.9 + 0.1 * seed) for seed in range(4)]
    batch = LinearPlant(*(np.stack([getattr(of, name) for of, _ in plants]) for name in "FGH"))
    together = simulate(default_scheme(2, 2, 2), batch, np.stack([z0 for _, z0 in plants]), 40)
    for i, (of, z0) in enumerate(plants):
        alone = simulate(default_scheme(2, 2, 2), of, z0, 40)
        assert np.abs(together.y[:, i] - alone.y).max() < 1e-6 * np.abs(alone.y).max()


def test_an_input_that_does_nothing_stays_bounded():
    """Its estimated effect goes to zero; were its size to grow as one over that, the run would leave float64."""
    dead = LinearPlant([[1.1, 0.3], [0.0, 0.9]], [[0.5, 0.0], [1.0, 0.0]], [[1.0, 0.2]])
    run = simulate(default_scheme(1, 2, 2), dead, [1.0, -1.0], 100)
    assert np.abs(run.y[-1]).max() < 1e-12
    assert np.abs(run.v).max() < 1e5 * 0.1
    alone = simulate(default_scheme(1, 1, 2), LinearPlant([[0.5]], [[0.0]], [[1.0]]), [1.0], 100)
    assert np.abs(alone.v).max() < 1e5 * 0.1


def test_the_size_of_an_input_is_what_it_moves():
    scheme = default_scheme(1, 1, 2)
    units, lifting = scheme.units, scheme.lifting
    model = replace_B(scheme.initial_model, [[0.5, -1.5], [0.0, 0.0]])
    of_x, of_v = units.weights(model, lifting, np.array([4.0]), 1)
    assert np.allclose(of_v, [(0.5 + 1.5) / 4.0])
    assert np.allclose(of_x, [0.25, 0.25, 0.5 * np.sqrt(units.past)])


def test_an_input_counts_in_a_smaller_size_while_its_effect_is_unknown():
    scheme = default_scheme(1, 2, 2, inputs=[0.5, 2.0])
    units, lifting, size = scheme.units, scheme.lifting, np.array([4.0])
    model = replace_B(scheme.initial_model, [[0.5, -1.5, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0]])
    known_x, known_v = units.weights(model, lifting, size, 2, np.zeros(6))
    assert np.allclose(known_v, units.weights(model, lifting, size, 2)[1])
    found_x, found_v = units.weights(model, lifting, size, 2, np.array([0.0, 0.0, 1.0, 0.04, 1.0, 1.0]))
    assert np.allclose(found_v, np.hypot(known_v, units.caution * np.array([1.0 / 0.5, 0.2 / 2.0])))
    assert np.array_equal(found_x, known_x)
    bold = replace(units, caution=0.0).weights(model, lifting, size, 2, np.ones(6))[1]
    assert np.array_equal(bold, known_v)


def test_caution_keeps_a_flexible_shaft_in_place():
    """Its input does little at first, so that an estimate made of few data asks for a very large one."""
    shaft, scheme = example("flexible-shaft"), default_scheme(1, 1, 4)
    bold = replace(scheme, units=replace(scheme.units, caution=0.0))
    peaks = [np.abs(simulate(of, shaft.plant, shaft.z0, 200).y).max() for of in (scheme, bold)]
    assert peaks[0] < 3 < 10 < peaks[1]


def test_noise_holds_the_estimate():
    """Told of the noise, the memory's weight counts signals in sizes as large as the noise makes them."""
    units, lifting = default_scheme(2, 1, 2, noise=[0.0, 0.3]).units, DelayLifting(2, 2)
    exact = default_scheme(2, 1, 2).units
    size = np.array([5.0, 3.0])
    grown = units.parameters(lifting, size, 1) / exact.parameters(lifting, size, 1)
    assert np.allclose(grown, 0.1 / 1e-5)
    assert np.array_equal(*(of.parameters(lifting, np.array([5.0, 0.0]), 1) for of in (units, exact)))


def replace_B(model, B):
    return type(model)(model.A, B)


@pytest.mark.parametrize("inputs", [0.0, -1.0, [1.0, 0.0], [], [[1.0]], "1", np.inf])
def test_bad_sizes(inputs):
    with pytest.raises(InputError, match="inputs must"):
        RunningUnits(inputs)


@pytest.mark.parametrize("make", [default_scheme, lambda *sizes: default_scheme(*sizes, noise=1e-3)])
def test_outputs_that_begin_at_zero_or_near_it(make):
    """An output that begins at zero has no size to count in; it gets one when it is seen."""
    unstable = LinearPlant([[1.1, 1.0], [0.0, 0.9]], [[0.0], [1.0]], [[1.0, 0.0]])
    runs = [simulate(make(1, 1, 2), unstable, [first, 1.0], 100) for first in (0.0, 1e-9)]
    for run in runs:
        assert np.abs(run.v).max() > 0
        assert np.abs(run.y).max() < 100
        assert np.abs(run.y[-1]).max() < 1e-3
        steps = [done.centre.theta for done in run.steps]
        assert np.all(run.newton_decrement < 1e-6)
        assert not np.array_equal(steps[1], steps[0])
    assert np.abs(runs[0].y).max() == pytest.approx(np.abs(runs[1].y).max(), rel=1e-3)
    late = simulate(make(1, 1, 2), unstable, [0.0, 0.0], 150, load=lambda k, v: v + (0.3 if k >= 20 else 0.0))
    assert np.all(late.v[:20] == 0)
    assert np.abs(late.v).max() > 0
    assert np.abs(late.y).max() < 1e4


def test_a_window_counts_in_sizes_too():
    found, z0 = plant(3)
    window = ProximalEstimator(8, LogCosh(0.1), WeightedSquares(1e-4))
    scheme = replace(default_scheme(2, 2, 2), estimator=window)
    other = LinearPlant(found.F, found.G, np.diag([1e3, 1e-3]) @ found.H)
    run, changed = (simulate(scheme, of, z0, 30) for of in (found, other))
    assert gap(run, changed, np.array([1e3, 1e-3]), 1.0) < 1e-6
    assert np.all(run.newton_decrement < 1e-9)
    raw = replace(scheme, units=None)
    run, changed = (simulate(raw, of, z0, 12) for of in (found, other))
    assert gap(run, changed, np.array([1e3, 1e-3]), 1.0) > 1e-2


@pytest.mark.parametrize("caution", [-1.0, [1.0], np.nan, "1"])
def test_bad_caution(caution):
    with pytest.raises(InputError, match="caution must"):
        RunningUnits(caution=caution)


@pytest.mark.parametrize("past", [0.0, -1.0, np.nan, "1"])
def test_bad_weight_of_past_inputs(past):
    with pytest.raises(InputError, match="past must"):
        RunningUnits(past=past)


@pytest.mark.parametrize("noise", [-1.0, [1.0, -1.0], [], [[1.0]], np.inf, "1"])
def test_bad_noise(noise):
    with pytest.raises(InputError, match="noise must"):
        RunningUnits(noise=noise)


def test_bad_schemes():
    scheme = default_scheme(2, 2, 2)
    with pytest.raises(InputError, match="units must have one size for inputs, or 2, one for each input, got 3"):
        replace(scheme, units=RunningUnits([1.0, 1.0, 1.0]))
    with pytest.raises(InputError, match="units must have one noise, or 2, one for each output, got 3"):
        default_scheme(2, 2, 2, noise=[1.0, 1.0, 1.0])
    with pytest.raises(InputError, match="units must be a RunningUnits, got 1"):
        replace(scheme, units=1)
    known = ProximalEstimator(4, constraints=LinearConstraints.shift(2, 2, 2, 2))
    moved = replace(window_scheme(2, 2, 2), initial_model=SignalModel.shift_of_ones(2, 2, 2, 2), estimator=known)
    with pytest.raises(InputError, match="units must be None where the estimator has constraints"):
        replace(moved, units=RunningUnits())
    terms = window_scheme(1, 1, 1)
    lifting = DelayLifting(1, 1, Polynomials(2))
    model = type(terms.initial_model)(np.eye(2), np.ones((2, 1)))
    with pytest.raises(InputError, match="units must be None where a lifting appends basis functions"):
        replace(terms, lifting=lifting, initial_model=model, estimator=GrowingMemory(), units=RunningUnits())


def test_settings_by_default():
    """Those behind the comparison with benchmark plants; the pages say what they mean."""
    units = default_scheme(1, 1, 2).units
    assert (units.inputs, units.caution, units.past, units.noise) == (0.1, 100.0, 0.03, 0.0)
    assert units.model_in_sizes
