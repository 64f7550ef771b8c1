"""Commands of a compromised companion computer: in its own name, on its own link, with the key of the aircraft.

ArduPilot accepts frames of its own system id always, also with the option that enforces the id of the ground station
(GCS_Common.cpp, `GCS_MAVLINK::accept_packet`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

from skyrange.attack.bases.mavlink_orders import NOBODY, Sender
from skyrange.attack.compromised_sender import SenderStream, redirect_order
from skyrange.attack.contract import Attack, AttackContext
from skyrange.attack.exclusive import Exclusive
from skyrange.attack.on_path import InjectionSource, ends_of
from skyrange.attack.victims import check_vehicles
from skyrange.codec.mavlink import Packer, message_id
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.signing import range_passphrase, secret_from_passphrase
from skyrange.contracts.components import Tap
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.links import Schedule, TapPlacement
from skyrange.contracts.verdicts import Inject, Replace, Verdict
from skyrange.core.ids import link_name, operator_of
from skyrange.core.time import Time

COMPONENT: Final = int(mav.MAV_COMP_ID_ONBOARD_COMPUTER)


@dataclass(slots=True)
class CompanionTap:
    """The attacker's program in the companion, on the link to the proxy: what it forwards and what it sends.

    It injects what its source makes, in the stream of the companion's own frames.
    """

    link: str
    system: int
    """MAVLink system id of the aircraft."""
    schedule: Schedule
    sham: bool
    holds_back: str
    """Whose orders it redirects to nobody: "station", "companion", or "" for none."""
    own: SenderStream
    forwarded: SenderStream
    source: InjectionSource | None

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Learn from it, and hold it back if it is an order."""
        if self.source is not None:
            self.source.see(now, frame)
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

    def next_wakeup(self) -> Time | None:
        """When the source is due."""
        return None if self.source is None else self.source.due

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        """Send what is due."""
        if self.source is None:
            return ()
        return [Inject(self.own.add(one), way, *ends_of(self.link, way)) for way, one in self.source.make(now)]


@dataclass(frozen=True, slots=True)
class _MakeTap:
    context: AttackContext
    holds_back: str
    source: Callable[..., InjectionSource] | None
    arguments: tuple[Any, ...]

    def __call__(self, link: str) -> Tap:
        context, vehicle = self.context, link.partition(":")[2]
        system = context.vehicles[vehicle].system_id
        secret = secret_from_passphrase(range_passphrase(context.chance.seed, operator_of(vehicle)))
        source = None
        if self.source is not None:
            sender = Sender(Packer(system, COMPONENT), NOBODY if context.sham else system, False)
            source = self.source(sender, *self.arguments)
        return CompanionTap(
            link, system, context.schedule, context.sham, self.holds_back, SenderStream(secret), SenderStream(secret),
            source,
        )  # fmt: skip


def compromise_companions(
    vehicles: Sequence[str],
    context: AttackContext,
    *,
    holds_back: str = "",
    source: Callable[..., InjectionSource] | None = None,
    arguments: tuple[Any, ...] = (),
) -> Attack:
    """The attack by a tap in the companion of each aircraft, which injects what `source(sender, *arguments)` makes.

    Raises `InputError` for aircraft that are not in the scenario.
    """
    check_vehicles(context, vehicles)
    maker = _MakeTap(context, holds_back, source, arguments)
    return Attack(
        taps=[TapPlacement(link_name("log", vehicle), "companion", maker) for vehicle in vehicles],
        exclusive=[Exclusive(f"companion of {vehicle}") for vehicle in vehicles],
    )
