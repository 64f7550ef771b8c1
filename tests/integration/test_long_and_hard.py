"""Endurance of a fleet: long missions over bad links, a ground station that vanishes and returns, every item.

The links are as bad as a poor mobile network: 1 % of the frames lost, and up to 200 ms of jitter on `gcs`.
"""

from __future__ import annotations

import json
import tracemalloc
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from skyrange.assembly.build import Additions
from skyrange.codec.mavlink import dialect
from skyrange.contracts.frames import Frame
from skyrange.contracts.links import Act, TapPlacement
from skyrange.contracts.verdicts import Drop, Verdict
from skyrange.core.time import Time, from_seconds
from skyrange.record import RunRecord
from skyrange.record import load as load_run
from skyrange.runtime.run import Run
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.shipped import load
from skyrange.study.runs import fly
from skyrange.vehicle.builtin.modes import Mode
from skyrange.vehicle.contract import VehicleSpec
from tests.integration.flight_harness import RELATIVE, Item, Range, jump, land, speed, start, takeoff, waypoint
from tests.integration.hovering import beat, modes, put, texts

pytestmark = pytest.mark.slow
BAD_LINKS = 'links=[{match="gcs:*", loss=0.01, jitter_ms=200}]'
MISHAPS = {"event.crash", "event.collision", "event.bad_frame", "event.ekf_failsafe", "event.glitch"}
AWAY = {"blue": (0, 84), "green": (84, 0), "orange": (0, -84), "purple": (-84, 0)}
"""Where `city-fleet` sends each operator's aircraft, metres east and north of their starts."""


def deliveries(count: int, laps: int, duration_s: float) -> Scenario:
    """`city-fleet` over bad links, each aircraft delivering so many times before it lands."""
    changes = [
        f"operators.*.fleets.*.count={count}",
        f"duration_s={duration_s}",
        BAD_LINKS,
    ]
    for operator, (east, north) in AWAY.items():
        lap = [[east, north], [east, north, 12], [east, north], [0, 0]]
        changes.append(f"operators.{operator}.fleets.0.plan.path.points={json.dumps([[0, 0], *lap * laps])}")
    return load("city-fleet", changes)


def kinds(record: RunRecord) -> list[str]:
    """Every event's kind."""
    return [str(kind) for kind in record.table("events", ["kind"]).column("kind").to_pylist()]


def test_deliveries_over_bad_links_all_arrive_alike_and_keep_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario = deliveries(count=1, laps=2, duration_s=400)
    record = fly(scenario, tmp_path / "one", report=False)
    found = {vehicle: (outcome["state"], outcome["reason"]) for vehicle, outcome in record.outcomes.items()}
    assert found == dict.fromkeys(found, ("complete", ""))
    assert len(found) == 4
    assert not MISHAPS & set(kinds(record))
    frames = record.table("frames", ["link", "fate"]).to_pylist()
    fates = [row["fate"] for row in frames if row["link"].startswith("gcs:")]
    assert fates.count("lost") / len(fates) == pytest.approx(0.01, rel=0.3)  # 13,000 frames: σ is 9 %

    monkeypatch.setattr("skyrange.record.write.files.part_writer.GROUP_ROWS", 200)  # columns wait for a row group
    run = Run.start(scenario, tmp_path / "two")
    run.advance(60.0)
    tracemalloc.start()
    try:
        held = []
        for step in range(1, 9):
            run.advance(60.0 + 5.0 * step)
            run.recorder.flush()  # else it does so each wall second, and a quick machine flies far in one
            held.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    # what was recorded has gone to files: 20 s of it are some 2,500 frames, which take more than 0.5 MB as objects
    assert min(held[4:]) - min(held[:4]) < 300_000
    run.advance(400.0)
    run.finish()
    assert load_run(tmp_path / "two").manifest["digests"] == record.manifest["digests"]


@dataclass
class Blackhole:
    """Lets nothing through."""

    link: str

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        return [Drop()]

    def next_wakeup(self) -> Time | None:
        return None

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        return ()


def without_station(folder: Path, *changes: str) -> RunRecord:
    """Four deliveries whose ground stations hear and say nothing from 60 to 90 s."""
    settings = ("operators.*.fleets.*.count=1", BAD_LINKS, *changes)
    taps = [TapPlacement("gcs:*", "companion", Blackhole, "cut")]
    plans = [Act("cut", start_ns=from_seconds(60.0), stop_ns=from_seconds(90.0))]
    return fly(load("city-fleet", settings), folder, additions=Additions(taps, plans), report=False)


def test_a_station_that_vanishes_sends_the_fleet_home_and_is_heard_again(tmp_path: Path) -> None:
    """FS_GCS_ENABLE is 1 in city-fleet: RTL 5 s after the last heartbeat (events.cpp `failsafe_gcs_check`)."""
    record = without_station(tmp_path / "run")
    events = record.table("events").to_pylist()
    homeward = [row for row in events if row["kind"] == "event.mode" and "gcs_failsafe" in row["data"]]
    assert sorted(row["about"] for row in homeward) == sorted(record.outcomes)
    assert all('"RTL"' in row["data"] for row in homeward)
    # a heartbeat a second, as old as 0.35 s and one in a hundred lost
    assert all(63.9 < row["time_ns"] * 1e-9 < 65.6 for row in homeward)
    assert not MISHAPS & {row["kind"] for row in events}
    assert sum(row["kind"] == "event.disarmed" for row in events) == 4
    decisions = record.table("decisions", ["time_ns", "kind"]).to_pylist()
    lost = [row["time_ns"] * 1e-9 for row in decisions if row["kind"] == "decision.link_lost"]
    found = [row["time_ns"] * 1e-9 for row in decisions if row["kind"] == "decision.link_restored"]
    assert len(lost) == len(found) == 4
    assert 64.9 < min(lost) <= max(lost) < 68.0
    assert 89.9 < min(found) <= max(found) < 92.5
    # they stand at home with half a plan flown, and their stations know
    track = record.table("truth", ["vehicle", "up_m"]).to_pylist()
    assert {row["vehicle"]: row["up_m"] < 0.3 for row in track} == dict.fromkeys(record.outcomes, True)
    assert {outcome["state"] for outcome in record.outcomes.values()} == {"failed"}
    assert all(outcome["reason"].startswith("disarmed at item") for outcome in record.outcomes.values())
    assert without_station(tmp_path / "again").manifest["digests"] == record.manifest["digests"]


def test_a_station_that_vanishes_may_leave_the_missions_alone(tmp_path: Path) -> None:
    record = without_station(tmp_path / "run", "operators.*.params={FS_GCS_ENABLE=1, FS_OPTIONS=2}")
    assert {outcome["state"] for outcome in record.outcomes.values()} == {"complete"}
    assert not MISHAPS & set(kinds(record))


def test_a_station_that_returns_is_obeyed_again() -> None:
    r = Range([VehicleSpec("blue/b1", 1, params={"FS_GCS_ENABLE": 1, "RTL_LOIT_TIME": 0})])
    r.upload("blue/b1", [takeoff(12), waypoint(0, 80, 12), waypoint(80, 80, 12), land(80, 0)])
    start(r, "blue/b1")
    while r.seconds < 14.0:
        beat(r)
        r.run(1.0)
    gone = r.seconds
    r.run(9.0)
    assert modes(r, gone) == [("RTL", "gcs_failsafe")]
    back = r.seconds
    beat(r)
    r.run(0.3)
    assert [words for _, words in texts(r, back)] == ["GCS Failsafe Cleared"]
    assert r.mode("blue/b1", Mode.AUTO) == 0
    while not r.events("event.disarmed"):
        beat(r)
        r.run(1.0)
        assert r.seconds < 120.0
    assert [note.data["seq"] for note in r.events("event.item_reached")] == [1, 2, 3]
    assert r.positions()[0] == pytest.approx([80.0, 0.0, 0.0], abs=0.5)
    put(r, "FS_GCS_ENABLE", 0)  # and it may be told anything on the ground
    assert r.mode("blue/b1", Mode.GUIDED) == 0
    assert r.arm("blue/b1") == 0


def placed(command: int, east: float, north: float, up: float, *params: float) -> Item:
    """An item with a place."""
    a, b, c, d = (*params, *[0.0] * (4 - len(params)))
    return (RELATIVE, command, (a, b, c, d), (east, north, up))


def plain(command: int, *params: float) -> Item:
    """An item without one."""
    a, b, c, d = (*params, *[0.0] * (4 - len(params)))
    return (dialect.MAV_FRAME_MISSION, command, (a, b, c, d), (0.0, 0.0, 0.0))


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_every_kind_of_mission_item_in_one_flight(noise: float) -> None:
    d = dialect
    items: list[Item] = [
        takeoff(10),
        placed(d.MAV_CMD_DO_SET_ROI, 50, 50, 0),
        placed(d.MAV_CMD_NAV_SPLINE_WAYPOINT, 20, 20, 12),
        placed(d.MAV_CMD_NAV_SPLINE_WAYPOINT, 40, 0, 12),
        waypoint(40, -20, 12),
        placed(d.MAV_CMD_NAV_SPLINE_WAYPOINT, 20, -40, 12),
        placed(d.MAV_CMD_NAV_SPLINE_WAYPOINT, 0, -20, 12, 1.0),
        plain(d.MAV_CMD_DO_SET_ROI_NONE),
        speed(3.0),
        plain(d.MAV_CMD_CONDITION_DISTANCE, 5.0),
        plain(d.MAV_CMD_CONDITION_YAW, 90.0, 30.0, 1.0),
        waypoint(0, 0, 12, 1.0),
        jump(12, 1),
        plain(d.MAV_CMD_CONDITION_DELAY, 1.0),
        placed(d.MAV_CMD_NAV_LOITER_TIME, 10, 0, 12, 2.0),
        placed(d.MAV_CMD_NAV_LOITER_TURNS, 10, 10, 12, 1.0, 0.0, 8.0),
        placed(d.MAV_CMD_NAV_LOITER_TO_ALT, 10, 10, 16),
        plain(d.MAV_CMD_NAV_DELAY, 2.0, -1.0, -1.0, -1.0),
        placed(d.MAV_CMD_DO_SET_ROI_LOCATION, 50, 50, 0),
        plain(d.MAV_CMD_DO_SET_HOME, 1.0),
        placed(d.MAV_CMD_DO_LAND_START, 0, 0, 0),
        land(5, 5),
        takeoff(8),
        plain(d.MAV_CMD_NAV_RETURN_TO_LAUNCH),
    ]
    after_landing = {"MIS_OPTIONS": 4.0}  # the mission goes on where a take-off follows
    r = Range([VehicleSpec("blue/b1", 1, params=after_landing)], noise=noise)
    r.run(30.0)
    assert r.upload("blue/b1", items) == d.MAV_MISSION_ACCEPTED
    start(r, "blue/b1")
    r.run_until(r.has("event.disarmed"), 300.0)
    assert [note.data["reason"] for note in r.events("event.disarmed")] == ["mission_exit"]
    reached = [note.data["seq"] for note in r.events("event.item_reached")]
    flown = [1, 3, 4, 5, 6, 7, 12, 12, 15, 16, 17, 18, 22, 23]
    assert [seq for seq in reached if seq != 24] == flown
    assert not r.events("event.crash")
    assert np.abs(r.positions()[0, 2]) < 0.1
