"""Autopilot belief: the last state that an aircraft's autopilot reported, as its companion received it.

From `rid_data`: HEARTBEAT, SYSTEM_TIME, GPS_RAW_INT, GLOBAL_POSITION_INT, HOME_POSITION, for avoidance
POSITION_TARGET_GLOBAL_INT, and the OPEN_DRONE_ID_LOCATION of an autopilot that makes the Location itself. This is
belief, never truth: if the autopilot is deceived, the false position is broadcast.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.f3411.columns import CODES, NUMBERS
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.message_columns import classify_frames, kind_of_message, unpack_group
from skyrange.codec.remote_id.open_drone_id import location_columns
from skyrange.contracts.frames import Ints, Payloads
from skyrange.core.time import NS_PER_MS, NS_PER_US, Time

AUTOPILOT: Final = int(mav.MAV_COMP_ID_AUTOPILOT1)
_ARMED: Final = int(mav.MAV_MODE_FLAG_SAFETY_ARMED)

BELIEF_DTYPE: Final = np.dtype(
    [
        # when each was received, ns; -1 never
        ("heartbeat_ns", "i8"), ("time_ns", "i8"), ("gnss_ns", "i8"), ("position_ns", "i8"), ("home_ns", "i8"),
        ("goal_ns", "i8"), ("location_ns", "i8"),
        ("mode", "i8"), ("armed", "i8"), ("state", "i8"),  # custom_mode, 0 or 1, MAV_STATE
        ("boot_utc_us", "i8"),  # UTC of its boot, µs since 1970; -1 unknown
        ("time_boot_ms", "i8"),  # its clock at that SYSTEM_TIME
        ("fix", "i8"),  # GPS_FIX_TYPE
        ("geoid_m", "f8"),  # ellipsoid height less mean sea level, from its receiver; NaN unknown
        ("geoid_model_m", "f8"),  # the same from the companion's geoid model, for receivers that report none
        ("h_acc_m", "f8"), ("v_acc_m", "f8"), ("vel_acc_mps", "f8"),  # NaN unknown
        ("boot_ms", "i8"),  # its clock at the position below
        ("lat_e7", "i8"), ("lon_e7", "i8"), ("alt_msl_m", "f8"), ("above_home_m", "f8"),
        ("vel_n", "f8"), ("vel_e", "f8"), ("vel_d", "f8"),  # m/s
        ("home_lat_e7", "i8"), ("home_lon_e7", "i8"), ("home_msl_m", "f8"),
        ("goal_lat_e7", "i8"), ("goal_lon_e7", "i8"), ("goal_msl_m", "f8"),
        ("location_numbers", "f8", (len(NUMBERS),)), ("location_codes", "i8", (len(CODES),)),
        # above: the autopilot's own Location
        ("bad", "i8"),  # frames that are not from its autopilot
    ]
)  # fmt: skip
"""The belief of one aircraft."""


class Beliefs:
    """The beliefs of many aircraft, one row of `table` each. Deep-copyable."""

    def __init__(self, systems: Ints, geoid_model_m: float = 0.0) -> None:
        """`systems` (n,): MAVLink system ids; messages of other systems or components are ignored and counted.

        `geoid_model_m` is the geoid undulation where they fly.
        """
        self.systems = systems
        self.table: NDArray[Any] = np.zeros(len(systems), dtype=BELIEF_DTYPE)
        for name in (
            "heartbeat_ns",
            "time_ns",
            "gnss_ns",
            "position_ns",
            "home_ns",
            "goal_ns",
            "location_ns",
            "boot_utc_us",
        ):
            self.table[name] = -1
        self.table["geoid_model_m"] = geoid_model_m
        for name in ("geoid_m", "h_acc_m", "v_acc_m", "vel_acc_mps"):
            self.table[name] = np.nan

    def update(self, places: Ints, at_ns: Ints, payloads: Payloads) -> dict[int, Ints]:
        """Take in frames in their order; returns the rows of each message id that was received.

        Only whole MAVLink 2 frames are read; others, and those of foreign systems, are counted in `bad`.
        """
        kinds = classify_frames(payloads)
        heard: dict[int, Ints] = {}
        np.add.at(self.table["bad"], places[kinds < 0], 1)
        for number, read in _READERS.items():
            rows = np.flatnonzero(kinds == kind_of_message(number))
            if not rows.size:
                continue
            messages = unpack_group(payloads, kind_of_message(number), rows)
            is_own = (messages.systems == self.systems[places[rows]]) & (messages.components == AUTOPILOT)
            np.add.at(self.table["bad"], places[rows[~is_own]], 1)
            rows = rows[is_own]
            if rows.size:
                # of several messages from one aircraft the last one counts, because it is assigned last
                read(self.table, places[rows], at_ns[rows], messages.values[is_own])
                heard[number] = rows
        return heard


def _heartbeat(table: Any, at: Ints, when: Ints, values: Any) -> None:
    table["heartbeat_ns"][at] = when
    table["mode"][at] = values["custom_mode"]
    table["armed"][at] = (values["base_mode"] & _ARMED) != 0
    table["state"][at] = values["system_status"]


def _system_time(table: Any, at: Ints, when: Ints, values: Any) -> None:
    known = values["time_unix_usec"] > 0
    unix_us, boot_ms = values["time_unix_usec"].astype(np.int64), values["time_boot_ms"].astype(np.int64)
    table["time_ns"][at] = when
    table["boot_utc_us"][at] = np.where(known & (unix_us >= 0), unix_us - boot_ms * 1000, -1)
    table["time_boot_ms"][at] = boot_ms


def _gps_raw_int(table: Any, at: Ints, when: Ints, values: Any) -> None:
    table["gnss_ns"][at] = when
    table["fix"][at] = values["fix_type"]
    both = (values["alt_ellipsoid"] != 0) & (values["fix_type"] >= mav.GPS_FIX_TYPE_3D_FIX)
    # equal heights: the receiver has no geoid model, as ArduPilot's GPS_INPUT (AP_GPS.cpp, `have_undulation`)
    undulation_m = (values["alt_ellipsoid"].astype(np.float64) - values["alt"]) * 1e-3
    table["geoid_m"][at] = np.where(
        both, np.where(undulation_m != 0.0, undulation_m, table["geoid_model_m"][at]), table["geoid_m"][at]
    )
    for name, field in (("h_acc_m", "h_acc"), ("v_acc_m", "v_acc"), ("vel_acc_mps", "vel_acc")):
        table[name][at] = np.where(values[field] > 0, values[field] * 1e-3, np.nan)  # 0: an extension that was not sent


def _global_position(table: Any, at: Ints, when: Ints, values: Any) -> None:
    table["position_ns"][at] = when
    table["boot_ms"][at] = values["time_boot_ms"]
    table["lat_e7"][at], table["lon_e7"][at] = values["lat"], values["lon"]
    table["alt_msl_m"][at], table["above_home_m"][at] = values["alt"] * 1e-3, values["relative_alt"] * 1e-3
    for name, field in (("vel_n", "vx"), ("vel_e", "vy"), ("vel_d", "vz")):
        table[name][at] = values[field] * 1e-2


def _home_position(table: Any, at: Ints, when: Ints, values: Any) -> None:
    table["home_ns"][at] = when
    table["home_lat_e7"][at], table["home_lon_e7"][at] = values["latitude"], values["longitude"]
    table["home_msl_m"][at] = values["altitude"] * 1e-3


def _position_target(table: Any, at: Ints, when: Ints, values: Any) -> None:
    table["goal_ns"][at] = when
    table["goal_lat_e7"][at], table["goal_lon_e7"][at] = values["lat_int"], values["lon_int"]
    table["goal_msl_m"][at] = values["alt"]


def _own_location(table: Any, at: Ints, when: Ints, values: Any) -> None:
    table["location_ns"][at] = when
    numbers, codes = location_columns(values)
    table["location_numbers"][at], table["location_codes"][at] = numbers.T, codes.T


_READERS: Final = {
    int(mav.MAVLINK_MSG_ID_HEARTBEAT): _heartbeat,
    int(mav.MAVLINK_MSG_ID_SYSTEM_TIME): _system_time,
    int(mav.MAVLINK_MSG_ID_GPS_RAW_INT): _gps_raw_int,
    int(mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT): _global_position,
    int(mav.MAVLINK_MSG_ID_HOME_POSITION): _home_position,
    int(mav.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT): _position_target,
    int(mav.MAVLINK_MSG_ID_OPEN_DRONE_ID_LOCATION): _own_location,
}


def utc_us(table: Any, boot_ms: Ints) -> Ints:
    """(n,) UTC in µs since 1970 at `boot_ms` of each autopilot's clock; -1 if unknown, as after a reboot."""
    known = (table["boot_utc_us"] >= 0) & (boot_ms >= table["time_boot_ms"] - 1000)
    return np.where(known, table["boot_utc_us"] + boot_ms * (NS_PER_MS // NS_PER_US), -1)


def clock_us(table: Any, now: Time) -> Ints:
    """(n,) UTC in µs since 1970 now, by the last time that each autopilot told; -1 if it told none."""
    known = (table["boot_utc_us"] >= 0) & (table["time_ns"] >= 0)
    last_utc_us = table["boot_utc_us"] + table["time_boot_ms"] * (NS_PER_MS // NS_PER_US)
    return np.where(known, last_utc_us + (now - table["time_ns"]) // NS_PER_US, -1)


def is_fresh(told_ns: Ints, now: Time, within_ns: Time) -> NDArray[np.bool_]:
    """(n,) whether each was received, and no longer ago than `within_ns`."""
    lately: NDArray[np.bool_] = (told_ns >= 0) & (now - told_ns <= within_ns)
    return lately
