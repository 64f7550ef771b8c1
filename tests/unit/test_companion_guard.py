"""Who flies the aircraft: taking it from its mission, giving it back, and keeping the hands off."""

from __future__ import annotations

import numpy as np

from skyrange.core.time import NS_PER_S
from skyrange.remoteid.belief import Beliefs
from skyrange.vehicle.avoidance.contract import Action, Decision, Episode
from skyrange.vehicle.companion.asking import AGAIN_NS, WANTS, Asking
from skyrange.vehicle.companion.guard import SHOWN_NS, TELL_NS, TRIES, YIELD_NS, Guard, Hold
from skyrange.vehicle.companion.wire import AUTO, GUIDED, RTL

S = NS_PER_S
GOAL = (100.0, 0.0, 30.0)
AWAY = (50.0, -40.0, 30.0)
EPISODE = Episode(0, (0.0, 0.0, 30.0))
GO = Decision(Action.GO, EPISODE, AWAY)
STOP = Decision(Action.STOP, EPISODE)
LOITER, LAND = 5, 9


def taken() -> Guard:
    """An aircraft that shows GUIDED, commanded at 10 s."""
    guard = Guard()
    guard.follow(10 * S, GO, GOAL)
    assert guard.observe(11 * S, GUIDED, 11 * S, True, False) is None
    assert guard.hold is Hold.OURS
    return guard


def test_taking_and_giving_back() -> None:
    guard = Guard()
    order = guard.follow(10 * S, GO, GOAL)
    assert order is not None
    assert (order.mode, order.place, order.stop, order.note) == (GUIDED, AWAY, False, "decision.avoid")
    assert guard.hold is Hold.TAKING
    assert guard.goal_enu_m == GOAL
    assert guard.observe(10 * S + 1, AUTO, 10 * S - 1, True, False) is None  # an old heartbeat
    assert guard.observe(11 * S, GUIDED, 11 * S, True, False) is None
    assert guard.hold is Hold.OURS
    order = guard.follow(20 * S, Decision(Action.RESUME, None), GOAL)
    assert order is not None
    assert (order.mode, order.note, guard.hold) == (AUTO, "decision.resume", Hold.GIVING)
    assert guard.observe(21 * S, AUTO, 21 * S, True, False) is None
    assert guard.hold is Hold.MISSION
    assert not guard.engaged


def test_a_waypoint_is_told_once_and_again_after_a_while() -> None:
    guard = taken()
    assert guard.follow(10 * S + TELL_NS - 1, GO, GOAL) is None
    again = guard.follow(10 * S + TELL_NS, GO, GOAL)
    assert again is not None
    assert (again.place, again.mode, again.note) == (AWAY, None, "")
    near = guard.follow(14 * S, GO._replace(waypoint_enu_m=(50.2, -40.0, 30.0)), GOAL)
    assert near is None
    other = guard.follow(14 * S, GO._replace(waypoint_enu_m=(60.0, -40.0, 30.0)), GOAL)
    assert other is not None
    assert other.note == "decision.avoid"
    halt = guard.follow(14 * S, STOP, GOAL)
    assert halt is not None
    assert (halt.stop, halt.place, halt.mode) == (True, None, None)


def test_a_lost_command_is_repeated_and_then_given_up() -> None:
    guard = Guard()
    guard.follow(0, GO, GOAL)
    orders = []
    for step in range(1, 60):
        now = step * S // 4
        order = guard.observe(now, AUTO, now, True, False)
        if order is not None:
            orders.append((now, order.mode, order.note))
        if guard.engaged:
            guard.follow(now, GO, GOAL)
    assert [mode for _, mode, _ in orders] == [GUIDED] * (TRIES - 1) + [None]
    assert [now for now, _, _ in orders] == [SHOWN_NS * count for count in range(1, TRIES + 1)]
    assert orders[-1][2] == "decision.avoid_refused"
    assert guard.hold is Hold.MISSION


def test_it_yields_to_whoever_chooses_another_mode() -> None:
    for mode in (LOITER, LAND, RTL, 0, AUTO):  # AUTO again, after GUIDED had shown, is somebody's choice too
        guard = taken()
        order = guard.observe(15 * S, mode, 15 * S, True, False)
        assert order is not None
        assert (order.note, order.mode, guard.engaged) == ("decision.yield", None, False)
        assert guard.quiet_until_ns == 15 * S + YIELD_NS
    guard = Guard()
    guard.follow(10 * S, GO, GOAL)
    assert guard.observe(11 * S, LAND, 11 * S, True, False) is not None
    assert not guard.engaged


def test_a_failsafe_ends_it_and_does_not_leave_the_aircraft_hanging_in_guided() -> None:
    guard = taken()
    order = guard.observe(15 * S, GUIDED, 15 * S, True, True)
    assert order is not None
    assert (order.mode, guard.engaged) == (AUTO, False)
    guard = taken()
    order = guard.observe(15 * S, RTL, 15 * S, True, True)
    assert order is not None
    assert (order.mode, guard.engaged) == (None, False)


def test_it_ends_on_the_ground() -> None:
    guard = taken()
    order = guard.observe(15 * S, GUIDED, 15 * S, False, False)
    assert order is not None
    assert (order.mode, order.note) == (None, "decision.avoid_ended")


def test_going_home_is_a_command_and_the_end() -> None:
    guard = taken()
    order = guard.follow(30 * S, Decision(Action.RETURN, None), GOAL)
    assert order is not None
    assert (order.mode, order.note, guard.engaged) == (RTL, "decision.avoid_return", False)


def test_keep_is_nothing() -> None:
    guard = Guard()
    assert guard.follow(0, Decision(Action.KEEP, None), GOAL) is None
    assert not guard.engaged


# --- what is asked for --------------------------------------------------------------------------------


def names(asked: list[tuple[int, object]]) -> list[str]:
    return [want.told for _, want in asked]  # type: ignore[attr-defined]


def test_what_is_missing_is_asked_for_at_first_and_again_when_it_stops() -> None:
    table = Beliefs(np.array([1, 2])).table
    asking = Asking(np.array([True, False]))
    assert asking.due(S, table, AUTO) == []  # nobody is there yet
    table["beat_ns"] = S
    first = asking.due(S, table, AUTO)
    assert [(row, want.told) for row, want in first] == [
        (0, "gnss_ns"), (1, "gnss_ns"), (0, "time_ns"), (1, "time_ns"), (0, "home_ns"), (1, "home_ns"), (0, "goal_ns"),
    ]  # fmt: skip
    for name in ("gnss_ns", "time_ns", "home_ns"):
        table[name] = 2 * S
    table["place_ns"][1] = 3 * S  # a ground station has asked for that one's positions
    assert [(row, want.told) for row, want in asking.due(4 * S, table, AUTO)] == [(0, "place_ns")]
    table["place_ns"] = 4 * S
    assert asking.due(5 * S, table, AUTO) == []
    table["place_ns"] = 14 * S
    assert names(asking.due(14 * S, table, AUTO)) == ["gnss_ns"] * 2 + ["time_ns"] * 2 + ["home_ns"] * 2
    table["mode"], table["state"] = AUTO, 4
    table["place_ns"] = table["gnss_ns"] = table["time_ns"] = table["home_ns"] = 14 * S
    assert names(asking.due(14 * S, table, AUTO)) == ["goal_ns"]  # in AUTO, in the air, and nothing told
    assert AGAIN_NS == 10 * S
    assert all(want.interval_ns <= S or want.told in ("time_ns", "home_ns") for want in WANTS)
