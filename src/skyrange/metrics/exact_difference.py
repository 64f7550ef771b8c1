"""Exact comparison of two runs: the first difference in each table, and the identity of a flight.

Rows are compared in an order that does not depend on how they were recorded: frames by time of sending, link,
direction, sender and serial, truth by time and vehicle. Both runs are read once, in parallel, with bounded memory. If
truth differs, positions are read a second time.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from skyrange.codec.mavlink import message_name
from skyrange.core.ids import FrameId
from skyrange.core.time import to_seconds
from skyrange.metrics.aircraft import DEPARTED_M, departures, read_ticks
from skyrange.metrics.time_series import vehicles
from skyrange.record.digests import combine_digests
from skyrange.record.read.run import RunRecord, load
from skyrange.record.read.time_order import sort_by_time
from skyrange.record.schema import DERIVED, TABLES
from skyrange.record.verification import verify_run

_KEYS: dict[str, tuple[str, ...]] = {
    "frames": ("sent_ns", "link", "direction", "sender", "serial"),
    "truth": ("time_ns", "vehicle"),
    "events": ("time_ns", "about", "source", "kind", "data"),
    "decisions": ("time_ns", "about", "source", "kind", "data"),
    "labels": ("at_ns", "attack", "actor", "action", "frame"),
}
"""The tables that are compared row by row, with the columns that order and identify rows, first a time in ns."""

_FEATURES = ("time_ns", "link", "direction")
"""The same for `features`, which are compared if one of the runs has no frames."""

_COUNTED = [name for name in TABLES if name not in DERIVED and name != "payloads"]
"""Derived tables and payloads are left out: they follow from the others, however payloads were de-duplicated."""


@dataclass(frozen=True, slots=True)
class RowDifference:
    """The first row of one table in which two runs differ.

    `only_in` is "a" or "b" if the other run has no such row; otherwise `columns` has (a's value, b's value) of each
    column that differs. Values are JSON values; bytes are hexadecimal.
    """

    table: str
    time_ns: int
    row: str
    only_in: str | None
    columns: Mapping[str, tuple[Any, Any]]

    def __str__(self) -> str:
        start = f"{self.table}: first at {to_seconds(self.time_ns):.6f} s, {self.row}"
        if self.only_in:
            return f"{start}: only in {self.only_in}"
        cells = [f"    {name}: {_short(name, a)} | {_short(name, b)}" for name, (a, b) in self.columns.items()]
        return "\n".join([start, *cells])


@dataclass(frozen=True, slots=True)
class Difference:
    """The result of a comparison. `a` and `b` are the folders, `statuses` how each run ended; pairs are (a's, b's)."""

    a: str
    b: str
    same: bool
    statuses: tuple[str, str]
    counts: Mapping[str, tuple[int, int]]
    digests: Mapping[str, tuple[str | None, str | None]]
    first: Mapping[str, RowDifference]
    outcomes: Mapping[str, tuple[Any, Any]]
    columns: Mapping[str, tuple[list[str], list[str]]]
    numeric: tuple[str | None, str | None]
    unverified: tuple[tuple[str, ...], tuple[str, ...]]
    """What is not as the run's own manifest says (`record.verification`); such runs are never the same."""
    uncompared: Mapping[str, str]
    """By table, why its rows are not compared: a run's level leaves it out. The digests of frames and truth tell
    whether they are equal; of runs that did not end nothing does, and these are not the same.
    """
    apart: Mapping[str, tuple[float, float | None]]
    """By aircraft, the largest distance in metres between its positions in the two runs at the same time, and when in
    seconds it first exceeded `DEPARTED_M`; empty if truth is the same or the fleets differ."""

    @property
    def first_frame(self) -> RowDifference | None:
        """The first frame that differs."""
        return self.first.get("frames")

    @property
    def first_truth(self) -> RowDifference | None:
        """The first truth row that differs."""
        return self.first.get("truth")

    def to_dict(self) -> dict[str, Any]:
        """The result as JSON values."""
        return asdict(self)

    def __str__(self) -> str:
        lines = [f"a: {self.a} ({self.statuses[0]})", f"b: {self.b} ({self.statuses[1]})"]
        for side, problems in zip("ab", self.unverified, strict=True):
            lines += [f"{side} is not as its manifest says: {problem}" for problem in problems]
        lines += [self._describe_uncompared(table, why) for table, why in self.uncompared.items()]
        if self.same:
            rows = ", ".join(f"{count} {name}" for name, (count, _) in self.counts.items() if count)
            return "\n".join([*lines, f"the same: {rows or 'both empty'}"])
        lines += [str(self.first[table]) for table in ("frames", "truth") if table in self.first]
        others = [row for table, row in self.first.items() if table not in ("frames", "truth")]
        lines += [str(row) for row in sorted(others, key=_time)]
        lines += [f"rows of {name}: {a} | {b}" for name, (a, b) in self.counts.items() if a != b]
        for name, (a, b) in self.columns.items():
            lines.append(f"columns of {name}: only in a {', '.join(a) or '-'}; only in b {', '.join(b) or '-'}")
        lines += [_apart(vehicle, *distance) for vehicle, distance in self.apart.items() if distance[0] > 0.0]
        lines += [f"outcome of {vehicle}: {_outcome(a)} | {_outcome(b)}" for vehicle, (a, b) in self.outcomes.items()]
        if self.numeric[0] != self.numeric[1]:
            lines.append(f"numeric platforms differ: {self.numeric[0]} | {self.numeric[1]}")
        return "\n".join(lines)

    def _describe_uncompared(self, table: str, why: str) -> str:
        first_digest, second_digest = self.digests.get(table, (None, None))
        known = (
            ""
            if first_digest is None or second_digest is None
            else f"; the digests {'are equal' if first_digest == second_digest else 'differ'}"
        )
        return f"{table} not compared: {why}{known}"


def diff(a: RunRecord | Path | str, b: RunRecord | Path | str) -> Difference:
    """Compare two runs, complete or killed; raises `InputError` for a folder that is not a run's.

    Runs that ended are verified first. Frames and truth of two that are as their manifests say are not compared row by
    row if their digests are equal. A table that one of the runs does not keep is not compared; if that is frames,
    features are, where both have them.
    """
    left, right = (run if isinstance(run, RunRecord) else load(run) for run in (a, b))
    digests = {
        name: (_digest(left, name), _digest(right, name)) for name in ("events", "frames", "truth", "fingerprint")
    }
    unverified = _unverified(left), _unverified(right)
    first: dict[str, RowDifference] = {}
    columns: dict[str, tuple[list[str], list[str]]] = {}
    uncompared = {
        table: " and ".join(
            f"{side} has none (level {run.level})"
            for side, run in zip("ab", (left, right), strict=True)
            if not run.keeps(table)
        )
        for table in _COUNTED
        if not (left.keeps(table) and right.keeps(table))
    }
    tables = [table for table in _KEYS if table not in uncompared]
    if "frames" in uncompared and left.keeps("features") and right.keeps("features"):
        tables.append("features")
    for table in tables:
        first_columns, second_columns = (set(run.tables.schema(table).names) for run in (left, right))
        if first_columns != second_columns:
            columns[table] = sorted(first_columns - second_columns), sorted(second_columns - first_columns)
        known = digests.get(table, (None, None)) if table in ("frames", "truth") else (None, None)
        if known[0] is None or known[0] != known[1] or any(unverified):
            difference = _first_difference(table, left, right, first_columns & second_columns)
            if difference is not None:
                first[table] = difference
    counts = {name: (left.rows(name), right.rows(name)) for name in _COUNTED if name not in uncompared}
    ends = left.outcomes, right.outcomes
    outcomes = {
        vehicle: (ends[0].get(vehicle), ends[1].get(vehicle))
        for vehicle in sorted({*ends[0], *ends[1]})
        if ends[0].get(vehicle) != ends[1].get(vehicle)
    }
    return Difference(
        a=str(left.path),
        b=str(right.path),
        same=not (first or outcomes or columns or any(unverified))
        and all(digests[name][0] and not _differ(digests[name]) for name in ("frames", "truth") if name in uncompared)
        and all(first_count == second_count for first_count, second_count in counts.values()),
        statuses=(left.status, right.status),
        counts=counts,
        digests=digests,
        first=first,
        outcomes=outcomes,
        columns=columns,
        numeric=(_numeric(left), _numeric(right)),
        unverified=unverified,
        uncompared=uncompared,
        apart=_distances(left, right) if "truth" in first else {},
    )


def _differ(pair: tuple[str | None, str | None] | None) -> bool:
    return pair is not None and pair[0] != pair[1]


def _unverified(run: RunRecord) -> tuple[str, ...]:
    return verify_run(run).problems if _digest(run, "fingerprint") is not None else ()


def _distances(a: RunRecord, b: RunRecord) -> dict[str, tuple[float, float | None]]:
    names = [vehicle.id for vehicle in vehicles(a)]
    if not names or names != [vehicle.id for vehicle in vehicles(b)]:
        return {}
    away_m, first_ns = departures(read_ticks(a), read_ticks(b))
    moments = [to_seconds(ns) if ns >= 0 else None for ns in first_ns.tolist()]
    return dict(zip(names, zip(away_m.tolist(), moments, strict=True), strict=True))


def _apart(vehicle: str, away_m: float, first_s: float | None) -> str:
    when = f", more than {DEPARTED_M:g} m from {first_s:.2f} s on" if first_s is not None else ""
    return f"{vehicle}: up to {away_m:.3g} m apart{when}"


def _first_difference(table: str, a: RunRecord, b: RunRecord, columns: set[str]) -> RowDifference | None:
    keys = _keys_of(table)
    streams = _ordered(table, a, columns), _ordered(table, b, columns)
    held: list[Any] = [None, None]
    while True:
        for side in (0, 1):
            if held[side] is None or not held[side].num_rows:
                held[side] = next(streams[side], None)
        left, right = held
        if left is None or right is None:
            if left is None and right is None:
                return None
            rest = left if right is None else right
            return _missing_row(table, keys, rest.slice(0, 1).to_pylist()[0], "a" if right is None else "b")
        rows = min(left.num_rows, right.num_rows)
        place = _first_unequal_row(left.slice(0, rows), right.slice(0, rows))
        if place is not None:
            return _row_difference(
                table, keys, left.slice(place, 1).to_pylist()[0], right.slice(place, 1).to_pylist()[0]
            )
        held = [left.slice(rows), right.slice(rows)]


def _ordered(table: str, run: RunRecord, columns: set[str]) -> Iterator[pa.Table]:
    """The common columns of a table in canonical order; frames have payloads instead of payload ids."""
    names = [name for name in run.tables.schema(table).names if name in columns and name != "payload_id"]
    keys = _keys_of(table)
    names = [*keys, *sorted(name for name in names if name not in keys)]

    def tables() -> Iterator[pa.Table]:
        if table == "frames":
            source = run.tables.frames_with_payloads(names)
        else:
            source = (pa.Table.from_batches([batch]) for batch in run.batches(table, names))
        for batch in source:
            if "causes" in names:
                place = batch.schema.get_field_index("causes")
                batch = batch.set_column(place, "causes", pc.binary_join(batch.column("causes"), " "))
            yield batch

    return sort_by_time(tables, keys[0], keys[1:])


def _keys_of(table: str) -> tuple[str, ...]:
    return _FEATURES if table == "features" else _KEYS[table]


def _first_unequal_row(a: pa.Table, b: pa.Table) -> int | None:
    places = []
    for name in a.column_names:
        if a.column(name).equals(b.column(name)) and not pa.types.is_floating(a.column(name).type):
            continue
        rows = np.flatnonzero(_unequal(a.column(name).combine_chunks(), b.column(name).combine_chunks()))
        if len(rows):
            places.append(int(rows[0]))
    return min(places, default=None)


def _unequal(a: pa.Array, b: pa.Array) -> NDArray[np.bool_]:
    """Mask of differing rows: floats differ if their bits do; a null differs from every value."""
    if pa.types.is_floating(a.type):
        bits: NDArray[np.bool_] = a.to_numpy(zero_copy_only=False).view(np.int64) != b.to_numpy(
            zero_copy_only=False
        ).view(np.int64)
        return bits
    values = pc.fill_null(pc.not_equal(a, b), fill_value=False)
    gaps = pc.xor(pc.is_null(a), pc.is_null(b))
    result: NDArray[np.bool_] = pc.or_(values, gaps).to_numpy(zero_copy_only=False)
    return result


def _row_difference(table: str, keys: tuple[str, ...], a: dict[str, Any], b: dict[str, Any]) -> RowDifference:
    first_key, second_key = tuple(a[key] for key in keys), tuple(b[key] for key in keys)
    if first_key < second_key:
        return _missing_row(table, keys, a, "a")
    if second_key < first_key:
        return _missing_row(table, keys, b, "b")
    cells = {name: (_value(a[name]), _value(b[name])) for name in a if not _alike(a[name], b[name])}
    return RowDifference(table, int(first_key[0]), _name(table, a), None, cells)


def _missing_row(table: str, keys: tuple[str, ...], row: dict[str, Any], side: str) -> RowDifference:
    return RowDifference(table, int(row[keys[0]]), _name(table, row), side, {})


def _name(table: str, row: Mapping[str, Any]) -> str:
    """The name of a row for people: of a frame, its id and message."""
    if table == "frames":
        what = message_name(row["payload"]) or f"{len(row['payload'])} bytes"
        return f"{FrameId(row['link'], row['direction'], row['sender'], row['serial'])} ({what})"
    if table == "truth":
        return str(row["vehicle"])
    return " ".join(str(row[key]) for key in _keys_of(table)[1:])


def _alike(a: object, b: object) -> bool:
    if isinstance(a, float) and isinstance(b, float):
        return a.hex() == b.hex()
    return a == b


def _value(value: Any) -> Any:
    """A value as JSON can represent it: bytes in hexadecimal, infinities and not-a-number as text."""
    if isinstance(value, bytes):
        return value.hex()
    return str(value) if isinstance(value, float) and not np.isfinite(value) else value


def _short(column: str, value: Any) -> str:
    text = str(value)
    if column != "payload":
        return text
    name = message_name(bytes.fromhex(text))
    return (f"{name} " if name else "") + (text if len(text) <= 64 else text[:64] + "…")


def _digest(run: RunRecord, name: str) -> str | None:
    digest = (run.manifest.get("digests") or {}).get(name) if run.ended and not run.tables.spooled else None
    return str(digest) if digest else None


def _numeric(run: RunRecord) -> str | None:
    platform = run.manifest.get("platform")
    numeric = platform.get("numeric") if isinstance(platform, dict) else None
    return str(numeric) if numeric else None


def _outcome(entry: Any) -> str:
    if not isinstance(entry, dict):
        return "none"
    reason = f" ({entry['reason']})" if entry.get("reason") else ""
    when = f" at {entry['finished_s']} s" if entry.get("finished_s") is not None else ""
    return f"{entry.get('state')}{when}{reason}"


def _time(row: RowDifference) -> int:
    return row.time_ns


def identify_flight(manifest: Mapping[str, Any]) -> str:
    """32 hex digits over the exact digests of all frames and of all positions of a run; "" for a run without digests.

    The digest of events is left out: an attack that is muted is not part of a flight, nor is when it would have begun.
    """
    digests = manifest.get("digests") or {}
    parts = [str(digests.get(name, "")) for name in ("frames", "truth")]
    return combine_digests(parts) if all(parts) else ""


def repeats_to_the_byte(manifest: Mapping[str, Any]) -> bool:
    """Whether a run, flown again, would be the same to the byte: it was virtual, and its engines and medium say so.

    Of a record of a version that did not ask them, the builtin ones are known to be.
    """
    parts = [*(manifest.get("engines") or ()), *([manifest["medium"]] if manifest.get("medium") else [])]
    repeatable = (part.get("repeatable", "bytes" if part.get("kind") == "builtin" else "outcome") for part in parts)
    return not manifest.get("live") and all(what == "bytes" for what in repeatable)
