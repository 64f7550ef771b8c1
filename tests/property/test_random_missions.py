"""Random missions for the comparison of autopilots: legal, repeatable, and simpler ones are simpler."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mission import parse_waypoints
from skyrange.codec.mission.qgc_wpl import format_waypoints
from skyrange.gcs.plan.checks import check
from skyrange.gcs.protocols.mission_items import encode_mission
from skyrange.study.compare.mission_flights import (
    ORIGIN,
    ComparableMission,
    ComparedMission,
    FlownMission,
    compare_flights,
    flight_plan,
)
from skyrange.study.compare.mission_parity import is_legal, legal_missions, shrink_mission
from skyrange.study.compare.random_missions import RandomMission, random_mission, simpler
from skyrange.study.measures.path_distance import path_distance_m
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
