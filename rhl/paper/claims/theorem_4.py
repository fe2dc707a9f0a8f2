"""Theorem 4: a scheme that needs no Assumption 5, this project's own and reviewed by nobody else."""

from __future__ import annotations

from fractions import Fraction
from functools import cache, partial
from typing import Any

import numpy as np

from rhl._checks import Array
from rhl.controllability import controllability_margin
from rhl.errors import DivergedError
from rhl.family import ModelFamily
from rhl.lifting import DelayLifting
from rhl.memory import GrowingMemory
from rhl.model import SignalModel
from rhl.paper.claims.claim import Claim, Control, Effort, Evidence, worst_of
from rhl.paper.claims.estimation import draw_model, estimate, trajectory
from rhl.paper.claims.theorem_3 import end_over_peak
from rhl.plants import LinearPlant
from rhl.plants.analysis import observability, pbh, signal_model
from rhl.schedules import PowerDecay
from rhl.scheme import Controller, Scheme
from rhl.simulation import simulate
from rhl.trace import Trace

_claim = partial(Claim, page="notebooks/24-theorem-4.ipynb", test="tests/paper/claims/test_theorem_4.py")
_STEPS = 200
_AT_REST = 1e-2
_ROUNDING = 1e-9
# Outputs, inputs and m; plants have order p m, so that their augmented pair is controllable.
_SIZES = ((1, 1, 1), (1, 1, 2), (1, 1, 3), (2, 1, 1), (2, 2, 1))


def family_scheme(p: int, q: int, m: int, initial: SignalModel | None = None, alone: bool = False) -> Scheme:
    """Return the scheme of Theorem 4 for plants of order p m; ``alone``: with no other initial model than the one."""
    n = p * m
    family = ModelFamily.grid(p, m, q, m)
    return Scheme(
        DelayLifting(m, m),
        GrowingMemory(1e-4),
        Controller(1.0, 1.0, 1.0, max(20, 2 * (n + (m - 1) * q)), PowerDecay(10, 2)),
        silent_model(p, q, m) if initial is None else initial,
        family=ModelFamily(family.shifts[:1]) if alone else family,
    )


def silent_model(p: int, q: int, m: int) -> SignalModel:
    """Return a model that moves stacked outputs along and thinks that no input does anything: not controllable."""
    shift = SignalModel.shift_of_ones(p, m, q, m)
    return SignalModel(shift.A, np.where(np.arange(p * m)[:, None] < p, 0.0, shift.B))


def draw_plant(rng: np.random.Generator, p: int, q: int, m: int) -> LinearPlant:
    """Draw a plant of order p m, of spectral radius 1.1, controllable, and observable from m outputs."""
    n = p * m
    while True:
        F, G, H = rng.normal(size=(n, n)), rng.normal(size=(n, q)), rng.normal(size=(p, n))
        F *= 1.1 / np.max(np.abs(np.linalg.eigvals(F)))
        if np.linalg.cond(observability(F, H, m)) < 20 and pbh(F, G) > 0.2:
            return LinearPlant(F, G, H)


@cache
def runs(seed: int, cases: int, alone: bool = False) -> tuple[Trace | None, ...]:
    """Run the scheme of Theorem 4 from a silent initial model on random plants; None where a run left float64."""
    rng, found = Effort(seed).rng("theorem-4"), list[Trace | None]()
    for p, q, m in _SIZES:
        for _ in range(max(2, cases // 40)):
            plant, z0 = draw_plant(rng, p, q, m), rng.normal(size=p * m)
            try:
                found.append(simulate(family_scheme(p, q, m, alone=alone), plant, z0 / np.linalg.norm(z0), _STEPS))
            except DivergedError:
                found.append(None)
    return tuple(found)


def check_rest(effort: Effort, alone: bool = False) -> Evidence:
    """Look whether state and input come to rest. ``alone``: with the initial model alone."""
    found = [
        np.inf if trace is None else float(end_over_peak(trace)) for trace in runs(effort.seed, effort.cases, alone)
    ]
    return Evidence(len(found), worst_of(found), _AT_REST, "what is left of slow modes after 200 steps")


def check_margin(effort: Effort, alone: bool = False) -> Evidence:
    """Look whether the margin in use falls below the share of the largest one that the hysteresis keeps.

    The largest margin of the family is at least the one that the shift nearest to the truth's has; that is checked by
    ``check_grid``. Here: at the end of a run the model in use has at least a thousandth of the true pair's margin.
    """
    found = []
    for trace in runs(effort.seed, effort.cases, alone):
        if trace is None:
            return Evidence(1, np.inf, 0.0, "a run left float64")
        family = trace.scheme.family
        assert family is not None
        memory, lifting = trace.scheme.estimator, trace.scheme.lifting
        assert isinstance(memory, GrowingMemory)
        for k in range(0, _STEPS, 20):
            done = trace.steps[k]
            assert done.data is not None
            members = family.members(done.estimate, memory.spread(done.data))
            best = float(np.max(controllability_margin(lifting.augment(members))))
            own = float(controllability_margin(lifting.augment(done.model)))
            found.append(family.hysteresis * best - own if best > 0 else np.inf)
    return Evidence(len(found), worst_of(found), 1e-12, "rounding of the margins")


def remembered(rng: np.random.Generator) -> tuple[GrowingMemory, Array, Array, Array]:
    """Draw a signal model and a trajectory of it; return a memory, the data, [A B] and the regressors [x; u]."""
    n, q = (int(size) for size in rng.integers(1, 4, 2))
    truth, memory = draw_model(rng, n, q), GrowingMemory(10.0 ** rng.uniform(-3, 1))
    u = rng.standard_normal((12, q)) * (rng.random((12, 1)) < 0.5)
    x = trajectory(truth, rng.standard_normal(n), u)
    data = memory.begin(n, q)
    for k in range(len(u)):
        data = memory.remember(data, x[[k + 1, k]], u[[k]])
    return memory, data, np.concatenate([truth.A, truth.B], axis=1), np.concatenate([x[:-1], u], axis=1)


def check_affine(effort: Effort, early: bool = False) -> Evidence:
    """Compare the library's estimate from theta_0 + G with theta^ + G M, and theta^ with theta - (theta - theta_0) M.

    ``early``: take M of the data without the last transition.
    """
    rng, found = effort.rng("theorem-4.affine"), []
    for _ in range(max(3, effort.cases // 5)):
        memory, data, truth, rows = remembered(rng)
        n, d = truth.shape
        start, G = rng.standard_normal((2, n, d))
        M = memory.spread(data)
        if early:
            M = np.asarray(memory.weight * np.linalg.inv(rows[:-1].T @ rows[:-1] + memory.weight * np.eye(d)))
        one, other = (_rows(memory.minimise(SignalModel(of[:, :n], of[:, n:]), data)) for of in (start, start + G))
        found.append(float(np.max(np.abs(other - one - G @ M))))
        found.append(float(np.max(np.abs(one - truth + (truth - start) @ M))))
    return Evidence(len(found), worst_of(found), 1e-8, "rounding through an information matrix of condition 1e6")


def _rows(model: SignalModel) -> Array:
    return np.concatenate([model.A, model.B], axis=-1)


def check_errors(effort: Effort, weight: float = 1.0) -> Evidence:
    """Check that |M(k) phi(k)|^2 is at most t_k (rho + |phi(k)|^2), where the t_k >= 0 sum to the size of phi at most.

    ``weight``: of the next data in the memory, with which the bound is tested; another one is another estimator.
    """
    rng, found = effort.rng("theorem-4.errors"), []
    for _ in range(max(3, effort.cases // 5)):
        memory, _, _, rows = remembered(rng)
        rho, d = memory.weight, rows.shape[1]
        M, total = np.eye(d), 0.0
        for phi in rows:
            after = M - np.outer(M @ phi, M @ phi) * weight / (rho + weight * phi @ M @ phi)
            t = float(np.trace(M - after))
            total += t
            size = rho + float(phi @ phi)
            found.append((float(np.sum((M @ phi) ** 2)) - t * size) / size)
            found.append(total - d)
            M = after
    return Evidence(len(found), worst_of(found), _ROUNDING, "rounding of the traces")


def arx_pair(a: Any, b: Any) -> Any:
    """Return the augmented pair's controllability matrix of y(k+1) = sum a_i y(k+1-i) + sum b_i v(k+1-i), in sympy."""
    import sympy as sp

    n = len(a)
    size = 2 * n - 1
    A, B = sp.zeros(size, size), sp.zeros(size, 1)
    A[0, :n] = sp.Matrix([a])
    A[0, n:] = sp.Matrix([b[1:]]) if n > 1 else sp.zeros(1, 0)
    for i in range(1, n):
        A[i, i - 1] = 1
    for i in range(n + 1, size):
        A[i, i - 1] = 1
    B[0, 0] = b[0]
    if n > 1:
        B[n, 0] = 1
    return sp.Matrix.hstack(*[A**i * B for i in range(size)])


def check_resultant(effort: Effort, other: bool = False) -> Evidence:
    """Compare the determinant with the resultant of numerator and denominator, with symbols, for n = 1, 2, 3.

    ``effort`` is not used: nothing is drawn. ``other``: take the denominator with the opposite signs.
    """
    import sympy as sp

    s, faults = sp.Symbol("s"), 0
    for n in (1, 2, 3):
        a, b = sp.symbols(f"a1:{n + 1}"), sp.symbols(f"b1:{n + 1}")
        sign = 1 if other else -1
        below = s**n + sign * sum(a[i] * s ** (n - 1 - i) for i in range(n))
        above = sum(b[i] * s ** (n - 1 - i) for i in range(n))
        resultant = sp.expand(sp.resultant(below, above, s)) if n > 1 else b[0]
        determinant = sp.expand(arx_pair(list(a), list(b)).det(method="berkowitz"))
        faults += sp.expand(determinant - resultant) != 0 and sp.expand(determinant + resultant) != 0
    return Evidence(3, float(faults))


def monomials(variables: int, degree: int) -> list[tuple[int, ...]]:
    """Return the exponents of all monomials of total degree at most ``degree``."""
    if variables == 0:
        return [()]
    return [(i, *rest) for i in range(degree + 1) for rest in monomials(variables - 1, degree - i)]


def determined(p: int, q: int, m: int) -> list[tuple[int, ...]]:
    """Return the monomials that the grid for these sizes has to tell apart, as exponents of the entries of G."""
    if p == q == 1:
        return [(*one, *other) for one in monomials(m, m - 1) for other in monomials(m, m)]
    n = p * m + q * (m - 1)
    return monomials(p * (p * m + q * m), sum(n - i // q for i in range(n)))


def check_grid(effort: Effort, drop: bool = False) -> Evidence:
    """Find by how much the rank of the grid's monomials falls short of their number, exactly, modulo a prime.

    ``effort`` is not used: nothing is drawn. ``drop``: leave the last point of each grid out.
    """
    prime, short = 2_147_483_629, 0
    for p, q, m in _SIZES:
        shifts, wanted = ModelFamily.grid(p, m, q, m).shifts, determined(p, q, m)
        points = shifts.reshape(len(shifts), -1)
        rows = []
        for point in points[: len(points) - drop]:
            exact = [Fraction(value) for value in point]
            values = [entry.numerator * pow(entry.denominator, -1, prime) % prime for entry in exact]
            powers = [[pow(value, i, prime) for i in range(max(map(sum, wanted)) + 1)] for value in values]
            row = []
            for exponents in wanted:
                term = 1
                for i, e in enumerate(exponents):
                    term = term * powers[i][e] % prime
                row.append(term)
            rows.append(row)
        short += len(wanted) - _rank(rows, prime)
    return Evidence(len(_SIZES), float(short), 0.0, "a rank modulo a prime is at most the rank")


def _rank(rows: list[list[int]], prime: int) -> int:
    """Return the rank of a matrix of integers modulo a prime below 2^31."""
    M, rank = np.array(rows, dtype=np.int64), 0
    for column in range(M.shape[1]):
        pivots = np.flatnonzero(M[rank:, column])
        if len(pivots) == 0:
            continue
        M[[rank, rank + pivots[0]]] = M[[rank + pivots[0], rank]]
        M[rank] = M[rank] * pow(int(M[rank, column]), -1, prime) % prime
        below = M[rank + 1 :, column].copy()
        M[rank + 1 :] = (M[rank + 1 :] - below[:, None] * M[rank] % prime) % prime
        rank += 1
        if rank == len(M):
            break
    return rank


def check_window(effort: Effort, mixed: bool = False) -> Evidence:
    """See the paper's own estimator, with a window and mixing, move initial models affinely.

    A third initial model lies on the line through two others, and must stay on the line through their estimates; and
    the true model must stay where it is. ``mixed``: let the second mix by other constants.
    """
    rng, found = effort.rng("theorem-4.window"), []
    for _ in range(max(3, effort.cases // 10)):
        n, q, window = (int(size) for size in rng.integers(1, 4, 3))
        truth, u = draw_model(rng, n, q), rng.standard_normal((20, q))
        x, lam = trajectory(truth, rng.standard_normal(n), u), rng.uniform(0, 0.5, 20)
        starts = [draw_model(rng, n, q) for _ in range(2)]
        lams = [lam, 0.5 * lam + 0.4 if mixed else lam]
        ends = [estimate(x, u, start, window, by, window).models[-1] for start, by in zip(starts, lams, strict=True)]
        third = SignalModel(
            *(0.3 * one + 0.7 * two for one, two in ((starts[0].A, starts[1].A), (starts[0].B, starts[1].B)))
        )
        end = estimate(x, u, third, window, lam, window).models[-1]
        said = 0.3 * _rows(ends[0]) + 0.7 * _rows(ends[1])
        found.append(float(np.max(np.abs(said - _rows(end)))))
        kept = estimate(x, u, truth, window, lam, window).models[-1]
        found.append(float(np.max(np.abs(_rows(kept) - _rows(truth)))))
    return Evidence(len(found), worst_of(found), _ROUNDING, "rounding of twenty regressions")


def check_controllable(effort: Effort, larger: int = 0) -> Evidence:
    """See that the true augmented pair of a minimal plant of order p m is controllable.

    ``larger``: by how much more than m is stacked.
    """
    rng, short = effort.rng("theorem-4.controllable"), []
    for _ in range(max(3, effort.cases // 5)):
        p, q, m = (int(size) for size in rng.integers(1, 3, 3))
        plant = draw_plant(rng, p, q, m)
        more = m + larger
        augmented = DelayLifting(more, more).augment(signal_model(plant.F, plant.G, plant.H, more))
        short.append(1e-8 - float(controllability_margin(augmented)))
    return Evidence(len(short), worst_of(short), 0.0, "plants are drawn with margins far above 1e-8")


_PROOF = "notebooks/24-theorem-4.ipynb#proof-theorem-4"

CLAIMS: tuple[Claim, ...] = (
    _claim(
        "theorem-4",
        "Theorem 4",
        "",
        "For controllable plants of order mp that are observable from m outputs, the scheme with a family of initial "
        "models brings state and input to zero, whatever the initial model, and without Assumption 5.",
        method="simulation",
        recorded="holds",
        stated=check_rest,
        control=Control(
            "the initial model alone, which thinks that no input does anything", partial(check_rest, alone=True)
        ),
        uses=(
            "theorem-1.star",
            "theorem-4.affine",
            "theorem-4.errors",
            "theorem-4.grid",
            "theorem-4.controllable",
            "theorem-4.hysteresis",
            "lemma-6.index",
            "remark-4",
            "eq-21",
            "lemma-6.converse",
        ),
        proof=_PROOF,
    ),
    _claim(
        "theorem-4.affine",
        "Theorem 4",
        "",
        "With growing memory and a fixed centre the estimate from theta_0 + G is theta^ + G M, and theta^ is "
        "theta - (theta - theta_0) M.",
        method="numerical sampling",
        recorded="holds",
        stated=check_affine,
        control=Control("M of the data without the last transition", partial(check_affine, early=True)),
        uses=("remark-2", "assumption-7"),
        proof=_PROOF,
    ),
    _claim(
        "theorem-4.errors",
        "Theorem 4",
        "",
        "One-step errors obey |M phi|^2 <= t_k (rho + |phi|^2) with t_k >= 0 that sum to at most the size of phi.",
        method="numerical sampling",
        recorded="holds",
        stated=check_errors,
        control=Control("data that count a tenth in the memory", partial(check_errors, weight=0.1)),
        uses=("theorem-4.affine",),
        proof=_PROOF,
    ),
    _claim(
        "theorem-4.resultant",
        "Theorem 4",
        "",
        "For one input and output with as many of both stacked, n = 1, 2, 3, the determinant of the augmented pair's "
        "controllability matrix is the resultant of numerator and denominator, up to its sign.",
        method="symbolic identity",
        recorded="holds",
        stated=check_resultant,
        control=Control("the denominator with opposite signs", partial(check_resultant, other=True)),
        proof="notebooks/24-theorem-4.ipynb#proof-resultant",
    ),
    _claim(
        "theorem-4.grid",
        "Theorem 4",
        "",
        "The grid determines every polynomial of the minors' degrees: n - 1 in the coefficients of outputs and n in "
        "those of inputs for one of each, Lemma 5's degree for several.",
        method="exact arithmetic",
        recorded="holds",
        stated=check_grid,
        control=Control("a point of the grid left out", partial(check_grid, drop=True)),
        uses=("theorem-4.resultant", "lemma-5.minors"),
        proof=_PROOF,
    ),
    _claim(
        "theorem-4.hysteresis",
        "Theorem 4",
        "",
        "Along the runs the model in use keeps the share of the family's largest margin that the hysteresis asks for.",
        method="simulation",
        recorded="holds",
        stated=check_margin,
        control=Control("the initial model alone", partial(check_margin, alone=True)),
        uses=("theorem-4.grid",),
        proof=_PROOF,
    ),
    _claim(
        "theorem-4.controllable",
        "Theorem 4",
        "",
        "A controllable plant of order mp that is observable from m outputs has a controllable augmented pair.",
        method="numerical sampling",
        recorded="holds",
        stated=check_controllable,
        control=Control("m + 1 outputs and inputs stacked", partial(check_controllable, larger=1)),
        uses=("remark-4", "eq-55"),
        proof=_PROOF,
    ),
    _claim(
        "theorem-4.window",
        "Theorem 4",
        "",
        "The paper's own estimator, with a window and any mixing weights that do not depend on the model, moves "
        "initial models affinely too, and keeps the truth where it is.",
        method="numerical sampling",
        recorded="holds",
        stated=check_window,
        control=Control("mixing weights that differ from model to model", partial(check_window, mixed=True)),
        uses=("eq-20", "remark-2"),
        proof="notebooks/24-theorem-4.ipynb#proof-theorem-4-window",
    ),
)
