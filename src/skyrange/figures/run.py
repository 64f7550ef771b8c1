"""Figures of a run: of its record, and of tracks that were read before."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from skyrange.figures import svg
from skyrange.figures.base_map import fit_map
from skyrange.figures.subject import Subject, subject_of
from skyrange.figures.svg import Figure, format_number
from skyrange.figures.symbols import draw_mark
from skyrange.figures.time_chart import draw_chart
from skyrange.figures.track_simplification import select_samples
from skyrange.figures.trajectory_box import draw_box
from skyrange.metrics.mishaps import Mishap, drawing_order, read_mishaps
from skyrange.metrics.time_series import Record, Track, Vehicle, belief_tracks, truth_tracks
from skyrange.metrics.track_deviation import deviations_m
from skyrange.metrics.waypoints import received_waypoints

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
    subject: Subject, tracks: Mapping[str, Track], operators: Sequence[str] | None, source: Source, titled: bool = True
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
        own = [vehicle for vehicle in subject.fleet if vehicle.operator == operator]
        parts = draw_box(subject, own, tracks, width, height)
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
    return draw_chart(subject, lines, "height above the origin, m", title, width, height)


def track_deviation(record: Record, width: float = 760.0, height: float = 300.0) -> Figure:
    """Cross-track deviation (m) over simulated time (s) of each aircraft while in the air.

    The deviation is the horizontal distance of the true position from the line through home and the waypoints that the
    aircraft received (`waypoints.received_waypoints`). Sizes are in pixels.
    """
    subject = subject_of(record)
    lines = deviations_m(subject.fleet, truth_tracks(record), received_waypoints(record))
    title = f"Distance from the planned track in {subject.name}"
    return draw_chart(subject, lines, "metres beside the planned track", title, width, height)


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
