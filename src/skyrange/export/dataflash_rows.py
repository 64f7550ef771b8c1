"""Rows of DataFlash messages, of several aircraft and kinds, and their bytes in order of time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import ArrayLike, NDArray

from skyrange.core.time import NS_PER_US
from skyrange.export.dataflash_messages import DEFINITIONS, Records

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]

I8_LIMITS, U8_LIMITS, I16_LIMITS, U16_LIMITS, I32_LIMITS = (
    (np.iinfo(kind).min, np.iinfo(kind).max) for kind in (np.int8, np.uint8, np.int16, np.uint16, np.int32)
)


class Rows(NamedTuple):
    """Messages of one kind, in no order."""

    name: str
    vehicle: Ints
    """(n,) numbers of aircraft."""
    time_ns: Ints
    """(n,)"""
    records: Records
    """(n,)"""


def make_rows(name: str, vehicle: Ints, time_ns: Ints, **fields: ArrayLike) -> Rows:
    """Messages of a kind; fields that are not given are zero. `TimeUS` is the time since the scenario's start, at
    which all aircraft boot.
    """
    records = DEFINITIONS[name].records(len(time_ns))
    records["TimeUS"] = time_ns // NS_PER_US
    for label, values in fields.items():
        records[label] = values
    return Rows(name, vehicle, time_ns, records)


def scaled(values: ArrayLike, scale: float, limits: tuple[int, int]) -> Floats:
    """Numbers in the units of an integer field, to the nearest, within the field's limits; zero if not a number."""
    found: Floats = np.clip(np.rint(np.nan_to_num(np.asarray(values, dtype=np.float64) * scale)), *limits)
    return found


def column(table: pa.Table, name: str) -> NDArray[Any]:
    """A numeric column of a table; nulls are not numbers."""
    values: NDArray[Any] = table.column(name).to_numpy()
    return values


def vehicle_numbers(names: pa.ChunkedArray, vehicles: pa.Array) -> Ints:
    """(n,) the number of each row's aircraft among `vehicles`; -1 for any other one."""
    found = pc.fill_null(pc.index_in(names, value_set=vehicles), -1)
    numbers: Ints = found.to_numpy().astype(np.int64)
    return numbers


def encode_in_order(parts: Sequence[Rows]) -> Iterator[tuple[int, bytes]]:
    """The bytes of all messages of each aircraft, by its number, in order of time. Those of one time keep the order of
    `parts`.
    """
    parts = [part for part in parts if len(part.time_ns)]
    if not parts:
        return
    vehicle = np.concatenate([part.vehicle for part in parts])
    sizes = np.repeat([part.records.dtype.itemsize for part in parts], [len(part.time_ns) for part in parts])
    order = np.lexsort((np.concatenate([part.time_ns for part in parts]), vehicle))
    ends = np.cumsum(sizes[order])
    starts = np.empty(len(order), dtype=np.int64)
    starts[order] = ends - sizes[order]
    out = np.empty(int(ends[-1]), dtype=np.uint8)
    done = 0
    for part in parts:
        size, count = part.records.dtype.itemsize, len(part.time_ns)
        places = starts[done : done + count, None] + np.arange(size)
        out[places] = part.records.view(np.uint8).reshape(count, size)
        done += count
    vehicles = vehicle[order]
    firsts = np.flatnonzero(np.diff(vehicles, prepend=-1))
    bounds = [*(ends - sizes[order])[firsts].tolist(), len(out)]
    for number, first, last in zip(vehicles[firsts].tolist(), bounds, bounds[1:], strict=False):
        yield number, out[first:last].tobytes()


class Attitudes(NamedTuple):
    """Attitudes in ArduPilot's frames, forward-right-down to north-east-down."""

    roll_deg: Floats
    pitch_deg: Floats
    yaw_deg: Floats
    """0 to 360."""
    quaternion: Floats
    """(n, 4) w, x, y, z; w is not negative."""

    def fields(self) -> Mapping[str, Floats]:
        """The fields of SIM and AHR2 in the units in which they are stored."""
        q = {f"Q{number + 1}": self.quaternion[:, number] for number in range(4)}
        roll, pitch = (scaled(angle, 100.0, I16_LIMITS) for angle in (self.roll_deg, self.pitch_deg))
        return {"Roll": roll, "Pitch": pitch, "Yaw": scaled(self.yaw_deg, 100.0, U16_LIMITS) % 36_000.0, **q}


def attitudes_of_truth(w: Floats, x: Floats, y: Floats, z: Floats) -> Attitudes:
    """The attitudes of quaternions that turn forward-left-up to east-north-up, as truth has them.

    In ArduPilot's frames the quaternion is (0, √½, √½, 0) q (0, 1, 0, 0): half turns that exchange the axes.
    """
    half = np.sqrt(0.5)
    q = half * np.stack([w + z, x + y, x - y, w - z], axis=1)
    return _attitudes(np.where(q[:, :1] < 0.0, -q, q))


def attitudes_of_angles(roll: Floats, pitch: Floats, yaw: Floats) -> Attitudes:
    """The attitudes of roll, pitch and yaw in radians (Quaternion::from_euler of libraries/AP_Math/quaternion.cpp)."""
    (cr, sr), (cp, sp), (cy, sy) = ((np.cos(angle / 2.0), np.sin(angle / 2.0)) for angle in (roll, pitch, yaw))
    parts = [cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy,
             cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy]  # fmt: skip
    q = np.stack(parts, axis=1)
    return Attitudes(
        np.degrees(roll), np.degrees(pitch), np.degrees(yaw) % 360.0, np.where(q[:, :1] < 0.0, -q, q)
    )  # fmt: skip


def _attitudes(q: Floats) -> Attitudes:
    """The angles of quaternions in ArduPilot's frames (Quaternion::get_euler_roll and the like)."""
    w, x, y, z = q.T
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return Attitudes(np.degrees(roll), np.degrees(pitch), np.degrees(yaw) % 360.0, q)


class HeldValues:
    """The newest values of each aircraft before some times, as long as they are not older than `max_age_ns`."""

    def __init__(self, width: int, max_age_ns: int) -> None:
        self._held: dict[int, tuple[Ints, Floats]] = {}
        self._width, self._max_age_ns = width, max_age_ns

    def add(self, vehicle: Ints, time_ns: Ints, values: Floats) -> None:
        """Add (n, width) values, each at its time."""
        for number in np.unique(vehicle).tolist():
            mine = vehicle == number
            times, rows = time_ns[mine], values[mine]
            if number in self._held:
                old_times, old_rows = self._held[number]
                times, rows = np.concatenate([old_times, times]), np.concatenate([old_rows, rows])
            order = np.argsort(times, kind="stable")
            self._held[number] = times[order], rows[order]

    def find(self, vehicle: Ints, time_ns: Ints) -> Floats:
        """(n, width) the values at some times; not a number where there are none that are new enough."""
        found = np.full((len(time_ns), self._width), np.nan)
        for number in np.unique(vehicle).tolist():
            if number not in self._held:
                continue
            mine = np.flatnonzero(vehicle == number)
            times, rows = self._held[number]
            place = np.searchsorted(times, time_ns[mine], side="right") - 1
            known = (place >= 0) & (time_ns[mine] - times[place] <= self._max_age_ns)
            found[mine[known]] = rows[place[known]]
        return found

    def forget(self) -> None:
        """Keep the last value of each aircraft alone: no earlier time will be asked for."""
        self._held = {number: (times[-1:], rows[-1:]) for number, (times, rows) in self._held.items()}
