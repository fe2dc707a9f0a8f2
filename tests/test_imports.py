"""Imports point one way: a module of the library may import only from those before it."""

import ast
from pathlib import Path

import pytest

import rhl

FOLDER = Path(rhl.__file__).parent
ORDER = [
    "_checks",
    "model",
    "_realisation",
    "plants",
    "ready",
    "structure",
    "basis",
    "lifting",
    "bregman",
    "knowledge",
    "_proximal",
    "estimator",
    "controllability",
    "_riccati",
    "horizon",
    "schedules",
    "scheme",
    "instruments",
    "closed_loop",
    "trace",
    "published",
    "diagnosis",
    "_sections",
    "config",
    "plotting",
    "book",
    "explore",
    "cli",
]
# Beside the order, what keeps parts apart: control without estimation, problems without plants, and so on.
FORBIDDEN = {
    "controllability": {"estimator", "bregman", "plants"},
    "horizon": {"plants", "estimator", "controllability", "lifting"},
    "scheme": {"plants"},
    "estimator": {"plants", "lifting"},
    "lifting": {"plants"},
    "plotting": {"config"},
    "cli": {"book"},
}
SOURCES = {path.stem: path.read_text(encoding="utf-8") for path in FOLDER.glob("*.py") if path.stem != "__init__"}


def imported(source):
    """The modules of the library that this source imports, wherever in it the statement stands."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            # `from rhl import model` names a module, `from rhl.model import SignalModel` does so before `import`.
            names = [f"rhl.{alias.name}" for alias in node.names] if node.module == "rhl" else [node.module]
        elif isinstance(node, ast.ImportFrom):
            names = [f"rhl.{node.module}"] if node.module else [f"rhl.{alias.name}" for alias in node.names]
        else:
            continue
        found |= {name.split(".")[1] for name in names if name.startswith("rhl.")}
    return found & set(ORDER)


def faults(module, source):
    """What `module` imports and should not."""
    allowed = set(ORDER[: ORDER.index(module)]) - FORBIDDEN.get(module, set())
    return sorted(imported(source) - allowed)


def test_every_module_has_its_place():
    assert set(SOURCES) == set(ORDER)


@pytest.mark.parametrize("module", ORDER)
def test_direction(module):
    assert faults(module, SOURCES[module]) == []


def test_there_is_something_to_see():
    assert {"closed_loop", "plants", "_checks"} <= imported(SOURCES["trace"])


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
    assert faults("published", f"import numpy\nfrom rhl.trace import Trace\n{statement}\n") == ["plotting"]


@pytest.mark.parametrize("module", FORBIDDEN)
def test_an_import_that_keeps_the_order_may_be_forbidden(module):
    for other in FORBIDDEN[module]:
        assert faults(module, f"from rhl.{other} import x") == [other]


def test_other_imports_are_free():
    assert faults("_checks", "import numpy as np\nfrom rhlike.model import x\nfrom rhl import __version__\n") == []
