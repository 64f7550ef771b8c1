"""View `mavlink`: the frames at a place with header fields, message name and raw bytes."""

from __future__ import annotations

from typing import Final

import numpy as np
import pyarrow as pa

from skyrange.codec.mavlink import decode
from skyrange.codec.mavlink.frame_layout import HEADER_V2, LAYOUTS, MAGIC_V1, MAGIC_V2, MIN_FRAME, SIGNED
from skyrange.codec.mavlink.message_columns import classify_frames, message_ids
from skyrange.contracts.frames import Ints, Payloads
from skyrange.core.errors import DecodeError
from skyrange.record.read.station_frames import payload_column

_IDS: Final = sorted(LAYOUTS)
_NAMES: Final = pa.array([str(LAYOUTS[number].cls.msgname) for number in _IDS], pa.string())


def describe_mavlink(seen: pa.Table) -> pa.Table:
    """Rows of `seen_frames` as rows of the view, without its first and last columns."""
    payloads = payload_column(seen.column("raw"))
    first = _byte(payloads, np.zeros(len(payloads), dtype=np.int64))
    version = np.select([first == MAGIC_V2, first == MAGIC_V1], [2, 1], 0)
    version[payloads.sizes < np.where(version == 2, HEADER_V2 + 2, MIN_FRAME)] = 0
    no_header = version == 0
    two = version == 2
    ids = message_ids(payloads)
    columns = {
        "version": pa.array(version.astype(np.int16)),
        "valid": pa.array(_valid(payloads, version)),
        "signed": pa.array(two & (_byte(payloads, np.full(len(payloads), 2)) & SIGNED > 0)),
        "sequence": _field(payloads, np.where(two, 4, 2), no_header),
        "system": _field(payloads, np.where(two, 5, 3), no_header),
        "component": _field(payloads, np.where(two, 6, 4), no_header),
        "message_id": pa.array(ids.astype(np.int32), mask=no_header),
        "message": _message(ids, no_header),
    }
    for name, column in columns.items():
        seen = seen.append_column(name, column)
    return seen


def _byte(payloads: Payloads, offset: Ints) -> Ints:
    """(n,) the byte at an offset of each payload; 0 beyond its end."""
    if not len(payloads.data):
        return np.zeros(len(payloads), dtype=np.int64)
    inside = offset < payloads.sizes
    at = np.where(inside, payloads.starts + offset, 0)
    return np.where(inside, payloads.data[at], 0).astype(np.int64)


def _field(payloads: Payloads, offset: Ints, missing: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> pa.Array:
    return pa.array(_byte(payloads, offset).astype(np.int16), mask=missing)


def _message(ids: Ints, missing: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> pa.Array:
    known = np.array(_IDS)
    place = np.minimum(np.searchsorted(known, ids), len(known) - 1)
    return _NAMES.take(pa.array(place, mask=missing | (known[place] != ids)))


def _valid(payloads: Payloads, version: Ints) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """(n,) whether each payload is one whole message; those that the fast path does not know are decoded."""
    valid = classify_frames(payloads) >= 0
    for row in np.flatnonzero(~valid & (version > 0)).tolist():
        try:
            decode(payloads[row])
        except DecodeError:
            continue
        valid[row] = True
    return valid
