"""`rhl compare`, and `rhl new --from`: plants by name, a table of scores, one sentence for what is not there."""

import pytest

from rhl.app.cli import main
from rhl.app.config import load
from rhl.plants.benchmarks import names
from rhl.plants.examples import EXAMPLES


def test_scores_of_one_plant(capsys):
    assert main(["compare", "toy", "--steps", "60"]) == 0
    out = capsys.readouterr().out
    assert "1 plants, 60 steps, no noise" in out
    assert "the plant known: 1 of 1 at rest, 1 of them with a peak below 100" in out
    assert "excite, identify, regulate" in out


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["compare", "ac33"], "benchmark must be one of ac3, "),
        (["compare", "toy", "--steps", "3"], "steps must be an integer of at least 20, got 3"),
        (["compare", "toy", "--steps", "many"], "argument --steps: invalid int value: 'many'"),
        (["new", "mine", "--from", "ac33"], "--from must name a plant that comes with rhl, one of ac3, "),
        (["new", "mine", "--from", ""], "--from must name a plant that comes with rhl, one of cart-pendulum, "),
    ],
)
def test_refused(arguments, sentence, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith(f"rhl: {sentence}")
    assert said.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("source", [*names(), *EXAMPLES])
def test_a_file_from_every_plant_is_read(source, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["new", "mine", "--from", source]) == 0
    experiment = load("mine.toml").experiment()
    assert experiment.name == "mine"
    assert experiment.scheme.units is not None


def test_such_a_file_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["new", "mine", "--from", "ac3"]) == 0
    assert main(["run", "mine.toml", "--output", "mine.csv"]) == 0
    assert "400 rows in mine.csv; at the end largest |z|" in capsys.readouterr().out
    assert main(["new", "mine", "--from", "ac3"]) == 2
    assert "mine.toml, which exists; add --force to write over it" in capsys.readouterr().err
