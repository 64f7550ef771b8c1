"""Map of radio coverage: losses from one transmitter of a loss table at one height, over the buildings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from skyrange.figures import svg
from skyrange.figures.base_map import BaseMap, fit_map
from skyrange.figures.svg import Figure
from skyrange.radio.propagation.loss_table_file import LossTableFile

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
    for row, own in enumerate(classes):
        edges = np.flatnonzero(np.diff(own, prepend=-2, append=-2))
        for first, last in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
            if own[first] < 0:
                continue
            low, high = south + row * step, south + (row + 1) * step
            left, right = west + first * step, west + last * step
            box = np.array([(left, low), (right, low), (right, high), (left, high)])
            paths[own[first]].append(svg.path_data(base.pixels(box), close=True))
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
