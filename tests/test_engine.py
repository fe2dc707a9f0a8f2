"""The engine of the page that runs rhl is one version, by its hash, whole or not at all."""

import base64
import hashlib
import io
import re
import stat
import tarfile

import pytest

from tests.conftest import ROOT
from tools import engine


def package(path, names=engine.FILES):
    """A package with such files, and more that no page loads; its SHA-512."""
    with tarfile.open(path, "w:gz") as archive:
        for name in (*names, "README.md"):
            entry = tarfile.TarInfo(f"package/{name}")
            content = f"this is {name}".encode()
            entry.size = len(content)
            archive.addfile(entry, io.BytesIO(content))
    return base64.b64encode(hashlib.sha512(path.read_bytes()).digest()).decode()


def test_what_a_page_loads_is_unpacked(tmp_path):
    kept = tmp_path / "build" / "pyodide"
    engine.unpack(tmp_path / "a.tgz", package(tmp_path / "a.tgz"), kept)
    assert {path.name for path in kept.iterdir()} == {*engine.FILES, "version"}
    assert (kept / "pyodide.mjs").read_text() == "this is pyodide.mjs"
    assert engine.present(kept)


def test_another_package_is_refused(tmp_path):
    package(tmp_path / "a.tgz")
    with pytest.raises(engine.NoEngineError, match=re.escape(f"must have the SHA-512 {engine.SHA512}, got ")):
        engine.unpack(tmp_path / "a.tgz", engine.SHA512, tmp_path / "kept")
    assert not (tmp_path / "kept").exists()


def test_a_package_that_lacks_a_file_is_refused_and_what_was_there_stays(tmp_path):
    kept = tmp_path / "kept"
    engine.unpack(tmp_path / "a.tgz", package(tmp_path / "a.tgz"), kept)
    sha512 = package(tmp_path / "b.tgz", engine.FILES[:-1])
    with pytest.raises(engine.NoEngineError, match=f"must hold {engine.FILES[-1]}"):
        engine.unpack(tmp_path / "b.tgz", sha512, kept)
    assert engine.present(kept)


@pytest.mark.parametrize("lost", [*engine.FILES, "version"])
def test_an_engine_that_lacks_a_file_is_not_there(tmp_path, lost):
    kept = tmp_path / "kept"
    engine.unpack(tmp_path / "a.tgz", package(tmp_path / "a.tgz"), kept)
    (kept / lost).unlink()
    assert not engine.present(kept)


def test_an_engine_of_another_version_is_not_there(tmp_path):
    kept = tmp_path / "kept"
    engine.unpack(tmp_path / "a.tgz", package(tmp_path / "a.tgz"), kept)
    (kept / "version").write_text("0.1")
    assert not engine.present(kept)


NPMS = {
    "npm, which fetches it, is not installed": None,
    "npm could not download pyodide": "echo 'npm error network' >&2; exit 1",
    "the package must have the SHA-512": "echo another > package.tgz",  # npm is called in the folder itself
}


@pytest.mark.parametrize("words", NPMS)
@pytest.mark.parametrize(("ci", "status"), [("", 0), ("true", 1)])
def test_without_a_package_the_build_goes_on_but_not_in_continuous_integration(
    tmp_path, monkeypatch, capsys, words, ci, status
):
    (tmp_path / "bin").mkdir()
    if NPMS[words]:
        npm = tmp_path / "bin" / "npm"
        npm.write_text(f"#!/bin/sh\n{NPMS[words]}\n")
        npm.chmod(npm.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    monkeypatch.setenv("CI", ci)
    assert engine.main(tmp_path / "kept") == status
    said = capsys.readouterr().err
    assert said.startswith(f"the page that runs rhl in the browser has no engine in this build: {words}")
    assert said.count("\n") == 1
    assert not (tmp_path / "kept").exists()


def test_an_engine_that_is_there_is_not_fetched_again(tmp_path, monkeypatch):
    kept = tmp_path / "kept"
    engine.unpack(tmp_path / "a.tgz", package(tmp_path / "a.tgz"), kept)
    monkeypatch.setenv("PATH", "")
    monkeypatch.setenv("CI", "true")
    assert engine.main(kept) == 0


def test_the_book_is_built_after_it_is_fetched():
    recipe = re.search(r"^book:.*\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text(encoding="utf-8"), flags=re.MULTILINE)
    lines = recipe[1].splitlines()
    assert lines[0].strip() == "python tools/engine.py"
    assert "tools/fresh.py" in lines[1]


def test_nothing_of_the_package_is_in_the_repository():
    assert not [path for name in engine.FILES for path in (ROOT / "book").rglob(name)]
