"""Schedule of reports: which are due, and how they are sent, in one pass per service over the whole fleet.

Each aircraft's reports start at a phase of its own within the interval, as if the aircraft had been switched on at
different times. An aircraft's frames of one moment keep the order of `table.BUILDERS`, as do its sequence numbers.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from skyrange.codec.mavlink import dialect
from skyrange.codec.mavlink.message_columns import MessageTable, assign_sequence_numbers, pack_batches
from skyrange.contracts.frames import Ints
from skyrange.core.compiled import compiled
from skyrange.core.time import NEVER, NS_PER_MS, Time
from skyrange.vehicle.builtin.fleet import COMPONENT_ID, Fleet
from skyrange.vehicle.builtin.telemetry.table import AVAILABLE, BUILDERS, NEVER_SENT, build_table

SERVICE_NS: Final = 10 * NS_PER_MS
COLUMN: Final = {message: column for column, message in enumerate((*BUILDERS, *sorted(NEVER_SENT)))}
"""Column of every message that has an interval; those that can be sent come first."""
_SENT: Final = len(BUILDERS)
_HEARTBEAT: Final = COLUMN[dialect.MAVLINK_MSG_ID_HEARTBEAT]
_IN_ORDER: Final = tuple(BUILDERS)
_NEVER: Final = int(NEVER)


class Batch(NamedTuple):
    """Messages of one type that are due: the aircraft, the contents, and the sequence numbers."""

    message_id: int
    rows: Ints
    values: MessageTable
    sequences: Ints


@compiled
def _take_due(due: Ints, interval: Ints, soonest: Ints, picked: Ints, now: int, rows: Ints, ends: Ints) -> int:
    """Write the aircraft that are due, message by message, to `rows`; `ends` are the ends of each message's part.

    Intervals that a message has missed are skipped (GCS_MAVLINK::update_send).
    """
    count = 0
    for column in range(due.shape[1]):
        for place in range(picked.shape[0]):
            row = picked[place]
            if due[row, column] <= now:
                rows[count] = row
                count += 1
                due[row, column] = max(due[row, column] + interval[row, column], now + 1)
        ends[column] = count
    for place in range(picked.shape[0]):
        row = picked[place]
        least = due[row, 0]
        for column in range(1, due.shape[1]):
            least = min(least, due[row, column])
        soonest[row] = least
    return count


class Schedule:
    """When which message of which aircraft is due: (aircraft, message) arrays of nanoseconds.

    `period` is what was asked for; `interval` is longer while an aircraft's streams are slowed.
    """

    __slots__ = ("_factor", "_next", "due", "interval", "offset", "period", "soonest")

    def __init__(self, offsets_ns: Ints) -> None:
        """`offsets_ns` (aircraft,): the phase of each aircraft in its intervals, below one second."""
        count = offsets_ns.shape[0]
        self.offset = offsets_ns
        self.period = np.zeros((count, len(COLUMN)), dtype=np.int64)
        self.interval = np.zeros((count, _SENT), dtype=np.int64)
        self.due = np.full((count, _SENT), NEVER, dtype=np.int64)
        self._factor = np.ones(count, dtype=np.int64)
        self.soonest = np.full(count, NEVER, dtype=np.int64)
        self._next: Time = NEVER  # nothing is due before

    def set(self, row: int, message: int, period_ns: Time, now: Time) -> None:
        """Send `message` every `period_ns` from now on, at most once per service; 0 stops it."""
        column = COLUMN[message]
        self.period[row, column] = period_ns
        if column < _SENT:
            self.interval[row, column] = period_ns * (self._factor[row] if column != _HEARTBEAT else 1)
            offset = int(self.offset[row]) % period_ns if period_ns else 0
            self.due[row, column] = now + offset if period_ns else NEVER
            self.soonest[row] = self.due[row].min()
            self._next = min(self._next, int(self.soonest[row]))

    def clear(self, row: int) -> None:
        """Stop all messages, as at power-on."""
        self.period[row] = self.interval[row] = 0
        self._factor[row] = 1
        self.due[row] = NEVER
        self.soonest[row] = NEVER

    def slow(self, row: int, factor: int) -> None:
        """Make the intervals of one aircraft `factor` times as long as asked for, counted from what was sent last.

        HEARTBEAT keeps its own (`deferred_message` of GCS.h).
        """
        self._factor[row] = factor
        changed = self.period[row, :_SENT] * factor
        changed[_HEARTBEAT] = self.period[row, _HEARTBEAT]
        sent = self.due[row] < _NEVER
        self.due[row, sent] += (changed - self.interval[row])[sent]
        self.interval[row] = changed
        self.soonest[row] = self.due[row].min()
        self._next = int(self.soonest.min())

    def take(self, fleet: Fleet) -> list[Batch]:
        """Return the messages that are due, with contents and numbers; set their next times."""
        for row in sorted(fleet.stream_factors):
            self.slow(row, fleet.stream_factors[row])
        fleet.stream_factors.clear()
        if fleet.now < self._next:
            return []
        (picked,) = (self.soonest <= fleet.now).nonzero()
        rows = np.empty(len(picked) * _SENT, dtype=np.int64)
        ends = np.empty(_SENT, dtype=np.int64)
        _take_due(self.due, self.interval, self.soonest, picked, fleet.now, rows, ends)
        self._next = int(self.soonest.min())
        found: list[tuple[int, Ints]] = []
        start = 0
        for message, end in zip(_IN_ORDER, ends.tolist(), strict=True):
            if end > start:
                those = rows[start:end]
                if message in AVAILABLE:
                    those = those[AVAILABLE[message](fleet, those)]
                if len(those):
                    found.append((message, those))
            start = end
        batches = []
        for message, those in found:
            sequences = np.empty(len(those), dtype=np.int64)
            assign_sequence_numbers(those, fleet.sequences, sequences)
            batches.append(Batch(message, those, build_table(fleet, message, those), sequences))
        return batches

    def send_due(self, fleet: Fleet) -> None:
        """Send all messages that are due and set their next times."""
        batches = self.take(fleet)
        if not batches:
            return
        systems = fleet.system_ids
        payloads = pack_batches([(b.message_id, b.values, systems[b.rows], b.sequences) for b in batches], COMPONENT_ID)
        fleet.outbox.send_block(np.concatenate([batch.rows for batch in batches]), payloads)
