"""A fixed channel delays, loses, doubles, reorders and queues as declared."""

from __future__ import annotations

import pytest

from skyrange.contracts.frames import Fate
from skyrange.contracts.links import Channel, LinkSpec
from skyrange.core.chance import Chance
from skyrange.core.time import NS_PER_MS, NS_PER_S
from skyrange.kernel.directed_link import NOT_RANDOM, RETRANSMIT_MIN_NS, ChannelState, DirectedLink

MS = NS_PER_MS


def test_latency_only() -> None:
    state = ChannelState(Channel(latency_ns=5 * MS))
    assert state.carry(100, 40, NOT_RANDOM) == (Fate.DELIVERED, 100 + 5 * MS, None)


def test_rate_serialises_and_the_queue_is_bounded() -> None:
    state = ChannelState(Channel(latency_ns=MS, rate_bps=8_000, queue_bytes=100))  # one byte a millisecond
    arrivals = [state.carry(0, 40, NOT_RANDOM) for _ in range(4)]
    assert [a[0] for a in arrivals] == [Fate.DELIVERED, Fate.DELIVERED, Fate.OVERFLOW, Fate.OVERFLOW]
    assert arrivals[0][1] == 41 * MS
    assert arrivals[1][1] == 81 * MS
    assert state.carry(80 * MS, 40, NOT_RANDOM) == (Fate.DELIVERED, 121 * MS, None)


def test_frequencies_match_the_declared_chances() -> None:
    spec = Channel(latency_ns=10 * MS, jitter_ns=4 * MS, loss=0.1, duplicate=0.2, reorder=0.05)
    link = DirectedLink(LinkSpec("gcs:a/b", "a.gcs", "a/b.companion", spec), "fwd", Chance(3))
    n = 20_000
    lost = doubled = overtaken = 0
    last = 0
    for i in range(n):
        now = i * 100 * MS  # far enough apart that only `reorder_ns` could not overtake: order is checked below
        fate, arrival, twin = link.channel.carry(now, 50, link.draws("a.gcs", now))
        lost += fate is Fate.LOST
        doubled += twin is not None
        if fate is Fate.DELIVERED:
            delay = arrival - now
            overtaken += delay >= 30 * MS
            assert 10 * MS <= delay < 34 * MS
            assert arrival > last
            last = arrival
    # four standard deviations of a binomial: the draw is fixed, so this cannot flicker
    for count, p in ((lost, 0.1), (doubled, 0.9 * 0.2), (overtaken, 0.9 * 0.05)):
        assert abs(count - n * p) < 4 * (n * p * (1 - p)) ** 0.5


def test_jitter_keeps_order_and_reorder_breaks_it() -> None:
    def arrivals(spec: Channel) -> list[int]:
        link = DirectedLink(LinkSpec("gcs:a/b", "a.gcs", "a/b.companion", spec), "fwd", Chance(3))
        return [link.channel.carry(i * MS, 50, link.draws("a.gcs", i * MS))[1] for i in range(500)]

    smooth = arrivals(Channel(latency_ns=10 * MS, jitter_ns=50 * MS))
    assert smooth == sorted(smooth)
    assert len(set(smooth)) < len(smooth), "jitter over the spacing bunches frames up"
    rough = arrivals(Channel(latency_ns=10 * MS, reorder=0.1))
    assert rough != sorted(rough)


def test_a_reliable_link_loses_nothing_but_time() -> None:
    spec = Channel(mode="reliable", latency_ns=MS, loss=0.3)
    state = ChannelState(spec)
    assert state.carry(0, 50, (0.5, 0.0, 1.0, 1.0))[1] == MS
    once = state.carry(NS_PER_S, 50, (0.29, 0.0, 1.0, 1.0))  # 0.29 < 0.3, not < 0.09
    assert once == (Fate.DELIVERED, NS_PER_S + MS + RETRANSMIT_MIN_NS, None)
    behind = state.carry(NS_PER_S + 1, 50, (0.9, 0.0, 1.0, 1.0))
    assert behind[1] == once[1], "in order: the next frame waits for the retransmitted one"
    twice = state.carry(2 * NS_PER_S, 50, (0.08, 0.0, 1.0, 1.0))  # < 0.09, not < 0.027
    assert twice[1] == 2 * NS_PER_S + MS + 3 * RETRANSMIT_MIN_NS, "the time-out doubles"
    assert ChannelState(Channel(mode="reliable", loss=1.0)).carry(0, 1, (0.5, 0.0, 1.0, 1.0))[0] is Fate.DELIVERED


def test_one_frame_more_does_not_change_another_senders_luck() -> None:
    spec = LinkSpec("gcs:a/b", "a.gcs", "a/b.companion", Channel(loss=0.5))
    alone, crowded = DirectedLink(spec, "fwd", Chance(1)), DirectedLink(spec, "fwd", Chance(1))
    for now in range(0, 1000, 10):
        crowded.draws("intruder", now)
        assert alone.draws("a.gcs", now) == crowded.draws("a.gcs", now)
    assert alone.draws("a.gcs", 5000) != alone.draws("a.gcs", 5000), "the second frame at one time has luck of its own"


def test_latency_below_a_microsecond_is_refused() -> None:
    with pytest.raises(ValueError, match="latency_ns is 999"):
        LinkSpec("x:y", "a", "b", Channel(latency_ns=999))
