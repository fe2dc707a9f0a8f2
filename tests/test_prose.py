"""Every figure of the book has its texts, and every name of the library that the prose mentions is a link."""

import ast
import importlib
import inspect
import json
import pkgutil
import re
from pathlib import Path

import pytest

import rhl

ROOT = Path(__file__).resolve().parent.parent


def pages():
    """Each page of the book: its name, its prose without code, and its executed code."""
    for path in sorted(ROOT.glob("book/*.md")):
        text = path.read_text(encoding="utf-8")
        code = re.findall(
            r"^```\{code-cell\}[^\n]*\n(?::tags:[^\n]*\n)?(.*?)^```", text, flags=re.DOTALL | re.MULTILINE
        )
        yield path.name, re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE), "\n".join(code)
    for path in sorted(ROOT.glob("notebooks/*.ipynb")):
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        prose, code = (
            "\n\n".join("".join(c["source"]) for c in cells if c["cell_type"] == t) for t in ("markdown", "code")
        )
        yield path.name, prose, code


PAGES = list(pages())


def figure_faults(code):
    """Calls that show a figure without an alternative text or without a caption."""
    calls = [node for node in ast.walk(ast.parse(code)) if isinstance(node, ast.Call)]
    shown = [call for call in calls if isinstance(call.func, ast.Attribute) and call.func.attr == "show"]
    return [
        f"{ast.unparse(call.args[0])}: no {text}"
        for call in shown
        for text in ("alt", "caption")
        if text not in {keyword.arg for keyword in call.keywords}
    ]


def public_names():
    """Classes, functions and modules of the library, by the names that a page may call them."""
    found = set()
    for info in pkgutil.walk_packages(rhl.__path__, "rhl."):
        if not info.name.rpartition(".")[2].startswith("_"):
            module = importlib.import_module(info.name)
            found.add(info.name)
            for name, thing in vars(module).items():
                own = getattr(thing, "__module__", None) == info.name
                if own and not name.startswith("_") and (inspect.isclass(thing) or inspect.isfunction(thing)):
                    found |= {name, f"{info.name}.{name}"}
    return found


# One word in small letters is as likely to be a key, an option or a column as a function.
NAMES = {name for name in public_names() if not re.fullmatch(r"[a-z]+", name)}


def bare_names(prose):
    """Names of the library as plain code, outside headings and link texts."""
    lines = [line for line in prose.splitlines() if not line.startswith("#")]
    literals = re.findall(r"(?<![\[}`])`([\w.]+)(?:\(\))?`(?!`)", "\n".join(lines))
    return [name for name in literals if name in NAMES]


@pytest.mark.parametrize(("name", "code"), [(name, code) for name, _, code in PAGES if "plotting.show" in code])
def test_figures_have_their_texts(name, code):
    assert figure_faults(code) == []


@pytest.mark.parametrize(("name", "prose"), [(name, prose) for name, prose, _ in PAGES])
def test_names_are_links(name, prose):
    assert bare_names(prose) == []


def test_faults_are_found():
    assert figure_faults('plotting.show(draw, alt="a")\nplotting.show(draw, alt="a", caption="c")') == [
        "draw: no caption"
    ]
    assert figure_faults("plotting.show(draw)") == ["draw: no alt", "draw: no caption"]
    prose = (
        "# `LambdaSearch`\n"
        "`SignalModel`, `rhl.simulation.simulate()`, {py:class}`~rhl.plants.LinearPlant`, `k`, `solve`"
    )
    assert bare_names(prose) == ["SignalModel", "rhl.simulation.simulate"]
