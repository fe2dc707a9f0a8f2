"""The paper's examples as figures: published samples and ours, and the README's picture."""

import re

import numpy as np
import pytest

from rhl import plotting
from rhl.paper import figures
from rhl.paper.published import curve, linear_example, robot_arm
from tests.conftest import ROOT


@pytest.fixture(scope="module")
def linear():
    return linear_example().run()


def test_reproduction_draws_the_published_samples_and_ours(linear):
    axes = figures.reproduction(linear, "linear").axes
    ours, published = axes[0].lines
    assert np.array_equal(ours.get_ydata(), linear.y[:41, 0])
    assert np.array_equal(published.get_ydata(), curve("linear_y"))
    assert not np.array_equal(ours.get_ydata(), curve("linear_y"))


def test_reproduction_of_the_arm():
    figure = figures.reproduction(robot_arm().run(), "robot")
    assert [ax.get_ylabel() for ax in figure.axes] == [
        "angle $x_1$ (rad)",
        "velocity $x_2$ (rad/s)",
        "current $x_3$ (A)",
        "|difference|",
    ]


def coordinates(svg: str) -> list[float]:
    return [float(number) for number in re.findall(r"-?\d+\.\d+", svg)]


# A thousandth of a point: round-off in the run moves nothing by as much, a changed run moves its curves by more.
SAME_PICTURE = 1e-3


def test_the_readmes_picture_is_what_the_library_draws(linear, tmp_path):
    path = tmp_path / "linear.svg"
    plotting.save(lambda: figures.reproduction(linear, "linear"), path)
    committed = (ROOT / "book/figures/linear-example.svg").read_text(encoding="utf-8")
    # The last panel shows differences near 1e-13, which are rounding itself; the first two are compared.
    fresh, kept = (text.split('id="axes_3"')[0] for text in (path.read_text(encoding="utf-8"), committed))
    assert len(coordinates(fresh)) > 500
    assert np.allclose(coordinates(fresh), coordinates(kept), atol=SAME_PICTURE)


def test_another_run_is_another_picture(tmp_path):
    path = tmp_path / "linear.svg"
    plotting.save(lambda: figures.reproduction(linear_example(printed=True).run(), "linear"), path)
    committed = (ROOT / "book/figures/linear-example.svg").read_text(encoding="utf-8")
    fresh, kept = (coordinates(t.split('id="axes_3"')[0]) for t in (path.read_text(encoding="utf-8"), committed))
    assert len(fresh) != len(kept) or not np.allclose(fresh, kept, atol=SAME_PICTURE)


def test_differences_and_predictions_are_drawn_as_they_are(linear):
    figure = figures.reproduction(linear, "linear")
    drawn = figure.axes[2].lines[0].get_ydata()
    assert np.allclose(drawn, np.maximum(np.abs(linear.y[:41, 0] - curve("linear_y")), 1e-17))
    assert drawn.max() > 0.1
    predicted = plotting.run(linear).axes[0].lines[1].get_ydata()
    assert np.array_equal(predicted, linear.y_hat[:, 0])
    assert not np.array_equal(predicted, linear.y[:, 0])
