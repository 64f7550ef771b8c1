"""Scenarios as TOML text, with every value that a run used, so that the file alone repeats it.

A small emitter for this model's types; TOML v1.0.0 (toml.io/en/v1.0.0): basic strings, floats with a
point or exponent, offset date-times, tables and arrays of tables.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from skyrange.scenario.schema import Scenario

_ESCAPES = {"\b": "\\b", "\t": "\\t", "\n": "\\n", "\f": "\\f", "\r": "\\r", '"': '\\"', "\\": "\\\\"}


def to_toml(scenario: Scenario, files: Mapping[str, str] | None = None) -> str:
    """TOML text that `load_text` turns into a scenario equal to this one.

    `files` gives other names to files that the scenario names: those of copies beside the text.
    """
    data = scenario.data()
    for operator in data["operators"]:
        for key in ("params", "fleets"):
            if not operator[key]:  # of a scenario that is built they are in the vehicles
                del operator[key]
        for vehicle in operator["vehicles"]:
            _rename(vehicle["plan"], "file", files or {})
            if not vehicle["params"]:
                del vehicle["params"]
    for key in ("links", "attacks", "detectors", "approvals", "hosts"):
        if not data[key]:
            del data[key]
    if "radio" in data and not data["radio"]["params"]:
        del data["radio"]["params"]
    _rename(data.get("city", {}), "buildings", files or {})
    return "\n".join(_table(data, ())).strip("\n") + "\n"


def _rename(table: dict[str, Any], key: str, files: Mapping[str, str]) -> None:
    if key in table:
        table[key] = files.get(table[key], table[key])


def _table(table: Mapping[str, Any], path: tuple[str, ...]) -> list[str]:
    """A table's lines: its values, then its tables, then its arrays of tables."""
    lines = [f"{_key(name)} = {_value(value)}" for name, value in table.items() if not _is_section(value, path)]
    for name, value in table.items():
        here = (*path, name)
        if _is_section(value, path) and isinstance(value, dict):
            lines += ["", f"[{_dotted(here)}]", *_table(value, here)]
    for name, value in table.items():
        here = (*path, name)
        if _is_section(value, path) and isinstance(value, list):
            for element in value:
                lines += ["", f"[[{_dotted(here)}]]", *_table(element, here)]
    return lines


def _is_section(value: Any, path: tuple[str, ...]) -> bool:
    """Whether a value stands under a heading of its own: tables at the top, arrays of tables anywhere."""
    if isinstance(value, dict):
        return path == ()
    return isinstance(value, list) and bool(value) and all(isinstance(element, dict) for element in value)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return repr(value)  # shortest text that reads back equal; always with a point or an exponent
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, datetime):
        return value.astimezone(UTC).isoformat().replace("+00:00", "Z")
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(_value(element) for element in value)}]"
    if isinstance(value, dict):
        inside = ", ".join(f"{_key(name)} = {_value(element)}" for name, element in value.items())
        return f"{{ {inside} }}" if inside else "{}"
    raise TypeError(f"a scenario holds no {type(value).__name__}")


def _text(text: str) -> str:
    escaped = (
        _ESCAPES.get(char) or (f"\\u{ord(char):04X}" if ord(char) < 0x20 or ord(char) == 0x7F else char)
        for char in text
    )
    return f'"{"".join(escaped)}"'


def _key(name: str) -> str:
    bare = name and all(char.isascii() and (char.isalnum() or char in "-_") for char in name)
    return name if bare else _text(name)


def _dotted(path: tuple[str, ...]) -> str:
    return ".".join(_key(name) for name in path)
