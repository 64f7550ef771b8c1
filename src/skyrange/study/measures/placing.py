"""Places that `placing = "clear"` moved, in words."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any


def describe_placing(moves: Iterable[Mapping[str, Any]]) -> list[str]:
    """A line for each row of the manifest's `placing`: aircraft that are nearer to another one than declared first,
    the nearest first, then by how far they were moved.
    """
    return [_line(row) for row in sorted(moves, key=_urgency)]


def _urgency(row: Mapping[str, Any]) -> tuple[bool, float, float]:
    near = _is_nearer(row)
    return not near, row["nearest_m"] if near else 0.0, -row["moved_m"]


def _is_nearer(row: Mapping[str, Any]) -> bool:
    return "nearest_m" in row and bool(row["nearest_m"] < row["declared_m"])


def _line(row: Mapping[str, Any]) -> str:
    text = f"{row.get('vehicle') or row['receiver']} moved by {row['moved_m']:.0f} m"
    if _is_nearer(row):
        text += f", now {row['nearest_m']:.0f} m from {row['nearest']} (declared: {row['declared_m']:.0f} m)"
    if "protected_m" in row:
        text += f", within the {row['protected_m']:g} m that avoidance keeps"
    return text
