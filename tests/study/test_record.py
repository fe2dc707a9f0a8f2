"""The full comparison as recorded: complete, and what a few of its cells are computed to be again."""

import csv
import io
from itertools import product

import numpy as np
import pytest

from rhl.app._compare import rows
from rhl.plants.benchmarks import benchmark, names
from rhl.study.compare import METHODS, Score, compare
from rhl.study.record import Cell, condensed, main, recorded
from tests.conftest import ROOT

CELLS = {(cell.plant, cell.method, cell.noise, cell.bounded): cell for cell in recorded()}
NOISE = (0.0, 0.01, 0.05)
SEEDS = max(cell.runs for cell in CELLS.values())


def test_every_case_is_there_once():
    # A method that is newer than the record is not in it.
    methods = {cell.method for cell in CELLS.values()}
    assert methods <= set(METHODS)
    assert set(CELLS) == set(product(names(10), methods, NOISE, (False, True)))
    assert len(recorded()) == len(CELLS)
    assert SEEDS >= 5
    for cell in CELLS.values():
        drawn = cell.method in ("excite-identify", "adaptive-lq", "deepc")
        assert cell.runs == (SEEDS if drawn or (cell.noise and cell.method != "known-plant") else 1)
        assert 0 <= cell.low_peak <= cell.at_rest <= cell.runs


def again(plant, method, noise, bounded, seed=0):
    one = benchmark(plant)
    scores = compare(
        one.sampled(),
        one.z0,
        one.order(),
        noise=noise,
        bounded=3.0 if bounded else None,
        methods=[method],
        seeds=CELLS[plant, method, noise, bounded].runs,
        seed=seed,
    )
    (cell,) = condensed(csv.DictReader(io.StringIO(rows([(plant, score) for score in scores]))))
    return cell


@pytest.mark.parametrize(
    "key",
    [
        ("ac10", "known-plant", 0.05, True),
        ("toy", "excite-identify", 0.0, False),
        ("cstr", "adaptive-lq", 0.01, False),
        ("maglev", "deepc", 0.0, False),
        ("dc-motor", "deepc", 0.05, True),
        ("rohrs", "paper", 0.05, False),
        ("rosenbrock", "window_scheme", 0.01, True),
    ],
)
def test_cells_are_what_they_were(key):
    cell, recalled = again(*key), CELLS[key]
    assert (cell.plant, cell.method, cell.noise, cell.bounded, cell.runs) == (*key, recalled.runs)
    # Runs on the verge may fall on either side where sums are taken in another order.
    assert abs(cell.at_rest - recalled.at_rest) <= 1
    assert np.isclose(cell.cost, recalled.cost, rtol=0.03)


def test_other_errors_make_other_cells():
    key = ("cstr", "adaptive-lq", 0.01, False)
    assert again(*key, seed=100).cost != CELLS[key].cost


def test_the_default_scheme_is_no_worse_than_recorded():
    for key in (("dc-motor", "default_scheme", 0.01, False), ("vehicle-lateral", "default_scheme", 0.0, True)):
        assert again(*key).at_rest >= 0.9 * CELLS[key].at_rest > 0


def scored(method, rest, peak, **about):
    return Score(method, rest, peak, peak, 1.0, None, **about)


def test_condensed():
    text = rows(
        [
            ("toy", scored("deepc", True, 2.0, noise=0.01)),
            ("toy", scored("deepc", True, 400.0, noise=0.01, seed=1)),
            ("toy", scored("deepc", False, np.inf, noise=0.01, seed=2)),
            ("toy", scored("deepc", True, 1.2345, bounded=3.0)),
        ]
    )
    assert condensed(csv.DictReader(io.StringIO(text))) == [
        Cell("toy", "deepc", 0.01, False, 3, 2, 1, 400.0, 400.0),
        Cell("toy", "deepc", 0.0, True, 1, 1, 1, 1.23, 1.23),
    ]


def test_what_is_printed_is_what_is_read(tmp_path, capsys, monkeypatch):
    file = tmp_path / "rows.csv"
    file.write_text(rows([("toy", scored("deepc", True, 2.5, bounded=3.0)), ("toy", scored("paper", False, np.inf))]))
    main([str(file)])
    (tmp_path / "study" / "data").mkdir(parents=True)
    (tmp_path / "study" / "data" / "comparison.csv").write_text(capsys.readouterr().out)
    monkeypatch.setattr("rhl.study.record.files", lambda _: tmp_path)
    assert recorded() == (
        Cell("toy", "deepc", 0.0, True, 1, 1, 1, 2.5, 2.5),
        Cell("toy", "paper", 0.0, False, 1, 0, 0, np.inf, np.inf),
    )


def test_the_readme_s_numbers_are_those_on_record():
    of = [cell for cell in recorded() if cell.method == "default_scheme" and not cell.noise and not cell.bounded]
    readme = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    assert f"It brings {sum(cell.at_rest for cell in of)} of {sum(cell.runs for cell in of)} benchmark plants" in readme
    assert f"Its median cost is {np.median([cell.cost for cell in of]):.0f} times that of the regulator" in readme
