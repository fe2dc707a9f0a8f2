"""The record of evidence is of today's claims, and another number is told from rounding."""

from dataclasses import replace

import pytest

from rhl.paper.claims import ledger
from rhl.paper.claims.claim import Effort, judge
from tests.evidence import EFFORT, drift, kept

CLAIM = next(claim for claim in ledger.CLAIMS if claim.id == "lemma-2.gains")


def test_every_claim_is_on_record():
    assert list(kept()) == [claim.id for claim in ledger.CLAIMS]


@pytest.mark.parametrize(
    ("change", "differs"),
    [
        ({}, False),
        ({"worst": 1e-9}, True),
        ({"cases": 2}, True),
        ({"tolerance": 0.006}, True),
    ],
)
def test_another_number_is_noticed(change, differs):
    found = judge(CLAIM, EFFORT)
    wrong = replace(found, evidence=replace(found.evidence, **change))
    assert (drift(wrong, EFFORT) != "") == differs
    assert drift(wrong, Effort(0, 10)) == ""
    assert (drift(replace(found, evidence=None), EFFORT)) != ""
