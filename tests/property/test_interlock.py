"""No bytes make a message leave that moves a vehicle: what comes out is looked at by rules of our own."""

from __future__ import annotations

import struct
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrange.codec.mavlink import Packer, decode
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.deframer import Deframer
from skyrange.codec.mavlink.frames import LAYOUTS, checksum, pack_header_v2
from skyrange.vehicle.external.interlock import PERMITTED_COMMANDS, PERMITTED_MESSAGES, Interlock
from tests.tiers import examples

SYSTEM = 7
HARMLESS = {
    "AUTOPILOT_VERSION_REQUEST", "HEARTBEAT", "MISSION_ACK", "MISSION_REQUEST", "MISSION_REQUEST_INT",
    "MISSION_REQUEST_LIST", "PARAM_REQUEST_LIST", "PARAM_REQUEST_READ", "PING", "REQUEST_DATA_STREAM", "TIMESYNC",
}  # fmt: skip
HARMLESS_COMMANDS = {410, 510, 511, 512, 519, 520}


def harmless(frame: bytes) -> bool:
    said = decode(frame)
    if frame[0] != 0xFD or frame[2] != 0:
        return False
    if said.get_type() == "COMMAND_LONG":
        return bool(said.target_system == SYSTEM and said.command in HARMLESS_COMMANDS)
    if said.get_type() == "HEARTBEAT":
        return bool(said.get_srcSystem() == SYSTEM and said.get_srcComponent() != 1)
    return said.get_type() in HARMLESS and getattr(said, "target_system", SYSTEM) in (0, SYSTEM)


def whatever_is_found_in(stream: bytes) -> list[bytes]:
    """Every frame that a receiver finds, wherever in the stream it begins to listen."""
    found = []
    for at in range(len(stream)):
        pieces = Deframer().feed(stream[at:])
        found += [piece.data for piece in pieces[:1] if not piece.garbage]
    return found


def v2(number: int, body: bytes, system: int = 255, component: int = 190, sequence: int = 0, flags: int = 0) -> bytes:
    covered = pack_header_v2(
        0xFD, len(body), flags, 0, sequence, system, component, number & 0xFFFF, number >> 16
    ) + body  # fmt: skip
    return covered + checksum(covered[1:], LAYOUTS[number].crc_extra).to_bytes(2, "little") + bytes(13 * flags)


def v1(number: int, body: bytes, system: int = 255) -> bytes:
    covered = bytes((0xFE, len(body), 0, system, 190, number)) + body
    return covered + checksum(covered[1:], LAYOUTS[number].crc_extra).to_bytes(2, "little")


bytes_ = st.integers(0, 255)
likely = st.sampled_from([*PERMITTED_MESSAGES, 0, 4, 111, 11, 76, 75, 44, 73, 23, 70, 84, 86, 69, 110, 126, 256, 51])
numbers = likely | st.sampled_from(sorted(LAYOUTS))


@st.composite
def frames(draw: st.DrawFn) -> bytes:
    """A valid frame of any message, with any content, half of them addressed to the vehicle."""
    number = draw(numbers)
    size = LAYOUTS[number].size
    body = bytearray(draw(st.binary(min_size=1, max_size=min(255, size + draw(st.sampled_from([0, 0, 60]))))))
    if draw(st.booleans()) and len(body) >= size:
        for name in ("target_system", "target_component"):
            cls: Any = LAYOUTS[number].cls
            if name in cls.fieldnames:
                order = cls.ordered_fieldnames.index(name)
                sizes = struct.calcsize(cls.unpacker.format[: 1 + order])
                body[sizes] = SYSTEM if name == "target_system" else 1
    if number < 256 and draw(st.integers(0, 4)) == 0:
        return v1(number, bytes(body[:255]), draw(bytes_))
    system, component = draw(st.sampled_from([255, SYSTEM, 254])), draw(st.sampled_from([190, 191, 1, 253]))
    return v2(number, bytes(body), system, component, draw(bytes_), draw(st.sampled_from([0, 0, 0, 1])))


@st.composite
def commands(draw: st.DrawFn) -> bytes:
    number = draw(st.sampled_from(sorted(PERMITTED_COMMANDS)) | st.integers(0, 65_535))
    params = [draw(st.floats(width=32)) for _ in range(7)]
    target = draw(st.sampled_from([SYSTEM, SYSTEM, 0, 8]))
    body = struct.pack("<7fHBBB", *params, number, target, draw(st.sampled_from([0, 1, 154])), 0)
    return v2(76, body)


pieces = st.lists(st.binary(max_size=300) | frames() | commands(), max_size=8)


@settings(max_examples=examples(400), deadline=None)
@given(pieces, st.booleans())
def test_what_leaves_a_closed_interlock_only_asks(payloads: list[bytes], joined: bool) -> None:
    """And so does whatever a receiver may find that lost its place, or that has another idea of it."""
    lock = Interlock(SYSTEM)
    left = b"".join(
        payload for payload in ([b"".join(payloads)] if joined else payloads) if lock.check(payload) is None
    )
    assert all(harmless(frame) for frame in whatever_is_found_in(left))
    assert not [piece for piece in Deframer().feed(left) if piece.garbage]


@settings(max_examples=examples(200), deadline=None)
@given(pieces)
def test_what_leaves_an_open_one_is_whole_and_for_no_other(payloads: list[bytes]) -> None:
    lock = Interlock(SYSTEM, open_=True)
    left = b"".join(payload for payload in payloads if lock.check(payload) is None)
    for frame in whatever_is_found_in(left):
        said = decode(frame)
        target = getattr(said, "target_system", getattr(said, "target", SYSTEM))
        assert target == SYSTEM or (target == 0 and said.get_type() in ("PING", "TIMESYNC"))


GROUND = Packer(255, 190)
LONG = mav.MAVLink_command_long_message
ARM = LONG(SYSTEM, 1, mav.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0)
MOTION = [
    ARM,
    LONG(SYSTEM, 1, mav.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 0, 10),
    LONG(SYSTEM, 1, mav.MAV_CMD_MISSION_START, 0, 0, 0, 0, 0, 0, 0, 0),
    LONG(SYSTEM, 1, mav.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 0, 1, 0, 0, 0, 0, 0, 0),
    LONG(SYSTEM, 1, mav.MAV_CMD_DO_MOTOR_TEST, 0, 1, 0, 50, 2, 0, 0, 0),
    LONG(SYSTEM, 1, mav.MAV_CMD_DO_SET_SERVO, 0, 9, 1900, 0, 0, 0, 0, 0),
    mav.MAVLink_command_int_message(SYSTEM, 1, 0, mav.MAV_CMD_COMPONENT_ARM_DISARM, 0, 0, 1, 0, 0, 0, 0, 0, 0),
    mav.MAVLink_command_int_message(SYSTEM, 1, 0, mav.MAV_CMD_REQUEST_MESSAGE, 0, 0, 1, 0, 0, 0, 0, 0, 0),
    mav.MAVLink_set_mode_message(SYSTEM, 1, 4),
    mav.MAVLink_mission_count_message(SYSTEM, 1, 3),
    mav.MAVLink_mission_item_int_message(SYSTEM, 1, 1, 6, 16, 0, 1, 0, 0, 0, 0, 0, 0, 10),
    mav.MAVLink_mission_set_current_message(SYSTEM, 1, 2),
    mav.MAVLink_mission_clear_all_message(SYSTEM, 1),
    mav.MAVLink_param_set_message(SYSTEM, 1, b"ARMING_CHECK", 0.0, 9),
    mav.MAVLink_rc_channels_override_message(SYSTEM, 1, 1500, 1500, 1900, 1500, 0, 0, 0, 0),
    mav.MAVLink_manual_control_message(SYSTEM, 0, 0, 1000, 0, 0),
    mav.MAVLink_set_position_target_global_int_message(0, SYSTEM, 1, 6, 0xDF8, 0, 0, 10, 0, 0, 0, 0, 0, 0, 0, 0),
    mav.MAVLink_set_attitude_target_message(0, SYSTEM, 1, 0, [1, 0, 0, 0], 0, 0, 0, 0.9),
    mav.MAVLink_file_transfer_protocol_message(0, SYSTEM, 1, bytes(251)),
    mav.MAVLink_serial_control_message(10, 0, 0, 0, 1, bytes(70)),
    mav.MAVLink_setup_signing_message(SYSTEM, 1, bytes(32), 0),
    mav.MAVLink_set_gps_global_origin_message(SYSTEM, 0, 0, 0),
    mav.MAVLink_gps_input_message(0, 0, 0, 0, 0, 3, 0, 0, 0, 1, 1, 0, 0, 0, 1, 1, 1, 10),
    mav.MAVLink_system_time_message(1, 1),
    mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3),
    mav.MAVLink_open_drone_id_arm_status_message(0, b""),
    mav.MAVLink_param_request_read_message(SYSTEM + 1, 1, b"X", -1),
    mav.MAVLink_param_request_read_message(0, 1, b"X", -1),
    mav.MAVLink_ping_message(1, 1, SYSTEM + 1, 1),
    LONG(SYSTEM, 1, mav.MAV_CMD_SET_MESSAGE_INTERVAL, 0, 33, 100, 0, 0, 0, 0, 0),
    LONG(SYSTEM, 1, mav.MAV_CMD_SET_MESSAGE_INTERVAL, 0, 0, -1, 0, 0, 0, 0, 0),
    LONG(SYSTEM, 1, mav.MAV_CMD_SET_MESSAGE_INTERVAL, 0, 33, float("nan"), 0, 0, 0, 0, 0),
]
ASKING = [
    mav.MAVLink_param_request_list_message(SYSTEM, 1),
    mav.MAVLink_param_request_read_message(SYSTEM, 1, b"WPNAV_SPEED", -1),
    mav.MAVLink_mission_request_list_message(SYSTEM, 1),
    mav.MAVLink_mission_request_int_message(SYSTEM, 1, 253),
    mav.MAVLink_mission_ack_message(SYSTEM, 1, 0),
    mav.MAVLink_request_data_stream_message(SYSTEM, 1, 6, 10, 1),
    mav.MAVLink_timesync_message(0, 5),
    mav.MAVLink_ping_message(1, 1, 0, 0),
    LONG(SYSTEM, 1, mav.MAV_CMD_SET_MESSAGE_INTERVAL, 0, 33, 100_000, 0, 0, 0, 0, 0),
    LONG(SYSTEM, 1, mav.MAV_CMD_REQUEST_MESSAGE, 0, 148, 0, 0, 0, 0, 0, 0),
]


@pytest.mark.parametrize("message", MOTION, ids=lambda m: f"{m.get_type()}-{getattr(m, 'command', '')}")
def test_what_moves_or_writes_is_refused(message: Any) -> None:
    lock = Interlock(SYSTEM)
    assert lock.check(GROUND.pack(message)) is not None
    assert sum(lock.refused.values()) == 1


@pytest.mark.parametrize("message", ASKING, ids=lambda m: f"{m.get_type()}-{getattr(m, 'command', '')}")
def test_what_asks_passes(message: Any) -> None:
    assert Interlock(SYSTEM).check(GROUND.pack(message)) is None


def test_an_open_one_lets_motion_pass_but_to_others() -> None:
    lock = Interlock(SYSTEM, open_=True)
    assert lock.check(GROUND.pack(ARM)) is None
    for target in (0, SYSTEM + 1):
        other = LONG(target, 1, mav.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0)
        assert lock.check(GROUND.pack(other)) is not None
    assert lock.check(GROUND.pack(mav.MAVLink_ping_message(1, 1, SYSTEM + 1, 1))) is not None
    assert lock.check(b"arm, please") is not None
    assert lock.check(GROUND.pack(ARM)[:-1]) is not None


def test_no_frame_hides_in_another_or_across_two() -> None:
    """As a receiver would find it that lost the first byte of what carries it."""
    skip = v1(41, struct.pack("<HBB", 2, SYSTEM, 1))
    assert len(skip) == 12
    lock = Interlock(SYSTEM)
    carried = GROUND.pack(mav.MAVLink_param_request_read_message(SYSTEM, 1, skip + b"abcd", -1))
    assert skip in carried
    assert lock.check(carried) == ("PARAM_REQUEST_READ", "", "another frame is hidden in it")
    head = bytes((18, 0, 255, 190, mav.MAVLINK_MSG_ID_SET_MODE))
    first = v2(20, struct.pack("<hBB", -1, SYSTEM, 1) + b"a" * 10 + b"\xfe" + head)
    begun = v2(20, struct.pack("<hBB", -1, SYSTEM, 1) + bytes(16))[:14] + b"bb"
    ends = checksum(head + first[-2:] + begun, LAYOUTS[mav.MAVLINK_MSG_ID_SET_MODE].crc_extra).to_bytes(2, "little")
    second = v2(20, begun[10:] + ends + b"c" * 12)
    assert lock.check(first) is None
    assert lock.check(second) == ("PARAM_REQUEST_READ", "", "another frame is hidden in it")
    assert Interlock(SYSTEM).check(second) is None, "by itself it hides nothing"
