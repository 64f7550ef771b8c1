"""Capture files read as a stream: the packets of pcapng and of pcap, with their times, link types and interfaces.

Sources: IETF draft-ietf-opsawg-pcapng (blocks, the options `if_name`, `if_tsresol` and `if_tsoffset`, name resolution)
and draft-ietf-opsawg-pcap (the older format). Both byte orders are read. A block that cannot be is skipped up to the
next packet block or section that can; a record of pcap has no mark by which to find the next one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BufferedIOBase
from typing import Final, Literal, NamedTuple

from skyrange.core.errors import DecodeError

_SECTION: Final = 0x0A0D0D0A
_INTERFACE, _SIMPLE, _NAMES, _PACKET = 1, 3, 4, 6
_ORDER: Final = 0x1A2B3C4D
_IF_NAME, _RESOLUTION, _OFFSET = 2, 9, 14
_IPV4_NAME: Final = 1
_BINARY: Final = 0x80
_MOST_BLOCK: Final = 16 << 20
_MOST_PACKET: Final = 1 << 20
_MOST_INTERFACES: Final = 4096
_MOST_NAMES: Final = 65_536
_CHUNK: Final = 1 << 20
Order = Literal["little", "big"]
_OLD: Final[dict[bytes, tuple[Order, int]]] = {
    b"\xa1\xb2\xc3\xd4": ("big", 1_000), b"\xd4\xc3\xb2\xa1": ("little", 1_000),
    b"\xa1\xb2\x3c\x4d": ("big", 1), b"\x4d\x3c\xb2\xa1": ("little", 1),
}  # fmt: skip
"""Magic bytes of pcap: byte order, and nanoseconds in a unit of the fraction."""
_NS: Final = 1_000_000_000
_SECTION_BYTES: Final = _SECTION.to_bytes(4, "big")


def is_capture(data: bytes) -> bool:
    """Whether a file that begins with `data` is pcapng or pcap."""
    return data[:4] == _SECTION_BYTES or data[:4] in _OLD


class Interface(NamedTuple):
    """An interface of a capture."""

    link_type: int
    name: str
    per_s: int = 1_000_000
    """Units of its times in a second."""
    offset_s: int = 0


class Packet(NamedTuple):
    """A packet as it was captured."""

    time_ns: int
    """Since 1970 UTC."""
    interface: Interface
    data: bytes
    is_cut: bool
    """Whether the capture has its first bytes only."""


@dataclass(slots=True)
class CaptureCounts:
    """What was in a capture, in one pass over it."""

    packets: int = 0
    cut_packets: int = 0
    bad_bytes: int = 0
    """Bytes of blocks and records that cannot be."""
    untimed_packets: int = 0
    """Packets without a time, or of an interface that is not described; they are left out."""
    cut_bytes: int = 0
    """Bytes at the end that are the begin of a block or a record."""
    names: dict[bytes, str] = field(default_factory=dict)
    """Names of IPv4 addresses, as the capture has them."""


class _Stream:
    """Bytes of a file, looked at before they are taken."""

    def __init__(self, file: BufferedIOBase) -> None:
        self._file, self._held, self._at = file, b"", 0

    def peek(self, count: int) -> bytes:
        """The next `count` bytes, or what is left."""
        if len(self._held) - self._at < count:
            more = self._file.read(max(count, _CHUNK))
            self._held, self._at = self._held[self._at :] + (more or b""), 0
        return self._held[self._at : self._at + count]

    def skip(self, count: int) -> None:
        """Go on behind bytes that were looked at."""
        self._at += count

    def take(self, count: int) -> bytes:
        """The next `count` bytes, or what is left; go on behind them."""
        data = self.peek(count)
        self._at += len(data)
        return data


def read_packets(file: BufferedIOBase, counts: CaptureCounts) -> Iterator[Packet]:
    """The packets of a capture from the present place of `file` on; what is met is added to `counts`.

    Holds a chunk of 1 MiB, or one block. Raises `DecodeError` for a file that does not begin as a capture.
    """
    stream = _Stream(file)
    magic = stream.peek(4)
    if magic in _OLD:
        yield from _read_old(stream, counts, *_OLD[magic])
    elif magic == _SECTION_BYTES:
        yield from _Blocks(stream, counts).read()
    else:
        raise DecodeError(f"first bytes {magic.hex()}, neither pcapng nor pcap")


def _read_old(stream: _Stream, counts: CaptureCounts, order: Order, unit_ns: int) -> Iterator[Packet]:
    head = stream.take(24)
    if len(head) < 24:
        counts.cut_bytes += len(head)
        return
    interface = Interface(_whole(head[20:24], order) & 0x0FFF_FFFF, "")
    while len(record := stream.peek(16)) == 16:
        seconds, fraction, size, length = (_whole(record[at : at + 4], order) for at in (0, 4, 8, 12))
        if size > _MOST_PACKET or fraction * unit_ns >= _NS:
            while left := stream.take(_CHUNK):
                counts.bad_bytes += len(left)
            return
        data = stream.peek(16 + size)[16:]
        if len(data) < size:
            break
        stream.skip(16 + size)
        yield _count(Packet(seconds * _NS + fraction * unit_ns, interface, data, size < length), counts)
    counts.cut_bytes += len(stream.peek(_MOST_PACKET + 16))


def _count(packet: Packet, counts: CaptureCounts) -> Packet:
    counts.packets += 1
    counts.cut_packets += packet.is_cut
    return packet


class _Blocks:
    """The blocks of a pcapng file."""

    def __init__(self, stream: _Stream, counts: CaptureCounts) -> None:
        self._stream, self._counts = stream, counts
        self._order: Order = "little"
        self._interfaces: list[Interface] = []

    def read(self) -> Iterator[Packet]:
        while len(head := self._stream.peek(12)) == 12:
            if head[:4] == _SECTION_BYTES:
                self._order = "big" if _whole(head[8:12], "big") == _ORDER else "little"
            kind, size = (_whole(head[at : at + 4], self._order) for at in (0, 4))
            if size < 12 or size % 4 or size > _MOST_BLOCK:
                self._skip_bad()
                continue
            block = self._stream.peek(size)
            if len(block) < size:
                break
            if _whole(block[-4:], self._order) != size:
                self._skip_bad()
                continue
            self._stream.skip(size)
            packet = self._take(kind, block[8:-4])
            if packet is not None:
                yield _count(packet, self._counts)
        while left := self._stream.take(_CHUNK):
            self._counts.cut_bytes += len(left)

    def _skip_bad(self) -> None:
        """Skip to the next packet block or section that can be."""
        mark = _PACKET.to_bytes(4, self._order)
        self._stream.skip(1)
        skipped = 1
        while data := self._stream.peek(_CHUNK):
            places = [place for place in (data.find(mark), data.find(_SECTION_BYTES)) if place >= 0]
            step = min(places, default=max(len(data) - 3, 1))
            self._stream.skip(step)
            skipped += step
            if places and self._is_block():
                break
            if not places and len(data) <= 3:
                skipped += len(self._stream.take(3))
                break
            if places:
                self._stream.skip(1)
                skipped += 1
        self._counts.bad_bytes += skipped

    def _is_block(self) -> bool:
        head = self._stream.peek(8)
        size = _whole(head[4:8], self._order)
        if len(head) < 8 or size < 12 or size % 4 or size > _MOST_BLOCK:
            return False
        block = self._stream.peek(size)
        return len(block) == size and _whole(block[-4:], self._order) == size

    def _take(self, kind: int, body: bytes) -> Packet | None:
        if kind == _SECTION:
            self._interfaces = []
        elif kind == _INTERFACE and len(body) >= 8 and len(self._interfaces) < _MOST_INTERFACES:
            self._interfaces.append(self._read_interface(body))
        elif kind == _NAMES:
            self._read_names(body)
        elif kind == _SIMPLE:
            self._counts.untimed_packets += 1
        elif kind == _PACKET:
            return self._read_packet(body)
        return None

    def _read_interface(self, body: bytes) -> Interface:
        name, per_s, offset_s = "", 1_000_000, 0
        for code, value in self._options(body[8:]):
            if code == _IF_NAME:
                name = value.decode("utf-8", "replace")[:64]
            elif code == _RESOLUTION and len(value) == 1:
                per_s = 2 ** (value[0] & 0x7F) if value[0] & _BINARY else 10 ** min(value[0], 18)
            elif code == _OFFSET and len(value) == 8:
                offset_s = int.from_bytes(value, self._order, signed=True)
        return Interface(_whole(body[:2], self._order), name, per_s, offset_s)

    def _options(self, data: bytes) -> Iterator[tuple[int, bytes]]:
        at = 0
        while at + 4 <= len(data):
            code, size = (_whole(data[place : place + 2], self._order) for place in (at, at + 2))
            if code == 0 or at + 4 + size > len(data):
                return
            yield code, data[at + 4 : at + 4 + size]
            at += 4 + size + -size % 4

    def _read_names(self, body: bytes) -> None:
        for code, value in self._options(body):  # records have the form of options
            if code == _IPV4_NAME and len(value) > 4 and len(self._counts.names) < _MOST_NAMES:
                name = value[4:].split(b"\0", 1)[0].decode("utf-8", "replace")[:64]
                if name:
                    self._counts.names[value[:4]] = name

    def _read_packet(self, body: bytes) -> Packet | None:
        number, high, low, size, length = (_whole(body[at : at + 4], self._order) for at in range(0, 20, 4))
        if len(body) < 20 or number >= len(self._interfaces) or size > len(body) - 20:
            self._counts.untimed_packets += 1
            return None
        interface = self._interfaces[number]
        time_ns = (high << 32 | low) * _NS // interface.per_s + interface.offset_s * _NS
        return Packet(time_ns, interface, body[20 : 20 + size], size < length)


def _whole(data: bytes, order: Order) -> int:
    return int.from_bytes(data, order)
