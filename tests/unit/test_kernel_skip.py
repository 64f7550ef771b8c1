"""A kernel that stands still: what was due meanwhile happens once, afterwards, and a late one begins in the present."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import pytest

from skyrange.assembly.build import build
from skyrange.contracts.components import Agent
from skyrange.contracts.links import Channel, LinkSpec
from skyrange.contracts.mailboxes import Inbox, Outbox
from skyrange.core.errors import ComponentError
from skyrange.core.ids import Port
from skyrange.core.time import NEVER, NS_PER_MS, NS_PER_S, Time
from skyrange.kernel import Kernel
from skyrange.kernel.wiring import Wiring
from skyrange.scenario.toml_files import load_data

SCENARIO = {
    "name": "one",
    "origin": [-35.0, 149.0],
    "operators": [{"id": "blue", "vehicles": [{"id": "b1", "plan": {"path": {"points": [[0.0, 9.0]], "alt_m": 5.0}}}]}],
}
LINK = LinkSpec("l:1", "a", "b", Channel(latency_ns=NS_PER_S // 5))


@dataclass
class Ticker:
    """Sends a byte every 100 ms, and as many as it is late never."""

    name: str = "a"
    service_ns: Time = 20 * NS_PER_MS
    due: Time = 0
    steps: list[Time] = field(default_factory=list)
    got: list[Time] = field(default_factory=list)
    ports: Sequence[Port] = (Port("a", "l:1"),)

    def next_wakeup(self) -> Time | None:
        return self.due

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        self.steps.append(now)
        self.got += [arrival.at for arrival in inbox]
        out = Outbox()
        if now >= self.due:
            self.due = now - now % (NS_PER_S // 10) + NS_PER_S // 10
            out.send(self.ports[0], b"x")
        return out


@dataclass
class Listener(Ticker):
    name: str = "b"
    ports: Sequence[Port] = (Port("b", "l:1"),)

    due: Time = NEVER

    def next_wakeup(self) -> Time | None:
        return None


def made(*agents: Agent) -> Kernel:
    return Kernel(Wiring(1, [LINK], agents, fuse=False))


def test_what_was_due_while_it_stood_still_happens_once() -> None:
    ticker, listener = Ticker(), Listener()
    kernel = made(ticker, listener)
    kernel.advance(NS_PER_S + NS_PER_MS)
    steps, got = len(ticker.steps), len(listener.got)
    kernel.skip(6 * NS_PER_S + 1)
    kernel.advance(6 * NS_PER_S + 90 * NS_PER_MS)
    assert ticker.steps[steps:] == [6 * NS_PER_S + 20 * NS_PER_MS]
    assert listener.got[got:] == [6 * NS_PER_S + 1] * 2  # what was under way, both at once
    kernel.advance(7 * NS_PER_S)
    assert len(ticker.steps) == steps + 1 + 10


def test_one_that_begins_late_begins_then() -> None:
    ticker = Ticker()
    kernel = made(ticker)
    kernel.skip(30 * NS_PER_S)
    assert kernel.due == 30 * NS_PER_S
    kernel.advance(30 * NS_PER_S + 150 * NS_PER_MS)
    assert ticker.steps == [30 * NS_PER_S, 30 * NS_PER_S + 100 * NS_PER_MS]


def test_what_is_past_is_not_skipped() -> None:
    ticker = Ticker()
    kernel = made(ticker)
    kernel.advance(NS_PER_S)
    kernel.skip(NS_PER_S // 2)
    assert kernel.now == NS_PER_S
    kernel.advance(NS_PER_S + NS_PER_S // 10)
    assert len(ticker.steps) == 12


def test_a_world_cannot_stand_still() -> None:
    kernel = Kernel(build(load_data(SCENARIO, "test")).wiring)
    with pytest.raises(ComponentError, match="cannot stand still"):
        kernel.skip(NS_PER_S)
