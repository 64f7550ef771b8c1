"""Payload columns: many byte strings in one buffer, with the start and size of each."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from skyrange.core.compiled import compiled

Bytes = NDArray[np.uint8]
Ints = NDArray[np.int64]


@compiled
def _gather(data: Bytes, starts: Ints, sizes: Ints, out: Bytes, places: Ints) -> None:
    """Copy each payload to its place in `out`."""
    for row in range(starts.shape[0]):
        start = starts[row]
        place = places[row]
        for offset in range(sizes[row]):
            out[place + offset] = data[start + offset]


class Payloads:
    """Payload `i` is `data[starts[i] : starts[i] + sizes[i]]`. Immutable, so that columns may share a buffer."""

    __slots__ = ("data", "kinds", "sizes", "starts")

    def __init__(self, data: Bytes, starts: Ints, sizes: Ints) -> None:
        self.data = data
        self.starts = starts
        self.sizes = sizes
        self.kinds: Ints | None = None
        """What `codec.mavlink.message_columns.classify_frames` has found, so that it is found once."""

    @classmethod
    def of(cls, payloads: Iterable[bytes]) -> Payloads:
        """A column of separate byte strings."""
        parts = list(payloads)
        sizes = np.fromiter(map(len, parts), np.int64, len(parts))
        # a bytearray gives an array that may be written to, as all others are: one version of each kernel serves both
        return cls(np.frombuffer(bytearray().join(parts), dtype=np.uint8), _starts(sizes), sizes)

    @classmethod
    def join(cls, columns: Iterable[Payloads]) -> Payloads:
        """One column of several, in their order, in a buffer that holds nothing else."""
        parts = [column.compact() for column in columns]
        if len(parts) == 1:
            return parts[0]
        sizes = np.concatenate([part.sizes for part in parts]) if parts else np.zeros(0, dtype=np.int64)
        data = np.concatenate([part.data for part in parts]) if parts else np.zeros(0, dtype=np.uint8)
        return cls(data, _starts(sizes), sizes)

    def take(self, rows: Ints) -> Payloads:
        """Some of the payloads, in the same buffer."""
        taken = Payloads(self.data, self.starts[rows], self.sizes[rows])
        if self.kinds is not None:
            taken.kinds = self.kinds[rows]
        return taken

    def compact(self) -> Payloads:
        """The same payloads in a buffer without gaps."""
        starts = _starts(self.sizes)
        total = int(starts[-1] + self.sizes[-1]) if len(self) else 0
        if total == len(self.data) and np.array_equal(starts, self.starts):
            return self
        out = np.empty(total, dtype=np.uint8)
        _gather(self.data, self.starts, self.sizes, out, starts)
        return Payloads(out, starts, self.sizes)

    def __len__(self) -> int:
        return len(self.starts)

    def __getitem__(self, row: int) -> bytes:
        start = int(self.starts[row])
        return self.data[start : start + int(self.sizes[row])].tobytes()

    def __iter__(self) -> Iterator[bytes]:
        whole = self.data.tobytes()
        for start, size in zip(self.starts.tolist(), self.sizes.tolist(), strict=True):
            yield whole[start : start + size]


def _starts(sizes: Ints) -> Ints:
    starts = np.zeros(len(sizes), dtype=np.int64)
    np.cumsum(sizes[:-1], out=starts[1:])
    return starts
