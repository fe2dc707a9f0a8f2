"""Fetch the interpreter that lets a page of the book run `rhl`: Pyodide's core, one version, by its hash.

It is Python compiled for browsers, under the Mozilla Public License 2.0. `npm pack` downloads the package;
the files that a page loads are kept in `build/pyodide` between builds. A build without npm or network continues without
them, and the page then reports that it has no engine; with CI=true the build fails.

    python tools/engine.py
"""

import base64
import hashlib
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

VERSION = "314.0.7"
SHA512 = "0YvXxEhfEdpLfb/XkM2BFAeMROq0iMUX2bzzH9pOttyMcWkwq+HbE5uyuGD82LN7y2q+SNvi/6V5JEsOlD2R1A=="
FILES = ("pyodide.mjs", "pyodide.asm.mjs", "pyodide.asm.wasm", "python_stdlib.zip", "pyodide-lock.json")
ROOT = Path(__file__).resolve().parent.parent
KEPT = ROOT / "build" / "pyodide"
PATIENCE = 300  # seconds


class NoEngineError(Exception):
    """The engine is not available; the message says why in one sentence."""


def fetched(folder: Path) -> Path:
    """Download the package into a folder with npm."""
    npm = shutil.which("npm")
    if npm is None:
        raise NoEngineError("npm, which fetches it, is not installed")
    command = [npm, "pack", "--silent", f"--pack-destination={folder}", f"pyodide@{VERSION}"]
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=PATIENCE, check=False)
    except subprocess.TimeoutExpired:
        raise NoEngineError(f"npm did not download pyodide {VERSION} within {PATIENCE} s") from None
    found = list(folder.glob("*.tgz"))
    if done.returncode or len(found) != 1:
        said = next((line.strip() for line in done.stderr.splitlines() if line.strip()), "it gave no reason")
        raise NoEngineError(f"npm could not download pyodide {VERSION}: {said}")
    return found[0]


def unpack(package: Path, sha512: str, kept: Path) -> None:
    """Check a package and put the files that a page loads into a folder, which appears whole or not at all."""
    found = base64.b64encode(hashlib.sha512(package.read_bytes()).digest()).decode()
    if found != sha512:
        raise NoEngineError(f"the package must have the SHA-512 {sha512}, got {found}; it is not used")
    begun = kept.with_name(f"{kept.name}.begun")
    shutil.rmtree(begun, ignore_errors=True)
    begun.mkdir(parents=True)
    with tarfile.open(package) as archive:
        for name in FILES:
            try:
                source = archive.extractfile(f"package/{name}")
            except KeyError:
                source = None
            if source is None:
                raise NoEngineError(f"the package must hold {name}, but does not")
            (begun / name).write_bytes(source.read())
    (begun / "version").write_text(VERSION, encoding="utf-8")
    shutil.rmtree(kept, ignore_errors=True)
    begun.rename(kept)


def present(kept: Path) -> bool:
    """Whether a folder contains the complete engine of this version."""
    note = kept / "version"
    return note.is_file() and note.read_text(encoding="utf-8") == VERSION and all((kept / of).is_file() for of in FILES)


def main(kept: Path = KEPT) -> int:
    """Fetch the engine unless it is present; return 1 if a required one is missing."""
    if present(kept):
        return 0
    try:
        with tempfile.TemporaryDirectory() as folder:
            unpack(fetched(Path(folder)), SHA512, kept)
    except NoEngineError as error:
        print(f"the page that runs rhl in the browser has no engine in this build: {error}", file=sys.stderr)
        return 1 if os.environ.get("CI") == "true" else 0
    return 0


if __name__ == "__main__":
    sys.exit(main())
