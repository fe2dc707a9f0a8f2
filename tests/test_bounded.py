"""Plans within bounds of the input, against an active-set method and their own optimality conditions."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

import rhl._bounded
from rhl import InputError, NotSolvedError, Plan, Saturation, SignalModel, default_scheme, simulate, solve
from rhl.plants import LinearPlant
from rhl.problems import V1, InputBounds


def problem(seed, *, summed=False, size=None):
    rng = np.random.default_rng(seed)
    n, q, N = int(rng.integers(1, 6)), int(rng.integers(1, 4)), int(rng.integers(3, 25))
    A = rng.standard_normal((n, n))
    A *= rng.uniform(0.5, 1.3) / np.abs(np.linalg.eigvals(A)).max()
    model, reach = SignalModel(A, rng.standard_normal((n, q))), size or 10.0 ** rng.uniform(-2, 0)
    bounds = InputBounds(-reach * rng.uniform(0.2, 1, q), reach * rng.uniform(0.2, 1, q), summed)
    R, weight = 10.0 ** rng.uniform(-3, 1), 10.0 ** rng.uniform(-2, 6)
    return V1(model, 1.0, R, 1.0, weight, N, bounds), rng.standard_normal(n)


def least_squares(one, x):
    """The objective as |M u + c|^2, for u or for the sums of u where those are bounded."""
    model, N = one.model, one.horizon
    n, q = model.B.shape
    states, start, rows, offs = np.zeros((n, N * q)), x, [], []
    for i in range(N):
        rows.append(states)
        offs.append(start)
        states, start = model.A @ states, model.A @ start
        states[:, q * i : q * (i + 1)] += model.B
    rows.append(np.sqrt(one.weight) * states)
    offs.append(np.sqrt(one.weight) * start)
    rows.append(np.sqrt(one.R[0, 0]) * np.eye(N * q))
    offs.append(np.zeros(N * q))
    M = np.concatenate(rows)
    if one.bounds.summed:
        M = M @ (np.eye(N * q) - np.eye(N * q, k=-q))
    return M, np.concatenate(offs)


@pytest.mark.parametrize("summed", [False, True])
@pytest.mark.parametrize("seed", range(20))
def test_against_an_active_set_method(seed, summed):
    one, x = problem(seed, summed=summed)
    plan, (M, c) = solve(one, x), least_squares(one, x)
    low, high = (np.tile(edge, one.horizon) for edge in (one.bounds.low, one.bounds.high))
    found = lsq_linear(M, -c, (low, high), method="bvls", tol=1e-14, max_iter=5000)
    v = np.cumsum(plan.u, axis=0) if summed else plan.u
    # Inputs to the last bit; their sums as far as sums of differences go.
    rounding = 1e-13 * (one.bounds.high - one.bounds.low) if summed else 0.0
    assert np.all(v >= one.bounds.low - rounding)
    assert np.all(v <= one.bounds.high + rounding)
    least = np.sum((M @ found.x + c) ** 2)
    assert plan.value == pytest.approx(least, rel=1e-6)
    assert plan.residual() < 1e-5


def test_bounds_that_are_kept_change_nothing():
    one, x = problem(3, size=1e9)
    free = solve(V1(one.model, one.Q, one.R, one.QN, one.weight, one.horizon), x)
    assert np.array_equal(solve(one, x).u, free.u)


def test_a_clipped_plan_is_not_optimal():
    for seed in range(10):
        one, x = problem(seed, size=0.05)
        free = solve(V1(one.model, one.Q, one.R, one.QN, one.weight, one.horizon), x)
        clipped = np.clip(free.u, one.bounds.low, one.bounds.high)
        followed = Plan(one, clipped, one.model.predictor(one.horizon).predict(x, clipped))
        assert Plan(one, free.u, free.x).residual() > 1e-2
        if not np.all((clipped == one.bounds.low) | (clipped == one.bounds.high)):
            assert followed.residual() > 1e3 * solve(one, x).residual()


def test_a_batch_is_its_members():
    one, x = problem(4, size=0.3)
    scales = np.array([0.01, 1.0, 3.0])
    bounds = InputBounds(scales[:, None] * one.bounds.low, scales[:, None] * one.bounds.high)
    wide = V1(one.model, one.Q, one.R, one.QN, one.weight, one.horizon, bounds)
    together = solve(wide, np.stack([x, 2 * x, 3 * x]))
    for i, scale in enumerate(scales):
        of = InputBounds(scale * one.bounds.low, scale * one.bounds.high)
        alone = solve(V1(one.model, one.Q, one.R, one.QN, one.weight, one.horizon, of), (i + 1) * x)
        assert np.allclose(together.u[i], alone.u, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("summed", [False, True])
def test_the_active_set_method_finds_the_same_plan(summed, monkeypatch):
    one, x = problem(4, size=0.05, summed=summed)
    found = solve(one, x)
    monkeypatch.setattr(rhl._bounded, "_ITERATIONS", 1)  # so that the interior-point method misses its tolerance
    other = solve(one, x)
    assert not np.array_equal(other.u, found.u)
    assert np.allclose(other.u, found.u, rtol=1e-5, atol=1e-7)
    assert other.value == pytest.approx(float(found.value), rel=1e-8)


def test_weights_that_are_far_apart():
    """A terminal weight of 1e20 beside inputs that cost 1e-8: too much for the interior-point method."""
    model = SignalModel([[1.4, 1.0, 0.0], [0.0, 1.3, 1.0], [0.0, 0.0, 1.2]], [[0.0], [0.0], [1.0]])
    one = V1(model, 1.0, 1e-8, 1.0, 1e20, 40, InputBounds([-1.0], [1.0]))
    plan, (M, c) = solve(one, [0.3, 0.0, 0.0]), least_squares(one, np.array([0.3, 0.0, 0.0]))
    assert np.all(np.abs(plan.u) <= 1 + 1e-7)
    found = lsq_linear(M, -c, (-np.ones(40), np.ones(40)), method="bvls", tol=1e-14, max_iter=5000)
    assert plan.value <= np.sum((M @ found.x + c) ** 2) * (1 + 1e-6)


@pytest.mark.parametrize("summed", [False, True])
def test_a_plan_keeps_its_bounds_where_the_state_grows_without_limit(summed):
    """The feedback and what keeps it within bounds would cancel: the state grows to 1e18."""
    one = V1(SignalModel([[2.0]], [[1.0]]), 1.0, 1.0, 1.0, 1.0, 60, InputBounds([-0.1], [0.1], summed))
    plan = solve(one, [1.0])
    v = np.cumsum(plan.u, axis=0) if summed else plan.u
    assert np.abs(v).max() <= 0.1 + 1e-15
    # No input is better than pushing back with all there is, at the first step at least.
    assert plan.u[0] == pytest.approx(-0.1)
    idle = one.model.predictor(60).predict(np.array([1.0]), np.zeros((60, 1)))
    assert plan.value < Plan(one, np.zeros((60, 1)), idle).value


def test_what_is_not_solved_is_said(monkeypatch):
    one, x = problem(0, size=0.3)
    assert solve(one, x).residual() < 1e-5
    monkeypatch.setattr(rhl._bounded, "_ITERATIONS", 1)
    monkeypatch.setattr(rhl._bounded, "_STEPS", 0)
    with pytest.raises(NotSolvedError, match=r"must be found in .* active-set steps, got none; shorten"):
        solve(one, x)


def test_the_scheme_keeps_what_the_actuator_can_do():
    plant = LinearPlant([[1.15, 0.3], [0.0, 1.05]], [[0.0], [1.0]], [[1.0, 0.0]])
    actuator = Saturation(-0.3, 0.5)
    run = simulate(default_scheme(1, 1, 2, bounds=actuator), plant, [0.4, -0.2], 150, actuator=actuator)
    free = simulate(default_scheme(1, 1, 2), plant, [0.4, -0.2], 150)
    assert np.abs(free.v).max() > 0.5
    assert np.all((run.v_computed >= -0.3) & (run.v_computed <= 0.5))
    assert np.any(run.v_computed < -0.3 + 1e-6)
    assert np.array_equal(run.v, run.v_computed)
    assert np.abs(run.z[-1]).max() < 1e-6
    assert max(plan.residual() for plan in (done.plan for done in run.steps)) < 1e-5


@pytest.mark.parametrize(
    ("low", "high", "sentence"),
    [
        ([0.0], [0.0], "low must be below high for each input"),
        ([0.0, 1.0], [1.0], "low must be below high for each input"),
        ([np.nan], [1.0], "low must be finite"),
    ],
)
def test_bad_bounds(low, high, sentence):
    with pytest.raises(InputError, match=sentence):
        InputBounds(low, high)


def test_bounds_of_other_sizes():
    with pytest.raises(InputError, match="bounds must be of 1 inputs, got 2"):
        V1(SignalModel([[1.0]], [[1.0]]), 1.0, 1.0, 1.0, 1.0, 3, InputBounds([-1.0, -1.0], [1.0, 1.0]))
    with pytest.raises(InputError, match=r"bounds must be numbers or have 1 entries, one for each input, got \(2,\)"):
        default_scheme(1, 1, 1, bounds=Saturation([-1.0, -2.0], [1.0, 2.0]), inputs=0.1)
    with pytest.raises(InputError, match=r"bounds must be an? InputBounds, got"):
        V1(SignalModel([[1.0]], [[1.0]]), 1.0, 1.0, 1.0, 1.0, 3, Saturation(-1.0, 1.0))
    with pytest.raises(InputError, match="bounds must be a Saturation, got 1"):
        default_scheme(1, 1, 1, bounds=1, inputs=0.1)
