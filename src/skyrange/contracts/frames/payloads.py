"""Payload columns: many byte strings in one buffer, with the start and size of each."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from skyrange.core.arrays import Bytes, Ints, as_read_only
from skyrange.core.compiled import compiled

__all__ = ["Bytes", "Ints", "Payloads"]


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

    __slots__ = ("_arrays", "kinds")

    def __init__(self, data: Bytes, starts: Ints, sizes: Ints) -> None:
        self._arrays = data, starts, sizes
        self.kinds: Ints | None = None
        """What `codec.mavlink.message_columns.classify_frames` has found, so that it is found once."""

    @property
    def data(self) -> Bytes:
        """The buffer, read-only."""
        return as_read_only(self._arrays[0])

    @property
    def starts(self) -> Ints:
        """(n,) where each payload begins in the buffer, read-only."""
        return as_read_only(self._arrays[1])

    @property
    def sizes(self) -> Ints:
        """(n,) the bytes of each payload, read-only."""
        return as_read_only(self._arrays[2])

    @property
    def arrays(self) -> tuple[Bytes, Ints, Ints]:
        """Buffer, starts and sizes for kernels, which are compiled for arrays that may be written to; none writes."""
        return self._arrays

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
        sizes = np.concatenate([part._arrays[2] for part in parts]) if parts else np.zeros(0, dtype=np.int64)
        data = np.concatenate([part._arrays[0] for part in parts]) if parts else np.zeros(0, dtype=np.uint8)
        return cls(data, _starts(sizes), sizes)

    def take(self, rows: Ints) -> Payloads:
        """Some of the payloads, in the same buffer."""
        data, starts, sizes = self._arrays
        taken = Payloads(data, starts[rows], sizes[rows])
        if self.kinds is not None:
            taken.kinds = self.kinds[rows]
        return taken

    def compact(self) -> Payloads:
        """The same payloads in a buffer without gaps."""
        data, begin, sizes = self._arrays
        starts = _starts(sizes)
        total = int(starts[-1] + sizes[-1]) if len(self) else 0
        if total == len(data) and np.array_equal(starts, begin):
            return self
        out = np.empty(total, dtype=np.uint8)
        _gather(data, begin, sizes, out, starts)
        return Payloads(out, starts, sizes)

    def __len__(self) -> int:
        return len(self._arrays[1])

    def __getitem__(self, row: int) -> bytes:
        data, starts, sizes = self._arrays
        start = int(starts[row])
        return data[start : start + int(sizes[row])].tobytes()

    def __iter__(self) -> Iterator[bytes]:
        data, starts, sizes = self._arrays
        whole = data.tobytes()
        for start, size in zip(starts.tolist(), sizes.tolist(), strict=True):
            yield whole[start : start + size]


def _starts(sizes: Ints) -> Ints:
    starts = np.zeros(len(sizes), dtype=np.int64)
    np.cumsum(sizes[:-1], out=starts[1:])
    return starts
