"""Reports of sensors and outputs: receiver, inertial sensors, barometer, motors and radio.

After `send_raw_imu`, `send_scaled_pressure_instance`, `send_servo_output_raw` and others of
libraries/GCS_MAVLink/GCS_Common.cpp, and AP_GPS::send_mavlink_gps_raw. A board has a second inertial sensor and
barometer; here they repeat the values of the first.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mavlink import dialect
from skyrange.codec.mavlink.message_columns import MessageTable
from skyrange.contracts.frames import Ints
from skyrange.core import elementary, elementwise
from skyrange.core.compiled import compiled
from skyrange.core.projection import geodetic_of
from skyrange.core.time import NS_PER_US
from skyrange.vehicle.builtin.fleet import Fleet
from skyrange.vehicle.builtin.telemetry import columns
from skyrange.vehicle.builtin.telemetry.columns import I16, I32, U16, clip_to_field, finite_or_zero, to_whole

_GRAVITY_MPS2: Final = 9.80665  # AP_Math definitions.h GRAVITY_MSS
_MIN_PWM_US: Final = 1000
_PWM_RANGE_US: Final = 1000
"""MOT_PWM_MIN to MOT_PWM_MAX."""
_SERVOS: Final = tuple(f"servo{motor + 1}_raw" for motor in range(16))
_CHANNELS: Final = tuple(f"chan{channel + 1}_raw" for channel in range(18))
_SEA_LEVEL_HPA: Final = 1013.25
_RANGE_CM: Final = (20, 5000)
_UNKNOWN_DOP: Final = 9999  # GPS_UNKNOWN_DOP
_RANGE_ERROR_M: Final = 1.5
"""Accuracy over dilution of precision, as in `estimation.gnss` for the horizontal one."""
_DOP_MIN, _DOP_MAX = 0.5, 99.99
_FIX_2D: Final = dialect.GPS_FIX_TYPE_2D_FIX
_RADPS_PER_RPM: Final = 2.0 * math.pi / 60.0
_ESC_HZ: Final = 100
"""Report rate of a speed controller; each report is counted."""


def gps_raw_int(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    """GPS_RAW_INT: the receiver's fix, not the estimate."""
    at = fleet.origin
    _fill_gps_raw_int(
        at.lat_deg, at.lon_deg, at.alt_msl_m, at.ellipsoid_of(at.alt_msl_m), fleet.now, rows, fleet.boot_ns,
        fleet.estimate, out,
    )  # fmt: skip


@compiled
def _fill_gps_raw_int(  # noqa: PLR0917
    lat0_deg: float, lon0_deg: float, alt_m: float, ellipsoid_m: float, now: int, rows: Ints, boot_ns: Ints,
    estimate: Any, out: Any,
) -> None:  # fmt: skip
    for place in range(rows.shape[0]):
        row = rows[place]
        e: Any = estimate[row]
        o: Any = out[place]
        up = finite_or_zero(e.gnss_pos[2])
        vel_e, vel_n = finite_or_zero(e.gnss_vel[0]), finite_or_zero(e.gnss_vel[1])
        lat, lon = geodetic_of(lat0_deg, lon0_deg, finite_or_zero(e.gnss_pos[0]), finite_or_zero(e.gnss_pos[1]))
        o.time_usec = max(now - int(e.gnss_age_s * 1e9) - boot_ns[row], 0) // NS_PER_US
        o.fix_type = e.gnss_fix
        o.lat = np.rint(lat * 1e7)
        o.lon = np.rint(lon * 1e7)
        o.alt = to_whole((alt_m + up) * 1e3, -I32, I32)
        o.alt_ellipsoid = to_whole((ellipsoid_m + up) * 1e3, -I32, I32)
        if e.gnss_fix >= _FIX_2D:
            o.eph = to_whole(e.gnss_hdop * 100.0, 0, U16 - 1)  # 65535 would mean unknown
            o.epv = to_whole(min(max(e.gnss_acc[1] / _RANGE_ERROR_M, _DOP_MIN), _DOP_MAX) * 100.0, 0, U16 - 1)
        else:
            o.eph = _UNKNOWN_DOP
            o.epv = _UNKNOWN_DOP
        o.vel = to_whole(math.sqrt(vel_e * vel_e + vel_n * vel_n) * 100.0, 0, U16 - 1)
        o.cog = int(elementary.atan2(vel_e, vel_n) * (180.0 / math.pi) % 360.0 * 100.0) % 36_000
        o.satellites_visible = e.gnss_sats
        o.h_acc = to_whole(e.gnss_acc[0] * 1e3, 0, I32)
        o.v_acc = to_whole(e.gnss_acc[1] * 1e3, 0, I32)
        o.vel_acc = to_whole(e.gnss_acc[2] * 1e3, 0, I32)


def _fill_imu(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    e = fleet.estimate
    for name, field, scale, most in (
        ("acc", "imu_accel", 1000.0 / _GRAVITY_MPS2, I16),
        ("gyro", "rate", 1000.0, I16),
        ("mag", "compass", 1000.0, I16),
    ):
        read = columns.finite_or_zeros(e[field][rows]) * scale
        out["x" + name] = clip_to_field(read[:, 0], most)
        out["y" + name] = clip_to_field(-read[:, 1], most)
        out["z" + name] = clip_to_field(-read[:, 2], most)


def raw_imu(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    """RAW_IMU: thousandths of gravity, mrad/s and mgauss, forward-right-down; scaled as from ArduPilot, not raw."""
    out["time_usec"] = columns.boot_us(fleet, rows)
    _fill_imu(fleet, rows, out)


def scaled_imu(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    """SCALED_IMU and SCALED_IMU2."""
    out["time_boot_ms"] = columns.boot_ms(fleet, rows)
    _fill_imu(fleet, rows, out)


def scaled_imu3(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    """SCALED_IMU3: a third compass without an inertial sensor, as in ArduPilot's SITL."""
    out["time_boot_ms"] = columns.boot_ms(fleet, rows)
    read = columns.finite_or_zeros(fleet.estimate["compass"][rows]) * 1000.0
    out["xmag"], out["ymag"], out["zmag"] = (
        clip_to_field(read[:, 0], I16),
        clip_to_field(-read[:, 1], I16),
        clip_to_field(-read[:, 2], I16),
    )


def scaled_pressure(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    """SCALED_PRESSURE(2): the height of the barometer as a pressure of the standard atmosphere (ISO 2533)."""
    height = fleet.origin.alt_msl_m + columns.finite_or_zeros(fleet.estimate["baro_up"][rows])
    out["time_boot_ms"] = columns.boot_ms(fleet, rows)
    out["press_abs"] = _SEA_LEVEL_HPA * elementwise.power(np.maximum(1.0 - 2.25577e-5 * height, 0.0), 5.25588)
    out["temperature"] = clip_to_field(1500.0 - 0.65 * height, I16)


def rangefinder(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    """RANGEFINDER, downward."""
    out["distance"] = np.fmin(np.fmax(fleet.estimate["height"][rows], 0.0), _RANGE_CM[1] * 0.01)


def distance_sensor(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    """DISTANCE_SENSOR of the rangefinder."""
    out["time_boot_ms"] = columns.boot_ms(fleet, rows)
    out["min_distance"], out["max_distance"] = _RANGE_CM
    out["current_distance"] = clip_to_field(fleet.estimate["height"][rows] * 100.0, _RANGE_CM[1], 0)
    out["type"] = dialect.MAV_DISTANCE_SENSOR_LASER
    out["orientation"] = dialect.MAV_SENSOR_ROTATION_PITCH_270


def servo_output_raw(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    """SERVO_OUTPUT_RAW: the motors' pulse lengths in µs, in ArduPilot's motor order."""
    out["time_usec"] = columns.boot_us(fleet, rows) & 0xFFFFFFFF
    commands = fleet.actuators[rows]
    pulses = _MIN_PWM_US + _PWM_RANGE_US * commands
    for motor in range(commands.shape[1]):
        out[_SERVOS[motor]] = pulses[:, motor]


def esc_telemetry(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    """ESC_TELEMETRY_1_TO_4: each rotor's speed and its share of the battery's current; temperature is not measured.

    A rotor's power is proportional to the cube of its speed (`world.multirotor`), by which the current is divided.
    """
    power = fleet.battery
    speed = np.abs(fleet.rotor_speeds[rows])
    work = speed * speed * speed
    share = work / np.maximum(work.sum(axis=1, keepdims=True), 1e-9)
    out["voltage"] = clip_to_field(power["voltage"][rows] * 100.0, U16, 0)[:, None]
    out["current"] = clip_to_field(power["current"][rows, None] * share * 100.0, U16, 0)
    out["totalcurrent"] = clip_to_field(power["consumed_mah"][rows] / speed.shape[1], U16, 0)[:, None]
    out["rpm"] = clip_to_field(speed / _RADPS_PER_RPM, U16, 0)
    out["count"] = (columns.boot_ms(fleet, rows) * _ESC_HZ // 1000 & U16)[:, None]


def rc_channels(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    """RC_CHANNELS: the channels of `pilot`; the signal strength is unknown."""
    out["time_boot_ms"] = columns.boot_ms(fleet, rows)
    sticks = fleet.rc_channels[rows]
    out["chancount"] = sticks.shape[1]
    for channel in range(sticks.shape[1]):
        out[_CHANNELS[channel]] = sticks[:, channel]
    out["rssi"] = 255


def has_fix(fleet: Fleet, rows: Ints) -> NDArray[np.bool_]:
    """Whether a receiver is fitted and has ever reported a position."""
    known: NDArray[np.bool_] = np.isfinite(fleet.estimate["gnss_pos"][rows, 0])
    return known


def ahrs(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    """AHRS: drift and error of the attitude, from the innovations of compass and horizontal velocity."""
    e = fleet.estimate
    out["error_rp"] = np.minimum(e["vel_ratio"][rows], 1.0) * math.radians(1.0)
    out["error_yaw"] = np.minimum(e["mag_ratio"][rows], 1.0) * math.radians(5.0)
