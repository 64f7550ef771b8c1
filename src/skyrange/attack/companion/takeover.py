"""Takeover by the companion: it leads its own aircraft away, and forwards no order of the operator."""

from __future__ import annotations

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.compromised_sender import CompromisedCompanion
from skyrange.attack.bases.mavlink.orders import Leader
from skyrange.attack.bases.mavlink.params import Track


@sky.attack(
    "companion.takeover",
    technique="T0813",
    places=(),
    persists="mode",
    effect="the aircraft obeys its companion alone; the operator sees it leave and cannot call it back",
    knowledge="what the companion has: telemetry, the operator's orders, and the key of a signed link",
    position="in the companion computer, through which the control link passes",
    budget="one or two frames for each target, on board",
    load="the sham: as many frames of the same lengths, which change nothing; orders of the operator pass",
    content="targets along the plan of the aircraft itself",
)
class Takeover(CompromisedCompanion):
    """Has a companion computer fly its aircraft away and hold back the orders of the operator."""

    track: Track = sky.param(
        "Places to lead the aircraft to, in order, each [east_m, north_m, up_m] in metres from the origin."
    )
    within_m: sky.Number = sky.param("Distance at which a place is reached, in metres.", default=3.0, gt=0, le=1000)
    every_s: sky.Number = sky.param("Time between two targets, in seconds.", default=0.5, ge=0.02, le=10)
    holds_back = "station"
    leader: Leader

    def marks(self) -> dict[str, sky.Place]:
        return {"end of the track": self.track[-1]}

    def begin(self) -> None:
        super().begin()
        self.leader = Leader(self.sender, self.schedule, self.origin, self.track, self.within_m)

    def see(self, now: sky.Time, frame: sky.Frame) -> None:
        self.leader.see(now, frame)

    def orders(self, now: sky.Time) -> list[sky.Order | sky.MavlinkMessage]:
        return self.leader.orders(now)
