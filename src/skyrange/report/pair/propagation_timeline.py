"""Propagation timeline: onset, acts, propagation and effect, with one lane per attack and per aircraft."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup

from skyrange.core.time import NS_PER_S
from skyrange.figures.subject import Subject
from skyrange.figures.svg import format_number, format_tick, ticks
from skyrange.figures.twins import Span
from skyrange.record.notes import parse_details
from skyrange.report import quantities
from skyrange.report.rendering import render
from skyrange.report.viewer import at_moment, link_moment

Row = Mapping[str, Any]

MAX_MARKS = 300
"""Marks of one phase drawn in one lane; propagation.parquet holds all."""
MAX_LANES = 40
MAX_STEPS = 60
"""Rows of the table of decisions."""

_MEANINGS = {
    "onset": "onset: the first act of an attack or a fault",
    "act": "its further acts",
    "frame": "a frame that leads back to one",
    "decision": "a decision or event that does",
    "effect": "effect: truth departs from the twin",
}

_IN_ORDER_OF_TABS = frozenset({"onset", "effect"})
"""Marks that the tab key reaches; the table of steps leads to the others."""


def render_timeline(
    subject: Subject, propagation: Sequence[Row], attacks: Sequence[str], spans: Sequence[Span], end_s: float
) -> Markup:
    """Render the timeline; `propagation` are the rows of one seed."""
    lanes = []
    for name in attacks:
        attack_spans = [span for span in spans if span[2] == name]
        lanes.append(_lane(name, None, _of(propagation, "attack", name, ("onset", "act")), attack_spans, end_s))
    touched = [vehicle for vehicle in subject.fleet if any(row["vehicle"] == vehicle.id for row in propagation)]
    for vehicle in touched[:MAX_LANES]:
        rows = _of(propagation, "vehicle", vehicle.id, ("propagation", "effect"))
        lanes.append(_lane(vehicle.id, subject.index(vehicle), rows, spans, end_s))
    return render(
        "pair/chain.html.jinja",
        lanes=lanes if propagation else [],
        symbols=_MEANINGS,
        ticks=_ticks(end_s),
        more=max(len(touched) - MAX_LANES, 0),
    )


def render_steps(subject: Subject, propagation: Sequence[Row]) -> Markup:
    """Render the table: onset, the first decision of each kind about each aircraft, and effect."""
    seen: set[tuple[str | None, str]] = set()
    rows = []
    for row in propagation:
        key = (row["vehicle"], row["kind"])
        if row["phase"] == "act" or row["kind"] == "frame" or (row["phase"] == "propagation" and key in seen):
            continue
        seen.add(key)
        rows.append(row)
    places = {vehicle.id: index for index, vehicle in enumerate(subject.fleet)}
    return render("pair/steps.html.jinja", rows=[_step(row, places) for row in rows[:MAX_STEPS]])


def _step(row: Row, places: Mapping[str, int]) -> Mapping[str, Any]:
    at_s = row["at_ns"] / NS_PER_S
    what = str(row["kind"]).removeprefix("decision.").removeprefix("event.").replace("_", " ")
    if row["kind"] in ("sensor", "scan") and row["link"]:
        what = f"alters {row['link'].partition(':')[0]}"
    if row["kind"] == "body" and row["link"]:
        what = f"acts on {row['link'].partition(':')[0]}"
    if row["phase"] == "effect":
        what = f"departs from the twin, by up to {row['departure_m']:.1f} m"
    depth = str(row["depth"]) if row["depth"] is not None else quantities.MISSING
    return {
        "badge": {"onset": "bad", "propagation": "wait", "effect": "ok"}[row["phase"]],
        "phase": row["phase"],
        "attack": f"{row['attack']} (fault)" if row["fault"] else row["attack"] or "",
        "vehicle": row["vehicle"],
        "place": places.get(row["vehicle"]),
        "what": what,
        "data": parse_details(row["data"]) if row["data"] else None,
        "source": row["source"],
        "numbers": (at_moment(quantities.quantity(at_s, "s", 2), at_s, row["vehicle"] or ""), depth),
    }


def _of(propagation: Sequence[Row], key: str, value: str, phases: Sequence[str]) -> list[Row]:
    return [row for row in propagation if row[key] == value and row["phase"] in phases]


def _symbol(row: Row) -> str:
    """The name under which the template draws a row's symbol."""
    if row["phase"] == "propagation":
        return "frame" if row["kind"] == "frame" else "decision"
    return str(row["phase"])


def _lane(name: str, index: int | None, rows: Sequence[Row], spans: Sequence[Span], end_s: float) -> Mapping[str, Any]:
    """A lane of an attack, or of the aircraft with the number `index`."""
    drawn: dict[str, list[Row]] = {symbol: [] for symbol in ("act", "frame", "decision", "onset", "effect")}
    for row in rows:
        drawn[_symbol(row)].append(row)
    return {
        "name": name,
        "index": index,
        "count": len(rows),
        "marks": [
            (
                symbol,
                format_number(100 * min(row["at_ns"] / NS_PER_S / end_s, 1.0)),
                _title(row),
                link_moment(row["at_ns"] / NS_PER_S, row["vehicle"] or ""),
                symbol in _IN_ORDER_OF_TABS,
            )
            for symbol, symbol_rows in drawn.items()
            for row in _thinned(symbol_rows)
        ],
        "bands": [
            (format_number(100 * begin / end_s), format_number(100 * max(end - begin, 0.0) / end_s), label)
            for begin, end, label in spans
        ],
    }


def _thinned(rows: Sequence[Row]) -> Sequence[Row]:
    """At most `MAX_MARKS` rows, evenly spaced."""
    return rows[:: -(-len(rows) // MAX_MARKS)] if rows else rows


def _title(row: Row) -> str:
    what = f"{row['phase']}: {row['kind']}" if row["phase"] != row["kind"] else row["kind"]
    return f"{row['at_ns'] / NS_PER_S:.3f} s, {what}, {row['source']}"


def _ticks(end_s: float) -> list[tuple[str, str]]:
    """Positions in percent and texts of the ticks of the time axis."""
    values, step = ticks(0.0, end_s, 10)
    return [
        (format_number(100 * value / end_s), format_tick(value, step))
        for value in values
        if 0.01 < value / end_s < 0.99
    ]
