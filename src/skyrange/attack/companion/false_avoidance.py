"""False avoidance: the companion evades nobody, again and again, and hands back to the mission each time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, Literal

from pydantic import Field, model_validator

from skyrange.attack.bases.mavlink_orders import Sender, mode_order, read
from skyrange.attack.companion.own_commands import compromise_companions
from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.on_path import Repetition
from skyrange.attack.victims import Victims
from skyrange.codec.mavlink import Message, message_id
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.links import Schedule
from skyrange.contracts.params import Number, Params, refuse
from skyrange.core.errors import Problem
from skyrange.core.geodesy import Origin
from skyrange.core.time import NEVER, Time, from_seconds

_POSITION_ONLY: Final = 0b1101_1111_1000
"""POSITION_TARGET_TYPEMASK: velocity, acceleration, yaw and yaw rate are ignored."""
_UNKNOWN: Final = -1


class FalseAvoidance(Params):
    """How often, how far and how long it evades."""

    vehicles: Victims = Field(description="Aircraft whose companion is compromised, such as ['blue/b1'].")
    every_s: Number = Field(default=15.0, ge=2, le=3600, description="Time between two evasions, in seconds.")
    hold_s: Number = Field(
        default=6.0, ge=1, le=3600, description="Length of an evasion in seconds, shorter than every_s."
    )
    aside_m: Number = Field(
        default=20.0,
        ge=-1000,
        le=1000,
        description="Distance of the evasion in metres: to the right of the course, negative to the left.",
    )

    @model_validator(mode="after")
    def _ends_before_the_next(self) -> FalseAvoidance:
        if self.hold_s >= self.every_s:
            raise refuse(Problem("hold_s", repr(self.hold_s), f"less than every_s, {self.every_s} s"))
        return self


@dataclass(slots=True)
class Evasions:
    """A source of evasions: GUIDED and a target beside the course, later AUTO.

    It starts one only while heartbeats show AUTO, as an avoidance does. In the sham all is addressed to nobody.
    """

    sender: Sender
    schedule: Schedule
    origin: Origin
    period_ns: Time
    hold_ns: Time
    aside_m: float
    mode: int = _UNKNOWN
    place: tuple[float, float, float] | None = None
    """East and north in metres from the origin, altitude above mean sea level in metres."""
    course: tuple[float, float] = (0.0, 1.0)
    """East and north, of length 1."""
    back_ns: Time = NEVER
    """When the mission goes on."""
    clock: Repetition = field(init=False)

    def __post_init__(self) -> None:
        self.clock = Repetition(self.schedule, self.period_ns)

    @property
    def due(self) -> Time | None:
        """When the next evasion begins or ends."""
        begin = self.clock.due
        return begin if self.back_ns == NEVER else self.back_ns if begin is None else min(begin, self.back_ns)

    def see(self, now: Time, frame: Frame) -> None:
        """Learn mode, position and course."""
        if frame.direction != "rev":
            return
        number = message_id(frame.payload)
        if number not in (mav.MAVLINK_MSG_ID_HEARTBEAT, mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT):
            return
        message = read(frame.payload)
        if message is None or message.get_srcComponent() != mav.MAV_COMP_ID_AUTOPILOT1:
            return
        if number == mav.MAVLINK_MSG_ID_HEARTBEAT:
            self.mode = message.custom_mode
            return
        east, north = self.origin.enu_of(message.lat * 1e-7, message.lon * 1e-7)
        self.place = (east, north, message.alt * 1e-3)
        speed = math.hypot(message.vx, message.vy)
        if speed >= 100:  # cm/s
            self.course = (message.vy / speed, message.vx / speed)

    def make(self, now: Time) -> Sequence[tuple[Literal["fwd"], bytes]]:
        """The orders that are due."""
        messages: list[Message] = []
        if now >= self.back_ns:
            self.back_ns = NEVER
            messages.append(mode_order(mav.COPTER_MODE_AUTO).message(self.sender.target))
        if self.clock.take(now) and self.mode == mav.COPTER_MODE_AUTO and self.place is not None:
            self.back_ns = now + self.hold_ns
            messages.append(mode_order(mav.COPTER_MODE_GUIDED).message(self.sender.target))
            messages.append(self._target(now, self.place))
        return [("fwd", self.sender.pack(message)) for message in messages]

    def _target(self, now: Time, place: tuple[float, float, float]) -> Message:
        east, north = self.course
        lat, lon = self.origin.geodetic_of(place[0] + north * self.aside_m, place[1] - east * self.aside_m)
        return mav.MAVLink_set_position_target_global_int_message(
            now // 1_000_000 & 0xFFFFFFFF, self.sender.target, self.sender.component, mav.MAV_FRAME_GLOBAL_INT,
            _POSITION_ONLY, round(lat * 1e7), round(lon * 1e7), place[2], 0, 0, 0, 0, 0, 0, 0, 0,
        )  # fmt: skip


def make(params: FalseAvoidance, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for aircraft that are not in the scenario."""
    arguments = (
        context.schedule, context.origin, from_seconds(params.every_s), from_seconds(params.hold_s), params.aside_m,
    )  # fmt: skip
    return compromise_companions(params.vehicles, context, source=Evasions, arguments=arguments)


FALSE_AVOIDANCE = AttackPlugin(
    FalseAvoidance,
    make,
    "Has a companion computer evade aircraft that are not there, and resume the mission each time.",
    technique="T0831",
    surface=("log",),
    persists="acts",
    effect="the mission is late and costs more energy, by evasions that look like those of an avoidance",
    threat=ThreatModel(
        knowledge="how an avoidance changes to GUIDED and back; position and mode from telemetry on board",
        position="in the companion computer",
        equipment="a program on the companion: from its supply chain, an update or a remote login",
        budget="three frames for each evasion, on board",
    ),
    controls=Controls(
        load="the sham: the same orders, addressed to a system that is not there",
        content="a target on the course: aside_m = 0, which stops the aircraft only",
        placement="the companion of another aircraft",
    ),
)
