"""802.11 management frames, and the payload by which a program has its radio send one.

A request is sent on its node's `rid_up` link: 8 bytes, little-endian, then the frame with its check sequence.

| bytes | field | meaning |
|---|---|---|
| 0 | magic | 0x1F |
| 1 | channel | Wi-Fi channel 1…13 |
| 2–3 | power | radiated power (EIRP) in 0.01 dBm, signed |
| 4–7 | reserved | 0 |

A management frame is a header of 24 bytes (IEEE 802.11-2020, 9.3.3.1): frame control, duration, receiver, transmitter,
BSSID, sequence control; a Deauthentication's body (9.3.3.12) begins with its reason code.
"""

from __future__ import annotations

import struct
import zlib
from typing import Final, NamedTuple

from skyrange.core.errors import DecodeError

MAGIC: Final = 0x1F
DEAUTHENTICATION: Final = 12
BROADCAST: Final = b"\xff" * 6
NOBODY: Final = b"\x02\x00\x00\x00\x00\x00"
"""A locally administered address that no radio has."""
CLASS_3_FRAME: Final = 7
"""Reason code: class 3 frame received from a station that is not associated (table 9-49)."""

_REQUEST: Final = struct.Struct("<BBhI")
_HEADER: Final = struct.Struct("<HH6s6s6sH")
_TYPE_MASK: Final = 0x000F
"""Protocol version and type; both 0 in a management frame."""
_FCS: Final = 4


class ManagementFrameHeader(NamedTuple):
    """The addresses and subtype of a management frame."""

    subtype: int
    destination: bytes
    source: bytes
    bssid: bytes

    def is_for(self, address: bytes) -> bool:
        """Whether a radio with this address takes it as sent to itself."""
        return self.destination in (address, BROADCAST)


class FrameRequest(NamedTuple):
    """An order to send a management frame."""

    channel: int
    power_cdbm: int
    mac_frame: bytes


def encode_deauthentication(destination: bytes, source: bytes, bssid: bytes, sequence: int = 0) -> bytes:
    """A Deauthentication frame with its check sequence; `sequence` counts modulo 4096."""
    control = DEAUTHENTICATION << 4
    frame = _HEADER.pack(control, 0, destination, source, bssid, (sequence & 0xFFF) << 4)
    frame += struct.pack("<H", CLASS_3_FRAME)
    return frame + struct.pack("<I", zlib.crc32(frame))


def decode_management(frame: bytes) -> ManagementFrameHeader:
    """The header of a management frame with its check sequence; raises `DecodeError` for anything else."""
    if len(frame) < _HEADER.size + _FCS:
        raise DecodeError(f"{len(frame)} bytes, a management frame has at least {_HEADER.size + _FCS}")
    control, _, destination, source, bssid, _ = _HEADER.unpack_from(frame)
    if control & _TYPE_MASK:
        raise DecodeError(f"frame control 0x{control:04x}, expected a management frame")
    if struct.unpack("<I", frame[-_FCS:])[0] != zlib.crc32(frame[:-_FCS]):
        raise DecodeError("a wrong frame check sequence")
    return ManagementFrameHeader((control >> 4) & 0xF, destination, source, bssid)


def pack_request(request: FrameRequest) -> bytes:
    """Encode a request; raises `ValueError` if a field does not fit its bytes."""
    try:
        return _REQUEST.pack(MAGIC, request.channel, request.power_cdbm, 0) + request.mac_frame
    except struct.error as error:
        raise ValueError(f"{request}: {error}") from error


def unpack_request(payload: bytes) -> FrameRequest:
    """Decode a request; raises `DecodeError` for anything that is none."""
    if len(payload) < _REQUEST.size:
        raise DecodeError(f"{len(payload)} bytes, a request has at least {_REQUEST.size}")
    magic, channel, power_cdbm, _ = _REQUEST.unpack_from(payload)
    if magic != MAGIC:
        raise DecodeError(f"first byte 0x{magic:02x}, expected 0x{MAGIC:02x}")
    if not 1 <= channel <= 13:
        raise DecodeError(f"Wi-Fi channel {channel}, expected 1…13")
    frame = payload[_REQUEST.size :]
    decode_management(frame)
    return FrameRequest(channel, power_cdbm, frame)
