"""Plans: their shapes, what is wrong with them, where they lead, what airspace they claim."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest
from shapely.geometry import Point as ShapelyPoint
from shapely.geometry import Polygon

from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mission import Mission, MissionItem, format_waypoints
from skyrange.core.errors import InputError
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_S
from skyrange.gcs.plan import plans, routes
from skyrange.gcs.plan.checks import MAX_ITEMS, check
from skyrange.gcs.plan.paths import Point, square
from skyrange.gcs.plan.plans import FlightPlan
from skyrange.gcs.plan.volumes import Margins, volumes

ORIGIN = Origin(-35.3633280, 149.1652241, 584.0, 19.0)
HOME = (5.0, 7.0, 0.0)


def enu(plan: FlightPlan, item: MissionItem) -> tuple[float, float, float]:
    east_m, north_m = ORIGIN.enu_of(item.x, item.y)
    return east_m, north_m, item.z


def item(
    command: int, *, frame: int = 3, x: float = 0.0, y: float = 0.0, z: float = 0.0, **params: float
) -> MissionItem:
    one, two, three, four = (params.get(f"param{n}", 0.0) for n in (1, 2, 3, 4))
    return MissionItem(frame, command, one, two, three, four, x, y, z)


def auto(*items: MissionItem) -> FlightPlan:
    return FlightPlan("auto", "m", ORIGIN, Point(*HOME), mission=Mission(items, source="m"))


TAKEOFF = item(22, z=10.0)
RTL = item(20)


# --- shapes -----------------------------------------------------------------------------------------


def test_the_square_has_the_published_corners_in_the_published_order() -> None:
    # uav-cyber-sim, simulator/planner/plan.py, create_square_path: clockwise goes north first.
    assert square(5, 4) == ((0, 0, 4), (0, 5, 4), (5, 5, 4), (5, 0, 4), (0, 0, 4))
    assert square(5, 4, clockwise=False) == ((0, 0, 4), (5, 0, 4), (5, 5, 4), (0, 5, 4), (0, 0, 4))


def test_a_square_mission_takes_off_goes_round_and_lands_at_home() -> None:
    plan = plans.square(ORIGIN, HOME, side_m=20, alt_m=8, cruise_mps=4)
    assert [i.command for i in plan.items] == [22, 178, 16, 16, 16, 16, 21]
    assert plan.items[1].param2 == 4
    assert {i.frame for i in plan.items} == {2, 3}
    got = [enu(plan, i) for i in plan.items if i.command in (16, 21)]
    wanted = [(5, 27, 8), (25, 27, 8), (25, 7, 8), (5, 7, 8), (5, 7, 0)]
    for a, b in zip(got, wanted, strict=True):
        assert math.dist(a, b) < 0.01
    assert plan.items[0].z == 8
    assert check(plan, "plan") == []


def test_a_guided_square_visits_the_same_places() -> None:
    plan = plans.square(ORIGIN, HOME, side_m=20, alt_m=8, kind="guided")
    assert plan.targets_enu_m == ((5, 7, 8), (5, 27, 8), (25, 27, 8), (25, 7, 8), (5, 7, 8))
    assert plan.items == ()
    same = plans.square(ORIGIN, HOME, side_m=20, alt_m=8)
    for a, b in zip(routes.enu_points(plan), routes.enu_points(same), strict=True):
        assert math.dist(a, b) < 0.01
    assert check(plan, "plan") == []


def test_a_path_that_does_not_begin_above_home_flies_to_its_first_point() -> None:
    plan = plans.path(ORIGIN, HOME, [(10, 0, 6), (10, 10, 6)])
    assert [i.command for i in plan.items] == [22, 178, 16, 16, 20]


# --- files --------------------------------------------------------------------------------------------


def far_mission(home: tuple[float, float, float] | None, frame: int = 3) -> Mission:
    base = 584.0 if frame in (0, 5) else 0.0
    far = Origin(40.0, -74.0, 10.0)
    lat, lon = far.geodetic_of(100.0, 50.0)
    items = (
        item(22, frame=frame, x=40.0, y=-74.0, z=base + 20),
        item(178, frame=2, param1=1, param2=3),
        item(16, frame=frame, x=lat, y=lon, z=base + 20),
        item(16, frame=10, x=lat, y=lon, z=25),
        RTL,
    )
    return Mission(items, home, source="far")


@pytest.mark.parametrize("home", [None, (40.0, -74.0, 10.0)])
def test_a_file_is_re_anchored_with_its_shape_kept(tmp_path: Path, home: tuple[float, float, float] | None) -> None:
    file = tmp_path / "far.waypoints"
    file.write_text(format_waypoints(replace(far_mission(home), home=home or (40.0, -74.0, 10.0))))
    plan = plans.from_file(ORIGIN, HOME, file)
    assert plan.name == "far.waypoints"
    assert [i.frame for i in plan.items if i.command == 16] == [3, 3]
    assert math.dist(enu(plan, plan.items[2]), (105.0, 57.0, 20.0)) < 0.02
    assert check(plan, "plan") == []
    away = plans.from_file(ORIGIN, HOME, file, anchor=False)
    assert any("km from home" in str(fault) for fault in check(away, "plan"))


def test_without_a_planned_home_the_first_placed_item_is_the_anchor() -> None:
    mission = plans.anchored(far_mission(None), ORIGIN, Point(*HOME))
    assert math.dist(ORIGIN.enu_of(mission.items[0].x, mission.items[0].y), HOME[:2]) < 0.01
    assert mission.home is not None
    assert mission.home[2] == 584.0


def test_sea_level_altitudes_become_relative_or_are_refused() -> None:
    mission = plans.anchored(far_mission((40.0, -74.0, 580.0), frame=0), ORIGIN, Point(*HOME))
    assert [i.z for i in mission.items if i.command == 22] == [24.0]
    with pytest.raises(InputError, match="planned home"):
        plans.anchored(far_mission(None, frame=0), ORIGIN, Point(*HOME))


# --- checks -------------------------------------------------------------------------------------------

NAN = math.nan


@pytest.mark.parametrize(
    ("items", "says"),
    [
        ((), "0 mission items"),
        ((TAKEOFF,) * (MAX_ITEMS + 1), f"{MAX_ITEMS + 1} mission items"),
        ((item(16, x=-35.36, y=149.16, z=5), RTL), "NAV_TAKEOFF"),
        ((item(178, param1=1, param2=2), RTL), "NAV_TAKEOFF"),
        ((TAKEOFF, item(16, x=-35.3633, y=149.1652, z=-3), RTL), "3.0 m below the ground"),
        ((TAKEOFF, item(16, frame=0, x=-35.3633, y=149.1652, z=500), RTL), "84.0 m below the ground"),
        ((TAKEOFF, item(16, x=NAN, y=149.1652, z=5), RTL), "latitude nan"),
        ((TAKEOFF, item(16, x=-35.3633, y=149.1652, z=NAN), RTL), "altitude nan"),
        ((TAKEOFF, item(16, x=95.0, y=149.1652, z=5), RTL), "latitude 95"),
        ((TAKEOFF, item(16, frame=1, x=5, y=5, z=5), RTL), "frame 1"),
        ((TAKEOFF, item(16, x=-34.3633, y=149.1652, z=math.inf), RTL), "altitude inf"),
        ((TAKEOFF, item(178, param1=1, param2=NAN), RTL), "param2: nan"),
        ((TAKEOFF, item(16, x=-35.3633, y=149.1652, z=5, param1=math.inf), RTL), "param1: inf"),
        ((TAKEOFF, item(16, x=0.0, y=1.0, z=5), RTL), "km from home"),
        ((TAKEOFF, item(177, param1=9, param2=1), RTL), "an item from 1 to 3"),
        ((TAKEOFF, item(177, param1=1, param2=-2), RTL), "-1 for ever"),
        ((item(93, param1=5), item(16, x=-35.36, y=149.16, z=5), TAKEOFF, RTL), "command 16"),
        ((TAKEOFF, item(177, param1=2, param2=30000), RTL), "come to an end"),
        ((TAKEOFF, item(177, param1=2, param2=-1), RTL), "item 2 (command 177): jumps for ever to itself"),
        ((TAKEOFF, item(178, param1=1, param2=5), item(177, param1=2, param2=-1), RTL), "item 3 (command 177): jumps"),
        ((TAKEOFF, item(177, param1=3, param2=-1), item(177, param1=2, param2=-1), RTL), "item 2 (command 177): jumps"),
        ((TAKEOFF, item(600, param1=7), item(601, param1=7, param2=-1), RTL), "item 3 (command 601): jumps for ever"),
        ((TAKEOFF, item(177, param1=3, param2=2), item(177, param1=2, param2=-1), RTL), "item 3 (command 177): jumps"),
    ],
)
def test_a_faulty_mission_is_told_apart(items: tuple[MissionItem, ...], says: str) -> None:
    faults = check(auto(*items), "blue/b1.plan")
    assert any(says in str(fault) for fault in faults), faults
    assert all(fault.where.startswith("blue/b1.plan") for fault in faults)


@pytest.mark.parametrize(
    ("items", "endless"),
    [
        ((item(22, z=0.0), RTL), False),
        ((item(22, z=-10.0), item(16, z=0.0), RTL), False),
        ((item(93, param1=5), TAKEOFF, RTL), False),
        ((item(84, z=10.0), RTL), False),
        ((TAKEOFF, item(16, x=-35.3633, y=149.1652, z=5), item(177, param1=2, param2=-1), RTL), True),
        ((TAKEOFF, item(17, x=-35.3633, y=149.1652, z=5)), True),
        ((TAKEOFF, item(177, param1=1, param2=-1), RTL), True),
        ((TAKEOFF, item(177, param1=2, param2=3), RTL), False),
        ((TAKEOFF, item(177, param1=4, param2=-1), RTL, item(177, param1=3, param2=-1)), False),
        ((TAKEOFF, item(600, param1=7), item(93, param1=2), item(601, param1=7, param2=2), RTL), False),
    ],
)
def test_a_mission_that_arducopter_takes_has_no_faults(items: tuple[MissionItem, ...], endless: bool) -> None:
    """Take-offs to any height, delays before one, jumps and waits for ever (AP_Mission, ModeAuto::takeoff_start)."""
    plan = auto(*items)
    assert check(plan, "p") == []
    assert routes.is_endless(plan) is endless
    assert math.isfinite(routes.estimated_duration_s(plan))


def test_what_is_repeated_for_ever_is_flown_twice_in_the_estimate() -> None:
    there = item(16, x=-35.3633, y=149.1652, z=5)
    found = routes.legs(auto(TAKEOFF, there, item(177, param1=2, param2=-1), RTL))
    assert [piece.end.up_m for piece in found] == pytest.approx([found[0].end.up_m, 5.0, 5.0])
    assert found[1].end == found[2].end


def test_all_faults_come_at_once() -> None:
    bad = replace(auto(TAKEOFF, item(16, x=NAN), item(177, param1=99, param2=-3)), cruise_mps=0.0)
    assert len(check(bad, "p")) == 4


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"targets_enu_m": ()}, "0 targets"),
        ({"targets_enu_m": (Point(0, 0, NAN),)}, "finite"),
        ({"targets_enu_m": (Point(0, 0, 5), Point(1, 1, -2))}, "2.0 m below the ground"),
        ({"targets_enu_m": (Point(0, 0, 0),)}, "take off to"),
        ({"acceptance_m": 0.0}, "radius"),
        ({"cruise_mps": NAN}, "speed"),
        ({"home_enu_m": Point(0, 0, -1)}, "home"),
        ({"home_enu_m": Point(NAN, 0, 0)}, "finite"),
    ],
)
def test_a_faulty_guided_plan_is_told_apart(changes: dict[str, object], says: str) -> None:
    plan = plans.square(ORIGIN, HOME, side_m=5, alt_m=5, kind="guided")
    assert any(says in str(fault) for fault in check(replace(plan, **changes), "p"))  # type: ignore[arg-type]


# --- routes -------------------------------------------------------------------------------------------


def at(east_m: float, north_m: float, z: float) -> MissionItem:
    lat, lon = ORIGIN.geodetic_of(east_m, north_m)
    return item(16, x=lat, y=lon, z=z)


def test_length_and_time_of_a_square_by_hand() -> None:
    plan = plans.square(ORIGIN, HOME, side_m=20, alt_m=5, cruise_mps=4)
    assert routes.length_m(plan) == pytest.approx(4 * 20 + 2 * 5, abs=0.02)
    # climb 5/2.5 + 4 sides 20/4 + approach of the landing 0 + landing 5/0.5, and 2 s at each of 7 points
    assert routes.estimated_duration_s(plan) == pytest.approx(2 + 20 + 0 + 10 + 7 * 2, abs=0.05)


def test_jumps_are_flown_as_often_as_they_say() -> None:
    once = auto(TAKEOFF, at(5, 7, 10), at(105, 7, 10), at(5, 7, 10), RTL)
    thrice = auto(TAKEOFF, at(5, 7, 10), at(105, 7, 10), at(5, 7, 10), item(177, param1=3, param2=2), RTL)
    assert routes.length_m(thrice) - routes.length_m(once) == pytest.approx(400.0, abs=0.1)


def test_returning_to_launch_climbs_under_its_cone() -> None:
    # ArduCopter: 15 m, but no more than 3 m per metre from home, and never down.
    far = routes.enu_points(auto(TAKEOFF, at(105, 7, 10), RTL))
    assert max(point.up_m for point in far) == 15.0
    near = routes.enu_points(auto(TAKEOFF, at(9, 7, 5), RTL))
    assert near[-3].up_m == pytest.approx(12.0, abs=0.01)
    assert far[-1][:2] == HOME[:2]
    assert far[-1].up_m == 0.0


def test_zero_coordinates_mean_here_and_speed_changes_count() -> None:
    slow = auto(TAKEOFF, item(178, param1=1, param2=1), item(16, z=20.0), at(105, 7, 20), RTL)
    assert routes.enu_points(slow)[2] == (5.0, 7.0, 20.0)
    fast = auto(TAKEOFF, item(178, param1=1, param2=10), item(16, z=20.0), at(105, 7, 20), RTL)
    assert routes.estimated_duration_s(slow) - routes.estimated_duration_s(fast) == pytest.approx(2 * 90, abs=0.5)


# --- volumes ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["auto", "guided"])
def test_volumes_hold_the_flight_with_its_margins(kind: plans.Kind) -> None:
    plan = plans.square(ORIGIN, HOME, side_m=40, alt_m=10, kind=kind)
    margins = Margins(horizontal_m=6, vertical_m=2, early_s=4, late_s=9, drift=0.5)
    claimed = volumes(plan, 100 * NS_PER_S, margins)
    legs = routes.legs(plan)
    assert len(claimed) == len(legs)
    since_s = 0.0
    for volume, leg in zip(claimed, legs, strict=True):
        ring = Polygon([ORIGIN.enu_of(lat, lon) for lat, lon in volume.outline])
        for k in range(11):
            east, north, up = (a + (b - a) * k / 10 for a, b in zip(leg.start, leg.end, strict=True))
            circle = ShapelyPoint(east, north).buffer(6 - 1e-3, quad_segs=32)
            assert ring.contains(circle)
            # ellipsoid height = up + 584 m above sea level + 19 m geoid
            assert volume.lower_m <= max(up - 2, 0) + 603 + 1e-9
            assert volume.upper_m >= up + 2 + 603 - 1e-9
        until_s = since_s + leg.duration_s
        assert volume.start_ns == pytest.approx((100 + since_s - 4) * NS_PER_S, abs=2)
        assert volume.end_ns == pytest.approx((100 + until_s * 1.5 + 9) * NS_PER_S, abs=2)
        assert ring.area < 5_000
        since_s = until_s
    assert min(volume.lower_m for volume in claimed) == 603.0


def test_the_frames_of_mavlink_are_those_the_plans_know() -> None:
    assert {0, 3, 5, 6, 10, 11} == plans.GLOBAL_FRAMES
    assert mav.MAV_CMD_NAV_WAYPOINT in plans.LOCATED
