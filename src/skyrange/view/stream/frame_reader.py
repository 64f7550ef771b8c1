"""What frames tell the viewer as they are recorded: reported positions, telemetry, missions, approvals, broadcasts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from skyrange.codec.mavlink import dialect
from skyrange.codec.mavlink.message_columns import classify_frames, kind_of_message, unpack_group
from skyrange.contracts.frames import Fate, Payloads
from skyrange.core.errors import InputError
from skyrange.core.geodesy import Origin
from skyrange.core.ids import endpoint
from skyrange.core.time import Time
from skyrange.metrics.paths import may_be_waypoints
from skyrange.record.manifest import origin_of, start_unix_ns_of
from skyrange.record.read.observations import (
    FRAME_COLUMNS,
    RADIO_LINK,
    Transmissions,
    decoded_rows,
    describe_observations,
)
from skyrange.record.read.station_frames import decode_station_frames, payload_column
from skyrange.record.read.tables import PayloadWindow
from skyrange.view.stream.events import STATUS_FIELDS
from skyrange.view.stream.held import Reports
from skyrange.view.stream.positions import Layer
from skyrange.view.stream.tracks import GLOBAL_POSITION_INT, places_of

Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]

TABLES: Final = ("payloads", "frames", "receptions")
"""The tables that are read here."""
_STATUS_IDS: Final = {
    dialect.MAVLINK_MSG_ID_SYS_STATUS: STATUS_FIELDS["SYS_STATUS"],
    dialect.MAVLINK_MSG_ID_MISSION_CURRENT: STATUS_FIELDS["MISSION_CURRENT"],
}
_STATION_KINDS: Final = np.array([-1, *map(kind_of_message, (GLOBAL_POSITION_INT, *_STATUS_IDS))])
"""What is decoded of what a station received; -1 may be MAVLink 1."""
_NAMED: Final = ("link", "direction", "sender", "fate")


@dataclass
class Told:
    """What some frames told, in no order; times in ns."""

    reports: dict[Layer, list[Reports]] = field(default_factory=lambda: {Layer.AUTOPILOT: [], Layer.STATION: []})
    status: list[tuple[Time, str, str, float]] = field(default_factory=list)
    """Time, aircraft, name and value, as `events.StatusTable` takes them."""
    planned: list[tuple[Time, str, bytes]] = field(default_factory=list)
    """Time of sending, link and payload, as `WaypointReader` takes them."""
    approvals: list[tuple[Time, str, bytes]] = field(default_factory=list)
    """Time of arrival, direction and payload, as `ClaimReader` takes them."""
    observations: list[pa.RecordBatch] = field(default_factory=list)
    """Rows of the table `observations`."""


@dataclass(frozen=True)
class _Names:
    """What the names in the columns of frames say about them."""

    dictionaries: Sequence[pa.Array]
    vehicles: pa.Array
    """Of each link, its name after the colon."""
    gcs: Flags
    approval: Flags
    radio: Flags
    back: Flags
    """Of each direction, whether it is `rev`."""
    autopilot: Ints
    """Of each sender, the place of the aircraft whose autopilot it is, or -1."""
    delivered: Flags
    """Of each fate."""


class FrameReader:
    """Reads the frames of one recorder, with their payloads and receptions, as they come."""

    def __init__(self, manifest: Mapping[str, Any], places: Mapping[str, int]) -> None:
        """`places` are those of aircraft by id in the scene."""
        self._origin = origin_of(manifest)
        self._start_unix_ns = start_unix_ns_of(manifest)
        self._places = places
        self._autopilots = {endpoint(vehicle, "autopilot"): place for vehicle, place in places.items()}
        self._payloads = PayloadWindow()
        self._transmissions = Transmissions()
        self._names: _Names | None = None
        self._told = Told()

    def add(self, table: str, batch: pa.RecordBatch) -> None:
        """Read rows of one of `TABLES`, in the order that `RowReader.add` has."""
        if table == "payloads":
            self._payloads.add(batch)
        elif table == "frames":
            self._add_frames(batch)
        else:
            rows = decoded_rows(batch)
            if rows.num_rows:
                joined = self._transmissions.join(pa.Table.from_batches([rows]))
                self._told.observations.append(describe_observations(joined, self._origin, self._start_unix_ns))

    def take(self) -> Told:
        """What was told since the last call."""
        told, self._told = self._told, Told()
        return told

    def _add_frames(self, batch: pa.RecordBatch) -> None:
        if not batch.num_rows:
            return
        names = self._look_up([batch.column(name).dictionary for name in _NAMED])
        link, direction, sender, fate = (
            batch.column(name).indices.to_numpy(zero_copy_only=False).astype(np.int64) for name in _NAMED
        )
        back, delivered = names.back[direction], names.delivered[fate]
        heard = names.gcs[link] & back & delivered
        believed = back & (names.autopilot[sender] >= 0)
        commanded = names.gcs[link] & ~back & delivered
        approved = names.approval[link] & delivered
        sent = names.radio[link]
        ids = batch.column("payload_id").to_numpy()
        rows = np.flatnonzero(heard | believed | commanded | approved | sent)
        payloads = self._payloads.take(ids[rows])
        if len(payloads) < len(rows):
            raise InputError.one("record", "payloads", "rows that are missing", "a payload for each frame")
        self._payloads.drop_before_window(int(ids.max()))

        column = payload_column(pa.chunked_array([payloads]))
        kinds = classify_frames(column)
        self._read_beliefs(batch, rows, names.autopilot[sender[rows]], column, kinds, believed[rows])
        station = np.flatnonzero(heard[rows] & np.isin(kinds, _STATION_KINDS))
        self._read_station(batch, rows[station], names.vehicles.take(pa.array(link[rows[station]])), payloads, station)
        self._read_singly(batch, rows, names, link, payloads, commanded[rows], approved[rows])
        radio = np.flatnonzero(sent[rows])
        if len(radio):
            frames = pa.Table.from_batches([batch.select(list(FRAME_COLUMNS)).take(pa.array(rows[radio]))])
            self._transmissions.add(frames.append_column("payload", payloads.take(pa.array(radio))))

    def _read_beliefs(  # noqa: PLR0917
        self, batch: pa.RecordBatch, rows: Ints, places: Ints, column: Payloads, kinds: Ints, believed: Flags
    ) -> None:
        kind = kind_of_message(GLOBAL_POSITION_INT)
        chosen = np.flatnonzero(believed & (kinds == kind))
        if len(chosen):
            times = batch.column("sent_ns").to_numpy()[rows[chosen]]
            enu_m = places_of(unpack_group(column, kind, chosen).values, self._origin or Origin(0.0, 0.0))
            self._told.reports[Layer.AUTOPILOT].append(Reports(times, places[chosen], enu_m))

    def _read_station(
        self, batch: pa.RecordBatch, rows: Ints, vehicles: pa.Array, payloads: pa.Array, chosen: Ints
    ) -> None:
        if not len(rows):
            return
        times = batch.column("arrived_ns").fill_null(0).to_numpy()[rows]
        columns = {"time_ns": times, "vehicle": vehicles, "payload": payloads.take(pa.array(chosen))}
        frames = decode_station_frames(pa.table(columns))
        places = np.array([self._places.get(owner, -1) for owner in frames.owners], dtype=np.int64)
        for group in frames.groups(frames.received & np.isin(frames.kinds, _STATION_KINDS)):
            owner = frames.owner[group.rows]
            known = np.flatnonzero(places[owner] >= 0)
            when, whose, values = frames.time_ns[group.rows][known], owner[known], group.values[known]
            if group.message_id == GLOBAL_POSITION_INT:
                enu_m = places_of(values, self._origin or Origin(0.0, 0.0))
                self._told.reports[Layer.STATION].append(Reports(when, places[whose], enu_m))
                continue
            name, key, scale = _STATUS_IDS[group.message_id]
            told = (values[name].astype(np.float64) * scale).tolist()
            ids = [frames.owners[number] for number in whose.tolist()]
            self._told.status += zip(when.tolist(), ids, [key] * len(ids), told, strict=True)

    def _read_singly(  # noqa: PLR0917
        self,
        batch: pa.RecordBatch,
        rows: Ints,
        names: _Names,
        link: Ints,
        payloads: pa.Array,
        commanded: Flags,
        approved: Flags,
    ) -> None:
        """Read missions and approvals, which are few."""
        if commanded.any():
            commanded = commanded & may_be_waypoints(payloads).to_numpy(zero_copy_only=False)
        sent, arrived = batch.column("sent_ns"), batch.column("arrived_ns")
        for number in np.flatnonzero(commanded).tolist():
            row = int(rows[number])
            name = names.dictionaries[0][int(link[row])].as_py()
            self._told.planned.append((sent[row].as_py(), name, payloads[number].as_py()))
        for number in np.flatnonzero(approved).tolist():
            row = int(rows[number])
            direction = batch.column("direction")[row].as_py()
            self._told.approvals.append((arrived[row].as_py(), direction, payloads[number].as_py()))

    def _look_up(self, dictionaries: Sequence[pa.Array]) -> _Names:
        """What the names say; computed anew only when a column has other names."""
        held = self._names
        if held is not None and all(a.equals(b) for a, b in zip(held.dictionaries, dictionaries, strict=True)):
            return held
        links, directions, senders, fates = (names.to_pylist() for names in dictionaries)
        kinds = [name.partition(":")[0] for name in links]
        self._names = _Names(
            dictionaries,
            pa.array([name.partition(":")[2] for name in links], pa.string()),
            np.array([kind == "gcs" for kind in kinds]),
            np.array([kind == "approval" for kind in kinds]),
            np.array([name.startswith(RADIO_LINK) for name in links]),
            np.array([name == "rev" for name in directions]),
            np.array([self._autopilots.get(name, -1) for name in senders], dtype=np.int64),
            np.array([name == str(Fate.DELIVERED) for name in fates]),
        )
        return self._names
