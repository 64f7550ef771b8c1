"""Bases of kinds that inject frames on control links: of any content, and MAVLink in the name of a station."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, Literal

from skyrange.attack.bases.in_air import InAir
from skyrange.attack.bases.mavlink.orders import STATION, Order, Sender, read
from skyrange.attack.bases.roles import OnControlLinks
from skyrange.attack.bases.rounds import RoundsOnLink
from skyrange.attack.contract import Attack, AttackContext
from skyrange.attack.declaration import Facts
from skyrange.attack.tapped_links import CONTROL_LINKS, MESSAGE_NUMBERS
from skyrange.attack.victims import Victims, check_vehicles
from skyrange.codec.mavlink import Message, Packer, message_id
from skyrange.contracts.frames import Frame
from skyrange.contracts.params import Whole
from skyrange.contracts.plugins.form import param, place_of
from skyrange.contracts.verdicts import Verdicts
from skyrange.core.errors import InputError, nearest
from skyrange.core.geodesy import Origin
from skyrange.core.ids import link_name
from skyrange.core.time import Time


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
        self.systems = {link_name(self.on, one): context.vehicles[one].system_id for one in self.vehicles}
        return Attack(taps=self.make_taps(list(self.systems), context), shown=self.marks())

    def begin(self) -> None:
        """See `LinkTap`."""
        super().begin()
        self.target, self.systems = self.systems[self.link], {}
        own = self.sender == "own"
        packer = Packer(*((self.system_id, self.component_id) if own else STATION))
        self.claimed = Sender(packer, self.target, not own, is_sham=self.sham)

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
        return [self.inject(self.pack(one)) for one in self.orders(now)]

    def orders(self, now: Time) -> Sequence[Order | Message | bytes]:
        """The commands and other messages of a round, or frames as they are."""
        raise NotImplementedError

    def pack(self, order: Order | Message | bytes) -> bytes:
        """The next frame of the sender that it claims to be; a frame as it is."""
        return order if isinstance(order, bytes) else self.claimed.pack(order)
