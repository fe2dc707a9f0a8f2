"""Streams that are closed, full or narrow, terminals that go, files that appear: one line, and no traceback."""

import gzip
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from rhl import _files
from rhl.app import _run, _status, cli
from rhl.app._streams import STDOUT, interruptible, printable, target_name
from rhl.errors import InputError
from rhl.paper.published import Experiment
from tests.app.test_bad_files import GOOD, OWN, but, whole_rows
from tests.app.test_config import LINEAR

RHL = f"{sys.executable} -m rhl"
RUN = "run run.toml --output t.csv"
CLOSED = "got standard output, which is closed\n"
LOOP = "got loop.csv: Too many levels of symbolic links"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("run.toml").write_text(LINEAR, encoding="utf-8")
    Path("loop.csv").symlink_to("loop.csv")
    Path("loop.toml").symlink_to("loop.toml")
    return tmp_path


def shell(command, **environment):
    """What a command of the shell says: exit status of its first part, standard output, standard error."""
    done = subprocess.run(
        ["bash", "-c", f"{command}; exit ${{PIPESTATUS[0]}}"],
        capture_output=True,
        check=False,
        env=os.environ | {"PYTHONUNBUFFERED": ""} | environment,
        timeout=120,
    )
    assert b"Traceback" not in done.stderr
    return done.returncode, done.stdout.decode(), done.stderr.decode()


def test_the_package_is_the_command(folder):
    assert shell(f"{RHL} --version") == shell(
        f"{sys.executable} -c 'import sys; from rhl.app.cli import main; sys.exit(main())' --version"
    )
    status, out, err = shell(f"{RHL} {RUN}")
    assert (status, err, whole_rows("t.csv")) == (0, "", 42)
    assert out.startswith("42 rows in t.csv; at the end largest |z| ")
    assert shell(f"{RHL} fly")[2].startswith("rhl: argument COMMAND: invalid choice: 'fly'")


@pytest.mark.parametrize(
    ("call", "status", "says"),
    [
        (f"{RUN} >&-", 0, ""),
        (f"{RUN} 2>&-", 0, ""),
        (f"{RUN} >&- 2>&- <&-", 0, ""),
        ("check run.toml >&-", 0, ""),
        ("run missing.toml --output t.csv 2>&-", 2, ""),
        ("--help >&-", 0, ""),
        ("--help > /dev/full", 2, "rhl: the table must be written to standard output, got: No space left on device\n"),
        ("run run.toml --output - >&-", 2, f"rhl: --output must name a target that can be written, {CLOSED}"),
        (
            "run run.toml --output - > /dev/full",
            2,
            "rhl: the table must be written to standard output, got: No space left on",
        ),
        ("schema >&-", 2, f"rhl: --output must name a target that can be written, {CLOSED}"),
        ("verify --list | head -1", (0, 141), ""),
        ("run run.toml --output - | head -1", (0, 141), ""),
    ],
)
def test_streams_that_are_closed_or_full(folder, call, status, says):
    found, out, err = shell(f"{RHL} {call}")
    assert found in (status if isinstance(status, tuple) else (status,))
    assert err.replace(f"{out}", "").startswith(says) if says else "rhl: " not in err
    assert Path("t.csv").exists() == call.startswith(RUN)
    assert not Path("t.csv").exists() or whole_rows("t.csv") == 42


@pytest.mark.parametrize("stream", ["2>&1 | true", "2>&1 > /dev/null | true"])
def test_nobody_reads_a_complaint(folder, stream):
    """The exit status stays what it is."""
    assert shell(f"(sleep 0.3; {RHL} run missing.toml --output t.csv; echo $? > status) {stream}")[0] == 0
    assert Path("status").read_text(encoding="utf-8") == "2\n"


@pytest.mark.parametrize("environment", [{"PYTHONIOENCODING": "ascii"}, {"LC_ALL": "C", "PYTHONUTF8": "0"}])
def test_an_encoding_that_lacks_letters_shows_them_escaped(folder, environment):
    Path("run.toml").write_text(but('name = "linear"', 'name = "größe"'), encoding="utf-8")
    environment |= {"PYTHONCOERCECLOCALE": "0"}
    status, out, err = shell(f"{RHL} check run.toml", **environment)
    assert (status, err) == (0, "")
    assert out.startswith("gr\\xf6\\xdfe: before a run" if "LC_ALL" not in environment else "gr")
    status, out, err = shell(f"{RHL} run run.toml --output größe.csv", **environment)
    assert (status, err) == (0, "")
    assert out.isascii()
    assert whole_rows("größe.csv") == 42


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (["run", "run.toml", "--output", "loop.csv"], f"--output must name a file that can be written, {LOOP}"),
        (["schema", "--output", "loop.csv", "--force"], f"--output must name a file that can be written, {LOOP}"),
        (["run", "loop.toml", "--output", "t.csv"], "loop.toml must be a readable TOML file, got: Too many levels of"),
        (["check", "loop.toml"], "loop.toml must be a readable TOML file, got: Too many levels of"),
        (["new", "loop"], "NAME must name a file that can be written, got loop.toml: Too many levels of"),
        (["run", "run.toml", "--output", "t.csv", "--plot", "-"], "--plot must end in .svg, .pdf or .png, got -"),
        (["run", "run.toml", "\x1b[31m\x07", "--output", "t.csv"], "unrecognized arguments: \\x1b[31m\\x07; see"),
    ],
)
def test_links_in_a_circle_and_other_names(folder, capsys, call, says):
    Path("-").write_text("mine", encoding="utf-8")
    assert cli.main(call) == _status.BAD_INPUT
    streams = capsys.readouterr()
    assert streams.err.startswith(f"rhl: {says}")
    assert streams.err.count("\n") == 1
    assert streams.out == ""


def test_control_characters_are_shown():
    assert printable("größe: a\x1b[31m\nb\u202e") == "größe: a\\x1b[31m\\nb\\u202e"


def test_a_folder_of_control_characters_is_shown_escaped(folder, capsys):
    Path("a\x1b[31m").mkdir()
    assert cli.main(["new", "a\x1b[31m/mine"]) == 0
    assert capsys.readouterr().out.startswith(
        "a\\x1b[31m/mine.toml is ready to run: rhl run 'a\\x1b[31m/mine.toml' --output"
    )


@pytest.mark.parametrize(
    ("name", "printed"), [("-x", "./-x"), ("x", "x"), ("there/-x", "there/-x"), ("-x.toml", "./-x")]
)
def test_the_printed_command_works(folder, capsys, name, printed):
    Path("there").mkdir()
    assert cli.main(["new", "--", name]) == 0
    said = capsys.readouterr().out
    assert said.startswith(f"{printed}.toml is ready to run: rhl run {printed}.toml --output {printed}.csv --plot ")
    assert cli.main(said.partition(": rhl ")[2].split()) == 0
    assert Path(f"{printed}.svg").exists()


def test_a_file_of_that_name_is_no_stream():
    assert [target_name(text) is STDOUT for text in ("-", "/dev/stdout", "./-", "/dev/null")] == [
        *(True, True, False, False)
    ]


def test_rows_are_printed_and_words_are_not(folder, capsys):
    assert cli.main(["run", "run.toml", "--output", "t.csv"]) == 0
    words = capsys.readouterr().out
    for name in ("-", "/dev/stdout"):
        assert cli.main(["run", "run.toml", "--output", name]) == 0
        streams = capsys.readouterr()
        assert streams.out == Path("t.csv").read_text(encoding="utf-8")
        assert streams.err == words.replace("t.csv", "standard output")
    assert not Path("-").exists()
    assert shell(f"{RHL} run run.toml --output /dev/stdout > whole.csv")[0] == 0
    assert whole_rows("whole.csv") == 42


@pytest.mark.parametrize(
    ("call", "begins", "words"),
    [
        (["schema", "--output", "-"], '{\n "$schema"', ""),
        (["reproduce", "robot", "--output", "-"], "k,y1,y2,y3,v1", "within"),
        (["verify", "eq-1", "--fast", "--json", "-"], '{\n "version"', "checked by"),
    ],
)
def test_every_result_can_be_printed(folder, capsys, call, begins, words):
    assert cli.main(call) == 0
    streams = capsys.readouterr()
    assert streams.out.startswith(begins)
    assert words in streams.err
    assert not words or words not in streams.out


def test_a_run_that_stops_at_once_prints_the_heading(folder, capsys):
    Path("run.toml").write_text(but("-10]", "1e200]"), encoding="utf-8")
    assert cli.main(["run", "run.toml", "--output", "-"]) == _status.STOPPED
    assert capsys.readouterr().out == "k,y1,v1,yhat1,z1,z2,z3,weight,lambda\n"


def test_pipes_are_written_into(folder):
    status, _, err = shell(f"{RHL} run run.toml --output >(gzip > t.gz)")
    assert (status, err) == (0, "")
    deadline = time.monotonic() + 30
    while time.monotonic() < deadline and not (Path("t.gz").exists() and Path("t.gz").stat().st_size > 100):
        time.sleep(0.02)
    assert len(gzip.decompress(Path("t.gz").read_bytes()).splitlines()) == 43
    # A file that is open already is written into too, after what it holds.
    Path("log.csv").write_text("before\n", encoding="utf-8")
    assert shell(f"{RHL} run run.toml --output /dev/stderr 2>> log.csv")[0] == 0
    first, *rows = Path("log.csv").read_text(encoding="utf-8").splitlines()
    assert (first, len(rows)) == ("before", 43)
    os.mkfifo("pipe")
    assert shell(f"cat pipe > got.csv & {RHL} run run.toml --output pipe; wait")[0] == 0
    assert whole_rows("got.csv") == 42
    assert Path("pipe").is_fifo()


@pytest.mark.parametrize("link", [os.link, None], ids=["links", "no links"])
def test_a_file_that_appears_during_the_run_is_kept(folder, capsys, monkeypatch, link):
    """Of two runs that name the same file the later one is refused, and leaves nothing half-written."""
    real = Experiment.run

    def overtaken(experiment, progress):
        Path("t.csv").write_text("another's", encoding="utf-8")
        return real(experiment, progress)

    if link is None:

        def without(*_):
            raise PermissionError

        monkeypatch.setattr(os, "link", without)
    monkeypatch.setattr(Experiment, "run", overtaken)
    before = {entry.name for entry in folder.iterdir()}
    assert cli.main(RUN.split()) == _status.BAD_INPUT
    assert capsys.readouterr().err == (
        "rhl: t.csv must be a new file, got one that another program has made meanwhile; choose another name\n"
    )
    assert Path("t.csv").read_text(encoding="utf-8") == "another's"
    assert {entry.name for entry in folder.iterdir()} == before | {"t.csv"}
    assert cli.main([*RUN.split(), "--force"]) == 0
    assert whole_rows("t.csv") == 42
    _files.write_whole("new", "content", new=True)
    assert Path("new").read_text(encoding="utf-8") == "content"
    with pytest.raises(InputError, match="new must be a new file, got one"):
        _files.write_whole("new", "other", new=True)
    assert {entry.name for entry in folder.iterdir()} == before | {"t.csv", "new"}


@pytest.mark.parametrize("start", ["1e200]", "-10]"], ids=["fails at once", "interrupted at once"])
def test_force_keeps_a_good_file_where_no_row_was_made(folder, capsys, monkeypatch, start):
    assert cli.main(RUN.split()) == 0
    good = Path("t.csv").read_bytes()
    Path("run.toml").write_text(but("-10]", start), encoding="utf-8")
    if start == "-10]":

        def interrupted(*_):
            raise KeyboardInterrupt

        monkeypatch.setattr(Experiment, "run", interrupted)
    assert cli.main([*RUN.split(), "--force"]) in (_status.STOPPED, _status.INTERRUPTED)
    assert capsys.readouterr().err.endswith("; there is no row before it, and t.csv is unchanged\n")
    assert Path("t.csv").read_bytes() == good


def started(command, **streams):
    """A long run as a process, once it is under way."""
    Path("run.toml").write_text(OWN.replace("steps = 42", "steps = 100000"), encoding="utf-8")
    Path("p.py").write_text(f"import time\n{GOOD}n = 0\ngood = step\n", encoding="utf-8")
    with Path("p.py").open("a", encoding="utf-8") as file:
        file.write(
            "def step(z, v):\n global n\n n += 1\n time.sleep(0.001)\n if n == 20: open('mark', 'w').close()\n"
            " return good(z, v)\n"
        )
    process = subprocess.Popen([*command, *RUN.split(), "--allow-python"], **streams)
    deadline = time.monotonic() + 60
    while not Path("mark").exists() and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.02)
    return process


def test_a_terminal_that_is_closed_keeps_the_rows(folder):
    main, side = os.openpty()
    # The leader of a session that opens a terminal is told when that is closed.
    code = f"import os; os.close(os.open({os.ttyname(side)!r}, os.O_RDWR)); from rhl.app.cli import main; exit(main())"
    process = started([sys.executable, "-c", code], stdin=side, stdout=side, stderr=side, start_new_session=True)
    os.close(side)
    os.close(main)
    assert process.wait(timeout=60) == _status.INTERRUPTED
    assert 10 <= whole_rows("t.csv") < 100000


@pytest.mark.parametrize("ignored", [False, True])
def test_a_hangup_interrupts_unless_it_is_ignored(folder, ignored):
    handler = "IGN" if ignored else "DFL"
    code = (
        f"import signal; signal.signal(signal.SIGHUP, signal.SIG_{handler})\nfrom rhl.app.cli import main; exit(main())"
    )
    process = started([sys.executable, "-c", code], stderr=subprocess.PIPE, text=True)
    process.send_signal(signal.SIGHUP)
    if ignored:
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(timeout=0.5)
        process.send_signal(signal.SIGTERM)
    _, err = process.communicate(timeout=60)
    rows = whole_rows("t.csv")
    assert process.returncode == _status.INTERRUPTED
    assert err == f"rhl: the run was interrupted at k = {rows}; the {rows} rows before it are in t.csv\n"


def test_a_second_hangup_does_not_hit_the_writing():
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    try:
        with interruptible():
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(signal.SIGHUP)
            try:
                signal.raise_signal(signal.SIGHUP)
            except KeyboardInterrupt:
                pytest.fail("the second one interrupts too")
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_DFL
    finally:
        signal.signal(signal.SIGHUP, before)


def test_columns_say_how_wide_a_table_is(folder, capsys, monkeypatch):
    def width():
        assert cli.main(["check", "run.toml"]) == 0
        return max(map(len, capsys.readouterr().out.splitlines()))

    monkeypatch.delenv("COLUMNS", raising=False)
    assert width() == 140
    for asked in (90, 200):
        monkeypatch.setenv("COLUMNS", str(asked))
        assert width() == asked


@pytest.mark.parametrize("asked", ["0", "²", "٣", "-5", "abc", "1000000000", ""])
def test_columns_that_are_no_number_of_columns_do_not_count(folder, capsys, monkeypatch, asked):
    def width():
        assert cli.main(["check", "run.toml"]) == 0
        return max(map(len, capsys.readouterr().out.splitlines()))

    for columns, lines, wanted in ((asked, "25", 140), (asked, "²", 140), ("90", "²", 90)):
        monkeypatch.setenv("COLUMNS", columns)
        monkeypatch.setenv("LINES", lines)
        assert width() == wanted


@pytest.mark.parametrize("call", ["--version", "--help", "campaign --help"])
@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_help_that_cannot_be_printed_is_an_error(folder, call, unbuffered):
    """Without a buffer argparse itself meets the error, and says nothing of it."""
    says = "rhl: the table must be written to standard output, got: No space left on device\n"
    assert shell(f"{RHL} {call} > /dev/full", PYTHONUNBUFFERED=unbuffered) == (2, "", says)
    status, out, err = shell(f"{RHL} {call}", PYTHONUNBUFFERED=unbuffered)
    assert (status, err) == (0, "")
    assert out.startswith("rhl " if call == "--version" else "usage: rhl ")
    assert shell(f"{RHL} {call} | true", PYTHONUNBUFFERED=unbuffered)[2] == ""


def test_a_message_that_cannot_be_written_leaves_the_exit_status(tmp_path):
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [*RHL.split(), "run", "missing.toml", "--output", "t.csv"], cwd=tmp_path, stderr=full, check=False
        )
    assert done.returncode == _status.BAD_INPUT


def test_which_stage_makes_the_weight_too_large(monkeypatch):
    """With an adaptive weight it is the stage, not the step."""
    monkeypatch.setattr(_run, "too_heavy", lambda controller, k: f"at {k}")
    for adaptive, says in ((False, "at 7"), (True, "at 0")):
        scheme = SimpleNamespace(controller=SimpleNamespace(adaptive=adaptive))
        error = SimpleNamespace(k=7, what="weight must be finite", trace=None)
        assert _run._heavy(SimpleNamespace(scheme=scheme), error) == says
