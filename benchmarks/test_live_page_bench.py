"""What a run in the browser costs: the same files of the library by numba, by an interpreter, and by the live page.

The live page is meant to make the 60 steps of the linear example in three seconds.
"""

import json
import subprocess
import sys
import time

import pytest

from rhl import simulate
from tests import browser as seen
from tests.conftest import HTML, ROOT, current_book
from tests.test_live_page import PAGE, PRESETS, driver, live_page, ran

SETTINGS = PRESETS["linear-example"]
STEPS = 60
WITHOUT_NUMPY = """
import json, sys, time
sys.path.insert(0, sys.argv[1])
import driver
settings = json.load(sys.stdin)
driver.whole(settings)
begin = time.perf_counter()
rows, said = driver.whole(settings)
print(json.dumps([time.perf_counter() - begin, len(rows), said]))
"""


class Clock:
    """A clock that tells the seconds which another process says it took: pytest-benchmark times its own calls only."""

    now = 0.0

    def __call__(self):
        return self.now


CLOCK = Clock()


def noted(benchmark, row, run):
    """Have a benchmark take the seconds that ``run`` returns, with the number of steps, five times."""
    benchmark.group = f"{STEPS} steps of the linear example, as the live page runs it"
    benchmark.extra_info |= {"row": row, "steps": STEPS}

    def once():
        seconds, steps = run()
        CLOCK.now += seconds
        return steps

    assert benchmark.pedantic(once, rounds=5, warmup_rounds=1) == STEPS


@pytest.mark.benchmark(timer=CLOCK)
def test_numba(benchmark):
    """The library itself."""
    plant, scheme, z0, steps = driver.prepare(SETTINGS)

    def run():
        begin = time.perf_counter()
        trace = simulate(scheme, plant, z0, steps)
        return time.perf_counter() - begin, len(trace)

    noted(benchmark, "rhl", run)


@pytest.mark.benchmark(timer=CLOCK)
def test_interpreter(benchmark, tmp_path):
    """The page's archive in an interpreter without numpy."""
    archive = tmp_path / "library.zip"
    archive.write_bytes(live_page.library(ROOT))

    def run():
        done = subprocess.run(
            [sys.executable, "-I", "-S", "-B", "-c", WITHOUT_NUMPY, str(archive)],
            input=json.dumps(SETTINGS),
            capture_output=True,
            text=True,
            check=True,
        )
        seconds, steps, said = json.loads(done.stdout)
        assert said == ""
        return seconds, steps

    noted(benchmark, "an interpreter without numpy", run)


@pytest.mark.benchmark(timer=CLOCK)
def test_browser(benchmark):
    """The page in Chromium, its engine loaded."""
    if seen.chromium() is None:
        pytest.skip("no Chromium; `apt-get install chromium` brings one")
    if not (current_book() / "_static/live/engine/version").is_file():
        pytest.skip("the built book holds no engine; with npm installed, `make book` brings one")
    with seen.launch() as browser, seen.serve(HTML) as site, seen.visit(browser, site, PAGE, "light") as (page, _):

        def run():
            told, signals = ran(page)
            return told["seconds"], len(signals["y1"])

        noted(benchmark, "the live page", run)
