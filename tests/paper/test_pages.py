"""What the prose pages show as code runs, and what `rhl.paper.pages` hands to them is fit to print."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest

from rhl.errors import InputError
from rhl.paper.pages import comparison_table, grouped, scientific, table, tell
from rhl.paper.published import Comparison

ROOT = Path(__file__).resolve().parents[2]


def python_blocks(text: str) -> str:
    """Join the fenced Python of a page: later blocks go on from earlier ones."""
    return "\n".join(re.findall(r"^```python\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL))


PAGES = [page for page in sorted((ROOT / "book").glob("*.md")) if python_blocks(page.read_text(encoding="utf-8"))]


def test_there_is_code_to_run():
    assert {page.name for page in PAGES} >= {"scheme.md", "api.md"}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_code_on_prose_pages_runs(page):
    code = python_blocks(page.read_text(encoding="utf-8"))
    assert "assert " in code
    exec(compile(code, page.name, "exec"), {})


def test_code_that_is_wrong_is_noticed():
    with pytest.raises(AssertionError):
        exec(python_blocks("```python\nx = 1\n```\ntext\n```python\nassert x == 2\n```\n"), {})


def test_numbers_told_are_plain():
    told = {}

    def glue(name, value, display):
        told[name] = value

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("myst_nb.glue", glue)
        tell(a=np.float64(0.1), b=np.int64(3), c="text", d=2)
    assert told == {"a": 0.1, "b": 3, "c": "text", "d": 2}
    assert [type(value) for value in told.values()] == [float, int, str, int]


@pytest.mark.parametrize("value", [np.nan, np.inf, float("nan")])
def test_no_page_says_nan(value):
    with pytest.raises(InputError, match="a must be finite to be told"):
        tell(a=value)


@pytest.mark.parametrize(
    ("value", "digits", "written"),
    [(5.83e-13, 2, "5.8·10⁻¹³"), (1.0, 1, "1·10⁰"), (123456.0, 4, "1.235·10⁵"), (9.99e-10, 2, "1.0·10⁻⁹")],
)
def test_numbers_are_written_as_in_prose(value, digits, written):
    assert scientific(value, digits) == written


def test_long_numbers_may_break():
    assert grouped("-12.345678901", 3) == "−12.345 678 901"
    assert grouped("7") == "7"


def test_tables():
    page = comparison_table([Comparison("y", 14, 2e-12, 10, 1e-9), Comparison("v", 3, 0.07, 13, None)]).to_html()
    assert 'class="dataframe"' in page
    assert all(entry in page for entry in ("2e-12", "1e-09", "within", "unexplained", "none"))
    assert ">1<" in table(row for row in [{"n": 1}]).to_html()


def test_bars_in_docstrings_are_absolute_values():
    sys.path.insert(0, str(ROOT / "book/_ext"))
    from docstring_bars import escape_bars

    lines = ["the size |x| of ``|x|`` and :math:`|x|`", ".. math:: |x|", "", "   |y|", "and |z|"]
    assert escape_bars(lines) == [
        r"the size \|x\| of ``|x|`` and :math:`|x|`",
        ".. math:: |x|",
        "",
        "   |y|",
        r"and \|z\|",
    ]
