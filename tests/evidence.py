"""The evidence of every claim on record, of its control too: how many cases, the worst of them, the tolerance.

    python -m tests.evidence    # records it anew in tests/data/evidence.json, after a change that is meant

A check that draws other cases, or compares with another bound, may still come out as recorded; its numbers do not.
"""

import json
import math
from pathlib import Path

from rhl.paper.claims import ledger
from rhl.paper.claims.claim import Effort, Judgement

RECORD = Path(__file__).resolve().parent / "data/evidence.json"
EFFORT = Effort(1, 10)
# Another processor rounds otherwise, which a run enlarges; below `ROUNDING` nothing else is left.
RTOL, ROUNDING = 1e-2, 1e-6
UNSTEADY = {"lemma-1.b"}  # whose control is as large as rounding makes it


def numbers(judgement: Judgement) -> list[float | None]:
    """Cases, worst and tolerance of every check of a claim, its control's too; a worst that is not finite is None."""
    found = [] if judgement.evidence is None else [judgement.evidence, *judgement.beside]
    return [
        value
        for each in found
        for value in (each.cases, each.worst if math.isfinite(each.worst) else None, each.tolerance)
    ]


def kept() -> dict[str, list[float | None]]:
    """The record."""
    return json.loads(RECORD.read_text(encoding="utf-8"))


def same(found: float | None, wanted: float | None) -> bool:
    """Whether two numbers agree as far as rounding allows."""
    if found is None or wanted is None:
        return found is wanted
    return math.isclose(found, wanted, rel_tol=RTOL, abs_tol=ROUNDING)


def drift(judgement: Judgement, effort: Effort) -> str:
    """What differs from the record, as a sentence; empty if nothing does, or if the record is of other cases."""
    id, record, found = judgement.claim.id, kept(), numbers(judgement)
    if effort != EFFORT or id not in record:
        return ""
    wanted, compared = record[id], 3 if id in UNSTEADY else None
    if len(found) == len(wanted) and all(map(same, found[:compared], wanted[:compared])):
        return ""
    return f"{id} gives {found}, on record is {wanted}"


def main() -> None:
    """Record every claim's evidence."""
    found = {row.claim.id: numbers(row) for row in ledger.run(ledger.CLAIMS, EFFORT)}
    lines = (f" {json.dumps(id)}: {json.dumps(values)}" for id, values in found.items())
    RECORD.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
