"""Message streams: which messages each contains, and their rates at boot, by ArduCopter's table.

libraries/GCS_MAVLink/GCS_MAVLink_Parameters.cpp (`STREAM_…_msgs`), limited to the messages that are sent here, and
`handle_request_data_stream` (GCS_Param.cpp). Without a request only HEARTBEAT is sent, at 1 Hz, since ArduCopter's
rates at boot are 0.
"""

from __future__ import annotations

from typing import Any, Final

from skyrange.codec.mavlink import dialect as mav
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.vehicle.builtin.fleet import Fleet, Vehicle
from skyrange.vehicle.builtin.parameters.table import INDEX
from skyrange.vehicle.builtin.telemetry.schedule import Schedule

STREAMS: Final[dict[int, tuple[str, tuple[int, ...]]]] = {
    mav.MAV_DATA_STREAM_RAW_SENSORS: (
        "SR0_RAW_SENS",
        (
            mav.MAVLINK_MSG_ID_RAW_IMU,
            mav.MAVLINK_MSG_ID_SCALED_IMU2,
            mav.MAVLINK_MSG_ID_SCALED_IMU3,
            mav.MAVLINK_MSG_ID_SCALED_PRESSURE,
            mav.MAVLINK_MSG_ID_SCALED_PRESSURE2,
        ),
    ),
    mav.MAV_DATA_STREAM_EXTENDED_STATUS: (
        "SR0_EXT_STAT",
        (
            mav.MAVLINK_MSG_ID_SYS_STATUS,
            mav.MAVLINK_MSG_ID_POWER_STATUS,
            mav.MAVLINK_MSG_ID_MCU_STATUS,
            mav.MAVLINK_MSG_ID_MEMINFO,
            mav.MAVLINK_MSG_ID_MISSION_CURRENT,
            mav.MAVLINK_MSG_ID_GPS_RAW_INT,
            mav.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT,
            mav.MAVLINK_MSG_ID_FENCE_STATUS,
            mav.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT,
        ),
    ),
    mav.MAV_DATA_STREAM_RC_CHANNELS: (
        "SR0_RC_CHAN",
        (mav.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW, mav.MAVLINK_MSG_ID_RC_CHANNELS),
    ),
    mav.MAV_DATA_STREAM_RAW_CONTROLLER: ("SR0_RAW_CTRL", ()),
    mav.MAV_DATA_STREAM_POSITION: (
        "SR0_POSITION",
        (mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED),
    ),
    mav.MAV_DATA_STREAM_EXTRA1: (
        "SR0_EXTRA1",
        (mav.MAVLINK_MSG_ID_ATTITUDE, mav.MAVLINK_MSG_ID_AHRS2, mav.MAVLINK_MSG_ID_ESC_TELEMETRY_1_TO_4),
    ),
    mav.MAV_DATA_STREAM_EXTRA2: ("SR0_EXTRA2", (mav.MAVLINK_MSG_ID_VFR_HUD,)),
    mav.MAV_DATA_STREAM_EXTRA3: (
        "SR0_EXTRA3",
        (
            mav.MAVLINK_MSG_ID_AHRS,
            mav.MAVLINK_MSG_ID_RANGEFINDER,
            mav.MAVLINK_MSG_ID_DISTANCE_SENSOR,
            mav.MAVLINK_MSG_ID_SYSTEM_TIME,
            mav.MAVLINK_MSG_ID_TERRAIN_REPORT,
            mav.MAVLINK_MSG_ID_BATTERY_STATUS,
            mav.MAVLINK_MSG_ID_EKF_STATUS_REPORT,
            mav.MAVLINK_MSG_ID_VIBRATION,
        ),
    ),
}
"""MAV_DATA_STREAM → the parameter of its rate at boot, and its messages."""
MIN_INTERVAL_MS: Final = 3
"""The shortest interval accepted, for a 400 Hz loop; here a message is sent every 10 ms at most."""

_OF_MESSAGE: Final = {message: name for name, messages in STREAMS.values() for message in messages}


def interval_ns(rate_hz: float) -> Time:
    """Return the interval of a rate, in whole milliseconds as in ArduPilot: 0, never, below 1 Hz or over 1 kHz.

    `get_interval_for_stream` and `cap_message_interval` (GCS_Common.cpp): at most 0.8 of the main loop's rate.
    """
    whole_ms = 1000 // int(rate_hz) if rate_hz >= 1.0 else 0
    return max(whole_ms, MIN_INTERVAL_MS) * NS_PER_MS if whole_ms else 0


def start_boot_streams(schedule: Schedule, fleet: Fleet, vehicle: Vehicle) -> None:
    """Start what is sent at boot: HEARTBEAT and Open Drone ID's Location at 1 Hz, streams at their SR0_… rates."""
    schedule.clear(vehicle.row)
    schedule.set(vehicle.row, mav.MAVLINK_MSG_ID_HEARTBEAT, NS_PER_S, fleet.now)
    if fleet.param(vehicle, "DID_ENABLE"):  # AP_OpenDroneID.h, _mavlink_dynamic_period_ms
        schedule.set(vehicle.row, mav.MAVLINK_MSG_ID_OPEN_DRONE_ID_LOCATION, NS_PER_S, fleet.now)
    for name, messages in STREAMS.values():
        period = interval_ns(fleet.param(vehicle, name))
        for message in messages:
            schedule.set(vehicle.row, message, period, fleet.now)


def default_interval_ns(fleet: Fleet, vehicle: Vehicle, message: int) -> Time:
    """Return the default interval of a message; 0 is never."""
    if message == mav.MAVLINK_MSG_ID_HEARTBEAT:
        return NS_PER_S
    return interval_ns(fleet.param(vehicle, _OF_MESSAGE[message])) if message in _OF_MESSAGE else 0


def on_request_data_stream(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, message: Any) -> None:
    """REQUEST_DATA_STREAM: start or stop one stream, or all (0).

    The stream's parameter is set until the next boot.
    """
    if message.start_stop > 1:
        return
    # ArduPilot stores the rate as a signed 16-bit integer: a larger one is negative, and nothing is sent
    asked = message.req_message_rate if message.start_stop == 1 else 0
    rate = asked if asked <= 32_767 else 0
    chosen = STREAMS if message.req_stream_id == mav.MAV_DATA_STREAM_ALL else (message.req_stream_id,)
    for stream in chosen:
        if stream not in STREAMS:
            continue
        name, messages = STREAMS[stream]
        index = INDEX[name]
        vehicle.unsaved_params.setdefault(index, float(fleet.stored_params[vehicle.row, index]))
        fleet.stored_params[vehicle.row, index] = rate
        period = interval_ns(rate)
        for number in messages:
            schedule.set(vehicle.row, number, period, fleet.now)
