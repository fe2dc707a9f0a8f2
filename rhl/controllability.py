"""Controllability margins and Lemma 5's search for a mixing weight."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol, get_args

import numpy as np

from rhl._checks import Array, choice, describe, fraction, instance, integer, numbers, positive
from rhl.errors import InputError, LostControllabilityError, RHLError
from rhl.model import PredictorMaps, SignalModel

Augment = Callable[[SignalModel], SignalModel]

# Relative to the largest singular value; rounding leaves a zero one at a few times 1e-16.
_ZERO = 1e-12


def controllability_matrix(model: SignalModel) -> Array:
    """Return [B, AB, ..., A^(n-1) B], shape (..., n, n q), as in the proof of Lemma 5.

    Examples
    --------
    >>> controllability_matrix(SignalModel([[1.0, 1.0], [0.0, 1.0]], [[0.0], [1.0]]))
    array([[0., 1.],
           [1., 1.]])
    """
    instance("model", model, SignalModel)
    blocks = [model.B]
    for _ in range(model.n - 1):
        blocks.append(model.A @ blocks[-1])
    return np.concatenate(blocks, axis=-1)


def controllability_margin(model: SignalModel) -> Array:
    """Return the smallest singular value of the controllability matrix, shape (...).

    Zero if the pair is not controllable; NaN where a power of A leaves the range of float64.

    Examples
    --------
    >>> model = SignalModel([[1.0, 0.0], [0.0, 1.0]], [[0.0], [1.0]])  # no input reaches the first state
    >>> float(controllability_margin(model))
    0.0
    """
    with np.errstate(over="ignore", invalid="ignore"):
        C = controllability_matrix(model)
    known = np.all(np.isfinite(C), axis=(-1, -2))
    least = np.linalg.svd(np.where(known[..., None, None], C, 0.0), compute_uv=False)[..., -1]
    return np.asarray(np.where(known, least, np.nan))


def s_plus(maps: PredictorMaps | SignalModel, horizon: int | None = None) -> Array:
    r"""Return the smallest nonzero singular value of :math:`[B_{N-1}, \dots, B_0]`, shape (...).

    For bounded maps Assumption 5(a), as a bound on the gain matrices, holds along a loop if and only if the infimum
    over k of this number is positive. Theorem 1* of the book uses it. Infinite where all :math:`B_i` are zero,
    since then no input is planned; NaN where a power of A leaves the range of float64. Singular values below 1e-12 of
    the largest count as zero, since rounding leaves them no larger.

    For a model of order n, steps beyond the n-th do not decrease it, since they add to the same subspace. In an
    unstable model they make the largest singular value so large that rounding hides small ones, so use fewer steps.

    Parameters
    ----------
    maps : PredictorMaps or SignalModel
        The maps, or a model whose powers give them, equation (21).
    horizon : int, optional
        N, for a model.

    Examples
    --------
    >>> model = SignalModel([[1.0, 0.0], [0.0, 1.0]], [[0.0], [2.0]])  # no input reaches the first state
    >>> float(s_plus(model, horizon=1))
    2.0
    """
    instance("maps", maps, PredictorMaps, SignalModel)
    if isinstance(maps, PredictorMaps):
        BB = np.concatenate(np.moveaxis(maps.B, -3, 0), axis=-1)
    else:
        blocks = [maps.B]
        with np.errstate(over="ignore", invalid="ignore"):
            for _ in range(integer("horizon", horizon, 1) - 1):
                blocks.append(maps.A @ blocks[-1])
        BB = np.concatenate(blocks, axis=-1)
    known = np.all(np.isfinite(BB), axis=(-1, -2))
    found = np.linalg.svd(np.where(known[..., None, None], BB, 0.0), compute_uv=False)
    counted = (found > 0) & (found > _ZERO * found[..., :1])
    return np.asarray(np.where(known, np.min(np.where(counted, found, np.inf), axis=-1), np.nan))


class Mixing(Protocol):
    """Chooses lambda_k of equation (15): any object with this function can be a scheme's mixing.

    Examples
    --------
    >>> class Half:
    ...     def choose(self, estimate, previous, augment):
    ...         return np.full(estimate.A.shape[:-2], 0.5)
    >>> model = SignalModel([[1.0]], [[1.0]])
    >>> float(chosen(Half(), model, model, lambda pair: pair))
    0.5
    """

    def choose(self, estimate: SignalModel, previous: SignalModel, augment: Augment) -> Array:
        """Return lambda in [0, 1), a number or shape (...), for (1 - lambda) estimate + lambda previous."""


@dataclass(frozen=True)
class ConstantMixing:
    """The same lambda at every step, ``lam`` in [0, 1); 0 is no mixing.

    Examples
    --------
    >>> model = SignalModel([[1.0]], [[1.0]])
    >>> float(ConstantMixing(0.5).choose(model, model, lambda pair: pair))
    0.5
    """

    lam: float = 0.0

    def __post_init__(self) -> None:
        fraction("lam", self.lam)

    def choose(self, estimate: SignalModel, previous: SignalModel, augment: Augment) -> Array:
        """Return the constant, one for each member of the batch."""
        return np.full(estimate.A.shape[:-2], float(self.lam))


Count = Literal["lemma", "sharp"]


def candidates(n: int, lambda_max: float, count: Count = "lemma") -> Array:
    """Return equidistant weights in (0, lambda_max), enough that at least one keeps controllability.

    For a pair of order n there are 2 n^2 + 1, as in Lemma 5 ("lemma"), or n(n+1)/2 ("sharp"). The latter is the least
    sufficient number if the estimate is not controllable, an observation of this project that the book proves.
    InputError if lambda_max is outside (0, 1).

    Examples
    --------
    >>> len(candidates(3, 0.9)), len(candidates(3, 0.9, "sharp"))
    (19, 6)
    """
    positive("lambda_max", lambda_max)
    fraction("lambda_max", lambda_max)
    n = integer("n", n, 1)
    choice("count", count, get_args(Count))
    number = 2 * n**2 + 1 if count == "lemma" else n * (n + 1) // 2
    return lambda_max * np.arange(1, number + 1) / (number + 1)


@dataclass(frozen=True)
class LambdaSearch:
    r"""Lemma 5's search: mix only if the estimate is not controllable.

    If the estimate's margin reaches ``least_margin``, lambda is 0. Otherwise the candidates in
    :math:`(0, \lambda_{max})` are tried, :math:`2n^2+1` of them as in the lemma, which says that at least one gives a
    controllable pair, because :math:`\det(C C^\top)` is a polynomial of degree at most :math:`2n^2` in lambda.
    Source: Lemma 5 (Lemma 4 in versions without Lemma 1) and Theorem 2(iii).

    Parameters
    ----------
    pair : {"lifted", "augmented"}
        The pair that stays controllable: the lifted one, as in Theorem 2(iii), or Remark 4's augmented pair, which the
        controller uses. The first does not imply the second.
    rule : {"first", "best"}
        Take the first candidate that reaches the margin (the paper's), or the one with the largest margin.
    lambda_max : float
        In (0, 1).
    least_margin : float
        The least singular value of the controllability matrix that counts as controllable in floating point. For the
        augmented pair it is a lower bound of :func:`s_plus` over any horizon of n' steps or more, so a run in which
        the search never fails satisfies Theorem 3' of the book.
    count : {"lemma", "sharp"}
        The number of candidates: :math:`2n^2+1` as in the lemma, or the sharp :math:`n(n+1)/2`.

    Examples
    --------
    >>> lost, kept = SignalModel([[1.0]], [[0.0]]), SignalModel([[1.0]], [[1.0]])
    >>> lam = LambdaSearch(lambda_max=0.8).choose(lost, kept, lambda pair: pair)
    >>> bool(controllability_margin(lost.mix(kept, lam)) > 0.5)
    True
    """

    pair: Literal["lifted", "augmented"] = "augmented"
    rule: Literal["first", "best"] = "best"
    lambda_max: float = 0.9
    least_margin: float = 1e-9
    count: Count = "lemma"

    def __post_init__(self) -> None:
        choice("pair", self.pair, ("lifted", "augmented"))
        choice("rule", self.rule, ("first", "best"))
        choice("count", self.count, get_args(Count))
        positive("lambda_max", self.lambda_max)
        fraction("lambda_max", self.lambda_max)
        positive("least_margin", self.least_margin)

    def choose(self, estimate: SignalModel, previous: SignalModel, augment: Augment) -> Array:
        """Search lambda, shape (...), for every member of the batch; LostControllabilityError if every candidate fails.

        ``estimate`` is theta*(k), perhaps not controllable, ``previous`` is theta~(k-1), controllable, and ``augment``
        is Remark 4's augmentation, called if ``pair`` is "augmented".
        """
        view: Augment = augment if self.pair == "augmented" else lambda model: model
        lost = ~(controllability_margin(view(estimate)) >= self.least_margin)
        lead = np.broadcast_shapes(lost.shape, previous.A.shape[:-2])
        lost, chosen = np.broadcast_to(lost, lead), np.zeros(lead)
        # Usually every member is controllable, and no candidate is needed.
        if np.any(lost):
            chosen[lost] = self._search(_members(estimate, lost, lead), _members(previous, lost, lead), view)
        return chosen

    def _search(self, estimate: SignalModel, previous: SignalModel, view: Augment) -> Array:
        """Search lambda for members, shape (members, 1), none of which is controllable."""
        lam = candidates(view(estimate).n, self.lambda_max, self.count)
        margins = np.nan_to_num(controllability_margin(view(estimate.mix(previous, lam))))
        enough = margins >= self.least_margin
        if not np.all(np.any(enough, axis=-1)):
            raise LostControllabilityError(
                f"no lambda in (0, {self.lambda_max:g}) keeps the {self.pair} pair's margin above "
                f"{self.least_margin:g} (largest found {np.min(np.max(margins, axis=-1)):.3g}); "
                "widen lambda_max, lower least_margin, mix by a constant, "
                "or start from a model with a larger margin"
            )
        return np.asarray(lam[np.argmax(enough if self.rule == "first" else margins, axis=-1)])


def _members(model: SignalModel, those: np.ndarray, lead: tuple[int, ...]) -> SignalModel:
    """Return some members of a batch with an axis for candidates, shape (members, 1)."""
    A, B = (np.broadcast_to(M, (*lead, *M.shape[-2:]))[those][:, None] for M in (model.A, model.B))
    return SignalModel(A, B)


def chosen(mixing: Mixing, estimate: SignalModel, previous: SignalModel, augment: Augment) -> Array:
    """Return the lambda in [0, 1) that a mixing, possibly the user's own, chooses for each member of the batch.

    InputError if it chooses anything else; exceptions of the user's own mixing pass through.
    """
    lead = np.broadcast_shapes(estimate.A.shape[:-2], previous.A.shape[:-2])
    name, each = type(mixing).__name__, f" for each member of the batch, shape {lead}" if lead else ""
    asked = f"{name}.choose must return a lambda in [0, 1){each}, got "
    try:
        found = mixing.choose(estimate, previous, augment)
    except Exception as error:
        if not isinstance(error, RHLError):
            error.add_note(f"the function 'choose' of {name} raised this")
        raise
    try:
        lam = numbers(found)
    except Exception:  # ragged, complex, strings, or any error of the object's own conversion
        raise InputError(asked + describe(found)) from None
    if lam.shape not in ((), lead):
        raise InputError(f"{asked}shape {lam.shape}")
    if not np.all((lam >= 0) & (lam < 1)):
        raise InputError(f"{asked}{lam[~((lam >= 0) & (lam < 1))][0]:g}")
    return np.broadcast_to(lam, lead)
