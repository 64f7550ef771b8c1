"""Remote ID messages and frames made by other implementations, byte for byte."""

from __future__ import annotations

import pytest

from skyrange.codec.f3411 import (
    Authentication,
    BasicId,
    Location,
    MessagePack,
    OperatorId,
    SelfId,
    SingleMessage,
    System,
    authentication,
    decode,
    encode,
)
from skyrange.codec.remote_id import wifi
from skyrange.codec.remote_id.link_payload import RidFrame, RidHeader, Transport
from tests.remote_id_encoders import encode_nan_sync_beacon, split_pages

# opendroneid-core-c, test/test_inout.c: what the program prints under "Encoded Data", for the inputs it is given
# (altitudes 100, 110, 80 m; 5.4 and 5.25 m/s; 215.7°; 360.52 s; ceiling 176.9 m and radius 75 m cut to a step).
INOUT: list[tuple[str, SingleMessage]] = [
    ("0222 3132333435363738393031323334353637383930 000000", BasicId(2, 2, "12345678901234567890")),
    (
        "1226 24160a 42bf241b 6ed1b4b6 9808 ac08 7008 6b53 150e 02 00",
        Location(
            2, 45.539309, -122.966389, 110.0, 100.0, 80.0, 1, 5.5, 5.0, 216.0, 11, 6, 5, 3, 2, 360.5,
        ),
    ),
    ("2210 01 28 003fab01" + b"12345678901234567".hex(), Authentication(1, 0, b"12345678901234567", 1, 40, 28_000_000)),
    ("2211" + b"12345678901234567890123".hex(), Authentication(1, 1, b"12345678901234567890123")),
    ("3200" + b"DronesRUS: Real Estate\0".hex(), SelfId(0, "DronesRUS: Real Estate")),
    (
        "4204 a6bf241b d2d1b4b6 2300 07 3109 2308 24 f907 003fab01 00",
        System(0, 45.539319, -122.966379, 20.5, 35, 70.0, 176.5, 41.5, 1, 2, 4, 28_000_000),
    ),
    ("5200" + b"98765432100123456789".hex() + "000000", OperatorId(0, "98765432100123456789")),
]  # fmt: skip

# librid 0.4, examples/{basic_id,location,system,operator_id,self_id}/README.md
LIBRID: list[tuple[str, SingleMessage]] = [
    ("0212" + b"1ABCD2345EF678XYZ".hex() + "000000" + "000000", BasicId(1, 2, "1ABCD2345EF678XYZ")),
    (
        "12202d3e0420bd5c25401c190d9b08c10834084a5339300100",
        Location(2, 62.683472, 21.974944, 120.5, 101.5, 50.0, 0, 15.5, 2.0, 45.0, 10, 4, 5, 3, 1, 1234.5),
    ),
    (
        "42043412ef23c376a00e01000ac008d007123408100e000000",
        System(0, 60.2870324, 24.5397187, 50.0, 1, 100.0, 120.0, 0.0, 1, 1, 2, 3600),
    ),
    ("520046494e38376173747264676531326b3800000000000000", OperatorId(0, "FIN87astrdge12k8")),
    ("320044726f6e652064656c6976657279207465737400000000", SelfId(0, "Drone delivery test")),
]

# kilpkonn/remote-id, src/codec/decode.rs: messages that modules of Dronetag broadcast, their first two bytes
# (application code and counter) taken off. That decoder's test drops the second Location's course of 52°.
DRONETAG: list[tuple[list[int], SingleMessage]] = [
    (
        [18, 34, 157, 0, 0, 143, 76, 186, 29, 192, 227, 79, 5, 77, 9, 116, 9, 208, 7, 91, 4, 26, 14, 0, 0],
        Location(2, 49.8748559, 8.9121728, 210.0, 190.5, 0.0, 0, 0.0, 0.0, 337.0, 11, 5, 0, 4, 0, 361.0),
    ),
    (
        [18, 32, 52, 21, 0, 188, 82, 186, 29, 69, 238, 79, 5, 99, 9, 132, 9, 230, 7, 91, 4, 156, 34, 0, 0],
        Location(2, 49.875014, 8.9124421, 218.0, 201.5, 11.0, 0, 5.25, 0.0, 52.0, 11, 5, 0, 4, 0, 886.0),
    ),
    (
        [66, 4, 131, 76, 186, 29, 188, 227, 79, 5, 1, 0, 25, 0, 0, 0, 0, 16, 116, 9, 194, 254, 91, 10, 0],
        System(0, 49.8748547, 8.9121724, 210.0, 1, 250.0, None, None, 1, 1, 0, 173_801_154),
    ),
    (
        [82, 0, 78, 85, 76, 76, *[0] * 19],
        OperatorId(0, "NULL"),
    ),
]

VECTORS = [(bytes.fromhex(text.replace(" ", "")), message) for text, message in INOUT + LIBRID] + [
    (bytes(numbers), message) for numbers, message in DRONETAG
]


@pytest.mark.parametrize(("body", "message"), VECTORS)
def test_a_message_of_others_is_read_and_written(body: bytes, message: SingleMessage) -> None:
    assert decode(body) == message
    assert encode(message) == body


def test_the_pack_of_all_of_them() -> None:
    bodies = [bytes.fromhex(text.replace(" ", "")) for text, _ in INOUT]
    pack = MessagePack(tuple(message for _, message in INOUT))
    assert encode(pack) == b"\xf2\x19\x07" + b"".join(bodies)
    assert decode(encode(pack)) == pack


def test_authentication_in_three_pages() -> None:
    """librid, examples/auth_page/README.md."""
    pages = [
        bytes.fromhex("22300238808648 0b308201 22300d06092a864886f70d010101"),
        bytes.fromhex("22310500 0382010f00308201 0a0282010100bb6a8c7e5f2a9b"),
        bytes.fromhex("2232c57b993a1d036681f49e 2c87ab4fe01200000000000000"),
    ]
    messages = [decode(page) for page in pages]
    assert all(isinstance(message, Authentication) for message in messages)
    data = authentication.join_pages(message for message in messages if isinstance(message, Authentication))
    assert data == b"".join((pages[0][8:], pages[1][2:], pages[2][2:]))[:56]
    assert [encode(page) for page in split_pages(3, data, 189_302_400)] == pages


def test_a_beacon_of_others_is_built_to_the_byte() -> None:
    """opendroneid-core-c, test/unit_odid_wifi_beacon.cpp: 146 bytes, of which it spells out the first 98."""
    expected = (
        bytes.fromhex("8000 0000 ffffffffffff 123456214365 123456214365 0000 ffffffffffffffff 6400 2004 0014")
        + b"testSSID_0123456789A"
        + bytes.fromhex("01018c dd53 fa0bbc 0d 55 f21903 0214")
        + b"USS-Enterprise".ljust(20, b"\0")
        + bytes.fromhex("000000 1220")
    )
    pack = MessagePack(
        (BasicId(1, 4, "USS-Enterprise"), Location(2, speed_mps=62.0, vertical_mps=62.0, track_deg=0.25), System())
    )
    header = RidHeader(Transport.WIFI_BEACON, counter=0x55, address=bytes.fromhex("123456214365"))
    built = wifi.encode_beacon(RidFrame(header, encode(pack)), ssid=b"testSSID_0123456789A", timestamp_us=2**64 - 1)
    assert len(built) == 146 + wifi.FCS
    assert built.startswith(expected)


def test_names_of_the_nan_service_and_frames() -> None:
    """opendroneid-core-c, libopendroneid/wifi.c: the constants of its action frame and its synchronisation Beacon."""
    header = RidHeader(Transport.WIFI_NAN, counter=7, address=bytes.fromhex("020304050607"))
    body = encode(MessagePack((SelfId(0, "x"),)))
    action = wifi.encode_nan_action(RidFrame(header, body))
    assert action[:24].hex() == "d0000000" + "516f9a010000" + "020304050607" + "506f9a0100ff" + "0000"
    assert action[24:42].hex() == "0409506f9a13" + "03" + "2700" + "8869199d9209" + "010010"
    assert action[42:44] == bytes([29, 7])
    assert action[44:-4] == body + bytes.fromhex("0e0400" + "01" + "0002" + "07")
    sync = encode_nan_sync_beacon(header.address)
    assert sync[24:-4].hex() == (
        "0000000000000000" + "0002" + "2004" + "dd22506f9a13" + "000200feea"
        + "010d00020304050607eafe0000000000" + "0206008869199d9209"
    )  # fmt: skip
