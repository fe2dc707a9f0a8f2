"""Files that appear whole or not at all, and the text of a table of a run."""

from __future__ import annotations

import os
import re
import stat
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path

from rhl._checks import shown
from rhl.errors import InputError

# Paths of open descriptors: one may be a file, and replacing it would detach the open descriptor from its name.
_OPEN = re.compile(r"/(dev|dev/fd|proc/[^/]+/fd)/[^/]+")


def header(p: int, q: int, n: int) -> list[str]:
    """Return the names of a table's columns, for p outputs, q inputs and n plant states.

    Examples
    --------
    >>> header(1, 1, 2)
    ['k', 'y1', 'v1', 'yhat1', 'z1', 'z2', 'weight', 'lambda']
    """
    groups = (("y", p), ("v", q), ("yhat", p), ("z", n))
    return ["k", *(f"{name}{i + 1}" for name, count in groups for i in range(count)), "weight", "lambda"]


def table_text(columns: Mapping[str, Iterable[float]]) -> str:
    r"""Return columns of numbers as CSV with 17 significant digits; k is an integer.

    Examples
    --------
    >>> table_text({"k": [0, 1], "y1": [0.1, 2.0]})
    'k,y1\n0,0.10000000000000001\n1,2\n'
    """
    rows = (
        ",".join(str(entry) if name == "k" else format(entry, ".17g") for name, entry in zip(columns, row, strict=True))
        for row in zip(*columns.values(), strict=True)
    )
    return "\n".join([",".join(columns), *rows]) + "\n"


def is_stream(path: Path) -> bool:
    """Whether a path is written into instead of replaced: a device, a pipe, an open descriptor.

    OSError if this cannot be determined, for instance with circular links.
    """
    try:
        mode = path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return False
    return not stat.S_ISDIR(mode) and (bool(_OPEN.fullmatch(os.path.abspath(path))) or not stat.S_ISREG(mode))


def write_whole(path: str | os.PathLike[str], content: str | bytes, *, new: bool = False) -> None:
    """Write a file at once, so that no reader sees a part of it, text as UTF-8; InputError if it cannot be written.

    ``new``: InputError if the file exists by now.
    """
    data = content.encode() if isinstance(content, str) else content
    try:
        if is_stream(Path(path)):
            with Path(path).open("ab") as file:
                file.write(data)
            return
        target = Path(path).resolve()  # follow links
        if target.exists() and not new and not os.access(target.parent, os.W_OK):
            # The folder accepts no new file, so there is none to rename; the file itself is written.
            with target.open("wb") as file:
                file.write(data)
            return
        mode = target.stat().st_mode & 0o777 if target.exists() else 0o666 & ~_umask()
        descriptor, name = tempfile.mkstemp(dir=target.parent)
        try:
            with os.fdopen(descriptor, "wb") as file:
                file.write(data)
            os.chmod(name, mode)
            _put_new(name, target) if new else os.replace(name, target)
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise
    except FileExistsError:
        raise InputError(
            f"{shown(path)} must be a new file, got one that another program has made meanwhile; choose another name"
        ) from None
    except (OSError, ValueError, TypeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{shown(path)} must be a writable file, got: {reason}") from error


def _put_new(name: str, target: Path) -> None:
    """Rename a complete file; FileExistsError if the name is taken."""
    try:
        os.link(name, target)
    except FileExistsError:
        raise
    except OSError:  # a file system without hard links: an empty file takes the name until it is replaced
        os.close(os.open(target, os.O_CREAT | os.O_EXCL | os.O_WRONLY))
        os.replace(name, target)
    else:
        os.unlink(name)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
