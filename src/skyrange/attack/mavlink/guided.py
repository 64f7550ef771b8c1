"""Hijack: the aircraft is changed to GUIDED and led along a track by position targets."""

from __future__ import annotations

from typing import Literal

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.orders import Leader
from skyrange.attack.bases.mavlink.params import Track


@sky.attack(
    "mavlink.guided",
    technique="T0831",
    places=("radio_m",),
    persists="mode",
    effect="the aircraft flies to a place that the attacker chose and stays there or lands",
    knowledge="system ids, and mode and position that telemetry tells",
    budget="one or two frames for each target",
    load="the sham: as many frames of the same lengths; for a target a frame that the aircraft does not read",
    content="targets along the plan of the aircraft itself",
    placement="the same track for another aircraft",
)
class Hijack(sky.Injection):
    """Changes the aircraft to GUIDED and leads it along a track to another place."""

    reads = ("HEARTBEAT", "GLOBAL_POSITION_INT")

    track: Track = sky.param("Places in order, each [east_m, north_m, up_m] in metres from the origin.")
    within_m: sky.Number = sky.param("Distance in metres at which a place is reached.", default=3.0, gt=0, le=1000)
    every_s: sky.Number = sky.param("Time between two targets, in seconds.", default=0.5, ge=0.02, le=10)
    then: Literal["hold", "land"] = sky.param("At the last place: hold it, or land there (mode LAND).", default="hold")
    leader: Leader

    def begin(self) -> None:
        super().begin()
        self.leader = Leader(self.claimed, self.schedule, self.origin, self.track, self.within_m, self.then == "land")

    def marks(self) -> dict[str, sky.Place]:
        return {"end of the track": self.track[-1]}

    def on_message(self, now: sky.Time, message: sky.MavlinkMessage) -> None:
        self.leader.learn(now, message)

    def orders(self, now: sky.Time) -> list[sky.Order | sky.MavlinkMessage]:
        return self.leader.orders(now)
