"""Set points for the outputs, by way of increments of the input."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from rhl._checks import Array, describe, real_array
from rhl.errors import InputError, NotFiniteError


@dataclass(frozen=True, eq=False)
class SetPoint:
    r"""The target of the outputs, reached despite constant disturbances on the plant.

    The scheme then sees :math:`e(k) = y(k) - r` for an output and the increment :math:`\delta(k) = v(k) - v(k-1)` for
    an input. For a linear plant with constant disturbances, :math:`z^+ = F z + G v + d_1,\; y = H z + d_2`, these are
    output and input of a linear plant without disturbances,

    .. math::
        \begin{bmatrix} \tilde z \\ \tilde v \end{bmatrix}^+ =
        \begin{bmatrix} F & G \\ 0 & I \end{bmatrix} \begin{bmatrix} \tilde z \\ \tilde v \end{bmatrix}
        + \begin{bmatrix} G \\ I \end{bmatrix} \delta, \qquad e = H \tilde z,

    where tildes are distances from an equilibrium (z, v) with y = r, if there is one. This is the paper's remark on
    exosystems (Section V) for constant signals. The extended plant has the input as a further state, and its
    observability index is at most one above that of the plant.

    Parameters
    ----------
    value : float or array_like, shape (p,), or callable
        r, in the units of the outputs; or a function k -> r. A change of r takes effect at once: all stacked outputs
        are relative to the set point of step k.

    Examples
    --------
    >>> SetPoint(20.0).at(0, p=2)
    array([20., 20.])
    >>> SetPoint(lambda k: [0.0 if k < 50 else 1.0]).at(60, p=1)
    array([1.])
    """

    value: Array | float | Callable[[int], ArrayLike]

    def __post_init__(self) -> None:
        if not callable(self.value):
            found = real_array("value", self.value)
            if found.ndim > 1 or found.size == 0:
                raise InputError(f"value must be a number or one for each output, got shape {found.shape}")
            object.__setattr__(self, "value", found)

    def at(self, k: int, p: int) -> Array:
        """Return r(k), shape (p,); InputError if it has another size or is not finite."""
        given: object = self._called(k) if callable(self.value) else self.value
        try:
            found = real_array(f"the set point at k = {k}", given)  # type: ignore[arg-type]
        except NotFiniteError as error:  # an error of the caller, unlike a run that diverges
            raise InputError(str(error)) from None
        if found.shape not in ((), (p,)):
            raise InputError(
                f"the set point must be a number or have {p} entries, one for each output, got {describe(given)}"
            )
        return np.broadcast_to(found, p)

    def _called(self, k: int) -> object:
        assert callable(self.value)
        try:
            return self.value(k)
        except Exception as error:
            error.add_note(f"rhl called the set point at k = {k}")
            raise


def seen(set_point: SetPoint | None, k: int, y_history: Array, v_history: Array) -> tuple[Array, Array]:
    """Return the outputs and inputs that the scheme uses: the signals, or distances from r and increments.

    The histories are newest first, from y(k) and v(k-1) on; v needs one row more than the returned increments. Outputs
    from before k = 0 count as equal to the set point, and as zero without one.
    """
    if set_point is None:
        return y_history, v_history
    p, rows = y_history.shape[-1], y_history.shape[-2]
    measured = (np.arange(rows) <= k)[:, None]
    e = np.where(measured, y_history - set_point.at(k, p), 0.0)
    return e, v_history[..., :-1, :] - v_history[..., 1:, :]
