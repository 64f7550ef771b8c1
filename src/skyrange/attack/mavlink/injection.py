"""Injected MAVLink frames: whose name they bear, whom they address, when they are due, and the taps that inject them.

An injecting node sits on a link of an aircraft. A tap sees the frames of both directions, so it also learns the ids of
the operator's station and the answers of the autopilot.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Literal

from pydantic import Field

from skyrange.attack.contract import AttackContext, Place
from skyrange.attack.on_path import InjectingTap, InjectionSource, Repetition, TapMaker, place_taps
from skyrange.attack.victims import Victims, check_vehicles
from skyrange.codec.mavlink import Message, Packer, decode, message_id, sender_system
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.components import Tap
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.links import Schedule, TapPlacement
from skyrange.contracts.params import Params, Whole
from skyrange.core.errors import DecodeError
from skyrange.core.geodesy import Origin
from skyrange.core.ids import hash64, link_name
from skyrange.core.time import Time

NOBODY: Final = 251
"""System id that shams address: aircraft have 1 to 250, so nobody obeys, and the frame has the same size."""
STATION: Final = (255, int(mav.MAV_COMP_ID_MISSIONPLANNER))
"""System and component id of ground stations by convention; used until a heartbeat of the station was seen."""
_AUTOPILOT: Final = int(mav.MAV_COMP_ID_AUTOPILOT1)
_SEQUENCE: Final = 4
"""Offset of the sequence number in a MAVLink 2 frame."""


class Injection(Params):
    """Where frames are injected, and in whose name."""

    vehicles: Victims = Field(description="Aircraft that the frames are for, such as ['blue/b1'].")
    on: Literal["gcs", "log", "autopilot"] = Field(
        default="gcs", description="Link on which the frames are injected: gcs, or log or autopilot on board."
    )
    sender: Literal["station", "own"] = Field(
        default="station",
        description="station: in the name of the operator's ground station, as its heartbeats tell it; own: in the "
        "name of system_id and component_id.",
    )
    system_id: Whole = Field(default=254, ge=1, le=255, description="System id of the sender 'own', 1 to 255.")
    component_id: Whole = Field(default=190, ge=1, le=255, description="Component id of the sender 'own', 1 to 255.")


@dataclass(slots=True)
class Sender:
    """The sender that injected frames name, and the system that they address."""

    packer: Packer
    target: int
    """System id of the aircraft; that of nobody in a sham."""
    claims_station: bool
    address: int = 0
    """Address of the link, for chance."""
    component: int = _AUTOPILOT

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

    def pack(self, message: Message) -> bytes:
        """The frame of a message."""
        return self.packer.pack(message)


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


@dataclass(frozen=True, slots=True)
class Order:
    """A MAVLink command with its parameters, sent as COMMAND_INT where it has a place, else as COMMAND_LONG."""

    command: int
    values: tuple[float, ...] = ()
    place: Place | None = None
    """Latitude and longitude in degrees, altitude above mean sea level in metres."""

    def message(self, system: int, component: int = _AUTOPILOT) -> Message:
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


def geodetic(origin: Origin, place: Place) -> Place:
    """Latitude and longitude in degrees and altitude above mean sea level in metres of a place from the origin."""
    lat, lon = origin.geodetic_of(place[0], place[1])
    return lat, lon, origin.alt_msl_m + place[2]


@dataclass(slots=True)
class ModeKeeper:
    """The mode that heartbeats of the aircraft show, and commands to change it where it is another one."""

    mode: int
    period_ns: Time
    seen: int = -1
    next_ns: Time = 0

    def see(self, now: Time, frame: Frame) -> None:
        """Learn the mode from a heartbeat of the autopilot."""
        if frame.direction != "rev" or message_id(frame.payload) != mav.MAVLINK_MSG_ID_HEARTBEAT:
            return
        message = read(frame.payload)
        if message is not None and message.get_srcComponent() == _AUTOPILOT:
            self.seen = message.custom_mode

    def orders(self, now: Time) -> list[Order]:
        """The command, where the mode is another one and the last command was `period_ns` ago."""
        if self.seen == self.mode or now < self.next_ns:
            return []
        self.next_ns = now + self.period_ns
        return [mode_order(self.mode)]


@dataclass(frozen=True, slots=True)
class _Senders:
    """What makes the sender of each link."""

    targets: tuple[tuple[str, int], ...]
    own: tuple[int, int] | None

    def make(self, link: str) -> Sender:
        packer = Packer(*(self.own or STATION))
        return Sender(packer, dict(self.targets)[link], self.own is None, hash64(link))


def _make_tap(
    link: str,
    tap: Callable[..., Tap],
    source: Callable[..., InjectionSource],
    senders: _Senders,
    arguments: tuple[Any, ...],
) -> Tap:
    return tap(link, source(senders.make(link), *arguments))


def inject(
    params: Injection,
    context: AttackContext,
    source: Callable[..., InjectionSource],
    *arguments: Any,
    tap: Callable[..., Tap] = InjectingTap,
) -> list[TapPlacement]:
    """Taps that inject what `source(sender, *arguments)` makes, one for each aircraft.

    Arguments are immutable or meant to be shared, as the schedule is. Raises `InputError` for aircraft that are not in
    the scenario.
    """
    check_vehicles(context, params.vehicles)
    targets = {link_name(params.on, vehicle): vehicle for vehicle in params.vehicles}
    systems = tuple(
        (link, NOBODY if context.sham else context.vehicles[one].system_id) for link, one in targets.items()
    )
    own = (params.system_id, params.component_id) if params.sender == "own" else None
    return place_taps(list(targets), context, TapMaker(_make_tap, (tap, source, _Senders(systems, own), arguments)))


@dataclass(slots=True)
class Commands:
    """A source that sends the same commands again and again."""

    sender: Sender
    schedule: Schedule
    orders: tuple[Order, ...]
    period_ns: Time
    times: int
    clock: Repetition = field(init=False)

    def __post_init__(self) -> None:
        self.clock = Repetition(self.schedule, self.period_ns, self.times)

    @property
    def due(self) -> Time | None:
        """When the next commands are due."""
        return self.clock.due

    def see(self, now: Time, frame: Frame) -> None:
        """Learn who the station is."""
        self.sender.see(frame)

    def make(self, now: Time) -> Sequence[tuple[Literal["fwd"], bytes]]:
        """The commands that are due."""
        if not self.clock.take(now):
            return []
        return [("fwd", self.sender.pack(order.message(self.sender.target))) for order in self.orders]
