"""Flight of the own aircraft as telemetry on board tells it: mode, position and course."""

from __future__ import annotations

import math
from dataclasses import dataclass

from skyrange.attack.bases.mavlink.orders import read
from skyrange.attack.contract import Place
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink import message_id
from skyrange.contracts.frames import Frame
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
        speed = math.hypot(message.vx, message.vy)
        if speed >= 100:  # cm/s
            self.course = (message.vy / speed, message.vx / speed)

    def find_place(self, aside_m: float) -> Place | None:
        """The place at its altitude that is so far to the right of it: degrees, and metres above mean sea level."""
        if self.position is None:
            return None
        (here_east, here_north, alt_m), (east, north) = self.position, self.course
        lat, lon = self.origin.geodetic_of(here_east + north * aside_m, here_north - east * aside_m)
        return lat, lon, alt_m
