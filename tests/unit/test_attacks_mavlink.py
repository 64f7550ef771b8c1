"""What attacks that speak MAVLink put on a link, what they learn there, and which parameters they refuse."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest
from pydantic import ValidationError

from skyrange.attack.bases.mavlink.injection import Injection
from skyrange.attack.bases.mavlink.orders import stick_message
from skyrange.attack.contract import Aircraft, AttackContext, AttackPlugin
from skyrange.attack.link.eavesdrop import Overheard
from skyrange.attack.mavlink.malformed import (
    FORMS,
    Draw,
    harmless_frame,
    hostile_frame,
)
from skyrange.codec.ardupilot_files import parameters
from skyrange.codec.mavlink import Packer, decode, file_transfer
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.file_transfer import Error, Opcode
from skyrange.contracts.components import Tap
from skyrange.contracts.frames import Frame
from skyrange.contracts.links import Schedule
from skyrange.contracts.verdicts import Inject, Replace
from skyrange.core.chance import Chance
from skyrange.core.errors import DecodeError, InputError
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_S, Epoch, Time
from skyrange.gcs.protocols.mission_transfer import Download, MissionItemInt, Upload

COMMAND = AttackPlugin.find("mavlink.command")
EXFILTRATE = AttackPlugin.find("mavlink.exfiltrate")
FILE_READ = AttackPlugin.find("mavlink.file_read")
FILE_WRITE = AttackPlugin.find("mavlink.file_write")
FENCE = AttackPlugin.find("mavlink.fence")
GUIDED = AttackPlugin.find("mavlink.guided")
MALFORMED = AttackPlugin.find("mavlink.malformed")
MISSION_ALTER = AttackPlugin.find("mavlink.mission_alter")
MISSION_REPLACE = AttackPlugin.find("mavlink.mission_replace")
MODE = AttackPlugin.find("mavlink.mode")
PARAMETER = AttackPlugin.find("mavlink.parameter")

VEHICLE, SYSTEM, LINK = "blue/b1", 7, "gcs:blue/b1"
ORIGIN = Origin(40.0, -74.0, 20.0)
AIRCRAFT = Packer(SYSTEM, 1)
OPERATOR = Packer(255, 190)


def context(sham: bool = False, start_ns: Time = 0) -> AttackContext:
    links = [LINK, "log:blue/b1", "autopilot:blue/b1"]
    aircraft = {VEHICLE: Aircraft((0.0, 0.0, 0.0), "1", SYSTEM)}
    schedule = Schedule(start_ns=start_ns)
    return AttackContext("bad", aircraft, links, ORIGIN, Epoch(0), Chance(3), 90 * NS_PER_S, schedule, sham)


def tap(kind: AttackPlugin, sham: bool = False, start_ns: Time = 0, **params: Any) -> Tap:
    made = kind(kind.params.model_validate({"vehicles": [VEHICLE], **params}), context(sham, start_ns))
    (placement,) = made.taps
    assert placement.side == {"gcs": "companion"}.get(placement.match.split(":")[0], "proxy")
    return placement.make(placement.match)


def frame(direction: str, payload: bytes) -> Frame:
    ends = ("blue.gcs", "blue/b1.companion") if direction == "fwd" else ("blue/b1.companion", "blue.gcs")
    return Frame(LINK, direction, ends[0], 1, *ends, sent_ns=0, payload=payload)


def injected(one: Tap, now: Time) -> list[Any]:
    """The messages that it injects until `now`. Woken, it asks for a later time, or none: else it would never rest."""
    messages = []
    while (due := one.next_wakeup()) is not None and due <= now:
        for verdict in one.on_wakeup(due):
            assert isinstance(verdict, Inject)
            messages.append(decode(verdict.payload))
        after = one.next_wakeup()
        assert after is None or after > due
    return messages


def told(one: Tap, now: Time, message: Any) -> None:
    """The aircraft says something on the link."""
    one.on_frame(now, frame("rev", AIRCRAFT.pack(message)))


def test_a_command_bears_the_name_of_the_station_and_its_next_sequence_number() -> None:
    one = tap(COMMAND, command="DO_FLIGHTTERMINATION", values=[1.0])
    station = Packer(240, 17)
    station.sequence = 41
    heartbeat = mav.MAVLink_heartbeat_message(mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)
    one.on_frame(0, frame("fwd", station.pack(heartbeat)))
    (message,) = injected(one, NS_PER_S)
    assert (message.get_srcSystem(), message.get_srcComponent(), message.get_seq()) == (240, 17, 42)
    assert (message.target_system, message.command, message.param1) == (SYSTEM, 185, 1.0)
    assert one.next_wakeup() is None, "once"


def test_a_command_has_a_place_and_a_name_of_its_own() -> None:
    one = tap(COMMAND, command=192, at=[100.0, 0.0, 30.0], sender="own", system_id=66, on="autopilot", times=2)
    first, second = injected(one, 2 * NS_PER_S)
    lat, lon = ORIGIN.geodetic_of(100.0, 0.0)
    assert first.get_type() == "COMMAND_INT"
    assert (first.x, first.y, first.z, first.frame) == (round(lat * 1e7), round(lon * 1e7), 50.0, mav.MAV_FRAME_GLOBAL)
    assert (first.get_srcSystem(), second.get_seq()) == (66, 1)


def test_a_sham_requests_a_heartbeat_with_as_many_bytes() -> None:
    live, sham = (tap(COMMAND, sham=sham, command="DO_SET_MODE", values=[1, 6]) for sham in (False, True))
    (mine,), (other,) = injected(live, 0), injected(sham, 0)
    assert (other.target_system, other.command, other.param1) == (SYSTEM, mav.MAV_CMD_REQUEST_MESSAGE, 0.0)
    assert len(mine.get_msgbuf()) == len(other.get_msgbuf())


def test_nothing_is_sent_before_the_start() -> None:
    one = tap(COMMAND, start_ns=5 * NS_PER_S, command=20)
    assert injected(one, 5 * NS_PER_S - 1) == []
    assert one.next_wakeup() == 5 * NS_PER_S
    assert len(injected(one, 5 * NS_PER_S)) == 1


@pytest.mark.parametrize(
    ("kind", "params", "match"),
    [
        (COMMAND, {"command": "DO_FLYTERMINATION"}, "DO_FLIGHTTERMINATION"),
        (COMMAND, {"command": 70_000}, "0 to 65535"),
        (MODE, {"mode": "LOITR"}, "LOITER"),
        (FENCE, {"form": "move"}, "centre of the circle"),
        (PARAMETER, {"values": {"wpnav_speed": 1}}, "capital"),
        (MISSION_ALTER, {}, "not zero"),
        (MISSION_ALTER, {"form": "insert", "item": 1}, "place of the waypoint"),
        (MISSION_ALTER, {"form": "swap", "item": 2, "other": 2}, "another item"),
        (MISSION_ALTER, {"form": "delete"}, "number of an item"),
    ],
)
def test_bad_parameters_are_named(kind: AttackPlugin, params: dict[str, Any], match: str) -> None:
    with pytest.raises(ValidationError, match=match):
        kind.params.model_validate({"vehicles": [VEHICLE], **params})


@pytest.mark.parametrize("kind", [COMMAND, MISSION_ALTER])
def test_an_aircraft_that_is_not_there_is_named(kind: AttackPlugin) -> None:
    params = {"command": 20} if kind is COMMAND else {"offset_m": [1, 0, 0]}
    with pytest.raises(InputError, match=r"bad: vehicles.0: blue/b2 .*blue/b1"):
        kind(kind.params.model_validate({"vehicles": ["blue/b2"], **params}), context())


def test_sticks() -> None:
    channels = stick_message(7, 1, (1.0, -0.5, 0.25, 0.1), manual=False)
    # ArduCopter: channel 1 roll, 2 pitch (full forward is the lowest), 3 throttle, 4 yaw; 1000 to 2000 µs
    assert [getattr(channels, f"chan{n}_raw") for n in range(1, 6)] == [1250, 1000, 1250, 1550, 65535]
    manual = stick_message(7, 1, (1.0, -0.5, 0.25, 0.1), manual=True)
    assert (manual.x, manual.y, manual.z, manual.r) == (1000, -500, 250, 100)  # MAVLink: x forward, y right


def heartbeat_of_aircraft(mode: int) -> Any:
    return mav.MAVLink_heartbeat_message(mav.MAV_TYPE_QUADROTOR, mav.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, mode, 4, 3)


def test_the_mode_is_commanded_only_while_it_is_another_one() -> None:
    one = tap(MODE, mode="BRAKE", every_s=0.5)
    told(one, 0, heartbeat_of_aircraft(mav.COPTER_MODE_BRAKE))
    assert injected(one, NS_PER_S) == []
    told(one, NS_PER_S, heartbeat_of_aircraft(mav.COPTER_MODE_RTL))
    (message, _) = injected(one, 2 * NS_PER_S)
    assert (message.command, message.param2) == (mav.MAV_CMD_DO_SET_MODE, mav.COPTER_MODE_BRAKE)


def test_the_next_target_follows_when_the_aircraft_reports_that_it_is_there() -> None:
    one = tap(GUIDED, track=[[10, 0, 20], [50, 0, 20]], every_s=1, then="land")
    targets = [m for m in injected(one, 0) if m.get_type() == "SET_POSITION_TARGET_GLOBAL_INT"]
    told(one, NS_PER_S, heartbeat_of_aircraft(mav.COPTER_MODE_GUIDED))
    for place in ([10, 0], [50, 0]):
        lat, lon = ORIGIN.geodetic_of(*place)
        report = mav.MAVLink_global_position_int_message(0, round(lat * 1e7), round(lon * 1e7), 40_000, 0, 0, 0, 0, 0)
        told(one, NS_PER_S, report)
        targets += injected(one, one.next_wakeup() or 0)
    assert [round(ORIGIN.enu_of(t.lat_int * 1e-7, t.lon_int * 1e-7)[0]) for t in targets[:2]] == [10, 50]
    assert (targets[0].alt, targets[0].type_mask) == (40.0, 3576)
    assert (targets[2].command, targets[2].param2) == (mav.MAV_CMD_DO_SET_MODE, mav.COPTER_MODE_LAND)


def test_an_upload_answers_requests_and_gives_up_after_six_tries() -> None:
    one = tap(MISSION_REPLACE, track=[[10, 0, 20]], restart=False)
    (count,) = injected(one, 0)
    assert (count.get_type(), count.count) == ("MISSION_COUNT", 3)
    for seq, command in enumerate((mav.MAV_CMD_NAV_WAYPOINT, mav.MAV_CMD_NAV_WAYPOINT, mav.MAV_CMD_NAV_LAND)):
        told(one, seq + 1, mav.MAVLink_mission_request_message(255, 190, seq, 0))
        (item,) = injected(one, one.next_wakeup() or 0)
        assert (item.get_type(), item.seq, item.command) == ("MISSION_ITEM_INT", seq, command)
    told(one, 9, mav.MAVLink_mission_ack_message(255, 190, mav.MAV_MISSION_ACCEPTED, 0))
    assert one.next_wakeup() is None
    alone = tap(MISSION_REPLACE, track=[[10, 0, 20]], restart=False)
    assert len(injected(alone, 60 * NS_PER_S)) == 6


def item(command: int, param1: float, x: int, y: int, z: float) -> MissionItemInt:
    return MissionItemInt(3, command, param1, 0.0, 0.0, 0.0, x, y, z, 1)


LAT, LON = 400_000_000, -740_000_000
PLAN = (
    item(16, 0, LAT, LON, 20), item(22, 0, LAT, LON, 10), item(16, 1, LAT + 5000, LON, 10),
    item(16, 2, LAT + 5000, LON + 5000, 12), item(178, 1, 0, 0, 0), item(21, 0, LAT, LON, 0),
)  # fmt: skip


def through(one: Tap, direction: str, message: Any) -> Any:
    """What becomes of a message on its way."""
    payload = (OPERATOR if direction == "fwd" else AIRCRAFT).pack(message)
    for verdict in one.on_frame(1, frame(direction, payload)):
        assert isinstance(verdict, Replace)
        payload = verdict.payload
    return decode(payload)


def upload(one: Tap) -> tuple[list[Any], list[str]]:
    """The mission on board after an upload, and what the station says of upload and read-back."""
    station = Upload(PLAN, SYSTEM, 1)
    (message,) = station.begin(0)
    count = through(one, "fwd", message).count
    board = []
    for seq in range(count):
        asked = through(one, "rev", mav.MAVLink_mission_request_message(255, 190, seq, 0))
        (answer,) = station.on_request(1, asked.seq)
        board.append(through(one, "fwd", answer))
        assert board[-1].seq == seq
    station.on_ack(1, mav.MAV_MISSION_ACCEPTED)
    reader = Download(PLAN, SYSTEM, 1)
    reader.begin(2)
    messages = reader.on_count(2, through(one, "rev", mav.MAVLink_mission_count_message(255, 190, count, 0)).count)
    while messages and messages[0].get_type() == "MISSION_REQUEST_INT":
        seq = through(one, "fwd", messages[0]).seq
        messages = reader.on_item(3, through(one, "rev", board[seq]))
    return board, [station.result, reader.result]


def commands(board: list[Any]) -> list[tuple[int, float]]:
    return [(one.command, one.param1) for one in board]


ORIGINAL = [(one.command, one.param1) for one in PLAN]
SWAPPED = [ORIGINAL[n] for n in (0, 1, 3, 2, 4, 5)]


@pytest.mark.parametrize(
    ("params", "expected"),
    [
        ({"form": "offset", "offset_m": [100, 0, 5]}, ORIGINAL),
        ({"form": "delete", "item": 3}, [*ORIGINAL[:3], (600, 65535), *ORIGINAL[4:]]),
        ({"form": "insert", "item": 2, "at": [9, 9, 9]}, [*ORIGINAL[:2], (16, 0), *ORIGINAL[2:]]),
        ({"form": "swap", "item": 2, "other": 3}, SWAPPED),
        ({"form": "jump", "item": 3, "other": 2}, [*ORIGINAL[:3], (177, 2), *ORIGINAL[4:]]),
        ({"form": "delete", "item": 60}, ORIGINAL),
        ({"form": "insert", "item": 60, "at": [9, 9, 9]}, ORIGINAL),
        ({"form": "swap", "item": 2, "other": 60}, ORIGINAL),
    ],
)
def test_the_station_verifies_a_mission_that_is_not_on_board(params: dict[str, Any], expected: list[Any]) -> None:
    board, results = upload(tap(MISSION_ALTER, **params))
    assert results == ["done", "done"]
    assert commands(board) == expected
    _, results = upload(tap(MISSION_ALTER, sham=True, **params))
    assert results == ["done", "done"]


def test_an_offset_moves_waypoints_and_landing_but_neither_home_nor_speed() -> None:
    board, _ = upload(tap(MISSION_ALTER, offset_m=[100, 0, 5]))
    east = [ORIGIN.enu_of(one.x * 1e-7, one.y * 1e-7)[0] for one in board]
    assert [round(e) for e in (east[0], east[1], east[2], east[5])] == [0, 0, 100, 100]
    assert [one.z for one in board] == [20, 10, 15, 17, 0, 5]


def test_progress_is_told_in_the_numbers_of_the_operator() -> None:
    one = tap(MISSION_ALTER, form="insert", item=2, at=[9, 9, 9])
    upload(one)
    seen = [through(one, "rev", mav.MAVLink_mission_current_message(seq, 6)) for seq in range(1, 7)]
    assert [message.seq for message in seen] == [1, 2, 2, 3, 4, 5]
    assert {message.total for message in seen} == {5}


def test_an_upload_that_began_before_the_attack_is_left_alone() -> None:
    one = tap(MISSION_ALTER, start_ns=2, offset_m=[100, 0, 5])
    board, _ = upload(one)
    assert [one.z for one in board] == [one.z for one in PLAN]


def test_a_parameter_is_set_and_shown_as_it_was() -> None:
    one = tap(PARAMETER, values={"FS_GCS_ENABLE": 0}, shown={"FS_GCS_ENABLE": 1}, times=2, every_s=1)
    first, _ = injected(one, 9 * NS_PER_S)
    assert (first.param_id, first.param_value, first.target_system) == ("FS_GCS_ENABLE", 0.0, SYSTEM)
    answer = through(one, "rev", mav.MAVLink_param_value_message(b"FS_GCS_ENABLE", 0.0, 2, 300, 65535))
    assert (answer.param_value, answer.param_type, answer.param_count) == (1.0, 2, 300)
    other = through(one, "rev", mav.MAVLink_param_value_message(b"RTL_ALT", 5.0, 2, 300, 65535))
    assert other.param_value == 5.0


def test_what_is_read_is_learnt() -> None:
    one: Any = tap(EXFILTRATE, what=["parameters", "mission"], every_s=60)
    assert [m.get_type() for m in injected(one, 0)] == ["PARAM_REQUEST_LIST", "MISSION_REQUEST_LIST"]
    told(one, 1, mav.MAVLink_param_value_message(b"RTL_ALT", 1500.0, 6, 300, 4))
    told(one, 1, mav.MAVLink_mission_count_message(255, 190, 2, 0))
    for seq in range(2):
        (request,) = injected(one, one.next_wakeup() or 0)
        assert (request.get_type(), request.seq) == ("MISSION_REQUEST_INT", seq)
        told(one, 2 + seq, PLAN[seq].message(seq, 255, 190))
    assert one.learnt["parameters"] == {"RTL_ALT": (1500.0,)}
    assert one.learnt["mission"]["1"] == pytest.approx((22, 40.0, -74.0, 10))
    assert one.next_wakeup() == 60 * NS_PER_S, "the next round"


def reply_to(request: Any, opcode: int, data: bytes = b"", **more: Any) -> Any:
    """A reply of the aircraft to a request of MAVLink FTP that was injected."""
    asked = file_transfer.unpack(bytes(request.payload))
    more = {"request": asked.opcode, "session": asked.session, "sequence": asked.sequence + 1, **more}
    return mav.MAVLink_file_transfer_protocol_message(0, 255, 190, file_transfer.pack(opcode=opcode, data=data, **more))


def requested(messages: Sequence[Any]) -> list[tuple[int, int, bytes]]:
    """Sequence number, opcode and data of requests."""
    found = [file_transfer.unpack(bytes(message.payload)) for message in messages]
    return [(one.sequence, one.opcode, one.data.rstrip(b"\0")) for one in found]


def test_a_file_is_read_piece_by_piece_and_a_request_without_a_reply_is_repeated() -> None:
    """The same request comes again under its number; one that is refused for another's session has a new one."""
    one: Any = tap(FILE_READ, files=["/APM/a.txt", "/none"])
    (first,) = injected(one, 0)
    assert requested([first]) == [(0, Opcode.OPEN_FILE_RO, b"/APM/a.txt")]
    (again,) = injected(one, NS_PER_S // 2)
    assert again.payload == first.payload
    told(one, NS_PER_S // 2, reply_to(first, Opcode.NAK, bytes([Error.INVALID_SESSION])))
    (anew,) = injected(one, NS_PER_S)
    assert requested([anew]) == [(1, Opcode.OPEN_FILE_RO, b"/APM/a.txt")]
    stale = [reply_to(anew, Opcode.ACK, sequence=9), reply_to(anew, Opcode.ACK, session=9)]
    for message in (*stale, reply_to(anew, Opcode.ACK, (300).to_bytes(4, "little"))):
        told(one, NS_PER_S, message)
    pieces = [b"x" * 239, b"y" * 61]
    now, asked = NS_PER_S, []
    for piece in pieces:
        now += 2_000_000
        (read,) = injected(one, now)
        asked.append(file_transfer.unpack(bytes(read.payload)).offset)
        told(one, now, reply_to(read, Opcode.ACK, piece))
    (last,) = injected(one, now + 2_000_000)
    verdicts = one.on_frame(now, frame("rev", AIRCRAFT.pack(reply_to(last, Opcode.NAK, bytes([Error.END_OF_FILE])))))
    assert [note.data for note in verdicts] == [{"what": "file", "name": "/APM/a.txt", "bytes": 300}]
    assert (asked, one.stolen) == ([0, 239], {"/APM/a.txt": b"".join(pieces)})
    (end,) = injected(one, now + 4_000_000)
    assert requested([end])[0][1] == Opcode.TERMINATE_SESSION
    told(one, now, reply_to(end, Opcode.ACK))
    (other,) = injected(one, now + 6_000_000)
    told(one, now, reply_to(other, Opcode.NAK, bytes([Error.FILE_NOT_FOUND])))
    assert (requested([other])[0][2], one.next_wakeup()) == (b"/none", None)


def test_a_listing_without_end_and_a_silent_aircraft_are_survived() -> None:
    one: Any = tap(FILE_READ, files=["/"])
    for now in range(0, 4_000 * 2_000_000, 2_000_000):
        for request in injected(one, now):
            told(one, now, reply_to(request, Opcode.ACK, b"Fa\t1\0Db\0\xff\0" * 10))
    assert len(one.queue) + len(one.stolen) <= 1000
    silent: Any = tap(FILE_READ, files=["/a", "/b"])
    paths = [data for _, _, data in requested(injected(silent, 60 * NS_PER_S))]
    assert paths == [b"/a"] * 10 + [b"/b"] * 10
    assert silent.next_wakeup() is None


def test_parameters_and_other_files_are_written_and_closed() -> None:
    one: Any = tap(FILE_WRITE, values={"FS_GCS_ENABLE": 0}, path="/APM/scripts/a.lua", text="z" * 240)
    seen = []
    for now in range(0, 40_000_000, 2_000_000):
        for request in injected(one, now):
            seen.append(file_transfer.unpack(bytes(request.payload)))
            told(one, now, reply_to(request, Opcode.ACK))
    names = [Opcode(request.opcode).name for request in seen]
    first = ["CREATE_FILE", "WRITE_FILE", "TERMINATE_SESSION"]
    assert names == [*first, "CREATE_FILE", "WRITE_FILE", "WRITE_FILE", "TERMINATE_SESSION"]
    packed = seen[1].data[: seen[1].size]
    assert list(parameters.read_upload(packed)) == [("FS_GCS_ENABLE", 0.0)]
    assert [(r.offset, r.data[: r.size]) for r in seen[4:6]] == [(0, b"z" * 239), (239, b"z")]
    with pytest.raises(InputError, match=r"values.*something to write"):
        tap(FILE_WRITE)


def test_who_listens_learns_which_files_are_read_and_written() -> None:
    known = Overheard(NS_PER_S)
    for opcode, data in ((4, b"@PARAM/param.pck"), (5, b""), (6, b"/APM/a.lua"), (7, b"x"), (4, b"@PARAM/param.pck")):
        message = mav.MAVLink_file_transfer_protocol_message(0, SYSTEM, 1, file_transfer.pack(1, 1, opcode, data))
        known.learn(0, OPERATOR.pack(message))
    files = [says for fact, says in known.facts.items() if fact.startswith("file|")]
    assert files == [
        {"operation": "read", "path": "@PARAM/param.pck", "target_system": SYSTEM},
        {"operation": "write", "path": "/APM/a.lua", "target_system": SYSTEM},
    ]


def is_valid(payload: bytes) -> bool:
    try:
        decode(payload)
    except DecodeError:
        return False
    return True


@pytest.mark.parametrize("to_station", [False, True])
@pytest.mark.parametrize("form", FORMS)
def test_hostile_frames_are_damaged_or_absurd_and_have_harmless_twins(form: Any, to_station: bool) -> None:
    for number in range(60):
        payload = hostile_frame(form, Draw(bytes([number]) * 256), Packer(255, 190), SYSTEM, to_station=to_station)
        assert is_valid(payload) == (form in ("counts", "numbers"))
        twin = harmless_frame(len(payload), Packer(255, 190))
        assert len(twin) == len(payload)
        assert decode(twin).get_type() == "ENCAPSULATED_DATA"


def test_a_message_to_read_that_mavlink_does_not_have_is_named() -> None:
    with pytest.raises(InputError, match=r"class .*Misspelt in .*reads: HEARTBEET.*HEARTBEAT"):

        class Misspelt(Injection):
            """Reads."""

            reads = ("HEARTBEET",)


def test_hostile_frames_depend_on_the_seed_and_on_the_link() -> None:
    runs = [tap(MALFORMED, rate_hz=20, on=on) for on in ("gcs", "gcs", "log")]
    first, again, other = ([one.on_wakeup(one.next_wakeup() or 0)[0] for _ in range(40)] for one in runs)
    assert first == again
    one, two = ([verdict.payload for verdict in each if isinstance(verdict, Inject)] for each in (first, other))
    assert len(one) == len(two) == 40
    assert one != two
