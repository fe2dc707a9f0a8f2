"""The sources of the library: modules that are short, or say why they are not."""

import ast

import pytest

from tests.test_imports import SOURCES

LINES = 400
LONG = ["kernels.loops"]


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
