"""Frames made of others: blocks name what they answer, and who speaks where it forwards shifts nobody."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import numpy as np
import pytest

from skyrange.contracts.components import Agent
from skyrange.contracts.frames import Frame, Payloads
from skyrange.contracts.links import Channel, LinkSpec, Route, TapPlacement
from skyrange.contracts.mailboxes import Inbox, Outbox
from skyrange.contracts.references import FrameRefTable
from skyrange.contracts.verdicts import Direction, Inject, Verdict
from skyrange.core.ids import Port
from skyrange.core.time import NS_PER_MS, Time
from skyrange.kernel import Kernel, Wiring
from skyrange.record.write.memory_observer import MemoryObserver

MS = NS_PER_MS
NAMES = [f"blue/b{number}" for number in range(5)]
END = 200 * MS


class Callers:
    """Every aircraft calls up every 20 ms, in one block."""

    name = "callers"
    service_ns = 10 * MS

    def __init__(self) -> None:
        self.ports: Sequence[Port] = [Port(f"{name}.companion", f"rid_up:{name}") for name in NAMES]
        self.turn = 0

    def next_wakeup(self) -> Time | None:
        return self.turn * 20 * MS

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        out = Outbox()
        out.send_block(np.arange(len(NAMES)), Payloads.of([bytes([self.turn, place]) for place in range(len(NAMES))]))
        self.turn += 1
        return out


class Echo:
    """Passes what each aircraft calls to the next one, in one block that names its parents."""

    name = "oracle"
    service_ns = 10 * MS

    def __init__(self) -> None:
        self.ports: Sequence[Port] = [
            Port("oracle", f"{kind}:{name}") for kind in ("rid_up", "rid_down") for name in NAMES
        ]
        self.places = {port: place for place, port in enumerate(self.ports)}
        self.refs = FrameRefTable()

    def next_wakeup(self) -> Time | None:
        return None

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        out = Outbox()
        mail = inbox.columns(self.places)
        to = (mail.places + 1) % len(NAMES) + len(NAMES)
        out.send_block(to, mail.payloads, self.refs.parents(*self.refs.read(inbox, mail.order)))
        return out


class Forger:
    """A tap that puts a call of its own beside every third."""

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        return (
            [Inject(b"forged", cast(Direction, frame.direction), frame.src, frame.dst)] if frame.serial % 3 == 1 else []
        )

    def next_wakeup(self) -> Time | None:
        return None

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        return []


def heard(fuse: bool, tapped: str) -> tuple[Any, list[Frame]]:
    links = [LinkSpec(f"rid_up:{name}", f"{name}.companion", "oracle") for name in NAMES]
    links += [LinkSpec(f"rid_down:{name}", "oracle", f"{name}.companion") for name in NAMES]
    taps = [TapPlacement(f"rid_up:{tapped}", "companion", lambda link: Forger())] if tapped else []
    observer = MemoryObserver()
    kernel = Kernel(Wiring(3, links, [Callers(), Echo()], taps=taps, fuse=fuse), [observer])
    kernel.advance(END)
    kernel.finish()
    return observer.digests.frames, observer.frames


@pytest.mark.parametrize("tapped", ["", NAMES[2], "blue/*"])
@pytest.mark.parametrize("fuse", [True, False])
def test_what_is_passed_on_names_what_it_was_made_of(fuse: bool, tapped: str) -> None:
    _, frames = heard(fuse, tapped)
    sent = {frame.id: frame for frame in frames}
    down = [frame for frame in frames if frame.link.startswith("rid_down:")]
    assert len(down) >= 8 * len(NAMES)
    for frame in down:
        assert frame.parent is not None
        above = sent[frame.parent]
        assert above.payload == frame.payload
        assert above.link.startswith("rid_up:")
    forged = [frame for frame in down if frame.payload == b"forged"]
    assert bool(forged) == bool(tapped)
    for frame in forged:
        assert frame.parent is not None
        assert frame.parent.sender.startswith("tap@")


@pytest.mark.parametrize("tapped", ["", NAMES[2], "blue/*"])
def test_blocks_with_parents_leave_the_record_of_singles(tapped: str) -> None:
    assert heard(True, tapped)[0] == heard(False, tapped)[0]


class Voice:
    """A companion's own program: it speaks on `log` every so often, where its endpoint forwards."""

    service_ns = MS

    def __init__(self, vehicle: str, speaking: bool, every: Time) -> None:
        self.name = f"voice of {vehicle}"
        self.originates = [Port(f"{vehicle}.companion", f"log:{vehicle}")]
        self.ports: Sequence[Port] = []
        self.due: Time = 0
        self.speaking = speaking
        self.every = every

    def next_wakeup(self) -> Time | None:
        return self.due

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        out = Outbox()
        self.due = now + self.every
        if self.speaking:
            out.send(self.originates[0], b"mine")
        return out


class Station:
    """Sends a block to all aircraft every 10 ms."""

    name = "blue.gcs"
    service_ns = 10 * MS

    def __init__(self) -> None:
        self.ports: Sequence[Port] = [Port("blue.gcs", f"gcs:{name}") for name in NAMES]
        self.turn = 0

    def next_wakeup(self) -> Time | None:
        return self.turn * 10 * MS

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        out = Outbox()
        out.send_block(np.arange(len(NAMES)), Payloads.of([bytes([self.turn, place]) for place in range(len(NAMES))]))
        if self.turn % 3 == 0:  # a command among the heartbeats
            out.send(self.ports[self.turn % len(NAMES)], b"command")
        self.turn += 1
        return out


class Ears:
    """An autopilot that keeps what it hears."""

    name = "autopilots"
    service_ns = 10 * MS

    def __init__(self) -> None:
        self.ports: Sequence[Port] = [Port(f"{name}.autopilot", f"autopilot:{name}") for name in NAMES]
        self.heard: list[tuple[Time, Any]] = []

    def next_wakeup(self) -> Time | None:
        return None

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        self.heard += [(now, arrival) for arrival in inbox]
        return Outbox()


def spoken(
    fuse: bool,
    log: Channel,
    speaking: bool = True,
    every: Time = 7 * MS,
    proxy_ns: Time = 0,
    ends: Sequence[Time] = (END,),
) -> tuple[Any, list[tuple[Time, Any]], list[Frame]]:
    links = [LinkSpec(f"gcs:{name}", "blue.gcs", f"{name}.companion", Channel(latency_ns=9 * MS)) for name in NAMES]
    links += [LinkSpec(f"log:{name}", f"{name}.companion", f"{name}.proxy", log) for name in NAMES]
    links += [LinkSpec(f"autopilot:{name}", f"{name}.proxy", f"{name}.autopilot") for name in NAMES]
    routes = [Route(f"{name}.companion", f"gcs:{name}", f"log:{name}", 10 * MS) for name in NAMES]
    routes += [Route(f"{name}.proxy", f"log:{name}", f"autopilot:{name}", proxy_ns) for name in NAMES]
    ears = Ears()
    agents: list[Agent] = [Station(), ears, *(Voice(name, speaking, every) for name in NAMES[:2])]
    observer = MemoryObserver()
    kernel = Kernel(Wiring(3, links, agents, routes, fuse=fuse), [observer])
    for end in ends:
        kernel.advance(end)
    kernel.finish()
    return observer.digests.frames, ears.heard, observer.frames


CHANNELS = [
    Channel("reliable", MS // 10),
    Channel("reliable", MS // 10, rate_bps=20_000.0),
    Channel("datagram", MS, jitter_ns=5 * MS, loss=0.1),
]


@pytest.mark.parametrize("proxy_ns", [0, 30 * MS])
@pytest.mark.parametrize("every", [7 * MS, 10 * MS, 50 * MS])  # 10 and 50 ms: at the moments of what is forwarded
@pytest.mark.parametrize("log", CHANNELS)
def test_speaking_where_it_forwards_looks_alike_fused_or_not(log: Channel, every: Time, proxy_ns: Time) -> None:
    for ends in ((END,), (57 * MS, 130 * MS + 1, END - 3 * MS)):
        fused = spoken(True, log, every=every, proxy_ns=proxy_ns, ends=ends)
        unfused = spoken(False, log, every=every, proxy_ns=proxy_ns, ends=ends)
        assert fused[:2] == unfused[:2]
    assert any(frame.payload == b"mine" for frame in fused[2])


def test_what_is_said_has_a_sender_and_serials_of_its_own() -> None:
    _, _, loud = spoken(True, CHANNELS[0])
    _, _, still = spoken(True, CHANNELS[0], speaking=False)
    own = [frame for frame in loud if frame.payload == b"mine" and frame.link.startswith("log:")]
    assert {frame.sender for frame in own} == {f"{name}.companion.own" for name in NAMES[:2]}
    assert {frame.src for frame in own} == {f"{name}.companion" for name in NAMES[:2]}
    assert [f.serial for f in own if f.link == f"log:{NAMES[0]}"] == list(range(len(own) // 2))
    assert sorted(f.id for f in loud if f.link.startswith("log:") and f not in own) == sorted(
        f.id for f in still if f.link.startswith("log:")
    )
