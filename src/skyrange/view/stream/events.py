"""Events in the viewer's stream: tables of what happened in an arm, as columns whose texts have numbers."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from skyrange.core.time import NS_PER_S
from skyrange.metrics.safety import Mishap
from skyrange.metrics.time_series import RecordedNote, labelled_acts, read_notes
from skyrange.record import RunRecord
from skyrange.record.notes import parse_details
from skyrange.record.read.observations import KEPT_NS
from skyrange.record.schema import unit_of
from skyrange.view.stream.messages import EVENTS, Message

TEXTS: Final[Mapping[str, Sequence[str]]] = {
    "notes": ("table", "kind", "about", "source", "text"),
    "acts": ("author", "attack", "actor", "action", "about"),
    "alerts": ("detector", "kind", "subject", "text"),
    "mishaps": ("kind", "text"),
    "modes": ("mode",),
    "status": (),
    "claims": ("uas",),
    "receptions": (),
}
"""The tables, and which of their columns are texts."""
MERGED_NS: Final = NS_PER_S // 5
"""Acts alike that follow one another within this time are one row."""

STATUS_FIELDS: Final = {
    "SYS_STATUS": ("battery_remaining", "charge", 0.01),
    "MISSION_CURRENT": ("seq", "item", 1.0),
}
"""Messages that tell an aircraft's status: field, name in the table `status`, scale."""
_BROADCAST_COLUMNS: Final = [
    "time_ns", "receiver", "radio", "rssi_dbm", "frame", "uas_id", "east_m", "north_m", "up_m", "height_m",
]  # fmt: skip
_MANY_SEEN: Final = 100_000

Row = dict[str, Any]
Tables = dict[str, list[Row]]


@dataclass
class EventTables:
    """Rows of an arm by table; each has its time `t` in seconds, and all tables are in order of time."""

    rows: Tables = field(default_factory=lambda: {name: [] for name in TEXTS})

    def between(self, from_s: float, until_s: float) -> EventTables:
        """The rows from one time up to another, which is excluded."""
        times = {name: [row["t"] for row in rows] for name, rows in self.rows.items()}
        cut = {name: np.searchsorted(some, [from_s, until_s]).tolist() for name, some in times.items()}
        return EventTables({name: rows[slice(*cut[name])] for name, rows in self.rows.items()})

    def omit(self, tables: Sequence[str]) -> EventTables:
        """The same without the rows of some tables."""
        return EventTables({name: [] if name in tables else rows for name, rows in self.rows.items()})

    def encode(self, arm: int, from_s: float, until_s: float) -> Message:
        """As a message, without tables that have no rows."""
        names: dict[str, int] = {}
        head: dict[str, Any] = {"arm": arm, "from_s": from_s, "until_s": until_s}
        for table, rows in self.rows.items():
            if rows:
                head[table] = {
                    column: [names.setdefault(row[column], len(names)) for row in rows]
                    if column in TEXTS[table]
                    else [row[column] for row in rows]
                    for column in rows[0]
                }
        return Message(EVENTS, head | {"names": list(names)})

    @classmethod
    def decode(cls, message: Message) -> EventTables:
        """The tables of a message of events."""
        head, found = message.head, cls()
        for table, texts in TEXTS.items():
            columns = {
                column: [head["names"][number] for number in values] if column in texts else values
                for column, values in head.get(table, {}).items()
            }
            found.rows[table] = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
        return found


def read_events(record: RunRecord, nodes: Mapping[str, int], mishaps: Sequence[Mishap]) -> EventTables:
    """All events of a run; `nodes` are the places of aircraft and radios by id."""
    found = EventTables()
    notes = {name: read_notes(record, name) for name in ("events", "decisions")}
    rows = found.rows
    rows["notes"] = describe_notes(notes)
    rows["modes"] = describe_modes(notes["events"], nodes)
    rows["acts"] = merge_acts(labelled_acts(record))
    rows["alerts"] = [describe_alert(row) for row in record.table("alerts").sort_by("time_ns").to_pylist()]
    rows["mishaps"] = [describe_mishap(mark) for mark in mishaps]
    if record.keeps("frames"):
        rows["status"] = StatusTable(nodes).rows(_read_status(record))
    if record.keeps("observations"):
        rows["claims"], rows["receptions"] = _read_broadcasts(record, nodes)
    return found


def merge_acts(acts: Sequence[RecordedNote]) -> list[Row]:
    """Rows of labelled acts in order of time; acts alike that follow one another are one."""
    rows: list[Row] = []
    newest: dict[tuple[str, ...], Row] = {}
    for act in acts:
        author, _, action = act.kind.partition(".")
        attack = str(act.data.get("fault") or act.data.get("attack") or "")
        key = (author, attack, act.source, action, act.about)
        row, t = newest.get(key), _seconds(act.time_ns)
        if row is not None and t - row["until"] <= MERGED_NS / NS_PER_S:
            row["n"], row["until"] = row["n"] + 1, t
            continue
        texts = dict(zip(TEXTS["acts"], key, strict=True))
        newest[key] = {"t": t, **texts, "n": 1, "until": t}
        rows.append(newest[key])
    return rows


def _seconds(time_ns: int) -> float:
    return round(time_ns / NS_PER_S, 3)


def describe_notes(notes: Mapping[str, Sequence[RecordedNote]]) -> list[Row]:
    """Rows of `notes`, of `events` and `decisions` by table."""
    rows = [
        {
            "t": _seconds(row.time_ns),
            "table": table,
            "kind": row.kind,
            "about": row.about,
            "source": row.source,
            "text": _describe(row.data),
            "causes": len(row.causes),
        }
        for table, some in notes.items()
        for row in some
    ]
    return sorted(rows, key=lambda row: row["t"])


def describe_modes(events: Iterable[RecordedNote], nodes: Mapping[str, int]) -> list[Row]:
    """Rows of `modes`."""
    return [
        {"t": _seconds(row.time_ns), "vehicle": nodes[row.about], "mode": str(row.data.get("mode", "?"))}
        for row in events
        if row.kind == "event.mode" and row.about in nodes
    ]


def _describe(data: Mapping[str, Any]) -> str:
    """Details in words: the unit of a key's suffix follows its value."""
    return ", ".join(_describe_value(key, value) for key, value in data.items() if value not in ("", None))


def _describe_value(key: str, value: object) -> str:
    unit = unit_of(key) if isinstance(value, float | int) and not isinstance(value, bool) else ""
    words = (key.rpartition("_")[0] if unit else key).replace("_", " ")
    number = f"{value:.4g}" if isinstance(value, float) else str(value)
    return f"{words} {number}{' ' if unit else ''}{unit}"


def describe_alert(row: Mapping[str, Any]) -> Row:
    """A row of `alerts` from one of that table in the record."""
    data, score = parse_details(row["data"]), float(row["score"])
    texts = {"detector": row["detector"], "kind": row["kind"], "subject": row["subject"], "text": _describe(data)}
    return {"t": _seconds(row["time_ns"]), **texts, "score": score if np.isfinite(score) else 0.0}


def describe_mishap(mark: Mishap) -> Row:
    """A row of `mishaps`."""
    east_m, north_m, up_m = (round(value, 2) for value in mark.enu_m)
    where = {"e": east_m, "n": north_m, "u": up_m}
    return {"t": _seconds(mark.time_ns), "kind": mark.kind, **where, "text": mark.description}


class StatusTable:
    """Charge and mission item of each aircraft, as its station was told, where they changed."""

    def __init__(self, nodes: Mapping[str, int]) -> None:
        self._nodes = nodes
        self._newest: dict[str, tuple[float, float]] = {}

    def rows(self, told: Iterable[tuple[int, str, str, float]]) -> list[Row]:
        """Rows of `status` for what was told later than all before: time in ns, aircraft, `charge` or `item`, value."""
        rows: list[Row] = []
        for time_ns, vehicle, name, value in sorted(told):
            if vehicle not in self._nodes:
                continue
            charge, item = self._newest.get(vehicle, (-1.0, -1.0))
            state = (round(max(value, -1.0), 2), item) if name == "charge" else (charge, value)
            if self._newest.get(vehicle) != state:
                self._newest[vehicle] = state
                told_of = {"vehicle": self._nodes[vehicle], "charge": state[0], "item": int(state[1])}
                rows.append({"t": _seconds(time_ns), **told_of})
        return rows


def _read_status(record: RunRecord) -> Iterator[tuple[int, str, str, float]]:
    for message, (column, name, scale) in STATUS_FIELDS.items():
        table = record.telemetry(message, ["time_ns", "vehicle", column])
        values = (np.asarray(table.column(column).to_numpy(), dtype=np.float64) * scale).tolist()
        times, vehicles = table.column("time_ns").to_pylist(), table.column("vehicle").to_pylist()
        yield from ((time, vehicle, name, value) for time, vehicle, value in zip(times, vehicles, values, strict=True))


class BroadcastTables:
    """What decoded broadcasts claimed, each once, and who decoded them. Without a place, they claim nothing."""

    def __init__(self, nodes: Mapping[str, int]) -> None:
        self._nodes = nodes
        self._known = pa.array(list(nodes), pa.string())
        self._seen: dict[str, int] = {}
        """The broadcasts whose claim has a row, and the newest time at which they were decoded."""

    def rows(self, observations: pa.RecordBatch) -> tuple[list[Row], list[Row]]:
        """Rows of `claims` and of `receptions` for rows of `observations`, which are recorded later than all before."""
        nodes, claims, receptions = self._nodes, list[Row](), list[Row]()
        is_known = pc.and_(
            *(pc.is_in(observations.column(name), value_set=self._known) for name in ("radio", "receiver"))
        )
        newest = 0
        for row in observations.select(_BROADCAST_COLUMNS).filter(is_known).to_pylist():
            node, newest = nodes[row["radio"]], row["time_ns"]
            t, rssi = _seconds(newest), round(row["rssi_dbm"], 1)
            receptions.append({"t": t, "receiver": nodes[row["receiver"]], "node": node, "rssi": rssi})
            is_repeated = row["frame"] in self._seen
            self._seen[row["frame"]] = newest
            if is_repeated or row["east_m"] is None:
                continue
            up_m = row["up_m"] if row["up_m"] is not None else row["height_m"] or 0.0
            where = {"e": round(row["east_m"], 2), "n": round(row["north_m"], 2), "u": round(up_m, 2)}
            claims.append({"t": t, "node": node, "uas": row["uas_id"] or "", **where})
        if len(self._seen) > _MANY_SEEN:
            self._seen = {frame: t for frame, t in self._seen.items() if t >= newest - KEPT_NS}
        return claims, receptions


def _read_broadcasts(record: RunRecord, nodes: Mapping[str, int]) -> tuple[list[Row], list[Row]]:
    tables = BroadcastTables(nodes)
    claims, receptions = list[Row](), list[Row]()
    for batch in record.batches("observations", _BROADCAST_COLUMNS):
        more = tables.rows(batch)
        claims += more[0]
        receptions += more[1]
    return (sorted(claims, key=lambda row: row["t"]), sorted(receptions, key=lambda row: row["t"]))
