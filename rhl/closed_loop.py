"""The overall scheme (figure 1): lift, estimate, mix, augment, solve, apply the first input, repeat."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from rhl._checks import Array, InputError, NotFiniteError, integer, positive, read_only, real_array, weight_matrix
from rhl.controllability import ConstantMixing, LambdaSearch, Mixing, margin
from rhl.estimator import ProximalEstimator
from rhl.horizon import V1, Plan, solve
from rhl.lifting import DelayLifting, remember
from rhl.model import SignalModel
from rhl.plants import Plant


class DivergedError(ArithmeticError):
    """The closed loop left the range of float64.

    Attributes
    ----------
    k : int
        The step at which it did.
    what : str
        Which number.
    steps : tuple of Step
        The steps before, where ``simulate`` collected them.
    """

    def __init__(self, k: int, what: str, steps: tuple[Step, ...] = ()) -> None:
        super().__init__(f"the run left the range of floating-point numbers at k = {k}: {what}")
        self.k = k
        self.what = what
        self.steps = steps


@dataclass(frozen=True)
class HarmonicDecay:
    r"""The schedule :math:`\epsilon(k) = 1 / (1 + \eta k)` of Section VI.

    Parameters
    ----------
    rate : float
        :math:`\eta`, positive. The text has 1000 (linear) and 10 (robot arm); the linear data were made with 100.

    Raises
    ------
    InputError
        If the rate is not positive; epsilon has to tend to zero (Theorem 1).
    """

    rate: float

    def __post_init__(self) -> None:
        positive("rate", self.rate)

    def __call__(self, k: int) -> float:
        """Return epsilon(k)."""
        return 1.0 / (1.0 + self.rate * k)


@dataclass(frozen=True, eq=False)
class Controller:
    r"""What V1 is set up with at every step, Assumption 3 and Theorem 1.

    Parameters
    ----------
    Q, QN : float or array_like, shape (n', n')
        Stage and terminal weight on the augmented state; a number is that times the identity.
    R : float or array_like, shape (q, q)
        Input weight.
    horizon : int
        N, at least 1. The theory asks for N at least n'.
    epsilon : callable
        k -> epsilon(k) > 0.
    alpha : float
        :math:`\Gamma(x) = \alpha x^\top x`, positive (Theorem 1).
    model_delay : {0, 1}
        0: use the estimate of this step, theta~(k). 1: use that of the step before, theta~(k-1), as the published data
        do.

    Raises
    ------
    InputError
        If a number is out of range.
    """

    Q: Array | float
    R: Array | float
    QN: Array | float
    horizon: int
    epsilon: Callable[[int], float]
    alpha: float = 1.0
    model_delay: int = 0

    def __post_init__(self) -> None:
        integer("horizon", self.horizon, 1)
        positive("alpha", self.alpha)
        if isinstance(self.model_delay, bool) or self.model_delay not in (0, 1):
            raise InputError(f"model_delay must be 0 or 1, got {self.model_delay!r}")
        if not callable(self.epsilon):
            raise InputError(f"epsilon must be a function of k, got {self.epsilon!r}")

    def problem(self, model: SignalModel, x: Array, k: int) -> V1:
        """Set up V1 for the augmented model and state, equation (3)."""
        epsilon = self.epsilon(k)
        if not epsilon > 0:
            raise InputError(f"epsilon must be positive at every k, got {epsilon} at k = {k}")
        weight = self.alpha * np.sum(x**2, axis=-1) / epsilon
        return V1(model, self.Q, self.R, self.QN, weight, self.horizon)


@dataclass(frozen=True, eq=False)
class Scheme:
    """Receding horizon learning: everything that is chosen before the loop is closed.

    Parameters
    ----------
    lifting : DelayLifting
        How x and u are made of y and v.
    estimator : ProximalEstimator
        Equation (15).
    controller : Controller
        Equation (3).
    initial_model : SignalModel
        theta~(0), lifted; controllable (Theorem 2(iii)).
    mixing : ConstantMixing or LambdaSearch
        How lambda_k is chosen.

    Raises
    ------
    InputError
        If sizes do not fit each other, or the mixing is a search and the initial model is not controllable.
    """

    lifting: DelayLifting
    estimator: ProximalEstimator
    controller: Controller
    initial_model: SignalModel
    mixing: Mixing = field(default_factory=ConstantMixing)

    def __post_init__(self) -> None:
        augmented = self.lifting.augment(self.initial_model)
        if self.initial_model.n % self.lifting.outputs:
            raise InputError(
                f"the initial model's A must have an order that is a multiple of outputs = {self.lifting.outputs}, "
                f"got {self.initial_model.n}"
            )
        weight_matrix("Q", self.controller.Q, augmented.n)
        weight_matrix("R", self.controller.R, augmented.q)
        weight_matrix("QN", self.controller.QN, augmented.n)
        if isinstance(self.mixing, LambdaSearch):
            model = augmented if self.mixing.pair == "augmented" else self.initial_model
            least = np.min(margin(model))
            if not least >= self.mixing.least_margin:
                raise InputError(
                    "the initial model must be controllable for a lambda-search: "
                    f"its {self.mixing.pair} pair must have a margin of at least {self.mixing.least_margin:g}, "
                    f"got {least:.3g}"
                )

    @property
    def p(self) -> int:
        """Size of the output y."""
        return self.initial_model.n // self.lifting.outputs

    @property
    def q(self) -> int:
        """Size of the input v."""
        return self.initial_model.q // self.lifting.inputs


@dataclass(frozen=True, eq=False)
class Memory:
    """What the scheme carries from one step to the next.

    Attributes
    ----------
    k : int
        The step about to be taken.
    y : array, shape (..., T, p)
        y(k-1), y(k-2), ...; zero before k = 0.
    v : array, shape (..., T, q)
        v(k-1), v(k-2), ...; zero before k = 0.
    model : SignalModel
        theta~(k-1).
    y_hat : array, shape (..., p), or None
        The prediction of y(k) made at k-1.
    """

    k: int
    y: Array
    v: Array
    model: SignalModel
    y_hat: Array | None = None

    def __post_init__(self) -> None:
        _freeze(self, "y", "v", "y_hat")


@dataclass(frozen=True, eq=False)
class Step:
    """Everything that happened at one k.

    Attributes
    ----------
    k : int
        The step.
    y : array, shape (..., p)
        Output measured.
    v : array, shape (..., q)
        Input computed.
    y_hat : array, shape (..., p)
        Prediction of y(k) made at k-1; y(0) at k = 0.
    estimate : SignalModel
        theta*(k), the minimiser of equation (15).
    model : SignalModel
        theta~(k), after mixing.
    lam : array, shape (...)
        lambda_k.
    problem : V1
        What was solved at k.
    plan : Plan
        Its solution; ``plan.x[..., 0, :]`` is the augmented state X(k).
    memory : Memory
        What the step started from, y(k) included.
    z : array, shape (..., n), or None
        The plant's state z(k), where there is a plant.
    """

    k: int
    y: Array
    v: Array
    y_hat: Array
    estimate: SignalModel
    model: SignalModel
    lam: Array
    problem: V1
    plan: Plan
    memory: Memory
    z: Array | None = None

    def __post_init__(self) -> None:
        _freeze(self, "y", "v", "y_hat", "lam", "z")


def _freeze(record: Memory | Step, *names: str) -> None:
    for name in names:
        if getattr(record, name) is not None:
            object.__setattr__(record, name, read_only(getattr(record, name)))


def start(scheme: Scheme) -> Memory:
    """Return the memory before k = 0: all signals zero, the initial model."""
    depth = scheme.estimator.window + 1 + max(scheme.lifting.outputs, scheme.lifting.inputs)
    return Memory(0, np.zeros((depth, scheme.p)), np.zeros((depth, scheme.q)), scheme.initial_model)


def step(scheme: Scheme, memory: Memory, y: ArrayLike) -> Step:
    """Take one step of the scheme: from y(k) to v(k).

    Parameters
    ----------
    scheme : Scheme
        What was chosen beforehand.
    memory : Memory
        What the step before left, from ``start`` or ``advance``.
    y : array_like, shape (..., p)
        The output measured at k.

    Returns
    -------
    Step

    Raises
    ------
    DivergedError
        If a number leaves the range of float64.
    LostControllability
        If the lambda-search finds no candidate.
    """
    y = real_array("y", y, (scheme.p,))
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            return _step(scheme, memory, y)
    except (NotFiniteError, np.linalg.LinAlgError) as error:
        raise DivergedError(memory.k, str(error)) from error


def _step(scheme: Scheme, memory: Memory, y: Array) -> Step:
    lifting, estimator, controller = scheme.lifting, scheme.estimator, scheme.controller
    lead = np.broadcast_shapes(y.shape[:-1], memory.y.shape[:-2], memory.v.shape[:-2])
    y_history = remember(
        np.broadcast_to(memory.y, (*lead, *memory.y.shape[-2:])), np.broadcast_to(y, (*lead, scheme.p))
    )
    v_history = np.broadcast_to(memory.v, (*lead, *memory.v.shape[-2:]))
    x = lifting.window(y_history, lifting.outputs, estimator.window + 1)
    u = lifting.window(v_history, lifting.inputs, estimator.window)
    estimate = estimator.minimise(memory.model, x, u)
    lam = scheme.mixing.choose(estimate, memory.model, lifting.augment)
    model = estimate.mix(memory.model, lam)
    used = memory.model if controller.model_delay else model
    state = lifting.augmented_state(y_history, v_history)
    problem = controller.problem(lifting.augment(used), state, memory.k)
    plan = solve(problem, state)
    v = real_array("v", plan.u[..., 0, :])
    y_hat = y if memory.y_hat is None else memory.y_hat
    seen = Memory(memory.k, y_history, v_history, memory.model, memory.y_hat)
    return Step(memory.k, y, v, y_hat, estimate, model, lam, problem, plan, seen)


def advance(scheme: Scheme, done: Step, v: ArrayLike | None = None) -> Memory:
    """Return the memory for k+1, given the input that was really applied at k.

    Parameters
    ----------
    scheme : Scheme
        What was chosen beforehand.
    done : Step
        The step at k.
    v : array_like, shape (..., q), optional
        The input applied; the computed one where omitted.

    Returns
    -------
    Memory
    """
    applied = done.v if v is None else real_array("v", v, (scheme.q,))
    v_history = remember(done.memory.v, np.broadcast_to(applied, (*done.memory.v.shape[:-2], scheme.q)))
    lifting = scheme.lifting
    x = lifting.window(done.memory.y, lifting.outputs, 1)[..., 0, :]
    u = lifting.window(v_history, lifting.inputs, 1)[..., 0, :]
    with np.errstate(over="ignore", invalid="ignore"):
        predicted = np.einsum("...ab,...b->...a", done.model.A, x) + np.einsum("...ab,...b->...a", done.model.B, u)
    return Memory(done.k + 1, done.memory.y, v_history, done.model, predicted[..., : scheme.p])


def closed_loop(scheme: Scheme, plant: Plant, z0: ArrayLike) -> Iterator[Step]:
    """Run the scheme on a plant for as long as the caller asks for steps.

    Parameters
    ----------
    scheme : Scheme
        What was chosen beforehand.
    plant : Plant
        Unknown to the scheme but for the sizes of y and v.
    z0 : array_like, shape (..., n)
        Initial state z(0); leading axes run that many loops at once.

    Yields
    ------
    Step
        One for each k = 0, 1, ...

    Raises
    ------
    InputError
        If z0 does not fit the plant, or the plant's sizes do not fit the scheme.
    DivergedError
        If a number leaves the range of float64.
    """
    z = real_array("z0", z0, (plant.n,))
    for name, found, wanted in (("outputs", plant.p, scheme.p), ("inputs", plant.q, scheme.q)):
        if found != wanted:
            raise InputError(f"the plant must have {wanted} {name}, for which the initial model is made, got {found}")
    # One step without input shows the batch axes that the plant itself brings.
    with np.errstate(over="ignore", invalid="ignore"):
        z = np.broadcast_to(z, np.shape(plant.step(z, np.zeros(plant.q))))
    return _run(scheme, plant, z)


def _run(scheme: Scheme, plant: Plant, z: Array) -> Iterator[Step]:
    memory = start(scheme)
    while True:
        y = np.asarray(plant.output(z), dtype=np.float64)
        if not np.all(np.isfinite(y)):
            raise DivergedError(memory.k, "the plant's output is no longer finite")
        done = step(scheme, memory, y)
        yield Step(**{**vars(done), "z": z})
        with np.errstate(over="ignore", invalid="ignore"):
            z = np.asarray(plant.step(z, done.v), dtype=np.float64)
        if not np.all(np.isfinite(z)):
            raise DivergedError(done.k + 1, "the plant's state is no longer finite")
        memory = advance(scheme, done)


def replay(scheme: Scheme, y: ArrayLike, v: ArrayLike) -> Iterator[Step]:
    """Feed recorded outputs and inputs to the scheme; each step tells what it would have done.

    Parameters
    ----------
    scheme : Scheme
        What was chosen beforehand.
    y : array_like, shape (steps, p)
        Recorded outputs y(0), y(1), ...
    v : array_like, shape (steps, q)
        Recorded inputs, which are taken as applied, whatever the scheme computes.

    Yields
    ------
    Step
        ``v`` is what the scheme computes from the record up to k.
    """
    y, v = real_array("y", y, (None, scheme.p)), real_array("v", v, (None, scheme.q))
    if len(y) != len(v):
        raise InputError(f"y and v must have as many rows as each other, got {len(y)} and {len(v)}")
    memory = start(scheme)
    for output, applied in zip(y, v, strict=True):
        done = step(scheme, memory, output)
        yield done
        memory = advance(scheme, done, applied)
