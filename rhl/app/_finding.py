"""The findings of a diagnosis, each with a verdict and a sentence."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from rhl._checks import choice

Verdict = Literal["met", "violated", "suspect", "outside", "note"]
# Their meaning, for a reader.
VERDICTS: dict[Verdict, str] = {
    "met": "holds, in this run or for this plant and scheme",
    "violated": "does not hold",
    "suspect": "not decidable, but the numbers speak against it",
    "outside": "not covered by the theory",
    "note": "a number for information",
}
# Words of the paper in subjects and sentences, with their meaning.
TERMS: dict[str, str] = {
    "N_y": "N_y, N_v: the numbers of past values of outputs and of inputs that x(k) and u(k) stack; m: the smaller",
    "spectral radius": "spectral radius: the largest modulus of an eigenvalue of F",
    "observability index": "observability index: how many values of the outputs in a row determine the state",
    "augmented pair": "lifted pair: the model of x(k) and u(k); augmented pair: the same with past inputs as states",
    "inf s+": "s+: the smallest nonzero singular value of the map from planned inputs to planned states",
    "V1": "V1: the problem that plans; its weight Gamma(x)/epsilon(k) draws the end of a plan to zero",
    "of its minimiser": "certificate: Newton's step from an estimate, relative to the model",
}


@dataclass(frozen=True)
class Finding:
    """The result of one check.

    Attributes
    ----------
    subject : str
        What was checked, with the paper's name for it.
    verdict : {"met", "violated", "suspect", "outside", "note"}
        suspect: not decidable, but the numbers speak against it. outside: the theory does not cover it. note: a
        number for information.
    says : str
        A sentence or two, with numbers.
    """

    subject: str
    verdict: Verdict
    says: str

    def __post_init__(self) -> None:
        choice("verdict", self.verdict, get_args(Verdict))


@dataclass(frozen=True)
class Diagnosis:
    """All findings, with the most basic assumptions first."""

    findings: tuple[Finding, ...]

    @property
    def sound(self) -> bool:
        """Whether nothing is violated or suspect."""
        return not any(finding.verdict in ("violated", "suspect") for finding in self.findings)

    def legend(self) -> list[str]:
        """Return the meaning of the verdicts and of the words that occur in the findings, one on each line."""
        text = "\n".join(f"{finding.subject}\n{finding.says}" for finding in self.findings)
        given = {finding.verdict for finding in self.findings}
        verdicts = [f"{verdict}: {meaning}" for verdict, meaning in VERDICTS.items() if verdict in given]
        return verdicts + [meaning for word, meaning in TERMS.items() if word in text]

    def __str__(self) -> str:
        return "\n".join(f"{finding.verdict:9} {finding.subject}: {finding.says}" for finding in self.findings)
