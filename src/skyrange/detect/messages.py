"""MAVLink in observed frames, as columns: the headers of all messages, and the fields of those of one name.

The telemetry of an aircraft arrives at its ground station on its `gcs` link. A monitor at the end of the ground station
reads telemetry from the frames that arrive there. It cannot distinguish forged messages from true ones.
"""

from __future__ import annotations

from functools import cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mavlink import decode, encode_payload
from skyrange.codec.mavlink.frames import CHECKSUM, HEADER_V2, LAYOUTS
from skyrange.codec.mavlink.message_columns import (
    KIND_COUNT,
    MessageTable,
    classify_frames,
    kind_of_message,
    message_id_of_kind,
    message_ids,
    payload_dtype,
    unpack_group,
)
from skyrange.contracts.frames import Ints
from skyrange.contracts.monitors import ObservedFrames
from skyrange.core.errors import DecodeError, InputError, nearest

Flags = NDArray[np.bool_]

_UPPER_ROLES: Final = {"gcs": "gcs", "log": "companion", "autopilot": "proxy"}
"""The end of a link of each kind that is nearer to the ground station."""
_LOWER_ROLES: Final = {"gcs": "companion", "log": "proxy", "autopilot": "autopilot"}


class MessageHeads(NamedTuple):
    """Headers of valid MAVLink frames, one row each, in the order of their frames."""

    rows: Ints
    """(n,) the frame of each."""
    places: Ints
    """(n,) the place of its link end in `ObservedFrames.ports`."""
    at_ns: Ints
    """(n,) when it arrived or was sent; not before 0."""
    received: Flags
    """(n,) whether it arrived at the end."""
    to_vehicle: Flags
    """(n,) whether it travels from the ground station towards the autopilot."""
    systems: Ints
    """(n,) the claimed system id."""
    components: Ints
    """(n,) the claimed component id."""
    sequences: Ints
    """(n,) the sequence number, 0…255."""
    messages: Ints
    """(n,) the message id."""
    checksums: Ints
    """(n,) the checksum, which stands for the content of the frame."""

    def take(self, rows: Ints | Flags) -> MessageHeads:
        """Some of the rows."""
        return MessageHeads._make(column[rows] for column in self)

    @property
    def senders(self) -> Ints:
        """(n,) place, direction, system and component as one number."""
        return ((self.places << 1 | self.received) << 8 | self.systems) << 8 | self.components


def read_heads(frames: ObservedFrames) -> MessageHeads:
    """The headers of all whole, valid MAVLink frames of version 1 or 2. Signatures are not checked."""
    payloads = frames.payloads
    kinds = classify_frames(payloads)
    rows = np.flatnonzero(kinds >= 0)
    data, starts = payloads.data, payloads.starts[rows]
    ends = starts + payloads.sizes[rows]
    body = starts + HEADER_V2 + data[starts + 1] if len(rows) else starts
    assert np.all(body + CHECKSUM <= ends)
    sequences, systems, components = (data[starts + offset].astype(np.int64) for offset in (4, 5, 6))
    checksums = data[body].astype(np.int64) | data[body + 1].astype(np.int64) << 8 if len(rows) else starts
    messages = _ids_of_kinds()[kinds[rows]]
    strange = np.flatnonzero(kinds < 0)
    strange = strange[message_ids(payloads.take(strange)) >= 0]
    singles = [head for row in strange.tolist() if (head := _read_single(frames, row)) is not None]
    if singles:
        more = np.array(singles, dtype=np.int64).T
        rows = np.concatenate([rows, more[0]])
        order = np.argsort(rows, kind="stable")
        sequences, systems, components, messages, checksums = (
            np.concatenate([column, extra])[order]
            for column, extra in zip((sequences, systems, components, messages, checksums), more[1:], strict=True)
        )
        rows = rows[order]
    places = frames.places[rows]
    upper = np.array([_is_upper(port.link, port.endpoint) for port in frames.ports], dtype=np.bool_)
    received = frames.received[rows]
    at_ns = np.maximum(frames.at_ns[rows], 0)
    return MessageHeads(
        rows, places, at_ns, received, received != upper[places], systems, components, sequences, messages, checksums
    )


def _read_single(frames: ObservedFrames, row: int) -> tuple[int, int, int, int, int, int] | None:
    """A frame that only `decode` can read (MAVLink 1): (row, sequence, system, component, message, checksum)."""
    payload = frames.payloads[row]
    try:
        message = decode(payload)
    except DecodeError:
        return None
    if message.get_msgId() not in LAYOUTS:
        return None
    checksum = int.from_bytes(payload[-2:], "little")
    return row, message.get_seq(), message.get_srcSystem(), message.get_srcComponent(), message.get_msgId(), checksum


@cache
def _ids_of_kinds() -> Ints:
    return np.array([message_id_of_kind(kind) for kind in range(KIND_COUNT)], dtype=np.int64)


@cache
def _is_upper(link: str, endpoint: str) -> bool:
    kind, role = link.partition(":")[0], endpoint.rpartition(".")[2]
    if kind not in _UPPER_ROLES:
        return role == "gcs"
    return role == _UPPER_ROLES[kind] and role != _LOWER_ROLES[kind]


@cache
def message_numbers() -> dict[str, int]:
    """Message ids by name."""
    return {str(layout.cls.msgname): number for number, layout in LAYOUTS.items()}


def name_message(number: int) -> str:
    """The name of a message id of the dialect."""
    return str(LAYOUTS[number].cls.msgname)


class ObservedMessages(NamedTuple):
    """Messages of one kind, one row each, in the order of their frames."""

    rows: Ints
    """(n,) the frame of each message."""
    systems: Ints
    """(n,) the claimed MAVLink system id."""
    components: Ints
    """(n,) the claimed MAVLink component id."""
    values: MessageTable
    """(n,) the fields by MAVLink's names, in wire units: `values["custom_mode"]`."""


def read_messages(frames: ObservedFrames, name: str) -> ObservedMessages:
    """The messages called `name` (such as `HEARTBEAT`) among `frames`, of MAVLink 1 and 2.

    Frames without a whole, valid message are left out. Signatures are not checked. Raises `InputError` for a name that
    the dialect does not have.
    """
    number = _ids().get(name)
    if number is None:
        raise InputError.one("detector", "message", name, "a MAVLink message", nearest(name, _ids()))
    kinds = classify_frames(frames.payloads)
    rows = np.flatnonzero(kinds == kind_of_message(number))
    messages = unpack_group(frames.payloads, kind_of_message(number), rows)
    columns = (rows, messages.systems, messages.components, messages.values)
    strange = np.flatnonzero((kinds < 0) & (message_ids(frames.payloads) == number))
    singles = [single for row in strange.tolist() if (single := _read_message(frames, row, number)) is not None]
    if not singles:
        return ObservedMessages(*columns)
    heads = np.array([head for head, _ in singles], dtype=np.int64)
    values = np.array([body for _, body in singles], dtype=payload_dtype(number))
    order = np.argsort(np.concatenate([rows, heads[:, 0]]), kind="stable")
    more = (heads[:, 0], heads[:, 1], heads[:, 2], values)
    return ObservedMessages(*(np.concatenate(pair)[order] for pair in zip(columns, more, strict=True)))


def _read_message(frames: ObservedFrames, row: int, number: int) -> tuple[tuple[int, int, int], np.void] | None:
    """(row, system, component) and fields of a frame that only `decode` can read (MAVLink 1); None if it cannot."""
    try:
        message = decode(frames.payloads[row])
    except DecodeError:
        return None
    if message.get_msgId() != number:
        return None
    body: np.void = np.frombuffer(encode_payload(message), dtype=payload_dtype(number))[0]
    return (row, message.get_srcSystem(), message.get_srcComponent()), body


@cache
def _ids() -> dict[str, int]:
    return {str(layout.cls.msgname): number for number, layout in LAYOUTS.items()}
