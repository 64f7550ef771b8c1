"""The queue of an endpoint against a server that is simulated frame by frame."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from hypothesis import given
from hypothesis import strategies as st

from skyrange.contracts.links import ProcessingLimit
from skyrange.core.time import NS_PER_S, Time
from skyrange.kernel.processing_queue import ProcessingQueue

GAPS = st.lists(st.integers(0, 60) | st.integers(0, 2000), max_size=200)
"""Times between arrivals, in ns: bursts, and pauses in which the queue empties."""


def simulate(arrivals: Sequence[Time], service_ns: Time, places: int) -> list[Time | None]:
    """When each frame is processed: a server, and a queue that is emptied one frame at a time."""
    done: list[Time | None] = [None] * len(arrivals)
    waiting: deque[int] = deque()
    current: tuple[int, Time] | None = None
    for number, now in enumerate(arrivals):
        while current is not None and current[1] <= now:
            done[current[0]] = current[1]
            current = (waiting.popleft(), current[1] + service_ns) if waiting else None
        if current is None:
            current = number, now + service_ns
        elif len(waiting) < places:
            waiting.append(number)
    while current is not None:
        done[current[0]] = current[1]
        current = (waiting.popleft(), current[1] + service_ns) if waiting else None
    return done


@given(GAPS, st.integers(1, 300), st.integers(1, 20))
def test_it_is_a_server_with_a_bounded_queue(gaps: Sequence[int], service_us: int, places: int) -> None:
    queue = ProcessingQueue(ProcessingLimit("e", NS_PER_S / (service_us * 1000), places))
    assert queue.service_ns == service_us * 1000
    now, arrivals = 0, []
    for gap in gaps:
        now += gap * 1000
        arrivals.append(now)
    assert [queue.admit(at) for at in arrivals] == simulate(arrivals, queue.service_ns, places)


def test_of_a_long_flood_as_many_are_processed_as_declared() -> None:
    queue = ProcessingQueue(ProcessingLimit("e", 400.0, 39))
    done = [queue.admit(k * NS_PER_S // 2000) for k in range(20_000)]
    taken = [at for at in done if at is not None]
    assert len(taken) == 10 * 400 + 39
    late = [at - k * NS_PER_S // 2000 for k, at in enumerate(done) if at is not None]
    assert NS_PER_S * 39 / 400 < max(late) <= NS_PER_S * 40 / 400  # behind 39 that wait, and one in service
