"""MAVLink FTP and log requests, answered by an autopilot that stores neither files nor logs.

Without an answer a ground station repeats its request until it gives up, and reports that: MAVProxy asks for the
parameters as a file first. The payload of FILE_TRANSFER_PROTOCOL is that of https://mavlink.io/en/services/ftp.html.
"""

from __future__ import annotations

import struct
from typing import Any, Final

from skyrange.codec.mavlink import dialect as mav
from skyrange.vehicle.builtin.fleet import Causes, Fleet, Vehicle

_HEAD: Final = struct.Struct("<HBBBBBBI")
"""Sequence number, session, opcode, size, opcode of the request, burst complete, padding, offset."""
_PAYLOAD_BYTES: Final = 251
_ACK, _NAK = 128, 129
_EMPTY: Final = frozenset({1, 2})
"""TerminateSession and ResetSessions: done, because there are no sessions."""
_UNKNOWN_COMMAND, _FILE_NOT_FOUND = 7, 10
_NAMED: Final = frozenset({3, 4, 8, 11, 14, 16})
"""ListDirectory, OpenFileRO, RemoveFile, OpenFileWO, CalcFileCRC32 and ArduPilot's ListDirectoryWithTime."""


def on_file_transfer(fleet: Fleet, vehicle: Vehicle, message: Any, peer: tuple[int, int], causes: Causes) -> None:
    """FILE_TRANSFER_PROTOCOL: reject every request with the reason that there is no such file, or no such command."""
    sequence, session, opcode, *_ = _HEAD.unpack_from(bytes(message.payload))
    if opcode in (0, _ACK, _NAK):
        return
    done = opcode in _EMPTY
    error = b"" if done else bytes([_FILE_NOT_FOUND if opcode in _NAMED else _UNKNOWN_COMMAND])
    head = _HEAD.pack((sequence + 1) & 0xFFFF, session, _ACK if done else _NAK, len(error), opcode, 0, 0, 0)
    payload = (head + error).ljust(_PAYLOAD_BYTES, b"\0")
    fleet.send(vehicle, mav.MAVLink_file_transfer_protocol_message(0, *peer, list(payload)), causes)


def on_log_request_list(fleet: Fleet, vehicle: Vehicle, message: Any, peer: tuple[int, int], causes: Causes) -> None:
    """LOG_REQUEST_LIST: answer that there are no logs, as ArduPilot does (AP_Logger_MAVLinkLogTransfer.cpp)."""
    fleet.send(vehicle, mav.MAVLink_log_entry_message(0, 0, 0, 0, 0), causes)
