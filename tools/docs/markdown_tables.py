"""Markdown tables of the generated parts of the reference: rows, and the keys of a JSON Schema."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any


def table(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A Markdown table; bars in cells are escaped."""
    lines = [f"| {' | '.join(heads)} |", f"|{'---|' * len(heads)}"]
    lines += [f"| {' | '.join(str(cell).replace('|', chr(92) + '|') for cell in row)} |" for row in rows]
    return "\n".join(lines) + "\n"


Row = tuple[str, ...]

KEY_HEADS = ("key", "type", "range", "default", "meaning")


def keys(model: Mapping[str, Any], fields: Mapping[str, Any]) -> str:
    """The keys of one model as a table."""
    return table(KEY_HEADS, key_rows(model, fields))


def key_rows(model: Mapping[str, Any], fields: Mapping[str, Any]) -> list[Row]:
    """The keys of one model as rows of a table."""
    required = set(model.get("required", ()))
    return [
        (f"`{key}`", _kind(value), _range(fields[key]), _filled(key, value, required), value.get("description", ""))
        for key, value in model["properties"].items()
    ]


def shared_rows(tables: Iterable[Sequence[Row]], least: int) -> list[Row]:
    """Rows that are the same in `least` tables or more, one for each first cell, in the order in which they come."""
    counts = Counter(row for rows in tables for row in rows)
    chosen: dict[str, Row] = {}
    for row, count in counts.items():
        if count >= least and count > counts.get(chosen.get(row[0], ()), 0):
            chosen[row[0]] = row
    return list(chosen.values())


def own_rows(heads: Sequence[str], rows: Sequence[Row], shared: Sequence[Row], where: str) -> str:
    """A table of the rows that are not `shared`, and a line that names the shared ones, which `where` links to."""
    own = [row for row in rows if row not in shared]
    others = [_name(row[0]) for row in rows if row in shared]
    named = f"{where}: {', '.join(others)}\n" if others else ""
    return "\n".join(part for part in (table(heads, own) if own else "", named) if part)


def _name(cell: str) -> str:
    """The name of a key or an option without its value; another text as it is."""
    return f"{cell.partition(' ')[0].rstrip('`')}`" if cell.startswith("`") else cell


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
