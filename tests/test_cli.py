"""The command line: exit status, one sentence, no file left behind, rows kept."""

import csv
import subprocess
import sys

import numpy as np
import pytest

from rhl import cli
from rhl.published import linear_example
from tests.test_config import LINEAR


@pytest.fixture
def config(tmp_path):
    """Write a configuration, by default the linear example with replacements, and return its path."""

    def write(*replacements, text=LINEAR):
        for old, new in replacements:
            assert old in text
            text = text.replace(old, new, 1)
        path = tmp_path / "run.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def rows_of(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize(
    ("arguments", "status", "found"),
    [
        (["linear"], 0, ["within", "unexplained"]),
        (["robot"], 0, ["within"]),
        (["linear", "--printed"], 1, ["missed", "as printed"]),
        (["robot", "--printed"], 1, ["missed", "as printed"]),
    ],
)
def test_reproduce(capsys, arguments, status, found):
    assert cli.main(["reproduce", *arguments]) == status
    out = capsys.readouterr().out
    assert all(word in out for word in found)
    assert ("missed" in out) == (status == 1)


def test_reproduce_misses_when_the_library_is_wrong(capsys, monkeypatch):
    right = cli.published.linear_example
    monkeypatch.setattr(cli.published, "linear_example", lambda printed=False: right(printed=True))
    assert cli.main(["reproduce", "linear"]) == cli.MISSED


def test_reproduce_writes_its_run(tmp_path, capsys):
    table, figure = tmp_path / "trace.csv", tmp_path / "fig.svg"
    assert cli.main(["reproduce", "linear", "--output", str(table), "--plot", str(figure)]) == 0
    assert len(rows_of(table)) == 42
    assert figure.read_text(encoding="utf-8").rstrip().endswith("</svg>")


def test_run_writes_every_row_to_the_last_digit(config, tmp_path):
    table = tmp_path / "trace.csv"
    assert cli.main(["run", str(config()), "--output", str(table), "--plot", str(tmp_path / "fig.png")]) == 0
    rows, trace = rows_of(table), linear_example().run()
    assert list(rows[0]) == ["k", "y1", "v1", "yhat1", "z1", "z2", "z3", "weight", "lambda"]
    assert [row["k"] for row in rows] == [str(k) for k in range(42)]
    assert np.array_equal([float(row["v1"]) for row in rows], trace.v[:, 0])
    assert np.array_equal([float(row["weight"]) for row in rows], trace.weight)
    assert (tmp_path / "fig.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("replacement", "sentence"),
    [
        (("horizon = 20", "horizon = 0"), "rhl: controller.horizon must be a whole number"),
        (("mixing = 0.0", "mixing = 1.0"), "rhl: estimator.mixing must be"),
        (("R = 10000.0", "R = -1.0"), "rhl: controller.R must be positive definite"),
        (("H = [[1, 0, 1]]", "H = [[1, 0]]"), "rhl: plant.H must have shape"),
        (("0.92", "oops"), "must be valid TOML"),
    ],
)
def test_bad_input_is_one_sentence_and_leaves_no_file(config, tmp_path, capsys, replacement, sentence):
    table = tmp_path / "trace.csv"
    assert cli.main(["run", str(config(replacement)), "--output", str(table)]) == cli.BAD_INPUT
    captured = capsys.readouterr()
    assert sentence in captured.err
    assert captured.err.count("\n") == 1
    assert captured.out == ""
    assert not table.exists()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ([], "the following arguments are required"),
        (["reproduce", "line"], "invalid choice"),
        (["run", "run.toml"], "the following arguments are required: --output"),
        (["run", "missing.toml", "--output", "trace.csv"], "missing.toml must be a readable TOML file"),
        (["reproduce", "linear", "--output", "no/such/folder/t.csv"], "must name a file in a folder that exists"),
        (["reproduce", "linear", "--output", "."], "must name a file, got the folder"),
        (["reproduce", "linear", "--plot", "fig.jpeg"], "--plot must end in .svg, .pdf or .png"),
    ],
)
def test_bad_calls(tmp_path, monkeypatch, capsys, arguments, sentence):
    monkeypatch.chdir(tmp_path)
    assert cli.main(arguments) == cli.BAD_INPUT
    captured = capsys.readouterr()
    assert sentence in captured.err
    assert captured.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_overflow_says_where_and_keeps_the_rows(config, tmp_path, capsys):
    table = tmp_path / "trace.csv"
    assert cli.main(["run", str(config(("1.02", "1e30"))), "--output", str(table)]) == cli.STOPPED
    rows, message = rows_of(table), capsys.readouterr().err
    assert 0 < len(rows) < 42
    assert f"at k = {len(rows)}:" in message
    assert message.count("\n") == 1
    assert all(np.isfinite(float(entry)) for row in rows for entry in row.values())


def test_overflow_at_the_first_step_leaves_the_heading(config, tmp_path, capsys):
    table = tmp_path / "trace.csv"
    assert cli.main(["run", str(config(("-10]", "1e200]"))), "--output", str(table)]) == cli.STOPPED
    assert table.read_text(encoding="utf-8") == "k,y1,v1,yhat1,z1,z2,z3,weight,lambda\n"
    assert "at k = 0:" in capsys.readouterr().err


def test_interrupt_keeps_the_rows(config, tmp_path, capsys, monkeypatch):
    real, table = cli.simulate, tmp_path / "trace.csv"

    def interrupted(scheme, plant, z0, steps, progress):
        real(scheme, plant, z0, 5, progress)
        raise KeyboardInterrupt

    monkeypatch.setattr(cli, "simulate", interrupted)
    assert cli.main(["run", str(config()), "--output", str(table)]) == cli.INTERRUPTED
    assert len(rows_of(table)) == 5
    assert "interrupted at k = 5" in capsys.readouterr().err


def test_the_installed_command(config, tmp_path):
    """The command itself, in a process of its own: status and streams as above."""
    command = [sys.executable, "-c", "import sys; from rhl.cli import main; sys.exit(main())"]
    done = subprocess.run([*command, "reproduce", "robot"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    bad = subprocess.run([*command, "run", "x", "--output", "y"], capture_output=True, text=True, check=False)
    assert bad.returncode == 2
    assert "Traceback" not in bad.stderr
