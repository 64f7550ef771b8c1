"""Attitude that telemetry tells: turned by offsets of the Euler angles, in all messages that tell one."""

from __future__ import annotations

from math import pi, radians
from typing import Final

from skyrange.attack.bases.mavlink.message_fields import Fields, put
from skyrange.attack.euler_angles import euler_angles_of, quaternion_of, wrap_angle

ATTITUDE_MESSAGES: Final = ("ATTITUDE", "ATTITUDE_QUATERNION", "AHRS2", "VFR_HUD", "GLOBAL_POSITION_INT")
"""All messages that tell an attitude or a heading, by name."""
_PARTS: Final = ("q1", "q2", "q3", "q4")
_NO_HEADING: Final = 65_535
"""GLOBAL_POSITION_INT: the heading is not known."""


def turn_attitude(message: str, fields: Fields, by_deg: tuple[float, float, float]) -> None:
    """Add offsets of roll, pitch and yaw to what the message tells; headings turn by that of yaw."""
    yaw_deg = by_deg[2]
    if message == "ATTITUDE_QUATERNION":
        turned = quaternion_of(*_add(euler_angles_of(*(float(fields[name]) for name in _PARTS)), by_deg))
        for name, value in zip(_PARTS, turned, strict=True):
            put(fields, name, value)
    elif message == "VFR_HUD":
        put(fields, "heading", (float(fields["heading"]) + yaw_deg) % 360.0 // 1)
    elif message != "GLOBAL_POSITION_INT":
        roll, pitch, yaw = _add((fields["roll"], float(fields["pitch"]), fields["yaw"]), by_deg)
        put(fields, "roll", wrap_angle(roll))
        put(fields, "pitch", pitch)
        put(fields, "yaw", wrap_angle(yaw))
    elif fields["hdg"] != _NO_HEADING:
        put(fields, "hdg", (float(fields["hdg"]) + yaw_deg * 100.0) % 36_000.0 // 1)


def _add(angles: tuple[float, float, float], by_deg: tuple[float, float, float]) -> tuple[float, float, float]:
    """Roll, pitch and yaw in radians with offsets in degrees; the pitch within a right angle."""
    pitch = min(max(angles[1] + radians(by_deg[1]), -pi / 2), pi / 2)
    return angles[0] + radians(by_deg[0]), pitch, angles[2] + radians(by_deg[2])
