"""What time is it in the range? Nanoseconds since its time 0, by this machine's monotonic clock.

All processes of a machine share that clock (`CLOCK_MONOTONIC`), so between them there is nothing to measure.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

from skyrange.core.time import Time


@dataclass(frozen=True, slots=True)
class RangeClock:
    """A clock that is 0 at `zero_ns` of `time.monotonic_ns`."""

    zero_ns: int

    def now(self) -> Time:
        """The range's time."""
        return time.monotonic_ns() - self.zero_ns
