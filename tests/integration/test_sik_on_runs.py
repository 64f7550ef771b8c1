"""Runs over SiK radios: their reports in record, tlog and import, slower streams, jammers, forks and batches."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from skyrange.assembly.batches import explain_alone
from skyrange.assembly.build import build
from skyrange.codec.mavlink import decode, message_id
from skyrange.codec.mavlink import dialect as mav
from skyrange.flightlog.run_folder import read_run
from skyrange.kernel import Kernel
from skyrange.metrics.time_series import read_notes
from skyrange.record import RunRecord
from skyrange.record.write.memory_observer import MemoryObserver
from skyrange.runtime.batch import BatchedFlight, RunBatch
from skyrange.runtime.cores.division import divide
from skyrange.scenario import Scenario
from skyrange.study.runs import fly

pytestmark = pytest.mark.rotating


def make_scenario(duration_s: float = 24.0, more: str = "", **params: object) -> Scenario:
    """Two aircraft; the link of the first is over SiK radios with these parameters."""
    table = ", ".join(f"{key} = {str(value).lower()}" for key, value in params.items())
    return Scenario.from_toml(f"""
name = "sik"
duration_s = {duration_s}
origin = [40.0, -73.0]
[radio]
[[links]]
match = "gcs:blue/a"
channel = "sik"
sik = {{ {table} }}
[[operators]]
id = "blue"
station = [0, 0]
streams = "operator"
  [[operators.vehicles]]
  id = "a"
  start = [10, 0]
  plan = {{ speed_mps = 5, path = {{ alt_m = 20, points = [[100, 0]] }} }}
  [[operators.vehicles]]
  id = "b"
  start = [20, 0]
  plan = {{ speed_mps = 5, path = {{ alt_m = 20, points = [[100, 20]] }} }}
{more}
""")


def reports(record: RunRecord, direction: str) -> list[mav.MAVLink_radio_status_message]:
    return [
        decode(frame.payload)
        for frame in record.frames_with_payloads()
        if (frame.link, frame.direction) == ("gcs:blue/a", direction)
        and message_id(frame.payload) == mav.MAVLINK_MSG_ID_RADIO_STATUS
    ]


def sent_per_s(record: RunRecord, vehicle: str, window_s: tuple[float, float]) -> float:
    """Frames that an aircraft's autopilot sends in a second."""
    table = record.table("frames", ["link", "direction", "sent_ns"])
    rows = [
        row["sent_ns"] / 1e9
        for row in table.to_pylist()
        if row["link"] == f"autopilot:{vehicle}" and row["direction"] == "rev"
    ]
    count: int = sum(window_s[0] <= at < window_s[1] for at in rows)
    return count / (window_s[1] - window_s[0])


@pytest.fixture(scope="module")
def narrow(tmp_path_factory: pytest.TempPathFactory) -> RunRecord:
    """A radio that is too slow for the streams."""
    return fly(make_scenario(36.0, air_speed_kbps=16), tmp_path_factory.mktemp("sik") / "narrow", report=False)


def test_both_computers_get_a_report_a_second(narrow: RunRecord) -> None:
    for direction in ("fwd", "rev"):
        got = reports(narrow, direction)
        assert 30 <= len(got) <= 40
        assert {(one.get_srcSystem(), one.get_srcComponent()) for one in got} == {(51, 68)}
        assert [one.get_seq() for one in got] == list(range(len(got)))
        assert all(100 < one.rssi < 230 for one in got[8:])
        assert all(10 < one.noise < 60 for one in got[8:])


def test_streams_slow_down_until_the_buffer_drains(narrow: RunRecord) -> None:
    free = [one.txbuf for one in reports(narrow, "fwd")]
    assert min(free) < 50
    asked = sent_per_s(narrow, "blue/b", (28, 36))
    slowed = sent_per_s(narrow, "blue/a", (28, 36))
    assert asked > 50
    assert slowed < 0.8 * asked


def test_an_autopilot_without_such_a_radio_heeds_no_report(narrow: RunRecord, tmp_path: Path) -> None:
    """The same radio without framing does not report, and its aircraft sends as fast as the other one."""
    silent = fly(make_scenario(20.0, air_speed_kbps=16, mavlink=False), tmp_path / "silent", report=False)
    assert reports(silent, "fwd") == []
    assert sent_per_s(silent, "blue/a", (12, 20)) == pytest.approx(sent_per_s(silent, "blue/b", (12, 20)), rel=0.05)


def test_the_station_takes_reports_for_its_radios(narrow: RunRecord) -> None:
    assert not any(note.kind == "decision.foreign_frame" for note in read_notes(narrow, "decisions"))


def test_an_import_of_the_run_shows_the_radio(narrow: RunRecord) -> None:
    radio = read_run(narrow.path, "blue/a").tables["radio"]
    mine = reports(narrow, "rev")
    assert len(radio) == len(mine)
    assert np.array_equal(radio["rssi"], [one.rssi for one in mine])
    assert np.array_equal(radio["remote_noise"], [one.remnoise for one in mine])


def test_a_jammer_in_the_band_takes_the_link_and_shows_as_noise(tmp_path: Path) -> None:
    jam = """
[[attacks]]
id = "noise"
kind = "remote_id.jam"
start_s = 12
params = { centre_mhz = 921.5, bandwidth_mhz = 13, power_dbm = 30, transmitter_m = [40, 10, 2] }
"""
    record = fly(make_scenario(20.0, jam, power_dbm=10, aircraft_dbm=10), tmp_path / "jam", report=False)
    before, after = (
        [one.noise for one in got[slice(*rows)]] for got in [reports(record, "rev")] for rows in ((6, 11), (15, 20))
    )
    assert np.median(after) > np.median(before) + 40
    lost = [
        row["fate"] == "lost"
        for row in record.table("frames", ["link", "direction", "fate", "sent_ns"]).to_pylist()
        if (row["link"], row["direction"]) == ("gcs:blue/a", "rev") and row["sent_ns"] > 14e9
    ]
    assert sum(lost) > 0.5 * len(lost)


def test_a_fork_continues_as_the_run_does() -> None:
    scenario = make_scenario(9.0, air_speed_kbps=16)
    seen = [MemoryObserver(), MemoryObserver(), MemoryObserver()]
    straight = Kernel(build(scenario).wiring, [seen[0]])
    straight.advance(9_000_000_000)
    stem = Kernel(build(scenario).wiring, [seen[1]])
    stem.advance(5_530_000_000)
    seen[2] = copy.deepcopy(seen[1])
    fork = stem.fork([seen[2]])
    fork.advance(9_000_000_000)
    stem.advance(9_000_000_000)
    rows = [[(f.sent_ns, f.id, f.fate, f.arrived_ns) for f in one.frames] for one in seen]
    assert sorted(rows[0]) == sorted(rows[1]) == sorted(rows[2])


def test_runs_of_a_batch_are_those_of_themselves_alone(tmp_path: Path) -> None:
    scenario = make_scenario(8.0, air_speed_kbps=16)
    assert not explain_alone(scenario)
    chosen: Sequence[Scenario] = [scenario.model_copy(update={"seed": seed}) for seed in (1, 2)]
    batch = RunBatch.start([BatchedFlight(one, tmp_path / str(one.seed), True) for one in chosen])
    batch.execute()
    for one, together in zip(chosen, batch.records(), strict=True):
        alone = fly(one, tmp_path / f"alone-{one.seed}", report=False)
        assert alone.manifest["digests"] == together.manifest["digests"]


def test_a_run_over_such_radios_flies_on_one_core() -> None:
    assert "share one spectrum" in divide(make_scenario(), 2).reason
