"""Details of a real ArduCopter's behaviour, found by flying one beside the builtin: tests/parity compares the two."""

from __future__ import annotations

import math

import numpy as np
import pytest

from skyrange.codec.mavlink import dialect
from skyrange.vehicle.builtin.modes import Mode
from skyrange.vehicle.builtin.parameters.table import hover_throttle
from skyrange.vehicle.contract import VehicleSpec
from skyrange.world.airframes import AIRFRAMES
from tests.integration.flight_harness import Range, land, speed, start, takeoff, waypoint
from tests.integration.hovering import V, hovering, put

pytestmark = pytest.mark.rotating


def away(r: Range, north_m: float) -> None:
    """To a place in GUIDED."""
    lat, lon = r.origin.geodetic_of(0.0, north_m)
    frame = dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT
    target = dialect.MAVLink_set_position_target_global_int_message(
        0, 1, 1, frame, 0xDF8, round(lat * 1e7), round(lon * 1e7), 10.0, 0, 0, 0, 0, 0, 0, 0, 0
    )
    r.send(V, target)
    r.run_until(lambda x: abs(x.positions()[0, 1] - north_m) < 0.3, 60.0)
    r.run(3.0)


def test_a_do_item_takes_the_place_of_the_item_reached() -> None:
    """One number is kept until it is sent (GCS::send_mission_item_reached_message); the second DO item comes later."""
    r = Range([VehicleSpec(V, 1)])
    r.upload(V, [takeoff(5), speed(3), waypoint(0, 8, 5), speed(4), speed(5), waypoint(0, 16, 5), land(0, 16)])
    start(r, V)
    r.run_until(r.has("event.item_reached", 3), 60.0)
    assert [note.data["seq"] for note in r.events("event.item_reached")] == [1, 3, 6]
    assert [m.seq for m in r.heard("MISSION_ITEM_REACHED")] == [2, 4, 5, 6]


def test_a_return_begins_before_its_climb_has_ended() -> None:
    """mode_rtl.cpp `climb_start` gives the climb's leg the return as its next."""
    r = hovering()
    away(r, 40.0)
    r.mode(V, Mode.RTL)
    both = []
    r.run(12.0, lambda x: both.append(min(abs(x.velocities()[0, 1]), x.velocities()[0, 2])))
    assert max(both) > 0.4  # m/s, home and up at once; 0.05 where it stops in between


@pytest.mark.parametrize(("behaviour", "turned"), [(1, True), (2, False)])
def test_above_home_the_nose_turns_as_it_was_armed(behaviour: int, turned: bool) -> None:
    """`loiterathome_start`, and no landing before it is within 2° (`loiterathome_run`); the default leaves the nose."""
    r = hovering(WP_YAW_BEHAVIOR=behaviour, RTL_LOIT_TIME=0)
    yaw = float(r.engines[0]._fleet.estimate["yaw"][0])
    away(r, 30.0)
    off = r.command(V, dialect.MAV_CMD_CONDITION_YAW, 180.0, 0.0, 0.0, 0.0)
    assert off == 0
    r.run(5.0)
    r.mode(V, Mode.RTL)
    seen = []
    r.run(8.0, lambda x: seen.append(float(x.engines[0]._fleet.estimate["yaw"][0])))
    assert np.ptp(np.unwrap(seen[:40])) < math.radians(2.0)  # the climb leaves the nose where it is
    r.run_until(lambda x: x.positions()[0, 2] < 8.0, 60.0)
    difference = abs(math.remainder(float(r.engines[0]._fleet.estimate["yaw"][0]) - yaw, 2.0 * math.pi))
    assert (difference < math.radians(3.0)) is turned


def test_a_change_of_mode_is_told_at_once() -> None:
    """Copter::set_mode sends a heartbeat."""
    r = hovering()
    before = len(r.heard("HEARTBEAT"))
    r.mode(V, Mode.LOITER)
    assert [m.custom_mode for m in r.heard("HEARTBEAT")[before:]] == [Mode.LOITER]


@pytest.mark.parametrize("name", sorted(AIRFRAMES))
def test_the_hover_throttle_hovers(name: str) -> None:
    """Its command, by `thrust_to_actuator` with the default MOT_SPIN_MIN and MOT_SPIN_MAX, carries the weight."""
    airframe = AIRFRAMES[name]
    asked, expo = hover_throttle(airframe), airframe.thrust_expo
    part = (math.sqrt((1 - expo) ** 2 + 4 * expo * asked) - (1 - expo)) / (2 * expo)
    command = 0.15 + (0.95 - 0.15) * part
    assert (1 - expo) * command + expo * command**2 == pytest.approx(airframe.hover_thrust, rel=1e-9)


def test_motors_spool_up_from_ground_idle() -> None:
    """Idling at MOT_SPIN_ARM they are two thirds there (AP_MotorsMulticopter::output_logic): 0.17 s, not 0.5 s."""
    r = Range([VehicleSpec(V, 1)])
    put(r, "TKOFF_SLEW_TIME", 5.0)
    r.mode(V, Mode.GUIDED)
    r.arm(V)
    r.run(3.0)  # the motors start 2 s after arming
    commands = r.engines[0]._actuators
    assert commands == pytest.approx(0.1)
    assert r.command(V, dialect.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 5.0) == 0
    r.run(0.1)
    assert 0.12 < commands.max() < 0.15
    r.run(0.1)
    assert commands.max() > 0.15
