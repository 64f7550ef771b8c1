"""What the viewer asks of recorded runs beside their stream: frames on links of an aircraft, and recorded fields."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from skyrange.contracts.frames import Fate
from skyrange.core.errors import InputError
from skyrange.core.ids import FrameId
from skyrange.core.time import NS_PER_S
from skyrange.record import RunRecord
from skyrange.record.read.telemetry import FOLDER, message_schema
from skyrange.record.schema import arrow_schema
from skyrange.view.frame_texts import describe_payload
from skyrange.view.scan_queries import ScanQueries

POINTS: Final = 600
"""Points of a plot at most, twice over: the least and the largest value of each stretch of time."""
FRAMES_SHOWN: Final = 5
"""Newest frames of each direction of a link."""
MAX_FRAMES: Final = 2_000_000
"""Frames on the links of one aircraft that are kept in memory."""
_FORWARDED: Final = ", forwarded"
TABLES: Final = ("truth", "sensors")
"""Tables whose columns can be plotted, beside telemetry."""
_COLUMNS: Final = ("link", "direction", "sender", "serial", "src", "dst", "sent_ns", "fate", "parent")


class Series(NamedTuple):
    """A recorded field of an aircraft over time: `times_s` and `values` (n,), and its unit, which may be empty."""

    times_s: NDArray[np.float64]
    values: NDArray[np.float64]
    unit: str


Acts = Mapping[str, tuple[str, str]]
"""By frame id: who acted on it ("attack", "fault" or "harmless"), and how."""


class DirectedFrames(NamedTuple):
    """The frames on a link in one direction, in order of `times_ns` (n,), when they were sent."""

    link: str
    direction: str
    times_ns: NDArray[np.int64]
    frames: pa.Table


class RecordQueries:
    """Answers about the arms of a stream, by their numbers. All are values that JSON has; texts are as recorded."""

    def __init__(self, records: Sequence[RunRecord]) -> None:
        self._records = records
        self._frames = lru_cache(maxsize=4)(self._index_frames)
        self._series = lru_cache(maxsize=64)(self._read_series)
        self.scans = ScanQueries(records)
        self._acts = lru_cache(maxsize=2)(self._read_acts)

    def list_fields(self, arm: int) -> dict[str, list[list[str]]]:
        """The fields that can be plotted, `[name, unit]`, by table or MAVLink message."""
        record = self._record(arm)
        schemas = {name: arrow_schema(name) for name in TABLES if record.keeps(name) and record.rows(name)}
        if record.keeps(FOLDER):
            schemas |= {name: message_schema(name) for name in sorted(record.messages) if name != "BAD_DATA"}
        return {name: [[field.name, _unit_of(field)] for field in _plotted(schema)] for name, schema in schemas.items()}

    def read_series(self, arm: int, vehicle: str, source: str, field: str) -> dict[str, Any]:
        """A field of a table or a message over time, with at most `2 * POINTS` points: `t` in seconds, `v`, `unit`.

        Raises `InputError` for a field that the arm does not have.
        """
        found = self._series(arm, vehicle, source, field)
        times, values = _thin(found.times_s, found.values)
        told = [None if np.isnan(value) else value for value in values.tolist()]
        return {"t": np.round(times, 3).tolist(), "v": told, "unit": found.unit}

    def read_frames(self, arm: int, vehicle: str, until_s: float) -> dict[str, Any]:
        """The newest frames up to a time on each link of an aircraft, by link and direction, newest first.

        Of each: when it was sent (`t`), `src` and `dst` as it claims, `fate`, `name` of the message, its fields as a
        `text`, and which `act` is recorded of it, by `author` ("attack", "fault" or "harmless"). Raises `InputError`
        where the record has no frames, or too many.
        """
        groups: list[dict[str, Any]] = []
        acts, links = self._frames(arm, vehicle)
        for link, direction, times_ns, frames in links:
            end = int(np.searchsorted(times_ns, int(until_s * NS_PER_S), side="right"))
            rows = frames.slice(max(end - FRAMES_SHOWN, 0), min(end, FRAMES_SHOWN)).to_pylist()
            groups.append(
                {"link": link, "direction": direction, "frames": [_describe(row, acts) for row in reversed(rows)]}
            )
        groups.sort(key=lambda group: not group["link"].startswith("gcs:"))  # the way by which commands come
        return {"links": groups}

    def read_causes(self, arm: int, time_s: float, kind: str, about: str) -> dict[str, Any]:
        """The `frames` that caused a decision or an event, in order of time, as `read_frames` has them, with the `link`
        of each. Raises `InputError` where the record has no frames.
        """
        record = self._record(arm)
        self._require_frames(record)
        when = round(time_s * 1e3)
        wanted = {
            name
            for table in ("decisions", "events")
            for row in record.table(table, ["time_ns", "kind", "about", "causes"]).to_pylist()
            if abs(row["time_ns"] // 1_000_000 - when) <= 1 and (row["kind"], row["about"]) == (kind, about)
            for name in row["causes"] or ()
        }
        links = pa.array(sorted({name.partition("|")[0] for name in wanted}), pa.string())
        serials = pa.array(sorted({int(name.rpartition("|")[2]) for name in wanted}), pa.int64())
        found = []
        for batch in record.tables.frames_with_payloads(_COLUMNS) if wanted else ():
            chosen = pc.and_(pc.is_in(batch.column("link"), links), pc.is_in(batch.column("serial"), serials))
            found += [row for row in batch.filter(chosen).to_pylist() if _name_of(row) in wanted]
        acts = _spread_acts(self._acts(arm), pa.Table.from_pylist(found)) if found else {}
        return {
            "frames": [
                {"link": row["link"], **_describe(row, acts)} for row in sorted(found, key=lambda row: row["sent_ns"])
            ]
        }

    def _record(self, arm: int) -> RunRecord:
        if not 0 <= arm < len(self._records):
            raise InputError.one("viewer", "arm", arm, f"0 to {len(self._records) - 1}")
        return self._records[arm]

    def _read_series(self, arm: int, vehicle: str, source: str, field: str) -> Series:
        record = self._record(arm)
        if field not in [name for name, _ in self.list_fields(arm).get(source, ())]:
            expected = "a number that is recorded of this run"
            raise InputError.one("viewer", "field", f"{source}.{field}", expected)
        columns = ["time_ns", "vehicle", field]
        table = record.table(source, columns) if source in TABLES else record.telemetry(source, columns)
        mine = table.filter(pc.equal(table.column("vehicle"), vehicle)).sort_by("time_ns")
        values = mine.column(field).to_numpy(zero_copy_only=False).astype(np.float64)
        unit = _unit_of(table.schema.field(field))
        return Series(mine.column("time_ns").to_numpy() / NS_PER_S, values, unit)

    def _index_frames(self, arm: int, vehicle: str) -> tuple[Acts, list[DirectedFrames]]:
        """The frames on each directed link of an aircraft, and what is recorded of them or of what they forward."""
        record = self._record(arm)
        self._require_frames(record)
        found, count = [], 0
        for batch in record.tables.frames_with_payloads(_COLUMNS):
            names = [name for name in pc.unique(batch.column("link")).to_pylist() if name.partition(":")[2] == vehicle]
            if names:
                found.append(batch.filter(pc.is_in(batch.column("link"), pa.array(names))))
                count += found[-1].num_rows
            if count > MAX_FRAMES:
                raise InputError.one("viewer", "frames", f"more than {MAX_FRAMES:,}", "fewer of one aircraft")
        if not count:
            return {}, []
        frames = pa.concat_tables(found)
        acts = _spread_acts(self._acts(arm), frames)
        return acts, list(_divide(frames.sort_by([(name, "ascending") for name in ("link", "direction", "sent_ns")])))

    @staticmethod
    def _require_frames(record: RunRecord) -> None:
        if not record.keeps("frames"):
            expected = "full, the level that keeps frames"
            raise InputError.one("viewer", "level of the record", record.level, expected, "Fly it again at that level.")

    def _read_acts(self, arm: int) -> Acts:
        """By frame id: who acted on it, and how."""
        columns = ["attack", "action", "frame", "child", "benign", "fault"]
        acts: dict[str, tuple[str, str]] = {}
        for row in self._record(arm).table("labels", columns).to_pylist():
            author = "fault" if row["fault"] else "harmless" if row["benign"] else "attack"
            for name in filter(None, (row["frame"], row["child"])):
                acts[name] = author, f"{row['attack']}: {row['action']}"
        return acts


def _name_of(row: Mapping[str, Any]) -> str:
    return str(FrameId(row["link"], row["direction"], row["sender"], row["serial"]))


def _spread_acts(acts: Acts, frames: pa.Table) -> Acts:
    """`acts`, and what they make of frames that forward those that were acted on."""
    known = dict(acts)
    kept = frames.filter(frames.column("parent").is_valid()).sort_by("sent_ns") if acts else frames.slice(0, 0)
    for row in kept.select(["link", "direction", "sender", "serial", "parent"]).to_pylist():
        if row["parent"] in known:
            author, act = known[row["parent"]]
            known.setdefault(_name_of(row), (author, act if act.endswith(_FORWARDED) else act + _FORWARDED))
    return known


def _divide(frames: pa.Table) -> Iterator[DirectedFrames]:
    """Sorted frames by link and direction."""
    names = [frames.column(name).to_pylist() for name in ("link", "direction")]
    keys = list(zip(*names, strict=True))
    bounds = [0, *(row for row in range(1, len(keys)) if keys[row] != keys[row - 1]), len(keys)]
    for start, end in pairwise(bounds):
        part = frames.slice(start, end - start)
        link, direction = keys[start]
        yield DirectedFrames(link, direction, part.column("sent_ns").to_numpy(), part)


def _describe(row: Mapping[str, Any], acts: Acts) -> dict[str, Any]:
    """A frame as `RecordQueries.read_frames` tells it."""
    author, act = acts.get(_name_of(row), ("", ""))
    message, text = describe_payload(row["payload"])
    return {
        "t": round(row["sent_ns"] / NS_PER_S, 4), "src": row["src"], "dst": row["dst"], "sender": row["sender"],
        "fate": "" if row["fate"] == Fate.DELIVERED else row["fate"], "name": message,
        "text": text, "author": author, "act": act,
    }  # fmt: skip


def _plotted(schema: pa.Schema) -> list[pa.Field]:
    """Numbers other than the time."""
    types = pa.types
    return [
        field
        for field in schema
        if (types.is_integer(field.type) or types.is_floating(field.type))
        and field.name not in ("time_ns", "system_id", "component_id")
    ]


def _unit_of(field: pa.Field) -> str:
    metadata: Mapping[bytes, bytes] = field.metadata or {}
    return metadata.get(b"unit", b"").decode(errors="replace")


def _thin(times: NDArray[np.float64], values: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The least and the largest value of each stretch, where there are more than `2 * POINTS`."""
    if len(times) <= 2 * POINTS:
        return times, values
    stretch = ((times - times[0]) / max(times[-1] - times[0], 1e-9) * POINTS).astype(np.int64)
    order = np.lexsort((values, stretch))  # what is no number comes last, and is no largest value
    starts = np.flatnonzero(np.diff(stretch[order], prepend=-1))
    counts = np.bincount(stretch, weights=~np.isnan(values))[stretch[order][starts]].astype(np.int64)
    rows = np.unique(np.concatenate([order[starts], order[starts + np.maximum(counts - 1, 0)]]))
    return times[rows], values[rows]
