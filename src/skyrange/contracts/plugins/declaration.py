"""Declaration of kinds: what a decorator such as `attack` checks, makes and registers of a class."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from skyrange.contracts.plugins.form import Kind, describe_kind, make_params_model, place_of
from skyrange.contracts.plugins.homes import name_of_module
from skyrange.contracts.plugins.registry import Plugin, register
from skyrange.core.errors import InputError, nearest


@dataclass(frozen=True, slots=True)
class MakeKind:
    """Makes the parts of a kind: an instance with the parameters, assembled in a context."""

    kind: type[Kind]

    def __call__(self, params: Any, context: Any) -> Any:
        """The parts. Raises `InputError` for what does not fit the scenario."""
        return self.kind.of(params).assemble(context)


def declare(
    kind: type, name: str, base: type[Kind], plugin: Callable[..., Plugin[Any, Any]], facts: Mapping[str, Any]
) -> None:
    """Check a class, make the model of its parameters, and register `plugin(params, make, about, **facts)` as `name`.

    Raises `InputError` for a class without the base, a sentence that says what it does, methods that its base needs, or
    fields that a method reads (`fields.reads_fields`); for a name that is not the path of its module; and for
    parameters of which no model can be made.
    """
    where = place_of(kind)
    if not (isinstance(kind, type) and issubclass(kind, base)):
        raise InputError.one(
            where, "bases", ", ".join(one.__name__ for one in kind.__bases__), f"{base.__name__} or one of its bases"
        )
    about = describe_kind(kind) if "__doc__" in vars(kind) else ""
    if not about.endswith("."):
        raise InputError.one(where, "docstring", about or "missing", "a sentence that says what it does")
    for home in kind.__mro__:
        for method in vars(home).get("needs", ()):
            if getattr(kind, method, None) is vars(home).get(method):
                raise InputError.one(where, "methods", "missing", f"{method}, which every {home.__name__} defines")
    for method, made_for in vars(kind).items():
        for field in getattr(made_for, "field_names", ()):
            if not hasattr(kind, field):
                hint = nearest(field, kind.declared_params)
                raise InputError.one(where, method, field, "a parameter or other field of the kind", hint)
    expected = name_of_module(kind.__module__)
    if expected is not None and name != expected:
        raise InputError.one(where, "name", name, f"{expected!r}, the path of its module")
    kind.params_model = make_params_model(kind)
    made = plugin(kind.params_model, MakeKind(kind), about, source=where, **facts)
    register(made.group, name, made, at_home=expected is not None)
    kind.plugin = made


def plugin_of(kind: Any) -> Any:
    """The plugin of a class with a decorator, and a plugin as it is. Raises `InputError` for a class without one."""
    if isinstance(kind, type):
        found = vars(kind).get("plugin")
        if found is None:
            raise InputError.one(place_of(kind), "decorator", "missing", "a decorator with the name of the kind")
        return found
    return kind
