"""The command `rhl compare`: benchmark plants under the scheme and its rivals, as a table and as rows."""

from __future__ import annotations

import argparse
import csv
import io
from dataclasses import fields

from rich.table import Table

from rhl.app._streams import complain, deliver, print_table, progress, undisturbed, words_of
from rhl.errors import InputError
from rhl.plants.benchmarks import benchmark, names
from rhl.study.compare import METHODS, Score, Summary, compare, summaries

# The input bound, as a multiple of the largest input of the regulator that knows the plant.
_BOUND = 3.0


def compared(options: argparse.Namespace) -> bool:
    """Run the comparison, print it, and write its rows if asked; False if it was interrupted.

    The results up to an interruption are printed and written too.
    """
    if options.plants and options.collection:
        raise InputError("--collection must be left out where plants are named, got both; name plants or a collection")
    plants = [benchmark(name) for name in options.plants or names(10, options.collection)]
    for name, given, most in (("--steps", options.steps, 100_000), ("--seeds", options.seeds, 1_000)):
        if given > most:
            raise InputError(f"{name} must be an integer of at most {most}, got {given}")
    levels = options.noise or [0.0]
    cases = [(plant, noise) for noise in levels for plant in plants]
    done: list[tuple[str, tuple[Score, ...]]] = []
    with progress("comparing", len(cases)) as show:
        try:
            for plant, noise in cases:
                scores = compare(
                    plant.sampled(),
                    plant.z0,
                    plant.order(),
                    options.steps,
                    seeds=options.seeds,
                    noise=noise,
                    bounded=_BOUND if options.bounded else None,
                    methods=options.method or METHODS,
                )
                done.append((plant.name, scores))
                show(len(done))
        except KeyboardInterrupt:
            undisturbed()
            complain(f"interrupted after {len(done)} of {len(cases)} plants")
    words = words_of(options)
    bounds = f"inputs at most {_BOUND:g} times the regulator's" if options.bounded else "no input bounds"
    for noise in levels:
        of = [(name, scores) for name, scores in done if scores[0].noise == noise]
        errors = f"noise {noise:g}" if noise else "no noise"
        number = "1 plant" if len(of) == 1 else f"{len(of)} plants"
        print_table(_table(of, f"{number}, {options.steps} steps, {errors}, {bounds}"), 110, words)
        for row in summaries(score for _, scores in of for score in scores):
            print(
                f"{row.method}: {row.at_rest} of {row.runs} at rest, {row.low_peak} of them with a peak below 100; "
                f"median cost {row.cost:.3g}, {1e3 * row.step_time:.2g} ms a step",
                file=words,
            )
    for name, scores in done:
        for score in scores:
            if score.failure:
                complain(f"{name}: {score.method}, seed {score.seed}: {score.failure}")
    if options.output:
        deliver(options.output, rows([(name, score) for name, scores in done for score in scores]), options.force)
    return len(done) == len(cases)


def _table(done: list[tuple[str, tuple[Score, ...]]], title: str) -> Table:
    """Return a table with a line for each plant and method; over several seeds it shows medians."""
    table = Table(title=title, title_justify="left")
    for heading in ("plant", "method", "at rest", "peak", "cost", "largest input", "1 % at k"):
        table.add_column(heading, no_wrap=True, justify="left" if heading in ("plant", "method") else "right")
    for name, scores in done:
        for row in summaries(scores):
            table.add_row(name, *_line(row, [score for score in scores if score.method == row.method]))
            name = ""
    return table


def _line(row: Summary, scores: list[Score]) -> tuple[str, ...]:
    largest, settled = (sorted(of)[len(scores) // 2] for of in zip(*map(_ordered, scores), strict=True))
    rest = f"{row.at_rest} of {row.runs}" if row.runs > 1 else "yes" if row.at_rest else "no"
    numbers = (f"{number:.3g}" for number in (row.peak, row.cost, largest))
    return (row.method, rest, *numbers, "" if settled == float("inf") else f"{settled:.0f}")


def _ordered(score: Score) -> tuple[float, float]:
    return score.largest_input, float("inf") if score.settled_at is None else score.settled_at


def rows(done: list[tuple[str, Score]]) -> str:
    """Return the text of a CSV file with a row for each run; numbers have 17 digits, and missing values are empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    columns = [field.name for field in fields(Score)]
    writer.writerow(["plant", *columns])
    for name, score in done:
        writer.writerow([name, *(_entry(getattr(score, column)) for column in columns)])
    return text.getvalue()


def _entry(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.17g}"
    return str(int(value)) if isinstance(value, bool) else str(value)
