"""Sizes by which weights scale signals, so that a scheme does not depend on units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rhl._checks import Array, describe, positive, real_array
from rhl.errors import InputError
from rhl.lifting import DelayLifting
from rhl.model import SignalModel

# The smallest assumed effect of an input, as a share of the effect expected at its first size. Without this limit an
# input without effect would grow without bound as its estimated effect goes to zero; an effect of 1e-7 is still used.
_LEAST_GAIN = 1e-6

# The relative output error that the weight of ``GrowingMemory`` corresponds to without noise.
_EXACT = 1e-5


@dataclass(frozen=True, eq=False)
class RunningUnits:
    r"""Weights scale outputs and inputs by sizes measured in the run.

    The size of an output is its largest absolute value so far, :math:`s_i(k) = \max_{j \le k} |y_i(j)|`. The
    size of an input is the value that moves some output by its size, in the model in use,
    :math:`1 / \max_i \sum_l |B_{i}(l)| / s_i` over the rows that predict y(k+1) and the N_v inputs that u stacks. Q, R,
    QN and Gamma of the controller, the estimator's weights and the initial model refer to signals divided by these
    sizes. The same plant in other units then gives the same run.

    R uses a smaller size of an input while the data do not determine its effect:
    :math:`1/\sqrt{g^2 + s\,(\mathrm{caution}/\mathrm{inputs})^2}`, with g one over the size above and s the share of
    ``GrowingMemory.unknown``. An estimate from few data often has a very small effect of an input; without caution the
    input would then be large.

    The sizes converge if the outputs are bounded and the estimates converge. Theorem 1 is stated for constant weights,
    so it does not cover these.

    Parameters
    ----------
    inputs : float or array_like, shape (q,)
        The first size of each input, positive: a harmless one, such as a tenth of the actuator's range or less. The
        first inputs, whose effect is not known yet, are at most of that size. Smaller ones lower the peak, as long as
        the sensors measure their effect.
    caution : float
        The factor by which the size of an input of unknown effect is smaller than ``inputs``; 0 for no caution.
    past : float
        The weight of past inputs in the augmented state, relative to outputs of their size; positive.
    noise : float or array_like, shape (p,)
        Standard deviation of the error of each output, in its unit. The weight of ``GrowingMemory`` corresponds to a
        relative error of 1e-5, squared; it grows to the square of the largest relative error of an output.
    model_in_sizes : bool
        Whether the scheme's initial model refers to scaled signals; False: it is given in the units of the signals.
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

        The rows of an output that is zero are zero.
        """
        if not self.model_in_sizes:
            return model
        x, u = np.tile(size, lifting.outputs), np.tile(self._inputs(q), lifting.inputs)
        A = x[..., :, None] * model.A / np.where(x > 0, x, 1.0)[..., None, :]
        return SignalModel(A, x[..., :, None] * model.B / u)

    def parameters(self, lifting: DelayLifting, size: Array, q: int) -> Array:
        """Return the sizes of [x; u], shape (..., n + N_v q), by which the weight of the estimator scales them.

        They include the factor that noise adds to the weight.
        """
        x, u = np.tile(_seen(size), lifting.outputs), np.tile(self._inputs(q), lifting.inputs)
        found = np.concatenate([x, np.broadcast_to(u, (*x.shape[:-1], len(u)))], axis=-1)
        # An output that has been zero so far has no size to relate an error to.
        error = np.max(np.where(size > 0, self.noise / _seen(size), 0.0), axis=-1, keepdims=True)
        return np.asarray(found * np.hypot(1.0, error / _EXACT))

    def weights(
        self, model: SignalModel, lifting: DelayLifting, size: Array, q: int, unknown: Array | None = None
    ) -> tuple[Array, Array]:
        """Return one over the sizes of the augmented state, shape (..., n'), and of v, shape (..., q).

        ``model`` is the lifted one in use, ``unknown`` what ``GrowingMemory.unknown`` returns, shape (..., n + N_v q);
        if it is left out, everything is known. Past inputs are scaled as known, since they can no longer be chosen.
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
    # A signal that was always zero has no size yet; any size works, since its predictions are zero too.
    return np.where(size > 0, size, 1.0)
