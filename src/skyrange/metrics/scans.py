"""Scans of a run as points: what sensors measured, what companions received, what pulses met, and what is forged.

A scan has n pulses or pixels, of which m returned a distance. Points are from the sensor, in metres, in the frame of
its base (forward, left, up of the aircraft, or of its level gimbal) when each pulse was fired; or in local coordinates
(east, north, up).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from skyrange.assembly.optics import read_sensors
from skyrange.codec.range_scans import RangeScan, unpack_scan
from skyrange.core.arrays import Floats
from skyrange.core.errors import DecodeError, InputError
from skyrange.core.files import MAX_RECORD_BYTES, read_input
from skyrange.core.ids import FrameId, link_name
from skyrange.core.time import Time
from skyrange.optics.mounted_sensors import MountedSensor, list_pulses
from skyrange.optics.scanner import ENDPOINT
from skyrange.optics.sensor_models import DepthCameraModel
from skyrange.optics.sensor_poses import SensorPose, make_pulse_rays
from skyrange.record.read.run import RunRecord

SCENARIO: Final = "scenario.toml"
_FRAME: Final = ("link", "direction", "sender", "serial", "fate", "arrived_ns")
_POSITION: Final = ("east_m", "north_m", "up_m")
_VELOCITY: Final = ("vel_east_mps", "vel_north_mps", "vel_up_mps")
_ATTITUDE: Final = ("qw", "qx", "qy", "qz")
_RATES: Final = ("rate_x_radps", "rate_y_radps", "rate_z_radps")
Attitude = Literal["estimated", "true"]


@dataclass(frozen=True, slots=True)
class Scan:
    """One scan of a sensor, as measured or as received; arrays have an entry for each of n pulses or pixels."""

    sensor: MountedSensor
    number: int
    sent_ns: Time
    start_ns: Time
    pose: SensorPose
    """True motion of the aircraft at the start; the attitude and the rates are those of the sensor's base."""
    estimate: Floats
    """(4,) the attitude in the scan: quaternion from the base to local, w first."""
    resolution_m: float
    steps: NDArray[np.uint16]
    """(n,) distance, or depth along the axis of a camera; 0 is none."""
    kind: NDArray[np.uint8] | None
    """(n,) truth: 0 nothing, 1 the ground, 2 a building, 3 an aircraft; None for a scan that no sensor made."""
    row: NDArray[np.int32] | None
    """(n,) truth: which building of `RunRecord.city`, or which of `aircraft`; -1 for others."""
    is_false: NDArray[np.bool_] | None
    """(n,) truth: whether the distance is noise."""
    is_forged: NDArray[np.bool_] | None
    """(n,) truth: whether the distance is that of a false echo of an attack or a fault."""
    aircraft: tuple[str, ...] = ()
    received_ns: Time | None = None
    """When the companion received it; None for a scan as measured."""
    forged: NDArray[np.bool_] | None = None
    """(n,) of a received scan, which distances are not those of true light: those that the sensor did not send (all of
    them if the scan is no sensor's, or if its attitude, resolution, time or number was altered), and false echoes."""

    @property
    def returns(self) -> NDArray[np.bool_]:
        """(n,) which pulses or pixels have a distance: m of them."""
        found: NDArray[np.bool_] = self.steps > 0
        return found

    @property
    def distance_m(self) -> Floats:
        """(n,) along each ray; 0 for none."""
        distance: Floats = self.steps.astype(np.float64) * self.resolution_m
        if isinstance(self.sensor.model, DepthCameraModel):
            distance = distance / list_pulses(self.sensor.model.pattern, 0).direction[:, 0]
        return distance

    def points_in_base(self) -> Floats:
        """(m, 3) the points from the sensor, forward, left and up of its base."""
        direction = self.sensor.list_rays(self.number).direction
        points: Floats = (direction * self.distance_m[:, np.newaxis])[self.returns]
        return points

    def points(self, attitude: Attitude = "estimated") -> Floats:
        """(m, 3) the points in local coordinates: from the true position of the sensor at each pulse, in the attitude
        that the scan has, turned at the true rates, or with "true" in the true one.
        """
        turn = self.estimate if attitude == "estimated" else self.pose.attitude
        rays = make_pulse_rays(self.sensor.list_rays(self.number), self.pose._replace(attitude=turn))
        points: Floats = (rays.origin + rays.direction * self.distance_m[:, np.newaxis])[self.returns]
        return points


def list_mounted_sensors(record: RunRecord) -> list[MountedSensor]:
    """The sensors of a run, by the scenario in its folder. Raises `InputError` if that is missing or damaged."""
    who = str(record.path)
    data = read_input(record.path / SCENARIO, who, SCENARIO, max_bytes=MAX_RECORD_BYTES)
    airframes = {str(row["id"]): str(row["airframe"]) for row in record.manifest.get("vehicles") or []}
    return read_sensors(data, airframes, who)


def read_scans(record: RunRecord, vehicle: str | None = None, sensor: str | None = None) -> Iterator[Scan]:
    """The scans of a run as measured, in the order sent, one at a time: all, or those of a vehicle or a sensor's id.

    Raises `InputError` for a run whose level keeps none, and for a damaged table.
    """
    record.tables.require("scans")
    sensors = {(mounted.vehicle, mounted.id): mounted for mounted in list_mounted_sensors(record)}
    for row in read_rows(record):
        if vehicle in (None, row["vehicle"]) and sensor in (None, row["sensor"]):
            yield make_scan(record, row, sensors)


def read_received_scans(record: RunRecord, vehicle: str | None = None) -> Iterator[Scan]:
    """The scans that companions received, in the order recorded, one at a time: all, or those of a vehicle.

    The truth of a scan is that of the one that the sensor sent, from which it was made by whoever altered, delayed or
    repeated it. A scan that is nobody's has the pose of the last one that the sensor had sent. Frames that are no scan
    of a sensor of the aircraft, with as many distances as that has, are left out. Memory holds the scans that are
    received later again. Raises `InputError` as `read_scans`.
    """
    record.tables.require("scans")
    mounted = list_mounted_sensors(record)
    wanted = [sensor for sensor in mounted if vehicle in (None, sensor.vehicle)]
    links = {link_name("scan", sensor.vehicle): sensor.vehicle for sensor in wanted}
    numbered = {(sensor.vehicle, sensor.number): sensor for sensor in wanted}
    origins = _find_origins(record, links)
    sent = _SentScans(record, {(sensor.vehicle, sensor.id): sensor for sensor in mounted}, Counter(origins.values()))
    for table in record.tables.frames_with_payloads([*_FRAME, "sent_ns"]):
        for frame in _select_links(table, links).to_pylist():
            said = _unpack(frame)
            owner = links[frame["link"]]
            sensor = None if said is None else numbered.get((owner, said.sensor))
            origin = origins.get(_id_of(frame))
            source = None if origin is None else sent.take(origin)  # also of one that is left out, to forget it
            if said is None or sensor is None or len(said.steps) != len(sensor.list_rays(said.scan).delay_s):
                continue
            pose = source or sent.newest(sensor, frame["sent_ns"])
            if pose is not None:
                yield _receive(sensor, said, frame, source, pose)


# --- the table -----------------------------------------------------------------------------------------


def read_rows(record: RunRecord) -> Iterator[dict[str, Any]]:
    """The rows of `scans` one by one, with lists as arrays."""
    for batch in record.batches("scans"):
        yield from plain_rows(batch)


def plain_rows(batch: pa.RecordBatch) -> Iterator[dict[str, Any]]:
    """The rows of a batch of `scans` one by one, with lists as arrays."""
    plain = [name for name, kind in zip(batch.schema.names, batch.schema.types, strict=True) if not _is_array(kind)]
    arrays = [name for name in batch.schema.names if name not in plain]
    for number, row in enumerate(batch.select(plain).to_pylist()):
        values = {name: batch.column(name)[number].values for name in arrays}
        yield row | {name: value.to_numpy(zero_copy_only=False) for name, value in values.items()}


def _is_array(kind: pa.DataType) -> bool:
    return pa.types.is_list(kind) and not pa.types.is_string(kind.value_type)


def make_scan(record: RunRecord, row: Mapping[str, Any], sensors: Mapping[tuple[str, str], MountedSensor]) -> Scan:
    """The scan in a row of the table. Raises `InputError` for one of no sensor of the run."""
    sensor = sensors.get((row["vehicle"], row["sensor"]))
    if sensor is None:
        raise InputError.one(str(record.path), "scans: sensor", row["sensor"], f"a sensor of {row['vehicle']}")
    lengths = {len(row[name]) for name in ("steps", "kind", "row", "is_false", "is_forged")}
    if lengths != {len(sensor.list_rays(row["scan"]).delay_s)}:
        expected = "as many distances as the sensor has pulses"
        raise InputError.one(str(record.path), f"scans: {sensor.name}", f"lengths {sorted(lengths)}", expected)
    position, velocity, attitude, rates = (
        np.array([row[name] for name in names]) for names in (_POSITION, _VELOCITY, _ATTITUDE, _RATES)
    )
    return Scan(
        sensor,
        row["scan"],
        row["time_ns"],
        row["start_ns"],
        SensorPose(position, velocity, attitude, rates, np.array(sensor.place_m)),
        np.array([row[f"estimated_{name}"] for name in _ATTITUDE]),
        row["resolution_m"],
        row["steps"],
        row["kind"],
        row["row"],
        row["is_false"],
        row["is_forged"],
        tuple(row["aircraft"]),
    )


# --- frames --------------------------------------------------------------------------------------------

_Origin = tuple[str, int]
"""A vehicle, and the serial number of the frame that its scanner sent: that of the scan among those of the vehicle."""


def _id_of(frame: Mapping[str, Any]) -> str:
    return str(FrameId(frame["link"], frame["direction"], frame["sender"], frame["serial"]))


def _select_links(table: pa.Table, links: Mapping[str, str]) -> pa.Table:
    """The delivered frames on some links."""
    chosen = pc.and_(
        pc.is_in(table.column("link"), pa.array(list(links), pa.string())),
        pc.equal(table.column("fate"), "delivered"),
    )
    return table.filter(chosen)


def _find_origins(record: RunRecord, links: Mapping[str, str]) -> dict[str, _Origin]:
    """By the id of a delivered frame: the scan that it is made from."""
    parents: dict[str, str | None] = {}
    own: dict[str, _Origin] = {}
    delivered: list[str] = []
    for batch in record.batches("frames", [*_FRAME, "parent"]):
        table = pa.Table.from_batches([batch])
        chosen = pc.is_in(table.column("link"), pa.array(list(links), pa.string()))
        for frame in table.filter(chosen).to_pylist():
            key = _id_of(frame)
            parents[key] = frame["parent"]
            if frame["sender"] == ENDPOINT and frame["parent"] is None:
                own[key] = (links[frame["link"]], frame["serial"])
            if frame["fate"] == "delivered":
                delivered.append(key)
    origins = {}
    for key in delivered:
        first, hops = key, 0
        while first not in own and parents.get(first) is not None and hops < len(parents):
            first, hops = str(parents[first]), hops + 1
        if first in own:
            origins[key] = own[first]
    return origins


class _SentScans:
    """The scans that sensors sent, read as far as they are asked for and kept as long as they are."""

    def __init__(
        self, record: RunRecord, sensors: Mapping[tuple[str, str], MountedSensor], uses: Counter[_Origin]
    ) -> None:
        self._record, self._sensors, self._uses = record, sensors, uses
        self._rows = read_rows(record)
        self._ahead: Scan | None = None
        self._counts: Counter[str] = Counter()
        self._held: dict[_Origin, Scan] = {}
        self._newest: dict[str, Scan] = {}

    def _read(self, until_ns: Time | None = None) -> bool:
        """Read one more scan; false if there is none, or none that was sent by then."""
        if self._ahead is None:
            row = next(self._rows, None)
            if row is None:
                return False
            self._ahead = make_scan(self._record, row, self._sensors)
        scan = self._ahead
        if until_ns is not None and scan.sent_ns > until_ns:
            return False
        self._ahead = None
        origin = (scan.sensor.vehicle, self._counts[scan.sensor.vehicle])
        self._counts[scan.sensor.vehicle] += 1
        self._newest[scan.sensor.name] = scan
        if self._uses[origin]:
            self._held[origin] = scan
        return True

    def take(self, origin: _Origin) -> Scan | None:
        """A scan, one of the times that it is asked for; None if a crash has lost it."""
        while origin not in self._held:
            if not self._read():
                return None
        self._uses[origin] -= 1
        return self._held[origin] if self._uses[origin] else self._held.pop(origin)

    def newest(self, sensor: MountedSensor, until_ns: Time) -> Scan | None:
        """The last scan that a sensor had sent by a time, or one that was read since."""
        while self._read(until_ns):
            pass
        return self._newest.get(sensor.name)


def _unpack(frame: Mapping[str, Any]) -> RangeScan | None:
    try:
        return unpack_scan(frame["payload"])
    except DecodeError:
        return None


def _receive(sensor: MountedSensor, said: RangeScan, frame: Mapping[str, Any], source: Scan | None, pose: Scan) -> Scan:
    same = source is not None and _is_same(source, said)
    forged = np.ones(len(said.steps), dtype=np.bool_) if source is None or not same else said.steps != source.steps
    has_truth = source is not None and source.sensor.name == sensor.name
    if has_truth and pose.is_forged is not None:
        forged = forged | pose.is_forged
    return Scan(
        sensor,
        said.scan,
        frame["sent_ns"],
        said.start_ns,
        pose.pose,
        np.array(said.attitude),
        said.resolution_m,
        said.steps,
        pose.kind if has_truth else None,
        pose.row if has_truth else None,
        pose.is_false if has_truth else None,
        pose.is_forged if has_truth else None,
        pose.aircraft if has_truth else (),
        frame["arrived_ns"],
        forged,
    )


def _is_same(source: Scan, said: RangeScan) -> bool:
    """Whether all but the distances of a scan is what the sensor sent: numbers are floats in a frame."""
    return (
        (source.sensor.number, source.number % 2**32, source.start_ns) == (said.sensor, said.scan, said.start_ns)
        and round(source.resolution_m * 1e6) == round(said.resolution_m * 1e6)
        and bool((np.abs(source.estimate - np.array(said.attitude)) < _ROUNDED).all())
    )


_ROUNDED: Final = 2e-7
"""By how much a float of 32 bits may differ from a number up to 1, with some for the length of the quaternion."""
