"""`rhl campaign`: interrupted, killed and resumed bit for bit; what does not fit is said in one sentence."""

import builtins
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from rhl.app._campaign_keys import CampaignFile, SchemeSection, keys, load, parse
from rhl.app.cli import main
from rhl.study.backends import in_process
from rhl.study.campaign import LostWorkersError
from rhl.study.store import Store, StoreError
from rhl.study.store import load as results

pytest.importorskip("zarr")

GOOD = """\
name = "a small one"
seed = 1
steps = 20
chunk = 4

[plants]
kind = "random"
count = 6
n = [2, 3]

[[schemes]]
base = "default"
R = [1e-4, 1]

[[schemes]]
base = "window"
"""
# A shell without job control starts what runs in the background deaf to Ctrl-C.
HEARING = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
RHL = [sys.executable, "-c", f"{HEARING}; import sys; from rhl.app.cli import main; sys.exit(main())", "campaign"]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("c.toml").write_text(GOOD, encoding="utf-8")
    return tmp_path


def said(capsys):
    streams = capsys.readouterr()
    return streams.out, streams.err


def digest_of(out):
    return re.search(r"^sha256 over all variables: ([0-9a-f]{64})$", out, flags=re.MULTILINE).group(1)


def test_both_delays_of_the_model_can_be_swept(folder):
    Path("c.toml").write_text(GOOD.replace("R = [1e-4, 1]", "model_delay = [0, 1]"), encoding="utf-8")
    labels = [choice.label for choice in load("c.toml")[0].campaign().schemes]
    assert labels == ["default, model_delay = 0", "default, model_delay = 1", "window"]


def test_a_campaign(folder, capsys):
    assert main(["campaign", "c.toml", "--output", "a"]) == 0
    out, err = said(capsys)
    assert err == ""
    assert out.startswith("12 plants, 20 steps")
    assert "default, R = 0.0001" in out
    assert out.endswith("open it: xarray.open_zarr('a/results.zarr')\n")
    assert digest_of(out) == Store(Path("a"), load("c.toml")[0].campaign()).digest()
    found = results("a")
    assert found.scheme.values.tolist() == ["default, R = 0.0001", "default, R = 1", "window"]
    assert found.attrs["configuration"] == GOOD
    # Once more: refused without --resume, and all done with it.
    assert main(["campaign", "c.toml", "--output", "a"]) == 2
    assert said(capsys)[1] == "rhl: --output must name a new folder, got a, which exists; add --resume to continue it\n"
    assert main(["campaign", "c.toml", "--output", "a", "--resume"]) == 0
    assert said(capsys)[0] == out


def begun(output, *arguments, tasks):
    """Start a campaign of longer runs in a process of its own, and return it when some tasks are done."""
    text = GOOD.replace("steps = 20", "steps = 60").replace("count = 6", "count = 16")
    Path("c.toml").write_text(text, encoding="utf-8")
    process = subprocess.Popen(
        [*RHL, "c.toml", "--output", output, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    markers = Path(output, "done")
    while process.poll() is None and (not markers.is_dir() or len(list(markers.iterdir())) < tasks):
        time.sleep(0.02)
    return process


def is_running(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return Path(f"/proc/{pid}/stat").read_text(encoding="ascii").split(")")[1].split()[0] != "Z"


def children(pid):
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii").split()]


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="needs Linux's /proc")
def test_killed_and_resumed_is_uninterrupted(folder, capsys):
    process = begun("a", "--workers", "2", tasks=3)
    workers = children(process.pid)
    process.kill()
    process.communicate()
    assert process.returncode == -signal.SIGKILL
    done = len(list(Path("a", "done").iterdir()))
    campaign = load("c.toml")[0].campaign()
    assert 3 <= done < len(list(campaign.tasks()))
    before = Store(Path("a"), campaign).digest()
    assert main(["campaign", "c.toml", "--output", "a", "--resume"]) == 0
    resumed = digest_of(said(capsys)[0])
    assert main(["campaign", "c.toml", "--output", "b"]) == 0
    assert digest_of(said(capsys)[0]) == resumed != before
    assert len(workers) >= 2
    while any(map(is_running, workers)):  # they end by themselves; where they did not, this would not either
        time.sleep(0.02)


@pytest.mark.parametrize("number", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_interrupted(folder, capsys, number):
    process = begun("a b", tasks=2)
    process.send_signal(getattr(signal, number))
    out, err = process.communicate()
    assert (process.returncode, out) == (130, "")
    assert re.fullmatch(
        r"rhl: interrupted after \d+ of 32 tasks, which are kept; "
        r"rhl campaign c\.toml --output 'a b' --resume continues\n",
        err,
    )
    assert len(list(Path("a b", "done").iterdir())) >= 2


def test_other_seeds(folder, capsys):
    found = []
    for seed in (1, 2):
        Path("c.toml").write_text(GOOD.replace("seed = 1", f"seed = {seed}"), encoding="utf-8")
        assert main(["campaign", "c.toml", "--output", f"a{seed}"]) == 0
        found.append(digest_of(said(capsys)[0]))
    assert found[0] != found[1]
    assert main(["campaign", "c.toml", "--output", "a1", "--resume"]) == 2
    assert said(capsys)[1] == (
        "rhl: --resume must find the configuration as at the campaign's start, got seed = 2, which was 1; "
        "start again in another folder\n"
    )


@pytest.mark.parametrize(
    ("error", "says"),
    [
        (StoreError(Path("a"), OSError(28, "No space left on device")), "a must take the results, got: No space left"),
        (LostWorkersError("workers must stay"), "workers must stay; stopped after 0 of 12 tasks"),
    ],
)
def test_stopped(folder, capsys, monkeypatch, error, says):
    def stop(*_):
        raise error

    with monkeypatch.context() as patched:
        patched.setattr(Store, "write", stop)
        assert main(["campaign", "c.toml", "--output", "a"]) == 3
    err = said(capsys)[1]
    assert err.startswith(f"rhl: {says}")
    assert err.endswith("0 of 12 tasks, which are kept; rhl campaign c.toml --output a --resume continues\n")
    assert main(["campaign", "c.toml", "--output", "a", "--resume"]) == 0


@pytest.mark.parametrize("name", ["done", "lock"])
def test_a_folder_that_takes_nothing(folder, capsys, monkeypatch, name):
    """Neither the folder of the markers nor the lock."""
    assert main(["campaign", "c.toml", "--output", "a"]) == 0
    said(capsys)

    def fail(path, original, *arguments, **named):
        if path.name == name:
            raise PermissionError(13, "Permission denied")
        return original(path, *arguments, **named)

    for method in ("mkdir", "open"):
        original = getattr(Path, method)
        monkeypatch.setattr(Path, method, lambda path, *rest, to=original, **named: fail(path, to, *rest, **named))
    assert main(["campaign", "c.toml", "--output", "a", "--resume"]) == 2
    assert said(capsys) == ("", "rhl: a must take the results, got: Permission denied\n")


def test_a_folder_that_is_harmed(folder, capsys):
    """Damaged results are computed again; what no campaign writes is refused before anything is computed."""
    assert main(["campaign", "c.toml", "--output", "a"]) == 0
    out, _ = said(capsys)
    Path("a/results.zarr/peak/0.0").write_bytes(b"nonsense")
    assert main(["campaign", "c.toml", "--output", "a", "--resume"]) == 0
    assert said(capsys)[0] == out
    Path("a/results.zarr/.zgroup").unlink()
    assert main(["campaign", "c.toml", "--output", "a", "--resume"]) == 2
    assert said(capsys) == (
        "",
        "rhl: a must hold a campaign's results.zarr, got no .zgroup; copy the folder again, or start the campaign "
        "again in another one\n",
    )


@pytest.mark.parametrize("package", ["zarr", "xarray", "dask"])
def test_a_package_that_is_missing(folder, capsys, monkeypatch, package):
    original = builtins.__import__

    def without(name, *arguments, **named):
        if name.partition(".")[0] == package:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return original(name, *arguments, **named)

    monkeypatch.setattr(builtins, "__import__", without)
    assert main(["campaign", "c.toml", "--output", "a"]) == 2
    assert said(capsys)[1] == (
        f"rhl: this command needs the package {package}, got none installed; pip install 'rhl[study]'\n"
    )
    assert not Path("a").exists()


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        (
            "seed = 1",
            "",
            "seed must be an integer from 0 to 4294967295, from which plants and errors are drawn, got noth",
        ),
        (
            "seed = 1",
            "seed = -1",
            "seed must be an integer from 0 to 4294967295, from which plants and errors are drawn, got -1",
        ),
        ("steps = 20", "steps = 19", "steps must be an integer from 20 to 100000"),
        (
            "steps = 20",
            "step = 20",
            "step is not a known key; expected one of name, seed, steps, noise, input_bound, chunk, p",
        ),
        ("chunk = 4", "chunk = 0", "chunk must be an integer from 1 to 1000000"),
        ("chunk = 4", "noise = nan", "noise must be a number from 0 to 1e100"),
        ("chunk = 4", "noise = 1e308", "noise must be a number from 0 to 1e100"),
        ("chunk = 4", "input_bound = 0", "input_bound must be a positive number"),
        ('"random"', '"odd"', 'plants.kind must be "random", "random-continuous" or "benchmarks", got \'odd\''),
        ("count = 6", "", "plants.count must be an integer from 1 to 10000000"),
        (
            "n = [2, 3]",
            "n = [2, 0]",
            "plants.n must be an integer from 1 to 100, the order, or a list of such, got [2, 0]",
        ),
        ("n = [2, 3]", "n = []", "plants.n must have at least one size, got none"),
        ("n = [2, 3]", "hidden = 4", "plants.hidden must be below the least n, 4, got 4"),
        ("n = [2, 3]", "radius = [1]", "plants.radius must be a list of two numbers, got 1"),
        (
            "n = [2, 3]",
            "radius = [1, 0.5]",
            "plants.radius must be two numbers, positive and in ascending order, got [1.0, 0.5]",
        ),
        ("n = [2, 3]", "conditioning = 0.1", "plants.conditioning must be a number from 1 to 1e100, the larg"),
        ("n = [2, 3]", "conditioning = 1e308", "plants.conditioning must be a number from 1 to 1e100"),
        ("n = [2, 3]", "radius = [1e308, 1e308]", "plants.radius must be a list of two positive numbers of at most"),
        ("n = [2, 3]", "output_decades = 1e308", "plants.output_decades must be a number from 0 to 100"),
        ("n = [2, 3]", "input_decades = 1e308", "plants.input_decades must be a number from 0 to 100"),
        ('"window"', '"window"\nwindow = 1e300', "schemes[2].window must be a positive number of at most 100000"),
        ('"window"', '"window"\nwindow = 3e7', "schemes[2].window must be a positive number of at most 100000"),
        ('"window"', f'"window"\nlabel = "{"x" * 201}"', "schemes[2].label must be a string of at most 200 characters"),
        (
            "n = [2, 3]",
            "sampling = 1",
            "plants.sampling is not a known key; expected one of kind, count, n, p, q, radius",
        ),
        (
            "R = [1e-4, 1]",
            "R = [1e-4, 0]",
            "schemes[1].R must be a positive number, the weight of inputs, or a list of such, got",
        ),
        ("R = [1e-4, 1]", "R = []", "schemes[1].R must have at least one entry, got an empty list"),
        (
            "R = [1e-4, 1]",
            "order = 1",
            "schemes[1].order is not a known key; expected one of base, label, order_factor",
        ),
        ("R = [1e-4, 1]", "order_factor = 0", "schemes[1].order_factor must be a number from 1 to 100"),
        ("R = [1e-4, 1]", "R = [1, 1]", "schemes must have distinct labels, got 'default, R = 1' twice"),
        ('"window"', '"windows"', 'schemes[2].base must be "default" or "window"'),
        ('"window"', '"window"\ninputs = 1', 'schemes[2].inputs must be left out where base is "window", got 1.0'),
        (
            GOOD[GOOD.index("[[schemes]]") :],
            "",
            "schemes must be a list of at least one section [[schemes]], got nothing",
        ),
        (
            GOOD[GOOD.index("[[schemes]]") :],
            "[schemes]",
            "schemes must be a list of at least one section [[schemes]], got {}",
        ),
        ("seed = 1", "seed = 1\nschemes = 1\n#", "c.toml must be valid TOML, got: "),
        ("seed = 1", "seed = ", "c.toml must be valid TOML, got: "),
    ],
)
def test_files_that_are_refused(folder, capsys, old, new, sentence):
    assert old in GOOD
    Path("c.toml").write_text(GOOD.replace(old, new, 1), encoding="utf-8")
    assert main(["campaign", "c.toml", "--output", "a"]) == 2
    out, err = said(capsys)
    assert out == ""
    assert err.startswith(f"rhl: {sentence}")
    assert err.count("\n") == 1
    assert not Path("a").exists()


def test_an_empty_list_of_schemes():
    from rhl import InputError

    settings = {"name": "a", "seed": 1, "plants": {"kind": "benchmarks"}, "schemes": []}
    with pytest.raises(InputError, match=r"^schemes must be a list of at least one section \[\[schemes\]\], got \[\]"):
        parse(settings)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["c.toml"], "the following arguments are required: --output; see 'rhl campaign --help'"),
        (["no.toml", "--output", "a"], "no.toml must be a readable TOML file, got: No such file or directory"),
        (
            ["c.toml", "--output", "a", "--workers", "0"],
            "argument --workers: must be an integer from 1 to 1000, got '0'",
        ),
        (
            ["c.toml", "--output", "a", "--workers", "2", "--scheduler", "b"],
            "argument --scheduler: not allowed with argument",
        ),
        (
            ["c.toml", "--output", "a", "--scheduler", "b"],
            "--scheduler must be the address of a Dask scheduler that answers",
        ),
        (
            ["c.toml", "--output", "a", "--resume"],
            "--resume must find a campaign in a, got provenance.json: No such file",
        ),
        (["c.toml", "--output", "."], "--output must name a new folder, got ., which exists"),
        (
            ["c.toml", "--output", "no/a"],
            "--output must name a folder that can be created, got no/a: No such file or directory",
        ),
    ],
)
def test_calls_that_are_refused(folder, capsys, arguments, sentence):
    assert main(["campaign", *arguments]) == 2
    out, err = said(capsys)
    assert out == ""
    assert err.startswith(f"rhl: {sentence}")
    assert err.count("\n") == 1
    assert not Path("a").exists()


def test_every_key_is_in_the_help(capsys):
    assert main(["campaign", "--help"]) == 0
    out = " ".join(said(capsys)[0].split())
    for name, what in keys():
        assert f"{name}: " in out
        assert " ".join(what.split()) in out
    told = {name for name, _ in keys()}
    assert {f"schemes.{name}" for name in {**SchemeSection.keys()}} <= told
    assert {"plants.growth", "plants.radius", "plants.names", "noise"} <= told
    assert set(CampaignFile.keys()) - {"plants", "schemes"} <= told


SAMPLED = {"kind": "random-continuous", "count": 2}
BENCHMARKS = {"kind": "benchmarks", "names": ["ac1", "ac3"]}


@pytest.mark.parametrize(
    ("plants", "sentence"),
    [
        (SAMPLED | {"sampling": 1e300}, "plants.sampling must be a positive number of at most 1e9, the seconds"),
        (SAMPLED | {"sampling": [1, 1000]}, "plants.sampling must be at most 230 / the highest growth, got 1000 and"),
        (SAMPLED | {"growth": [0, 7000]}, "plants.sampling must be at most 230 / the highest growth, got 0.1 and"),
        (SAMPLED | {"growth": [-1e308, 1]}, "plants.growth must be a list of two numbers from -1e6 to 1e6"),
        (BENCHMARKS | {"sampling": 1e300}, "plants.sampling must be a positive number of at most 1e9, the seconds"),
        (BENCHMARKS | {"sampling": 1e3}, "plants.sampling must be short enough for ac3 to stay finite from sample to"),
    ],
)
def test_plants_that_leave_the_range_of_numbers(plants, sentence):
    from rhl import InputError

    settings = {"name": "a", "seed": 1, "schemes": [{"base": "default"}]}
    with pytest.raises(InputError) as caught:
        parse(settings | {"plants": plants}).campaign()
    assert str(caught.value).startswith(sentence)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("plants", "changes"),
    [
        (
            {"radius": [1e100, 1e100], "conditioning": 1e100, "output_decades": 100, "input_decades": 100},
            {"noise": 1e100},
        ),
        ({"kind": "random-continuous", "growth": [230, 230], "sampling": 1, "conditioning": 10}, {}),
        ({"kind": "random-continuous", "growth": [-1e6, -1e6], "sampling": 1e9}, {}),
        ({}, {"schemes": [{"base": "window", "label": "x" * 200, "window": 1000}]}),
    ],
)
def test_the_largest_numbers_run(plants, changes):
    settings = {"name": "a", "seed": 1, "steps": 20, "plants": {"kind": "random", "count": 3, "n": 3} | plants}
    campaign = parse(settings | {"schemes": [{"base": "default"}]} | changes).campaign()
    for task in campaign.tasks():
        assert len(next(iter(campaign.evaluate(task).values()))) == 3


def test_lists_make_a_scheme_each():
    file = parse(
        {
            "name": "a",
            "seed": 1,
            "plants": {"kind": "random-continuous", "count": 1, "sampling": [0.1, 1]},
            "schemes": [
                {"base": "default", "R": [1, 2], "units": False, "horizon": [5, 6]},
                {"base": "window", "label": "mine", "window": [1, 2]},
                {"base": "window", "label": "one"},
            ],
        }
    )
    labels = [one.label for one in file.campaign().schemes]
    assert labels[:2] == ["default, units = false, R = 1, horizon = 5", "default, units = false, R = 1, horizon = 6"]
    assert labels[4:] == ["mine, window = 1", "mine, window = 2", "one"]
    assert file.campaign().schemes[3].R == 2
    assert in_process().ahead == 1
