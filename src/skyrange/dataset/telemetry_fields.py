"""Telemetry fields of the view `aircraft`: the MAVLink field behind each column, and its factor to SI units."""

from __future__ import annotations

from typing import Final, NamedTuple


class TelemetryField(NamedTuple):
    """One column: `field` of `message` times `factor`."""

    column: str
    message: str
    field: str
    unit: str = ""
    factor: float = 1.0


FIELDS: Final = (
    TelemetryField("mode", "HEARTBEAT", "custom_mode"),
    TelemetryField("base_mode", "HEARTBEAT", "base_mode"),
    TelemetryField("system_status", "HEARTBEAT", "system_status"),
    TelemetryField("lat_deg", "GLOBAL_POSITION_INT", "lat", "deg", 1e-7),
    TelemetryField("lon_deg", "GLOBAL_POSITION_INT", "lon", "deg", 1e-7),
    TelemetryField("alt_msl_m", "GLOBAL_POSITION_INT", "alt", "m", 1e-3),
    TelemetryField("alt_relative_m", "GLOBAL_POSITION_INT", "relative_alt", "m", 1e-3),
    TelemetryField("vel_north_mps", "GLOBAL_POSITION_INT", "vx", "m/s", 1e-2),
    TelemetryField("vel_east_mps", "GLOBAL_POSITION_INT", "vy", "m/s", 1e-2),
    TelemetryField("vel_down_mps", "GLOBAL_POSITION_INT", "vz", "m/s", 1e-2),
    TelemetryField("heading_deg", "GLOBAL_POSITION_INT", "hdg", "deg", 1e-2),
    TelemetryField("roll_rad", "ATTITUDE", "roll", "rad"),
    TelemetryField("pitch_rad", "ATTITUDE", "pitch", "rad"),
    TelemetryField("yaw_rad", "ATTITUDE", "yaw", "rad"),
    TelemetryField("groundspeed_mps", "VFR_HUD", "groundspeed", "m/s"),
    TelemetryField("climb_mps", "VFR_HUD", "climb", "m/s"),
    TelemetryField("throttle", "VFR_HUD", "throttle", "%"),
    TelemetryField("gnss_fix", "GPS_RAW_INT", "fix_type"),
    TelemetryField("gnss_satellites", "GPS_RAW_INT", "satellites_visible"),
    TelemetryField("gnss_eph", "GPS_RAW_INT", "eph", "", 1e-2),
    TelemetryField("gnss_lat_deg", "GPS_RAW_INT", "lat", "deg", 1e-7),
    TelemetryField("gnss_lon_deg", "GPS_RAW_INT", "lon", "deg", 1e-7),
    TelemetryField("gnss_alt_m", "GPS_RAW_INT", "alt", "m", 1e-3),
    TelemetryField("gnss_speed_mps", "GPS_RAW_INT", "vel", "m/s", 1e-2),
    TelemetryField("ekf_velocity_ratio", "EKF_STATUS_REPORT", "velocity_variance"),
    TelemetryField("ekf_horizontal_ratio", "EKF_STATUS_REPORT", "pos_horiz_variance"),
    TelemetryField("ekf_vertical_ratio", "EKF_STATUS_REPORT", "pos_vert_variance"),
    TelemetryField("ekf_compass_ratio", "EKF_STATUS_REPORT", "compass_variance"),
    TelemetryField("ekf_flags", "EKF_STATUS_REPORT", "flags"),
    TelemetryField("battery_v", "SYS_STATUS", "voltage_battery", "V", 1e-3),
    TelemetryField("battery_a", "SYS_STATUS", "current_battery", "A", 1e-2),
    TelemetryField("battery_percent", "SYS_STATUS", "battery_remaining", "%"),
    TelemetryField("pressure_hpa", "SCALED_PRESSURE", "press_abs", "hPa"),
    TelemetryField("mission_item", "MISSION_CURRENT", "seq"),
    TelemetryField("cross_track_m", "NAV_CONTROLLER_OUTPUT", "xtrack_error", "m"),
)
"""EKF_STATUS_REPORT holds the estimator's innovations as test ratios: 1 is the limit of the gate."""

AGED: Final = ("HEARTBEAT", "GLOBAL_POSITION_INT", "ATTITUDE", "GPS_RAW_INT", "EKF_STATUS_REPORT")
"""Messages whose age is a column."""

ESTIMATES: Final = frozenset(
    {
        "AHRS", "AHRS2", "ATTITUDE", "ATTITUDE_QUATERNION", "EKF_STATUS_REPORT", "GLOBAL_POSITION_INT", "GPS_RAW_INT",
        "GPS2_RAW", "LOCAL_POSITION_NED", "NAV_CONTROLLER_OUTPUT", "RAW_IMU", "SCALED_IMU", "SCALED_IMU2",
        "SCALED_IMU3", "SCALED_PRESSURE", "SCALED_PRESSURE2", "VFR_HUD", "VIBRATION",
    }
)  # fmt: skip
"""Messages that tell sensor readings or what the estimator makes of them."""
