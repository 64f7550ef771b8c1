"""Benign frames: what a sham sends in place of hostile ones."""

from __future__ import annotations

from skyrange.codec.mavlink import dialect, message_id
from skyrange.codec.mavlink.frame_layout import CHECKSUM, HEADER_V2, LAYOUTS, MAGIC_V2, checksum


def benign_payload(payload: bytes) -> bytes:
    """Bytes of the same length that ask for nothing and report nothing: what a sham sends instead of `payload`.

    In place of a MAVLink frame that is an ENCAPSULATED_DATA with the same sender and sequence number, which no
    component of the range reads, as far as its payload of at most 255 bytes is long enough; else zeros.
    """
    size = len(payload) - HEADER_V2 - CHECKSUM
    if message_id(payload) is None or not 1 <= size <= 255:
        return bytes(len(payload))
    sender = payload[4:7] if payload[0] == MAGIC_V2 else payload[2:5]
    return mavlink_frame(dialect.MAVLINK_MSG_ID_ENCAPSULATED_DATA, sender, bytes(size - 1) + b"\1")


def mavlink_frame(number: int, sender: bytes, body: bytes) -> bytes:
    """A MAVLink 2 frame of a payload as it is; `sender` has sequence number, system id and component id."""
    header = bytes([MAGIC_V2, len(body), 0, 0]) + sender + number.to_bytes(3, "little")
    covered = header + body
    return covered + checksum(covered[1:], LAYOUTS[number].crc_extra).to_bytes(CHECKSUM, "little")
