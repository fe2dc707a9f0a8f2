"""The foot of every page: its notebook, its citation and, if the book has a public address, its other sites."""

import html
import json
import re
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlsplit

import yaml
from sphinx.application import Sphinx

# In Python's words for an object that has none of its own.
ADDRESS = re.compile(r" at 0x[0-9a-f]+(?=>)")


def addresses(repository: str, branch: str, notebook: str, page: str) -> dict[str, str]:
    """The other addresses of a page, on Binder, Colab and GitHub Pages, from the address of the repository.

    `notebook` is the notebook's path in the repository, empty if there is none; without a repository there are no
    addresses.
    """
    if not repository:
        return {}
    parts = urlsplit(repository)
    owner, _, name = parts.path.strip("/").partition("/")
    if parts.netloc != "github.com" or not owner or not name or "/" in name:
        raise ValueError(f"repository.url must look like https://github.com/OWNER/NAME, got {repository}")
    at = f"{owner}/{name}"
    found = {}
    if notebook:
        found["Binder"] = f"https://mybinder.org/v2/gh/{at}/{branch}?urlpath={quote(f'lab/tree/{notebook}', safe='')}"
        found["Colab"] = f"https://colab.research.google.com/github/{at}/blob/{branch}/{quote(notebook)}"
    root = f"https://{owner.lower()}.github.io/"
    found["this page online"] = root + ("" if name.lower() == f"{owner}.github.io".lower() else f"{name}/") + page
    return found


def bibtex(citation: dict[str, Any], bibliography: str) -> str:
    """The paper's entry from the bibliography, and one for the companion from CITATION.cff."""
    authors = " and ".join(f"{{{author['name']}}}" for author in citation["authors"])
    companion = {
        "title": f"{{{citation['title']}}}",
        "author": authors,
        "version": citation["version"],
        "note": "Executable companion to arXiv:2010.05891",
    }
    lines = [f"  {key:<7} = {{{value}}}," for key, value in companion.items()]
    return bibliography.strip() + "\n\n@software{rhl,\n" + "\n".join(lines) + "\n}"


def foot(source: str, kind: str, elsewhere: dict[str, str], repository: str, entries: str) -> str:
    """The foot as HTML; `source` is the address of the page's source."""
    links = [f'<a href="{html.escape(source)}" download>{kind}</a>']
    links += [f'<a href="{html.escape(address)}">{words}</a>' for words, address in elsewhere.items()]
    colab = (
        f"<p>On Colab, run <code>%pip install git+{html.escape(repository)}</code> first.</p>"
        if "Colab" in elsewhere
        else ""
    )
    return (
        '<aside class="take-away" aria-label="Take this page with you">'
        f"<p>Take away: {' · '.join(links)}</p>{colab}"
        f'<details><summary>Cite (BibTeX)</summary><pre tabindex="0">{html.escape(entries)}</pre></details></aside>'
    )


def settled(notebook: dict[str, Any]) -> dict[str, Any]:
    """A notebook without what differs between two builds: ids drawn at random, addresses in memory, times, counts."""
    cells, count = [], 0
    for i, cell in enumerate(notebook["cells"]):
        cell = cell | {"id": f"cell-{i}"}
        if cell["cell_type"] == "code":
            count += 1
            cell["execution_count"] = count
            cell["metadata"] = {key: value for key, value in cell["metadata"].items() if key != "execution"}
            cell["outputs"] = [_settled_output(output, count) for output in cell["outputs"]]
        cells.append(cell)
    return notebook | {"cells": cells}


def _settled_output(output: dict[str, Any], count: int) -> dict[str, Any]:
    if output["output_type"] == "execute_result":
        output = output | {"execution_count": count}
    if plain := output.get("data", {}).get("text/plain"):
        lines = [plain] if isinstance(plain, str) else plain
        output = output | {"data": output["data"] | {"text/plain": [ADDRESS.sub("", line) for line in lines]}}
    return output


def place_notebook(app: Sphinx, pagename: str) -> str:
    """Add the executed notebook of a MyST page to the sources; returns its name."""
    executed = Path(app.outdir).parent / "jupyter_execute" / f"{pagename}.ipynb"
    target = Path(app.outdir, "_sources", f"{pagename}.ipynb")
    target.parent.mkdir(parents=True, exist_ok=True)
    notebook = settled(json.loads(executed.read_text(encoding="utf-8")))
    target.write_text(json.dumps(notebook, indent=1, ensure_ascii=False, sort_keys=True) + "\n", encoding="utf-8")
    return f"{pagename}.ipynb"


def add_foot(app: Sphinx, pagename: str, templatename: str, context: dict[str, Any], doctree: Any) -> None:
    """Add the page's foot, and its notebook to the theme's download button."""
    if app.builder.name == "epub" or doctree is None or "body" not in context or not context.get("sourcename"):
        return
    source, notebook = context["sourcename"], ""
    if source.endswith(".ipynb"):
        notebook = source
    elif "kernelspec" in app.env.metadata[pagename]:
        # The theme offers this notebook in addition to the text source.
        source = context["ipynb_source"] = place_notebook(app, pagename)
    kind = "notebook" if source.endswith(".ipynb") else "source"
    options = app.config.html_theme_options
    repository = options.get("repository_url", "").rstrip("/")
    elsewhere = addresses(repository, options.get("repository_branch", "main"), notebook, f"{pagename}.html")
    root = Path(app.srcdir)
    entries = bibtex(
        yaml.load((root / "CITATION.cff").read_text(encoding="utf-8"), Loader=yaml.BaseLoader),
        (root / "book/references.bib").read_text(encoding="utf-8"),
    )
    address = f"{context['pathto']('_sources', 1)}/{source}"
    context["body"] += foot(address, kind, elsewhere, repository, entries)


def setup(app: Sphinx) -> dict[str, bool]:
    """Run before the theme, which has priority 500 and reads the values set here."""
    app.connect("html-page-context", add_foot, priority=400)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
