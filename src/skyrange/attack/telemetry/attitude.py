"""False attitude in telemetry: roll, pitch and yaw at an offset from the true ones."""

from __future__ import annotations

from math import pi, radians
from typing import Annotated, Final

from pydantic import Field

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.message_fields import Fields, put
from skyrange.core.elementary import asin, atan2, cos, sin

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


def wrap_angle(angle_rad: float) -> float:
    """The same angle from -π to π."""
    return (float(angle_rad) + pi) % (2 * pi) - pi


def euler_angles_of(w: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Roll, pitch and yaw in radians of a quaternion, in aerospace sequence."""
    return (
        atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        asin(min(max(2 * (w * y - z * x), -1.0), 1.0)),
        atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
    )


def quaternion_of(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """The quaternion w, x, y, z of Euler angles in radians, in aerospace sequence."""
    cr, cp, cy = cos(roll / 2), cos(pitch / 2), cos(yaw / 2)
    sr, sp, sy = sin(roll / 2), sin(pitch / 2), sin(yaw / 2)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


Angle = Annotated[sky.Number, Field(ge=-180, le=180)]


@sky.attack(
    "telemetry.attitude",
    surface=("gcs", "log", "autopilot"),
    effect="the ground station shows an aircraft that is inclined or turned, and a pilot would correct it",
    knowledge="the messages with attitude and heading",
)
class FalseAttitude(sky.AlteredTelemetry):
    """Alters roll, pitch and heading in telemetry.

    The offsets are added to the Euler angles; headings turn by the offset of yaw.
    """

    roll_deg: Angle = sky.param("Offset of roll in degrees, right wing down.", default=0.0)
    pitch_deg: Angle = sky.param("Offset of pitch in degrees, nose up.", default=0.0)
    yaw_deg: Angle = sky.param("Offset of heading in degrees, clockwise.", default=0.0)
    sees = ATTITUDE_MESSAGES

    def find_problems(self) -> sky.Problems:
        if not (self.roll_deg or self.pitch_deg or self.yaw_deg):
            yield sky.Problem("roll_deg", "0", "an offset of roll, pitch or yaw other than 0")

    def alter(self, message: str, fields: sky.MavlinkFields, since_ns: sky.Time) -> bool:
        turn_attitude(message, fields, (self.roll_deg, self.pitch_deg, self.yaw_deg))
        return True
