"""Sizes in which weights count signals, so that a scheme needs no unit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rhl._checks import Array, positive, real_array
from rhl.errors import InputError
from rhl.lifting import DelayLifting
from rhl.model import SignalModel

# An input is not taken to do less than this share of what was expected of its first size. One that does nothing would
# else grow without end, as its estimated effect goes to zero; one that does 1e-7 is still cheap enough to be used.
_LEAST_GAIN = 1e-6


@dataclass(frozen=True, eq=False)
class RunningUnits:
    r"""Weights count outputs and inputs in sizes that the run itself shows.

    The size of an output is the largest that was measured of it so far, :math:`s_i(k) = \max_{j \le k} |y_i(j)|`. The
    size of an input is what moves some output by its size, by the model in use,
    :math:`1 / \max_i \sum_l |B_{i}(l)| / s_i` over the rows that predict y(k+1) and the N_v inputs that u stacks. Q, R,
    QN and Gamma of the controller and the weight of ``GrowingMemory`` count signals in these sizes, and so does the
    initial model. The same plant in other units then gives the same run.

    The sizes settle where the outputs are bounded and the estimates converge; Theorem 1 is stated for weights that do
    not change, so this is outside of it.

    Parameters
    ----------
    inputs : float or array_like, shape (q,)
        A size of each input to begin with, positive: one that does no harm, as a tenth of the actuator's range or less.
        The first inputs are of that size, before anything is known of what they do; the smaller, the lower the peak,
        as long as the sensors see what they do.
    """

    inputs: Array | float = 0.1
    caution: float = 100.0

    def __post_init__(self) -> None:
        positive("caution", self.caution)
        sizes = real_array("inputs", self.inputs)
        if sizes.ndim > 1 or sizes.size == 0 or np.any(sizes <= 0):
            raise InputError(f"inputs must be positive, a number or one for each input, got {self.inputs}")
        object.__setattr__(self, "inputs", sizes)

    def initial(self, model: SignalModel, lifting: DelayLifting, size: Array, q: int) -> SignalModel:
        """Return theta~(0), given in sizes, in the units of the signals; size, shape (..., p), is that of y(0).

        An output that is zero is moved by no input until it is seen to be.
        """
        x, u = np.tile(size, lifting.outputs), np.tile(self._inputs(q), lifting.inputs)
        A = x[..., :, None] * model.A / np.where(x > 0, x, 1.0)[..., None, :]
        return SignalModel(A, x[..., :, None] * model.B / u)

    def parameters(self, lifting: DelayLifting, size: Array, q: int) -> Array:
        """Return the sizes of [x; u], shape (..., n + N_v q), which the weight of the estimator counts in."""
        x, u = np.tile(_seen(size), lifting.outputs), np.tile(self._inputs(q), lifting.inputs)
        return np.concatenate([x, np.broadcast_to(u, (*x.shape[:-1], len(u)))], axis=-1)

    def weights(
        self, model: SignalModel, lifting: DelayLifting, size: Array, q: int, unknown: Array | None = None
    ) -> tuple[Array, Array]:
        """Return one over the sizes of the augmented state, shape (..., n'), and of v, shape (..., q).

        ``model`` is the lifted one in use, ``unknown`` what ``GrowingMemory.unknown`` returns, shape (..., n + N_v q);
        where it is left out, nothing is. Past inputs count as if nothing was unknown: they can no longer be chosen.
        """
        p = size.shape[-1]
        effect = np.abs(model.B[..., :p, :]).reshape(*model.B.shape[:-2], p, lifting.inputs, q).sum(axis=-2)
        gain = np.max(effect / _seen(size)[..., None], axis=-2)
        v = np.where(gain > 0, np.maximum(gain, _LEAST_GAIN / self._inputs(q)), 1.0 / self._inputs(q))
        x = np.tile(1.0 / _seen(size), lifting.outputs)
        past = np.tile(v, lifting.inputs - 1)
        if unknown is not None:
            first = model.A.shape[-1]
            v = np.sqrt(v**2 + (self.caution / self._inputs(q)) ** 2 * unknown[..., first : first + q])
        lead = np.broadcast_shapes(x.shape[:-1], v.shape[:-1])
        return np.concatenate([np.broadcast_to(part, (*lead, part.shape[-1])) for part in (x, past)], axis=-1), v

    def _inputs(self, q: int) -> Array:
        return np.broadcast_to(self.inputs, q)


def _seen(size: Array) -> Array:
    # What was zero throughout has no size yet; any will do, since its predictions are zero as well.
    return np.where(size > 0, size, 1.0)
