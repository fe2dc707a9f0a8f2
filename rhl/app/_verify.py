"""The command `rhl verify`: check the claims of the paper and report them as a table and as JSON."""

from __future__ import annotations

import argparse
import json
import textwrap
from collections import Counter
from collections.abc import Sequence

from rich.table import Table

from rhl.app._streams import complain, deliver, print_table, progress, undisturbed, width_of, words_of
from rhl.paper.claims import ledger
from rhl.paper.claims.claim import Claim, Effort, Judgement

# The width of a complete row, in characters.
_WIDE = 230


def verified(options: argparse.Namespace, claims: Sequence[Claim], effort: Effort) -> list[Judgement]:
    """Check claims, print the results, and write them if asked.

    The results up to an interruption are printed and written too.
    """
    done: list[Judgement] = []
    with progress("checking", len(claims)) as show:

        def tick(judgement: Judgement) -> None:
            done.append(judgement)
            show(len(done))

        try:
            ledger.run(claims, effort, tick)
        except KeyboardInterrupt:
            undisturbed()
            complain(f"interrupted after {len(done)} of {len(claims)} claims")
    words = words_of(options)
    count = "1 claim" if len(done) == 1 else f"{len(done)} claims"
    title = f"{count}, seed {effort.seed}, {effort.cases} cases for each check that draws random ones"
    width = width_of(words, _WIDE)
    print_table(_table(done, title, width), _WIDE, words)
    if width < _WIDE:
        print(f"left out: what a claim says and how it is checked; {_WIDE} columns or --json show it", file=words)
    # Reasons that do not fit into a cell: why there is no evidence, and why there can be none.
    for row in done:
        if row.problem:
            print(f"{row.claim.id}: {row.problem}", file=words)
    for row in done:
        if row.verdict == "not-checkable":
            print(f"{row.claim.id} {row.status}: {row.claim.reason}", file=words)
    tally = ", ".join(f"{count} {status}" for status, count in Counter(row.status for row in done).most_common())
    other = sum(not row.as_recorded for row in done)
    recorded = f"{other} not as recorded" if other else "all as recorded"
    print(f"{tally}; {recorded}; {sum(row.seconds for row in done):.0f} s", file=words)
    if options.output:
        text = json.dumps(ledger.as_json(done, effort, asked=len(claims)), indent=1, allow_nan=False) + "\n"
        deliver(options.output, text, options.force)
    return done


def _table(done: list[Judgement], title: str, width: int) -> Table:
    """Return a row for each claim; on a narrow terminal without the two columns of sentences."""
    table, wide = Table(title=title, title_justify="left"), width >= _WIDE
    table.add_column("claim", no_wrap=wide, overflow="fold")
    if wide:
        table.add_column("says", no_wrap=True, overflow="ellipsis", max_width=72)
        table.add_column("checked by", no_wrap=True)
    for heading in ("cases", "worst", "tolerance"):
        table.add_column(heading, no_wrap=True, justify="right")
    table.add_column("status", no_wrap=True)
    table.add_column("control", no_wrap=True)
    for row in done:
        found, claim = row.evidence, row.claim
        numbers = [str(found.cases), f"{found.worst:.2g}", f"{found.tolerance:.2g}"] if found else [""] * 3
        status = row.status if row.verdict == claim.recorded else f"{row.status}, NOT {claim.recorded}"
        cells = [claim.statement, claim.method, *numbers] if wide else numbers
        control = row.told_true_from_false
        if not wide:  # broken here between words, since a table breaks within them
            status, control = textwrap.fill(status, 15), textwrap.fill(control.replace(", as it must", ""), 8)
        table.add_row(claim.id, *cells, status, control)
    return table
