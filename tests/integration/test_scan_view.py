"""What the viewer is told of scans: the newest of each sensor, thinned evenly, with the field that encloses them."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

import skyrange
from skyrange.analysis import read_scans
from skyrange.record import RunRecord
from skyrange.runtime.run import Run
from skyrange.scenario.model.scenario import Scenario
from skyrange.view import scan_queries
from skyrange.view.flying import FlightView
from skyrange.view.scan_index import ScanIndex
from skyrange.view.scan_queries import ScanQueries, draw_field
from skyrange.view.server import LiveStream

VIEWED = """
name = "viewed"
seed = 4
duration_s = 8
origin = [40.76, -73.98]
[[operators]]
id = "blue"
[[operators.vehicles]]
start = [0, 0, 90]
plan = { square = { side_m = 30, alt_m = 20 } }
sensors = [
    { model = "vlp-16", azimuths = 90 },
    { model = "d435", pixels = [16, 12], yaw_deg = 20, pitch_deg = -70, rate_hz = 5 },
    { model = "lidar-lite-v3hp", pitch_deg = -90, rate_hz = 10 },
    { model = "mid-360", pulses = 500 },
]
[[operators.vehicles]]
start = [8, 0]
plan = { square = { side_m = 30, alt_m = 20 } }
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RunRecord:
    return skyrange.run(Scenario.from_toml(VIEWED), tmp_path_factory.mktemp("viewed") / "run")


@pytest.mark.parametrize("until_s", [0.05, 0.1, 2.31, 4.9, 1.0])
def test_the_newest_scans_are_told(run: RunRecord, until_s: float) -> None:
    told = ScanQueries([run]).read_scans(0, "blue/b1", until_s)["scans"]
    newest = {scan.sensor.id: scan for scan in read_scans(run, "blue/b1") if scan.sent_ns <= until_s * 1e9}
    assert {row["sensor"]: row["t"] for row in told} == {id: scan.sent_ns / 1e9 for id, scan in newest.items()}
    for row in told:
        scan = newest[row["sensor"]]
        assert np.allclose(np.array(row["points"]).reshape(-1, 3) / 100, scan.points(), atol=0.006)
        assert scan.kind is not None
        assert scan.is_false is not None
        assert row["met"] == np.where(scan.is_false, 4, scan.kind)[scan.returns].tolist()


def test_an_aircraft_without_sensors_and_a_time_long_after_have_none(run: RunRecord) -> None:
    queries = ScanQueries([run])
    assert queries.read_scans(0, "blue/b2", 3.0) == {"scans": []}
    assert queries.read_scans(0, "blue/b1", 20.0) == {"scans": []}


def test_thinning_leaves_points_of_all_beams(run: RunRecord, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scan_queries, "MAX_POINTS", 300)
    (row, *_) = ScanQueries([run]).read_scans(0, "blue/b1", 4.0)["scans"]
    assert row["of"] > 600
    assert 150 < len(row["met"]) <= 300
    scan = next(scan for scan in ScanIndex(run).newest("blue/b1", 4_000_000_000) if scan.sensor.id == "vlp-16")
    heights = np.unique(
        np.round(scan.sensor.list_rays(0).direction[scan.returns][:: row["of"] // len(row["met"]), 2], 3)
    )
    assert len(heights) >= len(np.unique(np.round(scan.sensor.list_rays(0).direction[scan.returns][:, 2], 3))) - 1


def test_the_points_of_a_camera_are_inside_its_field(run: RunRecord) -> None:
    checked = 0
    for scan in read_scans(run, "blue/b1", "d435"):
        rectangle, *edges = draw_field(scan)
        eye = edges[0][0]
        points = scan.points()
        for a, b in itertools.pairwise(rectangle):
            inward = np.cross(a - eye, b - eye)
            inward *= np.sign(inward @ (rectangle[:-1].mean(axis=0) - eye))
            assert (((points - eye) @ inward) > -1e-6).all()
        checked += len(points)
    assert checked > 1000


def test_while_a_run_flies_the_newest_scans_are_told(run: RunRecord, tmp_path: Path) -> None:
    scenario = Scenario.from_toml(VIEWED)
    view = FlightView(scenario, LiveStream(), every_s=0.0)
    assert view.scans.read_scans(0, "blue/b1", 1.0) == {"scans": []}
    flight = Run.start(scenario, tmp_path / "run")
    view.start(flight)
    recorded = ScanQueries([run])
    for until_s in (2.0, 5.3):
        flight.advance(until_s)
        flight.recorder.flush()
        assert view.scans.read_scans(0, "blue/b1", until_s) == recorded.read_scans(0, "blue/b1", until_s)
    assert len(recorded.read_scans(0, "blue/b1", 5.3)["scans"]) == 4
    flight.finish("interrupted")
    assert view.fault is None
