"""Range reports: what a companion tells its autopilot of its sensors, as DISTANCE_SENSOR and OBSTACLE_DISTANCE.

After obstacle-avoidance companions, and what ArduPilot takes (AP_Proximity_MAV.cpp, AP_RangeFinder_MAVLink.cpp):
centimetres, `max_distance` + 1 for "nothing met", 65535 for "not looked". At most ten messages a second from a sensor.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, Literal, NamedTuple

from skyrange.codec.mavlink import Message, Packer
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.signing import SignedConnection, SignedConnections, SigningKey
from skyrange.codec.range_scans import RangeScan
from skyrange.contracts.mailboxes import Inbox, Outbox
from skyrange.core.ids import FrameId, Port, endpoint, link_name
from skyrange.core.time import NS_PER_MS, NS_PER_US, Time
from skyrange.optics.mounted_sensors import MountedSensor
from skyrange.optics.scan_patterns import SingleBeam
from skyrange.vehicle.companion.obstacle_sectors import SECTOR_DEG, ObstacleSectors, find_obstacles, measure_beam
from skyrange.vehicle.sight.scan_reader import ScanReader

ReportKind = Literal["distance", "obstacles"]
COMPONENT: Final = int(mav.MAV_COMP_ID_OBSTACLE_AVOIDANCE)
"""196: a component of the companion beside 191, with sequence numbers of its own."""
PERIOD_NS: Final[Time] = 100 * NS_PER_MS
"""Least time between two messages about one sensor. ArduPilot forgets a rangefinder after 500 ms and an obstacle
after 1000 ms (AP_RANGEFINDER_MAVLINK_TIMEOUT_MS, PROXIMITY_FACE_RESET_MS)."""
LINK_ID: Final = 0
"""Link id of its signatures, as of the companion's others."""
_NO_VALUE: Final = 65535
_MAX_CM: Final = 65533
_DOWN: Final = int(mav.MAV_SENSOR_ROTATION_PITCH_270)
_UP: Final = int(mav.MAV_SENSOR_ROTATION_PITCH_90)
_UNKNOWN_COVARIANCE: Final = 255


class ReportedSensor(NamedTuple):
    """A sensor whose scans its companion reports to the autopilot, and as what."""

    sensor: MountedSensor
    kind: ReportKind
    system_id: int


def find_orientation(yaw_deg: float, pitch_deg: float) -> int | None:
    """MAV_SENSOR_ORIENTATION of a beam: down, up, or level in a multiple of 45° from the nose; None for others."""
    if abs(pitch_deg) == 90.0:
        return _DOWN if pitch_deg < 0.0 else _UP
    eighths = yaw_deg / 45.0
    return int(eighths) % 8 if pitch_deg == 0.0 and eighths == int(eighths) else None


def can_report(sensor: MountedSensor, kind: ReportKind) -> bool:
    """Whether a sensor can be reported so: a single beam that points along an orientation, or a field of many rays."""
    is_beam = isinstance(sensor.model.pattern, SingleBeam)
    if kind == "obstacles":
        return not is_beam
    return is_beam and find_orientation(sensor.yaw_deg, sensor.pitch_deg) is not None


class RangeReports:
    """The reports of many aircraft, as a part of the agent at their companions' endpoints. Deep-copyable.

    `ports` are those on which scans arrive, in the order of their aircraft; it sends on each aircraft's `log`.
    """

    def __init__(self, reported: Sequence[ReportedSensor]) -> None:
        vehicles = list(dict.fromkeys(one.sensor.vehicle for one in reported))
        self.vehicles: Sequence[str] = vehicles
        self.ports: Sequence[Port] = [Port(endpoint(v, "companion"), link_name("scan", v)) for v in vehicles]
        self.originates: Sequence[Port] = [Port(endpoint(v, "companion"), link_name("log", v)) for v in vehicles]
        self._rows = {vehicle: row for row, vehicle in enumerate(vehicles)}
        self._reported = {(vehicles.index(one.sensor.vehicle), one.sensor.number): one for one in reported}
        self._packers = {key: Packer(one.system_id, COMPONENT) for key, one in self._reported.items()}
        for row in range(len(vehicles)):  # one component of an aircraft has one sequence
            of_row = [key for key in self._packers if key[0] == row]
            self._packers.update(dict.fromkeys(of_row, self._packers[of_row[0]]))
        self._sent_ns = dict.fromkeys(self._reported, -PERIOD_NS)

    def receive(self, now: Time, vehicle: str, scan: RangeScan, ref: FrameId, out: Outbox) -> None:
        """Report a scan of a sensor of an aircraft, if that is reported and it is time."""
        row = self._rows.get(vehicle, -1)
        key = (row, scan.sensor)
        if key not in self._reported or now - self._sent_ns[key] < PERIOD_NS:
            return
        self._sent_ns[key] = now
        message = make_report(scan, self._reported[key])
        out.send(self.originates[row], self._packers[key].pack(message), (ref,))


def make_report(scan: RangeScan, reported: ReportedSensor) -> Message:
    """The message about a scan of the sensor."""
    if reported.kind == "obstacles":
        return _make_obstacle_distance(scan, reported.sensor, find_obstacles(scan, reported.sensor))
    return _make_distance_sensor(scan, reported.sensor, measure_beam(scan))


def _to_cm(distance_m: float) -> int:
    return min(round(100.0 * distance_m), _MAX_CM)


def _make_obstacle_distance(scan: RangeScan, sensor: MountedSensor, found: ObstacleSectors) -> Message:
    near_cm, far_cm = _to_cm(sensor.model.near_m), _to_cm(sensor.model.reach_m)
    distances = []
    for distance_m, looked in zip(found.distance_m.tolist(), found.looked.tolist(), strict=True):
        if distance_m <= sensor.model.reach_m:
            distances.append(max(_to_cm(distance_m), near_cm))
        else:
            distances.append(far_cm + 1 if looked else _NO_VALUE)
    return mav.MAVLink_obstacle_distance_message(
        max(scan.start_ns, 0) // NS_PER_US,
        mav.MAV_DISTANCE_SENSOR_LASER,
        distances,
        0,
        near_cm,
        far_cm,
        SECTOR_DEG,
        0.0,
        mav.MAV_FRAME_BODY_FRD,
    )


def _make_distance_sensor(scan: RangeScan, sensor: MountedSensor, distance_m: float | None) -> Message:
    near_cm, far_cm = _to_cm(sensor.model.near_m), _to_cm(sensor.model.reach_m)
    orientation = find_orientation(sensor.yaw_deg, sensor.pitch_deg)
    if orientation is None:
        raise ValueError(f"{sensor.name} points in no direction that has an orientation")
    return mav.MAVLink_distance_sensor_message(
        max(scan.start_ns, 0) // NS_PER_MS % 2**32,
        near_cm,
        far_cm,
        far_cm + 1 if distance_m is None else _to_cm(distance_m),
        mav.MAV_DISTANCE_SENSOR_LASER,
        sensor.number,
        orientation,
        _UNKNOWN_COVARIANCE,
    )


class SensorCompanion:
    """The agent of companions that only report their sensors, in scenarios without a radio medium.

    Contract: `contracts.components.OriginatingRouter`. Deep copies continue alike.
    """

    service_ns: Time = 50 * NS_PER_MS
    """As of `Companion`."""

    def __init__(self, name: str, reports: RangeReports, scans: ScanReader, keys: Sequence[SigningKey | None]) -> None:
        """`keys` (vehicles,) are those of the autopilots whose MAVLink is signed."""
        self.name = name
        self._scans = scans
        self.reports = reports
        self.ports: Sequence[Port] = reports.ports
        self.originates: Sequence[Port] = reports.originates
        self._vehicles = dict(zip(self.ports, reports.vehicles, strict=True))
        signed = [
            SignedConnection(vehicle, key, scan, log)
            for vehicle, key, scan, log in zip(reports.vehicles, keys, self.ports, self.originates, strict=True)
            if key is not None
        ]
        self._signed = SignedConnections(self.ports, signed, LINK_ID, "event.signature_refused") if signed else None

    def next_wakeup(self) -> Time | None:
        """It acts on mail alone."""
        return None

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        """Report the scans that arrived."""
        out = Outbox()
        for arrival in inbox:
            vehicle = self._vehicles[arrival.port]
            scan = self._scans.read_or_note(vehicle, arrival.payload, arrival.ref, out)
            if scan is not None:
                self.reports.receive(now, vehicle, scan, arrival.ref, out)
        if self._signed is not None:
            self._signed.sign_outbox(now, out)
        return out
