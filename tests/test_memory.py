"""The estimator that forgets nothing: against the same problem with a window of every transition, and along a run."""

from dataclasses import replace

import numpy as np
import pytest

from rhl import GrowingMemory, InputError, LinearPlant, ProximalEstimator, SignalModel, default_scheme, simulate
from rhl.losses import WeightedSquares
from rhl.paper.published import linear_example


def absorbed(estimator, x, u):
    """The memory after all transitions of x, (steps + 1, n), and u, (steps, q), oldest first."""
    data = estimator.begin(x.shape[-1], u.shape[-1])
    for j in range(len(u)):
        data = estimator.remember(data, x[j : j + 2][::-1], u[j : j + 1])
    return data


def signals(seed, steps, n, q):
    rng = np.random.default_rng(seed)
    scales = 10.0 ** rng.uniform(-3, 3, (steps + 1, 1))
    return scales * rng.standard_normal((steps + 1, n)), rng.standard_normal((steps, q)), rng


@pytest.mark.parametrize(("steps", "n", "q"), [(1, 1, 1), (3, 4, 2), (40, 3, 1), (200, 6, 3)])
def test_equals_a_window_of_every_transition(steps, n, q):
    x, u, rng = signals(steps, steps, n, q)
    centre = SignalModel(rng.standard_normal((n, n)), rng.standard_normal((n, q)))
    for weight in (1.0, 1e-6):
        memory = GrowingMemory(weight)
        found = memory.minimise(centre, absorbed(memory, x, u))
        window = ProximalEstimator(steps, generator=WeightedSquares(weight))
        expected = window.minimise(centre, x[::-1], u[::-1])
        scale = np.abs(expected.theta).max()
        assert np.abs(found.theta - expected.theta).max() < 1e-9 * scale
        assert memory.newton_decrement(found, centre, x[1:], x[:-1], u) < 1e-10
        off = SignalModel(found.A + 1e-3, found.B)
        assert memory.newton_decrement(off, centre, x[1:], x[:-1], u) > 1e-6


def test_sizes_are_weights_of_the_generator():
    x, u, rng = signals(5, 6, 3, 2)
    centre, size = SignalModel(np.eye(3), np.ones((3, 2))), 10.0 ** rng.uniform(-2, 2, 5)
    memory = GrowingMemory(0.3)
    found = memory.minimise(centre, absorbed(memory, x, u), size)
    # One weight for each entry of theta, column by column: an entry in a column counts in the size of its signal.
    window = ProximalEstimator(6, generator=WeightedSquares(np.repeat(0.3 * size**2, 3)))
    expected = window.minimise(centre, x[::-1], u[::-1])
    assert np.abs(found.theta - expected.theta).max() < 1e-10 * np.abs(expected.theta).max()
    assert memory.newton_decrement(found, centre, x[1:], x[:-1], u, size) < 1e-12
    unsized = memory.minimise(centre, absorbed(memory, x, u))
    assert np.abs(unsized.theta - expected.theta).max() > 1e-6


def test_what_the_memory_leaves_open():
    """The share is the diagonal of the posterior over that of the prior variance, here of an inverse written out."""
    x, u, rng = signals(5, 3, 3, 2)
    memory, size = GrowingMemory(1e-3), 10.0 ** rng.uniform(-1, 1, 5)
    assert np.allclose(memory.unknown(memory.begin(3, 2), size), 1.0)
    data = absorbed(memory, x, u)
    phi = np.concatenate([x[:-1], u], axis=1)
    prior = 1e-3 * np.diag(size**2)
    expected = np.diag(np.linalg.inv(phi.T @ phi + prior)) * np.diag(prior)
    found = memory.unknown(data, size)
    assert np.allclose(found, expected, rtol=1e-8)
    assert not np.allclose(memory.unknown(data), expected, rtol=0.1)
    # Three transitions cannot tell five columns apart, and more never leave more open.
    assert found.sum() > 2 - 1e-9
    more = absorbed(memory, *signals(6, 30, 3, 2)[:2])
    assert memory.unknown(more, size).max() < 0.1


def test_what_is_left_open_of_a_batch_is_that_of_its_members():
    memory = GrowingMemory()
    members = [absorbed(memory, *signals(seed, 2, 2, 1)[:2]) for seed in range(3)]
    size = np.array([[1.0, 2.0, 3.0], [1.0, 1.0, 1.0], [0.1, 5.0, 1.0]])
    together = memory.unknown(np.stack(members), size)
    for found, data, of in zip(together, members, size, strict=True):
        assert np.array_equal(found, memory.unknown(data, of))


def test_a_batch_is_its_members():
    x, u, rng = signals(7, 12, 3, 1)
    members = np.stack([x, 2 * x, rng.standard_normal(x.shape)])
    memory, centre = GrowingMemory(1e-4), SignalModel(np.eye(3), np.ones((3, 1)))
    data = np.zeros((3, *memory.begin(3, 1).shape))
    for j in range(12):
        data = memory.remember(data, members[:, j : j + 2][:, ::-1], np.broadcast_to(u[j : j + 1], (3, 1, 1)))
    found = memory.minimise(centre, data)
    for i, member in enumerate(members):
        alone = memory.minimise(centre, absorbed(memory, member, u))
        assert np.array_equal(found.theta[i], alone.theta)


def test_memory_does_not_grow():
    x, u, _ = signals(1, 300, 2, 1)
    assert absorbed(GrowingMemory(), x, u).shape == absorbed(GrowingMemory(), x[:2], u[:1]).shape == (3, 5)


def misfit(trace, k):
    """How far the model of step k is from every transition of the run that is all measured, relative."""
    x, u = trace.lifted
    first = trace.scheme.first_measured
    predicted = trace.model(k).step(x[first - 1 : -1], u[first:])
    return np.abs(predicted - x[first:]).max() / np.abs(x).max()


def test_lemma_4_holds_as_printed_along_a_run():
    """A loss that never falls brings the estimate into the set of models that fit all data; a short window does not."""
    example = linear_example()
    growing = simulate(replace(example.scheme, estimator=GrowingMemory(1.0)), example.plant, example.z0, 160)
    window = simulate(example.scheme, example.plant, example.z0, 160)
    assert misfit(growing, 159) < 1e-13
    assert misfit(window, 159) > 1e-4
    moves = np.linalg.norm(np.diff(growing.theta, axis=0), axis=1)
    assert np.all(moves[-20:] < 1e-12 * moves.max())
    # The proximal iterates never move away from a model that fits everything: here from the last one.
    distance = np.linalg.norm(growing.theta - growing.theta[-1], axis=1)
    assert np.all(np.diff(distance) < 1e-12 * distance[0])
    assert np.abs(growing.z).max() < np.abs(window.z).max()


def test_zeros_from_before_the_run_are_not_remembered():
    example = linear_example()
    trace = simulate(replace(example.scheme, estimator=GrowingMemory(1.0)), example.plant, example.z0, 12)
    for k in range(4):
        assert np.array_equal(trace.theta[k], example.scheme.initial_model.theta)
    assert not np.array_equal(trace.theta[4], trace.theta[3])
    assert np.all(trace.newton_decrement < 1e-12)


@pytest.mark.parametrize("weight", [0.0, -1.0, np.nan, "1"])
def test_bad_weights(weight):
    with pytest.raises(InputError, match="weight must be"):
        GrowingMemory(weight)


def test_bad_data():
    memory, centre = GrowingMemory(), SignalModel(np.eye(2), np.ones((2, 1)))
    with pytest.raises(InputError, match=r"data must have shape \(3, 5\), as begin returns it, got \(2, 3\)"):
        memory.minimise(centre, memory.begin(1, 1))


def test_a_batch_without_units_tells_its_steps():
    example = linear_example()
    scheme = replace(example.scheme, estimator=GrowingMemory(1.0))
    starts = np.stack([example.z0, 0.5 * example.z0])
    together = simulate(scheme, example.plant, starts, 12)
    for i, z0 in enumerate(starts):
        alone = simulate(scheme, example.plant, z0, 12)
        assert np.allclose(together.y_hat[:, i], alone.y_hat)
        assert np.allclose(together.theta[:, i], alone.theta)


def test_a_batch_whose_members_all_diverge_at_once():
    plant = LinearPlant([[1.1]], [[1.0]], [[1.0]])
    run = simulate(default_scheme(1, 1, 1), plant, [[1e300], [-1e300]], 5)
    assert run.diverged_at.tolist() == [0, 0]
    assert np.all(run.v == 0)
