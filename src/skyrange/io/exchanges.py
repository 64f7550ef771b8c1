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

_UDP_SEGMENT: Final = 103
"""linux/udp.h, Linux 4.18: one call sends several datagrams of a size, the last may be shorter."""
_SEGMENT_LENGTH: Final = 18
"""Of the `cmsghdr` that says how long they are: two words of eight bytes, and two bytes (cmsg(3))."""
_BLANK: Final = ord(" ")

_sendmsg: Any = types.ExternalFunction("sendmsg", types.int64(types.int32, types.voidptr, types.int32))
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
        self._envelope: Ints = np.zeros(7, dtype=np.int64)
        """Linux' `msghdr`: peer and its length, parts and how many, control and its length, flags."""
        # one alone would be woken by its first line, take our core, and sleep until we have sent it the next;
        # of several each finds a core or waits for one, and what is saved here costs them as much (measured)
        together = self._compiled and count == 1 and _segments()
        self._parts: Ints = np.zeros((most if together else 0, 2), dtype=np.int64)
        """An `iovec` per line, address and length; none where lines go out one by one."""
        self._control = np.array([_SEGMENT_LENGTH, socket.IPPROTO_UDP | _UDP_SEGMENT << 32, 0])
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

        Its lines are its rows of `text` (k, n, bytes), so long as `lengths` (k, n) has; blanks may follow one in `text`
        and on the way. One after the other gets all of them: a process that has them does not fall asleep between two
        steps.
        """
        if self._compiled:
            _send(
                rows, counts, self._sockets, self._peers, text, lengths, self.taken, self._envelope, self._parts,
                self._control,
            )  # fmt: skip
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


def _segments() -> bool:
    """Whether the system sends several datagrams by one call, with the numbers above where they are expected."""
    if struct.calcsize("P") != 8 or sys.byteorder != "little":
        return False
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.setsockopt(socket.IPPROTO_UDP, _UDP_SEGMENT, 0)
        except OSError:
            return False
    return True


@kernel
def _send(
    rows: Ints,
    counts: Ints,
    sockets: NDArray[np.int32],
    peers: Bytes,
    text: Bytes,
    lengths: Ints,
    taken: Ints,
    envelope: Ints,
    parts: Ints,
    control: Ints,
) -> None:
    for row in rows:  # one that has died is told by its answer
        taken[row] = 0
        if 1 < counts[row] <= len(parts):
            _stuff(text[: counts[row], row], lengths[: counts[row], row], peers[row], envelope, parts, control)
            if _sendmsg(sockets[row], envelope.ctypes, 0) >= 0:
                continue
        for turn in range(counts[row]):
            _sendto(sockets[row], text[turn, row].ctypes, lengths[turn, row], 0, peers[row].ctypes, _ADDRESS)


@kernel
def _stuff(lines: Bytes, lengths: Ints, peer: Bytes, envelope: Ints, parts: Ints, control: Ints) -> None:
    """Fill the envelope with some lines for a peer; all but the last are made as long as the longest."""
    size = 0
    for length in lengths:
        size = max(size, length)
    last = len(lines) - 1
    for turn in range(len(lines)):
        if turn < last:
            lines[turn, lengths[turn] : size] = _BLANK
        parts[turn, 0] = lines[turn].ctypes.data
        parts[turn, 1] = size if turn < last else lengths[turn]
    control[2] = size
    envelope[0], envelope[1] = peer.ctypes.data, _ADDRESS
    envelope[2], envelope[3] = parts.ctypes.data, len(lines)
    envelope[4], envelope[5] = control.ctypes.data, 8 * len(control)


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
