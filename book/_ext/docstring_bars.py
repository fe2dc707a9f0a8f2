"""Allow |x| for an absolute value in docstrings; reStructuredText would look for a substitution named x."""

import re
from typing import Any

from sphinx.application import Sphinx

# Inline literals and roles are unchanged; any other bar is escaped.
_PIECES = re.compile(r"``.*?``|:\w+:`[^`]*`|\|")


def escape_bars(lines: list[str]) -> list[str]:
    """Escape bars outside literals, roles and math blocks."""
    out, math_indent = [], None
    for line in lines:
        indent = len(line) - len(line.lstrip())
        if math_indent is not None and line.strip() and indent <= math_indent:
            math_indent = None
        if line.lstrip().startswith(".. math::"):
            math_indent = indent
        inside = math_indent is not None or line.lstrip().startswith((">>>", "..."))
        out.append(line if inside else _PIECES.sub(lambda m: r"\|" if m.group() == "|" else m.group(), line))
    return out


def _process(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    lines[:] = escape_bars(lines)


def setup(app: Sphinx) -> dict[str, bool]:
    """Run after napoleon, which has priority 500."""
    app.connect("autodoc-process-docstring", _process, priority=900)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
