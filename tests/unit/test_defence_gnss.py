"""Gates, dead reckoning, and what the checks of GNSS make of hostile readings."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import TypeVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrange.attack.contract import Aircraft, AttackContext
from skyrange.contracts.alerts import find_problem
from skyrange.contracts.components import Sensors
from skyrange.contracts.links import Schedule
from skyrange.core.chance import Chance
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_MS, NS_PER_S, Epoch
from skyrange.defence.bases.fix_checks import FixCheck, FixGuard
from skyrange.defence.gnss.barometer import BarometerCheck, BarometerReadings, HeightErrors, Heights
from skyrange.defence.gnss.dead_reckoning import DeadReckoning
from skyrange.defence.gnss.gates import chi_square_gate, cusum_gate, normal_gate
from skyrange.defence.gnss.innovation import A, B, ErrorFilter, InnovationCheck
from skyrange.defence.gnss.receiver import Receiver, ReceiverCheck

CheckT = TypeVar("CheckT", bound=FixCheck)
FIELD = (-0.05, 0.2, -0.45)


def test_gates_are_those_of_the_tables() -> None:
    """Percentiles of the normal and the chi-square distribution (Abramowitz and Stegun, tables 26.5 and 26.8)."""
    assert normal_gate(0.05) == pytest.approx(1.95996, abs=1e-5)
    assert chi_square_gate(2, 0.05) == pytest.approx(5.99146, abs=1e-5)
    assert chi_square_gate(6, 0.001) == pytest.approx(22.458, abs=1e-3)
    assert chi_square_gate(100, 0.005) == pytest.approx(140.169, abs=1e-3)


def test_the_gate_of_the_cusum_has_the_run_length_of_siegmund() -> None:
    """Montgomery, Introduction to Statistical Quality Control, 6th ed., 9.1.2: k = 1/2 and h = 5 have 938 samples."""
    assert cusum_gate(0.5, 938.2) == pytest.approx(5.0, abs=1e-3)


def readings(count: int = 1) -> Sensors:
    """Readings of aircraft that stand still, level and facing east."""
    one = np.ones(count)
    return Sensors(
        gyro_radps=np.zeros((count, 3)),
        accel_mps2=np.tile([0.0, 0.0, 9.80665], (count, 1)),
        attitude=np.full((count, 4), np.nan),
        gnss_enu_m=np.zeros((count, 3)),
        gnss_vel_enu_mps=np.zeros((count, 3)),
        baro_up_m=np.zeros(count),
        rangefinder_m=np.zeros(count),
        compass_gauss=np.tile(FIELD, (count, 1)),
        gnss_accuracy=np.tile([1.5, 2.5, 0.2], (count, 1)),
        gnss_fix=np.full(count, 3),
        gnss_satellites=np.full(count, 10),
        gnss_time_ns=np.zeros(count, dtype=np.int64),
        gnss_utc_error_ns=np.zeros(count, dtype=np.int64),
        battery_v=12.0 * one,
        battery_a=one,
        rotor_radps=np.zeros((count, 4)),
        delta_angle_rad=np.zeros((count, 3)),
        delta_velocity_mps=np.tile([0.0, 0.0, 0.0980665], (count, 1)),
    )


def made(kind: type[CheckT], action: str = "reject") -> CheckT:
    """The check of one aircraft."""
    aircraft, origin = Aircraft((0.0, 0.0, 0.0), "A"), Origin(40.0, -74.0)
    context = AttackContext("d", {"a/1": aircraft}, (), origin, Epoch(0), Chance(1), NS_PER_S, Schedule())
    check = kind(action=action)
    check.assemble(context)
    return check


def innovation_check(action: str = "reject") -> InnovationCheck:
    check = made(InnovationCheck, action)
    check.tracker = DeadReckoning(1, FIELD)
    return check


def test_dead_reckoning_integrates_a_turn_and_a_push() -> None:
    """East for 2 s at 1 m/s² while it yaws by 90 degrees: its specific force turns in the body, not over ground."""
    reckoning, sensors = DeadReckoning(1, FIELD), readings()
    step = 10 * NS_PER_MS
    now = 0
    while now < 2 * NS_PER_S:
        reckoning.update(now, sensors)
        now += step
    start, rate = now, np.pi / 4.0
    sensors.rotor_radps[:] = 100.0
    while now <= start + 2 * NS_PER_S:
        yaw = rate * ((now - start) / NS_PER_S - 0.005)
        sensors.gyro_radps[0] = (0.0, 0.0, rate)
        sensors.accel_mps2[0] = (np.cos(yaw), -np.sin(yaw), 9.80665)
        sensors.delta_angle_rad[:] = sensors.gyro_radps * 0.01
        sensors.delta_velocity_mps[:] = sensors.accel_mps2 * 0.01
        reckoning.update(now, sensors)
        now += step
    found = reckoning.at(0, start + 2 * NS_PER_S - 10 * NS_PER_MS)
    assert found is not None
    position, velocity, _, _ = found
    assert velocity == pytest.approx([2.0, 0.0, 0.0], abs=0.03)
    assert position == pytest.approx([2.0, 0.0, 0.0], abs=0.04)


@pytest.mark.parametrize(
    ("field", "value", "rests"),
    [
        ("gyro_radps", (0.0, 0.0, 0.0), True),
        ("gyro_radps", (0.0, np.radians(2.8), 0.0), True),
        ("gyro_radps", (0.0, -np.radians(3.0), 0.0), False),
        ("accel_mps2", (0.0, 0.0, 8.9), True),
        ("accel_mps2", (0.0, 0.0, 8.7), False),
        ("accel_mps2", (4.5, 0.0, 9.80665), True),
        ("accel_mps2", (4.7, 0.0, 9.80665), False),
        ("rotor_radps", (0.0, 0.9, 0.0, 0.0), True),
        ("rotor_radps", (0.0, 0.0, 0.0, 1.0), False),
    ],
)
def test_an_aircraft_rests_below_three_degrees_a_second_at_1_g_with_rotors_that_stand(
    field: str, value: tuple[float, ...], rests: bool
) -> None:
    reckoning, sensors = DeadReckoning(1, FIELD), readings()
    getattr(sensors, field)[0] = value
    for step in range(5):
        reckoning.update(step * 10 * NS_PER_MS, sensors)
    assert reckoning.resting[0] == rests


def test_a_drift_at_rest_is_found_and_a_still_fix_is_not() -> None:
    for speed_mps, least in ((0.0, 0), (0.5, 1)):
        check, sensors, alerts = innovation_check(), readings(), 0
        for tick in range(600):
            now = tick * 10 * NS_PER_MS
            if tick % 20 == 0:
                sensors.gnss_time_ns[:] = now
                sensors.gnss_vel_enu_mps[0, 0] = speed_mps if tick > 300 else 0.0
                sensors.gnss_enu_m[0, 0] = speed_mps * max(tick - 300, 0) * 0.01
            sensors.gnss_fix[:] = 3
            alerts += len([one for one in check.on_sensors(now, sensors) if not hasattr(one, "sensor")])
        assert (alerts > 0) == bool(least)
        assert sensors.gnss_fix[0] == (1 if least else 3)


def test_the_guard_takes_fixes_away_until_they_were_plausible_for_its_time() -> None:
    guard, sensors = FixGuard(("a/1",), True, 2 * NS_PER_S), readings()
    assert len(guard.find(0, 0, "x", 2.0)) == 1
    assert [act.sensor for act in guard.apply(sensors)] == ["gnss"]
    assert sensors.gnss_fix[0] == 1
    guard.clear(0, 1 * NS_PER_S)
    assert guard.closed(0)
    guard.clear(0, 2 * NS_PER_S)
    assert not guard.closed(0)


def test_the_barometer_between_two_readings_is_interpolated() -> None:
    barometer = BarometerReadings([deque()])
    heights = Heights(HeightErrors(BarometerCheck()), 5.0, barometer.of[0])
    for now, up_m in ((0, 10.0), (5 * NS_PER_MS, 12.0), (50 * NS_PER_MS, 10.0), (100 * NS_PER_MS, 11.0)):
        barometer.update(now, replace(readings(), baro_up_m=np.array([up_m])))
    assert heights.height_at(25 * NS_PER_MS) == pytest.approx(10.25)
    assert heights.height_at(130 * NS_PER_MS) == 11.0
    assert heights.height_at(-1) is None


def test_a_clock_that_is_set_is_found_and_one_that_drifts_by_its_tolerance_is_not() -> None:
    receiver = Receiver(ReceiverCheck(), 5.0)
    place = (0.0, 0.0, 0.0)
    for second in range(100):
        now = second * NS_PER_S
        assert receiver.take(now, now, second * 90_000, place, place, 1.5)[0] == ""
    assert receiver.take(100 * NS_PER_S, 100 * NS_PER_S, 600_000_000, place, place, 1.5)[0] == "receiver.utc"


def test_a_place_after_a_gap_is_plausible_within_reach() -> None:
    for east_m, expected in ((60.0, ""), (200.0, "receiver.jump")):
        receiver = Receiver(ReceiverCheck(), 5.0)
        receiver.take(0, 0, 0, (0.0, 0.0, 0.0), (5.0, 0.0, 0.0), 1.5)
        now = 5 * NS_PER_S
        assert receiver.take(now, now, 0, (east_m, 0.0, 0.0), (5.0, 0.0, 0.0), 1.5)[0] == expected


NUMBERS = st.floats(allow_nan=True, allow_infinity=True)
WHOLE = st.integers(-(2**62), 2**62)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.lists(NUMBERS, min_size=19, max_size=19), WHOLE, WHOLE, st.integers(0, 8)), max_size=6))
def test_no_reading_raises_an_error(rows: list[tuple[list[float], int, int, int]]) -> None:
    checks = [innovation_check(), made(BarometerCheck), made(ReceiverCheck)]
    for count in range(150 + len(rows)):
        now, sensors = count * 10 * NS_PER_MS, readings()
        sensors.gnss_time_ns[:] = now - now % (200 * NS_PER_MS)
        if count >= 150:
            numbers, time, utc, fix = rows[count - 150]
            values = np.array(numbers)
            sensors.gyro_radps[0], sensors.accel_mps2[0], sensors.gnss_enu_m[0] = values[:9].reshape(3, 3)
            sensors.gnss_vel_enu_mps[0], sensors.compass_gauss[0] = values[9:15].reshape(2, 3)
            sensors.baro_up_m[0], sensors.gnss_accuracy[0] = values[15], values[16:19]
            sensors.gnss_time_ns[:], sensors.gnss_utc_error_ns[:], sensors.gnss_fix[:] = time, utc, fix
        for check in checks:
            for one in check.on_sensors(now, sensors):
                assert hasattr(one, "sensor") or not find_problem(now, one)


def drifting(rate_mps: float, acceleration_mps2: float, seconds: float) -> float | None:
    """How long a false level velocity, from 20 s on, passes the gates at hover with no noise; `None`: to the end."""
    check = InnovationCheck()
    gates, one = check.find_gates(), ErrorFilter(check)
    one.start(0, np.zeros(3), np.zeros(3), np.zeros((3, 3)), np.eye(3))
    for count in range(1, int((20.0 + seconds) / 0.2)):
        since_s = max(0.2 * count - 20.0, 0.0)
        speed_mps = rate_mps + acceleration_mps2 * since_s if since_s else 0.0
        off_m = rate_mps * since_s + 0.5 * acceleration_mps2 * since_s**2
        force, rotation = np.array([0.0, 0.0, 9.80665 * 0.2 * count]), 0.2 * count * np.eye(3)
        one.predict(count * 200 * NS_PER_MS, force, rotation, resting=False)
        innovation, spread, white = one.innovate(
            np.array([off_m, 0.0, 0.0]), np.array([speed_mps, 0.0, 0.0]), np.array([1.5, 2.5, 0.2])
        )
        square, window, drift = one.judge(white)
        if square > gates.fix or window > gates.window or drift > gates.drift:
            return since_s
        one.fuse(innovation, spread)
    return None


def test_what_dead_reckoning_sees_and_what_it_cannot_see() -> None:
    """A false velocity that could be the bias of an accelerometer passes; the limits are those of `evasion`."""
    assert drifting(1.0, 0.0, 10.0) is not None
    assert drifting(0.25, 0.0, 60.0) is None
    assert drifting(0.0, 0.5, 10.0) is not None
    assert drifting(0.0, 0.05, 60.0) is None


def test_the_tilt_of_the_alignment_hides_the_bias_until_the_aircraft_turns() -> None:
    """Error of a level acceleration, tilt × g − bias: none as aligned, sqrt(2) biases after a turn by 90 degrees."""
    params, one = InnovationCheck(), ErrorFilter(InnovationCheck())
    for heading in (0.0, 0.9, 4.0):
        cosine, sine = np.cos(heading), np.sin(heading)
        aligned = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        one.start(0, np.zeros(3), np.zeros(3), np.zeros((3, 3)), aligned)
        for attitude, biases in ((aligned, 0.0), (quarter @ aligned, np.sqrt(2.0))):
            error = np.zeros((2, 15))
            error[0, A.start + 1], error[1, A.start] = 9.80665, -9.80665
            error[:, B] = -attitude[:2]
            sigma = np.sqrt(np.diag(error @ one.covariance @ error.T))
            assert sigma == pytest.approx(biases * params.accel_bias_mps2, abs=1e-9)


def test_joined_trackers_are_what_each_is_alone() -> None:
    """In a batch of runs, one update is that of the trackers of all: of 1, 2 and 1 aircraft here."""
    counts, random = (1, 2, 1), np.random.default_rng(5)
    apart, members = ([DeadReckoning(count, FIELD) for count in counts] for _ in range(2))
    heights, parts = ([BarometerReadings([deque() for _ in range(count)]) for count in counts] for _ in range(2))
    joined, joined_heights = members[0].join(members[1:]), parts[0].join(parts[1:])
    still, rows = readings(4), (slice(0, 1), slice(1, 3), slice(3, 4))
    for step in range(450):
        now, noise = 10 * NS_PER_MS * step, random.normal(0.0, 1e-3, (4, 3)) * (1.0 if step < 400 else 30.0)
        sensors = replace(
            still,
            gyro_radps=still.gyro_radps + noise,
            delta_angle_rad=0.01 * noise,
            baro_up_m=np.floor(random.normal(0.0, 2.0, 4)),
        )
        joined.update(now, sensors)
        joined_heights.update(now, sensors)
        for alone, height, part in zip(apart, heights, rows, strict=True):
            own = Sensors(**{name: getattr(sensors, name)[part] for name in Sensors.__dataclass_fields__})
            alone.update(now, own)
            height.update(now, own)
        assert step != 399 or joined.aligned.all()
    for one, other in zip(apart, members, strict=True):
        assert one.resting.tobytes() == other.resting.tobytes()
        for row in range(one.count):
            alone_state, joined_state = one.at(row, now - 35 * NS_PER_MS), other.at(row, now - 35 * NS_PER_MS)
            assert alone_state is not None
            assert joined_state is not None
            assert [part.tobytes() for part in alone_state] == [part.tobytes() for part in joined_state]
    assert [part.of for part in heights] == [part.of for part in parts]
    assert parts[1].of == joined_heights.of[1:3]
