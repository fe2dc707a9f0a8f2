"""One thread, the processor's own kernels, and a plain table of every group at the end of `make bench`."""

import os
import re
import sys
from itertools import groupby
from pathlib import Path

# Before numpy loads: a BLAS reads its number of threads once, and tests may have pinned its kernels.
NUMPY_WAS_FIRST = "numpy" in sys.modules
os.environ.update({f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "OMP", "MKL", "NUMBA")})
for name in ("OPENBLAS_CORETYPE", "OPENBLAS_L2_SIZE"):
    os.environ.pop(name, None)


def machine():
    """The processor in one line."""
    info = Path("/proc/cpuinfo")
    found = re.search(r"model name\s*: (.*)", info.read_text(encoding="utf-8")) if info.exists() else None
    threads = "as set outside, numpy was loaded first" if NUMPY_WAS_FIRST else "1"
    return f"{found[1] if found else 'processor unknown'}, {os.cpu_count()} cores; BLAS threads: {threads}"


def time(seconds):
    """Seconds with a unit that leaves one to three digits before the point."""
    unit, factor = next(((u, f) for u, f in (("s", 1), ("ms", 1e3), ("us", 1e6)) if seconds * f >= 1), ("ns", 1e9))
    return f"{seconds * factor:.3g} {unit}"


def pytest_terminal_summary(terminalreporter):
    """Print a table for each group: median time of a step or call, its ratio to rhl's row, and what else was noted."""
    done = [bench for bench in terminalreporter.config._benchmarksession.benchmarks if bench and bench.stats.rounds]
    if not done:
        return
    terminalreporter.section(f"medians on {machine()}")
    for group, members in groupby(sorted(done, key=lambda bench: bench.group or ""), lambda bench: bench.group or ""):
        rows = [(bench.extra_info.pop("row", bench.name), bench) for bench in members]
        medians = [bench.stats.median / bench.extra_info.pop("steps", 1) for _, bench in rows]
        own = next((median for (name, _), median in zip(rows, medians, strict=True) if name == "rhl"), medians[0])
        columns = list(dict.fromkeys(name for _, bench in rows for name in bench.extra_info))
        table = [["", "median", "ratio", *columns]]
        for (name, bench), median in zip(rows, medians, strict=True):
            noted = [bench.extra_info.get(column, "") for column in columns]
            noted = [f"{value:.2g}" if isinstance(value, float) else str(value) for value in noted]
            table.append([name, time(median), f"{median / own:.2f}", *noted])
        widths = [max(map(len, column)) for column in zip(*table, strict=True)]
        terminalreporter.line(f"\n{group or 'no group'}")
        for name, *cells in table:
            aligned = [cell.rjust(width) for cell, width in zip(cells, widths[1:], strict=True)]
            terminalreporter.line("  ".join(["", name.ljust(widths[0]), *aligned]))
