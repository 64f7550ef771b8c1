"""Suppressed heartbeats: those of a ground station on the way to its aircraft, or those of the aircraft.

All other frames pass, so commands, telemetry and rates of frames look as before.
"""

from __future__ import annotations

from typing import Literal

import skyrange.plugin as sky
from skyrange.attack.bases.roles import LINKS_ABOUT, find_links
from skyrange.codec.mavlink import dialect as mav


@sky.attack(
    "identity.silence_station",
    technique="T0803",
    counterfactual="mute",
    surface=("gcs", "log", "autopilot"),
    persists="acts",
    effect="the failsafe for a lost ground station acts while commands and telemetry still pass",
    knowledge="the id of HEARTBEAT, which is never encrypted",
    position="on the path between ground station and aircraft",
    equipment="a router or computer that filters frames",
    budget="no frames of its own; about one frame a second is dropped",
    load="as many other frames dropped: link.drop with another message",
    content="none, because a drop has no content; the sham drops too",
    placement="the other direction, or another aircraft",
)
class SilencedHeartbeats(sky.LinkTap):
    """Drops heartbeats of the ground station or of the aircraft, and nothing else."""

    links: sky.LinkNames = sky.param(LINKS_ABOUT)
    towards: Literal["aircraft", "station"] = sky.param(
        "aircraft: the ground station's heartbeats are dropped, and its failsafe acts if FS_GCS_ENABLE is set; "
        "station: those of the aircraft, and the ground station takes the link for lost.",
        default="aircraft",
    )

    def build(self, context: sky.AttackContext) -> sky.Attack:
        """A tap on each link. Raises `InputError` for links that the scenario does not have, or of another kind."""
        return sky.Attack(taps=self.place(find_links(self.links, context, sky.CONTROL_LINKS), context))

    def on_frame(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        way = "fwd" if self.towards == "aircraft" else "rev"
        return (
            (sky.Drop(),)
            if frame.direction == way and sky.message_id(frame.payload) == mav.MAVLINK_MSG_ID_HEARTBEAT
            else ()
        )
