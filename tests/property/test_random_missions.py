"""Random missions for the comparison of autopilots: legal, repeatable, and simpler ones are simpler."""

from __future__ import annotations

import itertools
import json
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mission import parse_waypoints
from skyrange.codec.mission.qgc_wpl import format_waypoints
from skyrange.gcs.plan.checks import check
from skyrange.gcs.protocols.mission_transfer import encode_mission
from skyrange.metrics.paths import path_distance_m
from skyrange.parity.missions.comparison import (
    MissionAgreement,
    is_legal,
    legal_missions,
    page,
    results,
    shrink_mission,
)
from skyrange.parity.missions.flights import (
    ORIGIN,
    ComparableMission,
    ComparedMission,
    FlownMission,
    compare_flights,
    flight_plan,
)
from skyrange.parity.missions.mission_sources import PlacedItem, RandomMission, random_mission, simpler
from skyrange.vehicle.builtin.engine import BUILTIN

NUMBERS = st.integers(0, 2**31)
CALM = (0.0, 0.0)


@settings(deadline=None)
@given(NUMBERS)
def test_the_ground_station_and_the_builtin_take_every_mission(number: int) -> None:
    plan = flight_plan(random_mission(number))
    assert check(plan, "plan") == []
    items = encode_mission(plan)
    assert {BUILTIN.mission_result(item.message(seq, 1, 1)) for seq, item in enumerate(items) if seq} <= {0}


@settings(deadline=None)
@given(NUMBERS)
def test_a_mission_is_a_function_of_its_number_and_survives_its_file(number: int) -> None:
    mission = random_mission(number)
    assert mission == random_mission(number)
    placed = mission.at(ORIGIN, (100.0, -200.0))
    assert parse_waypoints(format_waypoints(placed), "m").items == placed.items


@settings(deadline=None)
@given(NUMBERS)
def test_simpler_missions_are_legal_but_for_jumps_and_no_longer(number: int) -> None:
    mission = random_mission(number)
    for other in simpler(mission):
        assert len(other.items) <= len(mission.items)
        assert other != mission
        for item in other.items:
            if item.command == mav.MAV_CMD_DO_JUMP:
                assert item.params[0] >= 1


def test_the_missions_cover_the_items_that_are_compared() -> None:
    drawn = {item.command for number in range(2_000) for item in random_mission(number).items}
    assert {16, 17, 18, 19, 20, 21, 22, 31, 82, 84, 85, 92, 93, 112, 114, 115, 177, 178, 195} - drawn <= {17}


def _flown(items: tuple[tuple[float, int], ...], path: np.ndarray, **changes: object) -> FlownMission:
    known = {"rejected": "", "items": items, "modes": ("AUTO",), "outcome": "complete", "down_s": 30.0, "path_m": path}
    return FlownMission(**{**known, **changes})  # type: ignore[arg-type]


LINE = np.stack([np.linspace(0.0, 50.0, 101), np.zeros(101), np.full(101, 10.0)], axis=1)

ASIDE = np.array([0.0, 1.0, 0.0])


@pytest.mark.parametrize(
    ("items", "path", "changes", "miss"),
    [
        (((10.0, 1), (20.0, 2)), LINE, {}, ""),
        (((10.5, 1), (20.6, 2)), LINE, {}, ""),
        (((10.0, 1), (20.8, 2)), LINE, {}, "time: NAV_WAYPOINT"),
        (((10.0, 1), (20.0, 3)), LINE, {}, "items: NAV_WAYPOINT"),
        (((10.0, 1),), LINE, {}, "items: NAV_WAYPOINT"),
        (((10.0, 1), (20.0, 2)), LINE + 0.9 * ASIDE, {}, ""),
        (((10.0, 1), (20.0, 2)), LINE + 1.2 * ASIDE, {}, "path"),
        (((10.0, 1), (20.0, 2)), LINE, {"modes": ("AUTO", "ALT_HOLD")}, "modes"),
        (((10.0, 1), (20.0, 2)), LINE, {"rejected": "mission upload refused"}, "accepted items"),
        (((10.0, 1), (20.0, 2)), LINE, {"outcome": "failed"}, "outcome"),
    ],
)
def test_a_difference_is_named(
    items: tuple[tuple[float, int], ...], path: np.ndarray, changes: dict[str, object], miss: str
) -> None:
    (mission,) = [one for one in legal_missions(40) if [item.command for item in one.items[:3]] == [22, 16, 16]][:1]
    reference = _flown(((10.0, 1), (20.0, 2)), LINE)
    one = compare_flights(mission, CALM, (_flown(items, path, **changes), reference))
    assert one.miss == miss
    assert one.alike is (miss == "")


FLIGHTS = st.builds(
    FlownMission,
    rejected=st.sampled_from(("", "", "mission upload refused")),
    items=st.sampled_from(((), ((10.0, 1),))),
    modes=st.sampled_from(((), ("GUIDED", "AUTO"))),
    outcome=st.sampled_from(("complete", "failed", "unfinished")),
    down_s=st.sampled_from((np.nan, 30.0)),
    path_m=st.sampled_from((LINE[:0], LINE[:1], LINE, LINE + 5.0 * ASIDE)),
    crashed=st.sampled_from(("", "", "20.0 s, 0% charge")),
)
HOVER = random_mission(0)


@given(FLIGHTS, FLIGHTS)
def test_flights_that_show_nothing_are_never_agreement(first: FlownMission, second: FlownMission) -> None:
    """Rejected, never lifted, a single point, ended in a crash: alike to the last number, and no evidence."""
    for pair in ((first, second), (first, first)):
        one = compare_flights(HOVER, CALM, pair)
        shows = all(not each.rejected and len(each.path_m) > 1 and not each.crashed for each in pair)
        assert shows or not one.alike
        assert [one.alike, bool(one.miss), bool(one.undecided)].count(True) == 1
        if pair[0] is pair[1]:
            assert one.alike is shows
            assert not one.miss
        agreement = MissionAgreement((one,), {})
        assert agreement.share == 1.0 or not one.alike
        assert json.dumps(results(agreement), allow_nan=False)
        assert f"{int(one.alike)} of {int(not one.undecided)} missions" in next(page(agreement))


@settings(deadline=None)
@given(st.floats(0.2, 3.0), st.floats(1.0, 9.0))
def test_the_distance_of_tracks_is_geometric(off_m: float, speed: float) -> None:
    """Another speed along the same line is no distance; a side step is."""
    other = LINE[(np.arange(101) ** 2) // 101]
    assert path_distance_m(LINE, other)[0] < 1.0
    assert path_distance_m(LINE, LINE + off_m * ASIDE)[0] == pytest.approx(off_m, abs=0.06)


def test_a_mission_that_differs_is_shrunk_to_what_differs() -> None:
    """Against a made-up pair that differs wherever a spline is flown."""
    (mission,) = [one for one in legal_missions(60) if any(item.command == 82 for item in one.items)][:1]
    runs = 0

    def fly(fleet: Sequence[ComparableMission], wind: tuple[float, float]) -> list[ComparedMission]:
        nonlocal runs
        runs += 1
        return [pair(one, wind) for one in fleet]

    def pair(one: ComparableMission, wind: tuple[float, float]) -> ComparedMission:
        assert isinstance(one, RandomMission)
        curved = any(item.command == 82 for item in one.items)
        return compare_flights(one, wind, (_flown((), LINE + 5.0 * curved * ASIDE), _flown((), LINE)))

    found = shrink_mission(pair(mission, (3.0, 90.0)), fly, 40)
    assert isinstance(found.mission, RandomMission)
    assert [item.command for item in found.mission.items].count(82) == 1
    assert len(found.mission.items) == 2
    assert found.wind_mps == 0.0
    assert is_legal(found.mission)


def _turned(start_deg: float, end_deg: float, rate_degps: float = 30.0, at_s: float = 10.0) -> FlownMission:
    """A flight along `LINE` with a turn at `at_s`."""
    times_s = np.linspace(0.0, 30.0, 101)
    turn = np.clip((times_s - at_s) * rate_degps, 0.0, abs(end_deg - start_deg))
    heading_deg = start_deg + np.sign(end_deg - start_deg) * turn
    return _flown((), LINE, time_s=times_s, heading_rad=np.radians(heading_deg))


def _with_turn(degrees: float, rate_degps: float, sense: float) -> RandomMission:
    turn = PlacedItem(mav.MAV_CMD_CONDITION_YAW, (degrees, rate_degps, sense, 0.0))
    return RandomMission(0, (PlacedItem(mav.MAV_CMD_NAV_TAKEOFF, place_m=(0.0, 0.0, 10.0)), turn))


@given(st.integers(0, 359), st.sampled_from((1, -1)), st.sampled_from((0, 360, -360)), st.booleans())
def test_a_whole_circle_from_the_requested_heading_is_undecided(
    degrees: int, sense: int, unwrapped: int, swap: bool
) -> None:
    """Whichever of the two turns, and however its heading is counted."""
    stays, turns = _turned(degrees, degrees), _turned(degrees + unwrapped, degrees + unwrapped + 360 * sense)
    pair = (turns, stays) if swap else (stays, turns)
    one = compare_flights(_with_turn(float(degrees), 30.0, float(sense)), CALM, pair)
    assert one.undecided == "rounding"
    assert not one.alike
    assert ("the first" in one.detail) is swap


@pytest.mark.parametrize(
    ("turn", "start_deg", "end_deg"),
    [
        ((40.0, 30.0, 1.0), 0.0, 360.0),  # another heading is requested
        ((0.0, 30.0, -1.0), 0.0, 360.0),  # in the other direction
        ((0.0, 30.0, 0.0), 0.0, 360.0),  # in none
        ((0.0, 30.0, 1.0), 0.0, 45.0),  # no circle
    ],
)
def test_other_turns_are_not_a_matter_of_rounding(
    turn: tuple[float, float, float], start_deg: float, end_deg: float
) -> None:
    pair = _turned(start_deg, start_deg), _turned(start_deg, end_deg)
    assert compare_flights(_with_turn(*turn), CALM, pair).undecided == ""


def test_a_turn_that_both_make_is_decided() -> None:
    mission = _with_turn(0.0, 90.0, 1.0)
    both = _turned(0.0, 360.0, 90.0), _turned(0.0, 360.0, 90.0, 10.6)
    assert compare_flights(mission, CALM, both).undecided == ""
    assert compare_flights(mission, CALM, (both[0], both[0])).alike


def test_the_missions_reach_turns_to_the_present_heading() -> None:
    """By both ways: the heading of a leg, and that of the same turn before; in every direction."""
    along, again = set(), set()
    for number in range(1_000):
        items = random_mission(number).items
        placed = [item for item in items if item.command == mav.MAV_CMD_NAV_WAYPOINT]
        for before, item in itertools.pairwise(items):
            if item.command == mav.MAV_CMD_CONDITION_YAW and before.command == mav.MAV_CMD_NAV_WAYPOINT:
                start, end = placed[placed.index(before) - 1].place_m, before.place_m
                course = np.degrees(np.arctan2(end[0] - start[0], end[1] - start[1])) % 360.0
                if item.params[2] and not item.params[3] and course == item.params[0]:
                    along.add((item.params[0], item.params[2]))
        turns = [item.params for item in items if item.command == mav.MAV_CMD_CONDITION_YAW]
        again |= {one[2] for one, two in itertools.pairwise(turns) if one == two and one[2] and not one[3]}
    assert along >= {(degrees, sense) for degrees in (0.0, 90.0, 180.0, 270.0) for sense in (1.0, -1.0)}
    assert again == {1.0, -1.0}
