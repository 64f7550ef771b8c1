"""Which payloads are new? Numbers byte strings in columns, each distinct one once per window, and hashes them.

An open-addressing table of the window's payloads, in one kernel; equal means equal bytes, never only equal hashes.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from skyrange.agent.payloads import Bytes, Ints, Payloads
from skyrange.core.compiled import kernel
from skyrange.record.digests import Words, hash_bytes
from skyrange.record.schema import PAYLOAD_WINDOW

_SLOTS: Final = 4 * PAYLOAD_WINDOW
_MASK: Final = _SLOTS - 1
_WINDOW: Final = PAYLOAD_WINDOW
PAYLOAD_SPOOL = pa.schema([("payload_id", pa.int64()), ("payload", pa.binary())])


@kernel
def _number(
    data: Bytes, starts: Ints, sizes: Ints, begin: int, window_bytes: int,
    slots: NDArray[np.int32], hashes: Words, store: Bytes, ends: Ints, state: Ints, ids: Ints, words: Words,
) -> int:  # fmt: skip
    """Number payloads from `begin` on: returns where the window was full, or how many there are.

    `ends` has where each kept payload ends in `store`, `state` is (payloads kept, bytes kept).
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


class PayloadNumbers:
    """Numbers the payloads of the current window; those not yet handed over are fresh.

    A window ends after `PAYLOAD_WINDOW` payloads or `window_bytes`, counted on payloads alone, so that ids do
    not depend on when the recorder flushes. Deep-copyable.
    """

    def __init__(self, window_bytes: int) -> None:
        """`window_bytes` of distinct payloads are de-duplicated together and held in memory."""
        self.window_bytes = window_bytes
        self.start = 0
        """The number of the window's first payload."""
        self._slots = np.full(_SLOTS, -1, dtype=np.int32)
        self._hashes = np.empty((PAYLOAD_WINDOW, 2), dtype=np.uint64)
        self._ends = np.zeros(PAYLOAD_WINDOW, dtype=np.int64)
        self._store = np.empty(1 << 16, dtype=np.uint8)
        self._state = np.zeros(2, dtype=np.int64)
        self._handed = 0
        self._left: list[tuple[int, Bytes, Ints]] = []  # of windows that ended: first id, bytes, ends

    def number(self, payloads: Payloads) -> tuple[Ints, Words]:
        """Ids (n,) and hashes (n, 2); those not seen in this window get the next ids."""
        rows = len(payloads)
        ids = np.empty(rows, dtype=np.int64)
        words = np.empty((rows, 2), dtype=np.uint64)
        begin = 0
        while True:
            self._make_room(int(payloads.sizes[begin:].sum()))
            done = _number(
                payloads.data, payloads.starts, payloads.sizes, begin, self.window_bytes,
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
        self._keep_fresh()
        self._slots.fill(-1)
        self._state[:] = 0
        self._handed = 0
        self.start += PAYLOAD_WINDOW

    def _keep_fresh(self) -> None:
        count = int(self._state[0])
        if count > self._handed:
            first = int(self._ends[self._handed - 1]) if self._handed else 0
            ends = self._ends[self._handed : count] - first
            self._left.append((self.start + self._handed, self._store[first : first + int(ends[-1])].copy(), ends))
            self._handed = count

    def fresh(self) -> pa.RecordBatch:
        """Rows of the payloads that were first seen since the last call."""
        self._keep_fresh()
        left, self._left = self._left, []
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
