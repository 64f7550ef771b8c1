"""Log messages of what was noted in a run: events, decisions, labels of hostile acts, and alerts of detectors."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

import pyarrow as pa

from skyrange.export.foxglove_schemas import LOG
from skyrange.export.timed_message import TimedMessage, time_json
from skyrange.record.read.run import RunRecord
from skyrange.record.read.time_order import sort_by_time

INFO: Final = 2
WARNING: Final = 3
ERROR: Final = 4

TOPICS: Final = {
    "events": "/log/events",
    "decisions": "/log/decisions",
    "labels": "/log/labels",
    "alerts": "/log/alerts",
}
"""The topic of the rows of each table."""

_LEVELS: Final = {
    "event.crash": ERROR,
    "event.collision": ERROR,
    "event.autopilot_lost": ERROR,
    "event.attack_start": WARNING,
    "event.fault_start": WARNING,
    "event.fence_breach": WARNING,
    "event.battery": WARNING,
    "event.ekf_failsafe": WARNING,
    "event.link_down": WARNING,
    "decision.approval_rejected": WARNING,
    "decision.rejected": WARNING,
    "decision.link_lost": WARNING,
    "decision.gave_up": ERROR,
    "decision.failed": ERROR,
}
"""The level of a kind of note; of others `INFO`."""

_Said = tuple[int, str, str]
"""Level, name and text."""


def log_messages(record: RunRecord, table: str, start_ns: int) -> Iterator[TimedMessage]:
    """The rows of a table of `TOPICS` in order of time, with bounded memory; none if the run's level leaves it out."""
    if not record.keeps(table):
        return
    key = "at_ns" if table == "labels" else "time_ns"
    describe = _DESCRIBED[table]

    def rows() -> Iterator[pa.Table]:
        return (pa.Table.from_batches([batch]) for batch in record.batches(table))

    for sorted_rows in sort_by_time(rows, key, ()):
        for row in sorted_rows.to_pylist():
            level, name, text = describe(row)
            said = (
                f'{{"timestamp":{time_json(start_ns + row[key])},"level":{level},'
                f'"message":{json.dumps(text, ensure_ascii=False)},"name":{json.dumps(name, ensure_ascii=False)}}}'
            )
            yield TimedMessage(row[key], TOPICS[table], LOG, said)


def _describe_note(row: Mapping[str, Any]) -> _Said:
    return _LEVELS.get(row["kind"], INFO), row["source"], _joined(f"{row['about']}: {row['kind']}", row["data"])


def _describe_label(row: Mapping[str, Any]) -> _Said:
    words = [f"{row['attack']}: {row['action']} {row['frame']}"]
    if row["child"]:
        words.append(f"by {row['child']}")
    if row["until_ns"] is not None:
        words.append(f"until {row['until_ns'] / 1e9:.6f} s")
    marks = ("harmless_intrusion", "benign", "fault")
    mark = next((mark for mark in marks if row.get(mark)), "")  # older records have no such columns
    words += [f"({mark.replace('_', ' ')})"] if mark else []
    return INFO if mark else WARNING, row["actor"], " ".join(words)


def _describe_alert(row: Mapping[str, Any]) -> _Said:
    return WARNING, row["detector"], _joined(f"{row['subject']}: {row['kind']} {row['score']:g}", row["data"])


def _joined(text: str, data: str | None) -> str:
    return text if data in (None, "", "{}") else f"{text} {data}"


_DESCRIBED: Final[Mapping[str, Callable[[Mapping[str, Any]], _Said]]] = {
    "events": _describe_note,
    "decisions": _describe_note,
    "labels": _describe_label,
    "alerts": _describe_alert,
}
