"""Plan views: base map with buildings, symbols of places and mishaps, maps of radio coverage and receptions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from skyrange.figures import svg
from skyrange.figures.subject import Subject
from skyrange.figures.svg import Figure, format_number
from skyrange.metrics.links import ReceptionColumns
from skyrange.metrics.safety import Mishap
from skyrange.radio.propagation.loss_table_file import LossTableFile

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


Place = tuple[float, float, float]
"""A position in metres east, north and up of the origin."""

SAME_PX: Final = 8
"""Positions within so many pixels of each other share one ring."""

HOSTILE: Final = "#b3261e"
"""Colour of attackers and of what they forge."""


def draw_mark(mark: Mishap, x: float, y: float) -> Element:
    """Draw a mishap at a pixel: a cross for a collision or crash, a triangle for a breach or failsafe."""
    shape = "M-6 -6L6 6M6 -6L-6 6" if mark.violent else "M0 -7L7 5H-7z"
    halo = {"d": shape, "fill": "none", "stroke": "#fff", "stroke-width": "5", "stroke-opacity": ".85"}
    line = {
        "d": shape,
        "fill": "none" if mark.violent else "#e08a00",
        "stroke": "#c81e1e" if mark.violent else "#8a4f00",
        "stroke-width": "2.6" if mark.violent else "1.2",
        "stroke-linecap": "round",
    }
    return svg.element(
        "g",
        {"class": "mishap", "transform": f"translate({svg.format_number(x)} {svg.format_number(y)})"},
        svg.element("path", halo),
        svg.element("path", line),
        svg.title(mark.description),
    )


def draw_places(base: BaseMap, places: Mapping[str, Place]) -> list[Element]:
    """Draw a ring at each attacker's position, with its names; numbered members of a swarm have no names."""
    named: dict[tuple[int, int], list[str]] = {}
    for name, place in places.items():
        x, y = base.pixels(np.array([place]))[0].tolist()
        named.setdefault((round(x / SAME_PX), round(y / SAME_PX)), []).append(name)
    rings = [_ring(base, {name: places[name] for name in names}) for names in named.values()]
    return [part for ring in rings for part in ring]


def _ring(base: BaseMap, places: Mapping[str, Place]) -> list[Element]:
    x, y = base.pixels(np.array(list(places.values())[:1]))[0].tolist()
    description = "; ".join(
        f"{name}: {e:.0f} m east, {n:.0f} m north, {up:.0f} m up" for name, (e, n, up) in places.items()
    )
    names = " · ".join(name for name in places if not name.rpartition(" ")[2].isdigit())
    ring = {"cx": x, "cy": y, "r": 7, "fill": HOSTILE, "fill-opacity": ".16", "stroke": HOSTILE, "stroke-width": 2}
    dot = {"cx": x, "cy": y, "r": 2, "fill": HOSTILE}
    parts = svg.element("circle", ring), svg.element("circle", dot), svg.title(description)
    return [svg.element("g", {"class": "hostile"}, *parts), svg.label(x + 11, y + 4, names, "start", 11, svg.BOLD)]


def draw_claim(base: BaseMap, enu_m: NDArray[np.float64], title: str) -> Element:
    """Draw a dotted line through (n, 3) positions that are claimed or believed, and not true."""
    line = {"d": svg.path_data(base.pixels(enu_m)), "fill": "none", "stroke": HOSTILE, "stroke-width": "1.4"}
    dotted = svg.element("path", {**line, "stroke-dasharray": "1.5 4", "stroke-linecap": "round"})
    return svg.element("g", {"class": "hostile"}, dotted, svg.title(title))


STEPS_DB: Final = (70.0, 80.0, 90.0, 100.0, 110.0, 120.0)
"""Borders of the classes of loss. Open Drone ID over Wi-Fi closes over about 105 dB: 15 dBm sent, -90 dBm received."""
MAX_COLUMNS: Final = 200
"""Squares drawn in each direction; of a larger grid every second one, third one and so on is drawn."""
_COLOURS: Final = ("#fcfdbf", "#feb078", "#f1605d", "#b73779", "#721f81", "#2c115f", "#000004")
"""Small to large loss, the magma map of matplotlib (public domain), which also reads in grey."""


def draw_coverage_map(
    content: LossTableFile, city: Sequence[Mapping[str, Any]], transmitter: int = 0, height_m: float | None = None
) -> Figure:
    """Draw the losses from a transmitter at the height of the table nearest to `height_m`, by default the lowest.

    Squares inside buildings or without a path stay empty. `city` is the buildings as in `City.to_json_rows`.
    """
    grid = content.header.grid.grid
    heights = np.array(grid.heights_m)
    level = 0 if height_m is None else int(np.argmin(np.abs(heights - height_m)))
    losses = content.loss_db[transmitter, level]
    half = 0.5 * grid.spacing_m
    corners = grid.points_enu_m[0, [0, -1], [0, -1]] + np.array([[-half, -half, 0.0], [half, half, 0.0]])
    base = fit_map([corners], city, 760.0)
    place = content.places_enu_m[transmitter]
    body = [*_draw_squares(base, losses, grid.west_m - half, grid.south_m - half, grid.spacing_m)]
    body += [base.draw_buildings(), *_draw_transmitter(base, place), *base.draw_legend(), *_draw_key()]
    at = f"[{place[0]:.0f}, {place[1]:.0f}, {place[2]:g}] m"
    title = f"Loss from {at} at {heights[level]:g} m above the ground, {content.header.frequency_mhz:g} MHz"
    return svg.document(base.width, base.height, title, body)


def _draw_squares(
    base: BaseMap, losses: NDArray[np.float32], west: float, south: float, side: float
) -> Sequence[Element]:
    """One path for each class of loss, of rectangles that join neighbours in a row."""
    every = -(-max(losses.shape) // MAX_COLUMNS)
    shown, step = losses[::every, ::every], side * every
    classes = np.where(np.isfinite(shown), np.searchsorted(STEPS_DB, shown), -1)
    paths: list[list[str]] = [[] for _ in _COLOURS]
    for row, row_classes in enumerate(classes):
        edges = np.flatnonzero(np.diff(row_classes, prepend=-2, append=-2))
        for first, last in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
            if row_classes[first] < 0:
                continue
            low, high = south + row * step, south + (row + 1) * step
            left, right = west + first * step, west + last * step
            box = np.array([(left, low), (right, low), (right, high), (left, high)])
            paths[row_classes[first]].append(svg.path_data(base.pixels(box), close=True))
    return [
        svg.element("path", {"d": "".join(parts), "fill": colour, "fill-opacity": ".85"})
        for parts, colour in zip(paths, _COLOURS, strict=True)
        if parts
    ]


def _draw_transmitter(base: BaseMap, place: NDArray[np.float64]) -> Sequence[Element]:
    x, y = base.pixels(place[None, :])[0].tolist()
    ring = {"cx": x, "cy": y, "r": 7, "fill": "#fff", "fill-opacity": ".6", "stroke": "#0b6e99", "stroke-width": 2.5}
    dot = {"cx": x, "cy": y, "r": 2.5, "fill": "#0b6e99"}
    return svg.element("circle", ring, svg.title("transmitter")), svg.element("circle", dot)


def _draw_key() -> Sequence[Element]:
    names = [f"< {STEPS_DB[0]:.0f}", *(f"{step:.0f}" for step in STEPS_DB[:-1]), f"≥ {STEPS_DB[-1]:.0f} dB"]
    parts = []
    for index, (name, colour) in enumerate(zip(names, _COLOURS, strict=True)):
        x = 14 + index * 56
        parts.append(svg.element("rect", {"x": x, "y": 9, "width": 10, "height": 10, "fill": colour}))
        parts.append(svg.label(x + 14, 18, name, "start"))
    return parts


MAX_DOTS = 4_000
"""Receptions drawn on one map, evenly spaced in time."""
MIN_EXTENT_M = 150.0
"""Least extent of the map in each direction, so that it shows the buildings that shape reception."""

_STEPS_DBM = (-95.0, -85.0, -75.0, -65.0)
_STRENGTH_COLOURS = ("#3b0f70", "#8c2981", "#de4968", "#fe9f6d", "#f7d13d")
"""Weak to strong, after the magma map of matplotlib (public domain), which also reads in grey."""


def draw_reception_map(subject: Subject, heard: ReceptionColumns, places: Mapping[str, Place]) -> Figure:
    """Draw a dot at the receiver's position for each reception, coloured by signal strength, hollow if not decoded."""
    shown = [heard.enu_m, *(np.array([place]) for place in places.values())]
    base = fit_map(shown, subject.city, 760.0, MIN_EXTENT_M)
    body = [base.draw_buildings()]
    rows = np.unique(np.linspace(0, len(heard) - 1, min(len(heard), MAX_DOTS)).astype(np.int64))
    for row in rows:
        x, y = base.pixels(heard.enu_m[row : row + 1])[0].tolist()
        colour = _STRENGTH_COLOURS[int(np.searchsorted(_STEPS_DBM, heard.rssi_dbm[row]))]
        fill = {"fill": colour} if heard.decoded[row] else {"fill": "none", "stroke": colour}
        who = f"{heard.receiver[row]} hears {heard.sender[row]}"
        hover_title = f"{who} at {heard.rssi_dbm[row]:.0f} dBm, {heard.time_ns[row] * 1e-9:.1f} s"
        body.append(svg.element("circle", {"cx": x, "cy": y, "r": 3.4, **fill}, svg.title(hover_title)))
    body += [*draw_places(base, places), *base.draw_legend(), *_draw_strength_key()]
    title = f"Where the attackers were heard in {subject.name}"
    return svg.document(base.width, base.height, title, body)


def _draw_strength_key() -> list[Element]:
    names = ["< −95", *(f"≥ {step:.0f}".replace("-", "−") for step in _STEPS_DBM)]
    parts = []
    for place, (name, colour) in enumerate(zip(names, _STRENGTH_COLOURS, strict=True)):
        x = 14 + place * 58
        parts.append(svg.element("circle", {"cx": x, "cy": "14", "r": "4", "fill": colour}))
        parts.append(svg.label(x + 7, 18, name, "start"))
    return parts
