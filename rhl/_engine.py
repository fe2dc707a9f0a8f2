"""The compiled closed loop: a batch in blocks of lanes, whose working arrays the kernel changes in place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from rhl._checks import Array
from rhl._lanes import blocks, to_lanes
from rhl.controllability import ConstantMixing
from rhl.lifting import DelayLifting
from rhl.scheme import Scheme


@dataclass(frozen=True, eq=False)
class Block:
    """A block of members of a batch, in lanes.

    ``plant`` holds [F G] and [H 0], without rows for a plant of the caller, and z, shape (n + q, lanes), the
    linear plant's state, then the input. ``state`` holds x, u, v(k-1) and theta~(k-1), see
    ``rhl.kernels.loops``; ``estimator`` and ``controller`` hold the parts of the scheme that the kernel needs.
    ``diverged_at``, shape (lanes,), is the step at which a lane left the range of float64, else -1.
    """

    members: slice
    plant: tuple[Array, Array]
    z: Array
    state: tuple[Array, Array, Array, Array]
    estimator: tuple[Any, ...]
    controller: tuple[Any, ...]
    diverged_at: np.ndarray


def serves(scheme: Scheme) -> bool:
    """Whether the compiled loop can run a scheme: squares, no constraints, constant mixing, a weight that grows with k.

    It has no bounds, set points or running units.
    """
    # Only these classes themselves, since a subclass may behave differently.
    own = type(scheme.lifting) is DelayLifting and type(scheme.mixing) is ConstantMixing
    controller = scheme.controller
    more = (controller.bounds, scheme.set_point, scheme.units)
    return own and scheme.estimator.by_rows and not controller.adaptive and all(part is None for part in more)


def begin(scheme: Scheme, lead: tuple[int, ...], plant: tuple[Array, Array, Array] | None, z: Array) -> list[Block]:
    """Return the blocks of a batch with axes ``lead`` before k = 0, for a scheme that the compiled loop serves.

    ``plant`` is F, G, H, with batch axes or without, or None for a plant of the caller; z, shape (..., n), is
    z(0).
    """
    model, controller, q = scheme.initial_model, scheme.controller, scheme.q
    estimator: Any = scheme.estimator
    theta = to_lanes(np.concatenate([model.A, model.B], axis=-1), lead, 2)
    members = theta.shape[-1]
    empty = np.empty((0, 0, members)), np.empty((scheme.p, 0, members))
    FG, H0, state = *empty, np.empty((0, members))
    if plant is not None:
        F, G, H = (to_lanes(M, lead, 2) for M in plant)
        FG, H0 = np.concatenate([F, G], axis=1), np.concatenate([H, np.zeros((len(H), q, members))], axis=1)
        state = np.concatenate([to_lanes(z, lead, 1), np.zeros((q, members))])
    factors = [to_lanes(M, lead, 2) for M in scheme.factors]
    trust, hold = estimator.roots_of_weights(model.n, model.q)
    mixing: Any = scheme.mixing
    fixed = trust, hold, float(mixing.lam)
    chosen = controller.horizon, float(controller.alpha), bool(controller.model_delay)
    found = []
    for part in blocks(members):
        fg, h, z_part, theta_part, Q, R, QN = (
            np.ascontiguousarray(M[..., part]) for M in (FG, H0, state, theta, *factors)
        )
        lanes = theta_part.shape[-1]
        signals = (
            np.zeros((estimator.window + 1, model.n, lanes)),
            np.zeros((estimator.window, model.q, lanes)),
            np.zeros((q, lanes)),
            theta_part,
        )
        diverged = np.full(lanes, -1)
        found.append(Block(part, (fg, h), z_part, signals, fixed, (Q, R, QN, *chosen), diverged))
    return found


def run(
    block: Block, first: int, epsilon: Array, lifted: Array | None, keep: bool
) -> tuple[tuple[Array, Array, Array], tuple[Array, Array]]:
    """Run a block for as many steps as there are values of epsilon, from step ``first``.

    ``lifted``, shape (steps, n, lanes), is x(k) for a plant of the caller, else None. Returns (y, v, z), shapes
    (steps, size, lanes), without entries in y and z for a plant of the caller; and theta*(k) and theta~(k),
    shapes (steps, n, n + q, lanes), without steps unless ``keep``.
    """
    from rhl.kernels import loops  # imported here, because loading the compiler takes longer than the rest

    steps, lanes, plant, theta = len(epsilon), len(block.diverged_at), block.plant, block.state[3]
    known = len(plant[0]) > 0
    sizes = (len(plant[1]) if known else 0, len(block.state[2]), len(plant[0]))
    y, v, z = (np.empty((steps, size, lanes)) for size in sizes)
    kept = steps if keep else 0
    models = np.empty((kept, *theta.shape)), np.empty((kept, *theta.shape))
    given = np.empty((0, 0, lanes)) if lifted is None else lifted
    signals = y, v, z
    settings = block.estimator, block.controller
    loops.run(first, plant, block.z, given, block.state, *settings, epsilon, block.diverged_at, signals, models)
    return (y, v, z), models
