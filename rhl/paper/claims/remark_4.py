"""Remark 4: past inputs as states, and whether the augmented pair is stabilizable."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from rhl.lifting import DelayLifting
from rhl.model import SignalModel
from rhl.paper.claims.claim import Claim, Control, Effort, Evidence, worst_of
from rhl.paper.claims.kalman import draw_plant, stacked
from rhl.paper.claims.theorem_2_iii import augmented_exactly
from rhl.plants.analysis import observability_index, pbh, signal_model

if TYPE_CHECKING:
    import sympy as sp

_claim = partial(Claim, page="notebooks/12-lemma-6.ipynb", test="tests/paper/claims/test_lemma_6.py")

# The least singular value of a PBH matrix of full rank, for entries near one; controls have at most 1e-12.
_RANK = 1e-8


def check_stabilizable(effort: Effort, augmented: bool = False, deaf: bool = False, index: bool = False) -> Evidence:
    """Test the pair (55), lifted or augmented, by PBH: the shortfall of its smallest singular value from the threshold.

    ``augmented``: test Remark 4's augmented pair. ``index``: stack as many samples as the observability index.
    ``deaf``: no input gain in the unstable block, so that the plant is not stabilizable.
    """
    rng = effort.rng("lemma-6.stabilizable")
    short = []
    for _ in range(effort.cases):
        form, _ = draw_plant(rng)
        if deaf:
            form = replace(form, G=np.where(np.arange(len(form.G))[:, None] < form.sizes[0], 0.0, form.G))
        F, G, H = form.observable
        m = observability_index(F, H) if index else form.F.shape[0]
        model = signal_model(F, G, H, m)
        model = DelayLifting(m, m).augment(model) if augmented else model
        short.append(_RANK - pbh(model.A, model.B, least_modulus=1.0 - 1e-9))
    return Evidence(len(short), worst_of(short), 0.0, f"full rank means a smallest singular value above {_RANK:g}")


def stabilizable_exactly(A: sp.Matrix, B: sp.Matrix) -> bool:
    """Decide whether a rational pair is stabilizable, by the rank at its eigenvalues, which must be rational.

    ValueError if one is not.
    """
    import sympy as sp

    values = A.eigenvals()
    if not all(value.is_Rational for value in values):
        raise ValueError("the eigenvalues must be rational")
    return all((value * sp.eye(A.rows) - A).row_join(B).rank() == A.rows for value in values if abs(value) >= 1)


def check_every_pair(
    effort: Effort, poles: tuple[Fraction, ...] = (Fraction(6, 5), Fraction(3), Fraction(-2))
) -> Evidence:
    """Count pairs of y+ = a y + v - a v(k-1), stabilizable as lifted ones, whose augmented pair is not.

    ``poles``: the numbers a. ``effort`` is not used, since nothing is random.
    """
    import sympy as sp

    lost = 0
    for a in poles:
        A, B = sp.Matrix([[a]]), sp.Matrix([[1, -a]])
        if not stabilizable_exactly(A, B):
            return Evidence(0, 0.0)  # no evidence about augmentation
        lost += not stabilizable_exactly(*augmented_exactly(A, B, 1))
    return Evidence(len(poles), float(lost), 0.0, "exact: rational numbers")


def check_chain(effort: Effort, offset: int) -> Evidence:
    """Run the chain zeta_1+ = zeta_2, ..., zeta_{m-1}+ = v(k) of Remark 4 and determine zeta_1(k).

    ``offset``: compare zeta_1(k) with v(k - m + offset): 0 as printed, 1 corrected.
    """
    rng = effort.rng("remark-4.chain")
    gaps = []
    for _ in range(effort.cases):
        m = int(rng.integers(2, 7))
        v = rng.normal(size=20)
        chain = np.zeros(m - 1)
        for k in range(20):
            if k - m + offset >= 0:
                gaps.append(abs(float(chain[0] - v[k - m + offset])))
            chain = np.append(chain[1:], v[k])
    return Evidence(len(gaps), worst_of(gaps), 0.0, "only copies are made")


def check_augmented(effort: Effort, depth: int = 0) -> Evidence:
    """Remark 4: mp + (m-1)q states, driven by v(k) alone, give the same x(k) as the lifted pair driven by u(k).

    ``depth``: reduction of the number of past inputs.
    """
    rng = effort.rng("remark-4")
    gaps = []
    for _ in range(effort.cases):
        p, q, m = (int(size) for size in rng.integers((1, 1, 2), (4, 4, 5)))
        model = SignalModel(rng.normal(size=(m * p, m * p)) / m, rng.normal(size=(m * p, m * q)))
        kept = SignalModel(model.A, model.B[:, : (m - depth) * q])
        augmented = DelayLifting(m, m - depth).augment(kept)
        wanted = m * p + (m - 1 - depth) * q
        v = rng.normal(size=(10, q))
        x, X = np.zeros(m * p), np.zeros(wanted)
        for row, u in zip(v, stacked(v, m), strict=True):
            x, X = model.A @ x + model.B @ u, augmented.A @ X + augmented.B @ row
            gaps.append(float(np.max(np.abs(x - X[: m * p])) / (1 + np.max(np.abs(x)))))
    return Evidence(len(gaps), worst_of(gaps), 1e-12, "rounding of ten steps")


CLAIMS: tuple[Claim, ...] = (
    _claim(
        "remark-4",
        "Remark 4",
        "intchain",
        "Carrying m - 1 past inputs as states gives a model of size mp + (m-1)q whose only input is v(k).",
        method="numerical sampling",
        recorded="holds",
        stated=check_augmented,
        control=Control("a chain that is one input too short", partial(check_augmented, depth=1)),
        proof="notebooks/12-lemma-6.ipynb#proof-augmented",
    ),
    _claim(
        "remark-4.chain",
        "Remark 4",
        "intchain",
        "The chain's first state zeta_1(k) is the oldest input that it carries.",
        method="exact arithmetic",
        recorded="holds-corrected",
        stated=partial(check_chain, offset=0),
        corrected=partial(check_chain, offset=1),
        control=Control("the chain read one step too early", partial(check_chain, offset=2)),
        reason="zeta_{m-2}+ = zeta_m should read zeta_{m-2}+ = zeta_{m-1}, and then zeta_1(k) is v(k-m+1), not v(k-m); "
        "the appendix uses m states, for which v(k-m) is right, but one more than needed.",
    ),
    _claim(
        "remark-4.stabilizable",
        "Remark 4",
        "intchain",
        "Augmenting the pair of equation (55) keeps it stabilizable.",
        method="numerical sampling",
        recorded="holds",
        stated=partial(check_stabilizable, augmented=True),
        control=Control(
            "an unstable block that no input reaches", partial(check_stabilizable, augmented=True, deaf=True)
        ),
        uses=("lemma-6.stabilizable",),
        proof="notebooks/12-lemma-6.ipynb#proof-stabilizable",
    ),
    _claim(
        "remark-4.every-pair",
        "Remark 4",
        "intchain",
        "Augmenting any stabilizable lifted pair keeps it stabilizable.",
        method="exact arithmetic",
        recorded="refuted",
        stated=check_every_pair,
        control=Control("a pole on the unit circle", partial(check_every_pair, poles=(Fraction(1), Fraction(-1)))),
        instance=Control(
            "poles inside the unit circle", partial(check_every_pair, poles=(Fraction(1, 2), Fraction(-4, 5)))
        ),
        reason="The remark's reason is that the chain's states go to zero with v. That is right if v feeds back the "
        "plant's own state, so for the pair of (55) (remark-4.stabilizable). Another lifted pair may use past inputs "
        "as free, which can no longer be chosen: that of y+ = a y + v - a v(k-1) is controllable, and no input "
        "reaches its augmented mode a. The limit of the estimates need not be the pair of (55).",
    ),
)
