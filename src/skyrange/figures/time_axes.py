"""Axes of charts over time whose lines belong to no aircraft of a run."""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from skyrange.figures import svg
from skyrange.figures.svg import format_number

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class TimeAxes:
    """A chart over seconds from 0, in pixels; `low` and `top` are the values at its edges."""

    width: float
    height: float
    last_s: float
    low: float
    top: float
    left: float = 48.0
    right: float = 12.0
    above: float = 20.0
    below: float = 26.0

    def place(self, times_s: Floats, values: Floats) -> Floats:
        """(n, 2) pixels."""
        x = self.left + (self.width - self.left - self.right) * times_s / self.last_s
        span = self.height - self.above - self.below
        y = self.height - self.below - span * (values - self.low) / (self.top - self.low)
        return np.stack([x, y], axis=1)

    def draw(self, unit: str, caption: str) -> list[Element]:
        """The grid, its numbers and a caption."""
        body = [svg.label(self.left, 12.0, caption, "start", extra={"opacity": ".7"})]
        values, step = svg.ticks(self.low, self.top)
        for value in values:
            y = float(self.place(np.zeros(1), np.array([value]))[0, 1])
            line = f"M{format_number(self.left)} {format_number(y)}H{format_number(self.width - self.right)}"
            body.append(svg.element("path", {"d": line, **svg.GRID}))
            body.append(svg.label(self.left - 6.0, y + 4.0, f"{svg.format_tick(value, step)} {unit}", "end"))
        times, step = svg.ticks(0.0, self.last_s, 8)
        for value in times:
            x = float(self.place(np.array([value]), np.array([self.low]))[0, 0])
            body.append(svg.label(x, self.height - 8.0, f"{svg.format_tick(value, step)} s"))
        return body
