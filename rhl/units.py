"""Sizes in which weights count signals, so that a scheme needs no unit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rhl._checks import Array, describe, positive, real_array
from rhl.errors import InputError
from rhl.lifting import DelayLifting
from rhl.model import SignalModel

# An input is not taken to do less than this share of what was expected of its first size. One that does nothing would
# else grow without end, as its estimated effect goes to zero; one that does 1e-7 is still cheap enough to be used.
_LEAST_GAIN = 1e-6

# The error of an output, relative to its size, that the weight of ``GrowingMemory`` stands for where there is no noise.
_EXACT = 1e-5


@dataclass(frozen=True, eq=False)
class RunningUnits:
    r"""Weights count outputs and inputs in sizes that the run itself shows.

    The size of an output is the largest that was measured of it so far, :math:`s_i(k) = \max_{j \le k} |y_i(j)|`. The
    size of an input is what moves some output by its size, by the model in use,
    :math:`1 / \max_i \sum_l |B_{i}(l)| / s_i` over the rows that predict y(k+1) and the N_v inputs that u stacks. Q, R,
    QN and Gamma of the controller and the estimator's weights count signals in these sizes, and so does the initial
    model. The same plant in other units then gives the same run.

    R counts an input in a smaller size while the data leave open what it does: with g one over the size above and s the
    share of ``GrowingMemory.unknown``, in :math:`1/\sqrt{g^2 + s\,(\mathrm{caution}/\mathrm{inputs})^2}`. An estimate
    made of few data often says that an input does next to nothing; without this the input would be large then.

    The sizes settle where the outputs are bounded and the estimates converge; Theorem 1 is stated for weights that do
    not change, so this is outside of it.

    Parameters
    ----------
    inputs : float or array_like, shape (q,)
        A size of each input to begin with, positive: one that does no harm, as a tenth of the actuator's range or less.
        The first inputs are of that size at most, before anything is known of what they do; the smaller, the lower the
        peak, as long as the sensors see what they do.
    caution : float
        How many times smaller than ``inputs`` an input counts of which nothing is known; 0 for no caution.
    past : float
        What past inputs weigh in the augmented state, where outputs of their size weigh one; positive.
    noise : float or array_like, shape (p,)
        Standard deviation of the error of each output, in its unit. The weight of ``GrowingMemory`` is taken to be the
        square of an error of 1e-5 relative to the output's size; it grows to the square of the largest such error.
    model_in_sizes : bool
        Whether the scheme's initial model counts signals in sizes; False: it is given in the units of the signals.
    """

    inputs: Array | float = 0.1
    caution: float = 100.0
    past: float = 0.03
    noise: Array | float = 0.0
    model_in_sizes: bool = True

    def __post_init__(self) -> None:
        sizes, caution, noise = (real_array(name, getattr(self, name)) for name in ("inputs", "caution", "noise"))
        if sizes.ndim > 1 or sizes.size == 0 or np.any(sizes <= 0):
            raise InputError(f"inputs must be positive, a number or one for each input, got {describe(self.inputs)}")
        if caution.ndim or caution < 0:
            raise InputError(f"caution must be a number of at least 0, got {describe(self.caution)}")
        if noise.ndim > 1 or noise.size == 0 or np.any(noise < 0):
            wanted = "a number of at least 0, or one for each output"
            raise InputError(f"noise must be {wanted}, got {describe(self.noise)}")
        object.__setattr__(self, "past", positive("past", self.past))
        object.__setattr__(self, "inputs", sizes)
        object.__setattr__(self, "caution", float(caution))
        object.__setattr__(self, "noise", noise)
        if not isinstance(self.model_in_sizes, bool):
            raise InputError(f"model_in_sizes must be True or False, got {describe(self.model_in_sizes)}")

    def initial(self, model: SignalModel, lifting: DelayLifting, size: Array, q: int) -> SignalModel:
        """Return theta~(0), given in sizes, in the units of the signals; size, shape (..., p), is that of y(0).

        Of an output that is zero nothing is said.
        """
        if not self.model_in_sizes:
            return model
        x, u = np.tile(size, lifting.outputs), np.tile(self._inputs(q), lifting.inputs)
        A = x[..., :, None] * model.A / np.where(x > 0, x, 1.0)[..., None, :]
        return SignalModel(A, x[..., :, None] * model.B / u)

    def parameters(self, lifting: DelayLifting, size: Array, q: int) -> Array:
        """Return the sizes of [x; u], shape (..., n + N_v q), which the weight of the estimator counts in.

        They are multiplied by what noise adds to the weight.
        """
        x, u = np.tile(_seen(size), lifting.outputs), np.tile(self._inputs(q), lifting.inputs)
        found = np.concatenate([x, np.broadcast_to(u, (*x.shape[:-1], len(u)))], axis=-1)
        # An output that has been zero so far has no size that an error could be relative to.
        error = np.max(np.where(size > 0, self.noise / _seen(size), 0.0), axis=-1, keepdims=True)
        return np.asarray(found * np.hypot(1.0, error / _EXACT))

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
        past = np.tile(np.sqrt(self.past) * v, lifting.inputs - 1)
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
