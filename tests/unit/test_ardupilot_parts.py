"""ArduPilot's parameters, GNSS input and what its messages tell, without a process."""

from __future__ import annotations

import numpy as np
import pytest

from skyrange.codec.mavlink import Packer, decode, dialect
from skyrange.core.errors import InputError
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_S, Epoch
from skyrange.vehicle.ardupilot import parameters
from skyrange.vehicle.ardupilot.gps_input import GnssReceivers
from skyrange.vehicle.event_detection import EventDetector
from skyrange.world import Body, World
from skyrange.world.airframes import AIRFRAMES

NEW = {"WP_SPD": 10.0, "WP_RADIUS_M": 2.0, "GPS1_TYPE": 1.0, "GPS1_DELAY_MS": 0.0, "SCHED_LOOP_RATE": 400.0}
OLD = {"WPNAV_SPEED": 1000.0, "WPNAV_RADIUS": 200.0, "GPS_TYPE": 1.0, "GPS_DELAY_MS": 0.0, "SCHED_LOOP_RATE": 400.0}
IRIS = AIRFRAMES["iris"]


@pytest.mark.parametrize(
    ("name", "value", "listed", "found"),
    [
        ("WPNAV_SPEED", 700.0, OLD, ("WPNAV_SPEED", 700.0)),
        ("WPNAV_SPEED", 700.0, NEW, ("WP_SPD", 7.0)),
        ("WP_SPD", 7.0, NEW, ("WP_SPD", 7.0)),
        ("WP_SPD", 7.0, OLD, ("WPNAV_SPEED", 700.0)),
        ("wp_spd", 7.0, OLD, ("WPNAV_SPEED", 700.0)),
        ("WP_SPED", 7.0, NEW, None),
    ],
)
def test_names_and_units_of_either_version_find_the_firmwares_own(
    name: str, value: float, listed: dict[str, float], found: tuple[str, float] | None
) -> None:
    assert parameters.resolve_parameter(name, value, listed) == found


def test_wrong_parameters_are_told_together_with_the_nearest_name() -> None:
    with pytest.raises(InputError) as caught:
        parameters.start_values("a/b", IRIS, {"WP_SPED": 1.0, "GPS1_TYPE": 2.0, "WP_SPD": float("inf")}, NEW, 120)
    told = str(caught.value)
    assert all(part in told for part in ("WP_SPED", "WP_SPD", "GPS1_TYPE", "finite"))


def test_gnss_comes_over_mavlink_with_the_receivers_own_lag_in_either_version() -> None:
    assert parameters.start_values("a/b", IRIS, {}, NEW, 120)["GPS1_DELAY_MS"] == 120.0
    assert parameters.start_values("a/b", IRIS, {}, OLD, 0) == {"GPS_TYPE": 14.0, "GPS_DELAY_MS": 1.0}


def test_open_drone_id_has_its_transmitter_on_the_link_autopilot_unless_told_otherwise() -> None:
    listed = NEW | {"DID_ENABLE": 0.0, "DID_MAVPORT": -1.0}
    assert parameters.start_values("a/b", IRIS, {"DID_ENABLE": 1.0}, listed, 0)["DID_MAVPORT"] == 0.0
    assert parameters.start_values("a/b", IRIS, {"DID_MAVPORT": 2.0}, listed, 0)["DID_MAVPORT"] == 2.0


@pytest.mark.parametrize(
    ("values", "steps", "moments"),
    [
        ({}, (2, 1), 1),  # 1.8 · 400 Hz in steps of 2.5 ms
        ({"SCHED_LOOP_RATE": 300.0}, (2, 1), 1),  # a turn of the loop is a tick and a third
        ({"SCHED_LOOP_RATE": 200.0}, (1, 1), 2),
        ({"SCHED_LOOP_RATE": 100.0}, (1, 2), 2),
        ({"SCHED_LOOP_RATE": 100.0, "SIM_RATE_HZ": 400.0}, (1, 1), 4),
        ({"SCHED_LOOP_RATE": 50.0}, (1, 4), 2),
        ({"SIM_RATE_HZ": 1200.0}, (3, 1), 1),
        # nothing checks the gyros before arming: once in a turn is enough (names and masks of 4.6, then of 4.7)
        ({"ARMING_CHECK": 1 << 3}, (1, 1), 1),
        ({"ARMING_CHECK": 0}, (1, 1), 1),
        ({"ARMING_CHECK": 1 << 4}, (2, 1), 1),
        ({"ARMING_CHECK": 1}, (2, 1), 1),
        ({"ARMING_CHECK": 1 << 3, "SCHED_LOOP_RATE": 100.0}, (1, 4), 1),
        ({"ARMING_CHECK": 1 << 3, "SIM_RATE_HZ": 800.0}, (2, 1), 1),
        ({"ARMING_SKIPCHK": 1 << 4}, (1, 1), 1),
        ({"ARMING_SKIPCHK": -1}, (1, 1), 1),
        ({"ARMING_SKIPCHK": 1 << 3}, (2, 1), 1),
    ],
)
def test_gyros_are_read_as_often_as_arming_wants(
    values: dict[str, float], steps: tuple[int, int], moments: int
) -> None:
    listed = {"SCHED_LOOP_RATE": 400.0}
    assert parameters.exchange_steps(values, listed, 0.0025) == steps
    assert parameters.moments_per_iteration(values, listed, 0.0025) == moments


@pytest.mark.parametrize("listed", [{"ARMING_CHECK": 1.0}, {"ARMING_SKIPCHK": 0.0}])
def test_rates_are_a_start_that_a_scenario_may_go_on_from(listed: dict[str, float]) -> None:
    listed = listed | {"SCHED_LOOP_RATE": 400.0, "SIM_RATE_HZ": 1200.0}

    def steps(rates: str, given: dict[str, float] | None = None) -> tuple[int, int]:
        values = parameters.start_values("a/b", IRIS, given or {}, listed, 120, rates)
        return parameters.exchange_steps(values, listed, 0.0025)

    assert [steps(rates) for rates in ("full", "single", "reduced")] == [(2, 1), (1, 1), (1, 2)]
    assert steps("single", {"ARMING_CHECK": 1.0}) == (2, 1)
    assert steps("reduced", {"SCHED_LOOP_RATE": 400.0}) == (2, 1)


def test_a_fix_is_said_once_at_most_five_times_a_second_in_gps_time() -> None:
    origin, epoch = Origin(40.0, -73.0, 100.0, -30.0), Epoch(1_767_268_800 * NS_PER_S)  # 2026-01-01T12:00:00Z
    receivers = GnssReceivers(1, origin, epoch)
    world = World([Body("a/b", "iris", 10.0, 20.0)])
    told = []
    for tick in range(400):
        now = tick * 2_500_000
        world.advance(now)
        sensors = world.sensors(slice(None))
        told += [(now, receivers.message(sensors, row)) for row in receivers.fresh(sensors)]
    assert [now for now, _ in told] == [0, 200_000_000, 400_000_000, 600_000_000, 800_000_000]
    first = decode(Packer(1, dialect.MAV_COMP_ID_GPS).pack(told[0][1]))
    # 2026-01-01 12:00:18 of GPS time is a Thursday of week 2399: 4 days, 12 h and 18 s into it
    assert (first.time_week, first.time_week_ms) == (2399, (4 * 86_400 + 12 * 3600 + 18) * 1000)
    east_m, north_m = origin.enu_of(first.lat * 1e-7, first.lon * 1e-7)
    assert (east_m, north_m) == pytest.approx((10.0, 20.0), abs=0.02)
    assert first.alt == pytest.approx(100.0, abs=0.01)
    assert first.fix_type == 6  # ideal sensors
    assert first.yaw == 0


def message(made: object) -> object:
    return decode(Packer(1, 1).pack(made))


def test_changes_are_told_once() -> None:
    witness = EventDetector(1, Origin(40.0, -73.0))
    armed, auto = dialect.MAV_MODE_FLAG_SAFETY_ARMED, 3

    def beat(mode: int, base: int) -> list[str]:
        made = dialect.MAVLink_heartbeat_message(2, 3, base, mode, 4, 3)
        return [kind for kind, _ in witness.on_report(message(made))]

    assert beat(0, 0) == []
    assert beat(auto, 0) == ["event.mode"]
    assert beat(auto, armed) == ["event.armed"]
    assert beat(auto, armed) == []
    assert beat(0, 0) == ["event.mode", "event.disarmed"]
    flying = dialect.MAVLink_extended_sys_state_message(0, dialect.MAV_LANDED_STATE_TAKEOFF)
    assert [kind for kind, _ in witness.on_report(message(flying))] == ["event.takeoff"]
    assert [kind for kind, _ in witness.on_report(message(flying))] == []


def test_belief_that_jumps_is_a_reset_and_belief_that_flies_is_none() -> None:
    witness = EventDetector(1, Origin(40.0, -73.0))
    status = dialect.MAVLink_ekf_status_report_message(dialect.EKF_POS_HORIZ_ABS, 0, 0, 0, 0, 0)
    list(witness.on_report(message(status)))
    kinds = []
    lat_e7 = 400_000_000
    for tick in range(20):
        lat_e7 += 90 + (900 if tick == 12 else 0)  # 10 m/s north, and 10 m at once
        place = dialect.MAVLink_global_position_int_message(tick * 100, lat_e7, -730_000_000, 0, 0, 1000, 0, 0, 0)
        for kind, data in witness.on_report(message(place)):
            kinds.append((tick, kind))
            assert data["north_m"] == pytest.approx(10.0, abs=0.3)
            assert abs(float(data["east_m"])) < 0.1
    assert kinds == [(12, "event.estimator")]


def test_a_false_fix_reaches_only_what_goes_to_the_receiver() -> None:
    receivers = GnssReceivers(1, Origin(40.0, -73.0), Epoch(0))
    world = World([Body("a/b", "iris", 0.0, 0.0)])
    world.advance(0)
    sensors = world.sensors(slice(None))
    true = receivers.message(sensors, 0)
    sensors.gnss_enu_m = sensors.gnss_enu_m + np.array([[100.0, 0.0, 0.0]])
    false = receivers.message(sensors, 0)
    assert false.lon > true.lon
    assert false.lat == true.lat
