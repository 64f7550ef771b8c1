"""Where were the hostile broadcasts heard, how strong, and who hears whom? A map and a table of receptions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

import numpy as np

from skyrange.study import svg
from skyrange.study.ground import ground_of
from skyrange.study.receptions import MOST_AIRCRAFT, Hearing, Receptions
from skyrange.study.report import words
from skyrange.study.subject import Subject
from skyrange.study.svg import Figure, number
from skyrange.study.twins import Place, spots

MOST_DOTS = 4_000
MOST_PAIRS = 300
LEAST_M = 150.0
"""The map shows this much each way: who hears whom is the work of the buildings around."""

_STEPS_DBM = (-95.0, -85.0, -75.0, -65.0)
_COLOURS = ("#3b0f70", "#8c2981", "#de4968", "#fe9f6d", "#f7d13d")
"""Weak to strong, after the magma map of matplotlib (public domain), which also reads in grey."""


def hearing_map(subject: Subject, heard: Receptions, places: Mapping[str, Place]) -> Figure:
    """A dot where a receiver was when a broadcast reached it, coloured by its strength; hollow where it was not
    decoded.
    """
    shown = [heard.enu_m, *(np.array([place]) for place in places.values())]
    ground = ground_of(shown, subject.city, 760.0, LEAST_M)
    body = [ground.buildings()]
    rows = np.unique(np.linspace(0, len(heard) - 1, min(len(heard), MOST_DOTS)).astype(np.int64))
    for row in rows:
        x, y = ground.pixels(heard.enu_m[row : row + 1])[0].tolist()
        colour = _COLOURS[int(np.searchsorted(_STEPS_DBM, heard.rssi_dbm[row]))]
        fill = f'fill="{colour}"' if heard.decoded[row] else f'fill="none" stroke="{colour}"'
        who = f"{heard.receiver[row]} hears {heard.sender[row]}"
        said = f"{who} at {heard.rssi_dbm[row]:.0f} dBm, {heard.time_ns[row] * 1e-9:.1f} s"
        body.append(f'<circle cx="{number(x)}" cy="{number(y)}" r="3.4" {fill}><title>{escape(said)}</title></circle>')
    body.append(spots(ground, places))
    body += [ground.legend(), _key()]
    title = f"Where the attackers were heard in {subject.name}"
    return Figure(svg.document(ground.width, ground.height, title, body), title)


def hearing_table(rows: Sequence[Hearing]) -> str:
    """Who heard whom."""
    table = words.table(
        "Who heard whom",
        ["sender", "receiver"],
        ["decoded", "of", "median", "strongest"],
        (
            f"<tr><th scope=row>{escape(row.sender)}</th><td>{escape(row.receiver)}</td>"
            + words.cells(
                words.count(row.decoded),
                words.count(row.of),
                words.quantity(row.median_dbm, "dBm", 0),
                words.quantity(row.most_dbm, "dBm", 0),
            )
            + "</tr>"
            for row in rows[:MOST_PAIRS]
        ),
        "tall",
    )
    cut = f"<p class=note>The first {MOST_PAIRS} of {len(rows)} pairs.</p>" if len(rows) > MOST_PAIRS else ""
    return table + cut


def heard_section(rows: Sequence[Hearing], fleet: int, end_s: float) -> str:
    """The section on who was heard by each receiver of a run of `fleet` aircraft, how strong, and how long ago at
    `end_s`; "" where nobody heard anybody.
    """
    if not rows:
        return ""
    table = words.table(
        "Who heard whom",
        ["receiver", "hears"],
        ["decoded", "median", "strongest", "longest silence", "age at the end"],
        (
            f"<tr><th scope=row>{escape(row.receiver)}</th><td>{escape(row.sender)}</td>"
            + words.cells(
                words.count(row.decoded),
                words.quantity(row.median_dbm, "dBm", 0),
                words.quantity(row.most_dbm, "dBm", 0),
                words.quantity(row.silence_s, "s", 1),
                words.quantity(None if row.last_s is None else max(end_s - row.last_s, 0.0), "s", 1),
            )
            + "</tr>"
            for row in rows[:MOST_PAIRS]
        ),
        "tall",
    )
    cut = f"<p class=note>The first {MOST_PAIRS} of {len(rows)} pairs.</p>" if len(rows) > MOST_PAIRS else ""
    whose = "each receiver on the ground and each aircraft" if fleet <= MOST_AIRCRAFT else "each receiver on the ground"
    return (
        '<section id="air"><h2>On the air</h2>'
        f'<p class="lead">Whom {whose} heard: the radio that truly sent, whoever it claimed to be. What ground '
        "stations made of it stands under events as track seen and track lost.</p>"
        f'<div class="card">{table}{cut}</div></section>'
    )


def _key() -> str:
    names = ["< −95", *(f"≥ {step:.0f}".replace("-", "−") for step in _STEPS_DBM)]
    parts = []
    for place, (name, colour) in enumerate(zip(names, _COLOURS, strict=True)):
        x = 14 + place * 58
        parts.append(f'<circle cx="{number(x)}" cy="14" r="4" fill="{colour}"/>' + svg.text(x + 7, 18, name, "start"))
    return "".join(parts)
