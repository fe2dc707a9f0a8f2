"""What one would use instead: a regulator that knows the plant, and one that excites, identifies and regulates."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rhl._checks import Array, integer, positive
from rhl._riccati import gains
from rhl.errors import InputError
from rhl.lifting import DelayLifting, remember
from rhl.model import SignalModel
from rhl.plants.linear import LinearPlant

# A direction of the data counts where its singular value exceeds this share of the largest.
_RANK_RTOL = 1e-9
# Steps that the identified regulator looks ahead; for slower modes it makes no difference that matters here.
_AHEAD = 300


@dataclass(frozen=True, eq=False)
class Run:
    """A run: outputs y, shape (steps, p), and inputs v, shape (steps, q).

    ``wanted`` is the number of steps asked for; fewer rows say that an output passed 1e100 then.
    """

    y: Array
    v: Array
    wanted: int


def weights(plant: LinearPlant, y0: Array, order: int) -> tuple[Array, Array]:
    r"""Return the cost that all are judged by, :math:`\sum_k |y(k)|_W^2 + |v(k)|_R^2`, as W (p, p) and R (q, q).

    Outputs count in their first sizes; those that are zero then, in the largest of the others. An input counts 1e-4 of
    what it moves outputs by within ``order`` steps, in these sizes.
    """
    size = np.where(np.abs(y0) > 0, np.abs(y0), np.max(np.abs(y0)))
    if not np.all((size > 1e-100) & (size < 1e100)):
        raise InputError(
            "y(0) must not be zero, and lie between 1e-100 and 1e100, since outputs count in its sizes, got "
            f"{np.max(np.abs(y0)):.3g}; begin from another z0"
        )
    effect, moved = np.zeros((plant.p, plant.q)), plant.G
    for _ in range(order):
        effect += np.abs(plant.H @ moved) / size[:, None]
        moved = plant.F @ moved
    gain = np.max(effect, axis=0)
    return np.diag(size**-2.0), 1e-4 * np.diag(np.where(gain > 0, gain, 1.0) ** 2)


def known_plant(plant: LinearPlant, z0: Array, steps: int, W: Array, R: Array) -> Run:
    """Run the regulator that knows plant and state and how many steps there are: no other inputs cost less."""
    K = _regulator(plant.F, plant.G, np.sqrt(W) @ plant.H, R, steps)
    return _closed(plant, z0, steps, lambda k, y, z: -K[k] @ z)


def excite_identify_regulate(
    plant: LinearPlant,
    z0: Array,
    steps: int,
    order: int,
    W: Array,
    R: Array,
    *,
    size: Array | float = 1.0,
    seed: int = 0,
) -> Run:
    """Excite at random until the data's rank stops rising, fit a model of the lifted signals, and regulate with it.

    Of the plant it uses what the scheme uses: outputs, inputs and ``order``, how many of each are stacked. Inputs of
    the first part are normal with standard deviation ``size``. The weights W and R are those of ``weights``.
    """
    positive("size", float(np.max(size)))
    m, rng = integer("order", order, 1), np.random.default_rng(integer("seed", seed, 0))
    lifting, p, q = DelayLifting(m, m), plant.p, plant.q
    n, scale = p * m, np.concatenate([np.tile(np.sqrt(np.diag(W)), m), np.tile(1.0 / np.broadcast_to(size, q), m)])
    past: list[Array] = [np.zeros((m + 1, p)), np.zeros((m + 1, q))]
    rows: list[Array] = []
    found: list[Array] = []
    ranks = [0, 0]

    def choose(k: int, y: Array, z: Array) -> Array:
        past[0] = remember(past[0], y)
        if k >= m and not found:
            rows.append(np.concatenate([past[0][1:].ravel(), past[1][:m].ravel(), past[0][:m].ravel()]))
            data = np.array(rows)
            known, target = data[:, : len(scale)] * scale, data[:, len(scale) :]
            ranks.append(int(np.linalg.matrix_rank(known, rtol=_RANK_RTOL)))
            if ranks[-1] == ranks[-3] and len(rows) > ranks[-1]:
                theta = (np.linalg.lstsq(known, target, rcond=_RANK_RTOL)[0] * scale[:, None]).T
                model = lifting.augment(SignalModel(theta[:, :n], theta[:, n:]))
                seen = np.concatenate([np.sqrt(W), np.zeros((p, model.n - p))], axis=1)
                found.append(_regulator(model.A, model.B, seen, R, _AHEAD)[0])
        v = -found[0] @ lifting.augmented_state(*past) if found else size * rng.standard_normal(q)
        past[1] = remember(past[1], v)
        return v

    return _closed(plant, z0, steps, choose)


def _regulator(A: Array, B: Array, seen: Array, R: Array, steps: int) -> Array:
    """Return the gains that make the sum of |seen z|^2 + |v|_R^2 over the steps least, shape (steps, q, n)."""
    n = len(A)
    triangle = np.zeros((n, n))
    factored = np.linalg.qr(seen, mode="r")
    triangle[: len(factored)] = factored
    return gains(np.zeros((n, n)), A, B, triangle, np.sqrt(R), steps)[0]


def _closed(plant: LinearPlant, z0: Array, steps: int, choose: Callable[[int, Array, Array], Array]) -> Run:
    z, outputs, inputs = np.asarray(z0, dtype=np.float64), [], []
    for k in range(integer("steps", steps, 1)):
        y = plant.H @ z
        if not np.max(np.abs(y)) < 1e100:
            break
        v = choose(k, y, z)
        outputs.append(y)
        inputs.append(v)
        z = plant.F @ z + plant.G @ v
    return Run(np.array(outputs), np.array(inputs), steps)
