"""Results of a campaign in a folder: a zarr store that xarray reads, and a marker for each completed task."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import platform
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from shutil import rmtree
from typing import TYPE_CHECKING, Any

import numpy as np

import rhl
from rhl._checks import describe, reason, shown
from rhl._files import write_whole
from rhl.errors import InputError, RHLError
from rhl.study import _layout
from rhl.study._layout import DATA, LOCK, MARKERS, PROVENANCE
from rhl.study.campaign import PLANT_VARIABLES, RUN_VARIABLES, Campaign, Task

if TYPE_CHECKING:
    import xarray as xr

_SOURCES = Path(rhl.__file__).parent
# The length of a marker, which holds a digest.
_MARKER = 64


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
        InputError if the folder exists or cannot be created, or the campaign is larger than what ``load`` reads.
        StoreError if the store cannot be written.
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
            (folder / MARKERS).mkdir()
            _template(campaign, provenance).to_zarr(folder / DATA, compute=False, consolidated=True, zarr_format=2)
            _layout.sizes(folder, whole=True)  # what is written can be read again
            # Written last, since a folder without it is not a campaign's.
            (folder / PROVENANCE).write_text(json.dumps(provenance, indent=1) + "\n", encoding="utf-8")
        except BaseException as error:
            rmtree(folder, ignore_errors=True)
            if isinstance(error, OSError):
                raise StoreError(folder, error) from error
            raise
        return cls(folder, campaign)

    @classmethod
    def resume(cls, path: str | os.PathLike[str], campaign: Campaign, settings: Any) -> Store:
        """Open a folder to continue; InputError if it is not a campaign's, or settings or versions have changed.

        As ``load``, it takes a folder from a stranger; StoreError if that cannot be written.
        """
        folder = Path(path)
        if folder.is_dir():
            _layout.files(folder)
        try:
            before = _layout.read_json(folder / PROVENANCE)
            if not isinstance(before, dict) or not {"settings", "versions"} <= set(before):
                raise ValueError
        except (OSError, ValueError) as error:
            why = getattr(error, "strerror", None) or "invalid JSON"
            anew = "remove the folder and start again" if folder.exists() else "leave it out to start"
            raise InputError(
                f"--resume must find a campaign in {shown(path)}, got {PROVENANCE}: {why}; {anew}"
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
        found = _layout.sizes(folder, whole=False)
        plants = len(campaign.plants)
        expected = _layout.Sizes(len(campaign.schemes), plants, min(campaign.chunk, plants))
        if found != expected:
            raise InputError(
                f"{shown(folder)} must hold results of {expected}, as the configuration has, got {found}; "
                "start again in another folder"
            )
        try:
            (folder / MARKERS).mkdir(exist_ok=True)  # without markers, every task is done again
        except OSError as error:
            raise StoreError(folder, error) from error
        return cls(folder, campaign)

    @cached_property
    def _arrays(self) -> Any:
        import zarr

        return zarr.open_group(self.path / DATA, mode="r+", zarr_format=2)

    def _selection(self, task: Task) -> tuple[slice, ...]:
        plants = slice(task.first, task.stop)
        return (plants,) if task.scheme is None else (slice(task.scheme, task.scheme + 1), plants)

    def _chunk(self, name: str, task: Task) -> Path:
        """Return the file of a task's chunk."""
        column = task.first // self.campaign.chunk
        return self.path / DATA / name / (f"{column}" if task.scheme is None else f"{task.scheme}.{column}")

    def write(self, task: Task, found: Mapping[str, np.ndarray]) -> None:
        """Store a task's results, then its marker; StoreError if the disk is full.

        An interrupt is raised when both are written.
        """
        _undisturbed(self._write, task, found)

    def _write(self, task: Task, found: Mapping[str, np.ndarray]) -> None:
        at = self._selection(task)
        try:
            for name, values in found.items():
                # The last chunk is longer than its task, so zarr would first read it, whatever it holds.
                self._chunk(name, task).unlink(missing_ok=True)
                self._arrays[name][at] = values.reshape(1, -1) if len(at) == 2 else values
            write_whole(self.path / MARKERS / task.name, _digest(found))
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
        variables, at = PLANT_VARIABLES if task.scheme is None else RUN_VARIABLES, self._selection(task)
        length = min(self.campaign.chunk, len(self.campaign.plants))
        try:
            with (self.path / MARKERS / task.name).open("rb") as marker:
                expected = marker.read(_MARKER + 1).decode("ascii")
            for name, about in variables.items():
                file = self._chunk(name, task)
                if file.exists() and _layout.chunk_fault(file, length * np.dtype(about.dtype).itemsize):
                    return False
            # Some versions of xarray store truth values as integers.
            found = {
                name: np.asarray(self._arrays[name][at]).reshape(-1).astype(about.dtype)
                for name, about in variables.items()
            }
            return _digest(found) == expected
        except (OSError, ValueError, RuntimeError):  # no marker, or a truncated chunk, which does not unpack
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
        """Keep other processes from writing into the folder meanwhile; InputError if one does.

        StoreError if the folder does not take the lock.
        """
        try:
            import fcntl
        except ImportError:  # a system without file locks
            yield
            return
        try:
            file = (self.path / LOCK).open("a")
        except OSError as error:
            raise StoreError(self.path, error) from error
        with file:
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
    stranger: InputError if it holds anything that no campaign writes, is larger than a campaign's, or is damaged.
    """
    import xarray as xr

    folder, name = Path(path), "scheme"
    _layout.files(folder)
    _layout.sizes(folder, whole=True)
    try:
        with xr.open_zarr(folder / DATA, chunks=None, consolidated=True, zarr_format=2) as found:
            for name, variable in found.variables.items():  # noqa: B007 - the error names it
                variable.load()
                for label in variable.values if variable.dtype.kind in "UO" else ():
                    str(label).encode()  # ValueError if it is no text
            return found.load()
    except (OSError, ValueError, RuntimeError, SystemError) as error:  # of zarr, its codecs, and numpy about characters
        raise InputError(
            f"{shown(folder)} must hold whole chunks, got {name}: {reason(error)}; {_layout.AGAIN}"
        ) from error


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
