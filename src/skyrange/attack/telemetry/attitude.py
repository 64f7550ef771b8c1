"""False attitude in telemetry: roll, pitch and yaw at an offset from the true ones."""

from __future__ import annotations

from dataclasses import dataclass
from math import asin, atan2, cos, pi, radians, sin
from typing import Annotated, Any, Final

from pydantic import Field, model_validator

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin
from skyrange.attack.telemetry.alteration import CONTROLS, TelemetryLinks, alter_telemetry, put, threat
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.params import Number, refuse
from skyrange.core.errors import Problem
from skyrange.core.time import Time

_ATTITUDE: Final = int(mav.MAVLINK_MSG_ID_ATTITUDE)
_QUATERNION: Final = int(mav.MAVLINK_MSG_ID_ATTITUDE_QUATERNION)
_AHRS2: Final = int(mav.MAVLINK_MSG_ID_AHRS2)
_HUD: Final = int(mav.MAVLINK_MSG_ID_VFR_HUD)
_POSITION: Final = int(mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT)
_PARTS: Final = ("q1", "q2", "q3", "q4")
_NO_HEADING: Final = 65_535
"""GLOBAL_POSITION_INT: the heading is not known."""

Angle = Annotated[Number, Field(ge=-180, le=180)]


class FalseAttitude(TelemetryLinks):
    """The aircraft seems to be inclined or turned."""

    roll_deg: Angle = Field(default=0.0, description="Offset of roll in degrees, right wing down.")
    pitch_deg: Angle = Field(default=0.0, description="Offset of pitch in degrees, nose up.")
    yaw_deg: Angle = Field(default=0.0, description="Offset of heading in degrees, clockwise.")

    @model_validator(mode="after")
    def _turns(self) -> FalseAttitude:
        if not (self.roll_deg or self.pitch_deg or self.yaw_deg):
            raise refuse(Problem("roll_deg", "0", "an offset of roll, pitch or yaw other than 0"))
        return self


@dataclass(slots=True)
class AttitudeAlteration:
    """Adds the offsets to the Euler angles; headings turn by the offset of yaw."""

    roll_rad: float
    pitch_rad: float
    yaw_deg: float

    @property
    def messages(self) -> frozenset[int]:
        """All messages with an attitude or a heading."""
        return frozenset((_ATTITUDE, _QUATERNION, _AHRS2, _HUD, _POSITION))

    def alter(self, since_ns: Time, number: int, fields: Any) -> bool:
        """See `Alteration`."""
        if number in (_ATTITUDE, _AHRS2):
            put(fields, "roll", _wrapped(fields["roll"] + self.roll_rad))
            put(fields, "pitch", min(max(float(fields["pitch"]) + self.pitch_rad, -pi / 2), pi / 2))
            put(fields, "yaw", _wrapped(fields["yaw"] + radians(self.yaw_deg)))
        elif number == _QUATERNION:
            roll, pitch, yaw = _euler_angles(*(float(fields[name]) for name in _PARTS))
            pitch = min(max(pitch + self.pitch_rad, -pi / 2), pi / 2)
            turned = _quaternion(roll + self.roll_rad, pitch, yaw + radians(self.yaw_deg))
            for name, value in zip(_PARTS, turned, strict=True):
                put(fields, name, value)
        elif number == _HUD:
            put(fields, "heading", (float(fields["heading"]) + self.yaw_deg) % 360.0 // 1)
        elif fields["hdg"] != _NO_HEADING:
            put(fields, "hdg", (float(fields["hdg"]) + self.yaw_deg * 100.0) % 36_000.0 // 1)
        return True


def _wrapped(angle_rad: float) -> float:
    return (float(angle_rad) + pi) % (2 * pi) - pi


def _euler_angles(w: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Roll, pitch and yaw in radians of a quaternion, in aerospace sequence."""
    return (
        atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        asin(min(max(2 * (w * y - z * x), -1.0), 1.0)),
        atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
    )


def _quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """The quaternion w, x, y, z of Euler angles in radians, in aerospace sequence."""
    cr, cp, cy = cos(roll / 2), cos(pitch / 2), cos(yaw / 2)
    sr, sp, sy = sin(roll / 2), sin(pitch / 2), sin(yaw / 2)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def make(params: FalseAttitude, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for links that the scenario does not have, or that carry no telemetry."""
    alteration = AttitudeAlteration(radians(params.roll_deg), radians(params.pitch_deg), params.yaw_deg)
    return alter_telemetry(params.links, context, alteration)


ATTITUDE = AttackPlugin(
    FalseAttitude,
    make,
    "Alters roll, pitch and heading in telemetry.",
    technique="T0856",
    surface=("gcs", "log", "autopilot"),
    persists="acts",
    effect="the ground station shows an aircraft that is inclined or turned, and a pilot would correct it",
    threat=threat("the messages with attitude and heading"),
    controls=CONTROLS,
)
