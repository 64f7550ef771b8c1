"""How is a drawing written as SVG? Numbers, ticks, paths and text, with nothing that a viewer must fetch."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

POINTS = 24_000
"""Samples that one figure draws at most, shared evenly by its aircraft."""

GRID = 'stroke="currentColor" stroke-opacity=".16" fill="none"'
"""The attributes of grid lines."""

FONT = "system-ui,-apple-system,'Segoe UI',Roboto,'Helvetica Neue',sans-serif"


@dataclass(frozen=True, slots=True)
class Figure:
    """A drawing; notebooks show it by itself. `svg` is a whole `<svg>` element, `title` says what it shows."""

    svg: str
    title: str

    def _repr_svg_(self) -> str:
        return self.svg

    def _repr_html_(self) -> str:
        return f'<div style="max-width:100%;overflow-x:auto">{self.svg}</div>'

    def save(self, path: str | Path) -> Path:
        """Write it as an `.svg` file and return its path."""
        target = Path(path)
        target.write_text('<?xml version="1.0" encoding="UTF-8"?>\n' + self.svg, encoding="utf-8")
        return target


def number(value: float) -> str:
    """At most one decimal, no trailing zero, no minus zero: a tenth of a pixel is enough."""
    text = f"{value:.1f}".removesuffix(".0")
    return "0" if text == "-0" else text


def label(value: float, step: float) -> str:
    """A tick's text, with the decimals that `step` needs and a true minus sign."""
    decimals = max(0, -math.floor(math.log10(step) + 1e-9)) if step < 1 else 0
    text = f"{value:.{decimals}f}"
    return "0" if float(text) == 0 else text.replace("-", "−")


def nice_step(span: float, about: int) -> float:
    """1, 2 or 5 times a power of ten, such that `span` (> 0) holds about `about` steps."""
    rough = max(span, 1e-9) / max(about, 1)
    power: float = 10.0 ** math.floor(math.log10(rough))
    return next(power * factor for factor in (1.0, 2.0, 5.0, 10.0) if power * factor >= rough * 0.999)


def ticks(low: float, high: float, about: int = 5) -> tuple[list[float], float]:
    """Round values within [low, high] and their step."""
    step = nice_step(high - low, about)
    first, last = math.ceil(low / step - 1e-6), math.floor(high / step + 1e-6)
    return [index * step for index in range(first, last + 1)], step


def path_data(points: Floats, close: bool = False) -> str:
    """The `d` of a path through (n, 2) pixels, in relative steps, tenths of a pixel."""
    if not len(points):
        return ""
    tenths = np.rint(points * 10).astype(np.int64)
    moves = np.diff(tenths, axis=0)
    moves = moves[(moves != 0).any(axis=1)]
    start = f"M{number(tenths[0, 0] / 10)} {number(tenths[0, 1] / 10)}"
    steps = " ".join(f"{number(dx / 10)} {number(dy / 10)}" for dx, dy in moves.tolist())
    return start + (f"l{steps}" if steps else "h0") + ("z" if close else "")


def text(x: float, y: float, words: str, anchor: str = "middle", size: float = 11, extra: str = "") -> str:
    """A `<text>` element, its words escaped."""
    return (
        f'<text x="{number(x)}" y="{number(y)}" text-anchor="{anchor}" font-size="{number(size)}" '
        f'fill="currentColor"{" " + extra if extra else ""}>{escape(words)}</text>'
    )


def document(width: float, height: float, title: str, body: Iterable[str], description: str = "") -> str:
    """A whole `<svg>` element with a title for screen readers; text and axes take the page's own colour."""
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" class="figure" viewBox="0 0 {number(width)} {number(height)}" '
        f'width="{number(width)}" height="{number(height)}" role="img" aria-label="{escape(title, quote=True)}" '
        f'font-family="{FONT}" preserveAspectRatio="xMidYMid meet">'
        f"<title>{escape(title)}</title>"
        + (f"<desc>{escape(description)}</desc>" if description else "")
        + "".join(body)
        + "</svg>"
    )
