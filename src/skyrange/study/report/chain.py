"""How did one thing lead to another? Onset, propagation and effect on one clock, a lane per attack and aircraft."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from skyrange.core.time import NS_PER_S
from skyrange.study.report import words
from skyrange.study.subject import Subject
from skyrange.study.svg import label, number, ticks

Row = Mapping[str, Any]
Span = tuple[float, float, str]

MOST_MARKS = 300
"""Marks of one phase drawn in one lane; the table holds all."""
MOST_LANES = 40
MOST_STEPS = 60
"""Rows of the table of decisions."""

_SHAPES = {
    "act": '<path d="M0 -7V7" stroke="#b3261e" stroke-width="1.6" stroke-opacity=".55"/>',
    "onset": '<path d="M0 -9L8 0L0 9L-8 0z" fill="#b3261e"/>',
    "frame": '<path d="M0 -4V4" stroke="#c77700" stroke-width="1.4" stroke-opacity=".7"/>',
    "decision": '<circle r="5" fill="#c77700" stroke="var(--card)" stroke-width="1.4"/>',
    "effect": '<path d="M-7 -7H7L0 8z" fill="#2457c5"/>',
}
_MEANINGS = {
    "onset": "onset: the first hostile act",
    "act": "further hostile acts",
    "frame": "a frame that leads back to one",
    "decision": "a decision or event that does",
    "effect": "effect: truth departs from the twin",
}


def chain(subject: Subject, labels: Sequence[Row], attacks: Sequence[str], spans: Sequence[Span], end_s: float) -> str:
    """The timeline as HTML; `labels` are of one seed."""
    if not labels:
        return words.nothing("No hostile act was labelled.")
    lanes = [(attack, _of(labels, "attack", attack, ("onset", "act"))) for attack in attacks]
    touched = [vehicle for vehicle in subject.fleet if any(row["vehicle"] == vehicle.id for row in labels)]
    parts = [_axis(end_s)]
    for name, rows in lanes:
        own = [span for span in spans if span[2] == name]
        parts.append(_lane(escape(name), "", rows, own, end_s))
    for vehicle in touched[:MOST_LANES]:
        rows = [row for row in labels if row["vehicle"] == vehicle.id and row["phase"] in ("propagation", "effect")]
        index = subject.index(vehicle)
        parts.append(_lane(words.named(index, vehicle.id), f"ink-{index}", rows, spans, end_s))
    legend = "".join(
        '<span><svg width="18" height="18" viewBox="-9 -9 18 18" aria-hidden="true">'
        f"{_SHAPES[glyph]}</svg>{said}</span>"
        for glyph, said in _MEANINGS.items()
    )
    cut = (
        f"<p class=note>{len(touched) - MOST_LANES} more aircraft were reached.</p>"
        if len(touched) > MOST_LANES
        else ""
    )
    return f'<div class="legend">{legend}</div><div class="lanes chain">{"".join(parts)}</div>{cut}'


def steps(subject: Subject, labels: Sequence[Row]) -> str:
    """The chain in words: onset, the first decision of each kind about each aircraft, effect."""
    seen: set[tuple[str | None, str]] = set()
    rows = []
    for row in labels:
        key = (row["vehicle"], row["kind"])
        if row["phase"] == "act" or row["kind"] == "frame" or (row["phase"] == "propagation" and key in seen):
            continue
        seen.add(key)
        rows.append(row)
    if not rows:
        return words.nothing("Nothing to tell.")
    places = {vehicle.id: index for index, vehicle in enumerate(subject.fleet)}
    return words.table(
        "From onset to effect",
        ["phase", "attack", "aircraft", "what", "by"],
        ["time", "steps from the act"],
        (_step(row, places) for row in rows[:MOST_STEPS]),
        "tall",
    )


def _step(row: Row, places: Mapping[str, int]) -> str:
    vehicle = row["vehicle"]
    about = words.named(places[vehicle], vehicle) if vehicle in places else words.NONE
    what = escape(str(row["kind"]).removeprefix("decision.").removeprefix("event.").replace("_", " "))
    if row["kind"] == "sensor" and row["link"]:
        what = f"alters {escape(row['link'].partition(':')[0])}"
    if row["phase"] == "effect":
        what = f"departs from the twin, by up to {row['departure_m']:.1f} m"
    if row["data"]:
        what += f" {words.details(json.loads(row['data']))}"
    depth = str(row["depth"]) if row["depth"] is not None else words.NONE
    numbers = words.cells(words.quantity(row["at_ns"] / NS_PER_S, "s", 2), depth)
    css = {"onset": "bad", "propagation": "wait", "effect": "ok"}[row["phase"]]
    return (
        f'<tr><td><span class="badge {css}">{row["phase"]}</span></td><td>{escape(row["attack"] or "")}</td>'
        f"<td>{about}</td><td class=wrapped>{what}</td><td class=dim>{escape(row['source'])}</td>{numbers}</tr>"
    )


def _of(labels: Sequence[Row], key: str, value: str, phases: Sequence[str]) -> list[Row]:
    return [row for row in labels if row[key] == value and row["phase"] in phases]


def _glyph(row: Row) -> str:
    if row["phase"] == "propagation":
        return "frame" if row["kind"] == "frame" else "decision"
    return str(row["phase"])


def _lane(name: str, css: str, rows: Sequence[Row], spans: Sequence[Span], end_s: float) -> str:
    drawn: dict[str, list[Row]] = {glyph: [] for glyph in ("act", "frame", "decision", "onset", "effect")}
    for row in rows:
        drawn[_glyph(row)].append(row)
    marks = "".join(
        f'<svg x="{number(100 * min(row["at_ns"] / NS_PER_S / end_s, 1.0))}%" y="14" overflow="visible"><g>'
        f"{_SHAPES[glyph]}<title>{escape(_said(row))}</title></g></svg>"
        for glyph, own in drawn.items()
        for row in _spread(own)
    )
    bands = "".join(
        f'<rect x="{number(100 * begin / end_s)}%" y="1" width="{number(100 * max(end - begin, 0.0) / end_s)}%" '
        f'height="26" fill="#b3261e" fill-opacity=".09"><title>{escape(said)}</title></rect>'
        for begin, end, said in spans
    )
    return (
        f'<div class="lane"><div class="lane-name">{name}</div><svg class="lane-marks {css}" height="28" role="img" '
        f'aria-label="{len(rows)} marks">{bands}{marks}</svg></div>'
    )


def _spread(rows: Sequence[Row]) -> Sequence[Row]:
    """At most `MOST_MARKS` of them, evenly."""
    return rows[:: -(-len(rows) // MOST_MARKS)] if rows else rows


def _said(row: Row) -> str:
    what = f"{row['phase']}: {row['kind']}" if row["phase"] != row["kind"] else row["kind"]
    return f"{row['at_ns'] / NS_PER_S:.3f} s, {what}, {row['source']}"


def _axis(end_s: float) -> str:
    values, step = ticks(0.0, end_s, 10)
    marks = "".join(
        f'<text x="{number(100 * value / end_s)}%" y="14" font-size="11" text-anchor="middle">'
        f"{label(value, step)}</text>"
        for value in values
        if 0.01 < value / end_s < 0.99
    )
    return (
        '<div class="lane axis"><div class="lane-name">time, s</div>'
        f'<svg class="lane-marks" height="20" aria-hidden="true">{marks}</svg></div>'
    )
