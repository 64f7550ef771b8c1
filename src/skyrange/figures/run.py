"""Figures of a run, of its record or of tracks that were read before, with the trajectory box."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from skyrange.figures import svg
from skyrange.figures.maps import draw_mark, fit_map
from skyrange.figures.subject import Subject, subject_of
from skyrange.figures.svg import Figure, format_number
from skyrange.figures.time_chart import draw_chart
from skyrange.figures.track_simplification import select_samples
from skyrange.metrics.paths import deviations_m, received_waypoints
from skyrange.metrics.safety import Mishap, drawing_order, read_mishaps
from skyrange.metrics.time_series import Record, Track, Vehicle, belief_tracks, truth_tracks

MAX_BUILDINGS = 300
"""Buildings drawn in one box: those nearest to its centre."""
MAX_SHADOWS = 100
"""Aircraft of one box whose paths throw shadows on its floor."""

_AZIMUTH = math.radians(-60.0)
_ELEVATION = math.radians(26.0)


def draw_box(
    subject: Subject,
    vehicles: Sequence[Vehicle],
    tracks: Mapping[str, Track],
    width: float,
    height: float,
    marks: Sequence[Mishap] = (),
) -> list[Element]:
    """Draw the paths of `vehicles`, and axes in metres, in a panel of `width` × `height` pixels.

    If the paths are flat, the vertical axis is stretched and the panel states the factor.
    """
    paths = [tracks[vehicle.id].enu_m for vehicle in vehicles]
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
    for vehicle in vehicles:
        track = tracks[vehicle.id]
        rows = select_samples(track.time_ns, track.enu_m, budget, 0.002 * half)
        if len(vehicles) <= MAX_SHADOWS:
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
        point: tuple[float, float, float], dx: float, dy: float, text: str, anchor: str, *, faint: bool
    ) -> None:
        x, y = project(np.array([point]))[0]
        parts.append(svg.label(x + dx, y + dy, text, anchor, 10.5, {"opacity": ".7"} if faint else None))

    line((low[0], low[1], low[2]), (high[0], low[1], low[2]), (high[0], high[1], low[2]), (high[0], high[1], high[2]))
    line((low[0], low[1], low[2]), (low[0], low[1], high[2]), (low[0], high[1], high[2]), (high[0], high[1], high[2]))
    line((low[0], low[1], low[2]), (low[0], high[1], low[2]), (high[0], high[1], low[2]))
    line((low[0], high[1], low[2]), (low[0], high[1], high[2]))
    for e in e_ticks:
        line((e, low[1], low[2]), (e, high[1], low[2]), (e, high[1], high[2]))
        draw_label((e, low[1], low[2]), -3, 14, svg.format_tick(e, e_step), "middle", faint=False)
    for n in n_ticks:
        line((high[0], n, low[2]), (low[0], n, low[2]), (low[0], n, high[2]))
        draw_label((high[0], n, low[2]), 7, 9, svg.format_tick(n, n_step), "start", faint=False)
    for u in u_ticks:
        line((low[0], low[1], u), (low[0], high[1], u), (high[0], high[1], u))
        draw_label((low[0], low[1], u), -7, 4, svg.format_tick(u, u_step), "end", faint=False)
    middle = 0.5 * (low + high)
    draw_label((middle[0], low[1], low[2]), -22, 32, "east, m", "middle", faint=True)
    draw_label((high[0], middle[1], low[2]), 34, 24, "north, m", "start", faint=True)
    draw_label((low[0], low[1], high[2]), -7, -10, "up, m", "middle", faint=True)
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


Floats = NDArray[np.float64]
Source = Literal["belief", "truth"]


def trajectories_3d(record: Record, operators: Sequence[str] | None = None, source: Source = "belief") -> Figure:
    """One box of trajectories per operator, side by side, axes in metres east, north and up of the origin.

    By default each box shows the positions that the operator's ground station received of its own aircraft
    (`source="belief"`: GLOBAL_POSITION_INT), as in figure 7 of the published five-aircraft demonstration;
    `source="truth"` shows the true positions. `operators` selects and orders the boxes; `None` shows all. Raises
    `ValueError` for an operator that the run does not have.
    """
    tracks = belief_tracks(record) if source == "belief" else truth_tracks(record)
    return draw_boxes(subject_of(record), tracks, operators, source)


def overview(record: Record) -> Figure:
    """True paths of all aircraft in one box, with buildings, axes in metres, and marks as in `plan_view`."""
    return draw_overview(subject_of(record), truth_tracks(record), read_mishaps(record))


def plan_view(record: Record, waypoints: Mapping[str, Floats] | None = None, width: float = 760.0) -> Figure:
    """Plan view: buildings shaded by height, true paths, homes, a scale bar and an arrow to the north.

    `waypoints` are (n, 3) ENU metres by vehicle id, drawn as small diamonds (`waypoints.received_waypoints` reads them
    from the record). Crosses mark collisions and crashes, triangles failsafes and fence breaches. `width` is in pixels.
    """
    return draw_plan(subject_of(record), truth_tracks(record), waypoints or {}, width, read_mishaps(record))


def altitude(record: Record, width: float = 760.0, height: float = 300.0) -> Figure:
    """True height above the origin (m) over simulated time (s), one line per aircraft. Sizes are in pixels."""
    return draw_altitude(subject_of(record), truth_tracks(record), width, height)


def draw_boxes(
    subject: Subject,
    tracks: Mapping[str, Track],
    operators: Sequence[str] | None,
    source: Source,
    *,
    titled: bool = True,
) -> Figure:
    """Draw `trajectories_3d` of the given tracks; `titled` writes the operator's name above each box."""
    known = list(dict.fromkeys(vehicle.operator for vehicle in subject.fleet))
    chosen = known if operators is None else list(operators)
    for operator in chosen:
        if operator not in known:
            raise ValueError(f"operator {operator!r} is not in this run; it has {', '.join(known) or 'none'}")
    columns = min(max(len(chosen), 1), 3)
    width, height = 460.0, 390.0
    body = []
    for place, operator in enumerate(chosen):
        vehicles = [vehicle for vehicle in subject.fleet if vehicle.operator == operator]
        parts = draw_box(subject, vehicles, tracks, width, height)
        if titled:
            heading = f"{operator} — as its ground station saw it" if source == "belief" else f"{operator} — truth"
            parts.insert(0, svg.label(width / 2, 20, heading, size=14, extra=svg.BOLD))
        x, y = format_number(place % columns * width), format_number(place // columns * height)
        body.append(svg.element("g", {"transform": f"translate({x} {y})"}, *parts))
    title = f"Trajectories of {', '.join(chosen) or 'nobody'} in {subject.name} ({source})"
    return svg.document(columns * width, max(1, math.ceil(len(chosen) / columns)) * height, title, body)


def draw_overview(subject: Subject, tracks: Mapping[str, Track], marks: Sequence[Mishap] = ()) -> Figure:
    """Draw `overview` of the given tracks."""
    title = f"All trajectories of {subject.name}"
    return svg.document(900, 520, title, draw_box(subject, subject.fleet, tracks, 900, 520, marks))


def draw_plan(
    subject: Subject,
    tracks: Mapping[str, Track],
    waypoints: Mapping[str, Floats],
    width: float = 760.0,
    marks: Sequence[Mishap] = (),
) -> Figure:
    """Draw `plan_view` of the given tracks."""
    homes = [np.array([vehicle.home_enu_m]) for vehicle in subject.fleet if vehicle.home_enu_m is not None]
    base = fit_map([*(t.enu_m for t in tracks.values()), *homes, *waypoints.values()], subject.city, width)
    pixels = base.pixels
    body = [base.draw_buildings()]
    for vehicle in subject.fleet:
        body += _draw_vehicle(subject, vehicle, tracks[vehicle.id], waypoints.get(vehicle.id), pixels)
    body += [draw_mark(mark, *pixels(np.array([mark.enu_m]))[0].tolist()) for mark in drawing_order(marks)]
    body += base.draw_legend()
    title = f"Plan view of {subject.name}"
    description = f"{len(subject.fleet)} aircraft; north is up"
    return svg.document(base.width, base.height, title, body, description)


def draw_altitude(subject: Subject, tracks: Mapping[str, Track], width: float = 760.0, height: float = 300.0) -> Figure:
    """Draw `altitude` of the given tracks."""
    lines = {name: (track.time_ns, track.enu_m[:, 2]) for name, track in tracks.items()}
    title = f"Altitude over time in {subject.name}"
    return draw_chart(subject, lines, "height above the origin, m", title, size_px=(width, height))


def track_deviation(record: Record, width: float = 760.0, height: float = 300.0) -> Figure:
    """Cross-track deviation (m) over simulated time (s) of each aircraft while in the air.

    The deviation is the horizontal distance of the true position from the line through home and the waypoints that the
    aircraft received (`waypoints.received_waypoints`). Sizes are in pixels.
    """
    subject = subject_of(record)
    lines = deviations_m(subject.fleet, truth_tracks(record), received_waypoints(record))
    title = f"Distance from the planned track in {subject.name}"
    return draw_chart(subject, lines, "metres beside the planned track", title, size_px=(width, height))


def _draw_vehicle(
    subject: Subject, vehicle: Vehicle, track: Track, waypoints: Floats | None, pixels: Any
) -> list[Element]:
    """Draw the path, waypoints and home of one aircraft."""
    rows = select_samples(track.time_ns, track.enu_m[:, :2], max(60, svg.MAX_POINTS // len(subject.fleet)), 0.02)
    parts = subject.draw_line(vehicle, pixels(track.enu_m[rows]))
    for x, y in pixels(waypoints).tolist() if waypoints is not None and len(waypoints) else []:
        diamond = np.array([[x, y - 4], [x + 4, y], [x, y + 4], [x - 4, y]])
        parts += subject.draw_line(vehicle, diamond, weight="1.2", close=True)
    if vehicle.home_enu_m is not None:
        x, y = pixels(np.array([vehicle.home_enu_m]))[0]
        home = svg.element(
            "g",
            {"class": f"home ink-{subject.index(vehicle)}", "fill": subject.colours[vehicle.id].light},
            svg.element("circle", {"cx": x, "cy": y, "r": 4.5}),
            svg.element("circle", {"cx": x, "cy": y, "r": 1.8, "fill": "#fff"}),
            svg.title(f"{vehicle.id}: home"),
        )
        parts.append(home)
        if len(subject.fleet) <= 40:  # more names would only cover each other
            parts.append(svg.label(x + 8, y + 13, vehicle.short, "start", 10.5, {"opacity": ".8"}))
    return parts
