"""Flight that a compromised ground station shows: telemetry of an aircraft that goes on with its plan.

From the start of the attack the shown aircraft moves along the uploaded mission, or to the last guided target, with
the speed that was reported. Mode, armed state and state of the mission stay what they were. Attitude, the target of the
autopilot (POSITION_TARGET_GLOBAL_INT, NAV_CONTROLLER_OUTPUT) and Remote ID stay true.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Final

from skyrange.attack.bases.mavlink.compromised_sender import without_signature
from skyrange.attack.bases.mavlink.message_fields import put, read_fields, write_alteration
from skyrange.attack.bases.mavlink.moved_position import POSITION_MESSAGES, STILL, MovedPosition
from skyrange.attack.bases.mavlink.orders import AUTOPILOT, read
from skyrange.attack.contract import Place
from skyrange.attack.tapped_links import MESSAGE_NUMBERS
from skyrange.codec.mavlink import Message, message_id
from skyrange.codec.mavlink import dialect as mav
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_S, Time

_ITEM: Final = int(mav.MAVLINK_MSG_ID_MISSION_ITEM_INT)
_TARGET: Final = int(mav.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT)
_ABOVE_SEA: Final = (mav.MAV_FRAME_GLOBAL, mav.MAV_FRAME_GLOBAL_INT)
_RETURN: Final = int(mav.MAV_CMD_NAV_RETURN_TO_LAUNCH)
_ARMED: Final = int(mav.MAV_MODE_FLAG_SAFETY_ARMED)
_AIRBORNE_M: Final = 1.0
_FROZEN: Final = {
    "HEARTBEAT": ("base_mode", "custom_mode", "system_status"),
    "MISSION_CURRENT": ("mission_state", "mission_mode"),
}
"""Fields that keep the value from before the attack."""
SHOWN_MESSAGES: Final = (*_FROZEN, *POSITION_MESSAGES)
"""The messages that show the flight, by name."""
_SHOWN: Final = {MESSAGE_NUMBERS[name]: name for name in SHOWN_MESSAGES}


@dataclass(slots=True)
class ShownFlight:
    """The flight that the operator's displays show."""

    origin: Origin
    home: Place
    system: int
    """System id of the aircraft."""
    speed_mps: float = 1.0
    """Greatest speed that was reported before the attack, at least 1 m/s."""
    items: dict[int, Place] = field(default_factory=dict)
    """Places of the mission by item, as the station uploaded them."""
    goal: Place | None = None
    """The last guided target."""
    item: int = 0
    """The item that the shown aircraft flies to."""
    place: Place | None = None
    """Where the shown aircraft is, metres from the origin; before the attack the reported place."""
    since_ns: Time = -1
    airborne: bool = False
    armed: bool = False
    frozen: dict[tuple[str, str], int] = field(default_factory=dict)
    position: MovedPosition = field(init=False)

    def __post_init__(self) -> None:
        self.position = MovedPosition(self.origin, STILL, STILL, None)

    def learn(self, payload: bytes) -> None:
        """Learn the plan from a frame of the station."""
        if message_id(payload) not in (_ITEM, _TARGET):
            return
        message = read(payload)
        if message is None:
            return
        if message.get_msgId() == _TARGET:
            self.goal = self._place_of(message.coordinate_frame, message.lat_int, message.lon_int, message.alt)
        elif message.mission_type == mav.MAV_MISSION_TYPE_MISSION:
            self._learn_item(message)

    def _learn_item(self, message: Message) -> None:
        if message.seq <= 1:  # a new upload
            self.items = {seq: place for seq, place in self.items.items() if seq < message.seq}
        if message.command == _RETURN:
            height_m = self.items[max(self.items)][2] if self.items else self.home[2]
            self.items[message.seq] = (self.home[0], self.home[1], height_m)
        elif message.seq and (message.x or message.y):
            self.items[message.seq] = self._place_of(message.frame, message.x, message.y, message.z)

    def _place_of(self, frame: int, lat_e7: int, lon_e7: int, height_m: float) -> Place:
        east, north = self.origin.enu_of(lat_e7 * 1e-7, lon_e7 * 1e-7)
        up = height_m - self.origin.alt_msl_m if frame in _ABOVE_SEA else self.home[2] + height_m
        return (east, north, up)

    def rewrite(self, payload: bytes, since_ns: Time, sham: bool) -> bytes | None:
        """The frame of telemetry that is shown instead, without a signature; `None` where it stays as it is."""
        number = message_id(payload)
        plain = without_signature(payload) if number in _SHOWN else None
        fields = None if plain is None or number is None else read_fields(plain, number)
        if plain is None or number is None or fields is None or plain[5:7] != bytes((self.system, AUTOPILOT)):
            return None
        true = fields.copy()
        return (
            write_alteration(plain, number, true, fields, sham)
            if self.alter(_SHOWN[number], fields, since_ns)
            else None
        )

    def alter(self, message: str, fields: Any, since_ns: Time) -> bool:
        """Write into the fields of a message; returns whether it is one to replace.

        `since_ns` counts from the start of the attack. Before it this learns, and nothing is to be replaced.
        """
        acts = since_ns >= 0
        for name in _FROZEN.get(message, ()):
            if not acts:
                self.frozen[message, name] = int(fields[name])
            elif (message, name) in self.frozen:
                put(fields, name, self.frozen[message, name])
        if message == "HEARTBEAT":
            self.armed = bool(fields["base_mode"] & _ARMED)
            return acts
        if message == "MISSION_CURRENT":
            if acts and self.item:
                put(fields, "seq", self.item)
            elif not acts:
                self.item = int(fields["seq"])
            return acts
        if message == "GLOBAL_POSITION_INT":
            self._advance(since_ns, fields)
        self.position.at = self.place if acts else None
        return self.position.alter(message, fields, 0) and acts

    def _advance(self, since_ns: Time, fields: Any) -> None:
        """Move the shown aircraft; before the attack it is where it was reported."""
        if since_ns < 0 or self.place is None:
            east, north = self.origin.enu_of(fields["lat"] * 1e-7, fields["lon"] * 1e-7)
            self.place = (east, north, fields["alt"] * 1e-3 - self.origin.alt_msl_m)
            self.airborne = self.armed and fields["relative_alt"] * 1e-3 > _AIRBORNE_M
            speed = math.hypot(fields["vx"], fields["vy"], fields["vz"]) * 1e-2
            self.speed_mps = max(self.speed_mps, speed)
            self.since_ns = max(since_ns, 0)
            return
        left_m = self.speed_mps * (since_ns - self.since_ns) / NS_PER_S
        self.since_ns = since_ns
        self.position.rate_mps = STILL
        while left_m > 0 and self.airborne and (goal := self._goal()) is not None:
            gap_m = math.dist(self.place, goal)
            if gap_m <= left_m:
                left_m -= gap_m
                self.place = goal
                if not self._next():
                    return
                continue
            share = left_m / gap_m
            here = self.place
            self.place = tuple(a + (b - a) * share for a, b in zip(here, goal, strict=True))  # type: ignore[assignment]
            rate = tuple((b - a) / gap_m * self.speed_mps for a, b in zip(here, goal, strict=True))
            self.position.rate_mps = (rate[0], rate[1], rate[2])
            return

    def _goal(self) -> Place | None:
        if not self.items:
            return self.goal
        later = [seq for seq in self.items if seq >= self.item]
        return self.items[min(later)] if later else None

    def _next(self) -> bool:
        """Go on to the next item of the mission; `False` at its end, and at a guided target."""
        later = [seq for seq in self.items if seq > self.item]
        if later:
            self.item = min(later)
        return bool(later)
