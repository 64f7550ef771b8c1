"""Clock offsets of processes: how far their clocks are from the run's, and from one another."""

from __future__ import annotations

from skyrange.core.time import NS_PER_MS, Time


class ClockOffsets:
    """Statistics of each process's clock against the run's; positive is ahead."""

    def __init__(self) -> None:
        self._last: dict[int, Time] = {}
        self._count = 0
        self._total = 0
        self._max = 0
        self._between = 0

    def record(self, row: int, ahead_ns: Time) -> None:
        """A report of process `row` was this far ahead of the tick in which it was read."""
        self._last[row] = ahead_ns
        self._count += 1
        self._total += abs(ahead_ns)
        self._max = max(self._max, abs(ahead_ns))
        self._between = max(self._between, max(self._last.values()) - min(self._last.values()))

    def forget(self, row: int) -> None:
        """Forget a process that was restarted or has ended."""
        self._last.pop(row, None)

    @property
    def summary(self) -> dict[str, float]:
        """`mean` and `max` distance from the run's clock, and the largest distance `between` two processes, ms; {}
        without data.
        """
        if not self._count:
            return {}
        parts = {"mean": self._total / self._count, "max": self._max, "between": self._between}
        return {name: round(part / NS_PER_MS, 3) for name, part in parts.items()}
