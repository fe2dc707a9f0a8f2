"""Plans on measured trajectories against model predictive control and against a general solver."""

import numpy as np
import pytest
from scipy.optimize import LinearConstraint, minimize

from rhl import LinearPlant
from rhl.study.deepc import Predictor, deepc, excitation_length, hankel
from rhl.study.rivals import known_plant, pose

PLANT = LinearPlant([[1.1, 1.0], [0.0, 0.9]], [[0.0], [1.0]], [[1.0, 0.0]])
Z0 = np.array([1.0, -1.0])
PAST, AHEAD = 2, 6


def simulated(z, v):
    y = []
    for u in v:
        y.append(PLANT.H @ z)
        z = PLANT.F @ z + PLANT.G @ u
    return np.array(y)


def predictor(of_g=1e-10, of_slack=1e10, bound=None, noise=0.0, R=0.1):
    rng = np.random.default_rng(0)
    v = rng.standard_normal((40, 1))
    y = simulated(Z0, v) + noise * rng.standard_normal((40, 1))
    U, Y = hankel(v, PAST + AHEAD), hankel(y, PAST + AHEAD)
    parts = (U[:PAST], Y[:PAST], U[PAST:], Y[PAST:])
    return Predictor(*parts, np.eye(1), R * np.eye(1), of_g, of_slack, bound)


def test_hankel():
    assert np.array_equal(hankel(np.arange(8.0).reshape(4, 2), 2), [[0, 2, 4], [1, 3, 5], [2, 4, 6], [3, 5, 7]])


def past(seed=1):
    """Inputs and outputs of PAST steps, and the state after them."""
    rng = np.random.default_rng(seed)
    z, u = rng.standard_normal(2), rng.standard_normal((PAST, 1))
    y = simulated(z, u)
    for v in u:
        z = PLANT.F @ z + PLANT.G @ v
    return u, y, z


def of_mpc(z, R=0.1):
    """The inputs that make the sum over the horizon least for the plant itself."""
    free = simulated(z, np.zeros((AHEAD, 1)))[:, 0]
    reach = np.stack([simulated(np.zeros(2), column[:, None])[:, 0] for column in np.eye(AHEAD)], axis=1)
    return -np.linalg.solve(reach.T @ reach + R * np.eye(AHEAD), reach.T @ free), reach, free


def test_without_noise_it_plans_as_one_who_knows_the_plant():
    """Theorem of Coulson, Lygeros and Doerfler: the plans are those of model predictive control."""
    u, y, z = past()
    wanted, _, _ = of_mpc(z)
    assert np.allclose(predictor().plan(u, y)[:, 0], wanted, rtol=1e-5, atol=1e-6)
    assert not np.allclose(predictor(of_g=1.0, of_slack=1.0).plan(u, y)[:, 0], wanted, rtol=1e-2)


def test_within_bounds_too():
    u, y, z = past()
    _, reach, free = of_mpc(z)
    bound = np.array([0.4])
    found = predictor(of_g=1e-6, of_slack=1e6, bound=bound).plan(u, y)[:, 0]
    wanted = minimize(
        lambda v: np.sum((free + reach @ v) ** 2) + 0.1 * np.sum(v**2),
        np.zeros(AHEAD),
        bounds=[(-0.4, 0.4)] * AHEAD,
        tol=1e-14,
    ).x
    assert np.abs(found).max() <= 0.4 < np.abs(predictor().plan(u, y)).max()
    assert np.allclose(found, wanted, atol=1e-3)


@pytest.mark.parametrize("bound", [None, np.array([0.3])])
def test_regularised_plans_against_a_general_solver(bound):
    u, y, _ = past(2)
    of = predictor(of_g=0.3, of_slack=50.0, bound=bound, noise=0.05)
    found = of.plan(u, y)[:, 0]

    def cost(g):
        slack = of.Yp @ g - y.ravel()
        return np.sum((of.Yf @ g) ** 2) + 0.1 * np.sum((of.Uf @ g) ** 2) + 0.3 * g @ g + 50.0 * slack @ slack

    def slope(g):
        slack = of.Yp @ g - y.ravel()
        return 2 * (of.Yf.T @ of.Yf @ g + 0.1 * of.Uf.T @ of.Uf @ g + 0.3 * g + 50.0 * of.Yp.T @ slack)

    limits = [LinearConstraint(of.Up, u.ravel(), u.ravel())]
    if bound is not None:
        limits.append(LinearConstraint(of.Uf, -bound[0], bound[0]))
    solved = minimize(
        cost,
        np.zeros(of.Up.shape[1]),
        jac=slope,
        constraints=limits,
        method="SLSQP",
        options={"ftol": 1e-14, "maxiter": 500},
    )
    assert np.allclose(found, of.Uf @ solved.x, atol=2e-5)


def test_a_run_excites_and_then_brings_to_rest():
    task = pose(PLANT, Z0, 2, 120)
    run = deepc(task)
    length = excitation_length(task)
    assert length == 2 * (2 + 20 + 2) - 1
    assert excitation_length(pose(PLANT, Z0, 2, 120, noise=0.01)) == 2 * (6 + 20 + 2) - 1
    drawn = task.size * task.rng().standard_normal((length, 1))
    assert np.array_equal(run.v[:length], drawn)
    assert np.abs(run.y[-20:]).max() < 1e-3 < np.abs(run.y[:length]).max()
    best = known_plant(task)
    assert np.sum(run.y**2) > np.sum(best.y**2)


def test_a_run_too_short_is_all_excitation():
    task = pose(PLANT, Z0, 2, 40)
    assert np.array_equal(deepc(task).v, task.size * task.rng().standard_normal((40, 1)))


def test_bounds_hold_in_a_run():
    stable = LinearPlant([[0.9, 1.0], [0.0, 0.8]], [[0.0], [1.0]], [[1.0, 0.0]])
    task = pose(stable, Z0, 2, 120, bounded=0.3)
    run = deepc(task)
    assert np.abs(run.v).max() <= task.bound
    assert np.abs(run.y[-20:]).max() < 0.05


def test_where_the_solver_gives_up_the_plan_is_clipped(monkeypatch):
    import piqp

    class Never:
        def setup(self, *_):
            pass

        def solve(self):
            return piqp.Status.PIQP_MAX_ITER_REACHED

    u, y, _ = past()
    of, free = predictor(bound=np.array([0.1])), predictor().plan(u, y)
    solved = of.plan(u, y)
    monkeypatch.setattr(piqp, "DenseSolver", Never)
    assert np.allclose(of.plan(u, y), np.clip(free, -0.1, 0.1))
    assert not np.allclose(solved, np.clip(free, -0.1, 0.1))
