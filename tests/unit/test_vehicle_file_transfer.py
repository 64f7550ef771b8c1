"""MAVLink FTP of the builtin autopilot, as pymavlink's client meets it, and by the bytes of ArduPilot's GCS_FTP.cpp."""

from __future__ import annotations

import math
import zlib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from pymavlink import DFReader, mavftp

from skyrange.codec.ardupilot_files import missions, parameters
from skyrange.codec.mavlink import Packer, decode
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink import file_transfer as ftp
from skyrange.codec.mavlink.file_transfer import Error, Opcode, Transfer
from skyrange.vehicle.builtin.file_transfer import server
from skyrange.vehicle.builtin.memory_card import CAPACITY_BYTES
from skyrange.vehicle.builtin.parameters.table import ALWAYS_LISTED
from skyrange.vehicle.contract import VehicleSpec
from tests.integration.flight_harness import GCS, Range, square

V = "blue/b1"
MISSION = square(20.0, 3.0)


class Master:
    """What pymavlink's client takes for its connection: it sends and receives in simulated time."""

    seconds = 0.0
    source_system, source_component = GCS
    target_system, target_component = 1, 1

    def __init__(self, range_: Range) -> None:
        self.range = range_
        self.read = len(range_.said)
        self.mav = self

    def file_transfer_protocol_send(self, network: int, system: int, component: int, payload: bytearray) -> None:
        self.range.send(V, mav.MAVLink_file_transfer_protocol_message(network, system, component, list(payload)))

    def recv_match(self, type: Any = None, blocking: bool = False, timeout: float = 0.0) -> Any:
        for _ in range(3):
            while self.read < len(self.range.said):
                self.read += 1
                if self.range.said[self.read - 1].message.get_type() in type:
                    return self.range.said[self.read - 1].message
            self.range.run(0.01)
            Master.seconds += 0.01
        Master.seconds += 0.07
        return None


@pytest.fixture(autouse=True)
def simulated_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """The client's clock goes on only while it waits for a message."""
    clock = SimpleNamespace(time=lambda: Master.seconds, sleep=lambda seconds: None)
    monkeypatch.setattr(mavftp, "time", clock)


def client(range_: Range) -> mavftp.MAVFTP:
    return mavftp.MAVFTP(Master(range_), 1, 1)


def ask(range_: Range, opcode: int, data: bytes = b"", **more: Any) -> list[Transfer]:
    """The replies to a request, each with the data that it says."""
    session, sequence = more.pop("session", 1), more.pop("sequence", range_.serial * 10)
    packer = more.pop("packer", range_.packers[V])
    before = len(range_.heard("FILE_TRANSFER_PROTOCOL"))
    message = mav.MAVLink_file_transfer_protocol_message(0, 1, 1, ftp.pack(sequence, session, opcode, data, **more))
    range_.send_bytes(V, packer.pack(message))
    range_.run(0.02)
    replies = [ftp.unpack(bytes(one.payload)) for one in range_.heard("FILE_TRANSFER_PROTOCOL")[before:]]
    return [one._replace(data=one.data[: one.size]) for one in replies]


def one(range_: Range, opcode: int, data: bytes = b"", **more: Any) -> Transfer:
    (reply,) = ask(range_, opcode, data, **more)
    return reply


@pytest.fixture(scope="module")
def booted() -> Range:
    r = Range([VehicleSpec(V, 1)])
    r.run(0.1)
    return r


@pytest.fixture(scope="module")
def flown() -> Range:
    """An aircraft that hovers, with a mission."""
    r = Range([VehicleSpec(V, 1)])
    r.upload(V, MISSION)
    r.take_off(V, 3.0)
    return r


def test_pymavlink_lists_writes_reads_renames_and_removes(booted: Range, tmp_path: Path) -> None:
    """Two pieces of 239 bytes and a rest, in a burst; the CRC of its own bytes; what is listed after each step."""
    r, local, back = booted.copy(), tmp_path / "mine.lua", tmp_path / "back.lua"
    local.write_bytes(bytes(range(256)) * 2)
    ftp_client = client(r)

    def listed(path: str) -> list[tuple[str, bool, int]]:
        found = ftp_client.cmd_list([path]).directory_listing
        return [(entry.name, entry.is_dir, entry.size_b) for entry in found]

    assert listed("/") == [("APM", True, 0)]
    assert listed("/APM/") == [("LOGS", True, 0), ("scripts", True, 0)]
    assert ftp_client.cmd_put([str(local), "/APM/scripts/mine.lua"]).error_code == 0
    assert ftp_client.process_ftp_reply("CreateFile", timeout=20).error_code == 0
    assert listed("/APM/scripts") == [("mine.lua", False, 512)]
    assert ftp_client.cmd_get(["/APM/scripts/mine.lua", str(back)]).error_code == 0
    assert ftp_client.process_ftp_reply("OpenFileRO", timeout=20).error_code == 0
    assert back.read_bytes() == local.read_bytes()
    assert ftp_client.cmd_rename(["/APM/scripts/mine.lua", "/APM/theirs.lua"]).error_code == 0
    assert listed("/APM") == [("LOGS", True, 0), ("scripts", True, 0), ("theirs.lua", False, 512)]
    assert ftp_client.cmd_mkdir(["/APM/x"]).error_code == 0
    assert ftp_client.cmd_mkdir(["/APM/x"]).error_code == mavftp.FtpError.FileExists
    assert ftp_client.cmd_crc(["/APM/theirs.lua"]).error_code == 0
    assert ftp_client.cmd_rm(["/APM/theirs.lua"]).error_code == 0
    assert ftp_client.cmd_rmdir(["/APM/x"]).error_code == 0
    assert ftp_client.cmd_rm(["/APM/x"]).error_code == mavftp.FtpError.FileNotFound
    told = [(n.data["operation"], n.data["path"]) for n in r.events("event.file")]
    assert told[:2] == [("write", "/APM/scripts/mine.lua"), ("read", "/APM/scripts/mine.lua")]
    assert [what for what, _ in told[2:]] == ["rename", "make_directory", "remove", "remove"]


def read_whole(range_: Range, path: str) -> bytes:
    data: bytes | None = client(range_).read(path, 1 << 20)
    assert data is not None
    return data


def test_pymavlink_decodes_the_parameters_and_their_defaults(booted: Range) -> None:
    r = booted.copy()
    r.send(V, mav.MAVLink_param_set_message(1, 1, b"RTL_ALT", 2222.0, 9))
    decoded = mavftp.MAVFTP.ftp_param_decode(read_whole(r, "@PARAM/param.pck?withdefaults=1"))
    fleet = r.engines[0]._fleet
    assert {name.decode(): pytest.approx(value) for name, value, _ in decoded.params} == {
        parameter.name: fleet.stored_params[0, index] for index, parameter in enumerate(ALWAYS_LISTED)
    }
    defaults = {name.decode(): value for name, value, _ in decoded.defaults}
    assert defaults["RTL_ALT"] == 1500.0
    assert "ArduCopter V4.6.0-dev (skyrange)" in r.words()  # the banner
    part = parameters.read_download(read_whole(r, "@PARAM/param.pck?start=2&count=3"))
    assert [name for name, _ in part] == [parameter.name for parameter in ALWAYS_LISTED[2:5]]


def test_pymavlink_sets_parameters_that_nobody_is_told_of(booted: Range, tmp_path: Path) -> None:
    r, local = booted.copy(), tmp_path / "param.pck"
    local.write_bytes(parameters.pack_upload({"RTL_ALT": 9000.0, "RTL_SPEED": 300.0, "NOBODYS": 1.0}))
    ftp_client = client(r)
    assert ftp_client.cmd_put([str(local), "@PARAM/param.pck"]).error_code == 0
    assert ftp_client.process_ftp_reply("CreateFile", timeout=20).error_code == 0
    fleet = r.engines[0]._fleet
    assert (fleet.param(fleet.vehicles[0], "RTL_ALT"), fleet.param(fleet.vehicles[0], "RTL_SPEED")) == (9000.0, 300.0)
    assert r.heard("PARAM_VALUE") == []
    (first, second), (file,) = r.events("event.parameter"), r.events("event.file")
    assert (first.data, second.data["name"]) == ({"name": "RTL_ALT", "value": 9000.0}, "RTL_SPEED")
    assert first.causes == file.causes
    assert len(file.causes) == 2  # the request to open it and one to write: what an effect is traced back to
    assert file.data == {"operation": "write", "path": "@PARAM/param.pck", "bytes": 43, "error": ""}


def test_a_mission_is_read_and_replaced_as_a_file(flown: Range) -> None:
    """38 bytes for each item; a mission that is flown is replaced where MISSION_CLEAR_ALL would be refused."""
    r = flown.copy()
    data = read_whole(r, "@MISSION/mission.dat")
    read = missions.read(data, 0)
    assert len(data) == 10 + 38 * 7
    assert [item.command for item in read.items] == [16, *(item[1] for item in MISSION)]
    assert r.mode(V, 3) == 0
    r.send(V, mav.MAVLink_mission_clear_all_message(1, 1, 0))
    r.run(0.02)
    assert r.heard("MISSION_ACK")[-1].type == mav.MAV_MISSION_ERROR
    answers = len(r.heard("MISSION_ACK"))
    moved = read.items
    for item in moved[1:]:
        item.z += 7.0
    assert one(r, Opcode.CREATE_FILE, b"@MISSION/mission.dat").opcode == Opcode.ACK
    upload = missions.pack(moved, 0)
    for at in range(0, len(upload), 200):
        assert one(r, Opcode.WRITE_FILE, upload[at : at + 200], offset=at).opcode == Opcode.ACK
    assert one(r, Opcode.TERMINATE_SESSION).opcode == Opcode.ACK
    stored = r.engines[0]._fleet.vehicles[0].mission
    assert [item.z for item in stored[1:-1]] == [item.z for item in moved[1:-1]]
    assert r.events("event.mission")[-1].data == {"items": 7}
    assert len(r.heard("MISSION_ACK")) == answers


def test_fence_and_rally_points_are_files_too(booted: Range) -> None:
    r = booted.copy()
    lat, lon = -353_633_280, 1_491_652_241
    circle = mav.MAVLink_mission_item_int_message(1, 1, 0, 0, 5003, 0, 1, 80.0, 0, 0, 0, lat, lon, 0.0, 1)
    point = mav.MAVLink_mission_item_int_message(1, 1, 0, 3, 5100, 0, 1, 0, 0, 0, 0, lat, lon, 12.0, 2)
    for name, kind, item in ((b"fence.dat", 1, circle), (b"rally.dat", 2, point)):
        assert one(r, Opcode.CREATE_FILE, b"@MISSION/" + name).opcode == Opcode.ACK
        assert one(r, Opcode.WRITE_FILE, missions.pack([item], kind)).opcode == Opcode.ACK
        assert one(r, Opcode.TERMINATE_SESSION).opcode == Opcode.ACK
        (again,) = missions.read(read_whole(r, f"@MISSION/{name.decode()}"), kind).items
        assert (again.command, again.x, again.y, again.z) == (item.command, item.x, item.y, item.z)
    assert [len(r.events(f"event.{what}")) for what in ("fence", "rally")] == [1, 1]


def test_the_log_of_a_flight_is_read_while_it_flies(flown: Range, tmp_path: Path) -> None:
    """pymavlink's reader of DataFlash logs finds home, the mission, parameters and modes; LOG_REQUEST_LIST does not."""
    r = flown.copy()
    r.send(V, mav.MAVLink_param_set_message(1, 1, b"RTL_ALT", 2222.0, 9))
    r.mode(V, 5)
    r.send(V, mav.MAVLink_log_request_list_message(1, 1, 0, 0xFFFF))
    r.send(V, mav.MAVLink_log_request_list_message(1, 1, 0, 0xFFFF))
    path = tmp_path / "log.bin"
    path.write_bytes(read_whole(r, "/APM/LOGS/00000001.BIN"))
    assert (r.heard("LOG_ENTRY"), r.words().count("Disarm for log download")) == ([], 1)
    log = DFReader.DFReader_binary(str(path))
    found: dict[str, list[dict[str, Any]]] = {}
    while (message := log.recv_msg()) is not None:
        found.setdefault(message.get_type(), []).append(message.to_dict())
    assert found["PARM"][0]["Name"] == ALWAYS_LISTED[0].name
    assert (len(found["PARM"]), found["PARM"][-1]["Name"], found["PARM"][-1]["Value"]) == (
        len(ALWAYS_LISTED) + 1, "RTL_ALT", 2222.0,
    )  # fmt: skip
    assert [(item["CId"], item["CTot"]) for item in found["CMD"]][1:] == [(item[1], 7) for item in MISSION]
    assert found["ORGN"][1]["Lat"] == pytest.approx(-35.363328, abs=1e-6)
    assert found["ORGN"][1]["Alt"] == pytest.approx(584.0, abs=0.5)
    assert [(mode["ModeNum"], mode["Rsn"]) for mode in found["MODE"]][-1] == (5, 2)
    assert [event["Id"] for event in found["EV"]] == [10]
    r.command(V, 400, 0.0, 21196.0)  # disarmed by force
    r.send(V, mav.MAVLink_log_request_list_message(1, 1, 0, 0xFFFF))
    r.run(0.02)
    (entry,) = r.heard("LOG_ENTRY")
    assert (entry.id, entry.num_logs, entry.last_log_num, entry.size) == (1, 1, 1, len(path.read_bytes()) + 12)
    assert entry.time_utc == pytest.approx(1_767_323_045, abs=20)


def test_each_boot_has_a_log_of_its_own(booted: Range) -> None:
    r = booted.copy()
    for _ in range(2):
        r.arm(V)
        r.command(V, 400, 0.0, 21196.0)
    assert one(r, Opcode.LIST_DIRECTORY, b"/APM/LOGS").data.count(b".BIN") == 1
    r.command(V, 246, 1.0)
    r.arm(V)
    listed = one(r, Opcode.LIST_DIRECTORY, b"/APM/LOGS").data
    assert [name in listed for name in (b"00000001.BIN", b"00000002.BIN", b"00000003.BIN")] == [True, True, False]
    assert one(r, Opcode.OPEN_FILE_RO, b"/apm/logs/lastlog.txt").data == (3).to_bytes(4, "little")
    assert one(r, Opcode.READ_FILE, size=239).data == b"2\r\n"
    assert one(r, Opcode.TERMINATE_SESSION).opcode == Opcode.ACK
    assert one(r, Opcode.REMOVE_FILE, b"/APM/LOGS/00000002.BIN").opcode == Opcode.ACK
    r.command(V, 400, 0.0, 21196.0)
    r.arm(V)  # who removes the log of this boot ends it
    assert b"00000002" not in one(r, Opcode.LIST_DIRECTORY, b"/APM/LOGS").data


REFUSED = [
    (Opcode.LIST_DIRECTORY, b"/nothing", [Error.FILE_NOT_FOUND]),
    (Opcode.LIST_DIRECTORY, b"@PARAM/", [Error.FILE_NOT_FOUND]),
    (Opcode.LIST_DIRECTORY, b"", [Error.INVALID_DATA_SIZE]),
    (Opcode.LIST_DIRECTORY, b"/APM/LOGS", [Error.END_OF_FILE]),  # an empty one
    (Opcode.OPEN_FILE_RO, b"/APM/../secret", [Error.FILE_NOT_FOUND]),
    (Opcode.OPEN_FILE_RO, b"/APM", [Error.FILE_NOT_FOUND]),
    (Opcode.OPEN_FILE_RO, b"@SYS/tasks.txt", [Error.FILE_NOT_FOUND]),
    (Opcode.OPEN_FILE_RO, b"@PARAM/param.pck?start=65535", [Error.FAIL_ERRNO, 22]),
    (Opcode.OPEN_FILE_RO, b"@MISSION/other.dat", [Error.FILE_NOT_FOUND]),
    (Opcode.OPEN_FILE_RO, b"two\0names", [Error.INVALID_DATA_SIZE]),
    (Opcode.OPEN_FILE_WO, b"/APM/none.lua", [Error.FILE_NOT_FOUND]),
    (Opcode.CREATE_FILE, b"/none/a.lua", [Error.FILE_NOT_FOUND]),
    (Opcode.CREATE_FILE, b"/APM/scripts", [Error.FAIL_ERRNO, 13]),
    (Opcode.CREATE_FILE, b"/APM/a*.lua", [Error.FAIL_ERRNO, 22]),
    (Opcode.READ_FILE, b"", [Error.FILE_NOT_FOUND]),
    (Opcode.WRITE_FILE, b"x", [Error.FILE_NOT_FOUND]),
    (Opcode.BURST_READ_FILE, b"", [Error.FILE_NOT_FOUND]),
    (Opcode.CREATE_DIRECTORY, b"/apm", [Error.FILE_EXISTS]),
    (Opcode.CREATE_DIRECTORY, b"@MISSION/x", [Error.FILE_NOT_FOUND]),
    (Opcode.REMOVE_DIRECTORY, b"/APM", [Error.FAIL_ERRNO, 13]),
    (Opcode.RENAME, b"/APM/LOGS\0/APM/scripts", [Error.FILE_EXISTS]),
    (Opcode.RENAME, b"/APM\0/APM/LOGS/x", [Error.FAIL_ERRNO, 13]),
    (Opcode.RENAME, b"/APM", [Error.INVALID_DATA_SIZE]),
    (Opcode.CALC_FILE_CRC32, b"@PARAM/param.pck", [Error.FILE_NOT_FOUND]),
    (Opcode.TRUNCATE_FILE, b"/APM/x", [Error.UNKNOWN_COMMAND]),
    (77, b"", [Error.UNKNOWN_COMMAND]),
]


def test_what_is_refused_says_why(booted: Range) -> None:
    """The errors of GCS_FTP.cpp over those of AP_Filesystem: a number of errno is told behind FAIL_ERRNO."""
    r = booted.copy()
    for opcode, data, why in REFUSED:
        reply = one(r, opcode, data)
        assert (reply.opcode, list(reply.data), reply.request) == (Opcode.NAK, why, opcode), (opcode, data)
    assert one(r, Opcode.READ_FILE, size=240).data == bytes([Error.INVALID_DATA_SIZE])
    assert one(r, Opcode.NONE).opcode == one(r, Opcode.RESET_SESSIONS).opcode == Opcode.ACK
    assert ask(r, Opcode.ACK) == ask(r, Opcode.NAK) == []
    assert r.events("event.file") == []


def test_a_session_has_one_file_and_belongs_to_its_number_alone(booted: Range) -> None:
    """Another number is refused for 3 s; another client with the same number reads and closes the file."""
    r, thief = booted.copy(), Packer(200, 77)
    path = b"@MISSION/mission.dat"
    assert one(r, Opcode.OPEN_FILE_RO, path, session=5).session == 5
    assert one(r, Opcode.OPEN_FILE_RO, path, session=5).data == bytes([Error.FAIL])
    assert one(r, Opcode.WRITE_FILE, b"x", session=5).data == bytes([Error.FAIL])
    assert one(r, Opcode.LIST_DIRECTORY, b"/", session=6).data == bytes([Error.INVALID_SESSION])
    assert one(r, Opcode.TERMINATE_SESSION, session=6).opcode == Opcode.ACK  # and ends nothing
    assert one(r, Opcode.READ_FILE, size=4, session=5, packer=thief).data[:2] == b"\x3d\x76"
    r.run(3.0)
    assert one(r, Opcode.OPEN_FILE_RO, path, session=6).opcode == Opcode.ACK
    assert one(r, Opcode.RESET_SESSIONS, session=6, packer=thief).opcode == Opcode.ACK
    assert one(r, Opcode.READ_FILE, size=4, session=6).data == bytes([Error.FILE_NOT_FOUND])


def test_a_request_that_comes_twice_has_the_same_reply(booted: Range) -> None:
    r = booted.copy()
    first = one(r, Opcode.CREATE_DIRECTORY, b"/APM/x", sequence=9)
    assert first.opcode == Opcode.ACK
    assert one(r, Opcode.CREATE_DIRECTORY, b"/APM/x", sequence=9) == first
    assert one(r, Opcode.CREATE_DIRECTORY, b"/APM/x", sequence=10).data == bytes([Error.FILE_EXISTS])


def test_a_burst_is_paced_and_requests_wait_for_its_end(booted: Range) -> None:
    """Five pieces every 10 ms with a sequence number for each; of the requests meanwhile, five wait."""
    r = booted.copy()
    assert one(r, Opcode.CREATE_FILE, b"/APM/big").opcode == Opcode.ACK
    for at in range(0, 2000, 200):
        one(r, Opcode.WRITE_FILE, bytes([at // 200]) * 200, offset=at)
    one(r, Opcode.TERMINATE_SESSION)
    one(r, Opcode.OPEN_FILE_RO, b"/APM/big")
    begin, sent = r.now, len(r.said)
    message = ftp.pack(100, 1, Opcode.BURST_READ_FILE, size=100)
    r.send(V, mav.MAVLink_file_transfer_protocol_message(0, 1, 1, message))
    for number in range(7):
        wait = ftp.pack(500 + number, 1, Opcode.READ_FILE, size=1, offset=number)
        r.send(V, mav.MAVLink_file_transfer_protocol_message(0, 1, 1, wait))
    r.run(0.1)
    said = [(s.at_s, ftp.unpack(bytes(s.message.payload))) for s in r.said[sent:] if hasattr(s.message, "payload")]
    pieces, rest = said[:21], said[21:]
    assert [reply.sequence for _, reply in pieces] == list(range(101, 122))
    assert b"".join(reply.data[: reply.size] for _, reply in pieces[:20]) == b"".join(
        bytes([n]) * 200 for n in range(10)
    )
    assert (pieces[20][1].opcode, pieces[20][1].error, pieces[20][1].offset) == (Opcode.NAK, Error.END_OF_FILE, 2000)
    assert [round((at - begin / 1e9) * 100) for at, _ in pieces[::5]] == [0, 1, 2, 3, 4]
    assert [reply.sequence for _, reply in rest] == [501, 502, 503, 504, 505]


def test_parameters_are_read_in_pieces_of_one_size_and_no_value_crosses_two(booted: Range) -> None:
    r = booted.copy()
    one(r, Opcode.OPEN_FILE_RO, b"@PARAM/param.pck")
    assert len(one(r, Opcode.READ_FILE, size=80).data) == 80
    assert list(one(r, Opcode.READ_FILE, size=79, offset=80).data) == [Error.FAIL_ERRNO, 22]
    values = [parameters.PackedParameter(f"A{number}", 1.5, 9) for number in range(40)]
    packed = parameters.pack_download(values, 40, 80)
    ends = [at for at in range(len(packed)) if packed[at : at + 4] == b"\0\0\xc0\x3f"]
    assert len(ends) == 40
    assert all(end // 80 == (end + 3) // 80 for end in ends)
    assert [name for name, _ in parameters.read_download(packed)] == [name for name, *_ in values]


@pytest.mark.parametrize("cut", [0, 3, 6, 8, 20])
def test_a_malformed_upload_sets_what_precedes_the_fault_and_tells_nobody(booted: Range, cut: int) -> None:
    r, whole = booted.copy(), parameters.pack_upload({"RTL_ALT": 3000.0, "RTL_SPEED": math.inf, "WPNAV_SPEED": 700.0})
    data = whole[:4] + len(whole[:-cut] if cut else whole).to_bytes(2, "little") + whole[6:]
    data = data[:-cut] if cut else data
    one(r, Opcode.CREATE_FILE, b"@PARAM/param.pck")
    one(r, Opcode.WRITE_FILE, data)
    assert one(r, Opcode.TERMINATE_SESSION).opcode == Opcode.ACK
    names = [n.data["name"] for n in r.events("event.parameter")]
    assert names == (["RTL_ALT", "WPNAV_SPEED"] if cut == 0 else ["RTL_ALT"])
    assert r.events("event.file")[0].data["error"] == ("" if cut == 0 else "EINVAL")


def test_a_card_takes_only_so_much(booted: Range) -> None:
    """A write far behind the end of a file takes no memory, and a full card says so."""
    r = booted.copy()
    one(r, Opcode.CREATE_FILE, b"/APM/gap")
    assert list(one(r, Opcode.WRITE_FILE, b"x", offset=CAPACITY_BYTES).data) == [Error.FAIL_ERRNO, 5]
    assert one(r, Opcode.WRITE_FILE, b"x", offset=1000).opcode == Opcode.ACK
    assert list(one(r, Opcode.WRITE_FILE, b"").data) == [Error.FAIL_ERRNO, 5]
    one(r, Opcode.TERMINATE_SESSION)
    reply = one(r, Opcode.CALC_FILE_CRC32, b"/APM/gap")
    # of zlib's CRC32, which inverts its beginning and its end, the same over as many bytes
    table = zlib.crc32(bytes(1000) + b"x", 0xFFFFFFFF) ^ 0xFFFFFFFF
    assert reply.data == table.to_bytes(4, "little")
    for name, most in (
        (b"@PARAM/param.pck", [Error.FAIL_ERRNO, 22]),
        (b"@MISSION/mission.dat", [Error.FAIL_ERRNO, 28]),
    ):
        one(r, Opcode.CREATE_FILE, name)
        assert list(one(r, Opcode.WRITE_FILE, b"x", offset=1 << 17).data) == most
        one(r, Opcode.TERMINATE_SESSION)


def test_a_reboot_drops_the_session_and_keeps_the_card(booted: Range) -> None:
    r = booted.copy()
    one(r, Opcode.CREATE_FILE, b"@PARAM/param.pck")
    one(r, Opcode.WRITE_FILE, parameters.pack_upload({"RTL_ALT": 3000.0}))
    one(r, Opcode.CREATE_DIRECTORY, b"/APM/kept")
    r.command(V, 246, 1.0)
    assert list(one(r, Opcode.READ_FILE, size=1).data) == [Error.FILE_NOT_FOUND]
    assert b"Dkept" in one(r, Opcode.LIST_DIRECTORY, b"/APM").data
    assert r.events("event.parameter") == []


def test_a_fork_in_the_middle_of_a_burst_goes_on_identically(booted: Range) -> None:
    r = booted.copy()
    one(r, Opcode.OPEN_FILE_RO, b"@PARAM/param.pck")
    message = ftp.pack(100, 1, Opcode.BURST_READ_FILE, size=80)
    r.send(V, mav.MAVLink_file_transfer_protocol_message(0, 1, 1, message))
    r.run(0.0125)
    forked = r.copy()
    for continued in (r, forked):
        continued.run(0.2)
    assert r.frames == forked.frames
    assert decode(r.frames[V][-1]).get_type() == "FILE_TRANSFER_PROTOCOL"


def test_a_file_in_place_of_the_log_directory_leaves_no_logs(booted: Range) -> None:
    r = booted.copy()
    assert one(r, Opcode.REMOVE_DIRECTORY, b"/APM/LOGS").opcode == Opcode.ACK
    assert one(r, Opcode.CREATE_FILE, b"/APM/LOGS").opcode == Opcode.ACK
    r.send(V, mav.MAVLink_log_request_list_message(1, 1, 0, 0xFFFF))
    r.run(0.1)
    (listed,) = r.heard("LOG_ENTRY")
    assert listed.num_logs == 0
    r.take_off(V, 3.0)
    card = r.engines[0]._fleet.vehicles[0].card
    assert (card.log, card.logs()) == (None, [])


def test_a_file_that_was_removed_while_it_is_open_grows_no_larger_than_the_card(booted: Range) -> None:
    r = booted.copy()
    assert one(r, Opcode.CREATE_FILE, b"/a").opcode == Opcode.ACK
    assert one(r, Opcode.REMOVE_FILE, b"/a").opcode == Opcode.ACK
    assert one(r, Opcode.WRITE_FILE, b"x", offset=CAPACITY_BYTES * 3 // 4).opcode == Opcode.ACK
    assert one(r, Opcode.WRITE_FILE, b"x", offset=CAPACITY_BYTES).opcode == Opcode.NAK


def test_a_piece_that_is_written_for_ever_takes_no_memory(booted: Range, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "MAX_CAUSES", 5)
    r = booted.copy()
    assert one(r, Opcode.CREATE_FILE, b"/a").opcode == Opcode.ACK
    for _ in range(20):
        assert one(r, Opcode.WRITE_FILE, b"x").opcode == Opcode.ACK
    session = r.engines[0]._fleet.vehicles[0].file_server
    assert session is not None
    assert session.file is not None
    assert 0 < len(session.file.causes) <= 5
