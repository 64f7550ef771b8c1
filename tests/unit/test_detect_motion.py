"""Detectors of motion, navigation and conformance: hand-made telemetry, and recorded attacks with their twins."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import deepcopy
from functools import partial
from math import atan2, cos, degrees, radians, sin
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import pytest

from skyrange.codec.mavlink import dialect
from skyrange.contracts.monitors import DetectorPlugin, ObservedFrame
from skyrange.core.time import NS_PER_S, from_seconds
from skyrange.core.volumes import Volume4D
from skyrange.detect.motion.consistency import DragModels, lean_acceleration
from skyrange.detect.navigation.gnss_innovation import SelfStarting
from skyrange.detect.series import MovingMean, Series, offset_m, rounds
from skyrange.scenario.shipped import load as load_scenario
from skyrange.study.runs import run
from skyrange.testing import check_monitor
from skyrange.testing.checks.monitors import collect_frames, serve
from skyrange.utm.contract import ApprovalDecision, OperationalIntent, intent_id
from skyrange.utm.intent_states import IntentState
from skyrange.utm.messages import Request, encode, encode_decision, encode_request
from tests.unit.telemetry_sample import (
    EPOCH,
    ORIGIN,
    PORTS,
    SPEED,
    Say,
    alerts,
    attitude,
    fix,
    make,
    north,
    position,
    pressure,
    replayed,
    residuals,
    seen,
    times,
)

pytestmark = pytest.mark.rotating

if TYPE_CHECKING:
    from skyrange.detect.bases import TelemetryDetector

CONSISTENCY = DetectorPlugin.find("motion.consistency")
FLEET = DetectorPlugin.find("motion.fleet")
CS_EMA = DetectorPlugin.find("navigation.cs_ema")
GNSS_INNOVATION = DetectorPlugin.find("navigation.gnss_innovation")
MULTI_SENSOR = DetectorPlugin.find("navigation.multi_sensor")
CONFORMANCE = DetectorPlugin.find("approval.conformance")

APPROVAL = 0
PLUGINS = (CONFORMANCE, CONSISTENCY, CS_EMA, FLEET, GNSS_INNOVATION, MULTI_SENSOR)


def status(at_s: float, percent: int) -> ObservedFrame:
    return seen(at_s, dialect.MAVLink_sys_status_message(0, 0, 0, 250, 12_000, 900, percent, 0, 0, 0, 0, 0, 0))


def light(until_s: float, say: Say = north, place: int = 1) -> list[ObservedFrame]:
    """The messages of the profile `light` that the detectors read."""
    found = [position(at, say, place) for at in times(until_s, 4)]
    found += [attitude(at, place=place) for at in times(until_s, 1)]
    return found + [status(at, 90 - int(at / 6)) for at in times(until_s, 1)]


def test_steady_flight_raises_nothing() -> None:
    for plugin in (CONSISTENCY, FLEET, GNSS_INNOVATION, MULTI_SENSOR):
        frames = [frame for place in (1, 2, 3) for frame in light(60.0, partial(north, place=place), place)]
        assert alerts(plugin, frames, 60.0) == [], plugin.about


def test_a_jump_and_a_climb_that_velocities_do_not_show_are_found() -> None:
    def jumped(at_s: float) -> tuple[float, float, float]:
        east, nrth, up = north(at_s)
        return (east + (3.0 if at_s >= 20 else 0.0), nrth, up + (3.0 if at_s >= 40 else 0.0))

    frames = [position(at, jumped, velocity=(0, SPEED, 0)) for at in times(60, 4)]
    found = alerts(CONSISTENCY, frames, 60.0)
    assert residuals(found) == {("blue/b1", "position"), ("blue/b1", "climb")}
    assert [round(alert.at / NS_PER_S) for alert in found] == [20, 40]
    assert found[0].score == pytest.approx((3.0 / 0.056 - 2.0) / 20.0, rel=0.05)
    assert found[0].data["error_m"] == pytest.approx(3.0, abs=0.05)
    assert alerts(CONSISTENCY, frames, 60.0, threshold=60.0) == []


def test_the_acceleration_of_a_step_is_bounded() -> None:
    frames = [position(at, north, velocity=(0, SPEED, 9.0 if at >= 20 else 0.0)) for at in times(22, 4)]
    assert ("blue/b1", "acceleration") in residuals(alerts(CONSISTENCY, frames, 22.0))


@pytest.mark.parametrize("rate_hz", [1, 10])
def test_a_lean_that_the_motion_does_not_show_is_found_and_wind_is_not(rate_hz: int) -> None:
    def leaning(roll_at: Callable[[float], float]) -> list[ObservedFrame]:
        flown = [position(at, north) for at in times(60, 4)]
        return flown + [attitude(at, roll_at(at)) for at in times(60, rate_hz)]

    found = alerts(CONSISTENCY, leaning(lambda at: radians(40) if at >= 30 else 0.0), 60.0)
    assert residuals(found) == {("blue/b1", "lean")}
    assert 30.0 < found[0].at / NS_PER_S < 42.0
    assert alerts(CONSISTENCY, leaning(lambda at: radians(15)), 60.0) == []


def test_a_battery_that_falls_or_rises_at_once_is_found() -> None:
    for wrong in (8, 99):
        frames = [status(at, 90 - int(at / 6) if at < 30 else wrong) for at in times(40, 1)]
        ((at_s, name),) = [(alert.at / NS_PER_S, alert.data["residual"]) for alert in alerts(CONSISTENCY, frames, 40)][
            :1
        ]
        assert (round(at_s), name) == (30, "battery")
    unknown = [status(at, 80 if at < 20 else -1) for at in times(40, 1)]
    assert alerts(CONSISTENCY, unknown, 40.0) == []


def test_drag_is_identified_and_then_predicts() -> None:
    models, places = DragModels(), np.zeros(1, dtype=np.int64)
    models.grow(1)
    noise = np.array([0.3])
    for number in range(60):
        course = number * 0.3
        velocity = 5.0 * np.array([[cos(course), sin(course)]])
        drag = -0.4 * (velocity - np.array([[3.0, -2.0]]))
        size = models.update(places, np.array([2.0]), velocity, drag, noise)
    assert size[0] < 0.1
    assert models.update(places, np.array([2.0]), velocity, drag + 4.0, noise)[0] > 5.0
    eastwards = lean_acceleration(np.array([0.0]), np.array([-0.2]), np.array([radians(90)]))
    assert eastwards[0] == pytest.approx([9.80665 * np.tan(0.2), 0.0], abs=1e-9)
    to_the_right = lean_acceleration(np.array([0.2]), np.array([0.0]), np.array([0.0]))
    assert to_the_right[0] == pytest.approx([9.80665 * np.tan(0.2), 0.0], abs=1e-9)


def ratios(at_s: float, velocity: float) -> ObservedFrame:
    return seen(at_s, dialect.MAVLink_ekf_status_report_message(831, velocity, 0.05, 0.02, 0.04, 0.0))


def test_innovations_within_the_gates_add_up() -> None:
    def wave(at_s: float) -> float:
        return 0.04 + 0.02 * sin(7.0 * at_s)

    nominal = [ratios(at, wave(at)) for at in times(60, 3)]
    assert alerts(GNSS_INNOVATION, nominal, 60.0) == []
    pulled = [ratios(at, 0.3 if at >= 30 else wave(at)) for at in times(60, 3)]
    found = alerts(GNSS_INNOVATION, pulled, 60.0)
    assert residuals(found) == {("blue/b1", "velocity")}
    assert 30.0 < found[0].at / NS_PER_S < 33.0
    px4 = [
        seen(
            at, dialect.MAVLink_estimator_status_message(0, 0, wave(at) ** 2 if at < 30 else 0.09, 0, 0, 0, 0, 0, 0, 0)
        )
        for at in times(60, 3)
    ]
    assert residuals(alerts(GNSS_INNOVATION, px4, 60.0)) == {("blue/b1", "velocity")}


def test_fixes_beside_the_estimate_and_lost_fixes_are_found() -> None:
    flown = [position(at, north) for at in times(60, 4)]
    assert alerts(GNSS_INNOVATION, flown + [fix(at, north, 1.5) for at in times(60, 2)], 60.0) == []
    away = [fix(at, north, 20.0 if at >= 30 else 0.0) for at in times(60, 2)]
    found = alerts(GNSS_INNOVATION, flown + away, 60.0)
    assert residuals(found) == {("blue/b1", "offset")}
    assert found[0].data["difference"] == pytest.approx(20.0, abs=1.0)
    boasting = [fix(at, north, 60.0 if at >= 30 else 0.0, h_acc_mm=100_000) for at in times(60, 2)]
    assert ("blue/b1", "offset") in residuals(alerts(GNSS_INNOVATION, flown + boasting, 60.0))
    for gap_s, expected in ((3.0, set()), (10.0, {("blue/b1", "accuracy")})):
        lost = [fix(at, north, fix_type=1 if 30 <= at < 30 + gap_s else 3) for at in times(60, 2)]
        assert residuals(alerts(GNSS_INNOVATION, flown + lost, 60.0)) == expected


def test_the_time_of_gnss_is_compared_with_the_clock_of_the_station() -> None:
    def clock(ahead_s: float) -> list[ObservedFrame]:
        unix_us = [0, *(EPOCH.utc_us(from_seconds(at + (ahead_s if at >= 10 else 0))) for at in range(1, 20))]
        return [seen(at, dialect.MAVLink_system_time_message(us, at * 1000)) for at, us in enumerate(unix_us)]

    assert alerts(GNSS_INNOVATION, clock(0.0), 20.0) == []
    ((at_s, score),) = [(alert.at / NS_PER_S, alert.score) for alert in alerts(GNSS_INNOVATION, clock(-20.0), 20.0)]
    assert (round(at_s), round(score)) == (10, 10)


def test_heights_of_barometer_and_receiver_are_compared() -> None:
    flown = [frame for at in times(60, 2) for frame in (position(at, north), fix(at, north))]
    assert alerts(MULTI_SENSOR, flown + [pressure(at, 27.0) for at in times(60, 2)], 60.0) == []
    false = [pressure(at, 27.0 + 15.0 * min(max(at - 20.0, 0.0) / 10.0, 1.0)) for at in times(60, 2)]
    found = alerts(MULTI_SENSOR, flown + false, 60.0)
    assert residuals(found) == {("blue/b1", "gnss_height"), ("blue/b1", "fused_height")}
    assert 24.0 < found[0].at / NS_PER_S < 40.0


def test_heading_is_compared_with_course_and_gyroscope() -> None:
    frames = [position(at, north, heading_deg=90.0 if at >= 30 else 5.0) for at in times(60, 4)]
    assert residuals(alerts(MULTI_SENSOR, frames, 60.0)) == {("blue/b1", "heading")}
    hovering = [position(at, lambda at: (0.0, 0.0, 30.0), heading_deg=90.0) for at in times(60, 4)]
    assert alerts(MULTI_SENSOR, hovering, 60.0) == []
    turned = [attitude(at, yaw=1.5 if at >= 30 else 0.0) for at in times(60, 10)]
    assert residuals(alerts(MULTI_SENSOR, turned, 60.0)) == {("blue/b1", "turn")}


def test_air_speed_is_compared_with_ground_speed() -> None:
    def hud(at_s: float, air_mps: float) -> ObservedFrame:
        return seen(at_s, dialect.MAVLink_vfr_hud_message(air_mps, 5.0, 0, 50, 50.0, 0.0))

    assert alerts(MULTI_SENSOR, [hud(at, 9.0) for at in times(60, 4)], 60.0) == []
    found = alerts(MULTI_SENSOR, [hud(at, 30.0 if at >= 30 else 5.0) for at in times(60, 4)], 60.0)
    assert residuals(found) == {("blue/b1", "air_speed")}


def fleet_of(says: Sequence[Say], until_s: float = 40.0, velocity: Any = None) -> list[ObservedFrame]:
    return [position(at, say, place, velocity) for place, say in enumerate(says, start=1) for at in times(until_s, 4)]


def test_a_step_of_several_aircraft_in_one_direction_is_common() -> None:
    def shifted(place: int, by_m: float) -> Say:
        return lambda at: (north(at, place)[0] + (by_m if at >= 20 else 0.0), *north(at, place)[1:])

    for steps, concerned in (((2, 2, 0), {"b1", "b2"}), ((2, 0, 0), set()), ((2, -2, 0), set())):
        says = [shifted(place, by_m) for place, by_m in enumerate(steps, start=1)]
        found = alerts(FLEET, fleet_of(says, velocity=(0, SPEED, 0)), 40.0)
        assert residuals(found) == {(f"blue/{name}", "common_step") for name in concerned}
        assert {alert.data["aircraft"] for alert in found} <= {2.0}


def test_two_aircraft_at_one_place_in_flight_are_found() -> None:
    def beside(at_s: float) -> tuple[float, float, float]:
        east, nrth, up = north(at_s, 1)
        return east + 1.0, nrth + 0.01, up

    found = alerts(FLEET, fleet_of([north, beside, lambda at: north(at, 3)]), 40.0)
    assert residuals(found) == {("blue/b1", "same_place"), ("blue/b2", "same_place")}

    def landed(at_s: float) -> tuple[float, float, float]:
        return 50.0, 0.0, 0.5

    assert alerts(FLEET, fleet_of([landed, landed]), 40.0) == []


def test_positions_that_were_reported_before_are_a_replay() -> None:
    old = [position(at, lambda at: north(at - 15.0 if at >= 20 else at), velocity=(0, SPEED, 0)) for at in times(40, 4)]
    found = alerts(FLEET, old, 40.0)
    assert residuals(found) == {("blue/b1", "replayed")}
    assert 20.5 < found[0].at / NS_PER_S < 22.0
    twice = [position(at, north) for at in times(40, 4)] * 2
    assert alerts(FLEET, twice, 40.0) == []


def test_links_that_are_lost_together_are_found() -> None:
    def until(ends_s: Sequence[float]) -> list[ObservedFrame]:
        return [
            position(at, partial(north, place=place), place)
            for place, end in enumerate(ends_s, start=1)
            for at in times(end, 4)
        ]

    assert residuals(alerts(FLEET, until([20, 20.5, 40]), 40.0)) == {
        ("blue/b1", "lost_together"),
        ("blue/b2", "lost_together"),
    }
    assert alerts(FLEET, until([20, 40, 40]), 40.0) == []
    assert alerts(FLEET, until([15, 25, 40]), 40.0) == []


def volume(north_m: tuple[float, float], begin_s: float = 0.0, end_s: float = 60.0) -> Volume4D:
    corners = [(40.0, north_m[0]), (60.0, north_m[0]), (60.0, north_m[1]), (40.0, north_m[1])]
    outline = tuple(ORIGIN.geodetic_of(*corner) for corner in corners)
    up = ORIGIN.ellipsoid_of(20.0)
    return Volume4D(outline, up, up + 50.0, from_seconds(begin_s), from_seconds(end_s))


def talk(payload: bytes, at_s: float, received: bool) -> ObservedFrame:
    ends = ("approval", "blue.gcs") if received else ("blue.gcs", "approval")
    return ObservedFrame(PORTS[APPROVAL], received, from_seconds(at_s), payload, *ends)


def claimed(volumes: Sequence[Volume4D], state: IntentState = IntentState.ACCEPTED) -> OperationalIntent:
    return OperationalIntent(intent_id("blue/b1"), "blue", "blue/b1", tuple(volumes), 0, state)


def approved(*volumes: Volume4D, accepted: bool = True) -> list[ObservedFrame]:
    decision = ApprovalDecision(accepted, "" if accepted else "taken", ovn="x")
    return [
        talk(encode_request(claimed(volumes), EPOCH), 0.0, False),
        talk(encode_decision(intent_id("blue/b1"), decision, EPOCH), 0.1, True),
    ]


def conformance(flight: Sequence[ObservedFrame], until_s: float = 50.0) -> list[tuple[str, object, int]]:
    flown = [position(at, north) for at in times(until_s, 4)]
    found = alerts(CONFORMANCE, [*flight, *flown], until_s)
    return [(alert.subject, alert.data["residual"], round(alert.at / NS_PER_S)) for alert in found]


def test_flights_are_compared_with_their_accepted_volumes() -> None:
    assert conformance(approved(volume((-10, 140)), volume((130, 300)))) == []
    outside = conformance(approved(volume((-10, 100))))  # left at 20 s
    assert outside == [("blue/b1", "outside", 30), ("blue/b1", "outside", 41)]  # and once more with twice the score
    late = conformance(approved(volume((-10, 300), 0.0, 25.0)))
    assert late[0] == ("blue/b1", "outside", 36)


def test_flights_without_an_accepted_intent_are_found() -> None:
    assert conformance([])[0] == ("blue/b1", "unapproved", 10)
    assert conformance(approved(volume((-10, 300)), accepted=False))[0] == ("blue/b1", "unapproved", 10)
    ended = [*approved(volume((-10, 300))), talk(encode(Request.end(claimed(()))), 20.0, False)]
    assert conformance(ended)[0] == ("blue/b1", "unapproved", 30)
    others = encode_request(OperationalIntent(intent_id("x"), "green", "green/g1", (volume((-10, 300)),)), EPOCH)
    assert conformance([*approved(volume((-10, 300))), talk(others, 1.0, False), talk(b"{}", 1.0, True)]) == []


def test_a_report_of_an_excursion_does_not_end_it() -> None:
    wide = claimed([volume((-10, 300))], IntentState.NONCONFORMING)
    accepted = ApprovalDecision(True, ovn="y")
    told = [
        talk(encode_request(wide, EPOCH, 1), 32.0, False),
        talk(encode_decision(intent_id("blue/b1"), accepted, EPOCH, 1), 32.1, True),
    ]
    assert conformance([*approved(volume((-10, 100))), *told])[-1] == ("blue/b1", "outside", 41)
    again = [
        talk(encode_request(claimed([volume((-10, 300))], IntentState.ACTIVATED), EPOCH, 1), 22.0, False),
        talk(encode_decision(intent_id("blue/b1"), accepted, EPOCH, 1), 22.1, True),
    ]
    assert conformance([*approved(volume((-10, 100))), *again]) == []


def test_links_without_their_approval_are_not_judged() -> None:
    frames = [position(at, north) for at in times(40, 4)]
    served = serve(make(CONFORMANCE), PORTS[1:], frames, from_seconds(40))
    assert [alert for *_, said in served for alert in said] == []


@pytest.mark.parametrize("plugin", PLUGINS, ids=lambda plugin: plugin.params.__name__)
def test_every_detector_follows_the_contract(plugin: DetectorPlugin) -> None:
    check_monitor(plugin, {"report_above": 0.01}, ports=PORTS)


@pytest.mark.parametrize("plugin", PLUGINS, ids=lambda plugin: plugin.params.__name__)
def test_extreme_values_are_survived_and_leave_other_aircraft_alone(plugin: DetectorPlugin) -> None:
    nan, huge = float("nan"), 3e38
    strange: list[ObservedFrame] = []
    for at in times(40, 1):
        value = (nan, huge, -huge, 0.0)[int(at) % 4]
        strange += [
            attitude(at, value, value, value, place=2),
            seen(at, dialect.MAVLink_ekf_status_report_message(0, value, value, value, value, value), 2),
            seen(at, dialect.MAVLink_scaled_pressure_message(0, value, value, -32_768), 2),
            seen(at, dialect.MAVLink_vfr_hud_message(value, -value, 0, 0, value, value), 2),
            seen(at, dialect.MAVLink_system_time_message(2**64 - 1, 2**32 - 1), 2),
            seen(at, dialect.MAVLink_global_position_int_message(
                int(at * 7919) % 2**32, -(2**31), 2**31 - 1, -(2**31), 2**31 - 1, -32_768, 32_767, 0, 65_535), 2),
        ]  # fmt: skip
    own = [*approved(volume((-10, 300))), *light(40.0)]
    found = alerts(plugin, [*own, *strange], 40.0, report_above=0.5)
    assert [alert for alert in found if alert.subject == "blue/b1"] == []
    assert all(np.isfinite(alert.score) for alert in found)


def test_other_components_are_not_the_autopilot() -> None:
    series = Series("HEARTBEAT", ("custom_mode",), timed=False)
    beats = [seen(at, dialect.MAVLink_heartbeat_message(2, 3, 81, at, 4, 3), component=1 + at % 2) for at in range(4)]
    steps = series.read(collect_frames(PORTS, beats))
    assert steps.after[:, 0].tolist() == [0.0, 2.0]
    assert np.isnan(steps.before[0, 0])
    assert steps.before[1, 0] == 0.0
    assert steps.seconds[1] == pytest.approx(2.0)
    more = series.read(collect_frames(PORTS, [seen(9, dialect.MAVLink_heartbeat_message(2, 3, 81, 7, 4, 3))]))
    assert (more.before[0, 0], more.seconds[0]) == (2.0, pytest.approx(7.0))


def test_sums_and_means_are_the_same_in_one_batch_and_in_many() -> None:
    places = np.array([0, 2, 0, 0, 2, 1])
    values = np.array([3.0, 1.0, -5.0, 4.0, np.nan, 2.0])
    assert [found.tolist() for found in rounds(places)] == [[0, 5, 1], [2, 4], [3]]
    whole, single = (cast("TelemetryDetector", make(CONSISTENCY)) for _ in range(2))
    expected = [single.accumulate("climb", places[[row]], values[[row]], 2.0)[0] for row in range(6)]
    assert whole.accumulate("climb", places, values, 2.0).tolist() == expected == [1.5, 0.5, 0.0, 2.0, 0.5, 1.0]
    means, one = MovingMean(2.0), MovingMean(2.0)
    seconds = np.full(6, 1.0)
    found = [one.add(places[[row]], seconds[[row]], values[[row]])[0] for row in range(6)]
    assert means.add(places, seconds, values).tolist() == found
    assert found[2] == pytest.approx(3.0 - 8.0 * (1.0 - np.exp(-0.5)))
    copied = deepcopy(means)
    means.add(places, seconds, values)
    assert copied.add(np.array([1]), np.array([0.0]), np.array([9.0])).tolist() == [2.0]


def test_values_are_standardised_by_their_own_past() -> None:
    normal, place = SelfStarting(0.01), np.zeros(1, dtype=np.int64)
    found = [normal.standardise(place, np.array([1.0 + 0.1 * (-1) ** number]))[0] for number in range(100)]
    assert found[:20] == [0.0] * 20
    assert abs(found[-1]) == pytest.approx(1.0, abs=0.05)
    assert normal.standardise(place, np.array([2.0]))[0] == 8.0
    assert normal.standardise(place, np.array([1.2]))[0] == pytest.approx(2.0, abs=0.1)  # the outlier did not count


def test_offsets_agree_with_the_projection() -> None:
    point = np.array([407_780_000.0]), np.array([-739_550_000.0])
    lat, lon = ORIGIN.geodetic_of(300.0, -200.0)
    east, nrth = offset_m(*point, np.array([lat * 1e7]), np.array([lon * 1e7]))
    assert (east[0], nrth[0]) == pytest.approx((300.0, -200.0), abs=0.05)
    assert degrees(atan2(east[0], nrth[0])) == pytest.approx(degrees(atan2(300, -200)), abs=0.01)
    across, _ = offset_m(np.array([0.0]), np.array([1_799_999_990.0]), np.array([0.0]), np.array([-1_799_999_990.0]))
    assert across[0] == pytest.approx(0.222, abs=0.01)


@pytest.mark.catalogue
@pytest.mark.parametrize(
    ("name", "attack", "duration_s", "plugins"),
    [
        ("falsified-log", "router", 30, [(CONSISTENCY, "position", 18, 20)]),
        ("gnss-pull-off", "pull", 32, [(GNSS_INNOVATION, "velocity", 17, 22), (CONSISTENCY, "position", 17, 25)]),
        ("telemetry.attitude", "attitude", 42, [(CONSISTENCY, "lean", 30, 40), (MULTI_SENSOR, "heading", 30, 40)]),
        ("sensor.barometer", "pump", 46, [(MULTI_SENSOR, "gnss_height", 34, 46), (GNSS_INNOVATION, "height", 25, 35)]),
        ("telemetry.battery", "battery", 32, [(CONSISTENCY, "battery", 30, 31)]),
        ("mavlink.mission_replace", "replace", 40, [(CONFORMANCE, "outside", 30, 36)]),
    ],
)
def test_shipped_attacks_are_found_and_their_nominal_runs_are_silent(
    tmp_path: Path, name: str, attack: str, duration_s: int, plugins: list[tuple[DetectorPlugin, str, float, float]]
) -> None:
    changes = [f"duration_s={duration_s}", *(['operators.0.streams="operator"'] if name == "sensor.barometer" else [])]
    attacked = run(load_scenario(name, changes), tmp_path / "attacked")
    nominal = run(load_scenario(name, [*changes, f"attacks.{attack}.muted=true"]), tmp_path / "nominal")
    for plugin, residual, first_s, last_s in plugins:
        links = ("gcs:*", "approval:*") if plugin is CONFORMANCE else ("gcs:*",)
        found = [alert for alert in replayed(attacked, plugin, links) if alert.data["residual"] == residual]
        assert {alert.subject for alert in found} == {"blue/b1"}, plugin.about
        assert first_s < found[0].at / NS_PER_S < last_s
    for plugin in PLUGINS:
        links = ("gcs:*", "approval:*") if plugin is CONFORMANCE else ("gcs:*",)
        assert replayed(nominal, plugin, links) == [], plugin.about


@pytest.mark.slow
def test_aircraft_whose_fixes_are_pulled_off_together_step_together(tmp_path: Path) -> None:
    changes = ["duration_s=26", 'attacks.pull.params.vehicles=["blue/b1", "blue/b2"]']
    attacked = run(load_scenario("gnss-pull-off", changes), tmp_path / "attacked")
    nominal = run(load_scenario("gnss-pull-off", [*changes, "attacks.pull.muted=true"]), tmp_path / "nominal")
    found = replayed(attacked, FLEET)
    assert residuals(found) == {("blue/b1", "common_step"), ("blue/b2", "common_step")}
    assert 17.0 < found[0].at / NS_PER_S < 20.0
    assert replayed(nominal, FLEET) == []
