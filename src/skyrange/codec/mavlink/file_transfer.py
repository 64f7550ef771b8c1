"""MAVLink FTP: the payload of FILE_TRANSFER_PROTOCOL (https://mavlink.io/en/services/ftp.html)."""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import Final, NamedTuple

DATA_BYTES: Final = 239
"""Most bytes of data in a payload."""
PAYLOAD_BYTES: Final = 251
_HEAD: Final = struct.Struct("<HBBBBBBI")
"""Sequence number, session, opcode, size, opcode of the request, burst complete, padding, offset."""


class Opcode(IntEnum):
    """What is requested, or how it was answered."""

    NONE = 0
    TERMINATE_SESSION = 1
    RESET_SESSIONS = 2
    LIST_DIRECTORY = 3
    OPEN_FILE_RO = 4
    READ_FILE = 5
    CREATE_FILE = 6
    WRITE_FILE = 7
    REMOVE_FILE = 8
    CREATE_DIRECTORY = 9
    REMOVE_DIRECTORY = 10
    OPEN_FILE_WO = 11
    TRUNCATE_FILE = 12
    RENAME = 13
    CALC_FILE_CRC32 = 14
    BURST_READ_FILE = 15
    ACK = 128
    NAK = 129


class Error(IntEnum):
    """The first byte of the data of a NAK; after FAIL_ERRNO there may be the number of `errno`."""

    FAIL = 1
    FAIL_ERRNO = 2
    INVALID_DATA_SIZE = 3
    INVALID_SESSION = 4
    NO_SESSIONS_AVAILABLE = 5
    END_OF_FILE = 6
    UNKNOWN_COMMAND = 7
    FILE_EXISTS = 8
    FILE_PROTECTED = 9
    FILE_NOT_FOUND = 10


class Transfer(NamedTuple):
    """One payload: a request or a reply. `size` is as it is sent, which may be more than there is."""

    sequence: int
    session: int
    opcode: int
    offset: int = 0
    data: bytes = b""
    size: int = 0
    request: int = 0
    """Opcode of the request that a reply answers."""
    burst_complete: bool = False

    @property
    def error(self) -> int:
        """Why it was refused: an `Error`, 0 for a reply that is no NAK."""
        return self.data[0] if self.opcode == Opcode.NAK else 0


def pack(
    sequence: int,
    session: int,
    opcode: int,
    data: bytes = b"",
    *,
    offset: int = 0,
    size: int | None = None,
    request: int = 0,
    burst_complete: bool = False,
) -> list[int]:
    """The payload, as the field of the message takes it; `size` is the length of the data unless it is given."""
    stated = len(data) if size is None else size
    head = _HEAD.pack(sequence & 0xFFFF, session, opcode, stated, request, burst_complete, 0, offset)
    return list((head + data).ljust(PAYLOAD_BYTES, b"\0"))


def unpack(payload: bytes) -> Transfer:
    """Read a payload of 251 bytes; `data` has all 239 of them."""
    sequence, session, opcode, size, request, burst_complete, _, offset = _HEAD.unpack_from(payload)
    return Transfer(sequence, session, opcode, offset, payload[_HEAD.size :], size, request, bool(burst_complete))


def text_of(transfer: Transfer) -> str:
    """The path that a request names: its data up to a NUL or its size. One character for each byte."""
    return transfer.data[: transfer.size].split(b"\0", 1)[0].decode("latin-1")
