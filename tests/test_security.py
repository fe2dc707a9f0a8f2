"""Files from strangers run no code, write nowhere else and fill no memory; the sources use nothing that could."""

import ast
import json
import os
import pickle
import re
import subprocess
import sys
import tomllib
import tracemalloc
from dataclasses import replace
from datetime import time
from pathlib import Path

import numpy as np
import pytest

from rhl import InputError, window_scheme
from rhl.app import _limits, _status, cli
from rhl.app._campaign_keys import parse as parse_campaign
from rhl.app._keys import read_toml
from rhl.app.config import load, parse
from tests.app.test_bad_files import GOOD, OWN
from tests.app.test_config import LINEAR, ORDER

ROOT = Path(__file__).resolve().parent.parent
# What may be used where, and why.
ALLOWED = {
    ("rhl/app/_plants.py", "runpy"),  # a plant of the reader's own, after --allow-python
    ("rhl/app/_plants.py", "runpy.run_path"),
    ("rhl/app/cli.py", "__import__"),  # of names in the source, so that a missing package is noticed first
    ("rhl/app/_campaign.py", "__import__"),
    ("tools/epub.py", "yaml.load"),  # with BaseLoader, which makes strings only
    ("book/_ext/take_away.py", "yaml.load"),
}
MODULES = {"pickle", "cPickle", "marshal", "shelve", "dill", "cloudpickle", "joblib", "runpy", "imp", "code"}
CALLS = {"eval", "exec", "compile", "__import__", "os.system", "os.popen", "yaml.load", "yaml.unsafe_load"} | {
    *("importlib.import_module", "np.fromregex", "runpy.run_path", "runpy.run_module", "yaml.full_load"),
}


def name_of(node):
    """The dotted name that an expression is; empty for another one."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute):
        inner = name_of(node.value)
        return f"{inner}.{node.attr}" if inner else ""
    return ""


def dangers(text):
    """The names of what a source uses that could run the contents of a file."""
    found = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names if alias.name.split(".")[0] in MODULES]
        elif isinstance(node, ast.ImportFrom):
            found += [node.module] if (node.module or "").split(".")[0] in MODULES else []
        elif isinstance(node, ast.Call):
            name, given = name_of(node.func), {key.arg: key.value for key in node.keywords}
            if name in CALLS or (name.startswith("os.") and name.startswith(("os.exec", "os.spawn"))):
                found.append(name)
            shell = given.get("shell")
            if shell is not None and not (isinstance(shell, ast.Constant) and shell.value is False):
                found.append("shell")
            allowed = given.get("allow_pickle")
            refused = isinstance(allowed, ast.Constant) and allowed.value is False
            if name in ("np.load", "numpy.load") and not refused:
                found.append(name)
    return found


@pytest.mark.parametrize("folder", ["rhl", "tools", "book/_ext"])
def test_the_sources_use_nothing_that_runs_the_contents_of_a_file(folder):
    files = sorted((ROOT / folder).rglob("*.py"))
    assert len(files) >= 5
    used = {(path.relative_to(ROOT).as_posix(), name) for path in files for name in dangers(path.read_text("utf-8"))}
    assert used <= ALLOWED
    assert {one for one in ALLOWED if one[0].startswith(f"{folder}/")} <= used  # no exception that nothing needs


@pytest.mark.parametrize(
    "line",
    [
        *("import pickle", "from pickle import loads", "import joblib.numpy_pickle", "import runpy"),
        *("eval(text)", "exec(text)", "compile(text, '', 'exec')", "__import__(name)", "os.system(text)"),
        *("os.execv(a, b)", "subprocess.run(text, shell=True)", "subprocess.Popen(text, shell=asked)"),
        *("np.load(file)", "np.load(file, allow_pickle=True)", "yaml.load(text)", "importlib.import_module(name)"),
    ],
)
def test_what_could_run_a_file_is_seen(line):
    assert len(dangers(f"def use(text):\n    {line}\n")) == 1


@pytest.mark.parametrize(
    "line",
    ["np.load(file, allow_pickle=False)", "subprocess.run([text], shell=False)", "p.eval(x)", "re.compile(text)"],
)
def test_what_could_not_is_not(line):
    assert dangers(line) == []


def test_the_only_machine_code_that_is_loaded_is_numbas_own():
    """numba keeps machine code, pickled, next to the library or in the user's cache: nobody else's file is read."""
    uses = [path for path in (ROOT / "rhl").rglob("*.py") if "cache=True" in path.read_text("utf-8")]
    assert [path.relative_to(ROOT).as_posix() for path in uses] == ["rhl/kernels/_compile.py"]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with a configuration whose Python file leaves a mark when it is executed."""
    (tmp_path / "inside").mkdir()
    monkeypatch.chdir(tmp_path / "inside")
    return tmp_path


def written(where, program=GOOD):
    """Write the configuration and, at a path from its folder, the plant; return the mark that it would leave."""
    mark = Path("mark").absolute()
    Path("run.toml").write_text(OWN.replace('"p.py"', json.dumps(where)), encoding="utf-8")
    Path(where).write_text(f"open({str(mark)!r}, 'w').close()\n{program}", encoding="utf-8")
    return mark


@pytest.mark.parametrize(
    "call", [["run", "run.toml", "--output", "t.csv"], ["check", "run.toml"]], ids=["run", "check"]
)
@pytest.mark.parametrize("where", ["p.py", "../p.py", "absolute"])
def test_a_python_plant_runs_only_if_it_is_allowed(folder, capsys, call, where):
    where = str(folder / "p.py") if where == "absolute" else where
    mark = written(where)
    assert cli.main(call) == _status.BAD_INPUT
    said = capsys.readouterr()
    assert re.fullmatch(
        r'rhl: plant\.kind must not be "python" unless --allow-python is given, got .*p\.py, which would be executed; '
        r"read that file, then add --allow-python\n",
        said.err,
    )
    assert (said.out, mark.exists(), Path("t.csv").exists()) == ("", False, False)
    assert cli.main([*call, "--allow-python"]) in (_status.OK, _status.MISSED)
    assert mark.exists()


def test_a_python_plant_that_is_not_allowed_is_not_even_opened(folder, monkeypatch):
    """A pipe that nobody writes would keep whoever opens it waiting for ever."""
    written("p.py")
    Path("p.py").unlink()
    os.mkfifo("p.py")
    code = "import sys; from rhl.app.cli import main; sys.exit(main())"
    done = subprocess.run(
        [sys.executable, "-c", code, "check", "run.toml"], timeout=60, capture_output=True, check=False
    )
    assert done.returncode == _status.BAD_INPUT
    with pytest.raises(subprocess.TimeoutExpired):
        subprocess.run([sys.executable, "-c", code, "check", "run.toml", "--allow-python"], timeout=5, check=False)


def test_the_library_asks_for_the_same_leave(folder):
    mark = written("p.py")
    config = load("run.toml")
    with pytest.raises(InputError, match="unless --allow-python is given"):
        config.experiment()
    assert not mark.exists()
    assert config.experiment(allow_python=True).plant.n == 2


def test_a_campaign_and_a_comparison_know_no_python(folder, capsys):
    mark = written("p.py")
    campaign = 'name = "c"\nseed = 1\n[plants]\nkind = "python"\nfile = "p.py"\n[[schemes]]\nbase = "default"\n'
    Path("c.toml").write_text(campaign, encoding="utf-8")
    assert cli.main(["campaign", "c.toml", "--output", "many"]) == _status.BAD_INPUT
    assert cli.main(["compare", "p.py"]) == _status.BAD_INPUT
    assert not mark.exists()
    for flag in (["campaign", "c.toml", "--output", "many"], ["compare", "toy"]):
        assert cli.main([*flag, "--allow-python"]) == _status.BAD_INPUT
        assert "unrecognized arguments: --allow-python" in capsys.readouterr().err


def huge(**changes):
    """The file that needs no more than an order, with changes of its keys and sections."""
    import tomllib

    data = tomllib.loads(ORDER)
    for name, value in changes.items():
        data[name] = data.get(name, {}) | value if isinstance(value, dict) else value
    return data


SEARCH = {"mixing": "search", "window": 10, "A0": "companion-of-ones", "B0": "eye-last-row-of-ones"} | {
    "least_margin": 1e-300
}
ROWS = [
    ({"steps": 100_000, "order": 50}, "steps must be such that the estimates of all steps are at most 250000000 num"),
    ({"lifting": {"outputs": 100, "inputs": 100}, "steps": 20_000}, "steps must be such that the estimates of all"),
    (
        {"controller": {"horizon": 10_000}, "simulation": {"v_min": -1, "v_max": 1}, "steps": 1, "order": 4}
        | {"set_point": 1.0, "estimator": {"window": 10_000}},
        None,
    ),
    (
        {"controller": {"horizon": 10_000}, "simulation": {"v_min": [-1, -1], "v_max": [1, 1]}}
        | {"plant": {"kind": "ready", "name": "quadruple-tank"}},
        "controller.horizon must be such that the bounded programme of a plan",
    ),
    (
        {"estimator": SEARCH, "order": 80, "steps": 1},
        "estimator.mixing must be such that the candidates of the search",
    ),
]


@pytest.mark.parametrize(("changes", "sentence"), ROWS)
def test_runs_that_would_fill_the_memory(changes, sentence):
    data = huge(**changes)
    if changes.get("plant"):
        data["plant"] = changes["plant"]
    if sentence is None:
        parse(data).experiment()  # the control: the largest numbers of the keys, where they fit together
        return
    with pytest.raises(InputError, match=sentence):
        parse(data).experiment()


def test_stacks_that_would_fill_the_memory():
    F = np.eye(20).tolist()
    plant = {"kind": "linear", "F": F, "G": F, "H": F, "z0": [1.0] * 20}
    for order, refused in ((60, True), (50, False)):
        data = huge(order=order, steps=2) | {"plant": plant}
        if refused:
            with pytest.raises(
                InputError, match=r"order or \[lifting\] must stack at most 1000 numbers, got 60 outputs"
            ):
                parse(data).experiment()
        else:
            assert parse(data).experiment().scheme.initial_model.n == 1000


def test_transfer_functions_that_would_fill_the_memory():
    def plant(count):
        return {"kind": "transfer-function", "num": [1.0], "den": [1.0] * count, "z0": [0.0] * (count - 1)}

    with pytest.raises(
        InputError, match=r"plant\.den must have at most 1000 coefficients in all channels together, got"
    ):
        parse(huge() | {"plant": plant(100_000)}).experiment()
    assert parse(huge(order=20) | {"plant": plant(21)}).experiment().plant.n == 20


@pytest.mark.parametrize("term", ["y1^" + "9" * 12, "*".join(["y1"] * 100_000), "sin(" * 10_000, "y" + "1" * 10_000])
def test_terms_of_any_length_are_refused(term):
    with pytest.raises(InputError, match=r"must be a (product|string such as 'y1\*y2' of at most 200 characters)"):
        parse(huge(lifting={"terms": [term]})).experiment()
    assert parse(huge(lifting={"terms": ["y1^3"]})).experiment().scheme.initial_model.n == 3


CAMPAIGN = {
    "name": "c",
    "seed": 1,
    "steps": 20,
    "plants": {"kind": "random", "count": 6, "n": [2, 3]},
    "schemes": [{"base": "default", "R": [1e-4, 1.0]}],
}


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"plants": {"count": 10_000_000}}, r"plants\.count must be such that there are at most 20000000 results, got"),
        ({"plants": {"count": 500_000}, "chunk": 1}, "at most 100000 tasks, got 3000000; enlarge chunk"),
        ({"plants": {"count": 500_000}, "chunk": 1_000_000, "steps": 1000}, "chunk must be such that a task holds at"),
        (
            {"plants": {"n": 100, "p": 100}, "schemes": [{"base": "default", "order_factor": 50.0}]},
            "schemes must stack",
        ),
        (
            {"schemes": [{"base": "window", "window": 100_000.0}], "plants": {"count": 250}},
            r"^schemes\.window must be such that a task holds at most 250000000 numbers, got 200000 transitions for",
        ),
        (
            {"schemes": [{"base": "default", "horizon": 10_000}], "plants": {"count": 250, "n": 100, "p": 10, "q": 10}},
            r"^schemes\.horizon must be such that a task holds at most 250000000 numbers, got 10000 steps for each of",
        ),
        (
            {"schemes": [{"base": "default", "R": [1.0] * 40, "weight": [1.0] * 40}]},
            "schemes must be at most 1000, got",
        ),
    ],
)
def test_campaigns_that_would_fill_memory_or_disk(changes, sentence):
    assert len(parse_campaign(CAMPAIGN).campaign().plants) == 12
    data = CAMPAIGN | {
        name: CAMPAIGN[name] | value if isinstance(value, dict) else value for name, value in changes.items()
    }
    with pytest.raises(InputError, match=sentence):
        parse_campaign(data).campaign()


@pytest.fixture
def store(tmp_path):
    """The folder of a small campaign, complete."""
    pytest.importorskip("zarr")
    from rhl.study.backends import in_process
    from rhl.study.campaign import run
    from rhl.study.store import Store

    campaign = parse_campaign(CAMPAIGN).campaign()
    made = Store.create(tmp_path / "many", campaign, "", CAMPAIGN)
    run(campaign, made, in_process())
    return made


class Marks:
    """Leaves a mark when it is unpickled."""

    def __init__(self, mark):
        self.mark = mark

    def __reduce__(self):
        return (Path.touch, (self.mark,))


def changed(path, change):
    about = json.loads(path.read_text("utf-8"))
    change(about)
    path.write_text(json.dumps(about), encoding="utf-8")


def both(store):
    """Open a store in each way in which the library does."""
    from rhl.study.store import Store, load

    return (lambda: load(store.path), lambda: Store.resume(store.path, store.campaign, CAMPAIGN))


def refused(store, sentence):
    for way in both(store):
        with pytest.raises(InputError, match=sentence):
            way()


def test_an_unchanged_store_opens(store):
    for way in both(store):
        way()


@pytest.mark.parametrize("place", [".zarray", ".zmetadata"])
@pytest.mark.parametrize(
    ("key", "value", "sentence"),
    [
        ("filters", [{"id": "pickle", "protocol": 5}], "peak with filters [{'id': 'pickle', 'protocol': 5}];"),
        ("compressor", {"id": "pickle"}, "peak with compressor {'id': 'pickle'};"),
        ("compressor", "pickle", "peak with compressor 'pickle';"),
        ("dtype", "|O", "peak of type '|O';"),
        ("dtype", [["a", "<f8"]], "peak of type [['a', '<f8']];"),
        ("shape", [10**6, 10**6], "peak in "),
        ("chunks", [10**6, 10**6], "peak with chunks [1000000, 1000000] for shape [2, 12];"),
    ],
)
def test_a_store_of_objects_or_of_any_size_is_refused(store, tmp_path, place, key, value, sentence):
    data, mark = store.path / "results.zarr", tmp_path / "mark"
    (data / "peak" / "0.0").write_bytes(pickle.dumps([Marks(mark)]))
    if place == ".zarray":
        changed(data / "peak" / ".zarray", lambda about: about.update({key: value}))
    else:
        changed(data / ".zmetadata", lambda about: about["metadata"]["peak/.zarray"].update({key: value}))
    found = sentence if place == ".zmetadata" else "peak/.zarray that differs from .zmetadata;"
    refused(store, re.escape(f"must hold a campaign's results.zarr, got {found}"))
    assert not mark.exists()
    pickle.loads((data / "peak" / "0.0").read_bytes())
    assert mark.exists()  # the control: the chunk does run code where it is unpickled


@pytest.mark.parametrize("name", ["done/0-0", "results.zarr/peak/0.0", "lock", "provenance.json"])
def test_a_store_with_links_is_refused(store, tmp_path, name):
    victim, link = tmp_path / "victim", store.path / name
    content = link.read_bytes() if link.exists() else b""
    victim.write_bytes(content)
    link.unlink(missing_ok=True)
    link.symlink_to(victim)
    refused(store, "must be a campaign's folder of plain files without links, got ")
    assert victim.read_bytes() == content


def test_a_store_of_another_format_is_refused(store):
    (store.path / "results.zarr" / "peak" / "zarr.json").write_text("{}", encoding="utf-8")
    refused(store, r"must hold a campaign's results\.zarr, got zarr\.json;")


@pytest.mark.parametrize("text", ["[]", "{}", '{"settings": 1}', "[" * 100_000, "nonsense"])
def test_a_record_that_no_campaign_writes_is_refused(store, text):
    from rhl.study.store import Store

    (store.path / "provenance.json").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"must find a campaign in .* got provenance\.json: invalid JSON"):
        Store.resume(store.path, store.campaign, CAMPAIGN)


@pytest.mark.parametrize("text", ["[]", "{}", "nonsense", '{"metadata": 3}', "[" * 100_000])
def test_metadata_that_no_campaign_writes_are_refused(store, text):
    (store.path / "results.zarr" / ".zmetadata").write_text(text, encoding="utf-8")
    refused(store, r"must hold a campaign's results\.zarr, got \.zmetadata that no campaign writes;")


def is_loopback(line):
    """Whether the server's first line names an address of this machine alone."""
    return re.match(r"Serving HTTP on (127\.\d+\.\d+\.\d+|::1) ", line) is not None


def first_line(arguments, tmp_path):
    process = subprocess.Popen(
        [sys.executable, "-u", *arguments], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=tmp_path
    )
    try:
        return process.stdout.readline()
    finally:
        process.kill()
        process.communicate()


def test_make_serve_serves_this_machine_alone(tmp_path):
    (recipe,) = re.findall(r"^\tpython (-m http\.server .*)$", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE)
    arguments = recipe.replace("$(PORT)", "0").replace("build/_build/html", ".").split()
    assert is_loopback(first_line(arguments, tmp_path))


def test_a_server_for_every_machine_is_told_from_it():
    assert not is_loopback("Serving HTTP on 0.0.0.0 port 8000 (http://0.0.0.0:8000/) ...\n")
    assert not is_loopback("Serving HTTP on :: port 8000 (http://[::]:8000/) ...\n")


def test_the_largest_file_is_not_read_whole(tmp_path):
    path = tmp_path / "run.toml"
    with path.open("wb") as file:
        file.truncate(10**12)  # a hole: a terabyte that takes no room on the disk
    with pytest.raises(InputError, match="must be a TOML file of at most 5000000 bytes, got more"):
        load(path)
    path.write_text(LINEAR, encoding="utf-8")
    assert load(path).steps == 42


def dotted(part="a", dot=".", count=3000):
    return dot.join([part] * count)


def parsing(path, text):
    """The tables of a file, or the sentence that refuses it, and the most memory that this took."""
    path.write_text(text, encoding="utf-8", newline="")
    tracemalloc.start()
    try:
        found = read_toml(path)[1]
    except InputError as error:
        found = str(error)
    finally:
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    return found, most


@pytest.mark.parametrize(
    "text",
    [
        f"{dotted()} = 1",
        f"[{dotted()}]",
        f"[[{dotted()}]]",
        f"x = [{{y = 1, {dotted()} = 1}}]",
        dotted(part='"a."') + " = 1",
        dotted(part="'a#'") + " = 1",
        dotted(dot=" .\t") + " = 1",
        f'x = \'"\' # """\r\n{dotted()} = 1',
        f"x = ''\n{dotted()} = 1",
        f'x = {{y = "\\"\'\\\\", {dotted()} = 1}}',
        f'x = {{y = """ \\""" \n \'\'\' """"", {dotted()} = 1}}',
        f"x = {{y = '''\\'''', {dotted()} = 1}}",
        f"{dotted(count=9)} = 1",
    ],
)
def test_a_key_of_many_parts_is_not_parsed(tmp_path, text):
    """The parser keeps every beginning of a key: 3000 parts would take 36 MB."""
    said, most = parsing(tmp_path / "run.toml", text)
    assert re.search(r"run\.toml must have keys of at most 8 parts, got more in line [12]: ", said)
    assert most < 6_000_000
    tomllib.loads(text)  # the control: the file is TOML


@pytest.mark.parametrize(
    ("text", "value"),
    [
        (f'x = "{dotted()}"', dotted()),
        (f"x = '{dotted()}'", dotted()),
        (f'x = """\n{dotted()}\\\\"""" ', dotted() + '\\"'),
        (f"x = '''{dotted()}''''", dotted() + "'"),
        (f'x = "it\'s {dotted()}" # {dotted()}', f"it's {dotted()}"),
        (f"x = 1 # it's {dotted()}\n", 1),
        ("x = [1.5, 2.5, 3.5, 4.5, 5.5, 6.5, 7.5, 8.5, 9.5]", [i + 0.5 for i in range(1, 10)]),
        ("x = 07:32:00.999", time(7, 32, 0, 999000)),
        (f"x.'{dotted()}'.c.d.e.f.g.h = 1.5", {dotted(): {"c": {"d": {"e": {"f": {"g": {"h": 1.5}}}}}}}),
    ],
)
def test_strings_and_numbers_with_dots_are_accepted(tmp_path, text, value):
    assert parsing(tmp_path / "run.toml", text)[0] == {"x": value}


def test_many_headers_are_not_parsed(tmp_path):
    """A header of eight parts takes eight kilobytes: a file of five megabytes would take two gigabytes."""
    path = tmp_path / "run.toml"
    said, most = parsing(path, "".join(f" [a{i}.a]\n" for i in range(10_001)))
    assert said.endswith(
        "must have at most 10000 lines that begin with a bracket, got 10001; leave out sections, or give a matrix in "
        "fewer lines"
    )
    assert most < 6_000_000
    found, most = parsing(path, "".join(f"[a{i}.a]\n" for i in range(10_000)))
    assert len(found) == 10_000
    assert most > 6_000_000


@pytest.mark.parametrize("text", ['"\\"', "'\"", '"""\\"', "a.\n", "a .\n", "a ", "\\", "0.5,"])
def test_a_file_is_searched_without_going_back(tmp_path, text):
    """In a time that grows with the text; one that grows with its square would be hours."""
    path = tmp_path / "run.toml"
    path.write_text(1_000_000 // len(text) * text, encoding="utf-8")
    with pytest.raises(InputError, match="must be valid TOML"):
        read_toml(path)


def test_a_plant_whose_states_would_fill_the_memory():
    """Of 1500 states and 100 000 steps the table alone took 11 GB."""
    data = tomllib.loads(ORDER)
    n = 1500
    data["plant"] |= {"F": np.eye(n).tolist(), "G": [[1.0]] * n, "H": [[1.0] * n], "z0": [1.0] * n}
    for steps, fits in ((16_600, True), (16_601, False), (100_000, False)):
        data["steps"] = steps
        if fits:
            assert parse(data).experiment().steps == steps
            continue
        with pytest.raises(InputError) as caught:
            parse(data).experiment()
        assert str(caught.value) == (
            "steps must be such that the entries of the table, each with its text as ten numbers, are at most "
            f"250000000 numbers, got {steps} and {15060 * steps} numbers; make it smaller, or stack less"
        )


def test_a_window_that_would_fill_the_memory():
    scheme = window_scheme(1, 1, 2)
    _limits.fits(scheme, 10, 2)
    with pytest.raises(InputError, match=r"^estimator\.window must be such that the transitions of the window"):
        _limits.fits(replace(scheme, estimator=replace(scheme.estimator, window=10**9)), 10, 2)
