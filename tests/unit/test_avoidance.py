"""Avoidance piece by piece: entering a cylinder, legs between walls, beginning and end, bad parameters."""

from __future__ import annotations

import importlib
import math
import tomllib
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from skyrange.city.buildings import Building
from skyrange.city.city import City
from skyrange.city.downtown import downtown_grid
from skyrange.contracts.plugins.registry import AVOIDANCE
from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_S
from skyrange.vehicle.avoidance.conflicts import entry_s, find_conflicts, velocity_towards
from skyrange.vehicle.avoidance.contract import (
    NO_TRACKS,
    AvoidanceAction,
    AvoidanceContext,
    AvoidanceLimits,
    AvoidancePlugin,
    Own,
    Tracks,
)
from skyrange.vehicle.avoidance.geometric import Geometric
from skyrange.vehicle.avoidance.none import NoAvoidance
from skyrange.vehicle.avoidance.orca import Orca
from skyrange.vehicle.avoidance.stop import Stop
from skyrange.vehicle.avoidance.wall_queries import (
    clearance,
    corners,
    find_buildings_nearby,
    is_leg_clear,
    is_straight_clear,
    walls_of,
)

ROOT = Path(__file__).parents[2]
OWN = Own((0.0, 0.0, 30.0), (10.0, 0.0, 0.0), (500.0, 0.0, 30.0), 10.0)


def tracks(*rows: tuple[float, ...]) -> Tracks:
    """Each (east, north, up, ve, vn, vu)."""
    table = np.array(rows, dtype=np.float64).reshape(-1, 6)
    return Tracks(table[:, :3].copy(), table[:, 3:].copy())


def test_the_moment_of_entering_by_hand() -> None:
    # 100 m ahead, closing at 10 m/s, cylinder of 20 m: after 8 s
    assert entry_s(100.0, 0.0, 0.0, -10.0, 0.0, 0.0, 20.0, 10.0) == pytest.approx(8.0)
    # 12 m to the side: sqrt(400 - 144) = 16 m of the cylinder ahead of abeam
    assert entry_s(100.0, 12.0, 0.0, -10.0, 0.0, 0.0, 20.0, 10.0) == pytest.approx(8.4)
    assert entry_s(100.0, 20.0, 0.0, -10.0, 0.0, 0.0, 20.0, 10.0) == math.inf
    # from 30 m above, descending at 2 m/s: inside the height after 10 s, when it is just over the middle
    assert entry_s(100.0, 0.0, 30.0, -10.0, 0.0, -2.0, 20.0, 10.0) == pytest.approx(10.0)
    assert entry_s(100.0, 0.0, 30.0, -10.0, 0.0, -1.0, 20.0, 10.0) == math.inf  # over before it is low enough
    # inside: only what closes in
    assert entry_s(10.0, 0.0, 0.0, -1.0, 0.0, 0.0, 20.0, 10.0) == 0.0
    assert entry_s(10.0, 0.0, 0.0, 1.0, 0.0, 0.0, 20.0, 10.0) == math.inf
    assert entry_s(10.0, 0.0, 0.0, 0.0, 0.0, 0.0, 20.0, 10.0) == math.inf
    assert entry_s(10.0, 0.0, 5.0, 0.0, 0.0, -1.0, 20.0, 10.0) == 0.0
    assert entry_s(10.0, 0.0, 0.0, -0.4, 0.0, 0.0, 20.0, 10.0) == math.inf  # a formation, and noise
    assert entry_s(-100.0, 0.0, 0.0, -10.0, 0.0, 0.0, 20.0, 10.0) == math.inf  # behind, and falling back


@given(
    st.tuples(*[st.floats(-200, 200)] * 2, st.floats(-40, 40)), st.tuples(*[st.floats(-30, 30)] * 2, st.floats(-5, 5))
)
@example((15.0, 0.0, 11.0), (0.0, 0.0, -1.0))
def test_entering_agrees_with_small_steps(r: tuple[float, float, float], v: tuple[float, float, float]) -> None:
    at = entry_s(*r, *v, 20.0, 10.0)
    times = np.arange(0.0, 30.0, 0.01)
    x, y, z = (r[axis] + v[axis] * times for axis in range(3))
    inside = (np.hypot(x, y) < 20.0) & (np.abs(z) < 10.0)
    if inside[0]:
        assert at in (0.0, math.inf)
    elif inside.any():
        first = float(times[np.argmax(inside)])
        assert first - 0.011 <= at <= first + 1e-9
    else:  # nothing seen in steps of 0.01 s: at most a graze, in between two of them, or later
        deep = at < 29.99 and (np.hypot(r[0] + v[0] * (at + 0.02), r[1] + v[1] * (at + 0.02)) < 19.0)
        assert not (deep and abs(r[2] + v[2] * (at + 0.02)) < 9.8)


def test_rows_in_the_way_come_soonest_first_and_unknown_heights_count_as_ones_own() -> None:
    seen = tracks(
        (110, 0, 30, 0, 0, 0), (60, 0, math.nan, 0, 0, 0), (50, 0, 60, 0, 0, 0), (200, 0, 30, -10, 0, 0),
        (400, 0, 30, 0, 0, 0),
    )  # fmt: skip
    assert find_conflicts(OWN.pos_enu_m, OWN.vel_enu_mps, seen, AvoidanceLimits()) == (1, 0, 3)
    assert find_conflicts(OWN.pos_enu_m, OWN.vel_enu_mps, seen, AvoidanceLimits(), standing_s=60.0) == (1, 0, 3, 4)
    assert find_conflicts(OWN.pos_enu_m, OWN.vel_enu_mps, NO_TRACKS, AvoidanceLimits()) == ()


def test_towards() -> None:
    velocity, takes_s = velocity_towards((0, 0, 0), (30, 40, 0), 5.0)
    assert velocity == pytest.approx((3.0, 4.0, 0.0))
    assert takes_s == pytest.approx(10.0)
    assert velocity_towards((1, 2, 3), (1, 2, 3), 5.0) == ((0.0, 0.0, 0.0), 0.0)


# --- walls ----------------------------------------------------------------------------------------

GRID = downtown_grid((3, 3), seed=5)


@settings(max_examples=200, deadline=None)
@given(*[st.tuples(st.floats(-160, 160), st.floats(-160, 160), st.floats(1, 100))] * 2, st.sampled_from([0.5, 4.0]))
def test_a_leg_is_clear_where_the_city_says_so(
    a: tuple[float, float, float], b: tuple[float, float, float], margin: float
) -> None:
    """`is_leg_clear` against shapely (`City.is_clear`); within a centimetre of the margin the two may differ."""
    walls = walls_of(GRID)
    near = find_buildings_nearby(walls, np.array((a, b)), margin + 1.0)
    found = is_leg_clear(walls, near, *a, *b, margin)
    if GRID.is_clear([a, b], margin + 0.01):
        assert found
    if not GRID.is_clear([a, b], margin - 0.01):
        assert not found


def test_clearance_and_corners_of_a_square() -> None:
    city = City([Building("1", 50.0, shapely.box(0, 0, 20, 20))], "test")
    walls = walls_of(city)
    near = np.zeros(1, dtype=np.int64)
    assert clearance(walls, near, -3.0, 10.0, 20.0, 5.0) == pytest.approx(3.0)
    assert clearance(walls, near, 10.0, 10.0, 20.0, 5.0) == 0.0
    assert clearance(walls, near, 10.0, 10.0, 56.0, 5.0) == 5.0
    room = np.empty((16, 2))
    count = corners(walls, near, math.sqrt(2.0), room)
    assert sorted(map(tuple, np.round(room[:count], 6).tolist())) == [(-1, -1), (-1, 21), (21, -1), (21, 21)]
    # an L's inner corner comes out inside the building, and a courtyard's corners in the walls
    shapes = [shapely.Polygon([(0, 0), (20, 0), (20, 10), (10, 10), (10, 20), (0, 20)])]
    shapes.append(shapely.box(0, 0, 40, 40) - shapely.box(10, 10, 30, 30))
    for shape in shapes:
        for oriented in (shape, shape.reverse()):
            walls = walls_of(City([Building("1", 50.0, oriented)], "test"))
            count = corners(walls, near, 1.0, room)
            outside = [clearance(walls, near, x, y, 20.0, 5.0) > 0.0 for x, y in room[:count].tolist()]
            assert outside.count(True) == (5 if shape is shapes[0] else 4)


def test_a_place_close_to_a_wall_may_be_left_but_a_wall_not_crossed() -> None:
    city = City([Building("1", 50.0, shapely.box(0, 0, 20, 20))], "test")
    walls = walls_of(city)
    assert is_straight_clear(walls, (-1.0, 10.0, 20.0), (-50.0, 10.0, 20.0), 4.0)
    assert (
        is_straight_clear(walls, (-1.0, -50.0, 20.0), (-1.0, 50.0, 20.0), 4.0) is False
    )  # its ends are free, so 4 m it is
    assert is_straight_clear(walls, (-1.0, 10.0, 20.0), (30.0, 10.0, 20.0), 4.0) is False
    assert (
        is_straight_clear(walls, (10.0, 10.0, 20.0), (-50.0, 10.0, 20.0), 4.0) is False
    )  # from inside nothing is clear
    assert is_straight_clear(walls_of(None), (0, 0, 0), (1000, 0, 0), 4.0)


# --- episodes ---------------------------------------------------------------------------------------


def test_no_conflict_no_episode_and_none_never_acts() -> None:
    seen = tracks((60, 0, 30, 0, 0, 0))
    assert Geometric().decide(0, OWN, NO_TRACKS, None).action is AvoidanceAction.KEEP
    assert NoAvoidance().decide(0, OWN, seen, None).action is AvoidanceAction.KEEP
    decision = Stop().decide(0, OWN, seen, None)
    assert (decision.action, decision.tracks) == (AvoidanceAction.STOP, (0,))


def test_a_decision_is_a_function_of_its_arguments() -> None:
    seen = tracks((60, 0, 30, 0, 0, 0), (100, 30, 30, -5, 0, 0))
    one, two = Geometric(), Geometric()
    first = one.decide(7, OWN, seen, None)
    for _ in range(3):
        one.decide(9, OWN, tracks((50, 1, 30, -3, 0, 0)), first.episode)
    assert one.decide(7, OWN, seen, None) == first == two.decide(7, OWN, seen, None)
    far_too = tracks((60, 0, 30, 0, 0, 0), (100, 30, 30, -5, 0, 0), (9000, 9000, 30, 0, 0, 0))
    assert one.decide(7, OWN, far_too, None).waypoint_enu_m == first.waypoint_enu_m


def test_it_resumes_only_after_the_way_was_clear_for_a_while() -> None:
    avoidance, second = Stop(), NS_PER_S
    episode = avoidance.decide(0, OWN, tracks((60, 0, 30, 0, 0, 0)), None).episode
    steps = []
    for at, clear in ((1, True), (2, False), (3, True), (4, True), (5, True)):
        seen = NO_TRACKS if clear else tracks((60, 0, 30, 0, 0, 0))
        decision = avoidance.decide(at * second, OWN, seen, episode)
        episode = decision.episode
        steps.append(decision.action)
    assert steps[:3] == [AvoidanceAction.STOP] * 3
    assert steps[3:] == [AvoidanceAction.STOP, AvoidanceAction.RESUME]  # clear_s is 1.5: at 3 s it began again


def test_entering_and_leaving_have_different_thresholds() -> None:
    beside = tracks((60, 22.0, 30, 0, 0, 0))  # clear of 20 m, not of 1.25 times 20 m
    assert Stop().decide(0, OWN, beside, None).action is AvoidanceAction.KEEP
    episode = Stop().decide(0, OWN, tracks((60, 0, 30, 0, 0, 0)), None).episode
    for at in range(1, 20):
        decision = Stop().decide(at * NS_PER_S, OWN, beside, episode)
        episode = decision.episode
        assert decision.action is AvoidanceAction.STOP


def test_it_returns_home_when_it_has_waited_long_enough() -> None:
    avoidance = Stop(None, AvoidanceLimits(give_up_s=50.0, longest_s=70.0))
    seen = tracks((60, 0, 30, 0, 0, 0))
    decision = avoidance.decide(0, OWN, seen, None)
    at = 0
    while decision.action is AvoidanceAction.STOP:
        at += 1
        decision = avoidance.decide(at * NS_PER_S, OWN, seen, decision.episode)
    assert decision.action is AvoidanceAction.RETURN
    assert at == 50
    assert decision.episode is None
    late = replace(avoidance.decide(0, OWN, seen, None).episode, begun_ns=-70 * NS_PER_S)  # type: ignore[type-var]
    assert avoidance.decide(1, OWN, seen, late).action is AvoidanceAction.RETURN


def test_who_was_climbing_comes_back_over_its_place_before_it_goes_on() -> None:
    # a take-off that is resumed goes straight up from wherever it is
    avoidance, second = Geometric(), NS_PER_S
    top = (0.0, 0.0, 60.0)
    climbing = Own((0.0, 0.0, 30.0), (0.0, 0.0, 2.5), top, 5.0)
    decision = avoidance.decide(0, climbing, tracks((8, 0, 50, 0, 0, 0)), None)
    assert decision.action in (AvoidanceAction.GO, AvoidanceAction.STOP)
    aside = climbing._replace(pos_enu_m=(25.0, 0.0, 30.0), vel_enu_mps=(0.0, 0.0, 0.0))
    for at in range(1, 8):  # the way to the top is clear, yet it is not over its place
        decision = avoidance.decide(at * second, aside, NO_TRACKS, decision.episode)
        assert decision.action is AvoidanceAction.GO
    assert decision.waypoint_enu_m == (0.0, 0.0, 30.0)
    back = aside._replace(pos_enu_m=(2.0, 0.0, 30.0))
    actions = []
    for at in range(8, 12):
        decision = avoidance.decide(at * second, back, NO_TRACKS, decision.episode)
        actions.append(decision.action)
        if decision.episode is None:
            break
    assert actions[-1] is AvoidanceAction.RESUME
    # who was flying along resumes wherever its way is clear
    decision = avoidance.decide(0, OWN, tracks((60, 0, 30, 0, 0, 0)), None)
    beside = OWN._replace(pos_enu_m=(30.0, 30.0, 30.0))
    for at in range(1, 5):
        decision = avoidance.decide(at * second, beside, NO_TRACKS, decision.episode)
        if decision.episode is None:
            break
    assert decision.action is AvoidanceAction.RESUME


def test_kinds_are_plugins_and_bad_parameters_are_named() -> None:
    offered = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"][AVOIDANCE]
    for kind, value in offered.items():
        module, name = value.split(":")
        plugin = getattr(importlib.import_module(module), name)
        assert isinstance(plugin, AvoidancePlugin)
        with suppress(InputError):  # orca, where pyrvo is not installed
            made: Any = plugin(AvoidanceLimits(), AvoidanceContext())
            assert made.kind == kind
    assert Orca.kind == "orca"
    assert Geometric(None, AvoidanceLimits(protected_m=30)).limits.protected_m == 30.0
    with pytest.raises(ValidationError) as error:
        AvoidanceLimits.model_validate({"protectd_m": 30, "look_ahead_s": -1, "margin": 0.5, "least_m": True})
    wrong = {fault["loc"][0] for fault in error.value.errors()}
    assert wrong == {"protectd_m", "look_ahead_s", "margin", "least_m"}
    for name, field in AvoidanceLimits.model_fields.items():
        assert field.description, name
