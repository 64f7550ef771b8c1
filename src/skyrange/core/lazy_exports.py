"""Lazy exports of a public module: its names are imported on first use, so that importing it stays quick.

Such a module passes a table of its names, by the module that has them. Type checkers and editors do not read it: they
read the same imports under `if TYPE_CHECKING:`, and a test holds the two equal.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from typing import Any

_EXPORTS: dict[str, dict[str, tuple[str, str]]] = {}


def export_lazily(module: str, names: Mapping[str, str]) -> Callable[[str], Any]:
    """The `__getattr__` of a module: imports the object that a name means, and keeps it.

    `names` has the exported names of each module, parted by blanks; `name=other` exports `name` as
    `other`. Raises AttributeError for any other name.
    """
    exports = _EXPORTS[module] = {}
    for home, several in names.items():
        for entry in several.split():
            name, _, alias = entry.partition("=")
            exports[alias or name] = (home, name)

    def get(name: str) -> Any:
        home = exports.get(name)
        if home is None:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        from importlib import import_module

        made = getattr(import_module(home[0]), home[1])
        setattr(sys.modules[module], name, made)
        return made

    return get


def exports_of(module: str) -> Mapping[str, tuple[str, str]]:
    """By exported name, the module that has the object and its name there, in the order in which they stand."""
    return _EXPORTS[module]
