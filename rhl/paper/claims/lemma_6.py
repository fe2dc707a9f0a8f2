"""Lemma 6 and Remark 4: stacked data of a stabilizable, detectable plant obey a stabilizable signal model."""

from __future__ import annotations

from functools import partial

import numpy as np

from rhl._checks import Array
from rhl.model import SignalModel
from rhl.paper.claims.claim import Claim, Control, Effort, Evidence, worst_of
from rhl.paper.claims.kalman import draw_plant, kalman_form, run_open_loop, stacked
from rhl.paper.claims.remark_4 import CLAIMS as REMARK
from rhl.paper.claims.remark_4 import check_stabilizable
from rhl.plants import LinearPlant
from rhl.plants.analysis import (
    inputs_to_stack,
    observability,
    observability_index,
    signal_model,
    spectral_radius,
)

_claim = partial(Claim, page="notebooks/12-lemma-6.ipynb", test="tests/paper/claims/test_lemma_6.py")

# Rounding of unit data in O and its pseudo-inverse, whose condition number is below 1e4 by construction.
_DATA = 1e-9


def transition_misfits(model: SignalModel, y: Array, v: Array, m: int) -> Array:
    """Return |x(k+1) - A x(k) - B u(k)|, relative to |x(k+1)| and one, for k = 0, 1, ..., equation (18)."""
    x, u = stacked(y, m), stacked(v, m)
    gap = x[1:] - x[:-1] @ model.A.T - u[:-1] @ model.B.T
    return np.asarray(np.linalg.norm(gap, axis=1) / (1 + np.linalg.norm(x[1:], axis=1)))


def check_data(effort: Effort, first: int | None = None, detune: float = 0.0) -> Evidence:
    """Check equation (18) on data of random plants with uncontrollable and unobservable modes, in random coordinates.

    ``first``: first checked k; by default m - 1, where the stacks are full of measurements.
    ``detune``: relative increase of the input matrix in the pair (55).
    """
    rng = effort.rng("lemma-6.data")
    misfits = []
    for _ in range(effort.cases):
        form, plant = draw_plant(rng)
        F, G, H = form.observable
        m = form.F.shape[0] + int(rng.integers(0, 2))
        v = rng.normal(size=(m + 12, plant.q))
        y = run_open_loop(plant, rng.normal(size=plant.n), v)
        model = signal_model(F, (1 + detune) * G, H, m)
        misfits.append(float(np.max(transition_misfits(model, y, v, m)[m - 1 if first is None else first :])))
    return Evidence(len(misfits), worst_of(misfits), _DATA, "rounding through O and its pseudo-inverse")


def check_index(effort: Effort, shorten: int = 0) -> Evidence:
    """Check equation (18) with m equal to the observability index of (53), which may be far below n."""
    rng = effort.rng("lemma-6.index")
    misfits = []
    for _ in range(effort.cases):
        form = kalman_form(rng, 2, 1, (4, 0, 2))
        F, G, H = form.observable
        m = observability_index(F, H) - shorten
        v = rng.normal(size=(m + 12, 1))
        y = run_open_loop(form.plant(np.eye(6)), rng.normal(size=6), v)
        misfits.append(float(np.max(transition_misfits(signal_model(F, G, H, m), y, v, m)[m - 1 :])))
    return Evidence(len(misfits), worst_of(misfits), _DATA, "rounding through O and its pseudo-inverse")


def check_start(effort: Effort, earlier: int = 0) -> Evidence:
    """Check equation (18) with zeros before k = 0, for a pair on stacks of the observability index.

    ``earlier``: start this many transitions before that index minus one.
    """
    rng, misfits = effort.rng("lemma-6.start"), []
    for _ in range(effort.cases):
        form = kalman_form(rng, 2, 1, (4, 0, 1))
        (F, G, H), m = form.observable, 5
        index = observability_index(F, H)
        v = rng.normal(size=(m + 12, 1))
        y = run_open_loop(form.plant(np.eye(5)), rng.normal(size=5), v)
        model = latest_pair(F, G, H, index, m)
        misfits.append(float(np.max(transition_misfits(model, y, v, m)[index - 1 - earlier :])))
    return Evidence(len(misfits), worst_of(misfits), _DATA, "rounding through O and its pseudo-inverse")


def latest_pair(F: Array, G: Array, H: Array, index: int, m: int) -> SignalModel:
    """Return the pair that predicts y(k+1) from the latest ``index`` outputs and inputs, and shifts the others."""
    p, q = H.shape[0], G.shape[1]
    short = signal_model(F, G, H, index)
    A, B = np.eye(m * p, k=-p), np.zeros((m * p, m * q))
    A[:p, : index * p], B[:p, : index * q] = short.A[:p], short.B[:p]
    return SignalModel(A, B)


def check_feedback_step(effort: Effort, as_printed: bool) -> Evidence:
    """Check that under v = K_s z_s the proof's w(k) evolves by F_s + G_s K_s.

    ``as_printed``: use w(k) = O' x(k), as printed, instead of O^+ (x(k) - R u(k-1)).
    """
    rng = effort.rng("lemma-6.proof")
    gaps = []
    for _ in range(effort.cases):
        F, G, H = kalman_form(rng, 2, 1, (2, 1, 0)).observable
        K, m = rng.normal(size=(1, 3)), 3
        z = [rng.normal(size=3)]
        for _ in range(8):
            z.append(F @ z[-1] + G @ (K @ z[-1]))
        states = np.array(z[:-1])
        x, u = stacked(states @ H.T, m), stacked(states @ K.T, m)
        O, R = observability(F, H, m), inputs_to_stack(F, G, H, m)
        w = x[m:] @ O if as_printed else (x[m:] - u[m - 1 : -1] @ R.T) @ np.linalg.pinv(O).T
        step = w[:-1] @ (F + G @ K).T
        gaps.append(float(np.max(np.abs(w[1:] - step)) / (1 + np.max(np.abs(w)))))
    return Evidence(len(gaps), worst_of(gaps), _DATA, "rounding through O and its pseudo-inverse")


def check_converse(effort: Effort, hidden_radius: float = 0.8) -> Evidence:
    """Check that under a stabilizing feedback of z_s the stacks go to zero, and with them the whole state z."""
    rng = effort.rng("lemma-6.converse")
    left = []
    for _ in range(max(1, effort.cases // 4)):
        form = kalman_form(rng, 1, 2, (2, 1, 1), hidden_radius)
        F, G, _ = form.observable
        K = _stabilizing(F, G)
        z = rng.normal(size=4)
        for _ in range(400):
            z = form.F @ z - form.G @ (K @ z[:3])
        left.append(float(np.max(np.abs(z))))
    return Evidence(len(left), worst_of(left), 1e-6, "0.9^400 times what a non-normal transient adds")


def _stabilizing(F: Array, G: Array) -> Array:
    from scipy.linalg import solve_discrete_are  # imported here, because loading it takes long

    P = solve_discrete_are(F, G, np.eye(len(F)), np.eye(G.shape[1]))
    return np.asarray(np.linalg.solve(np.eye(G.shape[1]) + G.T @ P @ G, G.T @ P @ F))


def check_kalman(effort: Effort, hidden_radius: float = 0.8) -> Evidence:
    """Recover the blocks of (52) from a plant in hidden coordinates, by invariant subspaces.

    The unobservable subspace, and the controllable part of its complement, are computed from the plant. In their
    coordinates the zero blocks of (52) must be zero, and F_3, F_6 must be stable.

    ``hidden_radius``: spectral radius of the unobservable block.
    """
    rng = effort.rng("eq-52")
    faults = []
    for _ in range(effort.cases):
        form = kalman_form(rng, 2, 1, (2, 1, 1), hidden_radius)
        plant = form.plant(np.linalg.qr(rng.normal(size=(4, 4)))[0])
        right = np.linalg.svd(observability(plant.F, plant.H, 4))[2]
        seen, unseen = right[:3], right[3:]  # rows: orthonormal bases of the observable part and its complement
        Fs, Gs = seen @ plant.F @ seen.T, seen @ plant.G
        left = np.linalg.svd(np.concatenate([np.linalg.matrix_power(Fs, i) @ Gs for i in range(3)], axis=1))[0]
        deaf = left[:, 2:]
        zeros = [seen @ plant.F @ unseen.T, plant.H @ unseen.T, deaf.T @ Fs @ left[:, :2], deaf.T @ Gs]
        largest = max(float(np.max(np.abs(block))) for block in zeros)
        growth = max(spectral_radius(deaf.T @ Fs @ deaf), spectral_radius(unseen @ plant.F @ unseen.T)) - 1
        faults.append(max(largest, growth))
    return Evidence(len(faults), worst_of(faults), _DATA, "rounding through subspaces of condition up to 1e3")


def check_subsystem(effort: Effort, leak: float = 0.0) -> Evidence:
    """Compare the outputs of (52) with those of (53): the block z_3 does not affect them.

    ``leak``: gain from z_3 to the output.
    """
    rng = effort.rng("eq-53")
    gaps = []
    for _ in range(effort.cases):
        form = kalman_form(rng, 2, 1, (2, 1, 2))
        F, G, H = form.observable
        H_leaky = form.H + leak * np.array([0, 0, 0, 1, 1])
        v, z = rng.normal(size=(15, 1)), rng.normal(size=5)
        whole = run_open_loop(LinearPlant(form.F, form.G, H_leaky), z, v)
        part = run_open_loop(LinearPlant(F, G, H), z[:3], v)
        gaps.append(float(np.max(np.abs(whole - part)) / (1 + np.max(np.abs(whole)))))
    return Evidence(len(gaps), worst_of(gaps), 1e-12, "rounding of fifteen steps")


def check_stack(effort: Effort, shift: int = 0) -> Evidence:
    """Check x(k) = O z_s(k-m+1) + R u(k-1), equation (54), along random runs.

    ``shift``: use the state that many steps later than in (54).
    """
    rng = effort.rng("eq-54")
    gaps = []
    for _ in range(effort.cases):
        form = kalman_form(rng, 2, 2, (2, 1, 0))
        F, G, H = form.observable
        m = 4
        v = rng.normal(size=(12, 2))
        z = [rng.normal(size=3)]
        for row in v:
            z.append(F @ z[-1] + G @ row)
        x, u = stacked(np.array(z[:-1]) @ H.T, m), stacked(v, m)
        O, R = observability(F, H, m), inputs_to_stack(F, G, H, m)
        for k in range(m, 12):
            right = O @ z[k - m + 1 + shift] + R @ u[k - 1]
            gaps.append(float(np.max(np.abs(x[k] - right)) / (1 + np.max(np.abs(right)))))
    return Evidence(len(gaps), worst_of(gaps), 1e-12, "rounding of a dozen steps")


_ZERO_HISTORY = (
    "With signals set to zero before k = 0, as in the paper, at most the first m - 1 transitions violate (18). It "
    "holds from k = m - 1 on, once the stacks are full of measurements, and for a suitable pair from the observability "
    "index minus one on (lemma-6.start)."
)

CLAIMS: tuple[Claim, ...] = (
    _claim(
        "lemma-6",
        "Lemma 6",
        "finalstep",
        "The stacks of the last m outputs and inputs of a stabilizable and detectable plant obey x+ = Ax + Bu.",
        method="numerical sampling",
        recorded="holds-corrected",
        stated=lambda effort: check_data(effort, first=0),
        corrected=check_data,
        control=Control("the pair of a plant with a slightly larger gain", lambda e: check_data(e, detune=1e-3)),
        reason=_ZERO_HISTORY,
        uses=("eq-55",),
        proof="notebooks/12-lemma-6.ipynb#proof-lemma-6",
    ),
    _claim(
        "lemma-6.index",
        "Lemma 6",
        "finalstep",
        "m may be less than n: the observability index of the observable part is enough.",
        method="numerical sampling",
        recorded="holds",
        stated=check_index,
        control=Control("one stacked output fewer than that index", lambda effort: check_index(effort, 1)),
        uses=("eq-55",),
        proof="notebooks/12-lemma-6.ipynb#proof-lemma-6",
    ),
    _claim(
        "lemma-6.start",
        "Lemma 6",
        "finalstep",
        "With zeros before k = 0, a suitable pair satisfies (18) from the observability index minus one on, for every "
        "m.",
        method="numerical sampling",
        recorded="holds",
        stated=check_start,
        control=Control("one transition earlier", partial(check_start, earlier=1)),
        uses=("lemma-6.index",),
        proof="notebooks/12-lemma-6.ipynb#proof-start",
    ),
    _claim(
        "lemma-6.stabilizable",
        "Lemma 6",
        "finalstep",
        "The pair (A, B) of equation (55) is stabilizable.",
        method="numerical sampling",
        recorded="holds",
        stated=check_stabilizable,
        control=Control("an unstable block that no input reaches", partial(check_stabilizable, deaf=True)),
        uses=("eq-53", "eq-55"),
        proof="notebooks/12-lemma-6.ipynb#proof-stabilizable",
    ),
    _claim(
        "lemma-6.index.stabilizable",
        "Lemma 6",
        "finalstep",
        "With m equal to the observability index the pair (A, B) of equation (55) is stabilizable, too.",
        method="numerical sampling",
        recorded="holds",
        stated=partial(check_stabilizable, index=True),
        control=Control("an unstable block that no input reaches", partial(check_stabilizable, index=True, deaf=True)),
        uses=("eq-53", "eq-55"),
        proof="notebooks/12-lemma-6.ipynb#proof-stabilizable",
    ),
    _claim(
        "lemma-6.proof",
        "Lemma 6",
        "finalstep",
        "Under a feedback of z_s, the vector w(k) of the proof evolves by F_s + G_s K_s.",
        method="numerical sampling",
        recorded="holds-corrected",
        stated=lambda effort: check_feedback_step(effort, as_printed=True),
        corrected=lambda effort: check_feedback_step(effort, as_printed=False),
        control=Control("w(k) as printed", lambda effort: check_feedback_step(effort, as_printed=True)),
        reason="w_k = O'x_k includes past inputs; the vector O^+ (x(k) - R u(k-1)) = z_s(k-m+1) evolves like this.",
        uses=("eq-54",),
    ),
    _claim(
        "lemma-6.converse",
        "Lemma 6",
        "finalstep",
        "If the stacks go to zero, so do outputs and inputs, and with them the whole state.",
        method="simulation",
        recorded="holds",
        stated=check_converse,
        control=Control("an unobservable block that is unstable", lambda effort: check_converse(effort, 1.05)),
        uses=("eq-52", "eq-54"),
        proof="notebooks/12-lemma-6.ipynb#proof-converse",
    ),
    *REMARK,
    _claim(
        "eq-52",
        "Equation 52",
        "kalman",
        "A stabilizable and detectable plant has, in suitable coordinates, this block form with F_3, F_6 stable.",
        method="numerical sampling",
        recorded="holds",
        stated=check_kalman,
        control=Control("an undetectable plant", lambda effort: check_kalman(effort, hidden_radius=1.05)),
        uses=("assumption-1",),
        proof="notebooks/12-lemma-6.ipynb#proof-kalman",
    ),
    _claim(
        "eq-53",
        "Equation 53",
        "subsys",
        "The unobservable block does not affect the outputs: they are those of the observable subsystem.",
        method="numerical sampling",
        recorded="holds",
        stated=check_subsystem,
        control=Control(
            "a leak of one percent from the block into the output", lambda effort: check_subsystem(effort, 0.01)
        ),
        uses=("eq-52",),
        proof="notebooks/12-lemma-6.ipynb#proof-lemma-6",
    ),
    _claim(
        "eq-54",
        "Equation 54",
        "stack",
        "The stack of outputs is O z_s(k-m+1) + R u(k-1).",
        method="numerical sampling",
        recorded="holds",
        stated=check_stack,
        control=Control("the state one step later", lambda effort: check_stack(effort, 1)),
        uses=("eq-53",),
        proof="notebooks/12-lemma-6.ipynb#proof-lemma-6",
    ),
    _claim(
        "eq-55",
        "Equation 55",
        "hsm",
        "Eliminating z_s gives x(k+1) = A x(k) + B u(k) with A = O F_s O^+.",
        method="numerical sampling",
        recorded="holds",
        stated=check_data,
        control=Control("the pair of a plant with a slightly larger gain", lambda e: check_data(e, detune=1e-3)),
        uses=("eq-54",),
        proof="notebooks/12-lemma-6.ipynb#proof-lemma-6",
    ),
)
