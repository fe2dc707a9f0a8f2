"""Figures: what they hold, and that they differ between themes."""

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure

from rhl import plotting
from rhl.errors import InputError
from rhl.paper.published import linear_example
from rhl.plants import LinearPlant
from rhl.scheme import default_scheme
from rhl.simulation import simulate

ALT = "A line falls to zero and stays there."


@pytest.fixture(scope="module")
def linear():
    return linear_example().run()


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


@pytest.mark.parametrize(("name", "theme", "sentence"), [("f.jpeg", "light", "must end in"), ("f.svg", "foo", "theme")])
def test_what_is_no_format_and_no_theme(linear, tmp_path, name, theme, sentence):
    with pytest.raises(InputError, match=sentence):
        plotting.save(lambda: plotting.run(linear), tmp_path / name, theme)


@pytest.mark.parametrize(("width", "size"), [(plotting.WIDTH, 9.0), (1.5 * plotting.WIDTH, 13.0)])
def test_type_too_small_for_a_phone_is_refused(width, size):
    def draw():
        figure = Figure(figsize=(width, 2.0))
        figure.text(0.5, 0.5, "small", fontsize=size)
        return figure

    with pytest.raises(InputError, match=r"to be read on a phone, got .* for 'small'"):
        plotting.show(draw, alt=ALT)


def test_wide_figures_may_have_large_type():
    def draw():
        figure = Figure(figsize=(2 * plotting.WIDTH, 2.0))
        figure.text(0.5, 0.5, "large", fontsize=19)
        return figure

    assert plotting.show(draw, alt=ALT).alt == ALT


def test_the_axis_of_a_weight_that_vanishes_ends_where_nothing_is_seen():
    plant = LinearPlant([[1.1, 1.0], [0.0, 0.9]], [[0.0], [1.0]], [[1.0, 0.0]])
    trace = simulate(default_scheme(1, 1, 2), plant, [1.0, -1.0], 100)
    assert trace.weight[trace.weight > 0].min() < 1e-30 * trace.weight.max()
    low, high = plotting.run(trace).axes[2].get_ylim()
    assert 1e-21 * trace.weight.max() < low < high
    short = simulate(default_scheme(1, 1, 2), plant, [1.0, -1.0], 5)
    low, _ = plotting.run(short).axes[2].get_ylim()
    assert low < short.weight[short.weight > 0].min()  # otherwise every value is shown


@pytest.mark.parametrize(
    ("plant", "z0", "scales"),
    [
        (LinearPlant([[1.1]], [[1.0]], [[1.0]]), [0.0], ["linear", "linear"]),
        (LinearPlant([[1.1]], [[1.0]], [[0.0]]), [1.0], ["linear", "linear"]),
        (LinearPlant(np.eye(2) / 2, np.eye(2), [[1.0, 0.0], [0.0, 0.0]]), [1.0, 1.0], ["log", "linear"]),
        (LinearPlant([[1.1]], [[1.0]], [[1.0]]), [1.0], ["log", "log"]),
    ],
)
def test_signals_that_are_zero_are_drawn(plant, z0, scales):
    trace = simulate(default_scheme(plant.p, plant.q, 1), plant, z0, 6)
    axes = plotting.run(trace, "zero").axes
    assert [ax.get_yscale() for ax in axes[2:]] == scales
    drawn = axes[2].lines[0].get_ydata()
    assert np.array_equal(drawn[trace.weight > 0], trace.weight[trace.weight > 0])
    assert np.all(np.isfinite(drawn)) == (scales[0] == "linear" or np.all(trace.weight > 0))
    assert plotting.render(lambda: plotting.run(trace), "run.svg").startswith(b"<?xml")
