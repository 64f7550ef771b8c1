"""Time of a log: nanoseconds since a whole second of UTC, which never go back, by the times that its frames have."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from skyrange.core.time import NS_PER_S, Time
from skyrange.log_detection.observed_log import Remark

_STEP_BACK_NS: Final = NS_PER_S
_GAP_NS: Final = 3600 * NS_PER_S
"""As `flightlog.tlog`: a longer step back, or a longer gap, is a clock that was set."""
_YEAR_2100_NS: Final = 4_102_444_800 * NS_PER_S
_MOST_NAMED: Final = 5


@dataclass(slots=True)
class LogClock:
    """Reads times in the order of a file. One clock is for one pass."""

    start_unix_ns: int | None = None
    """UTC of time 0: the whole second at or before the first frame. Set by the first time that is read."""
    steps: list[tuple[Time, int]] = field(default_factory=list)
    """When the clock was set, and by how much it stepped, in ns."""
    impossible: int = 0
    """Frames with a time before 1970 or after 2100, which are left out."""
    late: int = 0
    """Frames whose time is a little before that of the frame before them."""
    _last_ns: Time = 0
    _shift_ns: int = 0

    def read(self, unix_ns: int) -> Time | None:
        """The time of the next frame; None if it cannot be."""
        if not 0 <= unix_ns < _YEAR_2100_NS:
            self.impossible += 1
            return None
        if self.start_unix_ns is None:
            self.start_unix_ns = unix_ns // NS_PER_S * NS_PER_S
            self._last_ns = unix_ns - self.start_unix_ns
        now = unix_ns - self.start_unix_ns + self._shift_ns
        step = now - self._last_ns
        if step < -_STEP_BACK_NS or step > _GAP_NS:
            self.steps.append((self._last_ns, step))
            self._shift_ns -= step
            now = self._last_ns
        elif step < 0:
            self.late += 1
            now = self._last_ns
        self._last_ns = now
        return now

    def remarks(self) -> list[Remark]:
        """What was repaired."""
        remarks = [
            Remark("clock", f"it steps by {step / NS_PER_S:+,.1f} s at {at / NS_PER_S:,.1f} s; time goes on from there")
            for at, step in self.steps[:_MOST_NAMED]
        ]
        if len(self.steps) > _MOST_NAMED:
            remarks.append(Remark("clock", f"and {len(self.steps) - _MOST_NAMED:,} further steps"))
        if self.impossible:
            remarks.append(Remark("clock", f"{self.impossible:,} frames have a time that cannot be, and are left out"))
        if self.late:
            text = f"{self.late:,} frames are up to a second earlier than the frame before them; they take its time"
            remarks.append(Remark("clock", text))
        return remarks
