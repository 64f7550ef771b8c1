"""Are the types that public functions return public too?"""

from __future__ import annotations

import importlib
import inspect
from typing import Any, get_args, get_type_hints

import pytest

from skyrange.record import RunRecord

MODULES = ("skyrange", "skyrange.scenario", "skyrange.plugin", "skyrange.analysis", "skyrange.env")
REMOTE_ID = {"Authentication", "OperatorId", "Reserved", "SelfId", "System"}
"""Messages, which docs/reference/remote-id-bytes.md describes."""


def public_objects() -> dict[str, Any]:
    return {
        f"{name}.{each}": getattr(importlib.import_module(name), each)
        for name in MODULES
        for each in importlib.import_module(name).__all__
    }


def classes_in(hint: Any) -> set[type]:
    """The project's own classes in a type."""
    found = {hint} if inspect.isclass(hint) and hint.__module__.startswith("skyrange.") else set()
    return found.union(*(classes_in(part) for part in get_args(hint)))


def returned(function: Any) -> set[type]:
    try:
        return classes_in(get_type_hints(function).get("return"))
    except NameError:  # a name of another package, for type checkers alone
        return set()


def test_what_public_functions_and_records_return_is_public() -> None:
    objects = public_objects()
    public = [each for each in objects.values() if inspect.isclass(each)]
    functions = {name: each for name, each in objects.items() if inspect.isfunction(each)}
    functions |= {f"RunRecord.{name}": each for name, each in vars(RunRecord).items() if inspect.isfunction(each)}
    assert len(functions) > 80
    private = {
        name: sorted(
            each.__name__ for each in returned(function) if each not in public and each.__name__ not in REMOTE_ID
        )
        for name, function in functions.items()
    }
    assert {name: each for name, each in private.items() if each} == {}


@pytest.mark.parametrize("name", ["skyrange.plugin.read_messages", "skyrange.analysis.replay_monitor"])
def test_the_check_sees_classes(name: str) -> None:
    assert returned(public_objects()[name])
