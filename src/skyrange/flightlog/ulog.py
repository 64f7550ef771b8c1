"""ULogs (`.ulg`), which PX4 writes on board."""

from __future__ import annotations

import contextlib
import io
import math
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.core.errors import InputError
from skyrange.core.extras import require_extra
from skyrange.flightlog.model import FlightLog, Remark, TableBuilder

_READ: Final = (
    "vehicle_global_position", "vehicle_attitude", "vehicle_gps_position", "sensor_gps", "battery_status",
    "estimator_status", "vehicle_status", "home_position", "mission",
)  # fmt: skip
_ARMED: Final = 2  # vehicle_status.ARMING_STATE_ARMED
_MODES: Final = {0: "MANUAL", 1: "ALTCTL", 2: "POSCTL", 3: "AUTO", 4: "LOITER", 5: "RTL", 14: "OFFBOARD", 15: "STAB",
                 17: "TAKEOFF", 18: "LAND"}  # fmt: skip
"""vehicle_status.NAVIGATION_STATE, with AUTO for a mission."""
_TYPES: Final = {2: "QUADROTOR", 13: "HEXAROTOR", 14: "OCTOROTOR", 15: "TRICOPTER", 4: "HELICOPTER", 1: "FIXED_WING"}
_ROTARY: Final = 1  # vehicle_status.VEHICLE_TYPE_ROTARY_WING
_US: Final = 1e-6


def read_ulog(path: Path) -> FlightLog:
    """The log of a vehicle. Raises `InputError` if pyulog is missing, or cannot read the file."""
    require_extra("logs", str(path))
    from pyulog import ULog

    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said):
            log = ULog(str(path), list(_READ))
    except Exception as error:  # pyulog has errors of many kinds for damaged files
        reason = str(error) or type(error).__name__
        raise InputError.one(str(path), "ULog", reason, "a log that PX4 wrote") from error
    return _build(path, log)


def _build(path: Path, log: Any) -> FlightLog:
    topics: dict[str, dict[str, NDArray[Any]]] = {}
    for data in sorted(log.data_list, key=lambda data: data.multi_id, reverse=True):
        if "timestamp" in data.data:
            topics[data.name] = data.data  # of several instances the first
    start_us = log.start_timestamp
    tables = TableBuilder()
    remarks = []
    _add_motion(tables, topics, start_us)
    _add_states(tables, topics, start_us)
    start_unix_s = _add_gnss(tables, topics, start_us)
    if start_unix_s is None:
        remarks.append(Remark("clock", "the log has no GPS time: times are since its first message"))
    if log.dropouts:
        lost_s = sum(drop.duration for drop in log.dropouts) * 1e-3
        remarks.append(Remark("dropouts", f"the logger lost {lost_s:.2f} s in {len(log.dropouts)} gaps"))
    if getattr(log, "file_corruption", False):
        remarks.append(Remark("bytes", "the file is damaged; what can be read is used"))
    if "mission" in topics:
        remarks.append(Remark("mission", "a ULog has no mission items"))
    release = log.msg_info_dict.get("ver_sw_release")
    version = f" {release >> 24}.{release >> 16 & 255}.{release >> 8 & 255}" if isinstance(release, int) else ""
    firmware = f"{log.msg_info_dict.get('sys_name', '')}{version}".strip()
    sent = [*log.initial_parameters.items(), *((name, value) for _, name, value in log.changed_parameters)]
    params = {name: float(value) for name, value in sent if isinstance(value, int | float) and math.isfinite(value)}
    built, left_out = tables.build()
    return FlightLog(
        path, "ulog", start_unix_s, (log.last_timestamp - start_us) * _US, firmware, _name_type(topics, params),
        built, params, [], [*remarks, *left_out],
    )  # fmt: skip


def _name_type(topics: dict[str, dict[str, NDArray[Any]]], params: dict[str, float]) -> str:
    named = _TYPES.get(int(params.get("MAV_TYPE", -1)))
    kinds = topics.get("vehicle_status", {}).get("vehicle_type")
    if kinds is not None and len(kinds):
        rotary = int(kinds[-1]) == _ROTARY
        return (named or "QUADROTOR") if rotary and named != "FIXED_WING" else "QUADROTOR" if rotary else "FIXED_WING"
    return named or ""


def _rows(topic: dict[str, NDArray[Any]], start_us: int, *names: str) -> zip[tuple[float, ...]]:
    """Time and columns of a topic, by row; NaN for a column that this version of PX4 does not have."""
    times = (topic["timestamp"].astype(np.float64) - start_us) * _US
    return zip(times.tolist(), *(_column(topic, name).tolist() for name in names), strict=True)


def _column(topic: dict[str, NDArray[Any]], name: str) -> NDArray[np.float64]:
    missing = np.full(len(topic["timestamp"]), np.nan)
    return topic.get(name, missing).astype(np.float64)


def _add_motion(tables: TableBuilder, topics: dict[str, dict[str, NDArray[Any]]], start_us: int) -> None:
    if position := topics.get("vehicle_global_position"):
        for row in _rows(position, start_us, "lat", "lon", "alt", "vel_n", "vel_e", "vel_d"):
            tables.add("position", *row)
    if attitude := topics.get("vehicle_attitude"):
        w, x, y, z = (_column(attitude, f"q[{k}]") for k in range(4))
        roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
        pitch = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
        yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        times = (attitude["timestamp"].astype(np.float64) - start_us) * _US
        for row in zip(times.tolist(), roll.tolist(), pitch.tolist(), yaw.tolist(), strict=True):
            tables.add("attitude", *row)
    if homes := topics.get("home_position"):
        for row in _rows(homes, start_us, "lat", "lon", "alt"):
            tables.add("homes", *row)


def _add_states(tables: TableBuilder, topics: dict[str, dict[str, NDArray[Any]]], start_us: int) -> None:
    if status := topics.get("vehicle_status"):
        for time_s, arming, mode in _rows(status, start_us, "arming_state", "nav_state"):
            number = int(mode) if math.isfinite(mode) else -1
            tables.add("states", time_s, arming == _ARMED, _MODES.get(number, str(number)))
    if battery := topics.get("battery_status"):
        for row in _rows(battery, start_us, "voltage_v", "current_a", "remaining"):
            time_s, voltage_v, *rest = row
            tables.add("battery", time_s, voltage_v, *(value if value >= 0.0 else math.nan for value in rest))
    if estimator := topics.get("estimator_status"):
        names = ("vel_test_ratio", "pos_test_ratio", "hgt_test_ratio", "mag_test_ratio")
        for row in _rows(estimator, start_us, *names):
            tables.add("estimator", *row)


def _add_gnss(tables: TableBuilder, topics: dict[str, dict[str, NDArray[Any]]], start_us: int) -> float | None:
    """Add the fixes; the time of the log's first message, in seconds since 1970."""
    topic = topics.get("vehicle_gps_position") or topics.get("sensor_gps")
    if not topic:
        return None
    whole = "latitude_deg" in topic  # from PX4 1.14 on in degrees and metres, before in 1e-7 degrees and millimetres
    names = ("latitude_deg", "longitude_deg", "altitude_msl_m") if whole else ("lat", "lon", "alt")
    scales = (1.0, 1.0, 1.0) if whole else (1e-7, 1e-7, 1e-3)
    for time_s, fix, used, hdop, *place in _rows(topic, start_us, "fix_type", "satellites_used", "hdop", *names):
        scaled = (value * scale for value, scale in zip(place, scales, strict=True))
        tables.add(
            "gnss",
            time_s,
            int(fix) if math.isfinite(fix) else -1,
            int(used) if math.isfinite(used) else -1,
            hdop,
            *scaled,
        )
    utc_us = _column(topic, "time_utc_usec")
    known = np.flatnonzero(utc_us > 0.0)
    if not len(known):
        return None
    row = int(known[0])
    return float((utc_us[row] - (float(topic["timestamp"][row]) - start_us)) * _US)
