"""environment.lock belongs to pyproject.toml, pins everything by hash, and is what the tests run in."""

import re
import tomllib
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tools.lock import HEADER, fingerprint

ROOT = Path(__file__).resolve().parent.parent
PYPROJECT = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
LOCK = (ROOT / "environment.lock").read_text(encoding="utf-8")


def pins(lock):
    """Each pin of the lock as (Requirement, number of hashes); the lock may pin a name once per marker."""
    blocks = re.split(r"(?m)^(?=\w)", lock)[1:]
    return [
        (Requirement(block.splitlines()[0].rstrip("\\ ")), len(re.findall(r"--hash=sha256:[0-9a-f]{64}\b", block)))
        for block in blocks
    ]


def requirements(pyproject):
    """Everything a pyproject.toml asks for: at runtime, in every extra, and to be built."""
    parsed = tomllib.loads(pyproject)
    extras = parsed["project"]["optional-dependencies"].values()
    asked = [*parsed["project"]["dependencies"], *(need for extra in extras for need in extra)]
    needs = [Requirement(need) for need in [*asked, *parsed["build-system"]["requires"]]]
    return [need for need in needs if need.name != parsed["project"]["name"]]  # an extra may take in another


def faults(pyproject, lock):
    """In what the lock is not a full, hash-pinned answer to the pyproject.toml."""
    found, locked = [], {}
    for pin, hashes in pins(lock):
        locked.setdefault(canonicalize_name(pin.name), []).append(pin)
        if not re.fullmatch(r"==[^*,]+", str(pin.specifier)):
            found.append(f"{pin.name} is not pinned to one version")
        if hashes == 0:
            found.append(f"{pin.name} has no hash")
    for need in requirements(pyproject):
        candidates = locked.get(canonicalize_name(need.name), [])
        if not candidates:
            found.append(f"{need.name} is not in the lock")
        for pin in candidates:
            if not need.specifier.contains(str(pin.specifier).removeprefix("=="), prereleases=True):
                found.append(f"{pin} is locked, but {need} is asked for")
    if not lock.startswith(HEADER.format(fingerprint=fingerprint(pyproject))):
        found.append("the lock was not made from this pyproject.toml: run `make lock`")
    if "://" in lock:
        found.append("the lock names a host")
    return found


def test_lock_and_pyproject_agree():
    assert len(pins(LOCK)) > 100
    assert faults(PYPROJECT, LOCK) == []


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ('"numpy>=2.0"', '"numpy>=99"', "numpy>=99 is asked for"),
        ('"numpy>=2.0"', '"numpy>=2.0", "no-such-thing"', "no-such-thing is not in the lock"),
        ('"numpy>=2.0"', '"numpy>=2.0.1"', "not made from this pyproject.toml"),
        ('"uv>=0.4"', '"uv<0.4"', "uv<0.4 is asked for"),
        ('requires-python = ">=3.11"', 'requires-python = ">=3.12"', "not made from this pyproject.toml"),
    ],
)
def test_changed_pyproject_is_noticed(old, new, fault):
    assert PYPROJECT.count(old) == 1
    assert fault in " ".join(faults(PYPROJECT.replace(old, new), LOCK))


@pytest.mark.parametrize(
    ("pattern", "new", "fault"),
    [
        (r"(?m)^(mpmath==.*?) \\\n(    --hash.*\n)+", r"\1\n", "mpmath has no hash"),
        (r"(?m)^mpmath==\S+", "mpmath>=1", "mpmath is not pinned"),
        (r"(?m)^mpmath==.*\n(    .*\n)+", "", "mpmath is not in the lock"),
        (r"(?m)^pytest==\S+", "pytest==1.0", "pytest==1.0 is locked"),
        (r"\Z", "    # from https://example.org/simple\n", "names a host"),
    ],
)
def test_changed_lock_is_noticed(pattern, new, fault):
    edited, changes = re.subn(pattern, new, LOCK, count=1)
    assert changes == 1
    assert fault in " ".join(faults(PYPROJECT, edited))


def strays(lock):
    """Pins that apply to this machine and are not what is installed on it."""
    found = []
    for pin, _ in pins(lock):
        if pin.marker is None or pin.marker.evaluate():
            try:
                installed = version(pin.name)
            except PackageNotFoundError:
                found.append(f"{pin} is locked, nothing is installed")
                continue
            if installed != str(pin.specifier).removeprefix("=="):
                found.append(f"{pin} is locked, {installed} is installed")
    return found


def test_this_is_the_locked_environment():
    assert strays(LOCK) == []


def test_another_environment_is_noticed():
    edited = re.sub(r"(?m)^pytest==\S+", "pytest==1.0", LOCK) + "no-such-thing==1.0\n"
    assert [stray.split()[0] for stray in strays(edited)] == ["pytest==1.0", "no-such-thing==1.0"]
