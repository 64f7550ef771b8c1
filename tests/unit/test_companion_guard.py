"""Who flies the aircraft: taking it from its mission, giving it back, and keeping the hands off."""

from __future__ import annotations

import numpy as np

from skyrange.core.time import NS_PER_S
from skyrange.remoteid.autopilot_belief import Beliefs
from skyrange.vehicle.avoidance.contract import AvoidanceAction, AvoidanceDecision, Episode
from skyrange.vehicle.companion.autopilot_commands import (
    AUTO,
    GUIDED,
    REQUESTS,
    RETRY_NS,
    RTL,
    MessageRequest,
    MessageRequests,
)
from skyrange.vehicle.companion.control_handover import (
    CONFIRM_NS,
    MAX_TRIES,
    REPEAT_NS,
    YIELD_NS,
    ControlHandover,
    ControlState,
)

S = NS_PER_S
GOAL_REQUEST = (100.0, 0.0, 30.0)
AWAY = (50.0, -40.0, 30.0)
EPISODE = Episode(0, (0.0, 0.0, 30.0))
GO = AvoidanceDecision(AvoidanceAction.GO, EPISODE, AWAY)
STOP = AvoidanceDecision(AvoidanceAction.STOP, EPISODE)
LOITER, LAND = 5, 9


def taken() -> ControlHandover:
    """An aircraft that shows GUIDED, commanded at 10 s."""
    handover = ControlHandover()
    handover.follow(10 * S, GO, GOAL_REQUEST)
    assert handover.observe(11 * S, GUIDED, 11 * S, flying=True, failsafe=False) is None
    assert handover.control is ControlState.COMPANION
    return handover


def test_taking_and_giving_back() -> None:
    handover = ControlHandover()
    command = handover.follow(10 * S, GO, GOAL_REQUEST)
    assert command is not None
    assert (command.mode, command.place, command.stop, command.note) == (GUIDED, AWAY, False, "decision.avoid")
    assert (handover.control, handover.goal_enu_m) == (ControlState.TAKING_OVER, GOAL_REQUEST)
    assert handover.observe(10 * S + 1, AUTO, 10 * S - 1, flying=True, failsafe=False) is None  # an old heartbeat
    assert handover.observe(11 * S, GUIDED, 11 * S, flying=True, failsafe=False) is None
    assert (handover.control, handover.engaged) == (ControlState.COMPANION, True)
    command = handover.follow(20 * S, AvoidanceDecision(AvoidanceAction.RESUME, None), GOAL_REQUEST)
    assert command is not None
    assert (command.mode, command.note, handover.control) == (AUTO, "decision.resume", ControlState.RETURNING)
    assert handover.observe(21 * S, AUTO, 21 * S, flying=True, failsafe=False) is None
    assert (handover.control, handover.engaged) == (ControlState.MISSION, False)


def test_a_waypoint_is_told_once_and_again_after_a_while() -> None:
    handover = taken()
    assert handover.follow(10 * S + REPEAT_NS - 1, GO, GOAL_REQUEST) is None
    again = handover.follow(10 * S + REPEAT_NS, GO, GOAL_REQUEST)
    assert again is not None
    assert (again.place, again.mode, again.note) == (AWAY, None, "")
    near = handover.follow(14 * S, GO._replace(waypoint_enu_m=(50.2, -40.0, 30.0)), GOAL_REQUEST)
    assert near is None
    other = handover.follow(14 * S, GO._replace(waypoint_enu_m=(60.0, -40.0, 30.0)), GOAL_REQUEST)
    assert other is not None
    assert other.note == "decision.avoid"
    halt = handover.follow(14 * S, STOP, GOAL_REQUEST)
    assert halt is not None
    assert (halt.stop, halt.place, halt.mode) == (True, None, None)


def test_a_lost_command_is_repeated_and_then_given_up() -> None:
    handover = ControlHandover()
    handover.follow(0, GO, GOAL_REQUEST)
    orders = []
    for step in range(1, 60):
        now = step * S // 4
        command = handover.observe(now, AUTO, now, flying=True, failsafe=False)
        if command is not None:
            orders.append((now, command.mode, command.note))
        if handover.engaged:
            handover.follow(now, GO, GOAL_REQUEST)
    assert [mode for _, mode, _ in orders] == [GUIDED] * (MAX_TRIES - 1) + [None]
    assert [now for now, _, _ in orders] == [CONFIRM_NS * count for count in range(1, MAX_TRIES + 1)]
    assert orders[-1][2] == "decision.avoid_refused"
    assert handover.control is ControlState.MISSION


def test_it_yields_to_whoever_chooses_another_mode() -> None:
    for mode in (LOITER, LAND, RTL, 0, AUTO):  # AUTO again, after GUIDED had shown, is somebody's choice too
        handover = taken()
        command = handover.observe(15 * S, mode, 15 * S, flying=True, failsafe=False)
        assert command is not None
        assert (command.note, command.mode, handover.engaged) == ("decision.yield", None, False)
        assert handover.quiet_until_ns == 15 * S + YIELD_NS
    handover = ControlHandover()
    handover.follow(10 * S, GO, GOAL_REQUEST)
    assert handover.observe(11 * S, LAND, 11 * S, flying=True, failsafe=False) is not None
    assert not handover.engaged


def test_a_failsafe_ends_it_and_does_not_leave_the_aircraft_hanging_in_guided() -> None:
    handover = taken()
    command = handover.observe(15 * S, GUIDED, 15 * S, flying=True, failsafe=True)
    assert command is not None
    assert (command.mode, handover.engaged) == (AUTO, False)
    handover = taken()
    command = handover.observe(15 * S, RTL, 15 * S, flying=True, failsafe=True)
    assert command is not None
    assert (command.mode, handover.engaged) == (None, False)


def test_it_ends_on_the_ground() -> None:
    handover = taken()
    command = handover.observe(15 * S, GUIDED, 15 * S, flying=False, failsafe=False)
    assert command is not None
    assert (command.mode, command.note) == (None, "decision.avoid_ended")


def test_going_home_is_a_command_and_the_end() -> None:
    handover = taken()
    command = handover.follow(30 * S, AvoidanceDecision(AvoidanceAction.RETURN, None), GOAL_REQUEST)
    assert command is not None
    assert (command.mode, command.note, handover.engaged) == (RTL, "decision.avoid_return", False)


def test_keep_is_nothing() -> None:
    handover = ControlHandover()
    assert handover.follow(0, AvoidanceDecision(AvoidanceAction.KEEP, None), GOAL_REQUEST) is None
    assert not handover.engaged


# --- what is asked for --------------------------------------------------------------------------------


def names(asked: list[tuple[int, MessageRequest]]) -> list[str]:
    return [request.field for _, request in asked]


def test_what_is_missing_is_asked_for_at_first_and_again_when_it_stops() -> None:
    table = Beliefs(np.array([1, 2])).table
    asking = MessageRequests(np.array([True, False]))
    assert asking.due(S, table, AUTO) == []  # nobody is there yet
    table["heartbeat_ns"] = S
    first = asking.due(S, table, AUTO)
    assert [(row, request.field) for row, request in first] == [
        (0, "gnss_ns"), (1, "gnss_ns"), (0, "time_ns"), (1, "time_ns"), (0, "home_ns"), (1, "home_ns"), (0, "goal_ns"),
    ]  # fmt: skip
    for name in ("gnss_ns", "time_ns", "home_ns"):
        table[name] = 2 * S
    table["position_ns"][1] = 3 * S  # a ground station has asked for that one's positions
    assert [(row, request.field) for row, request in asking.due(4 * S, table, AUTO)] == [(0, "position_ns")]
    table["position_ns"] = 4 * S
    assert asking.due(5 * S, table, AUTO) == []
    table["position_ns"] = 14 * S
    assert names(asking.due(14 * S, table, AUTO)) == ["gnss_ns"] * 2 + ["time_ns"] * 2 + ["home_ns"] * 2
    table["mode"], table["state"] = AUTO, 4
    table["position_ns"] = table["gnss_ns"] = table["time_ns"] = table["home_ns"] = 14 * S
    assert names(asking.due(14 * S, table, AUTO)) == ["goal_ns"]  # in AUTO, in the air, and nothing told
    assert RETRY_NS == 10 * S
    assert all(request.interval_ns <= S or request.field in ("time_ns", "home_ns") for request in REQUESTS)
