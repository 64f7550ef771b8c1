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
_LATLON_TYPEMASK = 0b111
"""POSITION_TARGET_TYPEMASK: set bits ignore x, y, z."""


def received_waypoints(record: Record) -> dict[str, Floats]:
    """(n, 3) ENU metres by vehicle id, in the order received, without duplicates.

    They are read from MISSION_ITEM_INT (navigation commands with a position; item 0, ArduPilot's home, is skipped) and
    SET_POSITION_TARGET_GLOBAL_INT frames delivered on `gcs:` links. Altitudes above terrain are read as altitudes above
    home, because the ground is flat.
    """
    numbers = (dialect.MAVLINK_MSG_ID_MISSION_ITEM_INT, dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT)
    # MAVLink 2: 0xFD first, message id in bytes 7…9, little endian (mavlink.io, "Packet Serialization")
    ids = pa.array([each.to_bytes(3, "little") for each in numbers], pa.binary())
    places: dict[int, bytes] = {}
    for batch in record.batches("payloads", ["payload_id", "payload"]):
        chosen = batch.filter(pc.is_in(pc.binary_slice(batch.column("payload"), 7, 10), value_set=ids))
        places.update(zip(chosen.column("payload_id").to_pylist(), chosen.column("payload").to_pylist(), strict=True))
    if not places:
        return {}
    wanted = pa.array(places, pa.int64())
    rows: list[dict[str, Any]] = []
    for batch in record.batches("frames", ["link", "direction", "fate", "payload_id", "sent_ns"]):
        delivered = pc.and_(
            pc.equal(batch.column("direction"), "fwd"), pc.equal(batch.column("fate"), str(Fate.DELIVERED))
        )
        rows.extend(
            batch.filter(pc.and_(delivered, pc.is_in(batch.column("payload_id"), value_set=wanted))).to_pylist()
        )
    rows.sort(key=lambda row: row["sent_ns"])
    found: dict[str, dict[tuple[float, float, float], None]] = {}
    origin = origin_of(record.manifest) or Origin(0.0, 0.0)
    for row in rows:
        kind, _, vehicle = str(row["link"]).partition(":")
        point = _position(places[row["payload_id"]], origin) if kind == "gcs" else None
        if point is not None:
            found.setdefault(vehicle, {})[point] = None
    return {vehicle: np.array(list(points)) for vehicle, points in found.items()}


def _position(payload: bytes, origin: Origin) -> tuple[float, float, float] | None:
    """The position in ENU metres that a frame commands, or `None` if it commands none or is damaged."""
    try:
        message: Any = decode(payload)
    except DecodeError:
        return None
    if message.get_type() == "MISSION_ITEM_INT":
        if message.seq == 0 or message.command not in _COMMANDS or not (message.x or message.y):
            return None
        lat, lon, alt, frame = message.x, message.y, message.z, message.frame
    else:
        if message.type_mask & _LATLON_TYPEMASK:
            return None
        lat, lon, alt, frame = message.lat_int, message.lon_int, message.alt, message.coordinate_frame
    east, north = origin.enu_of(lat * 1e-7, lon * 1e-7)
    up = alt - origin.alt_msl_m if frame in _MSL_FRAMES else alt
    return (round(east, 2), round(north, 2), round(float(up), 2))


AIRBORNE_M = 0.5
"""An aircraft lower than this above home counts as on the ground."""


def deviations_m(
    fleet: Sequence[Vehicle], tracks: Mapping[str, Track], waypoints: Mapping[str, Floats]
) -> dict[str, tuple[Ints, Floats]]:
    """(n,) times in ns and (n,) metres by vehicle id, for samples in the air; vehicles without home or waypoints lack.

    `waypoints` are (n, 3) ENU metres in the order flown; the track leads from home through them. The distance is
    horizontal, so a wrong height is no deviation.
    """
    found = {}
    for vehicle in fleet:
        track, points, home = tracks[vehicle.id], waypoints.get(vehicle.id), vehicle.home_enu_m
        if home is None or points is None or not len(points) or not len(track):
            continue
        airborne = track.enu_m[:, 2] > home[2] + AIRBORNE_M
        line = shapely.LineString([home[:2], *points[:, :2].tolist()])
        away_m = shapely.distance(shapely.points(track.enu_m[airborne, :2]), line)
        found[vehicle.id] = (track.time_ns[airborne], np.asarray(away_m, dtype=np.float64))
    return found


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
