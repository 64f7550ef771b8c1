"""Markdown tables of the generated parts of the reference: rows, and the keys of a JSON Schema."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any


def table(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A Markdown table; bars in cells are escaped."""
    lines = [f"| {' | '.join(heads)} |", f"|{'---|' * len(heads)}"]
    lines += [f"| {' | '.join(str(cell).replace('|', chr(92) + '|') for cell in row)} |" for row in rows]
    return "\n".join(lines) + "\n"


def keys(model: Mapping[str, Any], fields: Mapping[str, Any]) -> str:
    """The keys of one model as a table."""
    required = set(model.get("required", ()))
    rows = [
        (f"`{key}`", _kind(value), _range(fields[key]), _filled(key, value, required), value.get("description", ""))
        for key, value in model["properties"].items()
    ]
    return table(("key", "type", "range", "default", "meaning"), rows)


def _choices(value: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The alternatives of a value but for null."""
    return [choice for choice in value.get("anyOf", [value]) if choice.get("type") != "null"]


def _kind(value: Mapping[str, Any]) -> str:
    return " or ".join(dict.fromkeys(_one_kind(one) for one in _choices(value)))


def _one_kind(value: Mapping[str, Any]) -> str:
    if "$ref" in value:
        return "table"
    if "enum" in value:
        return " or ".join(f'"{one}"' for one in value["enum"])
    kind = value.get("type")
    if kind == "array":
        below = value.get("items") or {}
        if "$ref" in below:
            return "array of tables"
        if "enum" in below or below.get("type") == "string":
            return "list of texts"
        if below.get("type") == "array":
            return "list of lists of numbers"
        return "list of values" if "items" in value and not below else "list of numbers"
    if kind == "string":
        return "date and time" if value.get("format") == "date-time" else "text"
    return {"number": "number", "integer": "whole number", "object": "table", "boolean": "true or false"}[str(kind)]


def _range(field: Any) -> str:
    """A field's bounds; those of a list's elements where only they have some."""
    bounds = _bounds(field.metadata)
    if not bounds:
        elements = [part for part in getattr(field.annotation, "__args__", ()) if hasattr(part, "__metadata__")]
        inner = [each for part in elements for data in part.__metadata__ for each in getattr(data, "metadata", ())]
        bounds = list(dict.fromkeys(_bounds(inner)))
    return " ".join(bounds)


def _bounds(metadata: Iterable[Any]) -> list[str]:
    words = (("gt", "above"), ("ge", "from"), ("lt", "below"), ("le", "to"), ("pattern", ""))
    return [
        _bound(word, getattr(constraint, key))
        for constraint in metadata
        for key, word in words
        if hasattr(constraint, key)
    ]


def _bound(word: str, value: object) -> str:
    return f"{word} {value}" if word else f"`{value}`"


def _filled(key: str, value: Mapping[str, Any], required: set[str]) -> str:
    if key in required:
        return "required"
    default = value.get("default")
    if default is None or default in ({}, []):
        return ""
    return f'"{default}"' if isinstance(default, str) else str(default)
