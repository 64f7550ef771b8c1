"""Faults injected into a live range in flight have the effects that the table in the docs has; in virtual time.

`test_live_faults_real` has three of them on real processes.
"""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest

from skyrange.core.errors import ComponentError
from skyrange.core.time import NS_PER_S
from skyrange.record import load
from skyrange.record.read.run import RunRecord
from tests.integration.live_faults import FAULTS, Harmed, LiveFault, VirtualHarmed, gap_s, harm_virtual, rows_of
from tests.integration.live_programs import ONE_AIRCRAFT
from tests.integration.live_virtual import VirtualFlight, fly_virtual, prepared

pytestmark = pytest.mark.rotating

PAGE = Path(__file__).parents[2] / "docs" / "explanation" / "live-faults.md"
COMMITTED = rows_of(PAGE.read_text())


def made(name: str, folder: Path) -> tuple[LiveFault, VirtualHarmed, RunRecord]:
    fault = next(one for one in FAULTS if one.name == name)
    harmed, record = harm_virtual(fault, folder)
    assert_rows(fault, harmed, record)
    return fault, harmed, record


def assert_rows(fault: LiveFault, harmed: Harmed, record: RunRecord) -> None:
    """What happened is what the table says."""
    rows = fault.rows(record, harmed)
    assert rows == [row for row in COMMITTED if row.fault in {one.fault for one in rows}]


def statuses(record: RunRecord) -> dict[str, list[str]]:
    """How each node's parts ended, in order of their starts."""
    found: dict[str, list[str]] = {}
    for node in record.manifest["nodes"]:
        found.setdefault(node["name"], []).append(node["status"])
    return found


def sent_by(record: RunRecord, sender: str, link: str) -> list[float]:
    """When, in s."""
    rows = record.table("frames", ["link", "sender", "sent_ns"]).to_pylist()
    return sorted(row["sent_ns"] / NS_PER_S for row in rows if row["sender"] == sender and row["link"] == link)


def test_the_table_has_every_fault() -> None:
    whats = [fault.differs.get(vehicle, fault.what) for fault in FAULTS for vehicle in fault.told]
    assert [row.fault for row in COMMITTED] == whats


@pytest.mark.slow
def test_a_ground_station_is_started_anew_and_goes_on_watching(tmp_path: Path) -> None:
    _, harmed, record = made("station", tmp_path)
    assert_station_went_on(record, harmed.hit_s)


def assert_station_went_on(record: RunRecord, hit_s: float) -> None:
    assert list(record.manifest["live"]["started_anew"]) == ["blue.gcs"]
    assert statuses(record)["blue.gcs"] == ["killed", "complete"]
    times = sent_by(record, "blue.gcs", "gcs:blue/b2")
    assert times[0] < hit_s < times[-1]
    serials = record.table("frames", ["link", "sender", "serial"]).to_pylist()
    own = [row["serial"] for row in serials if row["sender"] == "blue.gcs" and row["link"] == "gcs:blue/b2"]
    assert len(own) == len(set(own))


@pytest.mark.slow
def test_companion_proxy_and_approval_are_started_anew(tmp_path: Path) -> None:
    _, harmed, record = made("others", tmp_path)
    gone = {"approval", "blue/b1.companion", "blue/b2.proxy"}
    assert set(record.manifest["live"]["started_anew"]) == gone
    assert {name for name, ended in statuses(record).items() if ended == ["killed", "complete"]} == gone
    broadcasts = sent_by(record, "blue/b1.companion", "rid_up:blue/b1")
    silent = max(later - earlier for earlier, later in itertools.pairwise(broadcasts))
    assert 1.0 < silent < 15.0
    assert broadcasts[-1] > harmed.hit_s + silent


@pytest.mark.slow
def test_a_killed_companion_or_proxy_is_a_lost_link(tmp_path: Path) -> None:
    _, harmed, record = made("others for good", tmp_path)
    assert set(record.manifest["live"]["ended"]) == {"approval", "blue/b1.companion", "blue/b2.proxy"}
    for dead in ("blue/b1.companion", "blue/b2.proxy"):
        assert statuses(record)[dead] == ["killed"]
    assert max(sent_by(record, "blue.gcs", "gcs:blue/b1")) > harmed.hit_s + 10.0


@pytest.mark.slow
def test_without_its_world_a_range_ends_and_keeps_what_it_recorded(tmp_path: Path) -> None:
    _, harmed, record = made("world", tmp_path)
    assert "world: signal SIGKILL" in str(harmed.ended_by)
    assert record.status == "failed"
    assert max(record.table("truth", ["time_ns"]).column("time_ns").to_pylist()) > (harmed.hit_s - 1.5) * NS_PER_S


@pytest.mark.slow
def test_a_paused_ground_station_does_not_make_good_its_heartbeats(tmp_path: Path) -> None:
    _, _harmed, record = made("station paused", tmp_path)
    assert 4.5 < gap_s(record, "blue.gcs") < 7.0
    times = sent_by(record, "blue.gcs", "gcs:blue/b2")
    woke = next(later for earlier, later in itertools.pairwise(times) if later - earlier > 4.5)
    assert len([at for at in times if woke <= at < woke + 1.0]) <= 3
    assert record.manifest["live"]["late_max_s"]["blue.gcs"] == pytest.approx(5.0, abs=1.0)
    assert "blue.gcs" in record.manifest["live"]["fell_behind"]


@pytest.mark.slow
def test_a_paused_world_makes_good_every_tick(tmp_path: Path) -> None:
    _, _harmed, record = made("world paused", tmp_path)
    assert record.manifest["live"]["late_max_s"]["world"] == pytest.approx(5.0, abs=1.0)
    rows = record.table("truth", ["time_ns", "vehicle"]).to_pylist()
    times = [row["time_ns"] for row in rows if row["vehicle"] == "blue/b1"]
    assert max(later - earlier for earlier, later in itertools.pairwise(times)) < 0.2 * NS_PER_S


@pytest.mark.slow
def test_a_tcp_link_that_is_cut_is_there_again(tmp_path: Path) -> None:
    _, _harmed, record = made("link", tmp_path)
    assert_link_was_back(record)


def assert_link_was_back(record: RunRecord) -> None:
    frames = record.table("frames", ["link", "fate"]).to_pylist()
    assert any(row["fate"] == "lost" for row in frames if row["link"] == "log:blue/b2")
    times = sent_by(record, "blue/b2.proxy", "log:blue/b2")
    assert max(later - earlier for earlier, later in itertools.pairwise(times)) < 2.0


def test_a_pause_a_cut_link_and_a_restart_in_a_short_flight(tmp_path: Path) -> None:
    """What the others tell of whole flights, of one aircraft until it has taken off."""

    async def meddle(flight: VirtualFlight) -> None:
        harmed = VirtualHarmed(flight)
        await flight.reach(2.0)
        await harmed.pause("blue.gcs", 3.0)
        await flight.reach(6.5)
        await harmed.cut_tcp()
        await flight.reach(7.0)
        await harmed.kill("blue-b1.companion")

    flight = prepared(ONE_AIRCRAFT.format(seconds=10), tmp_path, on_death="restart")
    record = fly_virtual(flight, meddle)
    assert record.status == "complete"
    assert 2.5 < gap_s(record, "blue.gcs") < 4.5
    assert record.manifest["live"]["late_max_s"]["blue.gcs"] == pytest.approx(3.0, abs=1.0)
    assert list(record.manifest["live"]["fell_behind"]) == ["blue.gcs"]
    assert list(record.manifest["live"]["started_anew"]) == ["blue/b1.companion"]
    assert statuses(record)["blue/b1.companion"] == ["killed", "complete"]
    times = sent_by(record, "blue/b1.proxy", "log:blue/b1")
    assert max(later - earlier for earlier, later in itertools.pairwise(times)) < 2.0
    assert times[-1] > 9.5


def test_a_short_flight_without_its_world_ends_and_is_kept(tmp_path: Path) -> None:
    async def kill_the_world(flight: VirtualFlight) -> None:
        await flight.reach(3.0)
        await VirtualHarmed(flight).kill("world")

    with pytest.raises(ComponentError, match="world: signal SIGKILL") as caught:
        fly_virtual(prepared(ONE_AIRCRAFT.format(seconds=6), tmp_path, on_death="restart"), kill_the_world)
    assert caught.value.exit_code == 3
    record = load(tmp_path / "run")
    assert record.status == "failed"
    assert max(record.table("truth", ["time_ns"]).column("time_ns").to_pylist()) > 1.5 * NS_PER_S
