"""Aircraft led along a track: position targets in GUIDED, the next one where the last is reached."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

from skyrange.attack.bases.mavlink.orders import ModeKeeper, Order, Sender, geodetic, mode_order, read
from skyrange.attack.contract import Place
from skyrange.codec.mavlink import Message, message_id
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.frames import Frame
from skyrange.contracts.links import Schedule
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_S, Time

_POSITION_ONLY: Final = 0b1101_1111_1000
"""POSITION_TARGET_TYPEMASK: velocity, acceleration, yaw and yaw rate are ignored."""
_READ: Final = frozenset((int(mav.MAVLINK_MSG_ID_HEARTBEAT), int(mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT)))


@dataclass(slots=True)
class Leader:
    """Keeps the aircraft in GUIDED and tells it the target that is next, by the position that it reports."""

    sender: Sender
    schedule: Schedule
    origin: Origin
    track: tuple[Place, ...]
    within_m: float
    lands: bool = False
    at: int = 0
    landing: bool = False
    keeper: ModeKeeper = field(init=False)

    def __post_init__(self) -> None:
        """Keep GUIDED; a sham's commands count as obeyed."""
        self.keeper = ModeKeeper(mav.COPTER_MODE_GUIDED, NS_PER_S, self.sender.is_sham)

    def see(self, now: Time, frame: Frame) -> None:
        """Learn who the station is, mode and position."""
        self.sender.see(frame)
        if frame.direction == "rev" and message_id(frame.payload) in _READ:
            message = read(frame.payload)
            if message is not None:
                self.learn(now, message)

    def learn(self, now: Time, message: Message) -> None:
        """Learn mode or position from a HEARTBEAT or a GLOBAL_POSITION_INT of the aircraft."""
        if type(message).id == mav.MAVLINK_MSG_ID_HEARTBEAT:
            self.keeper.learn(message)
            return
        if now < self.schedule.start_ns or self.keeper.seen != mav.COPTER_MODE_GUIDED:
            return
        east, north = self.origin.enu_of(message.lat * 1e-7, message.lon * 1e-7)
        here = (east, north, message.alt * 1e-3 - self.origin.alt_msl_m)
        if math.dist(here, self.track[self.at]) <= self.within_m:
            if self.at + 1 < len(self.track):
                self.at += 1
            else:
                self.landing = self.lands

    def orders(self, now: Time) -> list[Order | Message]:
        """A change of mode, if one is needed, and the target."""
        if self.landing:
            return [] if self.keeper.seen == mav.COPTER_MODE_LAND else [mode_order(mav.COPTER_MODE_LAND)]
        return [*self.keeper.orders(now), target_message(now, self.sender, geodetic(self.origin, self.track[self.at]))]


def target_message(now: Time, sender: Sender, place: Place) -> Message:
    """The position target for who a sender addresses: degrees, and metres above mean sea level."""
    lat, lon, alt_m = place
    return mav.MAVLink_set_position_target_global_int_message(
        now // 1_000_000 & 0xFFFFFFFF, sender.target, sender.component, mav.MAV_FRAME_GLOBAL_INT,
        _POSITION_ONLY, round(lat * 1e7), round(lon * 1e7), alt_m, 0, 0, 0, 0, 0, 0, 0, 0,
    )  # fmt: skip
