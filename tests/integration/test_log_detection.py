"""Does a detector over what a run has exported raise the alerts that it raised in the run? Flown, exported, judged."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from skyrange.cli.app import app
from skyrange.export.packet_captures import mavlink, remote_id
from skyrange.log_detection.detector_choice import Request
from skyrange.log_detection.judging import Findings, judge
from skyrange.log_detection.opening import LogOptions, open_log
from skyrange.log_detection.result_files import alert_row_of
from skyrange.record import RunRecord
from skyrange.record.manifest import origin_of
from skyrange.record.write.files.operator_files import write_operator_files
from skyrange.scenario.toml_files import load_text
from tests.flights import shared_run

pytestmark = pytest.mark.rotating

AT_STATION = (
    "heartbeat.gap", "mavlink.source", "mavlink.commands", "mavlink.rate", "mavlink.sequence", "mavlink.timing",
    "motion.consistency", "motion.fleet", "navigation.cs_ema", "navigation.gnss_innovation", "navigation.multi_sensor",
)  # fmt: skip
OF_BOTH_DIRECTIONS = ("mavlink-source", "mavlink-commands", "mavlink-rate")
"""They judge what the station sends as well, of which a capture has what arrived, when it arrived."""


def declare(kind: str, id_: str = "", links: Sequence[str] = ("gcs:*",), side: str = "gcs") -> str:
    """A detector that raises alerts below its default threshold too, so that there are many to compare."""
    params = "" if kind == "heartbeat.gap" else "params = { report_above = 0.2 }"
    named = id_ or kind.replace(".", "-")
    return f'[[detectors]]\nid = "{named}"\nkind = "{kind}"\nlinks = {json.dumps(links)}\nside = "{side}"\n{params}\n'


RECEIVED = declare("remote_id.plausibility", "rid", ["rid_down:blue/*"], "companion")
DETECTORS = "".join(declare(kind) for kind in AT_STATION)
SCENARIO = f"""
name = "judged"
seed = 3
duration_s = 40
origin = {{ lat = 40.7780, lon = -73.9550, alt_msl_m = 20, geoid_m = -32.7 }}
start_utc = 2026-01-01T12:00:00Z
[radio]
[[links]]
match = "gcs:*"
mode = "datagram"
loss = 0.01
[[operators]]
id = "blue"
streams = "operator"
[[operators.fleets]]
id = "b"
count = 2
plan = {{ square = {{ side_m = 15, alt_m = 12 }} }}
[[attacks]]
id = "false-position"
kind = "telemetry.position"
start_s = 20
params = {{ links = ["gcs:blue/b1"], offset_m = [0, 40, 0] }}
[[attacks]]
id = "mode"
kind = "mavlink.mode"
start_s = 25
params = {{ vehicles = ["blue/b2"], mode = "LAND" }}
[[attacks]]
id = "replayed"
kind = "remote_id.replay"
start_s = 22
params = {{ transmitter_m = [0, 30, 10], delay_s = 8 }}
{DETECTORS}{RECEIVED}
{declare("mavlink.sequence", "on-board", ["gcs:*"], "companion")}
{declare("approval.conformance", "approved", ["gcs:*", "approval:*"])}
"""


def flown() -> RunRecord:
    """The run, which other tests of this file read too."""
    return shared_run(load_text(SCENARIO))


def raised(record: RunRecord, ids: Sequence[str]) -> list[tuple[Any, ...]]:
    """The alerts of the run itself, by some detectors."""
    return [tuple(row.values()) for row in record.alerts.to_pylist() if row["detector"] in ids]


def found(findings: Findings, names: dict[str, str] | None = None) -> list[tuple[Any, ...]]:
    """The alerts over a log as rows of a run's table, with other names of vehicles and stations."""
    rows = []
    for row in map(alert_row_of, findings.alerts):
        subject, data = row[3], row[6]
        for old, new in (names or {}).items():
            subject, data = subject.replace(old, new), data.replace(old, new)
        rows.append((*row[:3], subject, *row[4:6], data))
    return rows


def write(folder: Path, text: str) -> Path:
    path = folder / "detectors.toml"
    path.write_text(text)
    return path


def test_the_folder_of_a_run_gives_its_alerts() -> None:
    record = flown()
    findings = judge(open_log(record.path), Request())
    expected = [tuple(row.values()) for row in record.alerts.to_pylist()]
    assert len({row[1] for row in expected}) >= 6, "few detectors raised alerts: nothing is compared"
    assert found(findings) == expected
    assert findings.choice.left_out == ()


def test_its_telemetry_log_gives_the_alerts_at_the_station(tmp_path: Path) -> None:
    record = flown()
    write_operator_files(tmp_path, record.tables, record.manifest, with_csv=False)
    findings = judge(open_log(tmp_path / "blue.tlog"), Request(file=write(tmp_path, DETECTORS)))
    systems = {f"station/sys{row['system_id']}": row["id"] for row in record.manifest["vehicles"]}
    expected = raised(record, [kind.replace(".", "-") for kind in AT_STATION])
    assert len(systems) == 2
    assert found(findings, {**systems, "station.gcs": "blue.gcs"}) == expected


def test_its_capture_gives_the_alerts_about_what_arrived_at_the_station(tmp_path: Path) -> None:
    record = flown()
    kinds = [kind for kind in AT_STATION if kind.replace(".", "-") not in OF_BOTH_DIRECTIONS]
    path = mavlink(record, tmp_path / "mavlink.pcapng").path
    findings = judge(open_log(path), Request(file=write(tmp_path, "".join(map(declare, kinds)))))
    expected = raised(record, [kind.replace(".", "-") for kind in kinds])
    assert expected
    assert found(findings) == expected


def test_its_capture_gives_the_alerts_about_what_arrived_at_aircraft(tmp_path: Path) -> None:
    record = flown()
    path = mavlink(record, tmp_path / "mavlink.pcapng").path
    request = Request(file=write(tmp_path, declare("mavlink.sequence", "on-board", ["gcs:*"], "companion")))
    expected = raised(record, ["on-board"])
    assert expected
    assert found(judge(open_log(path, LogOptions(side="companion")), request)) == expected


def test_its_capture_of_remote_id_gives_the_alerts_of_its_receivers(tmp_path: Path) -> None:
    record = flown()
    log = open_log(remote_id(record, tmp_path / "remote_id.pcapng").path)
    origin = origin_of(record.manifest)
    assert origin is not None
    log.origin = origin  # a capture has none, and details are in metres from it
    findings = judge(log, Request(file=write(tmp_path, RECEIVED)))
    expected = raised(record, ["rid"])
    assert {row[2].rpartition(".")[2] for row in expected} >= {"time"}

    def rounded(rows: list[tuple[Any, ...]]) -> list[Any]:  # radio headers have the strength in whole dB
        return [(row[:6], {**json.loads(row[6]), "rssi_dbm": round(json.loads(row[6])["rssi_dbm"])}) for row in rows]

    assert rounded(found(findings)) == rounded(expected)


def test_the_command_writes_what_it_prints(tmp_path: Path) -> None:
    record = flown()
    write_operator_files(tmp_path, record.tables, record.manifest, with_csv=False)
    asked = ["detect", str(record.path), str(tmp_path / "blue.tlog"), "--benign", "--out", str(tmp_path / "out")]
    answer = CliRunner().invoke(app, [*asked, "--json"], env={"COLUMNS": "160"})
    assert answer.exit_code == 0, answer.output
    told = json.loads(answer.stdout)
    assert [log["format"] for log in told["logs"]] == ["run", "tlog"]
    assert len(told["logs"][0]["alerts"]) == record.alerts.num_rows
    kept = json.loads((tmp_path / "out" / "detection.json").read_text())
    assert kept == {name: value for name, value in told.items() if name != "files"}
    sequence = next(row for row in told["false_alarms"] if row["detector"] == "mavlink-sequence")
    observed = sum(one["observed_s"] for log in told["logs"] for one in log["observed"])
    assert sequence["logs"] == 2
    assert sequence["whole"]["hours"] == pytest.approx(observed / 3600.0, rel=1e-6)
    assert 0.0 < sequence["airborne"]["hours"] < sequence["whole"]["hours"]
