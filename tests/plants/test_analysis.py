"""Facts about known plants: derivatives, Hautus tests, observable parts, and signal models that make the same data."""

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rhl.errors import InputError
from rhl.paper.claims.kalman import run_open_loop, stacked
from rhl.plants import FunctionPlant, LinearPlant, RobotArm
from rhl.plants.analysis import (
    detectability,
    growth_alone,
    linearise,
    observability,
    observability_index,
    observable_part,
    rough_model,
    signal_model,
    stabilizability,
)

# A dozen steps of plants of order one, through O and its pseudo-inverse of condition up to 1e4.
ROUNDING = 1e-9


def random_plant(rng, n, p, q, hidden=0):
    """A plant of spectral radius 1.1 in mixed coordinates, the last ``hidden`` of whose modes no output sees."""
    while True:
        seen = n - hidden
        F = np.zeros((n, n))
        F[:seen, :seen] = rng.normal(size=(seen, seen))
        F[seen:] = rng.normal(size=(hidden, n))
        F *= 1.1 / np.abs(np.linalg.eigvals(F)).max()
        H = rng.normal(size=(p, n))
        H[:, seen:] = 0
        index = -(-seen // p)
        if np.linalg.cond(observability(F[:seen, :seen], H[:, :seen], index)) < 1e3:
            T = np.linalg.qr(rng.normal(size=(n, n)))[0]
            return LinearPlant(T @ F @ T.T, T @ rng.normal(size=(n, q)), H @ T.T), index


def misfit(model, plant, rng, outputs, inputs):
    """Largest |x(k+1) - A x(k) - B u(k)| along one run with full stacks, relative to the size of its data."""
    steps = max(outputs, inputs)
    v = rng.normal(size=(steps + 12, plant.q))
    y = run_open_loop(plant, rng.normal(size=plant.n), v)
    x, u = stacked(y, outputs), stacked(v, inputs)
    gap = x[1:] - x[:-1] @ model.A.T - u[:-1] @ model.B.T
    return np.abs(gap[steps - 1 :]).max() / (1 + np.abs(x).max())


# ---------------------------------------------------------------- rough models


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32), st.integers(1, 5), st.integers(1, 3), st.integers(1, 2), st.integers(0, 2), st.data())
def test_rough_model_makes_every_trajectory(seed, seen, p, q, hidden, data):
    rng = np.random.default_rng(seed)
    plant, index = random_plant(rng, seen + hidden, min(p, seen), q, hidden)
    outputs, inputs = data.draw(st.integers(index, index + 3)), data.draw(st.integers(index, index + 3))
    model = rough_model(plant, outputs, inputs)
    assert (model.n, model.q) == (outputs * plant.p, inputs * q)
    assert misfit(model, plant, rng, outputs, inputs) < ROUNDING
    # Another plant's model, or this one with its older inputs cut off, does not.
    other = LinearPlant(plant.F, 1.01 * plant.G, plant.H)
    assert misfit(rough_model(other, outputs, inputs), plant, rng, outputs, inputs) > 1e-6


@pytest.mark.parametrize("seed", range(5))
def test_shortened_lags_do_not_fit(seed):
    """Below the index no pair does, found by least squares: neither too few outputs nor too few inputs."""
    rng = np.random.default_rng(seed)
    plant, index = random_plant(rng, 4, 1, 1)
    v = rng.normal(size=(60, 1))
    y = run_open_loop(LinearPlant(0.8 * plant.F, plant.G, plant.H), rng.normal(size=4), v)

    def best(outputs, inputs):
        rows = np.hstack([stacked(y, outputs), stacked(v, inputs)])[index:-1]
        right = stacked(y, outputs)[index + 1 :]
        return np.abs(right - rows @ np.linalg.lstsq(rows, right, rcond=None)[0]).max()

    assert best(index, index) < ROUNDING
    assert best(index - 1, index) > 1e-6
    assert best(index, index - 1) > 1e-6


def test_rough_model_of_equal_lengths_is_the_pair_of_equation_55():
    plant, index = random_plant(np.random.default_rng(1), 3, 1, 2)
    ours, theirs = rough_model(plant, 4, 4), signal_model(plant.F, plant.G, plant.H, 4)
    assert index == 3
    np.testing.assert_allclose(ours.A, theirs.A, atol=ROUNDING)
    np.testing.assert_allclose(ours.B, theirs.B, atol=ROUNDING)


def test_longer_stacks_move_along_and_longer_inputs_do_nothing():
    plant = LinearPlant([[0.9]], [[2.0]], [[1.0]])
    model = rough_model(plant, 3, 1)
    np.testing.assert_allclose(model.A, [[0.9, 0, 0], [1, 0, 0], [0, 1, 0]], atol=1e-15)
    np.testing.assert_allclose(model.B, [[2], [0], [0]], atol=1e-15)
    model = rough_model(plant, 1, 3)
    np.testing.assert_allclose(model.A, [[0.9]], atol=1e-15)
    np.testing.assert_allclose(model.B, [[2, 0, 0]], atol=1e-15)


def test_rough_model_refuses():
    plant, _ = random_plant(np.random.default_rng(1), 3, 1, 1)
    for lengths, name in (((2, 3), "outputs"), ((3, 2), "inputs")):
        with pytest.raises(InputError, match=f"{name} must be at least 3, the observability index .* got 2; stack 3"):
            rough_model(plant, *lengths)
    with pytest.raises(InputError, match="outputs must be an integer of at least 1, got 0"):
        rough_model(plant, 0, 3)
    with pytest.raises(InputError, match=r"must be a LinearPlant, got RobotArm; pass rhl.plants.analysis.linearise"):
        rough_model(RobotArm(), 1, 1)
    assert rough_model(linearise(RobotArm()), 1, 1).n == 3
    with pytest.raises(InputError, match="H must not be zero, got outputs that are always zero"):
        rough_model(LinearPlant(plant.F, plant.G, 0 * plant.H), 3, 3)
    batch = LinearPlant(np.stack([plant.F] * 2), plant.G, plant.H)
    with pytest.raises(InputError, match=r"must be single matrices, got shapes \(2, 3, 3\)"):
        rough_model(batch, 3, 3)
    with pytest.raises(InputError, match=r"G must be a single matrix, got shape \(2, 3, 1\); take one of the batch"):
        rough_model(LinearPlant(plant.F, np.stack([plant.G] * 2), plant.H), 3, 3)


# ---------------------------------------------------------------- the observable part


@pytest.mark.parametrize("seed", range(10))
def test_observable_part_makes_the_same_outputs(seed):
    rng = np.random.default_rng(seed)
    plant, index = random_plant(rng, 6, 2, 2, hidden=2)
    part = observable_part(plant)
    assert (part.n, part.p, part.q) == (4, 2, 2)
    assert observability_index(plant.F, plant.H) == observability_index(part.F, part.H) == index == 2
    assert np.linalg.matrix_rank(control.obsv(part.F, part.H)) == 4
    v = rng.normal(size=(12, 2))
    from_rest = [run_open_loop(system, np.zeros(system.n), v) for system in (plant, part)]
    np.testing.assert_allclose(*from_rest, atol=ROUNDING)
    # Its eigenvalues are the plant's but for the two hidden ones.
    gaps = np.abs(np.linalg.eigvals(part.F)[:, None] - np.linalg.eigvals(plant.F)).min(axis=1)
    assert gaps.max() < 1e-6
    # What the outputs do see must not be left out.
    cut = LinearPlant(part.F[:3, :3], part.G[:3], part.H[:, :3])
    assert np.abs(run_open_loop(cut, np.zeros(3), v) - from_rest[0]).max() > 1e-3


@pytest.mark.parametrize("index", [1, 2, 3, 5])
def test_observability_index_of_chains(index):
    """A chain of delays is seen after as many outputs as it is long; two outputs halve it."""
    F = np.eye(index, k=1)
    assert observability_index(F, np.eye(1, index)) == index
    assert observability_index(F, np.eye(index)) == 1
    # From the far end only the last entry is seen.
    assert observability_index(F, np.eye(index)[-1:]) == 1
    assert observability_index(np.kron(np.eye(2), F), np.kron(np.eye(2), np.eye(1, index))) == index


def test_observability_index_does_not_mind_the_size_of_f():
    """Rows H F^i of size 1e60 and 1e-60 are judged by direction."""
    rng = np.random.default_rng(0)
    F, H = rng.normal(size=(6, 6)), rng.normal(size=(1, 6))
    assert [observability_index(scale * F, H) for scale in (1e-12, 1.0, 1e12)] == [6, 6, 6]


# ---------------------------------------------------------------- Hautus tests


def test_modes_by_hand():
    F = np.diag([2.0, -1.0, 0.5])
    modes = stabilizability(F, np.array([[0.1, 0.0], [0.0, 3.0], [0.0, 0.0]]))
    assert modes.holds
    assert np.array_equal(np.sort(modes.eigenvalues.real), [-1.0, 2.0])
    assert modes.worst == (2.0, pytest.approx(0.1))
    assert not modes.eigenvalues.flags.writeable
    deaf = stabilizability(F, np.array([[0.1], [0.0], [1.0]]))
    assert not deaf.holds
    assert deaf.worst == (-1.0, 0.0)
    assert stabilizability(0.5 * F[1:, 1:], np.zeros((2, 1))).worst is None
    assert stabilizability(0.5 * F[1:, 1:], np.zeros((2, 1))).holds


def test_detectability_is_the_dual():
    rng = np.random.default_rng(2)
    plant, _ = random_plant(rng, 5, 1, 2, hidden=2)
    ours, dual = detectability(plant.F, plant.H), stabilizability(plant.F.T, plant.H.T)
    np.testing.assert_allclose(np.sort(ours.margins), np.sort(dual.margins))


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("order", [1, 2])
def test_a_hidden_mode_on_the_circle_is_found_in_any_coordinates(seed, order):
    """Simple and double eigenvalues at 1 are scattered by rounding, a double one by 1e-8."""
    rng = np.random.default_rng(seed)
    F = np.zeros((5, 5))
    F[:order, :order] = np.eye(order) + np.eye(order, k=1)
    F[order:, order:] = rng.normal(size=(5 - order, 5 - order)) / 4
    G = rng.normal(size=(5, 2))
    T = np.linalg.qr(rng.normal(size=(5, 5)))[0] @ np.diag([1, 2, 0.5, 1, 3])
    inverse = np.linalg.inv(T)
    assert stabilizability(T @ F @ inverse, T @ G).holds
    assert detectability(T @ F @ inverse, G.T @ inverse).holds
    G[:order] = 0
    assert not stabilizability(T @ F @ inverse, T @ G).holds
    assert not detectability(inverse.T @ F.T @ T.T, G.T @ T.T).holds


def test_hautus_tests_refuse():
    with pytest.raises(InputError, match=r"G must have shape \(2, at least 1\), got \(3, 1\)"):
        stabilizability(np.eye(2), np.ones((3, 1)))
    with pytest.raises(InputError, match=r"H must have shape \(at least 1, 2\), got \(1, 3\)"):
        detectability(np.eye(2), np.ones((1, 3)))
    with pytest.raises(InputError, match=r"F must be a single matrix, got shape \(4, 2, 2\); take one of the batch"):
        stabilizability(np.zeros((4, 2, 2)), np.ones((2, 1)))


# ---------------------------------------------------------------- linearisation


@pytest.mark.parametrize(("variant", "stiff"), [("data", 1000 / 11), ("printed", 1309.0)])
def test_linearise_the_arm(variant, stiff):
    """Equation (24) with sin x1 replaced by x1."""
    a, b, d, e, f = (400 / 11, 19.12 / 11, 86.04, 3.64, 100.0) if variant == "data" else (36.4, 1.7, 1000.0, 3.6, 100.0)
    rate = np.array([[0, 1, 0], [-stiff, -b, a], [0, -e, -d]])
    linear = linearise(RobotArm(variant))
    np.testing.assert_allclose(linear.F, np.eye(3) + 0.01 * rate, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(linear.G, [[0], [0], [0.01 * f]], atol=1e-9)
    np.testing.assert_allclose(linear.H, np.eye(3), atol=1e-9)


@given(st.integers(0, 2**32))
@settings(max_examples=30, deadline=None)
def test_linearise_away_from_zero(seed):
    """A plant with sines, exponentials and products about an equilibrium of any size, against its derivatives."""
    rng = np.random.default_rng(seed)
    M, N = rng.normal(size=(3, 3)), rng.normal(size=(3, 2))
    z, v = rng.normal(size=3) * 10.0 ** rng.integers(-2, 3), rng.normal(size=2)

    def step(at, u):
        return z + np.sin(M @ (at - z)) + (N @ (u - v)) * np.exp(at - z)

    def output(at):
        return np.array([at[0] * at[1], at[2] ** 3])

    linear = linearise(FunctionPlant(step, output, 3, 2), z, v)
    size = 1 + np.abs(z).max() ** 2
    np.testing.assert_allclose(linear.F, M, atol=1e-7 * size)
    np.testing.assert_allclose(linear.G, N, atol=1e-7 * size)
    np.testing.assert_allclose(linear.H, [[z[1], z[0], 0], [0, 0, 3 * z[2] ** 2]], atol=1e-7 * size)


def test_linearise_keeps_linear_plants():
    plant, _ = random_plant(np.random.default_rng(0), 4, 2, 1)
    assert linearise(plant) is plant
    through = linearise(FunctionPlant(plant.step, plant.output, 4, 1))
    for ours, theirs in zip((through.F, through.G, through.H), (plant.F, plant.G, plant.H), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-10)


def test_linearise_refuses():
    sentence = "^z with v must be an equilibrium, where a step leaves z unchanged, got a step that moves z by 0.765"
    with pytest.raises(InputError, match=sentence):
        linearise(RobotArm(), [1.0, 0.0, 0.0])
    with pytest.raises(InputError, match=r"z must have shape \(3,\), got \(2,\)"):
        linearise(RobotArm(), [1.0, 0.0])
    with pytest.raises(InputError, match=r"z must have shape \(3,\), got \(2, 3\); take one"):
        linearise(RobotArm(), np.zeros((2, 3)))
    root = FunctionPlant(lambda z, v: np.sqrt(z) if z[0] >= 0 else z * np.nan, lambda z: z, 1, 1)
    with pytest.raises(InputError, match="the plant's step near the equilibrium must be finite, got nan"):
        linearise(root)
    # It rests at 1 too, where it has a slope.
    np.testing.assert_allclose(linearise(root, [1.0]).F, [[0.5]], rtol=1e-9)


def test_growth_from_a_first_output_of_zero():
    hidden = LinearPlant([[0.5, 1.0], [0.0, 0.5]], [[0.0], [1.0]], [[1.0, 0.0]])
    assert growth_alone(hidden, [0.0, 1.0], 5) == np.inf
    assert growth_alone(hidden, [0.0, 0.0], 5) == 1
    assert growth_alone(hidden, [1.0, 0.0], 5) == 1
