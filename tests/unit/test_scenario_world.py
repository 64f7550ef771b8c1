from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
import shapely

from skyrange.assembly.city import build_city
from skyrange.assembly.placement.clear_placing import MARGIN_M, STEP_M, apply_placing, find_clear_shift
from skyrange.assembly.placement.flight_plans import make_flight_plan, make_flight_plans
from skyrange.assembly.placement.start_checks import check_starts
from skyrange.city.buildings import Building
from skyrange.city.city import City
from skyrange.core.errors import InputError, Problem
from skyrange.gcs.plan.paths import Point
from skyrange.gcs.plan.routes import enu_points
from skyrange.scenario.model.scenario import Operator, Origin, Scenario, Start, Vehicle, mission_file, path, square

WPL = "QGC WPL 110\n0\t1\t0\t16\t0\t0\t0\t0\t40.0\t-74.0\t10\t1\n1\t0\t3\t22\t0\t0\t0\t0\t40.0\t-74.0\t20\t1\n"


def block(east_m: float, north_m: float, half_m: float, height_m: float) -> Building:
    shape = shapely.box(east_m - half_m, north_m - half_m, east_m + half_m, north_m + half_m)
    return Building(f"{east_m:g},{north_m:g}", height_m, shape)


def scenario(*vehicles: Vehicle, **keys: Any) -> Scenario:
    return Scenario(origin=Origin(lat=40.0, lon=-74.0), operators=(Operator(id="blue", vehicles=vehicles),), **keys)


def mission(tmp_path: Path, *rows: str) -> str:
    file = tmp_path / "m.waypoints"
    file.write_text(WPL + "".join(f"{i + 2}\t0\t3\t16\t0\t0\t0\t0\t{row}\t1\n" for i, row in enumerate(rows)))
    return str(file)


def find_faults(placed: Scenario, city: City | None) -> list[Problem]:
    return check_starts(placed, city, make_flight_plans(placed))


def test_a_sound_scenario_has_no_faults() -> None:
    sound = scenario(
        Vehicle(start=Start(), plan=square(5, 5)), Vehicle(start=Start(east_m=9), plan=path([(3, 4, 5)], mode="guided"))
    )
    assert find_faults(sound, None) == []
    assert find_faults(sound, City([block(50, 50, 5, 30)], "one")) == []


def test_a_start_inside_a_building_is_a_fault() -> None:
    city = City([block(0, 0, 5, 30)], "one")
    [fault] = find_faults(scenario(Vehicle(start=Start(east_m=2, north_m=2), plan=square(5, 50))), city)
    assert fault.where == "operators.blue.vehicles.b1.start"
    assert "30 m high" in fault.expected
    assert "placing" in fault.hint


def test_two_starts_at_one_place_are_a_fault() -> None:
    near = [Vehicle(start=Start(east_m=0.49 * i), plan=square(5, 5)) for i in range(2)]
    [fault] = find_faults(scenario(*near), None)
    assert fault.where == "operators.blue.vehicles.b2.start"
    assert "blue/b1 stands there" in fault.expected
    apart = [Vehicle(start=Start(east_m=0.51 * i, north_m=-0.1), plan=square(5, 5)) for i in range(5)]
    assert find_faults(scenario(*apart), None) == []


def test_a_mission_below_the_ground_or_unreadable_is_a_fault(tmp_path: Path) -> None:
    file = mission(tmp_path, "40.0001\t-74.0\t-30")
    faults = find_faults(scenario(Vehicle(plan=mission_file(file))), None)
    assert any("below the ground" in fault.value for fault in faults)
    (tmp_path / "m.waypoints").write_text("QGC WPL 110\n0\tx\n")
    faults = find_faults(scenario(Vehicle(plan=mission_file(file))), None)
    assert faults
    assert all(fault.where.startswith("operators.blue.vehicles.b1.plan.file") for fault in faults)
    (tmp_path / "m.waypoints").unlink()
    assert find_faults(scenario(Vehicle(plan=mission_file(file))), None)


def test_a_nan_in_a_mission_is_a_fault(tmp_path: Path) -> None:
    file = mission(tmp_path, "nan\t-74.0\t30")
    assert find_faults(scenario(Vehicle(plan=mission_file(file))), None)


def test_an_anchored_mission_moves_with_its_start(tmp_path: Path) -> None:
    file = mission(tmp_path, "40.0009\t-74.0\t20")
    vehicle = Vehicle(start=Start(east_m=300, north_m=-200), plan=mission_file(file, anchor="start"))
    corner = enu_points(make_flight_plan(scenario(vehicle).origin.datum, vehicle))[2]
    # 0.0009 degrees of latitude are 99.93 m at 40 degrees north (Snyder eq. 4-19: 111,035 m a degree)
    assert corner.east_m == pytest.approx(300, abs=0.01)
    assert corner.north_m == pytest.approx(-200 + 99.93, abs=0.05)


def test_the_shift_is_the_least_that_clears() -> None:
    city = City([block(0, 0, 10, 30)], "one")
    up = [Point(0, 0, 0), Point(0, 0, 20), Point(0, 0, 0)]
    shift = find_clear_shift(city, up)
    assert shift is not None
    east_m, north_m = shift
    assert math.hypot(east_m, north_m) == pytest.approx(16.0)  # the lattice's first beyond 10 m of wall + 5 m
    assert 10 + MARGIN_M <= max(abs(east_m), abs(north_m)) < 10 + MARGIN_M + STEP_M
    assert find_clear_shift(None, up) == (0.0, 0.0)


def test_legs_count_and_roofs_may_be_flown_over() -> None:
    city = City([block(0, 30, 10, 30)], "one")
    low = [Point(0, 0, 0), Point(0, 0, 20), Point(0, 60, 20), Point(0, 60, 0)]
    high = [Point(0, 0, 0), Point(0, 0, 36), Point(0, 60, 36), Point(0, 60, 0)]
    assert find_clear_shift(city, high) == (0.0, 0.0)
    shift = find_clear_shift(city, low)
    assert shift is not None
    assert abs(shift[0]) >= 10 + MARGIN_M


@pytest.mark.slow
def test_nowhere_is_said() -> None:
    city = City([block(0, 0, 900, 30)], "one")
    assert find_clear_shift(city, [Point(0, 0, 0), Point(0, 0, 20)]) is None
    with pytest.raises(InputError, match=r"operators\.blue\.vehicles\.b1\.placing.*within 600 m"):
        apply_placing(scenario(Vehicle(plan=square(5, 5), placing="clear")), city)


def test_placing_moves_only_the_loose_and_keeps_paths_apart() -> None:
    loose = [Vehicle(plan=square(5, 5), placing="clear") for _ in range(3)]
    fixed = Vehicle(plan=square(5, 5))
    before = scenario(*loose, fixed)
    after = apply_placing(before, None)
    assert apply_placing(before, None) == after
    vehicles = [vehicle for _, vehicle in after.fleet]
    assert vehicles[3].start == fixed.start
    assert all(vehicle.placing == "exact" for vehicle in vehicles)
    lines = [
        shapely.LineString([(e, n) for e, n, _ in enu_points(make_flight_plan(after.origin.datum, vehicle))])
        for vehicle in vehicles
    ]
    gaps = [a.distance(b) for i, a in enumerate(lines) for b in lines[:i]]
    assert min(gaps) >= 10.0 - 1e-6
    assert apply_placing(after, None) is after


def test_a_bad_mission_file_is_said_when_placing(tmp_path: Path) -> None:
    file = tmp_path / "bad.plan"
    file.write_text("{")
    loose = scenario(Vehicle(plan=mission_file(file, anchor="start"), placing="clear"))
    with pytest.raises(InputError, match=r"operators\.blue\.vehicles\.b1\.plan\.file"):
        apply_placing(loose, None)


def test_cities_are_built_as_said(tmp_path: Path) -> None:
    vehicle = Vehicle(plan=square(5, 5))
    assert build_city(scenario(vehicle)) is None
    grid = build_city(scenario(vehicle, city={"grid": {"blocks": (2, 3), "height_m": (10, 12), "seed": 4}}))
    assert grid is not None
    assert len(grid) == 2 * 3 * 4
    assert all(10 <= building.height_m <= 12 for building in grid.buildings)
    ring = [[-74.001, 40.0], [-74.0, 40.0], [-74.0, 40.001], [-74.001, 40.001], [-74.001, 40.0]]
    feature = {
        "type": "Feature",
        "properties": {"building": "yes", "height": "12"},
        "geometry": {"type": "Polygon", "coordinates": [ring]},
    }
    file = tmp_path / "t.geojson"
    file.write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    read = build_city(scenario(vehicle, city={"buildings": file}))
    assert read is not None
    assert read.inside(-10, 10) is not None  # west of the origin, from which it is measured
    assert read.inside(10, 10) is None
