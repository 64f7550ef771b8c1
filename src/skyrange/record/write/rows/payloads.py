"""De-duplication of payloads: numbers and hashes byte strings in columns, each distinct one once per window.

The payloads of a window are kept in a hash table with open addressing. Payloads are equal only if their bytes are
equal, never by their hashes alone.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from skyrange.contracts.frames import Bytes, Ints, Payloads
from skyrange.core.compiled import compiled
from skyrange.record.digests import Words, hash_bytes
from skyrange.record.schema import PAYLOAD_WINDOW

_SLOTS: Final = 4 * PAYLOAD_WINDOW
_MASK: Final = _SLOTS - 1
_WINDOW: Final = PAYLOAD_WINDOW
PAYLOAD_SPOOL = pa.schema([("payload_id", pa.int64()), ("payload", pa.binary())])


@compiled
def _assign_ids(  # noqa: PLR0917 - compiled
    data: Bytes, starts: Ints, sizes: Ints, begin: int, window_bytes: int,
    slots: NDArray[np.int32], hashes: Words, store: Bytes, ends: Ints, state: Ints, ids: Ints, words: Words,
) -> int:  # fmt: skip
    """Number payloads from row `begin` on; returns the row at which the window was full, or the number of rows.

    `ends` are the end offsets of the stored payloads in `store`; `state` is (payloads stored, bytes stored).
    """
    count = state[0]
    used = state[1]
    for row in range(begin, starts.shape[0]):
        start = starts[row]
        size = sizes[row]
        a, b = hash_bytes(data, start, size)
        slot = np.int64(b & np.uint64(_MASK))
        found = -1
        while slots[slot] >= 0:
            held = slots[slot]
            if hashes[held, 0] == a and hashes[held, 1] == b:
                first = ends[held - 1] if held > 0 else 0
                same = ends[held] - first == size
                place = 0
                while same and place < size:
                    same = store[first + place] == data[start + place]
                    place += 1
                if same:
                    found = held
                    break
            slot = (slot + 1) & _MASK
        if found < 0:
            if count == _WINDOW or used >= window_bytes:
                state[0] = count
                state[1] = used
                return row
            for place in range(size):
                store[used + place] = data[start + place]
            used += size
            ends[count] = used
            hashes[count, 0] = a
            hashes[count, 1] = b
            slots[slot] = count
            found = count
            count += 1
        ids[row] = found
        words[row, 0] = a
        words[row, 1] = b
    state[0] = count
    state[1] = used
    return int(starts.shape[0])


class PayloadDeduplicator:
    """Numbers the payloads of the current window and collects new ones until they are fetched.

    A window ends after `PAYLOAD_WINDOW` payloads or `window_bytes`. Both count payloads alone, so ids do not depend
    on when the recorder flushes. Deep-copyable.
    """

    def __init__(self, window_bytes: int, first: int = 0) -> None:
        """`window_bytes` of distinct payloads are de-duplicated together and kept in memory; ids count from `first`, a
        multiple of `PAYLOAD_WINDOW`.
        """
        self.window_bytes = window_bytes
        self.start = first
        """The id of the window's first payload."""
        self._slots = np.full(_SLOTS, -1, dtype=np.int32)
        self._hashes = np.empty((PAYLOAD_WINDOW, 2), dtype=np.uint64)
        self._ends = np.zeros(PAYLOAD_WINDOW, dtype=np.int64)
        self._store = np.empty(1 << 16, dtype=np.uint8)
        self._state = np.zeros(2, dtype=np.int64)
        self._fetched = 0
        self._pending: list[tuple[int, Bytes, Ints]] = []  # not fetched yet: first id, bytes, end offsets

    def assign_ids(self, payloads: Payloads) -> tuple[Ints, Words]:
        """Ids (n,) and hashes (n, 2) of payloads; payloads that are new in this window get the next ids."""
        rows = len(payloads)
        ids = np.empty(rows, dtype=np.int64)
        words = np.empty((rows, 2), dtype=np.uint64)
        begin = 0
        while True:
            self._make_room(int(payloads.sizes[begin:].sum()))
            done = _assign_ids(
                *payloads.arrays, begin, self.window_bytes,
                self._slots, self._hashes, self._store, self._ends, self._state, ids, words,
            )  # fmt: skip
            ids[begin:done] += self.start
            if done == rows:
                return ids, words
            self._end_window()
            begin = done

    def _make_room(self, wanted: int) -> None:
        need = int(self._state[1]) + wanted
        if need > len(self._store):
            grown = np.empty(max(need, 2 * len(self._store)), dtype=np.uint8)
            grown[: self._state[1]] = self._store[: self._state[1]]
            self._store = grown

    def _end_window(self) -> None:
        self._collect_new()
        self._slots.fill(-1)
        self._state[:] = 0
        self._fetched = 0
        self.start += PAYLOAD_WINDOW

    def _collect_new(self) -> None:
        count = int(self._state[0])
        if count > self._fetched:
            first = int(self._ends[self._fetched - 1]) if self._fetched else 0
            ends = self._ends[self._fetched : count] - first
            self._pending.append((self.start + self._fetched, self._store[first : first + int(ends[-1])].copy(), ends))
            self._fetched = count

    def skip_new(self) -> None:
        """Leave out the payloads that are new since the last call, as if they had been fetched."""
        self._fetched = int(self._state[0])
        self._pending = []

    def take_new(self) -> pa.RecordBatch:
        """Rows of the payloads that are new since the last call."""
        self._collect_new()
        left, self._pending = self._pending, []
        ids = [np.arange(first, first + len(ends), dtype=np.int64) for first, _, ends in left]
        values = [_binary(data, ends) for _, data, ends in left]
        arrays = [
            pa.array(np.concatenate(ids) if ids else np.zeros(0, dtype=np.int64)),
            pa.concat_arrays(values) if values else pa.array([], pa.binary()),
        ]
        return pa.RecordBatch.from_arrays(arrays, schema=PAYLOAD_SPOOL)


def _binary(data: Bytes, ends: Ints) -> pa.Array:
    offsets = np.zeros(len(ends) + 1, dtype=np.int32)
    offsets[1:] = ends
    return pa.Array.from_buffers(pa.binary(), len(ends), [None, pa.py_buffer(offsets), pa.py_buffer(data)])
