"""Heartbeats in the name of a ground station that was cut off, so that no failsafe acts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Final

from pydantic import Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.identity.silence_station import ROLES
from skyrange.attack.on_path import Names, Repetition, ends_of, side_of
from skyrange.attack.telemetry.alteration import telemetry_links
from skyrange.codec.mavlink import Packer, message_id
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.links import Schedule, TapPlacement
from skyrange.contracts.params import Number, Params, Whole
from skyrange.contracts.verdicts import Drop, Inject, Verdict
from skyrange.core.time import Time, from_seconds

_HEARTBEAT: Final = int(mav.MAVLINK_MSG_ID_HEARTBEAT)
STATION_SYSTEM: Final = 255
"""Default of SYSID_MYGCS, the system id of a ground station."""
FOREIGN_SYSTEM: Final = 254
"""System id in the heartbeats of the sham: a ground station that is not the aircraft's."""
ByteId = Annotated[Whole, Field(ge=1, le=255)]


class KeptAlive(Params):
    """The links on which the station is replaced, and by which heartbeats."""

    links: Annotated[Names, Field(min_length=1)] = Field(
        description="Links gcs, log or autopilot by name or pattern, such as ['gcs:blue/b1']."
    )
    cut: bool = Field(
        default=True,
        description="Whether all frames towards the aircraft are dropped; otherwise something else has to cut them.",
    )
    every_s: Number = Field(default=1.0, ge=0.1, le=60, description="Time between two heartbeats, in seconds.")
    system: ByteId | None = Field(
        default=None,
        description="System id in the heartbeats; default: that of the last heartbeat that passed, 255 before the "
        "first.",
    )


@dataclass(slots=True)
class StationSubstitute:
    """A tap that cuts off the ground station and sends heartbeats in its name; the sham sends those of another one."""

    link: str
    cut: bool
    system: int | None
    schedule: Schedule
    repetition: Repetition
    sham: bool
    packer: Packer

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Drop what goes to the aircraft; learn the station's ids from its heartbeats."""
        payload = frame.payload
        if frame.direction != "fwd":
            return ()
        if message_id(payload) == _HEARTBEAT and payload[0] == mav.PROTOCOL_MARKER_V2:
            if not self.sham and self.system is None:
                self.packer.system = payload[5]
            self.packer.component = payload[6]
        return [Drop()] if self.cut and now >= self.schedule.start_ns else ()

    def next_wakeup(self) -> Time | None:
        """When the next heartbeat is due."""
        return self.repetition.due

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        """Inject a heartbeat of a ground station."""
        if not self.repetition.take(now):
            return ()
        beat = mav.MAVLink_heartbeat_message(mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID, 0, 0, mav.MAV_STATE_ACTIVE, 3)
        return [Inject(self.packer.pack(beat), "fwd", *ends_of(self.link, "fwd"))]


@dataclass(frozen=True, slots=True)
class _MakeSubstitute:
    params: KeptAlive
    schedule: Schedule
    sham: bool

    def __call__(self, link: str) -> StationSubstitute:
        system = FOREIGN_SYSTEM if self.sham else self.params.system or STATION_SYSTEM
        repetition = Repetition(self.schedule, from_seconds(self.params.every_s))
        return StationSubstitute(
            link, self.params.cut, self.params.system, self.schedule, repetition, self.sham,
            Packer(system, mav.MAV_COMP_ID_MISSIONPLANNER),
        )  # fmt: skip


def make(params: KeptAlive, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for links that the scenario does not have, or of another kind."""
    maker = _MakeSubstitute(params, context.schedule, context.sham)
    links = telemetry_links(params.links, context, ROLES)
    return Attack(taps=[TapPlacement(name, side_of(name), maker) for name in links])


KEEP_ALIVE = AttackPlugin(
    KeptAlive,
    make,
    "Cuts off the ground station and sends heartbeats in its name.",
    technique="T0849",
    surface=ROLES,
    persists="acts",
    effect="the aircraft flies on without supervision, because its failsafe does not notice the lost station",
    threat=ThreatModel(
        knowledge="the system id of the ground station, which its heartbeats tell",
        position="on the path between ground station and aircraft",
        equipment="a computer that filters frames and sends MAVLink",
        budget="a frame of 21 bytes per heartbeat",
    ),
    controls=Controls(
        load="the sham: the same cut, with heartbeats of a ground station that is not the aircraft's",
        content="the same attack with cut = false",
        placement="the same attack on the link of another aircraft",
    ),
)
