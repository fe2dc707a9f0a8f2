"""Equations (25)-(38), the proof of Lemma 2, one by one along sampled closed loops."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np

from rhl._checks import Array
from rhl.horizon import solve
from rhl.model import SignalModel
from rhl.paper.claims import lyapunov_inequalities as steps
from rhl.paper.claims.claim import Claim, Control, Effort, Evidence, worst_of
from rhl.paper.claims.lyapunov_terms import SIZES, Bounds, Setting, Terms, bounds, draw, follow, size, square
from rhl.problems import V3

_claim = partial(
    Claim,
    method="numerical sampling",
    recorded="holds",
    page="notebooks/06-lemma-2.ipynb",
    proof="notebooks/06-lemma-2.ipynb#the-proof-step-by-step",
    test="tests/paper/claims/test_lemma_2_proof.py",
)

_STEPS = 40
# Relative to the values of V3 at the same step; gains of up to a few hundred magnify rounding.
_ROUNDING = 1e-9

Violation = Callable[[Terms, Bounds], Array]


@cache
def sample(seed: int, cases: int, error_decay: float = 0.6) -> tuple[tuple[Terms, Bounds], ...]:
    """Draw and run closed loops of all sizes; cached, since all equations of the proof use them."""
    rng = Effort(seed).rng("lemma-2")
    each = max(3, -(-cases // len(SIZES)))  # every kind of run
    loops = [follow(draw(rng, each, sizes, _STEPS, error_decay, weighted=True)) for sizes in SIZES]
    return tuple((t, bounds(t)) for t in loops)


def along(violation: Violation, effort: Effort, error_decay: float = 0.6) -> Evidence:
    """Compute the largest relative violation along the sampled closed loops."""
    loops = sample(effort.seed, effort.cases, error_decay)
    found = [float(np.max(violation(t, b))) for t, b in loops]
    return Evidence(sum(len(t.setting.x0) for t, _ in loops), worst_of(found), _ROUNDING, "rounding, relative to V3")


def check_young(effort: Effort, skew: float = 0.0) -> Evidence:
    """Check equation (29) for random symmetric Q and for the y that makes it tight.

    ``skew``: add a skew-symmetric part to Q, which does not change x'Qx.
    """
    rng = effort.rng("eq-29")
    excess = []
    for _ in range(effort.cases):
        n, rho = int(rng.integers(2, 6)), float(10 ** rng.uniform(-3, 3))
        root = rng.normal(size=(n, n))
        Q = root @ root.T
        lam, vectors = np.linalg.eigh(Q)
        Q = Q + skew * lam[-1] * (np.eye(n, k=1) - np.eye(n, k=-1))
        for x in (rng.normal(size=n), vectors[:, -1]):
            tight = rho * Q.T @ x / lam[-1]
            for y in (rng.normal(size=n), tight):
                right = lam[-1] * (rho / 2 * x @ x + y @ y / (2 * rho))
                excess.append(float((x @ Q @ y - right) / right))
    return Evidence(len(excess), worst_of(excess), 1e-12, "rounding of a few products")


def check_constant(effort: Effort, with_c: bool) -> Evidence:
    """Derive (38) from (33) and (36), with Young's constant as printed or corrected.

    The predictor is exact and r(k) = 0, so all beta are zero; r(k+1) makes Young's inequality tight.

    ``with_c``: use 2 rho-bar c < mu; otherwise 2 rho-bar < mu, as printed.
    """
    rng = effort.rng("eq-38.constant")
    excess = []
    for case in range(effort.cases):
        A = rng.normal(size=(2, 2)) + (5.0 if case % 2 else 8.0) * np.eye(2, k=1)
        model = SignalModel(A, np.array([[0.0], [1.0]]) + 0.1 * rng.normal(size=(2, 1)))
        x0 = np.array([[0.2 * rng.normal(), 1.0]])
        zero, mu = np.zeros((1, 3, 2)), float(10 ** rng.uniform(-1, 1))
        models = SignalModel(*(np.broadcast_to(M, (1, 3, *M.shape)) for M in (model.A, model.B)))
        plant, Q, R = SignalModel(A[None], model.B[None]), mu * np.eye(2), mu * np.eye(1)
        t = follow(Setting(plant, models, zero, x0, np.zeros((1, 2, 3)), 3, Q, R))
        c = size(np.concatenate([A, model.B], axis=1)) ** 2 / 2
        rho = 0.49 * mu / (float(c) if with_c else 1.0)
        S4, S5, x_next = 2 * t.S[0, 0, :2, 2:], t.S[0, 0, 2:, 2:], t.x_next[0, 0]
        r_next = np.linalg.lstsq(S4, rho * x_next, rcond=None)[0]
        value = solve(V3(model, mu, mu, r_next, 3), x_next).value
        right = -0.5 * mu * (square(x0[0]) + square(t.plan.u[0, 0, 0])) + r_next @ S5 @ r_next
        right = right + square(S4 @ r_next) / (2 * rho)
        excess.append(float((value - t.plan.value[0, 0] - right) / (t.plan.value[0, 0] + value)))
    return Evidence(len(excess), worst_of(excess), _ROUNDING, "rounding, relative to V3")


def _step(
    id: str,
    label: str,
    statement: str,
    violation: Violation,
    broken: tuple[str, dict[str, Any]],
    printed: dict[str, Any] | None = None,
    reason: str = "",
    **more: Any,
) -> Claim:
    """Return the claim of one equation; ``printed``: the switches for its printed form, if that fails.

    ``more``: further fields of the claim.
    """
    what, switches = broken
    check = partial(along, violation)
    stated = check if printed is None else partial(along, partial(violation, **printed))
    number = id.removeprefix("eq-").split(".")[0]
    return _claim(
        id,
        f"Equation {number}" if id.startswith("eq-") else "Lemma 2",
        label,
        statement,
        recorded="holds" if printed is None else "holds-corrected",
        stated=stated,
        corrected=None if printed is None else check,
        control=Control(what, partial(along, partial(violation, **switches))),
        reason=reason,
        **more,
    )


_ONE_STEP = (
    "The one-step error is e_1 in the notation of (8), not e_0, which is zero; its printed bound is that of e_1 with "
    "the sum in (8) ending at i - 1."
)
_GAMMA = (
    "gamma is at most gamma_1 x'x + gamma_2 r'r + gamma_3 with a constant gamma_3(k) -> 0: r(k+1) is not bounded by "
    "r(k), as x(k) = r(k) = 0 with r(k+1) != 0 shows. It goes to zero because r(k) does, and does not change any "
    "conclusion."
)

CLAIMS: tuple[Claim, ...] = (
    _step(
        "lemma-2.positive",
        "convergenceMPC3",
        "V3(x, p) is at least lambda_min(Q) x'x.",
        steps.below_state,
        ("twice that constant", {"share": 2.0}),
        uses=("assumption-3", "eq-11"),
    ),
    _step(
        "eq-25",
        "V0",
        "The increment of V3 is a change of terminal state at time k+1 plus a time step with r~+ as terminal state: "
        "the three problems are feasible, and their values are those of the value matrices.",
        steps.split,
        ("the middle value of the second part taken with the maps of time k", {"stale": True}),
        uses=("eq-26", "eq-11"),
    ),
    _step(
        "eq-26",
        "rt",
        "r~+ is the end of the shifted plan nu_1 ... nu_{N-1}, 0 under the maps of time k+1.",
        steps.shifted_end,
        ("a nonzero last input", {"last": 1.0}),
        kind="definition",
        proof="",
    ),
    _step(
        "eq-27",
        "statet",
        "The new prediction of the shifted plan is the old prediction plus w.",
        steps.shifted_states,
        ("the one-step error left out", {"printed": True}),
        printed={"printed": True},
        reason=_ONE_STEP,
        uses=("assumption-4b", "eq-26"),
    ),
    _step(
        "eq-28",
        "",
        "w_i consists of the one-step error and of the changes of the maps from k to k+1.",
        steps.written_w,
        ("the one-step error left out", {"printed": True}),
        printed={"printed": True},
        reason=_ONE_STEP,
        uses=("eq-27",),
    ),
    _claim(
        "eq-29",
        "Equation 29",
        "young",
        "x'Qy <= lambda (rho/2 x'x + y'y/(2 rho)) for symmetric Q between 0 and lambda.",
        stated=check_young,
        control=Control("a skew-symmetric part in Q, which does not change x'Qx", partial(check_young, skew=0.5)),
        proof="notebooks/06-lemma-2.ipynb#young",
    ),
    _claim(
        "eq-30",
        "Equation 30",
        "bw",
        "|w_i|^2 is at most alpha_1 x'x + alpha_2 r'r + alpha_3 with explicit coefficients that go to zero.",
        stated=partial(along, steps.bounded_w),
        control=Control(
            "a predictor whose error does not decay", lambda effort: along(steps.bounded_w, effort, error_decay=1.0)
        ),
        uses=("assumption-4b", "assumption-5", "eq-28", "lemma-1.a"),
    ),
    _step(
        "eq-31",
        "eq2",
        "The cost of the shifted plan is that of the old predictions, moved by w, and of the old inputs except the "
        "first.",
        steps.shifted_cost,
        ("w left out", {"with_w": False}),
        uses=("eq-27",),
    ),
    _step(
        "eq-32",
        "V1",
        "By optimality the time step changes V3 by at most -x'Qx - nu_0'R nu_0 plus terms in r and w.",
        steps.first_bound,
        ("the products of xi and w left out", {"cross": False}),
        uses=("eq-26", "eq-31"),
    ),
    _step(
        "eq-33",
        "V1a",
        "The same with coefficients beta_1, beta_2, beta_3 -> 0 and small beta_4, beta_5; r'Qr, whose weight is not "
        "small, is part of beta_3.",
        steps.first_step,
        ("r'Qr not counted in beta_3", {"counted": False}),
        uses=("assumption-5", "eq-29", "eq-30", "eq-32", "lemma-1.a"),
    ),
    _step(
        "eq-34",
        "bw2",
        "|r~+|^2 is at most 2 alpha_1 x'x + 2 alpha_2 r'r plus a constant that goes to zero with r(k).",
        steps.bounded_end,
        ("r(k) left out of the constant", {"with_r": False}),
        uses=("eq-30", "eq-34.end"),
    ),
    _step(
        "eq-34.end",
        "bw2",
        "r~+ is A_1(k) r(k) + w_N.",
        steps.end_with_w,
        ("r + w_N", {"printed": True}),
        printed={"printed": True},
        reason="Above (34) r~+ = A_1(k) r + w_N is derived; below (36) it is printed as r + w_N. The bounds change "
        "only by the factor |A_1(k)|^2.",
        uses=("assumption-4b", "eq-27"),
    ),
    _step(
        "eq-35",
        "V2x",
        "Two values of V3 from the same state differ by x'S_4 (r+ - r~+) and two quadratic forms in S_5.",
        steps.same_state,
        ("the cross term halved", {"halved": True}),
        uses=("lemma-1.a.value",),
    ),
    _step(
        "eq-36",
        "V3",
        "By Young's inequality that difference is at most rho-bar/2 |Ax + B nu_0|^2 + gamma.",
        steps.second_bound,
        ("half the term in Ax + B nu_0", {"share": 0.5}),
        uses=("eq-29", "eq-35"),
    ),
    _step(
        "eq-36.gamma",
        "V3",
        "gamma has a bound whose coefficients go to zero.",
        steps.bounded_gamma,
        ("the constant term left out", {"constant": False}),
        printed={"constant": False},
        reason=_GAMMA,
        uses=("assumption-5", "eq-34", "eq-36", "lemma-1.a.value"),
    ),
    _step(
        "eq-37",
        "V3a",
        "The change of terminal state increases V3 by at most rho-bar c (x'x + nu_0'nu_0) plus the bound of gamma.",
        steps.second_step,
        ("the constant term left out", {"constant": False}),
        printed={"constant": False},
        reason=_GAMMA,
        uses=("eq-36", "eq-36.gamma"),
    ),
    _step(
        "eq-38",
        "lyapinqe",
        "V3 decreases by mu/2 (x'x + nu_0'nu_0) up to terms with coefficients that are small or go to zero.",
        steps.decrease,
        ("the constant term left out", {"constant": False}),
        printed={"constant": False},
        reason=_GAMMA + " What (33) and (37) are inserted into is (25), not (32).",
        uses=("eq-25", "eq-33", "eq-37", "eq-38.constant"),
    ),
    _claim(
        "eq-38.constant",
        "Equation 38",
        "lyapinqe",
        "Young's constant can be chosen so that (33) and (36) give (38).",
        recorded="holds-corrected",
        stated=partial(check_constant, with_c=False),
        corrected=partial(check_constant, with_c=True),
        control=Control("2 rho-bar < mu, as printed", partial(check_constant, with_c=False)),
        reason="2 rho-bar < mu should read 2 rho-bar c < mu, with c from (37); if c > 1, as for a plant with large "
        "A, (38) fails with the printed choice.",
        uses=("eq-33", "eq-36"),
    ),
    _step(
        "lemma-2.conclusion",
        "convergenceMPC3",
        "From (38) it follows that x(k) goes to zero.",
        steps.contracts_up_to_delta,
        ("delta left out", {"with_delta": False}),
        printed={"falling": True},
        reason="The right side of (38) is not negative for all large k and x(k) != 0: V3 increases whenever r(k+1) is "
        "large compared with x(k). With V3 <= s (x'x + r'r) it follows that V3+ <= (1 - kappa/s) V3 + delta(k) and "
        "delta(k) -> 0, and such a sequence goes to zero.",
        uses=("assumption-5", "eq-38", "lemma-1.a.value", "lemma-2.positive"),
    ),
    _claim(
        "lemma-2.input",
        "Lemma 2",
        "convergenceMPC3",
        "With the state, the input goes to zero.",
        recorded="holds-corrected",
        stated=partial(along, steps.value_at_rest),
        corrected=partial(along, steps.input_by_gains),
        control=Control("r(k) left out of the bound", partial(along, partial(steps.input_by_gains, with_r=False))),
        reason="V3(0, p_3) = 0 holds only for r = 0; otherwise it is r'S_5 r. The input goes to zero because "
        "u = K_3 x + K_4 r with bounded gains.",
        uses=("assumption-5", "lemma-1.a", "lemma-2.conclusion"),
    ),
)
