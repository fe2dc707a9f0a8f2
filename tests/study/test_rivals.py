"""The rivals against what they claim: the least cost there is, a model that is exact, a loop that comes to rest."""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are
from scipy.optimize import minimize

from rhl import InputError, LinearPlant
from rhl.study.rivals import excite_identify_regulate, known_plant, pose, weights

PLANT = LinearPlant([[1.1, 1.0], [0.0, 0.9]], [[0.0], [1.0]], [[1.0, 0.0]])
Z0 = np.array([1.0, -1.0])


def cost(y, v, W, R):
    return np.einsum("ki,ij,kj", y, W, y) + np.einsum("ki,ij,kj", v, R, v)


def test_no_inputs_cost_less():
    steps, (W, R) = 8, weights(PLANT, PLANT.H @ Z0, 2)
    run = known_plant(pose(PLANT, Z0, 2, steps))

    def of(v):
        z, y = Z0, []
        for u in v:
            y.append(PLANT.H @ z)
            z = PLANT.F @ z + PLANT.G @ [u]
        return cost(np.array(y), v[:, None], W, R)

    assert np.isclose(of(run.v[:, 0]), cost(run.y, run.v, W, R), rtol=1e-12)
    found = minimize(of, np.zeros(steps), tol=1e-12)
    assert cost(run.y, run.v, W, R) <= found.fun * (1 + 1e-9)
    rng = np.random.default_rng(0)
    for _ in range(20):
        assert of(run.v[:, 0] + 1e-2 * rng.standard_normal(steps)) > cost(run.y, run.v, W, R)


def test_over_many_steps_it_is_the_stationary_regulator():
    W, R = weights(PLANT, PLANT.H @ Z0, 2)
    run = known_plant(pose(PLANT, Z0, 2, 400))
    P = solve_discrete_are(PLANT.F, PLANT.G, PLANT.H.T @ W @ PLANT.H + 1e-12 * np.eye(2), R)
    assert np.isclose(cost(run.y, run.v, W, R), Z0 @ P @ Z0, rtol=1e-6)


def test_weights_have_no_unit():
    other = LinearPlant(PLANT.F, PLANT.G / 50.0, 1e3 * PLANT.H)
    (W, R), (W_other, R_other) = (weights(of, of.H @ Z0, 2) for of in (PLANT, other))
    assert np.allclose(1e6 * W_other, W)
    assert np.allclose(50.0**2 * R_other, R)
    with pytest.raises(InputError, match=r"y\(0\) must be nonzero"):
        weights(PLANT, np.zeros(1), 2)


@pytest.mark.parametrize("seed", range(5))
def test_excitation_identifies_and_brings_to_rest(seed):
    task = pose(PLANT, Z0, 2, 60, seed=seed)
    W, R = task.W, task.R
    run = excite_identify_regulate(task)
    assert np.abs(run.y[-10:]).max() < 1e-6
    best = known_plant(task)
    assert cost(run.y, run.v, W, R) > cost(best.y, best.v, W, R)


def test_too_few_stacked_do_not_identify():
    """The control: with one output and one input stacked no model is exact, and the loop does not come to rest."""
    run = excite_identify_regulate(pose(PLANT, Z0, 1, 60))
    assert len(run.y) < 60 or np.abs(run.y[-10:]).max() > 1e-3


def test_a_run_that_leaves_the_range_ends():
    plant = LinearPlant([[1e30]], [[0.0]], [[1.0]])
    run = excite_identify_regulate(pose(plant, np.ones(1), 1, 50))
    assert len(run.y) < run.wanted == 50
    assert np.all(np.isfinite(run.y))


def test_with_noise_more_is_measured_first():
    """Ten rows for each of four unknowns; without noise the rank stops rising after a few."""
    noisy, exact = (pose(PLANT, Z0, 2, 60, noise=noise) for noise in (0.01, 0.0))
    drawn = noisy.size * noisy.rng().standard_normal((60, 1))
    run, quick = excite_identify_regulate(noisy), excite_identify_regulate(exact)
    assert np.array_equal(run.v[:41], drawn[:41])
    assert not np.isclose(run.v[41], drawn[41])
    assert not np.allclose(quick.v[:41], drawn[:41])


def test_errors_are_what_they_are_said_to_be():
    task = pose(PLANT, 3.0 * Z0, 2, 20000, noise=0.05)
    assert np.isclose(task.errors.std(), 0.05 * 3.0, rtol=0.02)
    assert not np.any(pose(PLANT, Z0, 2, 50).errors)
    assert np.array_equal(task.errors, pose(PLANT, 3.0 * Z0, 2, 20000, noise=0.05).errors)
    assert not np.isclose(task.errors[0], pose(PLANT, 3.0 * Z0, 2, 20000, noise=0.05, seed=1).errors[0])
    # What a method draws is another stream.
    assert abs(np.corrcoef(task.errors[:, 0], task.rng().standard_normal(20000))[0, 1]) < 0.03


def test_the_one_that_knows_is_not_misled_by_noise():
    noisy, exact = (known_plant(pose(PLANT, Z0, 2, 50, noise=noise)) for noise in (0.05, 0.0))
    assert np.array_equal(noisy.y, exact.y)


def test_bounds():
    free = known_plant(pose(PLANT, Z0, 2, 50))
    task = pose(PLANT, Z0, 2, 50, bounded=0.5)
    assert np.isclose(task.bound, 0.5 * np.abs(free.v).max())
    run = known_plant(task)
    assert np.isclose(np.abs(run.v).max(), task.bound)
    assert cost(run.y, run.v, task.W, task.R) > cost(free.y, free.v, task.W, task.R)
    assert np.abs(excite_identify_regulate(task).v).max() <= task.bound < np.abs(free.v).max()


def test_an_input_that_the_regulator_never_uses_has_the_bound_of_the_others():
    idle = LinearPlant([[1.1, 0.0], [0.0, 0.5]], np.eye(2), [[1.0, 0.0]])
    bound = pose(idle, [1.0, 0.0], 1, 50, bounded=3.0).bound
    assert bound[0] == bound[1] > 0


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"noise": -0.1}, r"noise must be a number in \[0, 1\), got -0.1"),
        ({"noise": 1.0}, r"noise must be a number in \[0, 1\), got 1.0"),
        ({"bounded": 0.0}, "bounded must be a positive finite number, got 0.0"),
        ({"steps": 0}, "steps must be an integer of at least 1, got 0"),
        ({"plant": LinearPlant([[0.5]], [[0.0]], [[1.0]]), "z0": [1.0], "bounded": 3.0}, "bounded must be None where"),
    ],
)
def test_refused(changes, sentence):
    with pytest.raises(InputError, match=sentence):
        pose(**{"plant": PLANT, "z0": Z0, "order": 2, "steps": 50} | changes)


def test_it_excites_until_the_rank_has_stayed_for_two_rows():
    """Order one: rows begin at k = 1, have rank two from the second on, and so suffice at k = 4."""
    run = excite_identify_regulate(pose(LinearPlant([[0.5]], [[1.0]], [[1.0]]), [1.0], order=1, steps=6))
    gains = run.v[:, 0] / run.y[:, 0]
    assert np.isclose(gains[4], gains[5], rtol=1e-6)
    assert not np.isclose(gains[3], gains[4], rtol=1e-2)
