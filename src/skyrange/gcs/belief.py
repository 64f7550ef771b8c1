"""What does a ground station believe about its aircraft? The last thing each message told it, a row per aircraft."""

from __future__ import annotations

from enum import IntFlag
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mavlink import dialect as mav
from skyrange.core.ids import FrameId
from skyrange.core.time import NEVER, Time

_ARMED: Final = mav.MAV_MODE_FLAG_SAFETY_ARMED
_BELIEF: Final = np.dtype(
    [
        ("watch", "i8"),  # a Watch: what its pilot wants to see itself
        ("heard_ns", "i8"),  # when its last heartbeat was read
        ("armed", "i8"),  # 0, 1, or -1 never told
        ("mode", "i8"),  # -1 never told
        ("beat_seq", "i8"),
        ("disarmed_beats", "i8"),
        ("position_ns", "i8"),
        ("item_ns", "i8"),
        ("item", "i8"),  # -1 never told
        ("farthest_item", "i8"),
        ("frames", "i8"),
        ("bad", "i8"),
        ("foreign", "i8"),
        ("read_ns", "i8"),  # when its pilot last read a frame itself
    ]
)


class Watch(IntFlag):
    """Which messages may mean something to a pilot even when they say nothing new."""

    NONE = 0
    HEARTBEAT = 1
    POSITION = 2
    COMPLETE = 4
    """MISSION_CURRENT that says the mission is complete."""


class Beliefs:
    """What a station believes about all its aircraft, by place; `gcs.reading` fills it from columns of frames."""

    def __init__(self, count: int) -> None:
        self.table: NDArray[Any] = np.zeros(count, dtype=_BELIEF)
        for name in ("armed", "mode", "item", "beat_seq"):
            self.table[name] = -1
        for name in ("heard_ns", "position_ns", "item_ns", "read_ns"):
            self.table[name] = -NEVER

    def old(self, now: Time, silent_ns: Time, stale_ns: Time) -> NDArray[np.int64]:
        """Places of aircraft whose last heartbeat is older than `silent_ns`, or position or item than `stale_ns`."""
        table = self.table
        told = np.minimum(table["position_ns"], table["item_ns"])
        return np.flatnonzero((table["heard_ns"] < now - silent_ns) | (told < now - stale_ns))

    def of(self, place: int) -> Belief:
        """One aircraft's row."""
        return Belief(self, place)


class Belief:
    """One aircraft as told by its telemetry: a view of its row in `Beliefs`; `-NEVER` and `None` mean "never told"."""

    __slots__ = ("_place", "_table", "mode_ref")

    def __init__(self, beliefs: Beliefs, place: int) -> None:
        self._table = beliefs.table
        self._place = place
        self.mode_ref: FrameId | None = None
        """The heartbeat that last changed `mode` or `armed`."""

    def _get(self, name: str) -> int:
        return int(self._table[name][self._place])

    def set(self, name: str, value: int) -> None:
        """Put a number into the row."""
        self._table[name][self._place] = value

    def count(self, name: str) -> int:
        """Count `frames`, `bad` or `foreign` up by one; the new number."""
        self._table[name][self._place] += 1
        return self._get(name)

    @property
    def heard_ns(self) -> Time:
        """When its last heartbeat was read."""
        return self._get("heard_ns")

    @property
    def armed(self) -> bool | None:
        """What its last heartbeat said."""
        told = self._get("armed")
        return None if told < 0 else bool(told)

    @property
    def mode(self) -> int | None:
        """ArduCopter's mode number."""
        told = self._get("mode")
        return None if told < 0 else told

    @property
    def disarmed_beats(self) -> int:
        """Heartbeats in a row that said it is disarmed; copies of one count once."""
        return self._get("disarmed_beats")

    @property
    def position_ns(self) -> Time:
        """When its last position was read."""
        return self._get("position_ns")

    @property
    def item_ns(self) -> Time:
        """When its last mission item was read."""
        return self._get("item_ns")

    @property
    def farthest_item(self) -> int:
        """Largest mission item that it named since the mission was started."""
        return self._get("farthest_item")

    @property
    def frames(self) -> int:
        """Frames that came on its link."""
        return self._get("frames")

    @property
    def bad(self) -> int:
        """Of them, those that are no valid MAVLink frame."""
        return self._get("bad")

    @property
    def foreign(self) -> int:
        """Of them, those of another system or component than the aircraft's autopilot."""
        return self._get("foreign")

    def on_heartbeat(self, now: Time, base_mode: int, mode: int, sequence: int, ref: FrameId) -> bool:
        """Take in a HEARTBEAT; whether the mode is another than before."""
        self.set("heard_ns", now)
        armed = bool(base_mode & _ARMED)
        if armed:
            self.set("disarmed_beats", 0)
        elif sequence != self._get("beat_seq"):
            self.set("disarmed_beats", self.disarmed_beats + 1)
        self.set("beat_seq", sequence)
        changed = mode != self.mode
        if changed or armed != self.armed:
            self.set("mode", mode)
            self.set("armed", armed)
            self.mode_ref = ref
        return changed

    def on_current(self, now: Time, item: int) -> bool:
        """Take in a MISSION_CURRENT; whether the item is another than before."""
        self.set("item_ns", now)
        changed = item != self._get("item")
        self.set("item", item)
        self.reached(item)
        return changed

    def reached(self, item: int) -> None:
        """It has come as far as `item`."""
        self.set("farthest_item", max(self.farthest_item, item))
