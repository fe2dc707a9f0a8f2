"""What a claim may look like, and how it is judged."""

import math

import pytest

from rhl.errors import InputError
from rhl.paper.claims.claim import Claim, Control, Effort, Evidence, judge, worst_of

PASSES = Evidence(1, 0.0, 0.0)
FAILS = Evidence(1, 1.0, 0.0)


def claim(**changes):
    made = {
        "id": "x",
        "item": "Lemma 0",
        "label": "x",
        "statement": "A sentence.",
        "method": "exact arithmetic",
        "recorded": "holds",
        "page": "p",
        "test": "t",
        "stated": lambda effort: PASSES,
        "control": Control("it broken", lambda effort: FAILS),
    }
    return Claim(**(made | changes))


@pytest.mark.parametrize(
    ("changes", "verdict", "as_recorded"),
    [
        ({}, "holds", True),
        ({"stated": lambda effort: FAILS}, "refuted", False),
        ({"recorded": "refuted", "reason": "r", "stated": lambda effort: FAILS}, "refuted", True),
        ({"recorded": "refuted", "reason": "r"}, "holds", False),
        ({"recorded": "observed"}, "observed", True),
        (
            {
                "recorded": "holds-corrected",
                "reason": "r",
                "stated": lambda effort: FAILS,
                "corrected": lambda effort: PASSES,
            },
            "holds-corrected",
            True,
        ),
        ({"recorded": "holds-corrected", "reason": "r", "corrected": lambda effort: PASSES}, "holds", False),
        (
            {
                "recorded": "holds-corrected",
                "reason": "r",
                "stated": lambda effort: FAILS,
                "corrected": lambda effort: FAILS,
            },
            "refuted",
            False,
        ),
        ({"control": Control("nothing broken", lambda effort: PASSES)}, "holds", False),
        ({"recorded": "not-checkable", "reason": "r", "stated": None, "control": None}, "not-checkable", True),
    ],
)
def test_verdicts(changes, verdict, as_recorded):
    judgement = judge(claim(**changes), Effort())
    assert judgement.verdict == verdict
    assert judgement.as_recorded == as_recorded


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"stated": None}, "must have a check and a control"),
        ({"control": None}, "must have a check and a control"),
        ({"recorded": "not-checkable", "reason": "r"}, "must have a check and a control, or neither"),
        ({"reason": "r"}, "must give a reason just where"),
        ({"recorded": "refuted"}, "must give a reason just where"),
        ({"recorded": "holds-corrected", "reason": "r"}, "must have a corrected check"),
    ],
)
def test_claims_that_could_lie_are_refused(changes, sentence):
    with pytest.raises(InputError, match=sentence):
        claim(**changes)


@pytest.mark.parametrize("evidence", [Evidence(0, 0.0), Evidence(5, math.nan, 1.0), Evidence(5, 2.0, 1.0)])
def test_no_cases_no_number_no_pass(evidence):
    assert not evidence.passes


def test_worst_of():
    assert worst_of([1.0, 3.0, 2.0]) == 3.0
    assert math.isnan(worst_of([1.0, math.nan, 2.0]))
    assert math.isnan(worst_of([]))


def test_randomness_depends_on_seed_and_name_alone():
    first = Effort(1).rng("a").normal(size=3)
    assert (first == Effort(1).rng("a").normal(size=3)).all()
    assert (first != Effort(1).rng("b").normal(size=3)).all()
    assert (first != Effort(2).rng("a").normal(size=3)).all()


@pytest.mark.parametrize(("seed", "cases"), [(-1, 10), (0, 0), (0.5, 10)])
def test_effort_is_checked(seed, cases):
    with pytest.raises(InputError, match="must be an integer"):
        Effort(seed, cases)
