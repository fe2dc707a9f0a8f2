"""A run as `rhl run` and `rhl check --run` show it: under a progress bar, with the reason why it stopped early."""

from __future__ import annotations

import sys

from rhl._checks import reason
from rhl.app._sections import too_heavy
from rhl.app._status import INTERRUPTED, OK, STOPPED
from rhl.app._streams import print_table, progress, undisturbed
from rhl.app.diagnosis import Diagnosis
from rhl.errors import DivergedError, LostControllabilityError, NotSolvedError
from rhl.paper.published import Experiment
from rhl.trace import Trace

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
