"""Theorem 4: a scheme of this project without Assumption 5, not reviewed by others."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial

import numpy as np

from rhl._checks import Array
from rhl.controllability import controllability_margin, controllability_matrix
from rhl.controller import Controller
from rhl.errors import DivergedError
from rhl.family import ModelFamily
from rhl.lifting import DelayLifting
from rhl.memory import GrowingMemory
from rhl.model import SignalModel
from rhl.paper.claims.claim import Claim, Control, Effort, Evidence, worst_of
from rhl.paper.claims.estimation import draw_model, estimate, theta_matrix, trajectory
from rhl.paper.claims.theorem_3 import end_over_peak
from rhl.paper.claims.theorem_4_grid import SIZES, check_grid, check_resultant, determined, monomials
from rhl.plants import LinearPlant
from rhl.plants.analysis import observability, pbh, signal_model
from rhl.schedules import PowerDecay
from rhl.scheme import Scheme
from rhl.simulation import simulate
from rhl.trace import Trace

_claim = partial(Claim, page="notebooks/24-theorem-4.ipynb", test="tests/paper/claims/test_theorem_4.py")
_STEPS = 200
_AT_REST = 1e-2
_ROUNDING = 1e-9


def family_scheme(p: int, q: int, m: int, initial: SignalModel | None = None, alone: bool = False) -> Scheme:
    """Return the scheme of Theorem 4 for plants of order p m; ``alone``: with a single initial model."""
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
    """Return a model that shifts stacked outputs, in which no input has an effect: not controllable."""
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
    """Run the scheme of Theorem 4 from a silent initial model on random plants; None if a run left float64."""
    rng, found = Effort(seed).rng("theorem-4"), list[Trace | None]()
    for p, q, m in SIZES:
        for _ in range(max(2, cases // 40)):
            plant, z0 = draw_plant(rng, p, q, m), rng.normal(size=p * m)
            try:
                found.append(simulate(family_scheme(p, q, m, alone=alone), plant, z0 / np.linalg.norm(z0), _STEPS))
            except DivergedError:
                found.append(None)
    return tuple(found)


def check_rest(effort: Effort, alone: bool = False) -> Evidence:
    """Check that state and input converge to zero. ``alone``: with the initial model alone."""
    found = [
        np.inf if trace is None else float(end_over_peak(trace)) for trace in runs(effort.seed, effort.cases, alone)
    ]
    return Evidence(len(found), worst_of(found), _AT_REST, "the rest of slow modes after 200 steps")


def chosen_members(trace: Trace) -> tuple[Array, Array, np.ndarray]:
    """Return the margin in use, the largest in the family, and the index of the member in use; each (steps,)."""
    family, memory, augment = trace.scheme.family, trace.scheme.estimator, trace.scheme.lifting.augment
    assert family is not None
    assert isinstance(memory, GrowingMemory)
    own, best, at = [], [], []
    for done in trace.steps:
        assert done.data is not None
        spread = memory.spread(done.data)
        members = family.members(done.estimate, spread)
        own.append(float(controllability_margin(augment(done.model))))
        best.append(float(np.max(controllability_margin(augment(members)))))
        at.append(int(family.nearest(done.model, done.estimate, spread)))
    return np.array(own), np.array(best), np.array(at)


def check_changes(effort: Effort, share: float = 0.9) -> Evidence:
    """Check that the member in use keeps the share of the largest margin, and that its changes end.

    The hysteresis is 0.9, so that changes occur; without any the runs are no evidence. ``share``: the tested share.
    """
    rng, worst, changes = effort.rng("theorem-4.hysteresis"), [], 0
    for p, q, m in ((1, 1, 1), (1, 1, 2), (2, 1, 1)):
        for _ in range(max(2, effort.cases // 40)):
            scheme = family_scheme(p, q, m, SignalModel.shift_of_ones(p, m, q, m))
            assert scheme.family is not None
            scheme = replace(scheme, family=replace(scheme.family, hysteresis=0.9))
            z0 = rng.normal(size=p * m)
            own, best, at = chosen_members(simulate(scheme, draw_plant(rng, p, q, m), z0 / np.linalg.norm(z0), 80))
            changed = np.diff(at) != 0
            changes += int(np.sum(changed))
            worst += [float(np.max((share * best - own) / best)), float(np.sum(changed[40:]))]
    if changes == 0:
        return Evidence(0, np.nan, why="the member never changes")
    return Evidence(len(worst), worst_of(worst), 1e-9, "rounding of the margins")


def check_member(effort: Effort, split: bool = False) -> Evidence:
    r"""Check step 3: the members' determinants give that of the truth, and the member of E* is the truth.

    The determinant of the member of E is a polynomial in E, so interpolation of its values on the grid gives its
    value at E*, which is the true determinant: the sum of :math:`w_i \pi_k(E_i)` with weights independent of the
    data. Hence the largest is at least the true one over :math:`\Lambda = \sum |w_i|`. Members are the library's,
    from random data of random plants. ``split``: use polynomials of degree n - 1 in the columns of outputs and n in
    those of inputs, and a grid for them; M mixes the columns and so changes these degrees.
    """
    rng, found = effort.rng("theorem-4.member"), []
    for _ in range(max(6, effort.cases // 10)):
        m = int(rng.integers(1, 3))
        memory, lifting, family = (
            GrowingMemory(10.0 ** rng.uniform(-2, 1)),
            DelayLifting(m, m),
            ModelFamily.grid(1, m, 1, m),
        )
        wanted = determined(1, 1, m)
        if split:
            wanted = [(*one, *other) for one in monomials(m, m - 1) for other in monomials(m, m)]
            family = ModelFamily(family.shifts[[_at(family, e) for e in wanted]])
        shift, (row, initial) = SignalModel.shift_of_ones(1, m, 1, m), rng.normal(size=(2, 2 * m))
        truth, centre = (
            SignalModel(np.vstack([of[:m], shift.A[1:]]), np.vstack([of[m:], shift.B[1:]])) for of in (row, initial)
        )
        data, x = memory.begin(m, m), rng.normal(size=m)
        for _ in range(int(rng.integers(1, 4))):
            u = rng.normal(size=m)
            after = truth.step(x, u)
            data, x = memory.remember(data, np.stack([after, x]), u[None]), after
        hat, M = memory.minimise(centre, data), memory.spread(data)
        V = np.array([[np.prod(point ** np.array(e)) for e in wanted] for point in family.shifts[:, 0]])
        weights = np.linalg.solve(V.T, [np.prod((row - initial) ** np.array(e)) for e in wanted])
        values, true = (
            np.linalg.det(controllability_matrix(lifting.augment(of))) for of in (family.members(hat, M), truth)
        )
        found.append(float(np.abs(weights @ values - true) / (np.sum(np.abs(weights * values)) + np.abs(true))))
        own = ModelFamily(np.stack([np.zeros((1, 2 * m)), (row - initial)[None]])).members(hat, M)
        found.append(float(np.max(np.abs(theta_matrix(own)[1] - theta_matrix(truth)))))
    return Evidence(len(found), worst_of(found), 1e-8, "rounding of determinants and of interpolation")


def _at(family: ModelFamily, exponents: tuple[int, ...]) -> int:
    """Return the index of the grid's point with these node numbers; the first four nodes are 0, 1, -1, 1/2."""
    point = np.array([(0.0, 1.0, -1.0, 0.5)[e] for e in exponents])
    return int(np.argmin(np.max(np.abs(family.shifts[:, 0] - point), axis=1)))


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
    """Compare the library's estimate from theta_0 + E with theta^ + E M, and theta^ with theta - (theta - theta_0) M.

    ``early``: use M of the data without the last transition.
    """
    rng, found = effort.rng("theorem-4.affine"), []
    for _ in range(max(3, effort.cases // 5)):
        memory, data, truth, rows = remembered(rng)
        n, d = truth.shape
        start, G = rng.standard_normal((2, n, d))
        M = memory.spread(data)
        if early:
            M = np.asarray(memory.weight * np.linalg.inv(rows[:-1].T @ rows[:-1] + memory.weight * np.eye(d)))
        hat, shifted = (memory.minimise(SignalModel(of[:, :n], of[:, n:]), data) for of in (start, start + G))
        one, other = theta_matrix(hat), theta_matrix(shifted)
        found.append(float(np.max(np.abs(other - theta_matrix(ModelFamily(np.stack([0 * G, G])).members(hat, M))[1]))))
        found.append(float(np.max(np.abs(one - truth + (truth - start) @ M))))
    return Evidence(len(found), worst_of(found), 1e-8, "rounding through an information matrix of condition 1e6")


def check_errors(effort: Effort, late: bool = False) -> Evidence:
    """Check that |M(k) phi(k)|^2 is at most t_k (rho + |phi(k)|^2), where the t_k >= 0 sum to the size of phi at most.

    M(k) is the library's. ``late``: use tr M(k+1) - tr M(k) as t_k.
    """
    rng, found = effort.rng("theorem-4.errors"), []
    for _ in range(max(3, effort.cases // 5)):
        memory, _, truth, rows = remembered(rng)
        n, d = truth.shape
        data, total = memory.begin(n, d - n), 0.0
        M = memory.spread(data)
        found.append(float(np.max(np.abs(M - np.eye(d)))))
        for phi in rows:
            after = truth @ phi
            data = memory.remember(data, np.stack([after, phi[:n]]), phi[None, n:])
            then = memory.spread(data)
            t = float(np.trace(M - then))
            total += t
            size = memory.weight + float(phi @ phi)
            left = float(np.sum((M @ phi) ** 2))
            found += [(left - (float(np.trace(then)) - float(np.trace(M)) if late else t) * size) / size, -t, total - d]
            M = then
    return Evidence(len(found), worst_of(found), 1e-8, "rounding through an information matrix of condition 1e6")


def check_window(effort: Effort, mixed: bool = False) -> Evidence:
    """Check that the paper's own estimator, with a window and mixing, maps initial models affinely.

    A third initial model lies on the line through two others, and must stay on the line through their estimates; and
    the true model must not change. ``mixed``: other mixing constants for the second.
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
        said = 0.3 * theta_matrix(ends[0]) + 0.7 * theta_matrix(ends[1])
        found.append(float(np.max(np.abs(said - theta_matrix(end)))))
        kept = estimate(x, u, truth, window, lam, window).models[-1]
        found.append(float(np.max(np.abs(theta_matrix(kept) - theta_matrix(truth)))))
    return Evidence(len(found), worst_of(found), _ROUNDING, "rounding of twenty regressions")


def check_controllable(effort: Effort, larger: int = 0) -> Evidence:
    """Check that the true augmented pair of a minimal plant of order p m is controllable.

    ``larger``: number of samples stacked in addition to m.
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
        "models brings state and input to zero for every initial model, without Assumption 5.",
        method="simulation",
        recorded="holds",
        stated=check_rest,
        control=Control("the initial model alone, in which no input has an effect", partial(check_rest, alone=True)),
        uses=(
            "theorem-1.star",
            "theorem-4.affine",
            "theorem-4.errors",
            "theorem-4.member",
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
        "With growing memory and a fixed centre the estimate from theta_0 + E is theta^ + E M, and theta^ is "
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
        "One-step errors obey |M phi|^2 <= t_k (rho + |phi|^2) with t_k >= 0 that sum to at most the number of entries "
        "of phi.",
        method="numerical sampling",
        recorded="holds",
        stated=check_errors,
        control=Control("the decrease of the trace with the opposite sign", partial(check_errors, late=True)),
        uses=("theorem-4.affine",),
        proof=_PROOF,
    ),
    _claim(
        "theorem-4.resultant",
        "Theorem 4",
        "",
        "For one input and output with as many of both stacked, n = 1, 2, 3, the determinant of the augmented pair's "
        "controllability matrix is the resultant of numerator and denominator, up to sign.",
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
        "The grid determines every polynomial in all entries of E of the minors' total degree: 2n - 1 for one input "
        "and output, Lemma 5's degree for several.",
        method="exact arithmetic",
        recorded="holds",
        stated=check_grid,
        control=Control("a point of the grid left out", partial(check_grid, drop=True)),
        uses=("theorem-4.resultant", "lemma-5.minors"),
        proof=_PROOF,
    ),
    _claim(
        "theorem-4.member",
        "Theorem 4",
        "",
        "The member of E* is the truth at every k, and the members' determinants give the true one with weights "
        "independent of the data, so the largest is bounded below.",
        method="numerical sampling",
        recorded="holds",
        stated=check_member,
        control=Control("degrees counted by columns, on a grid for them", partial(check_member, split=True)),
        uses=("theorem-4.affine", "theorem-4.grid", "theorem-4.controllable"),
        proof=_PROOF,
    ),
    _claim(
        "theorem-4.hysteresis",
        "Theorem 4",
        "",
        "The model in use keeps the hysteresis's share of the largest margin, and its changes end.",
        method="simulation",
        recorded="holds",
        stated=check_changes,
        control=Control("a larger share than the hysteresis", partial(check_changes, share=0.999)),
        uses=("theorem-4.member",),
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
        "The paper's own estimator, with a window and any mixing weights that do not depend on the model, maps "
        "initial models affinely too, and does not change the truth.",
        method="numerical sampling",
        recorded="holds",
        stated=check_window,
        control=Control("mixing weights that differ from model to model", partial(check_window, mixed=True)),
        uses=("eq-20", "remark-2"),
        proof="notebooks/24-theorem-4.ipynb#proof-theorem-4-window",
    ),
)
