"""The layout of a campaign's folder, exactly as the store writes it; anything else is refused before it is opened."""

from __future__ import annotations

import json
import os
import re
import stat
from collections.abc import Mapping
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from rhl._checks import describe, shown
from rhl.errors import InputError
from rhl.study.campaign import PLANT_VARIABLES, RUN_VARIABLES

DATA, PROVENANCE, MARKERS, LOCK = "results.zarr", "provenance.json", "done", "lock"
# The largest store that is loaded, in bytes; a campaign's largest has about 1 GB. The largest file of metadata.
LARGEST, LONGEST = 2_000_000_000, 20_000_000
# The most chunks of an array: each is a file and takes a moment to read.
_CHUNKS = 100_000
_TOGETHER, _ARRAY, _ATTRIBUTES, _GROUP = ".zmetadata", ".zarray", ".zattrs", ".zgroup"
AGAIN = "resume the campaign, which computes damaged results again"
_ANEW = "copy the folder again, or start the campaign again in another one"
_COORDINATES = ("scheme", "plant", "name")
_LABELS = re.compile("[<>]U[1-9][0-9]{0,4}")
_KEYS = {"shape", "chunks", "dtype", "fill_value", "order", "filters", "compressor", "zarr_format"}
_CODECS = {"blosclz", "lz4", "lz4hc", "snappy", "zlib", "zstd"}
# The header of a chunk that blosc has packed: bytes 4 to 8 hold its size unpacked, bytes 12 to 16 its size packed,
# which is larger by the header at most.
_HEADER = 16
# The end of the name of a file that zarr had not finished when its process was killed; no reader opens it.
_UNFINISHED = ".partial"


class _Wrong(Exception):
    """What a folder has that no campaign writes, and what to do about it."""

    def __init__(self, what: str, remedy: str = _ANEW) -> None:
        super().__init__(f"{what}; {remedy}")


@dataclass(frozen=True)
class Sizes:
    """The numbers of schemes and of plants of a store, and of plants in a chunk."""

    schemes: int
    plants: int
    chunk: int

    def __str__(self) -> str:
        return f"{self.schemes} schemes on {self.plants} plants, {self.chunk} in a chunk"


def files(folder: Path) -> None:
    """Refuse a folder with anything but plain files where the store reads or writes; InputError.

    A link could lead out of the folder, and whoever opens a pipe waits for ever.
    """
    data = folder / DATA
    try:
        entries = _plain_folder(folder)
        for name, kind in entries.items():
            if name in (DATA, MARKERS):
                _plain(folder / name, kind, stat.S_ISDIR, "folder")
            elif name in (PROVENANCE, LOCK):
                _plain(folder / name, kind, stat.S_ISREG, "file")
        places = [folder / MARKERS] if MARKERS in entries else []
        if DATA in entries:
            within = _plain_folder(data)
            folders = [name for name, kind in within.items() if stat.S_ISDIR(kind) and not name.startswith(".")]
            places += [data / name for name in folders]
            for name, kind in within.items():
                if name not in folders:
                    _plain(data / name, kind, stat.S_ISREG, "file")
        for place in places:
            for name, kind in _plain_folder(place).items():
                _plain(place / name, kind, stat.S_ISREG, "file")
    except _Wrong as error:
        raise InputError(
            f"{shown(folder)} must be a campaign's folder of plain files without links, got {error}"
        ) from None
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        raise _unreadable(folder, error) from None


def _plain_folder(path: Path) -> dict[str, int]:
    """Return the names in a folder that is no link, with their kinds."""
    if path.is_symlink():
        raise _Wrong(shown(path))
    with os.scandir(path) as found:
        return {entry.name: entry.stat(follow_symlinks=False).st_mode for entry in found}


def _plain(path: Path, kind: int, wanted: Any, what: str) -> None:
    if stat.S_ISLNK(kind):
        raise _Wrong(shown(path))
    if not wanted(kind):
        raise _Wrong(f"{shown(path)}, which is not a plain {what}")


def sizes(folder: Path, *, whole: bool) -> Sizes:
    """Return the sizes of a store whose metadata are as this library writes them; otherwise InputError.

    zarr and xarray would otherwise obey what they read: codecs such as pickle run code, a few bytes of metadata or of
    a chunk promise any number of entries, and attributes change types. Chunks that are not whole are refused too:
    those of results only if the store is to be read ``whole``, since a task whose data are wrong is done again.
    """
    data = folder / DATA
    try:
        about = _metadata(data)
        found = _arrays(about)
        _agree(data, about)
        for name in _names(about):
            if whole or name in _COORDINATES:
                _chunks(data / name, about[f"{name}/{_ARRAY}"])
    except _Wrong as error:
        raise InputError(f"{shown(folder)} must hold a campaign's {DATA}, got {error}") from None
    except (OSError, ValueError, RecursionError) as error:
        raise _unreadable(folder, error) from None
    return found


def _unreadable(folder: Path, error: Exception) -> InputError:
    why = getattr(error, "strerror", None) or "what no campaign writes"
    return InputError(f"{shown(folder)} must hold a campaign's {DATA}, got: {why}; {_ANEW}")


def read_json(file: Path) -> Any:
    """Return the content of a file of JSON; ValueError if it is something else, or longer than a campaign's."""
    with file.open("rb") as opened:
        content = opened.read(LONGEST + 1)
    if len(content) > LONGEST:
        raise ValueError
    try:
        return json.loads(content)
    except RecursionError:
        raise ValueError from None


def _read(file: Path, name: str) -> dict[str, Any]:
    try:
        found = read_json(file)
    except ValueError:
        found = None
    except FileNotFoundError:
        raise _Wrong(f"no {name}") from None
    if not isinstance(found, dict):
        raise _Wrong(f"{name} that no campaign writes")
    return found


def _metadata(data: Path) -> dict[str, Any]:
    """Return the metadata of all arrays by name, from the file that readers prefer to those of the arrays."""
    together = _read(data / _TOGETHER, _TOGETHER)
    about = together.get("metadata")
    if set(together) != {"metadata", "zarr_consolidated_format"} or not isinstance(about, dict):
        raise _Wrong(f"{_TOGETHER} that no campaign writes")
    if not _same(together["zarr_consolidated_format"], 1):
        raise _Wrong(f"{_TOGETHER} of the format {describe(together['zarr_consolidated_format'])}")
    names = _names(about)
    _known(names, "the array")
    missing = [name for name in (*PLANT_VARIABLES, *RUN_VARIABLES, "scheme", "plant") if name not in names]
    if missing:
        raise _Wrong(f"no array {missing[0]}")
    wanted = {_GROUP, _ATTRIBUTES, *(f"{name}/{part}" for name in names for part in (_ARRAY, _ATTRIBUTES))}
    for name in sorted(wanted ^ set(about)):
        raise _Wrong(f"{describe(name)} {'missing from' if name in wanted else 'in'} {_TOGETHER}")
    return about


def _agree(data: Path, about: Mapping[str, Any]) -> None:
    """Refuse arrays that the metadata do not name, and files of metadata that say something else."""
    _known([entry.name for entry in os.scandir(data) if entry.is_dir()], "the folder")
    for place in (data, *(data / name for name in _names(about))):
        if (place / "zarr.json").exists():
            raise _Wrong("zarr.json")
    for name in sorted(about):
        if not _same(_read(data / name, name), about[name]):
            raise _Wrong(f"{name} that differs from {_TOGETHER}")


def _names(about: Mapping[str, Any]) -> list[str]:
    return [name.removesuffix(f"/{_ARRAY}") for name in about if name.endswith(f"/{_ARRAY}")]


def _known(names: list[str], what: str) -> None:
    known = {*PLANT_VARIABLES, *RUN_VARIABLES, *_COORDINATES}
    for name in names:
        if name not in known:
            raise _Wrong(f"{what} {describe(name)}")


def _same(one: Any, other: Any) -> bool:
    """Whether two JSON values are written alike; 1, 1.0 and true are not."""
    return json.dumps(one, sort_keys=True) == json.dumps(other, sort_keys=True)


def _arrays(about: Mapping[str, Any]) -> Sizes:
    """Check the description of every array, and of all together."""
    if not _same(about[_GROUP], {"zarr_format": 2}):
        raise _Wrong(f"{_GROUP} {describe(about[_GROUP])}")
    for name, value in about[_ATTRIBUTES].items():
        if not (name in ("title", "steps", "configuration", "machine") or name.startswith("version of ")):
            raise _Wrong(f"the attribute {describe(name)}")
        if type(value) not in (int, str):
            raise _Wrong(f"the attribute {name} {describe(value)}")
    names, arrays = _names(about), {}
    for name in names:
        arrays[name] = _array(name, about[f"{name}/{_ARRAY}"])
        _attributes(name, about[f"{name}/{_ATTRIBUTES}"], "name" in names, arrays[name]["dtype"])
    (schemes,), (plants,), chunk = arrays["scheme"]["shape"], arrays["plant"]["shape"], arrays["n"]["chunks"][0]
    for name, array in arrays.items():
        shape = [{"scheme": schemes, "plant": plants}[one] for one in _dimensions(name)]
        if array["shape"] != shape:
            raise _Wrong(f"{name} of shape {describe(array['shape'])}, where {shape} is expected")
        if name in PLANT_VARIABLES or name in RUN_VARIABLES:
            chunks = [1, chunk][-len(shape) :]
            if array["chunks"] != chunks:
                raise _Wrong(f"{name} in chunks of {describe(array['chunks'])}, where {chunks} is expected")
    total = sum(prod(array["shape"]) * _item(array) for array in arrays.values())
    if total > LARGEST:
        raise _Wrong(f"{total} bytes, of which there are at most {LARGEST}", "give fewer plants or schemes")
    return Sizes(schemes, plants, chunk)


def _dimensions(name: str) -> list[str]:
    return ["scheme", "plant"] if name in RUN_VARIABLES else ["scheme"] if name == "scheme" else ["plant"]


def _item(array: Mapping[str, Any]) -> int:
    return np.dtype(array["dtype"]).itemsize


def _array(name: str, array: Any) -> dict[str, Any]:
    """Check the description of an array by itself."""
    if not (isinstance(array, dict) and _KEYS <= set(array) <= _KEYS | {"dimension_separator"}):
        raise _Wrong(f"{name}/{_ARRAY} that no campaign writes")
    dtype = array["dtype"]
    if not (isinstance(dtype, str) and _has_type(name, dtype)):
        raise _Wrong(f"{name} of type {describe(dtype)}")
    expected: dict[str, tuple[Any, ...]] = {
        "order": ("C",),
        "filters": (None, []),
        "dimension_separator": (".",),
        "zarr_format": (2,),
    }
    # What stands for the entries that are not written: xarray turns integers into floats to mark any but null.
    expected |= {"fill_value": ("NaN", np.nan) if dtype[1] == "f" else (None,)}
    for key, values in expected.items():
        if key in array and not any(_same(array[key], value) for value in values):
            raise _Wrong(f"{name} with {key} {describe(array[key])}")
    if not _is_blosc(array["compressor"]):
        raise _Wrong(f"{name} with compressor {describe(array['compressor'])}")
    for key in ("shape", "chunks"):
        numbers = array[key]
        if not (isinstance(numbers, list) and all(type(one) is int and one > 0 for one in numbers)):
            raise _Wrong(f"{name} with {key} {describe(numbers)}")
        if len(numbers) != len(_dimensions(name)):
            raise _Wrong(f"{name} with {key} {describe(numbers)}")
    pairs = list(zip(array["shape"], array["chunks"], strict=True))
    if any(chunk > length for length, chunk in pairs):
        raise _Wrong(f"{name} with chunks {describe(array['chunks'])} for shape {describe(array['shape'])}")
    count = prod(-(-length // chunk) for length, chunk in pairs)
    if count > _CHUNKS:
        raise _Wrong(f"{name} in {count} chunks, of which there are at most {_CHUNKS}", "enlarge chunk")
    return array


def _has_type(name: str, dtype: str) -> bool:
    if name in ("scheme", "name"):
        return bool(_LABELS.fullmatch(dtype))
    if name == "plant":
        return dtype[1:] in ("i4", "i8") and dtype[0] in "<>"
    known = np.dtype((PLANT_VARIABLES | RUN_VARIABLES)[name].dtype)
    # Some versions of xarray store truth values as integers.
    return dtype in ("|b1", "|i1") if known.kind == "b" else dtype[1:] == known.str[1:] and dtype[0] in "<>"


def _is_blosc(found: Any) -> bool:
    if not (isinstance(found, dict) and set(found) == {"id", "cname", "clevel", "shuffle", "blocksize"}):
        return False
    levels = {"clevel": range(10), "shuffle": range(-1, 3), "blocksize": range(1)}
    known = found["id"] == "blosc" and isinstance(found["cname"], str) and found["cname"] in _CODECS
    return known and all(type(found[key]) is int and found[key] in values for key, values in levels.items())


def _attributes(name: str, found: Any, has_names: bool, dtype: str) -> None:
    """Check an array's attributes: xarray scales entries and makes times of them if others say so."""
    expected: dict[str, Any] = {"_ARRAY_DIMENSIONS": _dimensions(name)}
    about = (PLANT_VARIABLES | RUN_VARIABLES).get(name)
    if about:
        expected |= {"units": about.units, "description": about.description}
        expected |= {"coordinates": "name"} if has_names else {}
        expected |= {"dtype": "bool"} if dtype == "|i1" else {}
    if not isinstance(found, dict):
        raise _Wrong(f"{name}/{_ATTRIBUTES} that no campaign writes")
    for key in sorted({*found, *expected}):
        if key not in expected:
            raise _Wrong(f"{name} with the attribute {describe(key)}")
        if key not in found:
            raise _Wrong(f"{name} without the attribute {key}")
        if not _same(found[key], expected[key]):
            raise _Wrong(f"{name} with the attribute {key} {describe(found[key])}")


def _chunks(folder: Path, array: Mapping[str, Any]) -> None:
    size = prod(array["chunks"]) * _item(array)
    with os.scandir(folder) as found:
        for entry in found:
            if entry.name.startswith(".") or entry.name.endswith(_UNFINISHED):
                continue
            if fault := chunk_fault(Path(entry.path), size):
                remedy = _ANEW if folder.name in _COORDINATES else AGAIN
                raise _Wrong(f"{describe(f'{folder.name}/{entry.name}')} {fault}", remedy)


def chunk_fault(file: Path, size: int) -> str:
    """Return why a file is not a whole chunk of ``size`` bytes as its header has it; "" if it is one.

    The library that unpacks it would believe the header, whatever the file's length.
    """
    length = file.stat().st_size
    with file.open("rb") as opened:
        header = opened.read(_HEADER)
    unpacked, packed = (int.from_bytes(header[at : at + 4], "little") for at in (4, 12))
    if length < _HEADER or length != packed or length > size + _HEADER:
        return f"of {length} bytes, not the {packed} of its header, for a chunk of {size}"
    return f"that unpacks to {unpacked} bytes for a chunk of {size}" if unpacked != size else ""
