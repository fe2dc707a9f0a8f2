"""Plants: what the scheme controls without knowing it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, Protocol, get_args

import numpy as np
from numpy.typing import ArrayLike

from rhl._checks import (
    Array,
    InputError,
    choice,
    common_batch,
    describe,
    integer,
    members,
    positive,
    read_only,
    real_array,
    reason,
    square,
)
from rhl._realisation import how_to_discretise, realise

if TYPE_CHECKING:
    import control


class PlantError(InputError):
    """A function that the caller gave for a plant does not do what a plant must; the message says which and what."""


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
    def from_control(cls, system: control.StateSpace | control.TransferFunction) -> LinearPlant:
        r"""Take a discrete-time system without feedthrough from python-control.

        A state space gives its own F, G, H. A transfer function is realised: each input by one companion form over the
        common denominator of its column, which is controllable; what the outputs do not see of that is taken away, so
        that no mode is hidden (an unstable pole that channels share would otherwise make the plant undetectable).

        Parameters
        ----------
        system : control.StateSpace or control.TransferFunction
            In discrete time (``dt`` positive or True), strictly proper (D = 0), with real numbers; any numbers of
            inputs and outputs.

        Returns
        -------
        LinearPlant
            Of the state space's order, or of the transfer function's McMillan degree. Roots of a numerator and a
            denominator that agree to ten digits or so count as cancelled.

        Raises
        ------
        InputError
            If the system is neither of the two, is in continuous time, has feedthrough, is improper, holds complex
            numbers, or is zero.

        Notes
        -----
        No slycot is needed.

        Examples
        --------
        >>> import control
        >>> plant = LinearPlant.from_control(control.tf([1.0], [1.0, -1.1], True))
        >>> plant.F, plant.G, plant.H
        (array([[1.1]]), array([[1.]]), array([[1.]]))
        """
        import control  # here, because it brings matplotlib along

        if not isinstance(system, control.StateSpace | control.TransferFunction):
            raise InputError(
                f"system must be a control.StateSpace or a control.TransferFunction, got {type(system).__name__}; "
                "a plant of another kind is an rhl.plants.FunctionPlant"
            )
        if not system.isdtime(strict=True):
            raise InputError(how_to_discretise(system, isinstance(system, control.TransferFunction)))
        if isinstance(system, control.TransferFunction):
            with np.errstate(over="ignore", invalid="ignore"):
                return cls(*realise(system))
        if any(np.iscomplexobj(M) for M in (system.A, system.B, system.C, system.D)):
            raise InputError(
                "system must have real matrices, got complex ones; give the real system that they stand for"
            )
        if np.any(system.D):
            q = system.ninputs
            raise InputError(
                "system must have D = 0 (y = H z, equation (1)), got a feedthrough; put one step of delay before it "
                f"with system * control.ss(np.zeros(({q}, {q})), np.eye({q}), np.eye({q}), 0, system.dt)"
            )
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
        """Return F z + G v, shape (..., n); InputError if z or v has another length."""
        z, v = check_lengths(z=(z, self.n), v=(v, self.q))
        common_batch(F=(self.F, 2), z=(z, 1), v=(v, 1))
        return np.einsum("...ab,...b->...a", self.F, z) + np.einsum("...ab,...b->...a", self.G, v)

    def output(self, z: Array) -> Array:
        """Return H z, shape (..., p); InputError if z has another length."""
        (z,) = check_lengths(z=(z, self.n))
        return np.einsum("...ab,...b->...a", self.H, z)


def check_lengths(**vectors: tuple[ArrayLike, int]) -> list[Array]:
    """Return finite vectors as arrays; refuse those whose last axis has another length than the one beside them."""
    arrays = []
    for name, (vector, length) in vectors.items():
        array = real_array(name, vector)
        if array.shape[-1:] != (length,):
            raise InputError(f"{name} must have shape (..., {length}) for this plant, got {array.shape}")
        arrays.append(array)
    return arrays


def check_plant(value: Any) -> None:
    """Refuse what is no plant."""
    kind = "a plant (LinearPlant, FunctionPlant, or your own class with n, q, p, step and output)"
    members("plant", value, kind, "n", "q", "p", "step", "output")


@dataclass(frozen=True, eq=False)
class FunctionPlant:
    r"""A plant of the caller's own, :math:`z(k+1) = f(z(k), v(k)),\; y(k) = g(z(k))`, from two plain functions.

    Parameters
    ----------
    transition : callable
        f, from z of shape (n,) and v of shape (q,) to the next state, shape (n,).
    measurement : callable
        g, from z of shape (n,) to y, shape (p,).
    n : int
        Size of the state, at least 1.
    q : int
        Size of the input, at least 1.
    names : tuple of str
        What messages call the two functions.

    Attributes
    ----------
    p : int
        Size of the output, found by asking for g(0).

    Raises
    ------
    PlantError
        If a function raises, or does not return finite real numbers of the right shape, at z = 0, v = 0; see
        :meth:`step` for later on.
    InputError
        If n or q is not a whole number of at least 1, or a function cannot be called.

    Notes
    -----
    The functions see one state at a time, whatever batch the plant is given, and read-only arrays: they must return
    new ones. The scheme brings the outputs to zero; so put the wanted equilibrium there.

    Examples
    --------
    >>> pendulum = FunctionPlant(
    ...     lambda z, v: [z[0] + 0.1 * z[1], z[1] + 0.1 * (np.sin(z[0]) + v[0])], lambda z: z[:1], n=2, q=1
    ... )
    >>> pendulum.p, pendulum.step(np.array([0.0, 1.0]), np.array([0.0]))
    (1, array([0.1, 1. ]))
    """

    transition: Callable[[Array, Array], ArrayLike]
    measurement: Callable[[Array], ArrayLike]
    n: int
    q: int
    names: tuple[str, str] = ("transition", "measurement")
    p: int = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "n", integer("n", self.n, 1))
        object.__setattr__(self, "q", integer("q", self.q, 1))
        functions: tuple[object, object] = (self.transition, self.measurement)
        for name, form, function in zip(self.names, ("(z, v)", "(z)"), functions, strict=True):
            if not callable(function):
                raise InputError(f"{name} must be a function {name}{form}, got {describe(function)}")
        z, v = read_only(np.zeros(self.n)), read_only(np.zeros(self.q))
        found = {
            self._output_name: _called(self._output_name, self.measurement, None, z),
            self._step_name: _called(self._step_name, self.transition, self.n, z, v),
        }
        for name, value in found.items():
            if not np.all(np.isfinite(value)):
                raise PlantError(
                    f"{name} must be finite at z = 0, v = 0, where the scheme is to bring the plant, got "
                    f"{describe(value)}; shift the coordinates so that the wanted equilibrium is at zero"
                )
        object.__setattr__(self, "p", len(found[self._output_name]))

    @property
    def _step_name(self) -> str:
        return f"{self.names[0]}(z, v)"

    @property
    def _output_name(self) -> str:
        return f"{self.names[1]}(z)"

    def step(self, z: Array, v: Array) -> Array:
        """Return the next state, shape (..., n), member by member of the batch.

        Parameters
        ----------
        z : array, shape (..., n)
        v : array, shape (..., q)

        Returns
        -------
        array, shape (..., n)
            Infinite or NaN where the function says so, and infinite where it leaves the range of float64
            (OverflowError): the closed loop stops there as diverged.

        Raises
        ------
        InputError
            If z or v has another length, or their batch axes do not fit.
        PlantError
            If the function raises, writes into its arguments, or returns something other than n real numbers.
        """
        z, v = check_lengths(z=(z, self.n), v=(v, self.q))
        lead = common_batch(z=(z, 1), v=(v, 1))
        z, v = np.broadcast_to(z, (*lead, self.n)), np.broadcast_to(v, (*lead, self.q))
        out = np.empty((*lead, self.n))
        for i in np.ndindex(lead):
            out[i] = _called(self._step_name, self.transition, self.n, read_only(z[i]), read_only(v[i]))
        return out

    def output(self, z: Array) -> Array:
        """Return the output, shape (..., p), member by member of the batch; it raises as :meth:`step` does."""
        (z,) = check_lengths(z=(z, self.n))
        out = np.empty((*z.shape[:-1], self.p))
        for i in np.ndindex(z.shape[:-1]):
            out[i] = _called(self._output_name, self.measurement, self.p, read_only(z[i]))
        return out


def _called(name: str, function: Callable[..., ArrayLike], length: int | None, *arguments: Array) -> Array:
    """Call a caller's function and check what comes back: real numbers of shape (length,), finite or not."""
    wanted = f"an array of shape ({'p' if length is None else length},)"
    where = ", ".join(f"{symbol} = {describe(value)}" for symbol, value in zip("zv", arguments, strict=False))
    try:
        returned = function(*arguments)
    except OverflowError:
        return np.full(1 if length is None else length, np.inf)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # whatever a user's function raises, sys.exit included
        if isinstance(error, ValueError) and "read-only" in str(error):
            raise PlantError(
                f"{name} must return {wanted} and leave its arguments alone, got an attempt to write into them; "
                "it must return a new array, so begin with z = z.copy()"
            ) from error
        raise PlantError(f"{name} must return {wanted}, got {reason(error)}; try it by hand at {where}") from error
    try:
        raw = np.asarray(returned)
    except Exception as error:  # ragged, or whatever an object's own conversion raises
        raise PlantError(
            f"{name} must return {wanted}, got {describe(returned)}, which is no rectangular array; "
            "return np.array([...]) with one number for each entry"
        ) from error
    if raw.dtype.kind not in "iuf":
        raise PlantError(
            f"{name} must return {wanted} of real numbers, got {describe(returned)}; return np.array([...]) of floats"
        )
    if raw.ndim != 1 or len(raw) == 0 or length not in (None, len(raw)):
        raise PlantError(
            f"{name} must return {wanted}, got shape {raw.shape}; return np.array([...]) with one number for each entry"
        )
    with np.errstate(over="ignore"):
        return np.asarray(raw, dtype=np.float64)


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
