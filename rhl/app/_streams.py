"""Where a command writes messages and results: its streams, the named files and standard output."""

from __future__ import annotations

import argparse
import io
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TextIO, cast

# Nothing here needs numpy before a file is read, so that help and refusals do not wait for it.
from rhl.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

# Stands for standard output in place of a file; compared by identity, since ./- is a file of that name.
STDOUT = Path("-")
# Opening these again would write from the start of a file to which a shell redirected standard output.
_NAMES_OF_STDOUT = ("-", "/dev/stdout", "/dev/fd/1", "/proc/self/fd/1")


def open_streams() -> None:
    """Make standard output and error accept every string; a closed stream discards it.

    Characters outside the encoding are escaped, as standard error does by default.
    """
    for name in ("stdout", "stderr"):
        stream = cast(TextIO | None, getattr(sys, name))
        if stream is None:
            # The next file opened would get its descriptor, so this one takes it.
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def drop(stream: TextIO) -> None:
    """Discard the rest of a stream; otherwise Python reports the error again when it closes the stream."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def complain(text: str) -> None:
    """Print a message on standard error, on one line."""
    try:
        print(f"rhl: {printable(text)}", file=sys.stderr, flush=True)
    except OSError:  # the terminal may be closed; the exit status reports the failure too
        drop(sys.stderr)


def printable(text: str) -> str:
    """Return a string with control characters escaped, so that it stays on its line and moves no cursor."""
    return "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in text)


@contextmanager
def interruptible() -> Iterator[None]:
    """Handle termination and a closed terminal like Ctrl-C, so that rows are kept.

    An ignored signal stays ignored (``nohup``).
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def hung_up(number: int, frame: Any) -> NoReturn:
        # The shell and the kernel both send one when a terminal is closed; the second must not hit the writing.
        signal.signal(number, signal.SIG_IGN)
        raise KeyboardInterrupt

    handlers: dict[str, Any] = {"SIGTERM": signal.default_int_handler, "SIGHUP": hung_up}
    known = {getattr(signal, name): handler for name, handler in handlers.items() if hasattr(signal, name)}
    before, ctrl_c = {number: signal.getsignal(number) for number in known}, signal.getsignal(signal.SIGINT)
    heard = [number for number in known if before[number] != signal.SIG_IGN]
    for number in heard:
        signal.signal(number, known[number])
    try:
        yield
    finally:
        for number in heard:
            signal.signal(number, before[number])
        if signal.getsignal(signal.SIGINT) != ctrl_c:  # `undisturbed` has changed it
            signal.signal(signal.SIGINT, ctrl_c)


def undisturbed() -> None:
    """Ignore further Ctrl-C until ``interruptible`` ends: after the first one, results are printed and written."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def progress(what: str, total: int) -> Iterator[Callable[[int], None]]:
    """Show the progress on standard error if it is a terminal."""
    if not sys.stderr.isatty() or find_spec("rich") is None:  # a run needs no bar
        yield lambda done: None
        return
    from rich.progress import Progress

    bar = Progress(console=_console(sys.stderr), transient=True)
    task = bar.add_task(what, total=total)
    bar.start()
    try:
        yield lambda done: bar.update(task, completed=done)
    finally:
        with suppress(OSError):  # a closed terminal ends the bar, but must not lose the rows
            bar.stop()


def width_of(file: TextIO, least_width: int) -> int:
    """Return the width of a table: the terminal's, without a terminal COLUMNS, or else ``least_width``.

    COLUMNS counts only if it is a number of columns, from 1 to 99999.
    """
    console = _console(file)
    # Off a terminal rich assumes 80 columns, which would fold the table.
    if not console.is_terminal and not _size_in("COLUMNS"):
        return max(console.width, least_width)
    return console.width


def _size_in(name: str) -> int:
    """Return the columns or lines that a variable of the environment holds, 0 if it holds no such number."""
    given = os.environ.get(name, "")
    return int(given) if given.isascii() and given.isdecimal() and len(given) < 6 else 0


def _console(file: TextIO, **settings: Any) -> Console:
    """Return a console; rich itself would take a width of 0, and would fail for digits that are no number."""
    from rich.console import Console

    if any(name in os.environ and not _size_in(name) for name in ("COLUMNS", "LINES")):
        settings = {"width": _size_in("COLUMNS") or _terminal_width(), "height": _size_in("LINES") or 25} | settings
    return Console(file=file, **settings)


def _terminal_width() -> int:
    for descriptor in range(3):
        with suppress(OSError):
            return os.get_terminal_size(descriptor).columns or 80
    return 80


def print_table(table: Table, least_width: int, file: TextIO) -> None:
    """Print a table of the width ``width_of``."""
    console = _console(file, highlight=False, width=width_of(file, least_width))
    with console.capture() as capture:
        console.print(table)
    print(capture.get(), end="", file=file)


def target_name(text: str) -> Path:
    """Read an output target from the command line: a file's name, or - for standard output."""
    return STDOUT if text in _NAMES_OF_STDOUT else file_name(text)


def file_name(text: str) -> Path:
    """Read a file's name from the command line."""
    if not text:
        raise argparse.ArgumentTypeError("a file's name must have at least one character, got none")
    return Path(text)


def words_of(options: argparse.Namespace) -> TextIO:
    """Return the stream for messages: standard error if results go to standard output."""
    return sys.stderr if options.output is STDOUT else sys.stdout


def named(path: Path) -> str:
    """Return the name of a target in messages."""
    from rhl._checks import shown

    return "standard output" if path is STDOUT else shown(path)


def deliver(path: Path, content: str | bytes, force: bool) -> None:
    """Write a whole target; overwrite an existing file only with --force."""
    from rhl._files import write_whole

    if path is STDOUT:
        assert isinstance(content, str)
        sys.stdout.write(content)
        sys.stdout.flush()
    else:
        write_whole(path, content, new=not force)


def check_targets(options: argparse.Namespace) -> None:
    """Refuse targets that cannot be written, or are named twice, before any work is done."""
    if options.plot and options.plot.suffix not in (".svg", ".pdf", ".png"):
        raise InputError(f"--plot must end in .svg, .pdf or .png, got {named(options.plot)}")
    taken: dict[Path, str] = {}
    if getattr(options, "config", None):
        taken[options.config.resolve()] = "the configuration"
    for flag, path in ((getattr(options, "flag", "--output"), options.output), ("--plot", options.plot)):
        if path is STDOUT:
            # `open_streams` put this in place of a closed one.
            if getattr(sys.stdout, "name", None) == os.devnull:
                raise InputError(f"{flag} must name a target that can be written, got standard output, which is closed")
        elif path is not None:
            _check(flag, path, options.force, taken)


def _check(flag: str, path: Path, force: bool, taken: dict[Path, str]) -> None:
    from rhl._files import is_stream

    name = named(path)
    try:
        if is_stream(path):
            if not os.access(path, os.W_OK):
                raise PermissionError(13, os.strerror(13))
            return
        resolved = path.resolve()
        if not resolved.parent.is_dir():
            raise InputError(f"{flag} must name a file in a folder that exists, got {name}")
        if resolved.is_dir():
            raise InputError(f"{flag} must name a file, got the folder {name}")
        if not os.access(resolved if resolved.exists() else resolved.parent, os.W_OK):
            raise PermissionError(13, os.strerror(13))
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        why = getattr(error, "strerror", None) or error
        raise InputError(f"{flag} must name a file that can be written, got {name}: {why}") from None
    if resolved in taken:
        raise InputError(f"{flag} must name a file of its own, got {name}, which is {taken[resolved]}")
    if resolved.exists() and not force:
        raise InputError(f"{flag} must name a new file, got {name}, which exists; add --force to write over it")
    taken[resolved] = f"also that of {flag}"
