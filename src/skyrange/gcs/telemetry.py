"""Telemetry at a ground station: its receiver, and the belief: the state of each aircraft as last reported.

A message that repeats known values, and that its flight sequencer does not watch for, only refreshes the belief. One
compiled function does this for all frames of a step. Any other message is left to the flight sequencer, together
with all later messages of the same aircraft in that step, so that each sequencer reads in order of arrival.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from enum import IntFlag
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.frames import HEADER_V2, LAYOUTS
from skyrange.codec.mavlink.message_columns import KIND_COUNT, KIND_TABLES, kind_at, kind_of_message, payload_dtype
from skyrange.contracts.frames import Bytes, Ints, Payloads
from skyrange.core.compiled import compiled
from skyrange.core.time import NEVER, Time

_ARMED: Final = int(mav.MAV_MODE_FLAG_SAFETY_ARMED)
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


def _offset(message_id: int, name: str) -> int:
    """Offset in bytes of a field in the payload of a message."""
    fields = payload_dtype(message_id).fields
    assert fields is not None
    return int(fields[name][1])


_HEADER: Final = int(HEADER_V2)
_WIDEST: Final = max(layout.size for layout in LAYOUTS.values())
_HEARTBEAT: Final = kind_of_message(mav.MAVLINK_MSG_ID_HEARTBEAT)
_BASE_MODE: Final = _offset(mav.MAVLINK_MSG_ID_HEARTBEAT, "base_mode")
_CUSTOM_MODE: Final = _offset(mav.MAVLINK_MSG_ID_HEARTBEAT, "custom_mode")
_POSITION: Final = kind_of_message(mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT)
_CURRENT: Final = kind_of_message(mav.MAVLINK_MSG_ID_MISSION_CURRENT)
_ITEM: Final = _offset(mav.MAVLINK_MSG_ID_MISSION_CURRENT, "seq")
_STATE: Final = _offset(mav.MAVLINK_MSG_ID_MISSION_CURRENT, "mission_state")
_COMPLETE: Final = int(mav.MISSION_STATE_COMPLETE)
_WATCH_HEARTBEAT: Final = int(Watch.HEARTBEAT)
_WATCH_POSITION: Final = int(Watch.POSITION)
_WATCH_COMPLETE: Final = int(Watch.COMPLETE)


@compiled
def _refresh_belief(now: int, belief: Any, kind: int, sequence: int, reported: Bytes) -> bool:
    """Refresh a belief from a payload; returns whether the flight sequencer has to read the message instead."""
    if kind == _HEARTBEAT:
        mode = np.int64(0)
        for byte in range(4):
            mode |= np.int64(reported[_CUSTOM_MODE + byte]) << (8 * byte)
        armed = 1 if reported[_BASE_MODE] & _ARMED else 0
        if mode != belief.mode or armed != belief.armed or belief.watch & _WATCH_HEARTBEAT:
            return True
        belief.heard_ns = now
        if armed == 1:
            belief.consecutive_disarmed = 0
        elif sequence != belief.heartbeat_seq:
            belief.consecutive_disarmed += 1
        belief.heartbeat_seq = sequence
    elif kind == _POSITION:
        if belief.watch & _WATCH_POSITION:
            return True
        belief.position_ns = now
    elif kind == _CURRENT:
        item = np.int64(reported[_ITEM]) | np.int64(reported[_ITEM + 1]) << 8
        if item != belief.item or (reported[_STATE] == _COMPLETE and belief.watch & _WATCH_COMPLETE):
            return True
        belief.item_ns = now
        belief.farthest_item = max(belief.farthest_item, item)
    return False


class _Frames(NamedTuple):
    """Received frames: frame `i` of the aircraft `places[i]` is `data[starts[i] : starts[i] + sizes[i]]`."""

    data: Bytes
    starts: Ints
    sizes: Ints
    places: Ints


class _Latest(NamedTuple):
    """What is read of which aircraft, and its latest messages."""

    systems: Ints
    """MAVLink system ids by aircraft."""
    component: int
    role: Ints
    """By kind of message: 0: stored only; 1: for the sequencer; 2: for it unless it only refreshes the belief."""
    slots: Ints
    """By kind of message: its place in `messages`; -1 before the first."""
    messages: NDArray[np.uint8]
    reported: NDArray[np.bool_]


@compiled
def _read(  # noqa: PLR0917
    now: int, frames: _Frames, begin: int, tables: Any, latest: _Latest, beliefs: Any, left: NDArray[np.bool_]
) -> int:
    """Process frames from row `begin` on; returns the first row whose kind has no slot yet, or the number of rows.

    `tables` are `KIND_TABLES`.
    """
    data, starts, sizes, places = frames
    systems, component, role, slots, messages, reported = latest
    for row in range(begin, starts.shape[0]):
        place = places[row]
        at = starts[row]
        left[row] = True
        if place >= systems.shape[0]:
            continue
        kind = kind_at(data, at, sizes[row], *tables)
        belief = beliefs[place]
        if kind < 0 or data[at + 5] != systems[place] or data[at + 6] != component:
            belief.read_ns = now
            continue
        slot = slots[kind]
        if slot < 0:
            return row
        body = messages[slot, place]
        length = min(np.int64(data[at + 1]), body.shape[0])
        for column in range(length):
            body[column] = data[at + _HEADER + column]
        for column in range(length, body.shape[0]):
            body[column] = 0
        reported[slot, place] = True
        for_sequencer = role[kind] == 1 or (role[kind] == 2 and belief.read_ns == now)
        if for_sequencer or (role[kind] == 2 and _refresh_belief(now, belief, kind, data[at + 4], body)):
            belief.read_ns = now
            continue
        left[row] = False
        belief.frames += 1
    return int(starts.shape[0])


class TelemetryReceiver:
    """Processes the telemetry that a station receives, in columns. Deep-copyable."""

    def __init__(self, beliefs: BeliefTable, systems: Sequence[int], component: int, read: Collection[int]) -> None:
        """`systems` are MAVLink system ids by aircraft index; `read` are the ids of messages that sequencers handle."""
        self._beliefs = beliefs
        role = np.zeros(KIND_COUNT, dtype=np.int64)
        for message_id in read:
            role[kind_of_message(message_id)] = 1
        role[[_HEARTBEAT, _POSITION, _CURRENT]] = 2
        self._latest = _Latest(
            np.array(systems, dtype=np.int64),
            component,
            role,
            np.full(KIND_COUNT, -1, dtype=np.int64),
            np.zeros((0, len(systems), _WIDEST), dtype=np.uint8),
            np.zeros((0, len(systems)), dtype=np.bool_),
        )

    def read(self, now: Time, places: Ints, payloads: Payloads) -> Ints:
        """Process frames of the aircraft with indices `places`; returns the rows left for sequencers and others."""
        left = np.empty(len(payloads), dtype=np.bool_)
        frames = _Frames(*payloads.arrays, places)
        done = 0
        while True:
            done = _read(now, frames, done, KIND_TABLES, self._latest, self._beliefs.table, left)
            if done == len(payloads):
                return left.nonzero()[0]
            self._add_slot(payloads, done)

    def _add_slot(self, payloads: Payloads, row: int) -> None:
        data, starts, sizes = payloads.arrays
        latest = self._latest
        count = len(latest.systems)
        latest.slots[kind_at(data, starts.item(row), sizes.item(row), *KIND_TABLES)] = len(latest.messages)
        self._latest = latest._replace(
            messages=np.concatenate([latest.messages, np.zeros((1, count, _WIDEST), dtype=np.uint8)]),
            reported=np.concatenate([latest.reported, np.zeros((1, count), dtype=np.bool_)]),
        )

    def latest(self, place: int, message_id: int) -> Any:
        """The latest message of a kind as a record of its fields, or `None` if there was none."""
        slot = self._latest.slots[kind_of_message(message_id)]
        if slot < 0 or not self._latest.reported[slot, place]:
            return None
        dtype = payload_dtype(message_id)
        return self._latest.messages[slot, place, : dtype.itemsize].copy().view(dtype)[0]
