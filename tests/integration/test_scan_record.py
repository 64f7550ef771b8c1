"""What scans leave behind: the table of their truth at each level, and points, labels and forged returns from it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import skyrange
from skyrange.analysis import Scan, read_received_scans, read_scans
from skyrange.assembly.optics import describe_scans, list_sensors
from skyrange.codec.range_scans import unpack_scan
from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_S
from skyrange.record import RunRecord, load
from skyrange.record.verification import verify_run
from skyrange.runtime.batch import BatchedFlight, RunBatch
from skyrange.runtime.run import Run
from skyrange.scenario.model.scenario import Scenario
from skyrange.study.execution.flight import fly_runs
from skyrange.study.execution.plan import PlannedRun

SEES = """
name = "sees"
seed = 3
duration_s = 9
origin = [40.76, -73.98]
[[operators]]
id = "blue"
[[operators.vehicles]]
start = [0, 0, 90]
plan = { square = { side_m = 30, alt_m = 20 } }
sensors = [
    { model = "vlp-16", azimuths = 180, noise_m = 0, range_m = 60, stabilised = true },
    { model = "d435", pixels = [64, 48], pitch_deg = -90, rate_hz = 5 },
]
[[operators.vehicles]]
start = [6, 0]
plan = { square = { side_m = 30, alt_m = 20 } }
"""
FORGERY = """
[[attacks]]
id = "forger"
kind = "link.corrupt"
start_s = 4
stop_s = 6
params = { links = ["scan:blue/b1"], first_byte = 44, bit_error_rate = 0.01 }
"""
"""Of all but the header."""
REPEATING = """
[[attacks]]
id = "repeater"
kind = "link.replay"
start_s = 4
stop_s = 6
params = { links = ["scan:blue/b1"], record_s = 3 }
"""


def fly(folder: Path, *changes: str, more: str = "") -> RunRecord:
    return skyrange.run(Scenario.from_toml(SEES + more, changes), folder)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RunRecord:
    return fly(tmp_path_factory.mktemp("sees") / "run")


def test_each_scan_that_is_sent_has_a_row_with_what_is_in_its_frame(run: RunRecord) -> None:
    frames = [frame for frame in run.frames_with_payloads() if frame.link == "scan:blue/b1"]
    rows = run.table("scans").to_pylist()
    assert len(rows) == len(frames) == run.manifest["counts"]["scans"] > 100
    for frame, row in zip(frames, rows, strict=True):
        said = unpack_scan(frame.payload)
        assert (frame.sent_ns, said.scan, said.start_ns) == (row["time_ns"], row["scan"], row["start_ns"])
        assert row["sensor"] == ("vlp-16", "d435")[said.sensor]
        assert said.steps.tolist() == row["steps"]
        assert len(row["kind"]) == len(row["row"]) == len(row["is_false"]) == len(row["steps"])
    assert verify_run(run).ok


def test_the_truth_names_the_aircraft_that_was_met(run: RunRecord) -> None:
    rows = run.table("scans").to_pylist()
    assert {name for row in rows for name in row["aircraft"]} == {"blue/b2"}
    for row in rows:
        kind, number = np.array(row["kind"]), np.array(row["row"])
        assert (kind == 3).any() == bool(row["aircraft"])
        assert (number[kind == 3] == 0).all()
        assert (number[kind < 2] == -1).all()


def test_points_lie_on_what_was_met(run: RunRecord) -> None:
    """In the true attitude: ground at height 0, the other aircraft where it is."""
    truth = {(row["time_ns"], row["vehicle"]): row for row in run.truth.to_pylist()}
    seen = on_ground = 0
    for scan in read_scans(run):
        assert scan.kind is not None
        assert scan.is_false is not None
        points, kind = scan.points("true"), scan.kind[scan.returns]
        real = ~scan.is_false[scan.returns]
        assert len(points) == len(scan.points_in_base()) == scan.returns.sum()
        ground = points[(kind == 1) & real]
        on_ground += len(ground)
        if scan.sensor.id == "vlp-16" and len(ground):  # of a camera, noise grows with the square of the depth
            assert np.abs(ground[:, 2]).max() < 0.1
        assert len(ground) < 1000 or abs(np.median(ground[:, 2])) < 0.03
        other = truth.get((scan.start_ns, "blue/b2"))
        if other is not None and (kind == 3).any() and scan.start_ns > 0:
            away = points[kind == 3] - [other["east_m"], other["north_m"], other["up_m"] + 0.1]
            assert np.linalg.norm(away, axis=1).max() < 0.7
            seen += 1
    assert seen > 20
    assert on_ground > 10_000


def test_an_estimated_attitude_turns_points_by_its_error(run: RunRecord) -> None:
    scan = next(scan for scan in read_scans(run, "blue/b1", "vlp-16") if scan.returns.sum() > 500)
    away = np.linalg.norm(scan.points() - scan.points("true"), axis=1)
    assert 0.0 < away.max() < 60 * np.radians(5)
    assert np.allclose(np.linalg.norm(scan.points_in_base(), axis=1), scan.distance_m[scan.returns])


def test_nothing_is_forged_where_nobody_acts(run: RunRecord) -> None:
    measured = {(scan.sensor.id, scan.number): scan for scan in read_scans(run)}
    received = list(read_received_scans(run))
    assert len(measured) - len(received) < 3
    for scan in received:
        assert scan.forged is not None
        assert not scan.forged.any()
        assert scan.steps.tolist() == measured[scan.sensor.id, scan.number].steps.tolist()
        assert np.allclose(scan.points(), measured[scan.sensor.id, scan.number].points(), atol=1e-4)


def test_forged_are_the_returns_that_an_attack_altered(tmp_path: Path) -> None:
    run = fly(tmp_path / "run", more=FORGERY)
    measured = {(scan.sensor.id, scan.number): scan for scan in read_scans(run)}
    forged = 0
    for scan in read_received_scans(run, "blue/b1"):
        source = measured[scan.sensor.id, scan.number]
        assert scan.forged is not None
        assert scan.kind is not None
        assert scan.forged.tolist() == (scan.steps != source.steps).tolist()
        assert source.kind is not None
        assert scan.kind.tolist() == source.kind.tolist()
        assert not scan.forged.any() or 3.9 * NS_PER_S < scan.sent_ns < 6.1 * NS_PER_S
        forged += int(scan.forged.sum())
    assert forged > 1000


def test_a_repeated_scan_is_itself_again(tmp_path: Path) -> None:
    received = list(read_received_scans(fly(tmp_path / "run", more=REPEATING)))
    again = [scan for scan in received if scan.sent_ns - scan.start_ns > NS_PER_S]
    assert len(received) > 135
    assert again
    assert not any(scan.forged.any() for scan in received if scan.forged is not None)


def test_levels_without_scans_count_them_and_have_the_same_digests(run: RunRecord, tmp_path: Path) -> None:
    study = fly(tmp_path / "study", "record.level=study")
    assert study.manifest["digests"] == run.manifest["digests"]
    assert study.manifest["not_kept"]["scans"] == run.rows("scans")
    assert not (tmp_path / "study" / "scans.parquet").exists()
    with pytest.raises(InputError, match='level = "full"'):
        next(read_scans(study))


def test_a_run_without_sensors_has_no_such_table(tmp_path: Path) -> None:
    bare = fly(tmp_path / "bare", "operators.blue.vehicles.0.sensors=[]")
    assert not (tmp_path / "bare" / "scans.parquet").exists()
    assert "scans" not in bare.manifest["counts"]
    assert list(read_scans(bare)) == []
    assert bare.table("scans").num_rows == 0


def test_runs_of_a_batch_record_what_runs_alone_record(run: RunRecord, tmp_path: Path) -> None:
    plan = [PlannedRun(str(n), Scenario.from_toml(SEES, changes)) for n, changes in enumerate((("seed=9",), ()))]
    assert not fly_runs(plan, tmp_path).errors
    assert load(tmp_path / "1").table("scans").equals(run.table("scans"))


def test_runs_in_memory_keep_no_truth_of_scans(tmp_path: Path) -> None:
    """No measure reads it, and memory is short. All else of such a run is that of one on disk."""
    scenarios = [Scenario.from_toml(SEES, changes) for changes in (("seed=9",), ())]
    batch = RunBatch.start([BatchedFlight(one, tmp_path / str(n), in_memory=True) for n, one in enumerate(scenarios)])
    batch.execute()
    records = batch.records()
    assert [record.table("scans").num_rows for record in records] == [0, 0]
    for scanner in (run.built.scanner for run in batch.runs):
        assert scanner is not None
        assert scanner.drain_truths() == []


def test_a_fork_goes_on_with_the_same_rows(run: RunRecord, tmp_path: Path) -> None:
    stem = Run.start(Scenario.from_toml(SEES), tmp_path / "stem")
    stem.advance(4.05)
    twin = stem.fork(tmp_path / "twin")
    for one in (stem, twin):
        one.advance(9)
        one.finish()
    for name in ("stem", "twin"):
        assert load(tmp_path / name).table("scans").equals(run.table("scans"))


def test_a_run_that_was_killed_keeps_the_scans_that_it_had_written(run: RunRecord, tmp_path: Path) -> None:
    flight = Run.start(Scenario.from_toml(SEES), tmp_path / "run")
    flight.advance(5)
    flight.recorder.flush()
    killed = load(tmp_path / "run")  # of which nothing was closed
    rows = killed.table("scans")
    assert rows.num_rows > 60
    assert rows.equals(run.table("scans").slice(0, rows.num_rows))
    assert all(isinstance(scan, Scan) for scan in read_received_scans(killed))
    flight.finish("interrupted")


def test_the_size_is_told_before_the_run(tmp_path: Path) -> None:
    many = "operators.blue.vehicles.0.sensors.1.pixels=[1000,1000]"
    scenario = Scenario.from_toml(SEES, [many])
    (line,) = describe_scans(scenario, list_sensors(scenario))
    assert "2 sensors: 0.2 GB of scans before compression" in line
