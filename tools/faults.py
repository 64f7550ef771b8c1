"""Faults that may be planted: each replaces one expression or statement of a module, and leaves the rest as it is."""

from __future__ import annotations

import ast
import io
import random
import tokenize
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from hashlib import blake2b

from tools.source import PACKAGE, Function, Place, Scopes, lines_of

KINDS = ("comparison", "constant", "sign", "statement", "arguments", "guard")
"""A comparison swapped with its neighbour; an integer one more or less, a float scaled; plus for minus; a statement
left out; two neighbouring arguments swapped; an `if` before raise, return, continue or break that is never taken, or an
assert left out."""

SCALE = 1.5
"""The factor of floats."""

OPERATORS: dict[type[ast.cmpop], tuple[str, str]] = {
    ast.Lt: ("<", "<="),
    ast.LtE: ("<=", "<"),
    ast.Gt: (">", ">="),
    ast.GtE: (">=", ">"),
    ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="),
    ast.Is: ("is", "is not"),
    ast.IsNot: ("is not", "is"),
    ast.In: ("in", "not in"),
    ast.NotIn: ("not in", "in"),
}
SYMMETRIC = {"min", "max", "hypot", "gcd", "lcm", "minimum", "maximum", "fmin", "fmax", "logical_and", "logical_or"}
TYPING = {"cast", "TypeVar", "NewType", "ParamSpec"}
HELP = {"Option", "Argument"}
TEXT_KEYWORDS = {"help", "short_help", "description", "title", "epilog", "metavar", "rich_help_panel"}
LOG_METHODS = {"debug", "info", "warning", "error", "exception", "critical", "log"}
LOGS = {"log", "_log", "_LOG", "LOG", "logger", "_logger", "LOGGER", "logging", "warnings"}


@dataclass(frozen=True)
class Fault:
    """A fault. All but the last four name it in a file whose lines may have moved."""

    path: str
    function: str
    kind: str
    statement: str
    before: str
    after: str
    occurrence: int
    line: int
    start: int
    end: int
    place: Place

    @property
    def identity(self) -> tuple[str, str, str, str, str, str, int]:
        """What names the fault: none of it changes when lines move."""
        return self.path, self.function, self.kind, self.statement, self.before, self.after, self.occurrence

    @property
    def id(self) -> str:
        """A short name made from the identity."""
        return blake2b("\0".join(map(str, self.identity)).encode(), digest_size=6).hexdigest()

    @property
    def package(self) -> str:
        """The package below skyrange; "skyrange" for modules in none."""
        parts = self.path.removeprefix(f"{PACKAGE}/").split("/")
        return parts[0] if len(parts) > 1 else "skyrange"

    @property
    def compiled(self) -> bool:
        """Whether numba compiles the code."""
        return self.place.kind == "compiled"

    def plant(self, text: bytes) -> bytes:
        """The module's text with the fault."""
        return text[: self.start] + self.after.encode() + text[self.end :]


def find_faults(path: str, text: bytes) -> list[Fault]:
    """All faults that can be planted in a module."""
    return list(_Finder(path, text).find())


def is_fault(fault: Fault, text: bytes) -> bool:
    """Whether the module can still be parsed and compiled, and is another program than before."""
    changed = fault.plant(text)
    try:
        tree = ast.parse(changed)
        compile(changed, fault.path, "exec", dont_inherit=True)
    except (SyntaxError, ValueError):
        return False
    return ast.dump(tree) != ast.dump(ast.parse(text))


class _Finder:
    def __init__(self, path: str, text: bytes) -> None:
        self._path = path
        self._text = text
        self._starts = [0]
        for line in text.splitlines(keepends=True):
            self._starts.append(self._starts[-1] + len(line))
        self._counts: Counter[tuple[str, ...]] = Counter()

    def find(self) -> Iterator[Fault]:
        yield from self._statements(ast.parse(self._text).body, Scopes())

    # ------------------------------------------------------------ statements

    def _statements(self, body: list[ast.stmt], scopes: Scopes) -> Iterator[Fault]:
        for statement in body:
            yield from self._statement(statement, scopes)

    def _statement(self, node: ast.stmt, scopes: Scopes) -> Iterator[Fault]:
        if isinstance(node, ast.Import | ast.ImportFrom) or _is_text(node) or _is_log(node) or _sets_all(node):
            return
        if isinstance(node, ast.If) and _is_type_checking(node.test):
            yield from self._statements(node.orelse, scopes)
            return
        functions = [scope for scope in scopes.stack if isinstance(scope, Function)]
        if isinstance(node, ast.Assert):
            if not _narrows(node.test):
                yield self._fault("guard", node, node, "pass", scopes)
        elif functions and _can_be_dropped(node):
            yield self._fault("statement", node, node, "pass", scopes)
        if isinstance(node, ast.If) and len(node.body) <= 2 and _jumps(node.body[-1]):
            yield self._fault("guard", node, node.test, self._never(node.test), scopes)
        if isinstance(node, ast.AugAssign) and isinstance(node.op, ast.Add | ast.Sub) and not _is_string(node.value):
            yield from self._augmented(node, scopes)
        for field, value in ast.iter_fields(node):
            if field in ("decorator_list", "annotation", "returns", "type_params"):
                continue
            nested = isinstance(node, Function | ast.ClassDef) and field == "body"
            inside = scopes.inside(node) if nested else scopes
            for child in value if isinstance(value, list) else [value]:
                yield from self._child(child, node, inside)

    def _child(self, child: object, statement: ast.stmt, scopes: Scopes) -> Iterator[Fault]:
        if isinstance(child, ast.stmt):
            yield from self._statement(child, scopes)
        elif isinstance(child, ast.excepthandler | ast.match_case | ast.withitem):
            for value in (value for _, value in ast.iter_fields(child)):
                for inner in value if isinstance(value, list) else [value]:
                    yield from self._child(inner, statement, scopes)
        elif isinstance(child, ast.AST):
            yield from self._expression(child, statement, scopes)

    def _augmented(self, node: ast.AugAssign, scopes: Scopes) -> Iterator[Fault]:
        middle = self._slice(self._end(node.target), self._start(node.value))
        old, new = ("+=", "-=") if isinstance(node.op, ast.Add) else ("-=", "+=")
        if middle.count(old) == 1 and "#" not in middle:
            text = self._of(node.target) + middle.replace(old, new) + self._of(node.value)
            yield self._fault("sign", node, node, text, scopes)

    # ------------------------------------------------------------ expressions

    def _expression(self, node: ast.AST, statement: ast.stmt, scopes: Scopes) -> Iterator[Fault]:
        if isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Call) and _is_help(node)):
            return  # positions inside f-strings are wrong before Python 3.12
        if isinstance(node, ast.Compare):
            yield from self._comparisons(node, statement, scopes)
        elif isinstance(node, ast.Constant):
            for text in self._neighbours(node):
                yield self._fault("constant", statement, node, text, scopes)
        elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Sub) and not _is_string(node):
            yield from self._opposite(node, statement, scopes)
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            yield self._fault("sign", statement, node, self._of(node).removeprefix("-").lstrip(), scopes)
        elif isinstance(node, ast.Call) and _name(node.func) not in SYMMETRIC | TYPING:
            yield from self._swapped(node, statement, scopes)
        if isinstance(node, ast.Lambda):
            scopes = scopes.inside(node)
        for child in ast.iter_child_nodes(node):
            if isinstance(node, ast.arg) or (isinstance(child, ast.keyword) and child.arg in TEXT_KEYWORDS):
                continue
            yield from self._expression(child, statement, scopes)

    def _comparisons(self, node: ast.Compare, statement: ast.stmt, scopes: Scopes) -> Iterator[Fault]:
        left: ast.expr = node.left
        for operator, right in zip(node.ops, node.comparators, strict=True):
            start, end = self._end(left), self._start(right)
            middle = self._slice(start, end)
            old, new = OPERATORS[type(operator)]
            if middle.count(old) == 1 and "#" not in middle:
                whole = self._slice(self._start(node), start) + middle.replace(old, new)
                yield self._fault("comparison", statement, node, whole + self._slice(end, self._end(node)), scopes)
            left = right

    def _neighbours(self, node: ast.Constant) -> list[str]:
        if type(node.value) is int:
            write = hex if self._of(node).lower().startswith("0x") else str
            return [write(value) for value in (node.value + 1, node.value - 1) if value >= 0]
        if type(node.value) is float and abs(node.value) < 1e300:
            return [repr(node.value * SCALE or SCALE)]
        return []

    def _opposite(self, node: ast.BinOp, statement: ast.stmt, scopes: Scopes) -> Iterator[Fault]:
        start, end = self._end(node.left), self._start(node.right)
        middle = self._slice(start, end)
        old, new = ("+", "-") if isinstance(node.op, ast.Add) else ("-", "+")
        if middle.count(old) == 1 and "#" not in middle:
            whole = self._slice(self._start(node), start) + middle.replace(old, new)
            yield self._fault("sign", statement, node, whole + self._slice(end, self._end(node)), scopes)

    def _swapped(self, node: ast.Call, statement: ast.stmt, scopes: Scopes) -> Iterator[Fault]:
        for first, second in zip(node.args, node.args[1:], strict=False):
            if isinstance(first, ast.Starred) or isinstance(second, ast.Starred) or self._of(first) == self._of(second):
                continue
            text = self._slice(self._start(node), self._start(first)) + self._of(second)
            text += self._slice(self._end(first), self._start(second)) + self._of(first)
            text += self._slice(self._end(second), self._end(node))
            yield self._fault("arguments", statement, node, text, scopes)

    def _never(self, test: ast.expr) -> str:
        binds = any(isinstance(node, ast.NamedExpr) for node in ast.walk(test))
        return f"({self._of(test)}) and False" if binds else "False"

    # ------------------------------------------------------------ text

    def _start(self, node: ast.AST) -> int:
        return self._starts[node.lineno - 1] + node.col_offset  # type: ignore[attr-defined, no-any-return]

    def _end(self, node: ast.AST) -> int:
        return self._starts[node.end_lineno - 1] + node.end_col_offset  # type: ignore[attr-defined, no-any-return]

    def _slice(self, start: int, end: int) -> str:
        return self._text[start:end].decode()

    def _of(self, node: ast.AST) -> str:
        return self._slice(self._start(node), self._end(node))

    def _fault(self, kind: str, statement: ast.stmt, node: ast.AST, after: str, scopes: Scopes) -> Fault:
        _, last = lines_of(statement)
        end = min(self._end(statement), self._starts[last])
        whole = " ".join(self._slice(self._start(statement), end).split())
        before = self._of(node)
        key = (scopes.name, kind, whole, before, after)
        self._counts[key] += 1
        place = scopes.place(self._path, statement)
        at: tuple[int, int] = (self._start(node), self._end(node))
        line: int = node.lineno  # type: ignore[attr-defined]
        return Fault(self._path, scopes.name, kind, whole, before, after, self._counts[key], line, *at, place)


def _name(node: ast.expr) -> str:
    return node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else ""


def _is_text(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def _is_log(node: ast.stmt) -> bool:
    if not (isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)):
        return False
    call = node.value.func
    return isinstance(call, ast.Attribute) and call.attr in {*LOG_METHODS, "warn"} and _name(call.value) in LOGS


def _sets_all(node: ast.stmt) -> bool:
    return isinstance(node, ast.Assign) and any(_name(target) == "__all__" for target in node.targets)


def _is_type_checking(test: ast.expr) -> bool:
    names = {_name(node) for node in ast.walk(test) if isinstance(node, ast.Name | ast.Attribute)}
    return bool(names & {"TYPE_CHECKING", "__name__"})


def _narrows(test: ast.expr) -> bool:
    """Whether an assertion only tells a type to a checker of types."""
    if isinstance(test, ast.BoolOp):
        return all(map(_narrows, test.values))
    if isinstance(test, ast.Compare):
        return isinstance(test.ops[0], ast.IsNot | ast.Is) and isinstance(test.comparators[0], ast.Constant)
    return isinstance(test, ast.Call) and _name(test.func) in {"isinstance", "callable"}


def _can_be_dropped(node: ast.stmt) -> bool:
    if isinstance(node, ast.Expr):
        return not isinstance(node.value, ast.Yield | ast.YieldFrom)
    return isinstance(node, ast.Assign | ast.AugAssign) or (isinstance(node, ast.AnnAssign) and node.value is not None)


def _jumps(node: ast.stmt) -> bool:
    return isinstance(node, ast.Raise | ast.Return | ast.Continue | ast.Break)


def _is_string(node: ast.expr) -> bool:
    if isinstance(node, ast.BinOp):
        return _is_string(node.left) or _is_string(node.right)
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str | bytes))


def _is_help(node: ast.Call) -> bool:
    return _name(node.func) in HELP


# ---------------------------------------------------------------- the choice


def count_code_lines(text: bytes) -> int:
    """The lines of a module that are neither blank nor comments nor docstrings."""
    lines: set[int] = set()
    for token in tokenize.tokenize(io.BytesIO(text).readline):
        if token.type not in _NO_CODE:
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.stmt) and _is_text(node):
            lines.difference_update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return len(lines)


_NO_CODE = {
    tokenize.ENCODING,
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}


def divide(sizes: Mapping[str, int], count: int) -> dict[str, int]:
    """Divide `count` among the packages by their sizes, the rest to the largest remainders."""
    whole = sum(sizes.values())
    shares = {name: count * size // whole for name, size in sizes.items()}
    by_remainder = sorted(sizes, key=lambda name: (-(count * sizes[name] % whole), name))
    for name in by_remainder[: count - sum(shares.values())]:
        shares[name] += 1
    return shares


def choose(sources: Mapping[str, bytes], count: int, seed: int) -> list[Fault]:
    """Choose `count` faults: spread over the packages by lines of code, balanced over kinds, two in no statement."""
    chance = random.Random(seed)  # noqa: S311
    sizes: Counter[str] = Counter()
    pools: dict[tuple[str, str], list[Fault]] = defaultdict(list)
    for path, text in sorted(sources.items()):
        for fault in find_faults(path, text):
            pools[fault.package, fault.kind].append(fault)
        parts = path.removeprefix(f"{PACKAGE}/").split("/")
        sizes[parts[0] if len(parts) > 1 else "skyrange"] += count_code_lines(text)
    for key in sorted(pools):
        chance.shuffle(pools[key])
    kinds = [KINDS[number % len(KINDS)] for number in range(count)]
    chance.shuffle(kinds)
    chosen: list[Fault] = []
    taken: set[tuple[str, Place]] = set()
    for package, share in sorted(divide(sizes, count).items()):
        for _ in range(share):
            kind = kinds.pop()
            for other in (kind, *(name for name in KINDS if name != kind)):
                drawn = _draw(pools[package, other], taken, sources)
                if drawn is not None:
                    chosen.append(drawn)
                    break
    return chosen


def _draw(pool: list[Fault], taken: set[tuple[str, Place]], sources: Mapping[str, bytes]) -> Fault | None:
    while pool:
        fault = pool.pop()
        statement = (fault.path, fault.place)
        if statement not in taken and is_fault(fault, sources[fault.path]):
            taken.add(statement)
            return fault
    return None
