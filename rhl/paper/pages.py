"""What the book's pages share: numbers for the prose, tables of comparisons."""

from __future__ import annotations

import html
import math
import os
from collections.abc import Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from rhl.errors import InputError
from rhl.paper.formal import anchor
from rhl.paper.published import Comparison

if TYPE_CHECKING:
    from pandas.io.formats.style import Styler

    from rhl.paper.claims.claim import Claim, Judgement


def tell(**values: float | int | str) -> None:
    """Hand numbers, or short strings, to the prose of the page under their names; outside the book, print them.

    ``**values``: read in the text as ``{glue:text}`name:.2f```. InputError if a number is not finite: no page shall say
    NaN.
    """
    in_book = "RHL_BOOK" in os.environ
    try:
        from myst_nb import glue  # here, because only the book's extra installs it
    except ImportError:
        if in_book:
            raise
        glue = None

    for name, value in values.items():
        plain = value if isinstance(value, str) else value.item() if hasattr(value, "item") else value
        if not isinstance(plain, str) and not math.isfinite(plain):
            raise InputError(f"{name} must be finite to be told in the text, got {plain}")
        if glue is not None:
            glue(name, plain, display=False)
        if not in_book:
            # Outside the book the prose shows the names only; so that a reader of the notebook finds the numbers.
            print(f"{name} = {plain}")


_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def scientific(value: float, digits: int = 2) -> str:
    """Return a number as prose writes it, with so many significant digits.

    Examples
    --------
    >>> scientific(5.83e-13)
    '5.8·10⁻¹³'
    """
    mantissa, _, exponent = f"{value:.{digits - 1}e}".partition("e")
    return f"{mantissa}·10{str(int(exponent)).translate(_RAISED)}"


def grouped(digits: str, by: int = 5) -> str:
    """Return a decimal number with a space after every few places, at which a line may break.

    Examples
    --------
    >>> grouped("-3.27391669925")
    '−3.27391 66992 5'
    """
    whole, point, places = digits.replace("-", "−").partition(".")
    return whole + point + " ".join(places[i : i + by] for i in range(0, len(places), by))


def table(rows: Iterable[Mapping[str, object]]) -> Styler:
    """Return rows of named entries as a table for a page."""
    import pandas as pd

    # The theme styles tables of this class for light and dark pages, and no others.
    return pd.DataFrame(list(rows)).style.hide().set_table_attributes('class="dataframe"')


def comparison_table(rows: Iterable[Comparison]) -> Styler:
    """Return comparisons with published data as a table for a page, one row each."""
    return table(
        {
            "signal": row.signal,
            "samples": row.samples,
            "largest |difference|": f"{row.largest:.2g}",
            "at k": row.at,
            "tolerance": "none" if row.tolerance is None else f"{row.tolerance:g}",
            "verdict": row.verdict,
        }
        for row in rows
    )


def ledger_table(judgements: Iterable[Judgement]) -> str:
    """Return judgements as HTML for a page in ``book/``: each row links to its page, its code and its test."""
    rows = [_ledger_row(judgement) for judgement in judgements]
    head = "<tr><th>claim</th><th>what it says, and what came out</th></tr>"
    return f'<table class="dataframe stacked"><thead>{head}</thead><tbody>{"".join(rows)}</tbody></table>'


def _ledger_row(judgement: Judgement) -> str:
    claim, found = judgement.claim, judgement.evidence
    check = claim.stated.func if isinstance(claim.stated, partial) else claim.stated
    module = check.__module__ if check else None
    links = [
        (f"../{claim.page.removesuffix('.ipynb').removesuffix('.md')}.html", "page"),
        (f"checks.html#{Path(claim.test).stem.replace('_', '-')}", "test"),
    ]
    if module:
        links.insert(1, (f"../_modules/{module.replace('.', '/')}.html", "code"))
    says = [html.escape(claim.statement)]
    if found and claim.control:
        says.append(
            f"<b>{judgement.verdict}</b>: {claim.method}, {found.cases} cases, worst {found.worst:.2g}, "
            f"tolerance {found.tolerance:.2g} ({html.escape(found.why)}). Fails with {html.escape(claim.control.what)}."
        )
    else:
        says.append(f"<b>{judgement.verdict}</b>.")
    if claim.reason:
        says.append(html.escape(claim.reason))
    if claim.formal:
        links.append((f"checked-by-machine.html#{anchor(claim.formal)}", "checked by machine"))
    says.append(" · ".join(f'<a href="{target}">{text}</a>' for target, text in links))
    item = "" if claim.item == "text" else f"<br>{html.escape(claim.item)}"
    return f'<tr id="{claim.id}"><td><code>{claim.id}</code>{item}</td><td>{"<br>".join(says)}</td></tr>'


def findings_table(claims: Iterable[Claim]) -> str:
    """Return what is wrong and what is right about claims as HTML for a page in ``book/``."""
    rows = [
        f"<tr><td>{html.escape(claim.item if claim.item != 'text' else 'In the text')}</td>"
        f"<td>{html.escape(claim.statement)}<br>{html.escape(claim.reason)}<br>"
        f'<a href="../{claim.page.removesuffix(".ipynb")}.html">{claim.id}</a></td></tr>'
        for claim in claims
    ]
    head = "<tr><th>where</th><th>what is said, and what is found</th></tr>"
    return f'<table class="dataframe stacked"><thead>{head}</thead><tbody>{"".join(rows)}</tbody></table>'
