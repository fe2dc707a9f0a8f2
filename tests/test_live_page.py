"""The page that runs rhl in the browser: what it shows is what the library computes, and so is what it refuses.

The same comparison is made twice: in an interpreter without numpy, numba or a browser, which is quick, and in Chromium.
"""

import importlib.util
import io
import json
import subprocess
import sys
import zipfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from rhl import (
    Controller,
    DelayLifting,
    LinearPlant,
    PowerDecay,
    ProximalEstimator,
    Scheme,
    SignalModel,
    simulate,
    window_scheme,
)
from rhl.controllability import ConstantMixing
from rhl.disturbances import Offset
from rhl.errors import RHLError
from rhl.losses import WeightedSquares
from rhl.paper import playground
from rhl.paper.published import linear_example
from tests import browser as seen
from tests.conftest import HTML, ROOT, current_book, needed

sys.path.insert(0, str(ROOT / "book/_ext"))

import live_page

LIVE = ROOT / "book/_static/live"
PAGE = "book/live.html"
PRESETS = {preset.name: dict(preset.fields) for preset in playground.presets()}
PUSHED = {"push_step": "20", "push_size": "0.5"}
# Ten plants: with one and several inputs and outputs, disturbed or not, and one with which the scheme fails.
RUNS = {
    "linear-example": {},
    "scalar": PUSHED,
    "pendulum": PUSHED,
    "double-integrator": {"lambda": "0.3", "R": "0.5", "steps": "40"},
    "dc-motor": {"Q": "2 0.5 0; 0.5 1 0; 0 0 1"},
    "cstr": {"m": "3", "window": "7"},
    "maglev": {"delay": "1", "rho": "0.001"},
    "rosenbrock": PUSHED | {"push_size": "0.5 -1"},
    "spinning-satellite": {"N": "5"},
    "ogata-pendulum": {"steps": "50"},
}
AGREE = 1e-9  # relative to the largest entry of a signal in the run
BUDGET_BYTES = 15e6


def loaded(name, path):
    """Python of the page as a module beside numpy, without leaving byte code where pages are copied from."""
    spec = importlib.util.spec_from_file_location(name, LIVE / path)
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    before, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    try:
        spec.loader.exec_module(module)
    finally:
        sys.dont_write_bytecode = before
    return module


driver = loaded("live_driver", "driver.py")


@cache
def of_the_library(name):
    """The signals of a run as the library computes them, with numba."""
    settings = PRESETS[name] | RUNS[name]
    plant, scheme, z0, steps = driver.prepare(settings)
    at, size = driver.push(settings, plant)
    push = np.array(size)
    load = (Offset(push, at), Offset(-push, at + 1)) if push.any() else None
    trace = simulate(scheme, plant, z0, steps, load=load)
    return {
        **{f"y{i + 1}": trace.y[:, i] for i in range(plant.p)},
        **{f"v{i + 1}": trace.v[:, i] for i in range(plant.q)},
        "weight": trace.weight,
        "lifted": trace.margin_lifted,
        "augmented": trace.margin_augmented,
    }


def columns(rows):
    """The same of the driver's rows."""
    found = {}
    for key, first in rows[0].items():
        if isinstance(first, list):
            found |= {f"{key}{i + 1}": np.array([row[key][i] for row in rows]) for i in range(len(first))}
        else:
            found[key] = np.array([row[key] for row in rows])
    return found


def differences(found, wanted):
    """Signals that differ, by how much; a signal that is missing or of another length differs."""
    if found.keys() != wanted.keys():
        return {"signals": sorted(found.keys() ^ wanted.keys())}
    gaps = {}
    for key, values in wanted.items():
        same = len(found[key]) == len(values)
        gaps[key] = np.max(np.abs(found[key] - values)) / np.max(np.abs(values)) if same else np.inf
    return {key: gap for key, gap in gaps.items() if not gap <= AGREE}


# ---------------------------------------------------------------- what a reader may type, and the library's own words


def typed(**changes):
    """Settings of the linear example with something else in some fields."""
    return PRESETS["linear-example"] | changes


EXAMPLE = linear_example()


def plant(**changes):
    """The linear example's plant with other matrices."""
    return LinearPlant(**({name: getattr(EXAMPLE.plant, name) for name in "FGH"} | changes))


def controller(**changes):
    """The linear example's controller with other settings."""
    given = {"Q": 100.0, "R": 10000.0, "QN": 100.0, "horizon": 20, "epsilon": PowerDecay(100), "model_delay": 1}
    return Controller(**(given | changes))


def scheme(**changes):
    """The linear example's scheme with another controller, which may not fit."""
    of = EXAMPLE.scheme
    return Scheme(of.lifting, of.estimator, controller(**changes), of.initial_model)


ASYMMETRIC = "; ".join(" ".join("2" if j == i else "1" if j == i + 1 else "0" for j in range(7)) for i in range(7))
NEGATIVE = "; ".join(" ".join("-2" if i == j == 3 else str(int(i == j)) for j in range(7)) for i in range(7))
BAD = {
    "F is not square": (typed(F="1 2 3; 4 5 6"), lambda: plant(F=[[1, 2, 3], [4, 5, 6]])),
    "G of another size": (typed(G="1; 2"), lambda: plant(G=[[1], [2]])),
    "a ragged matrix": (typed(F="1 2; 3"), lambda: plant(F=[[1, 2], [3]])),
    "not a number": (typed(H="1 nan 0"), lambda: plant(H=[[1, float("nan"), 0]])),
    "infinite": (typed(F="0 1 0; 0 1e999 0; 0 0 1"), lambda: plant(F=[[0, 1, 0], [0, float("inf"), 0], [0, 0, 1]])),
    "empty": (typed(F=""), lambda: plant(F=[])),
    "no numbers": (typed(F="1 x; 2 3"), lambda: plant(F=[[1, "x"], [2, 3]])),
    "unparsable": (typed(G="a plant, please"), lambda: plant(G=[["a", "plant", "please"]])),
    "z(0) of another size": (typed(z0="1 2"), lambda: simulate(EXAMPLE.scheme, EXAMPLE.plant, [1, 2], 3)),
    "a negative weight": (typed(R="-1"), lambda: scheme(R=-1)),
    "a weight of another size": (typed(Q="1 0; 0 1"), lambda: scheme(Q=[[1, 0], [0, 1]])),
    "an asymmetric weight": (typed(QN=ASYMMETRIC), lambda: scheme(QN=driver.matrix(ASYMMETRIC))),
    "an indefinite weight": (typed(Q=NEGATIVE), lambda: scheme(Q=driver.matrix(NEGATIVE))),
    "a horizon of zero": (typed(N="0"), lambda: controller(horizon=0)),
    "a horizon in words": (typed(N="long"), lambda: controller(horizon="long")),
    "a window that is no integer": (typed(window="2.5"), lambda: ProximalEstimator(2.5)),
    "m too small": (typed(m="0"), lambda: DelayLifting(0, 0)),
    "no steps": (typed(steps="0"), lambda: simulate(EXAMPLE.scheme, EXAMPLE.plant, EXAMPLE.z0, 0)),
    "a rate of zero": (typed(eta="0"), lambda: PowerDecay(0)),
    "a proximal weight of zero": (typed(rho="0"), lambda: WeightedSquares(0)),
    "no mixing weight": (typed(**{"lambda": "1"}), lambda: ConstantMixing(1)),
    "a delay of two": (typed(delay="2"), lambda: controller(model_delay=2)),
}


def sentence(call):
    """What the library says to a call that it refuses."""
    with pytest.raises(RHLError) as refused:
        call()
    return str(refused.value)


# ---------------------------------------------------------------- without a browser

OUTSIDE = """
import json, sys
sys.dont_write_bytecode = True
sys.path.insert(0, sys.argv[1])
import driver, numpy, rhl
assert all("library.zip" in module.__file__ for module in (driver, numpy, rhl))
assert not {"numba", "scipy"} & sys.modules.keys()
json.dump([driver.whole(settings) for settings in json.load(sys.stdin)], sys.stdout)
"""


def changed(packed, name, before, after):
    """An archive in which one file has another line."""
    found = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(packed)) as source, zipfile.ZipFile(found, "w") as target:
        for entry in source.namelist():
            text = source.read(entry).decode()
            if entry == name:
                assert text.count(before) == 1
                text = text.replace(before, after)
            target.writestr(entry, text)
    return found.getvalue()


# The terminal weight a millionth larger: what a slip of the page's own copy would do, if it had one.
SLIP = ("rhl/kernels/loops.py", "weight[l] = alpha * weight", "weight[l] = 1.000001 * alpha * weight")


def interpreted(folder, all_settings, packed=None):
    """What the driver finds in an interpreter without numpy and numba, from the archive that the page loads."""
    archive = Path(folder) / "library.zip"
    archive.write_bytes(live_page.library(ROOT) if packed is None else packed)
    done = subprocess.run(
        [sys.executable, "-I", "-S", "-c", OUTSIDE, str(archive)],
        input=json.dumps(list(all_settings)),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_the_archive_holds_the_library_s_files_as_they_are():
    with zipfile.ZipFile(io.BytesIO(live_page.library(ROOT))) as archive:
        names = archive.namelist()
        assert {"rhl/kernels/loops.py", "rhl/_checks.py", "rhl/_engine.py", "rhl/scheme.py"} <= set(names)
        sources = {name: ROOT / name if name.startswith("rhl/") else LIVE / name for name in names}
        sources = {name: Path(str(path).replace("live/numpy", "live/stand_in")) for name, path in sources.items()}
        assert all(archive.read(name) == path.read_bytes() for name, path in sources.items())
    assert live_page.library(ROOT) == live_page.library(ROOT)


def test_runs_agree_without_a_browser(tmp_path):
    found = interpreted(tmp_path, (PRESETS[name] | changes for name, changes in RUNS.items()))
    assert len(RUNS) == 10
    for name, (rows, said) in zip(RUNS, found, strict=True):
        assert said == ""
        assert differences(columns(rows), of_the_library(name)) == {}, name


def test_another_line_in_the_loops_is_found(tmp_path):
    packed = changed(live_page.library(ROOT), *SLIP)
    ((rows, _),) = interpreted(tmp_path, [PRESETS["linear-example"]], packed)
    assert {"y1", "v1"} <= differences(columns(rows), of_the_library("linear-example")).keys()


def test_a_signal_that_is_missing_or_short_is_found():
    wanted = of_the_library("scalar")
    assert differences(wanted, wanted) == {}
    assert differences({key: wanted[key] for key in wanted if key != "v1"}, wanted) == {"signals": ["v1"]}
    assert differences(wanted | {"y1": wanted["y1"][:-1]}, wanted) == {"y1": np.inf}


def test_sentences_agree_without_a_browser(tmp_path):
    found = interpreted(tmp_path, (settings for settings, _ in BAD.values()))
    said = {name: answer[1] for name, answer in zip(BAD, found, strict=True)}
    assert said == {name: sentence(call) for name, (_, call) in BAD.items()}
    assert all(answer[0] == [] for answer in found)


# In the place of each field, alone and as the first of its entries.
ODD = [
    "0",
    "1",
    "-1",
    "2.5",
    "1e200",
    "-1e308",
    "1e-320",
    "nan",
    "inf",
    "-inf",
    "x",
    "True",
    "None",
    "1j",
    "0x10",
    "1_000",
    "∞",
    "1;2",
    "[[1,0],[0,1]]",
]


def test_whatever_is_typed_ends_as_in_the_library(tmp_path):
    short = typed(steps="3", N="4")
    cases = [short | {key: odd} for key in short for odd in ["", *ODD, "1" + "0" * 400]]
    cases += [
        short | {key: " ".join([odd, *short[key].split(" ")[1:]])} for key in ("F", "G", "H", "z0") for odd in ODD
    ]
    found = interpreted(tmp_path, cases)
    for case, (rows, said) in zip(cases, found, strict=True):
        wanted, words = driver.whole(case)
        assert (len(rows), said) == (len(wanted), words), case
    ends = {"ran" if len(rows) == 3 else "ended" if rows else "refused" for rows, _ in found}
    assert ends == {"ran", "ended", "refused"}


def test_a_run_that_leaves_the_range_of_numbers_ends_with_the_library_s_words(tmp_path):
    # No input reaches the state, which grows until no float holds it.
    settings = PRESETS["scalar"] | {"F": "1e150", "G": "0", "steps": "20"}
    ((rows, said),) = interpreted(tmp_path, [settings])
    k = len(rows)
    assert 0 < k < 20
    assert said.startswith(f"the run left the range of floating-point numbers at k = {k}: ")
    plant, scheme, z0, steps = driver.prepare(settings)
    assert sentence(lambda: simulate(scheme, plant, z0, steps)).startswith(f"{said.partition(':')[0]}:")


def test_the_page_has_bounds_of_its_own():
    for name, most in driver.MOST.items():
        found = driver.start(typed(**{name: str(most + 1)}))[1]
        assert found == f"{name} must be at most {most} on this page, got {most + 1}"
    wide = {"F": "1", "G": "1 1 1 1", "H": "1; 1; 1; 1", "z0": "1", "m": "4"}
    said = "m times the number of outputs and inputs must be at most 30 on this page, got 32"
    assert driver.start(typed(**wide))[1] == said
    assert driver.start(typed(push_size="1 2"))[1] == "the size of the disturbance must have 1 or 1 entries, got 2"
    assert driver.start(typed(push_step="-1"))[1].startswith("the step of the disturbance must be an integer")


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("1 2; 3 4", [[1, 2], [3, 4]]),
        ("1,2\n3,4", [[1, 2], [3, 4]]),
        ("[[1, 2], [3, 4.5]]", [[1, 2], [3, 4.5]]),
        ("−1e-3", [[-0.001]]),
        ("", []),
        ("1 two", [[1, "two"]]),
    ],
)
def test_matrices_as_they_are_typed(text, found):
    assert driver.matrix(text) == found


def test_fields_are_read_as_they_were_written():
    given = window_scheme(2, 1, 2)
    plant = LinearPlant([[1.1, 1 / 3], [1e-7, 0.9]], [[0.0], [1.0]], np.eye(2))
    fields = playground.fields(plant, given, np.array([0.1, -2.0]))
    read, scheme, z0, steps = driver.prepare(fields)
    assert all(np.array_equal(getattr(read, name), getattr(plant, name)) for name in "FGH")
    assert np.array_equal(z0, [0.1, -2.0])
    assert steps == 60
    assert scheme.controller.horizon == given.controller.horizon
    assert scheme.controller.epsilon == given.controller.epsilon
    assert scheme.estimator.window == given.estimator.window
    assert float(scheme.estimator.generator.weight) == float(given.estimator.generator.weight)
    assert np.array_equal(scheme.initial_model.theta, given.initial_model.theta)


# ---------------------------------------------------------------- the stand-in beside numpy

stand_in = loaded("live_stand_in", "stand_in/__init__.py")
RNG = np.random.default_rng(0)


def both(M):
    """A matrix as the stand-in's array and as numpy's."""
    return stand_in.array(M.tolist()), M


@pytest.mark.parametrize("shape", [(1, 1), (2, 5), (4, 4), (6, 3)])
def test_factorisations_agree(shape):
    M = RNG.standard_normal(shape) * 10.0 ** RNG.integers(-3, 3, shape)
    ours, theirs = both(M)
    sizes = np.linalg.svd(theirs, compute_uv=False)
    assert np.allclose(stand_in.linalg.svd(ours, compute_uv=False).tolist(), sizes, rtol=0, atol=1e-14 * sizes[0])
    ours, theirs = both(M @ M.T + np.eye(len(M)))
    assert np.allclose(stand_in.linalg.cholesky(ours).tolist(), np.linalg.cholesky(theirs), rtol=1e-13, atol=1e-9)
    values = np.linalg.eigvalsh(theirs)
    assert np.allclose(stand_in.linalg.eigvalsh(ours).tolist(), values, rtol=0, atol=1e-13 * values[-1])


def test_a_matrix_that_is_not_definite_has_no_factor():
    with pytest.raises(stand_in.linalg.LinAlgError):
        stand_in.linalg.cholesky(stand_in.array([[1.0, 2.0], [2.0, 1.0]]))


@pytest.mark.parametrize(
    "part",
    [
        lambda a: a[1],
        lambda a: a[-1, 0],
        lambda a: a[..., 1:, None],
        lambda a: a[:, ::-1],
        lambda a: a[a > 0.5],
        lambda a: a.T,
        lambda a: a.reshape(3, -1),
        lambda a: a + a[:1],
        lambda a: 2 / a,
        lambda a: a @ a.T,
        lambda a: a[0, 1:] - a[1, :-1],
    ],
)
def test_arrays_agree(part):
    ours, theirs = both(RNG.uniform(0.1, 1.0, (2, 3)))
    found, wanted = part(ours), part(theirs)
    assert stand_in.shape(found) == np.shape(wanted)
    assert np.allclose(found.tolist() if np.ndim(wanted) else found, wanted, rtol=1e-15)


def test_parts_of_larger_arrays_are_no_copies():
    ours, theirs = stand_in.zeros((2, 2, 2, 1)), np.zeros((2, 2, 2, 1))
    for array in (ours, theirs):
        array[1][0, 1, 0] = 5.0
        array[0, 1, 0, 0] = 3.0
        array[0, :1] = [[[7.0], [8.0]]] if array is theirs else stand_in.array([[[7.0], [8.0]]])
    assert stand_in.flat(ours) == theirs.ravel().tolist()


def test_what_is_missing_is_said():
    with pytest.raises(AttributeError, match="the stand-in for numpy has no fft"):
        _ = stand_in.fft
    with pytest.raises(NotImplementedError):
        _ = stand_in.zeros((2, 2))[[0, 1]]
    with pytest.raises(KeyError):
        _ = stand_in.Grid((2, 2))[2, 0]


# ---------------------------------------------------------------- in the browser

SETTLE = """(host) => new Promise((done) => {
  host.addEventListener("settled", ({ detail }) => done(detail), { once: true });
  host.querySelector("button.run").click();
})"""
NUMBERS = """(host) => {
  host.querySelector("details").open = true;
  return new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => {
    const rows = [...host.querySelectorAll("table tr")].map((row) => [...row.children].map((cell) => cell.textContent));
    done(rows);
  })));
}"""


@pytest.fixture(scope="module")
def engine():
    """Without an engine in the book skips, and in continuous integration fails."""
    if not (current_book() / "_static/live/engine/version").is_file():
        needed("the built book holds no engine; with npm installed, `make book` brings one")


def choose(page, name, changes):
    """Fill the fields as a shared address does."""
    page.evaluate(
        "([name, changes]) => { location.hash = new URLSearchParams([['plant', name], ...Object.entries(changes)]); }",
        [name, changes],
    )
    page.wait_for_function("(name) => document.querySelector('#rhl-live-plant').value === name", arg=name)
    for key, text in changes.items():
        page.wait_for_function(
            "([key, text]) => document.querySelector(`#rhl-live-${key}`).value.replaceAll('\\n', '; ') === text",
            arg=[key, text],
        )


def ran(page):
    """Press run, wait for the end, and read the table of numbers; with what the page was told at the end."""
    told = page.locator("[data-live]").evaluate(SETTLE)
    head, *rows = page.locator("[data-live]").evaluate(NUMBERS)
    return told, {name: np.array([float(row[i]) for row in rows]) for i, name in enumerate(head) if name != "k"}


def test_runs_agree_in_the_browser(chromium, site, engine):
    with seen.visit(chromium, site, PAGE, "light") as (page, found):
        for name, changes in RUNS.items():
            choose(page, name, changes)
            told, signals = ran(page)
            assert told["ended"] == ""
            assert differences(signals, of_the_library(name)) == {}, name
            assert page.locator(".rhl-live .charts figure:has(svg)").count() == 4
    assert found == []


@pytest.mark.nightly
def test_another_line_in_the_loops_is_found_in_the_browser(chromium, site, engine):
    packed = changed((HTML / "_static/live/library.zip").read_bytes(), *SLIP)
    with seen.visit(chromium, site, PAGE, "light") as (page, _):
        page.context.route("**/live/library.zip", lambda route: route.fulfill(body=packed))
        _, signals = ran(page)
        assert {"y1", "v1"} <= differences(signals, of_the_library("linear-example")).keys()


def test_the_built_archive_is_of_this_commit(site):
    assert (HTML / "_static/live/library.zip").read_bytes() == live_page.library(ROOT)


@pytest.mark.nightly
def test_sentences_agree_in_the_browser(chromium, site, engine):
    with seen.visit(chromium, site, PAGE, "light") as (page, found):
        for name, (settings, call) in BAD.items():
            changes = {key: text for key, text in settings.items() if text != PRESETS["linear-example"][key]}
            choose(page, "linear-example", changes)
            told = page.locator("[data-live]").evaluate(SETTLE)
            assert told["refused"] == sentence(call), name
            page.get_by_text(f"rhl refuses this: {sentence(call)}.", exact=True).wait_for()
            (key,) = changes
            assert page.locator("[aria-invalid=true]").get_attribute("id") == f"rhl-live-{key}", name
        choose(page, "linear-example", {})
        told, _ = ran(page)
        assert told["ended"] == ""
        assert page.locator("[aria-invalid=true]").count() == 0
    assert found == []


def test_nothing_is_loaded_before_it_is_asked_for(chromium, site, engine):
    asked = []
    with seen.visit(chromium, site, PAGE, "light") as (page, found):
        page.context.on("request", lambda request: "favicon" in request.url or asked.append(request.url))
        names = page.evaluate("() => performance.getEntriesByType('resource').map(({ name }) => name)")
        assert not [name for name in names if "/engine/" in name or "worker.js" in name or "library.zip" in name]
        promised = page.evaluate("() => rhlLive.bytes")
        ran(page)
        sizes = {url: (HTML / url.removeprefix(site)).stat().st_size for url in set(asked)}
        assert all(url.startswith(f"{site}_static/live/") for url in asked)
        assert any(url.endswith("engine/pyodide.asm.wasm") for url in asked)
        assert sum(sizes.values()) == promised < BUDGET_BYTES
    assert found == []


def test_a_run_can_be_stopped_and_shared(chromium, site, engine):
    with seen.visit(chromium, site, f"{PAGE}#plant=maglev&steps=500&N=40", "light") as (page, found):
        assert page.locator("#rhl-live-N").input_value() == "40"
        page.locator("#rhl-live-N").press("Enter")
        stop = page.get_by_role("button", name="Stop")
        page.wait_for_function("document.querySelectorAll('.rhl-live .charts figure:has(svg)').length === 4")
        stop.click()
        page.get_by_text("Stopped after").wait_for()
        assert stop.is_disabled()
        assert page.evaluate("location.hash") == "#plant=maglev&N=40&steps=500"
        choose(page, "scalar", {})
        told, signals = ran(page)
        assert told["ended"] == ""
        assert len(signals["y1"]) == 60
        page.get_by_role("button", name="Back to this plant's settings").click()
    assert found == []


@pytest.mark.nightly
def test_a_disturbance_is_dragged_into_the_input(chromium, site, engine):
    with seen.visit(chromium, site, f"{PAGE}#plant=pendulum", "light") as (page, found):
        _, before = ran(page)
        canvas = page.locator(".rhl-live .canvas.drag")
        canvas.scroll_into_view_if_needed()
        box = canvas.bounding_box()
        page.mouse.move(box["x"] + 0.8 * box["width"], box["y"] + 0.5 * box["height"])
        page.mouse.down()
        page.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 0.15 * box["height"], steps=3)
        ended = page.locator("[data-live]").evaluate_handle(
            "(host) => ({ told: new Promise((done) => host.addEventListener('settled', done, { once: true })) })"
        )
        page.mouse.up()
        ended.evaluate("({ told }) => told.then(() => 1)")
        step, size = (page.locator(f"#rhl-live-push_{part}").input_value() for part in ("step", "size"))
        assert 20 < int(step) < 45
        assert float(size) > 0
        head, *rows = page.locator("[data-live]").evaluate(NUMBERS)
        after = np.array([float(row[head.index("y1")]) for row in rows])
        assert np.array_equal(after[: int(step) + 1], before["y1"][: int(step) + 1])
        assert not np.allclose(after[int(step) + 1 :], before["y1"][int(step) + 1 :])
        plant, scheme, z0, steps = driver.prepare(PRESETS["pendulum"])
        load = Offset(float(size), int(step)), Offset(-float(size), int(step) + 1)
        wanted = simulate(scheme, plant, z0, steps, load=load).y[:, 0]
        assert np.max(np.abs(after - wanted)) <= AGREE * np.max(np.abs(wanted))
    assert found == []


@pytest.mark.parametrize("theme", [seen.THEMES[0], pytest.param(seen.THEMES[1], marks=pytest.mark.nightly)])
def test_the_page_with_a_run_is_accessible(chromium, site, engine, theme):
    with seen.visit(chromium, site, f"{PAGE}#plant=rosenbrock", theme) as (page, found):
        ran(page)
        assert found + seen.content_faults(page) + seen.too_wide(page) + seen.violations(page, theme) == []


def test_from_a_folder_the_page_says_that_it_cannot_run(chromium, site):
    with chromium.new_page() as page:
        page.goto((HTML / PAGE).as_uri())
        page.get_by_text("This page was opened from a folder").wait_for()
        assert page.locator("[data-live] a").get_attribute("href") == "explore.html"
        assert page.locator("button.run").count() == 0
        assert page.locator(".tag_live-picture img").first.is_visible()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("window.rhlLive.engine = '';", "This build of the book holds no engine"),
        ("delete window.WebAssembly;", "This browser has no WebAssembly or no workers"),
    ],
)
def test_without_an_engine_the_page_says_so(chromium, site, engine, change, words):
    build = (HTML / "_static/live/build.js").read_text(encoding="utf-8") + change
    with chromium.new_page() as page:
        page.route("**/live/build.js*", lambda route: route.fulfill(body=build, content_type="text/javascript"))
        page.goto(site + PAGE)
        page.get_by_text(words).wait_for()
        assert page.locator("button.run").count() == 0
        page.locator("[data-live] a").click()
        page.wait_for_url("**/book/explore.html")


@pytest.mark.nightly
def test_an_engine_that_cannot_be_loaded_is_said(chromium, site, engine):
    with chromium.new_page() as page:
        page.route("**/engine/pyodide.mjs", lambda route: route.abort())
        page.goto(site + PAGE)
        page.locator("button.run").click()
        page.get_by_text("The run could not be made").wait_for()
        page.unroute("**/engine/pyodide.mjs")
        told, _ = ran(page)
        assert told["ended"] == ""


def test_with_scripts_off_there_is_a_picture(chromium, site):
    with chromium.new_page(java_script_enabled=False) as page:
        page.goto(site + PAGE)
        assert page.locator("noscript p").inner_text().startswith("Scripts are off in this browser")
        assert page.locator("noscript p").is_visible()
        assert page.locator(".tag_live-picture img").first.is_visible()


# ---------------------------------------------------------------- the plants that are offered


def test_plants_to_begin_with():
    names = list(PRESETS)
    assert names[0] == "linear-example"
    assert len(names) == len(set(names)) >= 10
    for fields in PRESETS.values():
        plant, scheme, z0, steps = driver.prepare(fields)
        assert plant.n <= 5
        trace = simulate(scheme, plant, z0, steps)
        assert len(trace) == steps


def test_the_linear_example_is_the_published_one():
    plant, scheme, z0, _ = driver.prepare(PRESETS["linear-example"])
    ours, theirs = simulate(scheme, plant, z0, EXAMPLE.steps), EXAMPLE.run()
    assert np.array_equal(ours.y, theirs.y)
    assert np.array_equal(ours.v, theirs.v)


def test_the_initial_model_is_that_of_both_schemes():
    wanted = SignalModel.companion_of_ones(4, 4)
    assert np.array_equal(driver.prepare(PRESETS["linear-example"])[1].initial_model.theta, wanted.theta)


def test_the_page_is_told_of_the_engine_only_where_there_is_one(tmp_path):
    assert live_page.description(tmp_path / "none", 7) == live_page.description(tmp_path, 7)
    without = live_page.description(tmp_path, 7)
    assert (without["engine"], without["bytes"]) == ("", 0)
    (tmp_path / "version").write_text("1.2")
    (tmp_path / "a.wasm").write_bytes(b"1234")
    told = live_page.description(tmp_path, 7)
    assert (told["engine"], told["bytes"]) == ("1.2", 11)
    assert [plant["name"] for plant in told["presets"]] == list(PRESETS)


def test_work_of_minutes_is_refused():
    said = driver.start(typed(m="12", N="200", steps="500"))[1]
    assert said.startswith("steps, N and m must be small enough for a run of about a minute on this page, got ")
    assert driver.start(typed(m="4", N="40", steps="60"))[1] == ""


def test_odd_entries_that_python_reads_leave_no_script_broken(chromium, site, engine):
    with seen.visit(chromium, site, PAGE, "light") as (page, found):
        for fields in ({"z0": "1e308 0 0"}, {"steps": "٦٠"}, {"push_size": "−5", "push_step": "１０"}):
            choose(page, "linear-example", fields)
            told = page.locator("[data-live]").evaluate(SETTLE)
            curves = page.locator(".rhl-live .charts figure").first.locator(".curve").count()
            assert bool(curves) == (told["ended"] == ""), fields
    assert found == []


@pytest.mark.nightly
def test_an_engine_cut_short_is_reported_and_the_next_run_works(chromium, site, engine):
    with seen.visit(chromium, site, PAGE, "light") as (page, _):
        page.context.route("**/pyodide.asm.wasm", lambda route: route.fulfill(body=b"\0asm", status=200))
        page.get_by_role("button", name="Run", exact=True).click()
        page.get_by_text("The run could not be made: engine/pyodide.asm.wasm must have").wait_for()
        page.context.unroute("**/pyodide.asm.wasm")
        told, _ = ran(page)
        assert told["ended"] == ""


@pytest.mark.nightly
def test_a_finger_scrolls_past_the_chart_and_a_click_changes_nothing(chromium, site, engine):
    with seen.visit(chromium, site, f"{PAGE}#plant=scalar", "light") as (page, found):
        ran(page)
        canvas = page.locator(".rhl-live .canvas.drag")
        assert canvas.evaluate("canvas => getComputedStyle(canvas).touchAction") == "auto"
        before = page.locator("#rhl-live-push_size").input_value()
        canvas.click()
        assert page.locator("#rhl-live-push_size").input_value() == before
    assert found == []
