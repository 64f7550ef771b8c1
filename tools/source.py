"""Places where code of the package is executed: functions, classes and constants, and the lines that refer to them.

What coverage.py does not see is found through references by name: compiled functions through the functions and tests
that call them, and what an import executes through the lines that use the class or the constant.
"""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from tools.contexts import ROOT, Contexts

PACKAGE = "src/skyrange"
TESTS = "tests"
COMPILERS = {"compiled", "inlined"}
CACHES = {"cache", "lru_cache"}

Function = ast.FunctionDef | ast.AsyncFunctionDef
Symbol = tuple[str, str]
"""A file, and a name that its module defines."""


@dataclass(frozen=True)
class Place:
    """Where some code is executed: in the body of a function, or by the import of its module.

    `symbols` are the names to look for if no test executes the lines by itself: the compiled function that contains
    them, the function whose results are cached, or the class or the constants that an import makes. In a test file,
    whose lines are not traced, they name the function.
    """

    path: str
    first: int
    last: int
    kind: str
    symbols: tuple[str, ...] = ()
    bodies: tuple[tuple[int, int], ...] = ()
    """The first and the last line of functions: of a class, or the one whose default values these are."""


class Scopes:
    """The names of enclosing classes and functions while a tree is walked."""

    def __init__(self, stack: tuple[ast.AST, ...] = ()) -> None:
        self.stack = stack

    def inside(self, node: ast.AST) -> Scopes:
        """The scopes of what is in the body of `node`."""
        return Scopes((*self.stack, node))

    @property
    def name(self) -> str:
        """The qualified name of the innermost function or class; "" in a module."""
        return ".".join(node.name for node in self.stack if isinstance(node, Function | ast.ClassDef))

    @property
    def compiled(self) -> str:
        """The name of the compiled function around; "" if there is none."""
        return next((node.name for node in self.stack if isinstance(node, Function) and _marked(node, COMPILERS)), "")

    def place(self, path: str, statement: ast.stmt, node: ast.AST | None = None) -> Place:
        """Where `node` of `statement` is executed; `statement` itself if not given."""
        first, last = lines_of(statement) if node is None else _span(node)
        functions = [scope for scope in self.stack if isinstance(scope, Function | ast.Lambda)]
        if _is_test(path):
            outer = next((scope for scope in (*self.stack, statement) if isinstance(scope, Function)), None)
            if outer is not None:
                return Place(path, first, last, "test", (outer.name,))
        if self.compiled:
            return Place(path, first, last, "compiled", (self.compiled,))
        if functions:
            inner = functions[-1]
            cached = isinstance(inner, Function) and _marked(inner, CACHES)
            names = (inner.name,) if isinstance(inner, Function) and cached and len(self.stack) == 1 else ()
            return Place(path, first, last, "function", names)
        if isinstance(statement, Function):
            if _marked(statement, COMPILERS):
                return Place(path, first, last, "compiled", (statement.name,))
            return Place(path, first, last, "import", (), (_body(statement),))
        classes = [scope for scope in (*self.stack, statement) if isinstance(scope, ast.ClassDef)]
        if classes:
            bodies = tuple(_body(inner) for inner in ast.walk(classes[0]) if isinstance(inner, Function))
            return Place(path, first, last, "import", (classes[0].name,), bodies)
        return Place(path, first, last, "import", tuple(_assigned(statement)))


def _marked(function: Function, marks: set[str]) -> bool:
    for mark in function.decorator_list:
        target = mark.func if isinstance(mark, ast.Call) else mark
        if (isinstance(target, ast.Name) and target.id in marks) or (
            isinstance(target, ast.Attribute) and target.attr in marks
        ):
            return True
    return False


def _span(node: ast.AST) -> tuple[int, int]:
    first: int = getattr(node, "lineno", 0)
    return first, getattr(node, "end_lineno", None) or first


def _body(function: Function) -> tuple[int, int]:
    return function.body[0].lineno, function.end_lineno or function.lineno


def lines_of(statement: ast.stmt) -> tuple[int, int]:
    """The first and the last line of a statement, without those of the statements in it."""
    first, last = _span(statement)
    inner: list[ast.AST] = [
        *getattr(statement, "body", []),
        *getattr(statement, "cases", []),
    ]
    return first, max(first, min([last, *(_first(node) - 1 for node in inner)]))


def _first(node: ast.AST) -> int:
    return _span(node.pattern if isinstance(node, ast.match_case) else node)[0]


def _assigned(statement: ast.stmt) -> Iterator[str]:
    for node in ast.walk(statement):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id


def _is_test(path: str) -> bool:
    return path.startswith(f"{TESTS}/")


def module_of(path: str) -> str:
    """The name of the module in a file below `src`, or in a test file."""
    parts = Path(path).with_suffix("").parts[0 if _is_test(path) else 1 :]
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def read_sources(root: Path = ROOT, package: str = PACKAGE) -> dict[str, bytes]:
    """The text of each module of the package, by its path relative to `root`."""
    return {str(path.relative_to(root)): path.read_bytes() for path in sorted((root / package).rglob("*.py"))}


def find_places(path: str, text: bytes, lines: Iterable[int]) -> list[Place]:
    """The places of the statements that have any of these lines, without those of the statements in them."""
    wanted = set(lines)
    places = []

    def walk(node: ast.AST, scopes: Scopes) -> None:
        if isinstance(node, ast.stmt):
            first, last = lines_of(node)
            if wanted.intersection(range(first, last + 1)):
                places.append(scopes.place(path, node))
        inside = scopes.inside(node) if isinstance(node, Function | ast.ClassDef) else scopes
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.stmt | ast.excepthandler | ast.match_case):
                walk(child, inside)

    walk(ast.parse(text), Scopes())
    return places


class References:
    """The places that refer to each name of each module, and the functions of each module.

    With the test files among `sources` it also finds the tests that refer to a name themselves.
    """

    def __init__(self, sources: Mapping[str, bytes]) -> None:
        self._paths = {module_of(path): path for path in sources}
        self._imports: dict[str, dict[str, Symbol]] = {}
        self._places: dict[Symbol, list[Place]] = defaultdict(list)
        self._functions: dict[str, list[tuple[int, int]]] = defaultdict(list)
        trees = {path: ast.parse(text) for path, text in sources.items()}
        for path, tree in trees.items():
            self._imports[path] = dict(self._read_imports(path, tree))
        for path, tree in trees.items():
            self._walk(path, tree, Scopes())

    def _read_imports(self, path: str, tree: ast.Module) -> Iterator[tuple[str, Symbol]]:
        package = module_of(path) if path.endswith("__init__.py") else module_of(path).rpartition(".")[0]
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom):
                parents = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
                source = ".".join([*parents, *([node.module] if node.module else [])])
                for alias in node.names:
                    if (inner := self._paths.get(f"{source}.{alias.name}")) is not None:
                        yield alias.asname or alias.name, (inner, "")
                    elif source in self._paths:
                        yield alias.asname or alias.name, (self._paths[source], alias.name)
            elif isinstance(node, ast.Import):
                for alias in node.names:
                    if alias.asname and alias.name in self._paths:
                        yield alias.asname, (self._paths[alias.name], "")

    def _walk(self, path: str, node: ast.AST, scopes: Scopes, statement: ast.stmt | None = None) -> None:
        if isinstance(node, ast.stmt):
            statement = node
        if isinstance(node, Function):
            self._functions[path].append(_body(node))
        symbol = self._symbol(path, node)
        if symbol is not None and statement is not None:
            self._places[symbol].append(scopes.place(path, statement))
        for field, value in ast.iter_fields(node):
            nested = isinstance(node, Function | ast.ClassDef | ast.Lambda) and field == "body"
            inside = scopes.inside(node) if nested else scopes
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    self._walk(path, child, inside, statement)

    def _symbol(self, path: str, node: ast.AST) -> Symbol | None:
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load):
            return self._resolve(path, node.id)
        if isinstance(node, ast.arg) and _is_test(path):  # it may be a fixture
            return self._resolve(path, node.arg)
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            module = self._imports[path].get(node.value.id)
            if module is not None and module[1] == "":
                return self._resolve(module[0], node.attr)
        return None

    def _resolve(self, path: str, name: str) -> Symbol | None:
        """The module that defines a name which `path` defines, imports or offers again."""
        followed = set()
        while (path, name) not in followed:
            followed.add((path, name))
            if name not in self._imports[path]:
                return path, name
            path, name = self._imports[path][name]
        return None

    def places(self, path: str, name: str) -> list[Place]:
        """The places that refer to a name of the module at `path`."""
        return self._places.get((path, name), [])

    def tests_at(self, place: Place, contexts: Contexts, visited: set[Symbol] | None = None) -> set[int]:
        """The tests that execute a place, by the record or through what refers to it."""
        visited = set() if visited is None else visited
        tests: set[int] = set()
        if place.kind == "test":
            tests |= contexts.named(place.path, place.symbols[0])
        if place.kind == "function":
            tests |= contexts.executed(place.path, range(place.first, place.last + 1))
        for first, last in place.bodies:
            tests |= contexts.executed(place.path, range(first, last + 1))
        for name in place.symbols:
            if (place.path, name) not in visited:
                visited.add((place.path, name))
                for other in self.places(place.path, name):
                    tests |= self.tests_at(other, contexts, visited)
        if place.kind == "import" and not tests:
            for first, last in self._functions[place.path]:
                tests |= contexts.executed(place.path, range(first, last + 1))
        return tests
