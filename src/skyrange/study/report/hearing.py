"""Receptions: a map of where hostile broadcasts were heard and how strong, and tables of who heard whom."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from markupsafe import Markup

from skyrange.study import svg
from skyrange.study.ground import fit_map
from skyrange.study.receptions import MOST_AIRCRAFT, Hearing, Receptions
from skyrange.study.report import words
from skyrange.study.report.rendering import render
from skyrange.study.subject import Subject
from skyrange.study.svg import Figure
from skyrange.study.symbols import Place, draw_places

MAX_DOTS = 4_000
MAX_PAIRS = 300
MIN_EXTENT_M = 150.0
"""The map shows this much each way: who hears whom is the work of the buildings around."""

_STEPS_DBM = (-95.0, -85.0, -75.0, -65.0)
_COLOURS = ("#3b0f70", "#8c2981", "#de4968", "#fe9f6d", "#f7d13d")
"""Weak to strong, after the magma map of matplotlib (public domain), which also reads in grey."""


def hearing_map(subject: Subject, heard: Receptions, places: Mapping[str, Place]) -> Figure:
    """A dot where a receiver was when a broadcast reached it, coloured by its strength; hollow where it was not
    decoded.
    """
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


def hearing_table(rows: Sequence[Hearing]) -> Markup:
    """Table of who heard whom, decoded or not."""
    return render(
        "receptions.html.jinja",
        texts=["sender", "receiver"],
        numbers=["decoded", "of", "median", "strongest"],
        rows=[
            {
                "first": row.sender,
                "second": row.receiver,
                "numbers": (
                    words.count(row.decoded),
                    words.count(row.of),
                    words.quantity(row.median_dbm, "dBm", 0),
                    words.quantity(row.most_dbm, "dBm", 0),
                ),
            }
            for row in rows[:MAX_PAIRS]
        ],
        total=len(rows),
    )


def air(rows: Sequence[Hearing], fleet: int, end_s: float) -> Mapping[str, Any] | None:
    """Who was heard by each receiver of a run of `fleet` aircraft, how strong, and how long ago at `end_s`; `None`
    where nobody heard anybody.
    """
    if not rows:
        return None
    table = render(
        "receptions.html.jinja",
        texts=["receiver", "hears"],
        numbers=["decoded", "median", "strongest", "longest silence", "age at the end"],
        rows=[
            {
                "first": row.receiver,
                "second": row.sender,
                "numbers": (
                    words.count(row.decoded),
                    words.quantity(row.median_dbm, "dBm", 0),
                    words.quantity(row.most_dbm, "dBm", 0),
                    words.quantity(row.silence_s, "s", 1),
                    words.quantity(None if row.last_s is None else max(end_s - row.last_s, 0.0), "s", 1),
                ),
            }
            for row in rows[:MAX_PAIRS]
        ],
        total=len(rows),
    )
    whose = "each receiver on the ground and each aircraft" if fleet <= MOST_AIRCRAFT else "each receiver on the ground"
    return {"receivers": whose, "table": table}


def _draw_key() -> list[Element]:
    names = ["< −95", *(f"≥ {step:.0f}".replace("-", "−") for step in _STEPS_DBM)]
    parts = []
    for place, (name, colour) in enumerate(zip(names, _COLOURS, strict=True)):
        x = 14 + place * 58
        parts.append(svg.element("circle", {"cx": x, "cy": "14", "r": "4", "fill": colour}))
        parts.append(svg.label(x + 7, 18, name, "start"))
    return parts
