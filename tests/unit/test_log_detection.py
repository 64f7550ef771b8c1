"""Do detectors over a log see what is in it, and does the command say what it left out, guessed or could not judge?"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect
from scipy import stats
from typer.testing import CliRunner

from skyrange.cli.app import app
from skyrange.cli.log_detection import DetectOptions
from skyrange.cli.log_detection import detect as run_detectors
from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_S
from skyrange.flightlog import read_log, split_flights
from skyrange.log_detection.airborne import airborne_ns
from skyrange.log_detection.detector_choice import Request, check_request
from skyrange.log_detection.false_alarms import DetectorRates, FalseAlarmRate, measure_false_alarms
from skyrange.log_detection.judging import Findings, judge
from skyrange.log_detection.log_clock import LogClock
from skyrange.log_detection.opening import LogOptions, open_log
from skyrange.log_detection.page import RATES, render_page, renew_page
from tests.written_logs import START_US, Moment, TlogWriter, hop, write_dataflash, write_tlog

GAP = Request(kinds=("heartbeat.gap",))
SEQUENCE = Request(kinds=("mavlink.sequence",))


def remarks_of(findings: Findings) -> str:
    return "\n".join(f"{one.subject}: {one.text}" for one in findings.remarks)


def silent_log(path: Path, silent_s: float = 7.0, system: int = 1) -> Path:
    """A hop whose heartbeats stop once, in the air."""
    writer = TlogWriter()
    for moment in hop(40.0, 2.0):
        if not 20.0 <= moment.time_s < 20.0 + silent_s:
            writer.heartbeat(moment.time_s, armed=3.0 < moment.time_s < 47.0, system=system)
        writer.moment(moment, system=system)
    path.write_bytes(writer.data)
    return path


def detect(*arguments: str) -> tuple[int, str, str]:
    """Exit code, output and notices of the command."""
    answer = CliRunner().invoke(app, ["detect", *arguments], env={"COLUMNS": "200"})
    return answer.exit_code, answer.stdout, answer.stderr if answer.exit_code == 0 else str(answer.exception)


def test_an_alert_has_the_time_the_subject_and_the_details_of_what_was_found(tmp_path: Path) -> None:
    findings = judge(open_log(silent_log(tmp_path / "a.tlog")), GAP)
    (raised,) = findings.alerts
    # the last heartbeat is at 19.5 s; START_US is a whole second, so times of the log are those of its frames
    assert raised.alert.at == 24.5 * NS_PER_S
    assert (raised.alert.subject, raised.alert.kind) == ("station/sys1", "heartbeat.gap")
    assert raised.time_ns == 25 * NS_PER_S, "monitors are served every 500 ms"
    assert findings.log.epoch.unix_ns == START_US * 1000


def test_time_0_is_the_whole_second_before_the_first_frame(tmp_path: Path) -> None:
    writer = TlogWriter()
    writer.shift_us = 300_000
    for second in range(20):
        if not 5 <= second < 13:
            writer.heartbeat(float(second), armed=False)
    (tmp_path / "a.tlog").write_bytes(writer.data)
    findings = judge(open_log(tmp_path / "a.tlog"), GAP)
    assert findings.first_ns == 300_000_000
    assert [raised.alert.at for raised in findings.alerts] == [9_300_000_000]


def test_monitors_are_served_until_all_was_shown_and_no_further(tmp_path: Path) -> None:
    writer = TlogWriter()
    for second in range(4):
        writer.heartbeat(second + 0.25, armed=False)
    writer.moment(Moment(8.2))
    (tmp_path / "a.tlog").write_bytes(writer.data)
    (raised,) = judge(open_log(tmp_path / "a.tlog"), GAP).alerts  # the service at 8.5 s is the last
    assert raised.time_ns == 8.5 * NS_PER_S


def test_the_airborne_time_is_that_of_the_flights_in_the_log(tmp_path: Path) -> None:
    path = silent_log(tmp_path / "a.tlog", 1.0)
    (flight,) = split_flights(read_log(path))
    (exposure,) = judge(open_log(path), GAP).exposures
    assert airborne_ns(exposure.airborne) / NS_PER_S == pytest.approx(flight.landing_s - flight.take_off_s, abs=0.5)
    assert exposure.observed_ns == 49.5 * NS_PER_S


def test_each_log_is_judged_by_itself_and_hours_add_up(tmp_path: Path) -> None:
    paths = [silent_log(tmp_path / "a.tlog"), silent_log(tmp_path / "b.tlog", 9.0)]
    one, two = ([judge(open_log(path), GAP)] for path in paths)
    (alone,), (both,) = measure_false_alarms(one), measure_false_alarms([*one, *two])
    assert (alone.whole.episodes, both.whole.episodes) == (1, 2)
    assert both.whole.hours == pytest.approx(2 * 49.5 / 3600.0)
    assert both.airborne.episodes == 2
    assert both.airborne.hours < both.whole.hours
    assert both.whole.per_h == pytest.approx(2.0 / both.whole.hours)
    low, high = both.whole.limits  # Garwood, by chi-square quantiles
    assert low == pytest.approx(stats.chi2.ppf(0.025, 4) / 2.0 / both.whole.hours)
    assert high == pytest.approx(stats.chi2.ppf(0.975, 6) / 2.0 / both.whole.hours)
    assert both.whole.lowest_per_h == pytest.approx(2.995732 / both.whole.hours, rel=1e-5)


def test_alerts_within_an_episode_are_one_alarm(tmp_path: Path) -> None:
    writer = TlogWriter()
    for second in range(100):
        if second % 7 == 0:  # gaps of 7 s: an alert in each
            writer.heartbeat(float(second), armed=False)
    (tmp_path / "a.tlog").write_bytes(writer.data)
    findings = judge(open_log(tmp_path / "a.tlog"), GAP)
    assert [raised.alert.at // NS_PER_S for raised in findings.alerts] == [5 + 7 * k for k in range(14)]
    (rates,) = measure_false_alarms([findings])
    assert rates.whole.episodes == 3, "episodes of 30 s begin at 5, 40 and 75 s"
    assert rates.airborne.per_h is None


def test_a_detector_that_a_log_has_nothing_for_is_named_with_its_reason(tmp_path: Path) -> None:
    findings = judge(open_log(silent_log(tmp_path / "a.tlog")), Request())
    reasons = {one.kind: one.reason for one in findings.choice.left_out}
    assert "flight approval" in reasons["approval.conformance"]
    assert "Remote ID" in reasons["remote_id.plausibility"]
    assert "'file'" in reasons["learned.windows"]
    assert "towards an aircraft" in reasons["mavlink.commands"]
    less = {one.kind: " ".join(one.less) for one in findings.choice.chosen}
    assert "reply" in less["mavlink.source"]
    assert "one aircraft" in less["motion.fleet"]
    assert "SYS_STATUS" in less["motion.consistency"]
    assert "SCALED_PRESSURE" in less["navigation.multi_sensor"]
    assert not less["heartbeat.gap"]


def test_a_log_for_which_nothing_is_left_is_refused(tmp_path: Path) -> None:
    path = silent_log(tmp_path / "a.tlog")
    with pytest.raises(InputError, match="none that applies"):
        judge(open_log(path), Request(kinds=("remote_id.plausibility",)))


@pytest.mark.parametrize(
    ("request_", "named"),
    [
        (Request(kinds=("heartbeat.gab",)), "heartbeat.gap"),
        (Request(kinds=("heartbeat.gap",), changes=("detectors.heartbeat-gap.params.limit_s=0",)), "limit_s"),
        (Request(kinds=("heartbeat.gap",), changes=("detectors.heartbeat-gap.params.limits=3",)), "limits"),
        (Request(kinds=("heartbeat.gap",), changes=("detectors.gap.params.limit_s=3",)), "detectors.gap"),
        (Request(kinds=("learned.windows",)), "file"),
    ],
)
def test_a_wrong_request_is_refused_before_a_log_is_opened(request_: Request, named: str) -> None:
    with pytest.raises(InputError, match=named):
        check_request(request_)


def test_parameters_are_set_as_in_a_scenario(tmp_path: Path) -> None:
    path = silent_log(tmp_path / "a.tlog")
    assert not judge(open_log(path), Request(kinds=GAP.kinds, changes=("detectors.*.params.limit_s=20",))).alerts
    file = tmp_path / "mine.toml"
    file.write_text('[[detectors]]\nid = "slow"\nkind = "heartbeat.gap"\nparams = { limit_s = 6 }\n')
    (raised,) = judge(open_log(path), Request(file=file)).alerts
    assert (raised.detector, raised.alert.data["limit_s"]) == ("slow", 6.0)
    file.write_text('[[detectors]]\nid = "gap"\nkind = "heartbeat.gap"\nside = "companion"\n')
    with pytest.raises(InputError, match="companion"):
        judge(open_log(path), Request(file=file))
    assert judge(open_log(path, LogOptions(side="companion")), Request(file=file)).choice.chosen
    file.write_text("seed = 1\n")
    with pytest.raises(InputError, match="detectors"):
        check_request(Request(file=file))


PLUGIN = '''
import skyrange.plugin as sky

@sky.detector("acme.loud")
class Loud(sky.Detector):
    """Raises an alert for each service with frames."""

    def observe(self, now, frames):
        return [self.alert(now, frames.ports[0].link, float(len(frames)), {"what": "<script>"})] if len(frames) else []
'''


def test_a_users_own_detector_runs_beside_the_shipped_ones(tmp_path: Path) -> None:
    plugin, log = tmp_path / "loud.py", silent_log(tmp_path / "a.tlog")
    plugin.write_text(PLUGIN)
    code, out, said = detect(str(log), "--plugin", str(plugin), "--detector", "acme.*", "--json", "--benign")
    assert code == 0, said
    told = json.loads(out)
    assert {row["kind"] for row in told["logs"][0]["alerts"]} == {"acme.loud"}
    assert sum(row["score"] for row in told["logs"][0]["alerts"]) == told["logs"][0]["frames"]
    assert told["false_alarms"][0]["kind"] == "acme.loud"
    page = render_page([judge(open_log(log), Request(kinds=("acme.*",)))], None)
    assert "&lt;script&gt;" in page
    assert "<script>" not in page.replace('<script>"use strict"', "").replace('<script type="application', "")


def test_what_damage_a_log_has_is_told_with_its_counts(tmp_path: Path) -> None:
    whole = silent_log(tmp_path / "a.tlog").read_bytes()
    frame = 8 + 12 + whole[9]  # the first one's bytes, with its time
    broken = bytearray(whole)
    broken[8 + 10] ^= 1  # the first one's checksum is wrong then
    data = bytes(broken[:frame]) + whole[:frame] + b"\x00garbage" + bytes(broken[frame:-3])
    (tmp_path / "b.log").write_bytes(data)
    findings = judge(open_log(tmp_path / "b.log"), GAP)
    said = remarks_of(findings)
    assert "file: it is called .log" in said
    assert "wrong checksum" in said
    assert "ends within a frame" in said
    assert findings.frames == judge(open_log(tmp_path / "a.tlog"), GAP).frames - 1


def test_frames_of_another_dialect_are_counted(tmp_path: Path) -> None:
    data = silent_log(tmp_path / "a.tlog").read_bytes()
    size = 8 + 12 + data[9]
    strange = struct.pack(">Q", START_US) + bytes([0xFD, 1, 0, 0, 0, 1, 1, 0x40, 0xE2, 0x00, 7, 1, 2])
    (tmp_path / "a.tlog").write_bytes(data[:size] + strange + data[size:])
    assert "1 frames are of messages that the dialect does not have" in remarks_of(
        judge(open_log(tmp_path / "a.tlog"), GAP)
    )


def test_a_clock_that_is_set_does_not_make_a_gap(tmp_path: Path) -> None:
    writer = TlogWriter()
    for second in range(20):
        writer.shift_us = 0 if second < 10 else -3600_000_000
        writer.heartbeat(float(second), armed=False)
    (tmp_path / "a.tlog").write_bytes(writer.data)
    findings = judge(open_log(tmp_path / "a.tlog"), GAP)
    assert not findings.alerts
    assert "it steps by -3,599.0 s at 9.0 s" in remarks_of(findings)


def test_a_clock_puts_frames_in_order_and_drops_times_that_cannot_be() -> None:
    clock = LogClock()
    base = START_US * 1000
    assert [clock.read(base + at) for at in (200, 300, 250, 400)] == [200, 300, 300, 400]
    assert clock.read(2**63) is None
    assert clock.read(base + 500) == 500
    said = " ".join(remark.text for remark in clock.remarks())
    assert "1 frames have a time that cannot be" in said
    assert "1 frames are up to a second earlier" in said


def two_vehicles(path: Path, *, each: bool) -> Path:
    """Two vehicles, and a station that numbers the frames of both links on their own, or in one sequence."""
    writer = TlogWriter()
    links = [dialect.MAVLink(None, 255, 190) for _ in range(2 if each else 1)]

    def add(time_s: float, message: Any, link: Any) -> None:
        writer.data += struct.pack(">Q", START_US + round(time_s * 1e6)) + message.pack(link)
        link.seq = (link.seq + 1) % 256

    beat = dialect.MAVLink_heartbeat_message(dialect.MAV_TYPE_GCS, dialect.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)
    for second in range(30):
        for system in (1, 2):
            writer.heartbeat(second + 0.1, armed=False, system=system)
        for link in links:
            add(second + 0.2, beat, link)
        for number, system in enumerate((1, 2)):
            request = dialect.MAVLink_param_request_read_message(system, 1, b"X", 0)
            add(second + 0.3, request, links[number if each else 0])
    path.write_bytes(writer.data)
    return path


@pytest.mark.parametrize("each", [True, False])
def test_frames_of_a_station_are_on_the_links_of_their_vehicles(tmp_path: Path, *, each: bool) -> None:
    log = open_log(two_vehicles(tmp_path / "a.tlog", each=each))
    assert log.vehicles == ["station/sys1", "station/sys2"]
    counts: dict[tuple[int, int], int] = {}
    for table in log.rows(log.ends):
        for place, received in zip(table["place"].to_pylist(), table["received"].to_pylist(), strict=True):
            counts[place, received] = counts.get((place, received), 0) + 1
    assert counts == {(0, 1): 30, (1, 1): 30, (0, 0): 60, (1, 0): 60}
    said = " ".join(remark.text for remark in log.remarks)
    assert ("found by its number" if each else "sent to every vehicle") in said


def test_one_vehicle_of_a_log_is_judged_alone(tmp_path: Path) -> None:
    path = two_vehicles(tmp_path / "a.tlog", each=True)
    log = open_log(path, LogOptions(systems=(2,)))
    assert log.vehicles == ["station/sys2"]
    assert "not asked for" in " ".join(remark.text for remark in log.remarks)
    findings = judge(log, SEQUENCE)
    assert findings.frames == 30 + 60, "what the station sent to the other one is left out"
    with pytest.raises(InputError, match="one of 1, 2"):
        open_log(path, LogOptions(systems=(7,)))


def test_a_part_of_a_log_is_judged_with_fresh_detectors(tmp_path: Path) -> None:
    path = silent_log(tmp_path / "a.tlog")
    assert not judge(open_log(path, LogOptions(to_s=19.0)), GAP).alerts
    log = open_log(path, LogOptions(from_s=18.0))
    assert log.epoch.unix_ns == (START_US + 18_000_000) * 1000
    (raised,) = judge(log, GAP).alerts
    assert raised.alert.at == 6.5 * NS_PER_S


@pytest.mark.parametrize("content", [b"", b"skyrange" * 100, b"\xfd\x00"])
def test_a_file_that_is_no_log_is_refused(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "a.tlog").write_bytes(content)
    with pytest.raises(InputError, match=r"tlog|telemetry log"):
        open_log(tmp_path / "a.tlog")


def test_a_log_of_the_autopilot_has_no_frames(tmp_path: Path) -> None:
    write_dataflash(tmp_path / "a.BIN", hop(10.0, 2.0))
    with pytest.raises(InputError, match="dataflash, which the autopilot writes on board"):
        open_log(tmp_path / "a.BIN")


def test_a_log_longer_than_a_month_is_refused(tmp_path: Path) -> None:
    writer = TlogWriter()
    for half_hour in range(1500):
        writer.heartbeat(1800.0 * half_hour, armed=False)
    (tmp_path / "a.tlog").write_bytes(writer.data)
    with pytest.raises(InputError, match="at most 30 days"):
        open_log(tmp_path / "a.tlog")


def test_the_command_prints_what_it_found_and_writes_files(tmp_path: Path) -> None:
    log, out = silent_log(tmp_path / "a.tlog"), tmp_path / "out"
    code, told, said = detect(str(log), "--benign", "--out", str(out))
    assert code == 0, said
    assert "a.tlog: not run: remote_id.plausibility" in said
    assert "a.tlog: runs with less: motion.fleet" in said
    assert "station/sys1: observed 50 s, in the air 39 s in 1 flight" in told
    assert "false alarms an hour, in the air" in told
    assert sorted(path.name for path in out.iterdir()) == [
        "alerts.csv", "alerts.parquet", "detection.html", "detection.json",
    ]  # fmt: skip
    table = pq.read_table(out / "alerts.parquet")
    assert table.schema.names[:2] == ["log", "utc"]
    kept = json.loads((out / "detection.json").read_text())
    assert table.num_rows == len(kept["logs"][0]["alerts"]) > 0
    assert len((out / "alerts.csv").read_text().splitlines()) == table.num_rows + 1
    code, _, said = detect(str(log), "--out", str(out))
    assert code != 0
    assert "a new or an empty folder" in said


def test_a_log_that_is_named_twice_is_refused(tmp_path: Path) -> None:
    log = silent_log(tmp_path / "a.tlog")
    code, _, said = detect(str(log), str(tmp_path / "." / "a.tlog"))
    assert code != 0
    assert "each log once" in said


def test_a_copy_of_a_log_is_noticed(tmp_path: Path) -> None:
    log = silent_log(tmp_path / "a.tlog")
    (tmp_path / "b.tlog").write_bytes(log.read_bytes())
    words = (str(log), str(tmp_path / "b.tlog"), "--benign", "--detector", "heartbeat.gap")
    code, _, said = detect(*words)
    assert code == 0
    assert "it counts twice" in said
    out = tmp_path / "out"
    _, told, _ = detect(*words, "--json", "--out", str(out))
    (warning,) = json.loads(told)["warnings"]
    assert "b.tlog have the same times and number of frames" in warning
    assert warning in (out / "detection.html").read_text()
    _, told, _ = detect(*words[:1], *words[2:], "--json")
    assert json.loads(told)["warnings"] == []


def test_mavlink_1_is_judged_as_mavlink_2_is(tmp_path: Path) -> None:
    alerts = []
    for version in (b"\xfe", b"\xfd"):
        writer = TlogWriter()
        packer = dialect.MAVLink(None, 1, 1)
        for second in range(20):
            beat = dialect.MAVLink_heartbeat_message(2, 3, 81, 3, 4, 3)
            if not 5 <= second < 13:
                frame = beat.pack(packer, force_mavlink1=version == b"\xfe")
                assert frame[:1] == version
                writer.data += struct.pack(">Q", START_US + second * 1_000_000) + frame
        (tmp_path / "a.tlog").write_bytes(writer.data)
        alerts.append(judge(open_log(tmp_path / "a.tlog"), GAP).alerts)
    assert alerts[0] == alerts[1]
    assert len(alerts[0]) == 1


def test_a_page_without_alerts_says_so(tmp_path: Path) -> None:
    page = render_page([judge(open_log(write_tlog(tmp_path / "a.tlog", hop(6.0, 2.0))), GAP)], None)
    assert "No alert was raised." in page
    assert "False alarms an hour" not in page


def test_rates_renew_the_table_of_a_page(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(f"before\n{RATES.begin}\nold\n{RATES.end}\nafter\n")
    quiet = FalseAlarmRate(0, 0.5, 0.0, (0.0, 7.38), 5.99)
    loud = FalseAlarmRate(3, 0.5, 6.0, (1.24, 17.5), 5.99)
    renew_page([], [DetectorRates("mavlink-rate", "mavlink.rate", 1, 9, whole=loud, airborne=quiet)], page)
    text = page.read_text()
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    assert "| `mavlink.rate` | 0 in 0.5 h | 0 | 0 to 7.38 | 3 in 0.5 h | 6 | 1.24 to 17.5 |" in text
    assert "no rate below 5.99 an hour" in text


@pytest.mark.parametrize(("benign", "reason"), [(False, "--benign"), (True, "a page without the marks")])
def test_a_page_is_checked_before_a_log_is_read(tmp_path: Path, benign: bool, reason: str) -> None:
    page = tmp_path / "page.md"
    page.write_text("nothing\n")
    with pytest.raises(InputError, match=reason):
        run_detectors(DetectOptions(logs=[tmp_path / "none.tlog"], benign=benign, page=page), as_json=True)
