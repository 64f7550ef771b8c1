"""Emergency landings in flight: beside the cars by depth, on them without; what is missing is said before the run."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import skyrange
from skyrange.assembly.city import build_city
from skyrange.core.errors import InputError
from skyrange.record import RunRecord
from skyrange.scenario.shipped import load
from skyrange.world.airframes import AIRFRAMES

pytestmark = pytest.mark.rotating

B1 = "operators.blue.vehicles.b1"
QUICK = ("duration_s=70", 'record.level="study"')


def decisions(run: RunRecord) -> dict[str, dict[str, object]]:
    """The last decision of each kind about the landing."""
    return {
        row["kind"]: json.loads(row["data"])
        for row in run.table("decisions").to_pylist()
        if row["kind"].startswith("decision.landing")
    }


def test_it_lands_between_the_cars(tmp_path: Path) -> None:
    scenario = load("emergency-landing", (*QUICK, "attacks=[]"))
    run = skyrange.run(scenario, tmp_path / "run")
    made = decisions(run)
    assert next(iter(made)) == "decision.landing_search"
    assert "decision.landing" in made
    events = [row["kind"] for row in run.table("events").to_pylist()]
    assert "event.landed" in events
    assert not {"event.collision", "event.crash"} & set(events)
    end = run.table("truth").to_pylist()[-1]
    city = build_city(scenario)
    assert city is not None
    assert end["on_ground"]
    assert not city.obstacles_within(end["east_m"], end["north_m"], AIRFRAMES["iris"].radius_m)


def test_it_comes_down_on_the_cars_by_a_false_floor(tmp_path: Path) -> None:
    run = skyrange.run(load("emergency-landing", (*QUICK, f"{B1}.landing={{second_look=false}}")), tmp_path / "run")
    place = decisions(run)["decision.landing"]
    assert isinstance(place["up_m"], float)
    assert place["up_m"] > 3.0, "a floor above the cars"
    assert "event.collision" in [row["kind"] for row in run.table("events").to_pylist()]


def test_it_needs_a_sensor_that_looks_down(tmp_path: Path) -> None:
    ahead = f'{B1}.sensors=[{{model="d435"}}]'
    with pytest.raises(InputError, match=r"b1.landing: depth — expected a LiDAR or a depth camera that looks down"):
        skyrange.run(load("emergency-landing", (ahead, "attacks=[]")), tmp_path / "run")
