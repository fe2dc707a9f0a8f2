"""The software behind a page's numbers: Python, packages, linear-algebra libraries."""

from __future__ import annotations

import platform
import re
import sys
from importlib.metadata import PackageNotFoundError, requires, version
from typing import Any

import threadpoolctl

from rhl.errors import InputError

# A line of the metadata, such as "dask[distributed]>=2024.8; extra == 'study'".
_REQUIREMENT = re.compile(
    r"(?P<name>[\w.-]+)(?:\[[\w,]+\])?(?P<range>[^;]*)(?:;.*extra == ['\"](?P<extra>[\w-]+)['\"])?"
)


def python() -> str:
    """Return the implementation of Python, its version and the processor's architecture, without names of machines.

    Examples
    --------
    >>> python().split()[0]
    'CPython'
    """
    return f"{platform.python_implementation()} {platform.python_version()}, {sys.platform}, {platform.machine()}"


def packages(extras: tuple[str, ...] = ("", "paper", "study", "book")) -> list[dict[str, str]]:
    """Return the direct dependencies of ``rhl``: package, version, supported versions, and the extra that needs it.

    ``extras``: those whose dependencies are returned, in this order; "" is the core. InputError if rhl's own metadata
    are missing.

    Examples
    --------
    >>> [package["package"] for package in packages(("",))]
    ['numba', 'numpy', 'piqp', 'scipy']
    """
    try:
        needed = requires("rhl") or []
    except PackageNotFoundError:
        raise InputError(
            "rhl must be installed to know its dependencies, got its files alone; run 'make env'"
        ) from None
    found = [match.groupdict(default="") for line in needed if (match := _REQUIREMENT.match(line))]
    rows: dict[str, dict[str, str]] = {}
    for extra in extras:
        for need in found:
            name = need["name"]
            # The metadata repeat the dependencies of an extra in every extra that takes it in.
            if need["extra"] == extra and name not in rows:
                supported = ", ".join(sorted(need["range"].strip().split(","), reverse=True))
                rows[name] = {"package": name, "version": _installed(name), "supported": supported, "for": extra}
    return list(rows.values())


def _installed(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"


def libraries() -> list[dict[str, Any]]:
    """Return the linear-algebra libraries that numpy and scipy have loaded: kernel, version, number of threads.

    OpenBLAS chooses a kernel by the processor, or by the variable OPENBLAS_CORETYPE. Each kernel rounds differently.

    Examples
    --------
    >>> {library["used for"] for library in libraries()} <= {"numpy", "scipy", "other"}
    True
    """
    import numpy.linalg  # noqa: F401, the import loads its library
    import scipy.linalg  # noqa: F401

    rows = []
    for found in threadpoolctl.threadpool_info():
        if found["user_api"] == "blas":
            path = found["filepath"]
            user = next((name for name in ("numpy", "scipy") if f"{name}.libs" in path), "other")
            rows.append(
                {
                    "library": found["internal_api"],
                    "used for": user,
                    "version": found["version"],
                    "kernel": found.get("architecture", ""),
                    "threads": found["num_threads"],
                }
            )
    return sorted(rows, key=lambda row: (row["used for"], row["library"]))
