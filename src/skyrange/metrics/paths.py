"""Paths of aircraft: the waypoints received, the deviation from the commanded track, the distance of two paths."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import shapely
from numpy.typing import NDArray

from skyrange.codec.mavlink import decode, dialect
from skyrange.contracts.frames import Fate
from skyrange.core.errors import DecodeError
from skyrange.core.geodesy import Origin
from skyrange.metrics.time_series import Ints, Record, Track, Vehicle
from skyrange.record.manifest import origin_of

_COMMANDS = {dialect.MAV_CMD_NAV_WAYPOINT, dialect.MAV_CMD_NAV_LAND, dialect.MAV_CMD_NAV_SPLINE_WAYPOINT}
_MSL_FRAMES = {dialect.MAV_FRAME_GLOBAL, dialect.MAV_FRAME_GLOBAL_INT}
NO_ITEM: Final = -1
"""The number of a target that a station sends in flight."""
_LATLON_TYPEMASK = 0b111
"""POSITION_TARGET_TYPEMASK: set bits ignore x, y, z."""


_PLANNED: Final = (dialect.MAVLINK_MSG_ID_MISSION_ITEM_INT, dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT)
# MAVLink 2: 0xFD first, message id in bytes 7…9, little endian (mavlink.io, "Packet Serialization")
_PLANNED_IDS: Final = pa.array([number.to_bytes(3, "little") for number in _PLANNED], pa.binary())


def may_be_waypoints(payloads: pa.Array) -> pa.Array:
    """(n,) whether payloads may be frames that `WaypointReader` takes a place from."""
    return pc.is_in(pc.binary_slice(payloads, 7, 10), value_set=_PLANNED_IDS)


class WaypointReader:
    """Waypoints that aircraft received, from frames delivered in direction `fwd` on `gcs:` links.

    They are read from MISSION_ITEM_INT (navigation commands with a position; item 0, ArduPilot's home, is skipped) and
    SET_POSITION_TARGET_GLOBAL_INT. Altitudes above terrain are read as altitudes above home, because the ground is
    flat.
    """

    def __init__(self, manifest: Mapping[str, Any]) -> None:
        self._origin = origin_of(manifest) or Origin(0.0, 0.0)
        self._points: dict[str, dict[tuple[float, float, float], int]] = {}

    def add(self, link: str, payload: bytes) -> bool:
        """Read a frame that was sent after all before; whether it had a waypoint that is new."""
        kind, _, vehicle = link.partition(":")
        found = _position(payload, self._origin) if kind == "gcs" else None
        if found is None or found[0] in self._points.setdefault(vehicle, {}):
            return False
        self._points[vehicle][found[0]] = found[1]
        return True

    @property
    def waypoints(self) -> dict[str, Floats]:
        """(n, 3) ENU metres by vehicle id, in the order received, without duplicates."""
        return {vehicle: np.array(list(points)) for vehicle, points in self._points.items() if points}

    @property
    def items(self) -> dict[str, list[int]]:
        """By vehicle id, the number of each waypoint's mission item, `NO_ITEM` of targets; ordered as `waypoints`."""
        return {vehicle: list(points.values()) for vehicle, points in self._points.items() if points}


def received_waypoints(record: Record) -> dict[str, Floats]:
    """(n, 3) ENU metres by vehicle id, in the order received, without duplicates, as `WaypointReader` reads them."""
    return read_waypoints(record).waypoints


def read_waypoints(record: Record) -> WaypointReader:
    """The reader of waypoints after all frames of a run."""
    places: dict[int, bytes] = {}
    for batch in record.batches("payloads", ["payload_id", "payload"]):
        chosen = batch.filter(may_be_waypoints(batch.column("payload")))
        places.update(zip(chosen.column("payload_id").to_pylist(), chosen.column("payload").to_pylist(), strict=True))
    reader = WaypointReader(record.manifest)
    if not places:
        return reader
    wanted = pa.array(places, pa.int64())
    rows: list[dict[str, Any]] = []
    for batch in record.batches("frames", ["link", "direction", "fate", "payload_id", "sent_ns"]):
        delivered = pc.and_(
            pc.equal(batch.column("direction"), "fwd"), pc.equal(batch.column("fate"), str(Fate.DELIVERED))
        )
        rows.extend(
            batch.filter(pc.and_(delivered, pc.is_in(batch.column("payload_id"), value_set=wanted))).to_pylist()
        )
    for row in sorted(rows, key=lambda row: row["sent_ns"]):
        reader.add(str(row["link"]), places[row["payload_id"]])
    return reader


def _position(payload: bytes, origin: Origin) -> tuple[tuple[float, float, float], int] | None:
    """The position in ENU metres that a frame commands, and its item; `None` if it commands none or is damaged."""
    try:
        message: Any = decode(payload)
    except DecodeError:
        return None
    if message.get_type() == "MISSION_ITEM_INT":
        if message.seq == 0 or message.command not in _COMMANDS or not (message.x or message.y):
            return None
        lat, lon, alt, frame, item = message.x, message.y, message.z, message.frame, int(message.seq)
    else:
        if message.type_mask & _LATLON_TYPEMASK:
            return None
        lat, lon, alt, frame = message.lat_int, message.lon_int, message.alt, message.coordinate_frame
        item = NO_ITEM
    east, north = origin.enu_of(lat * 1e-7, lon * 1e-7)
    up = alt - origin.alt_msl_m if frame in _MSL_FRAMES else alt
    return (round(east, 2), round(north, 2), round(float(up), 2)), item


AIRBORNE_M = 0.5
"""An aircraft lower than this above home counts as on the ground."""


def deviations_m(
    fleet: Sequence[Vehicle], tracks: Mapping[str, Track], waypoints: Mapping[str, Floats]
) -> dict[str, tuple[Ints, Floats]]:
    """(n,) times in ns and (n,) metres by vehicle id, for samples in the air; vehicles without home or waypoints lack.

    `waypoints` are (n, 3) ENU metres in the order flown; the track leads from home through them. The distance is
    horizontal, so a wrong height is no deviation.
    """
    deviations = {}
    for vehicle in fleet:
        track, points, home = tracks[vehicle.id], waypoints.get(vehicle.id), vehicle.home_enu_m
        if home is None or points is None or not len(points) or not len(track):
            continue
        airborne = track.enu_m[:, 2] > home[2] + AIRBORNE_M
        line = shapely.LineString([home[:2], *points[:, :2].tolist()])
        away_m = shapely.distance(shapely.points(track.enu_m[airborne, :2]), line)
        deviations[vehicle.id] = (track.time_ns[airborne], np.asarray(away_m, dtype=np.float64))
    return deviations


Floats = NDArray[np.float64]

_STEP_M: Final = 0.1
"""Tracks are resampled to this distance between points."""
_CHUNK: Final = 1024


def path_distance_m(first: Floats, second: Floats) -> tuple[float, str]:
    """Greatest distance of a point of either track (n, 3) from the other track, and where it is.

    NaN if either has fewer than two points: what was not flown agrees with nothing.
    This is the Hausdorff distance of the tracks as lines, to within half of `_STEP_M`.
    """
    if len(first) < 2 or len(second) < 2:
        return np.nan, ""
    most, where = 0.0, ""
    for points, line in ((first, resampled(second)), (second, resampled(first))):
        for start in range(0, len(points), _CHUNK):
            part = points[start : start + _CHUNK]
            squares = np.full(len(part), np.inf)
            for begin in range(0, len(line), _CHUNK):
                apart = part[:, None, :] - line[None, begin : begin + _CHUNK, :]
                squares = np.minimum(squares, (apart * apart).sum(axis=2).min(axis=1))
            far = int(squares.argmax())
            if np.sqrt(squares[far]) > most:
                most = float(np.sqrt(squares[far]))
                where = "near " + ", ".join(f"{value:.0f}" for value in part[far]) + " m"
    return most, where


def resampled(track: Floats) -> Floats:
    """The points of a track (n, 3) at equal distances of `_STEP_M` along it, with its ends."""
    steps = np.sqrt((np.diff(track, axis=0) ** 2).sum(axis=1))
    along = np.concatenate([[0.0], np.cumsum(steps)])
    wanted = np.append(np.arange(0.0, along[-1], _STEP_M), along[-1])
    return np.stack([np.interp(wanted, along, track[:, axis]) for axis in range(3)], axis=1)
