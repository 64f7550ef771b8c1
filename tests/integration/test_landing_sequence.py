"""DO_LAND_START: AUTO_RTL, its command and its failsafes (ModeAuto, AP_Mission::jump_to_landing_sequence)."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from skyrange.codec.mavlink import dialect
from skyrange.vehicle.builtin.modes import Mode
from tests.integration.flight_harness import RELATIVE, Item, Range, land, takeoff, waypoint
from tests.integration.hovering import V, beat, hovering, modes, put, texts

A = dialect
OK, FAILED = 0, 4
WARNING, INFO = 4, 6


def land_start(east: float = 0.0, north: float = 0.0, alt: float = 0.0) -> Item:
    return (RELATIVE, A.MAV_CMD_DO_LAND_START, (0.0, 0.0, 0.0, 0.0), (east, north, alt))


def far_and_near() -> list[Item]:
    """Two landing sequences: item 3 begins 300 m north, item 6 15 m east, where the aircraft hovers at (0, 0)."""
    return [
        takeoff(10),
        waypoint(0, 200, 10),
        land_start(0, 300, 10),
        waypoint(0, 310, 10),
        land(0, 320),
        land_start(15, 0, 10),
        waypoint(15, 0, 10),
        land(20, 0),
    ]


def shown(r: Range) -> int:
    assert r.command(V, A.MAV_CMD_REQUEST_MESSAGE, A.MAVLINK_MSG_ID_HEARTBEAT) == OK
    return int(r.heard("HEARTBEAT")[-1].custom_mode)


def ready(**params: float) -> Range:
    r = hovering(**params)
    assert r.upload(V, far_and_near()) == 0
    return r


def current(r: Range) -> int:
    return r.engines[0]._fleet.vehicles[0].current


def test_mode_27_flies_the_nearest_sequence_to_the_ground_shown_as_auto_rtl() -> None:
    r = ready()
    start = r.seconds
    assert r.mode(V, Mode.AUTO_RTL) == OK
    assert shown(r) == 27
    assert current(r) == 7
    assert modes(r, start) == [("AUTO", "gcs_command"), ("AUTO_RTL", "gcs_command")]
    assert r.events("event.mode")[-1].causes
    assert (INFO, "Landing sequence start") in texts(r, start)
    assert (INFO, "Mission: 6 LandStart") in texts(r, start)
    assert r.mode(V, Mode.AUTO_RTL) == OK  # already there: nothing happens
    assert modes(r, start)[2:] == []
    assert r.arm(V) == OK
    r.run_until(r.has("event.disarmed"), 60.0)
    assert r.positions()[0, :2] == pytest.approx((20.0, 0.0), abs=0.5)
    r.run(0.05)
    assert shown(r) == Mode.AUTO  # the sequence is over
    assert modes(r, start)[2:] == [("AUTO", "auto_rtl_exit")]


def test_set_mode_does_so_too_and_auto_ends_the_disguise() -> None:
    r = ready()
    r.send(V, A.MAVLink_set_mode_message(1, A.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, 27))
    r.run(0.05)
    assert shown(r) == 27
    assert r.command(V, A.MAV_CMD_REQUEST_MESSAGE, A.MAVLINK_MSG_ID_MISSION_CURRENT) == OK
    told = r.heard("MISSION_CURRENT")[-1]
    assert (told.seq, told.mission_state, told.mission_mode) == (7, A.MISSION_STATE_ACTIVE, 1)
    assert r.mode(V, Mode.AUTO) == OK
    assert shown(r) == Mode.AUTO
    assert current(r) == 7  # MIS_RESTART 0: on with the item


def test_auto_rtl_resumes_where_mis_restart_would_begin_anew() -> None:
    r = ready(MIS_RESTART=1)
    assert r.mode(V, Mode.AUTO_RTL) == OK
    assert current(r) == 7
    assert r.mode(V, Mode.AUTO) == OK
    assert current(r) == 1


def test_a_jump_out_of_the_sequence_ends_it() -> None:
    r = ready()
    assert r.command(V, A.MAV_CMD_DO_LAND_START) == OK
    start = r.seconds
    r.send(V, A.MAVLink_mission_set_current_message(1, 1, 2))
    r.run(0.05)
    assert shown(r) == Mode.AUTO
    assert modes(r, start) == [("AUTO", "auto_rtl_exit")]


def test_a_mission_that_lands_already_is_not_moved_by_the_mode_but_by_the_command() -> None:
    r = ready()
    assert r.mode(V, Mode.AUTO) == OK
    r.send(V, A.MAVLink_mission_set_current_message(1, 1, 3))  # the far sequence
    r.run(0.05)
    assert (shown(r), current(r)) == (Mode.AUTO, 4)
    start = r.seconds
    assert r.mode(V, Mode.AUTO_RTL) == OK
    assert (shown(r), current(r)) == (27, 4)
    assert texts(r, start) == [(INFO, "Landing sequence active")]
    assert r.command(V, A.MAV_CMD_DO_LAND_START) == OK
    assert (shown(r), current(r)) == (27, 7)


def test_a_start_without_a_place_stands_where_the_next_item_does() -> None:
    r = hovering()
    nowhere = (RELATIVE, A.MAV_CMD_DO_LAND_START, (0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert (
        r.upload(V, [takeoff(10), land_start(0, 60, 10), land(0, 60), nowhere, waypoint(0, 20, 10), land(0, 20)]) == 0
    )
    slot = r.engines[0]._fleet.vehicles[0].mission[4]
    slot.x = slot.y = 0  # the harness writes places as degrees
    assert r.command(V, A.MAV_CMD_DO_LAND_START) == OK
    assert current(r) == 5


def test_without_a_sequence_it_is_refused_and_says_why() -> None:
    r = hovering()
    assert r.upload(V, [takeoff(10), waypoint(0, 50, 10)]) == 0
    asks: tuple[tuple[Callable[[], int], str], ...] = (
        (lambda: r.mode(V, Mode.AUTO_RTL), "Mode change to AUTO RTL failed: No return path or landing sequence found"),
        (lambda: r.command(V, A.MAV_CMD_DO_LAND_START), "Mode change to AUTO RTL failed: No landing sequence found"),
    )
    for ask, why in asks:
        start = r.seconds
        assert ask() == FAILED
        assert texts(r, start) == [(WARNING, "Unable to start landing sequence"), (WARNING, why[:50])]
        assert shown(r) == Mode.GUIDED


def test_armed_on_the_ground_it_is_refused() -> None:
    r = hovering()
    assert r.mode(V, Mode.LAND) == OK
    r.run_until(r.has("event.disarmed"), 40.0)
    assert r.upload(V, far_and_near()) == 0
    assert r.mode(V, Mode.GUIDED) == OK
    assert r.arm(V) == OK
    assert r.mode(V, Mode.AUTO_RTL) == FAILED
    assert "Auto: Missing Takeoff Cmd" in r.words()
    assert shown(r) == Mode.GUIDED
    assert r.command(V, A.MAV_CMD_COMPONENT_ARM_DISARM, 0.0) == OK
    assert r.mode(V, Mode.AUTO_RTL) == OK  # disarmed, any mode may be chosen
    assert r.arm(V) == FAILED
    assert "Arm: AUTO_RTL mode not armable" in r.words()


def test_a_low_battery_lands_by_the_sequence() -> None:
    r = ready(BATT_FS_LOW_ACT=6)
    start = r.seconds
    put(r, "BATT_LOW_MAH", 1e5)
    r.run(0.5)
    assert modes(r, start) == [("AUTO", "battery_failsafe"), ("AUTO_RTL", "battery_failsafe")]
    assert current(r) == 7


def test_a_lost_ground_station_lands_by_the_sequence_and_does_not_continue_as_auto() -> None:
    r = ready(FS_GCS_ENABLE=6, FS_OPTIONS=2)
    beat(r)
    start = r.seconds
    r.run(6.0)
    assert modes(r, start) == [("AUTO", "gcs_failsafe"), ("AUTO_RTL", "gcs_failsafe")]
    assert shown(r) == 27
    put(r, "FS_GCS_ENABLE", 1)
    beat(r)
    start = r.seconds
    r.run(6.0)
    assert modes(r, start) == [("RTL", "gcs_failsafe")]  # FS_OPTIONS bit 1 lets AUTO go on, not AUTO_RTL
