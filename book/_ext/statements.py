"""Statements with the paper's own numbers, and links between statement, proof, checks, code and tests.

The blocks are written `{prf:lemma} Lemma 5 (a remark)`, as in sphinx-proof. That extension numbers the blocks
itself, which differs from the paper, and repeats ids; here the title is the unchanged argument.
"""

import json
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, cast

from bs4 import BeautifulSoup
from docutils import nodes
from docutils.parsers.rst import directives
from sphinx.application import Sphinx
from sphinx.domains import Domain
from sphinx.domains.std import StandardDomain
from sphinx.environment import BuildEnvironment
from sphinx.util.docutils import SphinxDirective

from rhl.paper.claims.claim import Claim
from rhl.paper.claims.ledger import CLAIMS
from rhl.paper.listing import section_id

# Labels with this prefix mark the paper's statement on a page.
STATED = "stated-"
PREVIEWS = "statements.json"


def standard(env: BuildEnvironment) -> StandardDomain:
    """The domain with the labels of all pages."""
    return cast(StandardDomain, env.get_domain("std"))


class Statement(SphinxDirective):
    """A statement with its argument as title."""

    required_arguments = 1
    final_argument_whitespace = True
    has_content = True
    option_spec: ClassVar[dict[str, Any]] = {
        "label": directives.unchanged_required,
        "class": directives.class_option,
        "nonumber": directives.flag,  # for compatibility with sphinx-proof; nothing is numbered here
    }

    def run(self) -> list[nodes.Node]:
        """Return an admonition whose label can be linked from every page."""
        block = nodes.admonition(classes=["statement", self.name.partition(":")[2], *self.options.get("class", [])])
        self.set_source_info(block)
        words, messages = self.state.inline_text(self.arguments[0], self.lineno)
        title = nodes.title(self.arguments[0], "", *words)
        block += [title, *messages]
        if label := self.options.get("label"):
            block["ids"].append(label)
            standard(self.env).note_hyperlink_target(label, self.env.docname, label, title.astext())
        self.state.nested_parse(self.content, self.content_offset, block)
        return [block]


class StatementDomain(Domain):
    """The kinds of statement in the book."""

    name = "prf"
    label = "Statements"
    directives = dict.fromkeys(
        ("theorem", "lemma", "proposition", "corollary", "assumption", "definition", "remark"), Statement
    )

    def merge_domaindata(self, docnames: Any, otherdata: dict[str, Any]) -> None:
        """Nothing to merge: labels live in the standard domain."""


def module_of(claim: Claim) -> str:
    """The module that checks a claim; empty if there is none."""
    check = claim.stated.func if isinstance(claim.stated, partial) else claim.stated
    return check.__module__ if check else ""


def docname_of(claim: Claim) -> str:
    """Sphinx's name of a claim's page."""
    return claim.page.rpartition(".")[0]


def leading(claims: list[Claim], name: str) -> Claim:
    """The claim after which a page, a module or a file of tests is named, such as "theorem-2"; a checked one, if any.

    If no claim has that name, it is the first.
    """
    named = [claim for claim in claims if claim.id.startswith(name)] or claims
    return next(filter(module_of, named), named[0])


def test_id(claim: Claim) -> str:
    """The anchor of a claim's tests on the page of the tests."""
    return Path(claim.test).stem.replace("_", "-")


def trail(
    app: Sphinx, docname: str, claims: list[Claim], name: str, proof: str = "", here: str = ""
) -> list[tuple[str, str]]:
    """The links of these claims, as (words, address relative to `docname`), in the order of an argument.

    `name` is their subject, such as "theorem-2", `proof` the id of the proof's section on this page, `here` the word
    for the current place.
    """
    main = leading(claims, name)

    def to(page: str, anchor: str = "") -> str:
        return app.builder.get_relative_uri(docname, page) + (f"#{anchor}" if anchor else "")

    page = docname_of(main)
    labels = standard(app.env).anonlabels
    stated = [id for place, id in labels.values() if place == page and id.startswith(STATED)]
    links = [("Statement", to(page, stated[0]))] if stated else [("Page", to(page))]
    if proof:
        links.append(("Proof", f"#{proof}"))
    links.append((f"Checks ({sum(map(bool, map(module_of, claims)))})", to("book/ledger", section_id(main.page))))
    if module := module_of(main):
        links.append(("Code", to(f"_modules/{module.replace('.', '/')}")))
    links.append(("Tests", to("book/checks", test_id(main))))
    return [(words, address) for words, address in links if words.partition(" ")[0] != here]


def paragraph(links: list[tuple[str, str]]) -> nodes.paragraph:
    """A trail as a line of text."""
    line = nodes.paragraph(classes=["trail"])
    for i, (words, address) in enumerate(links):
        line += [nodes.Text(" · ")] if i else []
        line += nodes.reference("", words, refuri=address, internal=True)
    return line


def sections(doctree: nodes.document, start: str) -> Iterator[nodes.section]:
    """The sections with an id with this prefix."""
    for section in doctree.findall(nodes.section):
        if any(id.startswith(start) for id in section["ids"]):
            yield section


def add_trails(app: Sphinx, doctree: nodes.document, docname: str) -> None:
    """Add a trail below the page's statement, under its proof's heading, and under each heading of the tests."""
    if app.builder.name != "html":
        return
    if docname == "book/checks":
        for section in sections(doctree, "test-"):
            claims = [claim for claim in CLAIMS if test_id(claim) in section["ids"]]
            if claims:
                name = test_id(claims[0]).removeprefix("test-")
                section.insert(1, paragraph(trail(app, docname, claims, name, here="Tests")))
    claims = [claim for claim in CLAIMS if docname_of(claim) == docname]
    stated = [block for block in doctree.findall(nodes.admonition) if any(id.startswith(STATED) for id in block["ids"])]
    if claims and stated:
        proofs = list(sections(doctree, "the-proof"))
        proof = proofs[0]["ids"][0] if proofs else ""
        (label,) = (id for id in stated[0]["ids"] if id.startswith(STATED))
        name = label.removeprefix(STATED)
        stated[0] += paragraph(trail(app, docname, claims, name, proof, here="Statement"))
        if proofs:
            proofs[0].insert(1, paragraph(trail(app, docname, claims, name, here="Proof")))


def add_trail_to_code(app: Sphinx, pagename: str, templatename: str, context: dict[str, Any], doctree: Any) -> None:
    """Add a trail above the source of a module that checks claims."""
    module = pagename.removeprefix("_modules/").replace("/", ".")
    claims = [claim for claim in CLAIMS if module_of(claim) == module]
    if claims and pagename.startswith("_modules/"):
        name = module.rpartition(".")[2].replace("_", "-")
        links = trail(app, pagename, claims, name, here="Code")
        line = " · ".join(f'<a class="reference internal" href="{address}">{words}</a>' for words, address in links)
        context["body"] = context["body"].replace("</h1>", f'</h1><p class="trail">{line}</p>', 1)


def write_previews(app: Sphinx, exception: Exception | None) -> None:
    """Collect the pages' statements in one file, for the previews of links."""
    if exception or app.builder.name != "html":
        return
    previews = {}
    for docname in sorted({docname_of(claim) for claim in CLAIMS} & app.env.found_docs):
        page = BeautifulSoup(Path(app.outdir, f"{docname}.html").read_text(encoding="utf-8"), "html.parser")
        if block := page.select_one(f".statement[id^={STATED}]"):
            for tag in block.select(".trail, .headerlink"):
                tag.decompose()
            for tag in [block, *block.select("[id]")]:
                del tag["id"]  # a preview may appear on the statement's own page
            previews[f"{docname}.html"] = str(block)
    Path(app.outdir, "_static", PREVIEWS).write_text(json.dumps(previews), encoding="utf-8")


def setup(app: Sphinx) -> dict[str, bool]:
    """Register with Sphinx."""
    app.add_domain(StatementDomain)
    app.connect("doctree-resolved", add_trails)
    app.connect("html-page-context", add_trail_to_code)
    app.connect("build-finished", write_previews)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
