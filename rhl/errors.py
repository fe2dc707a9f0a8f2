"""Every error and warning of the library; all errors derive from ``RHLError``."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rhl.trace import Trace


class RHLError(Exception):
    """The base class of the library's errors; each message says in one sentence what was expected and found.

    Examples
    --------
    >>> from rhl.model import SignalModel
    >>> try:
    ...     SignalModel([[1.0, 2.0]], [[1.0]])
    ... except RHLError as error:
    ...     print(type(error).__name__, error)
    InputError A must be square, got shape (1, 2)
    """


class InputError(RHLError, ValueError):
    """A value passed by the caller does not fit; the message says what was expected and found."""


class NotFiniteError(InputError):
    """A value is NaN or infinite.

    Examples
    --------
    >>> from rhl.model import SignalModel
    >>> SignalModel([[float("nan")]], [[1.0]])
    Traceback (most recent call last):
    rhl.errors.NotFiniteError: A must be finite, got nan among its entries
    """


class PlantError(InputError):
    """A function of the caller's plant is invalid; the message says which one and how.

    Examples
    --------
    >>> from rhl.plants import FunctionPlant
    >>> FunctionPlant(lambda z, v: z[:1], lambda z: z, n=2, q=1)
    Traceback (most recent call last):
    rhl.errors.PlantError: transition(z, v) must return an array of shape (2,), got shape (1,); return ...
    """


class InfeasibleError(RHLError, ValueError):
    """No input sequence steers the predictor from x to the terminal state r."""


class NotSolvedError(RHLError, ArithmeticError):
    """The estimator's problem was not solved to the accuracy that its certificate requires.

    Examples
    --------
    >>> import numpy as np
    >>> from rhl import ProximalEstimator, SignalModel
    >>> from rhl.losses import CustomLoss
    >>> concave = CustomLoss(lambda e: -50 * e @ e, lambda e: -100 * e, lambda e: -100 + 0 * e, assumption_6=True)
    >>> x, u = np.array([[1.0], [1.0]]), np.array([[1.0]])
    >>> ProximalEstimator(1, concave).minimise(SignalModel([[0.0]], [[0.0]]), x, u)
    Traceback (most recent call last):
    rhl.errors.NotSolvedError: the estimator's problem must be solved to ..., got ... (CustomLoss has negative ...
    """


class LostControllabilityError(RHLError, ArithmeticError):
    """No candidate lambda keeps the mixed pair controllable with the required margin."""


class DivergedError(RHLError, ArithmeticError):
    """The closed loop left the range of float64.

    ``k`` is the step, ``what`` the cause; ``trace`` holds the rows before it if ``simulate`` recorded any, else None.
    """

    def __init__(self, k: int, what: str, trace: Trace | None = None) -> None:
        super().__init__(f"the run left the range of floating-point numbers at k = {k}: {what}")
        self.k = k
        self.what = what
        self.trace = trace

    def __reduce__(self) -> tuple[type[DivergedError], tuple[int, str, Trace | None]]:
        # By default an exception is unpickled from its message alone, which would break a pool of processes.
        return type(self), (self.k, self.what, self.trace)


class AssumptionWarning(UserWarning):
    """A setting is allowed, but the assumption of the paper that the message names is not known to hold."""
