"""What pictures, sliders and maps show, as a few numbers each, so that a change of any of them is noticed.

    python -m tests.pictures    # records them anew in tests/data/pictures.json, after a change that is meant

A fingerprint is the count of the numbers in a picture and three sums of them; it tolerates rounding, not another place.
"""

import json
import re
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.figure import Figure

from rhl import V3, SignalModel, plotting, solve
from rhl.paper import chain, drawings, explored, figures, motion, sweeps, watch
from rhl.paper.chain_picture import legend, picture
from rhl.paper.claims.ledger import CLAIMS
from rhl.paper.claims.proximal import Ridge, Squares, iterate
from rhl.paper.published import linear_example, robot_arm

RECORD = Path(__file__).resolve().parent / "data/pictures.json"


def fingerprint(numbers: Iterable[float]) -> list[float]:
    """Count, sum, sum of sizes, and a sum weighted by place."""
    values = np.nan_to_num(np.array(list(numbers), dtype=float), posinf=1e9, neginf=-1e9)
    return [len(values), values.sum(), np.abs(values).sum(), float(values @ np.arange(1, len(values) + 1))]


def of_text(text: str) -> list[float]:
    """Of an SVG or other text: the numbers in it."""
    return fingerprint(float(number) for number in re.findall(r"-?\d+(?:\.\d+)?", text))


def of_figure(figure: Figure) -> list[float]:
    """Of a figure: places of lines, patches and words, and the limits of axes."""
    legends = [*figure.legends, *filter(None, (ax.get_legend() for ax in figure.axes))]
    found = [float(sum(map(ord, text.get_text()))) for legend in legends for text in legend.get_texts()]
    for ax in figure.axes:
        found += [*ax.get_xlim(), *ax.get_ylim()]
        for line in ax.lines:
            found += np.asarray(line.get_xydata(), dtype=float).ravel().tolist()
        for patch in ax.patches:
            found += patch.get_path().get_extents(patch.get_patch_transform()).extents.tolist()
        for text in ax.texts:
            found += [float(value) for value in text.xy] if hasattr(text, "xy") else [*map(float, text.get_position())]
        for collection in ax.collections:
            found += np.asarray(collection.get_offsets(), dtype=float).ravel().tolist()
    plt.close(figure)
    return fingerprint(found)


def of_data(data: object) -> list[float]:
    """Of nested lists and dictionaries: every number, in order; a string counts by its length."""

    def flat(part: object) -> Iterable[float]:
        if isinstance(part, dict):
            for value in part.values():
                yield from flat(value)
        elif isinstance(part, str):
            yield len(part)
        elif isinstance(part, list | tuple | np.ndarray | range):
            for value in part:
                yield from flat(value)
        elif part is not None:
            yield float(part)  # type: ignore[arg-type]

    return fingerprint(flat(data))


def _superposed() -> Figure:
    model, zero = SignalModel([[1.1, 0.5], [0.0, 0.9]], [[0.0], [1.0]]), np.zeros(2)
    x, r = np.array([2.0, -0.5]), np.array([-1.0, 0.6])
    parts = {"from x": solve(V3(model, 1.0, 1.0, zero, 8), x), "to r": solve(V3(model, 1.0, 1.0, r, 8), zero)}
    return drawings.superposed(parts, ("both", solve(V3(model, 1.0, 1.0, r, 8), x)))


def _shifted() -> Figure:
    now = np.arange(8.0).reshape(4, 2), np.ones((3, 1))
    return drawings.shifted_plan(now, (now[0] + 1, np.array([[1.0], [1.0], [0.0]])), now)


def _projections() -> Figure:
    normals, common = np.array([[1.0, 0.5], [0.2, 1.0]]), np.array([0.5, 0.3])
    levels = normals @ common
    ridges = [Ridge(a, float(b)) for a, b in zip(normals, levels, strict=True)]
    run = iterate(ridges, Squares(), np.array([2.0, 1.0]), np.zeros(2))
    return drawings.projections(normals, levels, run.centres, run.minimisers, common)


def _compared() -> Figure:
    figure, axes = plotting.panels(2)
    figures.against_published(axes[0], linear_example().run().y[:, 0], "linear_y", "y")
    plotting.differences(axes[1], {"a": np.array([1e-3, 1e-6]), "b": np.array([0.0, 1e-9])}, 1e-4)
    return figure


def _settings() -> list[float]:
    found = [each for name in sweeps.NAMES for group in sweeps.settings(name) for each in group]
    return [float(value) for setting in found for value in (setting.own, *setting.values)]


def _graph() -> str:
    nodes = chain.graph(CLAIMS, {claim.id: "cannot be checked" for claim in CLAIMS})
    return picture(nodes) + legend(nodes)


SETTINGS = "settings of sliders"  # themselves, not a fingerprint of them
PICTURES: dict[str, Callable[[], list[float]]] = {
    "window and plan": lambda: of_figure(drawings.window_and_plan(linear_example().run(), 9)),
    "arm": lambda: of_figure(drawings.arm_positions(robot_arm().run().z[:, 0], 5)),
    "superposed plans": lambda: of_figure(_superposed()),
    "shifted plan": lambda: of_figure(_shifted()),
    "projections": lambda: of_figure(_projections()),
    "linear example": lambda: of_figure(figures.reproduction(linear_example().run(), "linear")),
    "robot arm": lambda: of_figure(figures.reproduction(robot_arm().run(), "robot")),
    "a run": lambda: of_figure(plotting.run(linear_example().run())),
    "comparisons": lambda: of_figure(_compared()),
    "moving link": lambda: of_text(motion.link(np.linspace(1, 0, 9), 2.0, "A.", "B.", np.arange(9.0))._repr_html_()),
    "first page": lambda: of_text(figures.opening(watch.contrast())),
    "graph of statements": lambda: of_text(_graph()),
    SETTINGS: _settings,
    "spiral": lambda: of_data(sweeps.spiral(2000, 40)),
    "mixtures": lambda: of_data(sweeps.mixtures([2, 3])),
    "rates": lambda: of_data({**explored.pace(), "schedules": 0}),
    "a benchmark plant": lambda: of_data(explored.plant("toy")),
    "steps of the ball": lambda: of_data(watch.steps("ball")),
}


def main() -> None:
    """Record every picture."""
    found = {name: [float(f"{value:.9g}") for value in of()] for name, of in PICTURES.items()}
    RECORD.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
