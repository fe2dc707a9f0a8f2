"""ARCHITECTURE.md names modules and files that are there; its walk through a step is one of the doctests."""

import re
from pathlib import Path

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
