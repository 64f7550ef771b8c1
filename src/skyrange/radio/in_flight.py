"""Broadcasts in flight: a ring buffer from the medium's keys to the broadcasts behind them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.remote_id.link_payload import RidColumns
from skyrange.contracts.frames import Bytes, Ints, Payloads
from skyrange.core.compiled import compiled
from skyrange.core.time import NS_PER_S, Time

WIDTH = 256
"""Bytes of the longest body of any transport, rounded up."""
KEPT_NS: Time = 2 * NS_PER_S
"""How long a broadcast is kept: it waits half a second at most, and no event lasts longer than 50 ms."""


@compiled
def _copy_bodies(data: Bytes, starts: Ints, sizes: Ints, bodies: Bytes, places: Ints) -> None:
    for row in range(starts.shape[0]):
        for offset in range(sizes[row]):
            bodies[places[row], offset] = data[starts[row] + offset]


class InFlight:
    """Broadcasts by key; keys count up from 0."""

    __slots__ = ("_bodies", "_headers", "_sizes", "next")

    def __init__(self, room: int = 256) -> None:
        """`room` is a power of two; it grows as needed."""
        self.next = 0
        # at, transport, channel, counter, address (6), the frame that brought it (number, serial)
        self._headers = np.zeros((12, room), dtype=np.int64)
        self._sizes = np.zeros(room, dtype=np.int64)
        self._bodies = np.zeros((room, WIDTH), dtype=np.uint8)

    def add(self, now: Time, rows: RidColumns, chosen: Ints, at_ns: Ints, ref: Ints, serial: Ints) -> Ints:
        """Keep some rows, which the frames (`ref`, `serial`) of a `FrameRefTable` brought; returns their keys."""
        count = len(chosen)
        keys = np.arange(self.next, self.next + count)
        self._grow(now, count)
        places = self.rows_of(keys)
        self._headers[0, places] = at_ns
        for k, column in enumerate((rows.transport, rows.channel, rows.counter)):
            self._headers[1 + k, places] = column[chosen]
        self._headers[4:10, places] = rows.address[chosen].T
        self._headers[10, places], self._headers[11, places] = ref, serial
        bodies = rows.bodies
        self._sizes[places] = bodies.sizes[chosen]
        _copy_bodies(bodies.data, bodies.starts[chosen], bodies.sizes[chosen], self._bodies, places)
        self.next += count
        return keys

    def _grow(self, now: Time, count: int) -> None:
        """Double the ring until the new keys overwrite nothing younger than `KEPT_NS`."""
        while True:
            room = len(self._sizes)
            replaced = np.arange(max(self.next - room, 0), self.next + count - room)
            if not len(replaced) or (count <= room and bool((self._headers[0, replaced % room] < now - KEPT_NS).all())):
                return
            old = np.arange(max(self.next - room, 0), self.next)
            wider = InFlight(2 * room)
            there = old & (2 * room - 1)
            wider._headers[:, there] = self._headers[:, old % room]
            wider._sizes[there] = self._sizes[old % room]
            wider._bodies[there] = self._bodies[old % room]
            self._headers, self._sizes, self._bodies = wider._headers, wider._sizes, wider._bodies

    def rows_of(self, keys: Ints) -> Ints:
        """The row of each key."""
        return keys & (len(self._sizes) - 1)

    def transport(self, keys: Ints) -> Ints:
        """The transport of each key."""
        transport: Ints = self._headers[1, self.rows_of(keys)]
        return transport

    def counter(self, keys: Ints) -> Ints:
        """The message counter of each key."""
        counter: Ints = self._headers[3, self.rows_of(keys)]
        return counter

    def address(self, keys: Ints) -> NDArray[np.uint8]:
        """(n, 6) the claimed sender address of each key."""
        return self._headers[4:10, self.rows_of(keys)].T.astype(np.uint8)

    def frames(self, keys: Ints) -> tuple[Ints, Ints]:
        """The frames that brought the broadcasts: (numbers, serials) of the `FrameRefTable`."""
        places = self.rows_of(keys)
        return self._headers[10, places], self._headers[11, places]

    def bodies(self, keys: Ints) -> Payloads:
        """The bodies, as views of the ring."""
        places = self.rows_of(keys)
        return Payloads(self._bodies.reshape(-1), places * WIDTH, self._sizes[places])
