"""Base of kinds that command from a compromised companion: in its own name, on its own link, with the aircraft's key.

ArduPilot accepts frames of its own system id always, also with the option that enforces the id of the ground station
(GCS_Common.cpp, `GCS_MAVLINK::accept_packet`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, Final, Literal

from skyrange.attack.bases.mavlink.compromised_sender import SenderStream, redirect_order, station_key
from skyrange.attack.bases.mavlink.orders import Order, Sender
from skyrange.attack.bases.on_path import CopyForLink
from skyrange.attack.bases.rounds import RoundsOnLink
from skyrange.attack.contract import Attack, AttackContext
from skyrange.attack.declaration import Facts
from skyrange.attack.exclusive import Exclusive
from skyrange.attack.victims import Victims, check_vehicles
from skyrange.codec.mavlink import Message, Packer, message_id
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.frames import Frame
from skyrange.contracts.links import TapPlacement
from skyrange.contracts.plugins.form import param
from skyrange.contracts.verdicts import Inject, Replace, Verdicts
from skyrange.core.geodesy import Origin
from skyrange.core.ids import link_name, operator_of
from skyrange.core.time import Time

COMPONENT: Final = int(mav.MAV_COMP_ID_ONBOARD_COMPUTER)


class CompromisedCompanion(RoundsOnLink):
    """Runs in the companion of each aircraft, on the link to the proxy: what that forwards and what it sends.

    It holds back the orders that `holds_back` says, and adds those of `orders` to the companion's own stream, every
    `every_s` if the kind sets that.
    """

    attack_facts: ClassVar[Facts] = {
        "surface": ("log",),
        "persists": "acts",
        "intrudes": True,
        "position": "in the companion computer",
        "equipment": "a program on the companion: from its supply chain, an update or a remote login",
        "load": "the sham: as many frames of the same lengths to the aircraft, which change nothing",
        "placement": "the companion of another aircraft",
    }

    holds_back: ClassVar[Literal["station", "companion", ""]] = ""
    """Whose orders are redirected to nobody while it acts."""

    vehicles: Victims = param("Aircraft whose companion is compromised, such as ['blue/b1'].")

    origin: Origin
    systems: dict[str, int]
    """MAVLink system ids of the aircraft."""
    system: int
    """That of the aircraft on the link."""
    sender: Sender
    """The companion; that of a sham sends harmless frames."""
    own: SenderStream
    forwarded: SenderStream

    def assemble(self, context: AttackContext) -> Any:
        """See `Acting`. Raises `InputError` for aircraft that are not in the scenario."""
        check_vehicles(context, self.vehicles)
        self.origin = context.origin
        self.systems = {vehicle: context.vehicles[vehicle].system_id for vehicle in self.vehicles}
        return super().assemble(context)

    def build(self, context: AttackContext) -> Attack:
        """A tap in each companion."""
        make = CopyForLink(self)
        return Attack(
            taps=[TapPlacement(link_name("log", vehicle), "companion", make) for vehicle in self.vehicles],
            shown=self.marks(),
            exclusive=[Exclusive(f"companion of {vehicle}") for vehicle in self.vehicles],
        )

    def begin(self) -> None:
        """Take the name and the key of the companion."""
        super().begin()
        vehicle = self.link.partition(":")[2]
        self.system = self.systems[vehicle]
        self.sender = Sender(Packer(self.system, COMPONENT), self.system, False, is_sham=self.sham)
        secret = station_key(self.chance.seed, operator_of(vehicle))
        self.own, self.forwarded = SenderStream(secret), SenderStream(secret)

    def see(self, now: Time, frame: Frame) -> None:
        """Learn from a frame of either direction."""

    def on_frame(self, now: Time, frame: Frame) -> Verdicts:
        """Learn from it, and hold it back if it is an order."""
        self.see(now, frame)
        payload = frame.payload
        if frame.direction != "fwd" or message_id(payload) is None:
            return ()
        is_own = payload[5:7] == bytes((self.system, COMPONENT))
        if not is_own:
            self.own.observe(payload)
        stream = self.own if is_own else self.forwarded
        content = None
        if self.holds_back == ("companion" if is_own else "station") and self.is_acting(now):
            content = redirect_order(payload, self.sham)
        sent = stream.forward(payload, content)
        return [Replace(sent)] if content is not None or sent != payload else ()

    def send(self, now: Time) -> Verdicts:
        """The orders of a round, as frames."""
        return self.command(self.orders(now))

    def orders(self, now: Time) -> Sequence[Order | Message]:
        """The commands and other messages of a round."""
        return ()

    def command(self, orders: Sequence[Order | Message]) -> list[Inject]:
        """Orders as the next frames of the companion."""
        return [self.inject(self.own.add(self.sender.pack(one))) for one in orders]
