"""How soon a built page is seen, and what it weighs: the first page, the heaviest and the one with the most formulas.

These are measurements. The weight has a limit, which tests/test_browser.py holds; the paint, which depends on the
machine, is meant to stay below two seconds from localhost.
"""

import pytest

from tests import browser as seen
from tests.conftest import current_book

PAGES = ("book/index.html", "notebooks/01-linear-example.html", "notebooks/09-lemma-4.html")
# A page without formulas is ready before it is painted, so the entry may be still to come.
PAINT = """async () => {
  for (;;) {
    const [paint] = performance.getEntriesByName("first-contentful-paint");
    if (paint) return paint.startTime;
    await new Promise(requestAnimationFrame);
  }
}"""


@pytest.fixture(scope="module")
def chromium():
    """One browser for all pages."""
    if seen.chromium() is None:
        pytest.skip("no Chromium; `apt-get install chromium` brings one")
    with seen.launch() as browser:
        yield browser


@pytest.mark.parametrize("name", PAGES)
def test_load(benchmark, chromium, name):
    """Time until the page is typeset; first paint and weight are in the extra columns of --benchmark-json."""
    folder = current_book()
    benchmark.group = "load and typeset a page"
    paints = []

    def load():
        with seen.visit(chromium, site, name, "light") as (page, found):
            paints.append(page.evaluate(PAINT))
            benchmark.extra_info["bytes compressed"] = seen.weight(page, site, folder)
            return found

    with seen.serve(folder) as site:
        assert benchmark.pedantic(load, rounds=5) == []
    benchmark.extra_info["first paint, ms"] = round(sorted(paints)[len(paints) // 2])
    print(
        f"{name}: first paint {benchmark.extra_info['first paint, ms']} ms (median of {len(paints)}), "
        f"{benchmark.extra_info['bytes compressed']} bytes compressed"
    )
