"""Imports point one way: a module of the library may import only from those before it, and rooms keep apart."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import rhl

FOLDER = Path(rhl.__file__).parent
# The core; its two `__init__` stand where what they gather is complete.
CORE = [
    "errors",
    "_checks",
    "_files",
    "model",
    "plants._realisation",
    "plants.base",
    "plants.linear",
    "plants.functions",
    "plants.robot_arm",
    "plants",
    "plants.cart_pendulum",
    "plants.examples",
    "plants.analysis",
    "plants._benchmark",
    "plants._literature",
    "plants.benchmarks",
    "basis",
    "lifting",
    "kernels",
    "kernels._compile",
    "kernels.loops",
    "_lanes",
    "losses._convex",
    "losses.custom",
    "losses.standard",
    "losses",
    "losses._proximal",
    "losses._descent",
    "constraints",
    "estimator",
    "memory",
    "units",
    "controllability",
    "family",
    "_riccati",
    "problems",
    "_bounded",
    "horizon",
    "schedules",
    "disturbances",
    "tracking",
    "controller",
    "scheme",
    "state",
    "closed_loop",
    "live",
    "trace",
    "_engine",
    "simulation",
    "kernels.__main__",
    "plotting",
]
PAPER = [
    "paper",
    "paper.published",
    "paper.formal",
    "paper.certified",
    "paper.certified_samples",
    "paper.figures",
    "paper.drawings",
    "paper.motion",
    "paper.claims",
    "paper.claims.claim",
    *(
        f"paper.claims.{name}"
        for name in (
            "lyapunov_terms",
            "lyapunov_inequalities",
            "rotating_models",
            "predictors",
            "convexity",
            "proximal",
            "estimation",
            "estimator_setup",
            "growing",
            "spoiling",
            "lemma_4_fails",
            "varying_loss",
            "window_proof",
            "kalman",
            "lemma_1",
            "assumption_4",
            "remark_1",
            "lemma_2",
            "lemma_2_proof",
            "lemma_3",
            "lemma_4",
            "lemma_5",
            "theorem_2_iii",
            "remark_4",
            "lemma_6",
            "theorem_1",
            "contraction",
            "theorem_1_star",
            "assumption_5",
            "theorem_2",
            "theorem_3",
            "theorem_3_prime",
            "theorem_4_grid",
            "theorem_4",
            "simulations",
            "certified_limits",
            "certified",
        )
    ),
    "paper.claims.ledger",
    "paper.chain",
    "paper.environment",
    "paper.pages",
    "paper.listing",
    "paper.chain_picture",
    "paper.sweeps",
    "paper.playground",
    "paper.watch",
    "paper.explored",
]
CAMPAIGNS = [
    "study.ensembles",
    "study.choices",
    "study.campaign",
    "study._layout",
    "study.store",
    "study.backends",
    "study.shipped",
]
STUDY = [
    "study",
    "study.rivals",
    "study.adaptive",
    "study.deepc",
    "study.compare",
    "study.record",
    *CAMPAIGNS,
    "study.knobs",
]
CAMPAIGN_COMMAND = ["app._campaign_keys", "app._campaign"]
APP = [
    "app",
    *(
        f"app.{name}"
        for name in (
            "_finding",
            "_known",
            "_after",
            "diagnosis",
            "_keys",
            "_limits",
            "_plants",
            "_sections",
            "config",
            "_templates",
            "_status",
            "_streams",
            "_run",
            "_compare",
            "_verify",
        )
    ),
    *CAMPAIGN_COMMAND,
    "app.cli",
]
ORDER = [*CORE, *STUDY, *PAPER, *APP, "__main__"]
# Beside the order, what keeps parts apart: control without estimation, problems without plants, and so on.
PLANTS = {name for name in CORE if name.partition(".")[0] == "plants"}
FORBIDDEN = {
    "controllability": {"estimator", "losses", *PLANTS},
    "family": {"estimator", "memory", "losses", "lifting", *PLANTS},
    "horizon": {"estimator", "controllability", "lifting", *PLANTS},
    "controller": PLANTS,
    "scheme": PLANTS,
    "state": PLANTS,
    "estimator": {"lifting", *PLANTS},
    "memory": {"lifting", *PLANTS},
    "units": {"estimator", "losses", *PLANTS},
    "lifting": PLANTS,
    **{f"paper.{name}": set(STUDY) for name in ("published", "pages", "sweeps", "playground")},
    "app.cli": {"paper.pages", "paper.sweeps"},
}
# What takes long to load, or is needed by a room other than the core.
HEAVY = (
    "flint",
    "numba",
    "scipy",
    "rich",
    "pandas",
    "sympy",
    "control",
    "matplotlib",
    "dask",
    "distributed",
    "xarray",
    "zarr",
)


def name_of(path):
    """The module in a file below the library's folder, by its dotted name without `rhl.`; its own `__init__` is ''."""
    parts = path.relative_to(FOLDER).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


SOURCES = {name_of(path): path.read_text(encoding="utf-8") for path in FOLDER.rglob("*.py")}


def imported(source, module=""):
    """The modules of the library that this source imports, wherever in it the statement stands."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            # A relative import counts its dots from the folder that the module is in.
            folder = ["rhl", *module.split(".")[:-1]]
            base = folder[: len(folder) - node.level + 1] if node.level else []
            base = ".".join([*base, *([node.module] if node.module else [])])
            # `from rhl import model` names a module, `from rhl.model import SignalModel` does so before `import`.
            inner = [f"{base}.{alias.name}" for alias in node.names]
            names = [name for name in inner if name.removeprefix("rhl.") in ORDER] or [base]
            names += [base] if any(name.removeprefix("rhl.") not in ORDER for name in inner) else []
        else:
            continue
        found |= {name.removeprefix("rhl.") for name in names if name.startswith("rhl.")}
    return found & set(ORDER)


def faults(module, source):
    """What `module` imports and should not."""
    allowed = set(ORDER[: ORDER.index(module)]) - FORBIDDEN.get(module, set())
    return sorted(imported(source, module) - allowed)


def heavy_modules(statement):
    """Those of the heavy packages that are loaded after a statement in a fresh interpreter."""
    code = f"{statement}\nimport sys\nprint(*(name for name in {HEAVY} if name in sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.split()


def test_every_module_has_its_place():
    assert set(SOURCES) - {""} == set(ORDER)
    assert len(ORDER) == len(set(ORDER))


@pytest.mark.parametrize("module", ORDER)
def test_direction(module):
    # The type of an attribute of an error is written down where no program runs.
    known = {"trace"} if module == "errors" else set()
    assert set(faults(module, SOURCES[module])) == known


def test_what_the_library_offers_is_of_the_core():
    assert imported(SOURCES[""]) <= set(CORE)


def test_there_is_something_to_see():
    assert {"closed_loop", "plants.base", "_checks"} <= imported(SOURCES["simulation"])
    assert {"paper.published", "paper.claims.claim"} <= imported(SOURCES["paper.claims.theorem_2"])


@pytest.mark.parametrize(
    "statement",
    [
        "from rhl.plotting import figure",
        "from rhl import plotting",
        "import rhl.plotting",
        "import rhl.plotting as p",
        "from .plotting import figure",
        "from . import plotting",
        "def late():\n    from rhl.plotting import figure",
        "if TYPE_CHECKING:\n    import rhl.plotting",
    ],
)
def test_a_wrong_import_is_found(statement):
    source = f"import numpy\nfrom rhl.state import Step\n{statement}\n"
    assert faults("simulation", source) == ["plotting"]


@pytest.mark.parametrize(
    ("module", "statement", "found"),
    [
        ("simulation", "from rhl.paper.published import curve", ["paper.published"]),
        ("simulation", "from rhl.paper import published", ["paper.published"]),
        ("plotting", "from rhl.app.config import load", ["app.config"]),
        ("plotting", "from rhl import app", ["app"]),
        ("paper.pages", "from rhl.app.diagnosis import diagnose", ["app.diagnosis"]),
        ("paper.claims.claim", "from . import ledger", ["paper.claims.ledger"]),
        ("paper.claims.claim", "from ..pages import tell", ["paper.pages"]),
        ("plants.base", "from .linear import LinearPlant", ["plants.linear"]),
        ("plants.linear", "from rhl.plants import Plant", ["plants"]),
        ("paper.pages", "from rhl.study.rivals import Run", ["study.rivals"]),
        ("study.compare", "from rhl.paper import published", ["paper.published"]),
        ("app.config", "from rhl.paper.published import curve", []),
        ("paper.pages", "from rhl.plants import LinearPlant", []),
    ],
)
def test_rooms_keep_apart(module, statement, found):
    assert faults(module, statement) == found


@pytest.mark.parametrize("module", FORBIDDEN)
def test_an_import_that_keeps_the_order_may_be_forbidden(module):
    for other in FORBIDDEN[module]:
        assert faults(module, f"from rhl.{other} import x") == [other]


def test_other_imports_are_free():
    assert faults("_checks", "import numpy as np\nfrom rhlike.model import x\nfrom rhl import __version__\n") == []


def test_the_library_loads_nothing_heavy():
    assert heavy_modules("import rhl") == []
    assert heavy_modules("import rhl.plants.examples, rhl.plants.analysis") == []


def test_what_is_heavy_is_noticed():
    assert heavy_modules("import rhl, rhl.plotting") == ["matplotlib"]
