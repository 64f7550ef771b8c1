"""What the shipped scenarios are for happens in them: aircraft collide and fall, keep apart, or are blown about."""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from typer.testing import CliRunner

from skyrange.assembly.city import build_city
from skyrange.assembly.placement.clear_placing import MARGIN_M, apply_placing
from skyrange.assembly.placement.flight_plans import make_flight_plan, make_flight_plans
from skyrange.assembly.placement.start_checks import check_starts
from skyrange.cli.app import app
from skyrange.core.time import NS_PER_S
from skyrange.gcs.plan.routes import enu_points
from skyrange.metrics.paths import deviations_m, received_waypoints
from skyrange.metrics.summary import summary
from skyrange.metrics.time_series import RecordedNote, read_notes, truth_tracks, vehicles
from skyrange.record import RunRecord
from skyrange.record import load as load_run
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.shipped import load
from skyrange.study.runs import fly
from tests.flights import shared_run

pytestmark = pytest.mark.rotating

STREETS = Path(__file__).parents[3] / "shared/data/cities/manhattan-upper-east-side.geojson"


def flown(folder: Path, name: str, *changes: str, **how: Any) -> RunRecord:
    return fly(load(name, changes, **how), folder / "run", report=False)


def of_kind(record: RunRecord, kind: str) -> list[RecordedNote]:
    return [row for row in read_notes(record, "events") if row.kind == kind]


def all_complete(record: RunRecord) -> bool:
    facts = summary(record)
    return facts["mishaps"] == [] and {vehicle["outcome"] for vehicle in facts["vehicles"]} == {"complete"}


def run_head_on(folder: Path, *options: str) -> RunRecord:
    """Through the command line: an aircraft that crashes is a result of the run and no failure of it."""
    said = CliRunner().invoke(app, ["run", "head-on", "--out", str(folder), *options])
    assert said.exit_code == 0, said.output
    assert "blue/b1: collision with green/g1" in said.output
    return load_run(folder)


def test_head_on_repeats_until_both_have_fallen(tmp_path: Path) -> None:
    # what follows a collision, after 34.9 s, is chaotic, so this is where two runs would part first
    end_s = 43
    again, record = run_head_on(tmp_path / "run", "--set", f"duration_s={end_s}"), shared_run("head-on")
    for name in ("truth", "sensors", "events"):
        until = [
            [row for row in one.table(name).to_pylist() if row["time_ns"] < end_s * NS_PER_S] for one in (again, record)
        ]
        assert until[0] == until[1], name
    assert of_kind(again, "event.crash")


@pytest.mark.slow
def test_head_on_repeats_to_the_end(tmp_path: Path) -> None:
    assert run_head_on(tmp_path / "run").manifest["digests"] == shared_run("head-on").manifest["digests"]


def test_head_on_ends_in_a_collision_and_a_fall() -> None:
    record = shared_run("head-on")
    collisions = of_kind(record, "event.collision")
    assert {(row.about, row.data["with"]) for row in collisions} >= {("blue/b1", "green/g1"), ("green/g1", "blue/b1")}
    first = collisions[0]
    # they fly at 5 m/s each; within a few metres of the turning points they are slower
    assert 2.0 < first.data["speed_mps"] < 11.0
    assert abs(first.data["up_m"] - 30.0) < 2.0
    assert abs(first.data["north_m"]) < 3.0
    # energy: ½ · reduced mass · speed², less for a contact off the line between the two centres
    assert 0.0 < first.data["energy_j"] <= 0.5 * 0.75 * first.data["speed_mps"] ** 2 * 1.01
    crashes = of_kind(record, "event.crash")
    assert crashes
    fall_s = (crashes[0].time_ns - first.time_ns) * 1e-9
    # without air from 30 m it takes sqrt(2 · 30 / 9.81) = 2.5 s; a body of this drag falls at some 20 m/s at most
    assert 2.4 < fall_s < 8.0
    track = truth_tracks(record)[crashes[0].about]
    assert track.at(np.array([crashes[0].time_ns + 5_000_000_000]))[0, 2] < 1.0  # and there it lies
    # its ground station says so once the autopilot has disarmed; one that lies level may not notice
    outcomes = {vehicle["id"]: vehicle["outcome"] for vehicle in summary(record)["vehicles"]}
    assert outcomes[crashes[0].about] in ("failed", "unfinished")


def test_crossing_is_kept_apart_by_height_and_time() -> None:
    scenario = load("crossing")
    assert len(scenario.operators) == 4
    assert {vehicle.params["FS_GCS_ENABLE"] for _, vehicle in scenario.fleet} == {1.0}
    record = shared_run("crossing")
    assert all_complete(record)
    tracks = truth_tracks(record)
    at_corner = {}
    for name, track in tracks.items():
        across_m = np.hypot(track.enu_m[:, 0], track.enu_m[:, 1])
        assert across_m.min() < 12.0, name  # 6 m beside the middle of either street
        at_corner[name] = track.time_ns[across_m.argmin()] * 1e-9
    first = [time_s for name, time_s in at_corner.items() if name.endswith("1")]
    second = [time_s for name, time_s in at_corner.items() if name.endswith("2")]
    assert max(first) - min(first) < 4.0  # at one moment: height keeps them apart
    assert min(second) - max(first) > 5.0  # and time the others
    times = np.arange(0, 160_000_000_000, 100_000_000)
    places = {name: track.at(times) for name, track in tracks.items()}
    for (a, one), (b, other) in itertools.combinations(places.items(), 2):
        aloft = (one[:, 2] > 1.0) & (other[:, 2] > 1.0)
        across_m = np.hypot(*(one - other)[:, :2].T)
        above_m = np.abs(one - other)[:, 2]
        # plans are 8 m apart in height; receivers and barometers err by a metre or two
        assert not (aloft & (across_m < 8.0) & (above_m < 4.0)).any(), (a, b)


@pytest.mark.parametrize("to_its_end", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_city_fleet_flies_one_after_another(to_its_end: bool, tmp_path: Path) -> None:
    changes = [] if to_its_end else ["duration_s=52"]  # the last has reached its height after 48 s
    record = flown(tmp_path, "city-fleet", "operators.*.fleets.*.count=3", *changes)
    assert len(record.outcomes) == 12
    if to_its_end:
        assert all_complete(record)
    taken_off = sorted(row.time_ns * 1e-9 for row in of_kind(record, "event.takeoff") if row.about.startswith("blue/"))
    assert np.diff(taken_off) == pytest.approx([2.0, 2.0], abs=0.7)
    lowest = [vehicle["highest_m"] for vehicle in summary(record)["vehicles"]]
    assert np.array(lowest) == pytest.approx(np.repeat([30, 42, 54, 66], 3), abs=2.5)


def legs_of(scenario: Scenario) -> list[list[tuple[shapely.Geometry, float, float]]]:
    """Of each aircraft, its legs from above with their least and greatest height."""
    out = []
    for _, vehicle in scenario.fleet:
        path = enu_points(make_flight_plan(scenario.origin.datum, vehicle))
        out.append(
            [
                (shapely.MultiPoint([a[:2], b[:2]]).convex_hull, min(a[2], b[2]), max(a[2], b[2]))
                for a, b in itertools.pairwise(path)
            ]
        )
    return out


def check_apart(scenario: Scenario) -> None:
    """No two paths come within 10 m of each other where they are less than 8 m apart in height."""
    for one, other in itertools.combinations(legs_of(scenario), 2):
        for (a, a_low, a_high), (b, b_low, b_high) in itertools.product(one, other):
            if a_low < b_high + 8.0 and b_low < a_high + 8.0:
                assert shapely.distance(a, b) > 10.0 - 1e-6


MANY = ["operators.*.fleets.*.count=125"]


@pytest.mark.parametrize(
    ("changes", "buildings"), [([], None), ([], STREETS), pytest.param(MANY, None, marks=pytest.mark.slow)]
)
def test_city_fleet_finds_room(changes: list[str], buildings: Path | None) -> None:
    if buildings is not None and not buildings.exists():
        pytest.skip("the Upper East Side's buildings are not on this machine")
    scenario = load("city-fleet", changes, buildings=buildings)
    city = build_city(scenario)
    assert city is not None
    after = apply_placing(scenario, city)
    assert len(list(after.fleet)) == (500 if changes else 48)
    assert check_starts(after, city, make_flight_plans(after)) == []
    for _, vehicle in after.fleet:
        path = enu_points(make_flight_plan(after.origin.datum, vehicle))
        assert city.is_clear(path, MARGIN_M - 0.01), vehicle.id
        assert city.inside(vehicle.start.east_m, vehicle.start.north_m) is None
    if not changes:
        check_apart(after)
    if buildings is None:
        assert after.operators == apply_placing(scenario, None).operators  # its own downtown asks for no shift
    west, south, east, north = city.bounds
    inside = [west < v.start.east_m < east and south < v.start.north_m < north for _, v in after.fleet]
    assert np.mean(inside) > 0.8  # over the city, not beside it


def deviation_m(record: RunRecord) -> dict[str, float]:
    """Root mean square distance from the planned track by operator."""
    by_vehicle = deviations_m(vehicles(record), truth_tracks(record), received_waypoints(record))
    squares: dict[str, list[float]] = {}
    for name, (_, away_m) in by_vehicle.items():
        squares.setdefault(name.split("/")[0], []).append(float((away_m**2).mean()))
    return {operator: math.sqrt(np.mean(values)) for operator, values in squares.items()}


@pytest.mark.slow
def test_wind_blows_aircraft_off_their_tracks(tmp_path: Path) -> None:
    assert load("wind").wind.turbulence == "moderate"
    assert {vehicle.airframe for _, vehicle in load("wind").fleet} == {"iris", "x500", "hummingbird"}
    moderate = shared_run("wind")
    # without gusts the two aircraft of an airframe fly alike, so one is enough
    calm_air = ["wind.turbulence=none", "wind.speed_mps=0", "operators.*.fleets.*.count=1", "duration_s=142"]
    still = flown(tmp_path / "none", "wind", *calm_air)
    assert all_complete(moderate)
    assert all_complete(still)
    gusts, calm = deviation_m(moderate), deviation_m(still)
    assert gusts.keys() == calm.keys() == {"blue", "orange", "green"}
    assert sum(gusts.values()) > 1.2 * sum(calm.values())
    table = moderate.table("truth", ["wind_east_mps", "wind_north_mps"])
    air = np.hypot(*(table.column(name).to_numpy() for name in table.column_names))
    # 5 m/s on average; MIL-F-8785C's moderate gusts have about 2.7 m/s in each horizontal direction at 30 m
    assert 3.5 < air.mean() < 7.5
    assert air.max() > 8.0
