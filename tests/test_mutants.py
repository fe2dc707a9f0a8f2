"""Mutants: each changes one result, a sample keeps its members, and what notices a change is told apart."""

import ast
import json
from pathlib import Path
from types import SimpleNamespace

import pytest

from tools import mutants
from tools.mutations import Mutant, asserted, mutants_of, sample

ROOT = Path(__file__).resolve().parent.parent
SOURCE = '''\
"""A docstring with 1 < 2."""

from __future__ import annotations

LIMIT = 3


def clipped(value: float, size: int = 2) -> float:
    """Return a value below a limit, 1 < 2."""
    if not value > LIMIT:
        raise ValueError(f"at least {LIMIT + 1}")
    return min(value, size) - 1.5
'''


def changed(text):
    return {(mutant.before, mutant.after) for mutant in mutants_of("rhl/a.py", text)}


def test_every_kind_of_place_is_changed():
    assert changed(SOURCE) == {
        ("LIMIT = 3", "LIMIT = 4"),
        (
            "def clipped(value: float, size: int = 2) -> float:",
            "def clipped(value: float, size: int = 3) -> float:",
        ),
        ("if not value > LIMIT:", "if (value > LIMIT):"),
        ("if not value > LIMIT:", "if not (value >= LIMIT):"),
        ("if not value > LIMIT:", "if not (value < LIMIT):"),
        ('raise ValueError(f"at least {LIMIT + 1}")', "pass"),
        ("return min(value, size) - 1.5", "return (min(value, size) + 1.5)"),
        ("return min(value, size) - 1.5", "return (max(value, size)) - 1.5"),
        ("return min(value, size) - 1.5", "return min(value, size) - 3.0"),
    }


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("def f(n):\n    n += 1\n", "pass"),
        ("def f(n):\n    g(n)\n", "pass"),
        ("a = x if b is None else y\n", "a = x if (b is not None) else y"),
        ("a = b or c\n", "a = (b and c)"),
        ("a = abs(b)\n", "a = b"),
        ("if f(x):\n    a = b\n", "if (not f(x)):"),
        ("a = True\n", "a = False"),
    ],
)
def test_other_places(before, after):
    assert after in {pair[1] for pair in changed(before)}


def test_a_mutant_is_a_program_that_differs():
    for path in (ROOT / "rhl/horizon.py", ROOT / "rhl/kernels/loops.py", ROOT / "rhl/paper/claims/lemma_5.py"):
        text = path.read_text(encoding="utf-8")
        found = list(mutants_of("rhl/x.py", text))
        assert len(found) > 40
        for mutant in found[::7]:
            assert ast.dump(ast.parse(mutant.content)) != ast.dump(ast.parse(text))


def test_the_sample_keeps_its_members(tmp_path):
    """It depends on the changes, not on lines or files; another seed gives another sample."""
    (tmp_path / "rhl").mkdir()
    body = (ROOT / "rhl/horizon.py").read_text(encoding="utf-8")
    (tmp_path / "rhl/a.py").write_text(body, encoding="utf-8")
    first = {mutant.id for mutant in sample(tmp_path, 24, 0)}
    (tmp_path / "rhl/a.py").rename(tmp_path / "rhl/b.py")
    (tmp_path / "rhl/b.py").write_text("# a line more\n" + body, encoding="utf-8")
    assert {mutant.id for mutant in sample(tmp_path, 24, 0)} == first
    assert {mutant.id for mutant in sample(tmp_path, 24, 1)} != first


def test_every_room_has_its_share():
    rooms = [mutant.room for mutant in sample(ROOT, 300, 0)]
    assert {"rhl", "rhl.kernels", "rhl.losses", "rhl.plants", "rhl.app", "rhl.study", "rhl.paper"} < set(rooms)
    assert len(rooms) >= 300
    assert min(rooms.count(room) for room in rooms) >= 24


def test_of_a_notebook_what_it_states_is_changed():
    cell = {"cell_type": "code", "metadata": {}, "source": "a = f()\nassert a < 1e-9\nassert len(b) == 3"}
    found = list(asserted("notebooks/x.ipynb", json.dumps({"cells": [cell]})))
    assert {(mutant.before, mutant.after) for mutant in found} == {
        ("assert a < 1e-9", "assert (a > 1e-09)"),
        ("assert len(b) == 3", "assert (len(b) != 3)"),
        ("assert len(b) == 3", "assert (len(b) == 4)"),
    }
    assert json.loads(found[0].content)["cells"][0]["source"] != cell["source"]


@pytest.fixture
def project(tmp_path):
    """A small tree whose tests execute one line and check another."""
    (tmp_path / "tree/rhl").mkdir(parents=True)
    (tmp_path / "tree/tests").mkdir()
    (tmp_path / "tree/pytest.ini").write_text("[pytest]\n", encoding="utf-8")
    source = "def twice(x):\n    unused = 1 + 1\n    return 2 * x\n"
    (tmp_path / "tree/rhl/small.py").write_text(source, encoding="utf-8")
    test = (
        "import importlib.util\n\n\ndef test_twice():\n"
        "    spec = importlib.util.spec_from_file_location('small', 'rhl/small.py')\n"
        "    small = importlib.util.module_from_spec(spec)\n"
        "    spec.loader.exec_module(small)\n"
        "    assert small.twice(2) == 4\n"
    )
    (tmp_path / "tree/tests/test_small.py").write_text(test, encoding="utf-8")
    return tmp_path / "tree", source


def test_a_noticed_mutant_is_told_from_one_that_survives(project):
    tree, source = project
    found = {mutant.after: mutant for mutant in mutants_of("rhl/small.py", source)}
    for after, verdict in (
        ("return (2 / x)", "noticed"),
        ("unused = (1 - 1)", "survived"),
        ("return 3 * x", "noticed"),
    ):
        row = mutants.judged(tree, found[after], mutants._run_tests, ["tests/test_small.py::test_twice"], 60)
        assert row["verdict"] == verdict
        assert row["by"] == ("tests/test_small.py::test_twice" if verdict == "noticed" else "")
        assert (tree / "rhl/small.py").read_text(encoding="utf-8") == source


def test_a_mutant_that_never_ends_is_stopped(project):
    tree, source = project
    endless = Mutant("rhl/small.py", "", 1, "", "", f"while True:\n    pass\n{source}")
    assert mutants.judged(tree, endless, mutants._run_tests, ["tests/test_small.py"], 3)["verdict"] == "too long"


def test_the_table_counts():
    rows = [
        {"room": "rhl", "verdict": verdict} for verdict in ("noticed", "too long", "survived", "equivalent", "noticed")
    ]
    assert mutants.table(rows).splitlines()[-1].split() == ["all", "5", "3", "1", "1", "75.0%"]


def test_tests_come_from_likely_to_unlikely():
    """Those that execute the line, those that execute the module or stand in its file, those of its folder."""
    tests = {
        "tests/app/test_a.py::slow": {"seconds": 2.0, "lines": {"rhl/app/a.py": [3]}},
        "tests/app/test_b.py::fast": {"seconds": 0.1, "lines": {"rhl/app/a.py": [3]}},
        "tests/app/test_b.py::other_line": {"seconds": 0.1, "lines": {"rhl/app/a.py": [4]}},
        "tests/app/test_a.py::in_another_process": {"seconds": 0.5, "lines": {}},
        "tests/test_sources.py::reads_the_text": {"seconds": 0.6, "lines": {}},
        "tests/app/test_c.py::uses_what_another_imported": {"seconds": 0.1, "lines": {"rhl/b.py": [1]}},
        "notebooks/01-a.ipynb": {"seconds": 0.1, "lines": {"rhl/app/a.py": [3]}},
        "notebooks/02-b.ipynb": {"seconds": 0.2, "lines": {"rhl/app/a.py": [3]}},
    }
    unlikely = {
        "tests/study/test_d.py::elsewhere": {"seconds": 0.1, "lines": {"rhl/b.py": [1]}},
        "tests/test_d.py::in_another_process": {"seconds": 0.1, "lines": {}},
    }
    mutant = Mutant("rhl/app/a.py", "f", 3, "", "", "")
    found = mutants.tests_of(mutant, unlikely | tests, "")
    assert found == list(tests)[:-1]
    assert mutants.tests_of(mutant, tests, "tests/test_sources.py::reads_the_text")[0] == found[4]
    long = {f"tests/app/test_e.py::{i}": {"seconds": 40.0, "lines": {"rhl/app/a.py": [3]}} for i in range(4)}
    assert len([test for test in mutants.tests_of(mutant, long, "") if test in long]) == 2
    compiled = Mutant("rhl/kernels/loops.py", "f", 3, "", "", "")
    caller = {"tests/test_e.py::calls": {"seconds": 1.0, "lines": {"rhl/_engine.py": [9]}}}
    assert mutants.tests_of(compiled, unlikely | caller, "") == list(caller)


def test_listed_mutants_are_still_places_of_the_library():
    places = set()
    for path in sorted((ROOT / "rhl").rglob("*.py")):
        file = path.relative_to(ROOT).as_posix()
        for mutant in mutants_of(file, path.read_text(encoding="utf-8")):
            places.add((mutant.function, mutant.before, mutant.after))
    listed = mutants.known_equivalent()
    assert set(listed) <= places
    assert all(len(reason.split()) > 3 for reason in listed.values())


@pytest.mark.parametrize(
    ("given", "says"),
    [
        (["tests", "--size", "0"], "--size must be an integer of at least 1, got 0"),
        (["tests", "--at-least", "nan"], "--at-least must be a number from 0 to 1, got nan"),
        (["verify", "--root", "nowhere"], "--root must be a checkout of the project, got nowhere without rhl/"),
        (["verify", "--before", "nothing"], "--before must be results of an earlier run, found no file nothing"),
        (["verify", "--room", "rhl/nosuch.py"], "--room must be a file or folder of rhl/ with members of the sample"),
    ],
)
def test_what_would_judge_nothing_is_refused(tmp_path, monkeypatch, capsys, given, says):
    monkeypatch.setattr("sys.argv", ["mutants", *given, "--output", str(tmp_path / "out")])
    with pytest.raises(SystemExit) as left:
        mutants.main()
    assert left.value.code == 2
    assert says in capsys.readouterr().err


def test_a_result_that_was_cut_off_is_left_out(tmp_path):
    record = tmp_path / "tests.jsonl"
    assert mutants.kept(record) == []
    record.write_text('\n{"id": "a"}\n{"id": "b", "ver\n{"id": "c"}', encoding="utf-8")
    assert mutants.kept(record) == [{"id": "a"}, {"id": "c"}]


def test_lines_that_were_not_measured_to_the_end_are_measured_again(tmp_path, monkeypatch):
    """So are those of a run that was killed, which leave a file of one process."""
    folder, ran = tmp_path / "covered", []
    folder.mkdir()
    (folder / "1.json").write_text('{"stale": {}}', encoding="utf-8")

    def measured(command, **named):
        ran.append(command)
        folder.mkdir()
        (folder / "2.json").write_text('{"new": {}}', encoding="utf-8")
        return SimpleNamespace(returncode=1)

    monkeypatch.setattr(mutants.subprocess, "run", measured)
    assert [mutants.covered(tmp_path, folder) for _ in range(2)] == [{"new": {}}] * 2
    assert len(ran) == 1
