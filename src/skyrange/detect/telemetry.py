"""Telemetry in observed frames: MAVLink messages as columns.

The telemetry of an aircraft arrives at its ground station on its `gcs` link. A monitor at the end of the ground station
reads telemetry from the frames that arrive there. It cannot distinguish forged messages from true ones.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from skyrange.codec.mavlink import decode, encode_payload
from skyrange.codec.mavlink.frame_layout import LAYOUTS
from skyrange.codec.mavlink.message_columns import (
    MessageTable,
    classify_frames,
    kind_of_message,
    message_ids,
    payload_dtype,
    unpack_group,
)
from skyrange.contracts.frames import Ints
from skyrange.contracts.monitors import ObservedFrames
from skyrange.core.errors import DecodeError, InputError, nearest


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
    found = unpack_group(frames.payloads, kind_of_message(number), rows)
    columns = (rows, found.systems, found.components, found.values)
    strange = np.flatnonzero((kinds < 0) & (message_ids(frames.payloads) == number))
    singles = [single for row in strange.tolist() if (single := _read_single(frames, row, number)) is not None]
    if not singles:
        return ObservedMessages(*columns)
    heads = np.array([head for head, _ in singles], dtype=np.int64)
    values = np.array([body for _, body in singles], dtype=payload_dtype(number))
    order = np.argsort(np.concatenate([rows, heads[:, 0]]), kind="stable")
    more = (heads[:, 0], heads[:, 1], heads[:, 2], values)
    return ObservedMessages(*(np.concatenate(pair)[order] for pair in zip(columns, more, strict=True)))


def _read_single(frames: ObservedFrames, row: int, number: int) -> tuple[tuple[int, int, int], np.void] | None:
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
