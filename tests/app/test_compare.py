"""`rhl compare`, and `rhl new --from`: plants by name, a table of scores, one sentence for what is not there."""

import csv
import io

import numpy as np
import pytest

from rhl.app import _compare as module
from rhl.app.cli import main
from rhl.app.config import load
from rhl.plants.benchmarks import benchmark, names
from rhl.plants.examples import EXAMPLES
from rhl.study import compare as study
from rhl.study.compare import Score, compare


def test_scores_of_one_plant(capsys):
    assert main(["compare", "toy", "--steps", "60"]) == 0
    out = capsys.readouterr().out
    assert "1 plant, 60 steps, no noise, no input bounds" in out
    assert "known-plant: 1 of 1 at rest, 1 of them with a peak below 100; median cost 1, " in out
    assert "excite-identify" in out


def test_several_seeds_levels_and_methods(capsys):
    call = ["compare", "toy", "dc-motor", "--steps", "60", "--seeds", "3", "--noise", "0", "--noise", "0.01"]
    assert main([*call, "--method", "known-plant", "--method", "paper"]) == 0
    out = capsys.readouterr().out
    assert "2 plants, 60 steps, noise 0.01, no input bounds" in out
    assert "deepc" not in out
    assert out.count("known-plant: 2 of 2 at rest") == 2
    assert "paper: 6 of 6 at rest" in out


def test_bounded_inputs(capsys):
    assert main(["compare", "dc-motor", "--steps", "60", "--bounded", "--method", "default_scheme"]) == 0
    assert "1 plant, 60 steps, no noise, inputs at most 3 times the regulator's" in capsys.readouterr().out


def test_a_collection(capsys, monkeypatch):
    asked = []
    monkeypatch.setattr(module, "names", lambda largest, collection: asked.append((largest, collection)) or ("toy",))
    assert main(["compare", "--collection", "literature", "--steps", "60", "--method", "known-plant"]) == 0
    assert asked == [(10, "literature")]


def read(text):
    return list(csv.DictReader(io.StringIO(text)))


def test_rows(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    call = ["compare", "toy", "--steps", "60", "--seeds", "2", "--noise", "0.01", "--method", "deepc", "--output"]
    assert main([*call, "rows.csv"]) == 0
    rows = read((tmp_path / "rows.csv").read_text(encoding="utf-8"))
    assert [(row["plant"], row["method"], row["noise"], row["seed"]) for row in rows] == [
        ("toy", "deepc", "0.01", str(seed)) for seed in range(2)
    ]
    plant = benchmark("toy")
    scores = compare(plant.sampled(), plant.z0, plant.order(), 60, seeds=2, noise=0.01, methods=["deepc"])
    assert [float(row["cost"]) for row in rows] == [score.cost for score in scores]
    capsys.readouterr()
    assert main([*call, "rows.csv"]) == 2
    assert "rows.csv, which exists; add --force to write over it" in capsys.readouterr().err
    assert main([*call, "rows.csv", "--force"]) == 0
    capsys.readouterr()
    assert main([*call, "-"]) == 0
    said = capsys.readouterr()
    assert read(said.out)[0]["cost"] == rows[0]["cost"]
    assert "1 plant, 60 steps, noise 0.01, no input bounds" in said.err


def test_what_is_missing_is_empty_and_what_diverged_infinite():
    lost = Score("paper", False, np.inf, np.inf, np.inf, None, failure="RuntimeError: a, b")
    (row,) = read(module.rows([("toy", lost)]))
    assert (row["cost"], row["settled_at"], row["bounded"], row["at_rest"]) == ("inf", "", "", "0")
    assert row["failure"] == "RuntimeError: a, b"


def test_an_interrupt_keeps_what_is_done(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    whole, calls = module.compare, []

    def stopped(*args, **settings):
        calls.append(1)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return whole(*args, **settings)

    monkeypatch.setattr(module, "compare", stopped)
    call = ["compare", "toy", "cstr", "--steps", "60", "--method", "known-plant", "--output", "rows.csv"]
    assert main(call) == 130
    said = capsys.readouterr()
    assert "rhl: interrupted after 1 of 2 plants" in said.err
    assert "known-plant: 1 of 1 at rest" in said.out
    assert [row["plant"] for row in read((tmp_path / "rows.csv").read_text(encoding="utf-8"))] == ["toy"]


def test_a_run_that_fails_is_named(monkeypatch, capsys):
    def broken(tasks):
        raise RuntimeError("no luck")

    monkeypatch.setitem(study._RUN, "paper", broken)
    assert main(["compare", "toy", "--steps", "60", "--method", "paper", "--method", "known-plant"]) == 0
    said = capsys.readouterr()
    assert "rhl: toy: paper, seed 0: RuntimeError: no luck" in said.err
    assert "known-plant: 1 of 1 at rest" in said.out


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["compare", "ac33"], "benchmark must be one of ac3, "),
        (["compare", "toy", "--steps", "3"], "steps must be an integer of at least 20, got 3"),
        (["compare", "toy", "--steps", "many"], "argument --steps: invalid int value: 'many'"),
        (["compare", "toy", "--noise", "-1"], "noise must be a number in [0, 1), got -1.0"),
        (["compare", "toy", "--seeds", "0"], "seeds must be an integer of at least 1, got 0"),
        (["compare", "toy", "--method", "mpc"], "method must be one of known-plant, excite-identify, "),
        (["compare", "--collection", "slicot"], "collection must be one of compleib, literature, got 'slicot'"),
        (["compare", "toy", "--collection", "compleib"], "--collection must be left out where plants are named, "),
        (["compare", "toy", "--output", "no/rows.csv"], "--output must name a file in a folder that exists, "),
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
