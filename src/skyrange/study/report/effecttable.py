"""What did it cost each aircraft? The table of effects, and the intervals over seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from skyrange.study.report import words
from skyrange.study.spread import Interval
from skyrange.study.subject import Subject

Row = Mapping[str, Any]

MOST_ROWS = 200

_MEASURES = (
    ("delay_s", "arrival delay", "s", 1.0, 1),
    ("extra_distance_m", "extra distance", "m", 1.0, 1),
    ("extra_energy_j", "extra energy", "kJ", 1e-3, 2),
    ("min_separation_m", "least separation", "m", 1.0, 1),
    ("min_wall_m", "nearest wall", "m", 1.0, 1),
    ("near_misses", "near misses", "", 1.0, 2),
    ("collisions", "collisions", "", 1.0, 2),
    ("departure_m", "from the twin at most", "m", 1.0, 1),
)
_BADGES = {"complete": "ok", "failed": "bad", "unfinished": "wait"}


def effects(subject: Subject, rows: Sequence[Row]) -> str:
    """One row per aircraft against one twin, those that departed most first."""
    if not rows:
        return words.nothing("No aircraft was measured.")
    places = {vehicle.id: index for index, vehicle in enumerate(subject.fleet)}
    ordered = sorted(rows, key=lambda row: -row["departure_m"])
    table = words.table(
        "Effects on each aircraft",
        ["aircraft", "mission, in the twin → attacked"],
        ["departs at", "by at most", "delay", "distance", "energy", "separation", "wall", "near misses", "collisions"],
        (_row(row, places) for row in ordered[:MOST_ROWS]),
        "tall",
    )  # fmt: skip
    cut = f"<p class=note>The first {MOST_ROWS} of {len(rows)}; effects.parquet holds all.</p>"
    return table + (cut if len(rows) > MOST_ROWS else "")


def operators(subject: Subject, rows: Sequence[Row]) -> str:
    """One row per operator: what it cost its aircraft together; "" where each has but one."""
    owned: dict[str, list[Row]] = {}
    for row in rows:
        owned.setdefault(row["vehicle"].partition("/")[0], []).append(row)
    if len(owned) == len(rows):
        return ""
    places = {vehicle.id: index for index, vehicle in enumerate(subject.fleet)}
    return words.table(
        "What it cost whom",
        ["operator"],
        ["aircraft", "departed", "missions end otherwise", "delay", "distance", "energy", "near misses", "collisions"],
        (
            f"<tr><th scope=row>{words.named(places[own[0]['vehicle']], name)}</th>{_together(own)}</tr>"
            for name, own in owned.items()
        ),
    )


def ensemble(subject: Subject, found: Mapping[str, Mapping[str, Interval]], affected: Sequence[str]) -> str:
    """Means over seeds and their intervals, of the aircraft that were affected in some run."""
    places = {vehicle.id: index for index, vehicle in enumerate(subject.fleet)}
    chosen = [name for name in found if name in affected] or list(found)
    return words.table(
        "Means over seeds with 95 % intervals",
        ["aircraft"],
        [name for _, name, *_ in _MEASURES],
        (
            f"<tr><th scope=row>{words.named(places[name], name)}</th>"
            + words.cells(*(_interval(found[name].get(key), unit, scale, n) for key, _, unit, scale, n in _MEASURES))
            + "</tr>"
            for name in chosen[:MOST_ROWS]
        ),
        "tall",
    )


def _row(row: Row, places: Mapping[str, int]) -> str:
    outcome = " → ".join(
        f'<span class="badge {_BADGES.get(state, "wait")}">{escape(state)}</span>'
        for state in dict.fromkeys((row["outcome_twin"], row["outcome"]))
    )
    departed = row["departed_s"]
    energy = row["extra_energy_j"]
    numbers = words.cells(
        words.NONE if departed is None else words.quantity(departed, "s", 1),
        words.quantity(row["departure_m"], "m", 1),
        words.signed(row["delay_s"], "s", 1),
        words.signed(row["extra_distance_m"], "m", 1),
        words.signed(None if energy is None else energy / 1000.0, "kJ", 2),
        _change(row["min_separation_twin_m"], row["min_separation_m"]),
        _change(row["min_wall_twin_m"], row["min_wall_m"]),
        _counts(row["near_misses_twin"], row["near_misses"]),
        _counts(row["collisions_twin"], row["collisions"]),
    )
    quiet = " class=quiet" if departed is None else ""
    name = words.named(places[row["vehicle"]], row["vehicle"])
    return f"<tr{quiet}><th scope=row>{name}</th><td>{outcome}</td>{numbers}</tr>"


def _together(rows: Sequence[Row]) -> str:
    """The sums of one operator's aircraft as cells."""
    return words.cells(
        words.count(len(rows)),
        words.count(sum(row["departed_s"] is not None for row in rows)),
        words.count(sum(row["outcome"] != row["outcome_twin"] for row in rows)),
        words.signed(sum(row["delay_s"] or 0.0 for row in rows), "s", 1),
        words.signed(sum(row["extra_distance_m"] for row in rows), "m", 1),
        words.signed(sum(row["extra_energy_j"] or 0.0 for row in rows) / 1000.0, "kJ", 2),
        _counts(sum(row["near_misses_twin"] for row in rows), sum(row["near_misses"] for row in rows)),
        _counts(sum(row["collisions_twin"] for row in rows), sum(row["collisions"] for row in rows)),
    )


def _interval(found: Interval | None, unit: str, scale: float, decimals: int) -> str:
    if found is None:
        return words.NONE
    mean = words.signed(found.mean * scale, unit, decimals)
    if found.low is None or found.high is None:
        return f"{mean} <small>n = {found.n}</small>"
    low, high = (f"{value * scale:.{decimals}f}".replace("-", "−") for value in (found.low, found.high))
    text = f"{mean}<br><small>{low} … {high}, n = {found.n}</small>"
    return f"<b>{text}</b>" if found.clear else text


def _change(twin: float | None, attacked: float | None) -> str:
    if twin is None and attacked is None:
        return words.NONE
    shown = ["far" if value is None else f"{value:.1f}" for value in (twin, attacked)]
    return (f"{shown[0]} → {shown[1]}" if shown[0] != shown[1] else shown[0]) + "\u202f<small>m</small>"


def _counts(twin: int, attacked: int) -> str:
    return str(attacked) if twin == attacked else f"{twin} → {attacked}"
