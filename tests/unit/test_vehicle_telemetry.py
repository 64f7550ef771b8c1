"""What is reported equals the truth, in MAVLink's frames and units (north-east-down, forward-right-down)."""

from __future__ import annotations

import math

import numpy as np
import pytest

from skyrange.codec.mavlink import dialect
from skyrange.vehicle.contract import VehicleSpec
from tests.integration.flight_harness import EPOCH, ORIGIN, Range

V = "blue/b1"
A = dialect


@pytest.fixture(scope="module")
def r() -> Range:
    """On its way north-east and up, seen mid-way."""
    r = Range([VehicleSpec(V, 3, home_enu_m=(12.0, -8.0, 0.0), heading_deg=30.0)])
    r.take_off(V, 10.0)
    r.send(
        V, A.MAVLink_set_position_target_local_ned_message(0, 3, 1, 1, 0xDC7, 0, 0, 0, 3.0, 4.0, -1.0, 0, 0, 0, 0, 0)
    )
    r.run(1.5)
    for message in (30, 32, 33, 24, 74, 1, 2, 62, 42, 242, 245):
        assert r.command(V, A.MAV_CMD_REQUEST_MESSAGE, message) == 0
    return r


def near(r: Range, kind: str, field: str, value: float, tolerance: float) -> None:
    assert getattr(r.heard(kind)[-1], field) == pytest.approx(value, abs=tolerance), (kind, field)


def test_positions_and_velocities(r: Range) -> None:
    # the reports are up to 0.25 s old at 5 m/s and 2 m/s²
    (east, north, up), (v_east, v_north, v_up) = r.positions()[0], r.velocities()[0]
    for field, value in (("x", north), ("y", east), ("z", -up)):
        near(r, "LOCAL_POSITION_NED", field, value, 1.5)
    for field, value in (("vx", v_north), ("vy", v_east), ("vz", -v_up)):
        near(r, "LOCAL_POSITION_NED", field, value, 1.0)
    lat, lon = ORIGIN.geodetic_of(float(east), float(north))
    near(r, "GLOBAL_POSITION_INT", "lat", lat * 1e7, 150)
    near(r, "GLOBAL_POSITION_INT", "lon", lon * 1e7, 150)
    near(r, "GLOBAL_POSITION_INT", "alt", (584.0 + up) * 1e3, 500)
    near(r, "GLOBAL_POSITION_INT", "relative_alt", up * 1e3, 500)
    near(r, "GLOBAL_POSITION_INT", "vx", v_north * 100, 100)
    near(r, "GLOBAL_POSITION_INT", "vy", v_east * 100, 100)
    near(r, "GLOBAL_POSITION_INT", "vz", -v_up * 100, 60)
    near(r, "GPS_RAW_INT", "alt_ellipsoid", (584.0 + 19.0 + up) * 1e3, 500)
    near(r, "GPS_RAW_INT", "cog", math.degrees(math.atan2(v_east, v_north)) * 100, 1000)
    near(r, "VFR_HUD", "groundspeed", math.hypot(v_east, v_north), 1.0)


def test_leaning_forward_is_a_negative_pitch_and_heading_counts_from_north() -> None:
    r = Range([VehicleSpec(V, 3, heading_deg=30.0)])
    r.take_off(V, 10.0)
    ahead = (3.0 * math.cos(math.radians(30)), 3.0 * math.sin(math.radians(30)))  # north, east: along the nose
    r.send(V, A.MAVLink_set_position_target_local_ned_message(0, 3, 1, 1, 0xDC7, 0, 0, 0, *ahead, 0, 0, 0, 0, 0, 0))
    r.run(0.9)
    assert r.command(V, A.MAV_CMD_REQUEST_MESSAGE, A.MAVLINK_MSG_ID_ATTITUDE) == 0
    attitude = r.heard("ATTITUDE")[-1]
    assert attitude.pitch < -0.05
    assert abs(attitude.roll) < 0.03
    assert attitude.yaw == pytest.approx(math.radians(30.0), abs=0.02)


def test_attitude_is_the_truth_turned_to_ned(r: Range) -> None:
    truth = r.world.truth()
    w, x, y, z = (truth[k][0] for k in ("qw", "qx", "qy", "qz"))
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = -math.asin(2 * (w * y - z * x))
    yaw = math.pi / 2 - math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    near(r, "ATTITUDE", "roll", roll, 0.15)
    near(r, "ATTITUDE", "pitch", pitch, 0.15)
    assert abs((r.heard("ATTITUDE")[-1].yaw - yaw + math.pi) % (2 * math.pi) - math.pi) < 0.15


def test_home_time_and_state(r: Range) -> None:
    home = r.heard("HOME_POSITION")[-1]
    lat, lon = ORIGIN.geodetic_of(12.0, -8.0)
    assert (home.latitude, home.longitude, home.altitude) == (
        pytest.approx(lat * 1e7, abs=1),
        pytest.approx(lon * 1e7, abs=1),
        584_000,
    )
    clock = r.heard("SYSTEM_TIME")[-1]
    assert clock.time_unix_usec - clock.time_boot_ms * 1000 == EPOCH.unix_ns // 1000
    assert r.heard("EXTENDED_SYS_STATE")[-1].landed_state == A.MAV_LANDED_STATE_IN_AIR
    assert r.heard("SYS_STATUS")[-1].onboard_control_sensors_health & A.MAV_SYS_STATUS_SENSOR_GPS


def test_base_mode_as_arducopter_makes_it() -> None:
    r = Range([VehicleSpec(V, 3)])
    r.run(1.1)
    assert r.heard("HEARTBEAT")[-1].base_mode == 0x51  # what ArduCopter says in STABILIZE, disarmed
    r.take_off(V, 3.0)
    assert r.heard("HEARTBEAT")[-1].base_mode == 0xD9  # armed, with a position


def test_arming_tells_where_home_is() -> None:
    r = Range([VehicleSpec(V, 3, home_enu_m=(12.0, -8.0, 0.0))])
    assert r.mode(V, 4) == 0
    assert r.arm(V) == 0
    home = r.heard("HOME_POSITION")[-1]
    assert (home.latitude, home.longitude) == tuple(round(v * 1e7) for v in ORIGIN.geodetic_of(12.0, -8.0))
    assert all(math.isnan(part) for part in home.q)
    assert home.time_usec < 1_000_000  # since boot, as ArduPilot's, not UTC


def test_reports_start_at_moments_of_their_own() -> None:
    fleet = Range([VehicleSpec(f"blue/b{i}", i + 1) for i in range(8)])
    fleet.run(1.0)
    first: dict[str, float] = {}
    for said in fleet.said:
        first.setdefault(said.vehicle, said.at_s)
    assert len(first) == 8
    assert len(np.unique(list(first.values()))) > 4
