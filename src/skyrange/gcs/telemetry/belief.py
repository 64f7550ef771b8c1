"""Ground station's belief: the state of each aircraft as its telemetry last reported it, one row per aircraft."""

from __future__ import annotations

from enum import IntFlag
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mavlink import dialect as mav
from skyrange.core.time import NEVER, Time

_ARMED: Final = mav.MAV_MODE_FLAG_SAFETY_ARMED
_ROW: Final = np.dtype(
    [
        ("watch", "i8"),  # a Watch: the messages that its flight sequencer must see
        ("heard_ns", "i8"),  # when its last heartbeat was received
        ("armed", "i8"),  # 0, 1, or -1 before the first heartbeat
        ("mode", "i8"),  # -1 before the first heartbeat
        ("heartbeat_seq", "i8"),
        ("consecutive_disarmed", "i8"),
        ("position_ns", "i8"),
        ("item_ns", "i8"),
        ("item", "i8"),  # -1 before the first MISSION_CURRENT
        ("farthest_item", "i8"),
        ("frames", "i8"),
        ("bad", "i8"),
        ("foreign", "i8"),
        ("read_ns", "i8"),  # when its flight sequencer was last handed a frame
    ]
)


class Watch(IntFlag):
    """Messages that a flight sequencer must see even if they repeat known values."""

    NONE = 0
    HEARTBEAT = 1
    POSITION = 2
    COMPLETE = 4
    """MISSION_CURRENT that reports the mission as complete."""


class BeliefTable:
    """The beliefs of a station about all its aircraft, by index; `gcs.telemetry.receiver` updates them in columns."""

    def __init__(self, count: int) -> None:
        self.table: NDArray[Any] = np.zeros(count, dtype=_ROW)
        for name in ("armed", "mode", "item", "heartbeat_seq"):
            self.table[name] = -1
        for name in ("heard_ns", "position_ns", "item_ns", "read_ns"):
            self.table[name] = -NEVER

    def stale_rows(self, now: Time, silent_ns: Time, stale_ns: Time) -> NDArray[np.int64]:
        """Indices of aircraft whose last heartbeat is older than `silent_ns`, or position or item than `stale_ns`."""
        table = self.table
        reported = np.minimum(table["position_ns"], table["item_ns"])
        return np.flatnonzero((table["heard_ns"] < now - silent_ns) | (reported < now - stale_ns))

    def of(self, place: int) -> Belief:
        """The belief about the aircraft with index `place`."""
        return Belief(self, place)


class Belief:
    """One aircraft as its telemetry reports it: a view of its row in `BeliefTable`.

    A time of `-NEVER`, or `None`, means that no message has reported the value yet.
    """

    __slots__ = ("_place", "_table")

    def __init__(self, beliefs: BeliefTable, place: int) -> None:
        self._table = beliefs.table
        self._place = place

    def _get(self, name: str) -> int:
        return int(self._table[name][self._place])

    def set(self, name: str, value: int) -> None:
        """Set a field of the row."""
        self._table[name][self._place] = value

    def count(self, name: str) -> int:
        """Increment the counter `frames`, `bad` or `foreign` and return its new value."""
        self._table[name][self._place] += 1
        return self._get(name)

    @property
    def heard_ns(self) -> Time:
        """When the last heartbeat was received."""
        return self._get("heard_ns")

    @property
    def armed(self) -> bool | None:
        """Whether the last heartbeat reported the aircraft as armed."""
        reported = self._get("armed")
        return None if reported < 0 else bool(reported)

    @property
    def mode(self) -> int | None:
        """The `custom_mode` of the last heartbeat: a mode's number in the autopilot's own list."""
        reported = self._get("mode")
        return None if reported < 0 else reported

    @property
    def consecutive_disarmed(self) -> int:
        """Number of consecutive heartbeats that reported the aircraft as disarmed; duplicates count once."""
        return self._get("consecutive_disarmed")

    @property
    def position_ns(self) -> Time:
        """When the last position was received."""
        return self._get("position_ns")

    @property
    def item_ns(self) -> Time:
        """When the last MISSION_CURRENT was received."""
        return self._get("item_ns")

    @property
    def farthest_item(self) -> int:
        """Largest mission item number reported since the mission was started."""
        return self._get("farthest_item")

    @property
    def frames(self) -> int:
        """Number of frames received on the aircraft's link."""
        return self._get("frames")

    @property
    def bad(self) -> int:
        """Number of those that are not valid MAVLink frames."""
        return self._get("bad")

    @property
    def foreign(self) -> int:
        """Number of those from a system or component other than the aircraft's autopilot."""
        return self._get("foreign")

    def on_heartbeat(self, now: Time, base_mode: int, mode: int, sequence: int) -> bool:
        """Update the belief from a HEARTBEAT; returns whether the mode changed."""
        self.set("heard_ns", now)
        armed = bool(base_mode & _ARMED)
        if armed:
            self.set("consecutive_disarmed", 0)
        elif sequence != self._get("heartbeat_seq"):
            self.set("consecutive_disarmed", self.consecutive_disarmed + 1)
        self.set("heartbeat_seq", sequence)
        changed = mode != self.mode
        if changed or armed != self.armed:
            self.set("mode", mode)
            self.set("armed", armed)
        return changed

    def on_current(self, now: Time, item: int) -> bool:
        """Update the belief from a MISSION_CURRENT; returns whether the item changed."""
        self.set("item_ns", now)
        changed = item != self._get("item")
        self.set("item", item)
        self.reached(item)
        return changed

    def reached(self, item: int) -> None:
        """Note that the aircraft has reached mission item `item`."""
        self.set("farthest_item", max(self.farthest_item, item))
