"""The horizon solver one problem at a time and many at once, and what else a step may take."""

import numpy as np
import pytest

from rhl.controllability import LambdaSearch
from rhl.horizon import solve
from rhl.model import SignalModel
from rhl.paper.published import linear_example, robot_arm
from rhl.problems import V1, V2, V3

SEED = 2010_05891
BATCH = 200
n, q, N = 7, 1, 20


@pytest.fixture(scope="module")
def case():
    """Two hundred models of the linear example's size, with their states."""
    rng = np.random.default_rng(SEED)
    A = rng.standard_normal((BATCH, n, n))
    A /= np.max(np.abs(np.linalg.eigvals(A)), axis=-1)[:, None, None]
    return SignalModel(A, rng.standard_normal((BATCH, n, q))), rng.standard_normal((BATCH, n)), N


def problem(kind, model, N):
    if kind is V1:
        return V1(model, 1.0, 1.0, 1.0, 1e3, N)
    return V2(model, 1.0, N) if kind is V2 else V3(model, 1.0, 1.0, np.zeros(model.n), N)


@pytest.mark.parametrize("kind", [V1, V2, V3])
def test_one_batch(benchmark, kind, case):
    model, x, N = case
    benchmark.group = f"{BATCH} problems {kind.__name__}"
    plans = benchmark(lambda: solve(problem(kind, model, N), x))
    assert plans.u.shape == (BATCH, N, 1)


@pytest.mark.parametrize("kind", [V1, V2, V3])
def test_one_after_the_other(benchmark, kind, case):
    model, x, N = case
    benchmark.group = f"{BATCH} problems {kind.__name__}"
    members = [problem(kind, SignalModel(model.A[i], model.B[i]), N) for i in range(BATCH)]
    plans = benchmark.pedantic(lambda: [solve(member, x[i]) for i, member in enumerate(members)], rounds=3)
    assert len(plans) == BATCH


@pytest.mark.parametrize("form", ["model", "maps"])
def test_signal_model_or_predictor_maps(benchmark, form, case):
    model, x, N = case
    benchmark.group = "one V1, as a signal model or as general maps"
    one = SignalModel(model.A[0], model.B[0])
    posed = problem(V1, one if form == "model" else one.predictor(N), N)
    assert benchmark(lambda: solve(posed, x[0])).u.shape == (N, 1)


def test_robot_arm(benchmark):
    """A plant that is no LinearPlant goes step by step; test_step_bench.py has the linear example."""
    benchmark.group = "a step of the robot arm, everything included"
    made = robot_arm()
    benchmark.extra_info.update({"row": "rhl", "steps": made.steps})
    assert len(benchmark(made.run)) == made.steps


@pytest.mark.parametrize("pair", ["lifted", "augmented"])
def test_lambda_search(benchmark, pair):
    benchmark.group = "one search for lambda"
    made = linear_example().scheme
    lost = SignalModel(np.zeros((4, 4)), np.zeros((4, 4)))
    search = LambdaSearch(pair)
    assert benchmark(lambda: search.choose(lost, made.initial_model, made.lifting.augment)) > 0
