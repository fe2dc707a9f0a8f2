"""The rivals against what they claim: the least cost there is, a model that is exact, a loop that comes to rest."""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are
from scipy.optimize import minimize

from rhl import InputError, LinearPlant
from rhl.study.rivals import excite_identify_regulate, known_plant, weights

PLANT = LinearPlant([[1.1, 1.0], [0.0, 0.9]], [[0.0], [1.0]], [[1.0, 0.0]])
Z0 = np.array([1.0, -1.0])


def cost(y, v, W, R):
    return np.einsum("ki,ij,kj", y, W, y) + np.einsum("ki,ij,kj", v, R, v)


def test_no_inputs_cost_less():
    steps, (W, R) = 8, weights(PLANT, PLANT.H @ Z0, 2)
    run = known_plant(PLANT, Z0, steps, W, R)

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
    run = known_plant(PLANT, Z0, 400, W, R)
    P = solve_discrete_are(PLANT.F, PLANT.G, PLANT.H.T @ W @ PLANT.H + 1e-12 * np.eye(2), R)
    assert np.isclose(cost(run.y, run.v, W, R), Z0 @ P @ Z0, rtol=1e-6)


def test_weights_have_no_unit():
    other = LinearPlant(PLANT.F, PLANT.G / 50.0, 1e3 * PLANT.H)
    (W, R), (W_other, R_other) = (weights(of, of.H @ Z0, 2) for of in (PLANT, other))
    assert np.allclose(1e6 * W_other, W)
    assert np.allclose(50.0**2 * R_other, R)
    with pytest.raises(InputError, match=r"y\(0\) must not be zero"):
        weights(PLANT, np.zeros(1), 2)


@pytest.mark.parametrize("seed", range(5))
def test_excitation_identifies_and_brings_to_rest(seed):
    W, R = weights(PLANT, PLANT.H @ Z0, 2)
    run = excite_identify_regulate(PLANT, Z0, 60, 2, W, R, seed=seed)
    assert np.abs(run.y[-10:]).max() < 1e-6
    best = known_plant(PLANT, Z0, 60, W, R)
    assert cost(run.y, run.v, W, R) > cost(best.y, best.v, W, R)


def test_too_few_stacked_do_not_identify():
    """The control: with one output and one input stacked no model is exact, and the loop does not come to rest."""
    W, R = weights(PLANT, PLANT.H @ Z0, 2)
    run = excite_identify_regulate(PLANT, Z0, 60, 1, W, R)
    assert len(run.y) < 60 or np.abs(run.y[-10:]).max() > 1e-3


def test_a_run_that_leaves_the_range_ends():
    plant = LinearPlant([[1e30]], [[0.0]], [[1.0]])
    W, R = weights(plant, np.ones(1), 1)
    run = excite_identify_regulate(plant, np.ones(1), 50, 1, W, R)
    assert len(run.y) < run.wanted == 50
    assert np.all(np.isfinite(run.y))
