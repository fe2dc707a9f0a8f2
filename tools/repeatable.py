"""Build the book of the current commit twice, in two folders with different names, and compare the sites byte by byte.

The two builds differ in what a site must not depend on: the path of the project, the seed of Python's hashes, the time
zone. Each has an environment of its own, from the lock.

    python tools/repeatable.py build/repeatable
"""

import hashlib
import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SITE = "build/_build/html"
ENGINE = "build/pyodide"  # fetched by its hash, and copied so that it is fetched once
TREES: dict[str, dict[str, str]] = {
    "one": {"PYTHONHASHSEED": "1", "TZ": "UTC"},
    "another": {"PYTHONHASHSEED": "2", "TZ": "Asia/Tokyo"},
}


def hashes(site: Path) -> dict[str, str]:
    """The sha256 of every file of a site, by name."""
    files = sorted(path for path in site.rglob("*") if path.is_file())
    return {path.relative_to(site).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def whole(files: Mapping[str, str]) -> str:
    """One sha256 of all files."""
    return hashlib.sha256("".join(f"{name}\0{files[name]}\n" for name in sorted(files)).encode()).hexdigest()


def differing(one: Mapping[str, str], other: Mapping[str, str]) -> list[str]:
    """The names of files that differ, or that one site lacks."""
    return sorted(name for name in one.keys() | other.keys() if one.get(name) != other.get(name))


def build(tree: Path, own: Mapping[str, str]) -> dict[str, str]:
    """Build the commit in a fresh folder; returns the hashes of its site."""
    shutil.rmtree(tree, ignore_errors=True)
    subprocess.run(["git", "clone", "--quiet", ROOT, tree], check=True)
    if (ROOT / ENGINE).is_dir():
        shutil.copytree(ROOT / ENGINE, tree / ENGINE)
    log = tree.with_name(f"{tree.name}.log")
    bare = {name: value for name, value in os.environ.items() if name not in ("MAKEFLAGS", "MAKELEVEL", "VIRTUAL_ENV")}
    with log.open("w", encoding="utf-8") as file:
        status = subprocess.run(
            ["make", "book"], cwd=tree, check=False, env={**bare, **own}, stdout=file, stderr=subprocess.STDOUT
        ).returncode
    if status:
        raise SystemExit(f"'make book' must succeed in {tree}, got exit status {status}; {log} says why")
    return hashes(tree / SITE)


def main(folder: Path) -> int:
    """Build twice and compare; 1 if a file differs."""
    if subprocess.run(["git", "status", "--porcelain"], cwd=ROOT, check=True, capture_output=True).stdout:
        print("changes that are not committed are not built", file=sys.stderr)
    folder.mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor() as pool:
        one, other = pool.map(lambda name: build(folder / name, TREES[name]), TREES)
    for name, files in zip(TREES, (one, other), strict=True):
        print(f"{whole(files)}  {len(files)} files, built in {folder / name}")
    differ = differing(one, other)
    print("".join(f"{name} differs\n" for name in differ) or "the two sites are the same, byte for byte", end="")
    print()
    return 1 if differ else 0


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("one folder must be given, in which to build; type 'make repeatable'")
    sys.exit(main(Path(sys.argv[1]).resolve()))
