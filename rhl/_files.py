"""Files that appear whole or not at all, and the head of a table of a run."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from rhl._checks import shown
from rhl.errors import InputError


def header(p: int, q: int, n: int) -> list[str]:
    """Return the names of a table's columns, for p outputs, q inputs and n plant states.

    Examples
    --------
    >>> header(1, 1, 2)
    ['k', 'y1', 'v1', 'yhat1', 'z1', 'z2', 'weight', 'lambda']
    """
    groups = (("y", p), ("v", q), ("yhat", p), ("z", n))
    return ["k", *(f"{name}{i + 1}" for name, count in groups for i in range(count)), "weight", "lambda"]


def write_whole(path: str | os.PathLike[str], content: str | bytes) -> None:
    """Write a file so that no reader ever sees half of it, text as UTF-8; InputError if it cannot be written."""
    data = content.encode() if isinstance(content, str) else content
    try:
        target = Path(path).resolve()  # through a link to what it names
        if target.exists() and not (target.is_file() and os.access(target.parent, os.W_OK)):
            # A device, a pipe, or a file in a folder that takes no new ones: there is nothing to rename over it.
            with target.open("wb") as file:
                file.write(data)
            return
        mode = target.stat().st_mode & 0o777 if target.exists() else 0o666 & ~_umask()
        descriptor, name = tempfile.mkstemp(dir=target.parent)
        try:
            with os.fdopen(descriptor, "wb") as file:
                file.write(data)
            os.chmod(name, mode)
            os.replace(name, target)
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise
    except (OSError, ValueError, TypeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{shown(path)} must be a writable file, got: {reason}") from error


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
