"""Rows of the table `scans`: what LiDARs and depth cameras measured, and what is true of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, Protocol

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from skyrange.optics.scanner import ScanTruth

_POSE: Final = (
    "east_m", "north_m", "up_m", "vel_east_mps", "vel_north_mps", "vel_up_mps", "qw", "qx", "qy", "qz",
    "rate_x_radps", "rate_y_radps", "rate_z_radps",
)  # fmt: skip
_ESTIMATE: Final = ("estimated_qw", "estimated_qx", "estimated_qy", "estimated_qz")


class ScanSource(Protocol):
    """Source of scans: the agent that makes them."""

    def start_recording(self) -> None:
        """Keep the truth of scans from now on."""
        ...

    def drain_truths(self) -> Sequence[ScanTruth]:
        """The truth of the scans that were sent since the last call."""
        ...


def scan_batch(scans: Sequence[ScanTruth]) -> pa.RecordBatch:
    """Rows of the `scans` table, in the given order; at least one."""
    poses = np.array([np.concatenate(scan.pose[:4]) for scan in scans])
    estimates = np.array([scan.estimate for scan in scans])
    columns: dict[str, pa.Array] = {
        "time_ns": pa.array([scan.sent_ns for scan in scans], pa.int64()),
        "vehicle": _names([scan.vehicle for scan in scans]),
        "sensor": _names([scan.sensor for scan in scans]),
        "scan": pa.array([scan.scan for scan in scans], pa.int64()),
        "start_ns": pa.array([scan.start_ns for scan in scans], pa.int64()),
        **{name: pa.array(poses[:, k]) for k, name in enumerate(_POSE)},
        **{name: pa.array(estimates[:, k]) for k, name in enumerate(_ESTIMATE)},
        "resolution_m": pa.array([scan.resolution_m for scan in scans], pa.float64()),
        "steps": _lists([scan.steps for scan in scans]),
        "kind": _lists([scan.kind for scan in scans]),
        "row": _lists([scan.row for scan in scans]),
        "is_false": _lists([scan.is_false for scan in scans]),
        "is_forged": _lists([scan.is_forged for scan in scans]),
        "aircraft": pa.array([list(scan.aircraft) for scan in scans], pa.list_(pa.string())),
    }
    return pa.RecordBatch.from_arrays(list(columns.values()), names=list(columns))


def _names(texts: Sequence[str]) -> pa.DictionaryArray:
    """Names in the order of the alphabet in the dictionary."""
    unique = sorted(set(texts))
    place = {text: number for number, text in enumerate(unique)}
    codes = pa.array([place[text] for text in texts], pa.int32())
    return pa.DictionaryArray.from_arrays(codes, pa.array(unique, pa.string()))


def _lists(values: Sequence[NDArray[Any]]) -> pa.ListArray:
    offsets = np.zeros(len(values) + 1, dtype=np.int32)
    np.cumsum([len(part) for part in values], out=offsets[1:])
    return pa.ListArray.from_arrays(pa.array(offsets), pa.array(np.concatenate(values)))
