"""Does BIT* find what the lattice misses, repeat, and say what is wrong; and do flights take the energy of routes?"""

from __future__ import annotations

import math
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from skyrange.assembly.build import build
from skyrange.city.buildings import Building
from skyrange.city.city import City
from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_S
from skyrange.metrics.aircraft import read_ticks
from skyrange.planning.limits import Costs, Limits, NoRouteError
from skyrange.planning.routes import find_route
from skyrange.planning.sampling import Point3, Sampling
from skyrange.record import load as load_run
from skyrange.runtime.run import Run
from skyrange.scenario.model.plan import path
from skyrange.scenario.model.scenario import Operator, Origin, Scenario, Vehicle, Wind
from skyrange.scenario.toml_files import load_text
from skyrange.world.airframes import AIR_DENSITY_KGM3, AIRFRAMES, GRAVITY_MPS2, IRIS, Airframe

pytestmark = pytest.mark.rotating

GAP_M = 16.0
WALLS = City(
    [
        Building("south", 200.0, shapely.box(40, -400, 50, -GAP_M / 2)),
        Building("north", 200.0, shapely.box(40, GAP_M / 2, 50, 400)),
    ],
    "a gap",
)
ENDS = [(0.0, 40.0), (90.0, 40.0)]


def length_m(points: list[Point3]) -> float:
    return sum(math.dist(one, other) for one, other in pairwise(points))


def test_it_finds_a_gap_that_the_lattice_misses() -> None:
    limits = Limits(30.0, 60.0, clearance_m=6.0)
    with pytest.raises(NoRouteError):
        find_route(WALLS, ENDS, limits)
    route = find_route(WALLS, ENDS, limits, Sampling(20_000, 1))
    assert route[0] == (0.0, 40.0, 30.0)
    assert route[-1] == (90.0, 40.0, 30.0)
    assert WALLS.is_clear(route, 6.0)
    assert length_m(route) < 1.25 * 2 * math.hypot(45.0, 40.0)


def test_it_repeats_whatever_was_planned_before() -> None:
    limits = Limits(30.0, 60.0, clearance_m=4.0)
    first = find_route(WALLS, ENDS, limits, Sampling(8_000, 1))
    other = find_route(WALLS, ENDS, limits, Sampling(8_000, 2))
    assert find_route(WALLS, ENDS, limits, Sampling(8_000, 1)) == first
    assert other != first
    way = [*ENDS, (0.0, 60.0)]
    assert find_route(WALLS, way, limits, Sampling(8_000, 1)) == find_route(WALLS, way, limits, Sampling(8_000, 1))


@pytest.mark.parametrize("length", [0.01, 1.0, 12.0])
def test_short_legs_come_to_an_end(length: float) -> None:
    thin = City([Building("pole", 50.0, shapely.Point(0.5 * length, 0.0).buffer(0.001))], "a pole")
    limits = Limits(30.0, 32.0, clearance_m=max(0.25 * length, 0.001))
    route = find_route(thin, [(0.0, 0.0), (length, 0.0)], limits, Sampling(1_000, 1))
    assert route[-1] == (length, 0.0, 30.0)


@pytest.mark.parametrize(
    ("ends", "limits", "words"),
    [
        ([(45.0, 20.0), (90.0, 40.0)], Limits(30.0, 60.0), r"leg 1 begins at \(45, 20\) m, nearer than 5 m"),
        (
            ENDS,
            Limits(30.0, 60.0, clearance_m=7.0),
            "north, 200 m high, is in the way, and 300 iterations found no way",
        ),
    ],
)
def test_without_a_way_it_says_why(ends: list[tuple[float, float]], limits: Limits, words: str) -> None:
    with pytest.raises(NoRouteError, match=words):
        find_route(WALLS, ends, limits, Sampling(300, 1))


SCENARIO = """
name = "windy"
duration_s = 6
origin = [40.778, -73.955]
[city]
grid = { blocks = [8, 8], height_m = [40, 90] }
[[operators]]
id = "blue"
  [[operators.vehicles]]
  id = "b1"
  plan = { route = { to = [141, 141], alt_m = 30, planner = "ompl", iterations = 2000 } }
"""


def test_a_scenario_has_the_route_of_its_seed() -> None:
    first, again, other = (
        build(load_text(f"seed = {seed}\n{SCENARIO}")).scenario.operators[0].vehicles[0].plan for seed in (1, 1, 2)
    )
    assert first.path is not None
    assert first == again
    assert first != other


def test_without_its_package_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ompl.base", None)
    with pytest.raises(InputError, match=r"planner: ompl — .*pip install 'skyrange\[planning\]'"):
        build(load_text(SCENARIO))


@pytest.mark.slow
def test_planned_for_energy_a_route_takes_hardly_more_than_the_quickest_and_less_with_the_wind() -> None:
    """Shortcuts are taken greedily, so that it may take a little more."""
    wall = City([Building("wall", 200.0, shapely.box(-60, 40, 60, 50))], "a wall")
    ends = [(0.0, 0.0), (100.0, 90.0)]
    for sampling in (None, Sampling(5_000, 1)):
        spent = {}
        for wind in ((0.0, 9.0, 0.0), (0.0, -9.0, 0.0)):
            costs = Costs(5.0, wind, IRIS.power_for)
            route = find_route(wall, ends, Limits(30.0, 30.0, costs=costs), sampling)
            spent[wind] = sum(costs.of(one, other) for one, other in pairwise(route))
            quickest = find_route(wall, ends, Limits(30.0, 30.0), sampling)
            assert spent[wind] <= 1.02 * sum(costs.of(one, other) for one, other in pairwise(quickest))
        assert spent[0.0, 9.0, 0.0] < spent[0.0, -9.0, 0.0], "with the wind it takes less"


@pytest.mark.parametrize("east_m", [300.0, -300.0])
def test_a_flight_takes_the_power_that_its_cost_supposes(tmp_path: Path, east_m: float) -> None:
    """Against a wind of 7 m/s and with it, while its speed is steady."""
    vehicle = Vehicle(id="b1", plan=path([(0, 0), (east_m, 0)], alt_m=30, end="land", speed_mps=6))
    scenario = Scenario(
        name="windy",
        duration_s=75,
        origin=Origin(lat=40.778, lon=-73.955),
        operators=(Operator(id="blue", vehicles=(vehicle,)),),
        wind=Wind(speed_mps=7, from_deg=90),
    )
    Run.start(scenario, tmp_path / "run").execute()
    ticks = read_ticks(load_run(tmp_path / "run"))
    away_m = np.abs(ticks.enu_m[:, 0, 0])
    steady = (away_m > 80.0) & (away_m < 220.0)
    speed_mps = np.gradient(ticks.enu_m[:, 0, 0], ticks.time_ns / NS_PER_S)[steady].mean()
    wind_mps = scenario.wind.air.steady_enu_mps[0]
    supposed_w = IRIS.power_for(speed_mps - wind_mps, 0.0, 0.0)
    assert ticks.power_w[steady, 0].mean() == pytest.approx(supposed_w, rel=0.01)
    assert (supposed_w > 1.05 * IRIS.power_for(0.0, 0.0, 0.0)) == (east_m > 0.0), "against the wind it takes more"


@given(
    airframe=st.sampled_from(sorted(AIRFRAMES.values(), key=lambda one: one.name)),
    flat_mps=st.floats(0, 25),
    up_mps=st.floats(-3, 5),
    turn=st.floats(0, 7),
)
def test_power_agrees_with_its_own_balance(airframe: Airframe, flat_mps: float, up_mps: float, turn: float) -> None:
    east, north = flat_mps * math.cos(turn), flat_mps * math.sin(turn)
    power_w = airframe.power_for(east, north, up_mps)
    assert power_w == pytest.approx(airframe.power_for(flat_mps, 0.0, up_mps)), "whatever the direction"
    # from the power back to thrust and rotor speed: P = arm·T·sqrt(T / n·k) / efficiency + avionics
    count = len(airframe.rotors)
    shaft_w = (power_w - airframe.avionics_w) * airframe.drive_efficiency / airframe.torque_arm_m
    thrust_n = (shaft_w**2 * count * airframe.thrust_ns2) ** (1 / 3)
    rotors_n = count * airframe.rotor_drag_ns2 * math.sqrt(thrust_n / (count * airframe.thrust_ns2)) * flat_mps
    drag = 0.5 * AIR_DENSITY_KGM3 * airframe.drag_area_m2 * math.hypot(flat_mps, up_mps)
    held_n = math.hypot(drag * flat_mps, airframe.mass_kg * GRAVITY_MPS2 + drag * up_mps)
    assert math.hypot(thrust_n, rotors_n) == pytest.approx(held_n, rel=1e-3)
