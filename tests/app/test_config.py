"""The form of a run's file: what is read, what is refused, and in which words."""

import tomllib
from dataclasses import replace

import control
import jsonschema
import numpy as np
import pytest

from rhl.app._keys import FRACTION, WORDS, fitted, integer, key
from rhl.app._templates import template
from rhl.app.config import Config, keys, load, parse, schema
from rhl.controllability import ConstantMixing, LambdaSearch
from rhl.errors import InputError
from rhl.paper.published import linear_example, robot_arm
from rhl.plants import LinearPlant, RobotArm
from rhl.schedules import ExponentialDecay, PowerDecay
from rhl.scheme import default_scheme
from rhl.simulation import simulate

LINEAR = """\
name = "linear"
steps = 42
[plant]
kind = "linear"
F = [[0, 1, 0.1], [0, 1.02, 0], [0, 0, 0.92]]
G = [[0], [1], [0]]
H = [[1, 0, 1]]
z0 = [0.1, 0.1, -10]
[lifting]
outputs = 4
inputs = 4
[estimator]
window = 8
weight = 1.0
mixing = 0.0
A0 = "companion-of-ones"
B0 = "last-row-of-ones"
[controller]
Q = 100.0
R = 10000.0
QN = 100.0
horizon = 20
alpha = 1.0
eps_rate = 100.0
model_delay = 1
"""

ARM = """\
name = "arm"
steps = 62
[plant]
kind = "robot-arm"
variant = "data"
z0 = [5, -5, 1]
[lifting]
outputs = 2
inputs = 2
[estimator]
window = 10
weight = 1
mixing = 0.5
A0 = "companion-of-ones"
B0 = "eye-last-row-of-ones"
[controller]
Q = 10
R = [[100]]
QN = 10
horizon = 15
alpha = 1
eps_rate = 10
model_delay = 1
"""


def read(text: str) -> Config:
    return parse(tomllib.loads(text))


@pytest.mark.parametrize(("text", "example"), [(LINEAR, linear_example), (ARM, robot_arm)])
def test_files_describe_the_papers_examples(text, example):
    assert np.array_equal(read(text).experiment().run().columns()["v1"], example().run().columns()["v1"])


def test_another_setting_is_another_run():
    changed = read(LINEAR.replace("eps_rate = 100.0", "eps_rate = 1000.0")).experiment().run()
    assert np.abs(changed.v - linear_example().run().v).max() > 0.1


def test_parts():
    linear, arm = read(LINEAR).experiment(), read(ARM.replace('"data"', '"printed"')).experiment()
    assert isinstance(linear.plant, LinearPlant)
    assert linear.scheme.mixing == ConstantMixing(0.0)
    assert arm.plant == RobotArm("printed")
    searched = read(LINEAR.replace("mixing = 0.0", 'mixing = "search"')).experiment()
    assert searched.scheme.mixing == LambdaSearch()


def test_matrices_stand_for_names_and_numbers():
    eye = "[" + ", ".join(str([100.0 if i == j else 0.0 for j in range(7)]) for i in range(7)) + "]"
    text = (
        LINEAR.replace('"companion-of-ones"', "[[0,1,0,0],[0,0,1,0],[0,0,0,1],[1,1,1,1]]")
        .replace('"last-row-of-ones"', "[[0,0,0,0],[0,0,0,0],[0,0,0,0],[1,1,1,1]]")
        .replace("Q = 100.0", f"Q = {eye}", 1)
    )
    assert np.array_equal(read(text).experiment().run().v, linear_example().run().v)


REFUSED = [
    ("F = [[0, 1, 0.1], [0, 1.02, 0], [0, 0, 0.92]]", "F = [[0, 1], [1]]", "plant.F must be a rectangular array"),
    (
        "F = [[0, 1, 0.1], [0, 1.02, 0], [0, 0, 0.92]]",
        "F = [[0, 1, 2], [1, 2, 3]]",
        "plant.F must be square, got shape",
    ),
    ("F = [[0, 1, 0.1], [0, 1.02, 0], [0, 0, 0.92]]", "F = []", "plant.F must have shape"),
    ("0.92", "nan", "plant.F must be a square matrix of finite numbers"),
    ("0.92", "inf", "plant.F must be a square matrix of finite numbers"),
    ("0.92", '"a"', "plant.F must be .*'a'"),
    ("0.92", "true", "plant.F must be .*True"),
    ("0.92", "1" + "0" * 400, "plant.F must be a square matrix of finite numbers"),
    ("G = [[0], [1], [0]]", "G = [[1], [2]]", r"plant.G must have shape \(3, at least 1\), got \(2, 1\)"),
    ("H = [[1, 0, 1]]", "H = [[1, 0]]", r"plant.H must have shape \(at least 1, 3\), got \(1, 2\)"),
    ("z0 = [0.1, 0.1, -10]", "z0 = [1]", "plant.z0 must have 3 entries.* got 1"),
    ("z0 = [0.1, 0.1, -10]", "z0 = [[1, 2, 3]]", "plant.z0 must be a list"),
    ("z0 = [0.1, 0.1, -10]\n", "", "plant.z0 must be .* got nothing; add the key"),
    ('kind = "linear"', 'kind = "liner"', 'plant.kind must be "linear", .* or "python", got \'liner\''),
    ('kind = "linear"\n', "", "plant.kind must be .* got no such key"),
    ('kind = "linear"', 'kind = "robot-arm"', "plant.F is not a known key; expected one of kind, variant, z0"),
    ("outputs = 4", "outputs = 0", "lifting.outputs must be an integer from 1 to 100, .* got 0"),
    ("inputs = 4", "inputs = 1.5", "lifting.inputs must be an integer .* got 1.5"),
    ("window = 8", "window = -1", "estimator.window must be an integer .* got -1"),
    ("window = 8", "window = 1979-05-27", "estimator.window must be an integer"),
    ("weight = 1.0", "weight = 0", "estimator.weight must be a positive number.* got 0"),
    ("mixing = 0.0", "mixing = 1.0", r"estimator.mixing must be a number in \[0, 1\).* got 1.0"),
    ("mixing = 0.0", "mixing = nan", "estimator.mixing must be .* got nan"),
    ("mixing = 0.0", 'mixing = "serch"', "estimator.mixing must be .* got 'serch'"),
    ('"companion-of-ones"', "[[1, 2], [3, 4]]", r"estimator.A0 must have shape \(4, 4\) .* got \(2, 2\)"),
    ('"companion-of-ones"', '"ones"', "estimator.A0 must be .* got 'ones'"),
    ('"last-row-of-ones"', "[[1]]", r"estimator.B0 must have shape \(4, 4\) .* got \(1, 1\)"),
    ("R = 10000.0", "R = -1", "controller.R must be positive definite, got smallest eigenvalue -1"),
    ("R = 10000.0", "R = 0", "controller.R must be positive definite"),
    ("R = 10000.0", "R = [[1, 2], [3, 4]]", r"controller.R must be a number or a matrix of shape \(1, 1\)"),
    ("QN = 100.0", 'QN = "a"', "controller.QN must be a positive number .* got 'a'"),
    ("Q = 100.0", "Q = [[1, 2], [3, 4]]", r"controller.Q must be .* \(7, 7\), got shape \(2, 2\)"),
    ("horizon = 20", "horizon = 0", "controller.horizon must be an integer from 1 .* got 0"),
    ("horizon = 20", "horizon = true", "controller.horizon must be an integer .* got True"),
    ("horizon = 20", "horizon = 1" + "0" * 400, "controller.horizon must be an integer from 1 to 10000"),
    ("horizon = 20\n", "", "controller.horizon must be .* got nothing; add the key"),
    ("horizon = 20", "horizont = 20", "controller.horizont is not a known key; expected one of .*horizon"),
    ("alpha = 1.0", "alpha = -1", "controller.alpha must be a positive number.* got -1"),
    ("eps_rate = 100.0", "eps_rate = 0", "controller.eps_rate must be a positive number.* got 0"),
    ("model_delay = 1", "model_delay = 2", "controller.model_delay must be 0 .* or 1 .* got 2"),
    ("model_delay = 1", "model_delay = true", "controller.model_delay must be .* got True"),
    ("steps = 42", "steps = 0", "steps must be an integer from 1 .* got 0"),
    ("steps = 42\n", "", "steps must be .* got nothing; add the key"),
    ('name = "linear"', "name = 3", "name must be a string.* got 3"),
    ("steps = 42", "steps = 1" + "0" * 5000, "must be valid TOML, got: Exceeds the limit"),
    ("outputs = 4", "outputs = 1000", "lifting.outputs must be an integer from 1 to 100"),
    ("horizon = 20", '"a b\\n\\u001b[31m" = 1\nhorizon = 20', "controller.'a b.*31m' is not a known key"),
    (
        "[controller]",
        "[controler]",
        "controler is not a known key; expected one of name, steps, order, input_size, noise, set_point, plant",
    ),
    ("[lifting]\noutputs = 4\ninputs = 4\n", "", "lifting must be a section, got nothing; add the section"),
]


REFUSED += [
    (
        "window = 8",
        "window = 8\nloss_scale = 0.1",
        'estimator.loss_scale must be left out where loss is "sq.*got 0.1',
    ),
    (
        "window = 8",
        "window = 8\nlambda_max = 0.5",
        "estimator.lambda_max must be left out where mixing is",
    ),
    ("eps_rate = 100.0", "eps_rate = 1.0\neps_power = 2.0", "controller.eps_power must be left out where eps is 'harm"),
    (
        "[controller]",
        "[simulation]\noutlier_size = 2.0\n[controller]",
        "simulation.outlier_size must be left out",
    ),
    (
        "[controller]",
        "[rough]\nF = [[1]]\nG = [[1]]\nH = [[1]]\n[controller]",
        'estimator.A0 must be "rough" where there is a section',
    ),
]


@pytest.mark.parametrize(("old", "new", "sentence"), REFUSED, ids=[sentence[:60] for *_, sentence in REFUSED])
def test_refused(old, new, sentence, tmp_path):
    assert old in LINEAR
    path = tmp_path / "run.toml"
    path.write_text(LINEAR.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(InputError, match=sentence) as caught:
        load(path).experiment()
    assert "\n" not in str(caught.value)
    assert "\x1b" not in str(caught.value)


def test_a_transfer_function_may_have_several_channels_and_be_in_continuous_time():
    def plant(lines):
        head, tail = LINEAR[: LINEAR.index('kind = "linear"')], LINEAR[LINEAR.index("[lifting]") :]
        return read(f'{head}kind = "transfer-function"\n{lines}\n{tail}').plant.plant()[0]

    num, den = [[[1.0], [2.0, 1.0]], [[0.0], [3.0]]], [[[1.0, -1.0], [1.0, 2.0, 5.0]], [[1.0], [1.0, -1.0, 0.0]]]
    for more, dt, sampling in (("", True, None), ("sampling = 0.2", 0, 0.2)):
        found = plant(f"num = {num}\nden = {den}\nz0 = [0, 0, 0, 0, 0]\n{more}")
        wanted = LinearPlant.from_control(control.tf(num, den, dt), sampling)
        for ours, theirs in zip((found.F, found.G, found.H), (wanted.F, wanted.G, wanted.H), strict=True):
            np.testing.assert_array_equal(ours, theirs)
    shared = plant("num = [[[1], [2]], [[3], [4]]]\nden = [1, -1.1]\nz0 = [0, 0]")
    np.testing.assert_allclose(shared.H @ shared.G, [[1, 2], [3, 4]], rtol=1e-12)
    assert plant("num = [1]\nden = [1, 0]\nz0 = [0]\nsampling = 0.5").G == 0.5
    assert plant("num = [1]\nden = [1, 0]\nz0 = [0]").G == 1.0


@pytest.mark.parametrize(
    ("old", "new"), [("alpha = 1.0", "alpha = 2.0"), ("weight = 1.0", "weight = 2.0"), ("window = 8", "window = 7")]
)
def test_every_number_is_heeded(old, new):
    assert np.abs(read(LINEAR.replace(old, new)).experiment().run().v - linear_example().run().v).max() > 1e-3


def test_a_byte_order_mark_is_no_matter(tmp_path):
    path = tmp_path / "run.toml"
    path.write_text(LINEAR, encoding="utf-8-sig")
    assert load(path).steps == 42


def test_a_file_beyond_all_size_is_not_read(tmp_path):
    path = tmp_path / "run.toml"
    path.write_bytes(b"#" * 6_000_000)
    with pytest.raises(InputError, match="of at most 5000000 bytes"):
        load(path)


@pytest.mark.parametrize("value", ["1e150", "1e300"])
def test_an_initial_model_beyond_all_range_is_no_controllable_one(value):
    huge = f"[[{value}, 0, 0, 0], [0, {value}, 0, 0], [0, 0, {value}, 0], [0, 0, 0, {value}]]"
    text = LINEAR.replace('"companion-of-ones"', huge).replace("mixing = 0.0", 'mixing = "search"')
    with pytest.raises(InputError, match="must be controllable for a lambda-search"):
        read(text).experiment()


def test_unreachable_initial_model_is_refused_where_lambda_is_searched():
    dead = LINEAR.replace('"last-row-of-ones"', str([[0] * 4] * 4))
    assert read(dead).experiment().steps == 42
    with pytest.raises(InputError, match=r"\[estimator\] the initial model must be controllable"):
        read(dead.replace("mixing = 0.0", 'mixing = "search"')).experiment()


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"name = ", "must be valid TOML, got: Invalid value"),
        (b"\xff\xfe", "must be a TOML file in UTF-8"),
        (b"a = " + b"[" * 5000 + b"]" * 5000, "must be valid TOML, got: too deeply nested"),
        (b"", "name must be a string"),
    ],
)
def test_files_that_are_no_configuration(tmp_path, content, sentence):
    path = tmp_path / "run.toml"
    path.write_bytes(content)
    with pytest.raises(InputError, match=sentence):
        load(path)


def test_a_name_that_would_fill_the_screen():
    name = LINEAR.partition('"')[2].partition('"')[0]
    assert read(LINEAR.replace(name, "x" * 255, 1)).name == "x" * 255
    wanted = r"^name must be a string of at most 255 characters, the name of the run, .*, got 'x{56}\.\.\.$"
    with pytest.raises(InputError, match=wanted):
        read(LINEAR.replace(name, "x" * 256, 1))


def test_files_that_cannot_be_read(tmp_path):
    for path in (tmp_path / "missing.toml", tmp_path):
        with pytest.raises(InputError, match="must be a readable TOML file, got: "):
            load(path)


def test_every_key_is_documented():
    documented = dict(keys())
    assert all(documented.values())
    for text in (LINEAR, ARM):
        for section, entries in tomllib.loads(text).items():
            named = {f"{section}.{name}" for name in entries} if isinstance(entries, dict) else {section}
            assert named <= documented.keys()


def test_what_has_an_effect_is_heeded():
    robust = LINEAR.replace("window = 8", 'window = 8\nloss = "log-cosh"\nloss_scale = 0.1')
    assert read(robust).experiment().scheme.estimator.loss.scale == 0.1
    searched = LINEAR.replace("mixing = 0.0", 'mixing = "search"\nlambda_max = 0.5')
    assert read(searched).experiment().scheme.mixing.lambda_max == 0.5


def test_a_template_has_the_settings_of_the_default_scheme():
    file, default = read(template("mine")).experiment(), default_scheme(1, 1, 2)
    plant, z0 = file.plant, file.z0
    assert np.array_equal(simulate(file.scheme, plant, z0, 20).v, simulate(default, plant, z0, 20).v)


def test_the_schema_takes_what_the_parser_takes():
    validator = jsonschema.Draft202012Validator(schema())
    for text in (LINEAR, ARM, template("mine")):
        assert list(validator.iter_errors(tomllib.loads(text))) == []
    assert list(validator.iter_errors(tomllib.loads(LINEAR.replace("steps = 42", "steps = 0"))))
    assert list(validator.iter_errors(tomllib.loads(LINEAR.replace("horizon = 20", "horizont = 20"))))


VALUES = [
    *(True, 0, 1, -1, 2, 6, 7, 100, 101, 10_000, 10_001, 100_000, 100_001, 2**32 - 1, 2**32, 0.5, 1.5, -0.5, 5e-324),
    *(
        "",
        "?",
        "a\nb",
        "\x1b[31m",
        "größe",
        "none",
        "search",
        "squares",
        "constant",
        "linear",
        "data",
        "lifted",
        "first",
        "sharp",
        "rough",
    ),
    *([], [[]], [1], [[1.0]], [["?"]], [[[1.0]]], ["y1"], {}, {"a": 1}),
]
PLANTS = [
    {"kind": "transfer-function", "num": [1], "den": [1, 2], "z0": [1]},
    {"kind": "transfer-function", "num": [[[1], []]], "den": [[[1, 2], [1, 3]]], "sampling": 0.1, "z0": [1]},
    {"kind": "ready", "name": "slow-mode"},
    {"kind": "robot-arm", "variant": "data", "z0": [1, 2, 3]},
    {"kind": "python", "file": "p.py", "n": 1, "q": 1, "z0": [1]},
]


def verdicts(data):
    """Whether the parser takes a file, and whether the schema does."""
    try:
        parse(data)
    except InputError:
        return False, VALIDATOR.is_valid(data)
    return True, VALIDATOR.is_valid(data)


VALIDATOR = jsonschema.Draft202012Validator(schema())
ORDER = """
name = "no unit"
steps = 80
order = 2

[plant]
kind = "linear"
F = [[1.1, 1.0], [0.0, 0.9]]
G = [[0.0], [1.0]]
H = [[1.0, 0.0]]
z0 = [1.0, -1.0]
"""


def test_an_order_chooses_the_scheme():
    found = read(ORDER).experiment()
    trace = found.run()
    plant = LinearPlant([[1.1, 1.0], [0.0, 0.9]], [[0.0], [1.0]], [[1.0, 0.0]])
    assert np.array_equal(trace.v, simulate(default_scheme(1, 1, 2), plant, [1.0, -1.0], 80).v)
    assert np.abs(trace.z[-1]).max() < 1e-6
    other = read(ORDER.replace("order = 2", "order = 2\ninput_size = 0.5")).experiment().run()
    assert np.array_equal(other.v, simulate(default_scheme(1, 1, 2, 0.5), plant, [1.0, -1.0], 80).v)
    assert not np.array_equal(other.v, trace.v)


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("order = 2\n", "", "lifting must be a section, got nothing; add the section, or order in its place"),
        ("order = 2", "order = 0", "order must be an integer from 1 to 100, an upper bound .* got 0"),
        (
            "[plant]",
            "[knowledge]\nshift_rows = true\n[plant]",
            r"estimator.window must be given where \[knowledge\] is",
        ),
        (
            "[plant]",
            "[estimator]\nloss = 'log-cosh'\n[plant]",
            "estimator.loss must be left out where window is, since",
        ),
        (
            "[plant]",
            "[estimator]\nA0 = [[1, 0], [0, 1]]\n[plant]",
            "estimator.B0 must be given where A0 is, got nothing",
        ),
        ("[plant]", "[controller]\nbounded = true\n[plant]", "controller.bounded must be false where"),
        ("[plant]", "[controller]\neps_factor = 0.5\n[plant]", "controller.eps_factor must be left out where eps is"),
        (
            "[plant]",
            "[estimator]\nwindow = 5\ngenerator = 'entropy'\n[plant]",
            "estimator.weight must be given where generator",
        ),
        (
            "order = 2",
            "order = 2\ninput_size = 2\n[lifting]\ndegree = 2",
            "input_size must be left out where .knowledge. or",
        ),
        ("order = 2", "order = 2\nnoise = 2\n[lifting]\ndegree = 2", "noise must be left out where .knowledge. or"),
        (
            "order = 2",
            "order = 2\nset_point = [1, 2]",
            "set_point must be a number or have 1 entries, one for each output",
        ),
        ("order = 2", "order = 2\nset_point = nan", "set_point must be a number, .* got nan"),
        ("order = 2", "order = 2\ninput_size = -1", "input_size must be a positive number.* got -1"),
        ("order = 2", "order = 2\ninput_size = [1, 2]", "input_size must be a number or have 1 entries, .* got 2"),
    ],
)
def test_an_order_refused(old, new, sentence):
    with pytest.raises(InputError, match=sentence):
        read(ORDER.replace(old, new, 1)).experiment()


CHANGES = [
    ("[controller]\nR = 2.0", "controller", {"R": 2.0}),
    (
        "[controller]\nQ = 3\nQN = 4\nhorizon = 12\nalpha = 2",
        "controller",
        {"Q": 3, "QN": 4, "horizon": 12, "alpha": 2},
    ),
    ("[controller]\neps_rate = 7", "controller", {"epsilon": PowerDecay(7, 2)}),
    ("[controller]\neps_power = 3", "controller", {"epsilon": PowerDecay(1, 3)}),
    ("[controller]\neps = 'exponential'\neps_factor = 0.5", "controller", {"epsilon": ExponentialDecay(0.5)}),
    ("[controller]\nmodel_delay = 1\nadaptive = true", "controller", {"model_delay": 1, "adaptive": True}),
]


@pytest.mark.parametrize(("section", "part", "changed"), CHANGES)
def test_a_key_beside_an_order_changes_just_that(section, part, changed):
    found, default = read(f"{ORDER}\n{section}").experiment().scheme, default_scheme(1, 1, 2)
    expected = replace(default, **{part: replace(getattr(default, part), **changed)})
    plant = LinearPlant([[1.1, 1.0], [0.0, 0.9]], [[0.0], [1.0]], [[1.0, 0.0]])
    one, two, plain = (simulate(of, plant, [1.0, -1.0], 30).v for of in (found, expected, default))
    assert np.array_equal(one, two)
    assert not np.array_equal(one, plain)


def test_other_sections_beside_an_order():
    longer = read(f"{ORDER}\n[lifting]\noutputs = 4").experiment().scheme
    assert (longer.lifting.outputs, longer.lifting.inputs, longer.initial_model.n) == (4, 2, 4)
    window = read(f"{ORDER}\n[estimator]\nwindow = 6").experiment().scheme
    assert (window.estimator.window, window.estimator.generator.weight) == (6, default_scheme(1, 1, 2).estimator.weight)
    assert window.units is not None
    robust = read(f'{ORDER}\n[estimator]\nwindow = 6\nweight = 0.1\nloss = "log-cosh"').experiment().scheme
    assert robust.estimator.generator.weight == 0.1
    assert read(f"{ORDER}\n[estimator]\nweight = 1e-3\nmixing = 0.5").experiment().scheme.estimator.weight == 1e-3
    searched = f'{ORDER}\n[estimator]\nmixing = "search"\nA0 = [[0, 1], [1, 1]]\nB0 = [[1, 0], [1, 1]]'
    assert isinstance(read(searched).experiment().scheme.mixing, LambdaSearch)
    known = f"{ORDER}\n[knowledge]\nshift_rows = true\n[estimator]\nwindow = 6"
    assert read(known).experiment().scheme.units is None
    products = read(f"{ORDER}\n[lifting]\ndegree = 2").experiment().scheme
    assert products.units is None
    assert products.initial_model.n == 5


def test_a_rough_model_beside_an_order_is_in_the_units_of_the_signals():
    rough = "[rough]\nF = [[1.1, 1.0], [0.0, 0.9]]\nG = [[0.0], [1.0]]\nH = [[1.0, 0.0]]"
    found = read(f"{ORDER}\n{rough}").experiment()
    assert not found.scheme.units.model_in_sizes
    trace, blind = found.run(), read(ORDER).experiment().run()
    # Who knows the plant from the start is right from the first prediction that has data to start from.
    assert np.abs(trace.y_hat - trace.y)[2:].max() < 1e-9
    assert np.abs(blind.y_hat - blind.y)[2:].max() > 1e-2
    assert np.abs(trace.y).max() < np.abs(blind.y).max()


def test_bounds_of_the_actuator_are_in_the_plan_beside_an_order():
    limits = "[simulation]\nv_min = -0.5\nv_max = 0.5"
    bounded = read(f"{ORDER}\n{limits}").experiment()
    clipped = read(f"{ORDER}\n{limits}\n[controller]\nbounded = false").experiment()
    assert bounded.scheme.controller.bounds is bounded.actuator
    assert clipped.scheme.controller.bounds is None
    assert np.abs(bounded.run().v_computed).max() <= 0.5 < np.abs(clipped.run().v_computed).max()
    assert read(f"{LINEAR}\n{limits}").experiment().scheme.controller.bounds is None
    planned = LINEAR.replace("[controller]", "[controller]\nbounded = true")
    assert read(f"{planned}\n{limits}").experiment().scheme.controller.bounds is not None


def test_noise_that_the_scheme_expects():
    found = read(ORDER.replace("order = 2", "order = 2\nnoise = 0.02")).experiment()
    assert found.scheme.units.noise == 0.02
    assert found.sensor is None
    plant = LinearPlant([[1.1, 1.0], [0.0, 0.9]], [[0.0], [1.0]], [[1.0, 0.0]])
    told = simulate(default_scheme(1, 1, 2, noise=0.02), plant, [1.0, -1.0], 40).v
    assert np.array_equal(simulate(found.scheme, plant, [1.0, -1.0], 40).v, told)
    with pytest.raises(InputError, match="noise must be a number or have 1 entries, one for each output, got 2"):
        read(ORDER.replace("order = 2", "order = 2\nnoise = [0.1, 0.2]")).experiment()


def test_a_set_point_and_a_load():
    held = ORDER.replace("steps = 80", "steps = 150\nset_point = 2.0")
    trace = read(f"{held}\n[simulation]\nload = 0.3").experiment().run()
    assert np.abs(trace.y[-1] - 2.0).max() < 1e-6
    late = read(f"{held}\n[simulation]\nload = 0.3\nload_start = 100").experiment().run()
    assert np.array_equal(late.y[:101], read(held).experiment().run().y[:101])
    assert not np.array_equal(late.y[:110], read(held).experiment().run().y[:110])
    assert read(f"set_point = 2.0\n{LINEAR}").experiment().scheme.set_point.at(0, 1) == 2.0
    with pytest.raises(InputError, match=r"simulation.load_start must be left out where load is 0"):
        read(f"{held}\n[simulation]\nload_start = 5").experiment()


def test_an_input_size_needs_an_order():
    with pytest.raises(InputError, match="input_size must be left out where order is left out"):
        read(f"input_size = 2\n{LINEAR}").experiment()
    assert verdicts(tomllib.loads(f"input_size = 2\n{LINEAR}")) == (False, False)
    assert verdicts(tomllib.loads(f"noise = 2\n{LINEAR}")) == (False, False)
    assert verdicts(tomllib.loads(ORDER)) == (True, True)
    partly = {"rough": {"F": [[1]], "G": [[1]], "H": [[1]]}, "controller": {"R": 2.0}, "lifting": {"outputs": 3}}
    assert verdicts(tomllib.loads(ORDER) | partly) == (True, True)
    for section in ("lifting", "estimator", "controller"):
        short = tomllib.loads(LINEAR)
        short[section].popitem()
        assert verdicts(short) == (False, False)
        assert verdicts(short | {"order": 2}) == (True, True)


@pytest.mark.parametrize("path", [path for path, _ in keys()])
def test_the_schema_and_the_parser_agree_on_every_key(path):
    *tables, name = path.split(".")
    seen = set()
    for plant in [tomllib.loads(LINEAR)["plant"], *(PLANTS if tables == ["plant"] else [])]:
        for value in VALUES:
            whole = tomllib.loads(ORDER if path in ("order", "input_size", "noise") else LINEAR)
            data = whole | {"plant": dict(plant)}
            table = data.setdefault(tables[0], {}) if tables else data
            if tables == ["rough"]:
                table |= {"F": [[1]], "G": [[1]], "H": [[1]]}
            table[name] = value
            taken, valid = verdicts(data)
            assert taken == valid, (path, value)
            seen.add(taken)
    assert seen == {True, False} or path == "plant.kind"


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("steps = 42\n", ""),
        ("[lifting]\noutputs = 4\ninputs = 4\n", ""),
        ("alpha = 1.0", "alhpa = 1.0"),
        ("[rough]", "[rouhg]"),
    ],
)
def test_the_schema_and_the_parser_agree_on_which_keys_there_are(old, new):
    text = f"{LINEAR}[rough]\nF = [[1]]\nG = [[1]]\nH = [[1]]\n"
    assert verdicts(tomllib.loads(text)) == (True, True)
    assert verdicts(tomllib.loads(text.replace(old, new))) == (False, False)


def test_a_bound_is_said_where_it_is_checked():
    """The words of a key are made of its bounds: one changes with the other."""
    about = key("{}, a thing", integer(3, 8))
    assert about["description"] == "an integer from 3 to 8, a thing"
    assert [value for value in range(12) if fits(about, value)] == [3, 4, 5, 6, 7, 8]
    about = key('{}, or "none"', FRACTION, WORDS)
    assert about["description"] == 'a number in [0, 1), or "none"'
    taken = [
        value for value in (0, 0.5, 1, -0.1, 10**400, float("nan"), "none", "some", True, None) if fits(about, value)
    ]
    assert taken == [0, 0.5, "none"]


def fits(about, value):
    try:
        fitted(about, value)
    except ValueError:
        return False
    return True
