"""The command line: exit status, one sentence, no file left behind, rows kept."""

import csv
import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rhl import _files, plotting
from rhl.app import _status, cli
from rhl.app._status import STOPPED
from rhl.app.config import schema
from rhl.errors import InputError, LostControllabilityError, NotSolvedError
from rhl.paper import published
from rhl.paper.published import Experiment, linear_example
from tests.app.test_config import LINEAR


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
    right = published.linear_example
    monkeypatch.setattr(published, "linear_example", lambda printed=False: right(printed=True))
    assert cli.main(["reproduce", "linear"]) == _status.MISSED


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
        (("horizon = 20", "horizon = 0"), "rhl: controller.horizon must be an integer"),
        (("mixing = 0.0", "mixing = 1.0"), "rhl: estimator.mixing must be"),
        (("R = 10000.0", "R = -1.0"), "rhl: controller.R must be positive definite"),
        (("H = [[1, 0, 1]]", "H = [[1, 0]]"), "rhl: plant.H must have shape"),
        (("0.92", "oops"), "must be valid TOML"),
    ],
)
def test_bad_input_is_one_sentence_and_leaves_no_file(config, tmp_path, capsys, replacement, sentence):
    table = tmp_path / "trace.csv"
    assert cli.main(["run", str(config(replacement)), "--output", str(table)]) == _status.BAD_INPUT
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
    assert cli.main(arguments) == _status.BAD_INPUT
    captured = capsys.readouterr()
    assert sentence in captured.err
    assert captured.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_overflow_says_where_and_keeps_the_rows(config, tmp_path, capsys):
    table = tmp_path / "trace.csv"
    assert cli.main(["run", str(config(("1.02", "1e30"))), "--output", str(table)]) == STOPPED
    rows, message = rows_of(table), capsys.readouterr().err
    assert 0 < len(rows) < 42
    assert f"at k = {len(rows)}:" in message
    assert message.count("\n") == 1
    assert all(np.isfinite(float(entry)) for row in rows for entry in row.values())


def test_overflow_at_the_first_step_leaves_the_heading(config, tmp_path, capsys):
    table = tmp_path / "trace.csv"
    assert cli.main(["run", str(config(("-10]", "1e200]"))), "--output", str(table)]) == STOPPED
    assert table.read_text(encoding="utf-8") == "k,y1,v1,yhat1,z1,z2,z3,weight,lambda\n"
    assert "at k = 0:" in capsys.readouterr().err


def test_interrupt_keeps_the_rows(config, tmp_path, capsys, monkeypatch):
    real, table = Experiment.run, tmp_path / "trace.csv"

    def interrupted(experiment, progress):
        real(replace(experiment, steps=5), progress)
        raise KeyboardInterrupt

    monkeypatch.setattr(Experiment, "run", interrupted)
    assert cli.main(["run", str(config()), "--output", str(table)]) == _status.INTERRUPTED
    assert len(rows_of(table)) == 5
    assert "interrupted at k = 5" in capsys.readouterr().err


def test_the_installed_command(config, tmp_path):
    """The command itself, in a process of its own: status and streams as above."""
    command = [sys.executable, "-c", "import sys; from rhl.app.cli import main; sys.exit(main())"]
    done = subprocess.run([*command, "reproduce", "robot"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    bad = subprocess.run([*command, "run", "x", "--output", "y"], capture_output=True, text=True, check=False)
    assert bad.returncode == 2
    assert "Traceback" not in bad.stderr


@pytest.mark.parametrize("flags", [("--output", "run.toml"), ("--output", "same.svg", "--plot", "same.svg")])
def test_no_file_is_written_over_another_of_the_call(config, tmp_path, monkeypatch, capsys, flags):
    monkeypatch.chdir(tmp_path)
    path = config()
    more = () if "--output" in flags else ("--output", "t.csv")
    assert cli.main(["run", "run.toml", *flags, *more]) == _status.BAD_INPUT
    assert "must name a file of its own" in capsys.readouterr().err
    assert path.read_text(encoding="utf-8") == LINEAR
    assert [entry.name for entry in tmp_path.iterdir()] == ["run.toml"]


def test_links_are_followed_and_modes_kept(config, tmp_path):
    target, link = tmp_path / "real.csv", tmp_path / "link.csv"
    target.write_text("old", encoding="utf-8")
    target.chmod(0o600)
    link.symlink_to(target)
    assert cli.main(["run", str(config()), "--output", str(link), "--force"]) == 0
    assert link.is_symlink()
    assert len(rows_of(target)) == 42
    assert target.stat().st_mode & 0o777 == 0o600


def test_a_device_stays_a_device(config, capsys):
    assert cli.main(["run", str(config()), "--output", "/dev/null"]) == 0
    assert not Path("/dev/null").is_file()


def test_rows_do_not_stay_where_the_figure_fails(config, tmp_path, monkeypatch, capsys):
    real = _files.write_whole

    def full(path, content, new):
        if str(path).endswith(".svg"):
            raise InputError(f"{path} must be a writable file, got: No space left on device")
        real(path, content, new=new)

    monkeypatch.setattr(_files, "write_whole", full)
    table = tmp_path / "t.csv"
    call = ["run", str(config()), "--output", str(table), "--plot", str(tmp_path / "f.svg")]
    assert cli.main(call) == _status.BAD_INPUT
    assert not table.exists()


@pytest.mark.parametrize("output", ["t.csv", "-"])
@pytest.mark.parametrize("error", [ValueError("no such scale"), OverflowError("too large"), KeyboardInterrupt()])
def test_a_run_that_cannot_be_drawn_keeps_its_rows(config, tmp_path, capsys, monkeypatch, error, output):
    def failing(*_):
        raise error

    monkeypatch.chdir(tmp_path)
    call = ["run", str(config()), "--output", output, "--plot", "f.svg"]
    with monkeypatch.context() as broken:
        broken.setattr(plotting, "render", failing)
        interrupted = isinstance(error, KeyboardInterrupt)
        assert cli.main(call) == (_status.INTERRUPTED if interrupted else _status.BAD_INPUT)
    streams = capsys.readouterr()
    where = "standard output" if output == "-" else output
    says = f"--plot must be of a run that can be drawn, got {type(error).__name__}: {error}; the rows are in {where}"
    assert streams.err == f"rhl: {'interrupted' if interrupted else says}\n"
    text = streams.out if output == "-" else Path(output).read_text(encoding="utf-8")
    assert len(text.splitlines()) == 43
    assert not Path("f.svg").exists()
    assert cli.main([*call, "--force"]) == 0
    assert Path("f.svg").exists()


def test_a_run_of_zeros_is_drawn(config, tmp_path):
    table, figure = tmp_path / "t.csv", tmp_path / "f.svg"
    at_rest = config(("z0 = [0.1, 0.1, -10]", "z0 = [0, 0, 0]"))
    assert cli.main(["run", str(at_rest), "--output", str(table), "--plot", str(figure)]) == 0
    assert figure.exists()
    assert len(rows_of(table)) == 42


@pytest.mark.parametrize(
    ("replacements", "status"),
    [
        ([("1.02", "1e20"), ("steps = 42", "steps = 1000")], 3),
        ([("1.02", "1e3"), ("steps = 42", "steps = 200")], 3),
        ([("-10]", "1e100]")], 3),
        ([("weight = 1.0", "weight = 5e-324")], 0),
        ([('name = "linear"', "name = '$x_{$'")], 0),
        ([("R = 10000.0", "R = 1e308")], 0),
    ],
)
def test_extreme_runs_are_drawn_without_a_word(config, tmp_path, capsys, recwarn, replacements, status):
    table, figure = tmp_path / "t.csv", tmp_path / "f.svg"
    assert cli.main(["run", str(config(*replacements)), "--output", str(table), "--plot", str(figure)]) == status
    assert capsys.readouterr().err.count("\n") == (1 if status else 0)
    assert figure.exists()
    assert rows_of(table)


@pytest.mark.parametrize("error", [LostControllabilityError, NotSolvedError])
def test_a_run_that_stops_keeps_its_rows(config, tmp_path, capsys, monkeypatch, error):
    real, table = Experiment.run, tmp_path / "t.csv"

    def lost(experiment, progress):
        real(replace(experiment, steps=7), progress)
        raise error("no lambda")

    monkeypatch.setattr(Experiment, "run", lost)
    assert cli.main(["run", str(config()), "--output", str(table)]) == STOPPED
    assert len(rows_of(table)) == 7
    assert "stopped at k = 7: no lambda" in capsys.readouterr().err


@pytest.mark.parametrize(
    "asked",
    [
        ["run", "run.toml", "--output", "there"],
        ["run", "run.toml", "--output", "new.csv", "--plot", "there.svg"],
        ["reproduce", "robot", "--output", "there"],
        ["verify", "eq-1", "--fast", "--json", "there"],
        ["new", "there"],
        ["schema", "--output", "there"],
    ],
    ids=" ".join,
)
def test_what_exists_is_written_over_by_force_only(config, tmp_path, monkeypatch, capsys, asked):
    monkeypatch.chdir(tmp_path)
    config()
    for name in ("there", "there.svg", "there.toml"):
        Path(name).write_text("mine", encoding="utf-8")
    assert cli.main(asked) == _status.BAD_INPUT
    assert "must name a new file, got there" in capsys.readouterr().err
    assert {path.read_text(encoding="utf-8") for path in tmp_path.glob("there*")} == {"mine"}
    assert not Path("new.csv").exists()
    assert cli.main([*asked, "--force"]) == 0
    assert any(path.read_text(encoding="utf-8") != "mine" for path in tmp_path.glob("there*"))


def test_a_new_configuration_runs_as_it_is(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["new", "mine"]) == 0
    assert cli.main(["check", "mine.toml", "--run"]) == 0
    assert cli.main(["run", "mine.toml", "--output", "mine.csv"]) == 0
    assert len(rows_of(Path("mine.csv"))) == 60


@pytest.mark.parametrize("name", ["", ".toml", "no/such/folder", "a\nb"])
def test_names_that_a_new_configuration_cannot_have(tmp_path, monkeypatch, capsys, name):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["new", name]) == _status.BAD_INPUT
    assert capsys.readouterr().err.startswith("rhl: NAME must ")
    assert list(tmp_path.iterdir()) == []


def test_check_tells_a_sound_configuration_from_an_unsound_one(config, tmp_path, capsys):
    assert cli.main(["check", str(config())]) == 0
    assert "violated" not in capsys.readouterr().out
    deaf = tmp_path / "deaf.toml"
    deaf.write_text(LINEAR.replace("G = [[0], [1], [0]]", "G = [[0], [0], [1]]"), encoding="utf-8")
    assert cli.main(["check", str(deaf)]) == _status.MISSED
    assert "the input does not reach the mode 1.02" in " ".join(capsys.readouterr().out.replace("│", " ").split())


def test_check_says_how_a_run_went_that_stopped(config, tmp_path, capsys):
    path = tmp_path / "far.toml"
    path.write_text(LINEAR.replace("1.02", "1e30"), encoding="utf-8")
    assert cli.main(["check", str(path), "--run"]) == STOPPED
    streams = capsys.readouterr()
    assert "after" in streams.out
    assert "left the range of floating-point numbers" in streams.err


SHORT = """\
name = "short"
steps = 80
order = 2

[plant]
kind = "transfer-function"
num = [0.5]
den = [1, -1.1, 0, 0, 0, 0]
z0 = [1, 1, 1, 1, 1]
"""


def test_the_advice_after_a_run_follows_from_the_file(tmp_path, capsys):
    path = tmp_path / "short.toml"
    for order, status in ((2, _status.MISSED), (5, 0)):
        path.write_text(SHORT.replace("order = 2", f"order = {order}"), encoding="utf-8")
        assert cli.main(["check", str(path), "--run"]) == status
        after = " ".join(capsys.readouterr().out.partition("after 80 steps")[2].replace("│", " ").split())
        assert ("raise order to 5" in after) == (order == 2)
        assert "lower order" not in after


def test_the_disturbances_of_the_file_explain_its_run(tmp_path, capsys):
    path = tmp_path / "noisy.toml"
    path.write_text(f"{SHORT.replace('order = 2', 'order = 5')}\n[simulation]\nnoise = 0.1\nload = 1.0\n", "utf-8")
    assert cli.main(["check", str(path), "--run"]) == _status.MISSED
    cells = [line.split("│")[3].strip() for line in capsys.readouterr().out.splitlines() if line.count("│") == 4]
    assert "the sensor errors and the load of this run explain it" in " ".join(cells)


def test_a_run_with_a_set_point_reports_the_distance_from_it(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    ends = []
    for line in ("set_point = 1.0\n", ""):
        Path("goal.toml").write_text(line + SHORT.replace("order = 2", "order = 5"), encoding="utf-8")
        assert cli.main(["run", "goal.toml", "--output", f"goal{len(ends)}.csv"]) == 0
        ends.append(capsys.readouterr().out.partition("at the end ")[2])
    distance = abs(float(rows_of(Path("goal0.csv"))[-1]["y1"]) - 1.0)
    assert ends[0].startswith(f"largest |y - r| {distance:.3g}, largest |z| ")
    assert ends[1].startswith("largest |z| ")


def test_a_broken_assumption_is_one_line_of_warning(config, tmp_path, capsys):
    path = tmp_path / "constant.toml"
    path.write_text(LINEAR.replace("eps_rate = 100.0", 'eps = "constant"\neps_value = 0.1'), encoding="utf-8")
    assert cli.main(["run", str(path), "--output", str(tmp_path / "t.csv")]) == 0
    warned = capsys.readouterr().err.splitlines()
    assert len(warned) == 1
    assert warned[0].startswith("rhl: warning: Theorem 1 asks for an epsilon(k) that tends to zero: Constant does not")


def test_the_schema_is_printed(capsys):
    assert cli.main(["schema"]) == 0
    assert json.loads(capsys.readouterr().out) == schema()


def test_pdf_is_a_figure_too(tmp_path, capsys):
    assert cli.main(["reproduce", "linear", "--plot", str(tmp_path / "f.pdf")]) == 0
    assert (tmp_path / "f.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize("name", ["x" * 300, "y" * 5000 + "/t.csv"])
def test_names_that_no_file_can_have(capsys, name):
    assert cli.main(["reproduce", "linear", "--output", name]) == _status.BAD_INPUT
    assert "--output must name a file" in capsys.readouterr().err


def test_an_interrupt_outside_the_loop_is_one_sentence(monkeypatch, capsys):
    def interrupted(printed=False):
        raise KeyboardInterrupt

    monkeypatch.setattr(published, "linear_example", interrupted)
    assert cli.main(["reproduce", "linear"]) == _status.INTERRUPTED
    assert capsys.readouterr().err == "rhl: interrupted\n"


COMMAND = "import sys; from rhl.app.cli import main; sys.exit(main())"
WITHOUT = "import sys; sys.modules[{!r}] = None\n" + COMMAND


@pytest.mark.parametrize(
    ("package", "extra", "call"),
    [
        ("rich", "app", ["reproduce", "linear", "--output", "t.csv"]),
        ("rich", "app", ["check", "run.toml"]),
        ("rich", "app", ["verify", "eq-1", "--fast", "--json", "t.json"]),
        ("matplotlib", "plot", ["run", "run.toml", "--output", "t.csv", "--plot", "f.svg"]),
        ("matplotlib", "plot", ["reproduce", "robot", "--output", "t.csv", "--plot", "f.svg"]),
        ("control", "paper", ["run", "transfer.toml", "--output", "t.csv"]),
        ("control", "paper", ["check", "transfer.toml"]),
        ("sympy", "paper", ["verify", "--fast"]),
        ("flint", "paper", ["verify", "eq-22", "--fast"]),
    ],
)
def test_a_package_that_is_missing_is_named_with_its_extra(config, tmp_path, package, extra, call):
    path = config()
    plant = 'kind = "transfer-function"\nnum = [1.0]\nden = [1.0, -1.1]\nz0 = [1.0]\n'
    text = LINEAR[: LINEAR.index('kind = "linear"')] + plant + LINEAR[LINEAR.index("[lifting]") :]
    path.with_name("transfer.toml").write_text(text, encoding="utf-8")
    asked = [sys.executable, "-c", WITHOUT.format(package), *call]
    done = subprocess.run(asked, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.stderr == (
        f"rhl: this command needs the package {package}, got none installed; pip install 'rhl[{extra}]'\n"
    )
    assert (done.returncode, done.stdout) == (_status.BAD_INPUT, "")
    assert {entry.name for entry in tmp_path.iterdir()} == {"run.toml", "transfer.toml"}


def test_what_needs_no_such_package_does_without(config, tmp_path):
    config()
    code = "import sys; sys.modules.update(dict.fromkeys(('rich', 'matplotlib', 'control', 'sympy', 'pandas')))\n"
    for call in (
        ["run", "run.toml", "--output", "t.csv"],
        ["new", "mine"],
        ["schema"],
        ["--version"],
        ["run", "x.toml"],
    ):
        asked = [sys.executable, "-c", code + COMMAND, *call]
        done = subprocess.run(asked, capture_output=True, text=True, check=False, cwd=tmp_path)
        assert done.returncode == (2 if call[-1] == "x.toml" else 0), done.stderr
        assert done.stderr.count("\n") == (1 if done.returncode else 0)


def test_another_missing_module_is_no_matter_of_an_extra(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "rhl.app._templates", None)
    with pytest.raises(ImportError):
        cli.main(["new", "mine"])


def test_help_loads_nothing_that_takes_long():
    for call in (["--help"], ["run", "--help"], ["--version"], ["run"]):
        code = (
            "import sys\nfrom rhl.app.cli import main\ntry: main(sys.argv[1:])\nexcept SystemExit: pass\n"
            "heavy = {'numpy', 'scipy', 'numba', 'rich', 'matplotlib', 'rhl.app.config', 'rhl.paper.published'}\n"
            "print(heavy & set(sys.modules), file=sys.stderr)"
        )
        done = subprocess.run([sys.executable, "-c", code, *call], capture_output=True, text=True, check=True)
        assert done.stderr.splitlines()[-1] == "set()"


def test_a_reader_who_leaves_and_a_full_disk():
    command = f"{sys.executable} -c 'import sys; from rhl.app.cli import main; sys.exit(main())' reproduce robot"
    gone = subprocess.run(["bash", "-c", f"{command} | true; exit ${{PIPESTATUS[0]}}"], capture_output=True, text=True)
    assert gone.returncode in (0, _status.BROKEN_PIPE)
    assert gone.stderr == ""
    full = subprocess.run(["bash", "-c", f"{command} > /dev/full"], capture_output=True, text=True, check=False)
    assert full.returncode == _status.BAD_INPUT
    assert full.stderr == "rhl: the table must be written to standard output, got: No space left on device\n"


def test_verify_one_claim_and_the_ledgers_file(tmp_path, capsys):
    file = tmp_path / "ledger.json"
    assert cli.main(["verify", "remark-4.chain", "--fast", "--json", str(file)]) == 0
    written = json.loads(file.read_text(encoding="utf-8"))
    assert written["version"] == 2
    assert (written["seed"], written["cases"], written["complete"]) == (0, 10, True)
    (entry,) = written["claims"]
    assert entry["verdict"] == "holds-corrected"
    assert entry["status"] == "holds once corrected"
    assert entry["control"]["tripped"] is True
    assert set(entry) == {
        *("id", "item", "label", "statement", "method", "cases", "worst", "tolerance", "verdict", "reason"),
        *(
            "control",
            "page",
            "test",
            "seconds",
            "status",
            "as_recorded",
            "kind",
            "problem",
            "instance",
            "uses",
            "proof",
            "formal",
        ),
    }
    assert "remark-4.chain" in capsys.readouterr().out


def test_verify_fails_where_a_verdict_changed(monkeypatch, capsys):
    from rhl.paper.claims import ledger, lemma_6
    from rhl.paper.claims.claim import Control

    honest = next(claim for claim in lemma_6.CLAIMS if claim.id == "remark-4.chain")
    instance = Control("the corrected form", honest.corrected)
    lying = replace(honest, recorded="refuted", corrected=None, instance=instance)
    monkeypatch.setattr(ledger, "CLAIMS", (lying,))
    assert cli.main(["verify", "--fast"]) == 0  # without the correction it is refuted, as recorded
    monkeypatch.setattr(ledger, "CLAIMS", (replace(lying, stated=honest.corrected),))
    assert cli.main(["verify", "--fast"]) == _status.MISSED
    assert "holds on all cases tried, NOT refuted" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("target", "mutation", "problem"),
    [
        ("rhl.lifting.DelayLifting.augment", lambda *_: 1 / 0, "the check raised ZeroDivisionError: division by zero"),
        ("rhl.paper.claims.remark_4.worst_of", lambda found: float("nan"), "the check found nan"),
        ("rhl.paper.claims.remark_4.worst_of", lambda found: float("-inf"), "the check found -inf"),
        ("rhl.paper.claims.claim.Effort.rng", lambda *_: None, "the check raised AttributeError"),
    ],
)
def test_verify_reports_a_check_that_decides_nothing(tmp_path, monkeypatch, capsys, target, mutation, problem):
    """Neither a traceback that ends the run nor a verdict: a row, a sentence, an entry, a place in the tally."""
    file = tmp_path / "ledger.json"
    monkeypatch.setattr(target, mutation)
    assert cli.main(["verify", "remark-4.stabilizable", "eq-1", "--fast", "--json", str(file)]) == _status.MISSED
    printed = capsys.readouterr().out
    assert "no evidence, NOT holds" in printed
    assert f"remark-4.stabilizable: {problem}" in printed
    assert "1 no evidence, 1 cannot be checked" in printed
    assert "eq-1 cannot be checked: A definition." in printed
    text = file.read_text(encoding="utf-8")
    first = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))["claims"][0]
    assert (first["verdict"], first["status"], first["worst"]) == ("no-evidence", "no evidence", None)
    assert first["problem"].startswith(problem)
    assert first["as_recorded"] is False


def test_verify_reports_a_check_without_cases(monkeypatch, capsys):
    from rhl.paper.claims import ledger
    from rhl.paper.claims.claim import Evidence

    (honest,) = ledger.select(["eq-22"])
    monkeypatch.setattr(ledger, "CLAIMS", (replace(honest, stated=lambda effort: Evidence(0, 0.0)),))
    assert cli.main(["verify", "--fast"]) == _status.MISSED
    assert "eq-22: the check had no cases" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["lemma-99"], "ID must be one of the ledger's"),
        (["--cases", "0"], "--cases: must be an integer from 10 to 100000, got '0'"),
        (["--cases", "9"], "--cases: must be an integer from 10 to 100000, got '9'"),
        (["--cases", "100001"], "--cases: must be an integer from 10 to 100000"),
        (["--seed", "-1"], "seed must"),
    ],
)
def test_verify_refuses(capsys, arguments, sentence):
    assert cli.main(["verify", *arguments]) == _status.BAD_INPUT
    assert sentence in capsys.readouterr().err


def test_verify_lists(capsys):
    assert cli.main(["verify", "--list", "lemma-6"]) == 0
    assert capsys.readouterr().out.startswith("lemma-6 ")


def test_verify_lists_as_json(tmp_path, capsys):
    from rhl.paper.claims import ledger

    assert cli.main(["verify", "--list", "--json", "-"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert [entry["id"] for entry in listed["claims"]] == [claim.id for claim in ledger.CLAIMS]
    assert set(listed["claims"][0]) >= {"id", "statement", "recorded", "method"}
    file = tmp_path / "list.json"
    assert cli.main(["verify", "--list", "eq-22", "--json", str(file)]) == 0
    assert [entry["id"] for entry in json.loads(file.read_text(encoding="utf-8"))["claims"]] == ["eq-22"]
    assert capsys.readouterr().out.startswith("eq-22 ")


def test_verify_keeps_every_number_on_a_narrow_terminal(monkeypatch, capsys):
    for width in (80, 100, 230):
        monkeypatch.setenv("COLUMNS", str(width))
        assert cli.main(["verify", "eq-22", "theorem-2.iii.augmented", "lemma-5", "--fast"]) == 0
        out = capsys.readouterr().out
        assert all(word in out for word in ("cases", "worst", "tolerance", "machine-checked", "counterexample"))
        assert ("left out:" in out) == (width < 230)
        table = [line for line in out.splitlines() if line[:1] in "┏┃┡│└"]
        assert {len(line) for line in table} == {len(table[0])}
        assert len(table[0]) <= width


def test_verify_says_for_which_checks_the_number_of_cases_is(capsys):
    assert cli.main(["verify", "eq-22", "--fast"]) == 0
    assert capsys.readouterr().out.startswith("1 claim, seed 0, 10 cases for each check that draws random ones")


def test_a_second_interrupt_does_not_lose_the_table(tmp_path, monkeypatch, capsys):
    """The first Ctrl-C ends the checks; one that comes while the results are printed and written is ignored."""
    from rhl.app import _verify
    from rhl.paper.claims import ledger

    real_run, real_table, before = ledger.run, _verify.print_table, signal.getsignal(signal.SIGINT)

    def interrupted(claims, effort, progress):
        real_run(claims[:1], effort, progress)
        signal.raise_signal(signal.SIGINT)

    def pressed_again(*arguments):
        signal.raise_signal(signal.SIGINT)
        real_table(*arguments)

    monkeypatch.setattr(ledger, "run", interrupted)
    monkeypatch.setattr(_verify, "print_table", pressed_again)
    file = tmp_path / "v.json"
    assert cli.main(["verify", "eq-22", "lemma-5", "--fast", "--json", str(file)]) == _status.INTERRUPTED
    streams = capsys.readouterr()
    assert streams.err == "rhl: interrupted after 1 of 2 claims\n"
    assert "1 claim, seed 0" in streams.out
    written = json.loads(file.read_text(encoding="utf-8"))
    assert (written["complete"], len(written["claims"])) == (False, 1)
    assert signal.getsignal(signal.SIGINT) == before


def test_without_the_first_interrupt_the_second_one_ends_the_command(monkeypatch, capsys):
    from rhl.app import _verify

    monkeypatch.setattr(_verify, "print_table", lambda *_: signal.raise_signal(signal.SIGINT))
    assert cli.main(["verify", "eq-22", "--fast"]) == _status.INTERRUPTED
    assert capsys.readouterr().err == "rhl: interrupted\n"


def test_verify_fails_where_coq_has_not_checked_a_theorem(monkeypatch, capsys):
    from rhl.paper import formal
    from rhl.paper.claims import ledger

    (claim,) = ledger.select(["lemma-5"])
    assert claim.formal
    kept = formal.record()
    for theorems in ({}, {claim.formal: "Axioms: anything"}):
        monkeypatch.setattr(formal, "record", lambda theorems=theorems: replace(kept, theorems=theorems))
        assert cli.main(["verify", "lemma-5", "--fast"]) == _status.MISSED
        out = capsys.readouterr().out
        assert f"the record of Coq's results does not have the theorem {claim.formal}" in out
        assert "machine-checked" not in out
    monkeypatch.setattr(formal, "record", lambda: kept)
    assert cli.main(["verify", "lemma-5", "--fast"]) == 0
    assert "machine-checked" in capsys.readouterr().out


def test_check_explains_the_words_that_it_uses(config, capsys):
    assert cli.main(["check", str(config()), "--run"]) == _status.MISSED  # a run of 42 steps has not converged
    out = capsys.readouterr().out
    lines = out.splitlines()
    for said in ("met: holds", "note: a number", "N_y, N_v: the numbers", "lifted pair: the model", "s+: the smallest"):
        assert any(line.startswith(said) for line in lines), said
    assert "violated: does not hold" not in lines  # no finding has this verdict
    assert "Theorem 3" not in out  # it fails as printed, so a run cannot meet it


@pytest.mark.parametrize(
    ("asked", "sentence"),
    [
        (["--steps", "100001"], "--steps must be an integer of at most 100000, got 100001"),
        (["--seeds", "1001"], "--seeds must be an integer of at most 1000, got 1001"),
    ],
)
def test_a_comparison_has_limits(capsys, asked, sentence):
    assert cli.main(["compare", "toy", *asked]) == _status.BAD_INPUT
    assert capsys.readouterr().err == f"rhl: {sentence}\n"


def test_a_terminal_without_rich_shows_no_bar(config, tmp_path):
    """On a terminal a run shows its progress; without the package for it, it runs without."""
    main, side = os.openpty()
    call = [sys.executable, "-c", WITHOUT.format("rich"), "run", str(config()), "--output", str(tmp_path / "t.csv")]
    done = subprocess.run(call, stdin=side, stdout=side, stderr=side, check=False)
    os.close(side)
    os.close(main)
    assert done.returncode == 0
    assert len(rows_of(tmp_path / "t.csv")) == 42
