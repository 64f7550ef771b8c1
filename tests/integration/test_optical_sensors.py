"""Sensors of a scenario in flight: scans on their links, the surfaces in them, chance, and clear errors before."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import skyrange
from skyrange.assembly.build import build
from skyrange.codec.range_scans import DEPTH, LIDAR, RangeScan, unpack_scan
from skyrange.contracts.frames import Frame
from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_MS, NS_PER_S
from skyrange.kernel import Kernel
from skyrange.optics.mounted_sensors import list_pulses
from skyrange.record import RunRecord, load
from skyrange.runtime.cores.division import Division
from skyrange.runtime.cores.run import run_on_cores
from skyrange.scenario.model.optics import MODELS
from skyrange.scenario.model.scenario import Scenario
from skyrange.study.execution.flight import fly_runs
from skyrange.study.execution.plan import PlannedRun

LOOKS = """
name = "looks"
seed = 3
duration_s = 10
origin = [40.76, -73.98]
[[operators]]
id = "blue"
[[operators.vehicles]]
start = [0, 0, 90]
plan = { square = { side_m = 30, alt_m = 20 } }
sensors = [
    { model = "vlp-16", azimuths = 180, noise_m = 0, stabilised = true },
    { model = "d435", pixels = [64, 48], pitch_deg = -90, rate_hz = 5 },
]
[[operators.vehicles]]
start = [6, 0]
plan = { square = { side_m = 30, alt_m = 20 } }
"""


def fly(folder: Path, *changes: str) -> RunRecord:
    return skyrange.run(Scenario.from_toml(LOOKS, changes), folder)


def scans_of(run: RunRecord, link: str = "scan:blue/b1") -> list[tuple[int, RangeScan]]:
    """When each was sent, and the scan."""
    payloads = {row["payload_id"]: row["payload"] for row in run.table("payloads").to_pylist()}
    rows = run.table("frames").to_pylist()
    return [(row["sent_ns"], unpack_scan(payloads[row["payload_id"]])) for row in rows if row["link"] == link]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RunRecord:
    return fly(tmp_path_factory.mktemp("looks") / "run")


def test_each_scan_is_one_frame_that_is_sent_when_it_ends(run: RunRecord) -> None:
    scans = scans_of(run)
    lidar = [(sent, scan) for sent, scan in scans if scan.kind == LIDAR]
    depth = [(sent, scan) for sent, scan in scans if scan.kind == DEPTH]
    assert [scan.scan for _, scan in lidar] == list(range(100))
    assert {scan.start_ns - 100 * NS_PER_MS * scan.scan for _, scan in lidar} == {0}
    assert {sent - scan.start_ns for sent, scan in scans} == {100 * NS_PER_MS}
    assert len(depth) == 50
    assert {len(scan.steps) for _, scan in lidar} == {16 * 180}
    assert {len(scan.steps) for _, scan in depth} == {64 * 48}


def test_a_camera_that_looks_down_measures_the_height(run: RunRecord) -> None:
    truth = run.table("truth").to_pylist()
    heights = {row["time_ns"]: row["up_m"] for row in truth if row["vehicle"] == "blue/b1"}
    checked = 0
    for _, scan in scans_of(run):
        height = heights.get(scan.start_ns)
        if scan.kind == DEPTH and height is not None and 1.0 < height < 6.0:
            depth = scan.steps[scan.steps > 0] * scan.resolution_m
            assert np.median(depth) == pytest.approx(height + 0.05, abs=0.2)
            checked += 1
    assert checked >= 5


def test_a_lidar_sees_the_other_aircraft_where_it_is(run: RunRecord) -> None:
    """Both climb side by side, 6 m apart; the second is ahead, because the first looks east."""
    firing = list_pulses(Scenario.from_toml(LOOKS).operators[0].vehicles[0].sensors[0].make().pattern, 0)
    seen = 0
    for _, scan in scans_of(run):
        if scan.kind != LIDAR or scan.start_ns < 2 * NS_PER_S:
            continue
        ahead = np.degrees(np.arctan2(firing.direction[:, 1], firing.direction[:, 0])) ** 2 < 4.0**2
        distance = scan.steps[ahead] * scan.resolution_m
        level = np.abs(firing.direction[ahead, 2]) < 0.02
        seen += int(((distance > 5.4) & (distance < 6.2) & level).sum())
    assert seen > 50


def test_the_same_seed_gives_the_same_scans_and_another_one_does_not(run: RunRecord, tmp_path: Path) -> None:
    again, other = fly(tmp_path / "again"), fly(tmp_path / "other", "seed=4")
    assert again.manifest["digests"] == run.manifest["digests"]
    assert [s.steps.tolist() for _, s in scans_of(other)] != [s.steps.tolist() for _, s in scans_of(run)]


def test_sensors_alter_nothing_else(run: RunRecord, tmp_path: Path) -> None:
    without = fly(tmp_path / "bare", "operators.blue.vehicles.0.sensors=[]")
    assert without.manifest["digests"]["truth"] == run.manifest["digests"]["truth"]


def test_runs_of_a_batch_have_the_scans_of_runs_alone(run: RunRecord, tmp_path: Path) -> None:
    """Random company: the same scenario with other seeds, and another model of a LiDAR."""
    company = [("seed=9",), (), ("operators.blue.vehicles.0.sensors.0.azimuths=90",)]
    plan = [PlannedRun(str(n), Scenario.from_toml(LOOKS, changes)) for n, changes in enumerate(company)]
    assert not fly_runs(plan, tmp_path).errors
    together = load(tmp_path / "1")
    assert together.manifest["digests"] == run.manifest["digests"]
    assert [scan.steps.tolist() for _, scan in scans_of(together)] == [scan.steps.tolist() for _, scan in scans_of(run)]


@dataclass
class SeenScans:
    """An observer of payloads on links of scans."""

    payloads: list[bytes] = field(default_factory=list)

    def on_frame(self, frame: Frame) -> None:
        if frame.link.startswith("scan:"):
            self.payloads.append(frame.payload)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("on_"):
            return lambda *_: None
        raise AttributeError(name)


def test_several_cores_make_the_scans_of_one(run: RunRecord, tmp_path: Path) -> None:
    """Two operators, whose aircraft see each other."""
    red = '[[operators]]\nid = "red"\n[[operators.vehicles]]\nsensors = [{ model = "vlp-16" }]\nstart = [6, 0]'
    apart = LOOKS.replace("[[operators.vehicles]]\nstart = [6, 0]", red)
    scenario = Scenario.from_toml(apart, ("duration_s=5",))
    alone = skyrange.run(scenario, tmp_path / "alone")
    division = Division((("blue",), ("red",)))
    shared = load(run_on_cores(scenario, division, 2, tmp_path / "shared"))
    assert shared.manifest["digests"] == alone.manifest["digests"]
    for link in ("scan:blue/b1", "scan:red/r1"):
        of_both = [[scan.steps.tolist() for _, scan in scans_of(one, link)] for one in (shared, alone)]
        assert of_both[0]
        assert of_both[0] == of_both[1]


def test_a_copy_of_a_run_goes_on_alike() -> None:
    kernel = Kernel(build(Scenario.from_toml(LOOKS)).wiring)
    kernel.advance(3 * NS_PER_S + 70 * NS_PER_MS)  # in the middle of a scan
    seen = []
    for one in (deepcopy(kernel), kernel):
        seen.append(SeenScans())
        one.set_observers([seen[-1]])
        one.advance(4 * NS_PER_S)
    assert len(seen[0].payloads) >= 12
    assert seen[0].payloads == seen[1].payloads


BAD = {
    'model = "vlp-17"': "model: vlp-17 — expected a model of a sensor.*vlp-16",
    'model = "vlp-16", rate_hz = 7': "rate_hz: 7 — expected a rate whose period is a multiple of 2.5 ms.*7.01754",
    'model = "vlp-16", rate_hz = 1000': "rate_hz",
    'model = "vlp-16", place_m = [0, 0, 0.05]': "place_m: .* — expected a place outside the cylinder",
    'model = "d435", noise_m = 1': "noise_m: 1.* — expected a LiDAR; d435 is a depth camera",
    'model = "vlp-16", pixels = [3, 3]': "pixels: .* — expected a depth camera",
    'model = "vlp-16", range_m = 140': "range_m: 140 — expected at most 131.07 m",
    'model = "vlp-16", range_m = 0.5': "range_m: 0.5 — expected more than 1 m",
    'model = "mid-360", azimuth_deg = [10, -10]': r"azimuth_deg: \[10.0, -10.0\] — expected \[from, to\]",
    'model = "vlp-16", azimuths = 100000': "1,600,000 pulses a scan — expected at most 1,000,000",
    'model = "vlp-16", id = "a" }, { model = "d435", id = "a"': "an id that no other sensor of this aircraft has",
}


@pytest.mark.parametrize("bad", BAD)
def test_a_sensor_that_cannot_be_is_named_before_the_run(bad: str, tmp_path: Path) -> None:
    text = LOOKS.replace('model = "vlp-16", azimuths = 180, noise_m = 0, stabilised = true', bad)
    with pytest.raises(InputError, match=BAD[bad]):
        skyrange.run(Scenario.from_toml(text), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_models_have_the_names_of_the_description() -> None:
    described = Scenario.model_json_schema()["$defs"]["OpticalSensor"]["properties"]["model"]["description"]
    assert all(name in described for name in MODELS)
