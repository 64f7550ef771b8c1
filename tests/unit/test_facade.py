"""The public modules: what they export is there, typed where it stands, and imported on first use."""

from __future__ import annotations

import ast
import importlib
import inspect
import subprocess
import sys
from pathlib import Path

import pytest

from skyrange.core.lazy_exports import exports_of
from tests.unit.test_startup import HEAVY

FACADE = ("skyrange", "skyrange.scenario", "skyrange.plugin", "skyrange.analysis", "skyrange.env", "skyrange.testing")


@pytest.mark.parametrize("name", FACADE)
def test_what_is_listed_is_exported_and_nothing_else(name: str) -> None:
    module = importlib.import_module(name)
    public = [one for one in module.__all__ if not one.startswith("_")]
    assert sorted(exports_of(name)) == sorted(public)
    assert dir(module) == sorted(module.__all__)
    for one in public:
        home, original = exports_of(name)[one]
        assert getattr(module, one) is getattr(importlib.import_module(home), original)
    with pytest.raises(AttributeError, match=f"module '{name}' has no attribute 'nothing'"):
        _ = module.nothing


def test_no_module_is_exported_by_mistake() -> None:
    """A function and its module may have one name; pymavlink's dialect is a module by intention."""
    found = {(name, one) for name in FACADE for one in exports_of(name)}
    modules = {one for name, one in found if inspect.ismodule(getattr(importlib.import_module(name), one))}
    assert modules == {"mavlink"}


@pytest.mark.parametrize("name", FACADE)
def test_nothing_heavy_is_imported_before_it_is_used(name: str) -> None:
    code = f"import {name}\nimport sys\nprint([m for m in {HEAVY!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("name", FACADE)
def test_a_type_checker_sees_each_name_and_no_getattr(name: str) -> None:
    """Under TYPE_CHECKING all is imported by name, and no `__getattr__` makes an Any of what is not there."""
    module = importlib.import_module(name)
    assert module.__file__ is not None
    tree = ast.parse(Path(module.__file__).read_text(encoding="utf-8"))
    assert not [node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == "__getattr__"]
    conditions = [ast.unparse(node.test) for node in tree.body if isinstance(node, ast.If)]
    assert conditions == ["TYPE_CHECKING", "not TYPE_CHECKING"]


def layers_of(name: str) -> dict[str, int]:
    """By package below skyrange, the layer on which it stands, counted from the lowest one."""
    import tomllib

    rules = tomllib.loads(Path("pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]["contracts"]
    lines = next(rule["layers"] for rule in rules if rule["name"].startswith(name))
    return {one.strip(): number for number, line in enumerate(reversed(lines)) for one in line.split("|")}


def uses_of(module: Path) -> set[str]:
    """The names that a module takes from `skyrange.plugin`, which it imports as `sky`."""
    tree = ast.walk(ast.parse(module.read_text(encoding="utf-8")))
    return {
        node.attr
        for node in tree
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "sky"
    }


def test_what_kinds_take_from_the_facade_stands_on_no_higher_layer() -> None:
    """The rules of imports do not see these: the facade stands low, because it imports what is asked for alone."""
    layers, exports = layers_of("Layers"), exports_of("skyrange.plugin")
    source = Path("src/skyrange")
    users = [file for file in source.rglob("*.py") if "import skyrange.plugin as sky" in file.read_text("utf-8")]
    assert len(users) > 100
    wrong = []
    for file in users:
        own = layers[file.relative_to(source).parts[0]]
        for name in uses_of(file):
            home = exports[name][0].split(".")[1]
            if layers[home] > own or (layers[home] == own and home != file.relative_to(source).parts[0]):
                wrong.append(f"{file}: {name} of {home}")
    assert not wrong


@pytest.mark.parametrize("name", FACADE)
def test_exports_are_read_as_python_reads_them(name: str) -> None:
    module = importlib.import_module(name)
    assert module.__file__ is not None
    blocks = [node for node in ast.parse(Path(module.__file__).read_text("utf-8")).body if isinstance(node, ast.If)]
    imports = [line for line in blocks[0].body if isinstance(line, ast.ImportFrom)]
    expected = {alias.asname or alias.name: (line.module, alias.name) for line in imports for alias in line.names}
    assert len(imports) == len(blocks[0].body)
    assert exports_of(name) == expected


def test_the_facade_is_what_the_docs_say() -> None:
    from tools.docs import api_reference

    assert api_reference.FACADE == FACADE
