"""Trajectory box: paths in a parallel projection with axes, grid, buildings and shadows."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from skyrange.figures import svg
from skyrange.figures.subject import Subject
from skyrange.figures.symbols import draw_mark
from skyrange.figures.track_simplification import select_samples
from skyrange.metrics.mishaps import Mishap, drawing_order
from skyrange.metrics.time_series import Track, Vehicle

Floats = NDArray[np.float64]

MAX_BUILDINGS = 300
"""Buildings drawn in one box: those nearest to its centre."""

_AZIMUTH = math.radians(-60.0)
_ELEVATION = math.radians(26.0)


def draw_box(
    subject: Subject,
    own: Sequence[Vehicle],
    tracks: Mapping[str, Track],
    width: float,
    height: float,
    marks: Sequence[Mishap] = (),
) -> list[Element]:
    """Draw the paths of the vehicles `own`, and axes in metres, in a panel of `width` × `height` pixels.

    If the paths are flat, the vertical axis is stretched and the panel states the factor.
    """
    paths = [tracks[vehicle.id].enu_m for vehicle in own]
    if not any(len(path) for path in paths):
        return [svg.label(width / 2, height / 2, "nothing was received", extra={"opacity": ".6"})]
    everything = np.concatenate([path for path in paths if len(path)])
    low, high = everything.min(axis=0), everything.max(axis=0)
    low[2] = min(low[2], 0.0)
    centre = 0.5 * (low + high)
    half = max(float((high - low)[:2].max()), 4.0) * 0.54
    low[:2], high[:2] = centre[:2] - half, centre[:2] + half
    high[2] = low[2] + max((high[2] - low[2]) * 1.1, 2.0)
    rise = max((high[2] - low[2]) / (2 * half), 0.42) * 2 * half / (high[2] - low[2])
    project = _projector(low, high, rise, width, height)
    parts = _frame(low, high, project)
    parts.extend(_buildings(subject.city, low, high, project))
    budget = max(60, svg.MAX_POINTS // max(len(subject.fleet), 1))
    for vehicle in own:
        track = tracks[vehicle.id]
        rows = select_samples(track.time_ns, track.enu_m, budget, 0.002 * half)
        shadow = track.enu_m[rows].copy()
        shadow[:, 2] = low[2]
        parts += subject.draw_line(vehicle, project(shadow), "0.22", "1.2")
        parts += subject.draw_line(vehicle, project(track.enu_m[rows]))
    parts += [draw_mark(mark, *project(np.array([mark.enu_m]))[0].tolist()) for mark in drawing_order(marks)]
    if rise > 1.05:
        parts.append(svg.label(width - 12, height - 8, f"up drawn ×{rise:.1f}", "end", 10, {"opacity": ".6"}))
    return parts


def _projector(low: Floats, high: Floats, rise: float, width: float, height: float) -> Any:
    """A parallel projection of (n, 3) metres to (n, 2) pixels that fits the box into the panel."""
    centre = 0.5 * (low + high)
    ca, sa, ce, se = math.cos(_AZIMUTH), math.sin(_AZIMUTH), math.cos(_ELEVATION), math.sin(_ELEVATION)
    right = np.array([-sa, ca, 0.0])
    upward = np.array([-se * ca, -se * sa, ce * rise])
    half = 0.5 * (high - low)
    scale = min((width - 90) / (2 * float(np.abs(right) @ half)), (height - 96) / (2 * float(np.abs(upward) @ half)))

    def project(points: Floats) -> Floats:
        rel = points - centre
        return np.stack([width / 2 + rel @ right * scale, height / 2 + 8 - rel @ upward * scale], axis=1)

    return project


def _frame(low: Floats, high: Floats, project: Any) -> list[Element]:
    """Draw the floor and the two far walls with grid lines, ticks and axis names.

    At azimuth −60° the far walls are those of least east and of greatest north.
    """
    parts: list[Element] = []
    (e_ticks, e_step), (n_ticks, n_step), (u_ticks, u_step) = (
        svg.ticks(low[0], high[0], 5),
        svg.ticks(low[1], high[1], 5),
        svg.ticks(low[2], high[2], 4),
    )

    def line(*points: tuple[float, float, float]) -> None:
        parts.append(svg.element("path", {"d": svg.path_data(project(np.array(points))), **svg.GRID}))

    def draw_label(
        point: tuple[float, float, float], dx: float, dy: float, text: str, anchor: str, faint: bool
    ) -> None:
        x, y = project(np.array([point]))[0]
        parts.append(svg.label(x + dx, y + dy, text, anchor, 10.5, {"opacity": ".7"} if faint else None))

    line((low[0], low[1], low[2]), (high[0], low[1], low[2]), (high[0], high[1], low[2]), (high[0], high[1], high[2]))
    line((low[0], low[1], low[2]), (low[0], low[1], high[2]), (low[0], high[1], high[2]), (high[0], high[1], high[2]))
    line((low[0], low[1], low[2]), (low[0], high[1], low[2]), (high[0], high[1], low[2]))
    line((low[0], high[1], low[2]), (low[0], high[1], high[2]))
    for e in e_ticks:
        line((e, low[1], low[2]), (e, high[1], low[2]), (e, high[1], high[2]))
        draw_label((e, low[1], low[2]), -3, 14, svg.format_tick(e, e_step), "middle", False)
    for n in n_ticks:
        line((high[0], n, low[2]), (low[0], n, low[2]), (low[0], n, high[2]))
        draw_label((high[0], n, low[2]), 7, 9, svg.format_tick(n, n_step), "start", False)
    for u in u_ticks:
        line((low[0], low[1], u), (low[0], high[1], u), (high[0], high[1], u))
        draw_label((low[0], low[1], u), -7, 4, svg.format_tick(u, u_step), "end", False)
    middle = 0.5 * (low + high)
    draw_label((middle[0], low[1], low[2]), -22, 32, "east, m", "middle", True)
    draw_label((high[0], middle[1], low[2]), 34, 24, "north, m", "start", True)
    draw_label((low[0], low[1], high[2]), -7, -10, "up, m", "middle", True)
    return parts


def _buildings(city: Sequence[Mapping[str, Any]], low: Floats, high: Floats, project: Any) -> list[Element]:
    """Draw extruded buildings whose centre lies in the box, the farthest first."""
    centre = 0.5 * (low + high)
    inside = []
    for building in city:
        ring = np.asarray((building.get("rings") or [[]])[0], dtype=np.float64)
        if len(ring) < 3:
            continue
        middle = ring.mean(axis=0)
        if (np.abs(middle - centre[:2]) <= 0.5 * (high - low)[:2]).all():
            inside.append((float(np.hypot(*(middle - centre[:2]))), middle, ring, float(building.get("height_m") or 0)))
    inside.sort(key=lambda row: row[0])
    view = np.array([math.cos(_AZIMUTH), math.sin(_AZIMUTH)])
    near = sorted(inside[:MAX_BUILDINGS], key=lambda row: float(row[1] @ view))
    blocks = [_block(ring, min(tall, high[2]), low[2], project, view) for _, _, ring, tall in near]
    return [part for block in blocks for part in block]


def _block(ring: Floats, tall: float, ground: float, project: Any, view: Floats) -> list[Element]:
    """Draw one building: the walls that face the viewer, then the roof."""
    walls = []
    area = float((ring[:, 0] * np.roll(ring[:, 1], -1) - np.roll(ring[:, 0], -1) * ring[:, 1]).sum())
    for start, end in zip(ring, np.roll(ring, -1, axis=0), strict=True):
        outward = np.array([end[1] - start[1], start[0] - end[0]]) * math.copysign(1.0, area)
        if outward @ view > 0:
            corners = np.array([[*start, ground], [*end, ground], [*end, tall], [*start, tall]])
            walls.append(svg.path_data(project(corners), close=True))
    roof = svg.path_data(project(np.column_stack([ring, np.full(len(ring), tall)])), close=True)
    wall = {"class": "wall", "d": "".join(walls), "fill": "#8d98a8", "fill-opacity": ".5"}
    top = {"class": "roof", "d": roof, "fill": "#c3cbd6", "fill-opacity": ".6"}
    edge = {"stroke": "#6d7887", "stroke-width": ".5"}
    return [svg.element("path", wall), svg.element("path", {**top, **edge})]
