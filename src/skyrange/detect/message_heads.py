"""Headers of MAVLink frames in observed frames, as columns."""

from __future__ import annotations

from functools import cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mavlink import decode
from skyrange.codec.mavlink.frame_layout import CHECKSUM, HEADER_V2, LAYOUTS
from skyrange.codec.mavlink.message_columns import KIND_COUNT, classify_frames, message_id_of_kind, message_ids
from skyrange.contracts.frames import Ints
from skyrange.contracts.monitors import ObservedFrames
from skyrange.core.errors import DecodeError

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
    singles = [found for row in strange.tolist() if (found := _read_single(frames, row)) is not None]
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
