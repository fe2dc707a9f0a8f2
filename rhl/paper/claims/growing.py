"""Growing memory: with a loss that never decreases, Lemma 4 and Theorem 2(i) hold as printed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import cast

import numpy as np

from rhl._checks import Array
from rhl.losses import Convex, PseudoHuber, WeightedSquares, divergence
from rhl.losses._descent import solve
from rhl.losses._proximal import Proximal
from rhl.memory import GrowingMemory
from rhl.model import SignalModel
from rhl.paper.claims.claim import Claim, Control, Effort, Evidence, worst_of
from rhl.paper.claims.estimation import Estimates, draw_model, theta_matrix, trajectory
from rhl.paper.claims.proximal import Entropy, Mirror, Squares
from rhl.paper.published import linear_example
from rhl.simulation import simulate

# Convergence to X means this distance, relative to the data; without convergence it is at least a hundredth.
_ARRIVED = 1e-6
_WHY = "some sixty contractions, relative to the data"

# For the step k, the weights of the functions 0, ..., k in the sum; zero leaves one out.
Keep = Callable[[int], Array]


def keep_all(k: int) -> Array:
    """Return the weights of a memory that grows."""
    return np.ones(k + 1)


def keep_latest(k: int, window: int = 1) -> Array:
    """Return the weights of a window."""
    return np.where(np.arange(k + 1) > k - window, 1.0, 0.0)


def keep_fading(k: int, factor: float = 0.5) -> Array:
    """Return the weights of a memory with forgetting: one step back has the weight ``factor``."""
    return factor ** np.arange(k, -1, -1.0)


def iterate_sums(
    rows: Array, aims: Array, loss: Callable[[Array], Convex], g: Mirror, start: Array, mixing: Array, keep: Keep
) -> tuple[Array, Array]:
    r"""Run (20) on :math:`f(x,k) = \sum_{j\le k} w_j(k)\,\varphi(b_j - a_j^\top x)`; return minimisers and centres.

    ``rows`` (K, d), ``aims`` (K,): a_j and b_j. ``loss``: from the weights of the residuals to their loss.
    ``start`` (d,), ``mixing`` (K,): as in ``iterate``. The sum is minimised by the estimator's own Newton's method.
    Shapes (K, d) and (K+1, d).
    """
    centres, minimisers = [np.asarray(start, dtype=np.float64)], []
    for k, lam in enumerate(mixing):
        met = np.flatnonzero(keep(k))
        problem = Proximal(aims[met], rows[met], loss(keep(k)[met]), cast(Convex, g), centres[-1])
        minimisers.append(solve(problem))
        centres.append((1 - lam) * minimisers[-1] + lam * centres[-1])
    return np.array(minimisers), np.array(centres)


def check_growing(effort: Effort, keep: Keep = keep_all) -> Evidence:
    """Check that iterations converge into X, and that the sums of f(x*_{k+1}, j) over k obey Lemma 4's bound for all j.

    The first functions are steep and each occurs once; later ones are ever flatter, so their sum determines the limit
    only with memory. ``keep``: the weights of the memory.
    """
    rng, found, steps = effort.rng("lemma-4.growing"), [], 60
    for case in range(max(6, effort.cases // 8)):
        d = int(rng.integers(2, 5))
        rank = int(rng.integers(1, d + 1))
        basis = np.linalg.qr(rng.standard_normal((d, d)))[0][:rank]
        later = rng.standard_normal((steps - rank, rank)) @ basis
        rows = np.concatenate([2 * basis, later * 0.7 ** np.arange(steps - rank)[:, None]])
        target, start = rng.uniform(0.5, 2.0, (2, d))
        g: Mirror = Entropy() if case % 3 == 2 else Squares(float(rng.uniform(0.5, 2.0)))
        loss = partial(PseudoHuber, 1.0) if case % 2 else WeightedSquares
        aims, lambda_max = rows @ target, 0.6
        mixing = rng.uniform(0, lambda_max, steps)
        minimisers, centres = iterate_sums(rows, aims, loss, g, start, mixing, keep)
        found.append(float(np.max(np.abs(rows @ centres[-1] - aims))))
        # f(., j) is the sum of the functions 0, ..., j; from step j on it occurs at every step.
        losses = [[float(loss(np.ones(1)).value(b - a @ x[:, None])) for a, b in zip(rows, aims, strict=True)]
                  for x in minimisers]  # fmt: skip
        sums = np.cumsum(np.cumsum(losses, axis=1)[::-1], axis=0)[::-1]
        allowed = float(divergence(g, target, start)) / (1 - lambda_max)
        found.append(max(float(sums[j, j]) for j in range(steps)) / allowed - 1)
    return Evidence(len(found), worst_of([0.0, *found]), _ARRIVED, _WHY)


def remember(
    x: Array, u: Array, initial: SignalModel, mixing: Array, weight: float = 1.0, forgetting: float = 1.0
) -> Estimates:
    """Run the library's growing memory on recorded x, shape (K+1, n), and u, shape (K, q).

    ``initial``: theta~(0). ``mixing`` (K,): lambda_1, ..., lambda_K. ``weight``: of the proximal term.
    ``forgetting``: the factor on the weight of every transition at each step; one means no forgetting.
    """
    memory, best, models = GrowingMemory(weight), list[SignalModel](), [initial]
    data = memory.begin(initial.n, initial.q)
    for k, lam in enumerate(mixing, start=1):
        data = memory.remember(np.sqrt(forgetting) * data, x[[k, k - 1]], u[[k - 1]])
        best.append(memory.minimise(models[-1], data))
        models.append(best[-1].mix(models[-1], lam))
    return Estimates(x, u, 1, best, models)


def spiral_against(steps: int, forgetting: float = 1.0) -> Estimates:
    """Make the spiral's inputs nearly orthogonal to the growing memory's own estimate.

    The data are those of ``spiral_estimates`` with this estimator instead of a window. ``forgetting``: as above; zero
    is a window of one transition.
    """
    memory = GrowingMemory(1.0)
    models, u = [SignalModel(np.zeros((1, 1)), np.array([[1.0, 0.0]]))], np.zeros((steps, 2))
    data, x = memory.begin(1, 2), np.zeros((steps + 1, 1))
    for k in range(1, steps + 1):
        b = models[-1].B[0] / max(np.hypot(*models[-1].B[0]), np.finfo(float).tiny)
        delta = 0.5 * k**-0.75
        u[k - 1] = delta * b + np.sqrt(1 - delta**2) * np.array([b[1], -b[0]])
        data = memory.remember(np.sqrt(forgetting) * data, x[[k, k - 1]], u[[k - 1]])
        models.append(memory.minimise(models[-1], data))
    return Estimates(x, u, 1, models[1:], models)


def all_residuals(record: Estimates, model: SignalModel) -> Array:
    """Return x(j) - A x(j-1) - B u(j-1) of every transition of a record, shape (K, n)."""
    return record.x[1:] - np.hstack([record.x[:-1], record.u]) @ theta_matrix(model).T


def missed(record: Estimates) -> float:
    """Return the largest residual of the last model over all transitions, relative to the largest signal."""
    size = max(float(np.max(np.abs(record.x))), float(np.max(np.abs(record.u))))
    return float(np.max(np.abs(all_residuals(record, record.models[-1])))) / size


def example_run(steps: int = 160, growing: bool = True) -> Estimates:
    """Run the linear example's closed loop, with the growing memory of weight one or the paper's window.

    The record begins when the stacks are full of measurements, and the growing memory begins there too.
    """
    example = linear_example()
    scheme = replace(example.scheme, estimator=GrowingMemory(1.0)) if growing else example.scheme
    trace = simulate(scheme, example.plant, example.z0, steps)
    first, (x, u) = scheme.first_measured, trace.lifted
    models = [trace.model(k) for k in range(first - 1, steps)]
    # Without mixing theta*(k) is theta~(k). trace.lifted holds u(k-1) with x(k).
    return Estimates(x[first - 1 :], u[first:], 1, models[1:], models)


def check_estimator(effort: Effort, forgetting: float = 1.0) -> Evidence:
    r"""Check that the library's growing memory ends at a model that fits every transition, on three kinds of data.

    They are the spiral's, the linear example's in closed loop, and random ones with mixing, for which also
    :math:`\sum_k \sum_{j\le k} |x(j) - \Theta^*(k)\varphi(j-1)|^2` is compared with its bound.
    ``forgetting``: as in ``remember``; the loop of the example keeps everything.
    """
    rng, steps, lambda_max = effort.rng("theorem-2.i.growing"), 80, 0.6
    records = [spiral_against(1000, forgetting), example_run()]
    found = []
    for _ in range(max(4, effort.cases // 8)):
        n, q = (int(size) for size in rng.integers(1, 4, 2))
        truth, initial = draw_model(rng, n, q), draw_model(rng, n, q)
        u = rng.standard_normal((steps, q)) * float(rng.choice([0.0, 0.8, 1.0])) ** np.arange(steps)[:, None]
        x, weight = trajectory(truth, rng.standard_normal(n), u), 1e-12
        record = remember(x, u, initial, rng.uniform(0, lambda_max, steps), weight, forgetting)
        total = sum(np.sum(all_residuals(record, of)[: k + 1] ** 2) for k, of in enumerate(record.best))
        # Smaller sums are squares of rounding errors of the data.
        allowed = weight * record.distances(truth.theta)[0] ** 2 / (1 - lambda_max) + 1e-24 * np.sum(x**2)
        records.append(record)
        found.append(float(total / allowed) - 1)
    for record in records:
        half = np.array([model.theta for model in record.models[len(record.models) // 2 :]])
        found += [missed(record), float(np.max(np.ptp(half, axis=0))) if len(half) > 100 else 0.0]
    return Evidence(len(found), worst_of([0.0, *found]), _ARRIVED, _WHY)


_claim = partial(Claim, test="tests/paper/claims/test_growing.py")

LEMMA: tuple[Claim, ...] = (
    _claim(
        "lemma-4.growing",
        "Lemma 4",
        "timevaryingmin",
        "If f(x,k) never decreases in k, for any x, Lemma 4 holds as printed: the iterates converge to a point of X, "
        "and the sum of f(x*_{k+1}, j) over k is finite for every j.",
        "numerical sampling",
        "holds",
        page="notebooks/09-lemma-4.ipynb",
        stated=check_growing,
        control=Control("functions whose weights are halved at every step", partial(check_growing, keep=keep_fading)),
        uses=("eq-46", "lemma-4.weak"),
        proof="notebooks/09-lemma-4.ipynb#proof-growing",
    ),
)

THEOREM: tuple[Claim, ...] = (
    _claim(
        "theorem-2.i.growing",
        "Theorem 2(i)",
        "xxx",
        "With an estimator that keeps every transition since the window was first full of measurements, Theorem 2(i) "
        "holds as printed: the estimates converge to a model that fits every transition.",
        "numerical sampling",
        "holds",
        page="notebooks/11-theorem-2.ipynb",
        stated=check_estimator,
        control=Control("a memory that drops old data, on the spiral's data", partial(check_estimator, forgetting=0.5)),
        uses=("assumption-6", "assumption-7", "lemma-4.growing"),
        proof="notebooks/11-theorem-2.ipynb#proof-theorem-2-growing",
    ),
)
