"""False position in telemetry: an offset, or a track of the attacker's own, in all messages that tell a position."""

from __future__ import annotations

from typing import Literal

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.moved_position import POSITION_MESSAGES, STILL, MovedPosition


@sky.attack(
    "telemetry.position",
    effect="receivers of telemetry believe that the aircraft is elsewhere, and guided targets, Remote ID or avoidance "
    "follow",
    knowledge="the messages that tell a position; the true position from the frames that pass",
)
class FalsePosition(sky.AlteredTelemetry):
    """Alters the position in telemetry, in all messages that tell one."""

    form: Literal["offset", "track"] = sky.param(
        "offset: adds offset_m and drift_mps; track: claims at and velocity_mps, whatever is flown.", default="offset"
    )
    offset_m: sky.Enu = sky.param("Offset at the start, [east, north, up] in metres.", default=STILL)
    drift_mps: sky.Enu = sky.param("Growth of the offset, [east, north, up] in m/s; velocities agree.", default=STILL)
    at: sky.Enu | None = sky.place_param("Claimed position at the start", default=None)
    velocity_mps: sky.Enu = sky.param("Claimed velocity, [east, north, up] in m/s.", default=STILL)
    position: MovedPosition
    sees = POSITION_MESSAGES

    def find_problems(self) -> sky.Problems:
        if self.form == "track" and self.at is None:
            yield sky.Problem("at", "missing", "where the track begins, because form = 'track'")
        if self.form == "offset" and self.at is not None:
            yield sky.Problem("at", repr(list(self.at)), "no position with form = 'offset'", "Use offset_m.")
        if self.form == "offset" and self.offset_m == STILL and self.drift_mps == STILL:
            yield sky.Problem("offset_m", repr(list(STILL)), "an offset or a drift other than 0")

    def prepare(self, context: sky.AttackContext) -> None:
        rate = self.velocity_mps if self.form == "track" else self.drift_mps
        self.position = MovedPosition(context.origin, self.offset_m, rate, self.at)

    def marks(self) -> dict[str, sky.Place]:
        return {} if self.at is None else {"false position": self.at}

    def learn(self, message: str, fields: sky.MavlinkFields) -> None:
        self.position.learn(message, fields)

    def alter(self, message: str, fields: sky.MavlinkFields, since_ns: sky.Time) -> bool:
        return self.position.alter(message, fields, since_ns)
