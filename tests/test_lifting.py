"""Delay lifting and Remark 4's augmentation against direct recursion."""

import numpy as np
import pytest

from rhl._checks import InputError
from rhl.lifting import DelayLifting, remember
from rhl.model import SignalModel

SEED = 2010_05891
# The same short sums in another order; the models are contracting, so nothing grows.
ROUNDING = 1e-12


def lifted(rng, n, columns):
    """A contracting model, so that long runs stay of order one."""
    A = rng.standard_normal((n, n))
    return SignalModel(0.8 * A / np.linalg.norm(A, 2), rng.standard_normal((n, columns)))


@pytest.mark.parametrize("steps", [1, 2, 5])
def test_remember(steps):
    history = np.zeros((3, 2))
    for k in range(1, steps + 1):
        history = remember(history, np.full(2, float(k)))
    assert history[:, 0].tolist() == [float(max(k, 0)) for k in range(steps, steps - 3, -1)]


def test_remember_leaves_the_past_alone():
    history = np.zeros((3, 1))
    remember(history, np.ones(1))
    assert not np.any(history)


@pytest.mark.parametrize("p", [1, 2])
@pytest.mark.parametrize("depth", [1, 2, 3])
def test_window_stacks_newest_first(depth, p):
    signal = {k: np.array([10.0 * k + i for i in range(p)]) for k in range(10)}
    history = np.stack([signal[k] for k in reversed(range(10))])
    stacks = DelayLifting(depth, 1).window(history, depth, 4, start=2)
    assert stacks.shape == (4, depth * p)
    for j in range(4):
        expected = np.concatenate([signal[7 - j - i] for i in range(depth)])
        assert np.array_equal(stacks[j], expected)


@pytest.mark.parametrize("p", [1, 2])
@pytest.mark.parametrize("q", [1, 2, 3])
@pytest.mark.parametrize("N_y", [1, 2, 4])
@pytest.mark.parametrize("N_v", [1, 2, 3, 5])
def test_augmented_model_runs_like_the_lifted_one(p, q, N_y, N_v):
    rng = np.random.default_rng([SEED, p, q, N_y, N_v])
    lifting, n = DelayLifting(N_y, N_v), N_y * p
    model = lifted(rng, n, N_v * q)
    augmented = lifting.augment(model)
    assert (augmented.n, augmented.q) == (n + (N_v - 1) * q, q)
    v_history = rng.standard_normal((N_v, q))
    x = rng.standard_normal(n)
    X = np.concatenate([x, v_history[: N_v - 1].reshape(-1)])
    for v in rng.standard_normal((8, q)):
        v_history = remember(v_history, v)
        x = model.step(x, v_history.reshape(-1))
        X = augmented.step(X, v)
        np.testing.assert_allclose(
            X, np.concatenate([x, v_history[: N_v - 1].reshape(-1)]), rtol=ROUNDING, atol=ROUNDING
        )


@pytest.mark.parametrize("N_v", [1, 2, 3])
def test_augmented_state_is_outputs_then_past_inputs(N_v):
    outputs, inputs = np.array([[9.0, 90.0], [8.0, 80.0], [7.0, 70.0]]), np.array([[0.8], [0.7], [0.6]])
    state = DelayLifting(2, N_v).augmented_state(outputs, inputs)
    assert np.array_equal(state, [9.0, 90.0, 8.0, 80.0, *[0.8, 0.7][: N_v - 1]])


@pytest.mark.parametrize("lam", [0.0, 0.3, 1.0])
def test_mixing_commutes_with_augmentation(lam):
    rng = np.random.default_rng(SEED)
    lifting, one, other = DelayLifting(2, 3), lifted(rng, 4, 6), lifted(rng, 4, 6)
    outside = lifting.augment(one).mix(lifting.augment(other), lam)
    inside = lifting.augment(one.mix(other, lam))
    np.testing.assert_allclose(outside.theta, inside.theta, rtol=ROUNDING, atol=ROUNDING)
    # What depends on products does not commute; so this says something.
    squared = SignalModel(one.A @ one.A, one.B).mix(SignalModel(other.A @ other.A, other.B), 0.3)
    mixed = one.mix(other, 0.3)
    assert np.max(np.abs(squared.A - mixed.A @ mixed.A)) > 1e-3


def test_batches_agree_with_members():
    rng = np.random.default_rng(SEED)
    lifting, members = DelayLifting(2, 3), [lifted(rng, 4, 6) for _ in range(3)]
    together = lifting.augment(SignalModel(np.stack([m.A for m in members]), np.stack([m.B for m in members])))
    histories = rng.standard_normal((3, 6, 2)), rng.standard_normal((3, 6, 2))
    states = lifting.augmented_state(*histories)
    for i, member in enumerate(members):
        assert np.array_equal(together.A[i], lifting.augment(member).A)
        assert np.array_equal(together.B[i], lifting.augment(member).B)
        assert np.array_equal(states[i], lifting.augmented_state(histories[0][i], histories[1][i]))


@pytest.mark.parametrize(
    ("build", "sentence"),
    [
        (lambda: DelayLifting(0, 1), "outputs must be a whole number of at least 1, got 0"),
        (lambda: DelayLifting(1, 0), "inputs must be a whole number of at least 1, got 0"),
        (lambda: DelayLifting(1.5, 1), "outputs must be a whole number of at least 1, got 1.5"),
        (
            lambda: DelayLifting(1, 2).augment(SignalModel(np.eye(2), np.ones((2, 3)))),
            r"the model's input size must be a multiple of inputs = 2, which u stacks, got 3",
        ),
    ],
)
def test_refused(build, sentence):
    with pytest.raises(InputError, match=sentence):
        build()
