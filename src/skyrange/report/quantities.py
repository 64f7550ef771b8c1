"""Quantities as text: numbers with units, counts, durations, sizes, and missing values."""

from __future__ import annotations

import json
import math
from typing import Any, Final, NamedTuple

Quantity = tuple[tuple[str, str], ...]
"""Pairs of number and unit ("" for none), in the order written: `(("3", "min"), ("05", "s"))`."""

MISSING: Final[Quantity] = ()
"""A missing quantity, shown as a dash."""


class Linked(NamedTuple):
    """A text or a quantity that leads somewhere, such as to its moment in the viewer."""

    shown: str | Quantity
    href: str


Shown = str | Quantity | Linked


def count(value: int | float) -> str:
    """A whole number with thin spaces between thousands, such as 12 345."""
    return f"{int(value):,}".replace(",", "\u202f")


def quantity(value: float | None, unit: str, decimals: int = 1) -> Quantity:
    """A number with its unit; missing if it is `None` or not finite."""
    if value is None or not math.isfinite(value):
        return MISSING
    return ((f"{value:,.{decimals}f}".replace(",", "\u202f"), unit),)


def signed(value: float | None, unit: str, decimals: int) -> Quantity:
    """A difference with its sign and unit; zero is written without a sign."""
    if value is None:
        return MISSING
    text = f"{value:+.{decimals}f}"
    if float(text) == 0.0:
        text = text[1:]
    return ((text.replace("-", "−"), unit),)


def duration(seconds: float | None) -> Quantity:
    """A duration, such as 8.2 s, 3 min 05 s or 1 h 02 min."""
    if seconds is None or not math.isfinite(seconds):
        return MISSING
    if seconds < 100:
        return quantity(seconds, "s")
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return (str(minutes), "min"), (f"{rest:02d}", "s")
    return (str(minutes // 60), "h"), (f"{minutes % 60:02d}", "min")


def size(octets: float) -> Quantity:
    """A number of bytes with a decimal prefix."""
    for unit, scale in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if octets >= scale:
            return quantity(octets / scale, unit, 1 if octets >= 10 * scale else 2)
    return quantity(octets, "B", 0)


def latency(seconds: float) -> Quantity:
    """A latency in µs below 1 ms, in ms above."""
    if not math.isfinite(seconds):
        return MISSING
    return quantity(seconds * 1e6, "µs", 0) if seconds < 1e-3 else quantity(seconds * 1e3, "ms", 1)


def scalar(value: Any) -> str:
    """A value of an event's data as text: a float with six digits, a string unchanged, anything else as JSON."""
    if isinstance(value, float):
        return f"{value:.6g}"
    return value if isinstance(value, str) else json.dumps(value, default=str)
