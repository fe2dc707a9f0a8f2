"""Bad input through the API: the exact type, one sentence that names, expects, tells what was found; and fuzzing."""

import warnings

import control
import numpy as np
import pandas as pd
import pytest

from rhl import plotting
from rhl.app._templates import template
from rhl.app.config import load, parse
from rhl.app.diagnosis import Finding, diagnose, diagnose_run
from rhl.basis import Features, Polynomials, Terms
from rhl.closed_loop import advance, replay, start, step
from rhl.constraints import LinearConstraints
from rhl.controllability import ConstantMixing, LambdaSearch, candidates, controllability_margin
from rhl.controller import Controller
from rhl.disturbances import GaussianNoise, Outliers, Saturation, through
from rhl.errors import AssumptionWarning, DivergedError, InputError, NotFiniteError, PlantError
from rhl.estimator import ProximalEstimator
from rhl.horizon import condensed_hessian, solve
from rhl.lifting import DelayLifting
from rhl.losses import CustomLoss, Entropy, LogCosh, PseudoHuber, Varying, WeightedSquares, divergence
from rhl.model import PredictorMaps, SignalModel
from rhl.paper import figures
from rhl.paper.published import compare_linear, compare_robot, curve, robot_arm
from rhl.plants import FunctionPlant, LinearPlant, RobotArm
from rhl.plants._realisation import observable_basis
from rhl.plants.analysis import detectability, linearise, observable_part, rough_model, stabilizability
from rhl.plants.cart_pendulum import CartPendulum
from rhl.plants.examples import example, flexible_shaft, quadruple_tank
from rhl.problems import V1, V2, V3
from rhl.schedules import Constant, ExponentialDecay, PowerDecay, epsilon_at
from rhl.scheme import Scheme, window_scheme
from rhl.simulation import simulate
from rhl.trace import Trace
from tests.bad_input import faults, listing, refusal

ONE = SignalModel([[1.0]], [[1.0]])
PLANT = LinearPlant([[0.5]], [[1.0]], [[1.0]])
LIFTING, ESTIMATOR = DelayLifting(1, 1), ProximalEstimator(2)
MAPS = ONE.predictor(2)
KNOWN = LinearConstraints([[1.0, 0.0]], [1.0])
PROBLEM = V1(ONE, 1.0, 1.0, 1.0, 1.0, 2)


def controller(**changed):
    return Controller(**{"Q": 1.0, "R": 1.0, "QN": 1.0, "horizon": 3, "epsilon": PowerDecay(1), **changed})


def scheme(**changed):
    parts = {"lifting": LIFTING, "estimator": ESTIMATOR, "controller": controller(), "initial_model": ONE}
    return Scheme(**{**parts, **changed})


SCHEME = scheme()
TRACE = simulate(SCHEME, PLANT, [1.0], 3)
STEP = TRACE.steps[0]
DEAD = SignalModel([[1.0]], [[0.0]])
ROBOT = robot_arm().scheme


def fails(*_):
    raise ValueError("first line\nsecond line")


def leaves(*_):
    raise SystemExit(3)


def interrupts(*_):
    raise KeyboardInterrupt


def deep(*arguments):
    return deep(*arguments)


def writes(z, v):
    z[0] = 1.0
    return z


def plant(f=lambda z, v: z, g=lambda z: z[:1], n=2, q=1):
    return FunctionPlant(f, g, n, q)


def run(plant=PLANT, z0=(1.0,), steps=2, **more):
    return simulate(SCHEME, plant, z0, steps, **more)


def from_tf(num, den, dt=True):
    return lambda: LinearPlant.from_control(control.TransferFunction(num, den, dt))


def own(value=lambda x: x @ x, gradient=lambda x: 2 * x, **more):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AssumptionWarning)
        estimator = ProximalEstimator(2, CustomLoss(value, gradient, **more))
    return estimator.minimise(ONE, np.ones((3, 1)), np.ones((2, 1)))


def masked():
    return np.ma.masked_array([[1.0]], [[True]])


# What, the call, the regular expression that the message must match, and what it must say to do (or None).
API = [
    # model
    ("A not square", lambda: SignalModel([[1.0, 2.0]], [[1.0]]), r"^A must be square, got shape \(1, 2\)", None),
    (
        "A ragged",
        lambda: SignalModel([[1.0], [1.0, 2.0]], [[1.0]]),
        r"^A must be a rectangular array .*got \[\[1",
        None,
    ),
    ("A empty", lambda: SignalModel([[]], [[1.0]]), r"^A must have shape .*got \(1, 0\)", None),
    ("A complex", lambda: SignalModel([[1j]], [[1.0]]), r"^A must hold real numbers, got complex", None),
    ("A bool", lambda: SignalModel([[True]], [[1.0]]), r"^A must hold real numbers, got \[\[True\]\]", None),
    ("A objects", lambda: SignalModel([[None]], [[1.0]]), r"^A must hold real numbers, got \[\[None\]\]", None),
    ("A dates", lambda: SignalModel(np.array([["2020"]], dtype="M8[Y]"), [[1.0]]), r"^A must hold real numbers", None),
    ("A masked", lambda: SignalModel(masked(), [[1.0]]), r"^A must hold a number in every entry, got mask", "fill"),
    (
        "A beyond float64",
        lambda: SignalModel([[np.longdouble("1e4000")]], [[1.0]]),
        r"^A must be finite, got inf",
        None,
    ),
    ("B frame of text", lambda: SignalModel([[1.0]], pd.DataFrame([["a"]])), r"^B must hold real numbers, got", None),
    ("B nullable", lambda: SignalModel([[1.0]], pd.DataFrame([[pd.NA]])), r"^B must hold real numbers, got", None),
    ("B rows", lambda: SignalModel(np.eye(2), [[1.0]]), r"^B must have shape \(2, at least 1\), got \(1, 1\)", None),
    ("theta", lambda: SignalModel.from_theta([1.0], 1, 1), r"^theta must have shape \(2,\), got \(1,\)", None),
    ("theta of no order", lambda: SignalModel.from_theta([1.0], 0, 1), r"^n must be an integer .*got 0", None),
    ("initial B's name", lambda: SignalModel.companion_of_ones(1, 1, np.eye(2)), r"^inputs must be one of", None),
    ("mix with a matrix", lambda: ONE.mix([[1.0]], 0.5), r"^other must be a SignalModel, got", None),
    ("lam above 1", lambda: ONE.mix(ONE, 1.5), r"^lam must be in \[0, 1\], got 1.5", None),
    ("A[0]", lambda: PredictorMaps([[[2.0]], [[1.0]]], [[[1.0]]]), r"^A\[0\] must be the identity .*got another", None),
    # plants
    ("H columns", lambda: LinearPlant(np.eye(2), np.eye(2), [[1.0]]), r"^H must have shape .*got \(1, 1\)", None),
    ("z of another length", lambda: PLANT.step([1.0, 2.0], [1.0]), r"^z must have shape .*got \(2,\)", None),
    ("v text", lambda: PLANT.step([1.0], ["a"]), r"^v must hold real numbers, got \['a'\]", None),
    ("a list too long for the arm", lambda: RobotArm().step([1.0], [1.0]), r"^z must have shape \(..., 3\)", None),
    ("arm's variant", lambda: RobotArm("new"), r"^variant must be one of data, printed, got 'new'", None),
    ("arm's h", lambda: RobotArm("data", -1.0), r"^h must be a positive finite number, got -1.0", None),
    ("no system", lambda: LinearPlant.from_control(3), r"^system must be a control.StateSpace .*got int", "use"),
    ("continuous time", from_tf([1.0], [1.0, 1.0], 0), r"^system must be in discrete time .*got dt=0", "give the"),
    ("not strictly proper", from_tf([1.0, 1.0], [1.0, 1.0]), r"^system must be strictly proper .*degree 1", "delay it"),
    ("zero system", from_tf([0.0], [1.0, 1.0]), r"^system must respond to an input, got", "check its"),
    ("quotients beyond float64", from_tf([1e300], [1e-300, 1.0]), r"^system must have coefficients .*got", "scale"),
    (
        "feedthrough",
        lambda: LinearPlant.from_control(control.ss([[1.0]], [[1.0]], [[1.0]], [[1.0]], True)),
        r"^system must have D = 0 .*got a feedthrough",
        "put one step",
    ),
    ("F of many outputs", lambda: observable_basis(np.ones((2, 2, 2)), np.eye(2)), r"^F and H must be single", "take"),
    ("no function", lambda: plant(3), r"^transition must be a function transition\(z, v\), got 3", None),
    ("n zero", lambda: plant(n=0), r"^n must be an integer of at least 1, got 0", None),
    ("q text", lambda: plant(q="1"), r"^q must be an integer of at least 1, got '1'", None),
    ("length 0.5", lambda: CartPendulum(length=0), r"^length must be a positive finite number, got 0", None),
    ("friction NaN", lambda: CartPendulum(friction=np.nan), r"^friction must be finite, got nan", None),
    ("no example", lambda: example("x" * 999), r"^name must be one of cart-pendulum.*got 'xxx.*\.\.\.$", None),
    ("valves", lambda: quadruple_tank("open"), r"^valves must be one of minimum-phase, .*got 'open'", None),
    ("h of 1e308", lambda: flexible_shaft(1.7e308), r"^h must be a sampling time .*got 1.7e\+308", "shorten it"),
    # structure
    ("linearise a number", lambda: linearise(3), r"^plant must be a plant .*got 3 without n", None),
    (
        "no equilibrium",
        lambda: linearise(plant(lambda z, v: z + 1)),
        r"^z = 0 with v = 0 must be an equilibrium.*got",
        "solve",
    ),
    ("rough by a function", lambda: rough_model(plant(), 1, 1), r"^plant must be a LinearPlant, got Func", "pass rhl"),
    (
        "rough too short",
        lambda: rough_model(LinearPlant(np.eye(2, k=1), np.eye(2), [[1.0, 0.0]]), 1, 1),
        r"^outputs must be at least 2, the observability index.*got 1",
        "stack 2",
    ),
    (
        "rough beyond float64",
        lambda: rough_model(LinearPlant([[1e300, 1], [1, 1e300]], np.eye(2), [[1.0, 1.0]]), 3, 3),
        r"^plant must have powers of F up to 3 .*got",
        "stack less",
    ),
    (
        "blind plant",
        lambda: observable_part(LinearPlant([[1.0]], [[1.0]], [[0.0]])),
        r"^the plant's H must not",
        "choo",
    ),
    (
        "a batch to stabilizability",
        lambda: stabilizability(np.ones((2, 2, 2)), np.eye(2)),
        r"^F must be a single",
        "tak",
    ),
    ("detectability of text", lambda: detectability([["a"]], [[1.0]]), r"^F must hold real numbers", None),
    # basis and lifting
    ("degree 1", lambda: Polynomials(1), r"^degree must be an integer of at least 2, got 1", None),
    (
        "too many monomials",
        lambda: DelayLifting(9, 1, Polynomials(9)).size(3),
        r"^the polynomials must be 1 to",
        "choose",
    ),
    ("an input in a term", lambda: Terms(("v1",)), r"^'v1' must use outputs only .*got the input v1", "inputs are"),
    ("a term that is 1 at zero", lambda: Terms(("cos(y1)",)), r"^'cos\(y1\)' must be zero where .*got", "multiply"),
    ("an expression", lambda: Terms(("__import__('os')",)), r"must be a product of outputs .*got the factor", None),
    ("terms as text", lambda: Terms("y1"), r"^texts must be one or more products .*got 'y1'", None),
    (
        "a term's delay",
        lambda: DelayLifting(1, 1, Terms(("y1(k-3)",))).size(1),
        r"must use outputs .*got y1\(k-3\)",
        None,
    ),
    (
        "feature of NaN",
        lambda: DelayLifting(1, 1, Features(lambda w: [np.nan], 1)).size(1),
        r"^function must.*got NaN",
        None,
    ),
    (
        "feature not zero",
        lambda: DelayLifting(1, 1, Features(lambda w: [1.0], 1)).size(1),
        r"^function must be zero",
        "sub",
    ),
    (
        "feature of k",
        lambda: Features(lambda w, k: w, 1),
        r"^function must take the stacked outputs .*got one",
        "inputs",
    ),
    ("no outputs", lambda: DelayLifting(0, 1), r"^outputs must be an integer of at least 1, got 0", None),
    ("no basis", lambda: DelayLifting(1, 1, "y1"), r"^basis must be Polynomials, .*got 'y1'", None),
    ("negative window", lambda: LIFTING.window(np.ones((3, 1)), 1, 1, -1), r"^start must be an integer .*got -1", None),
    (
        "window beyond the past",
        lambda: LIFTING.window(np.ones((3, 1)), 2, 3),
        r"^history must have at least 4 .*got 3",
        None,
    ),
    ("augment a matrix", lambda: LIFTING.augment(np.eye(2)), r"^model must be a SignalModel, got array", None),
    (
        "B that does not stack",
        lambda: DelayLifting(1, 2).augment(ONE),
        r"^the model's input size must be a mul.*got 1",
        None,
    ),
    # losses, generators
    ("scale 0", lambda: LogCosh(0.0), r"^scale must be a positive finite number, got 0.0", None),
    ("scale beyond float64", lambda: PseudoHuber(10**400), r"^scale must be a positive finite .*got 1000", None),
    ("weight -1", lambda: WeightedSquares(-1.0), r"^weight must be positive.* got -1.0", None),
    (
        "weight not symmetric",
        lambda: WeightedSquares([[1.0, 1.0], [0.0, 1.0]]),
        r"^weight must be symmetric, got",
        None,
    ),
    (
        "weight indefinite",
        lambda: WeightedSquares([[1.0, 2.0], [2.0, 1.0]]),
        r"^weight must be positive def.* -1",
        None,
    ),
    ("entropy of a matrix", lambda: Entropy(np.eye(2)), r"^weight must be positive, .*got shape \(2, 2\)", None),
    ("own without gradient", lambda: CustomLoss(fails, None), r"^gradient must be a function of x, got None", None),
    (
        "own of NaN",
        lambda: own(gradient=lambda x: x * np.nan),
        r"'gradient' must return finite .*got \[nan\]?",
        "set lower",
    ),
    ("own of another shape", lambda: own(gradient=lambda x: x[:1]), r"'gradient' must return shape .*got \(1,\)", None),
    (
        "own known wrongly",
        lambda: own(assumption_6="yes"),
        r"^assumption_6 must be True, False or None, got 'yes'",
        None,
    ),
    ("varying by a loss", lambda: Varying(LogCosh()), r"^at must be a function of k .*got LogCosh", None),
    (
        "distance of other lengths",
        lambda: divergence(WeightedSquares(), [1.0, 2.0], [1.0]),
        r"^x and y must.*2 and 1",
        None,
    ),
    (
        "distance by a number",
        lambda: divergence(3, [1.0], [1.0]),
        r"^g must be a generator .*got 3 without value",
        None,
    ),
    (
        "weights of other length",
        lambda: divergence(Entropy([1.0, 2.0]), [1.0], [1.0]),
        r"^the weights of Entropy must.*got",
        None,
    ),
    (
        "outside the domain",
        lambda: divergence(Entropy(), [1.0], [-1.0]),
        r"^x and y must lie in the domain of Ent.*got",
        None,
    ),
    # constraints, estimator
    (
        "constraints that contradict each other",
        lambda: LinearConstraints([[1.0], [1.0]], [0.0, 1.0]),
        r"^the equalities must not .*got row",
        "remove",
    ),
    (
        "constraints of 0 = 1",
        lambda: LinearConstraints([[0.0]], [1.0]),
        r"^the equalities must not contradict each other, got",
        "remove",
    ),
    (
        "M without b",
        lambda: LinearConstraints([[1.0]], []),
        r"^M and b must have shapes .*got \(1, 1\) and \(0,\)",
        "give one",
    ),
    (
        "'?' in the API",
        lambda: LinearConstraints.entries([["?"]], [[1.0]]),
        r"^A and B must hold numbers, NaN where .*'\?'",
        None,
    ),
    (
        "None as unknown",
        lambda: LinearConstraints.entries([[None]], [[1.0]]),
        r"^A and B must hold numbers, .*None",
        None,
    ),
    (
        "complex constraints",
        lambda: LinearConstraints.entries([[1j]], [[1.0]]),
        r"^A and B must hold numbers, .*1j",
        None,
    ),
    ("known infinite", lambda: LinearConstraints.entries([[np.inf]], [[1.0]]), r"^b must be finite, got inf", None),
    ("constraints & number", lambda: KNOWN & 3, r"^the right operand of & must be a LinearConstraints, got 3", None),
    (
        "constraints of another size",
        lambda: KNOWN.nearest(SignalModel(np.eye(2), np.eye(2))),
        r"^the model must have 2",
        None,
    ),
    ("window 0", lambda: ProximalEstimator(0), r"^window must be an integer of at least 1, got 0", None),
    ("window 2.0", lambda: ProximalEstimator(2.0), r"^window must be an integer of at least 1, got 2.0", None),
    (
        "loss by name",
        lambda: ProximalEstimator(2, "squares"),
        r"^loss must be a loss or gen.*got 'squares' without",
        None,
    ),
    (
        "entropy as a loss",
        lambda: ProximalEstimator(2, Entropy()),
        r"^loss must take every real residual, got Entropy",
        None,
    ),
    (
        "x too short",
        lambda: ESTIMATOR.minimise(ONE, np.ones((2, 1)), np.ones((2, 1))),
        r"^x and u must have shapes .*got",
        None,
    ),
    ("x of NaN", lambda: ESTIMATOR.minimise(ONE, [[np.nan]] * 3, np.ones((2, 1))), r"^x must be finite, got nan", None),
    (
        "no centre",
        lambda: ESTIMATOR.minimise(None, np.ones((3, 1)), np.ones((2, 1))),
        r"^centre must be a SignalModel, got",
        None,
    ),
    # mixing
    ("lambda 1", lambda: ConstantMixing(1.0), r"^lam must be a number in \[0, 1\), got 1.0", None),
    ("lambda NaN", lambda: ConstantMixing(np.nan), r"^lam must be a number in \[0, 1\), got nan", None),
    ("lambda_max 0", lambda: LambdaSearch(lambda_max=0), r"^lambda_max must be a positive finite number, got 0", None),
    ("pair an array", lambda: LambdaSearch(np.eye(2)), r"^pair must be one of lifted, augmented, got array", None),
    ("count", lambda: candidates(2, 0.5, "few"), r"^count must be one of lemma, sharp, got 'few'", None),
    ("margin of a matrix", lambda: controllability_margin(np.eye(2)), r"^model must be a SignalModel, got array", None),
    # horizon
    (
        "horizon 0",
        lambda: V1(ONE, 1.0, 1.0, 1.0, 1.0, 0),
        r"^horizon must be an integer of at least 1, got 0",
        None,
    ),
    (
        "Q not symmetric",
        lambda: V1(SignalModel(np.eye(2), np.eye(2)), [[1.0, 1.0], [0.0, 1.0]], 1.0, 1.0, 1.0, 2),
        r"^Q must be symmetric, got entries that differ",
        None,
    ),
    (
        "R zero",
        lambda: V1(ONE, 1.0, 0.0, 1.0, 1.0, 2),
        r"^R must be positive definite, got smallest eigenvalue 0",
        None,
    ),
    ("weight negative", lambda: V1(ONE, 1.0, 1.0, 1.0, -1.0, 2), r"^weight must be nonnegative, got -1.0", None),
    ("model a matrix", lambda: V2(np.eye(2), 1.0, 2), r"^model must be a SignalModel or a PredictorMaps, got", None),
    ("r of another size", lambda: V3(ONE, 1.0, 1.0, [0.0, 0.0], 2), r"^r must have shape \(1,\), got \(2,\)", None),
    ("solve a number", lambda: solve(3, [1.0]), r"^problem must be a V1 or a V2 or a V3, got 3", None),
    ("hessian of V2", lambda: condensed_hessian(V2(ONE, 1.0, 2)), r"^problem must be a V1, got V2", None),
    ("x infinite", lambda: solve(PROBLEM, [np.inf]), r"^x must be finite, got inf", None),
    ("u beyond the maps", lambda: MAPS.predict([1.0], [[1.0]]), r"^u must have shape \(2, 1\), got \(1, 1\)", None),
    # schedules, controller, scheme
    ("rate 0", lambda: PowerDecay(0), r"^rate must be a positive finite number, got 0", None),
    ("power inf", lambda: PowerDecay(1.0, np.inf), r"^power must be a positive finite number, got inf", None),
    ("factor 1", lambda: ExponentialDecay(1.0), r"^factor must be a number in \[0, 1\), got 1.0", None),
    ("constant 0", lambda: Constant(0.0), r"^value must be a positive finite number, got 0.0", None),
    ("eps negative", lambda: epsilon_at(lambda k: -1.0, 1), r"^epsilon must be positive .*got -1.0 at k = 1", None),
    ("eps rises", lambda: epsilon_at(lambda k: 1.0 + k, 1), r"^epsilon must not rise .*got 2 at k = 1 after 1", None),
    ("eps of NaN", lambda: epsilon_at(lambda k: np.nan, 0), r"^epsilon must be positive .*got nan at k = 0", None),
    ("eps a pair", lambda: epsilon_at(lambda k: [1.0, 1.0], 0), r"^epsilon must return a number at k = 0, got", None),
    ("eps a number", lambda: controller(epsilon=0.1), r"^epsilon must be a function of k, got 0.1", None),
    ("Q text", lambda: controller(Q="1"), r"^Q must hold real numbers, got '1'", None),
    ("alpha 0", lambda: controller(alpha=0), r"^alpha must be a positive finite number, got 0", None),
    ("delay 2", lambda: controller(model_delay=2), r"^model_delay must be 0 or 1, got 2", None),
    ("delay an array", lambda: controller(model_delay=np.eye(2)), r"^model_delay must be 0 or 1, got array", None),
    ("adaptive 1", lambda: controller(adaptive=1), r"^adaptive must be True or False, got 1", None),
    ("lifting None", lambda: scheme(lifting=None), r"^lifting must be a DelayLifting, got None", None),
    ("mixing a number", lambda: scheme(mixing=0.5), r"^mixing must be a ConstantMixing, a Lam.*got 0.5", None),
    (
        "Q of the scheme",
        lambda: scheme(controller=controller(Q=np.eye(2))),
        r"^Q must be a number or a m.*got shape",
        None,
    ),
    (
        "nothing to search from",
        lambda: scheme(initial_model=DEAD, mixing=LambdaSearch()),
        r"^the initial model must be controllable .*got 0",
        "choose another",
    ),
    (
        "entropy from zero",
        lambda: scheme(initial_model=DEAD, estimator=ProximalEstimator(2, generator=Entropy())),
        r"^the initial model must lie in the domain of Entropy.*got 0",
        "choose one",
    ),
    (
        "a start that is known wrong",
        lambda: scheme(
            initial_model=DEAD, estimator=ProximalEstimator(2, constraints=LinearConstraints([[0.0, 1.0]], [1.0]))
        ),
        r"^the initial model must satisfy the equalities .*got a violation of 1",
        "start",
    ),
    ("order 0", lambda: window_scheme(1, 1, 0), r"^order must be an integer of at least 1, got 0", None),
    # disturbances
    ("bounds", lambda: Saturation(1.0, -1.0), r"^low must be below high .*got low 1.0 and high -1.0", None),
    (
        "bounds of other lengths",
        lambda: Saturation([0.0, 0.0], [1.0, 1.0, 1.0]),
        r"^low must be below high .*got",
        None,
    ),
    ("noise -1", lambda: GaussianNoise(-1.0, 0), r"^std must be a number, or one for each .*got -1.0", None),
    ("seed 1.5", lambda: GaussianNoise(1.0, 1.5), r"^seed must be an integer of at least 0, got 1.5", None),
    ("rate 1", lambda: Outliers(1.0, 1.0, 0), r"^rate must be a number in \[0, 1\), got 1.0", None),
    (
        "sensor's shape",
        lambda: through("sensor", lambda k, y: [1.0, 2.0], 0, np.ones(1)),
        r"^the sensor must ret.*got",
        None,
    ),
    ("sensor a number", lambda: run(sensor=3), r"^the sensor must be a function of \(k, signal\), got 3", None),
    # closed loop, trace
    ("no scheme", lambda: start(None), r"^scheme must be a Scheme, got None", None),
    ("no state", lambda: step(SCHEME, None, [1.0]), r"^state must be a ControllerState, got None", None),
    ("y of another size", lambda: step(SCHEME, STEP.state, [1.0, 2.0]), r"^y must have shape \(1,\), got", None),
    ("no plant", lambda: run(plant=3), r"^plant must be a plant .*got 3 without n", None),
    ("z0 of another size", lambda: run(z0=[1.0, 2.0]), r"^z0 must have shape \(1,\), got \(2,\)", None),
    (
        "a plant of other sizes",
        lambda: simulate(ROBOT, PLANT, [1.0], 2),
        r"^the plant must have 3 outputs.*got 1",
        None,
    ),
    ("applied_known 1", lambda: run(applied_known=1), r"^applied_known must be True or False, got 1", None),
    ("steps 0", lambda: run(steps=0), r"^steps must be an integer of at least 1, got 0", None),
    (
        "records of other lengths",
        lambda: list(replay(SCHEME, [[1.0]], [[1.0], [1.0]])),
        r"^y and v must.*1 and 2",
        None,
    ),
    (
        "v with more axes",
        lambda: advance(SCHEME, STEP, [[1.0]]),
        r"^v must have the batch axes .*got \(1, 1\)",
        None,
    ),
    ("a trace of nothing", lambda: Trace.of_steps(SCHEME, ()), r"^a trace must have at least one step, got none", None),
    ("a trace of lists", lambda: Trace(SCHEME, [[1.0]], [[1.0]]), r"^y must be an array of float64 of shape", None),
    ("a trace of NaN", lambda: Trace(SCHEME, np.full((1, 1), np.nan), np.ones((1, 1))), r"^y must be finite", None),
    (
        "a trace of numbers",
        lambda: Trace.of_steps(SCHEME, (1, 2)),
        r"^steps must be a tuple of Step, got \(1, 2\)",
        None,
    ),
    ("plan beyond the end", lambda: TRACE.plan(3), r"^k must be below the number of steps, 3, got 3", None),
    ("csv into a folder", lambda: TRACE.to_csv("."), r"^\. must be a writable file, got: ", None),
    ("csv to None", lambda: TRACE.to_csv(None), r"^None must be a writable file, got: ", None),
    # published, diagnosis, plotting
    ("no curve", lambda: curve("linear_z"), r"^name must be one of linear_y.*got 'linear_z'", None),
    ("compare a number", lambda: compare_linear(3), r"^trace must be a Trace, got 3", None),
    ("compare another run", lambda: compare_robot(TRACE), r"^trace must be a run of 62 steps .*got 3 steps", None),
    ("diagnose a number", lambda: diagnose(3, SCHEME), r"^plant must be a plant .*got 3 without n", None),
    ("diagnose without scheme", lambda: diagnose(PLANT, None), r"^scheme must be a Scheme, got None", None),
    ("diagnose no run", lambda: diagnose_run(3), r"^trace must be a Trace, got 3", None),
    ("verdict", lambda: Finding("a", "good", "b"), r"^verdict must be one of met, .*got 'good'", None),
    (
        "reproduction of another run",
        lambda: figures.reproduction(TRACE, "linear"),
        r"^trace must be a run of 42 .*got 3",
        None,
    ),
    (
        "reproduction of what",
        lambda: figures.reproduction(TRACE, "arm"),
        r"^experiment must be one of lin.*got 'arm'",
        None,
    ),
    ("a figure of no run", lambda: plotting.run(3), r"^trace must be a Trace, got 3", None),
    (
        "figure's ending",
        lambda: plotting.save(lambda: None, "f.jpg"),
        r"^path must end in one of .svg.*got 'f.jpg'",
        None,
    ),
    # files
    ("no dictionary", lambda: parse([1]), r"^a run must be described by a dictionary of keys, got \[1\]", None),
    ("keys that are numbers", lambda: parse({1: 2}), r"^a run must be described by a dictionary .*got {1: 2}", None),
    ("one key that is a number", lambda: parse({1: 2, "name": "a"}), r"^a run must be described by a dictionary", None),
    ("no file", lambda: load("missing.toml"), r"^missing.toml must be a readable TOML file, got: No such", None),
    ("a path of None", lambda: load(None), r"^None must be a readable TOML file, got: ", None),
    ("a template without a name", lambda: template(3), r"^name must be a string of .*, .*got 3", None),
]

# Those whose type says more than InputError.
KINDS = {
    **dict.fromkeys(["A beyond float64", "friction NaN", "x of NaN", "known infinite", "x infinite"], NotFiniteError),
}

# Functions of a plant of the user's own, what is wrong with them, and what the message says.
FUNCTIONS = [
    ("shape", {"f": lambda z, v: [1.0]}, r"^transition\(z, v\) must return .*\(2,\), got shape \(1,\)", "return"),
    (
        "ragged",
        {"f": lambda z, v: [[1.0], [1.0, 2.0]]},
        r"^transition.* must return .*not a rectangular array",
        "return",
    ),
    ("NaN", {"f": lambda z, v: z * np.nan}, r"^transition\(z, v\) must be finite at z = 0.*got array\(\[nan", "shift"),
    ("complex", {"f": lambda z, v: z * 1j}, r"^transition\(z, v\) must return .*real numbers, got", "return"),
    ("None", {"f": lambda z, v: None}, r"^transition\(z, v\) must return .*got None", "return"),
    ("output of text", {"g": lambda z: "ab"}, r"^measurement\(z\) must return .*real numbers, got 'ab'", "return"),
    ("output empty", {"g": lambda z: []}, r"^measurement\(z\) must return .*got shape \(0,\)", "return"),
]


@pytest.mark.parametrize(
    ("call", "wanted", "remedy", "kind"),
    [pytest.param(call, wanted, remedy, KINDS.get(what, InputError), id=what) for what, call, wanted, remedy in API],
)
def test_refused(tmp_path, monkeypatch, call, wanted, remedy, kind):
    monkeypatch.chdir(tmp_path)
    assert faults(refusal(call, kind), wanted, remedy) == []
    assert listing(tmp_path) == {}


@pytest.mark.parametrize(
    ("functions", "wanted", "remedy"),
    [pytest.param(functions, wanted, remedy, id=what) for what, functions, wanted, remedy in FUNCTIONS],
)
def test_functions_refused(functions, wanted, remedy):
    assert faults(refusal(lambda: plant(**functions), PlantError), wanted, remedy) == []


@pytest.mark.parametrize(
    ("call", "note"),
    [
        (lambda: plant(f=fails), "rhl called transition(z, v) at z = array([0., 0.]), v = array([0.])"),
        (lambda: plant(g=fails), "rhl called measurement(z) at z = array([0., 0.])"),
        (lambda: epsilon_at(fails, 1), "rhl called epsilon at k = 1"),
        (lambda: run(sensor=fails), "rhl called the sensor at k = 0 with a signal of shape (1,)"),
        (lambda: run(actuator=(Saturation(-1.0, 1.0), fails)), "rhl called the actuator at k = 0"),
        (
            lambda: DelayLifting(1, 1, Features(fails, 1)).size(1),
            "rhl called the basis function with stacked outputs of shape (1,)",
        ),
    ],
)
def test_what_a_function_of_the_users_raises_is_let_through(call, note):
    with pytest.raises(ValueError, match="first line\nsecond line") as caught:
        call()
    assert type(caught.value) is ValueError
    assert caught.traceback[-1].name == "fails"
    (said,) = caught.value.__notes__
    assert said.startswith(note)


@pytest.mark.parametrize(
    ("function", "kind"), [(leaves, SystemExit), (deep, RecursionError), (interrupts, KeyboardInterrupt)]
)
def test_what_ends_a_program_is_let_through(function, kind):
    calls = (
        lambda: plant(f=function),
        lambda: epsilon_at(function, 1),
        lambda: through("sensor", function, 0, np.ones(1)),
        lambda: Features(function, 1).count(1, 1),
    )
    for call in calls:
        with pytest.raises(kind):
            call()


def test_a_function_that_writes_into_its_arguments_is_told_how_not_to():
    with pytest.raises(ValueError, match="read-only") as caught:
        plant(f=writes)
    assert "begin with z = z.copy()" in caught.value.__notes__[0]


def test_the_table_is_large_and_its_names_are_its_own():
    assert len(API) + len(FUNCTIONS) >= 150
    assert len({what for what, *_ in API}) == len(API)


@pytest.mark.parametrize(
    ("message", "fault"),
    [
        ("must be positive, got -1", "does not match"),
        ("alpha must be positive,\ngot -1", "not one printable line"),
        ("alpha must be positive, got \x1b[31m-1", "not one printable line"),
        ("Traceback: alpha must be positive, got -1", "a traceback"),
        ("alpha -1: that is, we got a wrong number", "does not say what is expected"),
        ("alpha must be positive", "does not say what was found"),
        ("alpha must be positive, got -1" + "0" * 999, "characters"),
        ("alpha must be positive, got -1", "does not say what to do"),
    ],
)
def test_bad_messages_are_seen(message, fault):
    assert faults("alpha must be positive, got -1; raise it", "alpha", "raise it") == []
    assert any(fault in found for found in faults(message, "^alpha|Trace", "raise it"))


def test_other_errors_and_none_are_seen():
    for call in (lambda: 3, lambda: [][0], lambda: refusal(lambda: real(np.nan), InputError)):
        with pytest.raises(AssertionError, match=r"not refused|IndexError|NotFiniteError"):
            refusal(call)


def real(value):
    return SignalModel([[value]], [[1.0]])


def test_numbers_at_the_ends_of_the_range_are_numbers():
    """Denormal and huge weights are positive definite, and solved with."""
    for value in (5e-324, 1e-300, 1e300):
        plan = solve(V1(ONE, value, value, value, 1.0, 2), [1.0])
        assert np.all(np.isfinite(plan.u))
    assert run(z0=[5e-324]).columns()["y1"][0] == 5e-324
    with pytest.raises(DivergedError, match="k = 0: weight must be finite"):
        run(z0=[1e300])


def test_frames_and_series_are_arrays():
    frame = SignalModel(pd.DataFrame([[1.0]]), pd.DataFrame([[1.0]]))
    assert np.array_equal(frame.theta, ONE.theta)
    assert len(run(z0=pd.Series([1.0]))) == 2
