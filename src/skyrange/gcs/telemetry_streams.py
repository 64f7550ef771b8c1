"""Telemetry stream profiles: which messages and data streams a ground station requests, and at what rates.

ArduCopter sends HEARTBEAT at 1 Hz without a request. Other telemetry is requested either per message, with
MAV_CMD_SET_MESSAGE_INTERVAL, or per data stream, with REQUEST_DATA_STREAM. An autopilot never acknowledges
REQUEST_DATA_STREAM, and it decides which messages a stream contains.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final, NamedTuple

from skyrange.codec.mavlink import Message
from skyrange.codec.mavlink import dialect as mav


class StreamProfile(NamedTuple):
    """What is requested: (message id, rate in Hz) and (MAV_DATA_STREAM, rate in Hz)."""

    messages: tuple[tuple[int, float], ...]
    streams: tuple[tuple[int, int], ...] = ()


LIGHT: Mapping[int, float] = MappingProxyType(
    {
        mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 4.0,
        mav.MAVLINK_MSG_ID_ATTITUDE: 1.0,
        mav.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
        mav.MAVLINK_MSG_ID_MISSION_CURRENT: 1.0,
    }
)
"""7 frames per second; with HEARTBEAT these make the light load of 8 telemetry frames per aircraft and second."""

OPERATOR: Final = StreamProfile(
    ((mav.MAVLINK_MSG_ID_HOME_POSITION, 1.0), (mav.MAVLINK_MSG_ID_EXTENDED_SYS_STATE, 1.0)),
    (
        (mav.MAV_DATA_STREAM_RAW_SENSORS, 2),
        (mav.MAV_DATA_STREAM_EXTENDED_STATUS, 2),
        (mav.MAV_DATA_STREAM_RC_CHANNELS, 2),
        (mav.MAV_DATA_STREAM_POSITION, 3),
        (mav.MAV_DATA_STREAM_EXTRA1, 10),
        (mav.MAV_DATA_STREAM_EXTRA2, 10),
        (mav.MAV_DATA_STREAM_EXTRA3, 3),
    ),
)
"""What a QGroundControl session requests from ArduPilot (`APMFirmwarePlugin::initializeStreamRates`, defaults of
APMMavlinkStreamRate.SettingsGroup.json). The builtin autopilot in flight answers with about 105 frames per second."""

PROFILES: Mapping[str, StreamProfile] = MappingProxyType(
    {"light": StreamProfile(tuple(LIGHT.items())), "operator": OPERATOR}
)
"""Stream profiles by the name that a scenario uses."""


def interval_us(rate_hz: float) -> int:
    """The interval parameter of SET_MESSAGE_INTERVAL for a rate, in microseconds."""
    return round(1_000_000 / rate_hz)


def stream_requests(profile: StreamProfile, system: int, component: int) -> list[Message]:
    """One REQUEST_DATA_STREAM message for each data stream of a profile."""
    return [
        mav.MAVLink_request_data_stream_message(system, component, stream, rate_hz, 1)
        for stream, rate_hz in profile.streams
    ]
