"""The command line: parse, call, print."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import NoReturn

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from rhl import __version__, published
from rhl._checks import InputError
from rhl.closed_loop import DivergedError, Step
from rhl.config import load
from rhl.controllability import LostControllability
from rhl.trace import Trace, header, simulate, write_whole

OK, MISSED, BAD_INPUT, STOPPED, INTERRUPTED = 0, 1, 2, 3, 130


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one sentence, as everything here does."""

    def error(self, message: str) -> NoReturn:
        raise InputError(f"{message}; see '{self.prog} --help'")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status.

    Returns
    -------
    int
        0: done, and within tolerance where something is compared. 1: a tolerance is missed. 2: bad input. 3: the run
        stopped before its end; its rows up to there are kept. 130: interrupted; likewise.
    """
    try:
        options = _parser().parse_args(arguments)
        return int(options.command(options))
    except InputError as error:
        print(f"rhl: {error}", file=sys.stderr)
        return BAD_INPUT


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="rhl", description="Receding horizon learning, the companion of arXiv 2010.05891.")
    parser.add_argument("--version", action="version", version=f"rhl {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    reproduce = commands.add_parser("reproduce", help="compare a simulation of the paper with its published data")
    reproduce.add_argument("experiment", choices=("linear", "robot"))
    reproduce.add_argument("--printed", action="store_true", help="with the settings as the paper's text prints them")
    reproduce.add_argument("--output", type=Path, metavar="CSV", help="write the run's rows to this file")
    reproduce.set_defaults(command=_reproduce)

    run = commands.add_parser("run", help="run the scheme on a plant of your own")
    run.add_argument("config", type=Path, metavar="CONFIG.toml", help="what to run; the book documents every key")
    run.add_argument("--output", type=Path, metavar="CSV", required=True, help="write the run's rows to this file")
    run.set_defaults(command=_run)

    for command in (reproduce, run):
        command.add_argument("--plot", type=Path, metavar="FIGURE", help="draw the run to this .svg, .pdf or .png file")
    return parser


def _reproduce(options: argparse.Namespace) -> int:
    _check_targets(options)
    linear = options.experiment == "linear"
    experiment = (published.linear_example if linear else published.robot_arm)(printed=options.printed)
    trace = experiment.run()
    rows = published.compare_linear(trace, printed=options.printed) if linear else published.compare_robot(trace)
    settings = "the settings as printed" if options.printed else "the settings behind the data"
    table = Table(title=f"{experiment.name}, {settings}", title_justify="left")
    for heading in ("signal", "samples", "largest |difference|", "at k", "tolerance", "verdict"):
        table.add_column(heading, justify="left" if heading in ("signal", "verdict") else "right")
    for row in rows:
        tolerance = "none" if row.tolerance is None else f"{row.tolerance:g}"
        table.add_row(row.signal, str(row.samples), f"{row.largest:.3g}", str(row.at), tolerance, row.verdict)
    console = Console(highlight=False)
    # Off a terminal rich assumes 80 columns, which would fold the table.
    console.width = max(console.width, 110)
    console.print(table)
    if options.output:
        trace.to_csv(options.output)
    if options.plot:
        from rhl import plotting  # here, because loading matplotlib takes longer than the run

        plotting.save(lambda: plotting.reproduction(trace, options.experiment), options.plot)
    return MISSED if any(row.verdict == "missed" for row in rows) else OK


def _run(options: argparse.Namespace) -> int:
    config = load(options.config)
    experiment = config.experiment()
    _check_targets(options)
    done: list[Step] = []
    status, reason = OK, ""
    console = Console(stderr=True)
    with Progress(console=console, transient=True) if console.is_terminal else nullcontext() as progress:
        task = progress.add_task(experiment.name, total=experiment.steps) if progress else None

        def tick(step: Step) -> None:
            done.append(step)
            if progress and task is not None:
                progress.advance(task)

        try:
            simulate(experiment.scheme, experiment.plant, experiment.z0, experiment.steps, tick)
        except DivergedError as error:
            status, reason = STOPPED, str(error)
        except LostControllability as error:
            status, reason = STOPPED, f"the run stopped at k = {len(done)}: {error}"
        except KeyboardInterrupt:
            status, reason = INTERRUPTED, f"the run was interrupted at k = {len(done)}"
    if done:
        trace = Trace(experiment.scheme, tuple(done))
        trace.to_csv(options.output)
        if options.plot:
            from rhl import plotting

            plotting.save(lambda: plotting.run(trace, experiment.name), options.plot)
    else:
        plant = experiment.plant
        write_whole(options.output, ",".join(header(plant.p, plant.q, plant.n)) + "\n")
    if reason:
        print(f"rhl: {reason}; the {len(done)} rows before it are in {options.output}", file=sys.stderr)
    return status


def _check_targets(options: argparse.Namespace) -> None:
    """Refuse files that cannot be written before any work is done."""
    for flag, target in (("--output", options.output), ("--plot", options.plot)):
        if target is None:
            continue
        if not target.parent.is_dir():
            raise InputError(f"{flag} must name a file in a folder that exists, got {target}")
        if target.is_dir():
            raise InputError(f"{flag} must name a file, got the folder {target}")
    if options.plot and options.plot.suffix not in (".svg", ".pdf", ".png"):
        raise InputError(f"--plot must end in .svg, .pdf or .png, got {options.plot}")
