"""False avoidance: the companion evades nobody, again and again, and hands back to the mission each time."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Final

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.compromised_companion import CompromisedCompanion
from skyrange.attack.bases.mavlink.orders import read
from skyrange.codec.mavlink import dialect as mav

_POSITION_ONLY: Final = 0b1101_1111_1000
"""POSITION_TARGET_TYPEMASK: velocity, acceleration, yaw and yaw rate are ignored."""
_UNKNOWN: Final = -1


@sky.attack(
    "companion.false_avoidance",
    technique="T0831",
    effect="the mission is late and costs more energy, by evasions that look like those of an avoidance",
    knowledge="how an avoidance changes to GUIDED and back; position and mode from telemetry on board",
    budget="three frames for each evasion, on board",
    content="a target on the course: aside_m = 0, which stops the aircraft only",
)
class FalseAvoidance(CompromisedCompanion):
    """Has a companion computer evade aircraft that are not there, and resume the mission each time.

    An evasion is GUIDED and a target beside the course, later AUTO. It starts one only while heartbeats show AUTO, as
    an avoidance does. In the sham all is addressed to nobody.
    """

    every_s: sky.Number = sky.param("Time between two evasions, in seconds.", default=15.0, ge=2, le=3600)
    hold_s: sky.Number = sky.param("Length of an evasion in seconds, shorter than every_s.", default=6.0, ge=1, le=3600)
    aside_m: sky.Number = sky.param(
        "Distance of the evasion in metres: to the right of the course, negative to the left.",
        default=20.0, ge=-1000, le=1000,
    )  # fmt: skip

    origin: sky.Origin
    clock: sky.Repetition
    mode: int = _UNKNOWN
    position: tuple[float, float, float] | None = None
    """East and north in metres from the origin, altitude above mean sea level in metres."""
    course: tuple[float, float] = (0.0, 1.0)
    """East and north, of length 1."""
    back_ns: sky.Time = sky.NEVER
    """When the mission goes on."""

    def find_problems(self) -> sky.Problems:
        if self.hold_s >= self.every_s:
            yield sky.Problem("hold_s", repr(self.hold_s), f"less than every_s, {self.every_s} s")

    def prepare(self, context: sky.AttackContext) -> None:
        self.origin = context.origin

    def begin(self) -> None:
        super().begin()
        self.clock = sky.Repetition(self.schedule, sky.from_seconds(self.every_s))

    def next_wakeup(self) -> sky.Time | None:
        begin = self.clock.due
        return begin if self.back_ns == sky.NEVER else self.back_ns if begin is None else min(begin, self.back_ns)

    def see(self, now: sky.Time, frame: sky.Frame) -> None:
        if frame.direction != "rev":
            return
        number = sky.message_id(frame.payload)
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

    def make(self, now: sky.Time) -> Iterable[bytes]:
        messages: list[sky.MavlinkMessage] = []
        if now >= self.back_ns:
            self.back_ns = sky.NEVER
            messages.append(sky.mode_order(mav.COPTER_MODE_AUTO).message(self.sender.target))
        if self.clock.take(now) and self.mode == mav.COPTER_MODE_AUTO and self.position is not None:
            self.back_ns = now + sky.from_seconds(self.hold_s)
            messages.append(sky.mode_order(mav.COPTER_MODE_GUIDED).message(self.sender.target))
            messages.append(self._target(now, self.position))
        return [self.sender.pack(message) for message in messages]

    def _target(self, now: sky.Time, place: tuple[float, float, float]) -> sky.MavlinkMessage:
        east, north = self.course
        lat, lon = self.origin.geodetic_of(place[0] + north * self.aside_m, place[1] - east * self.aside_m)
        return mav.MAVLink_set_position_target_global_int_message(
            now // 1_000_000 & 0xFFFFFFFF, self.sender.target, self.sender.component, mav.MAV_FRAME_GLOBAL_INT,
            _POSITION_ONLY, round(lat * 1e7), round(lon * 1e7), place[2], 0, 0, 0, 0, 0, 0, 0, 0,
        )  # fmt: skip
