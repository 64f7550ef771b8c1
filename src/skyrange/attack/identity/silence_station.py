"""Suppressed heartbeats: those of a ground station on the way to its aircraft, or those of the aircraft."""

from __future__ import annotations

from typing import Literal

import skyrange.plugin as sky
from skyrange.attack.bases.links import OnControlLinks
from skyrange.codec.mavlink import dialect as mav


@sky.attack(
    "identity.silence_station",
    technique=sky.technique_by("towards", aircraft="T0803", station="T0804"),
    mechanism="link.drop",
    counterfactual="mute",
    effect="the failsafe for a lost ground station acts while commands and telemetry still pass",
    knowledge="the id of HEARTBEAT, which is never encrypted",
    equipment="a router or computer that filters frames",
    budget="no frames of its own; about one frame a second is dropped",
    load="as many other frames dropped: link.drop with another message",
    content="none, because a drop has no content; the sham drops too",
    placement="the other direction, or another aircraft",
)
class SilencedHeartbeats(OnControlLinks):
    """Drops heartbeats of the ground station or of the aircraft, and nothing else."""

    towards: Literal["aircraft", "station"] = sky.param(
        "aircraft: the ground station's heartbeats are dropped, and its failsafe acts if FS_GCS_ENABLE is set; "
        "station: those of the aircraft, and the ground station takes the link for lost.",
        default="aircraft",
    )

    def on_frame(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        direction = "fwd" if self.towards == "aircraft" else "rev"
        beat = frame.direction == direction and sky.message_id(frame.payload) == mav.MAVLINK_MSG_ID_HEARTBEAT
        return (sky.Drop(),) if beat else ()
