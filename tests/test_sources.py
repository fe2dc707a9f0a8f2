"""The sources of the library: short modules, and public names that are documented, exemplified and used."""

import ast
import doctest
import json
import re
from functools import cache
from pathlib import Path

import pytest

import rhl
from tests.test_imports import CORE, SOURCES, STUDY

ROOT = Path(__file__).resolve().parent.parent
LINES = 400
LONG = ["kernels.loops"]
# Not on a page of the library: the command line has a page of its own, and no program calls the compiled loops.
ON_NO_PAGE = {"app.cli", "kernels.loops"}


# Length


def long_modules(sources):
    return sorted(name for name, source in sources.items() if len(source.splitlines()) > LINES)


def says_why(source):
    """Whether the docstring of a module gives the reason for its length."""
    return "is in one file, because" in " ".join((ast.get_docstring(ast.parse(source)) or "").split())


def test_only_few_modules_are_long():
    assert long_modules(SOURCES) == LONG


@pytest.mark.parametrize("name", LONG)
def test_a_long_module_says_why(name):
    assert says_why(SOURCES[name])


def test_a_module_that_grows_is_noticed():
    longer = "\n" * (LINES + 1)
    assert long_modules({"a": "", "b": longer, "c": "\n" * LINES}) == ["b"]
    assert not says_why(f'"""A long module."""{longer}')
    assert not says_why(longer)


# What is defined, shown and used


def is_public(name):
    return not any(part.startswith("_") for part in name.split("."))


def definitions(source):
    """The functions and classes at the top of a module, by name."""
    return {node.name: node for node in ast.parse(source).body if isinstance(node, ast.ClassDef | ast.FunctionDef)}


def members(source):
    """The functions, classes and constants of a module and the methods of its classes, except dunder names."""
    found = []
    for node in ast.parse(source).body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            found.append(node.name)
        if isinstance(node, ast.ClassDef):
            found += [inner.name for inner in node.body if isinstance(inner, ast.FunctionDef)]
        if isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            found += [name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)]
    return [name for name in found if not name.startswith("__")]


@cache
def names_in(code):
    """The names that a program loads, imports or writes as a string, such as the name of a method."""
    found = set()
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load):
            found.add(node.id)
        elif isinstance(node, ast.Attribute):
            found.add(node.attr)
        elif isinstance(node, ast.ImportFrom):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            found.add(node.value)
    return found


def examples_in(text):
    """The code of the examples of a docstring or of a page, and what it prints."""
    return [(example.source, example.want) for example in doctest.DocTestParser().get_examples(text)]


def names_in_examples(source):
    """The names in the examples of a module, in their code or in what it prints."""
    documented = ast.Module | ast.ClassDef | ast.FunctionDef
    texts = [ast.get_docstring(node) or "" for node in ast.walk(ast.parse(source)) if isinstance(node, documented)]
    examples = [example for text in texts for example in examples_in(text)]
    return {name for code, printed in examples for name in {*names_in(code), *re.findall(r"\w+", printed)}}


def code_of_page(text):
    """The Python of a page in Markdown, without prompts and options of cells."""
    for block in re.findall(r"^```(?:python|\{code-cell\}[^\n]*)\n(.*?)^```", text, re.DOTALL | re.MULTILINE):
        examples = examples_in(block)
        yield "".join(code for code, _ in examples) if examples else re.sub(r"^:.*\n", "", block, flags=re.MULTILINE)


@cache
def pages():
    """The code of every page, cell by cell, and the prose of all."""
    code, prose = [], []
    for path in [*ROOT.glob("book/*.md"), ROOT / "README.md"]:
        text = path.read_text(encoding="utf-8")
        code += code_of_page(text)
        prose.append(text)
    for path in ROOT.glob("notebooks/*.ipynb"):
        for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
            (code if cell["cell_type"] == "code" else prose).append("".join(cell["source"]))
    return code, "\n".join(prose)


@cache
def on_pages():
    return set().union(*map(names_in, pages()[0]))


@cache
def shown():
    """The names in code on pages, in examples of the library, and in what pages refer to."""
    examples = set().union(*map(names_in_examples, SOURCES.values()))
    referred = {part for path in re.findall(r"rhl(?:\.\w+)+", pages()[1]) for part in path.split(".")}
    return on_pages() | examples | referred


@cache
def in_tests():
    """The names in tests, except in those that list names."""
    paths = [
        path for path in ROOT.glob("tests/**/*.py") if path.name not in ("test_public_names.py", Path(__file__).name)
    ]
    return set().union(*(names_in(path.read_text(encoding="utf-8")) for path in paths))


DOCUMENTED = {
    module.removeprefix("rhl.")
    for path in ROOT.glob("book/api*.md")
    for module in re.findall(r"automodule:: (\S+)", path.read_text(encoding="utf-8"))
}


def undocumented(module, source):
    """The public names of a module without a docstring, or all of them if it is on no page of the library."""
    public = {name: node for name, node in definitions(source).items() if not name.startswith("_")}
    if module not in DOCUMENTED and module.rpartition(".")[0] not in DOCUMENTED and module not in ON_NO_PAGE:
        return sorted(public)
    return sorted(name for name, node in public.items() if not ast.get_docstring(node))


def without_example(source):
    """The public names of a module that no example, no code of a page and no reference on a page shows."""
    found = []
    for name, node in definitions(source).items():
        if not name.startswith("_") and name not in shown() and not examples_in(ast.get_docstring(node) or ""):
            found.append(name)
    return found


def lost_members(page):
    """Names that a page of the library asks of a module that has no such name."""
    asked = re.findall(r"automodule:: rhl\.(\S+)\n +:members: (.+)", page)
    return [name for module, names in asked for name in names.split(", ") if name not in definitions(SOURCES[module])]


@pytest.mark.parametrize("page", sorted(ROOT.glob("book/api*.md")), ids=lambda path: path.name)
def test_pages_name_what_is_there(page):
    assert lost_members(page.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize("module", sorted(name for name in SOURCES if is_public(name)))
def test_public_names_are_documented(module):
    assert undocumented(module, SOURCES[module]) == []


@pytest.mark.parametrize("module", [name for name in [*CORE, *STUDY] if is_public(name) and name not in ON_NO_PAGE])
def test_public_names_have_an_example(module):
    assert without_example(SOURCES[module]) == []


def test_what_rhl_offers_is_used_by_a_test():
    assert sorted(set(rhl.__all__) - in_tests()) == []
    assert sorted({"Step", "no_test_knows"} - in_tests()) == ["no_test_knows"]


def test_names_that_lack_something_are_noticed():
    assert lost_members(".. automodule:: rhl.horizon\n   :members: solve, solved\n") == ["solved"]
    bare = "def no_one_knows(): pass\nclass _Hidden: pass\n"
    assert undocumented("model", bare) == ["no_one_knows"]
    assert undocumented("model", bare.replace("pass", '"""Return nothing."""')) == []
    assert undocumented("nowhere", bare.replace("pass", '"""Return nothing."""')) == ["no_one_knows"]
    assert without_example(bare) == ["no_one_knows"]
    assert without_example(bare.replace("pass", '">>> no_one_knows()"')) == []


# Dead code


def unused(sources, elsewhere):
    """Names that neither a module of these nor code elsewhere uses."""
    used = set().union(elsewhere, *map(names_in, sources.values()))
    return sorted(
        f"{module}: {name}" for module, source in sources.items() for name in members(source) if name not in used
    )


def test_nothing_is_there_for_the_tests_alone():
    """Names that only tests use are none of the library's, unless an example shows them to readers."""
    scripts = [path for folder in ("tools", "book", "benchmarks") for path in (ROOT / folder).rglob("*.py")]
    used = set().union(*(names_in(path.read_text(encoding="utf-8")) for path in scripts))
    examples = set().union(*map(names_in_examples, SOURCES.values()))
    # IPython calls `_repr_html_`, and argparse `print_help`.
    assert unused(SOURCES, used | on_pages() | examples | {"_repr_html_", "print_help"}) == []


def test_dead_code_is_noticed():
    living = "def used(): return 1\nclass Kept:\n    def called(self): return used()\nKept().called()\n"
    assert unused({"a": living}, set()) == []
    dead = living + "LEFT = 1\ndef forgotten(): return 1\nclass Other(Kept):\n    def never(self): pass\n"
    assert unused({"a": dead}, {"Other"}) == ["a: LEFT", "a: forgotten", "a: never"]


def changeable(source):
    """The dataclasses of a module whose fields can be set anew."""
    return [
        node.name
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.ClassDef)
        for decorator in node.decorator_list
        if "dataclass" in ast.unparse(decorator) and "frozen=True" not in ast.unparse(decorator)
    ]


def test_dataclasses_are_frozen():
    assert {name: found for name, source in SOURCES.items() if (found := changeable(source))} == {}
    assert changeable("@dataclass\nclass A: ...\n@dataclass(frozen=False)\nclass B: ...\n") == ["A", "B"]
