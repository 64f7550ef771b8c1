"""Lazy exports of a public module: its names are imported on first use, so that importing it stays quick.

Such a module imports what it exports under `if TYPE_CHECKING:`, where type checkers and editors read it, and this reads
the same lines when a name is asked for. So each name stands in one place (as with stub files in `lazy_loader`).
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import cache
from typing import Any


def export_lazily(module: str) -> Callable[[str], Any]:
    """The `__getattr__` of a module: imports the object that a name under its `if TYPE_CHECKING:` means, and keeps it.

    Raises AttributeError for any other name.
    """

    def get(name: str) -> Any:
        home = exports_of(module).get(name)
        if home is None:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        from importlib import import_module

        made = getattr(import_module(home[0]), home[1])
        setattr(sys.modules[module], name, made)
        return made

    return get


@cache
def exports_of(module: str) -> dict[str, tuple[str, str]]:
    """By exported name, the module that has the object and its name there, in the order in which they stand."""
    import ast
    from pathlib import Path

    file = sys.modules[module].__file__
    assert file is not None
    found: dict[str, tuple[str, str]] = {}
    for statement in ast.parse(Path(file).read_text(encoding="utf-8")).body:
        if isinstance(statement, ast.If) and ast.unparse(statement.test) == "TYPE_CHECKING":
            for line in statement.body:
                assert isinstance(line, ast.ImportFrom)
                assert line.module is not None
                found |= {alias.asname or alias.name: (line.module, alias.name) for alias in line.names}
    return found
