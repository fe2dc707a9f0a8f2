"""Schemes of a campaign: a base scheme and changed settings."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np

from rhl._checks import choice, describe, positive
from rhl.errors import InputError
from rhl.estimator import ProximalEstimator
from rhl.losses import WeightedSquares
from rhl.memory import GrowingMemory
from rhl.schedules import PowerDecay
from rhl.scheme import Scheme, default_scheme, window_scheme
from rhl.units import RunningUnits

Base = Literal["default", "window"]
# The longest window, in multiples of the scheme's order: the steps of the longest run.
LONGEST = 100_000


@dataclass(frozen=True)
class Choice:
    """A scheme of a campaign: a base scheme and changed settings.

    Parameters
    ----------
    label : str
        Its name in the results.
    base : {"default", "window"}
        ``default_scheme`` or ``window_scheme``.
    order_factor : float
        The scheme's order is the bound on the plant's observability index times this, rounded up; at least 1.
    inputs : float, optional
        Size of the first inputs of the default scheme.
    R, eps_rate, weight : float, optional
        Input weight, rate of the schedule of epsilon, weight of the estimator's generator.
    horizon : int, optional
        N, at least 1.
    model_delay : int, optional
        0 or 1.
    memory : {"growing", "window"}, optional
        The fitted transitions: all measured ones, or those of a window.
    window : float, optional
        The number of transitions in a window, in multiples of the scheme's order, at most 100000; 2 by default.
    units : bool, optional
        Whether the default scheme's weights use running units.

    Examples
    --------
    >>> Choice("longer plans", horizon=50).scheme(p=1, q=1, bound=2).controller.horizon
    50
    """

    label: str
    base: Base = "default"
    order_factor: float = 1.0
    inputs: float | None = None
    R: float | None = None
    eps_rate: float | None = None
    weight: float | None = None
    horizon: int | None = None
    model_delay: int | None = None
    memory: Literal["growing", "window"] | None = None
    window: float | None = None
    units: bool | None = None

    def __post_init__(self) -> None:
        choice("base", self.base, get_args(Base))
        if not 1 <= self.order_factor <= 100:
            raise InputError(f"order_factor must be a number from 1 to 100, got {describe(self.order_factor)}")
        for name in ("inputs", "R", "eps_rate", "weight", "window"):
            if getattr(self, name) is not None:
                positive(name, getattr(self, name))
        if self.window is not None and self.window > LONGEST:
            raise InputError(f"window must be at most {LONGEST}, got {self.window:g}")
        if self.base == "window":
            for name in ("inputs", "units"):
                if getattr(self, name) is not None:
                    raise InputError(
                        f'{name} must be left out where base is "window", got {describe(getattr(self, name))}; '
                        "it has no effect"
                    )
        if self.inputs is not None and self.units is False:
            raise InputError(f"inputs must be left out where units is false, got {self.inputs:g}; it has no effect")
        if self._growing and self.window is not None:
            raise InputError(f"window must be left out where every transition is kept, got {self.window:g}")

    @property
    def _growing(self) -> bool:
        return self.memory == "growing" or (self.memory is None and self.base == "default")

    def scheme(self, p: int, q: int, bound: int) -> Scheme:
        """Build the scheme for plants with p outputs, q inputs and a bound on their observability index."""
        order = int(np.ceil(bound * self.order_factor))
        if self.base == "window":
            scheme = window_scheme(p, q, order)
        else:
            scheme = default_scheme(p, q, order, *(() if self.inputs is None else (self.inputs,)))
        if self.units is False:
            scheme = replace(scheme, units=None)
        if self.units is True and scheme.units is None:
            scheme = replace(scheme, units=RunningUnits())
        return replace(scheme, estimator=self._estimator(scheme, order), controller=self._controller(scheme))

    def _estimator(self, scheme: Scheme, order: int) -> ProximalEstimator | GrowingMemory:
        if self.memory is None and self.window is None and self.weight is None:
            return scheme.estimator
        known: Any = scheme.estimator
        weight = self.weight
        if weight is None:
            weight = known.weight if isinstance(known, GrowingMemory) else float(known.generator.weight)
        # The other settings of the scheme's own estimator are kept.
        if self._growing:
            return replace(known, weight=weight) if isinstance(known, GrowingMemory) else GrowingMemory(weight)
        window = max(1, int(np.ceil((2.0 if self.window is None else self.window) * order)))
        generator = WeightedSquares(weight)
        if isinstance(known, ProximalEstimator):
            return replace(known, window=known.window if self.window is None else window, generator=generator)
        return ProximalEstimator(window, generator=generator)

    def _controller(self, scheme: Scheme) -> Any:
        named = {
            name: getattr(self, name) for name in ("R", "horizon", "model_delay") if getattr(self, name) is not None
        }
        if self.eps_rate is not None:
            known: Any = scheme.controller.epsilon
            own = isinstance(known, PowerDecay)
            named["epsilon"] = replace(known, rate=self.eps_rate) if own else PowerDecay(self.eps_rate)
        return replace(scheme.controller, **named)
