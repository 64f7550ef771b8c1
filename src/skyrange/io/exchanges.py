"""How do the exchanges with many processes cost one call, instead of two for each? libc, called from compiled code.

What is as usual, a servo packet of the peer's under a new count, is taken here. Anything else (nothing for a while, a
stranger, another peer) is left to `LockstepSitl`, one place that knows what to make of it. Where the system is not
Linux everything is.
"""

from __future__ import annotations

import socket
import struct
import sys
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numba import types
from numpy.typing import NDArray

from skyrange.core.compiled import kernel
from skyrange.io.sitl import HEAD, SIZES, LockstepSitl

Bytes = NDArray[np.uint8]
Ints = NDArray[np.int64]

BYTES: Final = 256
"""Of a datagram that is read, as `LockstepSitl` does; a servo packet has 40 or 72."""
_MAGICS: Final = np.array([int.from_bytes(magic, "little") for magic in SIZES])
_SIZES: Final = np.array([*SIZES.values()])
_ADDRESS: Final = 16
"""Bytes of Linux' `sockaddr_in`, of which the first eight say something: family, port and address (ip(7))."""
_PLACE: Final = 8

_sendto: Any = types.ExternalFunction(
    "sendto", types.int64(types.int32, types.voidptr, types.uint64, types.int32, types.voidptr, types.uint32)
)
_recvfrom: Any = types.ExternalFunction(
    "recvfrom", types.int64(types.int32, types.voidptr, types.uint64, types.int32, types.voidptr, types.voidptr)
)


class Exchanges:
    """With processes that have all spoken once; a row is one's place among `sitls`."""

    def __init__(self, sitls: Sequence[LockstepSitl], most: int = 1) -> None:
        """At most so many lines for each at once."""
        count = len(sitls)
        self.taken: Ints = np.zeros(count, dtype=np.int64)
        """(n,) answers since the last lines."""
        self._sitls = sitls
        self._compiled = sys.platform == "linux"
        self._sockets = np.array([sitl.fileno for sitl in sitls], dtype=np.int32)
        self._peers = np.zeros((count, _ADDRESS), dtype=np.uint8)
        self._counts: Ints = np.zeros(count, dtype=np.int64)
        self._heard = np.zeros((most, count, BYTES), dtype=np.uint8)
        self._sizes: Ints = np.zeros(count, dtype=np.int64)
        self._senders = np.zeros((count, _ADDRESS), dtype=np.uint8)
        self._odd = np.zeros(count, dtype=np.bool_)
        """Whether something was read of each that `LockstepSitl` has to judge."""
        for row in range(count):
            self._learn(row)

    @property
    def answers(self) -> Bytes:
        """(k, n, bytes) the first of each to the last lines, the second, …: pulse widths in µs, little-endian."""
        return self._heard[:, :, HEAD:]

    def send(self, rows: Ints, counts: Ints, text: Bytes, lengths: Ints) -> None:
        """Let each of `rows` compute as many steps as `counts` (n,) has; it has answered all before.

        Its lines are its rows of `text` (k, n, bytes), so long as `lengths` (k, n) has. One after the other gets all of
        them: a process that has them does not fall asleep between two steps.
        """
        if self._compiled:
            _send(rows, counts, self._sockets, self._peers, text, lengths, self.taken)
            return
        self.taken[rows] = 0
        for row in rows.tolist():
            for turn in range(counts[row]):
                self._sitls[row].send(text[turn, row, : lengths[turn, row]].tobytes())

    def take(self, rows: Ints, counts: Ints) -> list[int]:
        """Wait for the answers of each of `rows`, as many as `counts` (n,) has, and take them.

        Returns those where `take_late` has to do so, as often as answers are missing.
        """
        if self._compiled and _take(
            rows, counts, self._sockets, self._peers, self._counts, self._heard, self._sizes, self._senders, self.taken,
            self._odd,
        ):  # fmt: skip
            return []
        return [int(row) for row in rows if self.taken[row] < counts[row]]

    def take_late(self, row: int, deadline: float) -> bool:
        """Take the next answer of one, as `LockstepSitl.servos`; False where there is none."""
        sitl, turn = self._sitls[row], self.taken[row]
        sitl.count = int(self._counts[row])
        first = None
        if self._odd[row]:
            self._odd[row] = False
            host, port = self._senders[row, 4:_PLACE].tobytes(), self._senders[row, 2:4].tobytes()
            first = (
                self._heard[turn, row, : self._sizes[row]].tobytes(),
                (socket.inet_ntoa(host), int.from_bytes(port, "big")),
            )
        answer = sitl.servos(deadline, first)
        self._learn(row)
        if answer is None:
            return False
        self._heard[turn, row, HEAD : HEAD + len(answer)] = np.frombuffer(answer, dtype=np.uint8)
        self.taken[row] += 1
        return True

    def _learn(self, row: int) -> None:
        """Take over whom a process is and what it said last."""
        sitl = self._sitls[row]
        assert sitl.peer is not None
        host, port = sitl.peer
        place = struct.pack("=H", socket.AF_INET) + struct.pack("!H", port) + socket.inet_aton(host)
        self._peers[row, :_PLACE] = np.frombuffer(place, dtype=np.uint8)
        self._counts[row] = sitl.count


@kernel
def _send(
    rows: Ints, counts: Ints, sockets: NDArray[np.int32], peers: Bytes, text: Bytes, lengths: Ints, taken: Ints
) -> None:
    for row in rows:  # one that has died is told by its answer
        taken[row] = 0
        for turn in range(counts[row]):
            _sendto(sockets[row], text[turn, row].ctypes, lengths[turn, row], 0, peers[row].ctypes, _ADDRESS)


@kernel
def _take(
    rows: Ints,
    wanted: Ints,
    sockets: NDArray[np.int32],
    peers: Bytes,
    counts: Ints,
    heard: Bytes,
    sizes: Ints,
    senders: Bytes,
    taken: Ints,
    odd: NDArray[np.bool_],
) -> bool:
    """Whether all is taken."""
    whole = True
    room = np.empty(1, dtype=np.uint32)
    for row in rows:
        while taken[row] < wanted[row]:
            said = heard[taken[row], row]
            room[0] = _ADDRESS
            size = _recvfrom(sockets[row], said.ctypes, BYTES, 0, senders[row].ctypes, room.ctypes)
            if size < 0:  # nothing for a while, or a signal
                break
            sizes[row] = size
            if not _is_servos(said, size) or not _is_same(senders[row], peers[row]):
                odd[row] = True
                break
            count = np.int64(0)
            for place in range(4):
                count |= np.int64(said[4 + place]) << np.int64(8 * place)
            if count != counts[row]:  # else it was said again
                counts[row] = count
                taken[row] += 1
        whole = whole and taken[row] >= wanted[row]
    return whole


@kernel
def _is_servos(heard: Bytes, size: int) -> bool:
    magic = np.int64(heard[0]) | np.int64(heard[1]) << 8
    for kind in range(len(_MAGICS)):
        if magic == _MAGICS[kind]:
            return bool(size == _SIZES[kind])
    return False


@kernel
def _is_same(sender: Bytes, peer: Bytes) -> bool:
    same = True
    for place in range(_PLACE):
        same = same and sender[place] == peer[place]
    return same
