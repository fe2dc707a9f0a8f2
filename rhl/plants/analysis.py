"""Analysis of a known plant: linearisation, stabilizability, detectability, signal model (55)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rhl._checks import Array, instance, integer, read_only, real_array, reason, square
from rhl.errors import InputError, NotFiniteError
from rhl.model import SignalModel
from rhl.plants._realisation import observable_basis
from rhl.plants.base import Plant, check_plant
from rhl.plants.linear import LinearPlant

# The step of central differences: the truncation error is proportional to its square, rounding to its inverse. At the
# cube root of the machine precision both are near 4e-11 of the plant's size, for third derivatives of that size.
_STEP = float(np.finfo(np.float64).eps ** (1 / 3))
# How far an equilibrium may move in one step, relative to its own size and one: callers find theirs by iterating.
_REST_RTOL = 1e-6
# The computed values of a triple eigenvalue on the unit circle scatter by the cube root of the machine precision, 6e-6.
_CIRCLE_TOL = 1e-5
# A double eigenvalue is computed to about 1.5e-8 only, and the singular value of a rank defect there is as large.
_DEFECT_RTOL = 1e-7


@dataclass(frozen=True, eq=False)
class Modes:
    r"""The modes of a plant that do not decay, and how well the inputs reach (or the outputs observe) each of them.

    Source: the test of Popov, Belevitch and Hautus.

    Attributes
    ----------
    eigenvalues : array of complex, shape (r,)
        Those of F with :math:`|\lambda| \ge 1`, up to a tolerance of 1e-5 for a scattered triple eigenvalue.
    margins : array, shape (r,)
        The smallest singular value of :math:`[\lambda I - F,\; G]`, or of :math:`[\lambda I - F;\; H]`, at each.
    scale : float
        The norm of [F, G] or [F; H], to which the margins are compared.

    Examples
    --------
    >>> modes = stabilizability([[1.5, 0.0], [0.0, 0.5]], [[0.0], [1.0]])
    >>> modes.eigenvalues.real, modes.margins, modes.holds
    (array([1.5]), array([0.]), False)
    """

    eigenvalues: NDArray[np.complex128]
    margins: Array
    scale: float

    @property
    def holds(self) -> bool:
        """Whether every margin is above 1e-7 of the scale; true if every mode decays."""
        return bool(np.all(self.margins > _DEFECT_RTOL * self.scale))

    @property
    def worst(self) -> tuple[complex, float] | None:
        """The eigenvalue with the smallest margin, and that margin; None if every mode decays."""
        if len(self.margins) == 0:
            return None
        at = int(np.argmin(self.margins))
        return complex(self.eigenvalues[at]), float(self.margins[at])


def stabilizability(F: ArrayLike, G: ArrayLike) -> Modes:
    r"""Test whether inputs reach every mode that does not decay: the rank of :math:`[\lambda I - F,\; G]`.

    ``holds`` of the result says whether (F, G), shapes (n, n) and (n, q), is stabilizable, as Assumption 1 requires.
    InputError if the shapes do not fit or an entry is not finite.

    Examples
    --------
    >>> stabilizability([[1.1, 0.0], [0.0, 0.5]], [[1.0], [0.0]]).holds
    True
    >>> stabilizability([[1.1, 0.0], [0.0, 0.5]], [[0.0], [1.0]]).worst
    ((1.1+0j), 0.0)
    """
    F = _single("F", square("F", F))
    return _modes(F, _single("G", real_array("G", G, (len(F), None))))


def detectability(F: ArrayLike, H: ArrayLike) -> Modes:
    r"""Test whether every mode that does not decay is observable: the rank of :math:`[\lambda I - F;\; H]`.

    ``holds`` of the result says whether (F, H), shapes (n, n) and (p, n), is detectable, as Assumption 1 requires.
    InputError if the shapes do not fit or an entry is not finite.

    Examples
    --------
    >>> F = [[1.1, 0.0], [0.0, 1.2]]
    >>> detectability(F, [[1.0, 1.0]]).holds, detectability(F, [[1.0, 0.0]]).holds
    (True, False)
    """
    F = _single("F", square("F", F))
    return _modes(F.T, _single("H", real_array("H", H, (None, len(F)))).T)


def _modes(F: Array, G: Array) -> Modes:
    values = np.linalg.eigvals(F).astype(np.complex128)
    values = values[np.abs(values) >= 1 - _CIRCLE_TOL]
    values.flags.writeable = False
    margins = [np.linalg.svd(_hautus(F, G, value), compute_uv=False)[-1] for value in values]
    return Modes(values, read_only(margins), float(np.linalg.norm(np.concatenate([F, G], axis=1), 2)))


def _hautus(F: Array, G: Array, value: complex) -> NDArray[np.complex128]:
    return np.concatenate([value * np.eye(len(F)) - F, G], axis=1)


def _single(name: str, array: Array) -> Array:
    if array.ndim > 2:
        raise InputError(f"{name} must be a single matrix, got shape {array.shape}; take one of the batch")
    return array


def pbh(A: Array, B: Array, least_modulus: float = 0.0) -> float:
    """Return the smallest singular value of [lambda I - A, B] over the eigenvalues with |lambda| >= least_modulus.

    Positive with ``least_modulus`` 0: (A, B) is controllable; with 1: stabilizable (Popov, Belevitch, Hautus). Infinite
    if no eigenvalue is so large.
    """
    values = [value for value in np.linalg.eigvals(A) if abs(value) >= least_modulus]
    return min((float(np.linalg.svd(_hautus(A, B, value), compute_uv=False)[-1]) for value in values), default=np.inf)


def spectral_radius(F: Array) -> float:
    """Return the largest modulus of an eigenvalue; 0 for an empty matrix."""
    return float(np.max(np.abs(np.linalg.eigvals(F)), initial=0.0))


def linearise(plant: Plant, z: ArrayLike | None = None, v: ArrayLike | None = None) -> LinearPlant:
    r"""Linearise a plant about an equilibrium, by central differences.

    .. math::
        F = \frac{\partial f}{\partial z}(z, v), \qquad G = \frac{\partial f}{\partial v}(z, v), \qquad
        H = \frac{\partial g}{\partial z}(z)
        \qquad\text{of } z(k+1) = f(z(k), v(k)),\; y(k) = g(z(k))

    InputError if (z, v) does not fit the plant or is no equilibrium, or the plant is not finite near it.

    Parameters
    ----------
    plant : Plant
        Any plant; a linear one is returned unchanged.
    z, v : array_like, shapes (n,) and (q,), optional
        State at rest, and the input that keeps it there; zero by default.

    Returns
    -------
    LinearPlant
        The plant of deviations from z, v and the output there. Its relative error is about 1e-10 for plants whose third
        derivatives are no larger than the first ones, with 1e-7 as a safe bound. It is exact up to rounding if the
        plant is linear or quadratic.
    """
    check_plant(plant)
    at_z = np.zeros(plant.n) if z is None else _vector("z", z, plant.n)
    at_v = np.zeros(plant.q) if v is None else _vector("v", v, plant.q)
    rest = real_array("the plant's step from the equilibrium", plant.step(at_z, at_v))
    if rest.shape[-1] == plant.n:
        moved = float(np.max(np.abs(rest - at_z)))
        name = "z = 0 with v = 0" if z is None and v is None else "z with v"
        if moved > _REST_RTOL * (1 + float(np.max(np.abs(at_z)))):
            raise InputError(
                f"{name} must be an equilibrium, where a step leaves z unchanged, got a step that moves z by "
                f"{moved:.3g}; solve step(z, v) = z for one first"
            )
    if isinstance(plant, LinearPlant):
        return plant

    def derivative(name: str, function: str, about: Array, size: int) -> Array:
        columns = []
        for i, value in enumerate(about):
            ends = []
            for sign in (1.0, -1.0):
                shifted = about.copy()
                shifted[i] = value + sign * _STEP * max(1.0, abs(value))
                if function == "output":
                    out = plant.output(shifted)
                else:
                    out = plant.step(shifted, at_v) if name == "F" else plant.step(at_z, shifted)
                ends.append((shifted[i], real_array(f"the plant's {function} near the equilibrium", out, (size,))))
            (above, high), (below, low) = ends
            # The rounded distance, not the intended one.
            columns.append((high - low) / (above - below))
        return np.stack(columns, axis=-1)

    return LinearPlant(
        derivative("F", "step", at_z, plant.n),
        derivative("G", "step", at_v, plant.n),
        derivative("H", "output", at_z, plant.p),
    )


def _vector(name: str, value: ArrayLike, length: int) -> Array:
    vector = real_array(name, value, (length,))
    if vector.ndim != 1:
        raise InputError(f"{name} must have shape ({length},), got {vector.shape}; take one of the batch")
    return vector


def observability(F: Array, H: Array, m: int) -> Array:
    """Return O = [H F^(m-1); ...; H F; H], newest output first as in equation (54), shape (m p, n)."""
    return np.concatenate([H @ np.linalg.matrix_power(F, m - 1 - i) for i in range(m)])


def observability_index(F: ArrayLike, H: ArrayLike) -> int:
    """Return the least m >= 1 for which the observability matrix of m outputs has the rank of that of all n.

    As many outputs must be stacked for a signal model (Lemma 6). F has shape (n, n) and H (p, n); (F, H) need not be
    observable. InputError if the shapes do not fit or an entry is not finite.
    """
    return observable_basis(F, H)[1]


def observable_part(plant: LinearPlant) -> LinearPlant:
    """Return the subsystem (53) of a single plant, which determines the outputs.

    It is in coordinates z_o = V'z with V orthonormal from an orthogonal staircase: its outputs from V'z(0) are those of
    the plant from z(0). InputError if H is zero or the plant is a batch.

    Examples
    --------
    >>> observable_part(LinearPlant([[1.1, 0.0], [1.0, 0.9]], [[1.0], [0.0]], [[1.0, 0.0]])).n
    1
    """
    instance("plant", plant, LinearPlant)
    V, _ = observable_basis(plant.F, plant.H)
    if V.shape[1] == 0:
        raise InputError("the plant's H must not be zero, got outputs that are always zero; choose other outputs")
    return LinearPlant(V.T @ plant.F @ V, V.T @ _single("G", plant.G), plant.H @ V)


def inputs_to_stack(F: Array, G: Array, H: Array, m: int) -> Array:
    """Return the matrix R of x(k) = O z_s(k-m+1) + R u(k-1), equation (54), shape (m p, m q).

    Its last block column, that of v(k-m), is zero.
    """
    p, q = H.shape[0], G.shape[1]
    R = np.zeros((m * p, m * q))
    for row in range(m):
        # Row `row` holds y(k - row), which v(k-1-j) reaches through H F^(j-row) G for j >= row.
        for j in range(row, m - 1):
            R[row * p : (row + 1) * p, j * q : (j + 1) * q] = H @ np.linalg.matrix_power(F, j - row) @ G
    return R


def signal_model(F: Array, G: Array, H: Array, m: int) -> SignalModel:
    """Return the pair (A, B) of equation (55), of sizes m p and m q, for the subsystem (53) with (F, H) observable.

    m outputs and inputs are stacked, at least as many as the observability index.
    """
    q = G.shape[1]
    O, R = observability(F, H, m), inputs_to_stack(F, G, H, m)
    A = O @ F @ np.linalg.pinv(O)
    B = R.copy()
    B[:, q:] -= (A @ R)[:, :-q]
    B[:, -q:] += O @ G
    return SignalModel(A, B)


def growth_alone(plant: LinearPlant, z0: ArrayLike, steps: int) -> Array:
    r"""Return the growth of outputs without inputs, :math:`\max_{k \le steps} |H F^k z_0| / |H z_0|`, shape (...).

    Sizes are those of the largest entry. Infinite if a number leaves the range of float64; one if y is zero
    throughout. z0 has shape (..., n), and leading axes broadcast with those of the plant.

    Examples
    --------
    >>> float(growth_alone(LinearPlant([[2.0]], [[1.0]], [[1.0]]), [3.0], steps=5))
    32.0
    """
    instance("plant", plant, LinearPlant)
    z = real_array("z0", z0, (plant.n,))
    first = np.max(np.abs(np.einsum("...pn,...n->...p", plant.H, z)), axis=-1)
    largest = first
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(integer("steps", steps, 1)):
            z = np.einsum("...ab,...b->...a", plant.F, z)
            size = np.max(np.abs(np.einsum("...pn,...n->...p", plant.H, z)), axis=-1)
            largest = np.maximum(largest, np.where(np.isfinite(size), size, np.inf))
    grown = largest / np.where(first > 0, first, 1.0)
    return np.asarray(np.where(first > 0, grown, np.where(largest > 0, np.inf, 1.0)))


def rough_model(plant: LinearPlant, outputs: int, inputs: int) -> SignalModel:
    r"""Make the lifted model of equation (55) from a rough physical model, for the scheme to start from.

    .. math::
        x(k+1) = A x(k) + B u(k), \qquad x(k) = [y(k); \dots; y(k-\bar N_y+1)], \quad u(k) = [v(k); \dots;
        v(k-\bar N_v+1)]

    holds on every trajectory of the given plant, once the stacks are full of measurements. InputError if a length is
    below the observability index, or the plant is not a single linear one.

    Parameters
    ----------
    plant : LinearPlant
        The rough model; its unobservable part is left out. ``linearise`` makes one from a nonlinear plant.
    outputs, inputs : int
        :math:`\bar N_y` and :math:`\bar N_v`, both at least the plant's observability index m.

    Returns
    -------
    SignalModel
        Of sizes N_y p and N_v q. With N = min(N_y, N_v) its first N blocks are the pair (55) of length N; earlier
        outputs are only shifted, earlier inputs have no effect.

    Notes
    -----
    Source: equation (55) and Lemma 6, of the observable part (53). If more outputs than the index are stacked, A is
    not unique; this is the one of least norm that the proof's pseudo-inverse gives.
    """
    outputs, inputs = integer("outputs", outputs, 1), integer("inputs", inputs, 1)
    if not isinstance(cast(object, plant), LinearPlant):
        raise InputError(
            f"plant must be a LinearPlant, got {type(plant).__name__}; "
            "pass rhl.plants.analysis.linearise(plant) instead"
        )
    part = observable_part(plant)
    index = observability_index(part.F, part.H)
    for name, length in (("outputs", outputs), ("inputs", inputs)):
        if length < index:
            raise InputError(
                f"{name} must be at least {index}, the observability index of the plant, got {length}; "
                f"stack {index} outputs and inputs or more"
            )
    m, p, q = min(outputs, inputs), part.p, part.q
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            core = signal_model(part.F, part.G, part.H, m)
    except (NotFiniteError, np.linalg.LinAlgError) as error:
        raise InputError(
            f"plant must have powers of F up to {m} in the range of floating-point numbers, got {reason(error)}; stack "
            "less, or scale its states"
        ) from error
    A, B = np.zeros((outputs * p, outputs * p)), np.zeros((outputs * p, inputs * q))
    A[: m * p, : m * p], B[: m * p, : m * q] = core.A, core.B
    # y(k+1-i) for i >= m is the i-th block of x(k+1) and the one before it of x(k).
    older = (outputs - m) * p
    A[m * p :, (m - 1) * p : (m - 1) * p + older] = np.eye(older)
    return SignalModel(A, B)
