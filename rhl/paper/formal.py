"""Coq's results for the theorems in ``proofs/``, as recorded by ``make proofs``."""

from __future__ import annotations

import json
from dataclasses import dataclass
from importlib import resources

# What Coq says of a theorem that rests on no axiom.
CLOSED = "Closed under the global context"


@dataclass(frozen=True)
class Record:
    """The last run of ``make proofs``.

    Attributes
    ----------
    coq : str
        The version of Coq that checked the theorems.
    sources : dict
        The sha256 of each file that was checked, by its name.
    theorems : dict
        The axioms of each theorem according to Coq, by the theorem's file and name, such as "lemma_5.enough_weights".
    rejected : tuple of dict
        False statements that Coq rejected: "file", "what" was changed, and the line where it "stops".
    """

    coq: str
    sources: dict[str, str]
    theorems: dict[str, str]
    rejected: tuple[dict[str, str], ...]


def record() -> Record:
    """Return the record.

    Examples
    --------
    >>> record().theorems["lemma_5.enough_weights"]
    'Closed under the global context'
    """
    with resources.files("rhl.paper").joinpath("data", "proofs.json").open(encoding="utf-8") as file:
        kept = json.load(file)
    return Record(kept["coq"], kept["sources"], kept["theorems"], tuple(kept["rejected"]))


def proves(theorem: str) -> bool:
    """Whether the record says that Coq checked a theorem and that it rests on no axiom.

    Examples
    --------
    >>> proves("lemma_5.enough_weights"), proves("lemma_5.no_such_theorem")
    (True, False)
    """
    return record().theorems.get(theorem) == CLOSED


def anchor(theorem: str) -> str:
    """Return the anchor of a theorem on the page ``book/checked-by-machine.md``.

    Examples
    --------
    >>> anchor("lemma_5.enough_weights")
    'lemma-5-enough-weights'
    """
    return theorem.replace(".", "-").replace("_", "-")
