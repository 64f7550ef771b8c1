"""Telemetry receiver: decodes telemetry in columns, stores the latest messages, and updates the beliefs.

A message that repeats known values, and that its flight sequencer does not watch for, only refreshes the belief. One
compiled function does this for all frames of a step. Any other message is left to the flight sequencer, together
with all later messages of the same aircraft in that step, so that each sequencer reads in order of arrival.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.frame_layout import HEADER_V2, LAYOUTS
from skyrange.codec.mavlink.message_columns import KIND_COUNT, KIND_TABLES, kind_at, kind_of_message, payload_dtype
from skyrange.contracts.frames import Bytes, Ints, Payloads
from skyrange.core.compiled import compiled
from skyrange.core.time import Time
from skyrange.gcs.telemetry.belief import BeliefTable, Watch


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
_ARMED: Final = int(mav.MAV_MODE_FLAG_SAFETY_ARMED)
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


@compiled
def _read(
    now: int, data: Bytes, starts: Ints, sizes: Ints, places: Ints, begin: int, systems: Ints, component: int,
    kinds: NDArray[np.int32], extras: Ints, crcs: NDArray[np.uint16], role: Ints, slots: Ints,
    latest: NDArray[np.uint8], reported: NDArray[np.bool_], table: Any, left: NDArray[np.bool_],
) -> int:  # fmt: skip
    """Process frames from row `begin` on; returns the first row whose kind has no slot yet, or the number of rows."""
    for row in range(begin, starts.shape[0]):
        place = places[row]
        at = starts[row]
        left[row] = True
        if place >= systems.shape[0]:
            continue
        kind = kind_at(data, at, sizes[row], kinds, extras, crcs)
        belief = table[place]
        if kind < 0 or data[at + 5] != systems[place] or data[at + 6] != component:
            belief.read_ns = now
            continue
        slot = slots[kind]
        if slot < 0:
            return row
        body = latest[slot, place]
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
        self._systems = np.array(systems, dtype=np.int64)
        self._component = component
        # 0: stored only; 1: for the sequencer; 2: for the sequencer unless it only refreshes the belief
        self._role = np.zeros(KIND_COUNT, dtype=np.int64)
        for message_id in read:
            self._role[kind_of_message(message_id)] = 1
        self._role[[_HEARTBEAT, _POSITION, _CURRENT]] = 2
        self._slots = np.full(KIND_COUNT, -1, dtype=np.int64)
        self._latest = np.zeros((0, len(systems), _WIDEST), dtype=np.uint8)
        self._received = np.zeros((0, len(systems)), dtype=np.bool_)

    def read(self, now: Time, places: Ints, payloads: Payloads) -> Ints:
        """Process frames of the aircraft with indices `places`; returns the rows left for sequencers and others."""
        left = np.empty(len(payloads), dtype=np.bool_)
        done = 0
        while True:
            done = _read(
                now, *payloads.arrays, places, done, self._systems, self._component,
                *KIND_TABLES, self._role, self._slots, self._latest, self._received, self._beliefs.table, left,
            )  # fmt: skip
            if done == len(payloads):
                return left.nonzero()[0]
            self._add_slot(payloads, done)

    def _add_slot(self, payloads: Payloads, row: int) -> None:
        data, starts, sizes = payloads.arrays
        self._slots[kind_at(data, starts.item(row), sizes.item(row), *KIND_TABLES)] = len(self._latest)
        count = self._latest.shape[1]
        self._latest = np.concatenate([self._latest, np.zeros((1, count, _WIDEST), dtype=np.uint8)])
        self._received = np.concatenate([self._received, np.zeros((1, count), dtype=np.bool_)])

    def latest(self, place: int, message_id: int) -> Any:
        """The latest message of a kind as a record of its fields, or `None` if there was none."""
        slot = self._slots[kind_of_message(message_id)]
        if slot < 0 or not self._received[slot, place]:
            return None
        dtype = payload_dtype(message_id)
        return self._latest[slot, place, : dtype.itemsize].copy().view(dtype)[0]
