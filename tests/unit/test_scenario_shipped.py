from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from skyrange.assembly.build import build
from skyrange.assembly.city import build_city
from skyrange.assembly.placement.clear_placing import MARGIN_M, apply_placing
from skyrange.assembly.placement.flight_plans import make_flight_plan, make_flight_plans
from skyrange.assembly.placement.start_checks import check_starts
from skyrange.codec.mission import read_mission
from skyrange.core.errors import InputError
from skyrange.gcs.plan.routes import enu_points, estimated_duration_s
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.shipped import FOLDER, SHIPPED, load, source_of
from skyrange.scenario.toml_files import load_text, to_toml

STREETS = Path(__file__).parents[3] / "shared/data/cities/manhattan-upper-east-side.geojson"


def test_the_catalogue_is_what_is_shipped() -> None:
    assert {file.stem for file in FOLDER.glob("*.toml")} == set(SHIPPED)
    assert all(load(name).name == name for name in SHIPPED)


def test_squares_is_the_published_demonstration() -> None:
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
    squares = [v.plan.square for v in fleet.values()]
    assert [one and one.side_m for one in squares] == [5, 7, 4, 3, 2]
    assert {one and one.alt_m for one in squares} == {5}
    assert {v.depart_s for v in fleet.values()} == {10}
    assert scenario.duration_s == 180
    assert check_starts(scenario, None, make_flight_plans(scenario)) == []


def test_survey_flies_files_of_both_kinds_in_its_downtown() -> None:
    scenario = load("survey")
    assert len(list(scenario.fleet)) == 8
    assert len(scenario.operators) == 2
    files = {Path(vehicle.plan.file or "") for _, vehicle in scenario.fleet}
    assert {file.suffix for file in files} == {".plan", ".waypoints"}
    _flies(scenario)


def test_its_survey_is_a_complex_item_whose_items_are_flown() -> None:
    plan = json.loads((FOLDER / "survey" / "survey.plan").read_text())
    [survey] = [item for item in plan["mission"]["items"] if item["type"] == "ComplexItem"]
    assert survey["complexItemType"] == "survey"
    embedded = survey["TransectStyleComplexItem"]["Items"]
    assert [item["params"][4:6] for item in embedded] == survey["TransectStyleComplexItem"]["VisualTransectPoints"]
    flown = read_mission(FOLDER / "survey" / "survey.plan").items
    assert len(flown) == len(plan["mission"]["items"]) - 1 + len(embedded)


@pytest.mark.parametrize("buildings", [None, {"grid": {"blocks": [12, 10], "height_m": [30, 200], "seed": 5}}])
def test_survey_finds_room_in_other_cities(buildings: dict[str, Any] | None) -> None:
    scenario = load("survey")
    _flies(scenario if buildings is None else type(scenario)(**{**scenario.data(), "city": buildings}))


@pytest.mark.skipif(not STREETS.exists(), reason="the Upper East Side's buildings are not on this machine")
def test_survey_finds_room_in_manhattan() -> None:
    _flies(load("survey", buildings=STREETS))


def _flies(scenario: Scenario) -> None:
    city = build_city(scenario)
    assert city is not None
    after = apply_placing(scenario, city)
    assert check_starts(after, city, make_flight_plans(after)) == []
    for _, vehicle in after.fleet:
        plan = make_flight_plan(after.origin.datum, vehicle)
        assert city.is_clear(enu_points(plan), MARGIN_M - 0.01), vehicle.id
        assert estimated_duration_s(plan) < after.duration_s - 60
    assert load_text(to_toml(after)) == after


@pytest.mark.parametrize("name", ["rid-spoofing", "rid-city"])
@pytest.mark.rotating
def test_attacks_go_along_to_another_city(name: str) -> None:
    if not STREETS.exists():
        pytest.skip("the Upper East Side's buildings are not on this machine")
    for buildings in (None, STREETS):
        built = build(load(name, buildings=buildings))
        assert built.city is not None
        assert built.scenario.radio is not None
        for _, vehicle in built.scenario.fleet:
            path = enu_points(make_flight_plan(built.scenario.origin.datum, vehicle))
            assert built.city.is_clear(path, MARGIN_M - 0.01), vehicle.id
        for receiver in built.scenario.radio.receivers:
            assert built.city.inside(*receiver.place) is None
        if buildings is None:
            assert built.scenario.operators == apply_placing(load(name), None).operators, (
                "its own city asks for no shift"
            )
        if name == "rid-spoofing":
            start = built.scenario.operators[0].vehicles[0].start
            assert built.header["attacks"][0]["shown"] == {
                "red/r1 as claimed": [start.east_m, start.north_m + 290, 30.0]
            }


def test_a_receiver_moves_out_of_a_building() -> None:
    text = """
origin = [40.778, -73.955]
city.grid = {}
[radio]
receivers = [{ id = "one", operator = "o", place = [30, 30, 5], placing = "clear" }]
[[operators]]
id = "o"
  [[operators.vehicles]]
  plan.square = { side_m = 10, alt_m = 10 }
"""
    scenario = load_text(text)
    city = build_city(scenario)
    assert city is not None
    assert city.inside(30, 30, 5) is not None
    radio = apply_placing(scenario, city).radio
    assert radio is not None
    [receiver] = radio.receivers
    assert receiver.placing == "exact"
    assert city.inside(*receiver.place) is None
    assert receiver.place[2] == 5
    assert math.dist(receiver.place, (30, 30, 5)) < 60
    with pytest.raises(InputError, match="expected a place outside buildings"):
        build(load_text(text.replace('"clear"', '"exact"')))


def test_names_files_and_mistakes() -> None:
    assert source_of("squares") == FOLDER / "squares.toml"
    assert source_of("mine.toml") == Path("mine.toml")
    with pytest.raises(InputError, match="Did you mean 'squares'"):
        load("square")
    with pytest.raises(InputError, match="expected a file that exists"):
        load("nowhere/mine.toml")


def test_overrides_reach_shipped_scenarios_and_blame_the_command_line() -> None:
    overrides = ["operators.*.vehicles.*.autopilot=builtin", "operators.green.vehicles.g2.plan.square.alt_m=7.5"]
    scenario = load("squares", overrides, seed=9)
    assert scenario.seed == 9
    flown = scenario.operators[1].vehicles[1].plan.square
    assert flown is not None
    assert flown.alt_m == 7.5
    with pytest.raises(InputError, match=r"^squares with --set"):
        load("squares", ["duration_s=-1"])
