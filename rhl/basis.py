"""Functions of the stacked outputs that a lifting appends: polynomials, single terms, and functions of your own."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement
from math import comb
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from rhl._checks import Array, describe, integer, numbers, reason
from rhl.errors import InputError

# With more features no window determines the model, and no solver handles it.
_MOST = 2000


class Basis(Protocol):
    """Functions phi of the stacked outputs w(k) = [y(k); ...; y(k-N_y+1)], all zero at w = 0.

    Examples
    --------
    >>> class Squares:
    ...     def count(self, p, outputs):
    ...         return p * outputs
    ...
    ...     def features(self, stack, p):
    ...         return stack**2
    >>> from rhl.lifting import DelayLifting
    >>> DelayLifting(2, 1, basis=Squares()).size(1)
    4
    """

    def count(self, p: int, outputs: int) -> int:
        """Return how many functions there are for outputs of size p, of which N_y are stacked."""

    def features(self, stack: Array, p: int) -> Array:
        """Return phi(w), shape (..., count), for w of shape (..., N_y p)."""


@dataclass(frozen=True)
class Polynomials:
    """All monomials of degree 2 to ``degree`` in the entries of the stacked outputs.

    The degree is at least 2, since every lifting has degree 1. Source: Remark 3, Carleman's embedding;
    ``rhl.paper.claims`` checks that the paper's example of it is exact.

    Examples
    --------
    >>> Polynomials(2).features(np.array([2.0, 3.0]), p=1)
    array([4., 6., 9.])
    """

    degree: int

    def __post_init__(self) -> None:
        integer("degree", self.degree, 2)

    def count(self, p: int, outputs: int) -> int:
        """Return how many monomials there are."""
        d = p * outputs
        number = comb(d + self.degree, d) - d - 1  # all of degree at most m, without 1 and the outputs
        if not 1 <= number <= _MOST:
            raise InputError(
                f"the polynomials must be 1 to {_MOST} functions, got {number} of degree at most {self.degree} in "
                f"{d} outputs; choose another degree, or stack fewer outputs"
            )
        return number

    def features(self, stack: Array, p: int) -> Array:
        """Return the monomials, shape (..., count)."""
        entries = range(stack.shape[-1])
        chosen = [of for m in range(2, self.degree + 1) for of in combinations_with_replacement(entries, m)]
        return np.stack([np.prod(stack[..., list(of)], axis=-1) for of in chosen], axis=-1)


_FUNCTIONS: dict[str, Callable[[Array], Array]] = {"sin": np.sin, "tanh": np.tanh, "cos": np.cos, "exp": np.exp}
_FACTOR = re.compile(
    r"(?:(?P<function>[a-z]+)\()?(?P<signal>[a-z]+)(?P<index>\d+)(?:\(k(?:-(?P<delay>\d+))?\))?", re.ASCII
)


@dataclass(frozen=True)
class Terms:
    """Single products of outputs, written as strings: ``"y1*y2"``, ``"y1^3"``, ``"y1*y2(k-1)"``, ``"sin(y1)"``.

    A factor is an output ``y1``, ``y2``, ... with an optional delay ``(k-1)``, optionally inside sin or tanh, and with
    an optional integer exponent. InputError if a string is not such a product, uses an input (``v1``), or is not zero
    at zero. Inputs are not allowed: the scheme reads v(k) off u(k), and equation (14) keeps outputs and inputs apart.

    Examples
    --------
    >>> Terms(("y1*y2", "y1(k-1)^2")).features(np.array([2.0, 3.0, 5.0, 7.0]), p=2)
    array([ 6., 25.])
    """

    texts: Sequence[str]

    def __post_init__(self) -> None:
        if not isinstance(self.texts, (tuple, list)) or not self.texts:
            raise InputError(f"texts must be one or more products such as 'y1*y2', got {describe(self.texts)}")
        object.__setattr__(self, "texts", tuple(self.texts))
        if len(self.texts) > _MOST:
            raise InputError(f"texts must be at most {_MOST} products, got {len(self.texts)}")
        for text, factors in zip(self.texts, self._factors, strict=True):
            # A factor that does not vanish at zero is allowed in a product with one that does.
            if all(function == "cos" or function == "exp" for function, *_ in factors):
                raise InputError(
                    f"{text!r} must be zero where the outputs are, so that x can go to zero, got a value "
                    "of 1 there; multiply it by an output"
                )

    @cached_property
    def _factors(self) -> list[list[tuple[str, int, int, int]]]:
        return [[_factor(text, part) for part in _split(text)] for text in self.texts]

    def count(self, p: int, outputs: int) -> int:
        """Return the number of terms, after a check of the outputs that they name."""
        for text, factors in zip(self.texts, self._factors, strict=True):
            for _, index, delay, _ in factors:
                if index > p or delay >= outputs:
                    raise InputError(
                        f"{describe(text)} must use outputs y1 to y{p} with delays up to {outputs - 1}, got "
                        f"y{describe(index)}(k-{describe(delay)})"
                    )
        return len(self.texts)

    def features(self, stack: Array, p: int) -> Array:
        """Return the terms, shape (..., count)."""
        columns = []
        for factors in self._factors:
            column = np.ones(stack.shape[:-1])
            for function, index, delay, power in factors:
                entry = stack[..., delay * p + index - 1]
                column = column * (_FUNCTIONS[function](entry) if function else entry) ** power
            columns.append(column)
        return np.stack(columns, axis=-1)


def _split(text: object) -> list[str]:
    if not isinstance(text, str) or not text.strip() or len(text) > 200:
        raise InputError(f"a term must be a string such as 'y1*y2' of at most 200 characters, got {describe(text)}")
    # Spaces between digits are not allowed: "y1 2" is not y12.
    return re.sub(r"\s*([-*^()])\s*", r"\1", text.strip()).split("*")


def _factor(text: str, part: str) -> tuple[str, int, int, int]:
    body, _, exponent = part.partition("^")
    found = _FACTOR.match(body)
    rest = body[found.end() :] if found else ""
    power = int(exponent) if re.fullmatch("[0-9]{1,2}", exponent) else 0 if "^" in part else 1
    closed = found is not None and rest == (")" if found["function"] else "")
    if found and closed and found["signal"] == "v":
        raise InputError(
            f"{text!r} must use outputs only (y1, y2, ...), got the input v{found['index']}; inputs are delay-lifted, "
            "because v(k) has to be read off u(k)"
        )
    known = found is not None and found["signal"] == "y" and int(found["index"]) > 0 and power > 0
    if found is None or not closed or not known or (found["function"] or "sin") not in _FUNCTIONS:
        raise InputError(
            f"{text!r} must be a product of outputs such as 'y1*y2', 'y1(k-1)^2', 'sin(y1)' "
            f"(functions: {', '.join(_FUNCTIONS)}), got the factor {part!r}"
        )
    return found["function"] or "", int(found["index"]), int(found["delay"] or 0), power


@dataclass(frozen=True, eq=False)
class Features:
    """Functions of your own.

    InputError if ``function`` does not take one argument, and later if it returns another shape or is not zero at zero.
    Its own exceptions pass through, with a note about the call.

    Parameters
    ----------
    function : callable
        The stacked outputs w(k), shape (N_y p,) -> phi(w), shape (size,); zero at w = 0.
    size : int
        The number of values that it returns.
    """

    function: Callable[[Array], ArrayLike]
    size: int

    def __post_init__(self) -> None:
        integer("size", self.size, 1)
        if self.size > _MOST:
            raise InputError(f"size must be at most {_MOST}, got {self.size}")
        if not callable(self.function):
            raise InputError(f"function must be a function of the stacked outputs, got {describe(self.function)}")
        try:
            inspect.signature(self.function).bind(None)
        except TypeError as error:
            raise InputError(
                f"function must take the stacked outputs and nothing else, got one for which {error}; inputs are "
                "delay-lifted, because v(k) has to be read off u(k)"
            ) from error
        except ValueError:
            pass  # a built-in function has no signature to check

    def count(self, p: int, outputs: int) -> int:
        """Return ``size``, after a check of the function at zero."""
        at_zero = self.features(np.zeros(p * outputs), p)
        if np.any(at_zero != 0):
            raise InputError(
                f"function must be zero where the outputs are, so that x can go to zero, got {describe(at_zero)}; "
                "subtract its value at zero"
            )
        return self.size

    def features(self, stack: Array, p: int) -> Array:
        """Return phi(w), shape (..., size)."""
        rows = [self._row(w) for w in stack.reshape(-1, stack.shape[-1])]
        return np.reshape(rows, (*stack.shape[:-1], self.size))

    def _row(self, w: Array) -> Array:
        try:
            found = self.function(w)
        except Exception as error:
            error.add_note(f"rhl called the basis function with stacked outputs of shape {w.shape}")
            raise
        try:
            row = numbers(found)
        except Exception as error:  # any error of the object's own conversion
            raise InputError(
                f"function must take stacked outputs of shape {w.shape} and return {self.size} real numbers, "
                f"got {reason(error)}"
            ) from error
        if row.shape != (self.size,):
            raise InputError(f"function must return shape ({self.size},), got {row.shape}")
        if np.any(np.isnan(row)):
            raise InputError(f"function must return numbers, got NaN at stacked outputs {describe(w)}")
        return row
