"""Jamming bursts: what a medium is told of them, and what control links are told."""

from __future__ import annotations

import pytest

from skyrange.codec.remote_id.noise_request import CONTINUED, NoiseRequest, pack
from skyrange.core.time import NS_PER_MS, Time
from skyrange.radio.jamming import RENEWAL_NS, JammingBursts

LATE = 15 * NS_PER_MS
PERIOD = 100 * NS_PER_MS


def ordered(turnaround_us: int, count: int) -> JammingBursts:
    """`count` orders of 100 ms each, one after the other, each known 15 ms late."""
    bursts = JammingBursts()
    for k in range(count):
        order = NoiseRequest(3000, 2_412_000, 20_000, 100_000, k * PERIOD, turnaround_us)
        assert bursts.request(k * PERIOD + LATE, 0, k * PERIOD, pack(order))
    return bursts


def known(bursts: JammingBursts, at: Time) -> int:
    return sum(one.from_ns <= at < one.to_ns for one in bursts.bursts())


@pytest.mark.parametrize("turnaround_us", [0, CONTINUED])
def test_a_medium_gets_bursts_as_they_were_ordered(turnaround_us: int) -> None:
    table = ordered(turnaround_us, 3).emitters(0)
    assert table.from_ns.tolist() == [0, PERIOD, 2 * PERIOD]
    assert table.to_ns.tolist() == [PERIOD, 2 * PERIOD, 3 * PERIOD]


def test_continued_noise_has_no_gap_and_no_overlap_for_control_links() -> None:
    bursts = ordered(CONTINUED, 3)
    times = range(LATE, 2 * PERIOD + LATE + PERIOD + RENEWAL_NS, NS_PER_MS)
    assert {known(bursts, at) for at in times} == {1}
    assert known(bursts, LATE - 1) == 0
    assert known(bursts, times.stop) == 0


def test_before_the_next_order_is_known_the_noise_is_expected_to_last() -> None:
    """A frame that is sent just before the end of a burst must not find the channel free behind it."""
    assert known(ordered(CONTINUED, 1), PERIOD + LATE + 10 * NS_PER_MS) == 1
    assert known(ordered(0, 1), PERIOD + LATE + 10 * NS_PER_MS) == 0


def test_a_reactive_jammer_is_no_emitter_of_a_medium() -> None:
    bursts = ordered(20, 2)
    assert len(bursts.emitters(0).radio) == 0
    assert [one.turnaround_ns for one in bursts.bursts()] == [20_000, 20_000]
