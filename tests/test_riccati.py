"""The square-root step against the plain one, and the least steering against the pseudo-inverse."""

import numpy as np
import pytest

from rhl._riccati import gains, truncated_min_norm
from tests import oracle

SEED = 2010_05891
# One step on well conditioned data of order one.
ROUNDING = 1e-12


def step_data(n, q, lead=()):
    rng = np.random.default_rng([SEED, n, q])
    shapes = {"S": (n, n), "A": (n, n), "B": (n, q), "Q_factor": (n, n), "R_factor": (q, q)}
    data = {name: rng.standard_normal((*lead, *shape)) for name, shape in shapes.items()}
    return {name: np.triu(M) if name in ("S", "Q_factor", "R_factor") else M for name, M in data.items()}


def cost_step(**data):
    """One stage back, without the axis of stages."""
    K, V, S = gains(**data, horizon=1)
    return K[..., 0, :, :], V[..., 0, :, :], S


@pytest.mark.parametrize(("n", "q"), [(1, 1), (3, 1), (4, 3), (2, 5)])
def test_cost_step_is_the_riccati_step(n, q):
    data = step_data(n, q)
    S, A, B, C, D = map(oracle.exact, data.values())
    P = S.T @ S
    gain = oracle.solve(D.T @ D + B.T @ P @ B, B.T @ P @ A)
    before = C.T @ C + A.T @ P @ (A - B @ gain)
    K, V, S_before = cost_step(**data)
    np.testing.assert_allclose(K, oracle.rounded(gain), rtol=ROUNDING, atol=ROUNDING)
    np.testing.assert_allclose(S_before.T @ S_before, oracle.rounded(before), rtol=ROUNDING, atol=ROUNDING)
    np.testing.assert_allclose(V.T @ V, oracle.rounded(D.T @ D + B.T @ P @ B), rtol=ROUNDING, atol=ROUNDING)


def test_cost_step_completes_the_square():
    data, rng = step_data(3, 2), np.random.default_rng(SEED)
    K, V, S_before = cost_step(**data)
    x = rng.standard_normal(3)

    def cost(u):
        after = data["A"] @ x + data["B"] @ u
        return sum(np.sum((M @ v) ** 2) for M, v in (("Q_factor", x), ("R_factor", u), ("S", after)) for M in [data[M]])

    assert cost(-K @ x) == pytest.approx(np.sum((S_before @ x) ** 2), rel=ROUNDING)
    for u in rng.standard_normal((5, 2)):
        assert cost(u) == pytest.approx(np.sum((S_before @ x) ** 2) + np.sum((V @ (u + K @ x)) ** 2), rel=ROUNDING)


def test_a_cost_that_spans_thirty_orders_keeps_its_small_part():
    """P = diag(1e30, 1) would forget what is added to its small direction; its factor does not."""
    K, _, S = cost_step(
        S=np.diag([1e15, 1.0]), A=np.eye(2), B=np.array([[1.0], [0.0]]), Q_factor=np.eye(2), R_factor=np.eye(1)
    )
    np.testing.assert_allclose(np.abs(np.diag(S)), [np.sqrt(2), np.sqrt(2)], rtol=ROUNDING)
    np.testing.assert_allclose(K, [[1.0, 0.0]], atol=ROUNDING)


def test_weight_on_the_first_part_of_the_state_only():
    data = step_data(4, 2)
    padded = np.zeros((4, 4))
    padded[:2, :2] = data["Q_factor"][:2, :2]
    narrow = cost_step(**data | {"Q_factor": data["Q_factor"][:2, :2]})
    wide = cost_step(**data | {"Q_factor": padded})
    np.testing.assert_allclose(narrow[0], wide[0], rtol=ROUNDING, atol=ROUNDING)
    np.testing.assert_allclose(narrow[2].T @ narrow[2], wide[2].T @ wide[2], rtol=ROUNDING, atol=ROUNDING)


def test_cost_steps_of_a_batch():
    data = step_data(3, 2, lead=(2, 4))
    together = cost_step(**data)
    for index in np.ndindex(2, 4):
        alone = cost_step(**{name: M[index] for name, M in data.items()})
        for whole, part in zip(together, alone, strict=True):
            np.testing.assert_allclose(whole[index], part, rtol=ROUNDING, atol=ROUNDING)


@pytest.mark.parametrize(("rows", "columns", "rank"), [(3, 5, 3), (3, 5, 2), (4, 2, 2), (4, 2, 1), (3, 3, 0)])
def test_truncated_min_norm(rows, columns, rank):
    rng = np.random.default_rng(SEED)
    M = rng.standard_normal((rows, rank)) @ rng.standard_normal((rank, columns))
    wanted = rng.standard_normal(rows)
    w = truncated_min_norm(M, wanted, 1.0 + np.linalg.norm(M, axis=0))
    np.testing.assert_allclose(w, np.linalg.pinv(M, rcond=1e-10) @ wanted, rtol=1e-10, atol=ROUNDING)


@pytest.mark.parametrize(("noise", "followed"), [([1.0, 1.0], True), ([1.0, 1e6], False), ([1e6, 1.0], True)], ids=str)
def test_steering_that_may_be_rounding_is_not_followed(noise, followed):
    """A singular value of 1e-9 counts, unless the column it comes from was computed from products of size 1e6."""
    w = truncated_min_norm(np.diag([1.0, 1e-9]), np.ones(2), np.array(noise))
    np.testing.assert_allclose(w, [1.0, 1e9 if followed else 0.0], rtol=ROUNDING)


def test_truncated_min_norm_of_a_batch_with_other_ranks():
    M = np.stack([np.eye(2), np.diag([1.0, 0.0]), np.zeros((2, 2))])
    w = truncated_min_norm(M, np.ones((3, 2)), np.ones((3, 2)))
    assert np.array_equal(w, [[1, 1], [1, 0], [0, 0]])
