"""What helps a reader of the built book to find a thing, to follow it and to read it on a phone or without scripts."""

import re
from pathlib import Path

import pytest
from bs4 import BeautifulSoup

from rhl.paper.claims.ledger import CLAIMS
from tests import browser as seen
from tests.conftest import HTML, current_book

FORMULAS = """() => [...document.querySelectorAll("div.math")].filter((part) => part.clientWidth).map((part) => ({
  width: Math.round(part.querySelector("mjx-container > svg").getBoundingClientRect().width),
  reached: part.scrollWidth,
  room: part.clientWidth,
  says: part.dataset.scrolls ?? "",
  number: part.querySelector("[data-number]")?.dataset.number ?? "",
}))"""
CUT = """() => [...document.querySelectorAll("article table")]
  .filter((table) => table.getClientRects().length && table.scrollWidth > table.clientWidth + 1)
  .filter((table) => !(table.tBodies[0].rows.length > 12 && table.dataset.scrolls))
  .map((table) => table.textContent.slice(0, 60))"""


@pytest.fixture
def phone(chromium, site):
    """Open a page on a phone, typeset; its address is seen from the site."""
    with chromium.new_page(viewport={"width": 390, "height": 844}) as page:

        def visit(name):
            page.goto(f"{site}{name}")
            page.evaluate(seen.READY)
            page.evaluate(seen.TWO_FRAMES)
            return page

        yield visit


# ---------------------------------------------------------------- finding


def results(page, address, query):
    """The first results of a query: title, snippet."""
    page.goto(f"{address}search.html?q={query.replace(' ', '+')}")
    page.wait_for_function("document.querySelector('.search-summary')?.innerText.includes('finished')")
    items = page.locator("#search-results li")
    return [
        (item.locator("a").inner_text(), " ".join(item.locator(".context").all_inner_texts()))
        for item in items.all()[:5]
    ]


@pytest.mark.parametrize(
    ("query", "title"),
    [
        ("Lemma 4", "Lemma 4: "),
        ("lemma 1", "Lemma 1"),
        ("Theorem 3", "Theorem 3: "),
        ("robot arm", "The robot arm"),
        ("noise", "Peaking, saturation, noise"),
        ("set point", "Set points"),
        ("ledger", "The ledger"),
    ],
)
def test_the_search_puts_the_page_of_a_thing_first(chromium, site, query, title):
    with chromium.new_page() as page:
        found = results(page, site, query)
        assert found[0][0].startswith(title)
        assert query.lower() in found[0][1].lower()
        # Prose, neither code nor TeX nor the words of buttons.
        for _, snippet in found:
            assert not re.search(r"\\\\[a-z]|\bassert\b|import |Show code", snippet), snippet


def test_the_search_works_from_a_folder(chromium):
    folder = current_book()
    with chromium.new_page() as page:
        found = results(page, f"{folder.as_uri()}/", "Lemma 4")
    assert found[0][0].startswith("Lemma 4: ")
    assert "Lemma 4" in found[0][1]


def test_the_icon_of_the_search_lies_beside_its_text(chromium, site):
    with chromium.new_page(viewport={"width": 1280, "height": 800}) as page:
        page.goto(f"{site}search.html?q=lemma")
        field = page.locator(".bd-search-container form.bd-search")
        icon = field.locator("i, svg").first.bounding_box()
        text = field.locator("input").evaluate(
            "input => input.getBoundingClientRect().left + parseFloat(getComputedStyle(input).paddingLeft)"
        )
    assert icon["x"] + icon["width"] <= text


# ---------------------------------------------------------------- the way from statement to evidence


@pytest.mark.parametrize("result", ["theorem-1", "theorem-2", "theorem-3", "lemma-5"])
def test_trails_lead_to_the_result_of_their_page(result):
    folder = current_book()
    (path,) = folder.glob(f"notebooks/*-{result}.html")
    trail = BeautifulSoup(path.read_text(encoding="utf-8"), "html.parser").select_one(".statement .trail")
    links = {link.get_text().partition(" ")[0]: link["href"] for link in trail.select("a")}
    assert links["Checks"] == f"../book/ledger.html#result-{result}"
    assert Path(links["Code"]).stem == result.replace("-", "_")
    assert links["Tests"] == f"../book/checks.html#test-{result}"


def test_the_ledger_can_be_filtered_and_opens_the_claim_that_is_asked_for(chromium, site):
    with seen.visit(chromium, site, "book/ledger.html", "light") as (page, found):
        cards, shown = page.locator(".claim"), page.locator(".claim:visible")
        assert cards.count() == shown.count() == len(CLAIMS)
        page.locator("#ledger-word").fill("spiral")
        assert 0 < shown.count() < 30
        assert f"{shown.count()} of {len(CLAIMS)} claims" in page.locator(".rhl-filter [role=status]").inner_text()
        assert page.locator("#lemma-4-claims h2").is_visible()
        assert not page.locator("#lemma-3-claims h2").is_visible()
        page.locator("#ledger-word").fill("")
        page.locator("#ledger-status").select_option("fails: counterexample")
        assert set(shown.evaluate_all("all => all.map((one) => one.dataset.status)")) == {"fails: counterexample"}
        # A link to a claim that is filtered out brings it back, with its evidence.
        page.evaluate("location.hash = 'lemma-3'")
        page.locator("#lemma-3 details[open]").wait_for()
        assert shown.count() == len(CLAIMS)
    assert found == []


# ---------------------------------------------------------------- phones, and browsers without scripts


@pytest.mark.parametrize("name", ["notebooks/11-theorem-2.html", "book/scheme.html", "notebooks/06-lemma-2.html"])
def test_formulas_that_scroll_say_so_and_can_be_reached(phone, name):
    formulas = phone(name).evaluate(FORMULAS)
    wide = [formula for formula in formulas if formula["width"] > formula["room"] + 1]
    assert wide
    for formula in wide:
        assert formula["reached"] >= formula["width"]
        assert formula["says"] == f"{formula['number']} scroll →".strip()
    assert any(formula["number"] for formula in wide)
    assert all(not formula["says"] for formula in formulas if formula["width"] < formula["room"] - 1)


IN_SENTENCES = """() => [...document.querySelectorAll("article span.math")].filter((part) => part.clientWidth)
  .map((part) => [part, part.querySelector("mjx-container > svg").getBoundingClientRect().width])
  .filter(([part, width]) => width > part.clientWidth + 2)
  .map(([part, width]) => [Math.round(width), part.scrollWidth, getComputedStyle(part).overflowX, part.tabIndex])"""


def test_long_formulas_in_sentences_can_be_reached(phone):
    wide = phone("notebooks/12-lemma-6.html").evaluate(IN_SENTENCES)
    assert wide
    for width, reached, overflow, focus in wide:
        assert reached >= width - 2
        assert (overflow, focus) == ("auto", 0)


@pytest.mark.parametrize(
    "name",
    [
        "notebooks/03-text-against-data.html",
        "notebooks/19-plants-that-others-chose.html",
        "notebooks/02-robot-arm.html",
    ],
)
def test_no_table_is_cut_on_a_phone(phone, name):
    page = phone(name)
    assert page.locator("article table").count()
    assert page.evaluate(CUT) == []
    # The check sees a table that is cut.
    cards = "document.querySelectorAll('article table.cards').forEach((table) => table.classList.remove('cards'))"
    assert page.evaluate(f"() => {{ {cards}; return ({CUT})(); }}") != []


def test_formulas_can_be_read_without_scripts(chromium, site):
    name = "notebooks/11-theorem-2.html"
    page_as_built = BeautifulSoup((HTML / name).read_text(encoding="utf-8"), "html.parser")
    with chromium.new_page(java_script_enabled=False) as page:
        page.goto(f"{site}{name}")
        article = page.locator("article")
        assert not re.search(r"\\\\(tilde|begin|frac|\[|\()", article.inner_text())
        shown = sum(one.is_visible() for one in article.locator("math").all())
    # Those in parts that are folded are not in sight.
    assert 0.5 * len(page_as_built.select("article .math")) < shown <= len(page_as_built.select("article .math"))
