"""The robot arm of the paper's second simulation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from rhl._checks import Array, choice, common_batch, positive
from rhl.plants.base import check_lengths

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

    State: angle x1 (rad), angular velocity x2 (rad/s), motor current x3 (A); input: voltage u (V); the whole state is
    measured, y = x. This project inferred the "data" coefficients.

    Parameters
    ----------
    variant : {"data", "printed"}
        "printed" has the coefficients in the paper's text, (a, b, c, d, e, f) = (36.4, 1.7, 1309, 1000, 3.6, 100);
        "data" has those that reproduce the published curves, (400/11, 19.12/11, 1000/11, 86.04, 3.64, 100).
    h : float
        Step size in seconds.
    """

    variant: ArmVariant = "data"
    h: float = 0.01

    def __post_init__(self) -> None:
        choice("variant", self.variant, get_args(ArmVariant))
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
        """Return the state one step of h seconds later, shape (..., 3); InputError if z or v has another length."""
        z, v = check_lengths(z=(z, 3), v=(v, 1))
        common_batch(z=(z, 1), v=(v, 1))
        a, b, c, d, e, f = _ARM_COEFFICIENTS[self.variant]
        x1, x2, x3 = z[..., 0], z[..., 1], z[..., 2]
        rate = np.stack([x2, a * x3 - b * x2 - c * np.sin(x1), -d * x3 - e * x2 + f * v[..., 0]], axis=-1)
        return z + self.h * rate

    def output(self, z: Array) -> Array:
        """Return the state itself, shape (..., 3); InputError if z has another length."""
        (z,) = check_lengths(z=(z, 3))
        return z
