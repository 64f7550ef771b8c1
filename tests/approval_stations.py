"""Ground stations that ask a flight approval at given times, and keep its answers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from skyrange.contracts.links import Channel, LinkSpec
from skyrange.contracts.mailboxes import Inbox, Outbox
from skyrange.core.ids import APPROVAL, Port, endpoint, link_name
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.core.volumes import Volume4D
from skyrange.kernel import Kernel, Wiring
from skyrange.record import MemoryObserver
from skyrange.testing.checks.approval_policies import EPOCH, box
from skyrange.utm.contract import OperationalIntent, intent_id
from skyrange.utm.intent_states import IntentState
from skyrange.utm.messages import DecisionBody, Request, decode_response, encode

LAT, LON = 40.778, -73.955


@dataclass
class Station:
    """Asks for intents at their times, and keeps the answers."""

    operator: str
    asks: Sequence[tuple[float, bytes]]
    sent: int = 0
    answers: list[tuple[Time, DecisionBody]] = field(default_factory=list)
    service_ns: Time = 20 * NS_PER_MS
    may_err: bool = False
    """Whether an answer may be an error, which is not kept."""

    def __post_init__(self) -> None:
        self.name = endpoint(self.operator, "gcs")
        self.ports: Sequence[Port] = (Port(self.name, link_name(APPROVAL, self.operator)),)

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        out = Outbox()
        for arrival in inbox:
            body = decode_response(arrival.payload).body
            if isinstance(body, DecisionBody):
                self.answers.append((now, body))
            else:
                assert self.may_err, body
        while self.sent < len(self.asks) and self.asks[self.sent][0] * NS_PER_S <= now:
            out.send(self.ports[0], self.asks[self.sent][1])
            self.sent += 1
        return out

    def next_wakeup(self) -> Time | None:
        return round(self.asks[self.sent][0] * NS_PER_S) if self.sent < len(self.asks) else None


def intent(
    vehicle: str, *volumes: Volume4D, priority: int = 0, state: IntentState = IntentState.ACCEPTED
) -> OperationalIntent:
    operator = vehicle.split("/", maxsplit=1)[0]
    claimed = volumes or (box(LAT, LON, start_s=600.0),)
    return OperationalIntent(intent_id(vehicle), operator, vehicle, claimed, priority, state)


def ask(
    vehicle: str,
    *volumes: Volume4D,
    priority: int = 0,
    state: IntentState = IntentState.ACCEPTED,
    version: int = 0,
) -> bytes:
    return encode(Request.of(intent(vehicle, *volumes, priority=priority, state=state), EPOCH, version))


def end(vehicle: str) -> bytes:
    return encode(Request.end(intent(vehicle)))


def decisions(station: Station) -> list[str]:
    return [body.decision for _, body in station.answers]


def fly_requests(
    asks: Mapping[str, Sequence[tuple[float, bytes]]],
    until_s: float,
    agents: Sequence[Any],
    links: Sequence[LinkSpec],
    seed: int,
    may_err: bool = False,
) -> tuple[dict[str, Station], MemoryObserver]:
    """Run stations that ask at their times (s) beside the agents of an approval."""
    stations = [
        Station(operator, sorted(rows, key=lambda row: row[0]), may_err=may_err) for operator, rows in asks.items()
    ]
    channel = Channel(mode="reliable", latency_ns=25 * NS_PER_MS)
    own = [LinkSpec(station.ports[0].link, station.name, APPROVAL, channel) for station in stations]
    seen = MemoryObserver()
    kernel = Kernel(Wiring(seed=seed, links=[*own, *links], agents=[*stations, *agents]), [seen])
    kernel.advance(round(until_s * NS_PER_S))
    kernel.finish()
    return {station.operator: station for station in stations}, seen
