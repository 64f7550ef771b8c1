"""Waypoints that each aircraft received, read from delivered frames rather than from the plan."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from skyrange.codec.mavlink import decode, dialect
from skyrange.contracts.frames import Fate
from skyrange.core.errors import DecodeError
from skyrange.core.geodesy import Origin
from skyrange.metrics.time_series import Record
from skyrange.record.manifest import origin_of

Floats = NDArray[np.float64]

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
