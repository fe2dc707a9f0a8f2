"""The settings of V1 at every step: weights, horizon, epsilon(k), bounds of the inputs."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from rhl._checks import Array, describe, instance, integer, positive, real_array, weight_matrix
from rhl.disturbances import Saturation
from rhl.errors import AssumptionWarning, InputError
from rhl.losses import called
from rhl.model import SignalModel
from rhl.problems import V1, InputBounds
from rhl.schedules import Schedule, epsilon_at

# How far an input may be outside its bounds, in their widths; beyond, rounding would merge the bounds.
_FAR = 1e6


@dataclass(frozen=True, eq=False)
class Controller:
    r"""The settings of V1 at every step, Assumption 3 and Theorem 1.

    Parameters
    ----------
    Q, QN : float or array_like, shape (n', n')
        Stage and terminal weight on the augmented state; a number stands for that multiple of the identity.
    R : float or array_like, shape (q, q)
        Input weight.
    horizon : int
        N, at least 1. The theory requires N at least n'.
    epsilon : callable
        k -> epsilon(k), positive and never increasing: a schedule of ``rhl.schedules`` or your own function.
        AssumptionWarning if it is known not to tend to zero (Theorem 1).
    alpha : float
        :math:`\Gamma(x) = \alpha x^\top x`, positive (Theorem 1).
    model_delay : {0, 1}
        0: use the estimate of this step, theta~(k). 1: use that of the previous step, theta~(k-1), as the published
        data do.
    bounds : Saturation, optional
        The actuator's limits, which plans then respect, as the paper's outlook suggests (Section VII); outside its
        theory. Give the same object to ``simulate`` as its actuator. By default plans have no bounds.
    adaptive : bool
        False: epsilon decreases at every step. True: it is evaluated at a stage j(k) that increases only if the value
        function did not decrease, :math:`V_1(k) \ge V_1(k-1)` with the weight kept; a suggestion of the paper's outlook
        (Section VII), outside its theory.
    """

    Q: Array | float
    R: Array | float
    QN: Array | float
    horizon: int
    epsilon: Schedule
    alpha: float = 1.0
    model_delay: int = 0
    adaptive: bool = False
    bounds: Saturation | None = None

    def __post_init__(self) -> None:
        integer("horizon", self.horizon, 1)
        positive("alpha", self.alpha)
        delay: object = self.model_delay
        if isinstance(delay, bool) or not (isinstance(delay, int | np.integer) and delay in (0, 1)):
            raise InputError(f"model_delay must be 0 or 1, got {describe(delay)}")
        for name in ("Q", "R", "QN"):
            weight = real_array(name, getattr(self, name))
            object.__setattr__(self, name, weight if weight.ndim else float(weight))
        if not callable(self.epsilon):
            raise InputError(f"epsilon must be a function of k, got {describe(self.epsilon)}")
        if not isinstance(self.adaptive, bool):
            raise InputError(f"adaptive must be True or False, got {describe(self.adaptive)}")
        if self.bounds is not None:
            instance("bounds", self.bounds, Saturation)
        if not getattr(self.epsilon, "vanishes", True):
            warnings.warn(
                f"Theorem 1 asks for an epsilon(k) that tends to zero: {called(self.epsilon)} does not, so the "
                "terminal weight need not bring the state to zero",
                AssumptionWarning,
                stacklevel=3,
            )

    def problem(
        self,
        model: SignalModel,
        x: Array,
        k: int | np.ndarray,
        sizes: tuple[Array, Array] | None = None,
        before: Array | None = None,
    ) -> V1:
        """Set up V1 for the augmented model and state with epsilon(k), equation (3); see :meth:`weight`.

        ``sizes`` is the result of ``RunningUnits.weights``, with running units; ``before`` is v(k-1), shape (..., q),
        if the inputs of the plan are increments.
        """
        bounds = self._bounds(model.q, before)
        if sizes is None:
            return V1(model, self.Q, self.R, self.QN, self.weight(x, k), self.horizon, bounds)
        of_x, of_v = (np.asarray(of)[..., None, :] * np.asarray(of)[..., :, None] for of in sizes)
        Q, R, QN = (
            weight_matrix(name, getattr(self, name), of.shape[-1]) * of
            for name, of in (("Q", of_x), ("R", of_v), ("QN", of_x))
        )
        return V1(model, Q, R, QN, self.weight(sizes[0] * x, k), self.horizon, bounds)

    def _bounds(self, q: int, before: Array | None) -> InputBounds | None:
        if self.bounds is None:
            return None
        low, high = (np.broadcast_to(edge, q) for edge in (self.bounds.low, self.bounds.high))
        if before is None:
            return InputBounds(low, high)
        # An actuator may report an input so far outside its bounds that these would coincide in float64.
        near = np.clip(before, low - _FAR * (high - low), high + _FAR * (high - low))
        return InputBounds(low - near, high - near, summed=True)

    def weight(self, x: Array, k: int | np.ndarray) -> Array:
        """Return the terminal weight Gamma(x)/eps(k), shape (...), equation (3), for the augmented state x (..., n).

        ``k`` is the step or, for an adaptive weight, the stage: an integer, or an array of them, shape (...).
        """
        stages, where = np.unique(k, return_inverse=True)
        epsilon = np.array([epsilon_at(self.epsilon, int(at)) for at in stages])[where].reshape(np.shape(k))
        # Summed from first to last, like the compiled loop, so that the two agree exactly.
        return np.asarray(self.alpha * sum(x[..., i] ** 2 for i in range(x.shape[-1])) / epsilon)
