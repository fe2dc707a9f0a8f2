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

Recorded = Literal["holds", "holds-corrected", "refuted", "observed", "not-checkable"]
Verdict = Literal["holds", "holds-corrected", "refuted", "observed", "not-checkable", "no-evidence"]
Status = Literal[
    "proved here",
    "machine-checked",
    "holds on all cases tried",
    "holds once corrected",
    "fails: counterexample",
    "cannot be checked",
    "no evidence",
]
Kind = Literal["statement", "hypothesis", "definition"]
Method = Literal["symbolic identity", "exact arithmetic", "ball arithmetic", "numerical sampling", "simulation", "none"]


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

    Without cases, or with a largest violation of NaN or minus infinity (that of no numbers), it is no evidence, neither
    for the claim nor against it.

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
    def conclusive(self) -> bool:
        """Whether this is evidence at all."""
        return self.cases > 0 and self.worst > -math.inf

    @property
    def passes(self) -> bool:
        """Whether the claim was seen to hold."""
        return self.conclusive and self.worst <= self.tolerance


Check = Callable[[Effort], Evidence]


@dataclass(frozen=True)
class Control:
    """The same check under other conditions, which shows that it tells true from false.

    As a claim's ``control`` an assumption is broken, and ``check`` must fail; as its ``instance`` the conditions are
    such that even a refuted statement holds, and ``check`` must pass. ``what`` completes the sentence "with ...".
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
    instance : Control, optional
        Required of a refuted claim, and of no other: a case in which its statement holds, judged by the same check.
    reason : str
        What is wrong and what is right, or why it cannot be checked; empty where the claim simply holds.
    kind : Kind
        Whether the paper proves it, assumes it or defines it by it. What is assumed or defined has no proof; a check of
        it shows an instance, or what follows at once.
    uses : tuple of str
        The ids of the claims that the proof of this one uses, assumptions included; of a corrected claim, the proof of
        the corrected form.
    proof : str
        Where the book proves it, page and anchor, such as "notebooks/08-theorem-1.ipynb#proof"; empty where it does
        not.
    formal : str
        The name of the theorem that Coq checks; empty where there is none.
    """

    id: str
    item: str
    label: str
    statement: str
    method: Method = "none"
    recorded: Recorded = "not-checkable"
    page: str = field(kw_only=True)
    test: str = field(kw_only=True)
    stated: Check | None = None
    corrected: Check | None = None
    control: Control | None = None
    instance: Control | None = None
    reason: str = ""
    kind: Kind = "statement"
    uses: tuple[str, ...] = ()
    proof: str = ""
    formal: str = ""

    def __post_init__(self) -> None:
        checkable = self.recorded != "not-checkable"
        if checkable != (self.stated is not None) or checkable != (self.control is not None):
            raise InputError(f"claim {self.id} must have a check and a control, or neither and be not-checkable")
        if (self.recorded in ("holds-corrected", "refuted", "not-checkable")) != bool(self.reason):
            raise InputError(f"claim {self.id} must give a reason just where it is corrected, refuted or not checkable")
        if (self.recorded == "refuted") != (self.instance is not None):
            raise InputError(
                f"claim {self.id} must have an instance just where it is recorded as refuted: a case in which the same "
                "check passes"
            )
        if self.kind != "statement" and (self.uses or self.proof or self.formal):
            raise InputError(
                f"claim {self.id} is a {self.kind}, which nothing proves, and must name neither proof nor uses"
            )
        if (self.recorded == "holds-corrected") != (self.corrected is not None):
            raise InputError(
                f"claim {self.id} must have a corrected check just where it is recorded as holds-corrected"
            )


@dataclass(frozen=True)
class Judgement:
    """A claim after its checks ran.

    Attributes
    ----------
    claim : Claim
        What was judged.
    verdict : Verdict
        What came out.
    evidence : Evidence, optional
        That of the check that decided; None where nothing can be checked.
    tripped : bool, optional
        Whether the negative control failed, as it must; None where there is none, or where it gave no evidence.
    told_apart : bool, optional
        Whether the instance of a refuted claim passed, as it must; None where there is none, or no evidence.
    problem : str
        Why a check, a control or an instance gave no evidence; empty where all did.
    seconds : float
        The time taken.
    """

    claim: Claim
    verdict: Verdict
    evidence: Evidence | None
    tripped: bool | None
    told_apart: bool | None
    problem: str
    seconds: float

    @property
    def as_recorded(self) -> bool:
        """Whether the verdict is the recorded one, the control failed and the instance passed."""
        return (
            self.verdict == self.claim.recorded
            and self.tripped is (None if self.claim.control is None else True)
            and self.told_apart is (None if self.claim.instance is None else True)
        )

    @property
    def told_true_from_false(self) -> str:
        """What control and instance did, in words; empty where there is neither."""
        control = {True: "fails, as it must", False: "PASSES", None: "gives no evidence"}[self.tripped]
        instance = {True: "holds, as it must", False: "FAILS", None: "gives no evidence"}[self.told_apart]
        words = [control] if self.claim.control else []
        return "; ".join(words + ([f"instance {instance}"] if self.claim.instance else []))

    @property
    def status(self) -> Status:
        """What the verdict means, in words."""
        match self.verdict:
            case "holds" | "observed":
                if self.claim.formal:
                    return "machine-checked"
                return "proved here" if self.claim.proof else "holds on all cases tried"
            case "holds-corrected":
                return "holds once corrected"
            case "refuted":
                return "fails: counterexample"
            case "not-checkable":
                return "cannot be checked"
            case "no-evidence":
                return "no evidence"


def judge(claim: Claim, effort: Effort) -> Judgement:
    """Run a claim's checks, its control and its instance.

    "holds" (or "observed") if the stated check passes; else "holds-corrected" if there is a corrected check and it
    passes; else "refuted". A check that decides nothing (it raises, has no cases or finds NaN) makes it "no-evidence".
    """
    begin = time.perf_counter()
    if claim.stated is None or claim.control is None:
        return Judgement(claim, "not-checkable", None, None, None, "", 0.0)
    evidence, *problems = _run("the check", claim.stated, effort)
    verdict: Verdict = "observed" if claim.recorded == "observed" else "holds"
    if evidence.conclusive and not evidence.passes:
        verdict = "refuted"
        if claim.corrected is not None:
            evidence, *problems = _run("the corrected check", claim.corrected, effort)
            verdict = "holds-corrected" if evidence.passes else "refuted"
    if problems:
        verdict = "no-evidence"
    control, *more = _run("the control", claim.control.check, effort)
    tripped = not control.passes if control.conclusive else None
    told_apart = None
    if claim.instance is not None:
        instance, *rest = _run("the instance", claim.instance.check, effort)
        told_apart = instance.passes if instance.conclusive else None
        more += rest
    seconds = time.perf_counter() - begin
    return Judgement(claim, verdict, evidence, tripped, told_apart, "; ".join(problems + more), seconds)


def _run(name: str, check: Check, effort: Effort) -> tuple[Evidence] | tuple[Evidence, str]:
    """Run a check; return what it found and, where that is no evidence, why."""
    try:
        evidence = check(effort)
    except ModuleNotFoundError:
        raise  # a package that is not installed; the command line says which extra brings it
    except Exception as error:
        # One check that breaks must not end the run of the others; its row says what it raised.
        return Evidence(0, math.nan), f"{name} raised {type(error).__name__}: {error}"
    if evidence.conclusive:
        return (evidence,)
    if evidence.cases:
        return evidence, f"{name} found {evidence.worst}"
    return evidence, f"{name} had no cases" + ("" if evidence.why == Evidence.why else f": {evidence.why}")


def worst_of(violations: list[float]) -> float:
    """Return the largest violation, NaN if there is one; an empty list is NaN too."""
    return max(violations, key=lambda value: math.inf if math.isnan(value) else value, default=math.nan)
