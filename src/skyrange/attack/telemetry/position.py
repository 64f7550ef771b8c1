"""False position in telemetry: an offset, or a track of the attacker's own, in all messages that tell a position."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.moved_position import POSITION_MESSAGES, STILL, MovedPosition


@sky.attack(
    "telemetry.position",
    technique="T0856",
    effect="receivers of telemetry believe that the aircraft is elsewhere, and guided targets, Remote ID or avoidance "
    "follow",
    knowledge="the messages that tell a position; the true position from the frames that pass",
)
class FalsePosition(sky.AlteredTelemetry):
    """Alters the position in telemetry, in all messages that tell one.

    The aircraft appears at an offset from its position, or on a track of the attacker's.
    """

    form: Literal["offset", "track"] = sky.param(
        "offset: the true position and offset_m; track: positions along a line, whatever the aircraft does.",
        default="offset",
    )
    offset_m: sky.Enu = sky.param(
        "Offset at the start of the attack, [east, north, up] in metres; form = 'offset'.", default=STILL
    )
    drift_mps: sky.Enu = sky.param(
        "Growth of the offset, [east, north, up] in m/s; reported velocities agree. form = 'offset'.", default=STILL
    )
    at: sky.Enu | None = sky.param(
        "Claimed position at the start of the attack, [east_m, north_m, up_m] in metres from the origin or the "
        "attack's anchor; form = 'track'.",
        default=None,
    )
    velocity_mps: sky.Enu = sky.param("Claimed velocity, [east, north, up] in m/s; form = 'track'.", default=STILL)
    position: MovedPosition
    sees = POSITION_MESSAGES

    def find_problems(self) -> sky.Problems:
        """A form without its parameters, or with those of the other."""
        if self.form == "track" and self.at is None:
            yield sky.Problem("at", "missing", "where the track begins, because form = 'track'")
        if self.form == "offset" and self.at is not None:
            yield sky.Problem("at", repr(list(self.at)), "no position with form = 'offset'", "Use offset_m.")
        if self.form == "offset" and self.offset_m == STILL and self.drift_mps == STILL:
            yield sky.Problem("offset_m", repr(list(STILL)), "an offset or a drift other than 0")

    def prepare(self, context: sky.AttackContext) -> None:
        rate = self.velocity_mps if self.form == "track" else self.drift_mps
        self.position = MovedPosition(context.origin, self.offset_m, rate, self.at)

    def build(self, context: sky.AttackContext) -> sky.Attack:
        """See `AlteredTelemetry`."""
        return replace(super().build(context), shown={} if self.at is None else {"false position": self.at})

    def learn(self, message: str, fields: Any) -> None:
        self.position.learn(message, fields)

    def alter(self, message: str, fields: Any, since_ns: sky.Time) -> bool:
        return self.position.alter(message, fields, since_ns)
