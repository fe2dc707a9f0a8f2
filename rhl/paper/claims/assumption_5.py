"""Assumption 5: a condition that implies it, the number s+ that decides it, and its two readings."""

from __future__ import annotations

from functools import partial

import numpy as np

from rhl._checks import Array
from rhl.controllability import s_plus
from rhl.errors import InfeasibleError
from rhl.horizon import solve
from rhl.model import PredictorMaps, SignalModel
from rhl.paper.claims.claim import Claim, Control, Effort, Evidence, worst_of
from rhl.paper.claims.contraction import Loops, Run, constants, run
from rhl.paper.claims.lemma_1 import independent_solution, random_case, random_weight, stacked_form
from rhl.paper.claims.lyapunov_terms import at_the_end, follow
from rhl.paper.claims.rotating_models import losing
from rhl.paper.claims.theorem_1_star import AT_REST, runs
from rhl.problems import V1, V3

_claim = partial(Claim, test="tests/paper/claims/test_assumption_5.py")

# The rank condition and the gains are on the page of Lemma 1, the readings and s+ on that of Theorem 1.
_GAINS, _READINGS = "notebooks/05-lemma-1.ipynb", "notebooks/08-theorem-1.ipynb"
_ROUNDING = 1e-9


def check_rank(effort: Effort, of: str, full: bool = True) -> Evidence:
    """Find the shortfall of the rank of C(k) from the remark to Assumption 5.

    ``of`` {"column", "row"}: full column rank, as printed, or full row rank.
    ``full`` False: draw maps whose [B_0, ..., B_{N-1}] has a rank below n.
    """
    rng, short = effort.rng("assumption-5.rank"), []
    for _ in range(effort.cases):
        maps, Q, R = random_case(rng)
        if not full:
            maps = PredictorMaps(maps.A, maps.B * (np.arange(maps.n)[:, None] > 0))
        C = stacked_form(maps, Q, R)[1]
        short.append((C.shape[1] if of == "column" else C.shape[0]) - int(np.linalg.matrix_rank(C)))
    return Evidence(len(short), float(max(short)), 0.0, "a rank is an integer; the maps are well conditioned")


def gain_and_bound(maps: PredictorMaps, Q: Array, R: Array) -> tuple[float, float]:
    """Return the norm of V3's gain, from [x; r] to all nu_i and xi_i with i < N, and its bound.

    ``maps``: with [B_0, ..., B_{N-1}] of rank n.
    """
    H, C, B = stacked_form(maps, Q, R)
    n = maps.n
    weights = np.linalg.eigvalsh(H[:-n, :-n])
    bound = np.sqrt(weights[-1] / weights[0]) * np.linalg.norm(np.linalg.pinv(C) @ B, 2)
    gain = independent_solution(maps, Q, R, np.zeros(n), np.zeros(n))[1][:-n]
    return float(np.linalg.norm(gain, 2)), float(bound)


def check_bound(effort: Effort, full: bool = True) -> Evidence:
    """Find the excess of V3's gains over the bound from a feasible gain.

    The gain C'(CC')^-1 B is feasible, so the optimal one has w'Hw no larger, and is at most sqrt(cond H) times as large
    (H on the entries that are free).

    ``full`` False: violate the rank condition; V3 is then infeasible for some (x, r), and no bound exists.
    """
    rng, excess = effort.rng("assumption-5.bound"), []
    for _ in range(effort.cases):
        maps, Q, R = random_case(rng)
        n = maps.n
        if not full:
            maps = PredictorMaps(maps.A, maps.B * (np.arange(n)[:, None] > 0))
            try:
                solve(V3(maps, Q, R, np.eye(n)[0], maps.horizon), np.zeros(n))
            except InfeasibleError:
                return Evidence(1, np.inf, 0.0, "V3 is infeasible")
        gain, bound = gain_and_bound(maps, Q, R)
        excess.append(gain / bound - 1)
    return Evidence(len(excess), worst_of(excess), 1e-9, "rounding of the two norms")


def weakly_reached(delta: float) -> PredictorMaps:
    """Return the powers of A = diag(2, 0), B = (1, delta) over two steps: delta is the second state's input gain."""
    A, B = np.diag([2.0, 0.0]), np.array([[1.0], [delta]])
    return PredictorMaps(np.stack([np.eye(2), A, A @ A]), np.stack([B, A @ B]))


def check_implication(effort: Effort, least: float = 1e-4) -> Evidence:
    """Measure V3's gains, while V1's stay bounded, as the input gain of the second state tends to zero.

    ``effort`` is not used, since nothing is random. ``least``: the smallest delta.
    """
    ours, theirs = [], []
    for delta in np.geomspace(1.0, least, 7):
        maps = weakly_reached(float(delta))
        for x in np.eye(2):
            ours += [np.max(np.abs(solve(V1(maps, 1.0, 1.0, 1.0, w, 2), x).u)) for w in (1.0, 1e3, 1e6, 1e9)]
            theirs.append(np.max(np.abs(solve(V3(maps, 1.0, 1.0, x, 2), np.zeros(2)).u)))
    if max(ours) > 10:
        return Evidence(0, np.nan, why="V1's gains are not bounded, so nothing is refuted")
    return Evidence(len(theirs), float(max(theirs)), 1e3, "a hundred times the bound of V1's gains")


def gain_of(maps: PredictorMaps, Q: Array, R: Array) -> float:
    """Return the largest |(xi_0 .. xi_{N-1}, nu)| over all feasible (x, r) of norm one.

    A feasible pair is (x, A_N x + BB nu): the plan is computed for a basis of them.
    """
    n = maps.n
    BB = np.concatenate(list(maps.B[::-1]), axis=1)
    U, sizes, _ = np.linalg.svd(BB)
    span = U[:, : int(np.sum(sizes > 1e-12 * sizes[0]))]
    pairs = np.concatenate(
        [np.concatenate([np.eye(n), maps.A[-1]], axis=0), np.concatenate([np.zeros((n, span.shape[1])), span])], axis=1
    )
    basis = np.linalg.qr(pairs)[0]
    plans = [solve(V3(maps, Q, R, pair[n:], maps.horizon), pair[:n]) for pair in basis.T]
    columns = [np.concatenate([plan.x[:-1].reshape(-1), plan.u.reshape(-1)]) for plan in plans]
    return float(np.linalg.norm(np.stack(columns, axis=1), 2))


def check_equivalence(effort: Effort, largest: bool = False) -> Evidence:
    """Compare V3's largest gain with 1/s+ below and with sqrt(cond) M above, for maps of any rank.

    ``largest``: use the largest singular value as s+.
    """
    rng, found = effort.rng("assumption-5.s-plus"), []
    for i in range(max(4, effort.cases // 4)):
        n, q = int(rng.integers(2, 6)), int(rng.integers(1, 4))
        N, rank = int(rng.integers(1, n + 1)), int(rng.integers(1, n)) if i % 2 else n
        A = np.concatenate([np.eye(n)[None], rng.normal(size=(N, n, n))])
        span = np.linalg.qr(rng.normal(size=(n, n)))[0][:, :rank] * 10.0 ** rng.uniform(-3, -2, rank)
        span[:, 0] /= np.linalg.norm(span[:, 0])
        maps = PredictorMaps(A, span @ rng.normal(size=(N, rank, q)))
        Q, R = random_weight(rng, n), random_weight(rng, q)
        sizes = np.linalg.svd(np.concatenate(list(maps.B), axis=1), compute_uv=False)
        s = sizes[0] if largest else s_plus(maps)
        at, gain = constants(maps.A, maps.B, Q, R, np.eye(n), s), gain_of(maps, Q, R)
        low = min(np.linalg.eigvalsh(Q)[0], np.linalg.eigvalsh(R)[0])
        found += [1 / float(s) / gain - 1, gain / float(np.sqrt(at.top / low) * at.M) - 1]
    return Evidence(len(found), worst_of(found), _ROUNDING, "rounding of plans along directions with small gain")


def met_plans(of: Run) -> Array:
    """Return the plans' size over |x(k)| + |r(k)| along the loops, shape (T, loops), which reading (W) bounds."""
    plans = np.max(np.abs(of.nu), axis=(-1, -2)) + np.max(np.abs(of.xi), axis=(-1, -2))
    return np.asarray(plans / (np.linalg.norm(of.x[:-1], axis=-1) + np.linalg.norm(of.r, axis=-1)))


def fading_reach(reach: float = 0.5, first: float = 1.0) -> Run:
    r"""Run V1 on A = diag(1.2, 0.5), B = (1, 0) with models B(k) = (1, first reach^k) that converge to it; N = 2.

    With eps(k) = 0.02^k, unit weights and x(0) = (1, 1) the first state tends to 5/26 and not to zero.
    """
    A, B, eye = np.diag([1.2, 0.5])[None], np.array([[[1.0], [0.0]]]), np.eye(2)[None]

    def models(k: int) -> SignalModel:
        return SignalModel(A, B + np.array([[0.0], [first * reach**k]]))

    x0 = np.array([[1.0, 1.0]])
    return run(Loops(SignalModel(A, B), models, eye, np.eye(1)[None], eye, lambda k: 0.02**k, x0, 2), 40)


def check_met(effort: Effort, first: float = 1.0) -> Evidence:
    """Measure the last state of a loop with bounded plans and models that converge to the plant.

    ``effort`` is not used, since nothing is random. ``first``: input gain of the second state in the first model;
    zero makes the model exact, and s+ constant.
    """
    of = fading_reach(first=first)
    least = np.linalg.norm(of.error[-1], axis=-1) / np.linalg.norm(of.x[-2], axis=-1)
    if not (np.max(met_plans(of)) < 5 and np.max(least) < 1e-9 and np.max(np.abs(of.r[-1])) < 1e-9):
        return Evidence(0, np.nan, why="a hypothesis does not hold on this run")
    return Evidence(1, float(np.abs(of.x[-1, 0, 0])), AT_REST, "the rest of the first state, which began at one")


def check_met_plans(effort: Effort, share: float = 1.0) -> Evidence:
    """Compare the gains of V1's plans along loops with those of V3's plans for the same x and r.

    ``share``: factor on Q in V3.
    """
    found = []
    for of in runs(effort.seed, effort.cases):
        for k in range(0, 40, 10):
            maps, loops = PredictorMaps(of.A[k], of.B[k]), of.loops
            plan = solve(V3(maps, share * loops.Q, loops.R, of.r[k], loops.horizon), of.x[k])
            scale = np.linalg.norm(of.x[k], axis=-1) + np.linalg.norm(of.r[k], axis=-1)
            gains = [np.max(np.abs(nu), axis=(-1, -2)) / scale for nu in (plan.u, of.nu[k])]
            found.append(float(np.max(np.abs(gains[0] - gains[1]) / (1 + gains[1]))))
    return Evidence(len(found), worst_of(found), 1e-7, "rounding of plans with ends fixed by weights of 1e4")


def check_losing(effort: Effort, floor: float = 0.0) -> Evidence:
    """Run V3 with a model that loses controllability, r(k) -> 0; the plans in the run are bounded, the gains are not.

    ``effort`` is not used, since nothing is random. ``floor``: lower bound of the model's gain.
    """
    setting = losing(4000, floor)
    t = follow(setting)
    plans = np.max(np.abs(t.plan.u), axis=(-1, -2)) + np.max(np.abs(t.plan.x), axis=(-1, -2))
    given = np.linalg.norm(t.x, axis=-1) + np.linalg.norm(t.r, axis=-1)
    met = plans / given
    if not np.max(met) < 50:
        return Evidence(0, np.nan, why="the plans along the loop are not bounded")
    return Evidence(1, float(at_the_end(setting)[0]), 5e-3, "r(k) = 1/(k+1) has decreased to 3e-4")


CLAIMS: tuple[Claim, ...] = (
    _claim(
        "assumption-5",
        "Assumption 5",
        "new",
        "The gains of the solutions of V3 and of V1 along the closed loop stay below one bound.",
        reason="A hypothesis about an infinite run; assumption-5.bound checks a condition that implies part (a).",
        kind="hypothesis",
        page=_GAINS,
    ),
    _claim(
        "assumption-5.rank",
        "Assumption 5",
        "new",
        "If [B_0, ..., B_{N-1}] has rank n, then the constraint matrix C(k) of V3 has full rank.",
        page=_GAINS,
        method="numerical sampling",
        recorded="holds-corrected",
        stated=lambda effort: check_rank(effort, "column"),
        corrected=lambda effort: check_rank(effort, "row"),
        control=Control("maps of a lower rank", lambda effort: check_rank(effort, "row", full=False)),
        reason="The rank must be the full row rank, not the column rank, and the feasible gain is C'(CC')^-1 B, not "
        "(C'C)^-1 C'B.",
        uses=("eq-11",),
        proof=f"{_GAINS}#proof-row-rank",
    ),
    _claim(
        "assumption-5.bound",
        "Assumption 5",
        "new",
        "Under that rank condition the gains of V3 obey an explicit bound.",
        page=_GAINS,
        method="numerical sampling",
        recorded="holds",
        stated=check_bound,
        control=Control("maps of a lower rank", lambda effort: check_bound(effort, full=False)),
        uses=("assumption-3", "assumption-5.rank", "lemma-1.a"),
        proof=f"{_GAINS}#gain-bound",
    ),
    _claim(
        "assumption-5.implies",
        "Assumption 5",
        "new",
        "If Assumption 5 bounds gain matrices, part (b) implies part (a), as the proof of Theorem 1 uses.",
        page=_GAINS,
        method="numerical sampling",
        recorded="refuted",
        stated=check_implication,
        control=Control("a state with a smaller input gain", lambda effort: check_implication(effort, 1e-5)),
        instance=Control("a state with an input gain of at least a hundredth", partial(check_implication, least=1e-2)),
        reason="With A = diag(2, 0), B = (1, delta) the gains of V1 (and of V2) stay bounded as delta -> 0, those of "
        "V3 with respect to r grow like 1/delta. As a bound on the plans along the loop, (b) does imply (a) "
        "(assumption-5.implies-met), but then Lemma 2 fails (lemma-2.met). This book reads (a) as a bound on the gain "
        "matrices, which holds if and only if inf s+ > 0 (assumption-5.s-plus).",
    ),
    _claim(
        "assumption-5.s-plus",
        "Assumption 5",
        "",
        "The gain of V3 over all feasible (x, r) is at least 1/s+ and at most an explicit function of 1/s+, where s+ "
        "is the smallest nonzero singular value of [B_{N-1} ... B_0]: for bounded maps, Assumption 5(a) as a bound on "
        "gain matrices holds if and only if inf s+(k) > 0.",
        page=_READINGS,
        method="numerical sampling",
        recorded="holds",
        stated=check_equivalence,
        control=Control("the largest singular value as s+", partial(check_equivalence, largest=True)),
        uses=("assumption-3", "lemma-1.a", "eq-11"),
        proof=f"{_READINGS}#proof-s-plus",
    ),
    _claim(
        "assumption-5.implies-met",
        "Assumption 5",
        "",
        "If Assumption 5 bounds the plans along the loop of V1, part (b) implies part (a): they are plans of V3.",
        page=_READINGS,
        method="numerical sampling",
        recorded="holds",
        stated=check_met_plans,
        control=Control("ten times the stage weight in V3", partial(check_met_plans, share=10.0)),
        uses=("eq-40",),
        proof=f"{_READINGS}#two-readings",
    ),
    _claim(
        "lemma-2.met",
        "Lemma 2",
        "",
        "Lemma 2 with Assumption 5(a) read as a bound on the plans along the loop.",
        page=_READINGS,
        method="simulation",
        recorded="refuted",
        stated=check_losing,
        control=Control("a gain of at least a ten-thousandth", partial(check_losing, floor=1e-4)),
        instance=Control(
            "a gain of at least 0.1, so that the gain matrices are bounded", partial(check_losing, floor=0.1)
        ),
        reason="A model approaches the plant and loses its input gain of a stable state, which r(k) -> 0 prescribes. "
        "Its planned inputs are bounded by |x| + |r| and keep the first state away from zero. The proof of Lemma 2 "
        "uses the gain from r+ - r~+, for which there is no plan in the loop.",
        uses=("assumption-5",),
    ),
    _claim(
        "theorem-1.met",
        "Theorem 1",
        "",
        "Theorem 1 with Assumption 5 read as a bound on the plans along the loop, including V2's, and with "
        "predictors that converge to the plant itself.",
        page=_READINGS,
        method="simulation",
        recorded="refuted",
        stated=check_met,
        control=Control("B(k) = (1, 0.5^(k+1))", partial(check_met, first=0.5)),
        instance=Control("an exact model from the start, so that s+ is constant", partial(check_met, first=0.0)),
        reason="With A = diag(1.2, 0.5), B = (1, 0), models B(k) = (1, 0.5^k), N = 2, unit weights, eps(k) = 0.02^k "
        "and x(0) = (1, 1) all plans are below 2.5 |x|, the one-step error and r(k) go to zero, and x_1 tends to 5/26.",
        uses=("assumption-5",),
    ),
)
