"""Figures of an attacked run and its twin: plan view, altitude, and distance between the two over time."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from xml.etree.ElementTree import Element

import numpy as np

from skyrange.figures import svg
from skyrange.figures.maps import BaseMap, Place, draw_claim, draw_mark, draw_places, fit_map
from skyrange.figures.subject import Subject
from skyrange.figures.svg import Figure
from skyrange.figures.time_chart import draw_chart
from skyrange.figures.track_simplification import select_samples
from skyrange.metrics.safety import Mishap, drawing_order
from skyrange.metrics.time_series import Track

Span = tuple[float, float, str]
"""An interval: from and until, in seconds, and its name."""

MAX_NAMED = 40
"""No names are drawn for more aircraft than this, because they would overlap."""


def draw_twin_plan(
    subject: Subject,
    tracks: Mapping[str, Track],
    twins: Mapping[str, Track],
    affected: Collection[str],
    places: Mapping[str, Place],
    *,
    marks: Sequence[Mishap] = (),
    forged: Mapping[str, tuple[Place, Place]] | None = None,
    believed: Mapping[str, Track] | None = None,
    width: float = 760.0,
) -> Figure:
    """Plan view of the true paths: solid lines of the attacked run, dashed lines of the twin.

    The extent of the map covers the aircraft of `affected` (all aircraft if it is empty) and `places`, the attackers'
    positions by name. Paths of other aircraft are faint. `forged` are aircraft whose position is forged: the true
    position at the attack's start and the claimed one, joined by a dotted line. `believed` are the paths that aircraft
    with altered sensors believe to fly.
    """
    forged, believed = forged or {}, believed or {}
    chosen = (set(affected) or {vehicle.id for vehicle in subject.fleet}) | set(forged)
    paths = [group[name].enu_m for group in (tracks, twins, believed) for name in chosen if name in group]
    marked = [np.array([place]) for place in [*places.values(), *(true for true, _ in forged.values())]]
    base = fit_map([*paths, *marked], subject.city, width)
    body = [base.draw_buildings()]
    budget = max(60, svg.MAX_POINTS // (2 * max(len(subject.fleet), 1)))
    for group, dashed in ((twins, True), (tracks, False)):
        for vehicle in subject.fleet:
            track = group.get(vehicle.id)
            if track is None or (dashed and vehicle.id not in chosen):
                continue
            rows = select_samples(track.time_ns, track.enu_m[:, :2], budget, 0.02)
            faint = vehicle.id not in chosen
            pixels = base.pixels(track.enu_m[rows])
            weight = "1" if faint else "1.5" if dashed else "2.2"
            body += subject.draw_line(vehicle, pixels, "0.3" if faint else "1", weight, dashed=dashed)
    for name in sorted(chosen):
        body += _draw_home(subject, base, name)
    body += [
        draw_claim(base, np.array(ends), f"{name}: where it is, and where it is said to be")
        for name, ends in forged.items()
    ]
    for name, track in believed.items():
        rows = select_samples(track.time_ns, track.enu_m[:, :2], 400, 0.1)
        body.append(draw_claim(base, track.enu_m[rows], f"{name}: where it believes to be"))
    body += draw_places(base, places)
    body += [draw_mark(mark, *base.pixels(np.array([mark.enu_m]))[0].tolist()) for mark in drawing_order(marks)]
    body += base.draw_legend()
    title = f"Plan view of {subject.name}, attacked and not"
    description = "solid: attacked; dashed: the twin; north is up"
    return svg.document(base.width, base.height, title, body, description)


def draw_twin_heights(
    subject: Subject,
    tracks: Mapping[str, Track],
    twins: Mapping[str, Track],
    chosen: Collection[str],
    spans: Sequence[Span],
) -> Figure:
    """True heights over time, dashed for the twin; `spans` are the intervals in which attacks are active."""
    lines, dashed = (
        {name: (track.time_ns, track.enu_m[:, 2]) for name, track in group.items() if name in chosen}
        for group in (tracks, twins)
    )
    title = f"Altitude over time in {subject.name}, attacked and not"
    return draw_chart(
        subject, lines, "height above the origin, m", title, size_px=(760.0, 300.0), twins=dashed, spans=spans
    )


def draw_departures(
    subject: Subject,
    tracks: Mapping[str, Track],
    twins: Mapping[str, Track],
    chosen: Collection[str],
    spans: Sequence[Span],
) -> Figure:
    """Distance of each aircraft from its position in the twin at the same time."""
    lines = {}
    for name in chosen:
        track, twin = tracks.get(name), twins.get(name)
        if track is None or twin is None or not len(track) or not len(twin):
            continue
        both = track.time_ns <= twin.time_ns[-1]
        away_m = np.sqrt(((twin.at(track.time_ns[both]) - track.enu_m[both]) ** 2).sum(axis=1))
        lines[name] = (track.time_ns[both], away_m)
    title = f"Distance from the twin in {subject.name}"
    return draw_chart(subject, lines, "metres from where it is in the twin", title, size_px=(760.0, 300.0), spans=spans)


def _draw_home(subject: Subject, base: BaseMap, name: str) -> list[Element]:
    vehicle = next(vehicle for vehicle in subject.fleet if vehicle.id == name)
    if vehicle.home_enu_m is None:
        return []
    x, y = base.pixels(np.array([vehicle.home_enu_m]))[0].tolist()
    ink = {"class": f"home ink-{subject.index(vehicle)}", "fill": subject.colours[name].light}
    dot = svg.element("circle", {**ink, "cx": x, "cy": y, "r": 4.5}, svg.title(f"{name}: home"))
    if len(subject.fleet) > MAX_NAMED:
        return [dot]
    return [dot, svg.label(x + 8, y + 13, vehicle.id, "start", 11, svg.BOLD)]
