"""Streams of observed messages: their numbers by keys, and counts of events of each."""

from __future__ import annotations

from functools import partial
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.frames import Ints
from skyrange.contracts.plugins.form import state
from skyrange.core.time import Time

_NEVER: Final = -(2**62)
Scalar = TypeVar("Scalar", bound=np.generic)


class StreamNumbers:
    """Numbers 0, 1, 2 … of streams in the order in which their keys first occur. Grows with the number of keys."""

    def __init__(self) -> None:
        self._sorted = np.zeros(0, dtype=np.int64)
        self._numbers = np.zeros(0, dtype=np.int64)

    def __len__(self) -> int:
        return len(self._sorted)

    def find(self, keys: Ints) -> Ints:
        """(n,) the number of each key, -1 for one that has none."""
        if not len(self._sorted):
            return np.full(len(keys), -1, dtype=np.int64)
        places = np.minimum(np.searchsorted(self._sorted, keys), len(self._sorted) - 1)
        return np.where(self._sorted[places] == keys, self._numbers[places], -1)

    def assign(self, keys: Ints) -> Ints:
        """(n,) the number of each key; new keys get the next numbers, in order of key within one call."""
        known_numbers = self.find(keys)
        if (known_numbers >= 0).all():
            return known_numbers
        fresh = np.unique(keys[known_numbers < 0])
        every = np.concatenate([self._sorted, fresh])
        numbers = np.concatenate([self._numbers, len(self._numbers) + np.arange(len(fresh))])
        order = np.argsort(every, kind="stable")
        self._sorted, self._numbers = every[order], numbers[order]
        return self.find(keys)


class EventCounts:
    """Events of each stream since it was last quiet: none for longer than `quiet_ns`."""

    def __init__(self, quiet_ns: Time) -> None:
        self._quiet_ns = quiet_ns
        self._last_ns = np.zeros(0, dtype=np.int64)
        self._counts = np.zeros(0, dtype=np.int64)

    def add(self, at_ns: Ints, streams: Ints) -> NDArray[np.float64]:
        """Take in one event for each of the (n,) rows, in order of time; returns the (n,) counts after each."""
        if not len(streams):
            return np.zeros(0)
        self._last_ns = extend(self._last_ns, int(streams.max()) + 1, _NEVER)
        self._counts = extend(self._counts, int(streams.max()) + 1, 0)
        order = np.argsort(streams, kind="stable")
        chosen, first, size = np.unique(streams[order], return_index=True, return_counts=True)
        is_new = at_ns[order][first] - self._last_ns[chosen] > self._quiet_ns
        base = np.where(is_new, 0, self._counts[chosen])
        counts = np.empty(len(streams))
        counts[order] = np.arange(1, len(streams) + 1) - np.repeat(first - base, size)
        self._counts[chosen] = base + size
        self._last_ns[chosen] = at_ns[order][first + size - 1]
        return counts


def extend(values: NDArray[Scalar], count: int, fill: float) -> NDArray[Scalar]:
    """An array of at least `count` rows: `values`, and `fill` for the new ones; grows by doubling."""
    missing = count - len(values)
    if missing <= 0:
        return values
    return np.concatenate([values, np.full((max(missing, len(values)), *values.shape[1:]), fill, dtype=values.dtype)])


def table(*columns: int, dtype: type[Any] = np.int64) -> Any:
    """State of a detector with one row for each stream or link end, of so many columns; `Detector.grow` adds rows."""
    return state(partial(np.zeros, (0, *columns), dtype=dtype))
