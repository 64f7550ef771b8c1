"""Report to the Remote ID transmitter: OPEN_DRONE_ID_LOCATION, where DID_ENABLE was set at boot.

After libraries/AP_OpenDroneID/AP_OpenDroneID.cpp (`send_location_message`), with its rounding: speeds are truncated to
whole m/s, and the timestamp counts GPS time, ahead of UTC by the leap seconds.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from skyrange.codec.f3411 import values
from skyrange.codec.mavlink import dialect
from skyrange.codec.mavlink.message_columns import MessageTable
from skyrange.contracts.frames import Ints
from skyrange.core.time import GPS_LEAP_S, NS_PER_MS, NS_PER_S
from skyrange.vehicle.builtin.fleet import Fleet
from skyrange.vehicle.builtin.telemetry import columns
from skyrange.vehicle.builtin.telemetry.columns import Floats

_ANY_POSITION: Final = 2  # DID_OPTIONS bit 1: AllowNonGPSPosition
_FIX_3D: Final = int(dialect.GPS_FIX_TYPE_3D_FIX)
_FALLING_MPS: Final = 3.0
_NO_TRACK_CDEG: Final = 36_100  # ODID_INV_DIR
_MAX_MPS, _NO_SPEED_MPS = 254.25, 255.0  # ODID_MAX_SPEED_H, ODID_INV_SPEED_H
_MAX_CLIMB_MPS, _NO_CLIMB_MPS = 62.0, 63.0  # ODID_MAX_SPEED_V, ODID_INV_SPEED_V
_NO_TIME_S: Final = 65_535.0  # ODID_INV_TIMESTAMP
_UNKNOWN_CM: Final = -100_000.0  # ODID_INV_ALT
_ONE_SECOND: Final = int(dialect.MAV_ODID_TIME_ACC_1_0_SECOND)
_STANDARD_PRESSURE_OFFSET_M: Final = (1.0 - (1013.25 / 1013.2) ** (1.0 / 5.25588)) / 2.25577e-5
"""Height of 1013.25 hPa, the standard's sea level, over 1013.2 hPa, which is 0 here (ISO 2533)."""
_HOUR_MS: Final = 3_600_000
_HORIZONTAL, _VERTICAL, _SPEED = (
    np.array([-1.0 if limit is None else limit for limit in table])
    for table in (values.HORIZONTAL_ACCURACY_M, values.VERTICAL_ACCURACY_M, values.SPEED_ACCURACY_MPS)
)


def open_drone_id_location(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    """OPEN_DRONE_ID_LOCATION, broadcast."""
    e, watch = fleet.estimate, fleet.checks
    pos, vel, fallen = e["pos"][rows], e["vel"][rows], -columns.finite_or_zeros(e["gnss_vel"][rows, 2])
    armed, fixed = fleet.flight["armed"][rows] == 1, e["gnss_fix"][rows] >= _FIX_3D
    lax = fleet.settings["DID_OPTIONS"][rows].astype(np.int64) & _ANY_POSITION != 0
    danger = (watch["crashed"][rows] == 1) | (armed & ~fixed & ~lax) | (~armed & fixed & (fallen > _FALLING_MPS))
    flying = np.where(armed, dialect.MAV_ODID_STATUS_AIRBORNE, dialect.MAV_ODID_STATUS_GROUND)
    out["status"] = np.where(danger, dialect.MAV_ODID_STATUS_EMERGENCY, flying)
    out["latitude"], out["longitude"] = columns.lat_lon_e7(fleet, pos[:, 0], pos[:, 1])
    out["direction"] = np.where(fixed, columns.course_cdeg(vel[:, 0], vel[:, 1]), _NO_TRACK_CDEG)
    speed, climb = np.trunc(np.hypot(vel[:, 0], vel[:, 1])), np.trunc(vel[:, 2])
    out["speed_horizontal"] = np.where(speed <= _MAX_MPS, speed, _NO_SPEED_MPS) * 100.0
    out["speed_vertical"] = np.where(np.abs(climb) <= _MAX_CLIMB_MPS, climb, _NO_CLIMB_MPS) * 100.0
    zero_m = fleet.origin.alt_msl_m
    out["altitude_barometric"] = zero_m + columns.finite_or_zeros(e["baro_up"][rows]) + _STANDARD_PRESSURE_OFFSET_M
    out["altitude_geodetic"] = _centimetres(fleet.origin.ellipsoid_of(zero_m) + pos[:, 2])
    out["height"] = np.where(armed, _centimetres(pos[:, 2] - watch["armed_up_m"][rows]), 0.0)
    out["height_reference"] = dialect.MAV_ODID_HEIGHT_REF_OVER_TAKEOFF
    claims = e["gnss_acc"][rows]
    for column, (name, limits) in enumerate(
        (("horizontal_accuracy", _HORIZONTAL), ("vertical_accuracy", _VERTICAL), ("speed_accuracy", _SPEED))
    ):
        out[name] = _accuracy_codes(limits, claims[:, column])
    clocks = fleet.clocks  # the receiver's own time, not that of the autopilot's clock
    shown_ns = clocks.epoch.unix_ns + fleet.now + clocks.receiver_error_ns[rows]
    fix_ms = (shown_ns - (e["gnss_age_s"][rows] * NS_PER_S).astype(np.int64)) // NS_PER_MS
    out["timestamp"] = np.where(fixed, (fix_ms + GPS_LEAP_S * 1000) % _HOUR_MS * 1e-3, _NO_TIME_S)
    out["timestamp_accuracy"] = _ONE_SECOND


def _centimetres(metres: Floats) -> Floats:
    """Truncate heights to centimetres, the resolution of ArduPilot's Location; -1000 m, which would mean unknown, is a
    centimetre more.
    """
    centimetres = np.trunc(metres * 100.0)
    found: Floats = np.where(centimetres == _UNKNOWN_CM, _UNKNOWN_CM + 1.0, centimetres) * 0.01
    return found


def _accuracy_codes(limits: Floats, errors: Floats) -> Ints:
    """Apply `values.accuracy_code` to each; 0 for an unknown error."""
    below = errors[:, None] < limits[None, :]
    codes: Ints = np.where(below, np.arange(len(limits)), 0).max(axis=1)
    return codes
