"""Pre-arm checks: AP_Arming.cpp, ArduCopter/AP_Arming_Copter.cpp, AC_Fence.cpp `pre_arm_check`."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from skyrange.codec.mavlink import dialect
from skyrange.vehicle.builtin.arming import prearm
from skyrange.vehicle.builtin.arming.arming import arm
from skyrange.vehicle.builtin.fleet import Fleet
from skyrange.vehicle.builtin.modes import Mode
from skyrange.vehicle.contract import VehicleSpec
from tests.integration.flight_harness import Range, land, square, takeoff, waypoint
from tests.integration.hovering import V, believe, put, standing, texts

pytestmark = pytest.mark.rotating

A = dialect
CRITICAL = 2
OK, FAILED = 0, 4
GOOD = 1 | 2 | 4 | 8 | 16 | 32 | 256 | 512


def guided(**params: float) -> Range:
    """On the ground in GUIDED."""
    r = standing(**params)
    r.mode(V, Mode.GUIDED)
    r.run(0.2)
    return r


def refused(r: Range, forced: bool = False) -> list[str]:
    """What arming is refused with; nothing where it works."""
    start = r.seconds
    result = r.command(V, A.MAV_CMD_COMPONENT_ARM_DISARM, 1.0, 2989.0 if forced else 0.0)
    said = [words for severity, words in texts(r, start) if severity == CRITICAL]
    assert (result == OK) == (said == [])
    return said


@pytest.mark.parametrize(
    ("belief", "said"),
    [
        ({"gnss_fix": 1}, ["GPS 1: Bad fix"]),
        ({"gnss_age_s": 5.0}, ["GPS 1: Bad fix"]),
        ({"gnss_hdop": 1.5}, ["High GPS HDOP"]),
        ({"gnss_pos": (11.0, 0.0, 0.0), "pos": (0.0, 0.0, 0.0)}, ["GPS and AHRS differ by 11.0m"]),
        ({"status": GOOD & ~(16 | 512)}, ["Need Position Estimate"]),
        ({"status": 1024}, ["Need Alt Estimate", "EKF attitude is bad", "AHRS: EKF3 still initialising"]),
        ({"status": GOOD & ~32}, ["Need Alt Estimate"]),
        ({"status": GOOD & ~1}, ["EKF attitude is bad"]),
        ({"status": GOOD | 1 << 15}, ["GPS glitching"]),
        ({"mag_ratio": 0.81}, ["EKF compass variance"]),
        ({"pos_ratio": 1.0, "vel_ratio": 1.0}, ["EKF position variance"]),
        ({"vel_ratio": 0.9}, ["EKF velocity variance"]),
        ({"hgt_ratio": 0.9}, ["EKF height variance"]),
        ({"compass": (0.9, 0.0, 0.0)}, ["Check mag field:  900, max 875, min 185"]),
        ({"compass": (0.1, 0.0, 0.1)}, ["Check mag field:  141, max 875, min 185"]),
        ({"baro_up": 1.5, "status": GOOD & ~256}, ["Altitude disparity"]),
        ({}, []),
    ],
)
def test_belief(belief: dict[str, Any], said: list[str]) -> None:
    r = guided()
    believe(r, **belief)
    r.run(0.2)
    assert refused(r) == [f"Arm: {words}" for words in said]


def test_leaning() -> None:
    r = guided()
    fleet: Fleet = r.engines[0]._fleet
    believe(r, roll=0.6)  # until the next tick
    assert not arm(fleet, fleet.vehicles[0], (), checked=True)
    sent = b"".join(payload for _, payload, _ in fleet.outbox.departures)
    assert b"Arm: Leaning" in sent


@pytest.mark.parametrize(
    ("params", "said"),
    [
        ({"BATT_LOW_VOLT": 13}, "Battery 1 low voltage failsafe"),
        ({"BATT_CRT_VOLT": 13, "BATT_LOW_VOLT": 0}, "Battery 1 critical voltage failsafe"),
        ({"BATT_ARM_VOLT": 13}, "Battery 1 below minimum arming voltage"),
        ({"BATT_ARM_MAH": 4000}, "Battery 1 below minimum arming capacity"),
        ({"BATT_LOW_MAH": 4000}, "Battery 1 low capacity failsafe"),
        ({"BATT_CRT_MAH": 4000}, "Battery 1 critical capacity failsafe"),
        ({"BATT_CRT_VOLT": 10.5}, "Battery 1 voltage failsafe critical >= low"),
        ({"BATT_CRT_MAH": 500, "BATT_LOW_MAH": 400}, "Battery 1 capacity failsafe critical >= low"),
        ({"FENCE_ENABLE": 1, "FENCE_TYPE": 4}, "Fences enabled, but none selected"),
        ({"FENCE_ENABLE": 1, "FENCE_ALT_MAX": 12, "FENCE_ALT_MIN": 9, "FENCE_MARGIN": 2}, "FENCE_MARGIN too big"),
        ({"FENCE_ENABLE": 1, "FENCE_ALT_MAX": 12, "FENCE_ALT_MIN": 20}, "FENCE_ALT_MAX < FENCE_ALT_MIN"),
        ({"ARMING_MIS_ITEMS": 1}, "Missing mission item: land"),
        ({"ARMING_MIS_ITEMS": 32}, "No sufficiently close rally point located"),
    ],
)
def test_parameters(params: dict[str, float], said: str) -> None:
    r = guided(**params)
    assert refused(r)[0] == f"Arm: {said}"


def test_a_battery_that_is_not_there_is_unhealthy_unless_none_is_watched() -> None:
    r = guided()
    believe(r, battery_v=0.0)
    r.run(0.2)
    assert refused(r) == ["Arm: Battery 1 unhealthy"]
    put(r, "BATT_MONITOR", 0)
    assert refused(r) == []


def test_required_mission_items() -> None:
    r = guided(ARMING_MIS_ITEMS=1 | 8)
    r.upload(V, [takeoff(5), waypoint(5, 5, 5)])
    assert refused(r) == ["Arm: Missing mission item: land"]
    r.upload(V, [takeoff(5), land(5, 5)])
    assert refused(r) == []


def test_stabilize_needs_no_position_but_a_fence_does() -> None:
    r = standing()
    believe(r, status=1, gnss_fix=0)
    assert refused(r) == []
    r.command(V, dialect.MAV_CMD_COMPONENT_ARM_DISARM, 0)
    put(r, "FENCE_ENABLE", 1)
    r.run(0.2)
    assert "Arm: Fence requires position" in refused(r)
    assert "Arm: GPS 1: Bad fix" in refused(r)


@pytest.mark.parametrize(
    ("check", "said"),
    [
        (1, ["Arm: GPS 1: Bad fix", "Arm: Battery 1 low voltage failsafe"]),
        (1 << 3, ["Arm: GPS 1: Bad fix"]),
        (1 << 8, ["Arm: Battery 1 low voltage failsafe"]),
        (1 << 4, []),
    ],
)
def test_arming_check_chooses(check: int, said: list[str]) -> None:
    r = guided(ARMING_CHECK=check)
    believe(r, gnss_fix=0, battery_v=9.0)
    r.run(0.2)
    assert refused(r) == said


def test_without_checks_the_mandatory_ones_remain_and_it_warns() -> None:
    r = guided(ARMING_CHECK=0)
    believe(r, gnss_fix=0, battery_v=9.0, status=1)
    assert refused(r) == ["Arm: Need Position Estimate", "Arm: Need Alt Estimate"]
    believe(r, status=GOOD)
    assert refused(r) == []
    assert (4, "Warning: Arming Checks Disabled") in texts(r)


def test_forced_arming_needs_a_position_too() -> None:
    r = guided()
    believe(r, battery_v=9.0, status=1)
    assert refused(r, forced=True) == ["Arm: Need Position Estimate", "Arm: Need Alt Estimate"]
    believe(r, status=GOOD)
    assert refused(r, forced=True) == []


def test_auto_needs_a_mission() -> None:
    r = standing(AUTO_OPTIONS=1)
    r.mode(V, Mode.AUTO)
    assert refused(r) == ["Arm: Mode requires mission"]
    r.upload(V, square(5, 5))
    assert refused(r) == []


def ok(r: Range) -> bool:
    return bool(r.engines[0]._fleet.checks["prearm_ok"][0])


def test_what_fails_from_boot_is_told_every_30_s() -> None:
    r = standing(BATT_LOW_VOLT=13)
    r.run(95.0)
    at = [s.at_s for s in r.said if s.message.get_type() == "STATUSTEXT"]
    assert at == [31.0, 62.0, 93.0]  # more than 30 s, looked at every second
    assert set(r.words()) == {"PreArm: Battery 1 low voltage failsafe"}
    assert not ok(r)


def test_what_begins_to_fail_is_told_soon() -> None:
    r = standing()
    r.run(40.0)
    assert ok(r)
    assert r.words() == []
    start = r.seconds
    believe(r, battery_v=9.0)
    r.run(3.0)
    assert r.words() == ["PreArm: Battery 1 low voltage failsafe"]
    assert not ok(r)
    believe(r, battery_v=12.6)
    r.run(2.0)
    assert ok(r)
    believe(r, battery_v=9.0)
    r.run(10.0)
    assert len(texts(r, start)) == 2  # not within 4 s of the first


def test_options_keep_it_quiet_and_in_flight_nothing_is_checked() -> None:
    r = standing(BATT_LOW_VOLT=13, ARMING_OPTIONS=1)
    r.run(35.0)
    assert r.words() == []
    assert not ok(r)
    r.mode(V, Mode.GUIDED)
    put(r, "BATT_LOW_VOLT", 0)
    put(r, "DISARM_DELAY", 0)
    put(r, "ARMING_OPTIONS", 0)
    assert refused(r) == []
    believe(r, gnss_fix=0)
    said = len(r.words())
    r.run(65.0)
    assert len(r.words()) == said
    assert ok(r)


def test_the_table_takes_another_check(monkeypatch: pytest.MonkeyPatch) -> None:
    def identified(fleet: Fleet, seen: prearm.CheckInputs) -> list[prearm.Failure]:
        return [(np.ones(seen.rows.size, dtype=bool), "OpenDroneID: not identified")]

    monkeypatch.setattr(prearm, "CHECKS", [*prearm.CHECKS, identified])
    assert refused(guided()) == ["Arm: OpenDroneID: not identified"]


def test_each_aircraft_is_checked_by_its_own_row() -> None:
    specs = [VehicleSpec(f"blue/b{i}", i, params={"BATT_LOW_VOLT": 13.0 if i == 2 else 10.5}) for i in (1, 2, 3)]
    r = Range(specs)
    r.run(31.5)
    assert r.engines[0]._fleet.checks["prearm_ok"].tolist() == [1, 0, 1]
    assert {s.vehicle for s in r.said if s.message.get_type() == "STATUSTEXT"} == {"blue/b2"}
