"""A low battery: AP_BattMonitor `update_failsafes`, `check_failsafes`, ArduCopter `handle_battery_failsafe`."""

from __future__ import annotations

import pytest

from skyrange.vehicle.builtin.modes import Mode
from tests.integration.hovering import V, beat, believe, hovering, modes, put, standing, texts, when

pytestmark = pytest.mark.rotating

WARNING = 4


def test_a_low_voltage_counts_after_ten_seconds_and_only_warns_by_default() -> None:
    r = hovering()
    start = r.seconds
    believe(r, battery_v=10.4, battery_a=0.0)
    r.run(9.9)
    assert texts(r, start) == []
    r.run(0.4)
    used = float(r.engines[0]._fleet.battery["consumed_mah"][0])
    assert texts(r, start) == [(WARNING, f"Battery 1 is low 10.40V used {used:.0f} mAh"), (WARNING, "Battery Failsafe")]
    assert when(r, "Battery 1 is low") - start == pytest.approx(10.1, abs=0.12)
    assert modes(r, start) == []
    r.run(15.0)
    assert len(texts(r, start)) == 2  # once


def test_a_dip_does_not_count() -> None:
    r = hovering(BATT_FS_LOW_ACT=2)
    start = r.seconds
    for _ in range(4):
        believe(r, battery_v=10.4)
        r.run(8.0)
        believe(r, battery_v=11.0)
        r.run(0.2)
    assert texts(r, start) == []


@pytest.mark.parametrize("off", [{"BATT_LOW_TIMER": 0}, {"BATT_LOW_VOLT": 0}, {"BATT_MONITOR": 0}])
def test_what_disables_it(off: dict[str, float]) -> None:
    r = hovering(BATT_FS_LOW_ACT=2, **off)
    start = r.seconds
    believe(r, battery_v=9.0)
    r.run(15.0)
    assert texts(r, start) == []
    assert modes(r, start) == []


def test_low_returns_then_critical_lands() -> None:
    r = hovering(BATT_FS_LOW_ACT=2, BATT_FS_CRT_ACT=1, BATT_CRT_VOLT=10.0)
    start = r.seconds
    believe(r, battery_v=10.4)
    r.run(10.3)
    assert modes(r, start) == [("RTL", "battery_failsafe")]
    believe(r, battery_v=9.9)
    r.run(10.3)
    assert modes(r, start) == [("RTL", "battery_failsafe"), ("LAND", "battery_failsafe")]
    assert any(words.startswith("Battery 1 is critical 9.90V used") for _, words in texts(r, start))
    levels = [n.data["level"] for n in r.events("event.battery")]
    assert levels == ["low", "critical"]


def test_a_lower_priority_does_not_undo_a_higher() -> None:
    r = hovering(BATT_FS_LOW_ACT=1, BATT_FS_CRT_ACT=2, BATT_CRT_VOLT=10.0)
    start = r.seconds
    believe(r, battery_v=10.4)
    r.run(10.3)
    believe(r, battery_v=9.9)
    r.run(10.3)
    assert modes(r, start) == [("LAND", "battery_failsafe")]
    assert [words for _, words in texts(r, start)].count("Battery Failsafe") == 1


def test_a_landing_for_the_battery_is_not_undone_by_a_lost_station() -> None:
    r = hovering(BATT_FS_CRT_ACT=1, BATT_CRT_VOLT=10.0, BATT_LOW_TIMER=1, FS_GCS_ENABLE=1, LAND_SPEED=30)
    start = r.seconds
    beat(r)
    believe(r, battery_v=9.9)
    r.run(7.0)
    assert modes(r, start) == [("LAND", "battery_failsafe")]
    assert (WARNING, "GCS + Battery Failsafe - Continuing Landing") in texts(r, start)


def test_charge_drawn_is_counted_and_acts_at_once() -> None:
    r = hovering(BATT_CAPACITY=1000, BATT_LOW_MAH=0, BATT_FS_LOW_ACT=2)
    power = r.engines[0]._fleet.battery
    believe(r, battery_v=12.0, battery_a=0.0)
    r.run(0.2)
    before, spent = float(power["consumed_mah"][0]), float(power["consumed_wh"][0])
    start = r.seconds
    believe(r, battery_v=12.0, battery_a=36.0)  # 10 mAh a second
    r.run(3.0)
    assert power["consumed_mah"][0] - before == pytest.approx(30.0, abs=1.1)  # a sample is 0.1 s
    assert power["consumed_wh"][0] - spent == pytest.approx(0.36, abs=0.02)
    assert power["remaining_pct"][0] == int(100.0 - 0.1 * power["consumed_mah"][0])
    assert modes(r, start) == []
    put(r, "BATT_LOW_MAH", 1000.0 - power["consumed_mah"][0] - 20.0)
    r.run(2.4)
    assert modes(r, start) == [("RTL", "battery_failsafe")]
    assert when(r, "Battery 1 is low") - start == pytest.approx(5.1, abs=0.2)


def test_the_resting_voltage_takes_the_sag_out() -> None:
    r = hovering(BATT_FS_LOW_ACT=2, BATT_FS_VOLTSRC=1, BATT_LOW_TIMER=1)
    start = r.seconds
    for step in range(200):  # 11.4 V at rest behind 0.05 ohm
        amps = 20.0 if step % 2 else 30.0
        believe(r, battery_a=amps, battery_v=11.4 - 0.05 * amps)
        r.run(0.1)
    power = r.engines[0]._fleet.battery
    assert power["voltage"][0] < 10.5
    assert power["resting_v"][0] == pytest.approx(11.4, abs=0.1)
    assert texts(r, start) == []
    put(r, "BATT_FS_VOLTSRC", 0)
    r.run(1.5)
    assert modes(r, start) == [("RTL", "battery_failsafe")]


def test_terminate_stops_the_motors_in_the_air() -> None:
    r = hovering(BATT_FS_LOW_ACT=5, BATT_LOW_TIMER=1)
    believe(r, battery_v=9.0)
    r.run(1.5)
    assert [n.data["reason"] for n in r.events("event.disarmed")] == ["failsafe_action_terminate"]


def test_on_the_ground_it_disarms_and_then_forbids_arming() -> None:
    r = standing(DISARM_DELAY=0)
    r.mode(V, Mode.GUIDED)
    r.arm(V)
    start = r.seconds
    believe(r, battery_v=10.0)
    r.run(10.5)
    assert (WARNING, "Battery Failsafe - Disarming") in texts(r, start)
    assert [n.data["reason"] for n in r.events("event.disarmed")] == ["battery_failsafe"]
    start = r.seconds
    assert r.arm(V) == 4
    assert [w for _, w in texts(r, start)] == ["Arm: Battery 1 low voltage failsafe", "Arm: Battery failsafe"]


def test_disarmed_nothing_is_said_in_flight_words() -> None:
    r = standing()
    believe(r, battery_v=9.0)
    r.run(15.0)
    assert texts(r) == []
