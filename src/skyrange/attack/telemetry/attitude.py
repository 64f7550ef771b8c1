"""False attitude in telemetry: roll, pitch and yaw at an offset from the true ones."""

from __future__ import annotations

from math import pi, radians
from typing import Annotated, Any, Final

from pydantic import Field

import skyrange.plugin as sky
from skyrange.attack.euler_angles import euler_angles_of, quaternion_of, wrap_angle

_PARTS: Final = ("q1", "q2", "q3", "q4")
_NO_HEADING: Final = 65_535
"""GLOBAL_POSITION_INT: the heading is not known."""

Angle = Annotated[sky.Number, Field(ge=-180, le=180)]


@sky.attack(
    "telemetry.attitude",
    technique="T0856",
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
    sees = ("ATTITUDE", "ATTITUDE_QUATERNION", "AHRS2", "VFR_HUD", "GLOBAL_POSITION_INT")

    def find_problems(self) -> sky.Problems:
        if not (self.roll_deg or self.pitch_deg or self.yaw_deg):
            yield sky.Problem("roll_deg", "0", "an offset of roll, pitch or yaw other than 0")

    def alter(self, message: str, fields: Any, since_ns: sky.Time) -> bool:
        if message == "ATTITUDE_QUATERNION":
            turned = quaternion_of(*self._incline(*euler_angles_of(*(float(fields[name]) for name in _PARTS))))
            for name, value in zip(_PARTS, turned, strict=True):
                sky.put(fields, name, value)
        elif message == "VFR_HUD":
            sky.put(fields, "heading", (float(fields["heading"]) + self.yaw_deg) % 360.0 // 1)
        elif message != "GLOBAL_POSITION_INT":
            roll, pitch, yaw = self._incline(fields["roll"], float(fields["pitch"]), fields["yaw"])
            sky.put(fields, "roll", wrap_angle(roll))
            sky.put(fields, "pitch", pitch)
            sky.put(fields, "yaw", wrap_angle(yaw))
        elif fields["hdg"] != _NO_HEADING:
            sky.put(fields, "hdg", (float(fields["hdg"]) + self.yaw_deg * 100.0) % 36_000.0 // 1)
        return True

    def _incline(self, roll: float, pitch: float, yaw: float) -> tuple[float, float, float]:
        """Euler angles in radians with the offsets; the pitch within a right angle."""
        pitch = min(max(pitch + radians(self.pitch_deg), -pi / 2), pi / 2)
        return roll + radians(self.roll_deg), pitch, yaw + radians(self.yaw_deg)
