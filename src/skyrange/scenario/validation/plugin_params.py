"""Parameters of plugins in a scenario: their validation by the plugin's model, and their JSON Schema."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import AfterValidator, ValidationError

from skyrange.contracts.params import Params, refuse
from skyrange.contracts.plugins.registry import Plugin, find, is_known, kinds
from skyrange.core.errors import InputError, Problem, nearest
from skyrange.scenario.model.base import wrong
from skyrange.scenario.validation.error_messages import explain_errors


def known(group: str, what: str) -> AfterValidator:
    """A validator that a kind belongs to a plugin group; `what` names the kind in the error."""

    def check(kind: str) -> str:
        if not is_known(group, kind):
            raise wrong(kind, f"{what} that is installed", nearest(kind, kinds(group)))
        return kind

    return AfterValidator(check)


def params_of(plugin: Plugin[Any, Any], given: Mapping[str, Any], where: str = "") -> Params:
    """`given` as the parameters of a plugin. Raises InputError with every problem, at and below `where`."""
    try:
        return plugin.params.model_validate(given)
    except ValidationError as error:
        prefix = f"{where}." if where else ""
        explained = explain_errors(error, plugin.params, given)
        problems = [Problem(f"{prefix}{f.where}", f.value, f.expected, f.hint) for f in explained]
        raise InputError("scenario", problems) from None


def checked(plugin: Plugin[Any, Any], given: Mapping[str, Any], where: str = "") -> Params:
    """As `params_of`, for validators of a model: raises pydantic's error type."""
    try:
        return params_of(plugin, given, where)
    except InputError as error:
        raise refuse(*error.problems) from None


def normalized(plugin: Plugin[Any, Any], given: Mapping[str, Any], where: str = "") -> dict[str, Any]:
    """`given` completed with the defaults of the plugin's parameters, as plain data. Raises as `checked`."""
    return checked(plugin, given, where).model_dump(exclude_none=True)


def describe_by_kind(schema: dict[str, Any], table: dict[str, Any], group: str, selector: str = "kind") -> None:
    """Describe `params` of `table` in a JSON Schema, for each plugin of `group` that its key `selector` can name."""
    table["properties"][selector]["examples"] = list(kinds(group))
    table["allOf"] = [
        {
            "if": {"properties": {selector: {"const": kind}}, "required": [selector]},
            "then": {"properties": {"params": describe(schema, group, kind)}},
        }
        for kind in kinds(group)
    ]


def describe(schema: dict[str, Any], group: str, kind: str) -> dict[str, Any]:
    """Add the parameters of a plugin to the definitions of a JSON Schema, and return a reference to them."""
    name = definition_of(group, kind)
    params = find(group, kind).params.model_json_schema(mode="validation", ref_template=f"#/$defs/{name}.{{model}}")
    schema["$defs"].update({f"{name}.{below}": model for below, model in params.pop("$defs", {}).items()})
    schema["$defs"][name] = params
    return {"$ref": f"#/$defs/{name}"}


def definition_of(group: str, kind: str) -> str:
    """The name of a plugin's parameters in the definitions of a JSON Schema: `attacks.remote_id.spoof`."""
    return f"{group.rpartition('.')[2]}.{kind}"
