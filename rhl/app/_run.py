"""A run under a progress bar, the reason why it stopped early, its rows and its figure; the table of a diagnosis."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from rhl._checks import reason
from rhl._files import table_text
from rhl.app._sections import too_heavy
from rhl.app._status import INTERRUPTED, OK, STOPPED
from rhl.app._streams import STDOUT, deliver, named, print_table, progress, undisturbed
from rhl.app.diagnosis import Diagnosis
from rhl.errors import DivergedError, InputError, LostControllabilityError, NotSolvedError
from rhl.paper.published import Experiment
from rhl.trace import Trace

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CHECK_WIDTH = 140  # of the table of `rhl check`
TOO_LARGE = "the run must fit into memory"


def watched(experiment: Experiment) -> tuple[Trace | None, int, str]:
    """Run under a progress bar; return the rows so far, the exit status, and why it stopped early if it did."""
    trace: Trace | None = None
    with progress(experiment.name, experiment.steps) as show:

        def tick(so_far: Trace) -> None:
            nonlocal trace
            trace = so_far
            show(len(so_far))

        try:
            return experiment.run(tick), OK, ""
        except DivergedError as error:
            return error.trace, STOPPED, "; ".join(filter(None, (str(error), _heavy(experiment, error))))
        except (LostControllabilityError, NotSolvedError) as error:
            why = str(error)
        except MemoryError as error:
            why = f"{TOO_LARGE}, got {reason(error)}"
        except KeyboardInterrupt:
            undisturbed()
            return trace, INTERRUPTED, f"the run was interrupted at k = {len(trace or ())}"
    return trace, STOPPED, f"the run stopped at k = {len(trace or ())}: {why}"


def _heavy(experiment: Experiment, error: DivergedError) -> str:
    """Return which key of the file made the terminal weight leave the range of float64, if one did."""
    controller, k = experiment.scheme.controller, error.k
    if not error.what.startswith("weight "):
        return ""
    if controller.adaptive:
        k = int(error.trace.steps[-1].stage) + 1 if error.trace else 0
    return too_heavy(controller, k)


def write(options: argparse.Namespace, trace: Trace, draw: Callable[[], Figure]) -> None:
    """Write the rows and the figure; if one of them cannot be written, the other is removed too.

    If the figure cannot be drawn, the rows are written all the same, since the run may have taken long.
    """
    table = table_text(trace.columns()) if options.output else ""
    results: list[tuple[Path, str | bytes]] = []
    try:
        if options.plot:
            from rhl import plotting  # matplotlib is an extra, and takes long to load

            results.append((options.plot, plotting.render(draw, options.plot)))
    except BaseException as error:
        if options.output:
            deliver(options.output, table, options.force)
        if isinstance(error, ValueError | ArithmeticError):
            kept = f"the rows are in {named(options.output)}" if options.output else "leave out --plot"
            raise InputError(f"--plot must be of a run that can be drawn, got {reason(error)}; {kept}") from error
        raise
    if options.output:
        # Printed rows cannot be removed again, so they come last.
        results.insert(len(results) if options.output is STDOUT else 0, (options.output, table))
    made: list[Path] = []
    for path, content in results:
        fresh = path is not STDOUT and not path.exists()
        try:
            deliver(path, content, options.force)
        except InputError:
            for file in made:
                file.unlink(missing_ok=True)
            raise
        if fresh:
            made.append(path.resolve())


def print_findings(diagnosis: Diagnosis, title: str) -> None:
    """Print a diagnosis as a table."""
    from rich.markup import escape
    from rich.table import Table

    table = Table(title=escape(title), title_justify="left", show_lines=False)
    table.add_column("verdict", no_wrap=True)
    table.add_column("what", max_width=44)
    table.add_column("found")
    for finding in diagnosis.findings:
        table.add_row(finding.verdict, escape(finding.subject), escape(finding.says))
    print_table(table, CHECK_WIDTH, sys.stdout)
