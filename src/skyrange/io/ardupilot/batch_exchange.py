"""Batched exchanges with many SITL processes: libc's socket calls made from compiled code.

The usual case, a servo packet of the peer with a new count, is handled here. Anything else (nothing for a while, a
stranger, another peer) is left to `LockstepSitl`, and on systems other than Linux everything is.
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

from skyrange.core.compiled import compiled
from skyrange.io.ardupilot.sitl import HEAD, SIZES, LockstepSitl

Bytes = NDArray[np.uint8]
Ints = NDArray[np.int64]

BYTES: Final = 256
"""Bytes of a datagram that are read, as by `LockstepSitl`; a servo packet has 40 or 72."""
_MAGICS: Final = np.array([int.from_bytes(magic, "little") for magic in SIZES])
_SIZES: Final = np.array([*SIZES.values()])
_ADDRESS: Final = 16
"""Size of Linux' `sockaddr_in` in bytes; the first eight hold family, port and address (ip(7))."""
_PLACE: Final = 8

_UDP_SEGMENT: Final = 103
"""linux/udp.h, Linux 4.18: one call sends several datagrams of one size, the last may be shorter."""
_SEGMENT_LENGTH: Final = 18
"""Length of the `cmsghdr` with that size: two words of eight bytes, and two bytes (cmsg(3))."""
_BLANK: Final = ord(" ")

_sendmsg: Any = types.ExternalFunction("sendmsg", types.int64(types.int32, types.voidptr, types.int32))
_sendto: Any = types.ExternalFunction(
    "sendto", types.int64(types.int32, types.voidptr, types.uint64, types.int32, types.voidptr, types.uint32)
)
_recvfrom: Any = types.ExternalFunction(
    "recvfrom", types.int64(types.int32, types.voidptr, types.uint64, types.int32, types.voidptr, types.voidptr)
)


class BatchExchange:
    """Exchanges with processes that have all answered once; a row is a process's place in `sitls`."""

    def __init__(self, sitls: Sequence[LockstepSitl], most: int = 1) -> None:
        """`most` is the number of lines that a process gets at once at most."""
        count = len(sitls)
        self.taken: Ints = np.zeros(count, dtype=np.int64)
        """(n,) number of answers since the last lines."""
        self._sitls = sitls
        self._compiled = sys.platform == "linux"
        self._sockets = np.array([sitl.fileno for sitl in sitls], dtype=np.int32)
        self._peers = np.zeros((count, _ADDRESS), dtype=np.uint8)
        self._counts: Ints = np.zeros(count, dtype=np.int64)
        self._heard = np.zeros((most, count, BYTES), dtype=np.uint8)
        self._sizes: Ints = np.zeros(count, dtype=np.int64)
        self._senders = np.zeros((count, _ADDRESS), dtype=np.uint8)
        self._envelope: Ints = np.zeros(7, dtype=np.int64)
        """Linux' `msghdr`: peer and its length, parts and their number, control and its length, flags."""
        # a single process would be woken by its first line, take this core, and sleep until the next line is sent;
        # of several each finds a core or waits for one, and what is saved here costs them as much (measured)
        together = self._compiled and count == 1 and _segments()
        self._parts: Ints = np.zeros((most if together else 0, 2), dtype=np.int64)
        """An `iovec` per line, address and length; empty if lines are sent one by one."""
        self._control = np.array([_SEGMENT_LENGTH, socket.IPPROTO_UDP | _UDP_SEGMENT << 32, 0])
        self._unusual = np.zeros(count, dtype=np.bool_)
        """(n,) whether a datagram was read that is left to `LockstepSitl`."""
        for row in range(count):
            self._update_peer(row)

    @property
    def answers(self) -> Bytes:
        """(k, n, bytes) the k-th answer of each process to the last lines: pulse widths in µs, little-endian."""
        return self._heard[:, :, HEAD:]

    def send(self, rows: Ints, counts: Ints, text: Bytes, lengths: Ints) -> None:
        """Send each of `rows` the lines for as many steps as `counts` (n,) has; all lines before were answered.

        The lines of a process are its rows of `text` (k, n, bytes), with `lengths` (k, n) in bytes; blanks may follow a
        line in `text` and in the datagram. Each process gets all its lines at once, so that it does not fall asleep
        between two steps.
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

        Returns the rows for which `take_late` has to be called, once for each missing answer.
        """
        if self._compiled and _take(
            rows, counts, self._sockets, self._peers, self._counts, self._heard, self._sizes, self._senders, self.taken,
            self._unusual,
        ):  # fmt: skip
            return []
        return [int(row) for row in rows if self.taken[row] < counts[row]]

    def take_late(self, row: int, deadline: float) -> bool:
        """Take the next answer of one process, as `LockstepSitl.servos`; False if there is none."""
        sitl, turn = self._sitls[row], self.taken[row]
        sitl.count = int(self._counts[row])
        first = None
        if self._unusual[row]:
            self._unusual[row] = False
            host, port = self._senders[row, 4:_PLACE].tobytes(), self._senders[row, 2:4].tobytes()
            first = (
                self._heard[turn, row, : self._sizes[row]].tobytes(),
                (socket.inet_ntoa(host), int.from_bytes(port, "big")),
            )
        answer = sitl.servos(deadline, first)
        self._update_peer(row)
        if answer is None:
            return False
        self._heard[turn, row, HEAD : HEAD + len(answer)] = np.frombuffer(answer, dtype=np.uint8)
        self.taken[row] += 1
        return True

    def _update_peer(self, row: int) -> None:
        """Copy the peer of a process, and the count of its last answer."""
        sitl = self._sitls[row]
        assert sitl.peer is not None
        host, port = sitl.peer
        place = struct.pack("=H", socket.AF_INET) + struct.pack("!H", port) + socket.inet_aton(host)
        self._peers[row, :_PLACE] = np.frombuffer(place, dtype=np.uint8)
        self._counts[row] = sitl.count


def _segments() -> bool:
    """Whether the system can send several datagrams by one call, with the layout assumed above."""
    if struct.calcsize("P") != 8 or sys.byteorder != "little":
        return False
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.setsockopt(socket.IPPROTO_UDP, _UDP_SEGMENT, 0)
        except OSError:
            return False
    return True


@compiled
def _send(  # noqa: PLR0917 - compiled
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
    for row in rows:  # a process that has died shows by its missing answer
        taken[row] = 0
        if 1 < counts[row] <= len(parts):
            _fill_envelope(text[: counts[row], row], lengths[: counts[row], row], peers[row], envelope, parts, control)
            if _sendmsg(sockets[row], envelope.ctypes, 0) >= 0:
                continue
        for turn in range(counts[row]):
            _sendto(sockets[row], text[turn, row].ctypes, lengths[turn, row], 0, peers[row].ctypes, _ADDRESS)


@compiled
def _fill_envelope(lines: Bytes, lengths: Ints, peer: Bytes, envelope: Ints, parts: Ints, control: Ints) -> None:
    """Fill the `msghdr` with some lines for a peer; all but the last are padded to the longest."""
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


@compiled
def _take(  # noqa: PLR0917 - compiled
    rows: Ints,
    wanted: Ints,
    sockets: NDArray[np.int32],
    peers: Bytes,
    counts: Ints,
    heard: Bytes,
    sizes: Ints,
    senders: Bytes,
    taken: Ints,
    unusual: NDArray[np.bool_],
) -> bool:
    """Take the answers that have come; whether all have."""
    whole = True
    room = np.empty(1, dtype=np.uint32)
    for row in rows:
        while taken[row] < wanted[row]:
            packet = heard[taken[row], row]
            room[0] = _ADDRESS
            size = _recvfrom(sockets[row], packet.ctypes, BYTES, 0, senders[row].ctypes, room.ctypes)
            if size < 0:  # nothing for a while, or a signal
                break
            sizes[row] = size
            if not _is_servos(packet, size) or not _is_same(senders[row], peers[row]):
                unusual[row] = True
                break
            count = np.int64(0)
            for place in range(4):
                count |= np.int64(packet[4 + place]) << np.int64(8 * place)
            if count != counts[row]:  # else it is a repetition
                counts[row] = count
                taken[row] += 1
        whole = whole and taken[row] >= wanted[row]
    return whole


@compiled
def _is_servos(heard: Bytes, size: int) -> bool:
    magic = np.int64(heard[0]) | np.int64(heard[1]) << 8
    for kind in range(len(_MAGICS)):
        if magic == _MAGICS[kind]:
            return bool(size == _SIZES[kind])
    return False


@compiled
def _is_same(sender: Bytes, peer: Bytes) -> bool:
    same = True
    for place in range(_PLACE):
        same = same and sender[place] == peer[place]
    return same
