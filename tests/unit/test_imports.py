"""Imports of skyrange in tests and in the scripts of the docs: each names a module, or what a module has.

Tests that need other programs are skipped where these are absent, and their functions import what they need when they
run: without this, a module that moves would break them unseen.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

ROOT = Path(__file__).parents[2]


def imported_names(source: str) -> Iterator[tuple[str, str]]:
    """The modules of skyrange that a source imports, and the names from them, "" for the module itself."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from ((name.name, "") for name in node.names if name.name.split(".")[0] == "skyrange")
        elif isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "skyrange":
            yield from ((node.module, name.name) for name in node.names)


def is_there(module: str, name: str) -> bool:
    """Whether a module has a name, as an attribute or as a module in it."""
    try:
        found = import_module(module)
        return not name or hasattr(found, name) or bool(import_module(f"{module}.{name}"))
    except ModuleNotFoundError as error:
        if not (error.name or "").startswith("skyrange"):
            raise
        return False


def test_what_tests_and_scripts_import_is_there() -> None:
    files = [path for folder in ("tests", "docs") for path in sorted((ROOT / folder).rglob("*.py"))]
    named = {(*pair, path.relative_to(ROOT).as_posix()) for path in files for pair in imported_names(path.read_text())}
    known: dict[tuple[str, str], bool] = {}
    missing = []
    for module, name, path in sorted(named):
        pair = module, name
        if pair not in known:
            known[pair] = is_there(module, name)
        if not known[pair]:
            missing.append(f"{path}: {module} {name}".rstrip())
    assert not missing
    assert len(known) > 500


def test_a_module_that_moved_is_missed() -> None:
    source = "def f():\n    from skyrange.record.write import derivation, recorder\n    import skyrange.gone\n"
    assert [pair for pair in imported_names(source) if not is_there(*pair)] == [
        ("skyrange.record.write", "derivation"), ("skyrange.gone", ""),
    ]  # fmt: skip
