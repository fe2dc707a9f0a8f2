"""The command line: parse, call, print."""

from __future__ import annotations

import argparse
import json
import sys
import textwrap
import warnings
from collections.abc import Sequence
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any, NoReturn

# The rest is imported by the commands that need it, so that help and refusals do not wait for numpy.
from rhl import __version__
from rhl.app import _campaign
from rhl.app._status import BAD_INPUT, BROKEN_PIPE, INTERRUPTED, MISSED, OK
from rhl.app._streams import (
    STDOUT,
    check_targets,
    complain,
    deliver,
    drop,
    file_name,
    interruptible,
    named,
    open_streams,
    print_table,
    printable,
    target_name,
    width_of,
    words_of,
)
from rhl.errors import AssumptionWarning, InputError

if TYPE_CHECKING:
    from types import ModuleType


# Packages that some commands need, and the extra that brings them.
_EXTRAS = {
    **{"rich": "app", "matplotlib": "plot", "control": "paper", "pandas": "paper", "sympy": "paper", "flint": "paper"},
    **dict.fromkeys(("dask", "distributed", "xarray", "zarr"), "study"),
}


class _Parser(argparse.ArgumentParser):
    """Reports an error in one sentence, like every other command error."""

    def error(self, message: str) -> NoReturn:
        raise InputError(f"{message}; see '{self.prog} --help'")

    def print_help(self, file: Any = None) -> None:
        """Print the help; unlike argparse, which says nothing if a full disk takes none of it, raise OSError."""
        print(self.format_help(), end="", file=file)


class _Version(argparse.Action):
    """Prints the version, with the same errors."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> NoReturn:
        print(f"rhl {__version__}")
        parser.exit()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status.

    0: success. 1: a tolerance is exceeded or an assumption does not hold. 2: bad input.
    3: the run stopped before its end; its rows are kept. 130: interrupted; the rows are kept.
    """
    open_streams()
    try:
        with warnings.catch_warnings(), interruptible():
            warnings.simplefilter("default", AssumptionWarning)
            warnings.showwarning = _say
            try:
                options = _parser().parse_args(arguments)
            except SystemExit as done:  # help was asked for, and is printed
                status = int(done.code or OK)
            else:
                status = int(options.command(options))
        sys.stdout.flush()
        return status
    except InputError as error:
        complain(str(error))
        return BAD_INPUT
    except ImportError as error:
        package = (error.name or "").partition(".")[0]
        if package not in _EXTRAS:
            raise
        install = f"pip install 'rhl[{_EXTRAS[package]}]'"
        complain(f"this command needs the package {package}, got none installed; {install}")
        return BAD_INPUT
    except MemoryError as error:
        from rhl._checks import reason
        from rhl.app._run import TOO_LARGE

        complain(f"{TOO_LARGE}, got {reason(error)}; stack less, or shorten window or horizon")
        return BAD_INPUT
    except KeyboardInterrupt:
        complain("interrupted")
        return INTERRUPTED
    except BrokenPipeError:  # the reader of the table has closed it
        drop(sys.stdout)
        return BROKEN_PIPE
    except OSError as error:
        drop(sys.stdout)
        complain(f"the table must be written to standard output, got: {error.strerror}")
        return BAD_INPUT


def _say(message: Warning | str, *_: Any, **__: Any) -> None:
    complain(f"warning: {' '.join(str(message).split())}")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="rhl", allow_abbrev=False, description="Receding horizon learning, the companion of arXiv 2010.05891."
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show program's version number and exit")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    rows = "write the run's rows to this file; - prints them"
    reproduce = commands.add_parser(
        "reproduce", allow_abbrev=False, help="compare a simulation of the paper with its published data"
    )
    reproduce.add_argument("experiment", choices=("linear", "robot"))
    reproduce.add_argument("--printed", action="store_true", help="with the settings as the paper's text prints them")
    reproduce.add_argument("--output", type=target_name, metavar="CSV", help=rows)
    reproduce.set_defaults(command=_reproduce)

    run = commands.add_parser(
        "run",
        allow_abbrev=False,
        help="run the scheme on a plant of your own",
        epilog="The shortest file holds name, steps, order and [plant]. set_point is the target of the outputs, and "
        "[simulation] holds v_min and v_max, noise, outliers and a load. 'rhl new NAME' writes all keys.",
    )
    run.add_argument("config", type=file_name, metavar="CONFIG.toml", help="what to run; the book documents every key")
    run.add_argument(
        "--output",
        type=target_name,
        metavar="CSV",
        required=True,
        help=rows,
    )
    run.set_defaults(command=_run)

    check = commands.add_parser(
        "check", allow_abbrev=False, help="report which assumptions a plant and its settings meet"
    )
    check.add_argument("config", type=file_name, metavar="CONFIG.toml", help="what would run")
    check.add_argument("--run", action="store_true", help="run it too, and report the result")
    check.set_defaults(command=_check, output=None, plot=None)

    new = commands.add_parser("new", allow_abbrev=False, help="write a commented configuration that is ready to run")
    new.add_argument("name", metavar="NAME", help="the name of the run; the file is NAME.toml")
    new.add_argument("--from", dest="source", metavar="PLANT", help="use a published plant, by its name, such as ac1")
    new.set_defaults(command=_new, plot=None, flag="NAME")

    compare = commands.add_parser(
        "compare", allow_abbrev=False, help="run benchmark plants under the scheme and its rivals"
    )
    compare.add_argument("plants", nargs="*", metavar="PLANT", help="which plants; by default all up to order ten")
    compare.add_argument(
        "--collection", metavar="NAME", help="the plants of one collection only: compleib or literature"
    )
    compare.add_argument("--method", action="append", metavar="NAME", help="a method to run; repeatable (all)")
    compare.add_argument("--steps", type=int, default=400, metavar="T", help="how many steps (400)")
    compare.add_argument(
        "--noise",
        type=float,
        action="append",
        metavar="S",
        help="errors of outputs, relative to the first; repeatable (0)",
    )
    compare.add_argument(
        "--bounded", action="store_true", help="inputs at most three times those of the regulator that knows the plant"
    )
    compare.add_argument("--seeds", type=int, default=1, metavar="N", help="the number of runs of each random case (1)")
    compare.add_argument("--output", type=target_name, metavar="CSV", help="write a row for each run; - prints them")
    compare.set_defaults(command=_compare, plot=None)

    _campaign.add(commands)

    schema = commands.add_parser("schema", allow_abbrev=False, help="print the JSON schema of a configuration")
    schema.add_argument("--output", type=target_name, metavar="FILE", help="write it to this file instead; - prints it")
    schema.set_defaults(command=_schema, plot=None)

    verify = commands.add_parser("verify", allow_abbrev=False, help="check every claim of the paper, or some")
    verify.add_argument(
        "ids",
        nargs="*",
        metavar="ID",
        help="claims to check, or patterns such as 'certified.*'; by default all",
    )
    verify.add_argument("--list", action="store_true", help="list the claims instead of checking them")
    verify.add_argument(
        "--json",
        type=target_name,
        metavar="FILE",
        dest="output",
        help="write the results to this file; - prints it",
    )
    verify.add_argument("--seed", type=int, default=0, help="the seed of the random cases (default: 0)")
    amount = verify.add_mutually_exclusive_group()
    amount.add_argument(
        "--cases",
        type=_cases,
        default=100,
        metavar="N",
        help="random cases for each check that draws any, 10 to 100000 (default: 100)",
    )
    amount.add_argument("--fast", action="store_const", dest="cases", const=10, help="10 cases, for a quick check")
    verify.set_defaults(command=_verify, plot=None, flag="--json")

    for command in (run, check):
        command.add_argument(
            "--allow-python", action="store_true", help="execute the Python file that the configuration names"
        )
    for command in (reproduce, run):
        command.add_argument(
            "--plot", type=file_name, metavar="FIGURE", help="draw the run to this .svg, .pdf or .png file"
        )
    for command in (reproduce, run, new, compare, schema, verify):
        command.add_argument("--force", action="store_true", help="write over files that exist")
    return parser


def _cases(text: str) -> int:
    # With fewer cases a negative control may pass by chance.
    if not (text.isdecimal() and len(text) < 10 and 10 <= int(text) <= 100_000):
        raise argparse.ArgumentTypeError(f"must be an integer from 10 to 100000, got {text!r}")
    return int(text)


def _reproduce(options: argparse.Namespace) -> int:
    from rich.table import Table

    from rhl.app._run import write
    from rhl.paper import published

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
    write(options, trace, lambda: _paper_figures().reproduction(trace, options.experiment))
    print_table(table, 110, words_of(options))
    return MISSED if any(row.verdict == "missed" for row in rows) else OK


def _run(options: argparse.Namespace) -> int:
    from rhl._files import header
    from rhl.app._run import watched, write
    from rhl.app.config import load

    experiment = load(options.config).experiment(allow_python=options.allow_python)
    _check_targets(options)
    trace, status, why = watched(experiment)
    rows, output = len(trace or ()), options.output
    kept = f"the {rows} rows before it are in {named(output)}"
    if trace:
        write(options, trace, lambda: _figures().run(trace, experiment.name))
    elif output is not STDOUT and output.is_file():
        kept = f"there is no row before it, and {named(output)} is unchanged"  # with --force
    else:
        plant = experiment.plant
        deliver(output, ",".join(header(plant.p, plant.q, plant.n)) + "\n", options.force)
    if why:
        complain(f"{why}; {kept}")
    elif trace:
        end = f"largest |z| {abs(trace.z[-1]).max():.3g}, largest |v| {abs(trace.v[-1]).max():.3g}"
        if trace.set_point is not None:
            end = f"largest |y - r| {abs(trace.error[-1]).max():.3g}, {end}"
        print(f"{rows} rows in {named(output)}; at the end {end}", file=words_of(options))
    return status


def _check(options: argparse.Namespace) -> int:
    from rhl.app._run import CHECK_WIDTH, print_findings, watched
    from rhl.app.config import load
    from rhl.app.diagnosis import Diagnosis, diagnose, diagnose_run

    experiment = load(options.config).experiment(allow_python=options.allow_python)
    errs = {"sensor": experiment.sensor, "actuator": experiment.actuator, "load": experiment.load}
    found = diagnose(experiment.plant, experiment.scheme, z0=experiment.z0, **errs)
    print_findings(found, f"{experiment.name}: before a run")
    status, why = OK, ""
    if options.run:
        trace, status, why = watched(experiment)
        if trace:
            after = diagnose_run(trace, experiment.plant, **errs)
            print_findings(after, f"{experiment.name}: after {len(trace)} steps")
            found = Diagnosis((*found.findings, *after.findings))
    width = width_of(sys.stdout, CHECK_WIDTH)
    for line in found.legend():
        print(textwrap.fill(line, width, subsequent_indent="  "))
    if why:
        complain(why)
        return status
    return OK if found.sound else MISSED


def _new(options: argparse.Namespace) -> int:
    from rhl._checks import shown
    from rhl.app._templates import published, template

    name = options.name.removesuffix(".toml")
    stem = Path(name).name
    if not stem or not stem.isprintable():
        raise InputError(f"NAME must be a name for a new file, got {shown(options.name)!r}")
    options.output = Path(f"{name}.toml")
    _check_targets(options)
    text = template(stem) if options.source is None else published(stem, options.source)
    deliver(options.output, text, options.force)
    here = "./" if name.startswith("-") else ""  # the printed command would take the name for an option
    file, table, figure = (quote(f"{here}{path}") for path in (options.output, f"{name}.csv", f"{name}.svg"))
    print(printable(f"{here}{options.output} is ready to run: rhl run {file} --output {table} --plot {figure}"))
    return OK


def _compare(options: argparse.Namespace) -> int:
    from rhl.app._compare import compared

    _check_targets(options)
    return OK if compared(options) else INTERRUPTED


def _schema(options: argparse.Namespace) -> int:
    from rhl.app.config import schema

    options.output = options.output or STDOUT
    _check_targets(options)
    deliver(options.output, json.dumps(schema(), indent=1) + "\n", options.force)
    return OK


def _verify(options: argparse.Namespace) -> int:
    from rhl.paper.claims import ledger
    from rhl.paper.claims.claim import Effort

    effort, claims = Effort(options.seed, options.cases), ledger.select(options.ids)
    _check_targets(options)
    if options.list:
        if options.output:
            deliver(options.output, json.dumps(ledger.listed(claims), indent=1) + "\n", options.force)
        if options.output is not STDOUT:
            for claim in claims:
                print(f"{claim.id:28} {claim.statement}")
        return OK
    for package in ("sympy", "flint"):  # a missing package is reported before any claim is checked
        __import__(package)
    from rhl.app._verify import verified

    done = verified(options, claims, effort)
    if len(done) < len(claims):
        return INTERRUPTED
    return OK if all(row.as_recorded for row in done) else MISSED


def _figures() -> ModuleType:
    from rhl import plotting

    return plotting


def _paper_figures() -> ModuleType:
    from rhl.paper import figures

    return figures


def _check_targets(options: argparse.Namespace) -> None:
    check_targets(options)
    if options.plot:
        _figures()  # a missing matplotlib is reported before the run
