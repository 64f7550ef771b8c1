"""The same scenario at other places of the Earth: the same decisions and outcomes, and tracks within centimetres."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skyrange.codec.mission import MissionItem, format_plan
from skyrange.codec.mission.items import Mission
from skyrange.core.geodesy import Origin
from skyrange.record import RunRecord
from skyrange.scenario.toml_files import load_text
from skyrange.study.runs import fly

pytestmark = pytest.mark.slow

SCENARIO = """
name = "somewhere"
seed = 3
duration_s = {duration_s}
origin = [{lat}, {lon}]
[sensors]
noise = 0
{more}
[[operators]]
id = "a"
approval = "{approval}"
  [[operators.vehicles]]
  id = "a1"
  plan = {plan}
  [[operators.vehicles]]
  id = "a2"
  start = [30, 30]
  plan = {{ path = {{ points = [[0, 0, 10], [25, 10, 12]] }}, end = "rtl", mode = "guided" }}
[[operators]]
id = "b"
approval = "{approval}"
  [[operators.vehicles]]
  id = "b1"
  start = [8, 4]
  depart_s = 1
  plan = {{ path = {{ points = [[0, 0, 10], [8, 12, 11]] }}, end = "land" }}
"""
PATH = '{ path = { points = [[0, 0, 10], [15, 20, 12], [-12, 8, 10]] }, end = "land" }'
PLACES = {
    "null island": (0.0, 0.0), "date line": (0.0, 180.0), "west of it": (52.0, -180.0), "near it": (52.0, 179.99985),
    "north": (70.0, 20.0), "south": (-52.0, 0.0),
}  # fmt: skip
FAST = ("null island", "date line", "north")
CLOSED = """
[[constraints]]
id = "closed"
corners_m = [[5, 12], [25, 12], [25, 28], [5, 28]]
upper_m = 60
"""


def flown(folder: Path, lat: float, lon: float, *, approval: str, more: str, plan: str, duration_s: float) -> RunRecord:
    text = SCENARIO.format(lat=lat, lon=lon, approval=approval, more=more, plan=plan, duration_s=duration_s)
    return fly(load_text(text), folder, report=False)


def tracks(record: RunRecord) -> dict[str, Any]:
    table = record.table("truth", ["vehicle", "east_m", "north_m", "up_m"]).to_pydict()
    enu_m = np.column_stack([table[name] for name in ("east_m", "north_m", "up_m")])
    vehicles = np.array(table["vehicle"])
    return {name: enu_m[vehicles == name] for name in sorted(set(table["vehicle"]))}


def decisions(record: RunRecord) -> list[tuple[str, str]]:
    return [(row["kind"], row["about"]) for row in record.table("decisions").to_pylist()]


def states(record: RunRecord) -> dict[str, Any]:
    return {name: outcome["state"] for name, outcome in record.outcomes.items()}


DECIDED: dict[str, Any] = {"approval": "authority", "more": "", "plan": PATH, "duration_s": 48}
LOITERED: dict[str, Any] = {"approval": "approve-all", "more": "", "duration_s": 70}


@pytest.fixture(scope="module")
def decided(tmp_path_factory: pytest.TempPathFactory) -> RunRecord:
    """The flight of `DECIDED` at 10° N, 10° E."""
    return flown(tmp_path_factory.mktemp("reference") / "run", 10.0, 10.0, **DECIDED)


@pytest.fixture(scope="module")
def loitered(tmp_path_factory: pytest.TempPathFactory, loiter: str) -> RunRecord:
    """The flight of `LOITERED` at 10° N, 10° E."""
    return flown(tmp_path_factory.mktemp("reference") / "run", 10.0, 10.0, plan=loiter, **LOITERED)


@pytest.fixture(scope="module")
def loiter(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A plan of a file with a loiter and a spline, drawn at 10° N, 10° E."""
    origin = Origin(10.0, 10.0)

    def item(command: int, param1: float, east_m: float, north_m: float, up_m: float) -> MissionItem:
        return MissionItem(3, command, param1, 0.0, 0.0, 0.0, *origin.geodetic_of(east_m, north_m), up_m)

    items = (
        item(22, 0, 0, 0, 10),
        item(16, 0, 12, 0, 10),
        item(19, 4, 20, 15, 10),
        item(82, 0, 0, 20, 10),
        item(21, 0, 0, 0, 0),
    )
    file = tmp_path_factory.mktemp("plan") / "m.plan"
    file.write_text(format_plan(Mission(items, (10.0, 10.0, 0.0))))
    return f'{{ file = "{file}", anchor = "start" }}'


def check_alike(folder: Path, place: str, here: RunRecord | None = None, **how: Any) -> None:
    """At a place as at 10° N, 10° E, where `here` was flown. Items of missions are in 1e-7 degrees, 11 mm."""
    here = flown(folder / "reference", 10.0, 10.0, **how) if here is None else here
    there = flown(folder / place, *PLACES[place], **how)
    assert {k: one["state"] for k, one in here.outcomes.items()} == {
        k: one["state"] for k, one in there.outcomes.items()
    }
    assert decisions(here) == decisions(there)
    one, other = tracks(here), tracks(there)
    assert {name: len(track) for name, track in one.items()} == {name: len(track) for name, track in other.items()}
    for name, track in one.items():
        assert np.abs(track - other[name]).max() < 0.05, name


@pytest.mark.parametrize(
    "place", [*FAST, *(pytest.param(place, marks=pytest.mark.slow) for place in PLACES if place not in FAST)]
)
def test_an_authority_decides_and_aircraft_fly_alike(place: str, tmp_path: Path, decided: RunRecord) -> None:
    check_alike(tmp_path, place, decided, **DECIDED)


def test_the_federated_approval_decides_alike_on_the_date_line(tmp_path: Path) -> None:
    check_alike(tmp_path, "date line", approval="federated", more="", plan=PATH, duration_s=30)


@pytest.mark.parametrize("place", ["reference", "date line"])
def test_a_hashgraph_accepts_one_of_two_that_conflict_anywhere(place: str, tmp_path: Path) -> None:
    """Which one depends on the signatures of what they say, and so on where they are."""
    where = PLACES.get(place, (10.0, 10.0))
    record = flown(tmp_path / "run", *where, approval="hashgraph", more="", plan=PATH, duration_s=12)
    rejected = [about for kind, about in decisions(record) if kind == "decision.approval_rejected"]
    assert rejected in (["a/a1"], ["b/b1"])


def test_an_area_that_is_closed_across_the_date_line_is_closed(tmp_path: Path) -> None:
    check_alike(tmp_path, "near it", approval="authority", more=CLOSED, plan=PATH, duration_s=30)


@pytest.mark.parametrize("place", ["null island", "near it"])
def test_a_mission_file_with_a_loiter_flies_alike(place: str, tmp_path: Path, loitered: RunRecord, loiter: str) -> None:
    check_alike(tmp_path, place, loitered, plan=loiter, **LOITERED)
