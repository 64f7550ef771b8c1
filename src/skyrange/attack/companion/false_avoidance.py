"""False avoidance: the companion evades nobody, again and again, and hands back to the mission each time."""

from __future__ import annotations

from dataclasses import dataclass

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.compromised_sender import CompromisedCompanion
from skyrange.attack.bases.mavlink.orders import read, target_message
from skyrange.attack.contract import Place
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink import message_id
from skyrange.contracts.frames import Frame
from skyrange.core import elementary
from skyrange.core.geodesy import Origin

_READ = (mav.MAVLINK_MSG_ID_HEARTBEAT, mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT)


@dataclass(slots=True)
class OwnFlight:
    """What was told last."""

    origin: Origin
    mode: int = -1
    position: Place | None = None
    """East and north in metres from the origin, altitude above mean sea level in metres."""
    course: tuple[float, float] = (0.0, 1.0)
    """East and north, of length 1."""

    def see(self, frame: Frame) -> None:
        """Learn from a frame of the autopilot."""
        if frame.direction != "rev" or message_id(frame.payload) not in _READ:
            return
        message = read(frame.payload)
        if message is None or message.get_srcComponent() != mav.MAV_COMP_ID_AUTOPILOT1:
            return
        if message.get_msgId() == mav.MAVLINK_MSG_ID_HEARTBEAT:
            self.mode = message.custom_mode
            return
        east, north = self.origin.enu_of(message.lat * 1e-7, message.lon * 1e-7)
        self.position = (east, north, message.alt * 1e-3)
        speed = elementary.hypot(message.vx, message.vy)
        if speed >= 100:  # cm/s
            self.course = (message.vy / speed, message.vx / speed)

    def find_place(self, aside_m: float) -> Place | None:
        """The place at its altitude that is so far to the right of it: degrees, and metres above mean sea level."""
        if self.position is None:
            return None
        (here_east, here_north, alt_m), (east, north) = self.position, self.course
        lat, lon = self.origin.geodetic_of(here_east + north * aside_m, here_north - east * aside_m)
        return lat, lon, alt_m


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
    an avoidance does. The frames of the sham change nothing.
    """

    every_s: sky.Number = sky.param("Time between two evasions, in seconds.", default=15.0, ge=2, le=3600)
    hold_s: sky.Number = sky.param("Length of an evasion in seconds, shorter than every_s.", default=6.0, ge=1, le=3600)
    aside_m: sky.Number = sky.param(
        "Evasion in metres to the right of the course, negative to the left.", default=20.0, ge=-1000, le=1000
    )
    flight: OwnFlight
    back_ns: sky.Time | None = None
    """When the mission goes on."""

    def find_problems(self) -> sky.Problems:
        if self.hold_s >= self.every_s:
            yield sky.Problem("hold_s", repr(self.hold_s), f"less than every_s, {self.every_s} s")

    def begin(self) -> None:
        super().begin()
        self.flight = OwnFlight(self.origin)

    def see(self, now: sky.Time, frame: sky.Frame) -> None:
        self.flight.see(frame)

    def next_wakeup(self) -> sky.Time | None:
        return min((due for due in (self.clock.due, self.back_ns) if due is not None), default=None)

    def on_wakeup(self, now: sky.Time) -> sky.Verdicts:
        """Go back to the mission, or begin an evasion."""
        back: list[sky.Inject] = []
        if self.back_ns is not None and now >= self.back_ns:
            self.back_ns = None
            back = self.command([sky.mode_order(mav.COPTER_MODE_AUTO)])
        return [*back, *super().on_wakeup(now)]

    def orders(self, now: sky.Time) -> list[sky.Order | sky.MavlinkMessage]:
        place = self.flight.find_place(self.aside_m)
        if self.flight.mode != mav.COPTER_MODE_AUTO or place is None:
            return []
        self.back_ns = now + sky.from_seconds(self.hold_s)
        return [sky.mode_order(mav.COPTER_MODE_GUIDED), target_message(now, self.sender, place)]
