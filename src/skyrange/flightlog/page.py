"""The page of an imported flight: where it flew, what was made of its log, and which flights the log has."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mission.items import GLOBAL_FRAMES, LANDINGS, TAKEOFFS
from skyrange.core.files import atomic_write
from skyrange.figures import svg
from skyrange.figures.maps import fit_map
from skyrange.figures.time_axes import TimeAxes
from skyrange.flightlog.conversion import Conversion
from skyrange.flightlog.flights import Flight
from skyrange.flightlog.flown_path import track_m
from skyrange.report.rendering import asset, content_policy, render

Floats = NDArray[np.float64]
PAGE: Final = "import.html"
_WIDTH: Final = 760.0
_TRACK: Final = {"stroke": "#2f6fd6", "stroke-width": "2", "fill": "none"}
_PLANNED: Final = {"stroke": "currentColor", "stroke-width": "1.5", "stroke-dasharray": "6 4", "fill": "none"}
_PARTS: Final = (
    ("taken", "Taken", "What the scenario has from the log as it is."),
    ("estimated", "Estimated", "What was computed from the log."),
    ("assumed", "Assumed", "What the log does not say, and a flight needs."),
    ("ignored", "Ignored", "What the log says, and the scenario does not use."),
)


def write_page(conversion: Conversion, flights: Sequence[Flight], folder: Path) -> Path:
    """Write the page of a conversion into a folder; its path."""
    path = folder / PAGE
    with atomic_write(path) as file:
        file.write(render_page(conversion, flights).encode())
    return path


def render_page(conversion: Conversion, flights: Sequence[Flight]) -> str:
    """The page as HTML."""
    flight, style = conversion.flight, asset("style.css")
    log = flight.log
    track = track_m(flight)
    far_m = float(np.sqrt((track[:, 1:3] ** 2).sum(axis=1)).max())
    length_m = float(np.sqrt((np.diff(track[:, 1:], axis=0) ** 2).sum(axis=1)).sum())
    name = conversion.scenario["name"]
    airborne_s = flight.landing_s - flight.take_off_s
    return str(
        render(
            "flightlog/page.html.jinja",
            policy=content_policy(style),
            title=f"{name} · imported flight · skyrange",
            style=style,
            name=name,
            verdict=f"Flight {flight.number} of {log.path.name}, {log.firmware or 'unknown firmware'}: "
            f"{airborne_s:.0f} s in the air.",
            track=f"{length_m:.0f} m flown, at most {far_m:.0f} m from home and {track[:, 3].max():.0f} m above it. "
            "Solid: the track of the log. Dashed: the mission of the scenario.",
            map=_draw_map(conversion, track),
            heights=_draw_heights(track),
            parts=[
                {"title": title, "lead": lead, "facts": [fact for fact in conversion.facts if fact.kind == kind]}
                for kind, title, lead in _PARTS
            ],
            flights=[describe_flight(each) for each in flights],
        )
    )


def describe_flight(flight: Flight) -> tuple[str, str, str, str, str]:
    """Number, begin, time in the air, modes, and mission of a flight."""
    mission = f"{len(flight.mission.items)} items" if flight.mission is not None else "none"
    airborne = f"{flight.landing_s - flight.take_off_s:.0f} s"
    return str(flight.number), f"{flight.armed_s:.0f} s", airborne, ", ".join(flight.modes), mission


def _planned_m(conversion: Conversion) -> Floats:
    """(n, 3) the points that the scenario flies, in metres from home."""
    path = conversion.scenario["operators"][0]["vehicles"][0]["plan"].get("path")
    if path is not None:
        return np.array(path["points"], dtype=np.float64).reshape(-1, 3)
    points = [(0.0, 0.0, 0.0)]
    for item in conversion.mission.items if conversion.mission is not None else ():
        here = item.command in TAKEOFFS | LANDINGS and not (item.x or item.y)
        if item.frame in GLOBAL_FRAMES and (item.x or item.y) and not here and abs(item.x) <= 90.0:
            east_m, north_m = conversion.flight.origin.enu_of(item.x, item.y)
            points.append((east_m, north_m, item.z))
    return np.array(points, dtype=np.float64)


def _draw_map(conversion: Conversion, track: Floats) -> svg.Figure:
    planned = _planned_m(conversion)
    base = fit_map([track[:, 1:], planned], (), _WIDTH)
    home = base.pixels(np.zeros((1, 2)))[0]
    body = [
        svg.element("path", {"d": svg.path_data(base.pixels(planned)), **_PLANNED}),
        svg.element("path", {"d": svg.path_data(base.pixels(track[:, 1:])), **_TRACK}),
        svg.element("circle", {"cx": float(home[0]), "cy": float(home[1]), "r": 4.0, "fill": "currentColor"}),
        svg.label(float(home[0]) + 8.0, float(home[1]) + 4.0, "home"),
        *base.draw_legend(),
    ]
    return svg.document(base.width, base.height, "Track of the flight and mission of the scenario", body)


def _draw_heights(track: Floats) -> svg.Figure:
    """Height above home over the time since take-off."""
    seconds, up_m = track[:, 0] - track[0, 0], np.maximum(track[:, 3], 0.0)
    axes = TimeAxes(_WIDTH, 200.0, max(float(seconds[-1]), 1.0), 0.0, max(float(up_m.max()), 1.0) * 1.1)
    body = axes.draw("m", "height above home")
    body.append(svg.element("path", {"d": svg.path_data(axes.place(seconds, up_m)), **_TRACK}))
    return svg.document(_WIDTH, axes.height, "Height above home since take-off", body)
