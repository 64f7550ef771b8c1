"""Lazy exports of a public module: its names are imported on first use, so that importing it stays quick.

Such a module imports what it exports under `if TYPE_CHECKING:`, where type checkers and editors read it, and this reads
the same lines when a name is asked for. So each name stands in one place (as with stub files in `lazy_loader`).
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from functools import cache
from typing import Any, Final

_BLOCK: Final = re.compile(r"^if TYPE_CHECKING:\n((?:(?: .*)?\n)+)", re.MULTILINE)
_IMPORT: Final = re.compile(r"^ +from (\S+) import (?:\(([^)]*)\)|(.+))$", re.MULTILINE)


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
    from pathlib import Path

    file = sys.modules[module].__file__
    assert file is not None
    text = Path(file).read_text(encoding="utf-8")
    found: dict[str, tuple[str, str]] = {}
    for block in _BLOCK.findall(text):  # not by `ast`: that took 10 ms of each command that uses such a module
        for home, several, one in _IMPORT.findall(block):
            for entry in filter(None, (name.strip() for name in (several or one).split(","))):
                name, _, alias = entry.partition(" as ")
                found[alias or name] = (home, name)
    return found
