"""False avoidance: the companion evades nobody, again and again, and hands back to the mission each time."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Final

from skyrange.attack.bases.mavlink.compromised_companion import CompromisedCompanion
from skyrange.attack.bases.mavlink.orders import mode_order, read
from skyrange.attack.contract import AttackContext, Controls
from skyrange.attack.declaration import attack
from skyrange.attack.presets import ANOTHER_COMPANION, in_companion
from skyrange.attack.tapped_links import Repetition
from skyrange.codec.mavlink import Message, message_id
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.params import Number
from skyrange.contracts.plugins.fields import param
from skyrange.core.errors import Problem
from skyrange.core.geodesy import Origin
from skyrange.core.time import NEVER, Time, from_seconds

_POSITION_ONLY: Final = 0b1101_1111_1000
"""POSITION_TARGET_TYPEMASK: velocity, acceleration, yaw and yaw rate are ignored."""
_UNKNOWN: Final = -1


@attack(
    "companion.false_avoidance",
    technique="T0831",
    surface=("log",),
    persists="acts",
    effect="the mission is late and costs more energy, by evasions that look like those of an avoidance",
    threat=in_companion(
        "how an avoidance changes to GUIDED and back; position and mode from telemetry on board",
        budget="three frames for each evasion, on board",
    ),
    controls=Controls(
        load="the sham: the same orders, addressed to a system that is not there",
        content="a target on the course: aside_m = 0, which stops the aircraft only",
        placement=ANOTHER_COMPANION,
    ),
)
class FalseAvoidance(CompromisedCompanion):
    """Has a companion computer evade aircraft that are not there, and resume the mission each time.

    An evasion is GUIDED and a target beside the course, later AUTO. It starts one only while heartbeats show AUTO, as
    an avoidance does. In the sham all is addressed to nobody.
    """

    every_s: Number = param("Time between two evasions, in seconds.", default=15.0, ge=2, le=3600)
    hold_s: Number = param("Length of an evasion in seconds, shorter than every_s.", default=6.0, ge=1, le=3600)
    aside_m: Number = param(
        "Distance of the evasion in metres: to the right of the course, negative to the left.",
        default=20.0, ge=-1000, le=1000,
    )  # fmt: skip

    origin: Origin
    clock: Repetition
    mode: int = _UNKNOWN
    position: tuple[float, float, float] | None = None
    """East and north in metres from the origin, altitude above mean sea level in metres."""
    course: tuple[float, float] = (0.0, 1.0)
    """East and north, of length 1."""
    back_ns: Time = NEVER
    """When the mission goes on."""

    def find_problems(self) -> Iterator[Problem]:
        """An evasion ends before the next."""
        if self.hold_s >= self.every_s:
            yield Problem("hold_s", repr(self.hold_s), f"less than every_s, {self.every_s} s")

    def prepare(self, context: AttackContext) -> None:
        """Learn the origin."""
        self.origin = context.origin

    def begin(self) -> None:
        """Begin the repetition."""
        super().begin()
        self.clock = Repetition(self.schedule, from_seconds(self.every_s))

    def next_wakeup(self) -> Time | None:
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
        self.position = (east, north, message.alt * 1e-3)
        speed = math.hypot(message.vx, message.vy)
        if speed >= 100:  # cm/s
            self.course = (message.vy / speed, message.vx / speed)

    def make(self, now: Time) -> Iterable[bytes]:
        """The orders that are due."""
        messages: list[Message] = []
        if now >= self.back_ns:
            self.back_ns = NEVER
            messages.append(mode_order(mav.COPTER_MODE_AUTO).message(self.sender.target))
        if self.clock.take(now) and self.mode == mav.COPTER_MODE_AUTO and self.position is not None:
            self.back_ns = now + from_seconds(self.hold_s)
            messages.append(mode_order(mav.COPTER_MODE_GUIDED).message(self.sender.target))
            messages.append(self._target(now, self.position))
        return [self.sender.pack(message) for message in messages]

    def _target(self, now: Time, place: tuple[float, float, float]) -> Message:
        east, north = self.course
        lat, lon = self.origin.geodetic_of(place[0] + north * self.aside_m, place[1] - east * self.aside_m)
        return mav.MAVLink_set_position_target_global_int_message(
            now // 1_000_000 & 0xFFFFFFFF, self.sender.target, self.sender.component, mav.MAV_FRAME_GLOBAL_INT,
            _POSITION_ONLY, round(lat * 1e7), round(lon * 1e7), place[2], 0, 0, 0, 0, 0, 0, 0, 0,
        )  # fmt: skip
