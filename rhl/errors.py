"""Every error and warning of the library; all errors derive from ``RHLError``."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rhl.trace import Trace


class RHLError(Exception):
    """The base class of the library's errors; each message says in one sentence what was expected and found."""


class InputError(RHLError, ValueError):
    """A value passed by the caller does not fit; the message says what was expected and found."""


class NotFiniteError(InputError):
    """A value is NaN or infinite."""


class PlantError(InputError):
    """A function of the caller's plant is invalid; the message says which one and how."""


class InfeasibleError(RHLError, ValueError):
    """No input sequence steers the predictor from x to the terminal state r."""


class NotSolvedError(RHLError, ArithmeticError):
    """The estimator's problem was not solved to the accuracy that its certificate requires."""


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
