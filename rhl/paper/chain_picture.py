"""The graph of `rhl.paper.chain` as a picture and as a table, both HTML for a page in ``book/``."""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from rhl.paper.chain import STANDINGS, Node, Standing, arrows
from rhl.paper.claims.claim import Claim
from rhl.paper.listing import seen_from_book
from rhl.paper.pages import readable

# In CSS pixels of an unscaled picture; text has heights 13 and 11.
_HEIGHT, _BETWEEN, _GAP, _MARGIN = 56, 44, 7, 4
_NAME, _WORD, _LEAST = 6.8, 6.0, 70

# The text in a box below its name, shorter than the legend.
_WORDS: dict[Standing, str] = {
    "given": "assumed",
    "stands": "proved",
    "corrected": "once corrected",
    "tried": "tried",
    "fails": "fails",
    "undermined": "uses one that fails",
    "open": "open",
}


def names_of(claim: Claim) -> tuple[str, str]:
    """Return a node's name: the paper's item and the id's addition to it, as in ("Lemma 4", "weak")."""
    plain = "".join(filter(str.isalnum, claim.item)).lower()
    rest = claim.id
    while plain and rest:
        if rest[0] == plain[0]:
            plain = plain[1:]
        elif rest[0].isalnum():
            break
        rest = rest[1:]
    rest = rest.strip(".-")
    if claim.item.endswith(("*", "'")):
        rest = rest.partition(".")[2]  # the name already contains "star" or "prime"
    return claim.item, rest.replace("-", " ").replace(".", ", ")


def name_of(claim: Claim) -> str:
    """Return the name as one string: "Lemma 4: weak"."""
    return ": ".join(filter(None, names_of(claim)))


def said(node: Node) -> str:
    """Return a node's standing in a few words."""
    return "machine-checked" if node.standing == "stands" and node.claim.formal else _WORDS[node.standing]


def address(claim: Claim) -> str:
    """Return the address of a claim's proof, or else of its page, relative to ``book/``."""
    return seen_from_book(claim.proof or claim.page)


def _lines(node: Node) -> list[str]:
    """Return the small text below a node's name."""
    return [*filter(None, [names_of(node.claim)[1]]), said(node)]


@dataclass(frozen=True)
class Layout:
    """The positions of boxes and arrows.

    ``boxes``: left, top and width of each node. ``routes``: the points through which each arrow runs, top to bottom.
    """

    boxes: dict[str, tuple[float, float, float]]
    routes: dict[tuple[str, str], list[tuple[float, float]]]
    width: float
    height: float


def layout(nodes: Sequence[Node]) -> Layout:
    """Place nodes in layers, used ones above users, with few crossings and short arrows.

    Nodes without arrows have no position. Long arrows have a position in each layer between.
    """
    pairs = arrows(nodes)
    joined = {id for pair in pairs for id in pair}
    nodes = [node for node in nodes if node.claim.id in joined]
    rank = {node.claim.id: node.layer for node in nodes}
    for node in nodes:
        # A node that uses none goes as near as possible to its users.
        users = [rank[user] for used, user in pairs if used == node.claim.id]
        if not node.uses and users:
            rank[node.claim.id] = min(users) - 1
    widths: dict[str, float] = {
        node.claim.id: max(_LEAST, 12 + _NAME * len(node.claim.item), 12 + _WORD * max(map(len, _lines(node))))
        for node in nodes
    }
    layers: list[list[str]] = [[] for _ in range(max(rank.values()) + 1)]
    for node in nodes:
        layers[rank[node.claim.id]].append(node.claim.id)
    chains: dict[tuple[str, str], list[str]] = {}
    links: list[tuple[str, str]] = []
    for used, user in pairs:
        stops = [used]
        for between in range(rank[used] + 1, rank[user]):
            stop = f"{used} > {user} @ {between}"
            widths[stop] = 2.0
            layers[between].append(stop)
            stops.append(stop)
        chains[used, user] = [*stops, user]
        links += pairwise(chains[used, user])
    layers = _untangled(layers, links)
    centres = _spread(layers, links, widths)
    left = min(centres[id] - widths[id] / 2 for id in centres)
    top = {id: _MARGIN + i * (_HEIGHT + _BETWEEN) for i, layer in enumerate(layers) for id in layer}
    x = {id: centre - left + _MARGIN for id, centre in centres.items()}
    routes = {}
    for pair, stops in chains.items():
        first, last = stops[0], stops[-1]
        through = [(x[id], top[id] + dy) for id in stops[1:-1] for dy in (0.0, float(_HEIGHT))]
        routes[pair] = [(x[first], float(top[first] + _HEIGHT)), *through, (x[last], float(top[last]))]
    boxes = {
        node.claim.id: (x[node.claim.id] - widths[node.claim.id] / 2, float(top[node.claim.id]), widths[node.claim.id])
        for node in nodes
    }
    width = max(x[id] + widths[id] / 2 for id in x) + _MARGIN
    return Layout(boxes, routes, width, len(layers) * (_HEIGHT + _BETWEEN) - _BETWEEN + 2 * _MARGIN)


def crossings(layers: Sequence[Sequence[str]], links: Sequence[tuple[str, str]]) -> int:
    """Count the pairs of links between neighbouring layers that cross."""
    place = {id: (i, j) for i, layer in enumerate(layers) for j, id in enumerate(layer)}
    ends: dict[int, list[tuple[int, int]]] = {}
    for above, below in links:
        ends.setdefault(place[above][0], []).append((place[above][1], place[below][1]))
    return sum((a - c) * (b - d) < 0 for group in ends.values() for i, (a, b) in enumerate(group) for c, d in group[:i])


def _untangled(layers: list[list[str]], links: Sequence[tuple[str, str]]) -> list[list[str]]:
    """Order each layer by the mean positions of its neighbours, downwards and upwards in turn; keep the best."""
    above: dict[str, list[str]] = {}
    below: dict[str, list[str]] = {}
    for one, other in links:
        below.setdefault(one, []).append(other)
        above.setdefault(other, []).append(one)
    best = [list(layer) for layer in layers]
    now = [list(layer) for layer in layers]
    for sweep in range(40):
        linked = above if sweep % 2 == 0 else below
        for i in range(len(now)) if sweep % 2 == 0 else reversed(range(len(now))):
            share = {id: j / max(1, len(layer) - 1) for layer in now for j, id in enumerate(layer)}
            mean = {
                id: sum(share[other] for other in linked[id]) / len(linked[id]) if id in linked else share[id]
                for id in now[i]
            }
            now[i].sort(key=mean.__getitem__)
        if crossings(now, links) < crossings(best, links):
            best = [list(layer) for layer in now]
    return best


def _spread(
    layers: Sequence[Sequence[str]], links: Sequence[tuple[str, str]], widths: dict[str, float]
) -> dict[str, float]:
    """Return the centre of each entry, as near to the mean of its neighbours as order and widths allow.

    No layer is wider than the least width of the widest one.
    """
    room = max(sum(widths[id] + _GAP for id in layer) - _GAP for layer in layers)
    linked: dict[str, list[str]] = {id: [] for layer in layers for id in layer}
    for one, other in links:
        linked[one].append(other)
        linked[other].append(one)
    centres: dict[str, float] = {}
    for layer in layers:
        at = (room - sum(widths[id] + _GAP for id in layer)) / 2
        for id in layer:
            centres[id] = at + widths[id] / 2
            at += widths[id] + _GAP
    for sweep in range(60):
        for layer in layers if sweep % 2 == 0 else reversed(layers):
            wanted = [
                sum(centres[other] for other in linked[id]) / len(linked[id]) if linked[id] else centres[id]
                for id in layer
            ]
            centres |= zip(layer, _apart(wanted, [widths[id] for id in layer], room), strict=True)
    return centres


def _apart(wanted: Sequence[float], widths: Sequence[float], room: float) -> list[float]:
    """Return positions in [0, room], nearest to the wanted ones in the sum of squares, that keep order and distance."""
    if not wanted:
        return []
    offset = [widths[0] / 2]
    for one, other in pairwise(widths):
        offset.append(offset[-1] + (one + other) / 2 + _GAP)
    blocks: list[tuple[float, int]] = []
    for place, shift in zip(wanted, offset, strict=True):
        mean, count = place - shift, 1
        while blocks and blocks[-1][0] > mean:
            last, many = blocks.pop()
            mean, count = (mean * count + last * many) / (count + many), count + many
        blocks.append((mean, count))
    most = room - offset[-1] - widths[-1] / 2
    places = [min(max(mean, 0.0), most) for mean, count in blocks for _ in range(count)]
    return [place + shift for place, shift in zip(places, offset, strict=True)]


def picture(nodes: Sequence[Node]) -> str:
    """Return the graph as SVG: a link for each node with arrows, which point from used nodes to users."""
    plan = layout(nodes)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{plan.width:.0f}" height="{plan.height:.0f}" '
        f'viewBox="0 0 {plan.width:.0f} {plan.height:.0f}" role="group" aria-label="What rests on what">',
        '<defs><marker id="chain-tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" '
        'orient="auto"><path d="M0 0 8 4 0 8z"/></marker>'
        '<pattern id="chain-stripes" width="8" height="8" patternUnits="userSpaceOnUse" '
        'patternTransform="rotate(45)"><path d="M0 0V8" class="stripe"/></pattern></defs>',
    ]
    for (used, user), points in plan.routes.items():
        parts.append(f'<path class="arrow" data-from="{used}" data-to="{user}" d="{_curve(points)}"/>')
    for node in nodes:
        if node.claim.id not in plan.boxes:
            continue
        left, top, width = plan.boxes[node.claim.id]
        middle = left + width / 2
        box = f'x="{left:.1f}" y="{top:.1f}" width="{width:.1f}" height="{_HEIGHT}" rx="6"'
        lines = _lines(node)
        first = top + (_HEIGHT - 14 * len(lines)) / 2 + 3
        words = f'<text x="{middle:.1f}" y="{first:.1f}" class="name">{html.escape(node.claim.item)}</text>' + "".join(
            f'<text x="{middle:.1f}" y="{first + 14 * (i + 1):.1f}">{html.escape(line)}</text>'
            for i, line in enumerate(lines)
        )
        stripes = f'<rect class="stripes" {box}/>' if node.standing == "undermined" else ""
        parts.append(
            f'<a class="node {node.standing}" data-id="{node.claim.id}" href="{address(node.claim)}" '
            f'aria-label="{html.escape(f"{name_of(node.claim)}: {said(node)}. {node.claim.statement}")}">'
            f"<title>{html.escape(node.claim.statement)}</title><rect {box}/>{stripes}{words}</a>"
        )
    return "".join([*parts, "</svg>"])


def _curve(points: Sequence[tuple[float, float]]) -> str:
    """Return a path through the points that leaves and enters each of them vertically."""
    path = f"M{points[0][0]:.1f} {points[0][1]:.1f}"
    for (x0, y0), (x1, y1) in pairwise(points):
        middle = (y0 + y1) / 2
        path += f"C{x0:.1f} {middle:.1f} {x1:.1f} {middle:.1f} {x1:.1f} {y1:.1f}"
    return path


def legend(nodes: Sequence[Node]) -> str:
    """Return the legend of the colours that occur."""
    used = {node.standing for node in nodes}
    entries = "".join(
        f'<li class="{standing}">{words}</li>' for standing, words in STANDINGS.items() if standing in used
    )
    return f'<ul class="chain-legend">{entries}</ul>'


def as_table(nodes: Sequence[Node]) -> str:
    """Return the graph as a table, one row for each node, including pairs implied by other rows."""
    names = {node.claim.id: name_of(node.claim) for node in nodes}
    rows = []
    for node in nodes:
        uses = ", ".join(f'<a href="#row-{id}">{html.escape(names[id])}</a>' for id in node.uses) or "nothing further"
        rows.append(
            f'<tr id="row-{node.claim.id}" data-id="{node.claim.id}"><td><a href="{address(node.claim)}">'
            f"{html.escape(names[node.claim.id])}</a></td><td>{readable(node.claim.statement)}<br>"
            f'<span class="standing {node.standing}">{STANDINGS[node.standing]}</span><br>Uses: {uses}.</td></tr>'
        )
    head = "<tr><th>result</th><th>the statement, its standing, and the results that its proof uses</th></tr>"
    return f'<table class="dataframe stacked chain-table"><thead>{head}</thead><tbody>{"".join(rows)}</tbody></table>'
