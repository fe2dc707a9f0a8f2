"""What rests on what: the graph of statements and their uses in proofs, from the ledger.

Equations, steps of a proof, examples and definitions are not nodes. They are folded: a proof that uses one of them uses
the nodes behind it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from typing import Literal

from rhl.errors import InputError
from rhl.paper.claims.claim import Claim, Status

Standing = Literal["given", "stands", "corrected", "tried", "fails", "undermined", "open"]

# The standings, with their meaning for a reader.
STANDINGS: dict[Standing, str] = {
    "given": "assumed",
    "stands": "proved, like everything that its proof uses",
    "corrected": "holds once corrected",
    "tried": "holds on all cases tried, or uses a statement that was only tried",
    "fails": "fails: counterexample",
    "undermined": "uses a statement that fails",
    "open": "cannot be checked, or uses a statement that cannot",
}

_SHOWN = ("Assumption", "Lemma", "Theorem", "Remark")


@dataclass(frozen=True)
class Node:
    """A statement in the graph.

    Attributes
    ----------
    claim : Claim
        The statement and its proof.
    status : Status
        The status from its own checks and its proof.
    standing : Standing
        The status given everything that it uses.
    uses : tuple of str
        The ids of the nodes that its proof uses, directly or through folded claims.
    layer : int
        Zero if it uses no node, else one more than the largest layer among those it uses.
    """

    claim: Claim
    status: Status
    standing: Standing
    uses: tuple[str, ...]
    layer: int


def principal(claim: Claim) -> bool:
    """Whether a claim is an item itself, such as "lemma-1.a" for Lemma 1(a), and not a further result about it.

    This project's own items have marks, as in "Theorem 1*" and "Theorem 3'".
    """
    if claim.item.endswith(("*", "'")):
        return claim.id.count(".") == 1
    plain = ["".join(filter(str.isalnum, words)).lower() for words in (claim.id, claim.item)]
    return plain[0] == plain[1]


def shown(claims: Sequence[Claim]) -> list[Claim]:
    """Return the claims that are nodes: assumptions, lemmas, theorems, remarks and claims that support them.

    A supporting claim is one on a lemma or theorem that the proof of another item uses. Steps of one proof, and results
    that no item uses, are left out.
    """
    by_id = {claim.id: claim for claim in claims}
    items = [claim for claim in claims if claim.item.startswith(_SHOWN) and principal(claim)]
    carrying: set[str] = set()
    waiting = [claim.id for claim in items]
    while waiting:
        id = waiting.pop()
        if id not in carrying:
            carrying.add(id)
            waiting += [used for used in by_id[id].uses if used in by_id]
    elsewhere = {
        used
        for id in carrying
        for used in by_id[id].uses
        if used in by_id and by_id[used].item.startswith(_SHOWN) and _family(by_id[used]) != _family(by_id[id])
    }
    kept = elsewhere | {claim.id for claim in items}
    return [claim for claim in claims if claim.id in kept]


def _family(claim: Claim) -> str:
    """Return the item without its parts and marks: "Theorem 2" of Theorem 2(iii)."""
    return claim.item.partition("(")[0].rstrip("*'")


def in_order(claims: Sequence[Claim]) -> list[Claim]:
    """Return claims in an order in which each comes after all that it uses.

    InputError if one uses an unknown claim, or if uses form a cycle.
    """
    by_id = {claim.id: claim for claim in claims}
    for claim in claims:
        unknown = sorted(set(claim.uses) - set(by_id))
        if unknown:
            raise InputError(f"claim {claim.id} must use claims of the ledger, got {', '.join(unknown)}")
    try:
        order = list(TopologicalSorter({claim.id: claim.uses for claim in claims}).static_order())
    except CycleError as error:
        raise InputError(f"claims must not use themselves, got {' <- '.join(error.args[1])}") from None
    return [by_id[id] for id in order]


def folded(claims: Sequence[Claim]) -> dict[str, tuple[str, ...]]:
    """Return for each node the nodes that its proof uses, directly or through folded claims."""
    order = in_order(claims)
    nodes = {claim.id for claim in shown(claims)}
    reached: dict[str, set[str]] = {}
    for claim in order:
        reached[claim.id] = set().union(*({id} if id in nodes else reached[id] for id in claim.uses))
    return {claim.id: tuple(each.id for each in claims if each.id in reached[claim.id]) for claim in shown(claims)}


def standings(claims: Sequence[Claim], statuses: Mapping[str, Status]) -> dict[str, Standing]:
    """Return each claim's standing given everything that it uses, including folded claims.

    It "stands" if it is proved as printed from assumed or proved claims only. A corrected statement does not hold as
    printed; claims that use it use the corrected form, which does not weaken them if that form is proved.
    """
    without = [claim.id for claim in claims if claim.id not in statuses]
    if without:
        raise InputError(f"statuses must have one for each claim, got none for {', '.join(without)}")
    found: dict[str, Standing] = {}
    sound: set[str] = set()
    for claim in in_order(claims):
        status, used = statuses[claim.id], set(claim.uses)
        below = {found[id] for id in used}
        proved = status in ("proved here", "machine-checked") or (
            status == "holds once corrected" and bool(claim.proof)
        )
        if proved and used <= sound:
            sound.add(claim.id)
        if claim.kind != "statement":
            found[claim.id] = "given"
            sound.add(claim.id)
        elif status == "fails: counterexample":
            found[claim.id] = "fails"
        elif status in ("cannot be checked", "no evidence"):
            found[claim.id] = "open"
        elif below & {"fails", "undermined"}:
            found[claim.id] = "undermined"
        elif "open" in below:
            found[claim.id] = "open"
        elif status == "holds once corrected":
            found[claim.id] = "corrected"
        else:
            found[claim.id] = "stands" if claim.id in sound else "tried"
    return found


def graph(claims: Sequence[Claim], statuses: Mapping[str, Status]) -> list[Node]:
    """Return the nodes, each after all that it uses. ``statuses``: those of all claims, by id.

    InputError if a claim has no status, or as from ``in_order``.
    """
    uses, left = folded(claims), standings(claims, statuses)
    layers: dict[str, int] = {}
    nodes = []
    for claim in in_order(claims):
        if claim.id in uses:
            layers[claim.id] = 1 + max((layers[id] for id in uses[claim.id]), default=-1)
            nodes.append(Node(claim, statuses[claim.id], left[claim.id], uses[claim.id], layers[claim.id]))
    return nodes


def ancestors(nodes: Iterable[Node], id: str) -> set[str]:
    """Return the ids of all nodes that this one uses, directly or not, including itself.

    InputError if a node is not there.
    """
    uses = {node.claim.id: node.uses for node in nodes}
    unknown = sorted(({id} | {used for of in uses.values() for used in of}) - set(uses))
    if unknown:
        raise InputError(f"nodes must hold every id that is asked for or used, got none for {', '.join(unknown)}")
    found, waiting = set(), [id]
    while waiting:
        one = waiting.pop()
        if one not in found:
            found.add(one)
            waiting += uses[one]
    return found


def arrows(nodes: Sequence[Node]) -> list[tuple[str, str]]:
    """Return the pairs (used, user) to draw, without those implied by a path through other nodes."""
    above = {node.claim.id: ancestors(nodes, node.claim.id) for node in nodes}
    return [
        (id, node.claim.id)
        for node in nodes
        for id in node.uses
        if not any(id in above[other] for other in node.uses if other != id)
    ]
