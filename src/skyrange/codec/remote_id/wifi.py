"""802.11 frames that carry Remote ID: Beacons with a vendor specific element, and NAN action frames.

Sources: F3411-22a, Wi-Fi Beacon and Wi-Fi NAN broadcast methods; IEEE 802.11-2016, 9.3.3.3 (Beacon), 9.4.2.26 (vendor
specific element), 9.6.8.11 (vendor specific public action), 9.2.4.8 (FCS); Wi-Fi Alliance Neighbor Awareness
Networking 3.1, 2.8 (addresses), 9.5 (attributes); field values as in opendroneid-core-c `libopendroneid/wifi.c`.

A frame is everything from frame control to the last element, followed by its frame check sequence (4 bytes).
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from hashlib import sha256
from typing import Final
from zlib import crc32

from skyrange.codec.remote_id.link_payload import RidFrame, RidHeader, Transport
from skyrange.core.errors import DecodeError

BEACON: Final = 0x80
ACTION: Final = 0xD0
_HEADER: Final = struct.Struct("<HH6s6s6sH")
"""Frame control, duration, addresses 1…3, sequence control."""
_BEACON: Final = struct.Struct("<QHH")
"""Timestamp (us), interval (TU of 1024 us), capability."""
FCS: Final = 4

BROADCAST: Final = b"\xff" * 6
CAPABILITY: Final = 0x0420
"""Short preamble, short slot time: nothing that invites a station to join."""
RATES: Final = bytes([1, 1, 0x8C])
"""Supported rates element: 6 Mb/s, basic."""

VENDOR: Final = 0xDD
"""Element id of a vendor specific element."""
ASD_STAN: Final = b"\xfa\x0b\xbc\x0d"
"""Organisation and type under which Beacons carry ASTM's messages (5.4.9)."""

WFA_NAN: Final = b"\x50\x6f\x9a\x13"
"""Wi-Fi Alliance, NAN."""
NAN_ADDRESS: Final = bytes.fromhex("516f9a010000")
"""The NAN Network ID: address 1 of service discovery frames."""
NAN_CLUSTER: Final = bytes.fromhex("506f9a0100ff")
"""The cluster id that F3411 prescribes: address 3."""
SERVICE_ID: Final = sha256(b"org.opendroneid.remoteid").digest()[:6]
"""A NAN service is identified by the first 48 bits of the SHA-256 of its name in lower case: 88 69 19 9d 92 09."""
_PUBLIC_VENDOR: Final = b"\x04\x09" + WFA_NAN
"""Category public action, vendor specific, NAN."""
_DESCRIPTOR: Final = 0x03
_EXTENSION: Final = 0x0E
_INSTANCE: Final = 1
_PUBLISH_WITH_INFO: Final = 0x10
_UPDATE_INDICATOR: Final = 0x0200


def encode_beacon(
    frame: RidFrame, *, ssid: bytes = b"UAS", timestamp_us: int = 0, interval_tu: int = 100, sequence: int = 0
) -> bytes:
    """A Beacon with the address, counter and body of `frame`.

    `ssid` has 1…32 bytes, `sequence` is 0…4095; else `ValueError`.
    """
    if not 1 <= len(ssid) <= 32:
        raise ValueError(f"ssid of {len(ssid)} bytes, expected 1…32")
    header = frame.header
    content = ASD_STAN + bytes([header.counter]) + frame.body
    if len(content) > 255:
        raise ValueError(f"a body of {len(frame.body)} bytes, an element holds {255 - len(ASD_STAN) - 1}")
    return _with_fcs(
        _head(BEACON, BROADCAST, header.address, header.address, sequence)
        + _BEACON.pack(timestamp_us, interval_tu, CAPABILITY)
        + bytes([0, len(ssid)]) + ssid + RATES
        + bytes([VENDOR, len(content)]) + content
    )  # fmt: skip


def encode_nan_action(frame: RidFrame, *, sequence: int = 0) -> bytes:
    """A NAN service discovery frame with the address, counter and body of `frame` (at most 254 bytes, else
    `ValueError`).
    """
    header = frame.header
    info = bytes([header.counter]) + frame.body
    if len(info) > 255:
        raise ValueError(f"a body of {len(frame.body)} bytes, service info holds 254")
    descriptor = SERVICE_ID + bytes([_INSTANCE, 0, _PUBLISH_WITH_INFO, len(info)]) + info
    extension = struct.pack("<BHB", _INSTANCE, _UPDATE_INDICATOR, header.counter)
    return _with_fcs(
        _head(ACTION, NAN_ADDRESS, header.address, NAN_CLUSTER, sequence)
        + _PUBLIC_VENDOR
        + _attribute(_DESCRIPTOR, descriptor)
        + _attribute(_EXTENSION, extension)
    )


def decode_frame(frame: bytes) -> RidFrame:
    """Decode transport, address, counter and body of a Beacon or NAN action frame that carries Remote ID.

    Raises `DecodeError` if the frame check sequence is wrong, if the frame is of another kind, or if none of its
    elements or attributes holds a broadcast. The body is not decoded. A frame holds no channel, signal strength or
    time.
    """
    size = len(frame) - FCS
    if size < _HEADER.size:
        raise DecodeError(f"{len(frame)} bytes, a management frame has at least {_HEADER.size + FCS}")
    if crc32(frame[:size]).to_bytes(4, "little") != frame[size:]:
        raise DecodeError("wrong frame check sequence")
    control, _, to, address, _, _ = _HEADER.unpack_from(frame)
    body = frame[_HEADER.size : size]
    kind = control & 0xFC  # type and subtype; the version must be 0, flags may be set
    if control & 3:
        raise DecodeError(f"802.11 version {control & 3}")
    if kind == BEACON:
        transport = Transport.WIFI_BEACON
        content = _in_beacon(body)
    elif kind == ACTION:
        if to != NAN_ADDRESS:
            raise DecodeError(f"an action frame to {to.hex(':')}, NAN's go to {NAN_ADDRESS.hex(':')}")
        transport = Transport.WIFI_NAN
        content = _in_action(body)
    else:
        raise DecodeError(f"frame control 0x{control:04x}, neither a Beacon nor an action frame")
    return RidFrame(RidHeader(transport, counter=content[0], address=address), content[1:])


def _in_beacon(body: bytes) -> bytes:
    """Counter and messages."""
    if len(body) < _BEACON.size:
        raise DecodeError("a Beacon without its fixed fields")
    for kind, value in _elements(body, _BEACON.size):
        if kind == VENDOR and value.startswith(ASD_STAN) and len(value) > len(ASD_STAN):
            return value[len(ASD_STAN) :]
    raise DecodeError("a Beacon without Remote ID")


def _in_action(body: bytes) -> bytes:
    """Counter and messages."""
    if not body.startswith(_PUBLIC_VENDOR):
        raise DecodeError("an action frame of another kind than NAN")
    for kind, value in _attributes(body, len(_PUBLIC_VENDOR)):
        if kind == _DESCRIPTOR and value.startswith(SERVICE_ID) and len(value) > 10 and value[8] & _PUBLISH_WITH_INFO:
            if value[9] == 0 or len(value) < 10 + value[9]:
                raise DecodeError(f"service info of {value[9]} bytes in {len(value) - 10}")
            return value[10 : 10 + value[9]]
    raise DecodeError("NAN without Remote ID's service")


def _elements(body: bytes, at: int) -> Iterator[tuple[int, bytes]]:
    while at + 2 <= len(body):
        end = at + 2 + body[at + 1]
        if end > len(body):
            raise DecodeError(f"element {body[at]} of {body[at + 1]} bytes does not fit its frame")
        yield body[at], body[at + 2 : end]
        at = end


def _attributes(body: bytes, at: int) -> Iterator[tuple[int, bytes]]:
    while at + 3 <= len(body):
        end = at + 3 + int.from_bytes(body[at + 1 : at + 3], "little")
        if end > len(body):
            raise DecodeError(f"attribute {body[at]} of {end - at - 3} bytes does not fit its frame")
        yield body[at], body[at + 3 : end]
        at = end


def _attribute(kind: int, value: bytes) -> bytes:
    return struct.pack("<BH", kind, len(value)) + value


def _head(control: int, to: bytes, address: bytes, network: bytes, sequence: int) -> bytes:
    if len(address) != 6 or not 0 <= sequence <= 4095:
        raise ValueError(f"address {address.hex()}, sequence {sequence}: 6 bytes, 0…4095")
    return _HEADER.pack(control, 0, to, address, network, sequence << 4)


def _with_fcs(frame: bytes) -> bytes:
    """`frame` and its CRC-32 (802.11-2016, 9.2.4.8: that of IEEE 802.3), in the byte order of captures."""
    return frame + crc32(frame).to_bytes(FCS, "little")
