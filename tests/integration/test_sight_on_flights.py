"""Sight in flight: a ghost is disbelieved, a real aircraft is not, and one without radio is avoided."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import skyrange
from skyrange.core.errors import InputError
from skyrange.record import RunRecord
from skyrange.scenario.model.scenario import Scenario

pytestmark = pytest.mark.rotating

TEXT = """
name = "sight"
seed = 2
duration_s = 46
origin = { lat = 40.7780, lon = -73.9550, alt_msl_m = 20, geoid_m = -32.7 }
record.level = "study"
[radio]
[[operators]]
id = "blue"
avoidance = { kind = "geometric", fusion = "confirm" }
  [[operators.vehicles]]
  plan = { path = { points = [[0, 0], [0, 220]], alt_m = 30 }, speed_mps = 5, end = "land" }
  sensors = [{ model = "hap", stabilised = true, azimuth_deg = [-14, 14], pulses = 10547, rate_hz = 5 }]
[[attacks]]
id = "ghost"
kind = "remote_id.spoof"
start_s = 20
params = { at = [2, 110, 30], transmitter_m = [30, 120, 2] }
"""


def fly(folder: Path, *changes: str) -> RunRecord:
    return skyrange.run(Scenario.from_toml(TEXT, changes), folder)


def told(run: RunRecord, kind: str) -> list[tuple[float, dict[str, Any]]]:
    """Times in seconds and data of the events or decisions of a kind."""
    table = run.table("events" if kind.startswith("event.") else "decisions").to_pylist()
    return [(row["time_ns"] / 1e9, json.loads(row["data"])) for row in table if row["kind"] == kind]


def test_a_ghost_is_disbelieved_and_the_mission_goes_on(tmp_path: Path) -> None:
    believed = fly(tmp_path / "radio", "operators.blue.avoidance.fusion=radio")
    run = fly(tmp_path / "confirm")
    (at, verdict), *_ = told(run, "event.sight")
    assert verdict["verdict"] == "not-seen"
    assert 40.0 < verdict["away_m"] < 90.0
    resumed = [time for time, _ in told(run, "decision.resume") if time > at]
    assert resumed
    assert resumed[0] < min((time for time, _ in told(believed, "decision.resume")), default=46.0) - 3.0
    assert told(believed, "event.sight") == []


def test_a_real_aircraft_in_the_place_of_the_ghost_is_seen_and_avoided(tmp_path: Path) -> None:
    run = fly(tmp_path / "run", "attacks.ghost.honest=true")
    assert [data["verdict"] for _, data in told(run, "event.sight")][:1] == ["seen"]
    assert told(run, "event.collision") == []
    assert told(run, "decision.avoid")


def test_what_does_not_broadcast_is_seen_alone(tmp_path: Path) -> None:
    """Another aircraft without Remote ID climbs in the way: only sight avoids it."""
    silent = (
        'operators=[{id="blue",avoidance={kind="geometric",fusion="FUSION"},vehicles=[{plan={path={points=[[0,0],[0,220]],'
        'alt_m=30},speed_mps=5},sensors=[{model="hap",stabilised=true,azimuth_deg=[-14,14],pulses=10547,rate_hz=5}]}]},{id="red",remote_id={transports=[]},'
        "vehicles=[{start=[1,110],plan={path={points=[[0,0],[0,1]],alt_m=30}}}]}]"
    )
    runs = {
        fusion: fly(tmp_path / fusion, "attacks=[]", "duration_s=42", silent.replace("FUSION", fusion))
        for fusion in ("confirm", "either")
    }
    assert told(runs["confirm"], "decision.avoid") == []
    avoided = told(runs["either"], "decision.avoid")
    assert avoided
    assert avoided[0][1]["track"] == ""


def test_fusion_needs_sensors(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"b1.avoidance.fusion: confirm — expected radio: the aircraft has no LiDAR"):
        fly(tmp_path / "run", "operators.blue.vehicles.0.sensors=[]")


def test_the_defence_needs_sensors(tmp_path: Path) -> None:
    defence = 'defences=[{id="s",kind="remote_id.sight"}]'
    changes = ("operators.blue.vehicles.0.sensors=[]", "operators.blue.avoidance.fusion=radio", defence)
    with pytest.raises(InputError, match="no sensors — expected an aircraft with a LiDAR"):
        fly(tmp_path / "run", *changes)


def test_the_defence_drops_the_broadcasts_of_a_ghost(tmp_path: Path) -> None:
    run = fly(tmp_path / "run", "operators.blue.avoidance.fusion=radio", 'defences=[{id="s",kind="remote_id.sight"}]')
    alarms = run.table("alerts").to_pylist()
    assert alarms
    assert {row["kind"] for row in alarms} == {"remote_id.sight"}
    assert all(row["time_ns"] > 25e9 for row in alarms)
