"""Map of receptions: where broadcasts of attackers reached receivers, and how strong."""

from __future__ import annotations

from collections.abc import Mapping
from xml.etree.ElementTree import Element

import numpy as np

from skyrange.figures import svg
from skyrange.figures.base_map import fit_map
from skyrange.figures.subject import Subject
from skyrange.figures.svg import Figure
from skyrange.figures.symbols import Place, draw_places
from skyrange.metrics.receptions import ReceptionColumns

MAX_DOTS = 4_000
"""Receptions drawn on one map, evenly spaced in time."""
MIN_EXTENT_M = 150.0
"""Least extent of the map in each direction, so that it shows the buildings that shape reception."""

_STEPS_DBM = (-95.0, -85.0, -75.0, -65.0)
_COLOURS = ("#3b0f70", "#8c2981", "#de4968", "#fe9f6d", "#f7d13d")
"""Weak to strong, after the magma map of matplotlib (public domain), which also reads in grey."""


def draw_reception_map(subject: Subject, heard: ReceptionColumns, places: Mapping[str, Place]) -> Figure:
    """Draw a dot at the receiver's position for each reception, coloured by signal strength, hollow if not decoded."""
    shown = [heard.enu_m, *(np.array([place]) for place in places.values())]
    base = fit_map(shown, subject.city, 760.0, MIN_EXTENT_M)
    body = [base.draw_buildings()]
    rows = np.unique(np.linspace(0, len(heard) - 1, min(len(heard), MAX_DOTS)).astype(np.int64))
    for row in rows:
        x, y = base.pixels(heard.enu_m[row : row + 1])[0].tolist()
        colour = _COLOURS[int(np.searchsorted(_STEPS_DBM, heard.rssi_dbm[row]))]
        fill = {"fill": colour} if heard.decoded[row] else {"fill": "none", "stroke": colour}
        who = f"{heard.receiver[row]} hears {heard.sender[row]}"
        said = f"{who} at {heard.rssi_dbm[row]:.0f} dBm, {heard.time_ns[row] * 1e-9:.1f} s"
        body.append(svg.element("circle", {"cx": x, "cy": y, "r": 3.4, **fill}, svg.title(said)))
    body += [*draw_places(base, places), *base.draw_legend(), *_draw_key()]
    title = f"Where the attackers were heard in {subject.name}"
    return svg.document(base.width, base.height, title, body)


def _draw_key() -> list[Element]:
    names = ["< −95", *(f"≥ {step:.0f}".replace("-", "−") for step in _STEPS_DBM)]
    parts = []
    for place, (name, colour) in enumerate(zip(names, _COLOURS, strict=True)):
        x = 14 + place * 58
        parts.append(svg.element("circle", {"cx": x, "cy": "14", "r": "4", "fill": colour}))
        parts.append(svg.label(x + 7, 18, name, "start"))
    return parts
