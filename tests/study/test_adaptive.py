"""Adaptive LQ control against least squares of all data at once, and members of a batch against runs alone."""

from dataclasses import replace

import numpy as np
import pytest

from rhl import LinearPlant
from rhl.study.adaptive import adaptive_lq
from rhl.study.rivals import pose

PLANT = LinearPlant([[1.1, 1.0], [0.0, 0.9]], [[0.0], [1.0]], [[1.0, 0.0]])
Z0 = np.array([1.0, -1.0])


def dither(task):
    return task.size * np.arange(1, task.steps + 1)[:, None] ** -0.25 * task.rng().standard_normal((task.steps, 1))


def test_the_first_inputs_are_the_dither_alone():
    task = pose(PLANT, Z0, 2, 80)
    (run,) = adaptive_lq([task])
    assert np.allclose(run.v[:2], dither(task)[:2], rtol=1e-12)
    assert not np.allclose(run.v[3:6], dither(task)[3:6], rtol=1e-3)


def test_it_brings_to_rest_up_to_its_dither():
    task = pose(PLANT, Z0, 2, 300)
    (run,) = adaptive_lq([task])
    late = np.abs(dither(task)[-50:]).max()
    assert np.abs(run.y[-50:]).max() < 10 * late
    # The dither does not end, so that neither does the output.
    assert np.abs(run.y[-50:]).max() > 0.1 * late
    (quiet,) = adaptive_lq([replace(task, size=1e-4)])
    assert np.abs(quiet.y[-50:]).max() < 1e-2 * np.abs(run.y[-50:]).max()


def test_late_inputs_are_those_of_the_regulator_that_knows():
    """Once the model is exact, what is fed back is the stationary regulator's gain times the lifted state."""
    from scipy.linalg import solve_discrete_are

    task = pose(PLANT, Z0, 2, 120)
    (run,) = adaptive_lq([task])
    P = solve_discrete_are(PLANT.F, PLANT.G, PLANT.H.T @ task.W @ PLANT.H + 1e-12 * np.eye(2), task.R)
    K = np.linalg.solve(task.R + PLANT.G.T @ P @ PLANT.G, PLANT.G.T @ P @ PLANT.F)
    z, fed = Z0, []
    for v in run.v:
        fed.append(-K @ z)
        z = PLANT.F @ z + PLANT.G @ v
    gap = np.abs(run.v - dither(task) - np.array(fed))
    assert gap[60:].max() < 1e-3 * np.abs(run.v[60:]).max() < gap[:3].max()


def test_members_of_a_batch_are_runs_alone():
    tasks = [pose(PLANT, Z0, 2, 60, noise=0.02, seed=seed) for seed in range(3)]
    for together, task in zip(adaptive_lq(tasks), tasks, strict=True):
        (alone,) = adaptive_lq([task])
        assert np.allclose(together.y, alone.y, rtol=1e-6, atol=1e-9)
    assert not np.allclose(adaptive_lq(tasks[:1])[0].y, adaptive_lq(tasks[1:2])[0].y)


def test_bounds_hold():
    task = pose(PLANT, Z0, 2, 60, bounded=0.3)
    assert np.abs(adaptive_lq([task])[0].v).max() <= task.bound


@pytest.mark.parametrize("growth", [1e30, 1e120])
def test_a_run_that_leaves_the_range_ends(growth):
    (run,) = adaptive_lq([pose(LinearPlant([[growth]], [[0.0]], [[1.0]]), [1.0], 1, 50)])
    assert len(run.y) < run.wanted == 50
    assert np.all(np.isfinite(run.y))
    assert np.all(np.isfinite(run.v))
