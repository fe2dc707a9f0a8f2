"""Figures: what they hold, that they differ between themes, and the README's picture."""

import re
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest

from rhl import plotting
from rhl._checks import InputError
from rhl.published import curve, linear_example, robot_arm

ROOT = Path(__file__).resolve().parent.parent
ALT = "A line falls to zero and stays there."


@pytest.fixture(scope="module")
def linear():
    return linear_example().run()


def test_reproduction_draws_the_published_samples_and_ours(linear):
    axes = plotting.reproduction(linear, "linear").axes
    ours, published = axes[0].lines
    assert np.array_equal(ours.get_ydata(), linear.y[:41, 0])
    assert np.array_equal(published.get_ydata(), curve("linear_y"))
    assert not np.array_equal(ours.get_ydata(), curve("linear_y"))


def test_reproduction_of_the_arm():
    figure = plotting.reproduction(robot_arm().run(), "robot")
    assert [ax.get_ylabel() for ax in figure.axes] == [
        "angle $x_1$ (rad)",
        "velocity $x_2$ (rad/s)",
        "current $x_3$ (A)",
        "|difference|",
    ]


def test_run_draws_outputs_inputs_weight_and_margins(linear):
    axes = plotting.run(linear, "name").axes
    assert [len(ax.lines) for ax in axes] == [2, 1, 1, 2]
    assert np.array_equal(axes[3].lines[1].get_ydata(), linear.margin_augmented)


def test_pictures_differ_between_themes_and_carry_their_text(linear):
    picture = plotting.show(lambda: plotting.run(linear), alt=ALT)
    page = picture._repr_html_()
    assert page.count(f'alt="{ALT}"') == 2
    assert 'class="only-light' in page
    assert 'class="only-dark' in page
    assert picture.light != picture.dark
    assert "#0072b2" in picture.light
    assert "#0072b2" not in picture.dark


def test_drawing_leaves_the_settings_alone(linear):
    before = dict(mpl.rcParams)
    plotting.show(lambda: plotting.run(linear), alt=ALT)
    assert dict(mpl.rcParams) == before


@pytest.mark.parametrize("alt", ["", "figure.png", "A figure", "the output over time without an end"])
def test_alternative_text_must_be_a_sentence(linear, alt):
    with pytest.raises(InputError, match="alt must be a sentence"):
        plotting.show(lambda: plotting.run(linear), alt=alt)


@pytest.mark.parametrize("caption", ["figure.png", "A caption without an end"])
def test_caption_must_be_a_sentence_where_there_is_one(linear, caption):
    with pytest.raises(InputError, match="caption must be a sentence"):
        plotting.show(lambda: plotting.run(linear), alt=ALT, caption=caption)


def test_caption_is_shown_as_text(linear):
    page = plotting.show(lambda: plotting.run(linear), alt=ALT, caption="Two signals, y < 1, over k.")._repr_html_()
    assert "<figcaption>Two signals, y &lt; 1, over k.</figcaption></figure>" in page
    assert "figcaption" not in plotting.show(lambda: plotting.run(linear), alt=ALT)._repr_html_()


def test_pages_have_the_colours_of_figures():
    light, dark = plotting.css().splitlines()
    for theme, rule in (("light", light), ("dark", dark)):
        cycle = plotting.style(theme)["axes.prop_cycle"].by_key()["color"]
        assert all(f"--rhl-{i}: {colour};" in rule for i, colour in enumerate(cycle, start=1))
    assert "dark" in dark
    assert "dark" not in light


def test_first_page_draws_the_samples(linear):
    page = plotting.opening(linear)
    at = np.array([[float(x), float(y)] for x, y in re.findall(r'cx="(\S+)" cy="(\S+)"', page)])
    path = [float(y) for y in re.findall(r"(?:M\S+ |V)([\d.]+)", re.search(r' d="(\S+ [^"]+)"', page)[1])]
    assert len(at) == len(path) == len(curve("linear_y"))
    # Downwards on the page is downwards in the signal, in proportion.
    slope, _ = np.polyfit(curve("linear_y"), at[:, 1], 1)
    assert slope < 0
    assert np.abs(np.array(path) - at[:, 1]).max() < abs(slope) * 0.12 + 0.2
    assert np.abs(np.polyval(np.polyfit(curve("linear_y"), at[:, 1], 1), linear.y[:41, 0]) - path).max() < 0.2


@pytest.mark.parametrize(("suffix", "begin"), [(".svg", b"<?xml"), (".pdf", b"%PDF"), (".png", b"\x89PNG")])
def test_files_are_the_same_each_time(linear, tmp_path, suffix, begin):
    paths = [tmp_path / f"{name}{suffix}" for name in "ab"]
    for path in paths:
        plotting.save(lambda: plotting.run(linear), path)
    assert paths[0].read_bytes().startswith(begin)
    assert paths[0].read_bytes() == paths[1].read_bytes()


def test_unwritable_file(linear, tmp_path):
    with pytest.raises(InputError, match="must be a writable file"):
        plotting.save(lambda: plotting.run(linear), tmp_path / "no" / "fig.svg")


def coordinates(svg: str) -> list[float]:
    return [float(number) for number in re.findall(r"-?\d+\.\d+", svg)]


# A thousandth of a point: round-off in the run moves nothing by as much, a changed run moves its curves by more.
SAME_PICTURE = 1e-3


def test_the_readmes_picture_is_what_the_library_draws(linear, tmp_path):
    path = tmp_path / "linear.svg"
    plotting.save(lambda: plotting.reproduction(linear, "linear"), path)
    committed = (ROOT / "book/figures/linear-example.svg").read_text(encoding="utf-8")
    # The last panel shows differences near 1e-13, which are rounding itself; the first two are compared.
    fresh, kept = (text.split('id="axes_3"')[0] for text in (path.read_text(encoding="utf-8"), committed))
    assert len(coordinates(fresh)) > 500
    assert np.allclose(coordinates(fresh), coordinates(kept), atol=SAME_PICTURE)


def test_another_run_is_another_picture(tmp_path):
    path = tmp_path / "linear.svg"
    plotting.save(lambda: plotting.reproduction(linear_example(printed=True).run(), "linear"), path)
    committed = (ROOT / "book/figures/linear-example.svg").read_text(encoding="utf-8")
    fresh, kept = (coordinates(t.split('id="axes_3"')[0]) for t in (path.read_text(encoding="utf-8"), committed))
    assert len(fresh) != len(kept) or not np.allclose(fresh, kept, atol=SAME_PICTURE)


def test_differences_and_predictions_are_drawn_as_they_are(linear):
    figure = plotting.reproduction(linear, "linear")
    drawn = figure.axes[2].lines[0].get_ydata()
    assert np.allclose(drawn, np.maximum(np.abs(linear.y[:41, 0] - curve("linear_y")), 1e-17))
    assert drawn.max() > 0.1
    predicted = plotting.run(linear).axes[0].lines[1].get_ydata()
    assert np.array_equal(predicted, linear.y_hat[:, 0])
    assert not np.array_equal(predicted, linear.y[:, 0])


@pytest.mark.parametrize(("name", "theme", "sentence"), [("f.jpeg", "light", "must end in"), ("f.svg", "foo", "theme")])
def test_what_is_no_format_and_no_theme(linear, tmp_path, name, theme, sentence):
    with pytest.raises(InputError, match=sentence):
        plotting.save(lambda: plotting.run(linear), tmp_path / name, theme)
