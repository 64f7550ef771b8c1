"""Figures of one flight of a log and the simulated ones: its way, its height and its lean over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from skyrange.figures import svg
from skyrange.figures.maps import fit_map
from skyrange.figures.palette import OKABE_ITO
from skyrange.figures.svg import Figure
from skyrange.figures.time_axes import TimeAxes
from skyrange.parity.logs.comparison import ComparedFlight

Floats = NDArray[np.float64]
WIDTH: Final = 760.0
_LOG: Final = {"stroke": "currentColor", "stroke-width": "2", "fill": "none"}
COLOURS: Final = {"builtin": OKABE_ITO[0], "ardupilot": OKABE_ITO[2]}


def draw_way(flights: Sequence[ComparedFlight]) -> Figure:
    """The way over ground: the log's, and the middle of the simulated ones of each autopilot."""
    log = flights[0].log.track[:, 1:]
    centres = {flight.autopilot: flight.band.centre_m for flight in flights if flight.band is not None}
    base = fit_map([log, *centres.values()], (), WIDTH)
    body = [*base.draw_legend()]
    for autopilot, centre in centres.items():
        look = {"stroke": COLOURS[autopilot], "stroke-width": "1.8", "fill": "none", "stroke-dasharray": "6 3"}
        body.append(svg.element("path", {"d": svg.path_data(base.pixels(centre)), **look}))
    body.append(svg.element("path", {"d": svg.path_data(base.pixels(log)), **_LOG}))
    return svg.document(base.width, base.height, f"{flights[0].name}: way over ground", body)


def draw_heights(flights: Sequence[ComparedFlight]) -> Figure:
    """The height over time with the bands of the simulated flights."""
    track = flights[0].log.track
    tops = [float(track[:, 3].max())]
    tops += [float((flight.band.centre_m + flight.band.half_m)[:, 2].max()) for flight in flights if flight.band]
    axes = TimeAxes(WIDTH, 220.0, max(float(track[-1, 0]), 1.0), 0.0, max(tops) * 1.08)
    body = axes.draw("m", "height above home; the bands hold whole simulated tracks")
    for flight in flights:
        if flight.band is None:
            continue
        centre, half = flight.band.centre_m[:, 2], flight.band.half_m[:, 2]
        upper, lower = axes.place(flight.times_s, centre + half), axes.place(flight.times_s, centre - half)
        fill = {"fill": COLOURS[flight.autopilot], "fill-opacity": ".3", "stroke": COLOURS[flight.autopilot]}
        body.append(svg.element("path", {"d": svg.path_data(np.concatenate([upper, lower[::-1]]), close=True), **fill}))
    body.append(svg.element("path", {"d": svg.path_data(axes.place(track[:, 0], track[:, 3])), **_LOG}))
    return svg.document(WIDTH, axes.height, f"{flights[0].name}: height over time", body)


def draw_leans(flights: Sequence[ComparedFlight]) -> Figure:
    """The lean over time: the log's, and that of the first simulated flight of each autopilot."""
    lean = flights[0].log.lean
    lines = {flight.autopilot: flight.flown[0].lean for flight in flights if flight.flown}
    last_s = max(float(flights[0].log.track[-1, 0]), 1.0)
    shown = {name: line[line[:, 0] <= last_s] for name, line in lines.items()}
    top = max([float(line[:, 1].max()) for line in (lean, *shown.values()) if len(line)], default=1.0)
    axes = TimeAxes(WIDTH, 180.0, last_s, 0.0, max(top, 1.0) * 1.08)
    body = axes.draw("°", "lean; of the simulated flights the first seed")
    for autopilot, line in shown.items():
        look = {"stroke": COLOURS[autopilot], "stroke-width": "1.4", "fill": "none"}
        body.append(svg.element("path", {"d": svg.path_data(axes.place(line[:, 0], line[:, 1])), **look}))
    if len(lean):
        body.append(svg.element("path", {"d": svg.path_data(axes.place(lean[:, 0], lean[:, 1])), **_LOG}))
    return svg.document(WIDTH, axes.height, f"{flights[0].name}: lean over time", body)
