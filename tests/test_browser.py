"""Every page of the built book in a real browser, in both themes and at three widths; each check is seen to fail."""

import subprocess
import tarfile
from pathlib import Path

import pytest

from tests import browser as seen
from tests.conftest import HTML, ROOT

FAULTY = Path(__file__).resolve().parent / "data/faulty"
# Without index.html, which only sends the reader on.
NAMES = sorted(
    {
        path.relative_to(HTML).as_posix()
        for path in HTML.rglob("*.html")
        if "_static" not in path.relative_to(HTML).parts
    }
    - {"index.html"}
)


# One page of each template, judged in both themes and by axe; the others are looked at once, but for source code, which
# is one template without anything of its own. `make test-all` judges every page like the first ones.
TEMPLATES = {
    "first page": "book/index.html",
    "prose with tables": "book/cli.html",
    "notebook": "notebooks/11-theorem-2.html",
    "notebook with long code": "notebooks/14-your-own-plant.html",
    "sliders": "book/explore.html",
    "live page": "book/live.html",
    "ledger": "book/ledger.html",
    "map of results": "book/chain.html",
    "source code": "_modules/rhl/horizon.html",
    "search": "search.html",
    "index": "genindex.html",
}
OTHERS = sorted(set(NAMES) - set(TEMPLATES.values()))


@pytest.fixture(scope="session")
def faulty(chromium):
    """Address of pages with deliberate faults."""
    with seen.serve(FAULTY) as address:
        yield address


def test_there_are_pages(site):
    assert set(TEMPLATES.values()) <= set(NAMES)
    assert len(OTHERS) > len(TEMPLATES)


def test_the_root_leads_to_the_first_page(chromium, site):
    with chromium.new_page() as page:
        page.goto(site)
        page.wait_for_url(f"{site}book/index.html")


@pytest.mark.parametrize("theme", seen.THEMES)
@pytest.mark.parametrize("name", TEMPLATES.values(), ids=TEMPLATES)
def test_template(chromium, site, name, theme):
    assert "\n".join(seen.faults(chromium, site, name, theme, HTML)) == ""


@pytest.mark.parametrize("name", [name for name in OTHERS if not name.startswith("_modules/")])
def test_page(chromium, site, name):
    assert "\n".join(seen.one_look(chromium, site, name, HTML)) == ""


@pytest.mark.nightly
@pytest.mark.parametrize("theme", seen.THEMES)
@pytest.mark.parametrize("name", OTHERS)
def test_page_like_its_template(chromium, site, name, theme):
    assert "\n".join(seen.faults(chromium, site, name, theme, HTML)) == ""


def test_faultless_page(chromium, faulty):
    assert seen.one_look(chromium, faulty, "good.html", FAULTY) == []
    for theme in seen.THEMES:
        assert seen.faults(chromium, faulty, "good.html", theme, FAULTY) == []


def test_faults_on_the_way_are_found(chromium, faulty):
    with seen.visit(chromium, faulty, "bad.html", "light") as (page, found):
        assert "asks another host: https://book.invalid/script.js" in found
        assert "the console says: a deliberate error" in found
        assert "a script fails: a deliberate exception" in found
        assert f"status 404: {faulty}missing.png" in found
        assert seen.weight(page, faulty, FAULTY) > (FAULTY / "bad.html").stat().st_size / 10
    with seen.visit(chromium, faulty, "missing.html", "light") as (_, found):
        assert f"status 404: {faulty}missing.html" in found


def test_a_heavy_page_is_found(chromium, faulty, monkeypatch):
    monkeypatch.setattr(seen, "BUDGET", 100)
    for found in (
        seen.faults(chromium, faulty, "good.html", "light", FAULTY),
        seen.one_look(chromium, faulty, "good.html", FAULTY),
    ):
        assert any("bytes compressed" in fault for fault in found)


def test_faults_in_a_page_are_found(chromium, faulty):
    with seen.visit(chromium, faulty, "bad.html", "light") as (page, _):
        assert seen.content_faults(page) == [
            "the id twice is given twice",
            "broken image: missing.png",
            "alternative text is no sentence: plot",
            "TeX as text: Undefined control sequence",
            "TeX as text: $x$",
            "TeX as text: \\begin{align",
        ]


def test_faults_of_the_layout_are_found(chromium, faulty):
    with seen.visit(chromium, faulty, "bad.html", "light") as (page, _):
        light = seen.too_wide(page) + seen.violations(page, "light")
    assert [fault for fault in light if "too wide" in fault] == ["at 360 px the page is 340 px too wide"]
    for width in seen.WIDTHS:
        assert f"at {width} px button-name: button" in light
        assert f"at {width} px, light: color-contrast: #pale-on-light" in light
    assert [fault for fault in light if "scrollable-region" in fault] == [
        "at 360 px scrollable-region-focusable: .scrolls"
    ]
    with seen.visit(chromium, faulty, "bad.html", "dark") as (page, _):
        dark = seen.violations(page, "dark")
    assert {fault for fault in dark if "contrast" in fault} == {
        f"at {width} px, dark: color-contrast: #dim-on-dark" for width in (1440, 360)
    }


def test_the_packed_site_opens_from_a_local_server(chromium, site, tmp_path):
    packed = tmp_path / "site.tar.gz"
    subprocess.run(["make", "--silent", "site", f"SITE={packed}"], cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
    with tarfile.open(packed) as archive:
        archive.extractall(tmp_path, filter="data")
    with seen.serve(tmp_path / "rhl-book") as address:
        for name in ("book/index.html", "notebooks/10-lemma-5.html"):
            with seen.visit(chromium, address, name, "dark") as (page, found):
                assert page.locator("article h1").count() == 1
            assert found == []


def test_search_finds_without_another_host(chromium, site):
    with seen.visit(chromium, site, "search.html?q=controllability", "light") as (page, found):
        page.wait_for_selector("#search-results li a")
        addresses = page.eval_on_selector_all("#search-results li a", "links => links.map(({ href }) => href)")
    assert found == []
    assert all(address.startswith(site) for address in addresses)
    assert any("notebooks/10-lemma-5.html" in address for address in addresses)


def test_a_link_shows_the_statement_it_leads_to(chromium, site):
    with seen.visit(chromium, site, "notebooks/08-theorem-1.html", "light") as (page, found):
        link = page.locator("article a[href*='06-lemma-2.html']").first
        link.hover()
        card = page.locator(".statement-card")
        card.wait_for()
        card.locator("mjx-container").first.wait_for()
        assert card.inner_text().startswith("Lemma 2")
        page.keyboard.press("Escape")
        card.wait_for(state="detached")
        # A link that leads to no result shows nothing.
        page.locator("article a[href*='_modules/']").first.hover()
        page.wait_for_timeout(600)
        assert card.count() == 0
    assert found == []


def test_what_rests_on_what_can_be_narrowed_down(chromium, site):
    with seen.visit(chromium, site, "book/chain.html", "light") as (page, found):
        boxes, shown = page.locator(".rhl-chain a.node"), page.locator(".rhl-chain a.node:not(.away)")
        everything = boxes.count()
        assert shown.count() == everything > 20
        # By keyboard alone, and the choice stands in the address.
        page.locator("#chain-of").focus()
        page.keyboard.type("Lemma 2 and")
        page.keyboard.press("Enter")
        assert page.evaluate("location.hash") == "#of=lemma-2"
        names = shown.evaluate_all("nodes => nodes.map((node) => node.dataset.id)")
        assert {"lemma-2", "lemma-1.a", "assumption-3", "assumption-5"} <= set(names)
        assert not {"theorem-1", "lemma-4"} & set(names)
        assert page.locator(".chain-table tbody tr:visible").count() >= len(names)
        assert "None of them fails" in page.locator(".rhl-chain [role=status]").inner_text()
        sizes = page.locator(".rhl-chain svg text").evaluate_all(
            "texts => texts.map((text) => parseFloat(getComputedStyle(text).fontSize))"
        )
        assert min(sizes) >= 11
        page.goto(f"{site}book/chain.html#of=theorem-3")
        page.reload()
        assert page.locator("#chain-of").input_value() == "theorem-3"
        assert "What fails" in page.locator(".rhl-chain [role=status]").inner_text()
        page.locator('.rhl-chain a.node[data-id="lemma-2"]').click()
        page.wait_for_url("**/notebooks/06-lemma-2.html#the-proof-step-by-step")
    assert found == []


def test_what_rests_on_what_without_scripts(chromium, site):
    with chromium.new_page(java_script_enabled=False) as page:
        page.goto(f"{site}book/chain.html")
        assert page.locator(".rhl-chain a.node").first.is_visible()
        assert page.locator(".chain-table tbody tr").count() > 20
        assert page.locator("#chain-of").count() == 0


def test_the_picture_scrolls_on_a_phone_and_the_page_does_not(chromium, site):
    with chromium.new_page(viewport={"width": 390, "height": 844}) as page:
        page.goto(f"{site}book/chain.html")
        picture = page.locator(".chain-picture")
        assert picture.evaluate("part => part.scrollWidth > part.clientWidth")
        assert page.evaluate("document.documentElement.scrollWidth <= document.documentElement.clientWidth")
        picture.focus()
        page.keyboard.press("ArrowRight")
        page.wait_for_function("document.querySelector('.chain-picture').scrollLeft > 0")
