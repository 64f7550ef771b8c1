"""Base of kinds that command from a compromised companion: in its own name, on its own link, with the aircraft's key.

ArduPilot accepts frames of its own system id always, also with the option that enforces the id of the ground station
(GCS_Common.cpp, `GCS_MAVLINK::accept_packet`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, ClassVar, Final, Literal

from skyrange.attack.bases.mavlink.compromised_sender import SenderStream, redirect_order
from skyrange.attack.bases.mavlink.orders import NOBODY, Sender
from skyrange.attack.bases.on_path import CopyForLink, LinkTap
from skyrange.attack.contract import Attack, AttackContext
from skyrange.attack.declaration import Facts
from skyrange.attack.exclusive import Exclusive
from skyrange.attack.tapped_links import ends_of
from skyrange.attack.victims import Victims, check_vehicles
from skyrange.codec.mavlink import Packer, message_id
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.signing import range_passphrase, secret_from_passphrase
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.links import TapPlacement
from skyrange.contracts.plugins.fields import param
from skyrange.contracts.verdicts import Inject, Replace, Verdict
from skyrange.core.ids import link_name, operator_of
from skyrange.core.time import Time

COMPONENT: Final = int(mav.MAV_COMP_ID_ONBOARD_COMPUTER)


class CompromisedCompanion(LinkTap):
    """Runs in the companion of each aircraft, on the link to the proxy: what that forwards and what it sends.

    It holds back the orders that `holds_back` says, and adds the frames of `make` to the companion's own stream.
    """

    attack_facts: ClassVar[Facts] = {
        "surface": ("log",),
        "persists": "acts",
        "position": "in the companion computer",
        "equipment": "a program on the companion: from its supply chain, an update or a remote login",
        "load": "the sham: the same orders, addressed to a system that is not there",
        "placement": "the companion of another aircraft",
    }

    needs: ClassVar[tuple[str, ...]] = ()
    holds_back: ClassVar[Literal["station", "companion", ""]] = ""
    """Whose orders are redirected to nobody while it acts."""

    vehicles: Victims = param("Aircraft whose companion is compromised, such as ['blue/b1'].")

    systems: dict[str, int]
    """MAVLink system ids of the aircraft."""
    system: int
    """That of the aircraft on the link."""
    sender: Sender
    """The companion; it addresses the aircraft, and nobody in a sham."""
    own: SenderStream
    forwarded: SenderStream

    def assemble(self, context: AttackContext) -> Any:
        """See `Acting`. Raises `InputError` for aircraft that are not in the scenario."""
        check_vehicles(context, self.vehicles)
        self.systems = {vehicle: context.vehicles[vehicle].system_id for vehicle in self.vehicles}
        return super().assemble(context)

    def build(self, context: AttackContext) -> Attack:
        """A tap in each companion."""
        make = CopyForLink(self)
        return Attack(
            taps=[TapPlacement(link_name("log", vehicle), "companion", make) for vehicle in self.vehicles],
            exclusive=[Exclusive(f"companion of {vehicle}") for vehicle in self.vehicles],
        )

    def begin(self) -> None:
        """Take the name and the key of the companion."""
        vehicle = self.link.partition(":")[2]
        self.system = self.systems[vehicle]
        self.sender = Sender(Packer(self.system, COMPONENT), NOBODY if self.sham else self.system, False)
        secret = secret_from_passphrase(range_passphrase(self.chance.seed, operator_of(vehicle)))
        self.own, self.forwarded = SenderStream(secret), SenderStream(secret)

    def see(self, now: Time, frame: Frame) -> None:
        """Learn from a frame of either direction."""

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
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
        if self.holds_back == ("companion" if is_own else "station") and (
            self.schedule.start_ns <= now < self.schedule.stop_ns
        ):
            content = redirect_order(payload, self.sham)
        sent = stream.forward(payload, content)
        return [Replace(sent)] if content is not None or sent != payload else ()

    def make(self, now: Time) -> Iterable[bytes]:
        """The frames that it sends at `now`."""
        return ()

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        """Send what is due."""
        return [Inject(self.own.add(one), "fwd", *ends_of(self.link, "fwd")) for one in self.make(now)]
