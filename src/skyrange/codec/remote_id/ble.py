"""Bluetooth LE packets that carry Remote ID: legacy advertisements, and extended ones on Long Range.

Sources: F3411-22a, Bluetooth Legacy and Bluetooth Long Range broadcast methods (service data of the 16-bit UUID
0xFFFA, application code 0x0D, message counter, message or pack); Bluetooth Core Specification 5.4, Vol 6 Part B, 2.1
(packet), 2.3 (advertising PDUs), 2.3.4 (extended payload), 3.1.1 (CRC); Core Specification Supplement, Part A, 1.11
(service data).

A packet is encoded as captures show it, from the first byte after the preamble: access address, coding indicator (1
byte, coded PHY only), PDU, CRC; without whitening. Addresses are held most significant byte first, as they are
printed, and are sent in the opposite byte order.
"""

from __future__ import annotations

import struct
from typing import Final

from skyrange.codec.f3411 import SIZE
from skyrange.codec.remote_id.link_payload import RidFrame, RidHeader, Transport
from skyrange.core.errors import DecodeError

ACCESS_ADDRESS: Final = bytes.fromhex("d6be898e")
"""0x8E89BED6, the access address of all advertising packets (2.1.2)."""
S8: Final = 0
"""Coding indicator: eight symbols per bit, 125 kb/s (2.2.3)."""
CRC: Final = 3

ADV_NONCONN_IND: Final = 0b0010
ADV_EXT_IND: Final = 0b0111
"""The type of the PDU on a primary channel; on a secondary channel the same type is AUX_ADV_IND (2.3, table 2.3)."""
_RANDOM: Final = 0x40
"""TxAdd: the advertiser's address is random."""
_ADDRESS: Final = 0x01
_DATA_INFO: Final = 0x08
"""Extended header flags (2.3.4.1…5)."""

SERVICE_DATA: Final = 0x16
"""AD type: service data of a 16-bit UUID."""
REMOTE_ID: Final = b"\xfa\xff\x0d"
"""UUID 0xFFFA (ASTM International), application code of Remote ID."""


def _crc_table() -> tuple[int, ...]:
    """CRC table for one byte, least significant bit first: x^24 + x^10 + x^9 + x^6 + x^4 + x^3 + x + 1 (3.1.1),
    reflected.
    """
    table = []
    for byte in range(256):
        value = byte
        for _ in range(8):
            value = value >> 1 ^ (0xDA6000 if value & 1 else 0)
        table.append(value)
    return tuple(table)


_TABLE: Final = _crc_table()


def checksum(pdu: bytes) -> bytes:
    """The CRC of an advertising PDU (start value 0x555555), in the byte order of captures."""
    crc = 0xAAAAAA  # 0x555555 reflected
    for byte in pdu:
        crc = crc >> 8 ^ _TABLE[(crc ^ byte) & 0xFF]
    return crc.to_bytes(CRC, "little")


def encode_legacy(frame: RidFrame, *, random: bool = True) -> bytes:
    """ADV_NONCONN_IND for the 1M PHY, with the address, counter and message of `frame`.

    Raises `ValueError` unless the body is one message of 25 bytes.
    """
    if len(frame.body) != SIZE:
        raise ValueError(f"a body of {len(frame.body)} bytes, a legacy advertisement holds one message of {SIZE}")
    return ACCESS_ADDRESS + _pdu_with_crc(ADV_NONCONN_IND, _address(frame) + _advertising_data(frame), random=random)


def encode_auxiliary(frame: RidFrame, *, set_id: int = 0, random: bool = True) -> bytes:
    """AUX_ADV_IND for the coded PHY on a secondary channel, with the address, counter and body of `frame`.

    `set_id` 0…15 distinguishes the advertising sets of one advertiser. Raises `ValueError` for a body that does not
    fit.
    """
    service_data = _advertising_data(frame)
    extended = bytes([_ADDRESS | _DATA_INFO]) + _address(frame) + _data_info(frame, set_id)
    return (
        ACCESS_ADDRESS
        + bytes([S8])
        + _pdu_with_crc(ADV_EXT_IND, bytes([len(extended)]) + extended + service_data, random=random)
    )


def decode_packet(packet: bytes, *, coded: bool) -> RidFrame:
    """Decode transport, address, counter and body of an advertisement that carries Remote ID.

    `coded` says whether a coding indicator follows the access address. Raises `DecodeError` if the CRC is wrong or if
    the packet is not one that `encode_legacy` or `encode_auxiliary` make. The body is not decoded. A packet holds no
    channel, signal strength or time.
    """
    start = len(ACCESS_ADDRESS) + coded
    if len(packet) < start + 2 + CRC:
        raise DecodeError(f"{len(packet)} bytes, an advertisement has at least {start + 2 + CRC}")
    if packet[: len(ACCESS_ADDRESS)] != ACCESS_ADDRESS:
        raise DecodeError(f"access address {packet[:4].hex()}, not that of advertising")
    pdu = packet[start:-CRC]
    if checksum(pdu) != packet[-CRC:]:
        raise DecodeError("wrong CRC")
    kind, payload = pdu[0] & 15, pdu[2:]
    if pdu[1] != len(payload):
        raise DecodeError(f"a payload of {len(payload)} bytes, but the header announces {pdu[1]}")
    if kind == ADV_NONCONN_IND and not coded:
        if len(payload) < 6:
            raise DecodeError("no advertiser's address")
        transport, address, service_data = Transport.BT4, payload[5::-1], payload[6:]
    elif kind == ADV_EXT_IND:
        transport = Transport.BT5
        address, service_data = _extended(payload)
    else:
        raise DecodeError(f"PDU type {kind}, Remote ID uses {ADV_NONCONN_IND} and, extended, {ADV_EXT_IND}")
    counter, body = _service_data(service_data)
    return RidFrame(RidHeader(transport, counter=counter, address=address), body)


def _pdu_with_crc(kind: int, payload: bytes, *, random: bool) -> bytes:
    """The PDU header, the payload and their CRC."""
    if len(payload) > 255:
        raise ValueError(f"a payload of {len(payload)} bytes, at most 255")
    pdu = bytes([kind | (_RANDOM if random else 0), len(payload)]) + payload
    return pdu + checksum(pdu)


def _address(frame: RidFrame) -> bytes:
    address = frame.header.address
    if len(address) != 6:
        raise ValueError(f"address of {len(address)} bytes, expected 6")
    return address[::-1]


def _advertising_data(frame: RidFrame) -> bytes:
    service_data = bytes([SERVICE_DATA]) + REMOTE_ID + bytes([frame.header.counter]) + frame.body
    if len(service_data) > 255:
        raise ValueError(f"a body of {len(frame.body)} bytes does not fit an advertisement")
    return bytes([len(service_data)]) + service_data


def _data_info(frame: RidFrame, set_id: int) -> bytes:
    """ADI field: the data id, which changes with the counter, and the set id."""
    if not 0 <= set_id <= 15:
        raise ValueError(f"set_id {set_id}: 0…15")
    return struct.pack("<H", set_id << 12 | frame.header.counter)


def _extended(payload: bytes) -> tuple[bytes, bytes]:
    """Advertiser's address and advertising data of an extended payload."""
    size = payload[0] & 0x3F if payload else 0
    if size < 7 or len(payload) < 1 + size or not payload[1] & _ADDRESS:
        raise DecodeError("an extended advertisement without the advertiser's address")
    return payload[7:1:-1], payload[1 + size :]


def _service_data(service_data: bytes) -> tuple[int, bytes]:
    """Counter and body of the first AD structure that holds Remote ID."""
    at = 0
    while at < len(service_data) and service_data[at]:  # a length of 0 ends the data early
        end = at + 1 + service_data[at]
        if end > len(service_data):
            raise DecodeError(f"an AD structure of {service_data[at]} bytes does not fit its advertisement")
        if service_data[at + 1] == SERVICE_DATA and service_data[at + 2 : at + 5] == REMOTE_ID and end > at + 5:
            return service_data[at + 5], service_data[at + 6 : end]
        at = end
    raise DecodeError("an advertisement without Remote ID")
