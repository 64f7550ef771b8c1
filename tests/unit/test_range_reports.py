"""Reports of scans to the autopilot: sectors around the nose whatever the attitude, beams, pace, and hostile bytes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyrange.codec.mavlink import decode
from skyrange.codec.range_scans import DEPTH, LIDAR, RangeScan, pack_scan
from skyrange.contracts.mailboxes import Outbox
from skyrange.core.arrays import Floats
from skyrange.core.errors import DecodeError
from skyrange.core.ids import FrameId
from skyrange.core.time import NS_PER_MS
from skyrange.optics.mounted_sensors import MountedSensor, check_scan, list_pulses
from skyrange.optics.scan_patterns import RotatingPattern, SingleBeam
from skyrange.optics.sensor_models import D435, LIDAR_LITE_V3HP, MID_360, VLP_16
from skyrange.vehicle.companion.obstacle_sectors import SECTORS, find_obstacles
from skyrange.vehicle.companion.range_reports import (
    COMPONENT,
    RangeReports,
    ReportedSensor,
    can_report,
    find_orientation,
    make_report,
)
from skyrange.vehicle.sight.scan_reader import ScanReader

REF = FrameId("scan:blue/b1", "fwd", "oracle", 0)
TOP = (0.0, 0.0, 0.3)
angle = st.floats(-math.pi, math.pi)
lean = st.floats(-0.08, 0.08)


def turn(roll: float, pitch: float, yaw: float) -> Floats:
    """(w, x, y, z) of a yaw from east, a pitch and a roll, by their half angles."""
    cr, sr, cp, sp = math.cos(roll / 2), math.sin(roll / 2), math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    w, x = cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy
    return np.array([w, x, cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy])


def matrix(quaternion: Floats) -> Floats:
    w, x, y, z = quaternion
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


def look(sensor: MountedSensor, attitude: Floats, wall: tuple[float, float]) -> RangeScan:
    """A perfect scan of an upright wall at a distance from the aircraft, in a direction from east."""
    away, bearing = wall
    rotation = matrix(attitude)
    direction = sensor.list_rays(0).direction @ rotation.T
    normal = np.array([math.cos(bearing), math.sin(bearing), 0.0])
    towards = direction @ normal
    start = rotation @ np.array(sensor.place_m)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = np.where(towards > 0.02, (away - start @ normal) / towards, np.inf)
    if sensor.kind == DEPTH:
        distance = distance * list_pulses(sensor.model.pattern, 0).direction[:, 0]
    met = (distance >= sensor.model.near_m) & (distance <= sensor.model.reach_m)
    steps = np.where(met, np.round(np.where(met, distance, 0.0) / sensor.model.resolution_m), 0)
    parts = tuple(float(part) for part in attitude)
    return RangeScan(sensor.kind, 0, 0, sensor.model.resolution_m, 0, parts, steps.astype(np.uint16))  # type: ignore[arg-type]


@given(roll=lean, pitch=lean, yaw=angle, side=angle, away=st.floats(3.0, 12.0))
def test_a_wall_is_where_it_is_whatever_the_attitude(
    roll: float, pitch: float, yaw: float, side: float, away: float
) -> None:
    sensor = MountedSensor("blue/b1", "mid-360", 0, MID_360, TOP)
    found = find_obstacles(look(sensor, turn(roll, pitch, yaw), (away, side)), sensor)
    assert found.distance_m.min() == pytest.approx(away, rel=0.01, abs=0.02)
    clockwise = math.degrees(yaw - side) % 360.0
    nearest = 5.0 * int(found.distance_m.argmin())
    assert abs((nearest - clockwise + 180.0) % 360.0 - 180.0) < 8.0
    behind = round((clockwise + 180.0) / 5.0) % SECTORS
    assert not np.isfinite(found.distance_m[behind])


@given(yaw=angle, mount=st.sampled_from([0.0, 90.0, -45.0]))
def test_a_camera_says_where_it_did_not_look(yaw: float, mount: float) -> None:
    sensor = MountedSensor("blue/b1", "d435", 0, D435, TOP, yaw_deg=mount)
    ahead = yaw - math.radians(mount)
    found = find_obstacles(look(sensor, turn(0.0, 0.0, yaw), (6.0, ahead)), sensor)
    offset = (5.0 * np.arange(SECTORS) - mount + 180.0) % 360.0 - 180.0
    assert found.looked[np.abs(offset) < 34.0].all()
    assert not found.looked[np.abs(offset) > 41.0].any()
    assert found.distance_m[np.abs(offset) < 20.0] == pytest.approx(
        6.0 / np.cos(np.radians(np.abs(offset[np.abs(offset) < 20.0]) - 2.5).clip(0.0)), abs=0.1
    )


def test_neither_the_ground_nor_a_single_return_is_an_obstacle() -> None:
    """On the ground, and 30 false returns in the air."""
    sensor = MountedSensor("blue/b1", "vlp-16", 0, VLP_16, TOP)
    direction = sensor.list_rays(0).direction
    down = direction[:, 2] < -0.01
    ground = np.where(down, 0.3 / np.where(down, -direction[:, 2], 1.0), 0.0)
    steps = np.where(ground <= 100.0, ground / 0.002, 0.0).astype(np.uint16)
    level = (1.0, 0.0, 0.0, 0.0)
    assert not np.isfinite(find_obstacles(RangeScan(LIDAR, 0, 0, 0.002, 0, level, steps), sensor).distance_m).any()
    some = np.zeros(len(direction), dtype=np.uint16)
    some[:: len(direction) // 30] = np.arange(len(some[:: len(direction) // 30])) * 1500 + 1000
    assert not np.isfinite(find_obstacles(RangeScan(LIDAR, 0, 0, 0.002, 0, level, some), sensor).distance_m).any()


def test_orientations_of_beams() -> None:
    assert find_orientation(0.0, -90.0) == 25
    assert find_orientation(123.0, 90.0) == 24
    assert [find_orientation(45.0 * eighth, 0.0) for eighth in range(-1, 9)] == [7, 0, 1, 2, 3, 4, 5, 6, 7, 0]
    assert find_orientation(10.0, 0.0) is None
    assert find_orientation(0.0, -45.0) is None
    lite = MountedSensor("v", "l", 0, LIDAR_LITE_V3HP, TOP, pitch_deg=-90.0)
    assert can_report(lite, "distance")
    assert not can_report(lite, "obstacles")
    assert not can_report(MountedSensor("v", "m", 0, MID_360, TOP), "distance")


def beam(steps: int, **changes: Any) -> RangeScan:
    scan = RangeScan(LIDAR, 0, 0, 0.01, 5 * NS_PER_MS, (1.0, 0.0, 0.0, 0.0), np.array([steps], dtype=np.uint16))
    return scan._replace(**changes)


LITE = ReportedSensor(MountedSensor("blue/b1", "lidar-lite", 0, LIDAR_LITE_V3HP, TOP, pitch_deg=-90.0), "distance", 7)


def test_a_beam_is_told_in_centimetres_and_its_silence_as_beyond_its_range() -> None:
    message = make_report(beam(1234), LITE)
    assert (message.current_distance, message.min_distance, message.max_distance) == (1234, 5, 4000)
    assert (message.orientation, message.time_boot_ms, message.covariance) == (25, 5, 255)
    assert make_report(beam(0), LITE).current_distance == 4001


def test_reports_keep_their_pace() -> None:
    reports = RangeReports([LITE])
    out = Outbox()
    for tick in range(100):  # a scan each 10 ms
        reports.receive(tick * 10 * NS_PER_MS, "blue/b1", beam(500), REF, out)
    messages = [decode(departure.payload) for departure in out.departures]
    assert len(messages) == 10
    assert {(m.get_srcSystem(), m.get_srcComponent()) for m in messages} == {(7, COMPONENT)}
    assert [m.get_seq() for m in messages] == list(range(10))
    assert {departure.causes for departure in out.departures} == {(REF,)}
    out = Outbox()
    reports.receive(10**11, "blue/other", beam(5), REF, out)
    assert not out.departures
    reports.receive(10**11, "blue/b1", beam(5, start_ns=-(2**63)), REF, out)
    assert len(out.departures) == 1


def test_hostile_scans_are_counted_and_left_out() -> None:
    reader = ScanReader({"blue/b1": [LITE.sensor]})
    out = Outbox()
    wrong = np.array([1, 2], dtype=np.uint16)
    scans = [beam(5, kind=DEPTH), beam(5)._replace(steps=wrong), beam(5, resolution_m=0.02), beam(5, sensor=3)]
    for payload in [b"", b"RS", *map(pack_scan, scans)]:
        assert reader.read_or_note("blue/b1", payload, REF, out) is None
        assert reader.read("blue/b1", payload) is None
    assert [(note.kind, note.data["count"]) for note in out.notes] == [("event.bad_scan", count) for count in (1, 2, 4)]
    assert reader.read("blue/b2", pack_scan(beam(5))) is None, "of an aircraft without sensors"
    read = reader.read_or_note("blue/b1", pack_scan(beam(5)), REF, out)
    assert read is not None
    assert read.steps.tolist() == [5]
    assert len(out.notes) == 3


def test_a_scan_of_another_pattern_is_refused() -> None:
    few = MountedSensor("v", "s", 0, VLP_16, TOP)
    other = RotatingPattern((0.0,), 1e-3, 1e-3, 10.0)
    scan = RangeScan(LIDAR, 0, 0, 0.002, 0, (1.0, 0.0, 0.0, 0.0), np.zeros(other.sequences, dtype=np.uint16))
    with pytest.raises(DecodeError):
        check_scan(scan, few)
    assert isinstance(LIDAR_LITE_V3HP.pattern, SingleBeam)
