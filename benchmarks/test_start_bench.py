"""Whole processes from cold and from warm: processor time of the child, user and system, so that waiting is none."""

import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from tests.app.test_config import LINEAR

ROOT = Path(__file__).parent.parent
RHL = "import sys; from rhl.app.cli import main; sys.exit(main())"
COLD = "python -m rhl.kernels, nothing compiled yet"
ROUNDS = 5


def of_children():
    """Seconds of processor time that finished children have taken."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """A folder for machine code, and a function that runs Python with it; empty at first."""
    folder = tmp_path_factory.mktemp("machine-code")
    environment = os.environ | {"NUMBA_CACHE_DIR": str(folder), "PYTHONPATH": str(ROOT)}

    def python(*arguments):
        return subprocess.run(
            [sys.executable, *arguments], env=environment, cwd=folder, check=True, capture_output=True
        )

    (folder / "run.toml").write_text(LINEAR, encoding="utf-8")
    return python


@pytest.mark.benchmark(timer=of_children, group="whole processes, processor time")
@pytest.mark.parametrize(
    ("row", "arguments"),
    [
        ("python -c pass", ("-c", "pass")),
        ('python -c "import numpy"', ("-c", "import numpy")),
        ('python -c "import rhl"', ("-c", "import rhl")),
        ("rhl --help", ("-c", RHL, "--help")),
        (COLD, ("-m", "rhl.kernels")),  # fills the folder that the following find full
        ("python -m rhl.kernels", ("-m", "rhl.kernels")),
        ("rhl run of the linear example", ("-c", RHL, "run", "run.toml", "--output", "run.csv", "--force")),
    ],
)
def test_start(benchmark, compiled, row, arguments):
    benchmark.extra_info["row"] = row
    if row != COLD:
        compiled(*arguments)  # so that bytecode is written, and machine code if a test runs alone
    found = benchmark.pedantic(compiled, arguments, rounds=1 if row == COLD else ROUNDS)
    assert (b"compiling" in found.stderr) == (row == COLD)
