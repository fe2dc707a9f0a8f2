"""A family of initial models, one of whose estimates stays controllable: a scheme that needs no Assumption 5."""

from __future__ import annotations

from dataclasses import dataclass
from math import comb

import numpy as np

from rhl._checks import Array, fraction, instance, integer, positive, real_array
from rhl.controllability import Augment, controllability_margin
from rhl.errors import InputError
from rhl.model import SignalModel

# The largest family: with more members a step of the search takes longer than most sampling times.
_MOST = 50_000
# The most numbers in all shifts together, 0.4 GB.
_NUMBERS = 50_000_000


@dataclass(frozen=True, eq=False)
class ModelFamily:
    r"""Initial models around the given one; the controller uses a controllable one of their estimates.

    With the fixed centre :math:`\theta_0`, the estimate of all data, as rows [A B], obeys

    .. math::
        \hat\theta(k) = \theta - (\theta - \theta_0) M(k), \qquad M(k) = \rho \, (\Phi_k^\top \Phi_k + \rho I)^{-1},

    where theta is the plant's own signal model and the rows of :math:`\Phi_k` are the data [x; u] up to k. The estimate
    from :math:`\theta_0 + E` is therefore :math:`\hat\theta(k) + E M(k)`. For the unknown :math:`E^* = \theta -
    \theta_0` it is theta at every k. Each minor of the controllability matrix is a polynomial in E with a constant
    value at :math:`E^*`. On a finite set of E that determines polynomials of this total degree, it therefore cannot be
    small everywhere. The member in use changes only if its margin falls below a share of the largest one, and these
    changes end. This is Theorem 4 of the book, not of the paper.

    Parameters
    ----------
    shifts : array_like, shape (count, p, n + N_v q)
        Increments of the first p rows of the initial model's [A B]; one of them must be zero.
    hysteresis : float
        In (0, 1): the share of the largest margin that the member in use must keep.

    Examples
    --------
    >>> family = ModelFamily.grid(p=1, outputs=1, q=1, inputs=1)
    >>> family.shifts.shape
    (3, 1, 2)
    """

    shifts: Array
    hysteresis: float = 0.01

    def __post_init__(self) -> None:
        shifts = real_array("shifts", self.shifts, (None, None, None))
        if shifts.ndim != 3 or not np.any(np.all(shifts == 0, axis=(1, 2))):
            raise InputError(
                f"shifts must have shape (count, p, n + N_v q) with one that is zero, got shape {shifts.shape}"
                + ("" if shifts.ndim != 3 else " and none")
            )
        object.__setattr__(self, "shifts", shifts)
        positive("hysteresis", self.hysteresis)
        fraction("hysteresis", self.hysteresis)

    @classmethod
    def grid(
        cls, p: int, outputs: int, q: int, inputs: int, size: float = 1.0, hysteresis: float = 0.01
    ) -> ModelFamily:
        """Return a grid that determines every polynomial of the degrees that Theorem 4 needs.

        These are polynomials in all entries of a shift, since M mixes them. With one input and output and equally many
        of both stacked, n, the determinant of the augmented pair's controllability matrix is the resultant of numerator
        and denominator, of total degree 2n - 1; otherwise its minors have the degree of Lemma 5 at most. ``size`` is
        the largest entry of a shift. InputError if the grid would have more than 50,000 members.
        """
        for name, value in (("p", p), ("outputs", outputs), ("q", q), ("inputs", inputs)):
            integer(name, value, 1)
        positive("size", size)
        of_y, of_v = p * outputs, q * inputs
        # More variables than members are too many for any degree, and the sums below would take long.
        if p * (of_y + of_v) > _MOST:
            raise InputError(
                f"the grid must have at most {_MOST} members, got {p * (of_y + of_v)} entries of a shift alone; give "
                "your own shifts"
            )
        variables, n = p * (of_y + of_v), of_y + q * (inputs - 1)
        degree = 2 * outputs - 1 if p == q == 1 and outputs == inputs else sum(n - i // q for i in range(n))
        count = comb(variables + degree, degree)
        if count > _MOST:
            raise InputError(
                f"the grid must have at most {_MOST} members, got {count} for these sizes; give your own shifts"
            )
        if count * variables > _NUMBERS:
            raise InputError(
                f"the grid must have at most {_NUMBERS} numbers, got {count * variables}; give your own shifts"
            )
        return cls(size * np.reshape(_lower_set(variables, degree), (count, p, of_y + of_v)), hysteresis)

    def members(self, estimate: SignalModel, spread: Array) -> SignalModel:
        """Return the estimates from all initial models, shape (..., count): theta^ + E M."""
        p, d = self.shifts.shape[1:]
        moved = np.concatenate([estimate.A, estimate.B], axis=-1)[..., None, :, :] + np.zeros((len(self.shifts), 1, 1))
        moved[..., :p, :] += self.shifts @ spread[..., None, :, :]
        return SignalModel(moved[..., : estimate.n], moved[..., estimate.n : d])

    def nearest(self, model: SignalModel, estimate: SignalModel, spread: Array) -> np.ndarray:
        """Return the index of the member that a model is, shape (...)."""
        members = self.members(estimate, spread)
        pairs = (members.A, model.A), (members.B, model.B)
        gaps = [np.max(np.abs(of - one[..., None, :, :]), axis=(-1, -2)) for of, one in pairs]
        return np.asarray(np.argmin(np.maximum(*gaps), axis=-1))

    def choose(self, current: np.ndarray, estimate: SignalModel, spread: Array, augment: Augment) -> SignalModel:
        """Return the member in use: the current one, or the best one if the current margin is too small.

        ``current`` is its index, shape (...), and ``augment`` is Remark 4's augmentation.
        """
        instance("estimate", estimate, SignalModel)
        members = self.members(estimate, spread)
        margins = np.nan_to_num(controllability_margin(augment(members)))
        own = np.take_along_axis(margins, current[..., None], axis=-1)[..., 0]
        kept = own >= self.hysteresis * np.max(margins, axis=-1)
        at = np.where(kept, current, np.argmax(margins, axis=-1))[..., None, None, None]
        return SignalModel(*(np.take_along_axis(M, at, axis=-3)[..., 0, :, :] for M in (members.A, members.B)))


def _nodes(count: int) -> list[float]:
    """Return distinct numbers in [-1, 1], zero first: 0, 1, -1, 1/2, -1/2, 3/4, ..."""
    found, level = [0.0, 1.0, -1.0], 2
    while len(found) < count:
        for i in range(1, level, 2):
            found += [i / level, -i / level]
        level *= 2
    return found[:count]


def _lower_set(variables: int, degree: int) -> list[Array]:
    """Return points that determine each polynomial of total degree at most ``degree``, zero first.

    Interpolation is unique on nodes whose indices form a lower set, here those with a sum of at most ``degree``.
    """
    nodes = np.array(_nodes(degree + 1))
    indices: list[list[int]] = [[]]
    for _ in range(variables):
        indices = [[*head, i] for head in indices for i in range(degree + 1 - sum(head))]
    return [nodes[index] for index in indices]
