"""The sweeps behind the page to explore, and the page itself in a browser: what it shows is what `rhl` computes."""

import gzip
import json
import re
from contextlib import contextmanager
from dataclasses import replace
from fractions import Fraction
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from rhl import plotting
from rhl.controllability import controllability_margin
from rhl.errors import InputError
from rhl.model import SignalModel
from rhl.paper import explored, sweeps
from rhl.paper.claims.lemma_5 import crossing_pairs
from rhl.paper.claims.proximal import tangential_turns
from rhl.paper.published import curve
from tools import fresh

ROOT = Path(__file__).resolve().parents[2]
HTML = ROOT / fresh.BUILT / "html"
DATA = HTML / "_static" / "explore" / "data"
PAGE = "book/explore.html"

# Numbers are written with six digits: half a unit of the last is this much of a number that begins with 1.
WRITTEN = 5.01e-6
# A curve is drawn to a hundredth of a pixel, on an axis of about a hundred pixels.
DRAWN = 1e-3


# ---------------------------------------------------------------- the sweeps


class Cubic:
    """z+ = z^3 + v: out of reach for any linear scheme, and soon out of the range of float64."""

    n = q = p = 1

    def step(self, z, v):
        return z**3 + v

    def output(self, z):
        return z


def apart(found, expected):
    """The largest difference of two lists of numbers, relative to the larger of the two entries; inf if they differ
    in length or in where nothing is known."""
    if len(found) != len(expected) or any((a is None) != (b is None) for a, b in zip(found, expected, strict=True)):
        return np.inf
    pairs = [(a, b) for a, b in zip(found, expected, strict=True) if a is not None]
    return max((abs(a - b) / max(abs(a), abs(b)) for a, b in pairs if a != b), default=0.0)


@pytest.mark.parametrize("name", sweeps.NAMES)
def test_a_record_is_the_run(name):
    trace, record = sweeps.experiment(name).run(), sweeps.record(sweeps.experiment(name))
    assert apart(record["y1"], trace.y[:, 0].tolist()) < WRITTEN
    assert apart(record["v1"], trace.v[:, 0].tolist()) < WRITTEN
    assert apart(record["weight"], trace.weight.tolist()) < WRITTEN
    assert apart(record["margin_augmented"], trace.margin_augmented.tolist()) < WRITTEN
    assert record["diverged"] is None
    assert record.keys() >= {key for panel in sweeps.signals(name) for key in panel["curves"]}


def test_a_run_that_diverges_says_where():
    example = sweeps.experiment("linear")
    arm = sweeps.experiment("robot")
    record = sweeps.record(replace(example, plant=Cubic(), z0=np.array([3.0])))
    assert 2 < record["diverged"] < example.steps
    assert len(record["y1"]) == record["diverged"]
    assert sweeps.record(replace(arm, z0=np.full(3, 1e300)))["diverged"] == 0


@pytest.mark.parametrize("name", sweeps.NAMES)
def test_every_setting_changes_the_run_but_for_its_own_value(name):
    example = sweeps.experiment(name)
    own = sweeps.record(example)
    for setting in (setting for group in sweeps.settings(name) for setting in group):
        assert list(setting.values) == sorted(set(setting.values))
        assert sweeps.record(setting.change(example, setting.own)) == own
        other = setting.values[-1 if setting.own == setting.values[0] else 0]
        assert sweeps.record(setting.change(example, other))["v1"] != own["v1"]


def test_the_last_setting_of_a_group_changes_fastest():
    group = sweeps.settings("linear")[0]
    short = tuple(replace(setting, values=(setting.values[0], setting.own)) for setting in group)
    runs = list(sweeps.sweep("linear", short))
    assert len(runs) == 8
    assert runs[-1] == sweeps.record(sweeps.experiment("linear"))
    assert runs[6] == sweeps.record(group[2].change(sweeps.experiment("linear"), group[2].values[0]))
    assert runs[3] == sweeps.record(group[0].change(sweeps.experiment("linear"), group[0].values[0]))


def test_published_curves_are_the_paper_s():
    panels = sweeps.signals("linear")
    assert apart(panels[0]["published"]["y1"], curve("linear_y").tolist()) < WRITTEN
    assert apart(panels[0]["published"]["y1"], curve("linear_u").tolist()) > 1


def test_errors():
    with pytest.raises(InputError, match="name must be one of linear, robot, printed, got 'other'"):
        sweeps.settings("other")
    with pytest.raises(InputError, match="values of a must hold the experiment's own, 3"):
        sweeps.Setting("a", "words", "a", (1.0, 2.0), 3.0, lambda e, value: e)


def test_spiral_and_mixtures():
    spiral = sweeps.spiral(steps=1000, points=40)
    norm, angle = tangential_turns(1000, 0.75)
    assert apart(spiral["norm"][spiral["own"]], norm[spiral["k"]].tolist()) < WRITTEN
    assert apart(spiral["angle"][spiral["own"]], angle[spiral["k"]].tolist()) < WRITTEN
    mixtures = sweeps.mixtures([3])
    bad = set(mixtures["bad"][0])
    small = [place for place, value in enumerate(mixtures["margin"][0]) if value < 1e-12]
    assert set(small) >= bad
    assert len(bad) == mixtures["enough"][0]


# ---------------------------------------------------------------- the page


@contextmanager
def opened(chromium, url, ready="[data-explore=mixtures] svg", doctor=None, **context):
    """A page of a new context, closed at the end; `doctor` is given the page before it loads."""
    made = chromium.new_context(**context)
    page = made.new_page()
    page.set_default_timeout(20_000)
    if doctor:
        doctor(page)
    page.goto(url)
    if ready:
        for name in ("linear", "robot", "printed", "pace", "plants", "spiral"):
            page.wait_for_selector(f"[data-explore={name}] svg", state="attached")
        page.wait_for_selector(ready, state="attached")
    yield page
    made.close()


@pytest.fixture(scope="module")
def page(chromium, site):
    with opened(chromium, f"{site}{PAGE}") as page:
        page.locator("[data-explore] details").evaluate_all("all => all.forEach(one => { one.open = true })")
        yield page


def numbers(host):
    """The table of the run shown, column by column."""
    rows = host.evaluate(
        "host => [...host.querySelectorAll('.numbers tr')].map(row => [...row.cells].map(cell => cell.textContent))"
    )
    columns = zip(*rows[1:], strict=True)
    return [[None if entry == "–" else float(entry) for entry in column] for column in columns][1:]


def drawn(host, panel):
    """The first curve of a panel as drawn, its values read off the axis' own labels; relative to the axis' length."""
    chart = host.locator(".charts figure").nth(panel)
    path = chart.locator("path.curve").first.get_attribute("d")
    heights = [float(entry) for entry in re.findall(r"(?:M\S+ |V)(\S+?)(?=[HVML]|$)", path)]
    ticks = chart.locator("text.tick.up").evaluate_all(
        "all => all.map(t => [Number(t.dataset.value), t.getAttribute('y') - 4])"
    )
    return heights, ticks


def kind_of(host, panel):
    """How a panel's vertical axis is bent."""
    return host.locator(".charts figure svg[data-axis]").nth(panel).get_attribute("data-axis")


def off(heights, ticks, values, kind):
    """By which share of the axis, which is even, log or signed, the heights miss the values."""
    bend = {
        "even": np.array,
        "log": lambda v: np.log10(np.maximum(v, 1e-16)),
        "signed": lambda v: np.sign(v) * np.log10(1 + np.abs(v)),
    }[kind]
    at = np.array(ticks, dtype=float)
    at[:, 0] = bend(at[:, 0])
    slope, start = np.polyfit(*at.T, 1)
    return float(np.max(np.abs(slope * bend(values) + start - np.array(heights))) / np.ptp(at[:, 1]))


@cache
def computed(name, **changes):
    """What `rhl` computes with these settings, by key, the others being the experiment's own."""
    changed = sweeps.experiment(name)
    for setting in (setting for group in sweeps.settings(name) for setting in group):
        if setting.key in changes:
            changed = setting.change(changed, changes[setting.key])
    return sweeps.record(changed)


def mistakes(host, name, changes):
    """What in the explorer is not the run with these changes: columns of its table, curves of its charts."""
    record, panels = computed(name, **changes), sweeps.signals(name)
    # The axes stay as they are until they are asked to hold the run.
    host.get_by_role("button", name="Fit the axes").click()
    keys = [key for panel in panels for key in panel["curves"]]
    table = numbers(host)
    found = [key for key, column in zip(keys, table, strict=True) if not apart(column, record[key]) <= WRITTEN]
    for i, panel in enumerate(panels):
        key = next(iter(panel["curves"]))
        if not off(*drawn(host, i), record[key], kind_of(host, i)) <= DRAWN:
            found.append(f"curve of {key}")
    return found


# The caption of the table is "At N = 20, R = 100, ...".
SAYS = """([host, text]) => (host.querySelector(".numbers caption")?.textContent ?? "")
  .slice(3).split(", ").includes(text)"""


def moved(page, host, setting, key, text):
    """Press a key on a setting's slider and wait until the table is that of the new value."""
    host.locator("input[type=range]").nth(setting).focus()
    page.keyboard.press(key)
    page.wait_for_function(SAYS, arg=[host.element_handle(), text])


def shown(value):
    """How a slider words a number."""
    if 0.001 <= abs(value) < 1e4 or value == 0:
        return f"{value:.3g}".replace("-", "−") if abs(value) < 1000 else f"{value:.0f}"
    return "10" + f"{int(np.log10(value))}".translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


SLIDERS = [
    (name, place, setting)
    for name in sweeps.NAMES
    for place, setting in enumerate(setting for group in sweeps.settings(name) for setting in group)
]


# The first two and the last of each simulation; one script draws all, and the others are moved at night.
LAST = {name: max(place for of, place, _ in SLIDERS if of == name) for name in sweeps.NAMES}
MOVED = [
    pytest.param(
        *(name, place, setting),
        id=f"{name}-{setting.key}",
        marks=() if place < 2 or place == LAST[name] else pytest.mark.nightly,
    )
    for name, place, setting in SLIDERS
]


@pytest.mark.parametrize(("name", "place", "setting"), MOVED)
def test_each_slider_moved_by_keyboard_shows_what_rhl_computes(page, name, place, setting):
    host = page.locator(f"[data-explore={name}]")
    host.get_by_role("button", name="Back").click()
    assert mistakes(host, name, {}) == []
    own = setting.values.index(setting.own)
    for key, value in (
        ("ArrowLeft", setting.values[own - 1] if own else setting.values[own]),
        ("End", setting.values[-1]),
        ("Home", setting.values[0]),
        ("ArrowRight", setting.values[1]),
    ):
        moved(page, host, place, key, f"{setting.symbol} = {shown(value)}")
        said = host.locator("input[type=range]").nth(place).get_attribute("aria-valuetext")
        assert said.startswith(f"{setting.symbol} = {shown(value)}")
        assert mistakes(host, name, {setting.key: value}) == []
    # The control: the same picture is not the run beside it.
    assert mistakes(host, name, {setting.key: setting.values[0]})


def test_settings_of_one_group_are_combined_and_others_go_back(page):
    host = page.locator("[data-explore=linear]")
    host.get_by_role("button", name="Back").click()
    (horizon, weight, _), (_, _), (window,) = sweeps.settings("linear")[:3]
    moved(page, host, 0, "Home", "N = 1")
    moved(page, host, 1, "End", f"R = {shown(weight.values[-1])}")
    assert mistakes(host, "linear", {"horizon": horizon.values[0], "R": weight.values[-1]}) == []
    moved(page, host, 5, "Home", "N̄ = 1")
    assert mistakes(host, "linear", {"window": window.values[0]}) == []
    assert mistakes(host, "linear", {"window": window.values[0], "horizon": horizon.values[0]})


def test_what_changes_is_said(page):
    host = page.locator("[data-explore=linear]")
    moved(page, host, 6, "End", "λ = 0.95")
    said = page.wait_for_function(
        "host => [host.querySelector('[role=status]').textContent].find(text => text.includes('0.95'))",
        arg=host.element_handle(),
    ).json_value()
    peak = max(abs(value) for value in computed("linear", mixing=0.95)["y1"])
    assert f"|y| is at most {peak:.3g}" in said


def tampered(name, change):
    """A doctor that changes a file of runs on its way to the page."""

    def treat(page):
        def answer(route):
            text = (DATA / f"{name}.js").read_text(encoding="utf-8")
            head, body = text.split(",", 1)
            data = json.loads(body.rstrip()[:-1])
            change(data["runs"])
            route.fulfill(body=f"{head},{json.dumps(data)})", content_type="text/javascript")

        page.route(f"**/{name}.js", answer)

    return treat


def one_number(runs):
    runs[0]["y1"][7] *= 1.01


def wrong_place(runs):
    runs.insert(0, runs.pop())


@pytest.mark.parametrize("change", [one_number, wrong_place])
def test_tampered_data_are_noticed(chromium, site, change):
    with opened(chromium, f"{site}{PAGE}", doctor=tampered("linear-2-0", change)) as page:
        host = page.locator("[data-explore=linear]")
        host.locator("details").evaluate("one => { one.open = true }")
        moved(page, host, 5, "Home", "N̄ = 1")
        assert mistakes(host, "linear", {"window": 1})


def cut(runs):
    del runs[0]["y1"][9:]
    runs[0]["diverged"] = 9


def test_a_run_that_diverges_is_shown_as_such(chromium, site):
    with opened(chromium, f"{site}{PAGE}", doctor=tampered("linear-2-0", cut)) as page:
        host = page.locator("[data-explore=linear]")
        host.locator("details").evaluate("one => { one.open = true }")
        moved(page, host, 5, "Home", "N̄ = 1")
        assert host.locator("text.note").first.text_content() == "diverges, k = 9"
        host.get_by_text("leaves the range of floating-point numbers at k = 9").wait_for()
        assert len(numbers(host)[0]) == 9
        assert "NaN" not in host.inner_html()


def test_data_that_do_not_come_are_told(chromium, site):
    with opened(
        chromium, f"{site}{PAGE}", doctor=lambda page: page.route("**/linear-2-0.js", lambda r: r.abort())
    ) as page:
        host = page.locator("[data-explore=linear]")
        host.locator("input[type=range]").nth(5).focus()
        page.keyboard.press("Home")
        host.get_by_text("linear-2-0.js could not be loaded").wait_for()


def test_spiral(page):
    host = page.locator("[data-explore=spiral]")
    data = sweeps.spiral()
    steps, exponent = host.locator("input[type=range]").all()
    steps.focus()
    page.keyboard.press("Home")
    for _ in range(12):
        page.keyboard.press("ArrowRight")
    exponent.focus()
    page.keyboard.press("ArrowRight")
    k, e = data["k"][12], data["exponents"][data["own"] + 1]
    norm, angle = tangential_turns(k, e)
    point = host.locator("circle.point")
    at = complex(float(point.get_attribute("cx")), -float(point.get_attribute("cy"))) / (360 / 2 - 22)
    assert abs(at - norm[-1] * np.exp(1j * angle[-1])) < 1e-4
    assert abs(at - norm[-2] * np.exp(1j * angle[-2])) > 1e-3
    host.get_by_text(f"After {k} steps with e = {e}").wait_for()


def test_mixtures(page):
    host = page.locator("[data-explore=mixtures]")
    lam, order = host.locator("input[type=range]").all()
    lam.focus()
    page.keyboard.press("Home")
    host.get_by_role("button", name="next bad").click()
    host.get_by_text("exactly not controllable, bad value 1 of 9").wait_for()
    lam.focus()
    page.keyboard.press("End")
    host.get_by_text("At λ = 1 the mixture of order 4").wait_for()
    data = sweeps.mixtures([4])
    heights = [float(y) for y in re.findall(r"[ML]\S+ (\S+?)(?=L|$)", host.locator("path.curve").get_attribute("d"))]
    assert off(heights, drawn(host, 0)[1], data["margin"][0], "log") <= DRAWN
    assert off(heights, drawn(host, 0)[1], data["margin"][0][::-1], "log") > DRAWN
    order.focus()
    page.keyboard.press("Home")
    host.get_by_text("3 nonzero candidates are enough; the paper tries 9").wait_for()
    # What the page calls the margin at the far end is the margin of the controllable pair itself.
    pair = crossing_pairs(4, [Fraction(0), *(Fraction(1, 20 + i) for i in range(3))])[1]
    assert (
        apart(
            [data["margin"][0][-1]],
            [float(controllability_margin(SignalModel(*(np.array(M, dtype=float) for M in pair))))],
        )
        < 1e-5
    )


def weights(responses):
    """Bytes of what was loaded, by address, compressed as by a server that publishes books."""
    return {got.url: len(gzip.compress(got.body())) for got in responses if got.status == 200}


def test_the_page_is_light_and_asks_nobody_else(chromium, site):
    asked = []
    with opened(
        chromium, f"{site}{PAGE}", doctor=lambda page: page.on("response", lambda response: asked.append(response))
    ):
        sizes = weights(asked)
    assert all(url.startswith(site) for url in sizes)
    data = {url: size for url, size in sizes.items() if "/explore/data/" in url}
    assert len(data) == 8
    assert sum(sizes.values()) - sum(data.values()) < 1.5e6
    assert sum(path.stat().st_size for path in DATA.iterdir()) < 2.5e6


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_without_scripts_a_picture_stands_there(chromium, site, scheme):
    with opened(chromium, f"{site}{PAGE}", ready=None, java_script_enabled=False, color_scheme=scheme) as page:
        assert page.locator("[data-explore]:visible").count() == 0
        assert page.locator("noscript p").is_visible()
        pictures = page.locator(".rhl-figure img:visible")
        assert pictures.count() == 7
        assert all(len(text.split()) > 10 for text in pictures.evaluate_all("all => all.map(one => one.alt)"))


def test_with_scripts_the_pictures_make_room(page):
    assert page.locator("[data-explore]:visible").count() == 7
    assert page.locator(".rhl-figure img:visible").count() == 0


def test_the_page_works_from_a_folder(chromium, site):
    with opened(chromium, (HTML / PAGE).as_uri()) as page:
        host = page.locator("[data-explore=robot]")
        host.locator("details").evaluate("one => { one.open = true }")
        moved(page, host, 0, "Home", "N = 1")
        assert mistakes(host, "robot", {"horizon": 1}) == []


def test_colours_are_those_of_the_figures(page):
    for theme in ("light", "dark"):
        page.evaluate("theme => { document.documentElement.dataset.theme = theme }", theme)
        colour = page.locator("path.curve.c1").first.evaluate("path => getComputedStyle(path).stroke")
        first = plotting.style(theme)["axes.prop_cycle"].by_key()["color"][0]
        assert colour == f"rgb({', '.join(str(int(first[i : i + 2], 16)) for i in (1, 3, 5))})"


def test_on_a_phone(chromium, site):
    phone = {"viewport": {"width": 360, "height": 700}, "has_touch": True, "is_mobile": True}
    with opened(chromium, f"{site}{PAGE}", **phone) as page:
        assert page.evaluate("document.documentElement.scrollWidth") <= 360
        targets = page.locator("[data-explore] :is(input, button, summary)").evaluate_all(
            "all => all.map(one => one.getBoundingClientRect().height)"
        )
        assert len(targets) > 20
        assert min(targets) >= 44
        host = page.locator("[data-explore=linear]")
        host.locator("details").evaluate("one => { one.open = true }")
        control = host.locator("input[type=range]").nth(5)
        # Not by coordinates of the page: the slider moves until the charts above it are drawn.
        control.tap(position={"x": 8, "y": control.bounding_box()["height"] / 2})
        page.wait_for_function(SAYS, arg=[host.element_handle(), "N̄ = 1"])
        assert mistakes(host, "linear", {"window": 1}) == []


# ---------------------------------------------------------------- what helps to compare runs


TICKS = (
    "host => [...host.querySelectorAll('.charts figure')].map(one => "
    "[...one.querySelectorAll('text.tick.up')].map(t => t.dataset.value).join())"
)


def test_axes_stay_until_they_are_asked_to_fit(chromium, site):
    with opened(chromium, f"{site}{PAGE}") as page:
        host = page.locator("[data-explore=linear]")
        host.locator("details").evaluate("one => { one.open = true }")
        begun = host.evaluate(TICKS)
        moved(page, host, 0, "Home", "N = 1")
        assert host.evaluate(TICKS) == begun
        host.get_by_text("Curves leave the axes, which stay as they were.").wait_for()
        host.get_by_role("button", name="Fit the axes").click()
        assert host.evaluate(TICKS)[0] != begun[0]
        assert "Curves leave" not in host.locator("[role=status]").inner_text()


def ghost(host):
    """The thin line in the first panel: heights, and the axis' labels."""
    found = host.locator(".charts figure").first.locator("path.ghost")
    return found.get_attribute("d") if found.count() else None


def test_the_run_before_stays_as_a_thin_line(chromium, site):
    with opened(chromium, f"{site}{PAGE}") as page:
        host = page.locator("[data-explore=linear]")
        host.locator("details").evaluate("one => { one.open = true }")
        curve_of = host.locator(".charts figure").first.locator("path.curve").first
        assert ghost(host) is None
        first = curve_of.get_attribute("d")
        moved(page, host, 6, "ArrowRight", "λ = 0.05")
        second = curve_of.get_attribute("d")
        assert ghost(host) == first != second
        moved(page, host, 6, "ArrowRight", "λ = 0.1")
        assert ghost(host) == second
        # While a slider is dragged, the run before is the one at which the dragging began.
        third = curve_of.get_attribute("d")
        control = host.locator("input[type=range]").nth(6)
        control.scroll_into_view_if_needed()
        box = control.bounding_box()
        page.mouse.move(box["x"] + 0.3 * box["width"], box["y"] + box["height"] / 2)
        page.mouse.down()
        for share in (0.4, 0.5, 0.6, 0.7):
            page.mouse.move(box["x"] + share * box["width"], box["y"] + box["height"] / 2)
            page.wait_for_timeout(50)
        page.mouse.up()
        page.wait_for_function(
            "([host, d]) => host.querySelector('path.curve').getAttribute('d') !== d",
            arg=[host.element_handle(), third],
        )
        assert ghost(host) == third


def test_a_change_that_resets_others_says_so(page):
    host = page.locator("[data-explore=linear]")
    host.get_by_role("button", name="Back").click()
    line = host.locator("[role=status]")
    assert "reset" not in line.inner_text()
    moved(page, host, 0, "Home", "N = 1")
    assert "reset" not in line.inner_text()
    moved(page, host, 6, "End", "λ = 0.95")
    assert line.inner_text().startswith("This reset the other settings to N = 20. At N = 20,")
    assert host.locator("input[type=range]").first.input_value() == str(
        sweeps.settings("linear")[0][0].values.index(20)
    )


def test_the_map_shows_peaks_and_sets_both_settings(chromium, site):
    horizon, weight, rate = sweeps.settings("linear")[0]
    with opened(chromium, f"{site}{PAGE}") as page:
        host = page.locator("[data-explore=linear]")
        host.locator(".numbers").evaluate("box => { box.closest('details').open = true }")
        cells = host.locator(".map tbody tr").evaluate_all(
            "rows => rows.map(row => [...row.querySelectorAll('td')].map(cell => cell.textContent))"
        )
        assert (len(cells), len(cells[0])) == (len(weight.values), len(horizon.values))

        def peak(N, R, **more):
            return max(abs(y) for y in computed("linear", horizon=N, R=R, **more)["y1"])

        for N, R in ((1, 100.0), (5, 1e6), (20, 1e4), (30, 1e8)):
            shows = cells[weight.values.index(R)][horizon.values.index(N)]
            assert shows == str(round(peak(N, R)))
        assert cells[0][4] != str(round(peak(5, 1e6)))
        # The cell of the run shown takes the focus, arrows go on, Enter sets both sliders.
        chosen = host.locator(".map td[aria-selected=true]")
        assert chosen.get_attribute("aria-label").startswith("N = 20, R = 10⁴: largest output ")
        chosen.focus()
        page.keyboard.press("ArrowLeft")
        page.keyboard.press("ArrowUp")
        page.keyboard.press("Enter")
        page.wait_for_function(SAYS, arg=[host.element_handle(), "N = 15"])
        page.wait_for_function(SAYS, arg=[host.element_handle(), "R = 1000"])
        assert mistakes(host, "linear", {"horizon": 15, "R": 1e3}) == []
        assert chosen.get_attribute("aria-label").startswith("N = 15, R = 1000")
        # It follows the third setting.
        moved(page, host, 2, "End", f"η = {shown(rate.values[-1])}")
        cell = host.locator(".map tbody tr").nth(4).locator("td").nth(4)
        assert cell.inner_text() == str(round(peak(5, 1e6, rate=rate.values[-1])))
        # What another group shows is not in the map.
        moved(page, host, 6, "End", "λ = 0.95")
        assert chosen.count() == 0


def test_a_run_that_diverges_is_marked_in_the_map(chromium, site):
    def doctor(page):
        def answer(route):
            head, body = (DATA / "linear.js").read_text(encoding="utf-8").split(",", 1)
            data = json.loads(body.rstrip()[:-1])
            data["peaks"][2] = None
            route.fulfill(body=f"{head},{json.dumps(data)})", content_type="text/javascript")

        page.route("**/linear.js", answer)

    with opened(chromium, f"{site}{PAGE}", doctor=doctor) as page:
        cell = page.locator("[data-explore=linear] .map td").first
        assert cell.inner_text() == "×"
        assert cell.get_attribute("aria-label") == "N = 1, R = 100: the run diverges"


def test_charts_stay_in_sight_on_a_desktop(chromium, site):
    with opened(chromium, f"{site}{PAGE}", viewport={"width": 1280, "height": 800}) as page:
        for name in ("linear", "robot"):
            host = page.locator(f"[data-explore={name}]")
            host.locator("input[type=range]").last.scroll_into_view_if_needed()
            top, bottom = host.locator(".charts").evaluate(
                "a => [a.getBoundingClientRect().top, a.getBoundingClientRect().bottom]"
            )
            slider = host.locator("input[type=range]").last.bounding_box()
            assert -1 <= top < bottom <= slider["y"] + 1


def test_the_spirals_caption_follows_the_picture(page):
    host = page.locator("[data-explore=spiral]")
    line = host.locator("[role=status]")
    data = sweeps.spiral()
    steps, exponent = host.locator("input[type=range]").all()
    steps.focus()
    page.keyboard.press("End")
    exponent.focus()
    page.keyboard.press("Home")
    assert f"e = {data['exponents'][0]}:" in line.inner_text()
    host.get_by_role("button", name="Let it turn").click()
    for _ in range(5):
        page.wait_for_timeout(60)
        place, said = host.evaluate(
            "host => [host.querySelector('input').value, host.querySelector('[role=status]').textContent]"
        )
        assert said.startswith(f"After {data['k'][int(place)]:,} steps with e = {data['exponents'][0]}:")
    assert int(place) < len(data["k"]) - 1
    host.get_by_role("button", name="Stop").click()


def test_the_pace(page):
    host = page.locator("[data-explore=pace]")
    data = explored.pace()
    horizon, schedule, growth = host.locator("input[type=range]").all()
    for control, place in ((horizon, 1), (schedule, 2), (growth, 3)):
        control.fill(str(place))
    said = host.locator("[role=status]").inner_text()
    ends = [data["size"][3][2][1][-1], (data["level"][3][1] * data["epsilon"][2][-1]) ** 0.5]
    assert f"With a = 1.8, N = 2 and ε(k) = {data['schedules'][2]}," in said
    assert f"settles at {data['level'][3][1]:.3g}" in said
    heights = [
        float(y) for y in re.findall(r"[ML]\S+ (\S+?)(?=L|$)", host.locator("path.curve").first.get_attribute("d"))
    ]
    assert off(heights, drawn(host, 0)[1], data["size"][3][2][1], "log") <= DRAWN
    assert off(heights, drawn(host, 0)[1], data["size"][3][1][1], "log") > DRAWN
    assert host.locator("path.curve").count() == 2
    assert abs(ends[0] / ends[1] - 1) < 0.02
    horizon.fill("5")
    assert "the stage costs alone hold the plant" in host.locator("[role=status]").inner_text()
    assert host.locator("path.curve").count() == 1


def test_plants_that_others_chose(page):
    host = page.locator("[data-explore=plants]")
    host.locator("select").select_option("doyle")
    host.get_by_text("Doyle's plant on which LQG regulators have no guaranteed margins, order 2").wait_for()
    host.get_by_role("button", name="Fit the axes").click()
    data = explored.plant("doyle")
    for noise in (0, 2):
        host.locator("input[type=range]").fill(str(noise))
        host.get_by_role("button", name="Fit the axes").click()
        for i, key in enumerate(("default", "window", "known")):
            path = host.locator("path.curve").nth(i).get_attribute("d")
            heights = [float(y) for y in re.findall(r"[ML]\S+ (\S+?)(?=L|$)", path)]
            assert off(heights, drawn(host, 0)[1], data[key][noise], "log") <= DRAWN
        assert off(heights, drawn(host, 0)[1], data["default"][noise], "log") > DRAWN
    assert host.locator("option").count() == len(explored.plant_names())
