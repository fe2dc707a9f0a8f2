"""What a claim may look like, and how it is judged."""

import math
import time

import pytest

from rhl.errors import InputError
from rhl.paper.claims.claim import Claim, Control, Effort, Evidence, judge, worst_of

PASSES = Evidence(1, 0.0, 0.0)
FAILS = Evidence(1, 1.0, 0.0)
INSTANCE = Control("a case in which it holds", lambda effort: PASSES)


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


def test_the_seconds_are_those_of_the_checks():
    begin = time.perf_counter()
    seconds = judge(claim(), Effort()).seconds
    assert 0 < seconds <= time.perf_counter() - begin


@pytest.mark.parametrize(
    ("changes", "verdict", "as_recorded"),
    [
        ({}, "holds", True),
        ({"stated": lambda effort: FAILS}, "refuted", False),
        ({"recorded": "refuted", "reason": "r", "stated": lambda effort: FAILS, "instance": INSTANCE}, "refuted", True),
        ({"recorded": "refuted", "reason": "r", "instance": INSTANCE}, "holds", False),
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
        ({"reason": "r"}, "must give a reason exactly if"),
        ({"recorded": "refuted"}, "must give a reason exactly if"),
        ({"recorded": "holds-corrected", "reason": "r"}, "must have a corrected check"),
        ({"recorded": "refuted", "reason": "r"}, "must have an instance exactly if it is recorded as refuted"),
        ({"instance": Control("a case", lambda effort: PASSES)}, "must have an instance exactly if"),
        ({"kind": "hypothesis", "uses": ("y",)}, "is a hypothesis, which has no proof"),
        ({"kind": "definition", "proof": "p#proof"}, "is a definition, which has no proof"),
    ],
)
def test_claims_that_could_lie_are_refused(changes, sentence):
    with pytest.raises(InputError, match=sentence):
        claim(**changes)


NO_EVIDENCE = [Evidence(0, 0.0), Evidence(5, math.nan, 1.0), Evidence(5, -math.inf, 1.0)]


@pytest.mark.parametrize("evidence", [*NO_EVIDENCE, Evidence(5, 2.0, 1.0)])
def test_no_cases_no_number_no_pass(evidence):
    assert not evidence.passes
    assert evidence.conclusive == (evidence.worst == 2.0)


def raising(effort):
    raise ZeroDivisionError("by nothing")


@pytest.mark.parametrize("check", [raising, *(lambda effort, found=found: found for found in NO_EVIDENCE)])
@pytest.mark.parametrize("recorded", ["holds", "refuted", "holds-corrected"])
def test_no_evidence_is_neither_for_nor_against(check, recorded):
    reason = "" if recorded == "holds" else "r"
    corrected = (lambda effort: PASSES) if recorded == "holds-corrected" else None
    instance = INSTANCE if recorded == "refuted" else None
    made = claim(recorded=recorded, reason=reason, stated=check, corrected=corrected, instance=instance)
    judgement = judge(made, Effort())
    assert judgement.verdict == "no-evidence"
    assert judgement.problem.startswith("the check ")
    assert judgement.tripped is True
    assert not judgement.as_recorded


@pytest.mark.parametrize("check", [raising, *(lambda effort, found=found: found for found in NO_EVIDENCE)])
def test_a_control_without_evidence_has_not_failed(check):
    judgement = judge(claim(control=Control("it broken", check)), Effort())
    assert judgement.verdict == "holds"
    assert judgement.tripped is None
    assert judgement.problem.startswith("the control ")
    assert not judgement.as_recorded


@pytest.mark.parametrize(("found", "as_recorded"), [(PASSES, True), (FAILS, False), (Evidence(0, 0.0), False)])
def test_the_instance_of_a_refuted_claim_must_hold(found, as_recorded):
    instance = Control("a case in which it holds", lambda effort: found)
    made = claim(recorded="refuted", reason="r", stated=lambda effort: FAILS, instance=instance)
    assert judge(made, Effort()).as_recorded is as_recorded


def test_an_interrupt_is_not_swallowed():
    def interrupted(effort):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        judge(claim(stated=interrupted), Effort())


@pytest.mark.parametrize(
    ("changes", "status"),
    [
        ({}, "holds on all cases tried"),
        ({"recorded": "observed"}, "holds on all cases tried"),
        ({"proof": "p#proof"}, "proved here"),
        ({"proof": "p#proof", "formal": "lemma_5.enough_weights"}, "machine-checked"),
        ({"proof": "p#proof", "formal": "lemma_5.no_such_theorem"}, "proved here"),
        ({"proof": "p#proof", "stated": lambda effort: FAILS}, "fails: counterexample"),
        ({"proof": "p#proof", "stated": raising}, "no evidence"),
        ({"recorded": "not-checkable", "reason": "r", "stated": None, "control": None}, "cannot be checked"),
    ],
)
def test_status(changes, status):
    assert judge(claim(**changes), Effort()).status == status


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
