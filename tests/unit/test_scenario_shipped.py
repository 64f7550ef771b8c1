from __future__ import annotations

import json
from pathlib import Path

import pytest

from skyrange.codec import missions
from skyrange.core.errors import InputError
from skyrange.gcs.routes import enu_points, estimated_duration_s
from skyrange.scenario.catalogue import FOLDER, SHIPPED, load, source_of
from skyrange.scenario.check import check
from skyrange.scenario.emit import to_toml
from skyrange.scenario.flight import flight_plan
from skyrange.scenario.load import load_text
from skyrange.scenario.placing import MARGIN_M, placed
from skyrange.scenario.surroundings import build_city

STREETS = Path(__file__).parents[3] / "shared/data/cities/manhattan-upper-east-side.geojson"


def test_the_catalogue_is_what_is_shipped():
    assert {file.stem for file in FOLDER.glob("*.toml")} == set(SHIPPED)
    assert all(load(name).name == name for name in SHIPPED)


def test_squares_is_the_published_demonstration():
    scenario = load("squares")
    assert (scenario.origin.lat, scenario.origin.lon, scenario.origin.alt_msl_m) == (-35.3633280, 149.1652241, 0)
    fleet = {f"{operator.id}/{vehicle.id}": vehicle for operator, vehicle in scenario.fleet}
    assert {name: (v.start.east_m, v.start.north_m) for name, v in fleet.items()} == {
        "blue/b1": (5, 5),
        "blue/b2": (10, 0),
        "green/g1": (-5, -10),
        "green/g2": (-15, 0),
        "green/g3": (0, -20),
    }
    assert [v.plan.square.side_m for v in fleet.values()] == [5, 7, 4, 3, 2]
    assert {v.plan.square.alt_m for v in fleet.values()} == {5}
    assert {v.depart_s for v in fleet.values()} == {10}
    assert scenario.duration_s == 180
    assert check(scenario, None) == []


def test_survey_flies_files_of_both_kinds_in_its_downtown():
    scenario = load("survey")
    assert len(list(scenario.fleet)) == 8
    assert len(scenario.operators) == 2
    files = {Path(vehicle.plan.file) for _, vehicle in scenario.fleet}
    assert {file.suffix for file in files} == {".plan", ".waypoints"}
    _flies(scenario)


def test_its_survey_is_a_complex_item_whose_items_are_flown():
    plan = json.loads((FOLDER / "survey" / "survey.plan").read_text())
    [survey] = [item for item in plan["mission"]["items"] if item["type"] == "ComplexItem"]
    assert survey["complexItemType"] == "survey"
    embedded = survey["TransectStyleComplexItem"]["Items"]
    assert [item["params"][4:6] for item in embedded] == survey["TransectStyleComplexItem"]["VisualTransectPoints"]
    flown = missions.read(FOLDER / "survey" / "survey.plan").items
    assert len(flown) == len(plan["mission"]["items"]) - 1 + len(embedded)


@pytest.mark.parametrize("buildings", [None, {"grid": {"blocks": [12, 10], "height_m": [30, 200], "seed": 5}}])
def test_survey_finds_room_in_other_cities(buildings):
    scenario = load("survey")
    _flies(scenario if buildings is None else type(scenario)(**{**scenario.data(), "city": buildings}))


@pytest.mark.skipif(not STREETS.exists(), reason="the Upper East Side's buildings are not on this machine")
def test_survey_finds_room_in_manhattan():
    _flies(load("survey", buildings=STREETS))


def _flies(scenario):
    city = build_city(scenario)
    after = placed(scenario, city)
    assert check(after, city) == []
    for _, vehicle in after.fleet:
        plan = flight_plan(after.origin.datum, vehicle)
        assert city.clear_of(enu_points(plan), MARGIN_M - 0.01), vehicle.id
        assert estimated_duration_s(plan) < after.duration_s - 60
    assert load_text(to_toml(after)) == after


def test_names_files_and_mistakes():
    assert source_of("squares") == FOLDER / "squares.toml"
    assert source_of("mine.toml") == Path("mine.toml")
    with pytest.raises(InputError, match="Did you mean 'squares'"):
        load("square")
    with pytest.raises(InputError, match="expected a file that exists"):
        load("nowhere/mine.toml")


def test_overrides_reach_shipped_scenarios_and_blame_the_command_line():
    overrides = ["operators.*.vehicles.*.autopilot=builtin", "operators.green.vehicles.g2.plan.square.alt_m=7.5"]
    scenario = load("squares", overrides, seed=9)
    assert scenario.seed == 9
    assert scenario.operators[1].vehicles[1].plan.square.alt_m == 7.5
    with pytest.raises(InputError, match=r"^squares with --set"):
        load("squares", ["duration_s=-1"])
