"""Linear plants, also from python-control."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rhl._checks import Array, common_batch, positive, real_array, square
from rhl.errors import InputError
from rhl.plants._realisation import held, realise
from rhl.plants.base import check_lengths

if TYPE_CHECKING:
    import control


@dataclass(frozen=True, eq=False)
class LinearPlant:
    r"""The plant :math:`z(k+1) = F z(k) + G v(k),\; y(k) = H z(k)`, equation (1).

    The scheme assumes (F, G) stabilizable and (F, H) detectable (Assumption 1); this class does not, so that you
    can try other plants.

    Parameters
    ----------
    F, G, H : array_like, shapes (..., n, n), (..., n, q) and (..., p, n)
        State, input and output matrix; InputError if the shapes do not fit or an entry is not finite.
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
    def from_control(
        cls, system: control.StateSpace | control.TransferFunction, sampling: float | None = None
    ) -> LinearPlant:
        """Take a system without feedthrough from python-control; no slycot is needed.

        A state space gives its own F, G, H. A transfer function is realised: each input by one companion form over the
        common denominator of its column, which is controllable, reduced to the observable part. No mode is then hidden
        (an unstable pole shared by channels would otherwise make the plant undetectable), and the order is the McMillan
        degree. Roots of a numerator and a denominator that agree to about ten digits count as cancelled.

        ``sampling`` is the time between samples of a system in continuous time, positive; its inputs are held constant
        in between, and its state at the samples is the plant's.

        InputError if the system is neither of the two, is in continuous time (``dt`` neither positive nor True) without
        ``sampling`` or in discrete time with it, has feedthrough, is improper, holds complex numbers, or is zero. Any
        number of inputs and outputs is allowed.

        Examples
        --------
        >>> import control
        >>> plant = LinearPlant.from_control(control.tf([1.0], [1.0, -1.1], True))
        >>> plant.F, plant.G, plant.H
        (array([[1.1]]), array([[1.]]), array([[1.]]))
        >>> LinearPlant.from_control(control.tf([1.0], [1.0, 0.0]), sampling=0.5).G
        array([[0.5]])
        """
        import control  # imported here, because it loads matplotlib

        if not isinstance(system, control.StateSpace | control.TransferFunction):
            raise InputError(
                f"system must be a control.StateSpace or a control.TransferFunction, got {type(system).__name__}; "
                "use rhl.plants.FunctionPlant for another kind of plant"
            )
        if sampling is not None:
            sampling = positive("sampling", sampling)
        discrete = system.isdtime(strict=True)
        if discrete and sampling is not None:
            raise InputError(f"sampling must be left out for a system in discrete time, got {sampling:g}")
        if not discrete and sampling is None:
            known = "say dt=True when making it if it is, or " if system.dt is None else ""
            raise InputError(
                f"system must be in discrete time (dt positive or True), got dt={system.dt}; {known}give the time "
                "between samples, as in LinearPlant.from_control(system, sampling=Ts)"
            )
        with np.errstate(over="ignore", invalid="ignore"):
            transfer = isinstance(system, control.TransferFunction)
            F, G, H = realise(system) if transfer else _of_state_space(system)
        return cls(F, G, H) if sampling is None else cls(*held(F, G, sampling), H)

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

    def batch(self, z: Array) -> tuple[int, ...]:
        """Return the batch axes of the plant's matrices with those of a state, shape (..., n)."""
        return common_batch(F=(self.F, 2), G=(self.G, 2), H=(self.H, 2), z=(z, 1))

    def step(self, z: Array, v: Array) -> Array:
        """Return F z + G v, shape (..., n); InputError if z or v has another length."""
        z, v = check_lengths(z=(z, self.n), v=(v, self.q))
        common_batch(F=(self.F, 2), z=(z, 1), v=(v, 1))
        return np.einsum("...ab,...b->...a", self.F, z) + np.einsum("...ab,...b->...a", self.G, v)

    def output(self, z: Array) -> Array:
        """Return H z, shape (..., p); InputError if z has another length."""
        (z,) = check_lengths(z=(z, self.n))
        return np.einsum("...ab,...b->...a", self.H, z)


def _of_state_space(system: control.StateSpace) -> tuple[Array, Array, Array]:
    if any(np.iscomplexobj(M) for M in (system.A, system.B, system.C, system.D)):
        raise InputError("system must have real matrices, got complex ones; give the equivalent real system")
    if np.any(system.D):
        q = system.ninputs
        if system.isdtime(strict=True):
            remedy = "put one step of delay before it with system * control.ss("
            remedy += f"np.zeros(({q}, {q})), np.eye({q}), np.eye({q}), 0, system.dt)"
        else:
            remedy = "model the lag of a sensor or an actuator"
        raise InputError(f"system must have D = 0 (y = H z, equation (1)), got a feedthrough; {remedy}")
    return system.A, system.B, system.C
