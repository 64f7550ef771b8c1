"""Whole runs through the front door: outcome, repeatability, forks, interruption, and nothing half-written."""

from __future__ import annotations

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow.compute as pc
import pytest

from skyrange.cli.app import app
from skyrange.contracts.components import Finished
from skyrange.core.errors import ComponentError, InputError
from skyrange.metrics.exact_difference import diff
from skyrange.metrics.summary import summary
from skyrange.record import load
from skyrange.record.read.run import RunRecord
from skyrange.runtime.run import Run
from skyrange.scenario.model.scenario import Sensors
from skyrange.scenario.shipped import SHIPPED
from skyrange.scenario.shipped import load as load_scenario
from skyrange.study.runs import fly, run
from tests.flights import shared_run

SKYRANGE = [sys.executable, "-c", "from skyrange.cli import main; main()"]


def cli(*arguments: str, **more: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*SKYRANGE, *arguments], capture_output=True, text=True, timeout=300, **more)  # type: ignore[call-overload, no-any-return]


@pytest.fixture(scope="module")
def squares() -> Path:
    return shared_run("squares").path


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> RunRecord:
    """The first 20 s, of which all aircraft are in the air for 7."""
    scenario = load_scenario("squares", ["duration_s=20"])
    return fly(scenario, tmp_path_factory.mktemp("short") / "run", report=False)


def believed_m(record: RunRecord, vehicle: str) -> float:
    """The greatest height above home that an aircraft has told."""
    told = record.telemetry("GLOBAL_POSITION_INT")
    rows = told["vehicle"].to_numpy() == vehicle
    return float(max(told["relative_alt"].to_numpy()[rows])) * 1e-3


def test_squares_flies_at_its_height_where_sensors_are_ideal(tmp_path: Path) -> None:
    scenario = load_scenario("squares", ["duration_s=30"])
    fly(scenario.model_copy(update={"sensors": Sensors(noise=0.0)}), tmp_path / "run", report=False)
    for vehicle in summary(load(tmp_path / "run"))["vehicles"]:
        assert vehicle["highest_m"] == pytest.approx(5.0, abs=0.2)


def test_squares_completes_as_published(squares: Path) -> None:
    record = load(squares)
    facts = summary(record)
    assert facts["status"] == "complete"
    assert facts["simulated_s"] == 180.0
    sides = {"blue/b1": 5, "blue/b2": 7, "green/g1": 4, "green/g2": 3, "green/g3": 2}
    assert {v["id"]: v["outcome"] for v in facts["vehicles"]} == dict.fromkeys(sides, "complete")
    for vehicle in facts["vehicles"]:
        # up 5 m, four sides, down 5 m; corners are rounded by at most the waypoint radius, overshoot is small
        assert vehicle["distance_m"] == pytest.approx(10 + 4 * sides[vehicle["id"]], rel=0.25)
        # what it can know: in truth its barometer's wander is added, up to half a metre
        assert believed_m(record, vehicle["id"]) == pytest.approx(5.0, abs=0.2)
    lift_offs = {
        row["about"]: row["time_ns"] for row in record.table("events").to_pylist() if row["kind"] == "event.takeoff"
    }
    assert len(lift_offs) == 5
    assert max(lift_offs.values()) - min(lift_offs.values()) <= 100_000_000, "simultaneous take-off"


def test_the_folder_holds_what_the_design_says(squares: Path) -> None:
    names = {path.relative_to(squares).as_posix() for path in squares.rglob("*") if path.is_file()}
    tables = {f"{t}.parquet" for t in (
        "truth", "sensors", "telemetry/ATTITUDE", "frames", "payloads", "decisions", "events", "labels")}  # fmt: skip
    assert tables | {"manifest.json", "scenario.toml", "operators/blue.csv", "operators/green.csv",
                     "operators/blue.tlog", "operators/green.tlog",
                     "missions/flown/blue/b1.waypoints"} <= names  # fmt: skip
    assert not [name for name in names if "spool" in name]


def test_an_operator_sees_only_its_own(squares: Path) -> None:
    for operator in ("blue", "green"):
        with (squares / "operators" / f"{operator}.csv").open() as file:
            rows = list(csv.DictReader(file))
        assert {row["vehicle"].split("/")[0] for row in rows} == {operator}
        assert {"GLOBAL_POSITION_INT", "HEARTBEAT", "ATTITUDE"} <= {row["message"] for row in rows}


def test_every_hop_is_recorded_and_names_its_parent(squares: Path) -> None:
    frames = load(squares).table("frames").to_pylist()
    ids = {f"{f['link']}|{f['direction']}|{f['sender']}|{f['serial']}": f for f in frames}
    assert len(ids) == len(frames)
    up = [f for f in frames if f["link"] == "gcs:blue/b1" and f["direction"] == "rev"]
    assert len(up) > 1000
    for frame in up:
        log = ids[frame["parent"]]
        autopilot = ids[log["parent"]]
        assert (log["link"], autopilot["link"]) == ("log:blue/b1", "autopilot:blue/b1")
        assert autopilot["sender"] == "blue/b1.autopilot"
        assert autopilot["payload_id"] == log["payload_id"] == frame["payload_id"]
        assert frame["sent_ns"] >= log["arrived_ns"] > log["sent_ns"] >= autopilot["arrived_ns"]


def test_decisions_quote_frames_that_exist(squares: Path) -> None:
    record = load(squares)
    ids = {f"{f['link']}|{f['direction']}|{f['sender']}|{f['serial']}" for f in record.table("frames").to_pylist()}
    quoted = [cause for row in record.table("decisions").to_pylist() for cause in row["causes"]]
    assert len(quoted) > 20
    assert set(quoted) <= ids


@pytest.mark.slow
def test_same_seed_same_fingerprint_in_another_process_and_another_seed_another(squares: Path, tmp_path: Path) -> None:
    here = load(squares).manifest["digests"]
    prints = {}
    for seed in ("1", "2"):
        done = cli("run", "squares", "--seed", seed, "--out", str(tmp_path / seed), "--json")
        assert done.returncode == 0, done.stderr
        prints[seed] = json.loads(done.stdout)["digests"]
    assert prints["1"] == here
    assert prints["2"]["fingerprint"] != here["fingerprint"]
    assert prints["2"]["frames"] != here["frames"]
    assert diff(load(squares), load(tmp_path / "1")).same
    assert not diff(load(squares), load(tmp_path / "2")).same


def test_a_run_repeats_from_its_own_folder(short: RunRecord, tmp_path: Path) -> None:
    again = run(short.path / "scenario.toml", tmp_path / "again")
    assert again.manifest["digests"] == short.manifest["digests"]
    assert diff(short, again).same


def test_another_seed_has_another_fingerprint(short: RunRecord, tmp_path: Path) -> None:
    other = fly(load_scenario("squares", ["duration_s=20", "seed=2"]), tmp_path / "2", report=False)
    for digest in ("fingerprint", "frames"):
        assert other.manifest["digests"][digest] != short.manifest["digests"][digest]
    assert not diff(short, other).same


def test_a_fork_of_a_run_equals_the_straight_run(short: RunRecord, tmp_path: Path) -> None:
    trunk = Run.start(load_scenario("squares", ["duration_s=20"]), tmp_path / "trunk")
    trunk.advance(14.5)
    branch = trunk.fork(tmp_path / "branch")
    for part in (branch, trunk):
        part.advance(20.0)
        part.finish()
    for name in ("trunk", "branch"):
        assert load(tmp_path / name).manifest["digests"] == short.manifest["digests"]
        assert diff(load(tmp_path / name), short).same


def test_paced_equals_free(tmp_path: Path) -> None:
    scenario = load_scenario("squares", ["duration_s=3"])
    free = fly(scenario, tmp_path / "free", report=False)
    paced = fly(scenario, tmp_path / "paced", speed=3.0, report=False)
    assert paced.manifest["digests"] == free.manifest["digests"]
    assert paced.manifest["timings"]["wall_s"] >= 0.9
    assert free.manifest["timings"]["wall_s"] < paced.manifest["timings"]["wall_s"]


def test_ctrl_c_leaves_a_whole_record(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    command = [*SKYRANGE, "run", "squares", "--speed", "20", "--out", str(folder)]
    child = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert child.stderr is not None
    for line in child.stderr:
        if "18 of 180 s" in line or "19 of 180 s" in line:
            break
    child.send_signal(signal.SIGINT)
    out, err = child.communicate(timeout=60)
    assert child.returncode == 4, err
    assert "interrupted at" in err
    record = load(folder)
    assert record.status == "interrupted"
    assert 17.0 < record.manifest["simulated_s"] < 100.0
    assert max(record.table("truth").column("time_ns").to_pylist()) / 1e9 == pytest.approx(
        record.manifest["simulated_s"], abs=0.11
    )
    assert (folder / "report.html").exists()
    assert "blue/b1" in out
    in_flight = record.table("frames").filter(pc.equal(record.table("frames").column("fate"), "in_flight"))
    assert in_flight.column("arrived_ns").null_count == in_flight.num_rows


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["run", "squraes"], "Did you mean 'squares'?"),
        (["run", "squares", "--set", "operators.*.vehicles.*.autopilt=builtin"], "Did you mean 'autopilot'?"),
        (["run", "squares", "--set", "operators.*.vehicles.*.autopilot=bultin"], "Did you mean 'builtin'?"),
        (["run", "squares", "--set", "operators.blue.vehicles.b1.id=b2"], "operators.blue.vehicles"),
        (["run", "squares", "--set", "operators.blue.vehicles=[]"], "at least one vehicle"),
        (["run", "squares", "--set", "duration_s=nan"], "a finite number"),
        (["run", "squares", "--buildings", "nowhere.geojson"], "nowhere.geojson"),
        (["run", "missing.toml"], "a file that exists"),
        (["show", "nowhere"], "a run's folder"),
        (["diff", "nowhere", "nowhere"], "a run's folder"),
        (["report", "nowhere"], "a run's folder"),
        (["run", "squares", "--speed", "-1"], "--speed"),
        (["run", "squares", "--speed", "inf"], "expected 0, which is as fast as it goes"),
        (["run", "squares", "--out", "/dev/null/run"], "a writable folder"),
        (["run", "squares", "--out", "/proc/run"], "a writable folder"),
    ],
)
def test_bad_input_is_explained_and_leaves_nothing(
    arguments: list[str],
    expected: str,
    tmp_path: Path,
    command: Callable[..., int],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    code = command(*arguments)
    said = capsys.readouterr().err
    assert code == 2, said
    assert expected in " ".join(said.split())
    assert "Traceback" not in said
    assert list(tmp_path.iterdir()) == []


def test_an_out_folder_with_something_in_it_is_refused(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("precious")
    with pytest.raises(InputError, match=r"holds mine\.txt"):
        fly(load_scenario("squares", ["duration_s=1"]), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


FULL = """
import resource, signal, sys
from pathlib import Path
from skyrange.runtime.run import Run
from skyrange.scenario.shipped import load
run = Run.start(load("squares"), Path(sys.argv[1]))
run.advance(2.0)  # so that compiled code, which is kept in files too, is there before the disk is full
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))
run.execute(speed=20.0)
"""


@pytest.mark.slow
def test_a_disk_that_fills_up_ends_the_run_with_what_it_has(tmp_path: Path) -> None:
    # a limit on the size of files makes write() fail just as a full disk does, with another errno
    done = subprocess.run(
        [sys.executable, "-c", FULL, str(tmp_path / "run")], capture_output=True, text=True, timeout=120
    )
    assert done.returncode != 0
    assert "ComponentError" in done.stderr
    assert str(tmp_path / "run") in done.stderr
    record = load(tmp_path / "run")
    assert record.rows("truth") > 10
    assert len(summary(record)["vehicles"]) == 5


@pytest.mark.slow
def test_memory_is_bounded(tmp_path: Path) -> None:
    # once the first row group of most tables is written, longer must not take noticeably more: later ones leave memory
    code = (
        "import sys; from pathlib import Path; from skyrange.bench.fleet import fleet_scenario;"
        "from skyrange.runtime.memory import peak_memory_mb;"
        "from skyrange.runtime.run import Run; r = Run.start(fleet_scenario(40, 600), Path(sys.argv[1]));"
        "r.advance(float(sys.argv[2])); print(peak_memory_mb())"
    )
    peaks = {}
    for seconds in ("300", "600"):
        out = subprocess.run([sys.executable, "-c", code, str(tmp_path / seconds), seconds],
                             capture_output=True, text=True, check=True, timeout=300)  # fmt: skip
        peaks[seconds] = float(out.stdout)
    assert peaks["600"] < peaks["300"] + 40.0, peaks


def test_engines_that_fail_leave_a_failed_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    started = Run.start(load_scenario("squares", ["duration_s=20"]), tmp_path / "run")
    (mount,) = started.built.wiring.engines
    finish = mount.engine.finish

    def faulty(tick: int, wall_deadline_s: float) -> Finished:
        if tick > 5_000_000_000:
            raise ComponentError("engine builtin", "fell over")
        return finish(tick, wall_deadline_s)

    monkeypatch.setattr(mount.engine, "finish", faulty)
    with pytest.raises(ComponentError, match="fell over"):
        started.execute()
    record = load(tmp_path / "run")
    assert record.status == "failed"
    assert record.manifest["error"] == "engine builtin: fell over"
    assert record.rows("truth") == 5 * 51


def test_runs_started_at_once_get_folders_of_their_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    scenario = load_scenario("squares", ["duration_s=1"])
    first = Run.start(scenario)
    found = [Path("runs/squares"), Path("runs/squares-2")]  # the first look was before the other run began
    monkeypatch.setattr("skyrange.runtime.run.free_folder", lambda name: found.pop(0) if len(found) > 1 else found[0])
    second = Run.start(scenario)
    assert first.recorder.path == Path("runs/squares")
    assert second.recorder.path == Path("runs/squares-2")
    for each in (first, second):
        each.execute()
        assert load(each.recorder.path).status == "complete"


@pytest.mark.parametrize(("name", "at"), [("~/run", "home/run"), ("a:b", "a:b"), ("file:x", "file:x")])
def test_folders_are_named_as_in_a_shell(name: str, at: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    record = run("squares", name, changes=["duration_s=1"])
    assert record.path.resolve() == tmp_path / at
    assert record.rows("frames") > 100
    assert load(name).table("truth").num_rows > 10
    assert (tmp_path / at / "report.html").exists()


@pytest.mark.rotating
def test_an_output_that_lacks_signs(squares: Path) -> None:
    done = cli("show", str(squares), env={**os.environ, "PYTHONIOENCODING": "ascii"})
    assert done.returncode == 0, done.stderr
    assert "blue/b1" in done.stdout


@pytest.mark.slow
def test_a_list_in_json_lacks_no_signs() -> None:
    done = cli("scenarios", "--json", env={**os.environ, "PYTHONIOENCODING": "ascii"})
    assert {row["name"] for row in json.loads(done.stdout)} == set(SHIPPED)


@pytest.mark.parametrize(
    "buffered", [{}, pytest.param({"PYTHONUNBUFFERED": "1"}, marks=pytest.mark.slow)], ids=["buffered", "unbuffered"]
)
@pytest.mark.rotating
def test_an_output_that_lacks_room(squares: Path, buffered: dict[str, str]) -> None:
    bare = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [*SKYRANGE, "show", str(squares)],
            stdout=full, stderr=subprocess.PIPE, text=True, env={**bare, **buffered},
        )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr.endswith("\nskyrange: No space left on device\n")  # behind the notice that show does not verify


def test_an_engine_with_a_bug_is_blamed_and_leaves_a_failed_record(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started = Run.start(load_scenario("squares", ["duration_s=20"]), tmp_path / "run")
    (mount,) = started.built.wiring.engines
    monkeypatch.setattr(mount.engine, "begin", lambda *_: dict[str, Any]()["nothing"])
    with pytest.raises(ComponentError, match=r"engine builtin: raised KeyError\('nothing'\) at 0.000000 s"):
        started.execute()
    assert load(tmp_path / "run").status == "failed"


def test_brackets_in_names_and_reasons_are_shown_as_they_are(
    squares: Path,
    tmp_path: Path,
    command: Callable[..., int],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = tmp_path / "[bold]run"
    shutil.copytree(squares, folder)
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["outcomes"]["blue/b1"] = {"state": "failed", "reason": "[/no] way", "finished_s": None}
    (folder / "manifest.json").write_text(json.dumps(manifest))
    monkeypatch.setenv("COLUMNS", "200")
    assert command("show", str(folder)) == 0
    shown = capsys.readouterr().out
    assert "failed ([/no] way)" in shown
    assert f"run    {folder}" in shown


def test_show_says_what_takes_the_disk(squares: Path, capsys: pytest.CaptureFixture[str]) -> None:
    disk = summary(load(squares))["disk"]
    files = [path for path in squares.rglob("*") if path.is_file()]
    assert sum(disk.values()) == sum(path.stat().st_size for path in files)
    assert disk["frames"] == (squares / "frames.parquet").stat().st_size
    assert disk["telemetry"] == sum(path.stat().st_size for path in (squares / "telemetry").iterdir())
    assert list(disk.values()) == sorted(disk.values(), reverse=True)
    app(["show", str(squares)], standalone_mode=False)
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("disk")]
    assert f"truth {disk['truth'] / 1e6:.1f}" in line
