"""Rows of notes, labels and alerts, and the outcome of each aircraft's mission."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import pyarrow as pa

from skyrange.contracts.alerts import Alert, Scalar
from skyrange.contracts.mailboxes import Note
from skyrange.contracts.verdicts import Label
from skyrange.core.errors import ComponentError
from skyrange.core.time import Time, to_seconds
from skyrange.record.schema import arrow_schema

OUTCOME = "event.outcome"
"""Kind of the event that ends an aircraft's mission, with `state` (complete or failed) and `reason`."""

CRASH = "event.crash"
"""Kind of the event, of the world, that an aircraft hit the ground too hard or tipped over."""

COMPLETE = "complete"
FAILED = "failed"
UNFINISHED = "unfinished"
"""The state of an aircraft whose outcome was never noted."""

NoteRow = tuple[Time, str, str, str, str, list[str]]
"""time_ns, kind, about, source, data (JSON), causes."""

AlertRow = tuple[Time, str, str, str, float, Time, str]
"""time_ns, detector, kind, subject, score, at_ns, data (JSON)."""


def table_of(kind: str) -> str:
    """The table of a note: `decisions` for kinds that begin with `decision.`, else `events`."""
    return "decisions" if kind.startswith("decision.") else "events"


def note_row(now: Time, source: str, note: Note) -> NoteRow:
    """The row of a note with a copy of its details; `ComponentError` if these are not scalars."""
    text = _json_text(source, f"noted {note.kind}", note.data)
    return now, note.kind, note.about, source, text, [str(cause) for cause in note.causes]


def alert_row(now: Time, detector: str, alert: Alert) -> AlertRow:
    """The row of an alert with a copy of its details; `ComponentError` if these are not scalars."""
    text = _json_text(f"detector {detector}", f"raised {alert.kind}", alert.data)
    return now, detector, alert.kind, alert.subject, alert.score, alert.at, text


def parse_details(text: str | None) -> dict[str, Any]:
    """The details of a recorded note or alert; what is not a JSON object is under `text`, as in a damaged record."""
    try:
        value = json.loads(text) if text else {}
    except (ValueError, RecursionError):
        return {"text": text}
    return value if isinstance(value, dict) else {"text": value}


def _json_text(source: str, action: str, data: Mapping[str, Scalar]) -> str:
    try:
        return json.dumps(
            {key: _json_scalar(value) for key, value in data.items()}, ensure_ascii=False, allow_nan=False
        )
    except (TypeError, ValueError) as error:
        problem = f"{action} with data {dict(data)!r}, which are not all scalars"
        raise ComponentError(source, problem, "Details are of type str, int, float, bool or None") from error


def _json_scalar(value: Scalar) -> Scalar:
    """Infinities and not-a-number, which JSON lacks, become the strings `inf`, `-inf` and `nan`."""
    return str(float(value)) if isinstance(value, float) and not math.isfinite(value) else value


def note_batch(table: str, rows: Sequence[NoteRow]) -> pa.RecordBatch:
    """Rows of `decisions` or `events` as a batch."""
    return pa.RecordBatch.from_arrays(_columns(table, rows), schema=arrow_schema(table))


def label_batch(labels: Sequence[Label]) -> pa.RecordBatch:
    """Rows of `labels` as a batch."""
    rows = [
        (
            label.at_ns,
            label.attack,
            label.actor,
            label.action,
            str(label.frame),
            None if label.child is None else str(label.child),
            label.until_ns,
            label.benign,
            label.fault,
            label.harmless_intrusion,
        )
        for label in labels
    ]
    return pa.RecordBatch.from_arrays(_columns("labels", rows), schema=arrow_schema("labels"))


def alert_batch(rows: Sequence[AlertRow]) -> pa.RecordBatch:
    """Rows of `alerts` as a batch."""
    return pa.RecordBatch.from_arrays(_columns("alerts", rows), schema=arrow_schema("alerts"))


def _columns(table: str, rows: Sequence[Sequence[Any]]) -> list[pa.Array]:
    schema = arrow_schema(table)
    return [pa.array([row[place] for row in rows], field.type) for place, field in enumerate(schema)]


def outcome(now: Time, data: Mapping[str, Any]) -> dict[str, Any]:
    """The entry of an aircraft whose outcome was noted, as its ground station reports it."""
    return {"state": data.get("state"), "reason": data.get("reason"), "finished_s": to_seconds(now)}


def outcomes(
    vehicles: Iterable[str], noted: Mapping[str, dict[str, Any]], crashes: Mapping[str, Time]
) -> dict[str, dict[str, Any]]:
    """One entry for every declared aircraft and for every other aircraft with a noted outcome.

    `noted` are outcomes as ground stations report them, `crashes` the times of the first crashes by aircraft. A mission
    whose aircraft has crashed is not complete, whatever its ground station reports: a station takes a disarmed
    autopilot for a landed aircraft.
    """
    unfinished: dict[str, Any] = {"state": UNFINISHED, "reason": "", "finished_s": None}
    entries = {vehicle: dict(noted.get(vehicle, unfinished)) for vehicle in [*dict.fromkeys([*vehicles, *noted])]}
    for vehicle, entry in entries.items():
        if entry["state"] == COMPLETE and vehicle in crashes:
            reason = f"crashed at {to_seconds(crashes[vehicle]):.1f} s; its ground station reported complete"
            entry |= {"state": FAILED, "reason": reason}
    return entries


def outcomes_of_events(
    vehicles: Iterable[str], events: Iterable[tuple[Time, str, str, Mapping[str, Any]]]
) -> dict[str, dict[str, Any]]:
    """`outcomes` of events in the order in which they were recorded: time, kind, about, details."""
    noted: dict[str, dict[str, Any]] = {}
    crashes: dict[str, Time] = {}
    for now, kind, about, data in events:
        if kind == OUTCOME:
            noted[about] = outcome(now, data)
        elif kind == CRASH:
            crashes.setdefault(about, now)
    return outcomes(vehicles, noted, crashes)


def vehicle_ids(manifest: Mapping[str, Any]) -> list[str]:
    """Range-wide ids of the manifest's vehicles."""
    rows = manifest.get("vehicles") or []
    return [str(row["id"]) if "/" in str(row["id"]) else f"{row.get('operator')}/{row['id']}" for row in rows]
