"""A crash and a lost motor: ArduCopter/crash_check.cpp."""

from __future__ import annotations

import numpy as np
import pytest

from skyrange.contracts.mailboxes import Outbox
from skyrange.vehicle.builtin.failsafes import checks
from skyrange.vehicle.builtin.failsafes.crash import check_crash
from skyrange.vehicle.builtin.layout import FlightEvent
from tests.integration.flight_harness import Range
from tests.integration.hovering import hovering, texts

EMERGENCY = 0


def upset(r: Range, roll_rad: float) -> None:
    """The loop has counted its two seconds."""
    fleet = r.engines[0]._fleet
    fleet.outbox = Outbox()
    fleet.estimate["roll"] = roll_rad
    fleet.flight["tilt_error"] = roll_rad
    fleet.flight["land_accel"] = (1.0, 0.0, 0.0)
    fleet.flight["flags"] |= FlightEvent.CRASH
    check_crash(fleet, fleet.vehicles[0])


def test_a_crash_disarms_with_its_numbers() -> None:
    r = hovering()
    upset(r, np.radians(45.0))
    fleet = r.engines[0]._fleet
    assert fleet.flight["armed"][0] == 0
    assert [n.data["reason"] for n in fleet.outbox.notes if n.kind == "event.disarmed"] == ["crash"]
    sent = b"".join(payload for _, payload, _ in fleet.outbox.departures)
    assert b"Crash: Disarming: AngErr=45>30, Accel=1.0<3.0" in sent


@pytest.mark.parametrize(("enabled", "roll_deg"), [(0, 45.0), (1, 14.0)])
def test_switched_off_or_hardly_leaning_it_goes_on_and_is_looked_at_again(enabled: int, roll_deg: float) -> None:
    r = hovering(FS_CRASH_CHECK=enabled)
    upset(r, np.radians(roll_deg))
    flight = r.engines[0]._fleet.flight
    assert flight["armed"][0] == 1
    assert not flight["flags"][0] & FlightEvent.CRASH
    assert flight["crash_s"][0] == 0.0


def falling(r: Range, seconds: float, **flight: float) -> None:
    """Full thrust, level, and descending, for the check alone."""
    fleet = r.engines[0]._fleet
    fleet.outbox = Outbox()
    start = fleet.now
    fleet.estimate["vel"] = (0.0, 0.0, -2.0)
    fleet.flight["throttle"] = 1.0
    for name, value in flight.items():
        fleet.flight[name] = value
    for step in range(round(seconds * 10)):
        fleet.now = (start // 100_000_000 + step + 1) * 100_000_000
        checks.run_checks(fleet, np.array([[0.5, 0.7, 1.0, 0.6]]))


def lost(r: Range) -> int:
    sent = b"".join(payload for _, payload, _ in r.engines[0]._fleet.outbox.departures)
    return sent.count(b"Potential Thrust Loss (3)")


def test_a_motor_that_gives_no_thrust_is_told_after_a_second() -> None:
    r = hovering()
    falling(r, 1.0)
    assert lost(r) == 0
    falling(r, 0.5)
    assert lost(r) == 1


@pytest.mark.parametrize("flight", [{"throttle": 0.8}, {"tilt_target": 0.3}, {"tilt_error": 0.6}, {"landed": 1}])
def test_what_is_no_lost_motor(flight: dict[str, float]) -> None:
    r = hovering()
    falling(r, 3.0, **flight)
    assert lost(r) == 0


def test_it_can_be_switched_off() -> None:
    r = hovering(FLIGHT_OPTIONS=1)
    falling(r, 3.0)
    assert lost(r) == 0


def test_a_healthy_flight_says_nothing() -> None:
    r = hovering()
    assert texts(r, 1.0) == []
