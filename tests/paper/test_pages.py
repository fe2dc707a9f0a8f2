"""What the prose pages show as code runs, and what `rhl.paper.pages` hands to them is fit to print."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest

from rhl.errors import InputError
from rhl.paper.claims.claim import Evidence, Judgement
from rhl.paper.claims.ledger import CLAIMS
from rhl.paper.listing import badge, by_page, cards, findings_table, overview, section_id, status_counts
from rhl.paper.pages import (
    comparison_table,
    grouped,
    judgement_table,
    number,
    readable,
    scientific,
    table,
    tell,
)
from rhl.paper.published import Comparison

ROOT = Path(__file__).resolve().parents[2]


def python_blocks(text: str) -> str:
    """Join the fenced Python of a page: later blocks go on from earlier ones."""
    return "\n".join(re.findall(r"^```python\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL))


PAGES = [page for page in sorted((ROOT / "book").glob("*.md")) if python_blocks(page.read_text(encoding="utf-8"))]


def test_there_is_code_to_run():
    assert {page.name for page in PAGES} >= {"scheme.md", "api.md"}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_code_on_prose_pages_runs(page):
    code = python_blocks(page.read_text(encoding="utf-8"))
    assert "assert " in code
    exec(compile(code, page.name, "exec"), {})


def test_code_that_is_wrong_is_noticed():
    with pytest.raises(AssertionError):
        exec(python_blocks("```python\nx = 1\n```\ntext\n```python\nassert x == 2\n```\n"), {})


def test_numbers_told_are_plain():
    told = {}

    def display(data, raw, metadata):
        assert raw
        told[metadata["scrapbook"]["name"]] = data["application/papermill.record/text/plain"]

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RHL_BOOK", "1")
        patch.setattr("IPython.display.display", display)
        tell(a=np.float64(0.1), b=np.int64(3), c="text", d=2)
    assert told == {"a": "0.1", "b": "3", "c": "'text'", "d": "2"}


@pytest.mark.parametrize("value", [np.nan, np.inf, float("nan")])
def test_no_page_says_nan(value):
    with pytest.raises(InputError, match="a must be finite to appear"):
        tell(a=value)


@pytest.mark.parametrize(
    ("value", "digits", "written"),
    [(5.83e-13, 2, "5.8·10⁻¹³"), (1.0, 1, "1·10⁰"), (123456.0, 4, "1.235·10⁵"), (9.99e-10, 2, "1.0·10⁻⁹")],
)
def test_numbers_are_written_as_in_prose(value, digits, written):
    assert scientific(value, digits) == written


def test_long_numbers_may_break():
    assert grouped("-12.345678901", 3) == "−12.345 678 901"
    assert grouped("7") == "7"


def test_tables():
    page = comparison_table([Comparison("y", 14, 2e-12, 10, 1e-9), Comparison("v", 3, 0.07, 13, None)]).to_html()
    assert 'class="dataframe"' in page
    assert all(entry in page for entry in ("2·10⁻¹²", "10⁻⁹", "within", "unexplained", "none"))
    assert ">1<" in table(row for row in [{"n": 1}]).to_html()


def test_judgements_stand_in_words_and_plain_numbers():
    """The status is that of the judgement: another verdict is another status."""
    claim = next(claim for claim in CLAIMS if claim.id == "lemma-1.a")
    for verdict, status in (("holds", "proved here"), ("refuted", "fails: counterexample")):
        found = Judgement(claim, verdict, Evidence(7, -0.0, 2e-12, "rounding"), True, None, "", 0.1)
        page = judgement_table([found]).to_html()
        assert all(f">{entry}<" in page for entry in ("lemma-1.a", status, "7", "0", "2·10⁻¹²"))
        assert claim.control.what in page


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (2e-12, "2·10⁻¹²"),
        (1e-9, "10⁻⁹"),
        (1e5, "10⁵"),
        (-1.2e-7, "−1.2·10⁻⁷"),
        (150.4, "150"),
        (-9340.0, "−9300"),
        (0.79, "0.79"),
        (-0.25, "−0.25"),
        (0.0, "0"),
        (-0.0, "0"),
    ],
)
def test_numbers_are_written_as_on_paper(value, words):
    assert number(value) == words


@pytest.mark.parametrize(
    ("text", "set_as"),
    [
        ("x_N'Q_N x_N <= V2 + eps rho", "x<sub>N</sub>ᵀQ<sub>N</sub> x<sub>N</sub> ≤ V2 + ε ρ"),
        ("max(lambda_max(Q), 1) -> 0", "max(λ<sub>max</sub>(Q), 1) → 0"),
        ("C'(CC')^-1 B and B_{N-1}", "Cᵀ(CCᵀ)<sup>−1</sup> B and B<sub>N−1</sub>"),
        ("2 rho-bar < mu, r~+ = 0", "2 ρ̄ &lt; μ, r̃+ = 0"),
        ("theta~(k), x*_{k+1}, e_0(k)", "θ̃(k), x*<sub>k+1</sub>, e<sub>0</sub>(k)"),
        ("theta^ is theta_0", "θ̂ is θ<sub>0</sub>"),
        ("from 1e-10 to 1e3", "from 10⁻¹⁰ to 10³"),
        ("V1's gain, lemma-1.a, not 'the limit' of it", "V1's gain, lemma-1.a, not 'the limit' of it"),
    ],
)
def test_formulas_of_claims_are_set(text, set_as):
    assert readable(text) == set_as


def test_no_claim_shows_plain_text_formulas():
    """What is left of the ways to write a formula without setting it, in anything that a page shows of a claim."""
    left = re.compile(r"\b(eps|rho|lambda|theta|epsilon)\b|<=|->|\de-?\d|\w_\w|\^|~")
    found = [
        readable(words)
        for claim in CLAIMS
        for words in (claim.statement, claim.reason, claim.control.what if claim.control else "")
        if left.search(readable(words))
    ]
    assert found == []
    assert left.search("x_N <= 1e-3")


def test_rows_of_the_ledger_say_status_evidence_and_what_is_used():
    claim = next(claim for claim in CLAIMS if claim.id == "eq-39")
    row = cards([Judgement(claim, "holds", Evidence(7, 2e-12, 1e-9, "rounding"), True, None, "", 0.1)])
    assert '<span class="standing stands">proved here</span></p>' in row
    assert "numerical sampling: 7 cases, worst 2·10⁻¹²" in row
    assert "Fails with Γ a thousand times too small." in row
    assert '<a href="#assumption-3">assumption-3</a>' in row
    assert 'href="../notebooks/07-lemma-3.html#the-proof-step-by-step">proof' in row
    refuted = next(claim for claim in CLAIMS if claim.recorded == "refuted")
    row = cards([Judgement(refuted, "refuted", Evidence(1, 1.0, 0.0), True, True, "", 0.1)])
    assert f"Holds with {readable(refuted.instance.what)}." in row
    broken = Judgement(claim, "no-evidence", Evidence(0, np.nan), True, None, "the check raised E", 0.1)
    assert '<span class="standing open">no evidence</span>' in cards([broken])
    assert "the check raised E" in cards([broken])
    assert "1 " + badge("no evidence") in status_counts([broken])


def test_the_overview_counts_each_claim_once_and_leads_to_its_result():
    judgements = [Judgement(claim, claim.recorded, None, None, None, "", 0.0) for claim in CLAIMS]
    shown = overview(judgements)
    assert sum(map(int, re.findall(r"<td>(\d+)</td>", shown))) == len(CLAIMS)
    targets = re.findall(r'href="#([^"]*)"', shown)
    assert targets == [section_id(page) for page in by_page(CLAIMS, lambda claim: claim.page)]
    ledger = (ROOT / "book/ledger.md").read_text(encoding="utf-8")
    assert [target for target in targets if f"\n({target})=\n" not in ledger] == []


def test_findings_are_grouped_by_page():
    claims = [claim for claim in CLAIMS if claim.recorded == "holds-corrected"]
    groups = re.findall(r'<tr class="group">.*?<a href="([^"]*)">([^<]*)</a>', findings_table(claims))
    assert ("../notebooks/06-lemma-2.html", "Lemma 2") in groups
    assert len(groups) == len(set(groups)) > 4


def test_bars_in_docstrings_are_absolute_values():
    sys.path.insert(0, str(ROOT / "book/_ext"))
    from docstring_bars import escape_bars

    lines = ["the size |x| of ``|x|`` and :math:`|x|`", ".. math:: |x|", "", "   |y|", "and |z|"]
    assert escape_bars(lines) == [
        r"the size \|x\| of ``|x|`` and :math:`|x|`",
        ".. math:: |x|",
        "",
        "   |y|",
        r"and \|z\|",
    ]
