"""The compiler of the loops: numba if it is installed, otherwise none."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any, TypeVar

F = TypeVar("F", bound=Callable[..., Any])

numba: Any
try:
    import numba
    from numba.core import event
except ImportError:  # the loops are plain Python and also run interpreted, a few hundred times slower
    numba = None
else:

    class _Notice(event.Listener):
        """Reports once, on standard error, that the loops are being compiled."""

        said = False

        def on_start(self, event: Any) -> None:
            if not self.said and event.data["dispatcher"].py_func.__module__.startswith("rhl."):
                self.said = True
                print("rhl: compiling its loops, once for this installation: about 15 s", file=sys.stderr)

        def on_end(self, event: Any) -> None:
            """Do nothing; listeners require this method."""

    event.register("numba:compile", _Notice())  # type: ignore[no-untyped-call]


def compiled(function: F) -> F:
    """Compile a function at its first call, and cache the machine code on disk if a folder is writable."""
    if numba is None:
        return function
    options = {"nogil": True, "error_model": "numpy"}
    try:
        return numba.njit(cache=True, **options)(function)
    except RuntimeError:  # neither the package's folder nor the user's cache is writable
        return numba.njit(**options)(function)


def inlined(function: F) -> F:
    """Inline a function into its callers, so that constant arguments are constants at compile time."""
    return function if numba is None else numba.njit(inline="always", error_model="numpy")(function)
