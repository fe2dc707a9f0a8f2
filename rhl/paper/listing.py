"""Claims in the book: an overview by result, a card for each claim, and the findings."""

from __future__ import annotations

import html
from collections import Counter
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from rhl.paper.formal import anchor
from rhl.paper.pages import number, readable

if TYPE_CHECKING:
    from rhl.paper.claims.claim import Claim, Judgement, Status

Listed = TypeVar("Listed")

# The class of a status in book/_static/book.css, for its colour; the words carry the meaning too.
_COLOURS: dict[Status, str] = {
    "proved here": "stands",
    "machine-checked": "stands",
    "holds on all cases tried": "tried",
    "holds once corrected": "corrected",
    "fails: counterexample": "fails",
    "cannot be checked": "given",
    "no evidence": "open",
}


def badge(status: Status) -> str:
    """Return a status as HTML in its colour."""
    return f'<span class="standing {_COLOURS[status]}">{status}</span>'


def status_counts(judgements: Iterable[Judgement]) -> str:
    """Return the number of claims with each status, as HTML."""
    counts = Counter(judgement.status for judgement in judgements)
    return (
        '<p class="status-counts">'
        + " ".join(
            f'<span class="count">{counts[status]} {badge(status)}</span>' for status in _COLOURS if counts[status]
        )
        + "</p>"
    )


def title(page: str) -> str:
    """Return the name of the result on a page of the sources.

    Examples
    --------
    >>> title("notebooks/05-lemma-1.ipynb")
    'Lemma 1'
    """
    kind, _, rest = page.rpartition("/")[2].partition(".")[0].partition("-")[2].partition("-")
    return f"{kind} {rest}".replace("-", " ").strip().capitalize()


def by_page(listed: Iterable[Listed], page: Callable[[Listed], str]) -> dict[str, list[Listed]]:
    """Return claims or judgements by their page, in the order in which pages first occur."""
    groups: dict[str, list[Listed]] = {}
    for item in listed:
        groups.setdefault(page(item), []).append(item)
    return groups


def section_id(page: str) -> str:
    """Return the anchor in the ledger of the claims of a page of the sources."""
    return "result-" + page.rpartition("/")[2].partition(".")[0].partition("-")[2]


def overview(judgements: Iterable[Judgement]) -> str:
    """Return a table for the ledger: a row for each result, with the number of its claims with each status."""
    groups = by_page(judgements, lambda judgement: judgement.claim.page)
    counts = {page: Counter(judgement.status for judgement in group) for page, group in groups.items()}
    shown = [status for status in _COLOURS if any(count[status] for count in counts.values())]
    head = "".join(f'<th scope="col">{badge(status)}</th>' for status in shown)
    rows = "".join(
        f'<tr><th scope="row"><a href="#{section_id(page)}">{title(page)}</a></th>'
        + "".join(f"<td>{count[status] or ''}</td>" for status in shown)
        + "</tr>"
        for page, count in counts.items()
    )
    head = f'<tr><th scope="col">result</th>{head}</tr>'
    return f'<table class="dataframe overview"><thead>{head}</thead><tbody>{rows}</tbody></table>'


def cards(judgements: Iterable[Judgement]) -> str:
    """Return judgements as cards for the ledger: statement and status, and the evidence in a part that can be opened.

    Each card links to the claim's page, proof, code and test, from a page in ``book/``.
    """
    return f'<div class="claims">{"".join(map(_card, judgements))}</div>'


def _card(judgement: Judgement) -> str:
    claim, found = judgement.claim, judgement.evidence
    check = claim.stated.func if isinstance(claim.stated, partial) else claim.stated
    module = check.__module__ if check else None
    links = [(seen_from_book(claim.page), "page")]
    if claim.proof:
        links.append((seen_from_book(claim.proof), "proof"))
    if module:
        links.append((f"../_modules/{module.replace('.', '/')}.html", "code"))
    links.append((f"checks.html#{Path(claim.test).stem.replace('_', '-')}", "test"))
    if claim.formal:
        links.append((f"checked-by-machine.html#{anchor(claim.formal)}", "checked by machine"))
    says = [readable(words) for words in (judgement.problem, claim.reason) if words]
    evidence = []
    if found and claim.control:
        evidence.append(
            f"{claim.method}: {found.cases} cases, worst {number(found.worst)}, tolerance {number(found.tolerance)} "
            f"({readable(found.why)})."
        )
        evidence.append(f"Fails with {readable(claim.control.what)}.")
        if claim.instance:
            evidence.append(f"Holds with {readable(claim.instance.what)}.")
    if claim.uses:
        evidence.append("Uses " + ", ".join(f'<a href="#{id}">{id}</a>' for id in claim.uses) + ".")
    evidence.append(" · ".join(f'<a href="{target}">{text}</a>' for target, text in links))
    item = "" if claim.item == "text" else f" {html.escape(claim.item)}"
    return (
        f'<section class="claim" id="{claim.id}" data-status="{judgement.status}" '
        f'data-words="{html.escape(claim.statement)}">'
        f"<p><b><code>{claim.id}</code>{item}</b> {badge(judgement.status)}</p>"
        + "".join(f"<p>{words}</p>" for words in (readable(claim.statement), *says))
        + f"<details><summary>Evidence and links</summary>{''.join(f'<p>{words}</p>' for words in evidence)}</details>"
        "</section>"
    )


def seen_from_book(place: str) -> str:
    """Return the address, from ``book/``, of a page of the sources such as "notebooks/05-lemma-1.ipynb#proof"."""
    page, _, anchor = place.partition("#")
    return f"../{page.rpartition('.')[0]}.html" + (f"#{anchor}" if anchor else "")


def findings_table(claims: Iterable[Claim]) -> str:
    """Return findings about claims as HTML for a page in ``book/``, grouped by their pages."""
    rows = []
    for page, group in by_page(claims, lambda claim: claim.page).items():
        rows.append(f'<tr class="group"><th colspan="2"><a href="{seen_from_book(page)}">{title(page)}</a></th></tr>')
        rows += [
            f"<tr><td>{html.escape(claim.item if claim.item != 'text' else 'In the text')}</td>"
            f"<td>{readable(claim.statement)}<br>{readable(claim.reason)}<br>"
            f'<a href="ledger.html#{claim.id}">{claim.id}</a></td></tr>'
            for claim in group
        ]
    head = "<tr><th>where</th><th>statement and finding</th></tr>"
    return f'<table class="dataframe stacked"><thead>{head}</thead><tbody>{"".join(rows)}</tbody></table>'
