"""What rests on what: the ledger's graph is sound and complete, standings follow from it, and the picture shows it."""

import json
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest
from bs4 import BeautifulSoup

from rhl.errors import InputError
from rhl.paper import chain
from rhl.paper.chain_picture import address, as_table, crossings, layout, legend, name_of, names_of, picture
from rhl.paper.claims.claim import Claim, Judgement
from rhl.paper.claims.ledger import CLAIMS

ROOT = Path(__file__).resolve().parents[2]
PAPER = {"Assumption": 7, "Lemma": 6, "Theorem": 3, "Remark": 4}


def statuses(claims=CLAIMS):
    """As recorded; what really comes out is the business of other tests."""
    return {claim.id: Judgement(claim, claim.recorded, None, None, None, "", 0.0).status for claim in claims}


def claim(id, uses=(), item=None, **more):
    return Claim(
        id, item or f"Lemma {id}", "", "It holds.", reason="r", page="notebooks/p.ipynb", test="t", uses=uses, **more
    )


def absent(claims):
    """Assumptions, lemmas, theorems and remarks of the paper that are no node."""
    items = {each.item.split("(")[0] for each in chain.shown(claims)}
    return [f"{kind} {i}" for kind, count in PAPER.items() for i in range(1, count + 1) if f"{kind} {i}" not in items]


def anchors(page):
    """The places on a page of the sources that a link can lead to: headings, labels, names."""
    text = (ROOT / page).read_text(encoding="utf-8")
    if page.endswith(".ipynb"):
        cells = json.loads(text)["cells"]
        text = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")
    headings = re.findall(r"^#+ (.*)$", text, flags=re.MULTILINE)
    slugs = {re.sub(r"[^a-z0-9]+", "-", heading.lower()).strip("-") for heading in headings}
    labels = re.findall(r"^\(([\w-]+)\)=|^:(?:label|name): *([\w-]+)", text, flags=re.MULTILINE)
    return slugs | {one or other for one, other in labels}


def lost_proofs(claims):
    """Claims whose proof is on no page, or at no place of it."""
    found = []
    for each in claims:
        page, _, anchor = each.proof.partition("#")
        if each.proof and not ((ROOT / page).is_file() and anchor in anchors(page)):
            found.append(f"{each.id}: {each.proof}")
    return found


def test_the_ledger_rests_on_nothing_unknown_and_not_on_itself():
    order = [each.id for each in chain.in_order(CLAIMS)]
    assert sorted(order) == sorted(each.id for each in CLAIMS)
    place = {id: i for i, id in enumerate(order)}
    assert all(place[used] < place[each.id] for each in CLAIMS for used in each.uses)


@pytest.mark.parametrize(
    ("claims", "sentence"),
    [
        ([claim("1", ("2",))], "claim 1 must use claims of the ledger, got 2"),
        ([claim("1", ("2",)), claim("2", ("1",))], "must not use themselves, got .* <- "),
        ([claim("1", ("1",))], "must not use themselves"),
    ],
)
def test_graphs_that_cannot_be_are_refused(claims, sentence):
    with pytest.raises(InputError, match=sentence):
        chain.in_order(claims)


def test_every_item_of_the_paper_is_in_the_graph():
    assert absent(CLAIMS) == []
    assert absent([each for each in CLAIMS if not each.item.startswith("Lemma 3")]) == ["Lemma 3"]


def test_every_proof_is_where_the_ledger_says():
    assert lost_proofs(CLAIMS) == []
    assert sum(bool(each.proof) for each in CLAIMS) > 20
    proved = next(each for each in CLAIMS if each.proof)
    assert lost_proofs([replace(proved, proof="notebooks/06-lemma-2.ipynb#no-such-place")])
    assert lost_proofs([replace(proved, proof="notebooks/99-none.ipynb#the-proof")])


@pytest.mark.parametrize("id", ["lemma-1.a", "lemma-1.b", "lemma-2", "lemma-3"])
def test_lemmas_1_to_3_are_proved_here(id):
    assert statuses()[id] == "proved here"


def test_principal():
    assert chain.principal(claim("lemma-1.a", item="Lemma 1(a)"))
    assert chain.principal(claim("assumption-4b", item="Assumption 4(b)"))
    assert chain.principal(claim("theorem-1.star", item="Theorem 1*"))
    assert not chain.principal(claim("theorem-1.star.ends", item="Theorem 1*"))
    assert not chain.principal(claim("lemma-4.weak", item="Lemma 4"))


def test_steps_of_a_proof_and_results_that_carry_nothing_are_no_nodes():
    claims = [
        claim("theorem-1", ("theorem-1.step",), "Theorem 1"),
        claim("theorem-1.step", (), "Theorem 1"),
        claim("theorem-1.aside", ("lemma-2.other",), "Theorem 1"),
        claim("lemma-2.part", (), "Lemma 2"),
        claim("lemma-2.other", (), "Lemma 2"),
        claim("theorem-2", ("eq-9",), "Theorem 2"),
        claim("eq-9", ("lemma-2.part",), "Equation 9"),
    ]
    assert [each.id for each in chain.shown(claims)] == ["theorem-1", "lemma-2.part", "theorem-2"]


def test_equations_are_folded_into_what_uses_them():
    claims = [
        claim("assumption-3", item="Assumption 3", kind="hypothesis"),
        claim("eq-9", ("assumption-3",), "Equation 9"),
        claim("eq-10", ("eq-9",), "Equation 10"),
        claim("lemma-1", ("eq-10",), "Lemma 1"),
        claim("lemma-1.step", (), "Lemma 1"),
        claim("lemma-1.part", (), "Lemma 1"),
        claim("lemma-2", ("lemma-1", "lemma-1.part"), "Lemma 2"),
    ]
    assert chain.folded(claims) == {
        "assumption-3": (),
        "lemma-1": ("assumption-3",),
        "lemma-1.part": (),
        "lemma-2": ("lemma-1", "lemma-1.part"),
    }


def standing_of(status, *below, proof="", kind="statement"):
    """The standing of a claim with this status on claims of these (status, proof)."""
    claims = [claim(str(i), proof=proved) for i, (_, proved) in enumerate(below)]
    claims.append(
        claim("top", tuple(map(str, range(len(below)))) if kind == "statement" else (), proof=proof, kind=kind)
    )
    said = {str(i): each for i, (each, _) in enumerate(below)} | {"top": status}
    return chain.standings(claims, said)["top"]


@pytest.mark.parametrize(
    ("status", "below", "standing"),
    [
        ("proved here", [], "stands"),
        ("machine-checked", [("proved here", "p#a")], "stands"),
        ("proved here", [("holds once corrected", "p#a")], "stands"),
        ("proved here", [("holds once corrected", "")], "tried"),
        ("proved here", [("holds on all cases tried", "")], "tried"),
        ("proved here", [("proved here", "p#a"), ("fails: counterexample", "")], "undermined"),
        ("holds on all cases tried", [("fails: counterexample", "p#a")], "undermined"),
        ("holds once corrected", [("proved here", "p#a")], "corrected"),
        ("holds once corrected", [("fails: counterexample", "")], "undermined"),
        ("holds on all cases tried", [("proved here", "p#a")], "tried"),
        ("fails: counterexample", [("proved here", "p#a")], "fails"),
        ("fails: counterexample", [("fails: counterexample", "")], "fails"),
        ("no evidence", [], "open"),
        ("proved here", [("no evidence", "")], "open"),
    ],
)
def test_standings(status, below, standing):
    assert standing_of(status, *below, proof="p#a" if status in ("proved here", "machine-checked") else "") == standing


def test_what_is_assumed_takes_nothing_down():
    assert standing_of("cannot be checked", kind="hypothesis") == "given"
    claims = [claim("a", kind="hypothesis"), claim("b", ("a",), proof="p#a")]
    assert chain.standings(claims, {"a": "cannot be checked", "b": "proved here"})["b"] == "stands"


def test_a_failure_far_below_is_seen_at_the_top():
    claims = [claim("1"), *(claim(str(i), (str(i - 1),), proof="p#a") for i in range(2, 6))]
    said = {str(i): "proved here" for i in range(2, 6)} | {"1": "fails: counterexample"}
    found = chain.standings(claims, said)
    assert [found[str(i)] for i in range(1, 6)] == ["fails", *["undermined"] * 4]
    assert chain.standings(claims, said | {"1": "proved here"})["5"] == "stands"


def test_green_only_on_green():
    """In the ledger as it is: what is green rests on nothing that fails and on nothing that was only tried."""
    nodes = {node.claim.id: node for node in chain.graph(CLAIMS, statuses())}
    green = [node for node in nodes.values() if node.standing == "stands"]
    assert len(green) > 3
    assert {nodes[id].standing for node in green for id in node.uses} <= {"given", "stands", "corrected"}
    down = [node for node in nodes.values() if node.standing == "undermined"]
    assert all(
        any(nodes[id].standing == "fails" for id in chain.ancestors(nodes.values(), node.claim.id)) for node in down
    )


def test_arrows_leave_out_what_others_show():
    claims = [claim("1"), claim("2", ("1",)), claim("3", ("1", "2"))]
    claims = [replace(each, id=f"lemma-{each.id}", uses=tuple(f"lemma-{id}" for id in each.uses)) for each in claims]
    nodes = chain.graph(claims, {each.id: "cannot be checked" for each in claims})
    assert [node.layer for node in nodes] == [0, 1, 2]
    assert chain.arrows(nodes) == [("lemma-1", "lemma-2"), ("lemma-2", "lemma-3")]
    assert chain.ancestors(nodes, "lemma-3") == {"lemma-1", "lemma-2", "lemma-3"}


def test_boxes_stand_apart_and_above_what_uses_them():
    nodes = chain.graph(CLAIMS, statuses())
    plan = layout(nodes)
    joined = {id for pair in chain.arrows(nodes) for id in pair}
    assert set(plan.boxes) == joined
    rows = {}
    for left, top, width in plan.boxes.values():
        assert left >= 0
        assert left + width <= plan.width
        rows.setdefault(top, []).append((left, left + width))
    for row in rows.values():
        row.sort()
        assert all(one[1] < other[0] for one, other in pairwise(row))
    for (used, user), route in plan.routes.items():
        assert plan.boxes[used][1] < plan.boxes[user][1]
        assert [y for _, y in route] == sorted(y for _, y in route)


def test_crossings():
    layers = [["a", "b"], ["c", "d"]]
    assert crossings(layers, [("a", "c"), ("b", "d")]) == 0
    assert crossings(layers, [("a", "d"), ("b", "c")]) == 1


def test_picture_and_table_say_the_same():
    nodes = chain.graph(CLAIMS, statuses())
    drawn, rows = (BeautifulSoup(text, "html.parser") for text in (picture(nodes), as_table(nodes)))
    arrows = {(arrow["data-from"], arrow["data-to"]) for arrow in drawn.select(".arrow")}
    assert arrows == set(chain.arrows(nodes))
    by_id = {row["data-id"]: row for row in rows.select("tbody tr")}
    assert set(by_id) == {node.claim.id for node in nodes}
    for box in drawn.select("a.node"):
        row = by_id[box["data-id"]]
        assert box["href"] == row.select_one("a")["href"]
        assert box["aria-label"].startswith(row.select_one("a").text)
        assert row.select_one(".standing")["class"][1] == box["class"][1]
    for node in nodes:
        used = [link["href"] for link in by_id[node.claim.id].select("td:last-child a")]
        assert used == [f"#row-{id}" for id in node.uses]
    assert set(re.findall(r'class="(\w+)"', legend(nodes))) == {node.standing for node in nodes}
    assert legend([]) == '<ul class="chain-legend"></ul>'


@pytest.mark.parametrize(
    ("id", "item", "names"),
    [
        ("lemma-4.weak", "Lemma 4", ("Lemma 4", "weak")),
        ("lemma-1.a", "Lemma 1(a)", ("Lemma 1(a)", "")),
        ("assumption-5.implies", "Assumption 5", ("Assumption 5", "implies")),
        ("theorem-2.i.weak", "Theorem 2(i)", ("Theorem 2(i)", "weak")),
        ("theorem-1.star", "Theorem 1*", ("Theorem 1*", "")),
        ("theorem-1.star.ends", "Theorem 1*", ("Theorem 1*", "ends")),
        ("theorem-1.one-step", "Theorem 1", ("Theorem 1", "one step")),
    ],
)
def test_names(id, item, names):
    assert names_of(claim(id, item=item)) == names
    assert name_of(claim(id, item=item)) == ": ".join(filter(None, names))


def test_boxes_lead_to_proofs():
    assert address(claim("1")) == "../notebooks/p.html"
    assert address(claim("1", proof="notebooks/q.ipynb#here")) == "../notebooks/q.html#here"


def test_claims_without_a_status_and_nodes_that_are_not_there():
    statuses = dict.fromkeys((claim.id for claim in CLAIMS), "proved here")
    nodes = chain.graph(CLAIMS, statuses)
    with pytest.raises(InputError, match=f"statuses must have one for each claim, got none for {CLAIMS[0].id}$"):
        chain.graph(CLAIMS, {id: status for id, status in statuses.items() if id != CLAIMS[0].id})
    with pytest.raises(InputError, match="nodes must hold every id that is asked for or used, got none for lemma-99"):
        chain.ancestors(nodes, "lemma-99")
    used = next(node for node in nodes if node.uses)
    with pytest.raises(InputError, match=f"got none for .*{used.uses[0]}"):
        chain.ancestors([node for node in nodes if node.claim.id != used.uses[0]], used.claim.id)
    assert used.uses[0] in chain.ancestors(nodes, used.claim.id)
