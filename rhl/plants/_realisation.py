"""State-space matrices from transfer functions, and the observable part of a system."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rhl._checks import Array, real_array, square
from rhl.errors import InputError

# The new part of a row of the observability matrix counts as zero below this share of |F| (or of the rows of H, each
# scaled to norm one). Rounding with a few dozen states stays below 1e-13, and measurement noise hides such a weakly
# observable mode.
_SEEN_RTOL = 1e-10


def observable_basis(F: ArrayLike, H: ArrayLike) -> tuple[Array, int]:
    r"""Find the observable part of the state, :math:`\mathrm{im}\,[H' \; F'H' \; F'^2H' \; \dots]`.

    InputError if the shapes of F, (n, n), and H, (p, n), do not fit or an entry is not finite.

    Returns
    -------
    array, shape (n, r)
        Orthonormal columns V; z_o = V'z obeys z_o+ = V'FV z_o + V'G v, y = HV z_o, and z only enters y through it.
    int
        The observability index: the least m for which m block rows of the observability matrix have its full rank, at
        least 1.

    Notes
    -----
    The staircase algorithm: each block is made orthogonal to those before it and reduced to its rank. Powers of F are
    never formed, so unstable and stiff plants are treated as reliably as others.
    """
    F = real_array("F", F, (None, None))
    H = real_array("H", H, (None, square("F", F).shape[-1]))
    if F.ndim > 2 or H.ndim > 2:
        raise InputError(f"F and H must be single matrices, got shapes {F.shape} and {H.shape}; take one of the batch")
    # Outputs may be in any units, so only a row's direction matters. Its square may leave the range of float64.
    largest = np.max(np.abs(H), axis=1, keepdims=True)
    H = H / np.where(largest > 0, largest, 1.0)
    lengths = np.linalg.norm(H, axis=1, keepdims=True)
    block = (H / np.where(lengths > 0, lengths, 1.0)).T
    size, basis, index = 1.0, np.zeros((len(F), 0)), 0
    while True:
        for _ in range(2):  # twice, since rounding leaves a component along the previous columns
            block = block - basis @ (basis.T @ block)
        U, sigma, _ = np.linalg.svd(block, full_matrices=False)
        new = U[:, sigma > _SEEN_RTOL * size]
        if new.shape[1] == 0:
            return basis, max(index, 1)
        basis, index = np.concatenate([basis, new], axis=1), index + 1
        if basis.shape[1] == len(F):
            return basis, index
        block, size = F.T @ new, float(np.linalg.norm(F, 2))


def held(F: Array, G: Array, seconds: float) -> tuple[Array, Array]:
    r"""Sample dz/dt = F z + G v with v held constant between samples: :math:`e^{Ft}` and its integral times G."""
    from scipy.linalg import expm  # imported here, because most plants do not need it

    n, q = G.shape
    with np.errstate(over="ignore", invalid="ignore"):
        both = expm(seconds * np.block([[F, G], [np.zeros((q, n + q))]])) if n else np.eye(q)
    if not np.all(np.isfinite(both)):
        raise InputError(
            f"sampling must be short enough to keep the state in the range of float64 over one sample, got {seconds:g}"
        )
    return both[:n, :n], both[:n, n:]


def realise(system: Any) -> tuple[Array, Array, Array]:
    """Return F, G, H of a transfer function, controllable by construction and reduced to its observable part."""
    p, q = system.noutputs, system.ninputs
    columns = []
    for j in range(q):
        numerators, denominators = [], []
        for i in range(p):
            num, den = (np.trim_zeros(np.atleast_1d(part[i][j]), "f") for part in (system.num, system.den))
            if np.iscomplexobj(num) or np.iscomplexobj(den):
                raise InputError("system must have real coefficients, got complex ones; give the real system")
            if len(num) >= len(den):
                missing = len(num) - len(den) + 1
                slower = f"delay it by multiplying that channel with control.tf([1], {[1] + [0] * missing}, system.dt)"
                if not system.isdtime(strict=True):
                    slower = f"model the lag of a sensor or an actuator: {missing} more poles in that channel"
                raise InputError(
                    f"system must be strictly proper (y = H z, equation (1)), got degree {len(num) - 1} over "
                    f"{len(den) - 1} from input {j} to output {i}; {slower}"
                )
            numerators.append(num / den[0])
            denominators.append(den / den[0])
        columns.append(_companion(numerators, denominators))
    n = sum(len(F) for F, _ in columns)
    if n == 0:
        raise InputError("system must respond to an input, got a transfer function that is zero; check its numerators")
    F, G, H = np.zeros((n, n)), np.zeros((n, q)), np.zeros((p, n))
    at = 0
    for j, (Fj, Hj) in enumerate(columns):
        if len(Fj) == 0:
            continue
        rows = slice(at, at + len(Fj))
        F[rows, rows], H[:, rows], G[at, j] = Fj, Hj, 1.0
        at += len(Fj)
    if not (np.all(np.isfinite(F)) and np.all(np.isfinite(H))):
        raise InputError(
            "system must have coefficients in the range of floating-point numbers after division by the denominator's "
            "first one, got larger ones; scale its input, its output or time"
        )
    V, _ = observable_basis(F, H)
    return (F, G, H) if V.shape[1] == n else (V.T @ F @ V, V.T @ G, H @ V)


def _companion(numerators: list[Array], denominators: list[Array]) -> tuple[Array, Array]:
    """Return F and H of one input's column over the product of its distinct denominators; G is (1, 0, ..., 0)."""
    distinct: list[Array] = []
    for num, den in zip(numerators, denominators, strict=True):
        if len(num) and not any(np.array_equal(den, other) for other in distinct):
            distinct.append(den)
    common = np.array([1.0])
    for den in distinct:
        common = np.polymul(common, den)
    n = len(common) - 1
    F, H = np.eye(n, k=-1), np.zeros((len(numerators), n))
    F[:1] = -common[1:]
    for row, num, den in zip(H, numerators, denominators, strict=True):
        if len(num):
            raised = np.polymul(num, np.polydiv(common, den)[0])
            row[n - len(raised) :] = raised
    return F, H
