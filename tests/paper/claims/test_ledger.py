"""The ledger leaves nothing out: every numbered item has a claim, every claim a page, code and a test."""

import json
import math
import re
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from rhl.errors import InputError
from rhl.paper.claims import ledger
from rhl.paper.claims.claim import Claim, Effort, Evidence, Judgement, judge
from rhl.paper.listing import cards

ROOT = Path(__file__).resolve().parents[3]
COUNTS = {"Equation": 55, "Assumption": 7, "Lemma": 6, "Theorem": 3, "Remark": 4, "Figure": 9}


def missing_items(claims: tuple[Claim, ...]) -> list[str]:
    """Numbered items of the paper without a claim; parts such as 'Theorem 2(i)' count for the whole."""
    items = {claim.item.split("(")[0] for claim in claims}
    return [f"{kind} {i}" for kind, count in COUNTS.items() for i in range(1, count + 1) if f"{kind} {i}" not in items]


def faults(claims: tuple[Claim, ...]) -> list[str]:
    """What is wrong with how claims are filed."""
    pages = {
        entry["file"] for part in yaml.safe_load((ROOT / "_toc.yml").read_text())["parts"] for entry in part["chapters"]
    }
    found = [f"{claim} twice" for claim, count in Counter(claim.id for claim in claims).items() if count > 1]
    for claim in claims:
        if claim.page.removesuffix(".ipynb") not in pages:
            found.append(f"{claim.id}: no page {claim.page}")
        test = ROOT / claim.test
        if not test.is_file() or "CLAIMS" not in test.read_text(encoding="utf-8"):
            found.append(f"{claim.id}: no test {claim.test}")
        elif (
            f"(test-{test.stem.removeprefix('test_').replace('_', '-')})=" not in (ROOT / "book/checks.md").read_text()
        ):
            found.append(f"{claim.id}: {claim.test} is not on the page of tests")
        if not claim.statement.endswith("."):
            found.append(f"{claim.id}: its statement is no sentence")
    return found


def test_every_numbered_item_has_a_claim():
    assert missing_items(ledger.CLAIMS) == []


def test_an_item_left_out_is_noticed():
    without = tuple(claim for claim in ledger.CLAIMS if claim.item != "Equation 44")
    assert missing_items(without) == ["Equation 44"]


def test_every_claim_has_page_code_and_test():
    assert faults(ledger.CLAIMS) == []


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"page": "notebooks/99-none.ipynb"}, "no page"),
        ({"test": "tests/paper/claims/test_none.py"}, "no test"),
        ({"test": "tests/test_checks.py"}, "no test"),
        ({"statement": "no sentence"}, "no sentence"),
    ],
)
def test_claims_that_are_filed_wrong_are_noticed(change, fault):
    (found,) = faults((replace(ledger.CLAIMS[0], **change),))
    assert fault in found
    assert any("twice" in each for each in faults((ledger.CLAIMS[0], ledger.CLAIMS[0])))


def test_the_search_is_found_by_either_name():
    assert ledger.select(["brief-lemma-4"]) == ledger.select(["lambda-search"]) == ledger.select(["lemma-5"])
    with pytest.raises(InputError, match="ID must be one of the ledger's"):
        ledger.select(["lemma-44"])
    with pytest.raises(InputError, match=r"got lemma-1, lemma-44; did you mean 'lemma-1\.\*', lemma-4"):
        ledger.select(["lemma-1", "lemma-44"])


def test_a_pattern_selects_every_id_that_it_matches():
    selected = [claim.id for claim in ledger.select(["certified.*", "eq-1"])]
    assert selected == [claim.id for claim in ledger.CLAIMS if claim.id.startswith("certified.") or claim.id == "eq-1"]
    assert len(selected) > 5
    with pytest.raises(InputError, match=r"ID must be one of the ledger's.*got certifed"):
        ledger.select(["certifed.*", "eq-1"])


def test_a_page_has_its_claims_of_every_module():
    found = {claim.test for claim in ledger.of_page("05-lemma-1")}
    assert found == {"tests/paper/claims/test_lemma_1.py", "tests/paper/claims/test_assumption_5.py"}
    assert {claim.page for claim in ledger.of_page("05-lemma-1")} == {"notebooks/05-lemma-1.ipynb"}
    with pytest.raises(InputError, match="name must be that of a notebook with claims, such as '05-lemma-1', got '5'"):
        ledger.of_page("5")


def test_json_names_everything():
    judgements = ledger.run(ledger.select(["eq-1", "eq-22"]), Effort(3, 5))
    written = ledger.as_json(judgements, Effort(3, 5))
    assert (written["version"], written["seed"]) == (2, 3)
    first, second = written["claims"]
    assert first["verdict"] == "not-checkable"
    assert first["control"] is None
    assert second["control"]["tripped"] is True
    assert second["tolerance"] == 0.0


@pytest.mark.parametrize("worst", [math.nan, math.inf, -math.inf])
def test_what_json_does_not_know_is_null(worst):
    claim = next(claim for claim in ledger.CLAIMS if claim.control)
    found = judge(replace(claim, stated=lambda effort: Evidence(1, worst)), Effort())
    (entry,) = json.loads(json.dumps(ledger.as_json([found], Effort()), allow_nan=False))["claims"]
    assert entry["worst"] is None
    assert entry["status"] == ("no evidence" if worst != math.inf else "fails: counterexample")


def test_rows_link_to_code_of_this_library():
    unjudged = [Judgement(claim, claim.recorded, None, None, None, "", 0.0) for claim in ledger.CLAIMS]
    modules = set(re.findall(r'"\.\./_modules/([^"]*)\.html"', cards(unjudged)))
    assert len(modules) > 10
    assert all((ROOT / f"{module}.py").is_file() for module in modules)
