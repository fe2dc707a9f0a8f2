"""The command `rhl campaign`: start or resume a campaign, show its progress and report its results."""

from __future__ import annotations

import argparse
import logging
import shlex
import sys
import textwrap
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

# The rest is imported when the command runs, so that help and refusals do not wait for it.
from rhl.app._status import BAD_INPUT, INTERRUPTED, OK, STOPPED
from rhl.app._streams import complain, file_name, print_table, printable, progress

if TYPE_CHECKING:
    from rhl.study.campaign import Backend, Campaign
    from rhl.study.store import Store


class _Help(argparse.Action):
    """Prints the usage, then every key of the file."""

    def __init__(self, option_strings: list[str], dest: str, **named: Any) -> None:
        super().__init__(option_strings, dest, nargs=0, **named)

    def __call__(self, parser: argparse.ArgumentParser, *arguments: Any, **named: Any) -> None:
        from rhl.app._campaign_keys import keys

        print(parser.format_help())
        print("keys of CONFIG.toml:")
        for name, what in keys():
            told = textwrap.TextWrapper(110, initial_indent="  ", subsequent_indent="      ", break_on_hyphens=False)
            print(told.fill(f"{name}: {what}"))
        parser.exit()


def add(commands: Any) -> None:
    """Add the command to the parser's commands."""
    campaign = commands.add_parser(
        "campaign",
        allow_abbrev=False,
        add_help=False,
        help="run schemes on many plants, random or benchmark",
        description="Run schemes on many plants; the results go into a zarr store, which xarray reads.",
    )
    campaign.add_argument("-h", "--help", action=_Help, help="show this help, with every key of the file, and exit")
    campaign.add_argument("config", type=file_name, metavar="CONFIG.toml", help="which plants and schemes")
    campaign.add_argument(
        "--output", type=file_name, metavar="DIR", required=True, help="the folder to create for the results"
    )
    workers = campaign.add_mutually_exclusive_group()
    workers.add_argument(
        "--workers", type=_count, default=1, metavar="N", help="the number of worker processes (1: only this process)"
    )
    workers.add_argument("--scheduler", metavar="ADDRESS", help="use the workers of this Dask scheduler")
    campaign.add_argument("--resume", action="store_true", help="resume a campaign that was interrupted")
    campaign.set_defaults(command=_campaign)


def _count(text: str) -> int:
    if not (text.isdecimal() and 1 <= int(text) <= 1000):
        raise argparse.ArgumentTypeError(f"must be an integer from 1 to 1000, got {text!r}")
    return int(text)


def _campaign(options: argparse.Namespace) -> int:
    from rhl.app._campaign_keys import load
    from rhl.study.campaign import LostWorkersError, run
    from rhl.study.store import StoreError

    for package in ("zarr", "xarray", "dask", "rich"):  # a missing package is reported before any file is created
        __import__(package)
    file, text, settings = load(options.config)
    campaign = file.campaign()
    backend = _backend(options)
    again = shlex.join(["rhl", "campaign", str(options.config), "--output", str(options.output), "--resume"])
    with ExitStack() as held:
        try:
            store = _store(options, campaign, text, settings)
            held.enter_context(store.held())
        except StoreError as error:
            complain(str(error))
            return BAD_INPUT
        tasks, done = len(list(campaign.tasks())), 0
        show = held.enter_context(progress(file.name, tasks))

        def tick(count: int) -> None:
            nonlocal done
            done = count
            show(count)

        try:
            run(campaign, store, backend, progress=tick)
        except KeyboardInterrupt:
            status, why = INTERRUPTED, "interrupted"
        except (StoreError, LostWorkersError) as error:
            status, why = STOPPED, f"{error}; stopped"
        else:
            status, why = OK, ""
    if status:
        complain(f"{why} after {done} of {tasks} tasks, which are kept; {again} continues")
        return status
    _report(store, options)
    return OK


def _backend(options: argparse.Namespace) -> Backend:
    from rhl.study import backends

    if options.scheduler is None:
        return backends.in_process() if options.workers == 1 else backends.processes(options.workers)
    import distributed  # noqa: F401 - it sets up its logging when it is first imported

    # It would report lost workers with tracebacks, in addition to the message here.
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    return backends.cluster(options.scheduler)


def _store(options: argparse.Namespace, campaign: Campaign, text: str, settings: Any) -> Store:
    from rhl.study.store import Store

    if options.resume:
        return Store.resume(options.output, campaign, settings)
    return Store.create(options.output, campaign, text, settings)


def _report(store: Store, options: argparse.Namespace) -> None:
    from rich.markup import escape
    from rich.table import Table

    from rhl.study.campaign import summary

    rows = summary(store.dataset())
    table = Table(title=f"{rows[0]['plants']} plants, {store.campaign.steps} steps", title_justify="left")
    for heading in ("scheme", "at rest", "peak: 50 %", "90 %", "99 %", "diverged"):
        table.add_column(heading, justify="left" if heading == "scheme" else "right")
    for row in rows:
        peaks = (f"{row[f'peak_{at}']:.3g}" for at in (50, 90, 99))
        table.add_row(escape(row["scheme"]), f"{row['at_rest']:.2%}", *peaks, f"{row['diverged']:.2%}")
    print_table(table, 110, sys.stdout)
    print(f"sha256 over all variables: {store.digest()}")
    print(printable(f"open it: xarray.open_zarr({str(options.output / 'results.zarr')!r})"))
