"""Range scans: what a LiDAR or a depth camera sends its companion on `scan:OPERATOR/VEHICLE`, one frame for each scan.

| bytes | field | content |
|---|---|---|
| 0–1 | mark | `RS` |
| 2 | version | 1 |
| 3 | kind | 0 LiDAR, 1 depth camera |
| 4 | sensor | number of the sensor on its aircraft, from 0 |
| 5–7 | spare | zeros |
| 8–11 | scan | number of the scan, from 0, modulo 2³² |
| 12–15 | resolution | micrometres in a step |
| 16–23 | start | ns of range time, signed: the start of the scan |
| 24–39 | attitude | estimate of the sensor: quaternion of floats, w first, from its base (forward, left, up) to local |
| 40–43 | count | pulses or pixels |
| 44–… | steps | 16 bits each: distance, or depth along the axis of a camera; 0 is none |

All numbers are little-endian. The directions of the pulses are those of the sensor's model. Sensors have formats of
their makers; this one is the range's.
"""

from __future__ import annotations

import math
import struct
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.core.errors import DecodeError
from skyrange.core.time import Time

LIDAR: Final = 0
DEPTH: Final = 1
_MARK: Final = b"RS"
_VERSION: Final = 1
_HEADER: Final = struct.Struct("<2sBBB3xIIq4fI")
HEADER_BYTES: Final = _HEADER.size
MAX_STEPS: Final = 4_000_000
"""Pulses or pixels of a scan at most."""
_UNIT: Final = 1e-3
"""By how much the length of a quaternion of floats may differ from 1."""


class RangeScan(NamedTuple):
    """One scan of one sensor."""

    kind: int
    """`LIDAR` or `DEPTH`."""
    sensor: int
    scan: int
    resolution_m: float
    start_ns: Time
    attitude: tuple[float, float, float, float]
    steps: NDArray[np.uint16]
    """(n,) in the order of the model's pulses or, row by row from the top left, of its pixels."""


def pack_scan(scan: RangeScan) -> bytes:
    """The payload of a scan."""
    return (
        _HEADER.pack(
            _MARK,
            _VERSION,
            scan.kind,
            scan.sensor,
            scan.scan % 2**32,
            round(scan.resolution_m * 1e6),
            scan.start_ns,
            *scan.attitude,
            len(scan.steps),
        )
        + scan.steps.astype("<u2").tobytes()
    )


def unpack_scan(payload: bytes) -> RangeScan:
    """The scan in a payload. Raises `DecodeError` for one that is none."""
    if len(payload) < HEADER_BYTES:
        raise DecodeError(f"{len(payload)} bytes, a range scan has at least {HEADER_BYTES}")
    mark, version, kind, sensor, number, resolution, start_ns, *attitude, count = _HEADER.unpack_from(payload)
    if mark != _MARK or version != _VERSION:
        raise DecodeError(f"{mark!r}, version {version}: not a range scan of version {_VERSION}")
    if kind not in (LIDAR, DEPTH):
        raise DecodeError(f"kind {kind} of a range scan, known are {LIDAR} and {DEPTH}")
    if count > MAX_STEPS or len(payload) != HEADER_BYTES + 2 * count:
        raise DecodeError(f"{len(payload)} bytes with {count} steps")
    if resolution == 0:
        raise DecodeError("a range scan with a resolution of 0")
    length = math.sqrt(math.fsum(part * part for part in attitude)) if all(map(math.isfinite, attitude)) else math.nan
    if not abs(length - 1.0) < _UNIT:
        raise DecodeError(f"an attitude of length {length}")
    w, x, y, z = (part / length for part in attitude)
    steps = np.frombuffer(payload, dtype="<u2", offset=HEADER_BYTES).astype(np.uint16)
    return RangeScan(kind, sensor, number, resolution * 1e-6, start_ns, (w, x, y, z), steps)
