"""UDP datagrams over IPv4 for capture files; skyrange sends none of them itself.

Sources: RFC 791 (IPv4 header, and its checksum), RFC 768 (UDP).
"""

from __future__ import annotations

import struct
from typing import Final, NamedTuple

_IP: Final = struct.Struct(">BBHHHBBHII")
_UDP: Final = struct.Struct(">HHHH")
_WHOLE: Final = 0x4000
"""Flags: do not fragment, which permits an identification of 0 (RFC 6864)."""
_TTL: Final = 64
_PROTOCOL: Final = 17
MAX_PAYLOAD: Final = 0xFFFF - _IP.size - _UDP.size


class SocketAddress(NamedTuple):
    """One end of a datagram: an IPv4 address as a number, and a UDP port."""

    address: int
    port: int


def encode_datagram(source: SocketAddress, target: SocketAddress, payload: bytes) -> bytes:
    """The datagram from its IPv4 header on. The UDP checksum is omitted (0). Raises `ValueError` above `MAX_PAYLOAD`
    bytes.
    """
    if len(payload) > MAX_PAYLOAD:
        raise ValueError(f"{len(payload)} bytes, a datagram holds at most {MAX_PAYLOAD}")
    size = _UDP.size + len(payload)
    fields = [0x45, 0, _IP.size + size, 0, _WHOLE, _TTL, _PROTOCOL, 0, source.address, target.address]
    fields[7] = _checksum(_IP.pack(*fields))
    return _IP.pack(*fields) + _UDP.pack(source.port, target.port, size, 0) + payload


def _checksum(header: bytes) -> int:
    """One's complement of the one's complement sum of the header's 16-bit words."""
    total: int = sum(struct.unpack(f">{len(header) // 2}H", header))
    while total >> 16:
        total = (total & 0xFFFF) + (total >> 16)
    return ~total & 0xFFFF
