"""Fence and rally points of a plan: they are uploaded and read back after the mission, and the autopilot obeys them."""

from __future__ import annotations

import json
from math import hypot
from pathlib import Path
from typing import Any

import pytest

from skyrange.codec.mission import MissionItem, format_plan, read_mission
from skyrange.codec.mission.fence_and_rally import circle, polygon, rally_point
from skyrange.codec.mission.items import Mission
from skyrange.core.geodesy import Origin
from skyrange.record import RunRecord
from skyrange.scenario.toml_files import load_text
from skyrange.study.runs import fly
from tests.ardupilot import needs_arducopter

pytestmark = pytest.mark.rotating

ORIGIN = Origin(47.3977, 8.5456, 408.0)
RALLY = (20.0, 30.0, 15.0)
SCENARIO = """
name = "fenced"
seed = 2
duration_s = {duration_s}
origin = [47.3977, 8.5456, 408]

[[operators]]
id = "blue"
params = {{ FENCE_ENABLE = 1, RTL_ALT = 1500, RTL_LOIT_TIME = 0 }}
vehicles = [{{ id = "b1", autopilot = "{autopilot}", plan = {plan} }}]
{more}
"""
OWN = """{ path = { points = [[0, 0, 20], [0, 150, 20]] }, mode = "MODE", rally = [[20, 30, 15]], \
fence = { circles = [{ center = [0, 0], radius_m = 60 }] } }"""


def at(east_m: float, north_m: float) -> tuple[float, float]:
    return ORIGIN.geodetic_of(east_m, north_m)


def plan_file(folder: Path, away_m: float = 0.0) -> Path:
    """A plan to a point 150 m north, with a fence at 60 m and a rally point; drawn `away_m` east of the origin."""
    corners = [at(away_m + east, north) for east, north in ((-60, -60), (60, -60), (60, 60), (-60, 60))]
    items = (
        MissionItem(3, 22, 0.0, 0.0, 0.0, 0.0, *at(away_m, 0.0), 20.0),
        MissionItem(3, 16, 0.0, 0.0, 0.0, 0.0, *at(away_m, 150.0), 20.0),
        MissionItem(2, 20, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    )
    fence = polygon(corners, inclusion=True) + circle(at(away_m, 0.0), 70.0, inclusion=True)
    fence += circle(at(away_m - 40.0, 0.0), 5.0, inclusion=False)
    rally = (rally_point(at(away_m + RALLY[0], RALLY[1]), RALLY[2]),)
    file = folder / "fenced.plan"
    file.write_text(format_plan(Mission(items, (*at(away_m, 0.0), 408.0), fence, rally)))
    return file


def flown(
    folder: Path, plan: str, *, duration_s: float = 70.0, autopilot: str = "builtin", more: str = ""
) -> RunRecord:
    text = SCENARIO.format(duration_s=duration_s, autopilot=autopilot, plan=plan, more=more)
    return fly(load_text(text), folder / "run", report=False)


def lists(record: RunRecord, kind: str) -> list[tuple[str, Any]]:
    rows = [row for row in record.table("decisions").to_pylist() if row["kind"] == kind]
    data = [json.loads(row["data"]) for row in rows]
    return [(one.get("list", "mission"), one["items"]) for one in data]


def farthest_m(record: RunRecord) -> float:
    truth = record.table("truth", ["east_m", "north_m"]).to_pydict()
    return max(map(hypot, truth["east_m"], truth["north_m"]))


def events(record: RunRecord) -> list[str]:
    return [row["kind"] for row in record.table("events").to_pylist()]


def check_obeyed(record: RunRecord) -> None:
    """A breach 60 m north, within what it takes to stop, and a landing at the rally point."""
    assert 60.0 < farthest_m(record) < 85.0
    truth = record.table("truth", ["east_m", "north_m", "up_m"]).to_pydict()
    assert hypot(truth["east_m"][-1] - RALLY[0], truth["north_m"][-1] - RALLY[1]) < 5.0
    assert truth["up_m"][-1] < 0.5


UPLOADED = [("mission", 3), ("fence", 6), ("rally points", 1)]


def test_fence_and_rally_points_of_a_plan_are_uploaded_read_back_and_obeyed(tmp_path: Path) -> None:
    file = plan_file(tmp_path)
    record = flown(tmp_path, f'{{ file = "{file}" }}', duration_s=85.0)
    assert lists(record, "decision.uploaded") == lists(record, "decision.verified") == UPLOADED
    assert "event.fence_breach" in events(record)
    check_obeyed(record)
    kept = read_mission(record.path / "missions" / "flown" / "blue" / "b1.plan")
    (told,) = record.manifest["mission_files"]
    assert (told["items"], told["fence"], told["rally"]) == (3, 6, 1)
    assert all(one["harmless"] for one in told["ignored"])
    assert (kept.fence, kept.rally) == (read_mission(file).fence, read_mission(file).rally)


def test_they_move_with_the_anchor_of_the_plan(tmp_path: Path) -> None:
    file = plan_file(tmp_path, away_m=5_000.0)
    record = flown(tmp_path, f'{{ file = "{file}", anchor = "start" }}', duration_s=30.0)
    assert "event.fence_breach" in events(record)
    assert 60.0 < farthest_m(record) < 85.0


@pytest.mark.parametrize("mode", ["auto", "guided"])
def test_a_scenario_declares_them_for_any_plan(mode: str, tmp_path: Path) -> None:
    record = flown(tmp_path, OWN.replace("MODE", mode), duration_s=45.0)
    areas = [("fence", 1), ("rally points", 1)]
    assert [one for one in lists(record, "decision.verified") if one[0] != "mission"] == areas
    if mode == "auto":
        assert "event.fence_breach" in events(record)
    else:  # ArduCopter refuses a target outside its fence (ModeGuided::set_destination)
        assert farthest_m(record) < 60.0


def test_a_lossy_link_and_a_mission_hash_do_not_hinder_them(tmp_path: Path) -> None:
    more = """
[[links]]
match = "gcs:*"
loss = 0.15
jitter_ms = 40
duplicate = 0.1
reorder = 0.05

[[defences]]
id = "hash"
kind = "mission.hash"
"""
    record = flown(tmp_path, f'{{ file = "{plan_file(tmp_path)}" }}', duration_s=14.0, more=more)
    assert lists(record, "decision.verified") == UPLOADED
    assert record.table("alerts").num_rows == 0


@needs_arducopter
def test_an_arducopter_takes_and_obeys_the_same(tmp_path: Path) -> None:
    record = flown(tmp_path, f'{{ file = "{plan_file(tmp_path)}" }}', duration_s=110.0, autopilot="ardupilot")
    assert lists(record, "decision.verified") == UPLOADED
    check_obeyed(record)
