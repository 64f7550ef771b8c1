"""UTC clocks of a fleet's autopilots, which their GNSS receivers set.

After libraries/AP_RTC/AP_RTC.cpp (`set_utc_usec`) and AP_GPS.cpp (`update_instance`) of ArduPilot 4.5 or later (pull
request 24022; before, only the first fix did it): each 3D fix sets the clock of a disarmed aircraft, and never
backwards. RTC_TYPES keeps its default, so no other source sets it. The clock of an armed aircraft runs on, unless it
was never set.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.frames import Ints
from skyrange.core.time import NS_PER_US, Epoch, Time

_NONE: Final = np.zeros(0, dtype=np.int64)
_FIX_3D: Final = 3


class UtcClocks:
    """The clocks of all aircraft of one engine, by row. Deep-copyable."""

    __slots__ = ("_all_known", "_any_behind", "epoch", "error_ns", "known", "receiver_error_ns")

    def __init__(self, count: int, epoch: Epoch) -> None:
        self.epoch = epoch
        self.error_ns: Ints = np.zeros(count, dtype=np.int64)
        """(n,) how far each clock is ahead of UTC."""
        self.known: NDArray[np.bool_] = np.zeros(count, dtype=np.bool_)
        """(n,) whether the clock was ever set."""
        self.receiver_error_ns: Ints = self.error_ns
        """(n,) how far the receiver's own time is ahead of UTC in this tick."""
        self._all_known = False
        self._any_behind = False

    def update(self, receiver_error_ns: Ints, fix: Ints, armed: Ints) -> Ints:
        """Set the clocks by the receivers. Returns the rows of the clocks that were set.

        Without errors a fix sets a clock that is not behind to what it shows already, which changes nothing and is left
        out.
        """
        self.receiver_error_ns = receiver_error_ns
        if self._all_known and not self._any_behind and not np.count_nonzero(receiver_error_ns):
            return _NONE
        ahead = (armed == 0) & (receiver_error_ns > self.error_ns)
        rows = np.flatnonzero((fix >= _FIX_3D) & (ahead | ~self.known))
        self.error_ns[rows] = receiver_error_ns[rows]
        self.known[rows] = True
        self._look()
        return rows

    def restart(self, row: int, fix: int) -> None:
        """Restart a clock, as at boot: it is set by the fix if there is one, even backwards."""
        self.known[row] = fix >= _FIX_3D
        self.error_ns[row] = self.receiver_error_ns[row] if self.known[row] else 0
        self._look()

    def _look(self) -> None:
        """Note whether all clocks are known, and whether one is behind."""
        self._all_known = bool(self.known.all())
        self._any_behind = bool((self.error_ns < 0).any())

    def utc_us(self, rows: Ints, now: Time) -> Ints:
        """UTC by each clock, in µs since 1970; 0 if it is unknown, as in SYSTEM_TIME."""
        shown = (self.epoch.unix_ns + now + self.error_ns[rows]) // NS_PER_US
        utc: Ints = np.where(self.known[rows], np.maximum(shown, 0), 0)
        return utc
