"""The compiler of the loops: numba where it is installed, none elsewhere."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any, TypeVar

F = TypeVar("F", bound=Callable[..., Any])

numba: Any
try:
    import numba
    from numba.core import event
except ImportError:  # the loops are plain Python, so they also run interpreted, a few hundred times slower
    numba = None
else:

    class _Notice(event.Listener):
        """Says once, on standard error, why a first call takes seconds."""

        said = False

        def on_start(self, event: Any) -> None:
            if not self.said and event.data["dispatcher"].py_func.__module__.startswith("rhl."):
                self.said = True
                print("rhl: compiling its loops, once for this installation: about 15 s", file=sys.stderr)

        def on_end(self, event: Any) -> None:
            """Do nothing; a listener must have it."""

    event.register("numba:compile", _Notice())  # type: ignore[no-untyped-call]


def compiled(function: F) -> F:
    """Compile a function when it is first called, and keep the machine code on disk where a folder takes it."""
    if numba is None:
        return function
    options = {"nogil": True, "error_model": "numpy"}
    try:
        return numba.njit(cache=True, **options)(function)
    except RuntimeError:  # neither the package's folder nor the user's cache can be written
        return numba.njit(**options)(function)


def inlined(function: F) -> F:
    """Compile a function into those that call it, where a constant argument is then a constant."""
    return function if numba is None else numba.njit(inline="always", error_model="numpy")(function)
