"""The clock of the builtin autopilot under a wrong GNSS time: reports, waits until a time of day, and a reboot."""

from __future__ import annotations

from typing import Any

import pytest

from skyrange.codec.mavlink import dialect as A  # noqa: N812
from skyrange.core.time import GPS_LEAP_S, NS_PER_S
from skyrange.vehicle.contract import VehicleSpec
from tests.integration.flight_harness import EPOCH, Range, start, takeoff
from tests.integration.test_mission_commands_flown import do

V = "blue/b1"


def ranged(error_s: float, from_s: float = 0.0, **params: float) -> Range:
    r = Range([VehicleSpec(V, 1, params=params)])

    def tamper(now: int, sensors: Any) -> None:
        if now >= from_s * NS_PER_S:
            sensors.gnss_utc_error_ns[:] += round(error_s * NS_PER_S)

    r.tamper = tamper
    return r


def clock_error_s(r: Range) -> float:
    """Of the next SYSTEM_TIME."""
    assert r.command(V, A.MAV_CMD_REQUEST_MESSAGE, A.MAVLINK_MSG_ID_SYSTEM_TIME) == 0
    seen = next(said for said in reversed(r.said) if said.message.get_type() == "SYSTEM_TIME")
    return float(seen.message.time_unix_usec - EPOCH.utc_us(round(seen.at_s * NS_PER_S))) / 1e6


@pytest.mark.parametrize(("error_s", "shown_s"), [(20.0, 20.0), (-20.0, 0.0)])
def test_the_clock_follows_a_jump_forward_alone(error_s: float, shown_s: float) -> None:
    r = ranged(error_s, 1.0)
    r.run(2.0)
    assert clock_error_s(r) == pytest.approx(shown_s, abs=0.02)


def test_an_armed_aircraft_keeps_its_clock_and_its_location_has_the_time_of_the_receiver() -> None:
    r = ranged(20.0, 4.0, DID_ENABLE=1)
    r.take_off(V, 5.0)
    assert r.seconds > 5.0
    assert clock_error_s(r) == pytest.approx(0.0, abs=0.02)
    r.run(1.5)
    seen = next(said for said in reversed(r.said) if said.message.get_type() == "OPEN_DRONE_ID_LOCATION")
    true_s = (EPOCH.unix_ns / NS_PER_S + seen.at_s + GPS_LEAP_S) % 3600
    assert seen.message.timestamp - true_s == pytest.approx(20.0, abs=0.3)


@pytest.mark.parametrize(("error_s", "waits_s"), [(0.0, 30.0), (20.0, 10.0)])
def test_a_wait_until_a_time_of_day_ends_by_the_clock(error_s: float, waits_s: float) -> None:
    """And to the millisecond, as AP_RTC::get_time_utc counts."""
    r = ranged(error_s, DISARM_DELAY=0)
    r.run(0.5)
    second = (EPOCH.unix_ns // NS_PER_S + 30) % 86_400
    until = (second // 3600, second // 60 % 60, second % 60)
    assert r.upload(V, [do(A.MAV_CMD_NAV_DELAY, -1.0, *map(float, until)), takeoff(3)]) == A.MAV_MISSION_ACCEPTED
    start(r, V)
    r.run_until(lambda r: "Mission: 2 Takeoff" in r.words(), 40.0)
    assert r.seconds == pytest.approx(waits_s, abs=0.1)


def test_without_a_fix_the_time_is_unknown_and_nothing_waits() -> None:
    r = Range([VehicleSpec(V, 1)])

    def tamper(now: int, sensors: Any) -> None:
        sensors.gnss_fix[:] = 1

    r.tamper = tamper
    r.run(1.0)
    assert r.command(V, A.MAV_CMD_REQUEST_MESSAGE, A.MAVLINK_MSG_ID_SYSTEM_TIME) == 0
    assert r.heard("SYSTEM_TIME")[-1].time_unix_usec == 0


def test_a_reboot_sets_the_clock_anew() -> None:
    r = ranged(20.0)
    r.run(1.0)
    r.tamper = None
    assert clock_error_s(r) == pytest.approx(20.0, abs=0.02)
    assert r.command(V, A.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0) == 0
    r.run(0.1)
    assert clock_error_s(r) == pytest.approx(0.0, abs=0.02)
