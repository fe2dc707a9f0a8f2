"""The first page: the moving picture, and runs step by step; what it shows is what `rhl` computes."""

import gzip
import json
import re
from contextlib import contextmanager

import numpy as np
import pytest

from rhl.closed_loop import closed_loop
from rhl.errors import InputError
from rhl.paper import figures, watch
from tests.conftest import HTML

PAGE = "book/index.html"
DATA = HTML / "_static" / "explore" / "data"
# Numbers are written with six digits.
WRITTEN = 5.01e-6
# A curve is drawn to a hundredth of a pixel, on an axis of about a hundred pixels.
DRAWN = 1e-3
RNG = np.random.default_rng(20)
STEPS = [(name, int(k)) for name in watch.NAMES for k in sorted(RNG.choice(np.arange(1, 40), 3, replace=False))]


def close(found, expected):
    """Whether two lists of numbers are the same but for what is not written."""
    found, expected = np.array(found, dtype=float), np.array(expected)
    return found.shape == expected.shape and bool(np.all(np.abs(found - expected) <= WRITTEN * np.abs(expected)))


@pytest.fixture(scope="module")
def traces():
    return {name: watch.watched(name).experiment.run() for name in watch.NAMES}


# ---------------------------------------------------------------- the data


@pytest.mark.parametrize("name", watch.NAMES)
def test_the_data_are_the_run(traces, name):
    trace, data = traces[name], watch.steps(name)
    p = trace.scheme.p
    assert close(np.transpose(data["y"]), trace.y)
    assert close(np.transpose(data["predicted"]), trace.y_hat)
    assert close(np.transpose(data["v"]), trace.v)
    assert close(data["weight"], trace.weight)
    for k in (0, 5, len(trace) - 1):
        plan, model = trace.plan(k), trace.model(k)
        assert close(np.transpose(data["planned_y"][k]), plan.x[:, :p])
        assert close(np.transpose(data["planned_v"][k]), plan.u)
        assert close(plan.u[0], trace.v[k])
        assert close([of["values"][k] for of in data["of_outputs"]], model.A[:p].ravel())
        assert close([of["values"][k] for of in data["of_inputs"]], model.B[:p].ravel())
    # The control: the plan of the step before is another one.
    assert not close(np.transpose(data["planned_v"][5]), trace.plan(4).u)
    assert 0 < data["start"] < len(trace)
    assert len(data["outputs"]) == p


@pytest.mark.parametrize("name", watch.NAMES)
def test_what_the_model_is_fitted_to_is_what_the_estimator_uses(name):
    """A model changes with the outputs that it is fitted to, and with no older one."""
    experiment = watch.watched(name).experiment
    scheme = experiment.scheme
    steps = [done for _, done in zip(range(16), closed_loop(scheme, experiment.plant, experiment.z0), strict=False)]
    y = np.stack([done.y for done in steps])
    found = [watch.fitted(scheme, done.k) for done in steps]
    assert all(of is None or of[1] == done.k for of, done in zip(found, steps, strict=True))
    if name == "ball":
        first = scheme.first_measured
        assert [of for of in found if of] == [(first, k) for k in range(first, 16)]
        assert all(bool(np.any(done.data)) == (of is not None) for of, done in zip(found, steps, strict=True))
    else:
        window = scheme.estimator.window
        assert [of[1] - of[0] + 1 for of in found] == [min(k + 1, window) for k in range(16)]
    assert np.all(np.abs(y) > 0)


def test_no_other_run_is_watched():
    with pytest.raises(InputError, match="name must be one of ball, linear, arm, got 'other'"):
        watch.watched("other")


def test_the_three_runs_of_the_picture(traces):
    curves = watch.contrast()
    assert list(curves) == ["left alone", "known model", "this scheme"]
    assert np.array_equal(curves["this scheme"], traces["ball"].y[:, 0])
    plant, z = watch.suspended_ball().plant, watch.suspended_ball().z0
    for k in range(10):
        assert np.isclose(curves["left alone"][k], plant.output(z)[0], rtol=1e-12)
        z = plant.step(z, np.zeros(1))
    cost = {name: float(np.sum(values[:25] ** 2)) for name, values in curves.items()}
    assert cost["known model"] < cost["this scheme"] < cost["left alone"] / 100
    assert len({values[0] for values in curves.values()}) == 1


def points(picture, name):
    """The places of a curve in the picture."""
    path = re.search(rf'<path class="{name}" d="M([^"]+)"', picture)[1]
    return np.array([[float(part) for part in pair.split(" ")] for pair in path.split("L")])


def test_the_picture_draws_the_samples():
    curves = watch.contrast()
    picture = figures.opening(curves, 25)
    ticks = re.findall(r'y="([\d.]+)" text-anchor="end">(\d+)</text>', picture)
    levels = np.array([[float(value), float(y) - 5] for y, value in ticks])
    slope, start = np.polyfit(*levels.T, 1)
    assert slope < 0
    for name in ("known-model", "this-scheme"):
        drawn, values = points(picture, name), 100 * curves[name.replace("-", " ")][:25]
        assert len(drawn) == 25
        assert np.abs(drawn[:, 1] - slope * values - start).max() < 0.1
        assert np.abs(drawn[:, 1] - slope * values[::-1] - start).max() > 10
        assert levels[:, 1].min() <= drawn[:, 1].min()
        assert drawn[:, 1].max() < 200
    # Left alone it leaves the picture at the top.
    assert points(picture, "left-alone")[-1, 1] < 0


def test_files_are_small_and_legible():
    for name, text in watch.files():
        assert len(text.encode()) < 200_000
        assert json.loads(text)["y"], name


# ---------------------------------------------------------------- the page


@contextmanager
def opened(chromium, url, hash="", ready=True, doctor=None, **context):
    """The first page in a new context; `doctor` is given the page before it loads. Less motion unless asked for."""
    made = chromium.new_context(**{"reduced_motion": "reduce", "viewport": {"width": 1280, "height": 800}} | context)
    page = made.new_page()
    page.set_default_timeout(20_000)
    if doctor:
        doctor(page)
    page.goto(f"{url}{PAGE}{hash}")
    if ready:
        page.wait_for_selector("[data-explore=watch] svg", state="attached")
    yield page
    made.close()


@pytest.fixture(scope="module")
def page(chromium, site):
    with opened(chromium, site) as page:
        page.locator("[data-explore=watch] details").evaluate("one => { one.open = true }")
        yield page


AT = "k => document.querySelector('[data-explore=watch] input[type=range]').value === String(k)"


def turn_to(page, name, k):
    """Show a step of a run, by its address."""
    page.evaluate("hash => { location.hash = hash }", f"#watch={name}&k={k}")
    page.wait_for_function("name => document.querySelector('#rhl-watch-run').value === name", arg=name)
    page.wait_for_function(AT, arg=k)


def tables(page):
    """The plan, a row for each step ahead, and the model's entries by name, as the page shows them."""
    plan, model = page.locator("[data-explore=watch] table").evaluate_all(
        "all => all.map(one => [...one.tBodies[0].rows].map(row => [...row.cells].map(cell => cell.textContent)))"
    )
    return [[None if entry == "–" else float(entry) for entry in row] for row in plan], {
        name: float(value) for name, value in model
    }


def mistakes(page, trace, k):
    """What the page shows that is not step k of the run."""
    plan, model = tables(page)
    p, solved, found = trace.scheme.p, trace.plan(k), []
    if not close([row[1 : 1 + p] for row in plan], solved.x[:, :p]):
        found.append("planned outputs")
    if not close([row[1 + p :] for row in plan[:-1]], solved.u):
        found.append("planned inputs")
    of_outputs, of_inputs = watch.entries(trace)
    if not close(list(model.values()), [values[k] for values in (*of_outputs.values(), *of_inputs.values())]):
        found.append("model")
    chart = page.locator("[data-explore=watch] figure").first
    ticks = np.array(
        chart.locator("text.tick.up").evaluate_all(
            "all => all.map(t => [Number(t.dataset.value), t.getAttribute('y') - 4])"
        )
    )
    slope, start = np.polyfit(*ticks.T, 1)
    size = np.ptp(ticks[:, 1])
    path = chart.locator("path.curve.c1").get_attribute("d")
    heights = np.array([float(entry) for entry in re.findall(r"(?:M\S+ |V)(\S+?)(?=[HVML]|$)", path)])
    values = trace.y[: k + 1, 0]
    if len(heights) != k + 1 or np.max(np.abs(slope * values + start - heights)) > DRAWN * size:
        found.append("measured")
    mark = float(chart.locator("g.dots.now circle").get_attribute("cy"))
    if abs(slope * trace.y_hat[k, 0] + start - mark) > DRAWN * size:
        found.append("predicted")
    return found


@pytest.mark.parametrize(("name", "k"), STEPS)
def test_a_step_shows_what_rhl_computes(page, traces, name, k):
    turn_to(page, name, k)
    assert mistakes(page, traces[name], k) == []
    # The control: it is not the step after.
    assert {"measured", "planned inputs"} <= set(mistakes(page, traces[name], k + 1))


def test_a_step_in_words(page, traces):
    turn_to(page, "ball", 7)
    line = page.locator("[data-explore=watch] [role=status]")
    trace = traces["ball"]
    line.get_by_text("At step 7").wait_for()
    said = line.inner_text().replace("−", "-")
    assert f"predicted position = {trace.y_hat[7, 0]:.3g} m" in said
    assert f"position = {trace.y[7, 0]:.3g} m was measured" in said
    assert "outputs of steps 3 to 7" in said
    assert f"weights its end by {trace.weight[7]:.3g}." in said
    assert f"voltage = {trace.v[7, 0]:.3g} V, was applied" in said
    assert "looks 30 steps ahead" in said
    turn_to(page, "linear", 9)
    line.get_by_text("with the model of step 8: it looks 20 steps ahead").wait_for()
    assert f"Its first input, v = {traces['linear'].v[9, 0]:.3g}, was applied" in line.inner_text().replace("−", "-")


def half(data):
    data["planned_v"][7][0][0] /= 2


def shifted(data):
    data["y"][0].insert(0, data["y"][0].pop())


@pytest.mark.parametrize("change", [half, shifted])
def test_tampered_data_are_noticed(chromium, site, traces, change):
    def doctor(page):
        def answer(route):
            head, body = (DATA / "watch-ball.js").read_text(encoding="utf-8").split(",", 1)
            data = json.loads(body.rstrip()[:-1])
            change(data)
            route.fulfill(body=f"{head},{json.dumps(data)})", content_type="text/javascript")

        page.route("**/watch-ball.js", answer)

    with opened(chromium, site, "#watch=ball&k=7", doctor=doctor) as page:
        page.locator("[data-explore=watch] details").evaluate("one => { one.open = true }")
        page.wait_for_selector("[data-explore=watch] td")
        assert mistakes(page, traces["ball"], 7)


def test_by_keyboard(chromium, site):
    with opened(chromium, site, "#watch=linear&k=12") as page:
        host = page.locator("[data-explore=watch]")
        host.locator("input[type=range]").focus()
        page.keyboard.press("ArrowRight")
        page.wait_for_function(AT, arg=13)
        assert page.evaluate("location.hash") == "#watch=linear&k=13"
        page.keyboard.press("Home")
        page.wait_for_function(AT, arg=0)
        # Space plays, and pauses: afterwards nothing moves.
        page.keyboard.press(" ")
        assert host.get_by_role("button", name="Pause").is_visible()
        page.wait_for_function(AT, arg=2)
        page.keyboard.press(" ")
        assert host.get_by_role("button", name="Play").is_visible()
        page.wait_for_timeout(1000)
        assert page.evaluate(AT, 2)
        # Arrows step from a button too.
        host.get_by_role("button", name="Step back").focus()
        page.keyboard.press("ArrowRight")
        page.wait_for_function(AT, arg=3)
        page.keyboard.press("Enter")
        page.wait_for_function(AT, arg=2)
        # A click on a chart brings the focus there, so that the page does not scroll instead.
        host.locator(".canvas").nth(1).click()
        before = page.evaluate("scrollY")
        page.keyboard.press(" ")
        page.wait_for_function(AT, arg=3)
        page.keyboard.press(" ")
        assert page.evaluate("scrollY") == before
        host.locator("select").focus()
        page.keyboard.press("End")
        page.wait_for_function("document.querySelector('#rhl-watch-run').value === 'arm'")
        page.wait_for_function("location.hash === '#watch=arm&k=12'")


def test_a_link_restores_the_view(chromium, site):
    with opened(chromium, site, "#watch=arm&k=31") as page:
        assert page.evaluate(AT, 31)
        assert page.locator("#rhl-watch-run").input_value() == "arm"
        assert page.locator("[data-explore=watch] text.note").first.text_content() == "k = 31"
        page.wait_for_function("scrollY > 100")
    with opened(chromium, site, "#watch=linear&k=4000") as page:
        assert page.evaluate(AT, 41)
    for other in ("", "#watch=other&k=3", "#what-was-found"):
        with opened(chromium, site, other) as page:
            assert page.evaluate(AT, watch.watched("ball").start)
            assert page.evaluate("location.hash") == other


def test_the_link_is_copied_or_it_is_said_why_not(chromium, site):
    with opened(chromium, site, "#watch=ball&k=9", permissions=["clipboard-read", "clipboard-write"]) as page:
        page.get_by_role("button", name="Copy link").click()
        page.get_by_text("The link to this step is copied.").wait_for()
        assert page.evaluate("navigator.clipboard.readText()") == f"{site}{PAGE}#watch=ball&k=9"
    with opened(chromium, site, doctor=lambda p: p.add_init_script("delete Navigator.prototype.clipboard")) as page:
        page.get_by_role("button", name="Copy link").click()
        page.get_by_text("The address bar holds the link to this step.").wait_for()


def test_a_run_that_does_not_come_is_told(chromium, site):
    with opened(chromium, site, doctor=lambda p: p.route("**/watch-arm.js", lambda r: r.abort())) as page:
        page.locator("#rhl-watch-run").select_option("arm")
        page.get_by_text("watch-arm.js could not be loaded; this is still the suspended ball.").wait_for()
        assert page.locator("#rhl-watch-run").input_value() == "ball"


def test_values_under_the_pointer(page, traces):
    turn_to(page, "ball", 7)
    canvas = page.locator("[data-explore=watch] figure").first.locator(".canvas")
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    across = (box["width"] - 8 - 46) / (len(traces["ball"]) - 1)
    canvas.hover(position={"x": 46 + 4 * across, "y": box["height"] / 2})
    said = page.locator("[data-explore=watch] .readout:visible").inner_text()
    assert said.startswith("k = 4")
    assert f"measured: {traces['ball'].y[4, 0]:.3g}" in said
    page.mouse.move(0, 0)
    assert page.locator("[data-explore=watch] .readout:visible").count() == 0


SHOWN = "() => document.querySelector('.rhl-opening').dataset.shown"


def test_the_picture_moves_once_and_again_when_asked(chromium, site):
    with opened(chromium, site, reduced_motion="no-preference") as page:
        page.wait_for_function(f"() => ({SHOWN})() > 0 && ({SHOWN})() < 0.9")
        page.wait_for_function(f"() => ({SHOWN})() === '1'")
        page.wait_for_timeout(300)
        assert page.evaluate(SHOWN) == "1"
        page.get_by_role("button", name="Play again").click()
        page.wait_for_function(f"() => ({SHOWN})() < 0.9")


def test_the_picture_stands_still_where_less_motion_is_wanted(chromium, site):
    with opened(chromium, site) as page:
        page.wait_for_timeout(600)
        assert page.evaluate(SHOWN) == "1"
        assert page.locator(".rhl-opening .this-scheme").first.is_visible()
        page.locator(".rhl-opening").get_by_role("button", name="Play").click()
        page.wait_for_function(f"() => ({SHOWN})() < 0.9")


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_above_the_fold(chromium, site, theme):
    with opened(chromium, site, color_scheme=theme) as page:
        bottom = "one => one.getBoundingClientRect().bottom"
        assert page.locator(".rhl-opening svg").evaluate(bottom) < 800
        button = page.locator("a.start-here, .start-here a").first
        assert button.inner_text() == "Start here"
        assert button.evaluate(bottom) < 800
        assert page.locator("article section > p strong").first.evaluate(bottom) < 400
        # What shows code comes later: all of it, and there is some.
        tops = page.locator("article .cell, article pre").evaluate_all(
            "all => all.map(one => one.getBoundingClientRect().top)"
        )
        assert tops
        assert min(top for top in tops if top) > 800
        button.click()
        page.wait_for_url("**/book/scheme.html")


def test_without_scripts_pictures_stand_there(chromium, site):
    with opened(chromium, site, ready=False, java_script_enabled=False) as page:
        assert page.locator(".rhl-opening svg path").first.is_visible()
        assert page.locator(".rhl-opening button").count() == 0
        assert page.locator("[data-explore]:visible").count() == 0
        assert page.locator("img.rhl-light:visible").count() == 1
    with opened(chromium, site) as page:
        assert page.locator("img.rhl-light:visible").count() == 0


def test_the_page_is_light_and_asks_nobody_else(chromium, site):
    asked = []
    with opened(chromium, site, doctor=lambda p: p.on("response", lambda got: asked.append(got))):
        sizes = {got.url: len(gzip.compress(got.body())) for got in asked if got.status == 200}
    assert all(url.startswith(site) for url in sizes)
    # Only the run that is shown.
    assert sum("/explore/data/" in url for url in sizes) == 1
    assert sum(sizes.values()) < 1.5e6


def test_on_a_phone(chromium, site, traces):
    phone = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
    with opened(chromium, site, "#watch=ball&k=7", **phone) as page:
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        targets = page.locator(":is([data-explore], .rhl-opening) :is(input, button, summary, select)").evaluate_all(
            "all => all.map(one => one.getBoundingClientRect().height)"
        )
        assert len(targets) > 6
        assert min(targets) >= 44
        page.locator("[data-explore=watch] details").evaluate("one => { one.open = true }")
        page.wait_for_selector("[data-explore=watch] td")
        assert mistakes(page, traces["ball"], 7) == []
        letters = page.locator(".rhl-opening svg text").evaluate_all(
            "all => all.map(one => one.getBoundingClientRect().height)"
        )
        assert min(letters) > 11
