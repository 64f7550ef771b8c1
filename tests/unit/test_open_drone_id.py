"""F3411 ↔ MAVLink's OPEN_DRONE_ID_*: units, unknown values, and the frames between.

Units and unknown values: mavlink.io, common.xml, messages 12900…12905, 12915, 12919.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrange.codec.f3411 import (
    Authentication,
    BasicId,
    Location,
    Message,
    MessagePack,
    OperatorId,
    Reserved,
    SelfId,
    System,
    decode,
    deviations,
    encode,
)
from skyrange.codec.f3411.columns import CODES, NUMBERS, encode_locations
from skyrange.codec.mavlink import Packer, dialect
from skyrange.codec.mavlink import decode as decode_frame
from skyrange.codec.mavlink.message_columns import payload_dtype
from skyrange.codec.remote_id.open_drone_id import apply_system_update, from_mavlink, location_columns, to_mavlink
from skyrange.core.errors import DecodeError
from tests.property.test_f3411_roundtrip import SINGLES, locations


def carried(message: Message) -> Message:
    """`message` through a MAVLink frame."""
    return from_mavlink(decode_frame(Packer(1, 1).pack(to_mavlink(message))))


@given(SINGLES)
@settings(deadline=None)
def test_every_message_goes_through_mavlink_unchanged(message: Message) -> None:
    sent = decode(encode(message))._replace(version=2)
    if isinstance(sent, Reserved):
        with pytest.raises(ValueError, match="no MAVLink message"):
            to_mavlink(sent)
    elif isinstance(sent, Location) and sent.timestamp_s is not None:
        got = carried(sent)
        assert isinstance(got, Location)
        assert got.timestamp_s == pytest.approx(sent.timestamp_s, rel=2**-24)  # MAVLink has 32 bits for it
        assert got._replace(timestamp_s=sent.timestamp_s) == sent
    else:
        assert carried(sent) == sent


def test_units_of_a_location() -> None:
    said = to_mavlink(
        Location(2, 45.539309, -122.966389, 110.0, 100.0, 80.0, 1, 5.5, -5.0, 216.0, 11, 6, 5, 3, 2, 360.5)
    )
    assert (said.latitude, said.longitude) == (455_393_090, -1_229_663_890)
    assert (said.speed_horizontal, said.speed_vertical, said.direction) == (550, -500, 21_600)
    assert (said.altitude_geodetic, said.altitude_barometric, said.height) == (110.0, 100.0, 80.0)
    assert (said.height_reference, said.status, said.timestamp) == (1, 2, 360.5)
    assert (said.horizontal_accuracy, said.vertical_accuracy, said.barometer_accuracy) == (11, 6, 5)
    assert (said.speed_accuracy, said.timestamp_accuracy) == (3, 2)


def test_unknown_values_of_a_location() -> None:
    said = to_mavlink(Location())
    assert (said.direction, said.speed_horizontal, said.speed_vertical) == (36_100, 25_500, 6_300)
    assert (said.latitude, said.longitude) == (0, 0)
    assert said.altitude_geodetic == said.altitude_barometric == said.height == -1000.0
    assert said.timestamp == 65_535.0
    assert carried(Location()) == Location()


def test_speeds_saturate_as_in_the_standard() -> None:
    said = to_mavlink(Location(speed_mps=400.0, vertical_mps=-90.0))
    assert (said.speed_horizontal, said.speed_vertical) == (25_425, -6_200)


def test_units_of_a_system() -> None:
    system = System(1, 40.5, -73.25, 20.5, 35, 70.0, 176.5, 41.5, 1, 2, 4, 28_000_000)
    said = to_mavlink(system)
    assert (said.operator_latitude, said.operator_longitude) == (405_000_000, -732_500_000)
    assert (said.operator_altitude_geo, said.area_ceiling, said.area_floor) == (20.5, 176.5, 41.5)
    assert (said.area_count, said.area_radius, said.timestamp) == (35, 70, 28_000_000)
    assert (said.operator_location_type, said.classification_type, said.category_eu, said.class_eu) == (1, 1, 2, 4)
    assert carried(system) == system


def test_a_system_update_moves_the_operator() -> None:
    system = System(1, 40.5, -73.25, 20.5, timestamp_s=5)
    update = dialect.MAVLink_open_drone_id_system_update_message(0, 0, 410_000_000, -730_000_000, -1000.0, 9)
    assert apply_system_update(system, update) == System(1, 41.0, -73.0, None, timestamp_s=9)


def test_a_pack_is_carried_in_f3411_bytes() -> None:
    pack = MessagePack((BasicId(1, 2, "MFR11"), Location(2, 1.0, 2.0), OperatorId(0, "OP"), SelfId(0, "hi")))
    said = to_mavlink(pack)
    assert (said.single_message_size, said.msg_pack_size) == (25, 4)
    assert bytes(said.messages) == encode(pack)[3:] + bytes(125)
    assert carried(pack) == pack


def test_authentication_pages() -> None:
    for page in (Authentication(3, 0, b"a" * 17, 1, 40, 28_000_000), Authentication(3, 1, b"b" * 23)):
        assert carried(page) == page


@pytest.mark.parametrize(("size", "count"), [(24, 1), (25, 0), (25, 10), (255, 255)])
def test_a_pack_that_contradicts_itself_is_refused(size: int, count: int) -> None:
    hostile = dialect.MAVLink_open_drone_id_message_pack_message(0, 0, [0] * 20, size, count, [0xF2] * 225)
    with pytest.raises(DecodeError):
        from_mavlink(hostile)


def test_other_messages_are_refused() -> None:
    with pytest.raises(DecodeError, match="HEARTBEAT"):
        from_mavlink(dialect.MAVLink_heartbeat_message(2, 3, 0, 0, 0, 3))


def test_hostile_numbers_come_out_and_are_named() -> None:
    hostile = dialect.MAVLink_open_drone_id_location_message(
        0, 0, [0] * 20, 200, 65_535, 65_535, 32_767, 950_000_000, 2**31 - 1, math.nan, math.inf, 200, 1e30, 255, 255,
        255, 255, -5.0, 255,
    )  # fmt: skip
    got = from_mavlink(hostile)
    assert isinstance(got, Location)
    assert (got.status, got.lat_deg, got.alt_geo_m, got.alt_baro_m) == (200, 95.0, None, None)
    named = " ".join(deviations(got))
    for what in ("status 200", "lat_deg 95", "lon_deg 214", "track_deg 655", "vertical_mps 327", "timestamp_s -5"):
        assert what in named
    with pytest.raises(ValueError, match=r".+"):
        encode(got)


LOCATION = payload_dtype(dialect.MAVLINK_MSG_ID_OPEN_DRONE_ID_LOCATION)


@given(st.lists(locations(), min_size=1, max_size=5))
@settings(deadline=None)
def test_columns_of_locations_say_what_each_says(said: list[Location]) -> None:
    sent = [to_mavlink(decode(encode(location))) for location in said]
    table = np.zeros(len(sent), dtype=LOCATION)
    for row, message in enumerate(sent):
        assert LOCATION.names
        for name in LOCATION.names:
            table[name][row] = getattr(message, name)
    numbers, codes = location_columns(table)
    for row, message in enumerate(sent):
        one = from_mavlink(decode_frame(Packer(1, 1).pack(message)))
        for column, name in enumerate(NUMBERS):
            wanted = getattr(one, name)
            assert numbers[column, row] == wanted or (wanted is None and math.isnan(numbers[column, row])), name
        assert [getattr(one, name) for name in CODES] == codes[:, row].tolist()


@given(st.binary(min_size=59, max_size=59))
@settings(deadline=None)
def test_a_location_of_any_bytes_can_be_broadcast(raw: bytes) -> None:
    """What F3411 has no bytes for counts as unknown."""
    assert LOCATION.itemsize == 59
    bodies = encode_locations(*location_columns(np.frombuffer(raw, dtype=LOCATION)))
    assert isinstance(decode(bodies[0].tobytes()), Location)
