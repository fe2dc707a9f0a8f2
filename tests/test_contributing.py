"""The worked examples of CONTRIBUTING.md: each is applied to a copy of the tree, and its commands do what it says."""

import re
import shlex
import shutil
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
MOST_LINES = 25
# The first lines of an edit, as the text words them.
EDIT = re.compile(
    r"^In (?P<new>the new file )?`(?P<path>[^`]+)`(?:, (?P<where>above|below|instead of) `(?P<anchor>[^`]+)`)?:\n\n"
    r"```\w+\n(?P<code>.*?)^```\n",
    re.DOTALL | re.MULTILINE,
)
CONSOLE = re.compile(r"^```console\n(?P<lines>.*?)^```\n", re.DOTALL | re.MULTILINE)
# What the options of pyproject.toml add, doctests of modules and the report of skipped tests, is not needed here.
PYTEST = ("-m", "pytest", "-p", "no:cacheprovider", "--override-ini=addopts=", "--import-mode=importlib", "--nbmake")
PROGRAMS = {"rhl": ("-m", "rhl"), "pytest": PYTEST, "ruff": ("-m", "ruff"), "mypy": ("-m", "mypy")}


@dataclass(frozen=True)
class Edit:
    path: str
    where: str | None
    anchor: str | None
    code: str


@dataclass(frozen=True)
class Example:
    """A worked example: edits, and commands with what each must print."""

    edits: tuple[Edit, ...]
    commands: tuple[tuple[str, tuple[str, ...]], ...]


def example_of(section):
    edits = tuple(
        Edit(found["path"], "new" if found["new"] else found["where"], found["anchor"], found["code"])
        for found in EDIT.finditer(section)
    )
    commands = []
    for block in CONSOLE.finditer(section):
        for line in block["lines"].splitlines():
            if line.startswith("$ "):
                commands.append((line[2:], []))
            else:
                commands[-1][1].append(line)
    return Example(edits, tuple((command, tuple(prints)) for command, prints in commands))


SECTIONS = dict(re.findall(r"^### An? (\w+)\n(.*?)(?=^##|\Z)", TEXT.partition("## Worked examples")[2], re.S | re.M))
EXAMPLES = {name: example_of(section) for name, section in SECTIONS.items()}


def edited(text, edit):
    """The text of a file after an edit."""
    if edit.where == "new":
        assert text is None, f"{edit.path} is there already"
        return edit.code
    lines = [line for line in text.splitlines(keepends=True) if edit.anchor in line]
    assert len(lines) == 1, f"{edit.anchor} must be on one line of {edit.path}, got {len(lines)}"
    (line,) = lines
    if edit.where == "instead of":
        return text.replace(line, line.replace(edit.anchor, edit.code.rstrip("\n")))
    # Two blank lines separate functions and classes.
    return text.replace(line, f"{edit.code}\n\n{line}" if edit.where == "above" else f"{line}{edit.code}")


def apply(example, tree):
    for edit in example.edits:
        path = tree / edit.path
        found = path.read_text(encoding="utf-8") if path.exists() else None
        path.write_text(edited(found, edit), encoding="utf-8")


def run(command, tree):
    """What a command says in this tree, with its exit status on the last line."""
    name, *arguments = shlex.split(command)
    done = subprocess.run(
        [sys.executable, *PROGRAMS[name], *arguments],
        cwd=tree,
        env={"PYTHONPATH": str(tree), "PATH": str(Path(sys.executable).parent), "COLUMNS": "250", "HOME": str(tree)},
        capture_output=True,
        text=True,
        check=False,
    )
    return f"{done.stdout}{done.stderr}\nexit status {done.returncode}"


def missing(example, tree):
    """The commands of an example that fail or do not print what it says, each with what it said."""
    found = []
    for command, prints in example.commands:
        said = run(command, tree)
        if not said.endswith("exit status 0") or any(line not in said for line in prints):
            found.append(f"{command}\n{said}")
    return found


def copy_of_tree(folder):
    # With its dates and its compiled code, which is then not compiled again.
    return Path(shutil.copytree(ROOT, folder, ignore=shutil.ignore_patterns(".*", "build"), dirs_exist_ok=True))


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    """A copy of the tree with all examples, which do not get into each other's way."""
    folder = copy_of_tree(tmp_path_factory.mktemp("contributing") / "rhl")
    for example in EXAMPLES.values():
        apply(example, folder)
    return folder


def test_every_example_is_read():
    assert list(EXAMPLES) == ["claim", "plant", "loss", "notebook", "rival"]
    for name, section in SECTIONS.items():
        fenced = re.findall(r"^```(?!console|\n)", section, re.M)
        assert len(EXAMPLES[name].edits) == len(fenced), f"an edit of {name} is worded in another way"
        assert all(prints for _, prints in EXAMPLES[name].commands)


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_is_short(name):
    assert sum(len(edit.code.splitlines()) for edit in EXAMPLES[name].edits) < MOST_LINES


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_works(tree, name):
    assert missing(EXAMPLES[name], tree) == []


def test_examples_are_in_the_style_of_the_tree(tree):
    for command in ("ruff check --no-cache", "ruff format --check --no-cache"):
        said = run(command, tree)
        assert said.endswith("exit status 0"), said


@pytest.mark.nightly
def test_examples_keep_the_rules_of_the_tree(tree):
    rules = [f"tests/test_{name}.py" for name in ("imports", "sources", "public_names", "prose", "book", "losses")]
    rules += ["tests/paper/claims/test_ledger.py", "tests/plants/test_examples.py"]
    rules += ["tests/study/test_compare.py", "tests/study/test_record.py"]
    for command in ("mypy", f"pytest {' '.join(rules)}", "pytest --doctest-modules rhl/study/rivals.py rhl/losses"):
        said = run(command, tree)
        assert said.endswith("exit status 0"), said


@pytest.mark.parametrize(
    ("name", "right", "wrong", "command", "says"),
    [
        pytest.param(
            *("claim", 'recorded="holds"', 'recorded="refuted"'),
            *("rhl verify", "claim lemma-1.a.rest must give a reason"),
            marks=pytest.mark.nightly,
        ),
        ("claim", "end=1.0", "end=0.0", "rhl verify", "1 not as recorded"),
        ("plant", "[[0.2], [0.0]]", "[[0.2]]", "rhl run", "plant.G must have shape (2, at least 1), got (1, 1)"),
        pytest.param(
            *("loss", "4 * x**3", "3 * x**3", "pytest tests/test_losses.py", "1 failed, 4 passed"),
            marks=pytest.mark.nightly,
        ),
        ("notebook", "< 1e-6", "> 1e-6", "pytest notebooks", "AssertionError"),
        ("rival", '"proportional":', '"proportion":', "rhl compare", "method must be one of known-plant, "),
    ],
)
def test_an_example_with_a_fault_fails(tmp_path, name, right, wrong, command, says):
    example = EXAMPLES[name]
    assert sum(edit.code.count(right) for edit in example.edits) == 1
    edits = tuple(replace(edit, code=edit.code.replace(right, wrong)) for edit in example.edits)
    (noticed_by,) = (each for each in example.commands if each[0].startswith(command))
    apply(Example(edits, ()), copy_of_tree(tmp_path))
    (said,) = missing(Example((), (noticed_by,)), tmp_path)
    assert says in said


@pytest.mark.parametrize(
    ("edit", "text", "sentence"),
    [
        (Edit("a.py", "above", "x = 1", "y\n"), "x = 2\n", "x = 1 must be on one line of a.py, got 0"),
        (Edit("a.py", "below", "x = 1", "y\n"), "x = 1\nx = 1\n", "x = 1 must be on one line of a.py, got 2"),
        (Edit("a.py", "new", None, "y\n"), "x = 1\n", "a.py is there already"),
    ],
)
def test_an_edit_that_has_no_place_is_noticed(edit, text, sentence):
    with pytest.raises(AssertionError, match=sentence):
        edited(text, edit)
