"""The viewer's stream of a run whose rows are handed over as they are recorded."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from time import monotonic
from typing import Any, Final, TypeVar

import pyarrow as pa

from skyrange.core.time import NEVER, NS_PER_S, Time
from skyrange.metrics.approvals import ClaimReader
from skyrange.metrics.paths import WaypointReader
from skyrange.metrics.safety import find_mishaps, mishap_kind
from skyrange.metrics.time_series import RecordedNote, read_label_rows, read_note_rows
from skyrange.record import RunRecord
from skyrange.record.read.tables import decode_spooled
from skyrange.record.schema import arrow_schema
from skyrange.record.write.rows.ticks import split_ticks
from skyrange.view.stream.events import (
    BroadcastTables,
    EventTables,
    Row,
    StatusTable,
    describe_alert,
    describe_mishap,
    describe_modes,
    describe_notes,
    merge_acts,
)
from skyrange.view.stream.frame_reader import TABLES, FrameReader, Told
from skyrange.view.stream.held import HeldPositions
from skyrange.view.stream.messages import Message
from skyrange.view.stream.recorded import STEP_NS
from skyrange.view.stream.scene import ArmRecord, Plans, Span, make_scene, plan_scene
from skyrange.view.stream.truth_window import TruthWindow

SCENES_S: Final = 1.0
"""Wall time between two scenes that differ in missions or volumes."""
_NOTES: Final = ("events", "decisions")
_Item = TypeVar("_Item")


class GrowingStream:
    """Makes messages of the rows of one run, which one recorder has written or several have.

    A row is in a message once positions up to its time are, and later where it is handed over later.
    """

    def __init__(self, record: RunRecord, publish: Callable[[Message], None]) -> None:
        """`record` is that of the run that begins; scenes are made of its manifest and its city."""
        name = str(record.manifest.get("name") or record.path.name)
        self._arm = ArmRecord("run", name, record)
        self._publish = publish
        end_ns = round(float(record.manifest.get("duration_s") or 0.0) * NS_PER_S)
        self._planned_end_ns = end_ns or NEVER
        self._scene = make_scene([self._arm], Span(0, 1), name=name, plans=[Plans()])
        vehicles = [row["id"] for row in self._scene.head["vehicles"]]
        places = {vehicle: place for place, vehicle in enumerate(vehicles)}
        self._nodes = places | {row["id"]: len(places) + n for n, row in enumerate(self._scene.head["radios"])}
        self._places = places
        self._frames: dict[int, FrameReader] = {}
        """By number of the recorder."""
        self._truth = TruthWindow(places, STEP_NS)
        self._held: list[HeldPositions] = []
        self._waypoints, self._claims = WaypointReader(record.manifest), ClaimReader(record.manifest)
        self._status, self._broadcasts = StatusTable(self._nodes), BroadcastTables(self._nodes)
        self._told = Told()
        self._notes: dict[str, list[RecordedNote]] = {table: [] for table in _NOTES}
        self._acts: list[RecordedNote] = []
        self._alerts: list[Mapping[str, Any]] = []
        self._rows: dict[str, list[Row]] = {"claims": [], "receptions": []}
        self._until_s = 0.0
        self._plans_changed = False
        self._scene_due_s = 0.0
        self._publish(self._describe_scene(0, flying=True, whole=True))

    def add(self, table: str, batch: pa.RecordBatch, recorder: int = 0) -> None:
        """Take rows as `RowReader.add` does, of one of the recorders."""
        if table == "truth" and batch.num_rows:
            self._truth.add(split_ticks(batch), recorder)
        elif table in TABLES:
            if recorder not in self._frames:
                self._frames[recorder] = FrameReader(self._arm.record.manifest, self._places)
            self._frames[recorder].add(table, batch)
        elif table in _NOTES:
            self._notes[table] += read_note_rows(_rows_of(table, batch))
        elif table == "labels":
            self._acts += read_label_rows(_rows_of(table, batch))
        elif table == "alerts":
            self._alerts += _rows_of(table, batch)

    def complete(self) -> None:
        """Publish what is known of the time up to the newest position."""
        for frames in self._frames.values():
            told = frames.take()
            for layer, reports in told.reports.items():
                self._told.reports[layer] += reports
            self._told.status += told.status
            self._told.planned += told.planned
            self._told.approvals += told.approvals
            self._told.observations += told.observations
        newest = self._truth.newest_ns
        if newest is None or self._truth.start_ns is None:
            return
        self._publish_positions(self._truth.start_ns, newest)
        self._publish_events(newest, newest / NS_PER_S)
        if self._plans_changed and monotonic() >= self._scene_due_s:
            self._scene_due_s = monotonic() + SCENES_S
            self._plans_changed = False
            self._publish(self._describe_scene(newest, flying=True))

    def end(self, status: str, end_s: float | None = None) -> None:
        """Publish the rest of a run that has ended, and its last scene; without its end, that of the newest row."""
        self.complete()
        self._publish_events(NEVER, self._until_s if end_s is None else end_s)
        self._publish_last_scene(status, self._until_s)

    def break_off(self, status: str) -> None:
        """Publish the last scene of what has been published."""
        self._publish_last_scene(status, self._until_s)

    def _publish_last_scene(self, status: str, end_s: float) -> None:
        self._arm = ArmRecord(self._arm.id, self._arm.title, self._arm.record, status)
        self._publish(self._describe_scene(round(end_s * NS_PER_S), flying=False))

    def _publish_positions(self, start: Time, newest: Time) -> None:
        if not self._held:
            count = len(self._scene.head["vehicles"])
            self._held = [HeldPositions(layer, count, start, STEP_NS) for layer in self._told.reports]
        layers = [self._truth.take()]
        for held, reports in zip(self._held, self._told.reports.values(), strict=True):
            for some in reports:
                held.add(some)
            reports.clear()
            layers.append(held.take(newest))
        for samples in layers:
            if samples is not None:
                self._publish(samples.encode())

    def _publish_events(self, horizon: Time, until_s: float) -> None:
        """Publish the rows up to the horizon in ns, as those of the time until `until_s`."""
        tables = self._take_events(horizon)
        times = [row["t"] for rows in tables.rows.values() if rows for row in (rows[0], rows[-1])]
        if times:
            until_s = max(until_s, *times)
            self._publish(tables.encode(0, min(self._until_s, *times), until_s))
        self._until_s = until_s

    def _take_events(self, horizon: Time) -> EventTables:
        found = EventTables()
        notes = {table: _take(self._notes[table], lambda row: row.time_ns, horizon) for table in _NOTES}
        events = notes["events"]
        tracks = self._truth.tracks({row.about.split(".", 1)[0] for row in events if mishap_kind(row)})
        rows = found.rows
        rows["notes"], rows["modes"] = describe_notes(notes), describe_modes(events, self._nodes)
        rows["mishaps"] = [describe_mishap(mark) for mark in find_mishaps(events, tracks)]
        rows["acts"] = merge_acts(_take(self._acts, lambda row: row.time_ns, horizon))
        rows["alerts"] = [describe_alert(row) for row in _take(self._alerts, lambda row: row["time_ns"], horizon)]
        rows["status"] = self._status.rows(_take(self._told.status, lambda row: row[0], horizon))
        for batch in self._told.observations:
            for table, more in zip(self._rows, self._broadcasts.rows(batch), strict=True):
                self._rows[table] += more
        self._told.observations.clear()
        for table, waiting in self._rows.items():
            rows[table] = _take(waiting, lambda row: row["t"], horizon / NS_PER_S)
        for _, link, payload in _take(self._told.planned, lambda row: row[0], horizon):
            self._plans_changed |= self._waypoints.add(link, payload)
        approvals = _take(self._told.approvals, lambda row: row[:2], (horizon, "~"))
        for arrived, direction, payload in approvals:
            self._claims.add(direction, arrived, payload)
        self._plans_changed |= bool(approvals)
        return found

    def _describe_scene(self, newest: Time, *, flying: bool, whole: bool = False) -> Message:
        plans = Plans(self._waypoints.waypoints, self._claims.claims, self._waypoints.items)
        span = Span(self._truth.start_ns or 0, max(newest, 1))
        shown_until = self._planned_end_ns if flying else span.end_ns
        scene = plan_scene(self._scene, [self._arm], [plans], span, shown_until=shown_until)
        arms = [{**scene.head["arms"][0], "status": "running"}] if flying else scene.head["arms"]
        return Message(scene.kind, scene.head | {"flying": flying, "arms": arms}, self._scene.arrays if whole else {})


def _rows_of(table: str, batch: pa.RecordBatch) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = decode_spooled(batch, arrow_schema(table)).to_pylist()
    return rows


def _take(waiting: list[_Item], key: Callable[[_Item], Any], until: Any) -> list[_Item]:
    """Those up to a time in order of time, which wait no longer."""
    due = [row for row in waiting if key(row) <= until]
    if due:
        waiting[:] = [row for row in waiting if not key(row) <= until]
    return sorted(due, key=key)
