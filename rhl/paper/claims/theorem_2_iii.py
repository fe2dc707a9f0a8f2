"""Theorem 2(iii): the pair that mixing keeps controllable, and controllability of the limit of the estimates."""

from __future__ import annotations

from fractions import Fraction
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from rhl.controllability import LambdaSearch, controllability_margin
from rhl.lifting import DelayLifting
from rhl.model import SignalModel
from rhl.paper.claims.claim import Claim, Control, Effort, Evidence, worst_of
from rhl.paper.claims.growing import remember
from rhl.paper.claims.lemma_5 import Pair, hidden_modes, is_controllable, random_pairs

if TYPE_CHECKING:
    import sympy as sp

_claim = partial(Claim, page="notebooks/10-lemma-5.ipynb", test="tests/paper/claims/test_theorem_2_iii.py")

_EXACT = "exact: rational numbers"


def _rational(pair: Pair) -> tuple[sp.Matrix, sp.Matrix]:
    import sympy as sp  # imported here, because loading it takes long

    return sp.Matrix(pair[0].tolist()), sp.Matrix(pair[1].tolist())


def _floats(A: sp.Matrix, B: sp.Matrix) -> SignalModel:
    return SignalModel(np.array(A.tolist(), dtype=float), np.array(B.tolist(), dtype=float))


def check_kept(effort: Effort, *, mix: bool = True) -> Evidence:
    """Count pairs in use that are not controllable, exactly, along chains of mixtures.

    Each chain begins with a controllable pair, and every later estimate is not controllable; the library's search
    mixes it with the previous pair. ``mix`` False: use the estimates themselves.
    """
    rng, faults, cases = effort.rng("theorem-2.iii"), 0, 0
    search = LambdaSearch("lifted", "best", 0.9, 1e-9)
    for n, q in ((1, 1), (2, 1), (2, 2), (3, 1)):
        for _, first in random_pairs(rng, n, q, max(1, effort.cases // 25)):
            A, B = _rational(first)
            for _ in range(3):
                A_new, B_new = _rational(_uncontrollable(rng, n, q))
                lam = search.choose(_floats(A_new, B_new), _floats(A, B), lambda model: model) if mix else 0.0
                share = Fraction(float(lam))
                A, B = (1 - share) * A_new + share * A, (1 - share) * B_new + share * B
                faults, cases = faults + (not is_controllable(A, B)), cases + 1
    return Evidence(cases, float(faults), 0.0, _EXACT)


def _uncontrollable(rng: np.random.Generator, n: int, q: int) -> Pair:
    while True:
        pair = hidden_modes(rng, n, q)
        if not is_controllable(*pair):
            return pair


def check_step_to_augmented(
    effort: Effort, share: int = -1, third: int = 0, on: Literal["lifted", "augmented"] = "lifted"
) -> Evidence:
    """Count models y+ = a y + b v + c v(k-1) - a d v(k-2) whose lifted pair alone is controllable.

    ``share``: c = d + share a b; -1: a zero cancels the pole. ``third``: d; without it two inputs are stacked.
    ``on``: the pair that the search keeps controllable.
    """
    rng, faults, cases = effort.rng("theorem-2.iii.augmented"), 0, 0
    lifting, search = DelayLifting(1, 3 if third else 2), LambdaSearch(on, "best", 0.9, 1e-9)
    for _ in range(effort.cases):
        a, b = (int(x) for x in rng.integers(1, 5, 2) * rng.choice([-1, 1], 2))
        inputs = [b, third + share * a * b, -a * third][: lifting.inputs]
        new, old = (a, inputs), (1, [1] * lifting.inputs)
        estimate, before = (SignalModel(np.array([[float(A)]]), np.array([B], dtype=float)) for A, B in (new, old))
        lam = Fraction(float(search.choose(estimate, before, lifting.augment)))
        A = [[(1 - lam) * new[0] + lam * old[0]]]
        B = [[(1 - lam) * x + lam * y for x, y in zip(new[1], old[1], strict=True)]]
        if is_controllable(A, B):  # otherwise there is no evidence about the step from one to the other
            faults, cases = faults + (not is_controllable(*augmented_exactly(A, B, 1))), cases + 1
    return Evidence(cases, float(faults), 0.0, _EXACT)


def check_affine(effort: Effort, power: int = 1) -> Evidence:
    """Compare the augmentation of a mixture with the mixture of the augmentations, on integers.

    ``power``: mix powers of the entries instead, which is not affine.
    """
    rng, gaps = effort.rng("theorem-2.iii.affine"), []
    for _ in range(effort.cases):
        m, q, n = (int(size) for size in rng.integers(1, 4, 3))
        first, second = (
            SignalModel(rng.integers(-3, 4, (n, n)).astype(float), rng.integers(-3, 4, (n, m * q)).astype(float))
            for _ in range(2)
        )
        lifting = DelayLifting(1, m)
        mixed = first.mix(second, 0.25)
        one = lifting.augment(SignalModel(mixed.A**power, mixed.B**power))
        other = lifting.augment(first).mix(lifting.augment(second), 0.25)
        gaps.append(float(max(np.max(np.abs(one.A - other.A)), np.max(np.abs(one.B - other.B)))))
    return Evidence(len(gaps), worst_of(gaps), 0.0, "quarters of small integers are exact")


def augmented_exactly(A: Any, B: Any, q: int) -> tuple[sp.Matrix, sp.Matrix]:
    """Return Remark 4's pair for a lifted pair of rational numbers, X = [x(k); v(k-1); ...; v(k-m+1)]."""
    import sympy as sp

    A, B = sp.Matrix(A), sp.Matrix(B)
    past = B.cols - q
    chain = sp.zeros(past, A.rows + past)
    for i in range(q, past):
        chain[i, A.rows + i - q] = 1
    first = sp.zeros(past, q)
    for i in range(min(q, past)):
        first[i, i] = 1
    return sp.Matrix.vstack(sp.Matrix.hstack(A, B[:, q:]), chain), sp.Matrix.vstack(B[:, :q], first)


def stacks_of_plant(F: Any, G: Any, H: Any, m: int, v: Any, z: Any) -> tuple[sp.Matrix, sp.Matrix]:
    """Return rows [x(k), u(k)] and x(k+1), from the first k at which the stacks are measured.

    The plant, its inputs v, one to a row, and its first state are integers or fractions.
    """
    import sympy as sp

    F, G, H, z = sp.Matrix(F), sp.Matrix(G), sp.Matrix(H), sp.Matrix(z)
    y, inputs = [], [sp.Matrix(row) for row in v]
    for row in inputs:
        y.append(H * z)
        z = F * z + G * row
    y.append(H * z)

    def stack(signal: list[Any], k: int) -> sp.Matrix:
        return sp.Matrix.vstack(*(signal[k - i] for i in range(m))).T

    ks = range(m - 1, len(v))
    phi = sp.Matrix.vstack(*(sp.Matrix.hstack(stack(y, k), stack(inputs, k)) for k in ks))
    return phi, sp.Matrix.vstack(*(stack(y, k + 1) for k in ks))


def exact_models(rng: np.random.Generator, phi: sp.Matrix, after: sp.Matrix, count: int) -> list[tuple[Any, Any]]:
    """Draw rational pairs (A, B) that reproduce all transitions; components not determined by the data are random."""
    import sympy as sp

    n, (gram, pivots) = after.cols, phi.hstack(phi, after).rref()
    chosen = [j for j in pivots if j < phi.cols]
    if len(chosen) < len(pivots):
        raise ValueError("the data satisfy no signal model")
    theta = sp.zeros(phi.cols, n)
    for i, j in enumerate(chosen):
        theta[j, :] = gram[i, phi.cols :]
    open_ = phi.nullspace()
    found = []
    for _ in range(count):
        of = theta.copy()
        for direction in open_:
            of += direction * sp.Matrix([[int(a) for a in rng.integers(-3, 4, n)]])
        found.append((of[:n, :].T, of[n:, :].T))
    return found


_PLANTS = ((1, 1, 2), (1, 1, 3), (2, 1, 3), (2, 2, 2))


def check_limit(effort: Effort, *, excite: bool = True) -> Evidence:
    """Count models that are exact on a plant's data and have a controllable augmented pair, where mp > n.

    The data are integers; a draw whose regressors do not span S x R^q, with S the span of the X(k), is repeated.
    ``excite`` False: the inputs are v = -y, so they do not span it, and no draw is repeated.
    """
    rng, faults, cases = effort.rng("theorem-2.iii.limit"), 0, 0
    for n, p, m in _PLANTS:
        for _ in range(max(1, effort.cases // 50)):
            phi, after = _data(rng, n, p, m, excite)
            for A, B in exact_models(rng, phi, after, 2):
                faults, cases = faults + is_controllable(*augmented_exactly(A, B, 1)), cases + 1
    return Evidence(cases, float(faults), 0.0, _EXACT)


def _data(rng: np.random.Generator, n: int, p: int, m: int, excite: bool) -> tuple[sp.Matrix, sp.Matrix]:
    """Return the transitions of one random plant of one input, under inputs that excite, or under v = -y_1."""
    while True:
        F, G, H = (rng.integers(-2, 3, shape) for shape in ((n, n), (n, 1), (p, n)))
        z, v = rng.integers(-3, 4, (n, 1)), rng.integers(-2, 3, (2 * m + n + 4, 1))
        if excite:
            phi, after = stacks_of_plant(F, G, H, m, v, z)
        else:  # the outputs are those of the loop closed by v = -y_1
            phi, after = stacks_of_plant(F - G @ H[:1], G, H, m, 0 * v, z)
            phi[:, m * p :] = -phi[:, : m * p : p]
        state = phi[:, : m * p].row_join(phi[:, m * p + 1 :])  # X(k)
        if state.rank() and (phi.rank() == state.rank() + 1) == excite:
            return phi, after


def unexcited_model(true: bool = False) -> tuple[list[list[Any]], list[list[Any]]]:
    """Return a lifted pair, m = 2, that is exact on z+ = 1.2 z + v, y = z, v = -y, where y+ = 0.2 y.

    It is y+ = 1.04 y(k-1) + v(k-1), or the ``true`` one, y+ = 1.2 y + v.
    """
    if true:
        return [[Fraction(6, 5), 0], [1, 0]], [[1, 0], [0, 0]]
    return [[0, Fraction(26, 25)], [1, 0]], [[0, 1], [0, 0]]


def check_unexcited(effort: Effort, true: bool = False) -> Evidence:
    """Check that a model with augmented margin one reproduces data of rank one, and that the memory keeps a margin.

    ``true``: test the plant's own model instead.
    """
    import sympy as sp

    v, y = [], [Fraction(1)]
    for _ in range(12):
        v.append(-y[-1])
        y.append(Fraction(6, 5) * y[-1] + v[-1])
    phi, after = stacks_of_plant([[Fraction(6, 5)]], [[1]], [[1]], 2, [[of] for of in v], [[1]])
    A, B = (sp.Matrix(of) for of in unexcited_model(true))
    misfit = after - phi * sp.Matrix.hstack(A, B).T
    C = controllability(*augmented_exactly(A, B, 1))
    # An orthogonal controllability matrix has the margin one, exactly.
    faults = [float(phi.rank() != 1), float(not misfit.is_zero_matrix), float(sp.eye(3) != C.T * C)]
    # The memory begins near the model and must end with a margin, which the data permit.
    x, u = (np.array(of.tolist(), dtype=float) for of in (phi[:, :2], phi[:, 2:]))
    x = np.vstack([x, np.array(after[-1, :].tolist(), dtype=float)])
    begin = _floats(A, B).mix(SignalModel(np.zeros((2, 2)), np.zeros((2, 2))), 0.1)
    last = remember(x, u, begin, np.zeros(len(u)), 1e-6).models[-1]
    faults.append(0.5 - float(controllability_margin(DelayLifting(2, 2).augment(last))))
    return Evidence(len(faults), worst_of([0.0, *faults]), 0.0, "exact: rational numbers; the memory keeps a half")


def controllability(A: sp.Matrix, B: sp.Matrix) -> sp.Matrix:
    """Return [B, AB, ..., A^(n-1) B] exactly."""
    blocks = [B]
    for _ in range(A.rows - 1):
        blocks.append(A * blocks[-1])
    return B.hstack(*blocks)


CLAIMS: tuple[Claim, ...] = (
    _claim(
        "theorem-2.iii",
        "Theorem 2(iii)",
        "xxx",
        "Mixing by Lemma 5 keeps every lifted pair (A(k), B(k)) controllable, if the first is.",
        "exact arithmetic",
        "holds",
        stated=check_kept,
        control=Control("no mixing", partial(check_kept, mix=False)),
        uses=("lemma-5",),
        proof="notebooks/10-lemma-5.ipynb#proof-lemma-5",
    ),
    _claim(
        "theorem-2.iii.augmented",
        "Theorem 3",
        "mainthm",
        "The step from Theorem 2(iii) to the controller, which plans with Remark 4's augmented pair: that pair is "
        "controllable because the lifted one is.",
        "exact arithmetic",
        "refuted",
        stated=check_step_to_augmented,
        control=Control("a third input stacked", partial(check_step_to_augmented, third=2)),
        instance=Control(
            "past inputs with the opposite sign, y+ = a y + b v + a b v(k-1)", partial(check_step_to_augmented, share=1)
        ),
        reason="The lifted pair treats past inputs as free. The lifted pair of y+ = a y + b v - a b v(k-1) is "
        "controllable, while no input affects y - b v(k-1). Theorem 2(iii) is about the lifted pair and is right; the "
        "search must use the augmented pair, and can (theorem-2.iii.search).",
    ),
    _claim(
        "theorem-2.iii.search",
        "Theorem 2(iii)",
        "xxx",
        "The same search on the augmented pair keeps that pair controllable, if the first one is.",
        "exact arithmetic",
        "holds",
        stated=partial(check_step_to_augmented, on="augmented"),
        control=Control("a search that tests the lifted pair", check_step_to_augmented),
        uses=("lemma-5", "theorem-2.iii.affine"),
        proof="notebooks/10-lemma-5.ipynb#proof-search-augmented",
    ),
    _claim(
        "theorem-2.iii.affine",
        "Theorem 2(iii)",
        "xxx",
        "Augmenting commutes with mixing, so Lemma 5 applies to the augmented pair.",
        "exact arithmetic",
        "holds",
        stated=check_affine,
        control=Control("entries squared before augmenting", partial(check_affine, power=2)),
        uses=("remark-4",),
        proof="notebooks/10-lemma-5.ipynb#proof-search-augmented",
    ),
    _claim(
        "theorem-2.iii.limit",
        "Theorem 2(iii)",
        "xxx",
        "Where mp > n and the data excite (they span S x R^q, with S the span of the augmented states), no model that "
        "is exact on the data has a controllable augmented pair: the margins of a growing memory tend to zero.",
        "exact arithmetic",
        "holds",
        stated=check_limit,
        control=Control("inputs v = -y, which do not excite", partial(check_limit, excite=False)),
        uses=("lemma-6", "remark-4", "theorem-2.i.growing"),
        proof="notebooks/10-lemma-5.ipynb#proof-limit-margin",
    ),
    _claim(
        "theorem-2.iii.unexcited",
        "Theorem 2(iii)",
        "xxx",
        "Without excitation there may be one: z+ = 1.2 z + v, y = z, m = 2 under v = -y gives data of rank one, and "
        "y+ = 1.04 y(k-1) + v(k-1) is exact on them, with an augmented margin of one.",
        "exact arithmetic",
        "holds",
        stated=check_unexcited,
        control=Control("the plant's own model, y+ = 1.2 y + v", partial(check_unexcited, true=True)),
        proof="notebooks/10-lemma-5.ipynb#proof-limit-margin",
    ),
)
