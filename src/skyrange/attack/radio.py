"""Radio of an attacker: its own transmitter, with links to the environment oracle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, Protocol

from skyrange.attack.contract import ORACLE, AttackContext, Place, Transmitter
from skyrange.contracts.links import Channel, LinkSpec
from skyrange.contracts.mailboxes import Inbox, Outbox
from skyrange.core.errors import InputError, nearest
from skyrange.core.ids import Port
from skyrange.core.time import NS_PER_MS, NS_PER_US, Time

SERVICE_NS: Final = NS_PER_MS
"""Service time of the attacker's program, which has no other task."""
CHANNEL: Final = Channel(mode="reliable", latency_ns=100 * NS_PER_US)
"""Channel between that program and its radio, within one computer."""

MAST_M: Final = 2.0
"""Height of a transmitter without a given position: held by hand."""


class PayloadSource(Protocol):
    """Source of the `rid_up` payloads that a transmitter sends, when they are due. It can be deep-copied."""

    @property
    def due(self) -> Time:
        """When the next payload is due."""
        ...

    def make(self, now: Time) -> Sequence[bytes]:
        """The payloads that are due at `now`."""
        ...


@dataclass(slots=True)
class Broadcaster:
    """An agent that sends the payloads of `source` on its own `rid_up` link."""

    name: str
    up: Port
    source: PayloadSource
    service_ns: Time = SERVICE_NS
    ports: Sequence[Port] = field(init=False)

    def __post_init__(self) -> None:
        self.ports = [self.up]

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        """Send the payloads that are due."""
        out = Outbox()
        for payload in self.source.make(now):
            out.send(self.up, payload)
        return out

    def next_wakeup(self) -> Time | None:
        """When the next broadcast is due."""
        return self.source.due


def up_link(context: AttackContext) -> LinkSpec:
    """The link on which the attacker's radio gets the broadcasts to send."""
    return LinkSpec(context.up, context.radio, ORACLE, CHANNEL)


def down_link(context: AttackContext) -> LinkSpec:
    """The link on which the attacker's radio delivers the broadcasts that it receives."""
    return LinkSpec(context.down, ORACLE, context.radio, CHANNEL)


def transmitter(context: AttackContext, at_enu_m: Place, power_dbm: float, *, listens: bool = False) -> Transmitter:
    """The attacker's node in the medium."""
    return Transmitter(context.radio, at_enu_m, power_dbm, listens)


def place_transmitter(context: AttackContext, given_enu_m: Place | None, claimed_enu_m: Place) -> Place:
    """The given place of a transmitter, or one above the ground or roof at the position that it claims."""
    east_m, north_m, _ = claimed_enu_m
    below_m = context.city.height_at(east_m, north_m) if context.city is not None else 0.0
    return given_enu_m or (east_m, north_m, below_m + MAST_M)


def check_vehicle(context: AttackContext, parameter: str, vehicle: str) -> None:
    """Raises `InputError` for a vehicle that is not in the scenario."""
    if vehicle not in context.vehicles:
        hint = nearest(vehicle, context.vehicles)
        raise InputError.one(context.id, parameter, vehicle, "a vehicle of the scenario", hint)
