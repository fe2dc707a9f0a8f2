"""The paper's proof of Theorem 2(ii) over one window: equations (47) to (51), as printed and corrected."""

from __future__ import annotations

from functools import partial

import numpy as np

from rhl.model import SignalModel
from rhl.paper.claims.claim import Claim, Control, Effort, Evidence, worst_of
from rhl.paper.claims.estimation import Estimates, draw_model, estimate, theta_matrix, trajectory
from rhl.paper.claims.estimator_setup import ROUNDING, WHY, claim


def window_gap(record: Estimates, k: int, equation: int, printed: bool, limit: SignalModel | None = None) -> float:
    """Return the violation of (47), (48), (49), (50) or (51) at k, as printed or corrected.

    ``k``: at least the window. ``equation`` is 47 to 51.
    ``printed``: (47) with the residuals of theta*(k), the others with the error index l+1 instead of l+2.
    Corrected, (47) has e = e*(k) + lambda_k R(k) (theta*(k) - theta~(k-1)), computed without theta~(k).
    ``limit``: the A^, B^ of (49) to (51), and the (A, B) on the right of (51). The identities hold for every model;
    (51) needs the truth.
    """
    model, window = record.models[k], record.window
    x, u = record.data(k)
    if equation == 47:
        residuals = record.residuals(k, record.best[k - 1])
        if not printed:
            lam = 0.0 if record.mixing is None else record.mixing[k - 1]
            move = theta_matrix(record.best[k - 1]) - theta_matrix(record.models[k - 1])
            residuals = residuals + lam * np.hstack([x[1:], u]) @ move.T
        return float(np.max(np.abs(x[:-1] - (x[1:] @ model.A.T + u @ model.B.T + residuals))))
    errors = record.residuals(k, model)[::-1]  # e_1, ..., e_N: oldest transition first
    x0, inputs = x[window - 1], u[window - 2 :: -1] if window > 1 else u[:0]
    maps, worst = model.predictor(max(window, 1)), 0.0
    hats = maps if limit is None or equation == 48 else limit.predictor(max(window, 1))
    shift = 0 if printed else 1
    for j in range(window):
        lags = range(j)
        noise = sum((maps.A[j - 1 - m] @ errors[m + shift] for m in lags), start=np.zeros(model.n))
        e = noise + (maps.A[j] - hats.A[j]) @ x0
        e = e + sum(((maps.B[j - 1 - m] - hats.B[j - 1 - m]) @ inputs[m] for m in lags), start=np.zeros(model.n))
        found = hats.A[j] @ x0 + sum((hats.B[j - 1 - m] @ inputs[m] for m in lags), start=np.zeros(model.n)) + e
        # x(j + k - window + 1) is entry window - 1 - j, newest first.
        worst = max(worst, float(np.max(np.abs(found - x[window - 1 - j]))))
    return worst


def residual_excess(record: Estimates, truth: SignalModel, lambda_max: float) -> float:
    r"""Return the relative excess of the terms of (47)'s residuals over their bound.

    They are :math:`e^*(k) + \lambda_k R(k)(\theta^*(k) - \tilde\theta(k-1))`. The squares of residuals e* and steps sum
    to at most :math:`|\theta-\tilde\theta(0)|^2/(1-\lambda_{max})`, so both terms tend to zero for bounded R(k).
    """
    first = record.window - 1
    total = float(np.sum(record.moves()[first:] ** 2) + np.sum(record.misfits()[first:] ** 2))
    return (1 - lambda_max) * total / float(record.distances(truth.theta)[0] ** 2) - 1


def check_window(effort: Effort, equation: int, printed: bool = False) -> Evidence:
    """Check (47) to (51) on random estimates, with mixing and windows of at least three; with (47) also its sum."""
    rng, found = effort.rng(f"eq-{equation}"), []
    for _ in range(max(3, effort.cases // 10)):
        n, q = (int(size) for size in rng.integers(1, 4, 2))
        truth, window = draw_model(rng, n, q), int(rng.integers(3, 6))
        u = rng.standard_normal((25, q))
        x = trajectory(truth, rng.standard_normal(n), u)
        initial, mixing = draw_model(rng, n, q), rng.uniform(0.3, 0.9, 25)
        record = estimate(x, u, initial, window, mixing, first=window)
        limit = truth if equation == 51 else record.models[-1]
        found += [window_gap(record, k, equation, printed, limit) for k in range(window, 25, 5)]
        if equation == 47 and not printed:
            found.append(residual_excess(record, truth, float(np.max(mixing))))
        if equation == 51:  # its right side: the truth reproduces the signal
            ahead = truth.predictor(4).predict(x[5], u[5:9])
            found.append(float(np.max(np.abs(ahead - x[5:10]))))
    return Evidence(len(found), worst_of(found), ROUNDING, WHY)


_AS_IN_48 = "The errors have the same wrong index as in (48)."

CLAIMS: tuple[Claim, ...] = (
    claim(
        "eq-47",
        "Equation 47",
        "help",
        "Over the window, x(j) = A(k) x(j-1) + B(k) u(j-1) up to a residual e_{j-k+N}(k), which for bounded signals "
        "tends to zero.",
        "numerical sampling",
        "holds-corrected",
        stated=partial(check_window, equation=47, printed=True),
        control=Control("the formula as printed", partial(check_window, equation=47, printed=True)),
        corrected=partial(check_window, equation=47),
        reason="The residuals are printed as those of theta*(k), while A(k), B(k) are those of theta~(k), which is "
        "right only without mixing. The correct ones are e*(k) + lambda_k R(k) (theta*(k) - theta~(k-1)); for bounded "
        "signals the sum of its squares is finite.",
        uses=("theorem-2.i.weak",),
        proof="notebooks/11-theorem-2.ipynb#proof-window",
    ),
    claim(
        "eq-48",
        "Equation 48",
        "",
        "The estimate's powers reproduce the window from its first signal on, up to sums of powers times residuals.",
        "numerical sampling",
        "holds-corrected",
        stated=partial(check_window, equation=48, printed=True),
        control=Control("the formula as printed", partial(check_window, equation=48, printed=True)),
        corrected=partial(check_window, equation=48),
        reason="In (48) the sum starts from x(k-N+1), N being the window. By (47) the next transition has the error "
        "e_2, so the sum has the errors e_{l+2}, not e_{l+1}. If the sum starts from x(k-N), the printed index is "
        "right, and (8) follows for N steps instead of N-1.",
        uses=("eq-47",),
        proof="notebooks/11-theorem-2.ipynb#proof-window",
    ),
    claim(
        "eq-49",
        "Equation 49",
        "",
        "The same with the limits of the powers, and the differences to them.",
        "numerical sampling",
        "holds-corrected",
        stated=partial(check_window, equation=49, printed=True),
        control=Control("the formula as printed", partial(check_window, equation=49, printed=True)),
        corrected=partial(check_window, equation=49),
        reason=_AS_IN_48,
        uses=("eq-48",),
        proof="notebooks/11-theorem-2.ipynb#proof-window",
    ),
    claim(
        "eq-50",
        "Equation 50",
        "dum",
        "All differences collected in e_j, the limit's powers predict j steps ahead.",
        "numerical sampling",
        "holds-corrected",
        stated=partial(check_window, equation=50, printed=True),
        control=Control("the formula as printed", partial(check_window, equation=50, printed=True)),
        corrected=partial(check_window, equation=50),
        reason=_AS_IN_48,
        uses=("eq-49",),
        proof="notebooks/11-theorem-2.ipynb#proof-window",
    ),
    claim(
        "eq-51",
        "Equation 51",
        "",
        "Both the limit's powers plus e_j and the powers of (A, B) reproduce x(j+k), along the applied inputs.",
        "numerical sampling",
        "holds-corrected",
        stated=partial(check_window, equation=51, printed=True),
        control=Control("the formula as printed", partial(check_window, equation=51, printed=True)),
        corrected=partial(check_window, equation=51),
        reason=_AS_IN_48,
        uses=("eq-18", "eq-50"),
        proof="notebooks/11-theorem-2.ipynb#proof-window",
    ),
)
