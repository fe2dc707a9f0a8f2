"""Plants: linear ones, also from python-control, ones made of two functions, and the robot arm in both variants."""

import math

import control
import numpy as np
import pytest

from rhl.errors import InputError, PlantError
from rhl.plants import FunctionPlant, LinearPlant, RobotArm
from rhl.plants._realisation import observable_basis

SEED = 2010_05891
# A handful of products of order one.
ROUNDING = 1e-13


@pytest.fixture
def plant():
    rng = np.random.default_rng(SEED)
    return LinearPlant(rng.standard_normal((3, 3)), rng.standard_normal((3, 2)), rng.standard_normal((1, 3)))


def test_linear_plant(plant):
    z, v = np.array([1.0, -2.0, 0.5]), np.array([3.0, -1.0])
    assert (plant.n, plant.q, plant.p) == (3, 2, 1)
    np.testing.assert_allclose(plant.step(z, v), plant.F @ z + plant.G @ v, rtol=ROUNDING)
    np.testing.assert_allclose(plant.output(z), plant.H @ z, rtol=ROUNDING)
    with pytest.raises(ValueError, match="read-only"):
        plant.F[0, 0] = 1


def follow(plant, system, z, inputs):
    """Outputs of the plant and of python-control's own simulation, both (T, p)."""
    response = control.forced_response(system, U=inputs, X0=z)
    ours = []
    for v in inputs.T:
        ours.append(plant.output(z))
        z = plant.step(z, v)
    return np.array(ours), response.outputs.reshape(system.noutputs, -1).T


def test_from_control_follows_a_state_space(plant):
    system = control.StateSpace(plant.F, plant.G, plant.H, np.zeros((1, 2)), 0.1)
    taken = LinearPlant.from_control(system)
    inputs = np.random.default_rng(SEED).standard_normal((2, 8))
    ours, theirs = follow(taken, system, np.array([1.0, 2.0, 3.0]), inputs)
    np.testing.assert_allclose(ours, theirs, rtol=1e-11)


def test_dt_true_is_discrete(plant):
    assert LinearPlant.from_control(control.StateSpace(plant.F, plant.G, plant.H, 0, True)).n == 3
    assert LinearPlant.from_control(control.tf([1], [1, 0.5], True)).n == 1


def at(plant, point):
    """H (point I - F)^-1 G, the transfer matrix."""
    return plant.H @ np.linalg.solve(point * np.eye(plant.n) - plant.F, plant.G)


@pytest.mark.parametrize(
    ("num", "den", "order"),
    [
        ([[[1.0, 0.3]]], [[[1.0, -1.2, 0.9]]], 2),
        ([[[0.0, 0.0, 2.0]]], [[[4.0, 1.0, 0.0, 0.0]]], 3),  # a leading coefficient, leading zeros, two delays
        ([[[1.0, -0.5]]], [[[1.0, -2.0, 0.75]]], 1),  # a cancelled root at 1/2
        ([[[1.0], [0.0]], [[0.0], [3.0]]], [[[1.0, 0.5], [1.0]], [[1.0], [1.0, -1.1, 0.3]]], 3),  # zero channels
        ([[[1.0], [2.0, 1.0]]], [[[1.0, 0.5], [1.0, 0.2, 0.1]]], 3),  # 1 x 2
        ([[[1.0]], [[2.0, 1.0]]], [[[1.0, 0.5]], [[1.0, 0.2, 0.1]]], 3),  # 2 x 1
        # The unstable pole at 2 in three channels, with a residue of rank 2; the others at 0 and 1/2 once each.
        ([[[1.0], [2.0, 1.0]], [[1.0], [3.0]]], [[[1.0, -2.0], [1.0, -0.5, 0.0]], [[1.0, -2.0], [1.0, -2.0]]], 4),
        # The pole at 2 in all four channels with a residue of rank 1: one unstable mode, not four.
        ([[[1.0], [2.0]], [[3.0], [6.0]]], [[[1.0, -2.0]] * 2] * 2, 1),
    ],
)
def test_from_control_realises_a_transfer_function(num, den, order):
    system = control.tf(num, den, 0.1)
    taken = LinearPlant.from_control(system)
    for point in (1.3 + 0.4j, -0.2 + 2j, 3.0):
        np.testing.assert_allclose(at(taken, point), system(point, squeeze=False).reshape(taken.p, taken.q), rtol=1e-11)
        assert not np.allclose(at(taken, 1.01 * point), at(taken, point), rtol=1e-4)
    # Without hidden modes: as many as the McMillan degree, all reached and all seen.
    assert taken.n == order
    for M in (taken.F.T, taken.F):
        factor = taken.H.T if M is not taken.F else taken.G
        reach = np.concatenate([np.linalg.matrix_power(M, i) @ factor for i in range(order)], axis=1)
        assert np.linalg.matrix_rank(reach, 1e-8) == order


def complex_system(kind):
    """python-control refuses complex coefficients in its constructors, not afterwards."""
    if kind == "ss":
        system = control.ss([[0.5]], [[1.0]], [[1.0]], 0, 1)
        system.B = 1j * system.B
    else:
        system = control.tf([1.0], [1.0, 0.5], 1)
        system.num_array[0, 0] = np.array([1j])
    return system


@pytest.mark.parametrize(
    ("system", "sentence"),
    [
        (
            0.5,
            "system must be a control.StateSpace or a control.TransferFunction, got float; use rhl.plants",
        ),
        (control.tf([1], [1, 1]), r"in discrete time .* got dt=0; give .*from_control\(system, sampling=Ts\)$"),
        (control.ss([[1.0]], [[1.0]], [[1.0]], [[0.0]], 0), r"got dt=0; .*sampling=Ts\)$"),
        (control.ss([[1.0]], [[1.0]], [[1.0]], [[0.0]], None), "got dt=None; say dt=True when making it"),
        (control.tf([[[1], [2]]], [[[1, 1], [1, 2]]]), r"got dt=0; .*sampling=Ts\)$"),
        (
            control.ss([[1.0]], [[1.0]], [[1.0]], [[2.0]], 1),
            "must have D = 0 .* got a feedthrough; put one step",
        ),
        (control.tf([1, 0], [1, 0.5], 1), r"must be strictly proper .* got degree 1 over 1 from input 0 to output 0"),
        (control.tf([1, 0, 0], [1, 0.5], 1), r"degree 2 over 1 .* with control.tf\(\[1\], \[1, 0, 0\], system.dt\)"),
        (control.tf([0], [1, 0.5], 1), "system must respond to an input, got a transfer function that is zero"),
        (complex_system("ss"), "system must have real matrices, got complex ones"),
        (complex_system("tf"), "system must have real coefficients, got complex ones"),
    ],
)
def test_from_control_refuses(system, sentence):
    with pytest.raises(InputError, match=sentence):
        LinearPlant.from_control(system)


@pytest.mark.parametrize(
    ("system", "name"),
    [
        (control.tf([1], [1, 1]), "Ts"),
        (control.tf([[[1], [2]]], [[[1, 1], [1, 2]]]), "Ts"),
        (control.ss([[0.5]], [[1.0]], [[1.0]], [[2.0]], 0.1), "delay"),
        (control.ss(0.5 * np.eye(2), np.eye(2), np.eye(2), np.eye(2), 0.1), "delay"),
        (control.tf([1, 0, 0], [1, 0.5], 0.1), "multiply"),
    ],
)
def test_the_remedies_work(system, name):
    """What a message says to do is done, word for word, and the plant is taken."""
    with pytest.raises(InputError) as refusal:
        LinearPlant.from_control(system)
    words = {"Ts": "as in ", "delay": "before it with ", "multiply": "that channel with "}[name]
    call = str(refusal.value).split(words)[1]
    call = f"system * {call}" if name == "multiply" else call
    names = {"control": control, "np": np, "system": system, "Ts": 0.1, "LinearPlant": LinearPlant}
    remedied = eval(call, names)
    taken = remedied if name == "Ts" else LinearPlant.from_control(remedied)
    if name != "Ts":
        delay = 2 if name == "multiply" else 1
        np.testing.assert_allclose(at(taken, 3.0) * 3.0**delay, np.reshape(system(3.0), (taken.p, taken.q)), rtol=1e-12)


def responses(plant, count):
    """Outputs after an impulse of each input, shape (count, p, q)."""
    return np.array([plant.H @ np.linalg.matrix_power(plant.F, k) @ plant.G for k in range(count)])


# The unstable pole at 1 is shared by three channels; one channel is zero; one has an integrator.
CONTINUOUS = (
    [[[1.0], [2.0, 1.0]], [[0.0], [3.0]]],
    [[[1.0, -1.0], [1.0, 2.0, 5.0]], [[1.0], [1.0, -1.0, 0.0]]],
)


def test_several_channels_are_sampled_with_inputs_held():
    """Each channel as python-control samples it alone; sampled at another rate or without holding it is another."""
    taken = LinearPlant.from_control(control.tf(*CONTINUOUS), sampling=0.2)
    alone = [
        [
            responses(LinearPlant.from_control(control.sample_system(control.tf(num, den), 0.2)), 12)[:, 0, 0]
            if any(num)
            else np.zeros(12)
            for num, den in zip(*rows, strict=True)
        ]
        for rows in zip(*CONTINUOUS, strict=True)
    ]
    ours, theirs = responses(taken, 12), np.moveaxis(alone, -1, 0)
    assert (taken.p, taken.q, taken.n) == (2, 2, 5)
    np.testing.assert_allclose(ours, theirs, rtol=1e-10, atol=1e-12)
    other = responses(LinearPlant.from_control(control.tf(*CONTINUOUS), sampling=0.21), 12)
    assert np.abs(other - ours).max() > 1e-2
    impulses = control.sample_system(control.tf([1.0], [1.0, -1.0]), 0.2, method="backward_diff")
    assert abs(impulses(2.0) - at(taken, 2.0)[0, 0]) > 1e-2


def test_a_state_space_is_sampled_in_its_own_state():
    A, B = np.array([[0.0, 1.0], [2.0, -0.3]]), np.array([[0.0], [1.0]])
    system = control.ss(A, B, [[1.0, 0.0]], 0)
    taken, theirs = LinearPlant.from_control(system, sampling=0.1), control.sample_system(system, 0.1)
    np.testing.assert_allclose(taken.F, theirs.A, rtol=1e-12)
    np.testing.assert_allclose(taken.G, theirs.B, rtol=1e-12)


@pytest.mark.parametrize(
    ("system", "sampling", "sentence"),
    [
        (control.tf([1], [1, 1], 0.1), 0.1, "sampling must be left out for a system in discrete time, got 0.1"),
        (control.tf([1], [1, 1]), 0, "sampling must be a positive finite number, got 0"),
        (control.tf([1], [1, 1]), "fast", "sampling must be a positive finite number, got 'fast'"),
        (control.tf([1], [1, -1]), 1e6, "sampling must be short enough .*got 1e.06"),
        (control.tf([1, 0], [1, 1]), 0.1, "strictly proper .* got degree 1 over 1 .*; model the lag .*1 more poles"),
        (control.ss([[1.0]], [[1.0]], [[1.0]], [[2.0]]), 0.1, "D = 0 .* got a feedthrough; model the lag"),
    ],
)
def test_sampling_refuses(system, sampling, sentence):
    with pytest.raises(InputError, match=sentence):
        LinearPlant.from_control(system, sampling)


def test_observable_basis():
    """The mode at 3 is hidden behind a rotation; the index counts block rows, of which the second adds one column."""
    rng = np.random.default_rng(SEED)
    T = np.linalg.qr(rng.standard_normal((4, 4)))[0]
    F = np.diag([1.1, 0.5, -0.3, 3.0])
    H = np.array([[1.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]])
    V, index = observable_basis(T @ F @ T.T, H @ T.T)
    assert (V.shape, index) == ((4, 3), 2)
    np.testing.assert_allclose(V.T @ V, np.eye(3), atol=ROUNDING)
    np.testing.assert_allclose(V.T @ T[:, 3], 0, atol=ROUNDING)
    # Units of an output do not decide what is seen; a coupling of one millionth does.
    assert observable_basis(F, np.diag([1e-20, 1e20]) @ H)[0].shape == (4, 3)
    assert observable_basis(F, H + 1e-6 * np.eye(4)[3])[0].shape == (4, 4)
    assert observable_basis(F, np.zeros((1, 4)))[0].shape == (4, 0)
    with pytest.raises(InputError, match=r"F and H must be single matrices, got shapes \(2, 4, 4\)"):
        observable_basis(np.stack([F, F]), H)


@pytest.mark.parametrize(
    ("F", "G", "H", "sentence"),
    [
        (np.ones((2, 3)), np.ones((2, 1)), np.ones((1, 2)), r"F must be square, got shape \(2, 3\)"),
        (np.eye(2), np.ones((3, 1)), np.ones((1, 2)), r"G must have shape \(2, at least 1\), got \(3, 1\)"),
        (np.eye(2), np.ones((2, 1)), np.ones((1, 3)), r"H must have shape \(at least 1, 2\), got \(1, 3\)"),
        (np.eye(2), np.ones((2, 1)), [[np.nan, 0.0]], "H must be finite, got nan"),
    ],
)
def test_linear_plant_refuses(F, G, H, sentence):
    with pytest.raises(InputError, match=sentence):
        LinearPlant(F, G, H)


# Equation (24), as printed and as the published curves obey it, entry by entry.
@pytest.mark.parametrize(
    ("variant", "accelerate", "charge"),
    [
        (
            "data",
            lambda x, u: 400 / 11 * x[2] - 19.12 / 11 * x[1] - 1000 / 11 * np.sin(x[0]),
            lambda x, u: -86.04 * x[2] - 3.64 * x[1] + 100 * u,
        ),
        (
            "printed",
            lambda x, u: 36.4 * x[2] - 1.7 * x[1] - 1309 * np.sin(x[0]),
            lambda x, u: -1000 * x[2] - 3.6 * x[1] + 100 * u,
        ),
    ],
)
def test_robot_arm(variant, accelerate, charge):
    arm, x, u = RobotArm(variant), np.array([0.7, -2.0, 3.0]), 1.5
    expected = x + 0.01 * np.array([x[1], accelerate(x, u), charge(x, u)])
    np.testing.assert_allclose(arm.step(x, np.array([u])), expected, rtol=ROUNDING)
    assert np.array_equal(arm.output(x), x)
    assert (arm.n, arm.q, arm.p) == (3, 1, 3)


def test_variants_differ():
    x, v = np.array([0.7, -2.0, 3.0]), np.array([1.5])
    assert np.max(np.abs(RobotArm("data").step(x, v) - RobotArm("printed").step(x, v))) > 1


def test_robot_arm_rests():
    assert not np.any(RobotArm().step(np.zeros(3), np.zeros(1)))


def test_robot_arm_refuses():
    with pytest.raises(InputError, match="variant must be one of data, printed, got 'paper'"):
        RobotArm("paper")


@pytest.fixture
def function_plant(plant):
    return FunctionPlant(lambda z, v: plant.F @ z + plant.G @ v, lambda z: plant.H @ z, 3, 2)


@pytest.mark.parametrize("kind", ["linear", "arm", "functions"])
def test_wrong_lengths_are_refused(kind, plant, function_plant):
    plant = {"linear": plant, "arm": RobotArm(), "functions": function_plant}[kind]
    q = plant.q
    for z in (np.zeros(4), np.zeros((2, 1)), np.float64(0.0)):
        with pytest.raises(InputError, match=r"z must have shape \(\.\.\., 3\) for this plant, got \("):
            plant.step(z, np.zeros(q))
        with pytest.raises(InputError, match=r"z must have shape \(\.\.\., 3\) for this plant, got \("):
            plant.output(z)
    with pytest.raises(InputError, match=rf"v must have shape \(\.\.\., {q}\) for this plant, got \({q + 1},\)"):
        plant.step(np.zeros(3), np.zeros(q + 1))


@pytest.mark.parametrize("kind", ["linear", "arm", "functions"])
def test_batches_agree_with_members(kind, plant, function_plant):
    plant = {"linear": plant, "arm": RobotArm(), "functions": function_plant}[kind]
    rng = np.random.default_rng(SEED)
    z, v = rng.standard_normal((4, 5, 3)), rng.standard_normal((4, 5, plant.q))
    together, outputs = plant.step(z, v), plant.output(z)
    for i, j in np.ndindex(4, 5):
        np.testing.assert_allclose(together[i, j], plant.step(z[i, j], v[i, j]), rtol=ROUNDING, atol=ROUNDING)
        np.testing.assert_allclose(outputs[i, j], plant.output(z[i, j]), rtol=ROUNDING, atol=ROUNDING)


def test_function_plant_is_its_functions(plant, function_plant):
    z, v = np.array([1.0, -2.0, 0.5]), np.array([3.0, -1.0])
    assert (function_plant.n, function_plant.q, function_plant.p) == (3, 2, 1)
    np.testing.assert_allclose(function_plant.step(z, v), plant.step(z, v), rtol=ROUNDING)
    np.testing.assert_allclose(function_plant.output(z), plant.output(z), rtol=ROUNDING)
    # One input for a batch of states.
    np.testing.assert_allclose(function_plant.step(np.stack([z, 2 * z]), v)[1], plant.step(2 * z, v), rtol=ROUNDING)
    with pytest.raises(InputError, match=r"batch axes must broadcast together, got shapes z \(2, 3\), v \(3, 2\)"):
        function_plant.step(np.zeros((2, 3)), np.zeros((3, 2)))


def still(z, v):
    return 1.0 * z


def whole(z):
    return z


def write(z, v):
    z[0] += 1.0
    return z


def add_in_place(z, v):
    z += 1.0
    return z


@pytest.mark.parametrize(
    ("transition", "measurement", "sentence"),
    [
        (
            lambda z, v: z[:1],
            whole,
            r"transition\(z, v\) must return an array of shape \(2,\), got shape \(1,\); r",
        ),
        (lambda z, v: z[None], whole, r"transition\(z, v\) must return .* got shape \(1, 2\)"),
        (lambda z, v: None, whole, r"transition\(z, v\) must return .* of real numbers, got None; return np.array"),
        (lambda z, v: z + 0j, whole, r"of real numbers, got array\(\[0\.\+0\.j"),
        (lambda z, v: "ab", whole, "of real numbers, got 'ab'"),
        (lambda z, v: [1.0, [2.0]], whole, r"got \[1\.0, \[2\.0\]\], which is not a rectangular array"),
        (
            lambda z, v: z / 0.0 * v,
            whole,
            r"transition\(z, v\) must be finite at z = 0, .* got array\(\[nan, nan",
        ),
        (lambda z, v: [10.0**400, 0.0], whole, "transition.* must be finite at z = 0"),
        (
            still,
            lambda z: z[0],
            r"measurement\(z\) must return an array of shape \(p,\), got shape \(\); return",
        ),
        (still, lambda z: [], r"measurement\(z\) must return an array of shape \(p,\), got shape \(0,\)"),
        (still, lambda z: z + np.inf, r"measurement\(z\) must be finite at z = 0"),
    ],
)
@pytest.mark.filterwarnings("ignore:invalid value encountered:RuntimeWarning")
def test_function_plant_refuses(transition, measurement, sentence):
    with pytest.raises(PlantError, match=sentence):
        FunctionPlant(transition, measurement, 2, 1)


@pytest.mark.parametrize(
    ("transition", "kind", "said"),
    [
        (lambda z, v: 1 / 0, ZeroDivisionError, "division by zero"),
        (lambda z: z, TypeError, "takes 1 positional argument but 2 were given"),
        (write, ValueError, "read-only"),
        (add_in_place, ValueError, "read-only"),
    ],
)
def test_what_a_function_raises_is_let_through(transition, kind, said):
    with pytest.raises(kind, match=said) as caught:
        FunctionPlant(transition, whole, 2, 1)
    assert type(caught.value) is kind
    (note,) = caught.value.__notes__
    assert note.startswith("rhl called transition(z, v) at z = array([0., 0.]), v = array([0.])")
    assert note.endswith("begin with z = z.copy() to write into one")


def test_function_plant_refuses_its_sizes():
    with pytest.raises(InputError, match="n must be an integer of at least 1, got 0"):
        FunctionPlant(still, whole, 0, 1)
    with pytest.raises(InputError, match=r"measurement must be a function measurement\(z\), got 3"):
        FunctionPlant(still, 3, 2, 1)


def test_a_function_that_fails_later_says_where():
    def sticky(z, v):
        if z[0] > 5:
            raise LookupError("no such gear")
        return z[:1] if z[0] > 3 else z

    plant = FunctionPlant(sticky, whole, 2, 1)
    with pytest.raises(LookupError, match="no such gear") as seen:
        plant.step(np.array([6.0, 0.0]), np.zeros(1))
    assert seen.traceback[-1].name == "sticky"
    assert seen.value.__notes__[0].startswith("rhl called transition(z, v) at z = array([6., 0.]), v = array([0.])")
    with pytest.raises(PlantError, match=r"must return an array of shape \(2,\), got shape \(1,\)"):
        plant.step(np.array([4.0, 0.0]), np.zeros(1))
    with pytest.raises(PlantError, match=r"measurement\(z\) must return an array of shape \(1,\), got shape \(2,\)"):
        FunctionPlant(still, lambda z: z if z[0] else z[:1], 2, 1).output(np.ones(2))


def test_numbers_out_of_range_are_let_through():
    """The closed loop, not the plant, says that it has diverged."""
    with np.errstate(over="ignore"):
        assert np.all(np.isinf(FunctionPlant(lambda z, v: z * 1e300, whole, 2, 1).step(np.full(2, 1e300), np.zeros(1))))
    plant = FunctionPlant(lambda z, v: [math.exp(z[0]), 0.0], whole, 2, 1)
    assert np.all(np.isinf(plant.step(np.array([1000.0, 0.0]), np.zeros(1))))


def test_the_caller_keeps_its_state():
    """The function that writes is given a copy and refused; the array stays as it was."""
    seen = []
    plant = FunctionPlant(lambda z, v: seen.append(z) or 2 * z, whole, 2, 1)
    z = np.ones(2)
    plant.step(z, np.zeros(1))
    assert not np.shares_memory(seen[-1], z)
    assert z.flags.writeable
