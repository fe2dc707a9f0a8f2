"""The full comparison, too long for a page: twenty seeds, three noise levels, with and without input bounds.

These commands make it in about a quarter of an hour::

    rhl compare --seeds 20 --noise 0 --noise 0.01 --noise 0.05 --output free.csv
    rhl compare --seeds 20 --noise 0 --noise 0.01 --noise 0.05 --bounded --output bounded.csv
    python -m rhl.study.record free.csv bounded.csv > rhl/study/data/comparison.csv
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterable
from dataclasses import astuple, dataclass, fields
from importlib.resources import files
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class Cell:
    """The results of one method on one plant over its seeds.

    Attributes
    ----------
    plant, method : str
    noise : float
        Standard deviation of the errors, relative to the first outputs.
    bounded : bool
        Whether inputs were at most three times those of the regulator that knows the plant.
    runs, at_rest, low_peak : int
        The number of runs, of those at rest at the end, and of those of them with a peak below 100.
    peak, cost : float
        Medians over the runs, with three digits; infinite if half of them diverged.
    """

    plant: str
    method: str
    noise: float
    bounded: bool
    runs: int
    at_rest: int
    low_peak: int
    peak: float
    cost: float


def recorded() -> tuple[Cell, ...]:
    """Return the stored full comparison, plant by plant.

    Examples
    --------
    >>> known = [cell for cell in recorded() if cell.method == "known-plant" and not cell.bounded and not cell.noise]
    >>> {cell.cost for cell in known}
    {1.0}
    >>> recorded()[0]
    Cell(plant='ac1', method='known-plant', noise=0.0, bounded=False, runs=1, at_rest=1, ...)
    """
    text = files("rhl").joinpath("study", "data", "comparison.csv").read_text(encoding="utf-8")
    return tuple(
        Cell(
            row["plant"],
            row["method"],
            float(row["noise"]),
            row["bounded"] == "1",
            *(int(row[name]) for name in ("runs", "at_rest", "low_peak")),
            *(float(row[name]) for name in ("peak", "cost")),
        )
        for row in csv.DictReader(text.splitlines())
    )


def condensed(rows: Iterable[dict[str, str]]) -> list[Cell]:
    """Condense rows of ``rhl compare --output`` to a cell for each plant, method, noise and bound.

    Examples
    --------
    >>> row = {"plant": "toy", "method": "deepc", "noise": "0", "bounded": "", "at_rest": "1", "cost": "2.5"}
    >>> [cell.runs for cell in condensed([row | {"peak": "1.5"}, row | {"peak": "2.5"}])]
    [2]
    """
    groups: dict[tuple[str, str, float, bool], list[dict[str, str]]] = {}
    for row in rows:
        key = row["plant"], row["method"], float(row["noise"]), row["bounded"] != ""
        groups.setdefault(key, []).append(row)
    cells = []
    for key, of in groups.items():
        rest = [row["at_rest"] == "1" for row in of]
        low = [float(row["peak"]) < 100 for row in of]
        peak, cost = (float(f"{np.median([float(row[name]) for row in of]):.3g}") for name in ("peak", "cost"))
        cells.append(Cell(*key, len(of), sum(rest), sum(map(min, rest, low)), peak, cost))
    return cells


def main(paths: Iterable[str]) -> None:
    """Print the cells of files of rows as CSV."""
    rows = [row for path in paths for row in csv.DictReader(Path(path).read_text(encoding="utf-8").splitlines())]
    writer = csv.writer(sys.stdout, lineterminator="\n")
    writer.writerow([field.name for field in fields(Cell)])
    for cell in condensed(rows):
        writer.writerow([int(value) if isinstance(value, bool) else value for value in astuple(cell)])


if __name__ == "__main__":
    main(sys.argv[1:])
