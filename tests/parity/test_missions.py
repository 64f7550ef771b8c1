"""Random missions under both autopilots: 95 % of them agree in items, order, times and path; it takes minutes.

And missions that show nothing: flights that fall, and turns that a residue decides.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from skyrange.codec.mavlink import dialect as mav
from skyrange.parity.missions.comparison import compare
from skyrange.parity.missions.flights import compare_fleet, fleet_scenario, read
from skyrange.parity.missions.mission_sources import PlacedItem, RandomMission
from skyrange.study.runs import fly
from tests.ardupilot import needs_arducopter
from tests.catalogue import draw

CALM = (0.0, 0.0)
NO_FAILSAFE = {"BATT_LOW_VOLT": 0.0, "BATT_CRT_VOLT": 0.0, "BATT_LOW_MAH": 0.0, "BATT_CRT_MAH": 0.0}
TAKE_OFF = PlacedItem(mav.MAV_CMD_NAV_TAKEOFF, place_m=(0.0, 0.0, 15.0))
LAND = PlacedItem(mav.MAV_CMD_NAV_LAND)


def wait(seconds: float) -> PlacedItem:
    return PlacedItem(mav.MAV_CMD_NAV_DELAY, (seconds, 0.0, 0.0, 0.0))


@needs_arducopter
@pytest.mark.slow
@pytest.mark.parametrize("first", draw((0, 20, 40)))
def test_random_missions_are_flown_alike(first: int, tmp_path: Path) -> None:
    found = compare(tmp_path / "missions", 20, first=first, shrink=False)
    strays = [
        f"{one.mission.number} {one.miss}: {one.detail}; {one.mission.words}" for one in found.compared if one.miss
    ]
    assert found.share >= 0.95, strays
    assert not [one for one in found.compared if one.miss == "accepted items"], strays


@needs_arducopter
@pytest.mark.slow
def test_flights_that_fall_are_neither_complete_nor_agreement(tmp_path: Path) -> None:
    """Both hover until their batteries are empty, without any battery failsafe."""
    mission = RandomMission(0, (TAKE_OFF, wait(100.0), LAND))
    scenario = fleet_scenario([mission], CALM, tmp_path)
    low = {"charge": 0.1, "params": NO_FAILSAFE}
    operators = tuple(
        operator.model_copy(update={"vehicles": tuple(one.model_copy(update=low) for one in operator.vehicles)})
        for operator in scenario.operators
    )
    record = fly(scenario.model_copy(update={"operators": operators}), tmp_path / "run", report=False)
    (one,) = read(record, [mission], CALM)
    assert one.undecided == "both crash", one.detail
    assert not one.alike
    assert {entry["state"] for entry in record.outcomes.values()} <= {"failed", "unfinished"}
    charges = [float(flight.crashed.split()[2].rstrip("%")) for flight in one.flights]
    assert max(charges) <= 3.0, one.detail


@needs_arducopter
@pytest.mark.slow
def test_turns_to_the_present_heading_are_not_called_wrong(tmp_path: Path) -> None:
    turn = PlacedItem(mav.MAV_CMD_CONDITION_YAW, (0.0, 30.0, 1.0, 0.0))
    north = PlacedItem(mav.MAV_CMD_NAV_WAYPOINT, place_m=(0.0, 30.0, 15.0))
    mission = RandomMission(0, (TAKE_OFF, turn, wait(8.0), north, turn, wait(8.0), LAND))
    for one in compare_fleet(tmp_path / "run", [mission], CALM):
        assert not one.miss, f"{one.miss}: {one.detail}"
        assert one.undecided in ("", "rounding")
