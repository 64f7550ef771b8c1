"""How are numbers and tables said on the page? With units, thin spaces, and a dash where there is none."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any

NONE = '<span class="none">–</span>'


def count(value: int | float) -> str:
    """12 345 with thin spaces."""
    return f"{int(value):,}".replace(",", "\u202f")


def quantity(value: float | None, unit: str, decimals: int = 1) -> str:
    """A number and its unit, or a dash."""
    if value is None or not math.isfinite(value):
        return NONE
    text = f"{value:,.{decimals}f}".replace(",", "\u202f")
    return f"{text}\u202f<small>{unit}</small>" if unit else text


def signed(value: float | None, unit: str, decimals: int) -> str:
    """A difference with its sign and unit, or a dash."""
    if value is None:
        return NONE
    text = f"{value:+.{decimals}f}"
    if float(text) == 0.0:
        text = text[1:]
    return f"{text.replace('-', '−')}\u202f<small>{unit}</small>" if unit else text.replace("-", "−")


def duration(seconds: float | None) -> str:
    """`8.2 s`, `3 min 05 s` or `1 h 02 min`."""
    if seconds is None or not math.isfinite(seconds):
        return NONE
    if seconds < 100:
        return quantity(seconds, "s")
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes}\u202f<small>min</small> {rest:02d}\u202f<small>s</small>"
    return f"{minutes // 60}\u202f<small>h</small> {minutes % 60:02d}\u202f<small>min</small>"


def size(octets: float) -> str:
    """Bytes with a decimal prefix."""
    for unit, scale in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if octets >= scale:
            return quantity(octets / scale, unit, 1 if octets >= 10 * scale else 2)
    return quantity(octets, "B", 0)


def latency(seconds: float) -> str:
    """A latency in µs or ms."""
    if not math.isfinite(seconds):
        return NONE
    return quantity(seconds * 1e6, "µs", 0) if seconds < 1e-3 else quantity(seconds * 1e3, "ms", 1)


def cells(*values: str) -> str:
    """Right-aligned table cells of ready HTML."""
    return "".join(f"<td class=num>{value}</td>" for value in values)


def table(caption: str, texts: Sequence[str], numbers: Sequence[str], rows: Iterable[str], css: str = "") -> str:
    """A scrolling table of ready rows: columns of `texts` first, then right-aligned columns of `numbers`."""
    head = "".join(f"<th scope=col>{name}</th>" for name in texts)
    head += "".join(f"<th scope=col class=num>{name}</th>" for name in numbers)
    return (
        f'<div class="scroll {css}"><table class="grid"><caption class="vh">{escape(caption)}</caption>'
        f"<thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table></div>"
    )


def named(index: int, vehicle: str) -> str:
    """An aircraft's id after a swatch of its colour."""
    return f'<span class="swatch ink-{index}"></span>{escape(vehicle)}'


def nothing(sentence: str) -> str:
    """What stands where there is nothing to show."""
    return f'<p class="nothing">{escape(sentence)}</p>'


def details(data: Mapping[str, Any]) -> str:
    """Key–value pairs as escaped HTML, in the record's order."""
    return " ".join(
        f'<span class="kv"><span>{escape(str(key))}</span> {escape(_scalar(value))}</span>'
        for key, value in data.items()
    )


def _scalar(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    return value if isinstance(value, str) else json.dumps(value, default=str)
