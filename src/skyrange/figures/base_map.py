"""Base map of plan views: extent and scale, buildings, scale bar and north arrow."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from skyrange.figures import svg
from skyrange.figures.svg import format_number

Floats = NDArray[np.float64]

_STOREYS_M = 12.0
"""Buildings are shaded in eight steps of this height."""


@dataclass(frozen=True, slots=True)
class BaseMap:
    """A map of `width` × `height` pixels, north up, with `scale` pixels per metre and `corner_m` at its upper left."""

    city: Sequence[Mapping[str, Any]]
    corner_m: Floats
    scale: float
    width: float
    height: float

    def pixels(self, enu_m: Floats) -> Floats:
        """(n, 2) pixels of (n, 2 or 3) metres."""
        return np.stack(
            [(enu_m[:, 0] - self.corner_m[0]) * self.scale, (self.corner_m[1] - enu_m[:, 1]) * self.scale], axis=1
        )

    def draw_buildings(self) -> Element:
        """Draw the buildings on the map."""
        footprints = _footprints(self.city, self.pixels, self.width, self.height)
        return svg.element("g", {"class": "plan-buildings"}, *footprints)

    def draw_legend(self) -> list[Element]:
        """Draw a scale bar and a north arrow."""
        arrow = svg.element("path", {"d": "M0 -18L7 8L0 3L-7 8z", "fill": "currentColor"})
        letter = svg.label(0, 22, "N", size=12, extra=svg.BOLD)
        place = f"translate({format_number(self.width - 28)} 30)"
        bar = _scale_bar(self.scale, self.width, self.height)
        return [bar, svg.element("g", {"transform": place}, arrow, letter)]


def fit_map(
    places: Sequence[Floats], city: Sequence[Mapping[str, Any]], width: float, least_m: float = 10.0
) -> BaseMap:
    """A map that shows all `places`, (n, 3) metres each, with a margin, and at least `least_m` in each direction."""
    solid = [rows for rows in places if len(rows)]
    low = np.min([rows.min(axis=0) for rows in solid], axis=0)[:2] if solid else np.full(2, -5.0)
    high = np.max([rows.max(axis=0) for rows in solid], axis=0)[:2] if solid else np.full(2, 5.0)
    span = np.maximum(high - low, least_m)
    span = span + 2 * np.maximum(0.08 * span, 14.0 if city else 1.0)  # walls give a path its meaning
    span[1] = max(span[1], span[0] * 0.5)
    span[0] = max(span[0], span[1] * 0.9)
    scale = width / float(span[0])
    return BaseMap(city, 0.5 * (low + high) + np.array([-0.5, 0.5]) * span, scale, width, float(span[1]) * scale)


def _footprints(
    city: Sequence[Mapping[str, Any]], pixels: Callable[[Floats], Floats], width: float, height: float
) -> list[Element]:
    """Draw outlines that touch the map, in eight classes of height, each of which is one path."""
    classes: dict[int, list[str]] = {}
    for building in city:
        rings = [pixels(np.asarray(ring, dtype=np.float64)) for ring in building.get("rings") or [] if len(ring) > 2]
        if not rings or not _touches(rings[0], width, height):
            continue
        level = int(np.clip(float(building.get("height_m") or 0.0) // _STOREYS_M, 0, 7))
        classes.setdefault(level, []).append("".join(svg.path_data(ring, close=True) for ring in rings))
    edge = {"fill-rule": "evenodd", "stroke": "currentColor", "stroke-opacity": ".28", "stroke-width": ".7"}
    outlines = [
        {"d": "".join(classes[level]), "fill": "currentColor", "fill-opacity": f"{0.07 + 0.035 * level:.3f}"}
        for level in sorted(classes)
    ]
    return [svg.element("path", {**outline, **edge}) for outline in outlines]


def _touches(points: Floats, width: float, height: float) -> bool:
    low, high = points.min(axis=0), points.max(axis=0)
    return bool(high[0] > 0 and high[1] > 0 and low[0] < width and low[1] < height)


def _scale_bar(scale: float, width: float, height: float) -> Element:
    metres = svg.round_step(width / scale, 5)
    length = metres * scale
    y, top, right = (format_number(value) for value in (height - 16, height - 21, 16 + length))
    line = {"d": f"M16 {top}V{y}H{right}V{top}", "fill": "none", "stroke": "currentColor", "stroke-width": "1.4"}
    label = svg.label(16 + length / 2, height - 22, f"{svg.format_tick(metres, metres)} m")
    return svg.element("g", {"class": "scale-bar"}, svg.element("path", line), label)
