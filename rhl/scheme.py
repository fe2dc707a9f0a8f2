"""The settings of the closed loop: lifting, estimator, mixing, controller; and two default schemes."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from rhl._checks import Array, describe, instance, integer, locked, weight_matrix
from rhl.controllability import ConstantMixing, LambdaSearch, Mixing, controllability_margin
from rhl.controller import Controller
from rhl.disturbances import Saturation
from rhl.errors import InputError
from rhl.estimator import ProximalEstimator
from rhl.family import ModelFamily
from rhl.horizon import factor
from rhl.lifting import DelayLifting
from rhl.losses import WeightedSquares, called
from rhl.memory import GrowingMemory
from rhl.model import SignalModel
from rhl.schedules import PowerDecay
from rhl.tracking import SetPoint
from rhl.units import RunningUnits

# The most outputs and inputs that a ready scheme stacks; its matrices then have 0.2 GB each.
_STACKED = 5_000


@dataclass(frozen=True, eq=False)
class Scheme:
    """Receding horizon learning: all settings of the closed loop.

    InputError if sizes do not fit each other, the initial model contradicts the estimator's constraints or lies outside
    its generator's domain, or the mixing is a search and the initial model is not controllable.

    Parameters
    ----------
    lifting : DelayLifting
        The lifting of y and v to x and u.
    estimator : ProximalEstimator or GrowingMemory
        Equation (15).
    controller : Controller
        Equation (3).
    initial_model : SignalModel
        theta~(0), lifted; controllable (Theorem 2(iii)).
    mixing : Mixing
        How lambda_k is chosen: ConstantMixing, LambdaSearch, or your own object with a function ``choose``.
    units : RunningUnits, optional
        Weights and initial model are relative to signal sizes measured in the run; by default they are in the signals'
        units.
    set_point : SetPoint, optional
        The target of the outputs; the scheme then lifts distances from it and increments of the input. By default
        outputs and inputs go to zero, as in the paper.
    family : ModelFamily, optional
        Initial models; a controllable one of their estimates is used (Theorem 4 of the book). The estimator must be a
        ``GrowingMemory``, whose centre is then the initial model at every k; this model must shift outputs.
    """

    lifting: DelayLifting
    estimator: ProximalEstimator | GrowingMemory
    controller: Controller
    initial_model: SignalModel
    mixing: Mixing = field(default_factory=ConstantMixing)
    units: RunningUnits | None = None
    set_point: SetPoint | None = None
    family: ModelFamily | None = None

    def __post_init__(self) -> None:
        for name, *kinds in (
            ("lifting", DelayLifting),
            ("estimator", ProximalEstimator, GrowingMemory),
            ("controller", Controller),
            ("initial_model", SignalModel),
        ):
            instance(name, getattr(self, name), *kinds)
        self._check_units()
        # An array has a function of that name with another meaning.
        if not callable(getattr(self.mixing, "choose", None)) or isinstance(self.mixing, type | np.ndarray):
            wanted = "a ConstantMixing, a LambdaSearch, or an object with a function choose"
            raise InputError(f"mixing must be {wanted}, got {describe(self.mixing)}")
        augmented = self.lifting.augment(self.initial_model)
        self.lifting.output_size(self.initial_model.n)
        if self.estimator.constraints is not None:
            self.estimator.constraints.check("the initial model", self.initial_model)
        generator = self.estimator.generator
        if not np.all(self.initial_model.theta > generator.lower):
            raise InputError(
                f"the initial model must lie in the domain of {called(generator)}, entries above {generator.lower:g}, "
                f"got {self.initial_model.theta.min():g}; choose one with larger entries, or another generator"
            )
        self._check_sizes_of_signals()
        self._check_family()
        weight_matrix("Q", self.controller.Q, augmented.n)
        weight_matrix("R", self.controller.R, augmented.q)
        weight_matrix("QN", self.controller.QN, augmented.n)
        if isinstance(self.mixing, LambdaSearch):
            model = augmented if self.mixing.pair == "augmented" else self.initial_model
            least = np.min(controllability_margin(model))
            if not least >= self.mixing.least_margin:
                raise InputError(
                    "the initial model must be controllable for a lambda-search: "
                    f"its {self.mixing.pair} pair must have a margin of at least {self.mixing.least_margin:g}, "
                    f"got {least:.3g}; choose another initial model, lower least_margin, or mix by a constant"
                )

    def _check_sizes_of_signals(self) -> None:
        if self.controller.bounds is not None:
            _check_bounds(self.controller.bounds, self.q)
        if self.set_point is not None:
            instance("set_point", self.set_point, SetPoint)
            self.set_point.at(0, self.p)
            if self.lifting.basis is not None:
                raise InputError(
                    "set_point must be None where a lifting appends basis functions, which are made for zero, got one"
                )

    def _check_family(self) -> None:
        if self.family is None:
            return
        instance("family", self.family, ModelFamily)
        constant = isinstance(self.mixing, ConstantMixing) and self.mixing.lam == 0
        if not (isinstance(self.estimator, GrowingMemory) and constant and self.units is None):
            raise InputError(
                "a family of initial models must come with a GrowingMemory, no mixing and no units, got another "
                "estimator, a mixing or units"
            )
        n, q = self.initial_model.n, self.initial_model.q
        if self.family.shifts.shape[1:] != (self.p, n + q):
            raise InputError(
                f"the family's shifts must have shape (count, {self.p}, {n + q}), got {self.family.shifts.shape}"
                + ("" if self.set_point is None else "; with a set point a scheme stacks one output and input more")
            )
        shift = SignalModel.shift_of_ones(self.p, self.lifting.outputs, self.q, self.lifting.inputs)
        if self.lifting.basis is not None or not all(
            np.array_equal(of[..., self.p :, :], np.broadcast_to(M[self.p :], of[..., self.p :, :].shape))
            for of, M in ((self.initial_model.A, shift.A), (self.initial_model.B, shift.B))
        ):
            raise InputError(
                "the initial model of a family must shift stacked outputs, as SignalModel.shift_of_ones does, got "
                "another one"
            )

    def _check_units(self) -> None:
        if self.units is None:
            return
        instance("units", self.units, RunningUnits)
        if self.lifting.basis is not None:
            raise InputError("units must be None where a lifting appends basis functions, which have no size, got some")
        if self.estimator.constraints is not None:
            raise InputError(
                "units must be None where the estimator has constraints, which are given for the signals as they are, "
                "got some"
            )
        given, q = np.shape(self.units.inputs), self.initial_model.q // self.lifting.inputs
        if given not in ((), (q,)):
            raise InputError(f"units must have one size for inputs, or {q}, one for each input, got {given[0]}")
        given = np.shape(self.units.noise)
        if given not in ((), (self.p,)):
            raise InputError(f"units must have one noise, or {self.p}, one for each output, got {given[0]}")

    @cached_property
    def factors(self) -> tuple[Array, Array, Array]:
        """Upper triangular factors of Q, R and QN, on the augmented state."""
        controller, n = self.controller, self.lifting.augment(self.initial_model).n
        sizes = {"Q": n, "R": self.q, "QN": n}
        Q, R, QN = (
            locked(factor(weight_matrix(name, getattr(controller, name), size))) for name, size in sizes.items()
        )
        return Q, R, QN

    @property
    def depth(self) -> int:
        """The number of past outputs and inputs that a state keeps: enough for a step, and never fewer than that."""
        increments = 0 if self.set_point is None else 1
        return self.estimator.window + 1 + increments + max(self.lifting.outputs, self.lifting.inputs)

    @property
    def first_measured(self) -> int:
        """The first k at which the transition to x(k) has no zero from before k = 0 in it."""
        return max(self.lifting.outputs, self.lifting.inputs)

    @cached_property
    def p(self) -> int:
        """Size of the output y."""
        return self.lifting.output_size(self.initial_model.n)

    @property
    def q(self) -> int:
        """Size of the input v."""
        return self.initial_model.q // self.lifting.inputs


def _check_sizes(p: int, q: int, order: int) -> None:
    for name, value in (("p", p), ("q", q), ("order", order)):
        integer(name, value, 1)
    if (p + q) * order > _STACKED:
        raise InputError(
            f"p, q and order must stack at most {_STACKED} outputs and inputs, got {(p + q) * order}; give smaller ones"
        )


def _check_bounds(bounds: Saturation, q: int) -> None:
    instance("bounds", bounds, Saturation)
    if not {np.shape(bounds.low), np.shape(bounds.high)} <= {(), (q,)}:
        raise InputError(
            f"bounds must be numbers or have {q} entries, one for each input, got {np.shape(bounds.low)} and "
            f"{np.shape(bounds.high)}"
        )


def _share_of_range(bounds: Saturation) -> Array:
    """Return a hundredth of the range of each input, or 0.1 if that is not a positive finite number."""
    with np.errstate(over="ignore"):
        found = 0.01 * (np.asarray(bounds.high) - bounds.low)
    return np.where(np.isfinite(found) & (found > 0), found, 0.1)


def window_scheme(p: int, q: int, order: int) -> Scheme:
    r"""Return a scheme of the form that the paper simulates, for outputs of size p and inputs of size q.

    ``order`` is an upper bound on the order of the plant's observable part. The scheme has :math:`N_y = N_v` = order
    (Lemma 6), a window of twice that, squares for loss and generator, no mixing, unit weights, a horizon of twice the
    augmented state's size and at least 30, :math:`\epsilon(k) = 1/(1+10k)`, and the paper's initial model. Weights
    have units: if inputs and outputs differ in size, replace R first. The generator's weight, 0.01, is added to squares
    of the outputs and assumes that these are of size one.
    """
    _check_sizes(p, q, order)
    n = p * order
    return Scheme(
        lifting=DelayLifting(order, order),
        estimator=ProximalEstimator(2 * order, generator=WeightedSquares(0.01)),
        controller=Controller(1.0, 1.0, 1.0, max(30, 2 * (n + (order - 1) * q)), PowerDecay(10)),
        initial_model=SignalModel.companion_of_ones(n, q * order, "last-row-of-ones"),
    )


def default_scheme(
    p: int,
    q: int,
    order: int,
    inputs: Array | float | None = None,
    noise: Array | float = 0.0,
    *,
    bounds: Saturation | None = None,
    set_point: SetPoint | None = None,
) -> Scheme:
    r"""Return a default scheme for unknown plants, whose signals may have any size.

    ``p`` and ``q`` are the numbers of outputs and inputs, and ``order`` is an upper bound on the plant's observability
    index: that many of each are stacked (Lemma 6). ``inputs`` is the size of the first inputs, and ``noise`` the
    standard deviation of each output's error, see :class:`~rhl.units.RunningUnits`. The differences from
    :func:`window_scheme` follow, measured on the eighteen benchmark plants up to order ten that an input can bring to
    rest, and on random plants with one to three inputs and outputs:

    - every measured transition is kept (:class:`~rhl.memory.GrowingMemory`, weight 1e-10): a window of 2m transitions
      has fewer equations than a plant with several outputs has parameters, and drops the informative data once the
      plant is near rest. Seven of the eighteen come to rest with the window, and all of them with this memory. The
      weight is far below the squares of scaled signals: on 474 plants of the kinds above, 1e-8 gives outputs 5 %
      larger;
    - weights scale signals by sizes measured in the run (:class:`~rhl.units.RunningUnits`), since a weight that suits
      0.05 rad does not suit a column at 300 K. Without them, fifteen of the eighteen come to rest, and one diverges;
    - an input is scaled by a hundredth of its size while the data do not determine its effect (``caution``). The effect
      that is estimated from few data is often very small, which makes the input far too large. For the flexible shaft
      of ``rhl.plants.examples`` the largest angle is 1.6 times the first one, and 104 times without caution;
    - R = 0.03, and 0.03 for past inputs in the augmented state: with the paper's unit weights an input costs as much as
      the output that it moves, and again as each stacked past input. With unit weights, seventeen of the eighteen come
      to rest, and the median cost is 21 times that of the regulator that knows the plant; with these it is 8.5;
    - eps(k) = 1/(1+k)^2: with 1/(1+k) a plan over a finite horizon leaves a slow unstable mode at a level that falls
      with the square root of k only, and outputs of the 474 plants are 5 % larger. The terminal weight grows too soon
      if data determine the estimate slowly: ``bdt1``, of order eleven, reaches 74 times its first outputs, with (1 +
      k/24)^-3 1.1 times, for 24 entries of x and u;
    - the initial model only shifts outputs, and input j moves output i by 1/(1 + |i - j|) of its size. The estimate
      learns from the first inputs, which are below the given size. Inputs differ in their effects, since inputs with
      the same effect in the model would stay equal until rounding separates them.

    With noise, small inputs are not informative and outputs cannot get below the noise. There is then no caution,
    R = 1, past inputs have the weight 0.3, and the memory's weight is the square of the noise over the output's size.
    On two sets of 204 and 186 plants with errors of 1 % of the first outputs, the geometric mean of the costs is 0.57
    and 0.98 times that of the scheme without ``noise``; with errors of 5 % it is 0.45 and 0.90 times.
    """
    _check_sizes(p, q, order)
    stacked = order if set_point is None else order + 1
    return scheme_for(DelayLifting(stacked, stacked), p, q, inputs, noise, bounds=bounds, set_point=set_point)


def scheme_for(
    lifting: DelayLifting,
    p: int,
    q: int,
    inputs: Array | float | None = None,
    noise: Array | float = 0.0,
    *,
    bounds: Saturation | None = None,
    set_point: SetPoint | None = None,
) -> Scheme:
    """Return the scheme of :func:`default_scheme` for a given lifting; basis functions exclude running units."""
    n, stacked = lifting.size(p), lifting.outputs * p
    A, B = np.eye(n, k=-p), np.zeros((n, q * lifting.inputs))
    A[stacked:] = 0.0
    B[:p, :q] = 1.0 / (1.0 + np.abs(np.arange(p)[:, None] - np.arange(q)))
    if set_point is not None:
        A[:p, :p] = np.eye(p)
    if bounds is not None:
        _check_bounds(bounds, q)
    if inputs is None:
        inputs = 0.1 if bounds is None else _share_of_range(bounds)
    units, R = RunningUnits(inputs, noise=noise), 0.03
    if np.any(np.asarray(units.noise) > 0):
        R, units = 1.0, replace(units, caution=0.0, past=0.3)
    # Increments that are reversed later cost little, so a short plan makes inputs grow if the plant has a zero outside
    # the unit circle: those of the quadruple tank oscillate with 20 steps, less with 60, and not with 100.
    least = 30 if set_point is None else 100
    horizon = max(least, 2 * (n + (lifting.inputs - 1) * q))
    return Scheme(
        lifting=lifting,
        estimator=GrowingMemory(),
        controller=Controller(1.0, R, 1.0, horizon, PowerDecay(1, 2), bounds=bounds),
        initial_model=SignalModel(A, B),
        units=units if lifting.basis is None else None,
        set_point=set_point,
    )
