"""Every error and warning of the library; all errors lie below ``RHLError``."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rhl.trace import Trace


class RHLError(Exception):
    """What the library raises by itself; the message says in one sentence what was expected and found."""


class InputError(RHLError, ValueError):
    """A value passed by the caller does not fit; the message says what was expected and found."""


class NotFiniteError(InputError):
    """A value is NaN or infinite."""


class PlantError(InputError):
    """A function that the caller gave for a plant does not do what a plant must; the message says which and what."""


class InfeasibleError(RHLError, ValueError):
    """No input sequence steers the predictor from x to the terminal state r."""


class NotSolvedError(RHLError, ArithmeticError):
    """The estimator's problem was not solved to the accuracy that its certificate asks for."""


class LostControllabilityError(RHLError, ArithmeticError):
    """No candidate lambda keeps the mixed pair controllable by the asked margin."""


class DivergedError(RHLError, ArithmeticError):
    """The closed loop left the range of float64.

    At step ``k`` the number ``what`` did; ``trace`` holds the rows before, where ``simulate`` recorded any, else None.
    """

    def __init__(self, k: int, what: str, trace: Trace | None = None) -> None:
        super().__init__(f"the run left the range of floating-point numbers at k = {k}: {what}")
        self.k = k
        self.what = what
        self.trace = trace

    def __reduce__(self) -> tuple[type[DivergedError], tuple[int, str, Trace | None]]:
        # An exception is rebuilt from its message alone otherwise, which would break a pool of processes.
        return type(self), (self.k, self.what, self.trace)


class AssumptionWarning(UserWarning):
    """What was chosen is allowed, but an assumption of the paper, which the message names, is not known to hold."""
