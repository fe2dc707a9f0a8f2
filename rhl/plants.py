"""Plants: what the scheme controls without knowing it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, Protocol, get_args

import numpy as np

from rhl._checks import Array, InputError, common_batch, positive, real_array, square

if TYPE_CHECKING:
    import control


class Plant(Protocol):
    """A discrete-time system z(k+1) = step(z, v), y = output(z) with sizes n, q, p."""

    @property
    def n(self) -> int:
        """Size of the state z."""

    @property
    def q(self) -> int:
        """Size of the input v."""

    @property
    def p(self) -> int:
        """Size of the output y."""

    def step(self, z: Array, v: Array) -> Array:
        """Return the next state, shape (..., n)."""

    def output(self, z: Array) -> Array:
        """Return the output, shape (..., p)."""


@dataclass(frozen=True, eq=False)
class LinearPlant:
    r"""The plant :math:`z(k+1) = F z(k) + G v(k),\; y(k) = H z(k)`, equation (1).

    Parameters
    ----------
    F : array_like, shape (..., n, n)
        State matrix.
    G : array_like, shape (..., n, q)
        Input matrix.
    H : array_like, shape (..., p, n)
        Output matrix.

    Raises
    ------
    InputError
        If the shapes do not fit or an entry is not finite.

    Notes
    -----
    Source: equation (1). The scheme assumes (F, G) stabilizable and (F, H) detectable (Assumption 1); this class
    does not, so that readers can see what happens otherwise.
    """

    F: Array
    G: Array
    H: Array

    def __post_init__(self) -> None:
        F = square("F", self.F)
        object.__setattr__(self, "F", F)
        object.__setattr__(self, "G", real_array("G", self.G, (F.shape[-1], None)))
        object.__setattr__(self, "H", real_array("H", self.H, (None, F.shape[-1])))
        common_batch(F=(F, 2), G=(self.G, 2), H=(self.H, 2))

    @classmethod
    def from_statespace(cls, system: control.StateSpace) -> LinearPlant:
        """Take F, G, H from a discrete-time ``control.StateSpace`` without feedthrough.

        Parameters
        ----------
        system : control.StateSpace
            Discrete-time (``dt`` positive or True) with D = 0.

        Returns
        -------
        LinearPlant

        Raises
        ------
        InputError
            If the system is not a state space, is in continuous time, or has feedthrough.
        """
        import control  # here, because it brings matplotlib along

        if not isinstance(system, control.StateSpace):
            raise InputError(f"system must be a control.StateSpace, got {type(system).__name__}")
        if not system.isdtime(strict=True):
            raise InputError(
                f"system must be in discrete time (dt positive or True), got dt={system.dt}; "
                "discretise it first with control.sample_system(system, Ts)"
            )
        if np.any(system.D):
            raise InputError("system must have D = 0 (y = H z, equation (1)), got a feedthrough")
        if any(np.iscomplexobj(M) for M in (system.A, system.B, system.C)):
            raise InputError("system must have real matrices, got complex ones")
        return cls(system.A, system.B, system.C)

    @property
    def n(self) -> int:
        """Size of the state z."""
        return int(self.F.shape[-1])

    @property
    def q(self) -> int:
        """Size of the input v."""
        return int(self.G.shape[-1])

    @property
    def p(self) -> int:
        """Size of the output y."""
        return int(self.H.shape[-2])

    def step(self, z: Array, v: Array) -> Array:
        """Return F z + G v, shape (..., n)."""
        return np.einsum("...ab,...b->...a", self.F, z) + np.einsum("...ab,...b->...a", self.G, v)

    def output(self, z: Array) -> Array:
        """Return H z, shape (..., p)."""
        return np.einsum("...ab,...b->...a", self.H, z)


ArmVariant = Literal["data", "printed"]

# Rows: d x2/dt = a x3 - b x2 - c sin(x1); d x3/dt = -d x3 - e x2 + f u.
_ARM_COEFFICIENTS: dict[ArmVariant, tuple[float, ...]] = {
    "data": (400 / 11, 19.12 / 11, 1000 / 11, 86.04, 3.64, 100.0),
    "printed": (36.4, 1.7, 1309.0, 1000.0, 3.6, 100.0),
}


@dataclass(frozen=True)
class RobotArm:
    r"""The single-link robot arm with DC motor, equation (24), Euler-discretised.

    .. math::
        x_1^+ &= x_1 + h x_2 \\
        x_2^+ &= x_2 + h (a x_3 - b x_2 - c \sin x_1) \\
        x_3^+ &= x_3 + h (-d x_3 - e x_2 + f u)

    Parameters
    ----------
    variant : {"data", "printed"}
        "printed" has the coefficients in the paper's text, (a, b, c, d, e, f) = (36.4, 1.7, 1309, 1000, 3.6, 100);
        "data" has those that the published curves obey, (400/11, 19.12/11, 1000/11, 86.04, 3.64, 100).
    h : float
        Step size in seconds.

    Notes
    -----
    State: angle x1 (rad), angular velocity x2 (rad/s), motor current x3 (A); input: voltage u (V); the whole state is
    measured, y = x. Source: equation (24); the "data" coefficients are this project's observation.
    """

    variant: ArmVariant = "data"
    h: float = 0.01

    def __post_init__(self) -> None:
        if self.variant not in get_args(ArmVariant):
            raise InputError(f"variant must be one of {', '.join(get_args(ArmVariant))}, got {self.variant!r}")
        positive("h", self.h)

    @property
    def n(self) -> int:
        """Size of the state, 3."""
        return 3

    @property
    def q(self) -> int:
        """Size of the input, 1."""
        return 1

    @property
    def p(self) -> int:
        """Size of the output, 3."""
        return 3

    def step(self, z: Array, v: Array) -> Array:
        """Return the state one step of h seconds later, shape (..., 3)."""
        a, b, c, d, e, f = _ARM_COEFFICIENTS[self.variant]
        x1, x2, x3 = z[..., 0], z[..., 1], z[..., 2]
        rate = np.stack([x2, a * x3 - b * x2 - c * np.sin(x1), -d * x3 - e * x2 + f * v[..., 0]], axis=-1)
        return z + self.h * rate

    def output(self, z: Array) -> Array:
        """Return the state itself, shape (..., 3)."""
        return z
