"""Reports of estimated motion and targets: attitude, position, course, target, and to the Remote ID transmitter.

After libraries/GCS_MAVLink/GCS_Common.cpp (`send_attitude`, `send_global_position_int`, …) and
ArduCopter/GCS_MAVLink_Copter.cpp (`send_nav_controller_output`, `send_position_target_…`).

Report to the Remote ID transmitter: OPEN_DRONE_ID_LOCATION, where DID_ENABLE was set at boot. After
libraries/AP_OpenDroneID/AP_OpenDroneID.cpp (`send_location_message`), with its rounding: speeds are truncated to whole
m/s, and the timestamp counts GPS time, ahead of UTC by the leap seconds.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.f3411 import values
from skyrange.codec.mavlink import dialect
from skyrange.codec.mavlink.message_columns import MessageTable
from skyrange.contracts.frames import Ints
from skyrange.core import elementary_python, elementwise
from skyrange.core.compiled import compiled
from skyrange.core.projection import geodetic_of
from skyrange.core.time import GPS_LEAP_S, NS_PER_MS, NS_PER_S
from skyrange.vehicle.builtin.fleet import Fleet
from skyrange.vehicle.builtin.layout import ControlMode
from skyrange.vehicle.builtin.modes import Mode
from skyrange.vehicle.builtin.telemetry import columns
from skyrange.vehicle.builtin.telemetry.columns import (
    I16,
    I32,
    U16,
    Floats,
    boot_ms_of,
    clip_to_field,
    heading_cdeg_of,
    to_whole,
)

POSITION_KNOWN: Final = dialect.EKF_POS_HORIZ_REL | dialect.EKF_POS_HORIZ_ABS
_LEG: Final = int(ControlMode.LEG)
_POSITION_CONTROL: Final = int(ControlMode.POSITION)
_TAKEOFF: Final = int(ControlMode.TAKEOFF)
_POS_VEL_ACCEL: Final = int(ControlMode.POS_VEL_ACCEL)
_ACCEL_CONTROL: Final = int(ControlMode.ACCEL)
_ATTITUDE_CONTROL: Final = int(ControlMode.ATTITUDE)
# POSITION_TARGET_TYPEMASK bits to ignore
_POSITION: Final = 0b111
_VELOCITY: Final = 0b111000
_ACCEL: Final = 0b111000000
_YAW: Final = 0b110000000000
_LAST: Final = 0xF000


def attitude(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    """ATTITUDE."""
    _fill_attitude(fleet.now, rows, fleet.boot_ns, fleet.estimate, out)


@compiled
def _fill_attitude(now: int, rows: Ints, boot_ns: Ints, estimate: Any, out: Any) -> None:
    for place in range(rows.shape[0]):
        row = rows[place]
        e: Any = estimate[row]
        o: Any = out[place]
        o.time_boot_ms = boot_ms_of(now, boot_ns[row])
        o.roll = e.roll
        o.pitch = -e.pitch
        o.yaw = (1.5 * math.pi - e.yaw) % (2.0 * math.pi) - math.pi
        o.rollspeed = e.rate[0]
        o.pitchspeed = -e.rate[1]
        o.yawspeed = -e.rate[2]


def attitude_quaternion(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    """ATTITUDE_QUATERNION: from the body frame (forward-right-down) to north-east-down."""
    e = fleet.estimate
    rate = e["rate"][rows]
    half_roll, half_pitch = 0.5 * e["roll"][rows], -0.5 * e["pitch"][rows]
    half_yaw = 0.5 * columns.heading_rad(e["yaw"][rows])
    cr, sr = elementwise.cos(half_roll), elementwise.sin(half_roll)
    cp, sp = elementwise.cos(half_pitch), elementwise.sin(half_pitch)
    cy, sy = elementwise.cos(half_yaw), elementwise.sin(half_yaw)
    out["time_boot_ms"] = columns.boot_ms(fleet, rows)
    out["q1"] = cr * cp * cy + sr * sp * sy
    out["q2"] = sr * cp * cy - cr * sp * sy
    out["q3"] = cr * sp * cy + sr * cp * sy
    out["q4"] = cr * cp * sy - sr * sp * cy
    out["rollspeed"] = rate[:, 0]
    out["pitchspeed"] = -rate[:, 1]
    out["yawspeed"] = -rate[:, 2]


def ahrs2(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    """AHRS2: the secondary solution. Attitude is the estimator's, position the receiver's, as in ArduPilot's DCM."""
    e = fleet.estimate
    place = columns.finite_or_zeros(e["gnss_pos"][rows])
    out["roll"] = e["roll"][rows]
    out["pitch"] = -e["pitch"][rows]
    out["yaw"] = columns.heading_rad(e["yaw"][rows])
    out["altitude"] = fleet.origin.alt_msl_m + place[:, 2]
    out["lat"], out["lng"] = columns.lat_lon_e7(fleet, place[:, 0], place[:, 1])


def local_position_ned(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    """LOCAL_POSITION_NED, relative to the origin."""
    e = fleet.estimate
    pos, vel = e["pos"][rows], e["vel"][rows]
    out["time_boot_ms"] = columns.boot_ms(fleet, rows)
    out["x"], out["y"], out["z"] = pos[:, 1], pos[:, 0], -pos[:, 2]
    out["vx"], out["vy"], out["vz"] = vel[:, 1], vel[:, 0], -vel[:, 2]


def has_position(fleet: Fleet, rows: Ints) -> NDArray[np.bool_]:
    """Whether the estimator reports its position as valid."""
    known: NDArray[np.bool_] = (fleet.estimate["status"][rows] & POSITION_KNOWN) != 0
    return known


def global_position_int(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    """GLOBAL_POSITION_INT."""
    at = fleet.origin
    _fill_global_position_int(
        at.lat_deg, at.lon_deg, at.alt_msl_m, fleet.now, rows, fleet.boot_ns, fleet.estimate, fleet.checks, out
    )


@compiled
def _fill_global_position_int(  # noqa: PLR0917
    lat0_deg: float, lon0_deg: float, alt_m: float, now: int,
    rows: Ints, boot_ns: Ints, estimate: Any, watch: Any, out: Any,
) -> None:  # fmt: skip
    for place in range(rows.shape[0]):
        row = rows[place]
        e: Any = estimate[row]
        o: Any = out[place]
        lat, lon = geodetic_of(lat0_deg, lon0_deg, e.pos[0], e.pos[1])
        o.time_boot_ms = boot_ms_of(now, boot_ns[row])
        o.lat = np.rint(lat * 1e7)
        o.lon = np.rint(lon * 1e7)
        o.alt = to_whole((alt_m + e.pos[2]) * 1e3, -I32, I32)
        o.relative_alt = to_whole((e.pos[2] - watch[row].home[2]) * 1e3, -I32, I32)
        o.vx = to_whole(e.vel[1] * 100.0, -I16, I16)
        o.vy = to_whole(e.vel[0] * 100.0, -I16, I16)
        o.vz = to_whole(e.vel[2] * -100.0, -I16, I16)
        o.hdg = heading_cdeg_of(e.yaw)


def vfr_hud(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    """VFR_HUD; without an airspeed sensor `airspeed` is the receiver's ground speed."""
    e, f = fleet.estimate, fleet.flight
    vel, gnss_vel = e["vel"][rows], columns.finite_or_zeros(e["gnss_vel"][rows])
    out["airspeed"] = elementwise.hypot(gnss_vel[:, 0], gnss_vel[:, 1])
    out["groundspeed"] = elementwise.hypot(vel[:, 0], vel[:, 1])
    out["heading"] = columns.heading_cdeg(e["yaw"][rows]) // 100
    out["throttle"] = np.where(f["armed"][rows] == 1, clip_to_field(f["throttle"][rows] * 100.0, 100, 0), 0)
    out["alt"] = fleet.origin.alt_msl_m + e["pos"][rows, 2]
    out["climb"] = vel[:, 2]


def home_position(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    """HOME_POSITION; the attitude there is unknown."""
    home = columns.home_positions(fleet, rows)
    out["latitude"], out["longitude"] = columns.lat_lon_e7(fleet, home[:, 0], home[:, 1])
    out["altitude"] = columns.msl_mm(fleet, home[:, 2])
    out["x"], out["y"], out["z"] = home[:, 1], home[:, 0], -home[:, 2]
    out["q"] = math.nan
    out["time_usec"] = columns.boot_us(fleet, rows)


def gps_global_origin(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    """GPS_GLOBAL_ORIGIN: the origin of LOCAL_POSITION_NED."""
    zero = np.zeros(1)
    lat, lon = columns.lat_lon_e7(fleet, zero, zero)
    out["latitude"], out["longitude"] = lat[0], lon[0]
    out["altitude"] = columns.msl_mm(fleet, zero)[0]
    out["time_usec"] = columns.boot_us(fleet, rows)


def terrain_report(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    """TERRAIN_REPORT: the ground is flat, at the height of the origin."""
    pos = fleet.estimate["pos"][rows]
    out["lat"], out["lon"] = columns.lat_lon_e7(fleet, pos[:, 0], pos[:, 1])
    out["spacing"] = 100  # TERRAIN_SPACING
    out["terrain_height"] = fleet.origin.alt_msl_m
    out["current_height"] = pos[:, 2]


def _guided(fleet: Fleet, rows: Ints) -> NDArray[np.bool_]:
    guided: NDArray[np.bool_] = fleet.modes[rows] == Mode.GUIDED
    return guided


def nav_controller_output(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    """NAV_CONTROLLER_OUTPUT: the attitude that is flown for, target distance and bearing, errors of altitude and
    track.
    """
    e, f = fleet.estimate, fleet.flight
    flying = f["landed"][rows] == 0
    going = has_destination(fleet, rows)
    away = f["target_pos"][rows] - e["pos"][rows]
    behind = f["ref_pos"][rows] - e["pos"][rows]
    along = f["ref_vel"][rows, :2]
    speed = elementwise.hypot(along[:, 0], along[:, 1])
    across = np.abs(behind[:, 0] * along[:, 1] - behind[:, 1] * along[:, 0]) / np.maximum(speed, 1e-6)
    roll, pitch, yaw = _euler_of_quats(f["att_target"][rows])
    out["nav_roll"] = np.degrees(roll)
    out["nav_pitch"] = -np.degrees(pitch)
    out["nav_bearing"] = clip_to_field(np.degrees(columns.heading_rad(yaw)), 180)
    bearing = np.degrees(elementwise.atan2(away[:, 0], away[:, 1]))
    out["target_bearing"] = np.where(going, clip_to_field(bearing, 180), 0)
    out["wp_dist"] = np.where(going, clip_to_field(elementwise.hypot(away[:, 0], away[:, 1]), U16), 0)
    out["alt_error"] = np.where(flying, behind[:, 2], 0.0)
    out["xtrack_error"] = np.where(going & (speed > 0.01), across, 0.0)


def _euler_of_quats(quats: Floats) -> tuple[Floats, Floats, Floats]:
    """Roll, pitch and yaw of attitudes (n, 4), in the frames east-north-up and forward-left-up; radians."""
    w, x, y, z = quats.T
    roll = elementwise.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = elementwise.asin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    return roll, pitch, elementwise.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def position_target_global_int(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    """POSITION_TARGET_GLOBAL_INT: the destination."""
    target = fleet.flight["target_pos"][rows]
    out["time_boot_ms"] = columns.boot_ms(fleet, rows)
    out["coordinate_frame"] = dialect.MAV_FRAME_GLOBAL
    out["type_mask"] = _VELOCITY | _ACCEL | _YAW | _LAST
    out["lat_int"], out["lon_int"] = columns.lat_lon_e7(fleet, target[:, 0], target[:, 1])
    out["alt"] = fleet.origin.alt_msl_m + target[:, 2]


def has_destination(fleet: Fleet, rows: Ints) -> NDArray[np.bool_]:
    """Whether it flies to a destination (`get_wp` of the mode)."""
    control = fleet.flight["control"][rows]
    to_place: NDArray[np.bool_] = (control == _LEG) | (control == _POSITION_CONTROL)
    return to_place


def position_target_local_ned(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    """POSITION_TARGET_LOCAL_NED of GUIDED: the last target, by its kind."""
    f = fleet.flight
    control = f["control"][rows]
    track, push = control == _POS_VEL_ACCEL, control == _ACCEL_CONTROL
    placed = has_destination(fleet, rows) | (control == _TAKEOFF) | track
    moved = ~placed & ~push | track
    pushed = push | moved
    mask = np.where(placed, 0, _POSITION) | np.where(moved, 0, _VELOCITY) | np.where(pushed, 0, _ACCEL) | _YAW
    out["time_boot_ms"] = columns.boot_ms(fleet, rows)
    out["coordinate_frame"] = dialect.MAV_FRAME_LOCAL_NED
    out["type_mask"] = mask
    _fill_ned(out, ("x", "y", "z"), f["target_pos"][rows], placed)
    _fill_ned(out, ("vx", "vy", "vz"), f["target_vel"][rows], moved)
    _fill_ned(out, ("afx", "afy", "afz"), f["target_acc"][rows], pushed)


def _fill_ned(out: MessageTable, names: tuple[str, str, str], enu: Floats, is_known: NDArray[np.bool_]) -> None:
    for name, metres in zip(names, (enu[:, 1], enu[:, 0], -enu[:, 2]), strict=True):
        out[name] = np.where(is_known, metres, 0.0)


def has_local_target(fleet: Fleet, rows: Ints) -> NDArray[np.bool_]:
    """Whether the mode is GUIDED, the only one with a local target, and the target is not an attitude."""
    attitude: NDArray[np.bool_] = fleet.flight["control"][rows] == _ATTITUDE_CONTROL
    return _guided(fleet, rows) & ~attitude


_ANY_POSITION: Final = 2  # DID_OPTIONS bit 1: AllowNonGPSPosition
_FIX_3D: Final = int(dialect.GPS_FIX_TYPE_3D_FIX)
_FALLING_MPS: Final = 3.0
_NO_TRACK_CDEG: Final = 36_100  # ODID_INV_DIR
_MAX_MPS, _NO_SPEED_MPS = 254.25, 255.0  # ODID_MAX_SPEED_H, ODID_INV_SPEED_H
_MAX_CLIMB_MPS, _NO_CLIMB_MPS = 62.0, 63.0  # ODID_MAX_SPEED_V, ODID_INV_SPEED_V
_NO_TIME_S: Final = 65_535.0  # ODID_INV_TIMESTAMP
_UNKNOWN_CM: Final = -100_000.0  # ODID_INV_ALT
_ONE_SECOND: Final = int(dialect.MAV_ODID_TIME_ACC_1_0_SECOND)
_STANDARD_PRESSURE_OFFSET_M: Final = (1.0 - elementary_python.power(1013.25 / 1013.2, 1.0 / 5.25588)) / 2.25577e-5
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
    speed, climb = np.trunc(elementwise.hypot(vel[:, 0], vel[:, 1])), np.trunc(vel[:, 2])
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
    heights: Floats = np.where(centimetres == _UNKNOWN_CM, _UNKNOWN_CM + 1.0, centimetres) * 0.01
    return heights


def _accuracy_codes(limits: Floats, errors: Floats) -> Ints:
    """Apply `values.accuracy_code` to each; 0 for an unknown error."""
    below = errors[:, None] < limits[None, :]
    codes: Ints = np.where(below, np.arange(len(limits)), 0).max(axis=1)
    return codes
