"""The directive `built-from`: a paragraph that names the commit from which the book is built."""

import subprocess
from pathlib import Path

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.util.docutils import SphinxDirective


def _git(root: Path, *command: str) -> str | None:
    """What git prints, None if it fails or is not installed."""
    try:
        done = subprocess.run(["git", *command], cwd=root, capture_output=True, text=True, check=False)
    except OSError:
        return None
    return done.stdout.strip() if done.returncode == 0 else None


def commit(root: Path) -> tuple[str, str, str]:
    """A sentence about the sources in two parts, and between them the commit, empty if it is not known."""
    top, head = _git(root, "rev-parse", "--show-toplevel"), _git(root, "rev-parse", "HEAD")
    if top is None or not head or Path(top).resolve() != root.resolve():
        return "The commit is not known, because the sources are not a git repository.", "", ""
    if _git(root, "status", "--porcelain"):
        return "The sources are those of commit ", head, " with changes that are not committed."
    return "The sources are those of commit ", head, ", without changes."


class BuiltFrom(SphinxDirective):
    """The paragraph."""

    def run(self) -> list[nodes.Node]:
        """Make it, and note its text for the next build."""
        found = commit(Path(self.env.srcdir))
        noted(self.env)[self.env.docname] = found
        before, head, after = found
        return [
            nodes.paragraph(
                "", "", nodes.Text(before), *([nodes.literal(head, head)] if head else []), nodes.Text(after)
            )
        ]


def noted(env: BuildEnvironment) -> dict[str, tuple[str, str, str]]:
    """The paragraphs of the last build, by page; Sphinx keeps them with the pages."""
    found: dict[str, tuple[str, str, str]] = env.__dict__.setdefault("rhl_built_from", {})
    return found


def outdated(app: Sphinx, env: BuildEnvironment, added: set[str], changed: set[str], removed: set[str]) -> list[str]:
    """The pages that name another commit, which Sphinx would keep because their files have not changed."""
    now = commit(Path(env.srcdir))
    return [page for page, found in noted(env).items() if found != now and page not in removed]


def setup(app: Sphinx) -> dict[str, bool]:
    """Register with Sphinx."""
    app.add_directive("built-from", BuiltFrom)
    app.connect("env-get-outdated", outdated)
    return {"parallel_read_safe": False, "parallel_write_safe": True}
