"""How do two runs of one scenario look side by side? Both tracks from above, in height, and how far apart they are."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from html import escape

import numpy as np
from numpy.typing import NDArray

from skyrange.study import svg
from skyrange.study.chart import over_time
from skyrange.study.ground import Ground, ground_of
from skyrange.study.marks import Mark, by_weight, drawn
from skyrange.study.series import Track
from skyrange.study.subject import Subject
from skyrange.study.svg import Figure, number
from skyrange.study.thin import kept_rows

Floats = NDArray[np.float64]
Place = tuple[float, float, float]
Span = tuple[float, float, str]

SAME_PX = 8
"""Places nearer to each other than that, in pixels, share a ring."""
_BOLD = 'font-weight="600"'
MOST_NAMED = 40
"""Names on a map; more would only cover each other."""


def draw_twin_plan(
    subject: Subject,
    tracks: Mapping[str, Track],
    twins: Mapping[str, Track],
    affected: Collection[str],
    places: Mapping[str, Place],
    marks: Sequence[Mark] = (),
    forged: Mapping[str, tuple[Place, Place]] | None = None,
    believed: Mapping[str, Track] | None = None,
    width: float = 760.0,
) -> Figure:
    """Both true paths from above: solid as attacked, dashed in the twin.

    The map shows the aircraft of `affected` (all, where there is none) and `places`, the attackers' by name; the
    others' paths are faint. `forged` are aircraft of which something false is claimed: where they are when that
    begins, and where they are said to be; they are shown too, with a line from the one to the other. `believed` are
    the paths that deceived aircraft believe to fly.
    """
    forged, believed = forged or {}, believed or {}
    chosen = (set(affected) or {vehicle.id for vehicle in subject.fleet}) | set(forged)
    paths = [group[name].enu_m for group in (tracks, twins, believed) for name in chosen if name in group]
    marked = [np.array([place]) for place in [*places.values(), *(true for true, _ in forged.values())]]
    ground = ground_of([*paths, *marked], subject.city, width)
    body = [ground.buildings()]
    for group, dashed in ((twins, True), (tracks, False)):
        for vehicle in subject.fleet:
            track = group.get(vehicle.id)
            if track is None or (dashed and vehicle.id not in chosen):
                continue
            rows = kept_rows(track.time_ns, track.enu_m[:, :2], max(60, svg.POINTS // (2 * len(subject.fleet))), 0.02)
            faint = vehicle.id not in chosen
            pixels = ground.pixels(track.enu_m[rows])
            weight = "1" if faint else "1.5" if dashed else "2.2"
            body.append(subject.line(vehicle, pixels, "0.3" if faint else "1", weight, dashed=dashed))
    body += [_home(subject, ground, name) for name in sorted(chosen)]
    body += [
        _lie(ground, np.array(ends), f"{name}: where it is, and where it is said to be")
        for name, ends in forged.items()
    ]
    for name, track in believed.items():
        rows = kept_rows(track.time_ns, track.enu_m[:, :2], 400, 0.1)
        body.append(_lie(ground, track.enu_m[rows], f"{name}: where it believes to be"))
    body.append(spots(ground, places))
    body += [drawn(mark, *ground.pixels(np.array([mark.enu_m]))[0].tolist()) for mark in by_weight(marks)]
    body.append(ground.legend())
    title = f"Plan view of {subject.name}, attacked and not"
    words = "solid: attacked; dashed: the twin; north is up"
    return Figure(svg.document(ground.width, ground.height, title, body, words), title)


def draw_twin_heights(
    subject: Subject,
    tracks: Mapping[str, Track],
    twins: Mapping[str, Track],
    chosen: Collection[str],
    spans: Sequence[Span],
) -> Figure:
    """True heights over time, the twins' dashed; `spans` are when attacks act."""
    lines, dashed = (
        {name: (track.time_ns, track.enu_m[:, 2]) for name, track in group.items() if name in chosen}
        for group in (tracks, twins)
    )
    title = f"Altitude over time in {subject.name}, attacked and not"
    return over_time(subject, lines, "height above the origin, m", title, 760.0, 300.0, dashed, spans)


def draw_departures(
    subject: Subject,
    tracks: Mapping[str, Track],
    twins: Mapping[str, Track],
    chosen: Collection[str],
    spans: Sequence[Span],
) -> Figure:
    """How far each aircraft was from where it was in the twin at the same moment, over time."""
    lines = {}
    for name in chosen:
        track, twin = tracks.get(name), twins.get(name)
        if track is None or twin is None or not len(track) or not len(twin):
            continue
        both = track.time_ns <= twin.time_ns[-1]
        away_m = np.sqrt(((twin.at(track.time_ns[both]) - track.enu_m[both]) ** 2).sum(axis=1))
        lines[name] = (track.time_ns[both], away_m)
    title = f"Distance from the twin in {subject.name}"
    return over_time(subject, lines, "metres from where it is in the twin", title, 760.0, 300.0, spans=spans)


def _home(subject: Subject, ground: Ground, name: str) -> str:
    vehicle = next(vehicle for vehicle in subject.fleet if vehicle.id == name)
    if vehicle.home_enu_m is None:
        return ""
    x, y = ground.pixels(np.array([vehicle.home_enu_m]))[0].tolist()
    label = svg.text(x + 8, y + 13, vehicle.id, "start", 11, _BOLD)
    return (
        f'<circle class="home ink-{subject.index(vehicle)}" fill="{subject.inks[name].light}" cx="{number(x)}" '
        f'cy="{number(y)}" r="4.5"><title>{escape(name)}: home</title></circle>'
        + (label if len(subject.fleet) <= MOST_NAMED else "")
    )


def spots(ground: Ground, places: Mapping[str, Place]) -> str:
    """The attackers' places: a ring each, with the names of all that are there but those that are numbers of many."""
    named: dict[tuple[int, int], list[str]] = {}
    for name, place in places.items():
        x, y = ground.pixels(np.array([place]))[0].tolist()
        named.setdefault((round(x / SAME_PX), round(y / SAME_PX)), []).append(name)
    return "".join(_spot(ground, {name: places[name] for name in names}) for names in named.values())


def _spot(ground: Ground, places: Mapping[str, Place]) -> str:
    x, y = ground.pixels(np.array(list(places.values())[:1]))[0].tolist()
    said = "; ".join(f"{name}: {e:.0f} m east, {n:.0f} m north, {up:.0f} m up" for name, (e, n, up) in places.items())
    label = " · ".join(name for name in places if not name.rpartition(" ")[2].isdigit())
    return (
        f'<g class="hostile"><circle cx="{number(x)}" cy="{number(y)}" r="7" fill="#b3261e" fill-opacity=".16" '
        f'stroke="#b3261e" stroke-width="2"/><circle cx="{number(x)}" cy="{number(y)}" r="2" fill="#b3261e"/>'
        f"<title>{escape(said)}</title></g>" + svg.text(x + 11, y + 4, label, "start", 11, _BOLD)
    )


def _lie(ground: Ground, enu_m: Floats, said: str) -> str:
    """A dotted line through (n, 3) places that are not the truth."""
    return (
        f'<g class="hostile"><path d="{svg.path_data(ground.pixels(enu_m))}" fill="none" '
        f'stroke="#b3261e" stroke-width="1.4" stroke-dasharray="1.5 4" stroke-linecap="round"/>'
        f"<title>{escape(said)}</title></g>"
    )
