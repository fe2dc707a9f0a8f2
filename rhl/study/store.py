"""Results of a campaign in a folder: a zarr store that xarray reads, and a marker for each completed task."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import platform
import re
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from math import prod
from pathlib import Path
from shutil import rmtree
from typing import TYPE_CHECKING, Any

import numpy as np

import rhl
from rhl._checks import describe, shown
from rhl._files import write_whole
from rhl.errors import InputError, RHLError
from rhl.study.campaign import PLANT_VARIABLES, RUN_VARIABLES, Campaign, Task

if TYPE_CHECKING:
    import xarray as xr

_DATA, _PROVENANCE, _MARKERS, _LOCK = "results.zarr", "provenance.json", "done", "lock"
_SOURCES = Path(rhl.__file__).parent
# The largest store that is loaded, in bytes; a campaign's largest has about 1 GB. The largest provenance.
_LARGEST, _LONGEST = 2_000_000_000, 20_000_000
_PLAIN = re.compile("[|<>]([biufU])([0-9]{1,5})")


def versions() -> dict[str, str]:
    """Return what results depend on besides the configuration: versions, the library's source, and a lock file if any.

    The machine is not included, although another processor may round differently.

    Examples
    --------
    >>> {"python", "numpy", "source of rhl"} <= set(versions())
    True
    """
    found = {"rhl": rhl.__version__, "python": platform.python_version()}
    found |= {name: version(name) for name in ("numpy", "scipy", "numba")}
    digest = hashlib.sha256()
    for path in sorted(_SOURCES.rglob("*.py")):
        inside = path.relative_to(_SOURCES)
        # Modules for figures, printing and claims do not affect a run.
        if inside.parts[0] not in ("app", "paper", "plotting.py"):
            digest.update(f"{inside.as_posix()}\n".encode() + path.read_bytes())
    found["source of rhl"] = digest.hexdigest()[:16]
    lock = _SOURCES.parent / "environment.lock"
    found["environment.lock"] = hashlib.sha256(lock.read_bytes()).hexdigest()[:16] if lock.is_file() else "none found"
    return found


class StoreError(RHLError):
    """The store cannot be written; its contents stay.

    Examples
    --------
    >>> print(StoreError(Path("few"), OSError(errno.ENOSPC, "No space left on device")))
    few must take the results, got: No space left on device; make room
    """

    def __init__(self, path: Path, error: OSError) -> None:
        full = "; make room" if error.errno in (errno.ENOSPC, errno.EDQUOT) else ""
        what = error.strerror or " ".join(str(error).split()) or type(error).__name__
        super().__init__(f"{shown(path)} must take the results, got: {what}{full}")


@dataclass(frozen=True)
class Store:
    """The folder of a campaign; ``create`` or ``resume`` makes one, in which one process writes.

    It holds ``results.zarr`` for ``xarray.open_zarr``, ``provenance.json``, and in ``done`` a marker for each task. A
    task fills one chunk of each variable. Its marker is written after them and holds their digest, so that a task
    whose data did not arrive whole is done again.

    Parameters
    ----------
    path : Path
    campaign : Campaign
    """

    path: Path
    campaign: Campaign

    @classmethod
    def create(cls, path: str | os.PathLike[str], campaign: Campaign, configuration: str, settings: Any) -> Store:
        """Create a new folder without completed tasks.

        ``configuration`` is stored unchanged, and ``settings``, JSON data, is what ``resume`` compares.
        InputError if the folder exists or cannot be created. StoreError if the store cannot be written.
        """
        folder = Path(path)
        try:
            folder.mkdir()
        except FileExistsError:
            raise InputError(
                f"--output must name a new folder, got {shown(path)}, which exists; add --resume to continue it"
            ) from None
        except (OSError, ValueError) as error:
            why = getattr(error, "strerror", None) or error
            raise InputError(f"--output must name a folder that can be created, got {shown(path)}: {why}") from None
        provenance = {"versions": versions(), "settings": settings, "configuration": configuration}
        try:
            (folder / _MARKERS).mkdir()
            _template(campaign, provenance).to_zarr(folder / _DATA, compute=False, consolidated=True, zarr_format=2)
            # Written last, since a folder without it is not a campaign's.
            (folder / _PROVENANCE).write_text(json.dumps(provenance, indent=1) + "\n", encoding="utf-8")
        except BaseException as error:
            rmtree(folder, ignore_errors=True)
            if isinstance(error, OSError):
                raise StoreError(folder, error) from error
            raise
        return cls(folder, campaign)

    @classmethod
    def resume(cls, path: str | os.PathLike[str], campaign: Campaign, settings: Any) -> Store:
        """Open a folder to continue; InputError if it is not a campaign's, or settings or versions have changed."""
        folder = Path(path)
        try:
            before = _read_json(folder / _PROVENANCE)
            if not isinstance(before, dict) or not {"settings", "versions"} <= set(before):
                raise ValueError
        except (OSError, ValueError, RecursionError) as error:
            why = getattr(error, "strerror", None) or "invalid JSON"
            anew = "remove the folder and start again" if folder.exists() else "leave it out to start"
            raise InputError(
                f"--resume must find a campaign in {shown(path)}, got {_PROVENANCE}: {why}; {anew}"
            ) from None
        for what, now, then in (
            ("the configuration", settings, before["settings"]),
            ("the versions", versions(), before["versions"]),
        ):
            for name, mine, theirs in _differences(json.loads(json.dumps(now)), then):
                raise InputError(
                    f"--resume must find {what} as at the campaign's start, got {name} = {describe(mine)}, which was "
                    f"{describe(theirs)}; start again in another folder"
                )
        _trusted(folder)
        return cls(folder, campaign)

    @cached_property
    def _arrays(self) -> Any:
        import zarr

        return zarr.open_group(self.path / _DATA, mode="r+", zarr_format=2)

    def _selection(self, task: Task) -> tuple[slice, ...]:
        plants = slice(task.first, task.stop)
        return (plants,) if task.scheme is None else (slice(task.scheme, task.scheme + 1), plants)

    def write(self, task: Task, found: Mapping[str, np.ndarray]) -> None:
        """Store a task's results, then its marker; StoreError if the disk is full.

        An interrupt is raised when both are written.
        """
        _undisturbed(self._write, task, found)

    def _write(self, task: Task, found: Mapping[str, np.ndarray]) -> None:
        at = self._selection(task)
        try:
            for name, values in found.items():
                self._arrays[name][at] = values.reshape(1, -1) if len(at) == 2 else values
            write_whole(self.path / _MARKERS / task.name, _digest(found))
        except (OSError, InputError) as error:
            # The message of `write_whole` would name a file that the user did not name.
            cause = error if isinstance(error, OSError) else error.__cause__
            if not isinstance(cause, OSError):
                raise
            raise StoreError(self.path, cause) from error

    def done(self) -> set[Task]:
        """Return the tasks with a marker whose data in the store match it."""
        return {task for task in self.campaign.tasks() if _undisturbed(self._is_done, task)}

    def _is_done(self, task: Task) -> bool:
        try:
            expected = (self.path / _MARKERS / task.name).read_text(encoding="ascii")
        except (FileNotFoundError, ValueError):
            return False
        variables, at = PLANT_VARIABLES if task.scheme is None else RUN_VARIABLES, self._selection(task)
        try:
            # Some versions of xarray store truth values as integers.
            found = {
                name: np.asarray(self._arrays[name][at]).reshape(-1).astype(about.dtype)
                for name, about in variables.items()
            }
            return _digest(found) == expected
        except (OSError, ValueError, RuntimeError):  # a truncated chunk does not unpack
            return False

    def dataset(self) -> xr.Dataset:
        """Return the results, in memory."""
        return load(self.path)

    def digest(self) -> str:
        """Return a hash over every variable's bytes, independent of chunks, workers and interruptions."""
        found = self.dataset()
        return _digest({name: found[name].values for name in (*PLANT_VARIABLES, *RUN_VARIABLES)})

    @contextmanager
    def held(self) -> Iterator[None]:
        """Keep other processes from writing into the folder meanwhile; InputError if one does."""
        try:
            import fcntl
        except ImportError:  # a system without file locks
            yield
            return
        with (self.path / _LOCK).open("a") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                raise InputError(
                    f"--output must name a folder that no other campaign writes into, got {shown(self.path)}; "
                    "wait until it ends"
                ) from None
            yield


def load(path: str | os.PathLike[str]) -> xr.Dataset:
    """Return the results in a campaign's folder as an xarray.Dataset, in memory.

    Dimensions are scheme and plant. For incomplete tasks, floats are NaN and integers zero. The folder may come from a
    stranger: InputError if it is not a campaign's, holds links or objects, or is larger than a campaign's.
    """
    import xarray as xr

    _trusted(Path(path))
    with xr.open_zarr(Path(path) / _DATA, chunks=None) as found:
        return found.load()


def _read_json(file: Path) -> Any:
    with file.open("rb") as opened:
        content = opened.read(_LONGEST + 1)
    if len(content) > _LONGEST:
        raise ValueError
    return json.loads(content)


def _trusted(folder: Path) -> None:
    """Refuse a store that could write elsewhere, run code or fill the memory.

    Links could point out of the folder, codecs of zarr such as pickle run code when a chunk is read, and a few bytes of
    metadata can promise any number of entries.
    """
    data = folder / _DATA
    for path in (folder, *folder.rglob("*")):
        if path.is_symlink():
            raise InputError(f"{shown(folder)} must be a campaign's folder without links, got {shown(path)}")
    arrays: dict[str, Any] = {}
    try:
        arrays |= {path.as_posix(): _read_json(path) for path in data.rglob(".zarray")}
        # Readers prefer this file to those of the arrays.
        together = _read_json(data / ".zmetadata")["metadata"]
        arrays |= {name: about for name, about in together.items() if name.rpartition("/")[2] == ".zarray"}
        other = [path.name for path in data.rglob("zarr.json")]
        wrong = other[0] if other else next((why for about in arrays.values() if (why := _fault(about))), "")
        total = sum(_bytes(about, "shape") for about in arrays.values()) if not wrong else 0
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        why = getattr(error, "strerror", None) or "metadata that no campaign writes"
        raise InputError(f"{shown(folder)} must hold a campaign's {_DATA}, got: {why}") from None
    if wrong:
        raise InputError(f"{shown(folder)} must hold arrays of numbers and names only, got {wrong}")
    if total > 2 * _LARGEST:  # the metadata are there twice
        raise InputError(f"{shown(folder)} must hold at most {_LARGEST} bytes, got {total // 2}")


def _fault(about: dict[str, Any]) -> str:
    """Return what the metadata of an array have that no campaign writes; "" if there is nothing."""
    compressor, filters = about["compressor"], about["filters"]
    if filters or (compressor is not None and compressor.get("id") != "blosc"):
        return f"the codec {describe(filters or compressor)}"
    if not (isinstance(about["dtype"], str) and _PLAIN.fullmatch(about["dtype"])):
        return f"the type {describe(about['dtype'])}"
    return f"a chunk of {_bytes(about, 'chunks')} bytes" if _bytes(about, "chunks") > _LARGEST else ""


def _bytes(about: dict[str, Any], sizes: str) -> int:
    kind, size = _PLAIN.fullmatch(about["dtype"]).groups()  # type: ignore[union-attr] # `_fault` has matched it
    return prod(map(int, about[sizes])) * int(size) * (4 if kind == "U" else 1)


def _template(campaign: Campaign, provenance: dict[str, Any]) -> xr.Dataset:
    import dask.array as da
    import xarray as xr

    schemes, plants, chunk = len(campaign.schemes), len(campaign.plants), campaign.chunk

    def empty(shape: tuple[int, ...], chunks: tuple[int, ...], dims: tuple[str, ...], about: Any) -> xr.DataArray:
        data: Any = da.zeros(shape, dtype=about.dtype, chunks=chunks)
        return xr.DataArray(data, dims=dims, attrs={"units": about.units, "description": about.description})

    variables = {
        **{name: empty((plants,), (chunk,), ("plant",), about) for name, about in PLANT_VARIABLES.items()},
        **{
            name: empty((schemes, plants), (1, chunk), ("scheme", "plant"), about)
            for name, about in RUN_VARIABLES.items()
        },
    }
    labels = campaign.plants.labels()
    coordinates: dict[str, Any] = {"scheme": [one.label for one in campaign.schemes], "plant": np.arange(plants)}
    if labels:
        coordinates["name"] = ("plant", labels)
    attributes = {
        "title": "Receding horizon learning on many plants",
        "steps": campaign.steps,
        "configuration": provenance["configuration"],
        "machine": f"{platform.system()} {platform.machine()}",
        **{f"version of {name}": found for name, found in provenance["versions"].items()},
    }
    return xr.Dataset(variables, coordinates, attributes)


def _undisturbed(function: Callable[..., Any], *arguments: Any) -> Any:
    """Call a function in a thread, where Ctrl-C does not reach it: zarr reports interrupted calls at exit."""
    with ThreadPoolExecutor(1) as thread:
        return thread.submit(function, *arguments).result()


def _differences(now: Any, then: Any, name: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Yield the differences of two settings: the key and both values."""
    if isinstance(now, dict) and isinstance(then, dict):
        for key in {**now, **then}:
            yield from _differences(now.get(key), then.get(key), f"{name}.{key}" if name else key)
    elif isinstance(now, list) and isinstance(then, list) and len(now) == len(then):
        for i, (mine, theirs) in enumerate(zip(now, then, strict=True)):
            yield from _differences(mine, theirs, f"{name}[{i + 1}]")
    elif now != then:
        yield name, now, then


def _digest(arrays: Mapping[str, np.ndarray]) -> str:
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()
