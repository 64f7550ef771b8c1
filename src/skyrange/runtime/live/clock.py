"""Range clock: nanoseconds since time 0 of a live range, and the offset between the clocks of two machines.

All processes of a machine share one monotonic clock (`CLOCK_MONOTONIC`), so between them there is nothing to measure.
Another machine has another clock, which began elsewhere and runs faster or slower by some millionths. Its offset is
measured as NTP does it (RFC 5905, section 8): by requests and their answers, of which the quickest says most.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Protocol

import numpy as np

from skyrange.core.time import NS_PER_MS, NS_PER_S, Time

JUMP_NS: Final[Time] = 100 * NS_PER_MS
"""A clock whose offset changed by more than this, and by more than is uncertain, did not drift: it was set, or stood
still."""
PHI: Final = 15e-6
"""Assumed frequency tolerance of a clock, in s/s: RFC 5905, section 7.2, PHI."""
_PPM: Final = 1e6


class Clock(Protocol):
    """A machine's monotonic clock.

    Waiting is the event loop's, whose time passes with this clock: in a live range both are the system's, in virtual
    time (`tests.live_ranges`) both advance when every task waits.
    """

    def monotonic_ns(self) -> int:
        """Nanoseconds since an arbitrary instant; never decreases."""
        ...


class MonotonicClock:
    """The monotonic clock of the operating system."""

    def monotonic_ns(self) -> int:
        """See `Clock`."""
        return time.monotonic_ns()


@dataclass(slots=True)
class RangeClock:
    """The range's time: 0 at `zero_ns` of `clock`. `zero_ns` may be set anew as the offset is measured again."""

    clock: Clock
    zero_ns: int

    def now(self) -> Time:
        """The range's time in nanoseconds; negative before its start."""
        return self.clock.monotonic_ns() - self.zero_ns


@dataclass(frozen=True, slots=True)
class ClockSample:
    """One request and its answer: sent and received by the asking machine's clock, answered by the range's, in ns."""

    sent_ns: int
    answered_ns: int
    received_ns: int

    @property
    def offset_ns(self) -> int:
        """By how much the asking machine's clock is ahead of the range's, if both ways took equally long."""
        return (self.sent_ns + self.received_ns) // 2 - self.answered_ns

    @property
    def uncertainty_ns(self) -> int:
        """The largest possible error of the offset, however unequal the ways: half of the round-trip time."""
        return -(-(self.received_ns - self.sent_ns) // 2)


def quickest_sample(samples: Sequence[ClockSample]) -> ClockSample:
    """The sample with the least uncertainty."""
    return min(samples, key=lambda sample: sample.uncertainty_ns)


@dataclass(slots=True)
class ClockOffset:
    """One machine's clock against the range's: offset, uncertainty, drift and jumps."""

    offset_ns: int = 0
    uncertainty_ns: int = 0
    measured: int = 0
    """Number of samples so far."""
    jumps: list[dict[str, Any]] = field(default_factory=list)
    _samples: list[ClockSample] = field(default_factory=list)
    """All since the last jump."""

    def add_sample(self, sample: ClockSample, zero_ns: int) -> None:
        """Take one more measurement; `zero_ns` is the range's zero on its own clock, 0 before that is known.

        A sample that took long says less than what is known already, until that has grown old.
        """
        moved = abs(sample.offset_ns - self.offset_ns)
        known_ns = self.uncertainty_ns
        if self._samples:
            known_ns += round(PHI * (sample.answered_ns - self._samples[-1].answered_ns))
        jumped = bool(self._samples) and moved > JUMP_NS + sample.uncertainty_ns + known_ns
        if jumped:
            self._samples.clear()
            if zero_ns:
                at_s = (sample.answered_ns - zero_ns) / NS_PER_S
                by_s = (sample.offset_ns - self.offset_ns) / NS_PER_S
                self.jumps.append({"at_s": round(at_s, 3), "by_s": round(by_s, 3)})
        apart = moved > sample.uncertainty_ns + known_ns
        if not self._samples or apart or sample.uncertainty_ns <= known_ns:
            self.offset_ns, self.uncertainty_ns = sample.offset_ns, sample.uncertainty_ns
        else:
            self.uncertainty_ns = known_ns
        self._samples.append(sample)
        self.measured += 1

    @property
    def drift_ppm(self) -> tuple[float, float] | None:
        """Frequency error in millionths and its uncertainty; `None` before three measurements.

        The slope of a line through all measurements since the last jump, each weighted by its uncertainty as if that
        were a standard deviation.
        """
        if len(self._samples) < 3:
            return None
        at, offset, sigma = (
            np.array([getattr(sample, name) for sample in self._samples], np.float64)
            for name in ("answered_ns", "offset_ns", "uncertainty_ns")
        )
        weight = np.maximum(sigma, 1.0) ** -2
        from_mean = at - np.average(at, weights=weight)
        spread = float((weight * from_mean**2).sum())
        if spread == 0.0:
            return None
        slope = float((weight * from_mean * (offset - self.offset_ns)).sum()) / spread
        return _PPM * slope, _PPM * spread**-0.5

    @property
    def manifest_entry(self) -> dict[str, Any]:
        """What the manifest says of this clock, in seconds and ppm."""
        drift = self.drift_ppm
        return {
            "offset_s": round(self.offset_ns / NS_PER_S, 9),
            "uncertainty_s": round(self.uncertainty_ns / NS_PER_S, 9),
            "drift_ppm": None if drift is None else round(drift[0], 2),
            "drift_uncertainty_ppm": None if drift is None else round(drift[1], 2),
            "measured": self.measured,
            "jumps": list(self.jumps),
        }
