"""The list of all claims, and the function that runs them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from difflib import get_close_matches
from fnmatch import fnmatchcase
from typing import Any

from rhl.errors import InputError
from rhl.paper.claims import (
    assumption_4,
    assumption_5,
    certified,
    lemma_1,
    lemma_2,
    lemma_2_proof,
    lemma_3,
    lemma_4,
    lemma_5,
    lemma_6,
    remark_1,
    simulations,
    theorem_1,
    theorem_1_star,
    theorem_2,
    theorem_2_iii,
    theorem_3,
    theorem_3_prime,
    theorem_4,
)
from rhl.paper.claims.claim import Claim, Effort, Judgement, judge

VERSION = 2

# In reading order.
CLAIMS: tuple[Claim, ...] = tuple(
    claim
    for module in (
        assumption_4,
        remark_1,
        lemma_1,
        lemma_2,
        lemma_2_proof,
        lemma_3,
        theorem_1,
        assumption_5,
        theorem_1_star,
        lemma_4,
        lemma_5,
        theorem_2,
        theorem_2_iii,
        lemma_6,
        theorem_3,
        theorem_3_prime,
        theorem_4,
        simulations,
        certified,
    )
    for claim in module.CLAIMS
)

# In versions without Lemma 1 the search is "Lemma 4".
ALIASES = {"lambda-search": "lemma-5", "brief-lemma-4": "lemma-5"}


def select(ids: Sequence[str]) -> list[Claim]:
    """Return the claims of these ids, in the ledger's order; all if none is given.

    An id may be a pattern, such as "certified.*", for all claims whose ids it matches. InputError if an id is not in
    the ledger, or a pattern matches none.
    """
    wanted = [ALIASES.get(id, id) for id in ids]
    unknown = sorted({id for id in wanted if not any(fnmatchcase(claim.id, id) for claim in CLAIMS)})
    if unknown:
        ids = [claim.id for claim in CLAIMS]
        near = [_near(id.lower().replace(" ", "-"), ids) for id in unknown]
        hint = f"; did you mean {', '.join(filter(None, near))}?" if any(near) else ""
        raise InputError(
            f"ID must be one of the ledger's ('rhl verify --list' shows them), got {', '.join(unknown)}{hint}"
        )
    return [claim for claim in CLAIMS if not wanted or any(fnmatchcase(claim.id, id) for id in wanted)]


def _near(id: str, ids: list[str]) -> str:
    """Return the pattern for all claims of a result, or else the id that is most alike; empty if none is."""
    if any(other.startswith(f"{id}.") for other in ids):
        return f"'{id}.*'"
    return next(iter(get_close_matches(id, ids, 1)), "")


def of_page(name: str) -> list[Claim]:
    """Return the claims whose page is the notebook of this name, such as "05-lemma-1"; InputError if there is none."""
    found = [claim for claim in CLAIMS if claim.page == f"notebooks/{name}.ipynb"]
    if not found:
        raise InputError(f"name must be that of a notebook with claims, such as '05-lemma-1', got {name!r}")
    return found


def run(
    claims: Iterable[Claim], effort: Effort, progress: Callable[[Judgement], None] | None = None
) -> list[Judgement]:
    """Check claims one after the other. ``progress``: called with each judgement."""
    judgements = []
    for claim in claims:
        judgements.append(judge(claim, effort))
        if progress is not None:
            progress(judgements[-1])
    return judgements


def as_json(judgements: Iterable[Judgement], effort: Effort, *, asked: int | None = None) -> dict[str, Any]:
    """Return judgements in the form that ``rhl verify --json`` writes.

    ``asked``: how many claims were to be checked; "complete" says whether all were.
    """
    claims = [_entry(judgement) for judgement in judgements]
    complete = asked is None or len(claims) == asked
    return {"version": VERSION, "seed": effort.seed, "cases": effort.cases, "complete": complete, "claims": claims}


def listed(claims: Iterable[Claim]) -> dict[str, Any]:
    """Return claims without judgements in the form that ``rhl verify --list --json`` writes."""
    names = ("id", "item", "label", "statement", "method", "recorded", "kind", "page", "test")
    return {"version": VERSION, "claims": [{name: getattr(claim, name) for name in names} for claim in claims]}


def _entry(judgement: Judgement) -> dict[str, Any]:
    claim, evidence = judgement.claim, judgement.evidence
    # JSON has neither NaN nor infinity.
    worst = evidence.worst if evidence and math.isfinite(evidence.worst) else None
    return {
        "id": claim.id,
        "item": claim.item,
        "label": claim.label,
        "statement": claim.statement,
        "method": claim.method,
        "cases": evidence.cases if evidence else 0,
        "worst": worst,
        "tolerance": evidence.tolerance if evidence else None,
        "verdict": judgement.verdict,
        "status": judgement.status,
        "as_recorded": judgement.as_recorded,
        "problem": judgement.problem,
        "reason": claim.reason,
        "control": {"what": claim.control.what, "tripped": judgement.tripped} if claim.control else None,
        "instance": {"what": claim.instance.what, "holds": judgement.told_apart} if claim.instance else None,
        "kind": claim.kind,
        "uses": list(claim.uses),
        "proof": claim.proof,
        "formal": claim.formal,
        "page": claim.page,
        "test": claim.test,
        "seconds": round(judgement.seconds, 3),
    }
