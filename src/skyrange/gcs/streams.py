"""Which telemetry does a ground station ask for, and how often? Profiles of message → rate.

ArduCopter sends HEARTBEAT at 1 Hz unasked; all else is requested with MAV_CMD_SET_MESSAGE_INTERVAL.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from skyrange.codec.mavlink import dialect as mav

LIGHT: Mapping[int, float] = MappingProxyType(
    {
        mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 4.0,
        mav.MAVLINK_MSG_ID_ATTITUDE: 1.0,
        mav.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
        mav.MAVLINK_MSG_ID_MISSION_CURRENT: 1.0,
    }
)
"""7 frames a second; with HEARTBEAT the light load of 8 telemetry frames per aircraft-second."""

PROFILES: Mapping[str, Mapping[int, float]] = MappingProxyType({"light": LIGHT})
"""Message id → rate in Hz, by the profile's name."""


def interval_us(rate_hz: float) -> int:
    """The interval that SET_MESSAGE_INTERVAL asks for, in microseconds."""
    return round(1_000_000 / rate_hz)
