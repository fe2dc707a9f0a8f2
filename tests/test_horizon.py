"""The horizon problems against extended precision, against each other, and against their own certificate."""

from dataclasses import replace

import numpy as np
import pytest

from rhl._riccati import gains
from rhl.errors import InfeasibleError, InputError
from rhl.horizon import factor, solve
from rhl.model import PredictorMaps, SignalModel
from rhl.paper.published import linear_example, replay_published
from rhl.problems import V1, V2, V3
from tests import oracle
from tests.sizes import size

SEED = 2010_05891
# What the project promises for u_0: on the paper's own problems, and on others (or ten times what rounding the data
# to float64 already does to the exact answer).
PUBLISHED_RTOL = 1e-10
RANDOM_RTOL = 1e-8
# Entries of order one, well conditioned problems of a few stages: 1e-15 times a condition number of up to 1e5.
SMALL_RTOL = 1e-10
# The certificate divides by the sum of the terms that cancel, so rounding alone leaves a few units of 1e-16.
CERTIFIED = 1e-14
# V3's feasible directions are themselves known only to rounding times the condition of the terminal rows.
HELD_CERTIFIED = 100 * np.finfo(float).eps
# Inputs wrong by 1e-6 of their size leave a residual of that order; a hundredth of it is far from rounding.
SHIFT, UNCERTIFIED = 1e-6, 1e-8
# Two ways through the same floating-point recursion.
SAME_RTOL = 1e-12


def definite(rng, n, scale=1.0):
    """A symmetric positive definite matrix of about that size, condition number below about 100."""
    factor = rng.standard_normal((n, n))
    half = scale * (factor @ factor.T / n + 0.1 * np.eye(n)) / 2
    return half + half.T


def pair(rng, n, q, radius, coupling=None):
    """A random model of that spectral radius; with a coupling, half of it can be steered only that weakly."""
    A = rng.standard_normal((n, n))
    A *= radius / np.max(np.abs(np.linalg.eigvals(A)))
    B = rng.standard_normal((n, q))
    if coupling is not None:
        half = (n + 1) // 2
        A[half:, :half] *= coupling
        B[half:] *= coupling
        turn = np.linalg.qr(rng.standard_normal((n, n)))[0]
        A, B = turn @ A @ turn.T, turn @ B
    return A, B


def hidden_uncontrollable(rng, n, q, steerable, unsteerable=None):
    """An exactly uncontrollable model of small integers, its structure hidden by a unimodular transformation."""
    A = rng.integers(-1, 2, (n, n)).astype(float)
    B = rng.integers(-2, 3, (n, q)).astype(float)
    A[steerable:, :steerable] = 0
    B[steerable:] = 0
    if unsteerable is not None:
        A[steerable:, steerable:] = unsteerable
    lower = np.eye(n) + np.tril(rng.integers(-1, 2, (n, n)), -1)
    inverse = np.rint(np.linalg.inv(lower))
    assert np.array_equal(lower @ inverse, np.eye(n))
    return lower @ A @ inverse, lower @ B


def general_maps(rng, n, q, N):
    """Predictor maps that are no powers of one matrix."""
    A = np.concatenate([np.eye(n)[None], rng.standard_normal((N, n, n))])
    return PredictorMaps(A, rng.standard_normal((N, n, q)))


# V1, the paper's problems


RUNS = {"fed-back": replay_published(), "free": linear_example().run()}


@pytest.fixture(scope="module")
def published_answers():
    """u_0 in extended precision, for every step of both runs."""
    return {
        name: [oracle.first_input(done.plan.problem, done.plan.x[0]) for done in run.steps]
        for name, run in RUNS.items()
    }


def worst(name, answers, method):
    """The largest relative error of u_0 along a run, with a method from a step to u_0."""
    return max(
        oracle.relative_error(method(done), true) for done, true in zip(RUNS[name].steps, answers[name], strict=True)
    )


@pytest.mark.parametrize("name", RUNS)
def test_published_problems(name, published_answers):
    assert len(RUNS[name]) >= 41
    assert worst(name, published_answers, lambda done: done.plan.u[0]) <= PUBLISHED_RTOL


ASYMMETRY = 1e-16


def asymmetric(P, rng):
    """Move every entry by 1e-16 of itself, and its mirror the other way."""
    skew = np.triu(ASYMMETRY * np.abs(P) * rng.choice([-1.0, 1.0], P.shape), 1)
    return P + skew - skew.T


def plain_recursion(done, rng):
    """u_0 by P = Q + A'PA - (B'PA)'K, as often written, with the asymmetry injected and never removed."""
    problem = done.plan.problem
    A, B, P = problem.model.A, problem.model.B, problem.weight * problem.QN
    for _ in range(problem.horizon):
        P = asymmetric(P, rng)
        BPA = B.T @ P @ A
        K = np.linalg.solve(problem.R + B.T @ P @ B, BPA)
        P = problem.Q + A.T @ P @ A - BPA.T @ K
    return -K @ done.plan.x[0]


def condensed_equations(done):
    """u_0 by the normal equations in all inputs at once."""
    problem = done.plan.problem
    maps = problem.model.predictor(problem.horizon)
    N, n, q = maps.B.shape
    effect = np.zeros((N, n, N, q))
    for i in range(N):
        effect[i, :, : i + 1] = maps.B[i::-1].swapaxes(0, 1)
    weights = np.stack([problem.Q] * (N - 1) + [problem.weight * problem.QN])
    weighed = np.einsum("iab,ibjc->iajc", weights, effect).reshape(N * n, N * q)
    hessian = effect.reshape(N * n, N * q).T @ weighed + np.kron(np.eye(N), problem.R)
    return -np.linalg.solve(hessian, weighed.T @ (maps.A[1:] @ done.plan.x[0]).reshape(-1))[:q]


def disturbed_recursion(done, rng):
    """u_0 by the library's own stages, with the asymmetry injected between each two."""
    problem = done.plan.problem
    A, B, S = problem.model.A, problem.model.B, np.sqrt(problem.weight) * factor(problem.QN)
    for _ in range(problem.horizon):
        # The factorisation reads one triangle, so it takes the asymmetric entries as they are.
        S = factor(asymmetric(S.T @ S, rng))
        K, _, S = gains(S, A, B, factor(problem.Q), factor(problem.R), 1)
    return -K[0] @ done.plan.x[0]


@pytest.mark.parametrize("name", RUNS)
def test_asymmetry_is_not_amplified(name, published_answers):
    rng = np.random.default_rng(SEED)
    assert worst(name, published_answers, lambda done: disturbed_recursion(done, rng)) <= PUBLISHED_RTOL


# A thousand times the bound would be enough to tell; measured are 8e-4 and 2e-4 (it is a matter of rounding).
@pytest.mark.parametrize("name", RUNS)
def test_asymmetry_is_amplified_by_a_plain_recursion(name, published_answers):
    rng = np.random.default_rng(SEED)
    assert worst(name, published_answers, lambda done: plain_recursion(done, rng)) > 1000 * PUBLISHED_RTOL


@pytest.mark.parametrize("name", RUNS)
def test_condensed_equations_lose_the_input(name, published_answers):
    assert worst(name, published_answers, condensed_equations) > 0.01


# V1, random problems


def random_v1(index):
    """Problem ``index`` of 200: sizes up to n = 12, N = 60, weights up to 1e9, every second nearly uncontrollable."""
    rng = np.random.default_rng([SEED, index])
    if index % 20 == 0:
        n, N = 12, 60
    else:
        n = int(rng.integers(1, 13 if index % 4 == 2 else 7))
        N = int(rng.integers(1, 61 if index % 4 == 1 else 21))
    q = int(rng.integers(1, 4))
    A, B = pair(rng, n, q, rng.uniform(0.3, 1.5), 10 ** -rng.uniform(0, 12) if index % 2 else None)
    data = {
        "A": A,
        "B": B,
        "Q": definite(rng, n, 10 ** rng.uniform(-2, 2)),
        "R": definite(rng, q, 10 ** rng.uniform(-3, 4)),
        "QN": definite(rng, n, 10 ** rng.uniform(-2, 2)),
        "weight": np.array(10 ** rng.uniform(0, 9)),
        "x": rng.standard_normal(n),
    }
    return data, N, rng


@pytest.mark.parametrize("block", range(size(3, 10)))
def test_random_v1(block):
    for index in range(block * 20, block * 20 + 20):
        data, N, rng = random_v1(index)

        def exactly(N=N, **data):
            return oracle.riccati(horizon=N, **data)

        problem = V1(SignalModel(data["A"], data["B"]), data["Q"], data["R"], data["QN"], data["weight"], N)
        error = oracle.relative_error(solve(problem, data["x"]).u[0], exactly(**data))
        assert error <= RANDOM_RTOL or error <= 10 * oracle.movement(exactly, data, rng, draws=5), index


def test_random_problems_are_hard():
    """Among them are the largest sizes, unstable models and large weights; the promise is about those."""
    problems = [random_v1(index)[:2] for index in range(200)]
    assert sum(len(data["A"]) == 12 and N == 60 for data, N in problems) >= 10
    assert sum(np.max(np.abs(np.linalg.eigvals(data["A"]))) > 1.2 for data, _ in problems) >= 40
    assert max(data["weight"] for data, _ in problems) > 5e8
    assert {data["B"].shape[1] for data, _ in problems} == {1, 2, 3}


def test_oracle_shows_a_wrong_input():
    data, N, rng = random_v1(2)
    true = oracle.riccati(horizon=N, **data)
    wrong = oracle.riccati(horizon=N, **data | {"x": data["x"] * (1 + 2 * RANDOM_RTOL)})
    assert oracle.relative_error(oracle.rounded(true), true) <= 2 * oracle.HALF_ULP
    assert oracle.relative_error(wrong, true) > RANDOM_RTOL
    assert oracle.movement(lambda **data: oracle.riccati(horizon=N, **data), data, rng, draws=1) > 0


def test_a_plan_says_whether_it_is_optimal():
    plan = solve(V1(SignalModel([[2.0]], [[1.0]]), 1.0, 1.0, 1.0, 3.0, 4), [[1.0], [2.0]])
    assert plan.is_optimal()
    assert not replace(plan, u=np.add(plan.u, [[[0.0]], [[SHIFT]]])).is_optimal()
    with pytest.raises(InputError, match="tol must be a positive finite number, got 0"):
        plan.is_optimal(0)


def test_one_state_one_step_by_hand():
    # min x^2 + u^2 + 3 (2x + u)^2 at x = 1: u + 3 (2 + u) = 0.
    plan = solve(V1(SignalModel([[2.0]], [[1.0]]), 1.0, 1.0, 1.0, 3.0, 1), [1.0])
    np.testing.assert_allclose(plan.u, [[-1.5]], rtol=SAME_RTOL)
    np.testing.assert_allclose(plan.x, [[1.0], [0.5]], rtol=SAME_RTOL)
    np.testing.assert_allclose(plan.value, 1 + 1.5**2 + 3 * 0.25, rtol=SAME_RTOL)


def test_golden_ratio():
    """A = B = Q = R = 1: the stationary P is the golden ratio, the gain its inverse."""
    gain = -solve(V1(SignalModel([[1.0]], [[1.0]]), 1.0, 1.0, 1.0, 1.0, 40), [1.0]).u[0, 0]
    np.testing.assert_allclose(gain, (np.sqrt(5) - 1) / 2, rtol=SAME_RTOL)


def test_dense_and_recursive_oracles_agree():
    data, N, _ = random_v1(2)
    rest = {name: data[name] for name in ("Q", "R", "QN", "weight", "x")}
    dense = oracle.v1(*oracle.powers(data["A"], data["B"], N), **rest)
    assert oracle.relative_error(oracle.riccati(horizon=N, **data), dense[0]) < SAME_RTOL**2


# General maps

SIZES = [(1, 1, 1), (2, 1, 4), (3, 2, 2), (4, 3, 3), (3, 1, 2), (5, 2, 6)]
NUMBERS = list(range(4))


@pytest.fixture(params=SIZES, ids=str)
def sizes(request):
    """n, q and N."""
    return request.param


@pytest.mark.parametrize("number", NUMBERS)
def test_general_maps_v1(sizes, number):
    n, q, N = sizes
    rng = np.random.default_rng([SEED, number])
    maps, Q, R, QN = general_maps(rng, n, q, N), definite(rng, n), definite(rng, q), definite(rng, n)
    x = rng.standard_normal(n)
    plan = solve(V1(maps, Q, R, QN, 1e3, N), x)
    assert oracle.relative_error(plan.u, oracle.v1(maps.A, maps.B, Q, R, QN, 1e3, x)) < SMALL_RTOL
    assert plan.residual() < CERTIFIED


@pytest.mark.parametrize("number", NUMBERS)
def test_general_maps_v2(sizes, number):
    n, q, N = sizes
    rng = np.random.default_rng([SEED, number])
    maps, QN, x = general_maps(rng, n, q, N), definite(rng, n), rng.standard_normal(n)
    plan = solve(V2(maps, QN, N), x)
    assert oracle.relative_error(plan.u, oracle.v2(maps.A, maps.B, QN, x)) < SMALL_RTOL
    assert plan.residual() < CERTIFIED


@pytest.mark.parametrize("number", NUMBERS)
def test_general_maps_v3(sizes, number):
    n, q, N = sizes
    rng = np.random.default_rng([SEED, number])
    # Whole numbers, so that r is reachable exactly even where N q < n.
    A = np.concatenate([np.eye(n)[None], rng.integers(-3, 4, (N, n, n))])
    maps = PredictorMaps(A, rng.integers(-3, 4, (N, n, q)))
    x, Q, R = rng.integers(-3, 4, n), definite(rng, n), definite(rng, q)
    r = maps.predict(x, rng.integers(-3, 4, (N, q)))[-1]
    plan = solve(V3(maps, Q, R, r, N), x)
    assert oracle.relative_error(plan.u, oracle.v3(maps.A, maps.B, Q, R, r, x)) < SMALL_RTOL
    assert plan.residual() < CERTIFIED


def make(kind, model, rng, n, q, N):
    """A problem of that kind; V3 with a terminal state that the model can reach."""
    Q, R, QN = definite(rng, n), definite(rng, q), definite(rng, n)
    x = rng.standard_normal(n)
    if kind is V1:
        return V1(model, Q, R, QN, 10.0, N), x
    if kind is V2:
        return V2(model, QN, N), x
    maps = model if isinstance(model, PredictorMaps) else model.predictor(N)
    return V3(model, Q, R, maps.predict(x, rng.standard_normal((N, q)))[-1], N), x


@pytest.mark.parametrize("kind", [V1, V2, V3])
def test_powers_as_maps_agree_with_the_model(kind, sizes):
    n, q, N = sizes
    rng = np.random.default_rng(SEED)
    model = SignalModel(*pair(rng, n, q, 1.1))
    problem, x = make(kind, model, rng, n, q, N)
    plan, again = solve(problem, x), solve(replace(problem, model=model.predictor(N)), x)
    np.testing.assert_allclose(again.u, plan.u, rtol=SMALL_RTOL, atol=SMALL_RTOL * np.max(np.abs(plan.u)))
    np.testing.assert_allclose(again.x, plan.x, rtol=SMALL_RTOL, atol=SMALL_RTOL * np.max(np.abs(plan.x)))


# V2 and V3 on models


def held_certified(A, B, N):
    """The residual to expect of V3: from the singular values of the terminal rows that are more than rounding."""
    size = np.linalg.svd(np.concatenate(list(SignalModel(A, B).predictor(N).B), axis=1), compute_uv=False)
    return HELD_CERTIFIED * size[0] / size[size > SAME_RTOL * size[0]][-1] if size[0] else HELD_CERTIFIED


@pytest.mark.parametrize("number", NUMBERS)
@pytest.mark.parametrize(("n", "q", "N"), [(2, 1, 5), (3, 1, 2), (4, 2, 8), (5, 1, 12), (6, 3, 4)])
def test_v2_on_models(n, q, N, number):
    rng = np.random.default_rng([SEED, number])
    A, B = pair(rng, n, q, rng.uniform(0.5, 1.3))
    QN, x = definite(rng, n), rng.standard_normal(n)
    plan = solve(V2(SignalModel(A, B), QN, N), x)
    assert oracle.relative_error(plan.u, oracle.v2(*oracle.powers(A, B, N), QN, x)) < SMALL_RTOL
    assert plan.residual() < CERTIFIED


@pytest.mark.parametrize("number", NUMBERS)
@pytest.mark.parametrize(("n", "q", "N"), [(2, 1, 5), (3, 1, 3), (4, 2, 8), (5, 1, 12), (6, 3, 4)])
def test_v3_on_models(n, q, N, number):
    rng = np.random.default_rng([SEED, number])
    A, B = pair(rng, n, q, rng.uniform(0.5, 1.3))
    Q, R, r, x = definite(rng, n), definite(rng, q), rng.standard_normal(n), rng.standard_normal(n)
    plan = solve(V3(SignalModel(A, B), Q, R, r, N), x)
    assert oracle.relative_error(plan.u, oracle.v3(*oracle.powers(A, B, N), Q, R, r, x)) < SMALL_RTOL
    assert plan.residual() < held_certified(A, B, N)


@pytest.mark.parametrize("coupling", [1e-2, 1e-4, 1e-6])
@pytest.mark.parametrize("kind", [V2, V3])
def test_nearly_uncontrollable(kind, coupling):
    rng = np.random.default_rng(SEED)
    n, q, N = 4, 1, 9
    A, B = pair(rng, n, q, 1.1, coupling)
    problem, x = make(kind, SignalModel(A, B), rng, n, q, N)
    data = {"A": A, "B": B, "x": x} | {
        name: getattr(problem, name) for name in ("Q", "R", "QN", "r") if hasattr(problem, name)
    }

    def exactly(A, B, **rest):
        return (oracle.v2 if kind is V2 else oracle.v3)(*oracle.powers(A, B, N), **rest)

    plan = solve(problem, x)
    assert oracle.relative_error(plan.u, exactly(**data)) <= max(
        SMALL_RTOL, 10 * oracle.movement(exactly, data, rng, 5)
    )
    assert plan.residual() < (CERTIFIED if kind is V2 else held_certified(A, B, N))


@pytest.mark.parametrize("number", NUMBERS)
@pytest.mark.parametrize(
    ("n", "q", "N", "steerable"), [(2, 1, 3, 1), (3, 1, 5, 2), (4, 2, 2, 2), (5, 2, 6, 3), (3, 2, 4, 0)]
)
def test_uncontrollable(n, q, N, steerable, number):
    rng = np.random.default_rng([SEED, number])
    A, B = hidden_uncontrollable(rng, n, q, steerable)
    QN, x = definite(rng, n), rng.integers(-3, 4, n).astype(float)
    plan = solve(V2(SignalModel(A, B), QN, N), x)
    assert oracle.relative_error(plan.u, oracle.v2(*oracle.powers(A, B, N), QN, x)) < SMALL_RTOL
    assert plan.residual() < CERTIFIED
    # Whole numbers again: the state that some inputs reach is reachable exactly.
    r = SignalModel(A, B).predictor(N).predict(x, rng.integers(-3, 4, (N, q)))[-1]
    held = solve(V3(SignalModel(A, B), 1.0, 1.0, r, N), x)
    true = oracle.v3(*oracle.powers(A, B, N), np.eye(n), np.eye(q), r, x)
    assert oracle.relative_error(held.u, true) < SMALL_RTOL
    assert held.residual() < held_certified(A, B, N)


# What cannot be steered grows by 2 ** 20 here, and rounding with it: 1e-16 times 1e6, times a condition number.
GROWN_RTOL = 1e-8


@pytest.mark.parametrize("number", NUMBERS)
def test_uncontrollable_and_unstable(number):
    rng = np.random.default_rng([SEED, number])
    n, q, N = 4, 1, 20
    A, B = hidden_uncontrollable(rng, n, q, 2, unsteerable=np.array([[2.0, 1.0], [0.0, -1.0]]))
    model, QN, x = SignalModel(A, B), definite(rng, n), rng.integers(1, 4, n).astype(float)
    assert oracle.relative_error(solve(V2(model, QN, N), x).u, oracle.v2(*oracle.powers(A, B, N), QN, x)) < GROWN_RTOL
    r = model.predictor(N).predict(x, rng.integers(-3, 4, (N, q)))[-1]
    true = oracle.v3(*oracle.powers(A, B, N), np.eye(n), np.eye(q), r, x)
    assert oracle.relative_error(solve(V3(model, 1.0, 1.0, r, N), x).u, true) < GROWN_RTOL


@pytest.mark.parametrize("number", NUMBERS)
def test_v2_has_the_least_norm_among_minimisers(number):
    rng = np.random.default_rng([SEED, number])
    n, q, N = 3, 2, 5
    problem = V2(SignalModel(*pair(rng, n, q, 1.1)), definite(rng, n), N)
    x = rng.standard_normal(n)
    plan, maps = solve(problem, x), problem.model.predictor(N)

    def norm(u):
        return np.sum(maps.predict(x, u)[:-1] ** 2) + np.sum(u**2)

    to_end = np.concatenate(list(maps.B[::-1]), axis=1)
    kernel = np.linalg.svd(to_end)[2][n:]
    least = norm(plan.u)
    for direction in kernel:
        for shift in (1e-3, -1e-3, 1.0, -1.0):
            other = plan.u + shift * direction.reshape(N, q)
            np.testing.assert_allclose(maps.predict(x, other)[-1], plan.x[-1], atol=1e-12)  # still a minimiser
            assert norm(other) > least


@pytest.mark.parametrize("number", NUMBERS)
@pytest.mark.parametrize("weight", [0.0, 1.0, 1e6])
def test_v3_with_the_end_of_v1_is_v1(weight, number):
    """Equation (40)."""
    rng = np.random.default_rng([SEED, number])
    model = SignalModel(*pair(rng, 4, 2, 1.2))
    Q, R, x = definite(rng, 4), definite(rng, 2), rng.standard_normal(4)
    free = solve(V1(model, Q, R, definite(rng, 4), weight, 8), x)
    held = solve(V3(model, Q, R, free.x[-1], 8), x)
    np.testing.assert_allclose(held.u, free.u, rtol=0, atol=SMALL_RTOL * np.max(np.abs(free.u)))
    elsewhere = solve(V3(model, Q, R, free.x[-1] + 0.1, 8), x)
    assert np.max(np.abs(elsewhere.u - free.u)) > UNCERTIFIED


@pytest.mark.parametrize("number", NUMBERS)
def test_v1_tends_to_v2_as_the_weight_grows(number):
    """Its terminal cost tends to V2's from above (inequality (37) and after)."""
    rng = np.random.default_rng([SEED, number])
    A, B = hidden_uncontrollable(rng, 4, 1, 2)
    model, x = SignalModel(A, B), np.array([1.0, -2.0, 1.0, 3.0])
    least = solve(V2(model, 1.0, 5), x).value
    gaps = [np.sum(solve(V1(model, 1.0, 1.0, 1.0, weight, 5), x).x[-1] ** 2) - least for weight in (1e2, 1e4, 1e6)]
    assert gaps[0] >= gaps[1] >= -SMALL_RTOL * least
    assert abs(gaps[2]) <= 1e-3 * max(gaps[0], 1e-6 * least)


@pytest.mark.parametrize("steerable", [0, 1, 2])
def test_unreachable_end_is_refused(steerable):
    rng = np.random.default_rng(SEED)
    A, B = hidden_uncontrollable(rng, 3, 1, steerable)
    x = np.array([1.0, 2.0, -1.0])
    model = SignalModel(A, B)
    reachable = solve(V2(model, 1.0, 4), x).x[-1]
    assert solve(V3(model, 1.0, 1.0, reachable, 4), x).residual() < CERTIFIED
    off = np.linalg.svd(np.concatenate(list(model.predictor(4).B), axis=1))[0][:, -1]
    with pytest.raises(
        InfeasibleError, match=r"every terminal state misses r by at least 0\.01; choose r within reach"
    ):
        solve(V3(model, 1.0, 1.0, reachable + 0.01 * off, 4), x)


def test_too_short_a_horizon_is_infeasible():
    chain = SignalModel(np.eye(3, k=1), [[0.0], [0.0], [1.0]])
    assert solve(V3(chain, 1.0, 1.0, 2 * np.ones(3), 3), np.ones(3)).residual() < CERTIFIED
    with pytest.raises(InfeasibleError, match="2 steps"):
        solve(V3(chain, 1.0, 1.0, 2 * np.ones(3), 2), np.ones(3))


@pytest.mark.parametrize("scale", [1e-150, 1e-12, 1e12, 1e100])
@pytest.mark.parametrize("kind", [V1, V2, V3])
def test_inputs_scale_with_the_state(kind, scale):
    rng = np.random.default_rng(SEED)
    problem, x = make(kind, SignalModel(*pair(rng, 3, 1, 1.1)), rng, 3, 1, 5)
    plan = solve(problem, x)
    scaled = solve(replace(problem, r=problem.r * scale) if kind is V3 else problem, x * scale)
    np.testing.assert_allclose(scaled.u, plan.u * scale, rtol=SMALL_RTOL)


@pytest.mark.parametrize("kind", [V1, V2, V3])
def test_nothing_to_do(kind):
    rng = np.random.default_rng(SEED)
    problem, x = make(kind, SignalModel(*pair(rng, 3, 1, 1.1)), rng, 3, 1, 5)
    plan = solve(replace(problem, r=np.zeros(3)) if kind is V3 else problem, 0 * x)
    assert not np.any(plan.u)
    assert plan.residual() == 0


# Certificates


@pytest.mark.parametrize("maps", [False, True])
@pytest.mark.parametrize("kind", [V1, V2, V3])
def test_residual_tells_solutions_from_others(kind, maps):
    rng = np.random.default_rng(SEED)
    model = general_maps(rng, 3, 2, 4) if maps else SignalModel(*pair(rng, 3, 2, 1.1))
    problem, x = make(kind, model, rng, 3, 2, 4)
    plan = solve(problem, x)
    assert plan.residual() < CERTIFIED
    shift = SHIFT * np.max(np.abs(plan.u)) * rng.choice([-1.0, 1.0], plan.u.shape)
    predictor = model if maps else model.predictor(4)
    consistent = replace(plan, u=plan.u + shift, x=predictor.predict(x, plan.u + shift))
    assert consistent.residual() > UNCERTIFIED
    assert replace(plan, u=plan.u + shift).residual() > UNCERTIFIED
    assert replace(plan, x=plan.x * (1 + SHIFT)).residual() > UNCERTIFIED


def test_residual_of_v3_sees_a_detour_to_the_same_end():
    rng = np.random.default_rng(SEED)
    model = SignalModel(*pair(rng, 3, 2, 1.1))
    problem, x = make(V3, model, rng, 3, 2, 4)
    plan, maps = solve(problem, x), model.predictor(4)
    kernel = np.linalg.svd(np.concatenate(list(maps.B[::-1]), axis=1))[2][3:]
    for direction in kernel:
        u = plan.u + SHIFT * direction.reshape(4, 2)
        detour = replace(plan, u=u, x=maps.predict(x, u))
        np.testing.assert_allclose(detour.x[-1], problem.r, rtol=SAME_RTOL, atol=SAME_RTOL)
        assert detour.residual() > UNCERTIFIED


def test_residual_is_relative_to_the_terms_that_cancel():
    """By hand, for one step with x+ = x + (1, 1)u and a terminal weight whose rows nearly cancel."""
    QN, weight, x = np.array([[1.0, -0.9], [-0.9, 1.0]]), 3.0, np.array([1.0, 2.0])
    plan = solve(V1(SignalModel(np.eye(2), np.ones((2, 1))), 1.0, 2.0, QN, weight, 1), x)
    u = plan.u + 1e-3
    other = replace(plan, u=u, x=np.stack([x, x + u[0]]))
    gradient = 2 * u[0, 0] + weight * np.sum(QN @ other.x[-1])
    size = 2 * abs(u[0, 0]) + weight * np.sum(np.abs(QN) @ (np.abs(x) + np.abs(u[0])))
    assert other.residual() == pytest.approx(abs(gradient) / size, rel=1e-9)


@pytest.mark.parametrize("kind", [V1, V3])
def test_value_is_least(kind):
    rng = np.random.default_rng(SEED)
    model = SignalModel(*pair(rng, 3, 2, 1.1))
    problem, x = make(kind, model, rng, 3, 2, 4)
    plan, maps = solve(problem, x), model.predictor(4)
    moves = np.eye(8) if kind is V1 else np.linalg.svd(np.concatenate(list(maps.B[::-1]), axis=1))[2][3:]
    for move in moves:
        for shift in (1e-3, -1e-3):
            u = plan.u + shift * move.reshape(4, 2)
            assert replace(plan, u=u, x=maps.predict(x, u)).value > plan.value


# Batches


@pytest.mark.parametrize("maps", [False, True])
@pytest.mark.parametrize("kind", [V1, V2, V3])
def test_batch_is_what_its_members_are(kind, maps):
    rng = np.random.default_rng(SEED)
    models = [general_maps(rng, 3, 2, 4) if maps else SignalModel(*pair(rng, 3, 2, 1.1)) for _ in range(3)]
    made = [make(kind, model, rng, 3, 2, 4) for model in models]
    stacked = type(models[0])(np.stack([model.A for model in models]), np.stack([model.B for model in models]))
    parts = {
        name: np.stack([getattr(problem, name) for problem, _ in made])
        for name in ("Q", "R", "QN", "r", "weight")
        if hasattr(made[0][0], name)
    }
    plans = solve(kind(model=stacked, horizon=4, **parts), np.stack([x for _, x in made]))
    assert plans.u.shape == (3, 4, 2)
    assert plans.x.shape == (3, 5, 3)
    assert np.max(plans.residual()) < CERTIFIED
    for i, (problem, x) in enumerate(made):
        plan = solve(problem, x)
        np.testing.assert_allclose(plans.u[i], plan.u, rtol=SAME_RTOL, atol=SAME_RTOL)
        np.testing.assert_allclose(plans.x[i], plan.x, rtol=SAME_RTOL, atol=SAME_RTOL)
        np.testing.assert_allclose(plans.value[i], plan.value, rtol=SAME_RTOL, atol=SAME_RTOL)


@pytest.mark.parametrize("maps", [False, True])
@pytest.mark.parametrize("kind", [V1, V2, V3])
def test_one_model_many_states(kind, maps):
    rng = np.random.default_rng(SEED)
    model = general_maps(rng, 3, 2, 4) if maps else SignalModel(*pair(rng, 3, 2, 1.1))
    problem, _ = make(kind, model, rng, 3, 2, 4)
    states = rng.standard_normal((2, 5, 3))
    plans = solve(problem, states)
    assert plans.u.shape == (2, 5, 4, 2)
    np.testing.assert_allclose(plans.u[1, 3], solve(problem, states[1, 3]).u, rtol=SAME_RTOL, atol=SAME_RTOL)
    assert np.max(plans.residual()) < CERTIFIED


@pytest.mark.parametrize("kind", [V1, V2, V3])
def test_many_models_one_state(kind):
    rng = np.random.default_rng(SEED)
    models = [SignalModel(*pair(rng, 3, 2, 1.1)) for _ in range(4)]
    problem, x = make(kind, models[0], rng, 3, 2, 4)
    stacked = SignalModel(np.stack([model.A for model in models]), np.stack([model.B for model in models]))
    plans = solve(replace(problem, model=stacked), x)
    for i, model in enumerate(models):
        single = solve(replace(problem, model=model), x)
        np.testing.assert_allclose(plans.u[i], single.u, rtol=SAME_RTOL, atol=SAME_RTOL)
    assert np.max(plans.residual()) < CERTIFIED


def test_many_weights_one_state():
    rng = np.random.default_rng(SEED)
    problem, x = make(V1, SignalModel(*pair(rng, 3, 2, 1.1)), rng, 3, 2, 4)
    weights = np.array([0.0, 1.0, 1e6])
    plans = solve(replace(problem, weight=weights), x)
    for i, weight in enumerate(weights):
        np.testing.assert_allclose(plans.u[i], solve(replace(problem, weight=weight), x).u, rtol=SAME_RTOL)
    assert np.max(plans.residual()) < CERTIFIED


# What is refused

MODEL = SignalModel([[1.0, 1.0], [0.0, 1.0]], [[0.0], [1.0]])


@pytest.mark.parametrize(
    ("build", "sentence"),
    [
        (
            lambda: V1(MODEL, np.eye(3), 1.0, 1.0, 1.0, 3),
            r"Q must be a number or a matrix of shape \(2, 2\), got shape \(3, 3\)",
        ),
        (lambda: V1(MODEL, 1.0, 0.0, 1.0, 1.0, 3), "R must be positive definite, got smallest eigenvalue 0"),
        (lambda: V1(MODEL, 1.0, 1.0, [[1.0, 2.0], [0.0, 1.0]], 1.0, 3), "QN must be symmetric"),
        (lambda: V1(MODEL, 1.0, 1.0, 1.0, -1.0, 3), r"weight must be nonnegative, got -1\.0"),
        (lambda: V1(MODEL, 1.0, 1.0, 1.0, np.nan, 3), "weight must be finite"),
        (lambda: V1(MODEL, 1.0, 1.0, 1.0, 1.0, 0), "horizon must be an integer of at least 1, got 0"),
        (lambda: V1(MODEL.predictor(4), 1.0, 1.0, 1.0, 1.0, 3), "horizon must be that of the predictor maps, 4, got 3"),
        (lambda: V2(MODEL, -1.0, 3), "QN must be positive definite"),
        (lambda: V3(MODEL, 1.0, 1.0, [0.0, 0.0, 0.0], 3), r"r must have shape \(2,\), got \(3,\)"),
        (lambda: solve(V2(MODEL, 1.0, 3), [1.0]), r"x must have shape \(2,\), got \(1,\)"),
        (lambda: solve(V2(MODEL, 1.0, 3), [1.0, np.inf]), "x must be finite, got inf among its entries"),
    ],
)
def test_refused(build, sentence):
    with pytest.raises(InputError, match=sentence):
        build()


@pytest.mark.parametrize("miss", [1e-8, 1e-6])
def test_a_small_miss_of_r_is_infeasible_too(miss):
    """A mode out of reach ends at 0.5; r beside that by ten times the threshold or more is not to be had."""
    model = SignalModel(np.array([[0.5, 0.0], [0.0, 2.0]]), np.array([[0.0], [1.0]]))
    reachable = np.array([0.25, 3.0])
    assert float(solve(V3(model, 1.0, 1.0, reachable, 2), [1.0, 1.0]).residual()) < 1e-14
    with pytest.raises(InfeasibleError, match="misses r"):
        solve(V3(model, 1.0, 1.0, reachable + np.array([miss * 10, 0.0]), 2), [1.0, 1.0])
    with pytest.raises(InfeasibleError, match="misses r"):
        solve(V3(model, 1.0, 1.0, [0.0, 0.0], 2), [miss * 1e3, 1.0])


def test_a_plan_that_overflows_is_refused():
    model = SignalModel(np.array([[1e100]]), np.array([[0.0]]))
    with pytest.raises(InputError, match="range of floating-point numbers"):
        solve(V1(model, 1.0, 1.0, 1.0, 1.0, 30), [1.0])


def test_batches_that_do_not_fit_are_refused():
    model = SignalModel(np.zeros((4, 2, 2)), np.zeros((4, 2, 1)))
    with pytest.raises(InputError, match="leading batch axes must broadcast"):
        solve(V1(model, 1.0, 1.0, 1.0, 1.0, 3), np.zeros((5, 2)))


@pytest.mark.parametrize("seed", range(5))
def test_an_input_that_reaches_nothing_is_not_used(seed):
    """Rounding of the decomposition gives its column a singular value of 1e-17 beside ones of order one."""
    rng = np.random.default_rng(seed)
    A = np.concatenate([np.eye(4)[None], rng.normal(size=(2, 4, 4))])
    B = rng.normal(size=(2, 4, 2)) * [1.0, 0.0]
    x, maps = rng.normal(size=(20, 4)), PredictorMaps(A, B)
    plan, alone = solve(V2(maps, np.eye(4), 2), x), solve(V2(PredictorMaps(A, B[..., :1]), np.eye(4), 2), x)
    assert np.max(np.abs(plan.u[..., 1])) < 1e-12
    assert np.allclose(plan.u[..., :1], alone.u, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("which", [V2, V3])
def test_rank_deficient_maps_with_columns_of_different_sizes(which):
    """Everything acts along (1, 1, 1); rounding of the decomposition is several units of its largest value."""
    rng = np.random.default_rng(0)
    for _ in range(300):
        along = np.ones((3, 1)) / np.sqrt(3)
        A = np.concatenate([np.eye(3)[None], rng.normal(size=(3, 3, 3))])
        B = along @ (rng.normal(size=(3, 1, 2)) * [2.0**-10, 1.0])
        x, maps = rng.normal(size=3), PredictorMaps(A, B)
        problem = V2(maps, np.eye(3), 3)
        if which is V3:
            problem = V3(maps, 1.0, 1.0, solve(problem, x).x[-1], 3)
        assert solve(problem, x).residual() < 1e-9
