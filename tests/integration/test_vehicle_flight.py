"""Whole flights: the builtin autopilot in the world, commanded by MAVLink bytes alone.

Tolerances are on true positions in metres, chosen about twice what the controllers show.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from skyrange.codec.mavlink import dialect
from skyrange.vehicle.builtin.modes import Mode
from skyrange.vehicle.contract import VehicleSpec
from tests.integration.flight_harness import (
    ORIGIN,
    Range,
    jump,
    land,
    rtl,
    speed,
    square,
    start,
    takeoff,
    waypoint,
)

pytestmark = pytest.mark.rotating

V = "blue/b1"
A = dialect


def one(**params: float) -> Range:
    return Range([VehicleSpec(V, 1, params=params)])


def path(r: Range, since_s: float = 0.0) -> np.ndarray:
    return np.array([p[0] for t, p in r.track if t >= since_s])


def away_from_square(points: np.ndarray, side: float) -> np.ndarray:
    """Distance of points from the outline of a square with corners (0, 0) and (side, side)."""
    east, north = points[:, 0], points[:, 1]
    outside = np.hypot(
        np.maximum(np.maximum(-east, east - side), 0.0), np.maximum(np.maximum(-north, north - side), 0.0)
    )
    inside = np.minimum(np.minimum(east, side - east), np.minimum(north, side - north))
    return np.asarray(np.where(outside > 0.0, outside, np.abs(inside)))


def test_square_mission_from_upload_to_disarmed() -> None:
    r = one()
    assert r.upload(V, square(20, 5)) == 0
    start(r, V)
    r.run_until(r.has("event.item_reached", 5), 90.0)
    legs = [p for t, p in r.track if r.events("event.item_reached") and t > 8.6]
    points = np.array([p[0] for p in legs])
    assert away_from_square(points, 20.0).max() < 2.0  # corners are rounded inside WPNAV_RADIUS
    assert np.abs(points[:, 2] - 5.0).max() < 0.3
    r.run_until(r.has("event.disarmed"), 60.0)
    assert [n.data["seq"] for n in r.events("event.item_reached")] == [1, 2, 3, 4, 5, 6]
    assert [m.seq for m in r.heard("MISSION_ITEM_REACHED")] == [1, 2, 3, 4, 5, 6]
    order = [n.kind for _, n in r.notes if n.kind in ("event.armed", "event.takeoff", "event.landed", "event.disarmed")]
    assert order == ["event.armed", "event.takeoff", "event.landed", "event.disarmed"]
    contact = r.events("event.contact")[-1]
    assert contact.data["speed_mps"] == pytest.approx(0.5, abs=0.1)  # LAND_SPEED
    assert np.hypot(*r.positions()[0, :2]) < 0.3


def test_reached_items_quote_the_frames_that_wrote_them() -> None:
    r = one()
    r.upload(V, square(5, 5))
    slots = [slot.causes for slot in r.engines[0]._fleet.vehicles[0].mission]
    start(r, V)
    r.run_until(r.has("event.item_reached", 3), 60.0)
    for note in r.events("event.item_reached"):
        seq = note.data["seq"]
        assert isinstance(seq, int)
        assert note.causes == slots[seq]


def test_home_is_where_it_was_armed_even_on_a_height() -> None:
    spec = VehicleSpec(V, 1, home_enu_m=(30.0, -40.0, 0.0), heading_deg=90.0)
    r = Range([spec])
    r.upload(V, [takeoff(5), waypoint(40, -40, 5), rtl()])
    start(r, V)
    r.run_until(r.has("event.disarmed"), 90.0)
    assert np.hypot(*(r.positions()[0, :2] - [30.0, -40.0])) < 0.3


def test_mission_ends_on_a_land_item_at_its_place() -> None:
    r = one()
    r.upload(V, [takeoff(8), waypoint(0, 10, 8, hold_s=3.0), land(10, 10)])
    start(r, V)
    r.run_until(r.has("event.item_reached", 1), 30.0)
    r.run_until(lambda x: abs(x.positions()[0, 1] - 10.0) < 0.5, 30.0)
    held = r.seconds
    r.run_until(r.has("event.item_reached", 2), 30.0)
    assert r.seconds - held > 3.0
    r.run_until(r.has("event.disarmed"), 60.0)
    assert np.hypot(*(r.positions()[0, :2] - [10.0, 10.0])) < 0.3
    assert r.events("event.disarmed")[0].data["reason"] == "landed"


def test_jump_repeats_and_change_of_speed_acts() -> None:
    r = one()
    r.upload(V, [speed(3.0), takeoff(5), waypoint(0, 20, 5), waypoint(0, 0, 5), jump(3, 2), rtl()])
    start(r, V)
    r.run_until(r.has("event.item_reached", 7), 200.0)
    assert [n.data["seq"] for n in r.events("event.item_reached")] == [2, 3, 4, 3, 4, 3, 4]
    steps = np.diff(path(r), axis=0) / 0.05
    assert np.hypot(steps[:, 0], steps[:, 1]).max() == pytest.approx(3.0, abs=0.35)
    r.run_until(r.has("event.disarmed"), 60.0)


def test_speed_command_in_flight() -> None:
    r = one(WPNAV_SPEED=300)
    r.upload(V, [takeoff(5), waypoint(0, 200, 5), rtl()])
    start(r, V)
    r.run_until(lambda x: x.positions()[0, 1] > 30.0, 60.0)
    assert r.velocities()[0, 1] == pytest.approx(3.0, abs=0.2)
    assert r.command(V, A.MAV_CMD_DO_CHANGE_SPEED, 1.0, 6.0) == 0
    r.run(8.0)
    assert r.velocities()[0, 1] == pytest.approx(6.0, abs=0.3)
    assert r.command(V, A.MAV_CMD_DO_CHANGE_SPEED, 1.0, -3.0) == A.MAV_RESULT_DENIED
    assert r.command(V, A.MAV_CMD_DO_CHANGE_SPEED, 9.0, 3.0) == A.MAV_RESULT_FAILED  # no such kind of speed


def test_brake_stops_and_holds() -> None:
    r = one()
    r.upload(V, [takeoff(5), waypoint(0, 300, 5), rtl()])
    start(r, V)
    r.run_until(lambda x: x.velocities()[0, 1] > 8.0, 60.0)
    began = r.positions()[0, 1]
    assert r.mode(V, Mode.BRAKE) == 0
    r.run(8.0)
    stopped = r.positions()[0]
    # not sooner than v²/2a at 7.5 m/s²; PSC_JERK_XY of 5 m/s³ first has to turn the acceleration round and
    # lets the end run out with a time constant of 7.5 / 5 s
    assert 4.0 < stopped[1] - began < 25.0
    assert np.abs(r.velocities()[0]).max() < 0.2
    r.run(10.0)
    assert np.abs(r.positions()[0] - stopped).max() < 1.5
    assert abs(r.positions()[0, 2] - 5.0) < 0.3


def test_rtl_climbs_returns_waits_and_lands() -> None:
    r = one(RTL_ALT=1200)
    r.take_off(V, 6.0)
    lat, lon = ORIGIN.geodetic_of(0.0, 60.0)
    r.send(
        V,
        A.MAVLink_set_position_target_global_int_message(
            0, 1, 1, 6, 0xDF8, round(lat * 1e7), round(lon * 1e7), 6.0, 0, 0, 0, 0, 0, 0, 0, 0
        ),
    )
    r.run_until(lambda x: abs(x.positions()[0, 1] - 60.0) < 0.3, 60.0)
    assert r.command(V, A.MAV_CMD_NAV_RETURN_TO_LAUNCH) == 0
    began = r.seconds
    r.run_until(r.has("event.disarmed"), 120.0)
    points = path(r, began)
    assert points[:, 2].max() == pytest.approx(12.0, abs=0.3)
    far = points[points[:, 1] > 10.0]
    moving = far[far[:, 1] < 59.0]
    assert moving[:, 2].min() > 11.5  # climbed before it went
    assert np.hypot(*r.positions()[0, :2]) < 0.3
    assert r.events("event.disarmed")[0].data["reason"] == "landed"
    assert r.events("event.disarmed")[0].causes == r.events("event.mode")[-1].causes


def test_land_mode_lands_where_it_is() -> None:
    r = one()
    r.take_off(V, 15.0)
    assert r.command(V, A.MAV_CMD_NAV_LAND) == 0
    r.run_until(r.has("event.disarmed"), 60.0)
    assert np.hypot(*r.positions()[0, :2]) < 0.3
    falls = np.diff(path(r)[:, 2]) / 0.05
    assert falls.min() == pytest.approx(-1.5, abs=0.25)  # WPNAV_SPEED_DN above LAND_ALT_LOW


def local(x: float, y: float, z: float, v: tuple[float, float, float], mask: int, frame: int = 1) -> Any:
    return A.MAVLink_set_position_target_local_ned_message(0, 1, 1, frame, mask, x, y, z, *v, 0, 0, 0, 0, 0)


def test_guided_position_velocity_and_timeout() -> None:
    r = one()
    r.take_off(V, 10.0)
    r.send(V, local(20.0, -15.0, -12.0, (0, 0, 0), 0xDF8))  # north 20, east -15, up 12
    r.run(15.0)
    assert np.abs(r.positions()[0] - [-15.0, 20.0, 12.0]).max() < 0.3
    for _ in range(40):
        r.send(V, local(0, 0, 0, (0.0, 3.0, 0.0), 0xDC7))  # 3 m/s east, told again and again
        r.run(0.1)
    assert r.velocities()[0] == pytest.approx([3.0, 0.0, 0.0], abs=0.3)
    r.run(7.0)  # GUID_TIMEOUT has passed
    assert np.abs(r.velocities()[0]).max() < 0.3
    here = r.positions()[0].copy()
    r.send(V, local(5.0, 0.0, 0.0, (0, 0, 0), 0xDF8, frame=A.MAV_FRAME_LOCAL_OFFSET_NED))
    r.run(8.0)
    assert np.abs(r.positions()[0] - here - [0.0, 5.0, 0.0]).max() < 0.4


@pytest.fixture(scope="module")
def moving() -> Range:
    """At 10 m, told to fly 3 m/s east 2 s ago."""
    r = one()
    r.take_off(V, 10.0)
    r.send(V, local(0, 0, 0, (0.0, 3.0, 0.0), 0xDC7))
    r.run(2.0)
    return r


@pytest.mark.parametrize(
    "target",
    [
        local(math.nan, 0, -10, (0, 0, 0), 0xDF8),
        local(math.inf, 0, -10, (0, 0, 0), 0xDF8),
        local(3e38, 0, -10, (0, 0, 0), 0xDF8),
        local(0, 0, 0, (math.nan, 0, 0), 0xDC7),
        local(0, 0, 0, (3e38, 0, 0), 0xDC7),
        local(0, 0, 0, (0, 0, 0), 0xFFF),
        local(5, 5, -10, (0, 0, 0), 0xDF8, frame=77),
        A.MAVLink_set_position_target_global_int_message(0, 1, 1, 6, 0xDF8, 2**31 - 1, 0, 5, 0, 0, 0, 0, 0, 0, 0, 0),
        A.MAVLink_set_position_target_global_int_message(0, 1, 1, 6, 0xDF8, 0, 0, math.nan, 0, 0, 0, 0, 0, 0, 0, 0),
    ],
)
def test_senseless_targets_stop_the_aircraft(moving: Range, target: object) -> None:
    r = moving.copy()
    assert r.velocities()[0, 0] > 1.0
    r.send(V, target)
    r.run(4.0)
    assert np.abs(r.velocities()[0]).max() < 0.3
    assert abs(r.positions()[0, 2] - 10.0) < 0.5


def test_hover_holds_in_wind() -> None:
    r = Range([VehicleSpec(V, 1)], wind_enu_mps=(8.0, 0.0, 0.0))
    r.take_off(V, 10.0)
    r.run(15.0)
    since = r.seconds
    r.run(10.0)
    held = path(r, since)
    assert np.ptp(held, axis=0).max() < 0.02  # steady wind: no motion left
    assert np.abs(held - [0.0, 0.0, 10.0]).max() < 0.8  # where the wind had it when it left the ground


def test_mission_in_wind_stays_on_its_legs() -> None:
    r = Range([VehicleSpec(V, 1)], wind_enu_mps=(5.0, 5.0, 0.0))
    r.upload(V, square(20, 10))
    start(r, V)
    r.run_until(r.has("event.item_reached", 1), 30.0)
    since = r.seconds
    r.run_until(r.has("event.item_reached", 5), 90.0)
    assert away_from_square(path(r, since + 3.0), 20.0).max() < 1.5
    r.run_until(r.has("event.disarmed"), 90.0)


def test_it_lands_and_disarms_in_a_wind_that_takes_more_lean_than_the_landing_detector_allows() -> None:
    r = Range([VehicleSpec(V, 1)], wind_enu_mps=(10.0, 0.0, 0.0))
    r.take_off(V, 5.0)
    assert r.mode(V, Mode.LAND) == 0
    r.run_until(r.has("event.landed"), 30.0)
    r.run_until(r.has("event.disarmed"), 5.0)
    assert r.events("event.disarmed")[0].data["reason"] == "landed"


def test_an_aircraft_that_the_wind_holds_back_is_at_its_waypoints_when_it_reaches_them() -> None:
    r = Range([VehicleSpec(V, 1)], wind_enu_mps=(-11.0, 0.0, 0.0))  # it makes some 1.5 m/s good against this
    r.upload(V, [takeoff(10), waypoint(20, 0, 10), waypoint(20, 20, 10), rtl()])
    start(r, V)
    for count, (east, north) in ((2, (20.0, 0.0)), (3, (20.0, 20.0))):
        r.run_until(r.has("event.item_reached", count), 120.0)
        assert np.hypot(*(r.positions()[0, :2] - [east, north])) < 5.0


def test_disarm_in_flight_only_by_force() -> None:
    r = one()
    r.take_off(V, 5.0)
    assert r.command(V, A.MAV_CMD_COMPONENT_ARM_DISARM, 0.0) == A.MAV_RESULT_FAILED
    assert r.command(V, A.MAV_CMD_COMPONENT_ARM_DISARM, 0.0, 21196.0) == 0
    r.run(2.0)
    assert r.positions()[0, 2] < 1.0


def test_auto_resumes_the_item_it_left() -> None:
    r = one()
    r.upload(V, [takeoff(5), waypoint(0, 30, 5), waypoint(30, 30, 5), rtl()])
    start(r, V)
    r.run_until(r.has("event.item_reached", 2), 60.0)
    r.run(2.0)
    assert r.mode(V, Mode.GUIDED) == 0
    r.run(4.0)
    assert np.abs(r.velocities()[0]).max() < 0.4
    assert r.command(V, A.MAV_CMD_REQUEST_MESSAGE, A.MAVLINK_MSG_ID_MISSION_CURRENT) == 0
    assert r.heard("MISSION_CURRENT")[-1].mission_state == A.MISSION_STATE_NOT_STARTED  # ArduPilot has no PAUSED
    assert r.mode(V, Mode.AUTO) == 0
    r.run_until(r.has("event.item_reached", 3), 60.0)
    assert [n.data["seq"] for n in r.events("event.item_reached")] == [1, 2, 3]


def test_current_item_can_be_set_in_flight_and_the_mission_rewritten() -> None:
    r = one()
    r.upload(V, [takeoff(5), waypoint(0, 50, 5), waypoint(30, 0, 5), rtl()])
    start(r, V)
    r.run_until(r.has("event.item_reached", 1), 60.0)
    r.run(2.0)
    assert r.command(V, A.MAV_CMD_DO_SET_MISSION_CURRENT, 3.0) == 0
    r.run(3.0)
    r.upload(V, [takeoff(5), waypoint(0, 50, 5), waypoint(15, 5, 7), rtl()])
    r.run_until(r.has("event.item_reached", 2), 60.0)
    assert np.abs(r.positions()[0] - [15.0, 5.0, 7.0]).max() < 2.0
    assert [n.data["seq"] for n in r.events("event.item_reached")] == [1, 3]


def test_second_flight_after_landing() -> None:
    r = one()
    r.upload(V, [takeoff(4), waypoint(0, 6, 4), rtl()])
    for flight in (1, 2):
        start(r, V)
        r.run_until(r.has("event.disarmed", flight), 90.0)
        assert r.mode(V, Mode.STABILIZE) == 0
    assert [n.data["seq"] for n in r.events("event.item_reached")] == [1, 2, 3, 1, 2, 3]


def test_upload_in_flight_that_takes_the_current_item_away() -> None:
    r = one()
    r.upload(V, [takeoff(5), waypoint(0, 20, 5), waypoint(20, 20, 5), rtl()])
    start(r, V)
    r.run_until(r.has("event.item_reached", 2), 60.0)
    r.send(V, A.MAVLink_mission_count_message(1, 1, 2, 0))  # begins an upload, and never goes on
    r.run_until(r.has("event.item_reached", 3), 30.0)  # the item under way is still flown to its end
    r.run(10.0)
    assert np.abs(r.velocities()[0]).max() < 0.3
    assert abs(r.positions()[0, 2] - 5.0) < 0.3


def test_a_mission_emptied_in_flight_leaves_it_holding() -> None:
    r = one()
    r.upload(V, square(30, 5))
    start(r, V)
    r.run_until(r.has("event.item_reached", 2), 60.0)
    r.send(V, A.MAVLink_mission_clear_all_message(1, 1, 0))
    r.run(0.05)
    assert r.heard("MISSION_ACK")[-1].type == A.MAV_MISSION_ERROR  # it runs
    r.send(V, A.MAVLink_mission_count_message(1, 1, 0, 0))
    r.run(8.0)
    assert np.abs(r.velocities()[0]).max() < 0.3
    assert r.mode(V, Mode.RTL) == 0
    r.run_until(r.has("event.disarmed"), 90.0)


def test_repeated_mission_start_does_not_delay_the_take_off() -> None:
    r = one()
    r.upload(V, square(5, 5))
    start(r, V)
    for _ in range(35):
        assert r.command(V, A.MAV_CMD_MISSION_START) == 0
        r.run(0.1)
    assert len(r.events("event.takeoff")) == 1
