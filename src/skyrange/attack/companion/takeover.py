"""Takeover by the companion: it leads its own aircraft away, and forwards no order of the operator."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from skyrange.attack.bases.mavlink.compromised_companion import CompromisedCompanion
from skyrange.attack.bases.mavlink.leading import Leader
from skyrange.attack.bases.mavlink.params import Track
from skyrange.attack.contract import Attack, AttackContext, Controls
from skyrange.attack.declaration import attack
from skyrange.attack.presets import ANOTHER_COMPANION, in_companion
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.params import Number
from skyrange.contracts.plugins.fields import param
from skyrange.core.geodesy import Origin
from skyrange.core.time import Time, from_seconds


@attack(
    "companion.takeover",
    technique="T0813",
    surface=("log",),
    persists="mode",
    effect="the aircraft obeys its companion alone; the operator sees it leave and cannot call it back",
    places=(),
    threat=in_companion(
        "what the companion has: telemetry, the operator's orders, and the key of a signed link",
        position="in the companion computer, through which the control link passes",
        budget="one or two frames for each target, on board",
    ),
    controls=Controls(
        load="the sham: the same targets, addressed to a system that is not there; orders of the operator pass",
        content="targets along the plan of the aircraft itself",
        placement=ANOTHER_COMPANION,
    ),
)
class Takeover(CompromisedCompanion):
    """Has a companion computer fly its aircraft away and hold back the orders of the operator."""

    track: Track = param(
        "Places to lead the aircraft to, in order, each [east_m, north_m, up_m] in metres from the origin."
    )
    within_m: Number = param("Distance at which a place counts as reached, in metres.", default=3.0, gt=0, le=1000)
    every_s: Number = param("Time between two targets, in seconds.", default=0.5, ge=0.02, le=10)

    holds_back = "station"
    origin: Origin
    leader: Leader

    def build(self, context: AttackContext) -> Attack:
        """A tap in each companion, and where it leads."""
        return replace(super().build(context), shown={"end of the track": self.track[-1]})

    def prepare(self, context: AttackContext) -> None:
        """Learn the origin."""
        self.origin = context.origin

    def begin(self) -> None:
        """Begin the track."""
        super().begin()
        period_ns = from_seconds(self.every_s)
        self.leader = Leader(self.sender, self.schedule, self.origin, self.track, self.within_m, period_ns, False)

    def see(self, now: Time, frame: Frame) -> None:
        """Learn mode and position."""
        self.leader.see(now, frame)

    def next_wakeup(self) -> Time | None:
        """When the next target is due."""
        return self.leader.due

    def make(self, now: Time) -> Iterable[bytes]:
        """A change of mode, if one is needed, and the target."""
        return [payload for _, payload in self.leader.make(now)]
