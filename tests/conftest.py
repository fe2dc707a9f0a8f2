"""Generated examples are the same in every run, and slow machines are no failure; what needs a built book says so."""

import os
from pathlib import Path
from typing import NoReturn

import hypothesis
import pytest

from tests.sizes import size
from tools import fresh

hypothesis.settings.register_profile("repeatable", derandomize=True, deadline=None, max_examples=size(40, 100))
hypothesis.settings.load_profile("repeatable")

ROOT = Path(__file__).resolve().parent.parent
HTML = ROOT / fresh.BUILT / "html"


def needed(reason: str) -> NoReturn:
    """Skip what cannot run here for a reason; in continuous integration, fail."""
    pytest.fail(reason) if os.environ.get("CI") == "true" else pytest.skip(reason)


def current_book() -> Path:
    """The folder of the built book; without an up-to-date one, skips, and in continuous integration fails."""
    if not fresh.is_current(ROOT):
        needed("no built book that is newer than its sources; `make book` makes one")
    return HTML


@pytest.fixture(scope="session")
def chromium():
    """One browser for each process of the tests; without one, skips, and in continuous integration fails."""
    from tests import browser as seen  # here, because most tests do without

    if seen.chromium() is None:
        needed("no Chromium; `apt-get install chromium` brings one")
    with seen.launch() as browser:
        yield browser


@pytest.fixture(scope="session")
def site(chromium):
    """Address of the built book."""
    from tests import browser as seen

    current_book()
    with seen.serve(HTML) as address:
        yield address
