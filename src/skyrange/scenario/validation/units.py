"""Hints about units: for a key without its suffix, a value in another unit, or a number in quotes."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable

UNIT_NAMES = {
    "m": "metres",
    "mps": "m/s",
    "s": "seconds",
    "ms": "milliseconds",
    "deg": "degrees",
    "hz": "Hz",
    "bps": "bit/s",
    "bytes": "bytes",
}
"""Unit suffixes of the keys of a scenario."""

_TO_OURS = {
    ("ft", "m"): 0.3048,
    ("feet", "m"): 0.3048,
    ("km", "m"): 1000.0,
    ("cm", "m"): 0.01,
    ("mm", "m"): 0.001,
    ("mi", "m"): 1609.344,
    ("kmh", "mps"): 1 / 3.6,
    ("kph", "mps"): 1 / 3.6,
    ("kts", "mps"): 1852 / 3600,
    ("kt", "mps"): 1852 / 3600,
    ("knots", "mps"): 1852 / 3600,
    ("mph", "mps"): 0.44704,
    ("ms", "s"): 1e-3,
    ("us", "s"): 1e-6,
    ("ns", "s"): 1e-9,
    ("min", "s"): 60.0,
    ("h", "s"): 3600.0,
    ("s", "ms"): 1e3,
    ("us", "ms"): 1e-3,
    ("ns", "ms"): 1e-6,
    ("rad", "deg"): 180 / math.pi,
    ("kbps", "bps"): 1e3,
    ("mbps", "bps"): 1e6,
    ("khz", "hz"): 1e3,
    ("kb", "bytes"): 1e3,
}
"""Exact factors of the international foot, statute and nautical mile (1959 agreement; BIPM SI brochure, table 8)."""

_SUFFIXES = sorted({*UNIT_NAMES, *(unit for unit, _ in _TO_OURS)}, key=len, reverse=True)
_QUANTITY = re.compile(r"^\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*([A-Za-z/°]*)\s*$")
_SPELLINGS = {"m/s": "mps", "km/h": "kmh", "°": "deg", "sec": "s", "metres": "m", "meters": "m", "foot": "ft"}


def split_unit(key: str) -> tuple[str, str]:
    """A key's stem and unit suffix, "" if it has none: `alt_m` is ("alt", "m")."""
    stem, _, last = key.rpartition("_")
    return (stem, last.lower()) if stem and last.lower() in _SUFFIXES else (key, "")


def suggest_key(key: str, value: object, known: Iterable[str]) -> tuple[str, str] | None:
    """The known key that differs from `key` only in the unit, and a hint that converts `value`; None without one."""
    stem, unit = split_unit(key)
    for candidate in known:
        other_stem, other_unit = split_unit(candidate)
        if candidate != key and other_unit and stem.lower() == other_stem.lower():
            return candidate, _as(value, unit, candidate, other_unit)
    return None


def suggest_number(text: str, key: str) -> str:
    """A hint for a number in quotes at `key`; "" if the text is not a number."""
    match = _QUANTITY.match(text)
    if match is None:
        return ""
    number, unit = float(match[1]), _SPELLINGS.get(match[2].lower(), match[2].lower())
    ours = split_unit(key)[1]
    if not unit or unit == ours:
        return f"Write {key} = {match[1]}" + (
            f" without quotes, in {UNIT_NAMES[ours]}." if ours else " without quotes."
        )
    if not ours:
        return "Write a number without quotes and without a unit."
    return _as(number, unit, key, ours)


def _as(value: object, unit: str, key: str, ours: str) -> str:
    factor = _TO_OURS.get((unit, ours))
    if unit == "" or unit == ours:
        factor = 1.0 if unit else None
    if factor is not None and isinstance(value, (int, float)) and not isinstance(value, bool):
        return f"Write {key} = {value * factor:.10g}, in {UNIT_NAMES[ours]}."
    return f"Write {key}, in {UNIT_NAMES[ours]}."
