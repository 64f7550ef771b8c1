"""Frames made by other implementations, byte for byte."""

from __future__ import annotations

import pytest

from skyrange.codec.mavlink import Deframer, Packer, Piece, decode, dialect, message_fields

# rust-mavlink, mavlink/tests: test_shared/mod.rs, signing.rs, v2_encode_decode_tests.rs
HEARTBEAT_V1 = bytes.fromhex("fe09ef0102000500000002035903031f50")
HEARTBEAT_V2 = bytes.fromhex("fd090000ef01020000000500000002035903032e73")
HEARTBEAT_SIGNED = bytes.fromhex("fd090100ef0102000000050000000203590303c98b00ffffffffffff2718b168ccf5")
COMMAND_LONG_TRUNCATED = bytes.fromhex(
    "fd1e00000000324c0000" + "0000e64200409c45" + "00" * 20 + "ff01" + "bcc3"
)  # ask for message 115 (HIL_STATE_QUATERNION) every 5000 µs; of 33 payload bytes the last three are zero, unsent
PARAM_BAT1 = bytes.fromhex("fd1900005a01011600000000" + "80bff503040042" + "4154315f525f494e5445524e414c0009d414")
PARAM_HASH = bytes.fromhex("fd190000ed010116000052538984f503ffff5f484153485f434845434b000000000005" + "8787")
# A frame captured from an ArduPilot telemetry port, printed in a 2015 article (brucebotstudio.com, "Mavlink").
HEARTBEAT_CAPTURED = bytes.fromhex("FE 09 4E 01 01 00 00 00 00 00 02 03 51 04 03 1C 7F")

ALL = [
    HEARTBEAT_V1,
    HEARTBEAT_V2,
    HEARTBEAT_SIGNED,
    COMMAND_LONG_TRUNCATED,
    PARAM_BAT1,
    PARAM_HASH,
    HEARTBEAT_CAPTURED,
]


@pytest.mark.parametrize("frame", [HEARTBEAT_V1, HEARTBEAT_V2, HEARTBEAT_SIGNED])
def test_heartbeat(frame: bytes) -> None:
    message = decode(frame)
    assert message.get_type() == "HEARTBEAT"
    assert (message.get_seq(), message.get_srcSystem(), message.get_srcComponent()) == (239, 1, 2)
    assert message_fields(message) == {
        "type": dialect.MAV_TYPE_QUADROTOR,
        "autopilot": dialect.MAV_AUTOPILOT_ARDUPILOTMEGA,
        "base_mode": 0x59,
        "custom_mode": 5,
        "system_status": dialect.MAV_STATE_STANDBY,
        "mavlink_version": 3,
    }


def test_captured_heartbeat() -> None:
    message = decode(HEARTBEAT_CAPTURED)
    assert (message.get_seq(), message.base_mode, message.system_status) == (0x4E, 0x51, dialect.MAV_STATE_ACTIVE)


def test_truncated_payload_is_filled_with_zeros() -> None:
    message = decode(COMMAND_LONG_TRUNCATED)
    assert message.command == dialect.MAV_CMD_SET_MESSAGE_INTERVAL
    assert (message.param1, message.param2, message.param7) == (115.0, 5000.0, 0.0)
    assert (message.target_system, message.target_component, message.confirmation) == (0, 0, 0)


def test_parameter_text() -> None:
    assert message_fields(decode(PARAM_BAT1)) == {
        "param_id": "BAT1_R_INTERNAL",
        "param_value": -1.0,
        "param_type": dialect.MAV_PARAM_TYPE_REAL32,
        "param_count": 1013,
        "param_index": 4,
    }
    assert decode(PARAM_HASH).param_id == "_HASH_CHECK"


@pytest.mark.parametrize("frame", [HEARTBEAT_V2, COMMAND_LONG_TRUNCATED, PARAM_BAT1, PARAM_HASH])
def test_packing_gives_the_same_bytes(frame: bytes) -> None:
    message = decode(frame)
    packer = Packer(message.get_srcSystem(), message.get_srcComponent())
    packer.sequence = message.get_seq()
    assert packer.pack(message) == frame


def test_a_stream_of_them_all() -> None:
    deframer = Deframer()
    stream = b"".join(ALL)
    assert deframer.feed(stream) == [Piece(frame, garbage=False) for frame in ALL]
    assert deframer.finish() == []
    assert deframer.counts.frames == len(ALL)
