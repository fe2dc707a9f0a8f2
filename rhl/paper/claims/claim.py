"""What a claim is, how it is judged, and what a verdict means."""

from __future__ import annotations

import math
import time
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from rhl._checks import integer
from rhl.errors import InputError

Verdict = Literal["holds", "holds-corrected", "refuted", "observed", "not-checkable"]
Method = Literal["symbolic identity", "exact arithmetic", "numerical sampling", "simulation", "none"]


@dataclass(frozen=True)
class Effort:
    """How much a check may do: the seed of the whole ledger, and how many random cases a check draws that draws any."""

    seed: int = 0
    cases: int = 100

    def __post_init__(self) -> None:
        integer("seed", self.seed, 0)
        integer("cases", self.cases, 1)

    def rng(self, name: str) -> np.random.Generator:
        """Return the generator of one check; it depends on the seed and the name only, not on the order of checks."""
        return np.random.default_rng([self.seed, zlib.crc32(name.encode())])


@dataclass(frozen=True)
class Evidence:
    """What a check found.

    Attributes
    ----------
    cases : int
        How many cases were looked at; none is no evidence.
    worst : float
        The largest violation over all cases; it must not exceed the tolerance. Zero in exact arithmetic.
    tolerance, why : float, str
        What counts as rounding, and why, in a few words.
    """

    cases: int
    worst: float
    tolerance: float = 0.0
    why: str = "exact"

    @property
    def passes(self) -> bool:
        """Whether the claim was seen to hold; NaN and an empty sample do not pass."""
        return self.cases > 0 and self.worst <= self.tolerance


Check = Callable[[Effort], Evidence]


@dataclass(frozen=True)
class Control:
    """The same check with an assumption broken: it must be seen to fail.

    ``what`` says what is broken, completing "with ..."; ``check`` must not pass.
    """

    what: str
    check: Check


@dataclass(frozen=True)
class Claim:
    """One statement of the paper with everything that belongs to it.

    What says nothing of a method or a verdict cannot be checked. A module of claims fills in page and test once, with
    ``functools.partial``.

    Attributes
    ----------
    id : str
        Such as "lemma-5", "theorem-2.iii", "eq-44", "assumption-4b", "text-linear-observable".
    item : str
        The paper's name for it: "Lemma 5", "Theorem 2(iii)", "Equation 44", "text".
    label : str
        The LaTeX label in the paper's source; empty where there is none.
    statement : str
        In one sentence, in our words.
    method : Method
        How it is checked.
    recorded : Verdict
        What came out when the claim was entered; ``rhl verify`` fails if something else comes out. "observed": a check
        that passes is no proof.
    page, test : str
        The page of the book, such as "notebooks/10-lemma-5.ipynb", and the test file, from the root.
    stated, corrected : callable, optional
        Check the statement as the paper has it, None where it cannot be checked, and the corrected one, where that
        fails.
    control : Control, optional
        Required wherever there is a check.
    reason : str
        What is wrong and what is right, or why it cannot be checked; empty where the claim simply holds.
    """

    id: str
    item: str
    label: str
    statement: str
    method: Method = "none"
    recorded: Verdict = "not-checkable"
    page: str = field(kw_only=True)
    test: str = field(kw_only=True)
    stated: Check | None = None
    corrected: Check | None = None
    control: Control | None = None
    reason: str = ""

    def __post_init__(self) -> None:
        checkable = self.recorded != "not-checkable"
        if checkable != (self.stated is not None) or checkable != (self.control is not None):
            raise InputError(f"claim {self.id} must have a check and a control, or neither and be not-checkable")
        if (self.recorded in ("holds-corrected", "refuted", "not-checkable")) != bool(self.reason):
            raise InputError(f"claim {self.id} must give a reason just where it is corrected, refuted or not checkable")
        if (self.recorded == "holds-corrected") != (self.corrected is not None):
            raise InputError(
                f"claim {self.id} must have a corrected check just where it is recorded as holds-corrected"
            )


@dataclass(frozen=True)
class Judgement:
    """A claim after its checks ran, with the evidence of the check that decided.

    ``tripped`` says whether the negative control was violated, as it must be; ``seconds`` is the time taken.
    """

    claim: Claim
    verdict: Verdict
    evidence: Evidence | None
    tripped: bool | None
    seconds: float

    @property
    def as_recorded(self) -> bool:
        """Whether the verdict is the recorded one and the control was violated."""
        return self.verdict == self.claim.recorded and self.tripped is not False


def judge(claim: Claim, effort: Effort) -> Judgement:
    """Run a claim's checks and its control.

    "holds" (or "observed") if the stated check passes; else "holds-corrected" if there is a corrected check and it
    passes; else "refuted".
    """
    begin = time.perf_counter()
    if claim.stated is None or claim.control is None:
        return Judgement(claim, "not-checkable", None, None, 0.0)
    evidence = claim.stated(effort)
    verdict: Verdict = "observed" if claim.recorded == "observed" else "holds"
    if not evidence.passes:
        verdict = "refuted"
        if claim.corrected is not None:
            evidence = claim.corrected(effort)
            verdict = "holds-corrected" if evidence.passes else "refuted"
    tripped = not claim.control.check(effort).passes
    return Judgement(claim, verdict, evidence, tripped, time.perf_counter() - begin)


def worst_of(violations: list[float]) -> float:
    """Return the largest violation, NaN if there is one; an empty list is NaN too."""
    return max(violations, key=lambda value: math.inf if math.isnan(value) else value, default=math.nan)
