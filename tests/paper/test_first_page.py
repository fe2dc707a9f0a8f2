"""The commands on the book's first page do what it says of them."""

import re
import shlex
from pathlib import Path

from rhl.app import cli
from tests.conftest import ROOT


def commands():
    page = (ROOT / "book/index.md").read_text(encoding="utf-8")
    return re.findall(r"^\$ rhl (.*)$", page, flags=re.MULTILINE)


def test_the_three_lines_for_a_plant_of_ones_own(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert len(commands()) == 3
    for command in commands():
        assert cli.main(shlex.split(command)) == 0, capsys.readouterr().err
    assert {path.name for path in Path().iterdir()} == {"mine.toml", "mine.csv", "mine.svg"}
