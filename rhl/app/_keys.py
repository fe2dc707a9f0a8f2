"""The allowed values of a file's keys, as JSON schemas from which checks and descriptions are derived."""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Mapping
from contextlib import suppress
from math import inf
from pathlib import Path
from typing import Any, Self

from rhl._checks import describe, shown
from rhl.errors import InputError

Kind = Mapping[str, Any]

# The largest file in bytes, with room for matrices of a few hundred rows, and the most of its lines that begin with a
# bracket: each may be a table's header, of which the parser keeps a thousand bytes for each part of the key.
_LARGEST, _HEADERS = 5_000_000, 10_000
_HEADER = re.compile(r"^[ \t]*+\[", re.MULTILINE)
# The parser keeps all beginnings of a dotted key, the square of its length. The project's keys have up to three parts.
_PARTS = 8
_PART = r"""(?:[A-Za-z0-9_-]++|"[^"\\\n]*+(?:\\.[^"\\\n]*+)*+"?|'[^'\n]*+'?)"""
_DOT = r"[ \t]*+\.[ \t]*+"
# Comments, strings of several lines, and keys, as which numbers and strings count too; each alternative runs to its end
# without going back, and one without its end is an error of the parser.
_TOKENS = re.compile(
    r"""\#[^\n]*+"""
    r"""|\"{3}[^"\\]*+(?:(?:\\[\s\S]|"(?!""))[^"\\]*+)*+(?:"{3,5}+)?"""
    r"""|'{3}[^']*+(?:'(?!'')[^']*+)*+(?:'{3,5}+)?"""
    rf"""|{_PART}(?:{_DOT}{_PART}){{0,{_PARTS - 1}}}+(?P<more>{_DOT}["'\w-])?+"""
)


def integer(low: int, high: int) -> Kind:
    return {"type": "integer", "minimum": low, "maximum": high}


def list_of(*kinds: Kind) -> Kind:
    return {"type": "array", "items": _either(*kinds)}


def table_of(*sections: type[Section]) -> Kind:
    return {"type": "object", "sections": sections}


def _either(*kinds: Kind) -> Kind:
    return kinds[0] if len(kinds) == 1 else {"anyOf": list(kinds)}


# The upper limits are far above any use; they keep a typing error from exhausting the memory.
SIZE, LENGTH, COUNT = integer(1, 100), integer(1, 10_000), integer(1, 100_000)
NUMBER: dict[str, Any] = {"type": "number"}
POSITIVE: Kind = NUMBER | {"exclusiveMinimum": 0}
NOT_NEGATIVE: Kind = NUMBER | {"minimum": 0}
FRACTION: Kind = NUMBER | {"minimum": 0, "exclusiveMaximum": 1}
OPEN_FRACTION: Kind = NUMBER | {"exclusiveMinimum": 0, "exclusiveMaximum": 1}
FLAG: Kind = {"type": "boolean"}
TEXT: dict[str, Any] = {"type": "string"}
# Characters that end a line, move a cursor or change the writing direction would spoil tables and figures,
# and so would a text of pages; `rhl new` takes the name of a file, which is never longer than this.
LINE: Kind = TEXT | {
    "pattern": "^[^\\u0000-\\u001f\\u007f-\\u009f\\u2028-\\u202e\\u2066-\\u2069]*$(?!\\n)",
    "maxLength": 255,
}
VECTOR = list_of(NUMBER)
MATRIX = list_of(VECTOR)
# A matrix of numbers, with "?" for unknown entries.
PARTIAL = list_of(list_of(NUMBER, TEXT | {"enum": ["?"]}))
# One of the words that stand in quotes in the key's description.
WORDS: Kind = {}

_TYPES: dict[str, Any] = {
    "integer": int,
    "number": (int, float),
    "boolean": bool,
    "string": str,
    "array": list,
    "object": (),  # tables are read by their sections
    "none": (),
}


def key(what: str, *kinds: Kind, default: Any = ...) -> Any:
    """Declare a key of a section, whose value is of one of the kinds; of ``WORDS`` if none is given.

    ``what`` completes the sentence "KEY must be ..."; ``{}`` in it becomes the first kind's description. ``default`` is
    the value of a key that is left out; a key without default is required.
    """
    words, kinds = TEXT | {"enum": re.findall('"([^"]*)"', what)}, kinds or (WORDS,)
    about = {"description": what.replace("{}", _said(kinds[0])), **_either(*(kind or words for kind in kinds))}
    return about if default is ... else {**about, "default": default}


def _said(kind: Kind) -> str:
    low, high = (kind.get(end, kind.get(f"exclusive{end.title()}")) for end in ("minimum", "maximum"))
    match kind.get("type"), low, high:
        case "integer", _, _:
            return f"an integer from {low} to {high}"
        case "number", None, None:
            return "a number"
        case "number", _, None:
            return f"a number of at least {low}" if "minimum" in kind else "a positive number"
        case "number", _, _:
            return f"a number in {'[' if 'minimum' in kind else '('}{low}, {high})"
    string = f"a string of at most {kind['maxLength']} characters" if "maxLength" in kind else "a string"
    return {"boolean": "true or false", "string": string, "object": "a section"}.get(kind.get("type", ""), "")


def fitted(kind: Kind, value: Any) -> Any:
    """Return a value in the key's type, a number as float; ValueError if it is not of this kind."""
    for option in kind.get("anyOf", ()):
        with suppress(ValueError):
            return fitted(option, value)
    what: str = kind.get("type", "none")
    if not isinstance(value, _TYPES[what]) or isinstance(value, bool) != (what == "boolean"):
        raise ValueError
    if isinstance(value, list):
        return [fitted(kind["items"], entry) for entry in value]
    if what == "number":
        try:
            value = float(value)
        except OverflowError:
            raise ValueError from None
    if what in ("integer", "number"):
        # NaN fails every comparison, so this line refuses it too.
        inside = kind.get("exclusiveMinimum", -inf) < value < kind.get("exclusiveMaximum", inf)
        if not (inside and kind.get("minimum", -inf) <= value <= kind.get("maximum", inf)):
            raise ValueError
    elif value not in kind.get("enum", (value,)) or (isinstance(value, str) and not _matches(kind, value)):
        raise ValueError
    return value


def _matches(kind: Kind, text: str) -> bool:
    return len(text) <= kind.get("maxLength", inf) and bool(re.fullmatch(kind.get("pattern", "(?s:.*)"), text))


class Section:
    """A table of the file; class attributes describe its keys, and instance attributes hold their values.

    All keys of a table that ``overrides`` may be left out if the file has a scheme for it to change.
    """

    overrides = False

    def __init__(self, given: dict[str, Any]) -> None:
        self.given = given
        vars(self).update({name: about.get("default") for name, about in self.keys().items()} | given)

    @classmethod
    def keys(cls) -> dict[str, Kind]:
        """Return the description of each key, in the order of the file."""
        return {name: about for name, about in vars(cls).items() if isinstance(about, dict)}

    @classmethod
    def tag(cls) -> str:
        """Return the quoted kind of this table, where a section may have several kinds."""
        return cls.keys().get("kind", {}).get("description", "")

    @classmethod
    def read(cls, at: str, table: dict[Any, Any], wrong: list[tuple[bool, str]], changes: bool = False) -> Self:
        """Read a table; append each error to a list, as a pair: whether a key is unknown, and a sentence.

        ``changes`` says that overriding tables hold changes only.
        """
        keys, values = cls.keys(), {}
        for name, about in keys.items():
            what, kinds = f"{at}{name} must be {about['description']}", about.get("sections", ())
            if name not in table:
                if "default" not in about and not (changes and cls.overrides):
                    wrong.append((False, f"{what}, got nothing; add the {'section' if kinds else 'key'}"))
            elif kinds and isinstance(table[name], dict):
                tag = f'"{table[name].get("kind")}"'
                chosen = kinds if len(kinds) == 1 else [kind for kind in kinds if kind.tag() == tag]
                if chosen:
                    values[name] = chosen[0].read(f"{name}.", table[name], wrong, changes)
                else:
                    *others, last = (kind.tag() for kind in kinds)
                    got = describe(table[name]["kind"]) if "kind" in table[name] else "no such key"
                    wrong.append((False, f"{name}.kind must be {', '.join(others)} or {last}, got {got}"))
            else:
                try:
                    values[name] = fitted(about, table[name])
                except ValueError:
                    wrong.append((False, f"{what}, got {describe(table[name])}"))
        for name in (name for name in table if name not in keys):
            # A key may be any string; one that is not a plain word is quoted, so that it stays on its line.
            plain = isinstance(name, str) and name.replace("-", "_").isidentifier() and len(name) <= 60
            known = f"{at}{name if plain else describe(name)}"
            wrong.append((True, f"{known} is not a known key; expected one of {', '.join(keys)}, got {known}"))
        return cls(values)

    @classmethod
    def needed(cls) -> list[str]:
        """Return the required keys."""
        return [name for name, about in cls.keys().items() if "default" not in about]

    @classmethod
    def schema(cls) -> dict[str, Any]:
        """Return the table's form as a JSON schema; an overriding table has no required keys in it."""
        keys = cls.keys()
        properties = {}
        for name, about in keys.items():
            shown = {part: value for part, value in about.items() if part != "sections" and value is not None}
            kinds = [section.schema() for section in about.get("sections", ())]
            properties[name] = shown | ({} if not kinds else kinds[0] if len(kinds) == 1 else {"oneOf": kinds})
        return {
            "type": "object",
            "description": " ".join((cls.__doc__ or "").split()),
            "properties": properties,
            "required": [] if cls.overrides else cls.needed(),
            "additionalProperties": False,
        }

    def heeded(self, name: str, heeded: bool, where: str) -> None:
        """Refuse a key that is given but has no effect."""
        if name in self.given and not heeded:
            raise InputError(f"{name} must be left out {where}, got {describe(getattr(self, name))}; it has no effect")


def read_toml(path: str | os.PathLike[str]) -> tuple[str, dict[str, Any]]:
    """Read a TOML file and return its text and its tables; InputError if it is missing, too large or not TOML."""
    name = shown(path)
    try:
        with Path(path).open("rb") as file:
            content = file.read(_LARGEST + 1)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f"{name} must be a readable TOML file, got: {getattr(error, 'strerror', error)}") from error
    if len(content) > _LARGEST:
        raise InputError(f"{name} must be a TOML file of at most {_LARGEST} bytes, got more")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{name} must be a TOML file in UTF-8, got other bytes at position {error.start}") from error
    _check_size(name, text)
    try:
        data = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # the parser's own error is a ValueError, and so is a huge number's
        detail = "too deeply nested" if isinstance(error, RecursionError) else " ".join(str(error).split())
        raise InputError(f"{name} must be valid TOML, got: {detail}") from error
    return text, data


def _check_size(name: str, text: str) -> None:
    """Refuse keys and tables whose parsing would take far more memory than the file has bytes."""
    deep = next((token for token in _TOKENS.finditer(text) if token["more"]), None)
    if deep is not None:
        line = text.count("\n", 0, deep.start()) + 1
        raise InputError(
            f"{name} must have keys of at most {_PARTS} parts, got more in line {line}: {describe(deep[0])}; give each "
            "key below the header of its section"
        )
    headers = sum(1 for _ in _HEADER.finditer(text))
    if headers > _HEADERS:
        raise InputError(
            f"{name} must have at most {_HEADERS} lines that begin with a bracket, got {headers}; leave out sections, "
            "or give a matrix in fewer lines"
        )
