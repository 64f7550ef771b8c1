"""Which telemetry does a ground station ask for, and how often? Profiles of messages and streams.

ArduCopter sends HEARTBEAT at 1 Hz unasked. The rest is asked for message by message, with
MAV_CMD_SET_MESSAGE_INTERVAL, or by stream, with REQUEST_DATA_STREAM, which is never acknowledged; what a stream holds
is the autopilot's choice.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final, NamedTuple

from skyrange.codec.mavlink import Message
from skyrange.codec.mavlink import dialect as mav


class Profile(NamedTuple):
    """What is asked for: (message id, rate in Hz) and (MAV_DATA_STREAM, rate in Hz)."""

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
"""7 frames a second; with HEARTBEAT the light load of 8 telemetry frames per aircraft-second."""

OPERATOR: Final = Profile(
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
"""What a QGroundControl session asks of ArduPilot (`APMFirmwarePlugin::initializeStreamRates`, defaults of
APMMavlinkStreamRate.SettingsGroup.json): about 105 frames a second of the builtin autopilot in flight."""

PROFILES: Mapping[str, Profile] = MappingProxyType({"light": Profile(tuple(LIGHT.items())), "operator": OPERATOR})
"""By name."""


def interval_us(rate_hz: float) -> int:
    """The interval that SET_MESSAGE_INTERVAL asks for, in microseconds."""
    return round(1_000_000 / rate_hz)


def requests(profile: Profile, system: int, component: int) -> list[Message]:
    """A REQUEST_DATA_STREAM for each stream of a profile."""
    return [
        mav.MAVLink_request_data_stream_message(system, component, stream, rate_hz, 1)
        for stream, rate_hz in profile.streams
    ]
