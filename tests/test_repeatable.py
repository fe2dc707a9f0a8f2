"""Two builds of the same sources give the same site, byte for byte: seen on a small book in two folders."""

import pytest

from tests.small_book import Book
from tools import repeatable

FIGURE = """from rhl import plotting
from rhl.paper.pages import table
from rhl.paper.published import curve


def draw():
    figure, (axes,) = plotting.panels(1)
    plotting.held(axes, curve("linear_y"), "$y$")
    axes.legend()
    return figure


plotting.show(draw, "The published output falls.")
"""
TABLE = """from rhl.paper.pages import table

table([{"k": 0, "y": 1.5}, {"k": 1, "y": 2.5}])
"""
EXECUTED = f"""---
file_format: mystnb
kernelspec:
  name: python3
  display_name: Python 3
---

# A page with a table

```{{built-from}}
```

```{{code-cell}} ipython3
{TABLE}
```
"""
# An attribute at random is not part of any text, and thus of no other file.
RANDOM = """from uuid import uuid4

from IPython.display import HTML

HTML(f'<p data-at="{uuid4()}">random</p>')
"""


def small(root):
    book = Book(root)
    book.edit("_toc.yml", lambda text: text + "".join(f"      - file: {name}\n" for name in PAGES))
    book.write_notebook(FIGURE, "# A figure", "02-figure")
    book.write_notebook(RANDOM, "# At random", "03-random")
    (root / "book/executed.md").write_text(EXECUTED, encoding="utf-8")
    return book


PAGES = ("notebooks/02-figure", "notebooks/03-random", "book/executed")


@pytest.mark.nightly
def test_two_builds_agree_but_for_what_is_random(tmp_path):
    sites = []
    for folder, own in (("one", {"PYTHONHASHSEED": "1", "TZ": "UTC"}), ("another/place", {"PYTHONHASHSEED": "2"})):
        book = small(tmp_path / folder)
        book.built(**own)
        sites.append(repeatable.hashes(book.root / "build/_build/html"))
    assert {f"{name}.html" for name in PAGES} | {"searchindex.js", "objects.inv"} <= sites[0].keys()
    assert "_sources/book/executed.ipynb" in sites[0]
    assert repeatable.differing(*sites) == ["notebooks/03-random.html"]


def test_differing_files_are_named():
    one, other = {"a": "1", "b": "2", "c": "3"}, {"a": "1", "b": "4", "d": "5"}
    assert repeatable.differing(one, other) == ["b", "c", "d"]
    assert repeatable.differing(one, one) == []
    assert repeatable.whole(one) == repeatable.whole(dict(reversed(one.items())))
    assert len({repeatable.whole(files) for files in (one, other, {"a": "1"}, {})}) == 4


@pytest.mark.parametrize(("other", "status"), [({"a": "1"}, 0), ({"a": "2"}, 1)])
def test_a_difference_is_the_exit_status(tmp_path, monkeypatch, capsys, other, status):
    sites = iter([{"a": "1"}, other])
    monkeypatch.setattr(repeatable, "build", lambda tree, own: next(sites))
    assert repeatable.main(tmp_path) == status
    assert ("a differs" in capsys.readouterr().out) == bool(status)


def test_hashes_are_of_every_file(tmp_path):
    (tmp_path / "below").mkdir()
    (tmp_path / ".hidden").write_text("x")
    (tmp_path / "below/page.html").write_text("y")
    found = repeatable.hashes(tmp_path)
    assert found.keys() == {".hidden", "below/page.html"}
    (tmp_path / ".hidden").write_text("z")
    assert repeatable.differing(found, repeatable.hashes(tmp_path)) == [".hidden"]
