"""Acts on frames that many kinds have: a kind whose class has one as its `act` needs no method."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.verdicts import Delay, Drop, Verdict
from skyrange.core.time import NS_PER_US, Time, from_seconds

SHAM_NS: Final = NS_PER_US
"""Delay of a sham."""
_DROP: Final = (Drop(),)


def drop(probability: str | float = 1.0) -> Any:
    """Drop a frame with a probability: a number, or the name of the parameter that has it.

    The sham drops the same frames, because no benign act takes a frame off a link.
    """

    def act(self: Any, now: Time, frame: Frame) -> Sequence[Verdict]:
        share = getattr(self, probability) if isinstance(probability, str) else probability
        return _DROP if share >= 1.0 or self.draw(frame)[0] < share else ()

    return act


def delay(delay_s: str, jitter_s: str) -> Any:
    """Delay a frame by a constant and by a uniform random time, in the order of its direction; the sham by 1 µs.

    The arguments name the parameters. The kind has the state `last: dict[str, Time] = state(dict)`: until when the last
    frame of each direction is held.
    """

    def act(self: Any, now: Time, frame: Frame) -> Sequence[Verdict]:
        delay_ns, jitter_ns = from_seconds(getattr(self, delay_s)), from_seconds(getattr(self, jitter_s))
        if self.sham:
            delay_ns, jitter_ns = SHAM_NS, 0
        until = now + delay_ns
        if jitter_ns:
            until += int(self.draw(frame)[0] * jitter_ns)
        until = max(until, self.last.get(frame.direction, until))
        self.last[frame.direction] = until
        return (Delay(until),)

    return act


def drop_by_turns(down_s: str, up_s: str) -> Any:
    """Drop all frames for `down_s` from the start on, then none for `up_s`, and so on; both name parameters.

    The sham drops them too, because no benign act takes a frame off a link.
    """

    def act(self: Any, now: Time, frame: Frame) -> Sequence[Verdict]:
        down_ns = from_seconds(getattr(self, down_s))
        period_ns = down_ns + from_seconds(getattr(self, up_s))
        return _DROP if (now - self.schedule.start_ns) % period_ns < down_ns else ()

    return act
