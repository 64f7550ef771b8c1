"""Do readers of DataFlash logs find in the logs of a simulated flight what its run recorded?"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.compute as pc
import pytest
from pymavlink.DFReader import DFReader_binary
from typer.testing import CliRunner

from skyrange.cli.app import app
from skyrange.codec.mavlink import decode
from skyrange.codec.mission import read_mission
from skyrange.core.errors import InputError
from skyrange.export.dataflash_file import LogExport, write_dataflash
from skyrange.flightlog import read_log, split_flights
from skyrange.record import RunRecord, load
from skyrange.record.read import time_order
from skyrange.scenario.toml_files import load_text
from tests.flights import shared_run

pytestmark = pytest.mark.rotating
SCENARIO = """
name = "logged"
seed = 3
duration_s = 62
origin = { lat = 40.7780, lon = -73.9550, alt_msl_m = 20, geoid_m = -32.7 }
start_utc = 2026-01-01T12:00:00Z
wind = { speed_mps = 3, from_deg = 250 }
[[operators]]
id = "blue"
streams = "operator"
  [[operators.vehicles]]
  id = "b1"
  plan = { square = { side_m = 15, alt_m = 10 } }
  params = { WPNAV_SPEED = 400 }
  [[operators.vehicles]]
  id = "b2"
  start = [0, 30]
  plan = { square = { side_m = 10, alt_m = 10 } }
[[attacks]]
id = "pull"
kind = "gnss.drift"
start_s = 30
params = { vehicles = ["blue/b1"], rate_mps = [0.3, 0, 0] }
"""


@pytest.fixture(scope="module")
def record() -> RunRecord:
    return shared_run(load_text(SCENARIO))


@pytest.fixture(scope="module")
def logs(record: RunRecord, tmp_path_factory: pytest.TempPathFactory) -> LogExport:
    return write_dataflash(record, tmp_path_factory.mktemp("logs") / "logs")


def messages(path: Path, *names: str) -> Iterator[Any]:
    """The messages of a log as pymavlink reads them."""
    reader = DFReader_binary(str(path), zero_time_base=False)
    while (message := reader.recv_msg()) is not None:
        if not names or message.get_type() in names:
            yield message
    reader.close()


def altered(run: RunRecord, folder: Path, **changes: Any) -> RunRecord:
    """A copy of a run with another manifest."""
    shutil.copytree(run.path, folder)
    (folder / "manifest.json").chmod(0o644)
    (folder / "manifest.json").write_text(json.dumps({**run.manifest, **changes}))
    return load(folder)


def sent(record: RunRecord, vehicle: str, *names: str) -> dict[str, list[tuple[int, Any]]]:
    """Times and messages that an autopilot sent, by name, from the frames."""
    found: dict[str, list[tuple[int, Any]]] = {name: [] for name in names}
    for frame in record.frames_with_payloads():
        if frame.sender == f"{vehicle}.autopilot":
            message = decode(frame.payload)
            if message.get_type() in found:
                found[message.get_type()].append((frame.sent_ns, message))
    return {name: sorted(rows, key=lambda row: row[0]) for name, rows in found.items()}


def rows_of(record: RunRecord, table: str, vehicle: str) -> Any:
    found = record.table(table)
    return found.filter(pc.equal(found["vehicle"], vehicle)).to_pandas().sort_values("time_ns")


def test_pymavlink_reads_every_message_in_order_of_time(logs: LogExport, capfd: pytest.CaptureFixture[str]) -> None:
    counts: Counter[str] = Counter()
    for name, items in logs.by.items():
        of_log = Counter(message.get_type() for message in messages(logs.path / name))
        for defining in ("FMT", "UNIT", "MULT", "FMTU"):
            assert of_log.pop(defining)
        assert of_log.total() == items
        counts += of_log
        times = [message.TimeUS for message in messages(logs.path / name) if message.get_type() != "FMT"]
        assert times == sorted(times)
    assert counts == logs.messages
    assert capfd.readouterr() == ("", "")  # it prints a line for each bad header


def test_mavlogdump_opens_a_log(logs: LogExport) -> None:
    program = Path(sys.executable).with_name("mavlogdump.py")
    command = [sys.executable, str(program), "--types", "MSG,GPS", str(logs.path / "blue/b1.BIN")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert done.stderr == ""
    lines = done.stdout.splitlines()
    assert "ArduCopter V4.6.0-dev (simulated by skyrange" in lines[0]
    # the first GPS message dates all of them: its measurement is up to half a second older than the message
    assert all(line.startswith(("2026-01-01 12:0", "2026-01-01 11:59:59.")) for line in lines)


def test_the_log_imports_as_the_flight_that_the_autopilot_believed(record: RunRecord, logs: LogExport) -> None:
    log = read_log(logs.path / "blue/b1.BIN")
    assert (log.format, log.vehicle_type, log.firmware) == ("dataflash", "QUADROTOR", "ArduCopter V4.6.0-dev")
    assert log.start_unix_s == pytest.approx(record.manifest["start_unix_ns"] * 1e-9, abs=0.5)
    assert not log.remarks
    told = sent(record, "blue/b1", "GLOBAL_POSITION_INT", "ATTITUDE", "EKF_STATUS_REPORT")
    believed = told["GLOBAL_POSITION_INT"]
    position = log.tables["position"]
    assert len(position) == len(believed)
    expected = np.array([
        (at // 1_000 * 1e-6, m.lat * 1e-7, m.lon * 1e-7, m.alt * 1e-3, m.vx * 0.01, m.vy * 0.01, m.vz * 0.01)
        for at, m in believed
    ])  # fmt: skip
    found = np.stack([position[name] for name in position.dtype.names or ()], axis=1)
    assert np.abs(found - expected).max(axis=0) == pytest.approx([0.0] * 7, abs=4e-6)
    attitude = log.tables["attitude"]
    for name, field in (("roll_rad", "roll"), ("pitch_rad", "pitch"), ("yaw_rad", "yaw")):
        off = attitude[name] - [getattr(message, field) for _, message in told["ATTITUDE"]]
        assert np.abs((off + np.pi) % (2.0 * np.pi) - np.pi).max() < 1e-6
    ratios = [message.pos_horiz_variance for _, message in told["EKF_STATUS_REPORT"]]
    assert log.tables["estimator"]["horizontal"] == pytest.approx(ratios, abs=1e-6)
    assert log.params["WPNAV_SPEED"] == 400.0


def test_the_mission_and_the_flight_are_those_of_the_run(record: RunRecord, logs: LogExport) -> None:
    (flight,) = split_flights(read_log(logs.path / "blue/b1.BIN"))
    flown = read_mission(record.path / "missions" / "flown" / "blue" / "b1.waypoints")
    assert flight.mission is not None
    assert len(flight.mission.items) == len(flown.items)
    for found, wanted in zip(flight.mission.items, flown.items, strict=True):
        assert (found.command, found.frame) == (wanted.command, wanted.frame)
        assert found.values == pytest.approx(wanted.values, abs=1e-5)
    events = {row["kind"]: row["time_ns"] * 1e-9 for row in record.events.to_pylist() if row["about"] == "blue/b1"}
    assert flight.armed_s == pytest.approx(events["event.armed"], abs=1e-6)
    assert flight.disarmed_s == pytest.approx(events["event.disarmed"], abs=1e-6)
    assert flight.modes == ("GUIDED", "AUTO")


def test_sim_alone_has_the_truth(record: RunRecord, logs: LogExport) -> None:
    truth = rows_of(record, "truth", "blue/b1")
    found = [*messages(logs.path / "blue/b1.BIN", "SIM")]
    assert [message.TimeUS for message in found] == (truth["time_ns"] // 1_000).tolist()
    assert [message.Alt for message in found] == pytest.approx(20.0 + truth["up_m"], abs=1e-5)
    forward_up = 2.0 * (truth["qx"] * truth["qz"] - truth["qw"] * truth["qy"])
    assert [message.Pitch for message in found] == pytest.approx(np.degrees(np.arcsin(forward_up)), abs=0.0051)
    # the drift takes the aircraft away from where it believes to be
    last = {name: [*messages(logs.path / "blue/b1.BIN", name)][-1] for name in ("SIM", "POS")}
    assert abs(last["SIM"].Lng - last["POS"].Lng) > 3e-5


def test_readings_are_those_that_the_autopilot_received(record: RunRecord, logs: LogExport) -> None:
    received = rows_of(record, "received_sensors", "blue/b1")
    sensed = rows_of(record, "sensors", "blue/b1")
    assert 0 < len(received) < len(sensed)
    rows = {row["time_ns"] // 1_000: row for row in [*sensed.to_dict("records"), *received.to_dict("records")]}
    logged = [*messages(logs.path / "blue/b1.BIN", "GPS", "IMU", "MAG", "BAT")]
    assert Counter(message.get_type() for message in logged)["IMU"] == len(sensed)
    metres = 111_111.0
    for message in logged:
        row = rows[message.TimeUS]
        if message.get_type() == "GPS":
            assert metres * (message.Lat - 40.7780) == pytest.approx(row["gnss_north_m"], abs=0.3)
            assert message.VZ + row["gnss_vel_up_mps"] == pytest.approx(0.0, abs=1e-6)
            start_ms = 388_800_000 + 18_000  # 2026-01-01 is a Thursday; GPS time is 18 s ahead of UTC
            assert (message.GWk, message.GMS) == (2399, start_ms + round(row["gnss_time_s"] * 1e3))
            assert message.Status == row["gnss_fix"]
        elif message.get_type() == "IMU":
            assert message.AccZ == pytest.approx(-row["accel_z_mps2"])
            assert message.GyrX == pytest.approx(row["gyro_x_radps"])
        elif message.get_type() == "MAG":
            assert message.MagY == pytest.approx(-1e3 * row["compass_y_gauss"], abs=0.51)
        else:
            assert message.Volt == pytest.approx(row["battery_v"])
    times = [row["gnss_time_s"] for row in rows.values()]
    assert Counter(message.get_type() for message in logged)["GPS"] == len({*times})


def test_what_a_log_lacks_is_told(record: RunRecord, logs: LogExport) -> None:
    assert {"XKF1, XKF4", "XKF3", "BARO", "VIBE"} <= {*logs.left_out}
    unknown = logs.left_out["BAT.RemPct"]
    count = sum(message.RemPct == 255 for name in logs.by for message in messages(logs.path / name, "BAT"))
    assert unknown.startswith(f"unknown in {count:,} of {logs.messages['BAT']:,}:")
    assert 0 < count < 0.1 * logs.messages["BAT"]


def test_spans_of_time_leave_the_bytes_as_they_are(
    record: RunRecord, logs: LogExport, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spans = []

    def counted(*args: Any) -> Iterator[Any]:
        for span in time_order.align_sorted(*args):
            spans.append(span)
            yield span

    monkeypatch.setattr("skyrange.export.dataflash_file.align_sorted", counted)
    monkeypatch.setattr(time_order, "STRAGGLER_ROWS", 1)
    monkeypatch.setattr("skyrange.record.read.tables.BATCH_ROWS", 4_000)
    again = write_dataflash(record, tmp_path / "logs")
    assert len(spans) > 10
    assert again == logs._replace(path=again.path)
    for name in logs.by:
        assert (again.path / name).read_bytes() == (logs.path / name).read_bytes()


def test_a_run_without_frames_has_logs_of_readings_and_events(record: RunRecord, tmp_path: Path) -> None:
    study = altered(record, tmp_path / "study", record={**record.manifest["record"], "level": "study"})
    found = write_dataflash(study, tmp_path / "logs")
    assert {*found.messages} == {"MSG", "PARM", "MODE", "ARM", "EV", "GPS", "IMU", "MAG", "BAT", "SIM"}
    assert "keeps no frames" in found.left_out["ATT, POS, VNED, EKSR, AHR2, RFND, RCIN, RCOU, CMD"]
    assert {message.HDop for message in messages(found.path / "blue/b1.BIN", "GPS")} == {-0.01}
    summary = altered(record, tmp_path / "summary", record={**record.manifest["record"], "level": "summary"})
    with pytest.raises(InputError, match="summary"):
        write_dataflash(summary, tmp_path / "logs")


def test_aircraft_of_other_autopilots_have_no_log(record: RunRecord, tmp_path: Path) -> None:
    first, second = record.manifest["vehicles"]
    run = altered(record, tmp_path / "run", vehicles=[first, {**second, "autopilot": "ardupilot"}])
    found = write_dataflash(run, tmp_path / "logs")
    assert [*found.by] == ["blue/b1.BIN"]
    assert found.left_out["blue/b2"] == "no log: its autopilot is ardupilot, which writes its own"
    none = altered(record, tmp_path / "none", vehicles=[{**second, "autopilot": "ardupilot"}])
    with pytest.raises(InputError, match="expected one with the builtin autopilot"):
        write_dataflash(none, tmp_path / "more")
    assert not (tmp_path / "more").exists()


def test_the_command_tells_what_is_left_out_first_and_has_labels_only_where_asked(
    record: RunRecord, logs: LogExport, tmp_path: Path
) -> None:
    done = CliRunner().invoke(app, ["export", str(record.path), "--dataflash", "--labels", "--out", str(tmp_path)])
    assert done.exit_code == 0
    assert "XKF3: no report has the innovations of the estimator" in done.stderr
    assert str(tmp_path / "logs" / "blue" / "b2.BIN") in done.stdout
    labels = [*messages(tmp_path / "logs/blue/b1.BIN", "LABL")]
    acts = [row for row in record.table("labels").to_pylist() if "blue/b1" in row["frame"]]
    assert [(label.Attack, label.Kind, label.TimeUS) for label in labels] == [
        (row["attack"], 0, row["at_ns"] // 1_000) for row in acts
    ]
    assert labels
    assert "LABL" not in {message.Name for message in messages(logs.path / "blue/b1.BIN", "FMT")}
    with_labels, without = ((folder / "blue/b2.BIN").read_bytes() for folder in (tmp_path / "logs", logs.path))
    assert len(with_labels) - len(without) == 89 + 44  # FMT and FMTU of LABL: nobody attacks this one
    alone = CliRunner().invoke(app, ["export", str(record.path), "--labels"])
    assert isinstance(alone.exception, InputError)
