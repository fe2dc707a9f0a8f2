"""What is chosen beforehand: sizes that fit, domains, constraints; the default; and everything that is refused."""

from dataclasses import FrozenInstanceError, replace
from itertools import islice

import numpy as np
import pytest

from rhl.basis import Polynomials, Terms
from rhl.closed_loop import closed_loop
from rhl.constraints import LinearConstraints
from rhl.controllability import ConstantMixing, LambdaSearch
from rhl.controller import Controller
from rhl.errors import InputError
from rhl.estimator import ProximalEstimator
from rhl.lifting import DelayLifting
from rhl.losses import Entropy, LogCosh
from rhl.model import SignalModel
from rhl.plants import LinearPlant
from rhl.schedules import PowerDecay
from rhl.scheme import Scheme, default_scheme, window_scheme
from rhl.simulation import simulate
from rhl.tracking import SetPoint

NAN = np.nan


def controller(**changes):
    settings = {"Q": 1.0, "R": 1.0, "QN": 1.0, "horizon": 6, "epsilon": PowerDecay(10.0)}
    return Controller(**settings | changes)


def scheme(**changes):
    return replace(
        Scheme(
            DelayLifting(2, 2),
            ProximalEstimator(4),
            controller(),
            SignalModel.companion_of_ones(2, 2, "eye-last-row-of-ones"),
        ),
        **changes,
    )


# Controller


@pytest.mark.parametrize("alpha", [1.0, 2.5])
def test_problem_is_equation_3(alpha):
    """Gamma(x) / epsilon(k) = alpha x'x (1 + 10 k), member by member of a batch of stages."""
    made = controller(alpha=alpha)
    model = SignalModel(np.eye(3), np.ones((3, 1)))
    x = np.arange(12.0).reshape(4, 3)
    stages = np.array([0, 1, 5, 1])
    problem = made.problem(model, x, stages)
    np.testing.assert_allclose(problem.weight, alpha * np.sum(x**2, axis=1) * (1 + 10 * stages), rtol=1e-14)
    for i, k in enumerate(stages):
        assert problem.weight[i] == made.problem(model, x[i], int(k)).weight
    assert problem.horizon == 6


def test_own_epsilon():
    made = controller(epsilon=lambda k: 0.5**k)
    model = SignalModel([[1.0]], [[1.0]])
    assert made.problem(model, np.array([2.0]), 3).weight == 4 * 8
    with pytest.raises(InputError, match="epsilon must not rise"):
        controller(epsilon=lambda k: 1.0 + k).problem(model, np.array([2.0]), 3)


# Scheme


@pytest.mark.parametrize("basis", [None, Polynomials(2), Terms(("y1*y2",))])
def test_sizes_are_read_off_the_initial_model(basis):
    lifting = DelayLifting(2, 3, basis)
    n = lifting.size(2)
    made = scheme(lifting=lifting, initial_model=SignalModel(np.eye(n), np.ones((n, 6))))
    assert (made.p, made.q) == (2, 2)


def test_frozen():
    with pytest.raises(FrozenInstanceError):
        scheme().mixing = ConstantMixing(0.5)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"lifting": 2}, "lifting must be a DelayLifting, got 2"),
        ({"estimator": "squares"}, "estimator must be a ProximalEstimator or a GrowingMemory, got 'squares'"),
        ({"controller": None}, "controller must be a Controller, got None"),
        ({"initial_model": np.eye(2)}, r"initial_model must be a SignalModel, got array\("),
        (
            {"mixing": LambdaSearch},
            "or an object with a function choose, got <class 'rhl.controllability.LambdaSearch'>",
        ),
        (
            {"mixing": 0.5},
            "mixing must be a ConstantMixing, a LambdaSearch, or an object with a function choose, got 0.5",
        ),
        (
            {"estimator": ProximalEstimator(4, constraints=LinearConstraints.entries(np.eye(2), np.full((2, 2), NAN)))},
            r"the initial model must satisfy the equalities \(M theta = b\), got a violation of 1; start from con",
        ),
        (
            {"estimator": ProximalEstimator(4, constraints=LinearConstraints.entries([[NAN]], [[1.0]]))},
            "the constraints must have columns for the 8 parameters of the initial model, got 2 columns",
        ),
        (
            {"estimator": ProximalEstimator(4, generator=Entropy())},
            "the initial model must lie in the domain of Entropy, entries above 0, got 0",
        ),
        (
            {"lifting": DelayLifting(2, 2, Polynomials(2))},
            "an order that is a multiple of outputs = 2 plus the number of basis functions, got 2",
        ),
        ({"lifting": DelayLifting(2, 3)}, "input size must be a multiple of inputs = 3, which u stacks, got 2"),
        ({"controller": controller(Q=np.eye(2))}, r"Q must be a number or a matrix of shape \(3, 3\)"),
        ({"controller": controller(QN=-np.eye(3))}, "QN must be positive definite"),
        ({"controller": controller(R=[[1.0, 0.0], [0.0, 1.0]])}, r"R must be a number or a matrix of shape \(1, 1\)"),
    ],
)
def test_scheme_refused(changes, sentence):
    with pytest.raises(InputError, match=sentence):
        scheme(**changes)


def test_positive_models_are_in_the_domain():
    model = SignalModel(np.full((2, 2), 0.1), np.ones((2, 2)))
    made = scheme(estimator=ProximalEstimator(4, generator=Entropy()), initial_model=model)
    assert made.p == 1


def test_known_models_are_accepted():
    known = LinearConstraints.shift(1, 2, 1, 2)
    model = known.nearest(SignalModel(np.full((2, 2), 0.1), np.ones((2, 2))))
    assert scheme(estimator=ProximalEstimator(4, constraints=known), initial_model=model).p == 1


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"horizon": 1.5}, "horizon must be an integer of at least 1, got 1.5"),
        ({"alpha": -1.0}, "alpha must be a positive finite number, got -1.0"),
        ({"model_delay": True}, "model_delay must be 0 or 1, got True"),
        ({"epsilon": 0.5}, "epsilon must be a function of k, got 0.5"),
        ({"adaptive": 1}, "adaptive must be True or False, got 1"),
        ({"adaptive": None}, "adaptive must be True or False, got None"),
    ],
)
def test_controller_refused(changes, sentence):
    with pytest.raises(InputError, match=sentence):
        controller(**changes)


# Mixing of the user's own


class Own:
    """Mixes by what a function of the two models returns."""

    def __init__(self, rule):
        self.rule = rule

    def choose(self, estimate, previous, augment):
        assert augment(estimate).n == 3
        return self.rule(estimate, previous)


PLANT = LinearPlant([[0.8, 0.3], [0.1, 0.9]], [[0.5], [1.0]], [[1.0, 0.5]])


def test_own_mixing_runs():
    run = [simulate(scheme(mixing=by), PLANT, [1.0, 1.0], 12).v for by in (Own(lambda *_: 0.25), ConstantMixing(0.25))]
    np.testing.assert_allclose(*run, rtol=1e-9, atol=1e-12)
    searched = scheme(mixing=Own(lambda *models: LambdaSearch("lifted").choose(*models, None)))
    assert np.array_equal(replace(searched, controller=controller()).mixing.choose(MODEL, MODEL, AUGMENT), 0)
    # A rule that looks at the models: how far the estimate has moved.
    far = Own(lambda a, b: 0.9 * np.minimum(1, np.linalg.norm(a.A - b.A, axis=(-1, -2))))
    trace = simulate(scheme(mixing=far), PLANT, np.ones((3, 2)), 12, record="models")
    assert trace.lam.shape == (12, 3)
    assert 0 < np.max(trace.lam) <= 0.9


MODEL = SignalModel.companion_of_ones(2, 2, "eye-last-row-of-ones")
AUGMENT = DelayLifting(2, 2).augment


@pytest.mark.parametrize(
    ("found", "sentence"),
    [
        (1.0, r"^Own.choose must return a lambda in \[0, 1\) for each member of the batch, shape \(1,\), got 1$"),
        (-0.1, r"in \[0, 1\) for .* got -0.1$"),
        (NAN, r"in \[0, 1\) for .* got nan$"),
        ([0.1, 0.2, 0.3], r"shape \(1,\), got shape \(3,\)$"),
        ("half", "got 'half'$"),
        (None, "got None$"),
        (0.5j, "got 0.5j$"),
    ],
)
def test_own_mixing_refused(found, sentence):
    with pytest.raises(InputError, match=sentence):
        simulate(scheme(mixing=Own(lambda *_: found)), PLANT, [1.0, 1.0], 3)


def test_what_an_own_mixing_raises_comes_through():
    def fails(*_):
        raise KeyError("mine")

    with pytest.raises(KeyError, match="mine") as caught:
        simulate(scheme(mixing=Own(fails)), PLANT, [1.0, 1.0], 3)
    assert caught.value.__notes__ == ["the function 'choose' of Own raised this"]


# The default


@pytest.mark.parametrize(("p", "q", "order"), [(1, 1, 1), (1, 1, 3), (2, 3, 2), (2, 3, 6)])
def test_default_is_what_it_says(p, q, order):
    made = window_scheme(p, q, order)
    n = p * order
    assert (made.p, made.q) == (p, q)
    assert (made.lifting.outputs, made.lifting.inputs, made.lifting.basis) == (order, order, None)
    assert made.estimator.window == 2 * order
    assert made.estimator.constraints is None
    assert (made.estimator.loss.weight, made.estimator.generator.weight) == (1.0, 0.01)
    assert made.controller.horizon == max(30, 2 * (n + (order - 1) * q))
    assert made.controller.epsilon(1) == pytest.approx(1 / 11)
    assert made.mixing == ConstantMixing(0.0)
    assert np.array_equal(made.initial_model.A[-1], np.ones(n))


def test_default_scheme_is_another_where_noise_is_expected():
    exact, zero, noisy = (default_scheme(2, 1, 3, noise=std) for std in (0.0, [0.0, 0.0], [0.0, 0.1]))
    assert (exact.controller.R, exact.units.caution) == (zero.controller.R, zero.units.caution) == (0.03, 100.0)
    assert (noisy.controller.R, noisy.units.caution) == (1.0, 0.0)
    assert (exact.units.past, noisy.units.past) == (0.03, 0.3)
    for made in (exact, noisy):
        assert (made.controller.Q, made.controller.QN) == (1.0, 1.0)
        assert made.controller.epsilon(9) == pytest.approx(1e-2)


@pytest.mark.parametrize(
    ("p", "q", "order", "set_point", "horizon"),
    [(1, 1, 2, None, 30), (2, 1, 3, None, 30), (2, 2, 5, None, 36), (2, 2, 5, SetPoint(1.0), 100), (9, 9, 3, None, 90)],
)
def test_the_default_horizon_is_twice_the_augmented_state_s_size(p, q, order, set_point, horizon):
    assert default_scheme(p, q, order, set_point=set_point).controller.horizon == horizon


def test_default_brings_an_unstable_plant_to_rest():
    plant = LinearPlant([[1.2, 1.0], [0.0, 0.9]], [[0.0], [1.0]], [[1.0, 0.0]])
    last = list(islice(closed_loop(window_scheme(1, 1, 2), plant, [1.0, -1.0]), 50))[-1]
    assert np.linalg.norm(last.z) < 1e-3
    assert np.linalg.norm(np.linalg.matrix_power(plant.F, 50) @ [1.0, -1.0]) > 1e3


@pytest.mark.parametrize("estimator", [ProximalEstimator(4, LogCosh(0.1)), ProximalEstimator(4, generator=Entropy())])
def test_other_estimators_close_the_loop_too(estimator):
    plant = LinearPlant([[0.8, 0.3], [0.1, 0.9]], [[0.5], [1.0]], [[1.0, 0.5]])
    model = SignalModel(np.full((2, 2), 0.3), np.ones((2, 2)))
    made = scheme(estimator=estimator, initial_model=model)
    steps = list(islice(closed_loop(made, plant, [1.0, 1.0]), 25))
    assert np.linalg.norm(steps[-1].z) < 1e-1 * np.linalg.norm(steps[0].z)
    assert all(np.all(done.model.theta > estimator.generator.lower) for done in steps)


@pytest.mark.parametrize("sizes", [(0, 1, 1), (1, -1, 1), (1, 1, 1.5), (1, 1, True)])
def test_default_refused(sizes):
    with pytest.raises(InputError, match=r"(p|q|order) must be an integer of at least 1, got"):
        window_scheme(*sizes)


@pytest.mark.parametrize("make", [default_scheme, window_scheme])
@pytest.mark.parametrize("sizes", [(10**6, 1, 1), (10**5, 10**5, 10**5), (1, 2**40, 1), (1, 1, 2501)])
def test_sizes_that_no_memory_holds(make, sizes):
    p, q, order = sizes
    with pytest.raises(InputError) as caught:
        make(p, q, order)
    assert str(caught.value) == (
        f"p, q and order must stack at most 5000 outputs and inputs, got {(p + q) * order}; give smaller ones"
    )
    assert make(1, 1, 40).initial_model.n == 40
