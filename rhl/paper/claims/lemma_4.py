"""Lemma 4: proximal iterations for time-varying functions with a common minimiser, and weaker results that hold."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from rhl._checks import Array
from rhl.estimator import ProximalEstimator
from rhl.losses import WeightedSquares
from rhl.model import SignalModel
from rhl.paper.claims.claim import Claim, Control, Effort, Evidence, worst_of
from rhl.paper.claims.convexity import ROUNDING, WHY, check_assumption_6, check_convexity, check_only_quadratics
from rhl.paper.claims.growing import LEMMA as GROWING
from rhl.paper.claims.lemma_4_fails import CLAIMS as FAILS
from rhl.paper.claims.proximal import (
    SHAPES,
    Cosh,
    Entropy,
    Mirror,
    Ridge,
    Run,
    Squares,
    decrease_excess,
    draw_run,
    iterate,
    mixing_excess,
    optimality_gap,
    proximal_step,
    pull_excess,
    recurrent_run,
    size,
    spiral,
    sum_excess,
    symbolic_three_point,
    tangent_excess,
    three_point_gap,
)

_claim = partial(Claim, page="notebooks/09-lemma-4.ipynb", test="tests/paper/claims/test_lemma_4.py")

# Convergence means this distance; in the control it is at least a thousandth.
_ARRIVED = 1e-6


def _along(
    name: str, excess: Callable[[Run, Array], Array], consistent: bool = True, generator: Mirror | None = None
) -> Callable[[Effort], Evidence]:
    """Return a check of ``excess(run, x*) <= 0`` along random runs, relative to the size of D's terms."""

    def check(effort: Effort) -> Evidence:
        rng, found = effort.rng(name), []
        for case in range(max(effort.cases, 10)):
            squares = Squares(float(rng.uniform(0.5, 2.0)))
            g = generator or (Entropy() if case % 3 == 2 and consistent else squares)
            run, targets = draw_run(rng, g, consistent=consistent, scale=4.0 if generator else 1.0)
            found += [float(np.max(excess(run, target))) / size(run, target) for target in targets]
        return Evidence(len(found), worst_of(found), ROUNDING, WHY)

    return check


def _pull_of_another(run: Run, target: Array) -> Array:
    return pull_excess(replace(run, functions=[*run.functions[1:], run.functions[0]]), target)


def check_path(effort: Effort, rate: float = 1.5) -> Evidence:
    """Check the length of the path for functions whose gradients flatten: Lipschitz constants :math:`L_k = L k^{-e}`.

    ``rate``: e of the functions; the bound always uses e = 1.5.
    """
    rng, found = effort.rng("lemma-4.summable"), []
    for _ in range(max(effort.cases, 40)):
        d, mu, lambda_max = 3, float(rng.uniform(0.5, 2.0)), float(rng.choice([0.0, 0.5, 0.9]))
        k = np.arange(1, 61, dtype=np.float64)
        target, start = rng.standard_normal((2, d))
        directions = rng.standard_normal((len(k), d))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        functions = [
            Ridge(a, float(a @ target), shape, weight)
            for a, shape, weight in zip(directions, rng.choice(SHAPES[:3], len(k)), k**-rate, strict=True)
        ]
        run = iterate(functions, Squares(mu), start, rng.uniform(0, lambda_max, len(k)))
        lipschitz = 2 * np.sum(k**-1.5)
        bound = np.sqrt(lipschitz / 2 * run.distances(target)[0] / (1 - lambda_max)) / mu
        found.append(run.length / bound - 1)
    return Evidence(len(found), worst_of([0.0, *found]))


def check_interior(effort: Effort, radius: float | None = None) -> Evidence:
    r"""Check the path if X contains a ball, :math:`D=|x-y|^2`: its length is at most :math:`|\tilde x_0-c|^2/(2r)`.

    ``radius``: the r of the bound, on the spiral, whose X is a point; by default the true one, on random half-spaces.
    """
    if radius is not None:
        run = spiral(3000)
        return Evidence(1, run.length / (float(np.sum(run.centres[0] ** 2)) / (2 * radius)) - 1)
    rng, found = effort.rng("lemma-4.interior"), []
    for _ in range(effort.cases):
        d, r = int(rng.integers(2, 5)), float(rng.uniform(0.1, 1.0))
        centre, start = rng.standard_normal(d), 3 * rng.standard_normal(d)
        functions = []
        for _ in range(40):
            a = rng.standard_normal(d) * rng.uniform(0.2, 3.0)
            functions.append(Ridge(a, float(a @ centre) + r * float(np.linalg.norm(a)), "hinge"))
        run = iterate(functions, Squares(), start, rng.uniform(0, 0.9, 40))
        found.append(run.length / (float(np.sum((start - centre) ** 2)) / (2 * r)) - 1)
    return Evidence(len(found), worst_of([0.0, *found]))


def check_recurrent(effort: Effort, forgotten: bool = False) -> Evidence:
    """Check that runs end in X if each of finitely many functions recurs for ever, possibly with ever longer gaps."""
    rng, found = effort.rng("lemma-4.recurrent"), []
    for _ in range(max(2, effort.cases // 20)):
        run, _, family = recurrent_run(rng, forgotten)
        found.append(max(abs(float(f.a @ run.centres[-1]) - f.b) for f in family))
    return Evidence(len(found), worst_of(found), _ARRIVED, "some 25 visits of each function, each a contraction")


def check_common_minimiser(effort: Effort, noise: float = 0.0) -> Evidence:
    """Check (19) for the estimator: data of one signal model, hardly exciting, have a parameter that fits all of them.

    ``noise``: added to the data, which then satisfy no signal model.
    """
    rng, found = effort.rng("eq-19"), []
    for _ in range(effort.cases):
        n, q = (int(i) for i in rng.integers(1, 4, 2))
        A, B = rng.standard_normal((n, n)), rng.standard_normal((n, q))
        A *= 0.9 / max(abs(np.linalg.eigvals(A)))
        x, u = [rng.standard_normal(n)], np.outer(0.8 ** np.arange(30), rng.standard_normal(q))
        for v in u:
            x.append(A @ x[-1] + B @ v + noise * rng.standard_normal(n))
        regressors, successors = np.hstack([np.array(x[:-1]), u]), np.array(x[1:])
        scale = np.linalg.norm(regressors) * (1 + np.linalg.norm(np.hstack([A, B])))
        fit = np.linalg.lstsq(regressors, successors, rcond=None)[0]
        found.append(float(np.linalg.norm(regressors @ fit - successors) / scale))
    return Evidence(len(found), worst_of(found), ROUNDING, "a backward stable least-squares solution")


def check_iteration(effort: Effort, library: float = 1.0) -> Evidence:
    """Check that the library's estimator is (20): one transition, compared with the general proximal step row by row.

    ``library``: weight of the library's generator; the iteration has 1.
    """
    rng, found = effort.rng("eq-20"), []
    estimator = ProximalEstimator(1, generator=WeightedSquares(library))
    for _ in range(effort.cases):
        n, q, lam = int(rng.integers(1, 4)), int(rng.integers(1, 4)), float(rng.uniform(0, 0.9))
        centre = SignalModel(rng.standard_normal((n, n)), rng.standard_normal((n, q)))
        x, u = rng.standard_normal((2, n)), rng.standard_normal((1, q))
        mixed = estimator.minimise(centre, x, u).mix(centre, lam)
        rows = np.concatenate([centre.A, centre.B], axis=1)
        regressor = np.concatenate([x[1], u[0]])
        for i in range(n):
            best = proximal_step(Ridge(regressor, float(x[0, i])), Squares(), rows[i])
            expected = (1 - lam) * best + lam * rows[i]
            found.append(float(np.max(np.abs(np.concatenate([mixed.A[i], mixed.B[i]]) - expected))))
    return Evidence(len(found), worst_of(found), 1e-12, "numbers of size 1 to 10, two algorithms")


def check_three_point(effort: Effort, printed: bool = False) -> Evidence:
    """Check the equality in (44), symbolically and along runs; with x*_k, as printed, along runs only."""
    along = _along("eq-44", lambda run, target: three_point_gap(run, target, printed))(effort)
    if printed or symbolic_three_point():
        return along
    return Evidence(along.cases, 1.0)


_LEMMA = ("Lemma 4", "timevaryingmin")
_INCONSISTENT = "minimisers that differ from step to step"

CLAIMS: tuple[Claim, ...] = (
    *FAILS,
    _claim(
        "lemma-4.weak",
        *_LEMMA,
        "For every x* in X, D(x*, x~_k) never increases, and the sums of D(x*_{k+1}, x~_k) and of f(x*_{k+1}, k) are "
        "together at most D(x*, x~_0)/(1 - lambda_max): the iterates stay bounded, steps and residuals tend to zero.",
        "numerical sampling",
        "holds",
        stated=_along("lemma-4.weak", sum_excess),
        control=Control(_INCONSISTENT, _along("lemma-4.weak", sum_excess, consistent=False)),
        uses=("eq-46",),
        proof="notebooks/09-lemma-4.ipynb#proof-weak",
    ),
    _claim(
        "lemma-4.summable",
        *_LEMMA,
        "With D = mu |x-y|^2, if the gradients of f(.,k) have Lipschitz constants L_k with a finite sum, the path has "
        "finite length, at most sqrt(sum L_k / 2 * D(x*, x~_0) / (1 - lambda_max)) / mu, and the iterates converge, "
        "though not always into X.",
        "numerical sampling",
        "holds",
        stated=check_path,
        control=Control("Lipschitz constants that do not decay", partial(check_path, rate=0.0)),
        uses=("eq-41", "lemma-4.weak"),
        proof="notebooks/09-lemma-4.ipynb#proof-weak",
    ),
    _claim(
        "lemma-4.interior",
        *_LEMMA,
        "With D = |x-y|^2, if X contains a ball of radius r around c, the path has length at most |x~_0 - c|^2 / (2 "
        "r), and the iterates converge, though not always into X.",
        "numerical sampling",
        "holds",
        stated=check_interior,
        control=Control("an X without interior (the spiral) and r = 1/2", partial(check_interior, radius=0.5)),
        uses=("lemma-4.weak",),
        proof="notebooks/09-lemma-4.ipynb#proof-weak",
    ),
    _claim(
        "lemma-4.recurrent",
        *_LEMMA,
        "If f(.,k) is one of finitely many functions, each of which recurs for ever, after gaps of any length, "
        "the iterates converge to a point of X.",
        "numerical sampling",
        "holds",
        stated=check_recurrent,
        control=Control("one function that is never used again", partial(check_recurrent, forgotten=True)),
        uses=("eq-46", "lemma-4.weak"),
        proof="notebooks/09-lemma-4.ipynb#proof-weak",
    ),
    *GROWING,
    _claim(
        "assumption-6",
        "Assumption 6",
        "zerovalue",
        "Loss and generator are continuously differentiable and strictly convex, and the loss has its minimum only at "
        "zero: the library's weighted squares satisfy this.",
        "numerical sampling",
        "holds",
        stated=check_assumption_6,
        control=Control(
            "the sum of absolute values as loss", partial(check_assumption_6, value=lambda e: np.abs(e).sum(axis=-1))
        ),
        kind="hypothesis",
    ),
    _claim(
        "eq-19",
        "Equation 19",
        "eq:nonempty2",
        "The sets of minimisers have a common point: for the estimator, every parameter of a signal model that fits "
        "all data is one, even if the data do not excite.",
        "numerical sampling",
        "holds",
        stated=check_common_minimiser,
        control=Control("noise in the data", partial(check_common_minimiser, noise=0.01)),
        kind="hypothesis",
    ),
    _claim(
        "eq-20",
        "Equation 20",
        "eq:prox_iter2",
        "One iteration is a proximal step and a mixture of its minimiser with the old centre; the library's estimator, "
        "row by row, is the quadratic case.",
        "numerical sampling",
        "holds",
        stated=check_iteration,
        control=Control("another weight on the proximal term", partial(check_iteration, library=2.0)),
        kind="definition",
    ),
    _claim(
        "eq-41",
        "Equation 41",
        "eq:nec_opt",
        "At the minimiser x*_{k+1} the gradient of f is minus that of D(., x~_k).",
        "numerical sampling",
        "holds",
        stated=_along("eq-41", optimality_gap),
        control=Control(
            "the mixed iterate instead of the minimiser", _along("eq-41", partial(optimality_gap, mixed=True))
        ),
        uses=("assumption-6",),
        proof="notebooks/09-lemma-4.ipynb#proof-lemma-4",
    ),
    _claim(
        "eq-42",
        "Equation 42",
        "eq:taylor",
        "A convex f lies above its tangent at x*_{k+1}.",
        "numerical sampling",
        "holds",
        stated=_along("eq-42", tangent_excess),
        control=Control("-f, which is concave", _along("eq-42", lambda run, target: -tangent_excess(run, target))),
        proof="notebooks/09-lemma-4.ipynb#proof-lemma-4",
    ),
    _claim(
        "eq-43",
        "Equation 43",
        "eq:taylor_D",
        "At a common minimiser, the tangent's slope in (42) may be replaced by the gradient of D.",
        "numerical sampling",
        "holds",
        stated=_along("eq-43", pull_excess),
        control=Control("the minimiser of another function", _along("eq-43", _pull_of_another)),
        uses=("eq-19", "eq-41", "eq-42"),
        proof="notebooks/09-lemma-4.ipynb#proof-lemma-4",
    ),
    _claim(
        "eq-44",
        "Equation 44",
        "threepoint",
        "The right side of (43) is D(x*, x*_{k+1}) + D(x*_{k+1}, x~_k) - D(x*, x~_k), for every generator.",
        "symbolic identity",
        "holds-corrected",
        stated=partial(check_three_point, printed=True),
        control=Control("the gradient at x*_k, as printed, while mixing", partial(check_three_point, printed=True)),
        corrected=check_three_point,
        reason="As printed the gradient of g is taken at x*_k; it belongs to the proximal centre x~_k, as in (41). The "
        "two are the same only without mixing (lambda_k = 0).",
        proof="notebooks/09-lemma-4.ipynb#proof-lemma-4",
        formal="equation_44.three_point",
    ),
    _claim(
        "eq-45",
        "Equation 45",
        "l1",
        "Mixing at most averages the distances to x*, and the new minimiser is nearer to x* by D(x*_{k+1}, x~_k) and "
        "the residual.",
        "numerical sampling",
        "holds",
        stated=_along("eq-45", mixing_excess),
        control=Control("the sum of cosh x as generator", _along("eq-45", mixing_excess, generator=Cosh())),
        uses=("eq-43", "eq-44"),
        proof="notebooks/09-lemma-4.ipynb#proof-lemma-4",
    ),
    _claim(
        "eq-46",
        "Equation 46",
        "l2",
        "In each iteration D(x*, x~_k) decreases by (1 - lambda_max) times D(x*_{k+1}, x~_k) plus the residual, at "
        "least.",
        "numerical sampling",
        "holds",
        stated=_along("eq-46", decrease_excess),
        control=Control(_INCONSISTENT, _along("eq-46", decrease_excess, consistent=False)),
        uses=("eq-43", "eq-44", "eq-45"),
        proof="notebooks/09-lemma-4.ipynb#proof-lemma-4",
    ),
    _claim(
        "bregman-convexity-quadratic",
        *_LEMMA,
        "For weighted squares D is convex in its second argument.",
        "numerical sampling",
        "holds",
        stated=partial(check_convexity, g=Squares(np.array([0.3, 1.0, 5.0]))),
        control=Control("the sum of cosh x as generator", partial(check_convexity, g=Cosh())),
    ),
    _claim(
        "bregman-convexity-kl",
        *_LEMMA,
        "For the entropy, on positive vectors, D (Kullback-Leibler) is convex in its second argument.",
        "numerical sampling",
        "holds",
        stated=partial(check_convexity, g=Entropy()),
        control=Control("the sum of cosh x as generator", partial(check_convexity, g=Cosh())),
    ),
    _claim(
        "bregman-convexity-whole-space",
        *_LEMMA,
        "On the whole space, where Lemma 4 and Theorem 2 put g, only quadratics have a D that is convex in its second "
        "argument: any other strictly convex g has a pair of points where D(x, .) is concave.",
        "symbolic identity",
        "holds",
        stated=check_only_quadratics,
        control=Control(
            "the entropy, which is defined on positive vectors only", partial(check_only_quadratics, positive=True)
        ),
        proof="notebooks/09-lemma-4.ipynb#proof-whole-space",
    ),
)
