"""The findings of a diagnosis, each with a verdict and a sentence."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from rhl._checks import choice

Verdict = Literal["met", "violated", "suspect", "outside", "note"]


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

    def __str__(self) -> str:
        return "\n".join(f"{finding.verdict:9} {finding.subject}: {finding.says}" for finding in self.findings)
