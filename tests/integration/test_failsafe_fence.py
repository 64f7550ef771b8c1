"""The fence in flight: libraries/AC_Fence/AC_Fence.cpp, ArduCopter/fence.cpp."""

from __future__ import annotations

import math
from typing import Any

import pytest

from skyrange.codec.mavlink import dialect
from skyrange.vehicle.builtin import fence
from skyrange.vehicle.builtin.modes import Mode
from skyrange.vehicle.contract import VehicleSpec
from tests.integration.flight_harness import Range, takeoff, waypoint
from tests.integration.hovering import V, hovering, modes, put, standing, texts, when

pytestmark = pytest.mark.rotating

NOTICE, INFO = 5, 6
A = dialect


def go(r: Range, east: float, north: float, alt: float) -> float:
    """A mission that leads there, begun at once: unlike a target in GUIDED it is not refused for the fence; when."""
    r.upload(V, [takeoff(1.0), waypoint(east, north, alt)])
    assert r.mode(V, Mode.AUTO) == 0
    return r.seconds


def state(r: Range) -> Any:
    return r.engines[0]._fleet.fence[0]


def items(r: Range, zones: list[tuple[int, float, float, float]]) -> int:
    """Upload fence items (command, param1, east, north); the MAV_MISSION_RESULT."""
    r.send(V, A.MAVLink_mission_count_message(1, 1, len(zones), 1))
    r.run(0.01)
    for seq, (command, param1, east, north) in enumerate(zones):
        lat, lon = r.origin.geodetic_of(east, north)
        r.send(
            V,
            A.MAVLink_mission_item_int_message(
                1, 1, seq, 0, command, 0, 0, param1, 0, 0, 0, round(lat * 1e7), round(lon * 1e7), 0.0, 1
            ),
        )
        r.run(0.01)
    return int(r.heard("MISSION_ACK")[-1].type)


def box(half: float, command: int = 5001) -> list[tuple[int, float, float, float]]:
    return [(command, 4.0, e, n) for e, n in ((-half, -half), (half, -half), (half, half), (-half, half))]


def test_out_of_the_circle_it_returns_and_is_back() -> None:
    r = hovering(FENCE_ENABLE=1, FENCE_RADIUS=30)
    r.run(0.2)
    start = go(r, 60.0, 0.0, 10.0)
    r.run_until(lambda r: modes(r, start) != [], 30.0)
    assert r.positions()[0, 0] == pytest.approx(30.0, abs=1.5)  # 10 Hz at up to 10 m/s
    r.run(0.1)
    assert texts(r, start) == [(NOTICE, "Circle fence breached"), (INFO, "Manual recovery started")]
    assert modes(r, start) == [("RTL", "fence_breached")]
    status = r.heard("FENCE_STATUS")[-1]
    assert (status.breach_status, status.breach_count, status.breach_type) == (1, 1, A.FENCE_BREACH_BOUNDARY)
    assert status.breach_time / 1000.0 == pytest.approx(when(r, "breached"), abs=0.01)
    note = r.events("event.fence_breach")[0]
    assert note.data["fence"] == "Circle fence"
    r.run_until(lambda r: "Fence breach cleared" in r.words(), 30.0)
    assert r.positions()[0, 0] < 30.0
    assert (NOTICE, "Fence breach cleared") in texts(r, start)
    r.run_until(r.has("event.disarmed"), 90.0)
    assert math.hypot(*r.positions()[0, :2]) < 1.0


def test_disabled_by_default() -> None:
    r = hovering(FENCE_RADIUS=30, FENCE_ALT_MAX=12)
    start = go(r, 45.0, 0.0, 20.0)
    r.run(20.0)
    assert texts(r, start) == [(INFO, "Reached command #2")]
    assert r.heard("FENCE_STATUS") == []


def test_above_the_ceiling() -> None:
    r = hovering(FENCE_ENABLE=1, FENCE_ALT_MAX=12)
    start = go(r, 0.0, 0.0, 16.0)
    r.run_until(lambda r: modes(r, start) != [], 20.0)
    assert r.positions()[0, 2] == pytest.approx(12.2, abs=0.4)
    assert texts(r, start)[0] == (NOTICE, "Max Alt fence breached")
    assert modes(r, start) == [("RTL", "fence_breached")]


@pytest.mark.parametrize(("action", "expected"), [(0, []), (2, ["LAND"]), (3, ["RTL"]), (4, ["BRAKE"]), (5, ["LAND"])])
def test_actions(action: int, expected: list[str]) -> None:
    r = hovering(FENCE_ENABLE=1, FENCE_ALT_MAX=12, FENCE_ACTION=action)
    start = go(r, 0.0, 0.0, 16.0)
    r.run(4.0)
    assert [mode for mode, _ in modes(r, start)] == expected
    assert texts(r, start)[0] == (NOTICE, "Max Alt fence breached")


def test_a_polygon_and_an_exclusion_circle() -> None:
    r = hovering(FENCE_ENABLE=1)
    assert items(r, [*box(25.0), (5004, 8.0, 0.0, 15.0)]) == A.MAV_MISSION_ACCEPTED
    r.run(0.2)
    assert state(r)["breached"] == 0
    start = go(r, 0.0, 20.0, 10.0)  # into the circle
    r.run_until(lambda r: modes(r, start) != [], 20.0)
    assert r.positions()[0, 1] == pytest.approx(7.5, abs=1.2)
    assert texts(r, start)[0] == (NOTICE, "Polygon fence breached")
    r = hovering(FENCE_ENABLE=1)
    items(r, box(25.0))
    start = go(r, 0.0, 60.0, 10.0)
    r.run_until(lambda r: modes(r, start) != [], 20.0)
    assert r.positions()[0, 1] == pytest.approx(25.5, abs=1.2)


def test_far_outside_it_just_lands() -> None:
    r = hovering(FENCE_RADIUS=30)
    fleet = r.engines[0]._fleet
    fleet.assign_home(fleet.vehicles[0], (200.0, 0.0, 0.0))  # 170 m outside (AC_FENCE_GIVE_UP_DISTANCE is 100)
    r.run(1.1)
    start = r.seconds
    put(r, "FENCE_ENABLE", 1)
    r.run(0.2)
    assert modes(r, start) == [("LAND", "fence_breached")]


def test_a_backup_fence_20_m_further_out_breaches_anew_after_the_recovery_time() -> None:
    r = hovering(FENCE_ENABLE=1, FENCE_RADIUS=30, WPNAV_SPEED=300)  # slow: does not slide 20 m out
    start = go(r, 90.0, 0.0, 10.0)
    r.run_until(lambda r: modes(r, start) != [], 20.0)
    r.mode(V, Mode.BRAKE)  # the pilot takes over: 10 s without fence
    assert [w for _, w in texts(r, start)].count("Manual recovery started") == 2
    r.run(11.0)
    assert modes(r, start)[1:] == [("BRAKE", "gcs_command")]  # still breached, nothing new
    put(r, "WPNAV_SPEED", 100.0)  # another change of mode, another 10 s: they must not last to the backup
    start = go(r, 90.0, 0.0, 10.0)
    r.run_until(lambda r: modes(r, start) != [], 30.0)
    assert modes(r, start) == [("RTL", "fence_breached")]
    assert r.positions()[0, 0] == pytest.approx(51.0, abs=1.5)
    assert state(r)["count"] == 2


def test_options_hold_the_mode_until_back_inside() -> None:
    r = hovering(FENCE_ENABLE=1, FENCE_RADIUS=30, FENCE_OPTIONS=1)
    start = go(r, 60.0, 0.0, 10.0)
    r.run_until(lambda r: modes(r, start) != [], 20.0)
    assert r.mode(V, Mode.GUIDED) == 4
    assert "Mode change to GUIDED failed: in fence recovery" in r.words()
    r.run_until(lambda r: "Fence breach cleared" in r.words(), 20.0)
    assert r.mode(V, Mode.GUIDED) == 0


def test_the_floor_opens_by_itself_and_closes_for_landing() -> None:
    r = hovering(FENCE_ENABLE=1, FENCE_TYPE=15, FENCE_ALT_MIN=5)
    start = r.seconds
    r.run(0.3)
    assert texts(r, start) == [(NOTICE, "Min Alt fence enabled (auto enable)")]
    start = go(r, 0.0, 0.0, 3.0)
    r.run_until(lambda r: modes(r, start) != [], 20.0)
    assert modes(r, start) == [("RTL", "fence_breached")]
    assert (NOTICE, "Min Alt fence breached") in texts(r, start)
    start = r.seconds
    r.mode(V, Mode.LAND)
    r.run_until(r.has("event.disarmed"), 40.0)
    assert (NOTICE, "Min Alt fence auto-disabled") in texts(r, start)
    assert modes(r, start) == [("LAND", "gcs_command")]


def test_enabled_on_arming_and_disabled_on_disarming() -> None:
    r = standing(FENCE_AUTOENABLE=3, FENCE_RADIUS=40)
    r.mode(V, Mode.GUIDED)
    assert r.arm(V) == 0
    assert (NOTICE, "Max Alt, Circle and Polygon fences auto-enabled") in texts(r)
    assert state(r)["enabled"] == 7
    r.command(V, A.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)
    assert (NOTICE, "Max Alt, Circle and Polygon fences auto-disabled") in texts(r)
    assert state(r)["enabled"] == 0


def test_do_fence_enable() -> None:
    r = hovering(FENCE_RADIUS=30)
    fleet = r.engines[0]._fleet
    vehicle = fleet.vehicles[0]
    assert fence.handle_do_fence_enable(fleet, vehicle, 3, 0) == A.MAV_RESULT_FAILED
    assert fence.handle_do_fence_enable(fleet, vehicle, 1, 4) == A.MAV_RESULT_FAILED  # no polygon
    assert fence.handle_do_fence_enable(fleet, vehicle, 1, 2) == A.MAV_RESULT_ACCEPTED
    start = go(r, 0.0, 50.0, 10.0)
    r.run_until(lambda r: modes(r, start) != [], 20.0)
    assert fence.handle_do_fence_enable(fleet, vehicle, 0, 0) == A.MAV_RESULT_ACCEPTED
    r.run(0.2)
    assert state(r)["breached"] == 0


def test_on_the_ground_a_breach_forbids_arming() -> None:
    r = standing(FENCE_ENABLE=1)
    assert items(r, [(5003, 20.0, 100.0, 0.0)]) == A.MAV_MISSION_ACCEPTED
    r.mode(V, Mode.GUIDED)
    r.run(0.2)
    assert r.arm(V) == 4
    assert texts(r) == [(2, "Arm: Vehicle breaching Polygon fence")]


def test_a_return_stays_below_the_ceiling() -> None:
    r = hovering(FENCE_ENABLE=1, FENCE_ALT_MAX=14, RTL_ALT=3000)
    go(r, 25.0, 0.0, 10.0)
    r.run(8.0)
    r.mode(V, Mode.RTL)
    r.run_until(r.has("event.disarmed"), 90.0)
    assert max(float(at[0, 2]) for _, at in r.track) < 12.5  # FENCE_ALT_MAX less FENCE_MARGIN
    assert "Max Alt fence breached" not in r.words()


def test_one_aircrafts_fence_is_not_anothers() -> None:
    specs = [
        VehicleSpec(V, 1, params={"FENCE_ENABLE": 1, "FENCE_RADIUS": 30, "FS_GCS_ENABLE": 1}),
        VehicleSpec("blue/b2", 2, home_enu_m=(40.0, 0.0, 0.0)),
    ]
    both, alone = Range(specs), Range(specs[:1])
    for r in (both, alone):
        r.take_off(V, 5.0)
        go(r, 60.0, 0.0, 5.0)
        r.run(10.0)
    assert both.frames[V] == alone.frames[V]
    assert "Circle fence breached" in both.words()
    assert both.heard("STATUSTEXT", "blue/b2") == []
