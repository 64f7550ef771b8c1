from __future__ import annotations

import copy
import math

import numpy as np
import pytest

from skyrange.codec.mavlink import (
    Deframer,
    Packer,
    Piece,
    decode,
    dialect,
    message_fields,
    message_id,
    message_name,
    sender_system,
)
from skyrange.codec.mavlink.message_columns import classify_frames
from skyrange.contracts.frames import Payloads
from skyrange.core.errors import DecodeError

HEARTBEAT = dialect.MAVLink_heartbeat_message(2, 3, 0x59, 5, 3, 3)


def pymavlink_frame(message: object, sequence: int = 0, v1: bool = False) -> bytes:
    mav = dialect.MAVLink(None, 7, 1)
    mav.seq = sequence
    return bytes(message.pack(mav, force_mavlink1=v1))  # type: ignore[attr-defined]


FRAME = pymavlink_frame(HEARTBEAT)


def with_checksum(covered: bytes, crc_extra: int) -> bytes:
    crc = dialect.x25crc(covered[1:])
    crc.accumulate(bytes([crc_extra]))
    return covered + bytes(crc.crc.to_bytes(2, "little"))


def test_decoding_is_shared_and_carries_the_header() -> None:
    message = decode(FRAME)
    assert decode(bytes(bytearray(FRAME))) is message
    assert (message.get_srcSystem(), message.get_srcComponent(), message.get_seq()) == (7, 1, 0)
    assert message.get_msgbuf() == FRAME
    assert message.get_payload() == FRAME[10:-2]


@pytest.mark.parametrize(
    ("payload", "says"),
    [
        (b"", "0 bytes"),
        (b"\xfd" * 8, "at least 12"),
        (b"\x00" * 20, "first byte 0x00"),
        (FRAME + b"\0", "header announces"),
        (FRAME[:2] + b"\x02" + FRAME[3:], "incompatibility flags 0x02"),
        (FRAME[:2] + b"\x01" + FRAME[3:], "header announces"),
        (FRAME[:7] + b"\xff\xff\xff" + FRAME[10:], "message id 16777215"),
        (FRAME[:-1] + bytes([FRAME[-1] ^ 1]), "HEARTBEAT checksum"),
    ],
)
def test_what_is_wrong_is_said(payload: bytes, says: str) -> None:
    with pytest.raises(DecodeError, match=says):
        decode(payload)


def test_a_mavlink_1_frame_decodes_as_its_mavlink_2_twin() -> None:
    assert message_fields(decode(pymavlink_frame(HEARTBEAT, v1=True))) == message_fields(decode(FRAME))


def test_bytes_beyond_the_known_definition_are_ignored() -> None:
    # a newer sender's extension field: serialization guide, "MAVLink 2 extensions"
    longer = with_checksum(b"\xfd\x0a" + FRAME[2:-2] + b"\x2a", HEARTBEAT.crc_extra)
    assert message_fields(decode(longer)) == message_fields(decode(FRAME))


def test_packing_leaves_the_message_as_it_was() -> None:
    message = decode(FRAME)
    Packer(9, 9).pack(message)
    assert (message.get_srcSystem(), message.get_msgbuf()) == (7, FRAME)


def test_the_sequence_number_rolls_over() -> None:
    packer = Packer(7, 1)
    frames = [packer.pack(HEARTBEAT) for _ in range(257)]
    assert [frame[4] for frame in frames] == [*range(256), 0]
    assert frames[255] == pymavlink_frame(HEARTBEAT, 255)


def test_a_copied_packer_goes_on_alike() -> None:
    packer = Packer(7, 1)
    packer.pack(HEARTBEAT)
    twin = copy.deepcopy(packer)
    assert twin.pack(HEARTBEAT) == packer.pack(HEARTBEAT) == pymavlink_frame(HEARTBEAT, 1)


def test_what_does_not_fit_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match=r"HEARTBEAT.*'custom_mode': -1"):
        Packer(1, 1).pack(dialect.MAVLink_heartbeat_message(2, 3, 0, -1, 3, 3))
    with pytest.raises(ValueError, match="data: 3 values, expected 70"):
        Packer(1, 1).pack(dialect.MAVLink_serial_control_message(0, 0, 0, 0, 3, [1, 2, 3]))
    with pytest.raises(ValueError, match="system 256"):
        Packer(256, 1)


def test_describe_flattens_arrays_and_keeps_texts() -> None:
    packer = Packer(1, 1)
    row = message_fields(decode(packer.pack(dialect.MAVLink_statustext_message(6, b"Arm: \xff\0junk"))))
    assert row == {"severity": 6, "text": "Arm: \ufffd", "id": 0, "chunk_seq": 0}
    controls = [float(place) for place in range(16)]
    row = message_fields(decode(packer.pack(dialect.MAVLink_hil_actuator_controls_message(9, controls, 0, 0))))
    assert [row[f"controls[{place}]"] for place in range(16)] == controls
    assert "controls" not in row


def test_nan_survives() -> None:
    message = dialect.MAVLink_attitude_message(1, math.nan, math.inf, 0, 0, 0, 0)
    back = decode(Packer(1, 1).pack(message))
    assert math.isnan(back.roll)
    assert back.pitch == math.inf


def test_header_peeks() -> None:
    v1 = pymavlink_frame(HEARTBEAT, v1=True)
    odid = Packer(250, 1).pack(dialect.MAVLink_open_drone_id_system_update_message(0, 0, 1, 1, 0.0, 1))
    assert [message_id(payload) for payload in (FRAME, v1, odid)] == [0, 0, 12919]
    assert [message_name(payload) for payload in (FRAME, v1, odid)] == [
        "HEARTBEAT",
        "HEARTBEAT",
        "OPEN_DRONE_ID_SYSTEM_UPDATE",
    ]
    assert [sender_system(payload) for payload in (FRAME, v1, odid)] == [7, 7, 250]
    for nothing in (b"", b"\xfd", b"\xfd" * 11, b"\xfe" * 7, b"POST / HTTP/1.1"):
        assert message_id(nothing) is None
        assert message_name(nothing) is None
        assert sender_system(nothing) is None
    assert message_id(FRAME[:7] + b"\xff\xff\xff" + FRAME[10:]) == 0xFFFFFF
    assert message_name(FRAME[:7] + b"\xff\xff\xff" + FRAME[10:]) is None


def pieces(*chunks: bytes) -> tuple[Deframer, list[Piece]]:
    deframer = Deframer()
    out = [piece for chunk in chunks for piece in deframer.feed(chunk)]
    return deframer, out + deframer.finish()


def good(data: bytes) -> Piece:
    return Piece(data, garbage=False)


def garbage(data: bytes) -> Piece:
    return Piece(data, garbage=True)


def test_garbage_around_frames() -> None:
    deframer, out = pieces(b"boot\r\n" + FRAME + b"\xfd\xfd" + FRAME + b"bye")
    assert out == [garbage(b"boot\r\n"), good(FRAME), garbage(b"\xfd\xfd"), good(FRAME), garbage(b"bye")]
    counts = deframer.counts
    assert (counts.frames, counts.garbage_bytes, counts.bad_checksums, counts.truncated) == (2, 11, 0, 0)


def test_a_good_frame_inside_a_bad_one_is_found() -> None:
    # the outer header announces 40 bytes of payload, so it swallows what follows until its checksum fails
    outer = b"\xfd\x28" + FRAME[2:10] + b"abc"
    deframer, out = pieces(outer + FRAME + bytes(60))
    assert out == [garbage(outer), good(FRAME), garbage(bytes(60))]
    assert deframer.counts.bad_checksums == 1


def test_an_unknown_message_is_garbage_counted_apart() -> None:
    unknown = with_checksum(b"\xfd\x04\0\0\0\x07\x01\xff\xff\x7f" + b"abcd", 0)
    deframer, out = pieces(unknown + FRAME)
    assert out == [garbage(unknown), good(FRAME)]
    assert (deframer.counts.unknown_messages, deframer.counts.bad_checksums) == (1, 0)


def test_a_frame_with_flags_of_a_later_protocol_is_garbage() -> None:
    # serialization guide: a packet with an incompat_flags bit that is not understood must be discarded
    later = with_checksum(FRAME[:2] + b"\x02" + FRAME[3:-2], HEARTBEAT.crc_extra)
    deframer, out = pieces(later + FRAME)
    assert out == [garbage(later), good(FRAME)]
    assert deframer.counts.bad_checksums == 0


def test_a_truncated_end_is_told_once_and_searched() -> None:
    deframer, out = pieces(FRAME, FRAME[:-1])
    assert out == [good(FRAME), garbage(FRAME[:-1])]
    assert deframer.counts.truncated == 1
    # what looked like the head of a long frame was none: the frame it hid is not lost
    head = b"\xfd\xff" + FRAME[2:10]
    deframer, out = pieces(head + FRAME)
    assert out == [garbage(head), good(FRAME)]
    assert deframer.counts.truncated == 0


def test_it_holds_back_no_more_than_a_frame_and_can_be_copied() -> None:
    deframer = Deframer()
    assert deframer.feed(b"\xfd\xff\x01" + bytes(200)) == []
    twin = copy.deepcopy(deframer)
    assert sum(len(piece.data) for piece in deframer.feed(bytes(100))) == 303
    assert twin.feed(bytes(100)) == [garbage(b"\xfd\xff\x01" + bytes(300))]


def test_a_finished_deframer_takes_another_stream() -> None:
    deframer = Deframer()
    deframer.feed(FRAME[:5])
    deframer.finish()
    assert deframer.feed(FRAME) == [good(FRAME)]


def test_the_kinds_of_a_column_are_found_once_and_taken_along() -> None:
    beats = [dialect.MAVLink_heartbeat_message(2, 3, 81, mode, 4, 3) for mode in range(4)]
    frames = Payloads.of([Packer(1, 1).pack(beat) for beat in beats])
    found = classify_frames(frames)
    assert classify_frames(frames) is found
    rows = np.array([2, 0])
    taken = frames.take(rows)
    assert taken.kinds is not None
    assert np.array_equal(classify_frames(taken), found[rows])
    mixed = Payloads.join([frames, Payloads.of([b"\xfd", b""])])
    assert classify_frames(mixed).tolist() == [*found.tolist(), -1, -1]
