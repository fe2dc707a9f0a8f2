"""Delay lifting and Remark 4's augmentation against direct recursion."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rhl.basis import Features, Polynomials, Terms
from rhl.errors import InputError
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


# Functions of the outputs beside them

BASES = {
    "none": None,
    "squares": Polynomials(2),
    "cubes": Polynomials(3),
    "terms": Terms(("y1^2", "y1*y1(k-1)")),
    "own": Features(lambda w: [w[0] * w[1], w[1] ** 2], 2),
}
based = pytest.mark.parametrize("basis", BASES.values(), ids=BASES)


@based
def test_lifted_signal_is_stack_then_functions_of_it(basis):
    lifting, p = DelayLifting(2, 2, basis), 2
    history = np.random.default_rng(SEED).standard_normal((3, 6, p))
    x = lifting.lift(history, 4)
    assert x.shape == (3, 4, lifting.size(p))
    for i, j in np.ndindex(3, 4):
        w = np.concatenate([history[i, j], history[i, j + 1]])
        expected = w if basis is None else np.concatenate([w, basis.features(w, p)])
        assert np.array_equal(x[i, j], expected)
    state = lifting.augmented_state(history, np.ones((3, 4, 1)))
    assert np.array_equal(state, np.concatenate([x[:, 0], np.ones((3, 1))], axis=-1))
    assert not np.any(lifting.lift(np.zeros((3, p)), 2))


@settings(max_examples=30)
@given(st.sampled_from(list(BASES)), st.integers(1, 4), st.integers(2, 3))
def test_output_size_is_the_inverse_of_size(basis, p, outputs):
    """And refuses every order that is no size."""
    lifting = DelayLifting(outputs, 1, BASES[basis])
    assert lifting.output_size(lifting.size(p)) == p
    sizes = {lifting.size(other) for other in range(1, 5)}
    for n in range(1, lifting.size(3)):
        if n not in sizes:
            with pytest.raises(InputError, match=f"must have an order that is .* {outputs}.*, got {n}$"):
                lifting.output_size(n)


def test_orders_with_a_basis_are_refused_by_name():
    with pytest.raises(InputError, match=r"a multiple of outputs = 2 plus the number of basis functions, got 4"):
        DelayLifting(2, 1, Polynomials(2)).output_size(4)
    with pytest.raises(InputError, match=r"a multiple of outputs = 1 plus the number of basis functions, got 2"):
        DelayLifting(1, 1, Terms(("y1*y2",))).output_size(2)  # would be p = 1, which has no y2


def run_of_the_papers_example(steps):
    """z1+ = z1 + z2^2 + u, z2+ = 0.5 z2 with both measured (Remark 3)."""
    rng = np.random.default_rng(SEED)
    z, outputs, inputs = np.array([1.0, 2.0]), [], rng.standard_normal((steps, 1))
    for u in inputs:
        outputs.append(z)
        z = np.array([z[0] + z[1] ** 2 + u[0], 0.5 * z[1]])
    return np.stack(outputs), inputs


def misfit_of_the_best_linear_model(basis):
    outputs, inputs = run_of_the_papers_example(12)
    x = DelayLifting(1, 1, basis).lift(outputs[::-1], 12)[::-1]
    rows = np.concatenate([x[:-1], inputs[:-1]], axis=1)
    return np.max(np.abs(rows @ np.linalg.lstsq(rows, x[1:], rcond=None)[0] - x[1:]))


def test_carlemans_embedding_of_the_papers_example():
    basis = Terms(("y2^2",))
    model = SignalModel([[1.0, 0.0, 1.0], [0.0, 0.5, 0.0], [0.0, 0.0, 0.25]], [[1.0], [0.0], [0.0]])
    outputs, inputs = run_of_the_papers_example(12)
    x = DelayLifting(1, 1, basis).lift(outputs[::-1], 12)[::-1]
    np.testing.assert_allclose(model.step(x[:-1], inputs[:-1]), x[1:], rtol=ROUNDING, atol=ROUNDING)
    assert misfit_of_the_best_linear_model(basis) < ROUNDING
    # Another function of the same output, or none, leaves the best of all linear models far off.
    assert misfit_of_the_best_linear_model(None) > 0.05
    assert misfit_of_the_best_linear_model(Terms(("y1*y2",))) > 0.05


@pytest.mark.parametrize(
    ("build", "sentence"),
    [
        (lambda: DelayLifting(1, 1, "y1^2"), "basis must be Polynomials, Terms, Features or None, got 'y1"),
        (lambda: DelayLifting(1, 1, 2), "basis must be Polynomials, Terms, Features or None, got 2"),
        (lambda: DelayLifting(2, 1, Terms(("y2",))).size(1), "'y2' must use outputs y1 to y1 with delays up to 1"),
        (lambda: DelayLifting(2, 1).output_size(3), "an order that is a multiple of outputs = 2, got 3"),
        (lambda: DelayLifting(0, 1), "outputs must be an integer of at least 1, got 0"),
        (lambda: DelayLifting(1, 0), "inputs must be an integer of at least 1, got 0"),
        (lambda: DelayLifting(1.5, 1), "outputs must be an integer of at least 1, got 1.5"),
        (
            lambda: DelayLifting(1, 2).augment(SignalModel(np.eye(2), np.ones((2, 3)))),
            r"the model's input size must be a multiple of inputs = 2, which u stacks, got 3",
        ),
    ],
)
def test_refused(build, sentence):
    with pytest.raises(InputError, match=sentence):
        build()
