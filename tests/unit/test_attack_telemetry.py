"""Alterations of telemetry by hand: fields, bytes, checksums, and parameters that cannot be."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import replace
from math import radians
from typing import Any

import pytest
from pydantic import ValidationError

from skyrange.assembly.acts.attacks import make_attack_context
from skyrange.assembly.build import build
from skyrange.attack.bases.mavlink.message_fields import read_fields, write_fields
from skyrange.attack.contract import AttackContext, AttackPlugin
from skyrange.codec.mavlink import Message, Packer, decode, dialect, message_name
from skyrange.codec.mavlink.flight_modes import COPTER_MODE_NUMBERS
from skyrange.codec.mavlink.signing import (
    SignatureRefusal,
    Signer,
    SigningKey,
    range_passphrase,
    secret_from_passphrase,
    sign_frame,
    signing_timestamp,
)
from skyrange.contracts.components import Tap
from skyrange.contracts.frames import Frame
from skyrange.contracts.links import Schedule
from skyrange.contracts.verdicts import Inject, Replace
from skyrange.core.errors import InputError
from skyrange.core.time import NEVER, NS_PER_S
from skyrange.testing.checks.attacks import two_squares

SECOND_VEHICLE = AttackPlugin.find("identity.second_vehicle")
KEEP_ALIVE = AttackPlugin.find("identity.keep_alive")
STOLEN_KEY = AttackPlugin.find("signing.stolen_key")
ATTITUDE = AttackPlugin.find("telemetry.attitude")
BATTERY = AttackPlugin.find("telemetry.battery")
FALSE_ALARM = AttackPlugin.find("telemetry.false_alarm")
HIDE_FAILURES = AttackPlugin.find("telemetry.hide_failures")
HOME = AttackPlugin.find("telemetry.home")
MODE = AttackPlugin.find("telemetry.mode")
POSITION = AttackPlugin.find("telemetry.position")
SYSTEM_TIME = AttackPlugin.find("time.system_time")

LINK = "gcs:blue/b1"
START_NS = 10 * NS_PER_S


def context(sham: bool = False) -> AttackContext:
    built = build(two_squares(20.0))
    made = make_attack_context(built.scenario, built.wiring.links, built.city)
    return replace(made, id="a", schedule=Schedule(START_NS, NEVER), sham=sham)


def tap_of(kind: AttackPlugin, params: Mapping[str, Any], sham: bool = False, link: str = LINK) -> Tap:
    attack = kind(kind.params.model_validate({"links": [link], **params}), context(sham))
    return attack.taps[0].make(link)


def frame_of(payload: bytes, direction: str = "rev", link: str = LINK) -> Frame:
    return Frame(link, direction, "x", 0, "x", "y", sent_ns=0, payload=payload)


def sent(message: Message) -> bytes:
    """As the autopilot of blue/b1 sends it."""
    return Packer(1, 1).pack(message)


def altered(tap: Tap, message: Message, after_s: float = 2.0) -> Message:
    """The message that leaves the tap, some time after the start."""
    verdicts = tap.on_frame(START_NS + round(after_s * NS_PER_S), frame_of(sent(message)))
    (verdict,) = verdicts
    assert isinstance(verdict, Replace)
    found = decode(verdict.payload)  # its checksum fits
    assert (found.get_srcSystem(), found.get_srcComponent(), type(found)) == (1, 1, type(message))
    return found


def place(east_m: float, north_m: float, up_m: float) -> tuple[int, int, int]:
    """1e-7 degrees and millimetres above sea level."""
    origin = context().origin
    lat, lon = origin.geodetic_of(east_m, north_m)
    return round(lat * 1e7), round(lon * 1e7), round((origin.alt_msl_m + up_m) * 1e3)


def position(east_m: float, north_m: float, up_m: float) -> Message:
    lat, lon, alt = place(east_m, north_m, up_m)
    return dialect.MAVLink_global_position_int_message(1000, lat, lon, alt, round(up_m * 1e3), 300, 400, 0, 9000)


def test_an_offset_moves_all_messages_that_tell_a_position_alike() -> None:
    tap = tap_of(POSITION, {"offset_m": [10.0, 20.0, 5.0], "drift_mps": [1.0, 0.0, 0.0]})
    moved = altered(tap, position(0.0, 0.0, 30.0))
    lat, lon, alt = place(12.0, 20.0, 35.0)  # 2 s of drift
    assert abs(moved.lat - lat) <= 1
    assert abs(moved.lon - lon) <= 1
    assert (moved.alt, moved.relative_alt) == (alt, 35_000)
    assert (moved.vx, moved.vy, moved.vz) == (300, 500, 0), "north, east, down in cm/s"
    lat, lon, alt = place(0.0, 0.0, 30.0)
    gps = dialect.MAVLink_gps_raw_int_message(1, 3, lat, lon, alt, 100, 100, 500, 0, 12, alt_ellipsoid=alt + 1000)
    seen = altered(tap, gps)
    assert (seen.lat, seen.lon, seen.alt) == (moved.lat, moved.lon, moved.alt)
    assert seen.alt_ellipsoid == seen.alt + 1000
    assert seen.vel == round((300**2 + 500**2) ** 0.5)
    assert seen.cog == 5904, "atan2(5, 3) in 0.01 degrees"
    local = altered(tap, dialect.MAVLink_local_position_ned_message(1000, 1.0, 2.0, -30.0, 3.0, 4.0, 0.0))
    assert (local.x, local.y, local.z, local.vx, local.vy) == (21.0, 14.0, -35.0, 3.0, 5.0)
    hud = altered(tap, dialect.MAVLink_vfr_hud_message(0.0, 5.0, 90, 40, 30.0, 0.0))
    assert hud.alt == 35.0
    assert hud.groundspeed == pytest.approx((3**2 + 5**2) ** 0.5, rel=1e-6)


def test_a_constant_offset_leaves_velocities_and_needs_no_other_message() -> None:
    tap = tap_of(POSITION, {"offset_m": [10.0, 0.0, 0.0]})
    lat, lon, alt = place(0.0, 0.0, 30.0)
    gps = altered(tap, dialect.MAVLink_gps_raw_int_message(1, 3, lat, lon, alt, 100, 100, 512, 77, 12))
    assert (gps.vel, gps.cog, gps.alt, gps.alt_ellipsoid) == (512, 77, alt, 0)
    assert abs(gps.lon - place(10.0, 0.0, 30.0)[1]) <= 1
    nowhere = altered(tap, dialect.MAVLink_gps_raw_int_message(1, 1, 0, 0, 0, 100, 100, 0, 0, 0))
    assert (nowhere.lat, nowhere.lon) == (0, 0), "no fix stays no fix"


def test_a_drift_upwards_is_in_every_velocity_that_tells_of_it() -> None:
    """1, 2 and 3 m/s east, north and up, of an aircraft that truly flies 3 m/s north and 4 east and sinks 0.5 m/s."""
    tap = tap_of(POSITION, {"offset_m": [0.0, 0.0, 5.0], "drift_mps": [1.0, 2.0, 3.0]})
    true = position(0.0, 0.0, 30.0)
    true.vz = 50
    moved = altered(tap, true)
    assert (moved.vx, moved.vy, moved.vz) == (500, 500, -250)
    local = altered(tap, dialect.MAVLink_local_position_ned_message(1000, 1.0, 2.0, -30.0, 3.0, 4.0, 0.5))
    assert (local.vx, local.vy, local.vz) == (5.0, 5.0, -2.5)
    hud = altered(tap, dialect.MAVLink_vfr_hud_message(0.0, 5.0, 90, 40, 30.0, -0.5))
    assert (hud.climb, hud.heading) == (2.5, 90)
    assert hud.groundspeed == pytest.approx(50.0**0.5)


def test_a_false_track_does_not_depend_on_the_aircraft() -> None:
    params = {"form": "track", "at": [100.0, 0.0, 50.0], "velocity_mps": [0.0, -2.0, 0.0]}
    for true in (position(0.0, 0.0, 30.0), position(40.0, 7.0, 10.0)):
        seen = altered(tap_of(POSITION, params), true)
        lat, lon, alt = place(100.0, -4.0, 50.0)
        assert abs(seen.lat - lat) <= 1
        assert abs(seen.lon - lon) <= 1
        assert abs(seen.alt - alt) <= 1
        assert (seen.vx, seen.vy, seen.hdg) == (-200, 0, 18_000)


def test_what_is_no_position_of_the_autopilot_passes() -> None:
    tap = tap_of(POSITION, {"offset_m": [10.0, 0.0, 0.0]})
    good = sent(position(0.0, 0.0, 30.0))
    now = START_NS + NS_PER_S
    assert not tap.on_frame(START_NS - 1, frame_of(good)), "before the start"
    assert not tap.on_frame(now, frame_of(good, "fwd"))
    assert not tap.on_frame(now, frame_of(good[:-1] + bytes([good[-1] ^ 1]))), "a wrong checksum"
    assert not tap.on_frame(now, frame_of(good[:-3]))
    assert not tap.on_frame(now, frame_of(Packer(2, 1).pack(position(0.0, 0.0, 30.0)))), "another system"
    assert not tap.on_frame(now, frame_of(Packer(1, 191).pack(position(0.0, 0.0, 30.0)))), "another component"
    assert not tap.on_frame(now, frame_of(sent(dialect.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0))))
    assert len(tap.on_frame(now, frame_of(good))) == 1


def test_the_sham_keeps_the_content_and_has_as_many_bytes() -> None:
    payload = sent(dialect.MAVLink_global_position_int_message(1, 1, 1, 1, 1, 0, 0, 0, 0))
    now = START_NS + NS_PER_S
    sizes = []
    for sham in (False, True):
        (verdict,) = tap_of(POSITION, {"drift_mps": [1.0, 1.0, 1.0]}, sham).on_frame(now, frame_of(payload))
        assert isinstance(verdict, Replace)
        sizes.append(len(verdict.payload))
        if sham:
            assert decode(verdict.payload).to_dict() == decode(payload).to_dict()
    assert sizes[0] == sizes[1] > len(payload), "trailing zeros of the velocity are no longer zeros"


def test_a_signed_frame_is_refused_once_it_is_altered_and_not_as_the_sham() -> None:
    key = SigningKey(secret_from_passphrase("x"), 0)
    payload = sign_frame(sent(position(0.0, 0.0, 30.0)), key.secret, 1, 5)
    for sham, refusal in ((False, SignatureRefusal.WRONG), (True, None)):
        tap = tap_of(POSITION, {"offset_m": [10.0, 0.0, 0.0]}, sham)
        (verdict,) = tap.on_frame(START_NS + NS_PER_S, frame_of(payload))
        assert isinstance(verdict, Replace)
        assert len(verdict.payload) == len(payload)
        decode(verdict.payload)
        assert Signer(key, 0).check(verdict.payload) is refusal


def test_a_frame_written_unaltered_is_the_same_to_the_byte() -> None:
    for message in (position(1.0, 2.0, 3.0), dialect.MAVLink_heartbeat_message(2, 3, 81, 5, 4, 3)):
        payload = sent(message)
        number = type(message).id
        assert write_fields(payload, number, read_fields(payload, number)) == payload


def heartbeat(status: int = dialect.MAV_STATE_ACTIVE) -> Message:
    armed = dialect.MAV_MODE_FLAG_SAFETY_ARMED | dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    return dialect.MAVLink_heartbeat_message(2, 3, armed, COPTER_MODE_NUMBERS["AUTO"], status, 3)


def test_mode_armed_state_and_mission() -> None:
    tap = tap_of(MODE, {"mode": "LAND", "armed": False, "mission": "runs", "item_s": 5.0})
    beat = altered(tap, heartbeat())
    assert (beat.custom_mode, beat.base_mode) == (9, dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)
    assert beat.system_status == dialect.MAV_STATE_STANDBY
    current = dialect.MAVLink_mission_current_message(2, 6, dialect.MISSION_STATE_PAUSED, 1)
    assert not tap.on_frame(START_NS - 1, frame_of(sent(current)))
    later = dialect.MAVLink_mission_current_message(0, 6, dialect.MISSION_STATE_PAUSED, 1)
    for after_s, item in ((0.0, 2), (4.9, 2), (5.0, 3), (60.0, 6)):
        seen = altered(tap, later, after_s)
        assert (seen.seq, seen.mission_state) == (item, dialect.MISSION_STATE_ACTIVE)
    done = altered(tap_of(MODE, {"mission": "complete"}), current)
    assert (done.seq, done.mission_state) == (6, dialect.MISSION_STATE_COMPLETE)


def test_battery() -> None:
    tap = tap_of(BATTERY, {"remaining_percent": 20.0, "rate_percent_per_s": -2.0, "voltage_v": 9.5})
    status = altered(tap, dialect.MAVLink_sys_status_message(0, 0, 0, 0, 12_600, 100, 90, 0, 0, 0, 0, 0, 0))
    assert (status.voltage_battery, status.battery_remaining) == (9500, 16)
    cells = [4000, 4000, 2000] + [65_535] * 7
    pack = dialect.MAVLink_battery_status_message(0, 0, 1, 300, cells, 100, 500, 0, 90)
    seen = altered(tap, pack)
    assert list(seen.voltages) == [3800, 3800, 1900] + [65_535] * 7
    assert (seen.battery_remaining, seen.current_consumed) == (16, 4200), "500 mAh were 10 %, so 84 % are 4200 mAh"
    assert seen.charge_state == dialect.MAV_BATTERY_CHARGE_STATE_LOW
    assert altered(tap, pack, 60.0).battery_remaining == 0


def test_failures_are_hidden_and_invented() -> None:
    hiding = tap_of(HIDE_FAILURES, {})
    assert altered(hiding, heartbeat(dialect.MAV_STATE_CRITICAL)).system_status == dialect.MAV_STATE_ACTIVE
    health = altered(hiding, dialect.MAVLink_sys_status_message(63, 47, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0))
    assert health.onboard_control_sensors_health == 47
    text = altered(hiding, dialect.MAVLink_statustext_message(dialect.MAV_SEVERITY_CRITICAL, b"Fence breach"))
    assert (text.text, text.severity) == ("", dialect.MAV_SEVERITY_DEBUG)
    quiet = dialect.MAVLink_statustext_message(dialect.MAV_SEVERITY_INFO, b"hello")
    assert altered(hiding, quiet).text == "hello"
    alarm = tap_of(FALSE_ALARM, {"sensors": ["GPS"]})
    assert altered(alarm, heartbeat()).system_status == dialect.MAV_STATE_CRITICAL
    sick = altered(alarm, dialect.MAVLink_sys_status_message(63, 63, 63, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0))
    assert sick.onboard_control_sensors_health == 63 & ~dialect.MAV_SYS_STATUS_SENSOR_GPS


def test_attitude_home_and_time() -> None:
    tap = tap_of(ATTITUDE, {"roll_deg": 20.0, "yaw_deg": 100.0})
    seen = altered(tap, dialect.MAVLink_attitude_message(0, 0.1, 0.2, 3.0, 0, 0, 0))
    assert seen.roll == pytest.approx(0.1 + radians(20), abs=1e-6)
    assert seen.yaw == pytest.approx(3.0 + radians(100) - 2 * radians(180), abs=1e-6)
    level = altered(tap, dialect.MAVLink_attitude_quaternion_message(0, 1.0, 0.0, 0.0, 0.0, 0, 0, 0))
    turn = (
        level.q1,
        level.q2,
        level.q3,
        level.q4,
    )  # products of cosines and sines of 10° and 50°
    assert turn == pytest.approx((0.633022, 0.111619, 0.133022, 0.754407), abs=1e-6)
    assert altered(tap, position(0.0, 0.0, 1.0)).hdg == 19_000
    lat, lon, alt = place(3.0, 4.0, 0.0)
    home = altered(tap_of(HOME, {"offset_m": [-3.0, -4.0, 2.0]}), home_at(lat, lon, alt))
    assert (abs(home.latitude - place(0, 0, 0)[0]) <= 1, home.altitude) == (True, alt + 2000)
    clock = tap_of(SYSTEM_TIME, {"offset_s": -300.0, "drift_s_per_s": 0.5})
    assert altered(clock, dialect.MAVLink_system_time_message(10**15, 5)).time_unix_usec == 10**15 - 299 * 10**6
    assert altered(clock, dialect.MAVLink_timesync_message(10**12, 7)).tc1 == 10**12 - 299 * 10**9
    unknown = frame_of(sent(dialect.MAVLink_system_time_message(0, 5)))
    assert not clock.on_frame(START_NS + NS_PER_S, unknown), "an unknown time stays unknown"


def home_at(lat: int, lon: int, alt: int) -> Message:
    return dialect.MAVLink_home_position_message(lat, lon, alt, 0, 0, 0, (1, 0, 0, 0), 0, 0, 0)


def test_a_second_vehicle_waits_until_it_has_heard_the_first() -> None:
    params = {"at": [50.0, 60.0, 20.0], "velocity_mps": [2.0, 0.0, 0.0], "mode": "LAND", "armed": False}
    tap, sham = tap_of(SECOND_VEHICLE, params), tap_of(SECOND_VEHICLE, params, sham=True)
    assert not tap.on_wakeup(START_NS)
    for one in (tap, sham):
        for message in (heartbeat(), position(0.0, 0.0, 10.0)):
            assert not one.on_frame(START_NS, frame_of(sent(message)))
    verdicts = tap.on_wakeup(START_NS + NS_PER_S)
    benign = sham.on_wakeup(START_NS + NS_PER_S)
    beat, where = (decode(one.payload) for one in verdicts if isinstance(one, Inject))
    assert (beat.custom_mode, beat.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED) == (9, 0)
    lat, lon, alt = place(52.0, 60.0, 20.0)
    assert (abs(where.lat - lat) <= 1, abs(where.lon - lon) <= 1, where.alt) == (True, True, alt)
    assert (where.relative_alt, where.vy) == (20_000, 200)
    assert [len(v.payload) for v in verdicts if isinstance(v, Inject)] == [
        len(v.payload) for v in benign if isinstance(v, Inject)
    ]
    copied = copy.deepcopy(tap)
    assert copied.on_wakeup(START_NS + 2 * NS_PER_S) == tap.on_wakeup(START_NS + 2 * NS_PER_S)


def test_the_sham_of_a_kept_station_has_its_name_and_no_heartbeat() -> None:
    (beat,), (other,) = (
        [one.payload for one in tap_of(KEEP_ALIVE, {}, sham=sham).on_wakeup(START_NS) if isinstance(one, Inject)]
        for sham in (False, True)
    )
    assert (message_name(beat), message_name(other)) == ("HEARTBEAT", "ENCAPSULATED_DATA")
    assert (len(beat), beat[4:7]) == (len(other), other[4:7]), "the same length, sequence number and sender"


def test_a_stolen_key_signs_what_the_aircraft_accepts_and_a_guessed_one_does_not() -> None:
    initial = signing_timestamp(context().epoch.unix_ns)
    key = SigningKey(secret_from_passphrase(range_passphrase(7, "blue")), initial)
    aircraft = Signer(key, 1)
    aircraft.start(0)
    for params, refusal in (({}, None), ({"passphrase": "guessed"}, SignatureRefusal.WRONG)):
        tap = tap_of(STOLEN_KEY, params)
        late = sign_frame(sent(heartbeat()), key.secret, 0, initial + 10**9)
        tap.on_frame(START_NS - 1, frame_of(late))
        (verdict,) = tap.on_wakeup(START_NS)
        assert isinstance(verdict, Inject)
        order = decode(verdict.payload)
        assert order.command == dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH
        assert (order.get_srcSystem(), order.target_system) == (255, 1)
        assert int.from_bytes(verdict.payload[-12:-6], "little") == initial + 10**9 + 1, "later than all that passed"
        assert aircraft.check(verdict.payload) is refusal


@pytest.mark.parametrize(
    ("kind", "params", "match"),
    [
        (POSITION, {"form": "track"}, "at"),
        (POSITION, {"at": [0.0, 0.0, 1.0]}, "offset_m"),
        (POSITION, {}, "offset or a drift"),
        (MODE, {}, "a claim"),
        (MODE, {"mode": "AUTTO"}, "AUTO"),
        (BATTERY, {}, "a claim"),
        (BATTERY, {"voltage_v": 9.0, "rate_percent_per_s": 1.0}, "remaining_percent"),
        (FALSE_ALARM, {"sensors": ["GSP"]}, "GPS"),
        (ATTITUDE, {}, "offset"),
        (SYSTEM_TIME, {}, "offset"),
    ],
)
def test_parameters_that_claim_nothing_are_refused(kind: AttackPlugin, params: Mapping[str, Any], match: str) -> None:
    with pytest.raises(ValidationError, match=match):
        kind.params.model_validate({"links": [LINK], **params})


@pytest.mark.parametrize(
    ("kind", "links", "params"),
    [
        (HIDE_FAILURES, ["gcs:blue/b9"], {}),
        (HIDE_FAILURES, ["approval:*"], {}),
        (SECOND_VEHICLE, ["rid_data:blue/b1"], {"at": [0.0, 0.0, 1.0]}),
    ],
)
def test_links_without_that_telemetry_are_refused(
    kind: AttackPlugin, links: list[str], params: Mapping[str, Any]
) -> None:
    with pytest.raises(InputError, match=r"links\.0.*a link of the scenario"):
        kind(kind.params.model_validate({"links": links, **params}), context())


def test_a_frame_is_not_altered_twice() -> None:
    scenario = two_squares(5.0)
    built = build(scenario)
    context = replace(make_attack_context(built.scenario, built.wiring.links, built.city), id="checked")
    params = POSITION.params.model_validate({"links": ["log:blue/b1", "autopilot:*"], "offset_m": [1.0, 0.0, 0.0]})
    with pytest.raises(InputError, match="not both"):
        POSITION(params, context)
