"""Bad input on the command line: exit status, one line on standard error, nothing left behind; rows kept whole."""

import os
import re
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import pytest

from rhl.app import _status, cli
from tests.app.test_config import ARM, LINEAR
from tests.bad_input import faults, listing

RUN = ["run", "run.toml", "--output", "t.csv"]
ALLOWED = [*RUN, "--allow-python"]
PLANT = LINEAR[LINEAR.index('kind = "linear"') : LINEAR.index("[lifting]")]
STARTS = 'A0 = "companion-of-ones"\nB0 = "last-row-of-ones"'
OWN = LINEAR.replace(PLANT, 'kind = "python"\nfile = "p.py"\nn = 2\nq = 1\nz0 = [1, 1]\n')
GOOD = "def step(z, v): return [z[0], 0.5 * z[1] + v[0]]\ndef output(z): return z[:1]\n"
OUTPUT = "\ndef output(z): return z[:1]\n"


def plant(text):
    return LINEAR.replace(PLANT, text + "\n")


def transfer(num, den, z0="[1]", more=""):
    return plant(f'kind = "transfer-function"\nnum = {num}\nden = {den}\nz0 = {z0}\n{more}')


def has(section, lines):
    """The file with a line more in a section, or with a section more."""
    return (
        LINEAR.replace(f"[{section}]", f"[{section}]\n{lines}")
        if f"[{section}]" in LINEAR
        else (f"{LINEAR}[{section}]\n{lines}\n")
    )


def but(old, new):
    assert old in LINEAR
    return LINEAR.replace(old, new, 1)


def rough(lines):
    return but(STARTS, f'A0 = "rough"\nB0 = "rough"\n[rough]\n{lines}')


ANY = ", ".join(['["?", "?", "?", "?"]'] * 3)

# What, the file, the line after "rhl: ", and what it says to do (or None).
CONFIGURATIONS = [
    ("no TOML", "name = ", r"^run.toml must be valid TOML, got: Invalid value", None),
    ("TOML bomb", "a = " + "[" * 9000 + "]" * 9000, r"^run.toml must be valid TOML, got: too deeply", None),
    (
        "deep tables",
        "a." * 5000 + "b = 1",
        r"^run.toml must have keys of at most 8 parts, got more in line 1: .a.a.a",
        None,
    ),
    ("huge number", "steps = 1" + "0" * 5000, r"^run.toml must be valid TOML, got: Exceeds the limit", None),
    ("not UTF-8", b"\xff\xfe", r"^run.toml must be a TOML file in UTF-8, got other bytes at position 0", None),
    ("too large", b"#" * 5_000_001, r"^run.toml must be a TOML file of at most 5000000 bytes, got more", None),
    ("empty", "", r"^name must be a string of .*, the name of the run, without .*, got nothing", "add the key"),
    ("key of two lines", has("controller", '"a\\nb" = 1'), r"^controller.'a\\nb' is not a known key; expected", None),
    (
        "name of escapes",
        but('"linear"\nst', '"a\\u001b[31m"\nst'),
        r"^name must be a string of .*, .*got 'a.*x1b.31m'",
        None,
    ),
    ("name of two lines", but('"linear"\nst', '"a\\nb"\nst'), r"^name must be a string of .*, .*got 'a.nb'", None),
    ("name that turns", but('"linear"\nst', '"\\u202e"\nst'), r"^name must be a string of .*, .*got .*u202e", None),
    ("key of escapes", has("controller", '"\\u001b[31m" = 1'), r"^controller.'.*31m' is not a known key", None),
    ("key without end", has("controller", "k" * 5000 + " = 1"), r"^controller.'kkk.*\.\.\. is not a known key", None),
    ("section missing", but("[lifting]\noutputs = 4\ninputs = 4\n", ""), r"^lifting must be a section, got not", "add"),
    ("section twice", LINEAR + "[lifting]\n", r"^run.toml must be valid TOML, got: Cannot declare", None),
    ("array of sections", but("[lifting]", "[[lifting]]"), r"^lifting must be a section, got \[", None),
    ("steps 0", but("steps = 42", "steps = 0"), r"^steps must be an integer from 1 .*got 0", None),
    ("steps 10^9", but("steps = 42", "steps = 1000000000"), r"^steps must be .*to 100000.*got 1000000000", None),
    ("date", but("window = 8", "window = 1979-05-27"), r"^estimator.window must be .*got datetime.date\(1979", None),
    ("time", but("Q = 100.0", "Q = 07:32:00"), r"^controller.Q must be .*got datetime.time\(7, 32\)", None),
    ("beyond 64 bit", but("window = 8", "window = 0xFFFFFFFFFFFFFFFFFF"), r"^estimator.window must be .*got 472", None),
    ("bool as number", but("horizon = 20", "horizon = true"), r"^controller.horizon must be .*got True", None),
    ("text as number", but("alpha = 1.0", 'alpha = "1"'), r"^controller.alpha must be .*got '1'", None),
    ("table as number", but("alpha = 1.0", "alpha = {a = 1}"), r"^controller.alpha must be .*got \{'a': 1\}", None),
    ("NaN", but("0.92", "nan"), r"^plant.F must be a square matrix of finite numbers.* got", None),
    ("inf", but("-10]", "-inf]"), r"^plant.z0 must be a list of n finite numbers.*got \[0.1, 0.1, -inf\]", None),
    ("F not square", but(", [0, 0, 0.92]]", "]"), r"^plant.F must be square, got shape \(2, 3\)", None),
    ("F ragged", but("[0, 0, 0.92]", "[0, 0]"), r"^plant.F must be a rectangular array of numbers, got", None),
    ("F empty", but("[[0, 1, 0.1], [0, 1.02, 0], [0, 0, 0.92]]", "[]"), r"^plant.F must have shape .*got \(0,\)", None),
    ("F of 3 axes", but("[[0, 1, 0.1]", "[[[0, 1, 0.1]]"), r"^plant.F must be a square matrix .*got \[\[\[0", None),
    ("z0 too short", but("z0 = [0.1, 0.1, -10]", "z0 = [1]"), r"^plant.z0 must have 3 entries.*got 1", None),
    ("kind unknown", but('"linear"\nF', '"liner"\nF'), r"^plant.kind must be \"linear\".*got 'liner'", None),
    ("kind a list", but('"linear"\nF', '["linear"]\nF'), r"^plant.kind must be \"linear\".*got \['linear'\]", None),
    (
        "key of another kind",
        but('"linear"\nF', '"robot-arm"\nF'),
        r"^plant.F is not a known key; expected one of",
        None,
    ),
    ("arm's variant", ARM.replace('"data"', '"new"'), r"^plant.variant must be \"data\".*got 'new'", None),
    ("transfer not proper", transfer("[1, 2]", "[1]"), r"^plant.den must have a higher degree .*got", "append"),
    ("transfer zero", transfer("[0]", "[1, 1]"), r"^plant.den must have a higher degree .*got 2 and 0", "append"),
    ("transfer beyond float64", transfer("[1e300]", "[1e-300, 1]"), r"^\[plant\] system must have coeff.*got", "scale"),
    (
        "transfer of denormals",
        transfer("[1]", "[5e-324, 1]"),
        r"^\[plant\] system must have coefficients .*got",
        "scale",
    ),
    (
        "transfer ragged",
        transfer("[[[1]], [[1], [1]]]", "[1, 1]"),
        r"^plant.num must have as many .*got \[1, 2\]",
        None,
    ),
    ("transfer without", transfer("[[]]", "[1, 1]"), r"^plant.num must have as many lists .*got \[0\]", None),
    (
        "transfer's other shape",
        transfer("[[[1], [1]]]", "[[[1, 1]]]"),
        r"^plant.den must have 1 rows of 2 lists.*got \[\[\[1",
        None,
    ),
    (
        "a channel not proper",
        transfer("[[[1], [1, 2]]]", "[1, 1]"),
        r"^plant.den must have a higher .*got 2 and 2 coefficients from input 2 to output 1",
        "append",
    ),
    (
        "not proper in s",
        transfer("[1, 2]", "[1, 1]", more="sampling = 0.1"),
        r"^plant.den must have a higher .*got 2 and 2 coefficients",
        "model the lag",
    ),
    (
        "no channel at all",
        transfer("[[[0], [0]]]", "[1, 1]"),
        r"^\[plant\] system must respond .*got a transfer",
        "check",
    ),
    ("sampling 0", transfer("[1]", "[1, 1]", more="sampling = 0"), r"^plant.sampling must be a pos.*got 0", None),
    (
        "sampling too long",
        transfer("[1]", "[1, -1]", more="sampling = 1e6"),
        r"^plant.sampling must be short .*got 1e\+06",
        None,
    ),
    ("transfer's z0", transfer("[1]", "[1, 1]", "[1, 2]"), r"^plant.z0 must have 1 entries.*got 2", None),
    ("no ready plant", plant('kind = "ready"\nname = "cart"'), r"^plant.name must be one of cart-.*got 'cart'", None),
    ("ready plant's z0", plant('kind = "ready"\nname = "slow-mode"\nz0 = [1]'), r"^plant.z0 must have 2.*got 1", None),
    ("outputs 0", but("outputs = 4", "outputs = 0"), r"^lifting.outputs must be .*got 0", None),
    ("degree 7", has("lifting", "degree = 7"), r"^lifting.degree must be an integer from 1 to 6.*got 7", None),
    (
        "degree and terms",
        has("lifting", 'degree = 2\nterms = ["y1^2"]'),
        r"^lifting.terms must be left out.*got",
        "choose",
    ),
    (
        "too many monomials",
        has("lifting", "degree = 6").replace("outputs = 4", "outputs = 20"),
        r"^\[lifting\] the polynomials must be 1 to 2000 .*got",
        "choose",
    ),
    ("an input in a term", has("lifting", 'terms = ["v1"]'), r"^\[lifting\] 'v1' must use outputs only.*got", "inputs"),
    ("an output too many", has("lifting", 'terms = ["y9"]'), r"^\[lifting\] 'y9' must use outputs y1 .*got y9", None),
    ("no product", has("lifting", 'terms = ["y1+y2"]'), r"^\[lifting\] 'y1\+y2' must be a product .*got the fac", None),
    (
        "terms a string",
        has("lifting", 'terms = "y1^2"'),
        r"^lifting.terms must be a list of products.*got 'y1\^2'",
        None,
    ),
    ("a term not zero", has("lifting", 'terms = ["exp(y1)"]'), r"^\[lifting\] .* must be zero where.*got", "multiply"),
    ("window -1", but("window = 8", "window = -1"), r"^estimator.window must be .*got -1", None),
    ("weight 0", but("weight = 1.0", "weight = 0"), r"^estimator.weight must be a positive number.*got 0", None),
    ("lambda 1", but("mixing = 0.0", "mixing = 1.0"), r"^estimator.mixing must be a number in \[0, 1\).*got 1.0", None),
    ("lambda -0.1", but("mixing = 0.0", "mixing = -0.1"), r"^estimator.mixing must be .*got -0.1", None),
    ("lambda_max 1", has("estimator", "lambda_max = 1.0"), r"^estimator.lambda_max must be .*got 1.0", None),
    ("loss unknown", has("estimator", 'loss = "huber"'), r"^estimator.loss must be .*got 'huber'", None),
    ("loss_scale 0", has("estimator", "loss_scale = 0"), r"^estimator.loss_scale must be .*got 0", None),
    (
        "entropy from zeros",
        has("estimator", 'generator = "entropy"'),
        r"^\[estimator\] the initial.*Entropy.*got 0",
        "choo",
    ),
    ("A0 of another size", but('"companion-of-ones"', "[[1]]"), r"^estimator.A0 must have shape \(4, 4\).*got", None),
    ("A0 empty", but('"companion-of-ones"', "[]"), r"^estimator.A0 must have shape .*got \(0,\)", None),
    (
        "nothing to search from",
        but('"last-row-of-ones"', str([[0] * 4] * 4)).replace("mixing = 0.0", 'mixing = "search"'),
        r"^\[estimator\] the initial model must be controllable .*got 0",
        "choose another",
    ),
    ("rough alone", but('"companion-of-ones"', '"rough"'), r"^estimator.A0 and B0 must both be \"rough\".*got", "give"),
    (
        "rough without section",
        but(STARTS, 'A0 = "rough"\nB0 = "rough"'),
        r"^estimator.A0 must be \"rough\".*got none",
        "add",
    ),
    (
        "rough not square",
        rough("F = [[1, 2]]\nG = [[1]]\nH = [[1]]"),
        r"rough.F must be square, got shape \(1, 2\)",
        None,
    ),
    (
        "rough blind",
        rough("F = [[1]]\nG = [[1]]\nH = [[0]]"),
        r"\[rough\] the plant's H must not be zero, got",
        "choose",
    ),
    (
        "rough of two inputs",
        rough("F = [[1]]\nG = [[1, 1]]\nH = [[1]]"),
        r"rough.H and G must have 1 rows.*got 1 and 2",
        None,
    ),
    (
        "rough beyond float64",
        rough("F = [[1e300, 1], [1, 1e300]]\nG = [[1], [0]]\nH = [[1, 1]]"),
        r"\[rough\] plant must have powers of F .*got",
        "stack less",
    ),
    (
        "known of another size",
        has("knowledge", 'A = [[1, "?"]]'),
        r"^knowledge.A must have shape \(4, 4\), got 1",
        None,
    ),
    ("known ragged", has("knowledge", 'A = [["?"], [1, "?"]]'), r"^knowledge.A must have shape .*got 2 rows", None),
    (
        "known '??'",
        has("knowledge", 'A = [["??"]]'),
        r"^knowledge.A must be a matrix like A0 .*got \[\['\?\?'\]\]",
        None,
    ),
    ("known NaN", has("knowledge", "B = [[nan]]"), r"^knowledge.B must be a matrix like B0 .*got \[\[nan\]\]", None),
    (
        "known against itself",
        has("knowledge", f'shift_rows = true\nA = [{ANY}, [2, "?", "?", "?"]]'),
        r"^\[knowledge\] the equalities must not contradict each other, got row",
        "remove",
    ),
    (
        "known against A0",
        has("knowledge", f'A = [{ANY}, [7, "?", "?", "?"]]'),
        r"^estimator.A0 with B0 must satisfy the equalities .*got a violation of 6",
        '"shift-of-ones"',
    ),
    ("known with 1", has("knowledge", "shift_rows = 1"), r"^knowledge.shift_rows must be true or false.*got 1", None),
    ("R negative", but("R = 10000.0", "R = -1"), r"^controller.R must be positive definite, got .* -1", None),
    (
        "Q of another size",
        but("Q = 100.0", "Q = [[1, 0], [0, 1]]"),
        r"^controller.Q must be .*\(7, 7\), got shape",
        None,
    ),
    ("Q ragged", but("Q = 100.0", "Q = [[1], [1, 2]]"), r"^controller.Q must be a rectangular array .*got", None),
    (
        "R not symmetric",
        ARM.replace("Q = 10\n", f"Q = {[[1, 1], *[[0, 1]]]}\n"),
        r"^controller.Q must be .*got shape",
        None,
    ),
    ("horizon 0", but("horizon = 20", "horizon = 0"), r"^controller.horizon must be .*got 0", None),
    ("eps_rate 0", but("eps_rate = 100.0", "eps_rate = 0"), r"^controller.eps_rate must be .*got 0", None),
    (
        "eps without rate",
        but("eps_rate = 100.0\n", ""),
        r"^controller.eps_rate must be .*got nothing .*harmonic",
        "add",
    ),
    ("eps unknown", has("controller", 'eps = "linear"'), r"^controller.eps must be .*got 'linear'", None),
    (
        "eps_factor 1",
        has("controller", 'eps = "exponential"\neps_factor = 1.0'),
        r"^controller.eps_factor.*got 1.0",
        None,
    ),
    ("delay 2", but("model_delay = 1", "model_delay = 2"), r"^controller.model_delay must be .*got 2", None),
    (
        "one bound",
        has("simulation", "v_min = 1"),
        r"^simulation.v_max must be a number where .*got nothing",
        "add the key",
    ),
    (
        "bounds equal",
        has("simulation", "v_min = 1\nv_max = 1"),
        r"^simulation.v_min must be below v_max .*got 1.0",
        None,
    ),
    ("bounds too many", has("simulation", "v_min = [1, 2]\nv_max = 3"), r"^simulation.v_min must .*got 2", None),
    ("noise -1", has("simulation", "noise = -1"), r"^simulation.noise must be a number of at least 0.*got -1", None),
    (
        "noise too many",
        has("simulation", "noise = [1, 2]"),
        r"^simulation.noise must be a number or have 1.*got 2",
        None,
    ),
    ("outliers always", has("simulation", "outlier_rate = 1"), r"^simulation.outlier_rate must be .*got 1", None),
    ("seed -1", has("simulation", "seed = -1"), r"^simulation.seed must be .*got -1", None),
]

# The user's own Python file.
PROGRAMS = [
    ("missing", None, r"^plant.file must be a Python file that runs, got FileNotFoundError", None),
    ("syntax", "def step(", r"^plant.file must be a Python file that runs, got SyntaxError: .*line 1", None),
    ("no text", b"\xff\xfe\x00", r"^plant.file must be a Python file that runs, got SyntaxError", None),
    ("raises", "raise ValueError('a\\nb')", r"^plant.file must be .*got ValueError: a b, from p.py", None),
    (
        "raises what cannot be shown",
        "class E(Exception):\n def __str__(self): raise E\nraise E",
        r"must be .*got E,",
        None,
    ),
    ("exits", "import sys; sys.exit(0)", r"^plant.file must be .*got SystemExit: 0", None),
    ("recurses", "def f(): f()\nf()", r"^plant.file must be .*got RecursionError", None),
    ("no module", "import nosuchmodule", r"^plant.file must be .*got ModuleNotFoundError", None),
    ("no step", "x = 1", r"^plant.file must define a function step, got a file without it", None),
    ("step a number", "step = 1\noutput = 2", r"^\[plant\] step must be a function step\(z, v\), got 1", None),
    (
        "step raises",
        "def step(z, v): raise ValueError('a\\nb')" + OUTPUT,
        r"step\(z, v\) must .*got ValueError: a b",
        "try",
    ),
    ("step exits", "import sys\ndef step(z, v): sys.exit(0)" + OUTPUT, r"step\(z, v\) must .*got SystemExit: 0", "try"),
    ("step recurses", "def step(z, v): return step(z, v)" + OUTPUT, r"step\(z, v\) must .*got RecursionError", "try"),
    (
        "step of NaN",
        "def step(z, v): return z * float('nan')" + OUTPUT,
        r"step\(z, v\) must be finite .*got arr",
        "shift",
    ),
    (
        "step's shape",
        "def step(z, v): return [1.0]" + OUTPUT,
        r"step\(z, v\) must return .*\(2,\), got shape \(1,\)",
        "ret",
    ),
    ("step of text", "def step(z, v): return 'ab'" + OUTPUT, r"step\(z, v\) must return .*got 'ab'", "return"),
    (
        "step of z only",
        "def step(z): return z" + OUTPUT,
        r"step\(z, v\) must return .*got TypeError: step\(\) takes 1",
        "try",
    ),
    (
        "step too large",
        "import numpy\ndef step(z, v): return numpy.zeros(10**15)" + OUTPUT,
        r"step.* must .*got Memory",
        "try",
    ),
    (
        "step turns bad",
        "n = 0\ndef step(z, v):\n global n\n n += 1\n return [0.0] * (2 if n < 9 else 3)" + OUTPUT,
        r"^step\(z, v\) must return an array of shape \(2,\), got shape \(3,\)",
        "return",
    ),
    (
        "step writes",
        "def step(z, v):\n z[0] = 1\n return z" + OUTPUT,
        r"^\[plant\] step\(z, v\) must return an array of shape \(2,\) and leave its arguments alone, got an attempt "
        r"to write into them; it must return a new array, so begin with z = z.copy\(\)$",
        None,
    ),
    (
        "output raises",
        "def step(z, v): return z\ndef output(z): return 1 / 0\n",
        r"^\[plant\] output\(z\) must return an array of shape \(p,\), got ZeroDivisionError: division by zero; try it "
        r"yourself at z = array\(\[0., 0.\]\)$",
        None,
    ),
    (
        "output turns bad",
        "def step(z, v): return [z[0], 0.5 * z[1] + v[0]]\ndef output(z): return z[:1] if z[0] < 1 else z[9]\n",
        r"^output\(z\) must return an array of shape \(1,\), got IndexError: .*; try it yourself at z = array\(\[1., ",
        None,
    ),
    (
        "output too large",
        "import numpy\ndef step(z, v): return z\ndef output(z): return numpy.zeros(100000)\n",
        r"^order or \[lifting\] must stack at most 1000 numbers, got 4 outputs of size 100000",
        "stack fewer",
    ),
]

# Calls, with a valid run.toml beside a file there.csv and a folder there.
CALLS = [
    ([], r"^the following arguments are required: COMMAND; see 'rhl --help'"),
    (["fly"], r"^argument COMMAND: invalid choice: 'fly'"),
    (["run", "run.toml"], r"^the following arguments are required: --output"),
    (["run", "run.toml", "--out", "t.csv"], r"are required: --output|unrecognized arguments: --out"),
    (["run", "run.toml", "--output"], r"^argument --output: expected one argument"),
    (["run", "missing.toml", "--output", "t.csv"], r"^missing.toml must be a readable TOML file, got: No such file"),
    (["run", "there", "--output", "t.csv"], r"^there must be a readable TOML file, got: Is a directory"),
    (
        ["run", "run\x00.toml", "--output", "t.csv"],
        r"^'run\\x00.toml' must be a readable TOML file, got: embedded null",
    ),
    (
        ["run", "run.toml", "--output", "there.csv"],
        r"^--output must name a new file, got there.csv, which exists; add --force",
    ),
    (
        ["run", "run.toml", "--output", "t.csv", "--output", "there.csv"],
        r"^--output must name a new file, got there.csv",
    ),
    (["run", "run.toml", "--output", "t.csv", "--plot", "there.svg"], r"^--plot must name a new file, got there.svg"),
    (["run", "run.toml", "--output", "there", "--force"], r"^--output must name a file, got the folder there"),
    (["run", "run.toml", "--output", "run.toml", "--force"], r"^--output must name a file of its own, got run.toml"),
    (["run", "run.toml", "--output", "a.svg", "--plot", "a.svg"], r"^--plot must name a file of its own, got a.svg"),
    (["run", "run.toml", "--output", "no/t.csv"], r"^--output must name a file in a folder that exists, got no/t.csv"),
    (["run", "run.toml", "--output", ""], r"^argument --output: a file's name must have at least one character"),
    (["run", "run.toml", "--output", "t" * 300], r"^--output must name a file that can be written, got ttt"),
    (["run", "run.toml", "--output", "t\nt\x00"], r"^--output must name a file that can be written, got 't\\nt"),
    (["run", "run.toml", "--output", "/proc/t.csv"], r"^(--output|/proc/t.csv) must (name|be) a .*got"),
    (["run", "run.toml", "--output", "t.csv", "--plot", "f.jpg"], r"^--plot must end in .svg, .pdf or .png, got f.jpg"),
    (["check"], r"^the following arguments are required: CONFIG.toml"),
    (["check", "missing.toml"], r"^missing.toml must be a readable TOML file, got: "),
    (["check", "run.toml", "--force"], r"^unrecognized arguments: --force"),
    (["new", ""], r"^NAME must be a name for a new file, got ''"),
    (["new", "a\nb"], r"^NAME must be a name for a new file, got"),
    (["new", "run"], r"^NAME must name a new file, got run.toml, which exists; add --force"),
    (["new", "no/run"], r"^NAME must name a file in a folder that exists, got no/run.toml"),
    (["schema", "--output", "there"], r"^--output must name a file, got the folder there"),
    (["reproduce", "arm"], r"^argument experiment: invalid choice: 'arm'"),
    (["reproduce", "robot", "--output", "there.csv"], r"^--output must name a new file, got there.csv"),
    (["verify", "lemma-99"], r"^ID must be one of the ledger's .*got lemma-99"),
    (["verify", "--cases", "many"], r"^argument --cases: must be an integer from 10 to 100000, got 'many'"),
    (["verify", "--cases", "0"], r"^argument --cases: must be an integer from 10 to 100000, got '0'"),
    (["verify", "--seed", "-1"], r"^seed must be an integer of at least 0, got -1"),
    (["verify", "--cases", "50", "--fast"], r"^argument --fast: not allowed with argument --cases"),
    (["verify", "eq-1", "--json", "there.csv"], r"^--json must name a new file, got there.csv"),
]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there").mkdir()
    for name in ("there.csv", "there.svg"):
        (tmp_path / name).write_text("mine", encoding="utf-8")
    (tmp_path / "run.toml").write_text(LINEAR, encoding="utf-8")
    return tmp_path


def refused(folder, capsys, arguments, wanted, remedy=None):
    """Everything that is wrong with how a call was answered."""
    before = listing(folder)
    status = cli.main(arguments)
    said = capsys.readouterr()
    found = [] if status == 2 else [f"status {status}"]
    if listing(folder) != before:
        found.append("files left or changed")
    if said.out:
        found.append("something on standard output")
    if not (said.err.startswith("rhl: ") and said.err.endswith("\n")):
        found.append("no line that begins with rhl:")
    return found + faults(said.err.removeprefix("rhl: ").removesuffix("\n"), wanted, remedy)


@pytest.mark.parametrize("command", [RUN, ["check", "run.toml"]], ids=["run", "check"])
@pytest.mark.parametrize(("text", "wanted", "remedy"), [pytest.param(*row, id=what) for what, *row in CONFIGURATIONS])
def test_configurations(folder, capsys, text, wanted, remedy, command):
    Path("run.toml").write_bytes(text if isinstance(text, bytes) else text.encode())
    assert refused(folder, capsys, command, wanted, remedy) == []


@pytest.mark.parametrize(("program", "wanted", "remedy"), [pytest.param(*row, id=what) for what, *row in PROGRAMS])
def test_python_files(folder, capsys, program, wanted, remedy):
    Path("run.toml").write_text(OWN, encoding="utf-8")
    if program is not None:
        Path("p.py").write_bytes(program if isinstance(program, bytes) else program.encode())
    assert refused(folder, capsys, ALLOWED, wanted, remedy) == []


@pytest.mark.parametrize(("arguments", "wanted"), CALLS, ids=[repr(" ".join(asked))[:60] for asked, _ in CALLS])
def test_calls(folder, capsys, arguments, wanted):
    assert refused(folder, capsys, arguments, wanted) == []


def test_the_tables_are_large():
    assert len(CONFIGURATIONS) + len(PROGRAMS) + len(CALLS) >= 140


def test_bad_answers_are_seen(folder, capsys, monkeypatch):
    """The checker of the tables rejects: files left, another status, words on standard output, a traceback."""

    def answering(status, err, out="", leave=False):
        def main(arguments):
            print(err, file=sys.stderr)
            print(out, end="")
            if leave:
                Path("half").write_text("k,y1", encoding="utf-8")
            return status

        monkeypatch.setattr(cli, "main", main)
        return refused(folder, capsys, RUN, "^alpha")

    good = "rhl: alpha must be 1, got 2"
    assert answering(2, good) == []
    assert answering(0, good) == ["status 0"]
    assert answering(2, good, out="1 row") == ["something on standard output"]
    assert answering(2, good, leave=True) == ["files left or changed"]
    assert "a traceback" in answering(2, "Traceback (most recent call last):\nValueError: alpha")
    assert "not one printable line" in answering(2, good + "\n" + good)
    assert "no line that begins with rhl:" in answering(2, "alpha must be 1, got 2")


@pytest.mark.parametrize(
    ("text", "k"),
    [
        (but("-10]", "1e300]"), 0),
        (but("1.02", "1e308"), 2),
        (has("lifting", 'terms = ["y1^99"]'), 2),
        (has("simulation", "noise = 1.7e308"), 0),
        (plant('kind = "ready"\nname = "cart-pendulum"\nz0 = [1e300, 0, 0, 0]'), 0),
        (but("eps_rate = 100.0", 'eps = "exponential"\neps_factor = 5e-324'), 25),
    ],
)
def test_runs_that_leave_the_range_keep_whole_rows(folder, capsys, text, k):
    Path("run.toml").write_text(text, encoding="utf-8")
    assert cli.main(RUN) == _status.STOPPED
    assert capsys.readouterr().err.startswith(f"rhl: the run left the range of floating-point numbers at k = {k}: ")
    assert whole_rows("t.csv") == k


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("alpha = 1.0", "alpha = 1e308"), r"; controller\.alpha must be smaller, got 1e\+308; the"),
        (
            ("eps_rate = 100.0", "eps_rate = 1e308"),
            r"; controller\.eps_rate must be smaller, got 1e\+308, which makes eps\(\d+\) 1e-300; the",
        ),
        (
            ("eps_rate = 100.0", 'eps = "power"\neps_rate = 1e308\neps_power = 2'),
            r"; controller\.eps_rate or controller\.eps_power must be smaller, got 1e\+308 and 2, which",
        ),
        (
            ("eps_rate = 100.0", 'eps = "exponential"\neps_factor = 5e-324'),
            r"; controller\.eps_factor must be larger, got 4.94066e-324, which",
        ),
        (
            ("eps_rate = 100.0", 'eps = "constant"\neps_value = 5e-324'),
            r"; controller\.eps_value must be larger, got 4.94066e-324, which makes eps\(0\) 4.94e-324; the 0 rows",
        ),
        (
            ("eps_rate = 100.0", "eps_rate = 1e308\nadaptive = true"),
            r"; controller\.eps_rate must be smaller, got 1e\+308, which makes eps\(\d+\) 1e-300; the",
        ),
        (
            ("eps_rate = 100.0", "eps_rate = 100.0"),
            r"k = 0: weight must be finite, got inf among its entries; the 0 rows",
        ),
    ],
)
@pytest.mark.filterwarnings("ignore:Theorem 1 asks")
def test_a_weight_that_leaves_the_range_names_its_key(folder, capsys, change, says):
    """In the last row it is the state that does, and no key is blamed."""
    far = "-1e160]" if change[0] == change[1] else "-1e6]"
    Path("run.toml").write_text(but(*change).replace("-10]", far), encoding="utf-8")
    assert cli.main(RUN) == _status.STOPPED
    assert re.search(says, capsys.readouterr().err)


def whole_rows(path):
    """How many rows a table has, all of them finite and as long as its heading."""
    heading, *rows = Path(path).read_text(encoding="utf-8").splitlines()
    for k, row in enumerate(rows):
        entries = row.split(",")
        assert len(entries) == len(heading.split(","))
        assert entries[0] == str(k)
        assert np.all(np.isfinite([float(entry) for entry in entries]))
    return len(rows)


@pytest.mark.parametrize("ends", ["Q = 5e-324", "Q = 1e300", "alpha = 5e-324", "eps_rate = 5e-324", "QN = 5e-324"])
def test_the_ends_of_the_range_run(folder, capsys, ends):
    key = ends.split()[0]
    line = next(line for line in LINEAR.splitlines() if line.startswith(f"{key} = "))
    Path("run.toml").write_text(but(line, ends), encoding="utf-8")
    assert cli.main(RUN) == 0
    assert capsys.readouterr().err == ""
    assert whole_rows("t.csv") == 42


def test_the_last_of_two_outputs_counts_and_force_writes_over(folder, capsys):
    assert cli.main(["run", "run.toml", "--output", "a.csv", "--output", "b.csv"]) == 0
    assert not Path("a.csv").exists()
    assert whole_rows("b.csv") == 42
    assert cli.main(["run", "run.toml", "--output", "there.csv", "--force"]) == 0
    assert whole_rows("there.csv") == 42


def test_a_file_that_goes_elsewhere_takes_no_output_along(folder, capsys):
    Path("run.toml").write_text(OWN, encoding="utf-8")
    Path("p.py").write_text(f"import os\nos.chdir('/')\nprint('hello')\n{GOOD}", encoding="utf-8")
    assert cli.main(ALLOWED) == 0
    assert whole_rows(folder / "t.csv") == 42


def test_a_users_warning_is_one_line(folder, capsys):
    Path("run.toml").write_text(OWN, encoding="utf-8")
    Path("p.py").write_text(f"import warnings\nwarnings.warn('a\\nb\\x1b')\n{GOOD}", encoding="utf-8")
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        assert cli.main(ALLOWED) == 0
    assert capsys.readouterr().err == "rhl: warning: a b\\x1b\n"


@pytest.mark.skipif(os.geteuid() == 0, reason="for root every file can be written")
def test_folders_and_files_that_take_nothing(folder, capsys):
    Path("there").chmod(0o500)
    assert refused(folder, capsys, [*RUN[:3], "there/t.csv"], "Permission denied") == []
    Path("there.csv").chmod(0o400)
    assert refused(folder, capsys, [*RUN[:3], "there.csv", "--force"], "Permission denied") == []


COMMAND = [sys.executable, "-c", "import sys; from rhl.app.cli import main; sys.exit(main())"]


def test_a_full_disk_leaves_nothing(folder):
    code = (
        "import resource, signal, sys; from rhl.app.cli import main; signal.signal(signal.SIGXFSZ, signal.SIG_IGN); "
        "resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000)); sys.exit(main())"
    )
    before = listing(folder)
    done = subprocess.run([sys.executable, "-B", "-c", code, *RUN], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "rhl: t.csv must be a writable file, got: File too large\n"
    assert listing(folder) == before
    assert subprocess.run([*COMMAND, *RUN[:3], "/dev/full"], capture_output=True, check=False).returncode == 2


@pytest.mark.parametrize("request_to_end", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_in_mid_run_keeps_whole_rows(folder, request_to_end):
    Path("run.toml").write_text(OWN.replace("steps = 42", "steps = 100000"), encoding="utf-8")
    Path("p.py").write_text(f"{GOOD}n = 0\ngood = step\n", encoding="utf-8")
    with Path("p.py").open("a", encoding="utf-8") as file:
        file.write("def step(z, v):\n global n\n n += 1\n if n == 20: open('mark', 'w').close()\n return good(z, v)\n")
    # A shell that runs the tests in the background has its children ignore Ctrl-C.
    heeding = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
    command = [*COMMAND[:-1], heeding + COMMAND[-1], *ALLOWED]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60
    while not Path("mark").exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(request_to_end)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out) == (130, "")
    rows = whole_rows("t.csv")
    assert 10 <= rows < 100000
    assert err == f"rhl: the run was interrupted at k = {rows}; the {rows} rows before it are in t.csv\n"
    assert {path.name for path in folder.iterdir()} - {"mark", "p.py"} == {
        *("run.toml", "t.csv", "there", "there.csv", "there.svg")
    }
