"""What is broadcast, how often and when: 14 CFR 89.305 and 89.310, F3411-22a; made of belief alone."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest

from skyrange.codec import f3411
from skyrange.codec.f3411 import MessageType, Status
from skyrange.codec.mavlink import Packer
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.remote_id import link_payload
from skyrange.codec.remote_id.link_payload import RidFrame, Transport
from skyrange.contracts.frames import Payloads
from skyrange.core.chance import Chance
from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.remoteid.autopilot_belief import Beliefs
from skyrange.remoteid.broadcast_profiles import US_PERIOD_NS, Broadcast, sender_address, serial_number
from skyrange.remoteid.broadcaster import ARM_STATUS_TEXTS, LEAD_NS, Broadcaster

UTC_US = 1_767_323_045_000_000  # 2026-01-02T03:04:05Z
STATION = (40.7, -73.9, -20.0)
ARMED = mav.MAV_MODE_FLAG_SAFETY_ARMED


class Aircraft:
    """Beliefs and broadcaster of a few aircraft, fed with MAVLink."""

    def __init__(self, *broadcasts: Broadcast, seed: int = 1) -> None:
        self.beliefs = Beliefs(np.arange(1, len(broadcasts) + 1))
        self.broadcaster = Broadcaster(broadcasts, Chance(seed))
        self.packers = [Packer(place + 1, 1) for place in range(len(broadcasts))]

    def tell(self, now: Time, *messages: Any, place: int = 0, packer: Packer | None = None) -> None:
        frames = Payloads.of([(packer or self.packers[place]).pack(message) for message in messages])
        count = len(messages)
        self.beliefs.update(np.full(count, place), np.full(count, now), frames)

    def all_is_well(self, now: Time, place: int = 0, **place_fields: Any) -> None:
        self.tell(now, beat(), system_time(now), gps(), position(now, **place_fields), home(), place=place)

    def sent(self, until: Time, step: Time = 10 * NS_PER_MS, well: bool = True) -> list[tuple[Time, int, RidFrame]]:
        """All broadcasts up to a time, looked for every 10 ms; `well`: told everything once a second."""
        found = []
        for now in range(0, until, step):
            if well and now % NS_PER_S == 0:
                for place in range(len(self.packers)):
                    self.all_is_well(now, place)
            out = self.broadcaster.send(now, self.beliefs)
            if out is not None:
                found += [(now, p, link_payload.unpack(raw)) for p, raw in zip(out[0].tolist(), out[1], strict=True)]
        return found


def beat(state: int = mav.MAV_STATE_ACTIVE, armed: bool = True, mode: int = 3) -> Any:
    return mav.MAVLink_heartbeat_message(2, 3, ARMED if armed else 0, mode, state, 3)


def system_time(now: Time) -> Any:
    return mav.MAVLink_system_time_message(UTC_US + now // 1000, now // 1_000_000)


def gps(fix: int = 3, **more: int) -> Any:
    fields = {"alt_ellipsoid": -20_500, "h_acc": 900, "v_acc": 2_500, "vel_acc": 200} | more
    return mav.MAVLink_gps_raw_int_message(0, fix, 0, 0, 12_000, 100, 100, 0, 0, 10, **fields)


def position(now: Time, **more: int) -> Any:
    fields = {
        "lat": 407_780_000, "lon": -739_550_000, "alt": 62_000, "relative_alt": 50_000, "vx": 300, "vy": -400,
        "vz": -100,
    } | more  # fmt: skip
    return mav.MAVLink_global_position_int_message(now // 1_000_000, **fields, hdg=0)


def home() -> Any:
    return mav.MAVLink_home_position_message(407_770_000, -739_560_000, 12_000, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0)


def messages(frame: RidFrame) -> dict[type, Any]:
    said = f3411.decode(frame.body)
    parts = said.messages if isinstance(said, f3411.MessagePack) else (said,)
    return {type(part): part for part in parts}


def of(aircraft: Aircraft, now: Time = 0) -> f3411.Location:
    """The Location that it would send now."""
    twin = copy.deepcopy(aircraft)
    twin.broadcaster.due_ns[:] = now
    out = twin.broadcaster.send(now, twin.beliefs)
    assert out is not None
    found: f3411.Location = messages(link_payload.unpack(out[1][0]))[f3411.Location]
    return found


def test_us_profile_sends_every_element_of_89_305_each_second() -> None:
    aircraft = Aircraft(Broadcast("blue/b1", operator_place=STATION))
    sent = aircraft.sent(10 * NS_PER_S)
    times = np.diff([now for now, _, _ in sent])
    assert len(sent) in (10, 11)
    # 89.310(h)(3): at least one message a second, and 10 ms to spare for a Bluetooth advertisement's random delay
    assert (times == US_PERIOD_NS).all()
    assert US_PERIOD_NS <= NS_PER_S - 10 * NS_PER_MS
    for now, _, frame in sent[1:]:
        said = messages(frame)
        basic, location, system = said[f3411.BasicId], said[f3411.Location], said[f3411.System]
        assert f3411.deviations(f3411.decode(frame.body)) == ()
        assert basic.id_type == f3411.IdType.SERIAL_NUMBER  # (a)
        assert basic.uas_id == serial_number("blue/b1")
        assert f3411.is_serial_number(basic.uas_id)
        assert (system.operator_lat_deg, system.operator_lon_deg) == pytest.approx(STATION[:2])  # (b)
        assert system.operator_alt_geo_m == STATION[2]  # (c)
        assert (location.lat_deg, location.lon_deg) == (40.778, -73.955)  # (d)
        # (e): 62 m above the sea, where the receiver says that the ellipsoid is 32.5 m above it
        assert location.alt_geo_m == 62.0 - 32.5
        assert (location.speed_mps, location.track_deg, location.vertical_mps) == (5.0, 307.0, 1.0)  # (f)
        measured = now // NS_PER_S  # told at full seconds
        assert location.timestamp_s == pytest.approx(4 * 60 + 5 + measured)  # (g)
        assert system.timestamp_s == UTC_US // 10**6 + measured - f3411.EPOCH_2019_S
        assert location.status == Status.AIRBORNE  # (h)
        assert (location.height_m, location.height_type) == (50.0, 0)
        assert (location.horizontal_accuracy, location.vertical_accuracy, location.speed_accuracy) == (12, 5, 4)


def test_header_of_a_broadcast() -> None:
    aircraft = Aircraft(Broadcast("blue/b1", operator_place=STATION))
    sent = aircraft.sent(4 * US_PERIOD_NS)
    assert len(sent) == 4
    due = sent[0][2].header.time_ns
    for count, (now, _, frame) in enumerate(sent):
        at_ns = due + count * US_PERIOD_NS  # when the radio is to send it, to the nanosecond
        assert frame.header == link_payload.RidHeader(
            Transport.WIFI_BEACON,
            link_payload.ANY_CHANNEL,
            count,
            sender_address("blue/b1"),
            link_payload.NO_RSSI,
            at_ns,
        )
        assert 0 < at_ns - now <= LEAD_NS
    first = sender_address("blue/b1")[0]
    assert first & 0b11000011 == 0b11000010  # locally administered unicast, and random static
    assert sender_address("blue/b1") != sender_address("blue/b2")


@pytest.mark.parametrize(
    ("state", "armed", "status"),
    [
        (mav.MAV_STATE_STANDBY, False, Status.GROUND),
        (mav.MAV_STATE_STANDBY, True, Status.GROUND),
        (mav.MAV_STATE_ACTIVE, True, Status.AIRBORNE),
        (mav.MAV_STATE_CRITICAL, True, Status.EMERGENCY),
        (mav.MAV_STATE_EMERGENCY, True, Status.EMERGENCY),
        (mav.MAV_STATE_CRITICAL, False, Status.GROUND),
    ],
)
def test_emergency_status(state: int, armed: bool, status: int) -> None:
    aircraft = Aircraft(Broadcast("blue/b1"))
    aircraft.all_is_well(0)
    aircraft.tell(0, beat(state, armed))
    assert of(aircraft).status == status


def test_a_silent_autopilot_is_a_failure_and_the_time_mark_stays_old() -> None:
    aircraft = Aircraft(Broadcast("blue/b1"))
    aircraft.all_is_well(0)
    fresh, old = of(aircraft, 2 * NS_PER_S), of(aircraft, 9 * NS_PER_S)
    assert fresh.status == Status.AIRBORNE
    assert old.status == Status.REMOTE_ID_SYSTEM_FAILURE
    assert (old.timestamp_s, old.lat_deg) == (fresh.timestamp_s, fresh.lat_deg)


def test_what_is_not_known_is_said_to_be_unknown() -> None:
    aircraft = Aircraft(Broadcast("blue/b1"))
    aircraft.tell(0, beat())
    location = of(aircraft)
    assert (location.lat_deg, location.alt_geo_m, location.speed_mps, location.timestamp_s) == (None,) * 4
    aircraft.tell(0, position(0))
    assert of(aircraft).lat_deg is not None
    assert of(aircraft).alt_geo_m is None  # no receiver has told the geoid
    aircraft.tell(0, gps(fix=1))
    assert of(aircraft).alt_geo_m is None
    aircraft.tell(0, gps(h_acc=0), position(0, vx=3, vy=3))
    location = of(aircraft)
    assert location.alt_geo_m is not None
    assert location.horizontal_accuracy == 0
    assert (location.speed_mps, location.track_deg) == (0.0, None)


def test_a_deceived_autopilot_broadcasts_the_deception() -> None:
    aircraft = Aircraft(Broadcast("blue/b1"))
    aircraft.all_is_well(0, lat=407_790_000)
    assert of(aircraft).lat_deg == 40.779


def test_nothing_is_sent_before_the_autopilot_is_heard_and_strangers_are_not_believed() -> None:
    aircraft = Aircraft(Broadcast("blue/b1"))
    assert aircraft.sent(3 * NS_PER_S, well=False) == []
    for packer in (Packer(9, 1), Packer(1, 190)):
        aircraft.tell(0, beat(), position(0), packer=packer)
    assert aircraft.beliefs.table["bad"][0] == 4
    assert aircraft.beliefs.table["heartbeat_ns"][0] == -1
    aircraft.beliefs.update(np.zeros(2, dtype=np.int64), np.zeros(2, dtype=np.int64), Payloads.of([b"", b"\xfd" * 40]))
    assert aircraft.beliefs.table["bad"][0] == 6


def test_of_two_reports_in_one_step_the_later_counts() -> None:
    aircraft = Aircraft(Broadcast("blue/b1"))
    aircraft.tell(0, beat(), position(0, lat=1), position(5_000_000, lat=2))
    assert aircraft.beliefs.table["lat_e7"][0] == 2


def own(**more: Any) -> Any:
    """As ArduPilot says where it is: whole m/s, and the time by GPS."""
    fields = {
        "status": 2, "direction": 30_712, "speed_horizontal": 500, "speed_vertical": 100, "latitude": 407_781_234,
        "longitude": -739_551_234, "altitude_barometric": 61.5, "altitude_geodetic": 62.0, "height_reference": 0,
        "height": 49.0, "horizontal_accuracy": 11, "vertical_accuracy": 4, "barometer_accuracy": 0,
        "speed_accuracy": 3, "timestamp": 263.25, "timestamp_accuracy": 10,
    } | more  # fmt: skip
    return mav.MAVLink_open_drone_id_location_message(0, 0, [0] * 20, **fields)


def test_an_autopilots_own_location_is_broadcast_as_it_is_while_it_says_one() -> None:
    aircraft = Aircraft(Broadcast("blue/b1", operator_place=STATION, autopilot_location=True))
    aircraft.all_is_well(0)
    believed = of(aircraft)
    assert believed.lat_deg == 40.778  # none was said yet
    aircraft.tell(0, own())
    assert of(aircraft) == f3411.Location(
        Status.AIRBORNE, 40.7781234, -73.9551234, 62.0, 61.5, 49.0, 0, 5.0, 1.0, 307.0, 11, 4, 0, 3, 10, 263.2, 2
    )
    aircraft.tell(NS_PER_S, own(status=3))
    aircraft.all_is_well(3 * NS_PER_S)
    assert of(aircraft, 3 * NS_PER_S).status == Status.EMERGENCY
    assert of(aircraft, 3 * NS_PER_S + 1).lat_deg == 40.778  # older than 2 s is none
    assert of(aircraft, 9 * NS_PER_S).status == Status.REMOTE_ID_SYSTEM_FAILURE


def test_an_own_location_that_nobody_asked_for_is_not_broadcast() -> None:
    aircraft = Aircraft(Broadcast("blue/b1", operator_place=STATION))
    aircraft.all_is_well(0)
    aircraft.tell(0, own())
    assert of(aircraft).lat_deg == 40.778


def test_an_own_location_depends_on_nobody_else() -> None:
    aircraft = Aircraft(*(Broadcast(f"blue/b{n}", autopilot_location=n == 1, operator_place=STATION) for n in range(3)))
    for place in range(3):
        aircraft.all_is_well(0, place)
        aircraft.tell(0, own(), place=place)
    aircraft.broadcaster.due_ns[:] = 0
    out = aircraft.broadcaster.send(0, aircraft.beliefs)
    assert out is not None
    said = {place: messages(link_payload.unpack(raw))[f3411.Location] for place, raw in zip(*out, strict=True)}
    assert {place: location.lat_deg for place, location in said.items()} == {0: 40.778, 1: 40.7781234, 2: 40.778}


@pytest.mark.parametrize(
    ("lacks", "words"),
    [
        ({"latitude": 0, "longitude": 0}, "LOC: no position"),
        ({"altitude_geodetic": -1000.0}, "LOC: no ellipsoid height"),
        ({"timestamp": 65_535.0}, "LOC: no time"),
        ({}, ""),
    ],
)
def test_troubles_of_an_own_location_are_its_own(lacks: dict[str, Any], words: str) -> None:
    aircraft = Aircraft(Broadcast("blue/b1", operator_place=STATION, autopilot_location=True))
    aircraft.tell(0, beat(), gps(alt_ellipsoid=0), own(**lacks))  # no position, height or time of any other kind
    assert ARM_STATUS_TEXTS[aircraft.broadcaster.arm_status(0, aircraft.beliefs).item(0)] == words


def test_it_tells_its_autopilot_what_it_broadcasts() -> None:
    aircraft = Aircraft(Broadcast("blue/b1", autopilot_location=True))
    aircraft.all_is_well(0)
    ((basic, system),) = aircraft.broadcaster.identity_messages(np.array([0]), 0, aircraft.beliefs)
    assert basic == f3411.BasicId(f3411.IdType.SERIAL_NUMBER, 2, serial_number("blue/b1"), 2)
    assert isinstance(system, f3411.System)
    assert (system.operator_lat_deg, system.operator_lon_deg) == pytest.approx((40.777, -73.956))


def test_a_rebooted_autopilots_clock_is_not_believed_until_it_tells_the_time() -> None:
    aircraft = Aircraft(Broadcast("blue/b1"))
    aircraft.all_is_well(100 * NS_PER_S)
    assert of(aircraft, 100 * NS_PER_S).timestamp_s is not None
    aircraft.tell(100 * NS_PER_S, position(0))
    assert of(aircraft, 100 * NS_PER_S).timestamp_s is None


def test_take_off_location_stands_for_a_control_station_that_is_not_known() -> None:
    """14 CFR 89.315 (e), (f)."""
    aircraft = Aircraft(Broadcast("blue/b1"))
    *_, (_, _, frame) = aircraft.sent(3 * NS_PER_S)
    system = messages(frame)[f3411.System]
    assert system.operator_location_type == f3411.OperatorLocationType.TAKEOFF
    assert (system.operator_lat_deg, system.operator_lon_deg) == pytest.approx((40.777, -73.956))
    assert system.operator_alt_geo_m == 12.0 - 32.5
    assert system.timestamp_s > 0


def kinds_sent(profile: str, *transports: str, seconds: int = 12) -> dict[tuple[int, int], list[Time]]:
    """When each message went out by each transport."""
    aircraft = Aircraft(
        Broadcast(
            "blue/b1",
            profile=profile,
            transports=transports,
            operator_place=STATION,
            operator_id="OP1",
            text="survey",
        )
    )
    found: dict[tuple[int, int], list[Time]] = {}
    for now, _, frame in aircraft.sent(seconds * NS_PER_S):
        if frame.header.transport == Transport.BT4:
            assert len(frame.body) == f3411.SIZE
        else:
            assert frame.body[0] >> 4 == MessageType.MESSAGE_PACK
        for part in messages(frame):
            found.setdefault((frame.header.transport, _NUMBER[part]), []).append(now)
    return found


_NUMBER = {
    f3411.BasicId: MessageType.BASIC_ID, f3411.Location: MessageType.LOCATION, f3411.System: MessageType.SYSTEM,
    f3411.OperatorId: MessageType.OPERATOR_ID, f3411.SelfId: MessageType.SELF_ID,
}  # fmt: skip


def test_intervals_of_both_profiles_over_all_transports() -> None:
    """F3411-22a: dynamic messages at least every 1 s, static ones at least every 3 s; `us` all every second."""
    every = ("wifi_beacon", "wifi_nan", "bluetooth")
    for profile in ("us", "astm"):
        found = kinds_sent(profile, *every)
        assert len(found) == 4 * 5
        for (_, kind), times in found.items():
            most = US_PERIOD_NS if profile == "us" else NS_PER_S if kind == MessageType.LOCATION else 3 * NS_PER_S
            gaps = np.diff(times)
            assert gaps.size
            assert gaps.max() <= most + 10 * NS_PER_MS  # polled every 10 ms
            assert gaps.min() >= most - 10 * NS_PER_MS


def test_bluetooth_4_spreads_its_messages() -> None:
    found = kinds_sent("us", "bt4")
    times = np.sort(np.concatenate([np.array(times) for times in found.values()]))
    assert np.diff(times).min() >= 190 * NS_PER_MS  # five messages a second


def test_counters_go_round_and_count_each_message_of_bluetooth_4_by_itself() -> None:
    aircraft = Aircraft(Broadcast("blue/b1", transports=("bt4",), operator_place=STATION))
    counters: dict[type, list[int]] = {}
    for _, _, frame in aircraft.sent(300 * NS_PER_S, step=50 * NS_PER_MS):
        (kind,) = messages(frame)
        counters.setdefault(kind, []).append(frame.header.counter)
    for values in counters.values():
        assert values == [count % 256 for count in range(len(values))]
        assert len(values) >= 299


def test_aircraft_are_spread_over_the_second_and_do_not_depend_on_each_other() -> None:
    names = [f"blue/b{number}" for number in range(40)]
    together = Aircraft(*(Broadcast(name, operator_place=STATION) for name in names))
    sent = together.sent(2 * NS_PER_S)
    first = {place: now for now, place, _ in reversed(sent)}
    assert len({now % NS_PER_S for now in first.values()}) > 25
    alone = Aircraft(Broadcast(names[7], operator_place=STATION))
    mine = [(now, frame) for now, _, frame in alone.sent(2 * NS_PER_S)]
    assert mine == [(now, frame) for now, place, frame in sent if place == 7]  # system ids are not broadcast
    assert len(mine) == 2
    assert Broadcaster([Broadcast(names[7])], Chance(2)).due_ns[0] != alone.broadcaster.due_ns[0] % NS_PER_S


def test_after_a_long_sleep_it_goes_on_without_catching_up() -> None:
    aircraft = Aircraft(Broadcast("blue/b1", operator_place=STATION))
    aircraft.all_is_well(0)
    aircraft.broadcaster.send(NS_PER_S, aircraft.beliefs)
    out = aircraft.broadcaster.send(100 * NS_PER_S, aircraft.beliefs)
    assert out is not None
    assert len(out[1]) == 1
    assert 100 * NS_PER_S < aircraft.broadcaster.due_ns[0] <= 101 * NS_PER_S


def test_troubles_come_one_after_the_other() -> None:
    aircraft = Aircraft(Broadcast("blue/b1"))

    def trouble(now: Time = 0) -> str:
        return ARM_STATUS_TEXTS[aircraft.broadcaster.arm_status(now, aircraft.beliefs).item(0)]

    assert trouble() == "autopilot silent"
    for message, then in (
        (beat(), "LOC: no position"), (position(0), "LOC: no 3D fix"), (gps(fix=2), "LOC: no 3D fix"),
        (gps(alt_ellipsoid=0), "LOC: no ellipsoid height"), (gps(), "LOC: no time"),
        (mav.MAVLink_system_time_message(0, 0), "LOC: no time"), (system_time(0), "OP_LOC: no operator location"),
        (home(), ""),
    ):  # fmt: skip
        aircraft.tell(0, message)
        assert trouble() == then
    assert trouble(3 * NS_PER_S) == "LOC: no position"
    assert trouble(6 * NS_PER_S) == "autopilot silent"
    none = Broadcaster([Broadcast("blue/b1", transports=())], Chance(1))
    assert ARM_STATUS_TEXTS[none.arm_status(0, aircraft.beliefs).item(0)] == "no transmitter"
    assert none.next_due() is None


def test_bad_settings_are_named_all_at_once() -> None:
    with pytest.raises(InputError) as error:
        Broadcast("blue/b1", uas_id="NO-SERIAL", profile="usa", transports=("wifi", "bt4", "bluetooth"), text="x" * 24)
    assert [fault.where for fault in error.value.problems] == ["profile", "transports", "transports", "uas_id", "text"]
    assert "us" in error.value.problems[0].hint


def test_a_receiver_that_knows_no_geoid_is_helped_by_the_chart() -> None:
    """ArduPilot says the same for both heights where its receiver tells no geoid, as GPS_INPUT cannot."""
    same = gps()
    same.alt_ellipsoid = same.alt
    for geoid_model_m, geoid_m in ((-33.0, -33.0), (0.0, 0.0)):
        beliefs = Beliefs(np.array([1]), geoid_model_m)
        beliefs.update(np.zeros(1, dtype=np.int64), np.zeros(1, dtype=np.int64), Payloads.of([Packer(1, 1).pack(same)]))
        assert beliefs.table["geoid_m"][0] == geoid_m
    told = Beliefs(np.array([1]), -33.0)
    told.update(np.zeros(1, dtype=np.int64), np.zeros(1, dtype=np.int64), Payloads.of([Packer(1, 1).pack(gps())]))
    assert told.table["geoid_m"][0] == pytest.approx((gps().alt_ellipsoid - gps().alt) * 1e-3)


@pytest.mark.parametrize(
    ("field", "wrong"),
    [
        ("profile", {"profile": "eu"}),
        ("transports", {"transports": ("smoke",)}),
        ("transports", {"transports": ("wifi_beacon", "wifi_beacon")}),
        ("uas_id", {"uas_id": "no serial number"}),
        ("uas_id", {"uas_id": "x" * 21, "id_type": 2}),
        ("uas_id", {"uas_id": "é", "id_type": 2}),
        ("operator_id", {"operator_id": "x" * 21}),
        ("text", {"text": "x" * 24}),
        ("text", {"text": "ü"}),
    ],
)
def test_a_broadcast_that_cannot_be_is_refused_and_its_field_is_named(field: str, wrong: dict[str, Any]) -> None:
    with pytest.raises(InputError) as caught:
        Broadcast("blue/b1", **wrong)
    assert [problem.where for problem in caught.value.problems] == [field]


def test_the_longest_texts_are_broadcast() -> None:
    longest = Broadcast("blue/b1", uas_id="x" * 20, id_type=2, operator_id="x" * 20, text="x" * 23)
    assert longest.text == "x" * 23
