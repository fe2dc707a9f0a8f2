"""A plugin of pytest that records which lines of `rhl/` each test executes, and how long the test takes.

    RHL_COVERED=FOLDER pytest -p tools.covered ...

Each process of the tests writes one file to FOLDER. Lines that only run while modules are imported belong to no test.
`tools/mutants.py` reads the files: a changed line can only fail the tests that execute it.
"""

import json
import os
from pathlib import Path

import coverage
import pytest

_tracer = coverage.Coverage(data_file=None, source=["rhl"], config_file=False, messages=False)
_tracer.set_option("run:disable_warnings", ["no-data-collected"])  # in the process that only distributes tests
_seconds: dict[str, float] = {}
_failed: set[str] = set()


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item):  # type: ignore[no-untyped-def]
    """Count lines for this test; begin anew each time, because some tests take the place of the tracer."""
    _tracer.start()
    _tracer.switch_context(item.nodeid)
    result = yield
    _tracer.stop()
    return result


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Add up the durations of set-up, call and tear-down."""
    if report.failed:
        _failed.add(report.nodeid)
    _seconds[report.nodeid] = _seconds.get(report.nodeid, 0.0) + report.duration


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Write the record of this process, if it ran tests."""
    data = _tracer.get_data()
    lines: dict[str, dict[str, list[int]]] = {}
    for file in data.measured_files():
        where = Path(file).relative_to(session.config.rootpath).as_posix()
        for line, tests in data.contexts_by_lineno(file).items():
            for test in tests:
                lines.setdefault(test, {}).setdefault(where, []).append(line)
    if not lines:
        return
    folder = Path(os.environ["RHL_COVERED"])
    folder.mkdir(parents=True, exist_ok=True)
    # A test without lines runs the library in another process, or not at all.
    passed = _seconds.keys() - _failed
    record = {test: {"seconds": _seconds[test], "lines": lines.get(test, {})} for test in sorted(passed)}
    (folder / f"{os.getpid()}.json").write_text(json.dumps(record), encoding="utf-8")
