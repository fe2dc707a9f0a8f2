"""The book is built anew exactly when something it shows may have changed."""

import shlex
import sys

import pytest

from tests.conftest import ROOT
from tools import fresh

FILES = {
    "rhl/model.py": "A = 1\n",
    "rhl/paper/data/y.csv": "0,1\n",
    "rhl/__pycache__/model.pyc": "compiled",
    "environment.lock": "numpy==2\n",
    "pyproject.toml": "[project]\n",
    "tools/execute.py": "RUN = 1\n",
    "notebooks/conftest.py": "REFUSED = ()\n",
    "_config.yml": "title: book\n",
    "_toc.yml": "root: book/index\n",
    "book/index.md": "# Book\n",
    "notebooks/01.ipynb": "{}",
    "README.md": "read me\n",
}
OF_PAGES = {"_toc.yml", "book/index.md", "notebooks/01.ipynb"}
SUCCEED = [sys.executable, "-c", ""]
FAIL = [sys.executable, "-c", "raise SystemExit(3)"]


@pytest.fixture
def root(tmp_path):
    """A small project whose book has just been built with success."""
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    build(tmp_path)
    return tmp_path


def build(root, command=SUCCEED):
    """A build that leaves the three folders that the real one leaves, with a page."""
    leave = ["mkdir", "-p", *(f"{fresh.BUILT}/{folder}" for folder in (".jupyter_cache", ".doctrees", "html"))]
    return fresh.main(
        ["sh", "-c", f"{shlex.join(leave)}; echo a > {fresh.BUILT}/html/a.html; {shlex.join(command)}"], root
    )


def kept(root):
    """What the next build would find of the last one."""
    fresh.drop_stale(root)
    built = root / fresh.BUILT
    return {path.name for path in built.iterdir()} if built.exists() else set()


EVERYTHING = {".jupyter_cache", ".doctrees", "html"}
OUTPUTS = {".jupyter_cache"}
NOTHING = set()


def test_nothing_changed(root):
    assert kept(root) == EVERYTHING


@pytest.mark.parametrize("name", sorted(FILES.keys() - OF_PAGES - {"README.md", "rhl/__pycache__/model.pyc"}))
def test_changed_byte_below_the_outputs(root, name):
    text = (root / name).read_text()
    (root / name).write_text(text.replace(text[0], "~", 1))
    assert kept(root) == NOTHING


@pytest.mark.parametrize("name", sorted(OF_PAGES))
def test_changed_byte_in_a_page(root, name):
    text = (root / name).read_text()
    (root / name).write_text(text.replace(text[0], "~", 1))
    assert kept(root) == OUTPUTS


@pytest.mark.parametrize("name", ["rhl/__pycache__/model.pyc", "README.md"])
def test_changed_byte_elsewhere(root, name):
    (root / name).write_text("other")
    assert kept(root) == EVERYTHING


@pytest.mark.parametrize(
    "name", ["notebooks/.ruff_cache/0", "book/.ipynb_checkpoints/index.md", "rhl/__pycache__/x.pyc"]
)
def test_caches_that_tools_leave_decide_nothing(root, name):
    (root / name).parent.mkdir(parents=True, exist_ok=True)
    (root / name).write_text("cached")
    assert fresh.drop_stale(root)[0] == "everything"


def test_deleted_file(root):
    (root / "rhl/paper/data/y.csv").unlink()
    assert kept(root) == NOTHING


def test_renamed_file(root):
    (root / "rhl/model.py").rename(root / "rhl/models.py")
    assert kept(root) == NOTHING


def test_bytes_moved_between_files(root):
    (root / "rhl/model.py").write_text("")
    (root / "rhl/a.py").write_text(FILES["rhl/model.py"])
    assert kept(root) == NOTHING


def test_change_undone(root):
    (root / "rhl/model.py").write_text("A = 2\n")
    build(root)
    (root / "rhl/model.py").write_text(FILES["rhl/model.py"])
    assert kept(root) == NOTHING


def test_failed_build_keeps_no_pages(root):
    assert build(root, FAIL) == 3
    assert kept(root) == OUTPUTS


def test_build_that_was_cut_off_keeps_no_pages(root):
    fresh.drop_stale(root)
    assert kept(root) == OUTPUTS


@pytest.mark.parametrize("text", ["", "no json", "[]"])
def test_illegible_record(root, text):
    (root / fresh.RECORD).write_text(text)
    assert kept(root) == NOTHING


def test_command_runs_in_root(root):
    assert fresh.main([sys.executable, "-c", "open('was-here', 'w').close()"], root) == 0
    assert (root / "was-here").exists()


def test_another_interpreter_or_package_keeps_nothing(root, monkeypatch):
    assert fresh.is_current(root)
    monkeypatch.setattr(fresh, "installed", lambda: "another")
    assert not fresh.is_current(root)
    assert kept(root) == NOTHING


def test_a_page_that_is_gone_is_built_again(root):
    (root / fresh.BUILT / "html/a.html").unlink()
    assert not fresh.is_current(root)
    assert kept(root) == OUTPUTS


# Numbers may have been computed while the file was another one.
EDITED = "from pathlib import Path; file = Path('rhl/model.py'); text = file.read_text(); file.write_text('A = 2')"


@pytest.mark.parametrize("and_back", ["", "; file.write_text(text)"])
def test_an_edit_during_a_build_keeps_nothing(root, capsys, and_back):
    assert build(root, [sys.executable, "-c", EDITED + and_back]) == 1
    assert (
        "must not change while the book is built, got a change of rhl/model.py; build it again"
        in capsys.readouterr().out
    )
    assert not fresh.is_current(root)
    assert kept(root) == NOTHING


def test_two_builds_at_once_are_refused(root):
    second = f"import sys; sys.path.insert(0, {str(ROOT)!r}); from tools import fresh; from pathlib import Path; "
    second += "sys.exit(0 if fresh.main(['true'], Path()) == 1 else 3)"
    assert build(root, [sys.executable, "-c", second]) == 0
    assert fresh.is_current(root)
    assert build(root) == 0
