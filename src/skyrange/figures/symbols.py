"""Symbols of figures: mishaps, positions of attackers, and claimed positions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from skyrange.figures import svg
from skyrange.figures.base_map import BaseMap
from skyrange.metrics.mishaps import Mishap

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
    said = "; ".join(f"{name}: {e:.0f} m east, {n:.0f} m north, {up:.0f} m up" for name, (e, n, up) in places.items())
    names = " · ".join(name for name in places if not name.rpartition(" ")[2].isdigit())
    ring = {"cx": x, "cy": y, "r": 7, "fill": HOSTILE, "fill-opacity": ".16", "stroke": HOSTILE, "stroke-width": 2}
    dot = {"cx": x, "cy": y, "r": 2, "fill": HOSTILE}
    parts = svg.element("circle", ring), svg.element("circle", dot), svg.title(said)
    return [svg.element("g", {"class": "hostile"}, *parts), svg.label(x + 11, y + 4, names, "start", 11, svg.BOLD)]


def draw_claim(base: BaseMap, enu_m: NDArray[np.float64], said: str) -> Element:
    """Draw a dotted line through (n, 3) positions that are claimed or believed, and not true."""
    line = {"d": svg.path_data(base.pixels(enu_m)), "fill": "none", "stroke": HOSTILE, "stroke-width": "1.4"}
    dotted = svg.element("path", {**line, "stroke-dasharray": "1.5 4", "stroke-linecap": "round"})
    return svg.element("g", {"class": "hostile"}, dotted, svg.title(said))
