"""Scans in MCAP files: what the mcap package reads back is what companions received, in the schemas of the file."""

from __future__ import annotations

import base64
import json
from typing import Any

import jsonschema
import numpy as np
import pytest

import skyrange
from skyrange.analysis import export_mcap, read_received_scans
from skyrange.export.scan_messages import place_sensor
from skyrange.metrics.time_series import start_utc_ns
from skyrange.optics.mounted_sensors import list_pulses, turn_mount
from skyrange.record import RunRecord
from skyrange.scenario.model.scenario import Scenario

reader = pytest.importorskip("mcap.reader")

SEEN = """
name = "seen"
seed = 3
duration_s = 6
origin = [40.76, -73.98]
[[operators]]
id = "blue"
[[operators.vehicles]]
start = [0, 0, 90]
plan = { square = { side_m = 30, alt_m = 20 } }
sensors = [
    { model = "vlp-16", azimuths = 180 },
    { model = "d435", pixels = [32, 24], yaw_deg = 30, pitch_deg = -60, rate_hz = 5 },
]
[[attacks]]
id = "forger"
kind = "link.corrupt"
start_s = 4
stop_s = 5
params = { links = ["scan:blue/b1"], first_byte = 44, bit_error_rate = 0.01 }
"""
POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("kind", "u1"), ("forged", "u1"), ("rgba", "u1", 4)])


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RunRecord:
    record = skyrange.run(Scenario.from_toml(SEEN), tmp_path_factory.mktemp("seen") / "run")
    export_mcap(record)
    return record


@pytest.fixture(scope="module")
def messages(run: RunRecord) -> dict[str, list[tuple[int, dict[str, Any]]]]:
    """Of each topic, with their times; each is checked against the schema in the file."""
    found: dict[str, list[tuple[int, dict[str, Any]]]] = {}
    last = 0
    with (run.path / "run.mcap").open("rb") as file:
        for schema, channel, message in reader.make_reader(file).iter_messages(log_time_order=False):
            assert message.log_time >= last
            last = message.log_time
            value = json.loads(message.data)
            if channel.topic.startswith("/sensors/"):
                jsonschema.validate(value, json.loads(schema.data))
            found.setdefault(channel.topic, []).append((message.log_time, value))
    return found


def test_points_are_those_that_the_companion_received(run: RunRecord, messages: dict[str, Any]) -> None:
    scans = [scan for scan in read_received_scans(run) if scan.sensor.id == "vlp-16"]
    clouds = messages["/sensors/blue/b1/vlp-16/points"]
    assert len(clouds) == len(scans) > 50
    forged = 0
    for (at, cloud), scan in zip(clouds, scans, strict=True):
        assert scan.received_ns is not None
        assert scan.forged is not None
        assert at == start_utc_ns(run) + scan.received_ns
        assert cloud["point_stride"] == POINT.itemsize
        assert [field["offset"] for field in cloud["fields"]] == [0, 4, 8, 12, 13, 14, 15, 16, 17]
        points = np.frombuffer(base64.b64decode(cloud["data"]), dtype=POINT)
        assert np.allclose(np.column_stack([points["x"], points["y"], points["z"]]), scan.points(), atol=1e-4)
        assert points["forged"].tolist() == scan.forged[scan.returns].tolist()
        forged += int(points["forged"].sum())
    assert forged > 10


def test_a_depth_image_and_its_calibration_give_the_points_of_the_camera(
    run: RunRecord, messages: dict[str, Any]
) -> None:
    scans = [scan for scan in read_received_scans(run) if scan.sensor.id == "d435"]
    images = messages["/sensors/blue/b1/d435/depth"]
    (_, calibration), *_ = messages["/sensors/blue/b1/d435/calibration"]
    frames = [t for _, m in messages["/tf"] for t in m["transforms"] if t["child_frame_id"] == "blue/b1/d435"]
    assert len(images) == len(scans) == len(frames) > 25
    for (_, image), scan, frame in zip(images, scans, frames, strict=True):
        depth = (
            np.frombuffer(base64.b64decode(image["data"]), dtype="<u2").reshape(image["height"], image["width"]) / 1e3
        )
        row, column = np.nonzero(depth)
        (fx, _, cx, _, fy, cy, *_) = calibration["K"]
        z = depth[row, column]
        seen = np.column_stack([(column - cx) / fx * z, (row - cy) / fy * z, z])
        turn = matrix(*(frame["rotation"][part] for part in "wxyz"))
        points = seen @ turn.T + [frame["translation"][axis] for axis in "xyz"]
        away = np.linalg.norm(points - scan.points(), axis=1)  # which are those of the image in the attitude sent
        assert (away < 0.02 + 1e-4 * z).all()


def test_the_frame_of_a_lidar_is_that_of_its_pulses(run: RunRecord) -> None:
    scan = next(scan for scan in read_received_scans(run) if scan.sensor.id == "d435")
    _, turn = place_sensor(scan)
    ahead = list_pulses(scan.sensor.model.pattern, 0).direction
    base = matrix(*scan.estimate.tolist())
    optical = np.column_stack([-ahead[:, 1], -ahead[:, 2], ahead[:, 0]])
    assert np.allclose(optical @ matrix(*turn).T, ahead @ turn_mount(30, -60).T @ base.T, atol=1e-9)


def matrix(w: float, x: float, y: float, z: float) -> Any:
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
