"""The standard's resolutions, limits and unknown values, and what is named where a message departs from them.

F3411-22a, Location/Vector and System messages; the same constants in opendroneid-core-c, `opendroneid.h`.
"""

from __future__ import annotations

import pytest

from skyrange.codec.f3411 import (
    Authentication,
    BasicId,
    IdType,
    Location,
    Message,
    MessagePack,
    OperatorId,
    SelfId,
    System,
    decode,
    deviations,
    encode,
    is_serial_number,
    values,
)
from skyrange.core.errors import DecodeError


@pytest.mark.parametrize(
    ("speed_mps", "byte", "fast", "read_mps"),
    [
        (0.0, 0, 0, 0.0), (0.12, 0, 0, 0.0), (0.13, 1, 0, 0.25), (63.75, 255, 0, 63.75), (64.0, 255, 0, 63.75),
        (64.125, 255, 0, 63.75), (64.2, 1, 1, 64.5),
        (254.0, 254, 1, 254.25), (254.25, 254, 1, 254.25), (300.0, 254, 1, 254.25), (None, 255, 1, None),
    ],
)  # fmt: skip
def test_horizontal_speed_has_two_resolutions_and_saturates(
    speed_mps: float | None, byte: int, fast: int, read_mps: float | None
) -> None:
    assert values.encode_speed(speed_mps) == (byte, fast)
    assert values.decode_speed(byte, fast) == read_mps


@pytest.mark.parametrize(
    ("vertical_mps", "byte", "read_mps"),
    [(0.0, 0, 0.0), (-0.5, -1, -0.5), (62.0, 124, 62.0), (80.0, 124, 62.0), (-80.0, -124, -62.0), (None, 126, None)],
)
def test_vertical_speed(vertical_mps: float | None, byte: int, read_mps: float | None) -> None:
    assert values.encode_vertical(vertical_mps) == byte
    assert values.decode_vertical(byte) == read_mps


@pytest.mark.parametrize(
    ("altitude_m", "word", "read_m"),
    [
        (None, 0, None), (-1000.0, 1, -999.5), (-999.5, 1, -999.5), (0.0, 2000, 0.0), (12.5, 2025, 12.5),
        (31767.5, 65535, 31767.5), (40000.0, 65535, 31767.5),
    ],
)  # fmt: skip
def test_altitude(altitude_m: float | None, word: int, read_m: float | None) -> None:
    assert values.encode_altitude(altitude_m) == word
    assert values.decode_altitude(word) == read_m


@pytest.mark.parametrize(
    ("track_deg", "byte", "west", "read_deg"),
    [
        (0.0, 0, 0, 0.0), (179.4, 179, 0, 179.0), (179.6, 0, 1, 180.0), (271.0, 91, 1, 271.0), (359.4, 179, 1, 359.0),
        (359.6, 0, 0, 0.0), (360.0, 0, 0, 0.0), (None, 181, 1, None),
    ],
)  # fmt: skip
def test_track_has_an_east_west_bit(track_deg: float | None, byte: int, west: int, read_deg: float | None) -> None:
    assert values.encode_track(track_deg) == (byte, west)
    assert values.decode_track(byte, west) == read_deg


def test_time_counts_tenths_since_the_hour() -> None:
    assert values.encode_time(3599.94) == 35999
    assert values.encode_time(3600.0) == 36000
    assert values.encode_time(None) == 0xFFFF
    assert values.decode_time(0xFFFF) is None
    assert values.decode_time(1234) == 123.4
    with pytest.raises(ValueError, match="timestamp_s"):
        values.encode_time(6553.5)


def test_both_zero_is_an_unknown_place_and_one_zero_is_not() -> None:
    assert values.decode_position(0, 0) == (None, None)
    assert values.decode_position(0, 5) == (0.0, 5e-7)
    assert values.encode_position(None, None) == (0, 0)
    with pytest.raises(ValueError, match="both or neither"):
        values.encode_position(1.0, None)


def test_accuracies_promise_the_most_that_holds() -> None:
    assert values.accuracy_code(values.HORIZONTAL_ACCURACY_M, 2.5) == 11  # < 3 m
    assert values.accuracy_code(values.HORIZONTAL_ACCURACY_M, 3.0) == 10
    assert values.accuracy_code(values.HORIZONTAL_ACCURACY_M, 20_000.0) == 0
    assert values.accuracy_code(values.VERTICAL_ACCURACY_M, 0.5) == 6
    assert values.accuracy_code(values.SPEED_ACCURACY_MPS, 0.5) == 3
    assert values.accuracy_code(values.SPEED_ACCURACY_MPS, None) == 0
    assert values.accuracy_code(values.SPEED_ACCURACY_MPS, float("nan")) == 0
    assert len(values.HORIZONTAL_ACCURACY_M) == 13
    assert values.HORIZONTAL_ACCURACY_M[1] == 18_520.0


@pytest.mark.parametrize(
    ("message", "named"),
    [
        (Location(9), "status 9"),
        (Location(2, 95.0, 10.0), "lat_deg 95"),
        (Location(2, 10.0, -190.0), "lon_deg -190"),
        (Location(2, speed_mps=254.25), "speed_mps 254.25"),
        (Location(2, vertical_mps=62.0), "vertical_mps 62"),
        (Location(2, timestamp_s=4000.0), "timestamp_s 4000"),
        (Location(2, horizontal_accuracy=13), "horizontal_accuracy 13"),
        (Location(2, vertical_accuracy=7), "vertical_accuracy 7"),
        (Location(2, baro_accuracy=15), "baro_accuracy 15"),
        (Location(2, speed_accuracy=5), "speed_accuracy 5"),
        (Location(2, version=3), "version 3"),
        (BasicId(5, 0, "x"), "id_type 5"),
        (BasicId(1, 0, "hello"), "CTA-2063-A"),
        (BasicId(2, 0, "N\x07"), "plain ASCII"),
        (Authentication(6, 0, bytes(17), 0, 0, 0), "auth_type 6"),
        (Authentication(1, 0, bytes(17), 16, 0, 0), "last_page 16"),
        (Authentication(1, 0, bytes(17), 1, 41, 0), "length 41"),
        (SelfId(3, "x"), "description_type 3"),
        (SelfId(0, "é"), "plain ASCII"),
        (System(3), "operator_location_type 3"),
        (System(0, 91.0, 0.0), "operator_lat_deg 91"),
        (System(0, classification=2), "classification 2"),
        (System(0, classification=1, category=4), "category 4"),
        (System(0, classification=1, ua_class=8), "ua_class 8"),
        (OperatorId(1, "x"), "operator_id_type 1"),
        (MessagePack((Location(2), Location(2))), "2 messages Location"),
        (MessagePack((SelfId(0, "x"), Location(7))), "message 1, Location: status 7"),
    ],
)
def test_what_the_standard_forbids_is_read_as_it_is_and_named(message: Message, named: str) -> None:
    again = decode(encode(message))
    assert again == message
    found = deviations(again)
    assert len(found) == 1
    assert named in found[0]


@pytest.mark.parametrize(
    ("place", "byte", "named"), [(4, 125, "vertical_mps 62.5"), (4, 130, "vertical_mps -63"), (2, 200, "track_deg 380")]
)
def test_bytes_outside_their_range_are_read_as_what_they_add_up_to(place: int, byte: int, named: str) -> None:
    raw = bytearray(encode(Location(2, track_deg=200.0)))
    raw[place] = byte
    assert any(named in text for text in deviations(decode(bytes(raw))))


def test_an_honest_broadcast_has_no_faults() -> None:
    pack = MessagePack(
        (
            BasicId(IdType.SERIAL_NUMBER, 2, "1ABCC2345EF678XYZ"),
            BasicId(IdType.SPECIFIC_SESSION, 2, "\x01\xff\x00\x10"),
            Location(2, 40.7, -73.9, 12.5, 10.0, 30.0, 0, 12.0, -1.0, 271.0, 11, 5, 4, 3, 1, 1234.5),
            SelfId(0, "Roof inspection"),
            System(1, 40.7, -73.9, 3.0, timestamp_s=220_000_000),
            OperatorId(0, "FIN87astrdge12k8"),
        )
    )
    assert deviations(decode(encode(pack))) == ()


def test_serial_numbers_by_cta_2063() -> None:
    assert is_serial_number("1ABCC2345EF678XYZ")  # manufacturer 1ABC, C: twelve more
    assert is_serial_number("MFRX1Z")
    assert not is_serial_number("1ABCC2345EF678XY")
    assert not is_serial_number("IABC11")
    assert not is_serial_number("")


def test_binary_identifiers_have_a_printable_label() -> None:
    raw = bytes.fromhex("550e8400e29b41d4a716446655440000")  # of a UUID the last bytes may be zeros
    body = bytearray(encode(BasicId(IdType.UTM_UUID, 2, "")))
    body[2:18] = raw
    message = decode(bytes(body))
    assert isinstance(message, BasicId)
    assert message.label == "550e8400-e29b-41d4-a716-446655440000"
    assert BasicId(IdType.SPECIFIC_SESSION, 0, "\x01\xfe").label == "session:01fe"
    assert BasicId(IdType.SERIAL_NUMBER, 0, "MFRX1Z").label == "MFRX1Z"


@pytest.mark.parametrize(
    "message",
    [
        BasicId(1, 2, "x" * 21), BasicId(1, 2, "日"), BasicId(16, 2, "x"), SelfId(0, "x" * 24), SelfId(256, "x"),
        OperatorId(0, "x" * 21), Location(16), Location(height_type=2), Location(speed_mps=-1.0),
        Location(speed_mps=float("nan")), Location(track_deg=361.0), Location(lat_deg=220.0, lon_deg=0.0),
        Location(alt_geo_m=float("inf")), System(4), System(area_count=65536), System(timestamp_s=-1),
        Authentication(1, 0, bytes(18)), Authentication(1, 16, b""), MessagePack(()),
        MessagePack((SelfId(0, ""),) * 10),
        MessagePack((MessagePack((SelfId(0, ""),)),)),  # type: ignore[arg-type]
    ],
)  # fmt: skip
def test_what_has_no_bytes_is_refused(message: Message) -> None:
    with pytest.raises(ValueError, match=r".+"):
        encode(message)


@pytest.mark.parametrize(
    "body",
    [
        b"", b"\x02" * 24, b"\xf2", b"\xf2\x19\x00", b"\xf2\x18\x01" + bytes(24), b"\xf2\x19\x0a" + bytes(250),
        b"\xf2\x19\x02" + bytes(25), b"\xf2\x19\x01" + bytes(26),
    ],
)  # fmt: skip
def test_a_body_that_contradicts_itself_is_refused(body: bytes) -> None:
    with pytest.raises(DecodeError):
        decode(body)
