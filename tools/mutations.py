"""Changes of source code for mutation testing: one place of one file in another form (tools/mutants.py runs them)."""

import ast
import hashlib
import json
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

# Modules without results that a notebook could state.
NOT_RESULTS = (
    "rhl/plotting.py",
    "rhl/_checks.py",
    "rhl/paper/drawings.py",
    "rhl/paper/figures.py",
    "rhl/paper/motion.py",
)
# Keywords of drawing functions that set how something looks, not where it is.
STYLE = {
    *("alpha", "c", "color", "dpi", "figsize", "fontsize", "fontweight", "ha", "va", "height_ratios", "hspace", "loc"),
    *("ls", "linestyle", "lw", "linewidth", "marker", "ms", "markersize", "ncols", "pad", "rotation", "s", "size"),
    *("width_ratios", "wspace", "zorder", "indent"),
}
SWAPPED: dict[type, tuple[type, ...]] = {
    ast.Lt: (ast.LtE, ast.Gt),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.Lt),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.Add: (ast.Sub,),
    ast.Sub: (ast.Add,),
    ast.Mult: (ast.Div,),
    ast.Div: (ast.Mult,),
    ast.FloorDiv: (ast.Mult,),
    ast.Mod: (ast.Add,),
    ast.Pow: (ast.Mult,),
    ast.BitAnd: (ast.BitOr,),
    ast.BitOr: (ast.BitAnd,),
    ast.And: (ast.Or,),
    ast.Or: (ast.And,),
}
CALLED = {"min": "max", "max": "min", "any": "all", "all": "any", "zeros": "ones", "ones": "zeros"}
CALLED |= {"minimum": "maximum", "maximum": "minimum", "sum": "max", "floor": "ceil"}


@dataclass(frozen=True)
class Mutant:
    """One changed place: the file, the function around it, the line before and after, and the file's new content."""

    file: str
    function: str
    line: int
    before: str
    after: str
    content: str

    @property
    def id(self) -> str:
        """Hash of the change, which does not depend on the file or on the position."""
        return hashlib.sha256("\0".join((self.function, self.before, self.after)).encode()).hexdigest()[:16]

    @property
    def room(self) -> str:
        """The folder, as in "rhl.paper.claims"."""
        return ".".join(Path(self.file).parts[:-1])


def changes(node: ast.AST) -> Iterator[ast.AST]:
    """Every other form of this node alone."""
    match node:
        case ast.Compare(left, [op], [right]):
            for other in SWAPPED.get(type(op), ()):
                yield ast.Compare(left, [other()], [right])
        case ast.BinOp(left, op, right) if type(op) in SWAPPED:
            # Strings and paths are joined, not computed.
            if not any(isinstance(side, ast.JoinedStr | ast.Constant) and not _numeric(side) for side in (left, right)):
                yield ast.BinOp(left, SWAPPED[type(op)][0](), right)
        case ast.BoolOp(op, values):
            yield ast.BoolOp(SWAPPED[type(op)][0](), values)
        case ast.UnaryOp(ast.Not() | ast.USub(), operand):
            yield operand
        case ast.Constant(bool() as value):
            yield ast.Constant(not value)
        case ast.Constant(int() as value):
            yield ast.Constant(value + 1)
        case ast.Constant(float() as value):
            yield ast.Constant(2 * value if value else 1.0)
        case ast.Call(ast.Name("abs") | ast.Attribute(attr="abs") | ast.Name("sorted"), [only], []):
            yield only
        case ast.Call(ast.Name(name), args, keywords) if name in CALLED:
            yield ast.Call(ast.Name(CALLED[name]), args, keywords)
        case ast.Call(ast.Attribute(value, name), args, keywords) if name in CALLED:
            yield ast.Call(ast.Attribute(value, CALLED[name]), args, keywords)
        case ast.If(test=ast.Name(id=name)) if name == "TYPE_CHECKING":
            return
        case ast.If(test=ast.Name() | ast.Attribute() | ast.Call()):
            yield ast.UnaryOp(ast.Not(), node.test)
        case ast.Expr(ast.Call()) | ast.AugAssign() | ast.Raise():
            yield ast.Pass()


def _numeric(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, int | float)


def mutants_of(file: str, text: str, changes: Callable[[ast.AST], Iterator[ast.AST]] = changes) -> Iterator[Mutant]:
    """Every mutant of one file; ``changes`` gives the other forms of a node."""

    def visit(node: ast.AST, function: str) -> Iterator[Mutant]:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            function = f"{function}.{node.name}".lstrip(".")
        for other in changes(node):
            # Of an `if`, only the condition is replaced.
            place = node.test if isinstance(node, ast.If) else node
            assert isinstance(place, ast.expr | ast.stmt)
            yield _replaced(file, function, text, place, other)
        for child in _computed(node):
            yield from visit(child, function)

    yield from visit(ast.parse(text), "")


def _replaced(file: str, function: str, text: str, place: ast.expr | ast.stmt, other: ast.AST) -> Mutant:
    """The file with this place in another form; the rest of its bytes is kept."""
    content = text.encode()
    starts = [0]
    for line in content.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    assert place.end_lineno is not None
    assert place.end_col_offset is not None
    begin = starts[place.lineno - 1] + place.col_offset
    end = starts[place.end_lineno - 1] + place.end_col_offset
    source = ast.unparse(other)
    if isinstance(place, ast.expr) and not isinstance(other, ast.Constant | ast.Name):
        source = f"({source})"
    changed = content[:begin] + source.encode() + content[end:]
    first, last = starts[place.lineno - 1], starts[place.end_lineno]
    before = content[first:last].decode().strip()
    after = changed[first : len(changed) - (len(content) - last)].decode().strip()
    return Mutant(file, function, place.lineno, before, after, changed.decode())


def _computed(node: ast.AST) -> Iterator[ast.AST]:
    """The parts of a node in which a change can change a result: no messages, annotations, docstrings, imports."""
    match node:
        case ast.Raise() | ast.Import() | ast.ImportFrom() | ast.JoinedStr() | ast.AnnAssign(value=None):
            return
        case ast.AnnAssign(value=value) if value is not None:
            yield value
        case ast.FunctionDef(args=args, body=body):
            yield from [*args.defaults, *filter(None, args.kw_defaults), *body]
        case ast.If(test=ast.Name(id="TYPE_CHECKING")) | ast.If(test=ast.Compare(left=ast.Name(id="__name__"))):
            return
        case ast.Assert(test=test):
            yield test
        case ast.keyword(arg=name) if name in STYLE:
            return
        case _:
            yield from ast.iter_child_nodes(node)


def sample(root: Path, size: int, seed: int, folder: str = "rhl") -> list[Mutant]:
    """Mutants from every room, in proportion to its lines and at least 24 from each, ordered by room."""
    rooms: dict[str, list[Mutant]] = defaultdict(list)
    lines: Counter[str] = Counter()
    for path in sorted((root / folder).rglob("*.py")):
        file = path.relative_to(root).as_posix()
        text = path.read_text(encoding="utf-8")
        found = list({mutant.id: mutant for mutant in mutants_of(file, text)}.values())
        if found:
            rooms[found[0].room] += found
            lines[found[0].room] += text.count("\n")
    chosen = []
    for room, found in sorted(rooms.items()):
        share = max(24, round(size * lines[room] / lines.total()))
        ranked = sorted(found, key=lambda mutant: hashlib.sha256(f"{seed} {mutant.id}".encode()).digest())
        kept: list[Mutant] = []
        for mutant in ranked:  # no two in one line
            if all((mutant.file, mutant.line) != (other.file, other.line) for other in kept):
                kept.append(mutant)
            if len(kept) == share:
                break
        chosen += kept
    return chosen


def _contradicted(node: ast.AST) -> Iterator[ast.AST]:
    """An assertion's comparison turned round, or a number that it states changed; bounds and tolerances are neither."""
    match node:
        case ast.Compare(left, [ast.Eq() as op], [right]):
            yield ast.Compare(left, [SWAPPED[type(op)][0]()], [right])
            yield from (ast.Compare(left, [op], [other]) for other in _other_numbers(right))
        case ast.Compare(left, [op], [right]) if type(op) in SWAPPED:
            yield ast.Compare(left, [SWAPPED[type(op)][-1]()], [right])
        case ast.Call(ast.Attribute(_, "allclose" | "isclose" | "array_equal"), [left, right], keywords):
            yield from (ast.Call(node.func, [left, other], keywords) for other in _other_numbers(right))


def _other_numbers(node: ast.expr) -> Iterator[ast.expr]:
    """The expression with one of its numbers changed, for each of them."""
    for number in ast.walk(node):
        if isinstance(number, ast.Constant) and isinstance(value := number.value, int | float):
            number.value = value * 1.25 + 1 if isinstance(value, float) else value + 1
            yield ast.parse(ast.unparse(node), mode="eval").body
            number.value = value


def asserted(notebook: str, text: str) -> Iterator[Mutant]:
    """Changes of what a notebook asserts."""
    cells = json.loads(text)["cells"]
    for number, cell in enumerate(cells):
        code = "".join(cell["source"])
        if cell["cell_type"] != "code" or "assert" not in code:
            continue
        lines = {line for node in ast.walk(ast.parse(code)) if isinstance(node, ast.Assert) for line in _span(node)}
        for mutant in mutants_of(notebook, code, _contradicted):
            if mutant.line in lines:
                changed = [dict(each, source=mutant.content) if each is cell else each for each in cells]
                content = json.dumps(json.loads(text) | {"cells": changed}, indent=1, ensure_ascii=False)
                yield Mutant(notebook, f"cell {number}", mutant.line, mutant.before, mutant.after, content)


def _span(node: ast.stmt) -> range:
    assert node.end_lineno is not None
    return range(node.lineno, node.end_lineno + 1)


def _spoiled(node: ast.AST) -> Iterator[ast.AST]:
    """The return of numbers, one per cent larger."""
    match node:
        case ast.FunctionDef(returns=ast.Name("Array" | "float")):
            if isinstance(last := node.body[-1], ast.Return) and last.value is not None:
                larger = ast.Return(ast.BinOp(ast.Constant(1.01), ast.Mult(), last.value))
                yield ast.FunctionDef(**{**vars(node), "body": [*node.body[:-1], larger]})


def notebook_sample(root: Path, executes: dict[str, dict[str, list[int]]], seed: int) -> list[tuple[str, Mutant]]:
    """For every notebook one change of its assertions, and one of what a function that it executes returns."""

    def first(found: list[Mutant], notebook: str) -> list[Mutant]:
        return sorted(found, key=lambda of: hashlib.sha256(f"{seed} {notebook} {of.id}".encode()).digest())[:1]

    chosen: list[tuple[str, Mutant]] = []
    for path in sorted((root / "notebooks").glob("*.ipynb")):
        name = path.relative_to(root).as_posix()
        own = first(list(asserted(name, path.read_text(encoding="utf-8"))), name)
        returned = []
        for file, lines in executes[name].items():
            for mutant in mutants_of(file, (root / file).read_text(encoding="utf-8"), _spoiled):
                inside = range(mutant.line + 1, mutant.line + 1 + mutant.before.count("\n"))
                if not file.startswith(NOT_RESULTS) and not set(inside).isdisjoint(lines):
                    returned.append(mutant)
        chosen += [(name, mutant) for mutant in own + first(returned, name)]
    return chosen
