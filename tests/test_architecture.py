"""ARCHITECTURE.md names modules and files that are there; its walk through a step is one of the doctests."""

import re
import subprocess
from pathlib import Path

import pytest

from tests.test_imports import ORDER

ROOT = Path(__file__).resolve().parent.parent
TEXT = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")
# Packages with a row for all of their modules, and what only gathers the modules of its folder.
WHOLE = ("kernels", "losses", "paper.claims")
GATHERING = {"plants", "study", "paper", "app"}


def rows(text):
    """The modules of the table, in its order."""
    table = text.partition("## The order of imports")[2].partition("\n## ")[0]
    return re.findall(r"^\| `([\w.]+)` \|", table, re.MULTILINE)


def table_faults(text, order):
    """Modules without a row, rows without a module, rows out of order."""
    named = rows(text)
    expected = [name for name in order if not name.startswith(tuple(f"{package}." for package in WHOLE))]
    expected = [name for name in expected if name not in GATHERING]
    if sorted(named) == sorted(expected) and named != expected:
        return [next(name for name, wanted in zip(named, expected, strict=True) if name != wanted)]
    return sorted(set(named) ^ set(expected))


def lost_paths(text):
    """Files and folders that a page names in backticks and that are not there."""
    named = re.findall(r"`((?:rhl|book|tools|tests|notebooks|proofs|benchmarks|binder)/[\w./-]*)`", text)
    return sorted(path for path in set(named) if not (ROOT / path).exists())


def test_every_module_has_its_row():
    assert table_faults(TEXT, ORDER) == []


def test_a_row_that_is_wrong_is_noticed():
    assert table_faults(TEXT, [*ORDER, "study.later"]) == ["study.later"]
    assert table_faults(TEXT.replace("| `horizon` |", "| `horizons` |"), ORDER) == ["horizon", "horizons"]
    both = re.search(r"^(\| `trace` .*\n)(.*\n)", TEXT, re.MULTILINE)
    assert table_faults(TEXT.replace(both[0], both[2] + both[1]), ORDER) == ["_engine"]


def test_paths_that_texts_name_are_there():
    # CONTRIBUTING.md also names the files that its examples add.
    new = re.findall(
        r"^In the new file `([^`]+)`", (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"), re.MULTILINE
    )
    for name in ("ARCHITECTURE.md", "CONTRIBUTING.md", "README.md"):
        assert set(lost_paths((ROOT / name).read_text(encoding="utf-8"))) <= set(new)


def test_a_path_that_is_lost_is_noticed():
    assert lost_paths("`rhl/horizon.py`, `rhl/horizons.py`, `tests/`") == ["rhl/horizons.py"]


# What a repository has by custom, and the table of folders does not name.
CUSTOMARY = {"ARCHITECTURE.md", "CHANGELOG.md", "CITATION.cff", "CONTRIBUTING.md", "LICENSE", "Makefile", "README.md"}
CUSTOMARY |= {"SECURITY.md", "codemeta.json"}


def astray(files, text):
    """The names at the top level that are neither customary, nor hidden, nor in the table of folders."""
    folders = text.partition("## Folders")[2].partition("\n## ")[0]
    named = set(re.findall(r"`([\w.]+)/?`", folders)) | CUSTOMARY | {"benchmarks"}
    return sorted({name.partition("/")[0] for name in files} - named - {name for name in files if name[0] == "."})


def test_nothing_lies_astray_at_the_top_level():
    if not (ROOT / ".git").exists():
        pytest.skip("no git repository, whose files this is about")
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True, text=True).stdout
    files = [name for name in listed.split("\0") if name and not name.startswith(".")]
    assert astray(files, TEXT) == []
    assert astray([*files, "mine.toml"], TEXT) == ["mine.toml"]
