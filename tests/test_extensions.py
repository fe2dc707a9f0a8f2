"""The book's Sphinx extensions: what they make of a page's text, and what they refuse."""

import re
import subprocess
import sys
from types import SimpleNamespace

import pytest
import yaml
from bs4 import BeautifulSoup
from sphinx.errors import ExtensionError

from tests.conftest import ROOT

sys.path.insert(0, str(ROOT / "book/_ext"))

import built_from
import lean_pages
import leftovers
import local_mathjax
import search_pages
import take_away

NOTEBOOK = "notebooks/10-lemma-5.ipynb"
PAGE = "notebooks/10-lemma-5.html"


# ---------------------------------------------------------------- taking a page away


def test_one_setting_gives_every_address():
    assert take_away.addresses("https://github.com/Some/rhl", "main", NOTEBOOK, PAGE) == {
        "Binder": "https://mybinder.org/v2/gh/Some/rhl/main?urlpath=lab%2Ftree%2Fnotebooks%2F10-lemma-5.ipynb",
        "Colab": "https://colab.research.google.com/github/Some/rhl/blob/main/notebooks/10-lemma-5.ipynb",
        "this page online": "https://some.github.io/rhl/notebooks/10-lemma-5.html",
    }
    assert list(take_away.addresses("https://github.com/Some/rhl", "main", "", PAGE)) == ["this page online"]
    own = take_away.addresses("https://github.com/some/some.github.io", "main", "", PAGE)
    assert own == {"this page online": f"https://some.github.io/{PAGE}"}


def test_without_the_setting_there_is_no_address():
    assert take_away.addresses("", "main", NOTEBOOK, PAGE) == {}


@pytest.mark.parametrize(
    "address", ["https://example.org/a/b", "https://github.com/a", "https://github.com/a/b/tree/c"]
)
def test_an_address_of_another_form_is_refused(address):
    with pytest.raises(ValueError, match=r"^repository\.url must look like https://github\.com/OWNER/NAME, got"):
        take_away.addresses(address, "main", NOTEBOOK, PAGE)


def test_foot():
    elsewhere = take_away.addresses("https://github.com/some/rhl", "main", NOTEBOOK, PAGE)
    foot = BeautifulSoup(
        take_away.foot("a.ipynb", "notebook", elsewhere, "https://github.com/some/rhl", "@x{<}"), "html.parser"
    )
    assert [link.text for link in foot.select("a")] == ["notebook", "Binder", "Colab", "this page online"]
    assert foot.code.text == "%pip install git+https://github.com/some/rhl"
    assert foot.pre.text == "@x{<}"
    bare = take_away.foot("a.ipynb", "notebook", {}, "", "")
    assert "Colab" not in bare
    assert bare.count("<a ") == 1


def test_bibtex_is_the_bibliography_and_the_companion():
    citation = yaml.load((ROOT / "CITATION.cff").read_text(encoding="utf-8"), Loader=yaml.BaseLoader)
    entries = take_away.bibtex(citation, (ROOT / "book/references.bib").read_text(encoding="utf-8"))
    assert entries.startswith("@article{ebenbauer2020,") or entries.startswith("@misc{ebenbauer2020,")
    assert entries.count("\n@software{rhl,") == 1
    assert f"version = {{{citation['version']}}}" in entries
    assert entries.count("{") == entries.count("}")


def notebook_of(id, count, memory, **metadata):
    shown = {"data": {"text/plain": f"<Styler at {memory}>", "text/html": "<b>"}, "metadata": {}}
    result = shown | {"output_type": "execute_result", "execution_count": count}
    printed = {"output_type": "stream", "name": "stdout", "text": f"at {memory}>"}
    outputs = [result, shown | {"output_type": "display_data"}, printed]
    code = {"cell_type": "code", "execution_count": count, "id": id, "metadata": metadata, "outputs": outputs}
    return {"cells": [{"cell_type": "markdown", "id": f"{id}0", "metadata": {}, "source": "a"}, code], "metadata": {}}


def test_an_executed_notebook_has_nothing_at_random():
    one = take_away.settled(notebook_of("a", None, "0x7f01", execution={"iopub.status.busy": "now"}, tags=["x"]))
    assert one["cells"][1]["outputs"][0]["data"] == {"text/plain": ["<Styler>"], "text/html": "<b>"}
    assert one["cells"][1]["metadata"] == {"tags": ["x"]}
    assert [cell["id"] for cell in one["cells"]] == ["cell-0", "cell-1"]
    assert one == take_away.settled(notebook_of("b", 7, "0x7f01", tags=["x"]))
    # What a cell prints itself is not changed, and would show in two builds.
    assert one != take_away.settled(notebook_of("b", 7, "0x7f02", tags=["x"]))


# ---------------------------------------------------------------- where the book comes from


def git(folder, *command):
    own = ["-c", "user.name=a", "-c", "user.email=a@example.org"]
    subprocess.run(["git", *own, *command], cwd=folder, check=True, capture_output=True)


def test_the_commit_is_named_and_what_is_not_committed(tmp_path):
    root = tmp_path / "project"
    root.mkdir()
    assert built_from.commit(root)[1] == ""
    git(root, "init", "--quiet")
    assert built_from.commit(root)[1] == ""  # there is no commit yet
    (root / "a").write_text("a")
    git(root, "add", "a")
    git(root, "commit", "--quiet", "--message", "a")
    clean = built_from.commit(root)
    assert re.fullmatch("[0-9a-f]{40}", clean[1])
    assert clean[2] == ", without changes."
    (root / "a").write_text("b")
    assert built_from.commit(root) == (clean[0], clean[1], " with changes that are not committed.")
    # A copy inside another repository is not that repository's commit.
    (root / "copy").mkdir()
    assert built_from.commit(root / "copy")[1] == ""


def test_a_page_that_names_another_commit_is_outdated(tmp_path):
    now = built_from.commit(tmp_path)
    env = SimpleNamespace(srcdir=tmp_path)
    assert built_from.outdated(None, env, set(), set(), set()) == []
    built_from.noted(env).update(
        {"a": now, "b": ("The sources are those of commit ", "0" * 40, "."), "c": ("", "", "")}
    )
    assert built_from.outdated(None, env, set(), set(), {"c"}) == ["b"]


# ---------------------------------------------------------------- mending pages

AMISS = """<script src="../_static/vendor/fontawesome/6/js/all.min.js?digest=1"></script>
<link rel="preload" as="font" type="font/woff2" crossorigin href="_static/webfonts/fa-brands-400.woff2" />
<link rel="preload" as="font" type="font/woff2" crossorigin href="_static/webfonts/fa-solid-900.woff2" />
<img src="_static/minus.png" class="toggler" id="toggle-1" style="display: none" alt="-" />
<form class="bd-search" action="search.html"><input id="search-input"></form><input id="search-input">"""


def test_pages_are_mended():
    page, found = lean_pages.mend(AMISS)
    assert found == lean_pages.MENDINGS.keys()
    assert "fa-solid-900" in page
    assert "all.min.js" not in page
    assert "fa-brands-400" not in page
    assert page.count('id="search-input"') == 1
    assert lean_pages.mend(page) == (page, set())


def test_a_fix_that_applies_to_no_page_fails_the_build(tmp_path):
    app = SimpleNamespace(builder=SimpleNamespace(name="html"), outdir=tmp_path)
    (tmp_path / "a.html").write_text(AMISS, encoding="utf-8")
    lean_pages.mend_pages(app, None, {"a"})
    with pytest.raises(ExtensionError, match=r"^every fix must apply to a page, got none for these; remove them"):
        lean_pages.mend_pages(app, None, {"a"})
    lean_pages.mend_pages(app, None, set())  # Sphinx has kept every page of the last build, mended


# ---------------------------------------------------------------- roles that reach the reader


@pytest.mark.parametrize("text", ["a {glue:text}`value:.2f` b", '<span class="math">\\(x(glue:text`at:d`)\\)</span>'])
def test_roles_that_reach_the_reader_are_found(text):
    assert len(leftovers.leftover_roles(f"<article>{text}</article><pre>{{glue:text}}`code`</pre>")) == 1
    assert leftovers.leftover_roles(f"<article><code>{text}</code></article>") == []


def test_such_a_page_fails_the_build(tmp_path):
    app = SimpleNamespace(builder=SimpleNamespace(name="html"), outdir=tmp_path, env=SimpleNamespace(found_docs={"a"}))
    (tmp_path / "a.html").write_text("<article>fine</article>", encoding="utf-8")
    leftovers.refuse(app, None)
    (tmp_path / "a.html").write_text("<article>{ref}`b`</article>", encoding="utf-8")
    with pytest.raises(ExtensionError, match=r"a shows \{ref\}`b`"):
        leftovers.refuse(app, None)


# ---------------------------------------------------------------- formulas where no script runs

MACROS = {"argmin": r"\operatorname*{arg\,min}", "R": r"\mathbb{R}"}


def mathml_words(markup):
    return "".join(BeautifulSoup(markup, "html.parser").get_text().split())


def test_a_formula_stands_beside_its_tex_and_alone_in_the_epub():
    markup = '<span class="math">\\(x &lt; \\argmin_z z\\)</span>'
    both = local_mathjax.beside(markup, MACROS, instead=False)
    assert '<span class="tex">\\(x &lt; \\argmin_z z\\)</span><noscript><math' in both
    alone = local_mathjax.beside(markup, MACROS, instead=True)
    assert "\\" not in alone
    assert mathml_words(alone).startswith("x<arg")
    assert 'data-number="(7)"' in local_mathjax.beside(r"\[x \tag{7}\]", MACROS, instead=False)


def test_a_power_of_a_matrix_is_one_of_all_of_it():
    made, _ = local_mathjax.mathml(r"\begin{bmatrix} a \\ b \end{bmatrix}^+", True, MACROS)
    (power,) = BeautifulSoup(made, "html.parser").select("msup")
    assert [part.name for part in power.find_all(recursive=False)] == ["mrow", "mo"]


def test_a_power_of_nothing_fails_the_build(monkeypatch):
    monkeypatch.setattr(local_mathjax, "_converted", lambda tex, block: "<math><msup><mo>[</mo></msup></math>")
    with pytest.raises(ExtensionError, match=r"must have 2 parts, found 1: \[\^2"):
        local_mathjax.mathml("[^2", True, MACROS)


def test_lines_become_rows_and_the_number_stands_behind():
    lines = r"\begin{aligned}a &amp;= b\\ c &amp;= d\end{aligned}\tag{7}"
    markup = rf"<div>\[\begin{{equation*}}{lines}\end{{equation*}}\]</div>"
    alone = local_mathjax.beside(markup, MACROS, instead=True)
    assert len(BeautifulSoup(alone, "html.parser").select("mtr")) == 2
    assert mathml_words(alone) == "(7)a=bc=d"


@pytest.mark.parametrize("tex", [r"\unknowncommand x", r"\begin{alignat}{2} a &= b \end{alignat}"])
def test_what_cannot_be_converted_fails_the_build(tex):
    with pytest.raises(ExtensionError, match="a formula"):
        local_mathjax.mathml(tex, True, MACROS)


# ---------------------------------------------------------------- the search page


def test_texts_for_the_search_are_prose_by_section():
    page = """<article class="bd-article"><section id="top"><h1>Title<a class="headerlink">#</a></h1>
    <p>One <span class="math"><span class="tex">\\(x\\)</span><noscript><math><mi>x</mi></math></noscript></span>.</p>
    <pre>code</pre><section id="below"><h2>Part</h2><p>Two<b>fold</b></p></section></section></article>"""
    assert search_pages.prose(page) == {"": "Title One x.", "below": "Part Twofold"}
    assert search_pages.prose("<p>no article</p>") == {}
