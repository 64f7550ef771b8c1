"""The processor of an endpoint against one that is simulated frame by frame, with defences there that take time."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyrange.contracts.frames import Frame
from skyrange.contracts.links import Act, Channel, LinkSpec, ProcessingLimit, TapPlacement
from skyrange.contracts.mailboxes import Inbox, Outbox
from skyrange.contracts.verdicts import Drop, Verdict
from skyrange.core.ids import Port
from skyrange.core.time import NS_PER_S, Time
from skyrange.defence.placement import DefenceTap
from skyrange.kernel import Kernel, Wiring
from tests.probes.toys import Log

GAPS = st.lists(st.integers(0, 60) | st.integers(0, 2000), max_size=120)
"""Times between arrivals, in µs: bursts, and pauses in which the queue empties."""
LATENCY_NS: Time = 1000


@dataclass
class Source:
    """Sends a frame at each of some times."""

    times: Sequence[Time]
    name: str = "source"
    service_ns: Time = 1
    ports: Sequence[Port] = field(default_factory=lambda: [Port("a", "l")])
    sent: int = 0

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        out = Outbox()
        while self.sent < len(self.times) and self.times[self.sent] <= now:
            out.send(self.ports[0], bytes([self.sent % 251]))
            self.sent += 1
        return out

    def next_wakeup(self) -> Time | None:
        return self.times[self.sent] if self.sent < len(self.times) else None


@dataclass
class Sieve(DefenceTap):
    """Drops frames whose payload is a multiple of a number."""

    number: int

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        return [Drop()] if frame.payload[0] % self.number == 0 else ()


def fly(times: Sequence[Time], limit: ProcessingLimit | None, costs: Sequence[Time], muted: bool = False) -> Log:
    """Frames from `a` to `b`, where defences take time: the first drops multiples of 2, the second those of 3."""
    names = [f"d{k}" for k in range(len(costs))]
    log = Log()
    taps = [TapPlacement("l", "b", partial(Sieve, number=k + 2), names[k], cost_ns=ns) for k, ns in enumerate(costs)]
    kernel = Kernel(
        Wiring(
            1,
            [LinkSpec("l", "a", "b", Channel(latency_ns=LATENCY_NS))],
            agents=[Source(times)],
            taps=taps[::-1],  # the last of the wiring is nearest to the channel
            acts=[Act(name, muted=muted, role="defence") for name in names],
            processing=[limit] if limit is not None else [],
        ),
        [log],
    )
    kernel.advance(60 * NS_PER_S)
    kernel.finish()
    return log


def fates(log: Log) -> list[tuple[str, Time]]:
    """Of each frame in order: its fate, and when it was delivered."""
    return [(str(row[8]), int(str(row[7]))) for row in sorted(log.frames, key=lambda row: int(str(row[4])))]


def simulate(
    arrivals: Sequence[Time], service_ns: Time, places: int | None, costs: Sequence[Time]
) -> list[tuple[str, Time]]:
    """One processor and its queue, which is emptied one frame at a time."""
    done: list[tuple[str, Time]] = [("", -1)] * len(arrivals)
    waiting: deque[int] = deque()
    free_at: Time = -1

    def process(number: int, start: Time) -> Time:
        at = start
        for k, cost_ns in enumerate(costs):
            at += cost_ns
            if number % 251 % (k + 2) == 0:
                done[number] = ("dropped", -1)
                return at
        done[number] = ("delivered", at + service_ns)
        return at + service_ns

    for number, now in enumerate(arrivals):
        while waiting and free_at <= now:
            free_at = process(waiting.popleft(), free_at)
        if free_at <= now and not waiting:
            free_at = process(number, now)
        elif places is None or len(waiting) < places:
            waiting.append(number)
        else:
            done[number] = ("overflow", -1)
    while waiting:
        free_at = process(waiting.popleft(), free_at)
    return done


def times_of(gaps: Sequence[int]) -> list[Time]:
    now, found = 1000, []
    for gap in gaps:
        now += gap * 1000
        found.append(now)
    return found


@given(GAPS, st.integers(1, 300), st.integers(1, 20))
def test_it_is_a_server_with_a_bounded_queue(gaps: Sequence[int], service_us: int, places: int) -> None:
    times = times_of(gaps)
    log = fly(times, ProcessingLimit("b", NS_PER_S / (service_us * 1000), places), ())
    assert fates(log) == simulate([at + LATENCY_NS for at in times], service_us * 1000, places, ())


@given(GAPS, st.integers(1, 300), st.lists(st.integers(1, 300), min_size=1, max_size=2))
def test_a_frame_takes_the_time_of_each_defence_that_inspects_it(
    gaps: Sequence[int], service_us: int, costs_us: Sequence[int]
) -> None:
    # places for all: whether a tie of an arrival with the end of an inspection finds one is not said
    times, costs = times_of(gaps), [one * 1000 for one in costs_us]
    log = fly(times, ProcessingLimit("b", NS_PER_S / (service_us * 1000), 1000), costs)
    assert fates(log) == simulate([at + LATENCY_NS for at in times], service_us * 1000, 1000, costs)
    log = fly(times, None, costs)  # without a limit the endpoint itself takes no time, and its queue has no end
    assert fates(log) == simulate([at + LATENCY_NS for at in times], 0, None, costs)


@given(GAPS, st.integers(1, 300), st.integers(1, 20), st.booleans())
def test_muted_defences_take_no_time(gaps: Sequence[int], service_us: int, places: int, limited: bool) -> None:
    limit = ProcessingLimit("b", NS_PER_S / (service_us * 1000), places) if limited else None
    muted = fly(times_of(gaps), limit, (70_000, 5_000), muted=True)
    without = fly(times_of(gaps), limit, ())
    assert muted.frames == without.frames
    assert [row for row in muted.notes if row[2] == "event.processing_overflow"] == without.notes


def test_of_a_long_flood_as_many_are_processed_as_declared() -> None:
    times = [1000 + k * NS_PER_S // 2000 for k in range(20_000)]
    found = fates(fly(times, ProcessingLimit("b", 400.0, 39), ()))
    taken = [(sent, at) for sent, (fate, at) in zip(times, found, strict=True) if fate == "delivered"]
    assert len(taken) == 10 * 400 + 39
    late = max(at - sent - LATENCY_NS for sent, at in taken)
    assert NS_PER_S * 39 / 400 < late <= NS_PER_S * 40 / 400  # behind 39 that wait, and one in service


@pytest.mark.parametrize(("cost_us", "share"), [(1, 1.0), (1000, 0.5), (2000, 0.25)])
def test_a_defence_that_takes_longer_than_frames_come_starves_its_endpoint(cost_us: int, share: float) -> None:
    times = [1000 + k * NS_PER_S // 2000 for k in range(8_000)]  # one in 500 µs
    found = fates(fly(times, ProcessingLimit("b", 1e6, 10), (cost_us * 1000,)))
    assert sum(fate != "overflow" for fate, _ in found) / len(found) == pytest.approx(share, abs=0.01)
