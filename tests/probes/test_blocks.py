"""Frames sent in blocks: the record, the mail and its order are those of the same frames sent singly."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any, cast

import numpy as np
import pytest

from skyrange.contracts.components import Agent
from skyrange.contracts.frames import Fate, Frame, FrameBlock, Payloads
from skyrange.contracts.links import Act, Channel, LinkSpec, Route, TapPlacement
from skyrange.contracts.mailboxes import Inbox, Outbox
from skyrange.contracts.verdicts import Delay, Direction, Inject, Pass, Verdict
from skyrange.core.errors import ComponentError
from skyrange.core.ids import FrameId, Port
from skyrange.core.time import NS_PER_MS, Time
from skyrange.kernel import Kernel, Wiring, blocks
from skyrange.kernel.blocks import BlockForwarder
from skyrange.kernel.network import Network
from skyrange.record.write.memory_observer import MemoryObserver

MS = NS_PER_MS
NAMES = [f"blue/b{number}" for number in range(7)]
END = 95 * MS


class Many:
    """Speaks for all aircraft every 10 ms, some of them twice: in blocks, or singly."""

    name = "fleet"
    service_ns = 10 * MS

    def __init__(self, blocks: bool, commanded: bool = False) -> None:
        self.blocks = blocks
        self.commanded = commanded
        self.ports: Sequence[Port] = [Port(f"{name}.autopilot", f"autopilot:{name}") for name in NAMES]
        self.step_no = 0

    def next_wakeup(self) -> Time | None:
        return self.step_no * 10 * MS

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        out = Outbox()
        if now < self.step_no * 10 * MS:
            return out
        places = [row for row in range(len(NAMES)) if (row + self.step_no) % 3] + [1, self.step_no % 7]
        payloads = [bytes([self.step_no, place, count]) for count, place in enumerate(places)]
        payloads[0] = b"again and again"
        if self.step_no % 4 == 0:
            out.send(self.ports[2], b"first")
        if self.blocks:
            out.send_block(np.array(places, dtype=np.int64), Payloads.of(payloads))
        else:
            for place, payload in zip(places, payloads, strict=True):
                command = FrameId(f"gcs:{NAMES[place]}", "fwd", "blue.gcs", self.step_no)
                out.send(self.ports[place], payload, (command,) if self.commanded and place % 2 else ())
        self.step_no += 1
        return out


class Ears:
    """A station that keeps what it hears, by the frame and by the column."""

    name = "blue.gcs"
    service_ns = 20 * MS

    def __init__(self) -> None:
        self.ports: Sequence[Port] = [Port("blue.gcs", f"gcs:{name}") for name in NAMES]
        self.heard: list[Any] = []

    def next_wakeup(self) -> Time | None:
        return None

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        table = inbox.columns({port: place for place, port in enumerate(self.ports)})
        rows = zip(table.places.tolist(), table.at_ns.tolist(), table.payloads, table.order.tolist(), strict=True)
        for arrival, (place, at, payload, number) in zip(inbox, rows, strict=True):
            assert arrival == inbox.arrival(number)
            assert (arrival.port, arrival.at, arrival.payload) == (self.ports[place], at, payload)
            self.heard.append((now, arrival))
        return Outbox()


def is_odd(payload: bytes) -> bool:
    return len(payload) == 3 and payload[2] % 2 == 1


class Meddler:
    """A tap on one aircraft's `gcs` link that holds frames up, so that singles and blocks arrive together."""

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        if frame.serial % 3 == 1:
            return [Inject(b"!", cast(Direction, frame.direction), frame.src, frame.dst), Pass()]
        return [Delay(now + 7 * MS) if frame.serial % 3 else Pass()]

    def next_wakeup(self) -> Time | None:
        return None

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        return []


def wiring(blocks: bool, fuse: bool = True, gcs: Channel | None = None, tapped: str = "", agents: Any = None) -> Wiring:
    links, routes = [], []
    for name in NAMES:
        links += [
            LinkSpec(f"autopilot:{name}", f"{name}.proxy", f"{name}.autopilot", Channel("reliable", MS // 10)),
            LinkSpec(f"log:{name}", f"{name}.companion", f"{name}.proxy", Channel("reliable", MS // 10)),
            LinkSpec(f"rid_data:{name}", f"{name}.proxy", f"{name}.companion", Channel("reliable", MS)),
            LinkSpec(f"gcs:{name}", "blue.gcs", f"{name}.companion", gcs or Channel("datagram", 9 * MS)),
        ]
        routes += [
            Route(f"{name}.proxy", f"autopilot:{name}", f"log:{name}"),
            Route(f"{name}.proxy", f"autopilot:{name}", f"rid_data:{name}", 0, is_odd),
            Route(f"{name}.companion", f"log:{name}", f"gcs:{name}", 10 * MS),
        ]
    taps = [TapPlacement(f"gcs:{tapped}", "gcs", lambda link: Meddler())] if tapped else []
    own: Sequence[Agent] = [Many(blocks), Ears()]
    return Wiring(3, links, agents or own, routes, taps, fuse=fuse)


def outcome(observer: MemoryObserver, ears: Any) -> tuple[Any, ...]:
    return observer.digests.frames, len(observer.frames), ears.heard


def fly(*args: Any, ends: Sequence[Time] = (END,), **kwargs: Any) -> tuple[Any, ...]:
    observer = MemoryObserver()
    plan = wiring(*args, **kwargs)
    kernel = Kernel(plan, [observer])
    for end in ends:
        kernel.advance(end)
    kernel.finish()
    return outcome(observer, plan.agents[1])


@pytest.mark.parametrize("tapped", ["", NAMES[3], "blue/*"])
@pytest.mark.parametrize(
    "gcs", [None, Channel("datagram", 9 * MS, jitter_ns=5 * MS, loss=0.1), Channel("datagram", 9 * MS, rate_bps=1e5)]
)
def test_blocks_and_singles_leave_one_record(gcs: Channel | None, tapped: str) -> None:
    singly = fly(False, gcs=gcs, tapped=tapped)
    assert len(singly[2]) > 20
    assert fly(True, gcs=gcs, tapped=tapped) == singly
    assert fly(True, False, gcs=gcs, tapped=tapped) == singly
    assert fly(True, gcs=gcs, tapped=tapped, ends=range(0, END + 1, MS // 2)) == singly


class BlockCounter(MemoryObserver):
    """Counts the blocks that it is shown."""

    blocks = 0

    def on_block(self, block: FrameBlock) -> None:
        self.blocks += 1
        super().on_block(block)


@pytest.mark.parametrize("tapped", ["", NAMES[3], "blue/*"])
@pytest.mark.parametrize("gcs", [None, Channel("datagram", 9 * MS, jitter_ns=5 * MS, loss=0.1)])
@pytest.mark.parametrize("end", [10 * MS, 19 * MS, END])
def test_single_frames_that_are_gathered_leave_the_record_of_single_frames(
    monkeypatch: pytest.MonkeyPatch, gcs: Channel | None, tapped: str, end: Time
) -> None:
    outcomes, causes, blocks = [], [], []
    for least in (1_000, 1):
        monkeypatch.setattr("skyrange.kernel.network.GATHERED_MIN", least)
        observer, agents = BlockCounter(), [Many(False, commanded=True), Ears()]
        kernel = Kernel(wiring(False, gcs=gcs, tapped=tapped, agents=agents), [observer])
        kernel.advance(end)
        kernel.finish()
        outcomes.append(outcome(observer, agents[1]))
        causes.append({frame.id: frame.causes for frame in observer.frames})
        blocks.append(observer.blocks)
    assert outcomes[0] == outcomes[1]
    assert causes[0] == causes[1]
    assert any(causes[0].values())
    assert blocks[0] == 0
    assert (blocks[1] > 0) == (gcs is None and tapped != "blue/*")


@pytest.mark.parametrize("end", [0, MS // 20, MS // 10, MS, 10 * MS, 15 * MS, 19 * MS, 19 * MS + 1, END])
def test_a_block_under_way_at_the_end_is_recorded_hop_by_hop(end: Time) -> None:
    assert fly(True, ends=(end,)) == fly(False, ends=(end,))


def test_a_fork_with_blocks_under_way_continues_identically() -> None:
    straight = fly(True)
    stem_eyes, stem = MemoryObserver(), wiring(True)
    kernel = Kernel(stem, [stem_eyes])
    kernel.advance(14 * MS)
    twin_eyes = MemoryObserver()
    twin_eyes.frames += stem_eyes.frames
    twin = kernel.fork([twin_eyes])
    twin.advance(END)
    twin.finish()
    kernel.advance(END)
    kernel.finish()
    assert outcome(stem_eyes, stem.agents[1]) == straight
    assert twin_eyes.digests.frames == straight[0]


def test_hops_of_a_block_name_their_parents() -> None:
    observer = MemoryObserver()
    kernel = Kernel(wiring(True), [observer])
    kernel.advance(END)
    kernel.finish()
    sent = {frame.id: frame for frame in observer.frames}
    arrived = [frame for frame in observer.frames if frame.link.startswith("gcs:") and frame.fate is Fate.DELIVERED]
    assert arrived
    for frame in arrived:
        assert frame.parent is not None
        above = sent[frame.parent]
        assert above.parent is not None
        root = sent[above.parent]
        assert (above.link, root.link) == (frame.link.replace("gcs", "log"), frame.link.replace("gcs", "autopilot"))
        assert above.payload == root.payload == frame.payload
        assert root.parent is None


def test_blocks_of_an_attack_are_labelled_one_by_one_and_silenced_when_muted() -> None:
    for muted in (False, True):
        observer = MemoryObserver()
        plan = wiring(True, agents=[Ears()])
        plan.acts = [Act("bad", muted=muted, agents=[Many(True)])]
        kernel = Kernel(plan, [observer])
        kernel.advance(END)
        kernel.finish()
        sent = [frame.id for frame in observer.frames if frame.link.startswith("autopilot:")]
        assert sorted(label.frame for label in observer.labels) == sorted(sent)
        assert (sent == []) == muted


def test_a_block_from_a_port_that_is_no_links_end_is_refused() -> None:
    stray = Many(True)
    stray.ports = [*stray.ports, Port("blue/b9.autopilot", "autopilot:blue/b9")]
    kernel_wiring = wiring(True, agents=[stray, Ears()])
    with pytest.raises(ComponentError, match="no link's end"):
        Kernel(kernel_wiring, []).advance(END)


class Talker:
    """Sends frames of its own from the proxies of some aircraft, beside what these forward."""

    name = "talker"
    service_ns = 5 * MS

    def __init__(self) -> None:
        self.ports: Sequence[Port] = []
        self.originates: Sequence[Port] = [Port(f"{name}.proxy", f"log:{name}") for name in NAMES[:3]]
        self.next = 0

    def next_wakeup(self) -> Time | None:
        return self.next

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        out = Outbox()
        if now >= self.next:
            self.next = now + 5 * MS
            for port in self.originates:
                out.send(port, f"talk at {now}".encode())
        return out


@pytest.mark.parametrize("loss", [0.0, 0.3])
@pytest.mark.parametrize("end", [0, MS // 10, MS, 10 * MS, 10 * MS + 1, 15 * MS, 19 * MS, 19 * MS + 1, 29 * MS, END])
def test_frames_fates_and_times_are_the_same_by_each_way_over_a_hop(
    monkeypatch: pytest.MonkeyPatch, end: Time, loss: float
) -> None:
    """A hop is written four times, for speed: `_transmit`, `_follow_fused`, `_follow` and `_queue_singly`."""
    used: Counter[str] = Counter()

    def count(owner: Any, name: str) -> None:
        way = getattr(owner, name)

        def counted(*args: Any, **kwargs: Any) -> Any:
            used[name] += 1
            return way(*args, **kwargs)

        monkeypatch.setattr(owner, name, counted)

    for owner, name in (
        (Network, "_forward_queued"),
        (Network, "_follow_fused"),
        (blocks, "_follow"),
        (BlockForwarder, "_queue_singly"),
    ):
        count(owner, name)
    gcs = Channel("datagram", 9 * MS, loss=loss)
    outcomes = []
    for in_blocks, fuse, ways in (
        (False, False, {"_forward_queued"}),
        (False, True, {"_forward_queued", "_follow_fused"}),
        (True, True, {"_forward_queued", "_follow", "_queue_singly"}),
    ):
        used.clear()
        observer, ears = MemoryObserver(), Ears()
        kernel = Kernel(wiring(in_blocks, fuse, gcs, agents=[Many(in_blocks), ears, Talker()]), [observer])
        kernel.advance(end)
        kernel.finish()
        if end == END and not loss:
            assert ways <= set(used)
        fates = sorted(
            (frame.id, frame.sent_ns, frame.arrived_ns, frame.fate, frame.src, frame.dst, frame.payload, frame.parent)
            for frame in observer.frames
        )
        outcomes.append((fates, observer.digests.frames, ears.heard))
    assert outcomes[0][0]
    assert outcomes[1] == outcomes[0]
    assert outcomes[2] == outcomes[0]
