"""Defences of missions, parameters and numbering: what they let pass, hold, ask for and find."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from skyrange.attack.contract import Aircraft, AttackContext
from skyrange.codec.mavlink import Message, Packer, decode, file_transfer
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.file_transfer import Opcode
from skyrange.contracts.alerts import Alert
from skyrange.contracts.components import Tap
from skyrange.contracts.frames import Frame
from skyrange.contracts.links import Schedule
from skyrange.contracts.verdicts import Drop, Inject, Replace, Verdict
from skyrange.core.chance import Chance
from skyrange.core.errors import InputError
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_MS, NS_PER_S, Epoch, Time
from skyrange.defence.contract import DefencePlugin
from skyrange.defence.mavlink.sequence import Follower
from skyrange.defence.mavlink.signing import remove_signature
from skyrange.defence.mission.hash_ends import ASKED, UNKNOWN, HashMessage, Step, Upload, derive_key, read_message
from skyrange.defence.mission.read_back import MissionReadBack

HASH = DefencePlugin.find("mission.hash")
READ_BACK = DefencePlugin.find("mission.read_back")
SEQUENCE = DefencePlugin.find("mavlink.sequence")
SIGNING = DefencePlugin.find("mavlink.signing")
WATCH = DefencePlugin.find("parameter.watch")
COMPONENT = MissionReadBack.component

VEHICLE, SYSTEM = "blue/b1", 7
STATION, AUTOPILOT = Packer(255, 190), Packer(SYSTEM, 1)


def taps(kind: DefencePlugin, signed: Sequence[str] = (), **params: Any) -> list[Tap]:
    links = ["gcs:blue/b1", "log:blue/b1", "autopilot:blue/b1"]
    aircraft = {VEHICLE: Aircraft((0.0, 0.0, 0.0), "1", SYSTEM)}
    schedule = Schedule(start_ns=0)
    context = AttackContext(
        "guard",
        aircraft,
        links,
        Origin(40.0, -74.0, 20.0),
        Epoch(0),
        Chance(3),
        90 * NS_PER_S,
        schedule,
        signed=signed,
    )
    made = kind(kind.params.model_validate(params), context)
    return [placed.make(placed.match) for placed in made.taps]


def frame(payload: bytes, direction: str = "fwd", link: str = "gcs:blue/b1") -> Frame:
    return Frame(link, direction, "a", 0, "a", "b", sent_ns=0, payload=payload)


def sent(message: Message) -> Frame:
    return frame(STATION.pack(message))


def told(message: Message) -> Frame:
    return frame(AUTOPILOT.pack(message), "rev")


def injected(verdicts: Sequence[Verdict]) -> list[bytes]:
    return [one.payload for one in verdicts if isinstance(one, Inject)]


def alarms(verdicts: Sequence[Verdict]) -> list[str]:
    return [one.kind for one in verdicts if isinstance(one, Alert)]


def dropped(verdicts: Sequence[Verdict]) -> bool:
    return any(isinstance(one, Drop) for one in verdicts)


def count(number: int) -> Message:
    return mav.MAVLink_mission_count_message(SYSTEM, 1, number, 0)


def item(seq: int, x: int = 0) -> Message:
    values = (0.0, 0.0, 0.0, 0.0, x, 0, 10.0)
    return mav.MAVLink_mission_item_int_message(SYSTEM, 1, seq, 3, mav.MAV_CMD_NAV_WAYPOINT, 0, 1, *values, 0)


def heartbeat(armed: bool) -> Message:
    base = mav.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
    return mav.MAVLink_heartbeat_message(2, mav.MAV_AUTOPILOT_ARDUPILOTMEGA, base, 3, 4, 3)


# --- mission hash ---------------------------------------------------------------------------------------


def upload(items: Sequence[Message], now: Time = 0) -> tuple[Tap, Tap, list[Sequence[Verdict]]]:
    """Both ends, and what the aircraft's end answers to each frame of an upload whose TUNNEL comes first."""
    station, aircraft = taps(HASH)
    answers = []
    for message in items:
        one = sent(message)
        for payload in injected(station.on_frame(now, one)):
            assert dropped(aircraft.on_frame(now, frame(payload)))
        answers.append(aircraft.on_frame(now, one))
    return station, aircraft, answers


def test_an_upload_with_its_hashes_passes() -> None:
    _, _, answers = upload([count(3), item(0), item(1), item(2), item(2)])
    assert answers == [(), (), (), (), ()]


def test_an_altered_item_is_held_and_found_when_the_station_was_asked() -> None:
    station, aircraft, _ = upload([count(2), item(0)])
    station.on_frame(0, sent(item(1)))
    assert [type(one) for one in aircraft.on_frame(0, sent(item(1, x=5)))] == [Drop]
    due = aircraft.next_wakeup()
    assert due is not None
    (question,) = injected(aircraft.on_wakeup(due))
    asked = read_message(question)
    assert asked is not None
    assert asked.kind == ASKED
    (answer,) = injected(station.on_frame(due, frame(question, "rev")))
    verdicts = aircraft.on_frame(due, frame(answer))
    assert alarms(verdicts) == ["mission.forged"]
    assert not injected(verdicts)
    assert aircraft.next_wakeup() is None


def test_an_item_whose_hash_got_lost_passes_when_the_station_was_asked() -> None:
    station, aircraft, _ = upload([count(2), item(0)])
    last = sent(item(1))
    station.on_frame(0, last)
    assert dropped(aircraft.on_frame(0, last))
    (question,) = injected(aircraft.on_wakeup(100 * NS_PER_MS))
    (answer,) = injected(station.on_frame(120 * NS_PER_MS, frame(question, "rev")))
    verdicts = aircraft.on_frame(140 * NS_PER_MS, frame(answer))
    assert injected(verdicts) == [last.payload]
    assert not alarms(verdicts)


def test_a_mission_starts_only_when_all_of_it_has_come() -> None:
    start = mav.MAVLink_command_long_message(SYSTEM, 1, mav.MAV_CMD_MISSION_START, 0, *([0.0] * 7))
    _, aircraft, _ = upload([count(2), item(0)])
    assert alarms(aircraft.on_frame(0, sent(start))) == ["mission.incomplete"]
    _, aircraft, _ = upload([count(1), item(0)])
    assert aircraft.on_frame(0, sent(start)) == ()


def test_items_of_one_upload_do_not_fit_into_another() -> None:
    station, aircraft, _ = upload([count(3), item(0), item(1)])
    station.on_frame(0, sent(count(3)))  # the begin of the second upload is kept from the aircraft
    for seq in (0, 1):
        station.on_frame(0, sent(item(seq, x=9)))
    other = sent(item(2))
    (said,) = injected(station.on_frame(0, other))
    aircraft.on_frame(0, frame(said))
    assert alarms(aircraft.on_frame(0, other)) == ["mission.hash"]


def test_an_answer_with_another_key_is_no_answer() -> None:
    _, aircraft, _ = upload([])
    wrong = HashMessage(UNKNOWN, 1, bytes(16)).sealed(derive_key("other", VEHICLE))
    assert not wrong.is_genuine(derive_key("skyrange", VEHICLE))
    assert wrong.is_genuine(derive_key("other", VEHICLE))
    assert derive_key("other", "x/y") != derive_key("other", VEHICLE)
    assert aircraft.next_wakeup() is None


def test_the_hash_of_an_upload_covers_every_item_before() -> None:
    one, other = Upload(1, b"first", [b"a", b"b"]), Upload(1, b"first", [b"a", b"c"])
    assert one.parts(Step(0, 2, b"d")) != other.parts(Step(0, 2, b"d"))
    assert one.parts(Step(0, 1, b"d")) == other.parts(Step(0, 1, b"d"))
    assert one.parts(Step(0, 3, b"d")) is None


# --- read-back ------------------------------------------------------------------------------------------


def read_back(stored: Sequence[Message], armed: bool = True) -> Sequence[Verdict]:
    """What the station's end does at the end of a read-back in which the autopilot tells `stored`."""
    (tap,) = taps(READ_BACK)
    for message in (count(3), item(0), item(1), item(2)):
        tap.on_frame(0, sent(message))
    tap.on_frame(0, told(heartbeat(armed)))
    tap.on_frame(0, told(mav.MAVLink_mission_ack_message(255, 190, mav.MAV_MISSION_ACCEPTED, 0)))
    due = tap.next_wakeup()
    assert due == 10 * NS_PER_S
    (asked,) = injected(tap.on_wakeup(due))
    assert decode(asked).get_srcComponent() == COMPONENT
    verdicts = tap.on_frame(due, told(mav.MAVLink_mission_count_message(255, COMPONENT, len(stored), 0)))
    while dropped(verdicts) and injected(verdicts):
        request = decode(injected(verdicts)[0])
        if request.get_msgId() != mav.MAVLINK_MSG_ID_MISSION_REQUEST_INT:
            break
        answer = stored[request.seq]
        values = {name: getattr(answer, name) for name in type(answer).fieldnames}
        answer = type(answer)(**{**values, "target_system": 255, "target_component": COMPONENT})
        verdicts = tap.on_frame(due, told(answer))
    return verdicts


def test_the_mission_that_was_sent_ends_a_read_back_quietly() -> None:
    verdicts = read_back([item(0, x=77), item(1), item(2)])
    assert not alarms(verdicts)
    assert decode(injected(verdicts)[0]).get_type() == "MISSION_ACK"


@pytest.mark.parametrize("stored", [[item(0), item(1), item(2, x=9)], [item(0)]], ids=["another place", "one item"])
def test_another_mission_is_found_and_the_aircraft_called_back(stored: list[Message]) -> None:
    verdicts = read_back(stored)
    assert alarms(verdicts) == ["mission.differs"]
    assert decode(injected(verdicts)[0]).command == mav.MAV_CMD_NAV_RETURN_TO_LAUNCH
    assert not injected(read_back(stored, armed=False))


def test_a_mission_that_is_shortened_while_it_is_read_is_found_at_once() -> None:
    (tap,) = taps(READ_BACK)
    for message in (count(2), item(0), item(1)):
        tap.on_frame(0, sent(message))
    tap.on_frame(0, told(mav.MAVLink_mission_ack_message(255, 190, mav.MAV_MISSION_ACCEPTED, 0)))
    due = tap.next_wakeup()
    assert due is not None
    tap.on_wakeup(due)
    (asked,) = injected(tap.on_frame(due, told(mav.MAVLink_mission_count_message(255, COMPONENT, 2, 0))))
    assert decode(asked).seq == 1
    now_empty = told(mav.MAVLink_mission_count_message(255, COMPONENT, 0, 0))
    assert alarms(tap.on_frame(due, now_empty)) == ["mission.differs"]


def test_a_read_back_that_is_denied_shows_an_upload_of_somebody_else() -> None:
    (tap,) = taps(READ_BACK)
    for message in (count(2), item(0), item(1)):
        tap.on_frame(0, sent(message))
    tap.on_frame(0, told(mav.MAVLink_mission_ack_message(255, 190, mav.MAV_MISSION_ACCEPTED, 0)))
    due = tap.next_wakeup()
    assert due is not None
    tap.on_wakeup(due)
    denied = told(mav.MAVLink_mission_ack_message(255, COMPONENT, mav.MAV_MISSION_DENIED, 0))
    assert alarms(tap.on_frame(due, denied)) == ["mission.differs"]


def test_only_a_second_read_back_without_an_answer_raises_an_alarm() -> None:
    (tap,) = taps(READ_BACK)
    for message in (count(1), item(0)):
        tap.on_frame(0, sent(message))
    tap.on_frame(0, told(mav.MAVLink_mission_ack_message(255, 190, mav.MAV_MISSION_ACCEPTED, 0)))
    found = []
    for _ in range(2 * 7):
        due = tap.next_wakeup()
        assert due is not None
        found.append(alarms(tap.on_wakeup(due)))
    assert found == [[]] * 13 + [["mission.unanswered"]]


# --- parameters -----------------------------------------------------------------------------------------


def value_of(name: str, value: float) -> Message:
    return mav.MAVLink_param_value_message(name.encode(), value, 9, 100, 65535)


def test_parameters_are_locked_while_armed_and_set_back() -> None:
    (tap,) = taps(WATCH, allowed=["WPNAV_SPEED"])
    change = sent(mav.MAVLink_param_set_message(SYSTEM, 1, b"FS_GCS_ENABLE", 0.0, 9))
    assert tap.on_frame(0, change) == ()
    tap.on_frame(0, told(value_of("FS_GCS_ENABLE", 1.0)))
    tap.on_frame(0, told(heartbeat(True)))
    assert alarms(tap.on_frame(0, change)) == ["parameter.lock"]
    assert tap.on_frame(0, sent(mav.MAVLink_param_set_message(SYSTEM, 1, b"WPNAV_SPEED", 1.0, 9))) == ()
    assert tap.on_frame(0, told(value_of("FS_GCS_ENABLE", 1.0))) == ()
    verdicts = tap.on_frame(0, told(value_of("FS_GCS_ENABLE", 0.0)))
    restored = decode(injected(verdicts)[0])
    assert alarms(verdicts) == ["parameter.changed"]
    assert (restored.param_id, restored.param_value) == ("FS_GCS_ENABLE", 1.0)


def test_files_that_set_parameters_or_the_fence_are_locked_while_armed_too() -> None:
    """A file is opened to be written before it is written; reading one, and other files, are left."""

    def opens(opcode: int, path: bytes) -> Frame:
        payload = file_transfer.pack(1, 1, opcode, path)
        return sent(mav.MAVLink_file_transfer_protocol_message(0, SYSTEM, 1, payload))

    locked = [
        opens(Opcode.CREATE_FILE, b"@PARAM/param.pck"), opens(Opcode.OPEN_FILE_WO, b"@PARAM/param.pck?start=0"),
        opens(Opcode.CREATE_FILE, b"@MISSION/fence.dat"),
    ]  # fmt: skip
    free = [opens(Opcode.OPEN_FILE_RO, b"@PARAM/param.pck"), opens(Opcode.CREATE_FILE, b"/APM/scripts/a.lua")]
    (tap,) = taps(WATCH)
    tap.on_frame(0, told(value_of("FS_GCS_ENABLE", 1.0)))
    assert [tap.on_frame(0, frame) for frame in (*locked, *free)] == [()] * 5
    tap.on_frame(0, told(heartbeat(True)))
    assert tap.on_frame(0, told(value_of("FS_GCS_ENABLE", 5.0))) == ()  # learnt anew: a file was written before
    found = [alarms(tap.on_frame(second * NS_PER_S, frame)) for second, frame in enumerate(locked)]
    assert found == [["parameter.lock"]] * 3
    assert [tap.on_frame(0, frame) for frame in free] == [(), ()]


def test_the_watch_asks_oftener_for_what_it_does_not_know_and_still_for_the_rest() -> None:
    (tap,) = taps(WATCH, watched=["A", "B", "C"])
    asked = []
    for step in range(40):
        (payload,) = injected(tap.on_wakeup(step * NS_PER_S))
        asked.append(decode(payload).param_id)
        tap.on_frame(0, told(value_of("A", 1.0)))
        tap.on_frame(0, told(value_of("C", 1.0)))
    assert set(asked[:3]) == {"A", "B", "C"}
    assert asked.count("B") > asked.count("A") > 5
    assert asked.count("C") > 5


# --- numbering ------------------------------------------------------------------------------------------


def follower() -> Follower:
    return Follower(NS_PER_S, 5 * NS_PER_S)


def test_losses_copies_and_late_frames_are_no_findings() -> None:
    one = follower()
    for number in (250, 251, 255, 3, 0, 3):  # 252 to 254, 1 and 2 are lost; 0 is late; 3 comes twice
        assert one.take(0, number, number) == ""


def test_a_number_with_two_contents_is_a_conflict() -> None:
    one = follower()
    one.take(0, 9, 1)
    assert one.take(0, 10, 2) == ""
    assert one.take(0, 10, 3) == "conflict"
    assert one.take(0, 11, 4) == ""


def test_a_number_that_was_passed_long_ago_is_old() -> None:
    one = follower()
    for second in range(4):
        one.take(second * NS_PER_S, 2 * second, second)
    assert one.take(3 * NS_PER_S, 2, 1) == "old"
    assert one.take(3 * NS_PER_S, 1, 1) == "old"
    assert one.take(9 * NS_PER_S, 1, 1) == ""  # after a silence any number is taken


@settings(deadline=None)
@given(loss=st.lists(st.booleans(), min_size=1, max_size=600))
def test_losses_alone_never_raise_an_alarm(loss: list[bool]) -> None:
    one = follower()
    for step, lost in enumerate(loss):
        if not lost:
            assert one.take(step * NS_PER_S, step % 256, step) == ""


# --- signing --------------------------------------------------------------------------------------------


def replaced(verdicts: Sequence[Verdict]) -> bytes:
    (one,) = [one for one in verdicts if isinstance(one, Replace)]
    return one.payload


def test_signed_frames_arrive_as_they_left_and_others_are_dropped() -> None:
    station, aircraft = taps(SIGNING)
    one = sent(item(1))
    signed = replaced(station.on_frame(0, one))
    assert len(signed) == len(one.payload) + 13
    assert remove_signature(signed) == one.payload
    assert replaced(aircraft.on_frame(0, frame(signed))) == one.payload
    assert alarms(aircraft.on_frame(NS_PER_S, frame(signed))) == ["signing.replayed"]
    assert alarms(aircraft.on_frame(NS_PER_S, one)) == ["signing.unsigned"]
    _, stranger = taps(SIGNING, passphrase="other")
    assert alarms(stranger.on_frame(0, frame(signed))) == ["signing.wrong"]
    back = told(heartbeat(False))
    assert replaced(station.on_frame(0, frame(replaced(aircraft.on_frame(0, back)), "rev"))) == back.payload


def test_links_of_an_operator_that_signs_are_refused() -> None:
    with pytest.raises(InputError, match="does not sign"):
        taps(SIGNING, signed=("blue",))


# --- hostile bytes --------------------------------------------------------------------------------------

_MESSAGES = st.sampled_from([
    mav.MAVLINK_MSG_ID_TUNNEL, mav.MAVLINK_MSG_ID_MISSION_COUNT, mav.MAVLINK_MSG_ID_MISSION_ITEM_INT,
    mav.MAVLINK_MSG_ID_MISSION_ITEM, mav.MAVLINK_MSG_ID_MISSION_ACK, mav.MAVLINK_MSG_ID_PARAM_SET,
    mav.MAVLINK_MSG_ID_PARAM_VALUE, mav.MAVLINK_MSG_ID_COMMAND_LONG, mav.MAVLINK_MSG_ID_HEARTBEAT,
    mav.MAVLINK_MSG_ID_MISSION_CLEAR_ALL, mav.MAVLINK_MSG_ID_SET_MODE,
])  # fmt: skip


@st.composite
def _frames(draw: st.DrawFn) -> bytes:
    from skyrange.codec.mavlink.frames import LAYOUTS, checksum, pack_header_v2

    number = draw(_MESSAGES)
    body = draw(st.binary(min_size=1, max_size=LAYOUTS[number].size))
    covered = pack_header_v2(0xFD, len(body), 0, 0, draw(st.integers(0, 255)), 255, COMPONENT, number, 0) + body
    return covered + checksum(covered[1:], LAYOUTS[number].crc_extra).to_bytes(2, "little")


@pytest.mark.parametrize("kind", [HASH, READ_BACK, WATCH, SEQUENCE, SIGNING], ids=lambda kind: kind.params.__name__)
@settings(deadline=None, max_examples=60)
@given(payloads=st.lists(st.tuples(st.one_of(st.binary(max_size=60), _frames()), st.booleans()), max_size=20))
def test_no_bytes_raise(kind: DefencePlugin, payloads: list[tuple[bytes, bool]]) -> None:
    for tap in taps(kind):
        for step, (payload, forward) in enumerate(payloads):
            now = step * NS_PER_S
            link = getattr(tap, "link", "")
            tap.on_frame(now, frame(payload, "fwd" if forward else "rev", link))
            due = tap.next_wakeup()
            if due is not None and due <= now:
                tap.on_wakeup(now)


@pytest.mark.parametrize("names", [("",), ("WPNAV_SPEED", ""), ("wpnav_speed",), ("A" * 17,), ("Ä",), ("A", "A")])
@pytest.mark.parametrize("field", ["allowed", "watched"])
def test_what_is_no_name_of_a_parameter_is_refused(field: str, names: tuple[str, ...]) -> None:
    with pytest.raises(ValidationError, match=r"capital ASCII characters|each parameter once"):
        WATCH.params.model_validate({field: names})
    assert getattr(WATCH.params.model_validate({field: ("A", "B" * 16)}), field) == ("A", "B" * 16)
