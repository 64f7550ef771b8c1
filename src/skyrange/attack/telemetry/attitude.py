"""False attitude in telemetry: roll, pitch and yaw at an offset from the true ones."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.turned_attitude import ATTITUDE_MESSAGES, turn_attitude

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
