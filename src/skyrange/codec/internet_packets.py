"""UDP and TCP payloads in captured packets, below the usual link layers.

Sources: tcpdump.org, link-layer header types; RFC 791 (IPv4), RFC 8200 (IPv6), RFC 768 (UDP), RFC 9293 (TCP). Checksums
are not verified: senders leave them to their network cards, so captures have wrong ones.
"""

from __future__ import annotations

from collections.abc import Callable
from ipaddress import ip_address
from typing import Final, NamedTuple

_NULL, _ETHERNET, _RAW, _LINUX, _LOOP, _IPV4, _IPV6, _LINUX_2 = 0, 1, 101, 113, 108, 228, 229, 276
_VLANS: Final = frozenset({0x8100, 0x88A8, 0x9100})
_IP4_TYPE, _IP6_TYPE = 0x0800, 0x86DD
_TCP, _UDP = 6, 17
_SYN: Final = 0x02
_EXTENSIONS: Final = frozenset({0, 43, 60})
"""Hop-by-hop options, routing and destination options of IPv6, which all have their length in the second byte."""
_FRAGMENT: Final = 44


class Address(NamedTuple):
    """One end of a flow."""

    host: bytes
    """4 bytes of IPv4 or 16 of IPv6."""
    port: int

    def __str__(self) -> str:
        return f"{ip_address(self.host)}-{self.port}"


class Segment(NamedTuple):
    """A UDP datagram, or a segment of a TCP stream."""

    source: Address
    target: Address
    payload: bytes
    is_tcp: bool = False
    sequence: int = 0
    """Of a TCP segment's first byte."""
    begins: bool = False
    """Whether a TCP segment opens a connection (SYN)."""


def find_segment(link_type: int, data: bytes) -> Segment | None:
    """The UDP datagram or TCP segment in a packet; None if it has none that is whole enough, or is a fragment."""
    skip = _LINKS.get(link_type)
    start = skip(data) if skip is not None else -1
    if start < 0 or start >= len(data):
        return None
    version = data[start] >> 4
    return _in_ipv4(data[start:]) if version == 4 else _in_ipv6(data[start:]) if version == 6 else None


def _ethernet(data: bytes) -> int:
    at = 12
    while int.from_bytes(data[at : at + 2], "big") in _VLANS:
        at += 4
    return at + 2 if int.from_bytes(data[at : at + 2], "big") in (_IP4_TYPE, _IP6_TYPE) else -1


def _bytes(count: int) -> Callable[[bytes], int]:
    def skip(_data: bytes) -> int:
        return count

    return skip


_LINKS: Final[dict[int, Callable[[bytes], int]]] = {
    _ETHERNET: _ethernet, _NULL: _bytes(4), _LOOP: _bytes(4), _RAW: _bytes(0), 12: _bytes(0), 14: _bytes(0),
    _IPV4: _bytes(0), _IPV6: _bytes(0), _LINUX: _bytes(16), _LINUX_2: _bytes(20),
}  # fmt: skip
"""Where the IP header begins, by link type; LINKTYPE_RAW is 101, and 12 or 14 in files of some systems."""


def has_internet(link_type: int) -> bool:
    """Whether packets of a link type can have IP."""
    return link_type in _LINKS


def _in_ipv4(data: bytes) -> Segment | None:
    if len(data) < 20:
        return None
    head, total = (data[0] & 15) * 4, int.from_bytes(data[2:4], "big")
    if head < 20 or int.from_bytes(data[6:8], "big") & 0x3FFF:  # more fragments, or an offset
        return None
    end = min(total, len(data)) if total else len(data)  # 0 where the network card cuts it up
    return _in_transport(data[9], data[12:16], data[16:20], data[head:end])


def _in_ipv6(data: bytes) -> Segment | None:
    if len(data) < 40:
        return None
    kind, at = data[6], 40
    while kind in _EXTENSIONS and at + 2 <= len(data):
        kind, at = data[at], at + 8 + data[at + 1] * 8
    if kind == _FRAGMENT:
        return None
    end = min(40 + int.from_bytes(data[4:6], "big"), len(data))
    return _in_transport(kind, data[8:24], data[24:40], data[at:end])


def _in_transport(kind: int, source: bytes, target: bytes, data: bytes) -> Segment | None:
    if len(data) < (8 if kind == _UDP else 20):
        return None
    ends = Address(source, int.from_bytes(data[:2], "big")), Address(target, int.from_bytes(data[2:4], "big"))
    if kind == _UDP:
        size = int.from_bytes(data[4:6], "big")
        return Segment(*ends, data[8 : size if size >= 8 else len(data)])
    if kind == _TCP:
        head = (data[12] >> 4) * 4
        if head < 20:
            return None
        sequence, begins = int.from_bytes(data[4:8], "big"), bool(data[13] & _SYN)
        return Segment(*ends, data[head:], is_tcp=True, sequence=sequence, begins=begins)
    return None
