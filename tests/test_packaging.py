"""The wheel and the source distribution hold what they must and nothing else, and the one is built from the other."""

import hashlib
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

from tools import clean_room

ROOT = Path(__file__).resolve().parent.parent


def contents(archive):
    """Each file of a wheel or a source distribution, without folders, with the hash of its bytes."""
    if archive.suffix == ".whl":
        with zipfile.ZipFile(archive) as opened:
            files = {name: opened.read(name) for name in opened.namelist() if not name.endswith("/")}
    else:
        with tarfile.open(archive) as opened:
            members = [member for member in opened.getmembers() if member.isfile()]
            files = {member.name.partition("/")[2]: opened.extractfile(member).read() for member in members}
    return {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}


def build(kind, source, where):
    """Build in a process of its own, without a network."""
    call = [sys.executable, "-m", "hatchling", "build", "-t", kind, "-d", str(where)]
    subprocess.run(call, cwd=source, check=True, capture_output=True)
    return next(where.glob("*.whl" if kind == "wheel" else "*.tar.gz"))


@pytest.fixture(scope="module")
def archives(tmp_path_factory):
    """The source distribution, the wheel built from it and the wheel built from the tree."""
    folder = tmp_path_factory.mktemp("dist with a blank")
    sdist = build("sdist", ROOT, folder / "sdist")
    with tarfile.open(sdist) as opened:
        opened.extractall(folder / "unpacked", filter="data")
    (unpacked,) = (folder / "unpacked").iterdir()
    return sdist, build("wheel", unpacked, folder / "from the sdist"), build("wheel", ROOT, folder / "from the tree")


def tracked(folder):
    """The files of a folder that are committed or would be, from the root."""
    call = ["git", "-c", "core.quotePath=off", "ls-files", "-z", "--cached", "--others", "--exclude-standard", folder]
    listed = subprocess.run(call, cwd=ROOT, check=True, capture_output=True, text=True).stdout.split("\0")
    return {name for name in listed if name and (ROOT / name).is_file()}


def faults(found, wanted):
    """What a wheel lacks, or holds beside the package and its description."""
    described = {name for name in found if name.split("/")[0].endswith(".dist-info")}
    return sorted(f"lacks {name}" for name in wanted - set(found)) + sorted(
        f"holds {name}" for name in set(found) - wanted - described
    )


def test_the_wheel_holds_the_package_with_its_data_and_nothing_else(archives):
    *_, wheel = archives
    found, wanted = contents(wheel), tracked("rhl")
    assert faults(found, wanted) == []
    assert {Path(name).suffix for name in wanted} == {".py", ".csv", ".json", ".toml", ".typed"}
    assert any(name.endswith("licenses/LICENSE") for name in found)
    for left in ("tests", "notebooks", "book", "tools", "proofs", "benchmarks", "binder"):
        assert not any(name.split("/")[0] == left for name in found)


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (lambda found: found.pop("rhl/paper/data/linear_y.csv"), "lacks rhl/paper/data/linear_y.csv"),
        (lambda found: found.update({"tests/test_model.py": ""}), "holds tests/test_model.py"),
        (lambda found: found.update({"rhl/left.over": ""}), "holds rhl/left.over"),
    ],
)
def test_another_wheel_is_noticed(archives, change, fault):
    found = contents(archives[-1])
    change(found)
    assert faults(found, tracked("rhl")) == [fault]


def test_the_sdist_builds_the_same_wheel(archives):
    _, one, other = map(contents, archives)
    assert one == other
    assert one.keys() == {**one, **other}.keys()
    changed = other | {"rhl/model.py": ""}
    assert one != changed


def test_the_sdist_holds_what_is_needed_to_test_it(archives):
    sdist, *_ = archives
    found = contents(sdist)
    for folder in ("rhl", "tests", "notebooks", "book", "tools", "proofs"):
        assert tracked(folder) <= set(found), folder
    assert {"Makefile", "pyproject.toml", "environment.lock", "LICENSE", "README.md", "_config.yml"} <= set(found)
    assert not any(name.startswith((".github", ".ci", ".venv", "build/")) for name in found)


def ended(status, out="", err=""):
    return subprocess.CompletedProcess([], status, out, err)


ASKS = "rhl: this command needs the package rich, got none installed; pip install 'rhl[app]'\n"


@pytest.mark.parametrize(
    ("wanted", "done", "new", "wrong"),
    [
        ("", ended(0, "done\n"), [], ""),
        ("app", ended(2, err=ASKS), [], ""),
        ("", ended(2, err=ASKS), [], "exit status 2"),
        ("", ended(0, err="Traceback (most recent call last):"), [], "a traceback"),
        ("app", ended(0, "done\n"), [], "it worked without [app]"),
        ("paper", ended(2, err=ASKS), [], "it asks for [app], not for [paper]"),
        ("app", ended(1, err="No module named rich\n"), [], "another message than the one that names an extra"),
        ("app", ended(2, err=f"rhl: warning\n{ASKS}"), [], "another message than the one that names an extra"),
        ("app", ended(2, "half a table\n", ASKS), [], "half of a result"),
        ("app", ended(2, err=ASKS), ["t.csv"], "half of a result"),
    ],
)
def test_the_clean_room_judges_how_a_command_ends(wanted, done, new, wrong):
    assert clean_room.verdict(wanted, done, new) == wrong


def test_the_clean_room_tries_every_command_and_every_extra():
    import tomllib

    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert set(clean_room.EXPECTED) - {""} == {"app", "plot", "paper", "study"} < set(project["optional-dependencies"])
    tried = {command.split()[0] for expected in clean_room.EXPECTED.values() for command in expected}
    assert tried >= {"run", "check", "new", "reproduce", "verify", "compare", "campaign", "schema"}
    works = {
        command.split()[0]
        for expected in clean_room.EXPECTED.values()
        for command, asks in expected.items()
        if not asks
    }
    assert tried == works


def test_the_versions_of_a_room_are_those_of_the_lock():
    lock = 'a==1.0 \\\n    --hash=sha256:00\nb==2.0 ; python_full_version < "3.12" \\\n    # via a\n'
    assert clean_room.pins(lock) == 'a==1.0\nb==2.0 ; python_full_version < "3.12"\n'
