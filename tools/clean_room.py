"""Try the package where nothing else is installed: built, installed and run in empty environments.

The source distribution is built from the tree, and the wheel from it. The wheel is installed with each extra alone into
an environment of its own, with the versions of the lock. Each command must then work, or end with one sentence that
names the extra to install. Notebooks run with [paper] and Jupyter. Folders have a blank in their names.

    python tools/clean_room.py --notebooks all
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import textwrap
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
QUICK = ("01-linear-example.ipynb",)
JUPYTER = ("ipykernel", "nbclient")
# What every package alone provides, imported module by module; the rest needs extras.
CORE = """\
import importlib, pkgutil, rhl
names = [name for _, name, _ in pkgutil.walk_packages(rhl.__path__, "rhl.")]
core = [name for name in names if not name.startswith(("rhl.app", "rhl.paper", "rhl.study", "rhl.plotting"))]
for name in [name for name in core if not name.endswith("__main__")]:
    importlib.import_module(name)
data = importlib.resources.files("rhl.paper").joinpath("data", "linear_y.csv").read_text(encoding="utf-8")
assert data.startswith("k") or data[0].isalnum(), data[:20]
print(len(core), "modules of the core,", len(rhl.__all__), "public names")
"""
NOTEBOOK = """\
import sys, nbclient, nbformat
notebook = nbformat.read(sys.argv[1], as_version=4)
nbclient.NotebookClient(notebook, timeout=900, kernel_name="python3").execute()
print(sum(cell.cell_type == "code" for cell in notebook.cells), "cells")
"""
TRANSFER = """\
name = "transfer"
steps = 20
order = 1
[plant]
kind = "transfer-function"
num = [1.0]
den = [1.0, -1.1]
z0 = [1.0]
"""
CAMPAIGN = """\
name = "small"
seed = 1
steps = 20
[plants]
kind = "random"
count = 4
[[schemes]]
base = "default"
"""
NEW, RUN, PLOT = "new plant", "run plant.toml --output t.csv", "run plant.toml --output p.csv --plot p.svg"
CHECK, TRANSFERRED = "check plant.toml", "run transfer.toml --output c.csv"
LINEAR, DRAWN = "reproduce linear", "reproduce robot --output r.csv --plot r.svg"
VERIFY, LISTED, COMPARE = "verify --fast --json v.json", "verify --list", "compare toy --output m.csv"
MANY = "campaign small.toml --output many"
# For each extra, "" for none: each command and the extra that it must ask for; "" where it must work.
EXPECTED: dict[str, dict[str, str]] = {
    "": {NEW: "", RUN: "", PLOT: "plot", CHECK: "app", TRANSFERRED: "paper", LINEAR: "app", DRAWN: "app"}
    | {VERIFY: "paper", LISTED: "", COMPARE: "app", MANY: "study", "schema": "", "--version": "", "--help": ""},
    "app": {NEW: "", RUN: "", PLOT: "plot", CHECK: "", LINEAR: "", DRAWN: "plot", VERIFY: "paper", COMPARE: ""},
    "plot": {NEW: "", RUN: "", PLOT: "", CHECK: "app", DRAWN: "app"},
    "paper": {NEW: "", RUN: "", PLOT: "", CHECK: "", TRANSFERRED: "", LINEAR: "", DRAWN: "", VERIFY: "", COMPARE: ""}
    | {MANY: "study"},
    "study": {NEW: "", RUN: "", CHECK: "", COMPARE: "", MANY: "", PLOT: "plot", VERIFY: "paper"},
}
# Other languages and encodings, under which these commands work too.
LOCALES = {
    "LC_ALL=C without UTF-8": {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    "LC_ALL=de_DE.UTF-8": {"LC_ALL": "de_DE.UTF-8", "LANG": "de_DE.UTF-8"},
    "LC_ALL=de_DE.ISO-8859-1": {"LC_ALL": "de_DE.ISO-8859-1", "PYTHONUTF8": "0"},
}
ABROAD = (NEW, RUN, CHECK, LINEAR, LISTED, COMPARE, "schema --output größe.json")
# What the notebooks need beside Jupyter.
NOTEBOOK_EXTRAS = "paper"


@dataclass(frozen=True)
class Result:
    """One line of the transcript: what was tried, whether it went as it must, what was said, and the seconds."""

    what: str
    right: bool
    said: str
    seconds: float


def run(arguments: Sequence[str | Path], folder: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run a command without the tree on Python's path and without anything that an outer environment sets."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "VIRTUAL_ENV", "UV_"))}
    return subprocess.run(
        list(map(str, arguments)),
        cwd=folder,
        env=kept | environment,
        capture_output=True,
        text=True,
        encoding="utf-8",
        errors="replace",
        check=False,
    )


def verdict(wanted: str, done: subprocess.CompletedProcess[str], new: Iterable[str]) -> str:
    """What is wrong with how a command ended; empty if it worked, or asked for the extra ``wanted`` in one sentence."""
    if "Traceback" in done.stderr or "Traceback" in done.stdout:
        return "a traceback"
    if not wanted:
        return "" if done.returncode == 0 else f"exit status {done.returncode}"
    if done.returncode == 0:
        return f"it worked without [{wanted}]"
    asked = re.fullmatch(
        r"rhl: this command needs the package \w+, got none installed; pip install 'rhl\[(\w+)\]'\n", done.stderr
    )
    if asked is None:
        return "another message than the one that names an extra"
    if asked[1] != wanted:
        return f"it asks for [{asked[1]}], not for [{wanted}]"
    if done.stdout or list(new):
        return "half of a result"
    return ""


def pins(lock: str) -> str:
    """The versions of a lock without their hashes, as constraints."""
    return (
        "\n".join(line.removesuffix(" \\") for line in lock.splitlines() if re.match(r"[\w-]+(\[.*\])?==", line)) + "\n"
    )


def said(done: subprocess.CompletedProcess[str]) -> str:
    """The last line that a command printed, cut to a line of a transcript."""
    lines = (done.stdout if done.returncode == 0 else done.stderr).strip().splitlines()
    return textwrap.shorten(lines[-1], 150) if lines else ""


def built(uv: Path, python: str, where: Path) -> Path:
    """Build the source distribution from the tree, and the wheel from the source distribution."""
    common: list[str | Path] = [uv, "build", "--no-build-isolation", "--python", python, "--quiet", "--out-dir", where]
    for kind in ("--sdist", "--wheel"):
        source = ROOT if kind == "--sdist" else next(where.glob("*.tar.gz"))
        done = run([*common, kind, source], where)
        if done.returncode:
            raise SystemExit(f"the package must build, got: {done.stderr}")
    return next(where.glob("*.whl"))


def room(uv: Path, python: str, where: Path, wheel: Path, extra: str, more: Sequence[str] = ()) -> Path:
    """Make an empty environment with the wheel and one extra; returns the folder of its commands."""
    made = where / f"room {extra or 'core'}"
    constraints = where / "versions.txt"
    constraints.write_text(pins((ROOT / "environment.lock").read_text(encoding="utf-8")), encoding="utf-8")
    named = f"rhl[{extra}] @ {wheel.as_uri()}" if extra else f"rhl @ {wheel.as_uri()}"
    install: list[str | Path] = [uv, "pip", "install", "--quiet", "--no-build", "--constraint", constraints]
    calls: list[list[str | Path]] = [
        [uv, "venv", "--quiet", "--clear", "--python", python, made],
        [*install, "--python", made / "bin" / "python", named, *more],
    ]
    for call in calls:
        done = run(call, where)
        if done.returncode:
            raise SystemExit(f"the room for [{extra}] must be made, got: {done.stderr}")
    return made / "bin"


def commands(bin: Path, folder: Path, expected: dict[str, str], **environment: str) -> Iterable[Result]:
    """Try each command in a folder."""
    folder.mkdir()
    (folder / "transfer.toml").write_text(TRANSFER, encoding="utf-8")
    (folder / "small.toml").write_text(CAMPAIGN, encoding="utf-8")
    for command, wanted in expected.items():
        before, begun = set(folder.iterdir()), time.monotonic()
        done = run([bin / "rhl", *command.split()], folder, **environment)
        wrong = verdict(wanted, done, (path.name for path in set(folder.iterdir()) - before))
        what = f"rhl {command}" + (f"   (needs [{wanted}])" if wanted else "")
        yield Result(what, not wrong, f"{wrong}: {said(done)}" if wrong else said(done), time.monotonic() - begun)


def scripts(bin: Path, folder: Path, named: dict[str, list[str | Path]]) -> Iterable[Result]:
    """Run Python scripts, each given with its arguments, by what they try."""
    for what, arguments in named.items():
        begun = time.monotonic()
        done = run([bin / "python", *arguments], folder)
        yield Result(what, done.returncode == 0, said(done), time.monotonic() - begun)


def tried(uv: Path, python: str, where: Path, extras: Sequence[str], notebooks: str) -> Iterable[Result]:
    """Everything, one result after the other."""
    begun = time.monotonic()
    wheel = built(uv, python, where)
    yield Result("sdist from the tree, wheel from the sdist", True, wheel.name, time.monotonic() - begun)
    for extra in extras:
        begun = time.monotonic()
        bin = room(uv, python, where, wheel, extra)
        listed = run([uv, "pip", "list", "--quiet", "--python", bin / "python", "--format", "freeze"], where).stdout
        count = f"{len(listed.splitlines())} packages"
        yield Result(
            f"-- environment with {f'rhl[{extra}]' if extra else 'rhl alone'}", True, count, time.monotonic() - begun
        )
        if not extra:
            yield from scripts(bin, where, {"import every module of the core": ["-c", CORE]})
        yield from commands(bin, where / f"work {extra or 'core'}", EXPECTED[extra])
        if extra == "app":
            for name, environment in LOCALES.items():
                yield Result(f"-- the same under {name}", True, "", 0.0)
                yield from commands(bin, where / f"größe {name}", dict.fromkeys(ABROAD, ""), **environment)
    if notebooks != "none":
        begun = time.monotonic()
        bin = room(uv, python, where, wheel, NOTEBOOK_EXTRAS, JUPYTER)
        yield Result(f"-- environment with rhl[{NOTEBOOK_EXTRAS}] and Jupyter", True, "", time.monotonic() - begun)
        folder = where / "some notebooks"
        shutil.copytree(ROOT / "notebooks", folder, ignore=shutil.ignore_patterns("*.py", "*.toml", ".*", "__*"))
        names = sorted(path.name for path in folder.glob("*.ipynb")) if notebooks == "all" else QUICK
        yield from scripts(bin, folder, {f"notebook {name}": ["-c", NOTEBOOK, folder / name] for name in names})


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the transcript; returns 1 if something went otherwise than it must."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--notebooks", choices=("none", "quick", "all"), default="quick")
    parser.add_argument("--extras", nargs="*", choices=tuple(EXPECTED), default=tuple(EXPECTED))
    options = parser.parse_args(arguments)
    uv, wrong = Path(sys.executable).with_name("uv"), 0
    with tempfile.TemporaryDirectory(prefix="clean room ") as folder:
        for one in tried(uv, sys.executable, Path(folder), options.extras, options.notebooks):
            wrong += not one.right
            print(f"{'ok   ' if one.right else 'WRONG'} {one.seconds:5.1f} s  {one.what}", flush=True)
            if one.said:
                print(f"               {one.said}", flush=True)
    print(f"{wrong} wrong" if wrong else "everything as it must be")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
