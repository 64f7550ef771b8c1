"""Every report an operator's ground station uses: fields in MAVLink's frames and units, streams as ArduCopter has them.

Sources: libraries/GCS_MAVLink/GCS_Common.cpp, GCS_MAVLink_Parameters.cpp; units as
https://mavlink.io/en/messages/common.html has them.
"""

from __future__ import annotations

import copy
import math
from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest

from skyrange.codec.mavlink import decode, dialect, message_fields
from skyrange.codec.mavlink.message_columns import payload_dtype
from skyrange.contracts.mailboxes import Outbox
from skyrange.gcs.telemetry_streams import OPERATOR
from skyrange.vehicle.builtin.engine import BuiltinFleet
from skyrange.vehicle.builtin.layout import ControlMode
from skyrange.vehicle.builtin.modes import Mode
from skyrange.vehicle.builtin.telemetry import schedule
from skyrange.vehicle.builtin.telemetry.table import AVAILABLE, BUILDERS, build_message, build_table
from skyrange.vehicle.contract import VehicleSpec
from tests.integration.flight_harness import EPOCH, ORIGIN, Range

V = "blue/b1"
A = dialect
COUNT = 7


def engine(count: int = COUNT) -> BuiltinFleet:
    """A fleet in flight, every number of it different and none 0."""
    specs = [VehicleSpec(f"blue/b{row}", row + 1, seed=3) for row in range(count)]
    made = BuiltinFleet("x", specs, ORIGIN, EPOCH)
    fleet = made._fleet
    fleet.now = 123_456_789_000
    for table in (fleet.estimate, fleet.flight, fleet.battery):
        assert table.dtype.names
        for place, name in enumerate(table.dtype.names):
            kind = table.dtype[name]
            if kind.names or kind.base.kind != "f":
                continue
            shape = table[name].shape
            step = np.arange(1, math.prod(shape[1:]) + 1).reshape(shape[1:]) if len(shape) > 1 else 1.0
            table[name] = 0.01 * (place + 1) * step
            table[name] += 0.5 * np.arange(count).reshape(-1, *[1] * (len(shape) - 1))
    fleet.estimate["status"] = 831
    fleet.estimate["gnss_fix"], fleet.estimate["gnss_sats"] = 3, 9
    fleet.flight["armed"], fleet.flight["landed"], fleet.flight["control"] = 1, 0, ControlMode.POSITION
    fleet.battery["remaining_pct"] = 63
    for vehicle in fleet.vehicles:
        fleet.assign_mode(vehicle, Mode.GUIDED)
    return made


@pytest.mark.parametrize("number", BUILDERS)
def test_one_and_many_say_the_same_and_nothing_is_left_to_the_neighbours(number: int) -> None:
    fleet = engine()._fleet
    rows = np.array([5, 0, 3], dtype=np.int64)
    many = build_table(fleet, number, rows)
    assert many.dtype == payload_dtype(number)
    for place, row in enumerate(rows.tolist()):
        assert build_table(fleet, number, rows[place : place + 1]).tobytes() == many[place : place + 1].tobytes()
        told = build_message(fleet, fleet.vehicles[row], number)
        if told is not None:
            frame = decode(fleet.vehicles[row].packer.pack(told))
            assert frame.get_msgId() == number


def test_numbers_that_are_none_never_reach_a_frame() -> None:
    """A receiver without a fix has no position: no report may fail or invent one."""
    fleet = engine()._fleet
    for name in ("gnss_pos", "gnss_vel", "baro_up", "compass"):
        fleet.estimate[name] = np.nan
    fleet.estimate["gnss_fix"] = 1
    rows = np.arange(COUNT)
    with np.errstate(all="raise"):
        for number in BUILDERS:
            values = build_table(fleet, number, rows)
            for name in values.dtype.names or ():
                if values[name].dtype.kind == "f" and not (number == A.MAVLINK_MSG_ID_HOME_POSITION and name == "q"):
                    assert np.isfinite(values[name]).all(), (number, name)
    raw = build_table(fleet, A.MAVLINK_MSG_ID_GPS_RAW_INT, rows)
    assert (raw["fix_type"] == 1).all()
    assert (raw["eph"] == 9999).all()  # GPS_UNKNOWN_DOP
    assert build_message(fleet, fleet.vehicles[0], A.MAVLINK_MSG_ID_AHRS2) is None


def told(made: BuiltinFleet, number: int) -> SimpleNamespace:
    found = build_message(made._fleet, made._fleet.vehicles[2], number)
    assert found is not None
    return SimpleNamespace(**message_fields(found))


def test_frames_and_units() -> None:
    made = engine()
    fleet = made._fleet
    e, f = fleet.estimate[2], fleet.flight[2]
    attitude = told(made, A.MAVLINK_MSG_ID_ATTITUDE)
    assert (attitude.roll, attitude.pitch) == pytest.approx((e["roll"], -e["pitch"]))
    assert attitude.yaw == pytest.approx((math.pi / 2 - e["yaw"] + math.pi) % (2 * math.pi) - math.pi)
    assert attitude.time_boot_ms == 123_456
    quaternion = told(made, A.MAVLINK_MSG_ID_ATTITUDE_QUATERNION)
    q1, q2, q3, q4 = quaternion.q1, quaternion.q2, quaternion.q3, quaternion.q4
    assert math.atan2(2 * (q1 * q2 + q3 * q4), 1 - 2 * (q2 * q2 + q3 * q3)) == pytest.approx(attitude.roll, abs=1e-5)
    assert math.asin(2 * (q1 * q3 - q4 * q2)) == pytest.approx(attitude.pitch, abs=1e-5)
    assert math.atan2(2 * (q1 * q4 + q2 * q3), 1 - 2 * (q3 * q3 + q4 * q4)) == pytest.approx(attitude.yaw, abs=1e-5)
    raw = told(made, A.MAVLINK_MSG_ID_RAW_IMU)
    assert (raw.xacc, raw.yacc, raw.zacc) == tuple(
        int(s * v / 9.80665 * 1000) for s, v in zip((1, -1, -1), e["imu_accel"], strict=True)
    )
    assert (raw.xgyro, raw.ygyro) == (int(e["rate"][0] * 1000), int(-e["rate"][1] * 1000))
    assert raw.xmag == int(e["compass"][0] * 1000)  # mgauss
    pressure = told(made, A.MAVLINK_MSG_ID_SCALED_PRESSURE)
    height = 584.0 + float(e["baro_up"])
    assert pressure.press_abs == pytest.approx(1013.25 * (1 - 0.0065 * height / 288.15) ** 5.2559, rel=1e-5)
    gps = told(made, A.MAVLINK_MSG_ID_GPS_RAW_INT)
    lat, lon = ORIGIN.geodetic_of(*e["gnss_pos"][:2].tolist())
    assert (gps.lat, gps.lon) == pytest.approx((lat * 1e7, lon * 1e7), abs=1)
    assert gps.alt_ellipsoid - gps.alt == pytest.approx(19_000, abs=1)
    assert (gps.eph, gps.satellites_visible) == (int(e["gnss_hdop"] * 100), 9)
    assert (gps.h_acc, gps.v_acc, gps.vel_acc) == tuple(int(part * 1000) for part in e["gnss_acc"])
    nav = told(made, A.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT)
    away = f["target_pos"] - e["pos"]
    assert nav.wp_dist == int(math.hypot(away[0], away[1]))
    assert nav.alt_error == pytest.approx(f["ref_pos"][2] - e["pos"][2])
    # what it flies for, not what it is at: yaw 0.5 to the left of east, then nose down by 0.2, then right by 0.1
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(angle / 2), math.sin(angle / 2)) for angle in (0.1, 0.2, 0.5))
    fleet.flight["att_target"] = (
        cy * cp * cr + sy * sp * sr, cy * cp * sr - sy * sp * cr,
        cy * sp * cr + sy * cp * sr, sy * cp * cr - cy * sp * sr,
    )  # fmt: skip
    nav = told(made, A.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT)
    assert (nav.nav_roll, nav.nav_pitch) == pytest.approx((math.degrees(0.1), math.degrees(-0.2)))
    assert nav.nav_bearing == int(90 - math.degrees(0.5))
    target = told(made, A.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT)
    assert target.alt == pytest.approx(584.0 + f["target_pos"][2], abs=1e-3)
    assert target.type_mask == 0xFDF8  # only the position is said
    local = told(made, A.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED)
    place, moving, push = (f[name] for name in ("target_pos", "target_vel", "target_acc"))
    assert (local.x, local.y, local.z) == pytest.approx((place[1], place[0], -place[2]))
    assert (local.vx, local.afx, local.type_mask) == (0.0, 0.0, 0xDF8)
    for control, mask, said in (
        (ControlMode.POS_VEL_ACCEL, 0xC00, (place[1], moving[1], push[1])),
        (ControlMode.VELOCITY, 0xC07, (0.0, moving[1], push[1])),
        (ControlMode.ACCEL, 0xC3F, (0.0, 0.0, push[1])),
    ):
        fleet.flight["control"] = control
        local = told(made, A.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED)
        assert local.type_mask == mask, control
        assert (local.x, local.vx, local.afx) == pytest.approx(said), control
    fleet.flight["control"] = ControlMode.ATTITUDE  # no local target (send_position_target_local_ned)
    assert build_message(fleet, fleet.vehicles[2], A.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED) is None
    ekf = told(made, A.MAVLINK_MSG_ID_EKF_STATUS_REPORT)
    assert ekf.flags == 831
    assert (ekf.velocity_variance, ekf.compass_variance) == pytest.approx((e["vel_ratio"], e["mag_ratio"]))


def test_outputs_home_and_origin() -> None:
    made = engine()
    fleet = made._fleet
    fleet.actuators[2] = (0.0, 0.25, 0.5, 1.0)
    servo = told(made, A.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW)
    assert [servo.servo1_raw, servo.servo2_raw, servo.servo3_raw, servo.servo4_raw, servo.servo5_raw] == [
        1000, 1250, 1500, 2000, 0,
    ]  # fmt: skip
    fleet.rotor_speeds = np.tile((0.0, 100.0, 100.0, 200.0), (COUNT, 1))
    esc = build_message(fleet, fleet.vehicles[2], A.MAVLINK_MSG_ID_ESC_TELEMETRY_1_TO_4)
    assert esc is not None
    assert list(esc.rpm) == [0, 954, 954, 1909]  # 60 / 2π
    amperes = float(fleet.battery["current"][2])
    assert list(esc.current) == [int(amperes * 100 * share) for share in (0.0, 0.1, 0.1, 0.8)]  # as the cube: 1, 1, 8
    assert esc.voltage[0] == int(fleet.battery["voltage"][2] * 100)
    origin = told(made, A.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN)
    assert (origin.latitude, origin.longitude, origin.altitude) == (-353633280, 1491652241, 584_000)
    fleet.assign_home(fleet.vehicles[2], (100.0, -50.0, 7.0))
    home = told(made, A.MAVLINK_MSG_ID_HOME_POSITION)
    assert (home.x, home.y, home.z, home.altitude) == (-50.0, 100.0, -7.0, 591_000)


def test_battery_fence_and_failsafe() -> None:
    made = engine()
    fleet = made._fleet
    assert build_message(fleet, fleet.vehicles[2], A.MAVLINK_MSG_ID_FENCE_STATUS) is None
    status = told(made, A.MAVLINK_MSG_ID_SYS_STATUS)  # there, not in force, and well: AC_Fence.cpp, `sys_status_…`
    assert status.onboard_control_sensors_present & A.MAV_SYS_STATUS_GEOFENCE
    assert not status.onboard_control_sensors_enabled & A.MAV_SYS_STATUS_GEOFENCE
    assert status.onboard_control_sensors_health & A.MAV_SYS_STATUS_GEOFENCE
    fleet.fence["enabled"], fleet.fence["breached"], fleet.fence["count"] = 7, 1, 2
    fence = told(made, A.MAVLINK_MSG_ID_FENCE_STATUS)
    assert (fence.breach_status, fence.breach_count, fence.breach_type) == (1, 2, A.FENCE_BREACH_MAXALT)
    status = told(made, A.MAVLINK_MSG_ID_SYS_STATUS)
    assert status.onboard_control_sensors_enabled & A.MAV_SYS_STATUS_GEOFENCE
    assert not status.onboard_control_sensors_health & A.MAV_SYS_STATUS_GEOFENCE
    assert told(made, A.MAVLINK_MSG_ID_HEARTBEAT).system_status == A.MAV_STATE_ACTIVE
    fleet.checks["ekf_failsafe"] = 1
    assert told(made, A.MAVLINK_MSG_ID_HEARTBEAT).system_status == A.MAV_STATE_CRITICAL
    fleet.battery["voltage"], fleet.battery["current"], fleet.battery["consumed_mah"] = 11.1, 22.0, 1234.0
    fleet.battery["consumed_wh"], fleet.battery["level"] = 13.0, 2
    battery = build_table(fleet, A.MAVLINK_MSG_ID_BATTERY_STATUS, np.array([2]))[0]
    assert battery["voltages"].tolist() == [11_100, *[65_535] * 9]
    assert (battery["current_battery"], battery["current_consumed"], battery["energy_consumed"]) == (2200, 1234, 468)
    assert (battery["battery_remaining"], battery["charge_state"]) == (63, A.MAV_BATTERY_CHARGE_STATE_LOW)


def test_a_lost_receiver_and_a_doubting_estimator_show_in_health() -> None:
    made = engine()
    fleet = made._fleet
    healthy = told(made, A.MAVLINK_MSG_ID_SYS_STATUS).onboard_control_sensors_health
    assert healthy & A.MAV_SYS_STATUS_SENSOR_GPS
    fleet.estimate["gnss_age_s"] = 5.0
    fleet.estimate["vel_ratio"] = fleet.estimate["pos_ratio"] = fleet.estimate["hgt_ratio"] = 1.5
    doubting = told(made, A.MAVLINK_MSG_ID_SYS_STATUS).onboard_control_sensors_health
    assert not doubting & (A.MAV_SYS_STATUS_SENSOR_GPS | A.MAV_SYS_STATUS_AHRS)
    fleet.estimate["status"] = A.EKF_ATTITUDE
    assert build_message(fleet, fleet.vehicles[2], A.MAVLINK_MSG_ID_LOCAL_POSITION_NED) is None


def test_the_operators_streams() -> None:
    """What QGroundControl asks for, counted over ten seconds of hovering: rates by stream, frames and bytes."""
    r = Range([VehicleSpec(V, 3)])
    r.take_off(V, 5.0)
    for stream, rate in OPERATOR.streams:
        r.send(V, A.MAVLink_request_data_stream_message(3, 1, stream, rate, 1))
    for number, rate_hz in OPERATOR.messages:
        assert r.command(V, A.MAV_CMD_SET_MESSAGE_INTERVAL, number, 1e6 / rate_hz) == 0
    r.run(1.0)
    before, frames = len(r.said), len(r.frames[V])
    r.run(10.0)
    seen = Counter(said.message.get_type() for said in r.said[before:])
    rates = {
        1: ("HEARTBEAT", "HOME_POSITION", "EXTENDED_SYS_STATE"),
        2: ("SYS_STATUS", "RAW_IMU", "SCALED_IMU3", "MCU_STATUS", "MEMINFO", "RC_CHANNELS"),
        3: ("GLOBAL_POSITION_INT", "EKF_STATUS_REPORT"),
        10: ("ATTITUDE", "AHRS2", "VFR_HUD", "ESC_TELEMETRY_1_TO_4"),
    }
    for rate, kind in ((rate, kind) for rate, kinds in rates.items() for kind in kinds):
        assert seen[kind] == pytest.approx(rate * 10, abs=1), kind
    per_second = sum(seen.values()) / 10
    size = sum(len(payload) for payload in r.frames[V][frames:]) / 10
    assert 101 <= per_second <= 107
    assert 2_900 <= size <= 4_200  # more in flight and with noise, which leaves fewer zeros to cut


def test_an_aircrafts_frames_keep_order_and_numbers() -> None:
    made = engine()
    fleet = made._fleet
    fleet.now = 0
    for vehicle in fleet.vehicles:
        every = SimpleNamespace(start_stop=1, req_message_rate=10, req_stream_id=0)
        schedule.on_request_data_stream(fleet, made._schedule, vehicle, every)
    fleet.outbox = Outbox()
    for _ in range(30):
        fleet.now += 10_000_000
        made._schedule.send_due(fleet)
    order = list(BUILDERS)
    by_craft: dict[int, list[object]] = {}
    for departure in fleet.outbox.each(made.ports):
        by_craft.setdefault(made.ports.index(departure.port), []).append(decode(departure.payload))
    assert len(by_craft) == COUNT
    for row, heard in by_craft.items():
        assert {m.get_srcSystem() for m in heard} == {row + 1}  # type: ignore[attr-defined]
        assert [m.get_seq() for m in heard] == [place % 256 for place in range(len(heard))]  # type: ignore[attr-defined]
        half = [order.index(m.get_msgId()) for m in heard[: len(heard) // 3]]  # type: ignore[attr-defined]
        assert half == sorted(half)


def test_copies_of_a_fleet_number_their_frames_alike() -> None:
    made = engine()
    other = copy.deepcopy(made)
    made._fleet.send_text(made._fleet.vehicles[1], 6, "one more")
    assert made._fleet.sequences[1] == 1
    assert other._fleet.sequences[1] == 0
    assert other._fleet.vehicles[1].packer.sequence == 0
    other._fleet.vehicles[1].packer.sequence = 9
    assert other._fleet.sequences[1] == 9


def test_streams_hold_only_what_can_be_sent() -> None:
    for _, messages in schedule.STREAMS.values():
        assert set(messages) <= set(BUILDERS)
    assert set(AVAILABLE) <= set(BUILDERS)


@pytest.mark.parametrize(("rate", "period_ms"), [(0, 0), (3, 333), (10, 100), (50, 20), (400, 3), (1001, 0)])
def test_intervals_of_rates_are_whole_milliseconds(rate: int, period_ms: int) -> None:
    assert schedule.interval_ns(rate) == period_ms * 1_000_000
