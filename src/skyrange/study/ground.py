"""What lies under the paths, seen from above? A map's extent and scale, the buildings, a scale bar and north."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skyrange.study import svg
from skyrange.study.svg import number

Floats = NDArray[np.float64]

_STOREYS_M = 12.0
"""Buildings are shaded in eight steps of this height."""


@dataclass(frozen=True, slots=True)
class Ground:
    """A map of `width` × `height` pixels, north up: `scale` pixels a metre, `corner_m` what its upper left shows."""

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

    def buildings(self) -> str:
        """The buildings that it shows."""
        drawn = _footprints(self.city, self.pixels, self.width, self.height)
        return f'<g class="plan-buildings">{drawn}</g>'

    def legend(self) -> str:
        """A scale bar and an arrow to the north."""
        return _scale_bar(self.scale, self.width, self.height) + (
            f'<g transform="translate({number(self.width - 28)} 30)">'
            '<path d="M0 -18L7 8L0 3L-7 8z" fill="currentColor"/>'
            + svg.text(0, 22, "N", size=12, extra='font-weight="600"')
            + "</g>"
        )


def ground_of(
    places: Sequence[Floats], city: Sequence[Mapping[str, Any]], width: float, least_m: float = 10.0
) -> Ground:
    """The map that shows all of `places`, (n, 3) metres each, with a margin, and at least `least_m` each way."""
    solid = [rows for rows in places if len(rows)]
    low = np.min([rows.min(axis=0) for rows in solid], axis=0)[:2] if solid else np.full(2, -5.0)
    high = np.max([rows.max(axis=0) for rows in solid], axis=0)[:2] if solid else np.full(2, 5.0)
    span = np.maximum(high - low, least_m)
    span = span + 2 * np.maximum(0.08 * span, 14.0 if city else 1.0)  # walls give a path its meaning
    span[1] = max(span[1], span[0] * 0.5)
    span[0] = max(span[0], span[1] * 0.9)
    scale = width / float(span[0])
    return Ground(city, 0.5 * (low + high) + np.array([-0.5, 0.5]) * span, scale, width, float(span[1]) * scale)


def _footprints(
    city: Sequence[Mapping[str, Any]], pixels: Callable[[Floats], Floats], width: float, height: float
) -> str:
    """Outlines that touch the picture, in eight classes of height so that each class is one path."""
    classes: dict[int, list[str]] = {}
    for building in city:
        rings = [pixels(np.asarray(ring, dtype=np.float64)) for ring in building.get("rings") or [] if len(ring) > 2]
        if not rings or not _touches(rings[0], width, height):
            continue
        level = int(np.clip(float(building.get("height_m") or 0.0) // _STOREYS_M, 0, 7))
        classes.setdefault(level, []).append("".join(svg.path_data(ring, close=True) for ring in rings))
    return "".join(
        f'<path d="{"".join(classes[level])}" fill="currentColor" fill-opacity="{0.07 + 0.035 * level:.3f}" '
        'fill-rule="evenodd" stroke="currentColor" stroke-opacity=".28" stroke-width=".7"/>'
        for level in sorted(classes)
    )


def _touches(points: Floats, width: float, height: float) -> bool:
    low, high = points.min(axis=0), points.max(axis=0)
    return bool(high[0] > 0 and high[1] > 0 and low[0] < width and low[1] < height)


def _scale_bar(scale: float, width: float, height: float) -> str:
    metres = svg.nice_step(width / scale, 5)
    length = metres * scale
    y = height - 16
    return (
        f'<g class="scale-bar"><path d="M16 {number(y - 5)}V{number(y)}H{number(16 + length)}V{number(y - 5)}" '
        f'fill="none" stroke="currentColor" stroke-width="1.4"/>'
        + svg.text(16 + length / 2, y - 6, f"{svg.label(metres, metres)} m")
        + "</g>"
    )
