"""Write environment.lock from pyproject.toml, headed by a fingerprint of its source.

`make lock` calls this. tests/test_environment.py compares the fingerprint, so it detects a lock that was not made
from the current pyproject.toml even if its versions still fit.
"""

import hashlib
import json
import subprocess
import sys
import tomllib
from pathlib import Path

HEADER = """\
# Everything the project runs on, pinned by hash, for every platform and Python >= 3.11.
# Made from pyproject.toml by `make lock`; not edited by hand.
# requirements sha256:{fingerprint}
"""


def fingerprint(pyproject: str) -> str:
    """Sha256 of the parts of a pyproject.toml (given as a string) that determine the lock."""
    parsed = tomllib.loads(pyproject)
    project = parsed["project"]
    decides = {
        "requires-python": project["requires-python"],
        "dependencies": sorted(project["dependencies"]),
        "extras": {extra: sorted(needs) for extra, needs in project["optional-dependencies"].items()},
        "build": sorted(parsed["build-system"]["requires"]),
    }
    return hashlib.sha256(json.dumps(decides, sort_keys=True).encode()).hexdigest()


def main(uv: str, root: Path) -> None:
    """Resolve with the executable `uv`; versions in the lock are kept if they still fit."""
    pyproject, lock = root / "pyproject.toml", root / "environment.lock"
    resolve = "pip compile --quiet --universal --generate-hashes --all-extras --python-version 3.11"
    files = ["--no-header", "--output-file", lock.name, pyproject.name]
    subprocess.run([uv, *resolve.split(), *files], check=True, cwd=root, stdout=subprocess.DEVNULL)
    header = HEADER.format(fingerprint=fingerprint(pyproject.read_text(encoding="utf-8")))
    lock.write_text(header + lock.read_text(encoding="utf-8"), encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main(str(Path(sys.argv[1]).resolve()), Path(__file__).resolve().parent.parent)
