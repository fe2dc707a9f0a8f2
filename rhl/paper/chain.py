"""What rests on what: the graph of statements and of what their proofs use, read off the ledger.

Equations, steps of a proof, examples and definitions are no nodes. They are folded: where a proof uses one of them, it
uses what that one rests on.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from typing import Literal

from rhl.errors import InputError
from rhl.paper.claims.claim import Claim, Status

Standing = Literal["given", "stands", "corrected", "tried", "fails", "undermined", "open"]

# From a hypothesis to what fails, with what each means to a reader.
STANDINGS: dict[Standing, str] = {
    "given": "assumed",
    "stands": "proved, and so is all that it rests on",
    "corrected": "holds once corrected",
    "tried": "holds on all cases tried, or rests on what was only tried",
    "fails": "fails: counterexample",
    "undermined": "rests on what fails",
    "open": "cannot be checked, or rests on what cannot",
}

_SHOWN = ("Assumption", "Lemma", "Theorem", "Remark")


@dataclass(frozen=True)
class Node:
    """A statement in the graph.

    Attributes
    ----------
    claim : Claim
        What it says, and where it is proved.
    status : Status
        What its own checks and its proof say.
    standing : Standing
        What is left of that with all that it rests on.
    uses : tuple of str
        The ids of the nodes that its proof uses, directly or by way of folded claims.
    layer : int
        Zero where it uses no node, else one more than the largest among those that it uses.
    """

    claim: Claim
    status: Status
    standing: Standing
    uses: tuple[str, ...]
    layer: int


def principal(claim: Claim) -> bool:
    """Whether a claim is an item itself, such as "lemma-1.a" for Lemma 1(a), and not something further on it.

    This project's own items are marked as they are in mathematics: "Theorem 1*", "Theorem 3'".
    """
    if claim.item.endswith(("*", "'")):
        return claim.id.count(".") == 1
    plain = ["".join(filter(str.isalnum, words)).lower() for words in (claim.id, claim.item)]
    return plain[0] == plain[1]


def shown(claims: Sequence[Claim]) -> list[Claim]:
    """Return the claims that are nodes: assumptions, lemmas, theorems and remarks, and what carries them.

    That is, of what the items rest on, the claims on lemmas and theorems that the proof of another item uses. Steps of
    one proof, and results on which no item rests, are left out.
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
    """Return claims so that each comes after all that it uses.

    InputError if one uses what is not there, or if they go round in a circle.
    """
    by_id = {claim.id: claim for claim in claims}
    for claim in claims:
        unknown = sorted(set(claim.uses) - set(by_id))
        if unknown:
            raise InputError(f"claim {claim.id} must use claims of the ledger, got {', '.join(unknown)}")
    try:
        order = list(TopologicalSorter({claim.id: claim.uses for claim in claims}).static_order())
    except CycleError as error:
        raise InputError(f"claims must not rest on themselves, got {' <- '.join(error.args[1])}") from None
    return [by_id[id] for id in order]


def folded(claims: Sequence[Claim]) -> dict[str, tuple[str, ...]]:
    """Return for each node the nodes that its proof uses, through the claims that are none."""
    order = in_order(claims)
    nodes = {claim.id for claim in shown(claims)}
    reached: dict[str, set[str]] = {}
    for claim in order:
        reached[claim.id] = set().union(*({id} if id in nodes else reached[id] for id in claim.uses))
    return {claim.id: tuple(each.id for each in claims if each.id in reached[claim.id]) for claim in shown(claims)}


def standings(claims: Sequence[Claim], statuses: Mapping[str, Status]) -> dict[str, Standing]:
    """Return what is left of each claim's status with all that it rests on, folded claims included.

    It "stands" where it is proved, as printed, on nothing but what is assumed or proved. A corrected statement does not
    hold as printed; what uses it uses the corrected form, and loses nothing by it if that form is proved.
    """
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
    """Return the nodes, each after all that it uses. ``statuses``: of all claims, by id."""
    uses, left = folded(claims), standings(claims, statuses)
    layers: dict[str, int] = {}
    nodes = []
    for claim in in_order(claims):
        if claim.id in uses:
            layers[claim.id] = 1 + max((layers[id] for id in uses[claim.id]), default=-1)
            nodes.append(Node(claim, statuses[claim.id], left[claim.id], uses[claim.id], layers[claim.id]))
    return nodes


def ancestors(nodes: Iterable[Node], id: str) -> set[str]:
    """Return the ids of all nodes that this one rests on, itself included."""
    uses = {node.claim.id: node.uses for node in nodes}
    found, waiting = set(), [id]
    while waiting:
        one = waiting.pop()
        if one not in found:
            found.add(one)
            waiting += uses[one]
    return found


def arrows(nodes: Sequence[Node]) -> list[tuple[str, str]]:
    """Return the pairs (used, user) to draw: those that no longer way through other nodes already shows."""
    above = {node.claim.id: ancestors(nodes, node.claim.id) for node in nodes}
    return [
        (id, node.claim.id)
        for node in nodes
        for id in node.uses
        if not any(id in above[other] for other in node.uses if other != id)
    ]
