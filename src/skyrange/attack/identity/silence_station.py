"""Suppressed heartbeats: those of a ground station on the way to its aircraft, or those of the aircraft.

All other frames pass, so commands, telemetry and rates of frames look as before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Final, Literal

from pydantic import Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.on_path import SIDES, Names, TapMaker
from skyrange.attack.telemetry.alteration import FROM_AIRCRAFT, telemetry_links
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink import message_id
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.links import TapPlacement
from skyrange.contracts.params import Params
from skyrange.contracts.verdicts import Drop, Verdict
from skyrange.core.time import Time

_HEARTBEAT: Final = int(mav.MAVLINK_MSG_ID_HEARTBEAT)
ROLES: Final = ("gcs", "log", "autopilot")


class SilencedHeartbeats(Params):
    """Whose heartbeats are dropped, and where."""

    links: Annotated[Names, Field(min_length=1)] = Field(
        description="Links gcs, log or autopilot by name or pattern, such as ['gcs:blue/b1']."
    )
    towards: Literal["aircraft", "station"] = Field(
        default="aircraft",
        description="aircraft: the ground station's heartbeats are dropped, and its failsafe acts if FS_GCS_ENABLE is "
        "set; station: those of the aircraft, and the ground station takes the link for lost.",
    )


@dataclass(slots=True)
class HeartbeatFilter:
    """A tap that drops the heartbeats of one direction."""

    link: str
    direction: str

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Drop a heartbeat."""
        return [Drop()] if frame.direction == self.direction and message_id(frame.payload) == _HEARTBEAT else ()

    def next_wakeup(self) -> Time | None:
        """It acts on frames alone."""
        return None

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        """It acts on frames alone."""
        return ()


def make(params: SilencedHeartbeats, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for links that the scenario does not have, or of another kind."""
    links = telemetry_links(params.links, context, ROLES)
    taps = []
    for name in links:
        role = name.partition(":")[0]
        direction = FROM_AIRCRAFT[role] if params.towards == "station" else "fwd"
        taps.append(TapPlacement(name, SIDES[role], TapMaker(HeartbeatFilter, (direction,))))
    return Attack(taps=taps)


SILENCE_STATION = AttackPlugin(
    SilencedHeartbeats,
    make,
    "Drops heartbeats of the ground station or of the aircraft, and nothing else.",
    technique="T0803",
    counterfactual="mute",
    surface=ROLES,
    persists="acts",
    effect="the failsafe for a lost ground station acts while commands and telemetry still pass",
    threat=ThreatModel(
        knowledge="the id of HEARTBEAT, which is never encrypted",
        position="on the path between ground station and aircraft",
        equipment="a router or computer that filters frames",
        budget="no frames of its own; about one frame a second is dropped",
    ),
    controls=Controls(
        load="as many other frames dropped: link.drop with another message",
        content="none, because a drop has no content; the sham drops too",
        placement="the other direction, or another aircraft",
    ),
)
