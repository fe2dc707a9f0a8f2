"""Claims: their definition, their check and their verdict."""

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
from rhl.paper import formal

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
    """The effort of a check: the seed of the whole ledger, and the number of random cases."""

    seed: int = 0
    cases: int = 100

    def __post_init__(self) -> None:
        integer("seed", self.seed, 0)
        integer("cases", self.cases, 1)

    def rng(self, name: str) -> np.random.Generator:
        """Return the generator of one check; it depends only on the seed and the name, not on the order of checks."""
        return np.random.default_rng([self.seed, zlib.crc32(name.encode())])


@dataclass(frozen=True)
class Evidence:
    """The result of a check.

    Without cases, or with a largest violation of NaN or minus infinity (that of no numbers), it is evidence neither for
    the claim nor against it.

    Attributes
    ----------
    cases : int
        The number of checked cases; zero is no evidence.
    worst : float
        The largest violation over all cases; it must not exceed the tolerance. Zero in exact arithmetic.
    tolerance, why : float, str
        The largest violation that counts as rounding, and why.
    """

    cases: int
    worst: float
    tolerance: float = 0.0
    why: str = "exact"

    @property
    def conclusive(self) -> bool:
        """Whether the check is conclusive."""
        return self.cases > 0 and self.worst > -math.inf

    @property
    def passes(self) -> bool:
        """Whether the claim held in the check."""
        return self.conclusive and self.worst <= self.tolerance


Check = Callable[[Effort], Evidence]


@dataclass(frozen=True)
class Control:
    """The same check under other conditions, which shows that it can fail and pass.

    As a claim's ``control`` an assumption is violated, and ``check`` must fail. As its ``instance`` a refuted statement
    holds under the conditions, and ``check`` must pass. ``what`` completes the sentence "with ...".
    """

    what: str
    check: Check


@dataclass(frozen=True)
class Claim:
    """One statement of the paper with its checks and references.

    A claim without method and verdict cannot be checked. A module of claims sets page and test once, with
    ``functools.partial``.

    Attributes
    ----------
    id : str
        Such as "lemma-5", "theorem-2.iii", "eq-44", "assumption-4b", "text-linear-observable".
    item : str
        The paper's name for it: "Lemma 5", "Theorem 2(iii)", "Equation 44", "text".
    label : str
        The LaTeX label in the paper's source; empty if there is none.
    statement : str
        One sentence in our words.
    method : Method
        The method of the check.
    recorded : Verdict
        The verdict when the claim was entered; ``rhl verify`` fails if it changes. "observed": passing the check is
        not a proof.
    page, test : str
        The page of the book, such as "notebooks/10-lemma-5.ipynb", and the test file, from the root.
    stated, corrected : callable, optional
        The check of the paper's statement, None if it cannot be checked, and that of the corrected statement if the
        first fails.
    control : Control, optional
        Required with every check.
    instance : Control, optional
        Required for refuted claims only: a case in which the statement holds, by the same check.
    reason : str
        The error and its correction, or why there is no check; empty if the claim holds.
    kind : Kind
        Whether the paper proves it, assumes it or defines something by it. Assumptions and definitions have no proof;
        their checks show an instance or a direct consequence.
    uses : tuple of str
        The ids of the claims that its proof uses, including assumptions; for a corrected claim, the proof of the
        corrected form.
    proof : str
        Page and anchor of the book's proof, such as "notebooks/08-theorem-1.ipynb#proof"; empty if there is none.
    formal : str
        The name of the theorem that Coq checks; empty if there is none.
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
            raise InputError(f"claim {self.id} must give a reason exactly if it is corrected, refuted or not checkable")
        if (self.recorded == "refuted") != (self.instance is not None):
            raise InputError(
                f"claim {self.id} must have an instance exactly if it is recorded as refuted: a case in which the same "
                "check passes"
            )
        if self.kind != "statement" and (self.uses or self.proof or self.formal):
            raise InputError(
                f"claim {self.id} is a {self.kind}, which has no proof, and must name neither proof nor uses"
            )
        if (self.recorded == "holds-corrected") != (self.corrected is not None):
            raise InputError(
                f"claim {self.id} must have a corrected check exactly if it is recorded as holds-corrected"
            )


@dataclass(frozen=True)
class Judgement:
    """A claim after its checks.

    Attributes
    ----------
    claim : Claim
        The claim.
    verdict : Verdict
        The result.
    evidence : Evidence, optional
        The evidence of the deciding check; None if nothing can be checked.
    tripped : bool, optional
        Whether the negative control failed, as it must; None without control or evidence.
    told_apart : bool, optional
        Whether the instance of a refuted claim passed, as it must; None without instance or evidence.
    problem : str
        Why a check, a control or an instance gave no evidence, or that Coq's record lacks the theorem; else empty.
    seconds : float
        The time taken.
    beside : tuple of Evidence
        The evidence of the other checks: of the stated one if it fails, of the control, of the instance.
    """

    claim: Claim
    verdict: Verdict
    evidence: Evidence | None
    tripped: bool | None
    told_apart: bool | None
    problem: str
    seconds: float
    beside: tuple[Evidence, ...] = ()

    @property
    def as_recorded(self) -> bool:
        """Whether verdict and theorem are as recorded, the control failed and the instance passed."""
        return (
            self._formal_as_recorded
            and self.verdict == self.claim.recorded
            and self.tripped is (None if self.claim.control is None else True)
            and self.told_apart is (None if self.claim.instance is None else True)
        )

    @property
    def _formal_as_recorded(self) -> bool:
        return not self.claim.formal or formal.proves(self.claim.formal)

    @property
    def told_true_from_false(self) -> str:
        """The results of control and instance, in words; empty without either."""
        control = {True: "fails, as it must", False: "PASSES", None: "gives no evidence"}[self.tripped]
        instance = {True: "holds, as it must", False: "FAILS", None: "gives no evidence"}[self.told_apart]
        words = [control] if self.claim.control else []
        return "; ".join(words + ([f"instance {instance}"] if self.claim.instance else []))

    @property
    def status(self) -> Status:
        """The meaning of the verdict, in words."""
        match self.verdict:
            case "holds" | "observed":
                if self.claim.formal and self._formal_as_recorded:
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
    passes; else "refuted". An inconclusive check (it raises, has no cases or finds NaN) gives "no-evidence".
    """
    begin = time.perf_counter()
    if claim.stated is None or claim.control is None:
        return Judgement(claim, "not-checkable", None, None, None, "", 0.0)
    evidence, *problems = _run("the check", claim.stated, effort)
    beside: list[Evidence] = []
    verdict: Verdict = "observed" if claim.recorded == "observed" else "holds"
    if evidence.conclusive and not evidence.passes:
        verdict = "refuted"
        if claim.corrected is not None:
            beside.append(evidence)
            evidence, *problems = _run("the corrected check", claim.corrected, effort)
            verdict = "holds-corrected" if evidence.passes else "refuted"
    if problems:
        verdict = "no-evidence"
    control, *more = _run("the control", claim.control.check, effort)
    tripped = not control.passes if control.conclusive else None
    beside.append(control)
    told_apart = None
    if claim.instance is not None:
        instance, *rest = _run("the instance", claim.instance.check, effort)
        told_apart = instance.passes if instance.conclusive else None
        more += rest
        beside.append(instance)
    if claim.formal and not formal.proves(claim.formal):
        more.append(f"the record of Coq's results does not have the theorem {claim.formal}")
    seconds = time.perf_counter() - begin
    problem = "; ".join(problems + more)
    return Judgement(claim, verdict, evidence, tripped, told_apart, problem, seconds, tuple(beside))


def _run(name: str, check: Check, effort: Effort) -> tuple[Evidence] | tuple[Evidence, str]:
    """Run a check; return its evidence and, if it is inconclusive, why."""
    try:
        evidence = check(effort)
    except ModuleNotFoundError:
        raise  # a missing package; the command line names the extra that installs it
    except Exception as error:
        # A check that raises must not stop the others; its row holds the error.
        return Evidence(0, math.nan), f"{name} raised {type(error).__name__}: {error}"
    if evidence.conclusive:
        return (evidence,)
    if evidence.cases:
        return evidence, f"{name} found {evidence.worst}"
    return evidence, f"{name} had no cases" + ("" if evidence.why == Evidence.why else f": {evidence.why}")


def worst_of(violations: list[float]) -> float:
    """Return the largest violation, NaN if there is one; an empty list is NaN too."""
    return max(violations, key=lambda value: math.inf if math.isnan(value) else value, default=math.nan)
