"""The builtin's OPEN_DRONE_ID_LOCATION: AP_OpenDroneID.cpp `send_location_message`, its rounding included."""

from __future__ import annotations

import math
from typing import Any

import pytest

from skyrange.codec.f3411 import values
from skyrange.codec.mavlink import dialect
from skyrange.core.time import GPS_LEAP_S, NS_PER_S
from skyrange.vehicle.builtin.telemetry.table import build_message as told
from skyrange.vehicle.contract import VehicleSpec
from tests.integration.flight_harness import EPOCH, ORIGIN, Range
from tests.integration.hovering import V

NUMBER = dialect.MAVLINK_MSG_ID_OPEN_DRONE_ID_LOCATION


def ranged(**params: float) -> Range:
    return Range([VehicleSpec(V, 3, home_enu_m=(12.0, -8.0, 0.0), params=params)])


def last(r: Range) -> Any:
    return r.heard("OPEN_DRONE_ID_LOCATION")[-1]


@pytest.fixture(scope="module")
def flying() -> Range:
    """North-east at 5 m/s and up at 1.8 m/s, for long enough."""
    r = ranged(DID_ENABLE=1)
    r.take_off(V, 10.0)
    for _ in range(8):
        r.send(
            V,
            dialect.MAVLink_set_position_target_local_ned_message(
                0, 3, 1, 1, 0xDC7, 0, 0, 0, 3.0, 4.0, -1.8, 0, 0, 0, 0, 0
            ),
        )
        r.run(1.0)
    return r


def test_each_second_where_it_was_switched_on_at_boot(flying: Range) -> None:
    count = len(flying.heard("OPEN_DRONE_ID_LOCATION"))
    assert count == pytest.approx(flying.now / NS_PER_S, abs=2)
    off = ranged()
    off.send(V, dialect.MAVLink_param_set_message(3, 1, b"DID_ENABLE", 1.0, dialect.MAV_PARAM_TYPE_REAL32))
    off.run(3.0)
    assert off.heard("OPEN_DRONE_ID_LOCATION") == []
    assert off.command(V, dialect.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0) == 0
    off.run(3.0)
    assert len(off.heard("OPEN_DRONE_ID_LOCATION")) in (2, 3)


def test_nobody_can_ask_for_it(flying: Range) -> None:
    """`mavlink_id_to_ap_message_id` does not know it."""
    assert flying.command(V, dialect.MAV_CMD_REQUEST_MESSAGE, NUMBER) == dialect.MAV_RESULT_FAILED
    assert flying.command(V, dialect.MAV_CMD_SET_MESSAGE_INTERVAL, NUMBER, 1e5) == dialect.MAV_RESULT_DENIED


def test_what_it_says_in_flight(flying: Range) -> None:
    said = last(flying)
    east, north, up = (float(value) for value in flying.positions()[0])
    lat, lon = ORIGIN.geodetic_of(east, north)
    # up to a second old at 5 m/s, and the estimator's error
    assert said.latitude * 1e-7 == pytest.approx(lat, abs=8 / 111_000)
    assert said.longitude * 1e-7 == pytest.approx(lon, abs=8 / 84_000)
    assert said.status == dialect.MAV_ODID_STATUS_AIRBORNE
    assert said.speed_horizontal in (400, 500)  # 5 m/s, or just below, cut to whole ones
    assert said.speed_vertical == 100  # 1.8 m/s
    assert said.direction == pytest.approx(math.degrees(math.atan2(4.0, 3.0)) * 100, abs=1000)
    assert said.altitude_geodetic == pytest.approx(ORIGIN.ellipsoid_of(ORIGIN.alt_msl_m) + up, abs=4.0)
    assert said.altitude_barometric == pytest.approx(ORIGIN.alt_msl_m + up, abs=4.0)
    assert said.height == pytest.approx(up, abs=4.0)
    assert said.height_reference == dialect.MAV_ODID_HEIGHT_REF_OVER_TAKEOFF
    utc_s = EPOCH.utc_us(flying.now) / 1e6
    assert (said.timestamp - GPS_LEAP_S - utc_s + 1800.0) % 3600.0 - 1800.0 == pytest.approx(-0.7, abs=0.7)
    assert said.timestamp_accuracy == 10
    # as the receiver claims; the barometer's is not known
    tables = (values.HORIZONTAL_ACCURACY_M, values.VERTICAL_ACCURACY_M, values.SPEED_ACCURACY_MPS)
    claims = flying.engines[0]._fleet.estimate["gnss_acc"][0].tolist()
    accuracies = (said.horizontal_accuracy, said.vertical_accuracy, said.speed_accuracy, said.barometer_accuracy)
    assert accuracies == (*(values.accuracy_code(*pair) for pair in zip(tables, claims, strict=True)), 0)
    assert 0 not in accuracies[:3]


def test_on_the_ground_there_is_no_height() -> None:
    r = ranged(DID_ENABLE=1)
    r.run(8.0)
    assert last(r).status == dialect.MAV_ODID_STATUS_GROUND
    assert last(r).height == 0.0
    assert (last(r).speed_horizontal, last(r).speed_vertical) == (0, 0)


def test_emergencies_are_a_crash_and_no_fix_while_armed() -> None:
    r = ranged(DID_ENABLE=1)
    r.take_off(V, 10.0)
    fleet = r.engines[0]._fleet
    vehicle = fleet.vehicles[0]

    def now() -> Any:
        return told(fleet, vehicle, NUMBER)

    assert now().status == dialect.MAV_ODID_STATUS_AIRBORNE
    fleet.estimate["gnss_fix"][0] = 1
    assert now().status == dialect.MAV_ODID_STATUS_EMERGENCY
    assert (now().timestamp, now().direction) == (65_535.0, 36_100)
    fleet.settings["DID_OPTIONS"][0] = 2  # AllowNonGPSPosition
    assert now().status == dialect.MAV_ODID_STATUS_AIRBORNE
    fleet.checks["crashed"][0] = 1
    assert now().status == dialect.MAV_ODID_STATUS_EMERGENCY
