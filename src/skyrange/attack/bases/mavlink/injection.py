"""Bases of kinds that inject frames on control links: any content, MAVLink in a station's name, and scripts of it.

By https://mavlink.io/en/services/command.html and https://mavlink.io/en/services/mission.html: a command, or the count
of an upload, is sent again where no acknowledgement comes; items are sent on request.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Literal

from skyrange.attack.bases.links import OnControlLinks, RoundsOnLink
from skyrange.attack.bases.mavlink.orders import AUTOPILOT, STATION, Order, Sender, read
from skyrange.attack.bases.wifi_links import InAir
from skyrange.attack.contract import Attack, AttackContext, Place
from skyrange.attack.declaration import Facts
from skyrange.attack.params import Victims, check_vehicles
from skyrange.attack.tapped_links import CONTROL_LINKS, MESSAGE_NUMBERS
from skyrange.codec.mavlink import Message, Packer, message_id
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.frames import Frame
from skyrange.contracts.params import Whole
from skyrange.contracts.plugins.form import param, place_of
from skyrange.contracts.verdicts import Verdicts
from skyrange.core.errors import InputError, nearest
from skyrange.core.geodesy import Origin
from skyrange.core.ids import link_name
from skyrange.core.time import NS_PER_MS, Time


class InjectionOnLinks(InAir, OnControlLinks):  # type: ignore[misc]  # more places than its base
    """Injects frames in rounds on control links that the parameters name: `send` makes those of a round."""

    attack_facts: ClassVar[Facts] = {"intrudes": True}

    needs: ClassVar[tuple[str, ...]] = ("send",)

    systems: dict[str, int]
    """By aircraft: its system id; a tap keeps that of its own alone, so that copies of a run are small."""
    target: int
    """System id of the link's aircraft."""
    packer: Packer
    """Of a tap: makes frames in the name of a ground station, by the ids that these have by convention."""

    def build(self, context: AttackContext) -> Attack:
        """See `OnControlLinks`."""
        self.systems = {name: aircraft.system_id for name, aircraft in context.vehicles.items()}
        return super().build(context)

    def begin(self) -> None:
        """See `LinkTap`."""
        super().begin()
        self.target, self.systems = self.systems[self.link.partition(":")[2]], {}
        self.packer = Packer(*STATION)

    def send(self, now: Time) -> Verdicts:
        """The frames of a round."""
        raise NotImplementedError


class Injection(InAir, RoundsOnLink):
    """Injects MAVLink on a link of each named aircraft, in the name of its ground station or of a sender of its own.

    `orders` tells what is sent in a round. With `reads`, `on_message` is shown these messages of the aircraft. The sham
    sends as many frames of the same lengths to the aircraft, which change nothing (`harmless_message`).
    """

    attack_facts: ClassVar[Facts] = {
        "surface": CONTROL_LINKS,
        "intrudes": True,
        "knowledge": "system ids, from any frame",
        "position": "by place: near the link with a radio, in the operator's network, or on board",
        "equipment": "a computer with a MAVLink library",
        "load": "the sham: as many frames of the same lengths to the aircraft, which answers them and changes nothing",
    }

    needs: ClassVar[tuple[str, ...]] = ("orders",)
    reads: ClassVar[tuple[str, ...]] = ()
    """Names of the messages that `on_message` is shown."""
    numbers: ClassVar[frozenset[int]] = frozenset()
    """Their ids."""

    vehicles: Victims = param("Aircraft that the frames are for, such as ['blue/b1'].")
    on: Literal["gcs", "log", "autopilot"] = param(
        "Link on which the frames are injected: gcs, or log or autopilot on board.", default="gcs"
    )
    sender: Literal["station", "own"] = param(
        "station: in the name of the operator's ground station, as its heartbeats tell it; own: in the name of "
        "system_id and component_id.",
        default="station",
    )
    system_id: Whole = param("System id of the sender 'own', 1 to 255.", default=254, ge=1, le=255)
    component_id: Whole = param("Component id of the sender 'own', 1 to 255.", default=190, ge=1, le=255)

    origin: Origin
    systems: dict[str, int]
    """By link: system id of its aircraft. A tap keeps that of its own alone."""
    target: int
    """System id that its frames address: that of the link's aircraft."""
    claimed: Sender
    """The sender that its frames name."""

    def __init_subclass__(cls) -> None:
        """Raises `InputError` for a message in `reads` that MAVLink does not have."""
        for name in cls.reads:
            if name not in MESSAGE_NUMBERS:
                hint = nearest(name, MESSAGE_NUMBERS)
                raise InputError.one(place_of(cls), "reads", name, "a MAVLink message such as 'HEARTBEAT'", hint)
        cls.numbers = frozenset(MESSAGE_NUMBERS[name] for name in cls.reads)

    def assemble(self, context: AttackContext) -> Any:
        """See `Acting`."""
        self.origin = context.origin
        return super().assemble(context)

    def build(self, context: AttackContext) -> Attack:
        """A tap for each aircraft. Raises `InputError` for aircraft that are not in the scenario."""
        check_vehicles(context, self.vehicles)
        self.systems = {link_name(self.on, vehicle): context.vehicles[vehicle].system_id for vehicle in self.vehicles}
        return Attack(taps=self.make_taps(list(self.systems), context), shown=self.marks())

    def begin(self) -> None:
        """See `LinkTap`."""
        super().begin()
        self.target, self.systems = self.systems[self.link], {}
        is_own = self.sender == "own"
        packer = Packer(*((self.system_id, self.component_id) if is_own else STATION))
        self.claimed = Sender(packer, self.target, claims_station=not is_own, is_sham=self.sham)

    def on_frame(self, now: Time, frame: Frame) -> Verdicts:
        """Let it pass, and learn who the station is and what the aircraft says."""
        if frame.direction == "fwd":
            self.claimed.see(frame)
            return ()
        payload = frame.payload
        if not self.numbers or message_id(payload) not in self.numbers:
            return ()
        message = read(payload)
        return () if message is None else self.on_message(now, message) or ()

    def on_message(self, now: Time, message: Message) -> Verdicts | None:
        """Learn from a message of the aircraft that it reads; it passes unless a verdict says otherwise."""
        return None

    def send(self, now: Time) -> Verdicts:
        """The orders of a round, as frames."""
        return [self.inject(self.pack(order)) for order in self.orders(now)]

    def orders(self, now: Time) -> Sequence[Order | Message | bytes]:
        """The commands and other messages of a round, or frames as they are."""
        raise NotImplementedError

    def pack(self, order: Order | Message | bytes) -> bytes:
        """The next frame of the sender that it claims to be; a frame as it is."""
        return order if isinstance(order, bytes) else self.claimed.pack(order)


RETRY_NS: Final = 1_500 * NS_PER_MS
"""mavlink.io "Timeouts and retries": default."""
TRIES: Final = 6
"""The first try and five retries, as mavlink.io recommends."""
_ANSWER_NS: Final = NS_PER_MS
"""Time in which the node answers a request."""
_DOWNLOADS: Final = (mav.MAVLINK_MSG_ID_MISSION_ITEM_INT, mav.MAVLINK_MSG_ID_MISSION_COUNT)
"""Answers to what the sham requests."""
_REQUESTS: Final = (mav.MAVLINK_MSG_ID_MISSION_REQUEST, mav.MAVLINK_MSG_ID_MISSION_REQUEST_INT)


@dataclass(frozen=True, slots=True)
class Item:
    """An item of a mission, a fence or rally points; the place is in degrees and metres above sea level."""

    command: int
    place: Place
    param1: float = 0.0

    def message(self, system: int, component: int, seq: int, mission_type: int) -> Message:
        """MISSION_ITEM_INT of it."""
        lat, lon, alt_m = self.place
        return mav.MAVLink_mission_item_int_message(
            system, component, seq, mav.MAV_FRAME_GLOBAL, self.command, 0, 1, self.param1, 0.0, 0.0, 0.0,
            round(lat * 1e7), round(lon * 1e7), alt_m, mission_type,
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Upload:
    """Items to upload, all of one type."""

    items: tuple[Item, ...]
    mission_type: int = mav.MAV_MISSION_TYPE_MISSION


@dataclass(frozen=True, slots=True)
class Clear:
    """MISSION_CLEAR_ALL of one type."""

    mission_type: int = mav.MAV_MISSION_TYPE_MISSION


Step = Order | Upload | Clear


class Script(Injection):
    """Takes the steps of `steps` in order, once, each until it is answered or was tried six times.

    In place of an upload the sham requests an item, and of a removal the number of items.
    """

    needs: ClassVar[tuple[str, ...]] = ("steps",)
    reads = (
        "MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_ACK", "COMMAND_ACK", "MISSION_ITEM_INT", "MISSION_COUNT",
    )  # fmt: skip

    todo: tuple[Step, ...]
    done: int = 0
    """Steps that are answered, or were tried in vain."""
    tries: int = 0
    requested: int = -1
    """The number of the item that the aircraft asked for; -1 for none."""

    def steps(self) -> Sequence[Step]:
        """The steps."""
        raise NotImplementedError

    def begin(self) -> None:
        """See `LinkTap`."""
        super().begin()
        self.todo = tuple(self.steps())

    def period_ns(self) -> Time:
        """Time after which a step is tried again."""
        return RETRY_NS

    def next_wakeup(self) -> Time | None:
        """When it next sends."""
        return self.clock.due if self.done < len(self.todo) else None

    def on_message(self, now: Time, message: Message) -> None:
        """Go on where the aircraft answers; send the item that it asks for."""
        if not self.tries or self.done >= len(self.todo) or not self.claimed.is_answered(message):
            return
        step, number = self.todo[self.done], message.get_msgId()
        if isinstance(step, Order):
            command = mav.MAV_CMD_REQUEST_MESSAGE if self.sham else step.command
            answered = number == mav.MAVLINK_MSG_ID_COMMAND_ACK and message.command == command
            if answered and message.result != mav.MAV_RESULT_IN_PROGRESS:
                self._go_on(now)
            return
        if number == mav.MAVLINK_MSG_ID_COMMAND_ACK or message.mission_type != step.mission_type:
            return
        if number in _DOWNLOADS:
            if self.sham:
                self._go_on(now)
        elif number in _REQUESTS:
            if isinstance(step, Upload) and message.seq < len(step.items):
                self.requested = message.seq
                self.tries = 1
                self.clock.due = now + _ANSWER_NS
        elif self.sham or message.type != mav.MAV_MISSION_INVALID_SEQUENCE:
            self._go_on(now)

    def orders(self, now: Time) -> Sequence[Order | Message]:
        """The command, the count or the item that is due."""
        if self.tries >= TRIES and self.done < len(self.todo):
            self._go_on(now)
            self.clock.due = now + RETRY_NS
        if self.done >= len(self.todo):
            return []
        self.tries += 1
        return [self._message()]

    def _go_on(self, now: Time) -> None:
        self.done += 1
        self.tries = 0
        self.requested = -1
        self.clock.due = now + _ANSWER_NS

    def _message(self) -> Order | Message:
        step = self.todo[self.done]
        if isinstance(step, Order):
            return step
        if isinstance(step, Clear):
            return mav.MAVLink_mission_clear_all_message(self.target, AUTOPILOT, step.mission_type)
        if self.requested >= 0:
            return step.items[self.requested].message(self.target, AUTOPILOT, self.requested, step.mission_type)
        return mav.MAVLink_mission_count_message(self.target, AUTOPILOT, len(step.items), step.mission_type)
