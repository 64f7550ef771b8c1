"""Remote ID in columns: the same bytes and numbers as one by one, for honest, hostile and broken bodies."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike, NDArray

from skyrange.codec.f3411 import (
    Authentication,
    BasicId,
    Location,
    MessagePack,
    OperatorId,
    Reserved,
    SelfId,
    SingleMessage,
    System,
    decode,
    encode,
)
from skyrange.codec.f3411 import columns as f3411_columns
from skyrange.codec.f3411.broadcast_columns import NO_MESSAGE, decode_broadcasts
from skyrange.codec.f3411.columns import CODES, NUMBERS
from skyrange.codec.remote_id import link_payload
from skyrange.codec.remote_id.link_payload import RidFrame, RidHeader
from skyrange.contracts.frames import Payloads
from skyrange.core.errors import DecodeError
from tests.property.test_f3411_roundtrip import MESSAGES, SINGLES, locations
from tests.tiers import examples

pytestmark = pytest.mark.rotating

BODIES = st.one_of(
    MESSAGES.map(encode),
    st.binary(max_size=260),
    st.binary(min_size=25, max_size=25),
    st.builds(lambda count, rest: (bytes([0xF2, 25, count]) + rest)[: 3 + 25 * count], st.integers(0, 12),
              st.binary(min_size=300, max_size=300)),
)  # fmt: skip


def parts_of(body: bytes) -> tuple[SingleMessage, ...]:
    try:
        message = decode(body)
    except DecodeError:
        return ()
    return message.messages if isinstance(message, MessagePack) else (message,)


@given(st.lists(BODIES, max_size=12))
@settings(max_examples=examples(200), deadline=None)
def test_rows_say_what_decoding_one_by_one_says(bodies: list[bytes]) -> None:
    rows = f3411_columns.decode_locations(Payloads.of(bodies))
    assert rows.valid.tolist() == [bool(parts_of(body)) for body in bodies]
    for row, body in enumerate(bodies):
        parts = parts_of(body)
        location = next((part for part in parts if isinstance(part, Location)), None)
        who = next((part for part in parts if isinstance(part, BasicId)), None)
        assert rows.has_location[row] == (location is not None)
        assert rows.has_id[row] == (who is not None)
        assert rows.uas_id[row] == (who.uas_id.encode("latin-1") if who else b"")
        if who:
            assert (rows.id_type[row], rows.ua_type[row]) == (who.id_type, who.ua_type)
        for name in NUMBERS:
            one = getattr(location, name, None)
            got = getattr(rows, name)[row]
            assert math.isnan(got) if one is None else got == one, name
        if location:
            assert [getattr(rows, name)[row] for name in CODES] == [getattr(location, name) for name in CODES]


def code_of(part: SingleMessage) -> int:
    if isinstance(part, Reserved):
        return part.message_type
    kinds = (BasicId, Location, Authentication, SelfId, System, OperatorId)  # in the order of their numbers
    return next(number for number, kind in enumerate(kinds) if isinstance(part, kind))


@given(st.lists(BODIES, max_size=12))
@settings(max_examples=examples(200), deadline=None)
def test_whole_broadcasts_say_what_decoding_one_by_one_says(bodies: list[bytes]) -> None:
    rows = decode_broadcasts(Payloads.of(bodies))
    for row, body in enumerate(bodies):
        parts = parts_of(body)
        assert [kind for kind in rows.kinds[row].tolist() if kind != NO_MESSAGE] == [code_of(part) for part in parts]
        assert rows.version[row] == (body[0] & 15 if parts else 0)
        ids = [part for part in parts if isinstance(part, BasicId)]
        second = ids[1] if len(ids) > 1 else None
        assert rows.has_second_id[row] == (second is not None)
        assert rows.second_uas_id[row] == (second.uas_id.encode("latin-1") if second else b"")
        pages = [part for part in parts if isinstance(part, Authentication)]
        assert rows.has_authentication[row] == bool(pages)
        assert rows.auth_data[row] == b"".join(page.data for page in pages)
        if pages:
            first = pages[0]
            told = (first.last_page or 0, first.length or 0, first.timestamp_s or 0)
            assert (rows.auth_type[row], rows.auth_page[row]) == (first.auth_type, first.page)
            assert (rows.auth_last_page[row], rows.auth_length[row], rows.auth_timestamp_s[row]) == told
        text = next((part for part in parts if isinstance(part, SelfId)), None)
        assert rows.has_self_id[row] == (text is not None)
        assert rows.self_id[row] == (text.text.encode("latin-1") if text else b"")
        assert rows.description_type[row] == (text.description_type if text else 0)
        operator = next((part for part in parts if isinstance(part, OperatorId)), None)
        assert rows.has_operator_id[row] == (operator is not None)
        assert rows.operator_id[row] == (operator.operator_id.encode("latin-1") if operator else b"")
        assert rows.operator_id_type[row] == (operator.operator_id_type if operator else 0)
        system = next((part for part in parts if isinstance(part, System)), None)
        assert rows.has_system[row] == (system is not None)
        for name in System._fields:
            if name == "version":
                continue
            column = "system_timestamp_s" if name == "timestamp_s" else name
            one, got = getattr(system, name, None), getattr(rows, column)[row]
            if system is None:
                assert got == 0 or math.isnan(got), name
            else:
                assert math.isnan(got) if one is None else got == one, name


@given(st.lists(locations(), min_size=1, max_size=8))
@settings(max_examples=examples(200), deadline=None)
def test_columns_are_written_as_one_by_one(messages: list[Location]) -> None:
    messages = [message._replace(version=2) for message in messages]
    numbers = np.array([[getattr(m, name) for m in messages] for name in NUMBERS], dtype=np.float64)  # None is NaN
    codes = np.array([[getattr(m, name) for m in messages] for name in CODES], dtype=np.uint8)
    rows = f3411_columns.encode_locations(numbers, codes)
    assert [row.tobytes() for row in rows] == [encode(message) for message in messages]


@given(st.lists(st.tuples(SINGLES, SINGLES, SINGLES), min_size=1, max_size=6))
@settings(deadline=None)
def test_packs_are_built_as_one_by_one(rows: list[tuple[SingleMessage, SingleMessage, SingleMessage]]) -> None:
    parts = [f3411_columns.stack_messages([encode(row[place]) for row in rows]) for place in range(3)]
    assert list(f3411_columns.pack_bodies(parts)) == [encode(MessagePack(row)) for row in rows]
    assert list(f3411_columns.single_bodies(parts[0])) == [encode(row[0]) for row in rows]


def told(**given: ArrayLike) -> NDArray[np.uint8]:
    """Location messages: 40° north and east, at the ellipsoid, nothing else known but what is given."""
    fields = {"lat_deg": 40.0, "lon_deg": 40.0, "alt_geo_m": 0.0} | given
    columns = np.broadcast_arrays(*fields.values())
    numbers = np.full((len(NUMBERS), columns[0].size), np.nan)
    codes = np.zeros((len(CODES), columns[0].size), dtype=np.uint8)
    for name, column in zip(fields, columns, strict=True):
        if name in NUMBERS:
            numbers[NUMBERS.index(name)] = column
        else:
            codes[CODES.index(name)] = column
    return f3411_columns.encode_locations(numbers, codes)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("speed_mps", -0.5), ("track_deg", 361.0), ("track_deg", -1.0), ("timestamp_s", 7000.0), ("timestamp_s", -1.0),
        ("status", 16), ("height_type", 2), ("speed_accuracy", 16), ("lat_deg", 220.0), ("lon_deg", math.inf),
        ("lat_deg", math.nan), ("lon_deg", math.nan),
    ],
)  # fmt: skip
def test_what_has_no_bytes_is_refused_in_columns_too(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        told(**{name: value})


def test_a_pack_has_one_to_nine_messages() -> None:
    with pytest.raises(ValueError, match="1…9"):
        f3411_columns.pack_bodies([np.zeros((1, 25), dtype=np.uint8)] * 10)


def test_saturation_and_unknowns_in_columns() -> None:
    rows = told(
        alt_geo_m=[-5000.0, np.nan, 1e6], speed_mps=[np.inf, np.nan, 254.2], vertical_mps=[-100.0, np.nan, np.inf]
    )
    columns = f3411_columns.decode_locations(f3411_columns.single_bodies(rows))
    np.testing.assert_array_equal(columns.alt_geo_m, [-999.5, np.nan, 31767.5])
    np.testing.assert_array_equal(columns.speed_mps, [254.25, np.nan, 254.25])
    np.testing.assert_array_equal(columns.vertical_mps, [-62.0, np.nan, 62.0])


HEADERS = st.builds(
    RidHeader, st.integers(1, 4), st.integers(0, 255), st.integers(0, 255), st.binary(min_size=6, max_size=6),
    st.integers(-32768, 32767), st.integers(-(2**63), 2**63 - 1),
)  # fmt: skip


@given(st.lists(st.tuples(HEADERS, st.binary(max_size=240)), max_size=8))
@settings(deadline=None)
def test_link_payloads_are_packed_in_columns_as_one_by_one(rows: list[tuple[RidHeader, bytes]]) -> None:
    singly = [link_payload.pack(header, body) for header, body in rows]
    columns = {name: np.array([getattr(header, name) for header, _ in rows]) for name in RidHeader._fields}
    columns["address"] = np.array([list(header.address) for header, _ in rows], dtype=np.uint8).reshape(-1, 6)
    together = link_payload.pack_rows(**columns, bodies=Payloads.of(body for _, body in rows))
    assert list(together) == singly
    assert [link_payload.unpack(payload) for payload in singly] == [RidFrame(header, body) for header, body in rows]


@given(
    st.lists(st.tuples(HEADERS, st.binary(max_size=60)).map(lambda row: link_payload.pack(*row)), max_size=6), st.data()
)
@settings(max_examples=examples(200), deadline=None)
def test_broken_link_payloads_are_marked_and_the_others_read(payloads: list[bytes], data: st.DataObject) -> None:
    hostile = []
    for payload in payloads:
        kind = data.draw(st.sampled_from(["whole", "cut", "longer", "flipped"]))
        raw = bytearray(payload)
        if kind == "flipped":
            raw[data.draw(st.integers(0, len(raw) - 1))] ^= data.draw(st.integers(1, 255))
        cut = data.draw(st.integers(0, len(raw) - 1))
        hostile.append({"cut": bytes(raw[:cut]), "longer": bytes(raw) + b"x"}.get(kind, bytes(raw)))
    columns = link_payload.unpack_rows(Payloads.of(hostile))
    bodies = list(columns.bodies)
    for row, payload in enumerate(hostile):
        try:
            frame = link_payload.unpack(payload)
        except DecodeError:
            assert not columns.valid[row]
            assert bodies[row] == b""
            continue
        assert columns.valid[row]
        assert bodies[row] == frame.body
        got = RidHeader(
            int(columns.transport[row]), int(columns.channel[row]), int(columns.counter[row]),
            columns.address[row].tobytes(), int(columns.rssi_cdbm[row]), int(columns.time_ns[row]),
        )  # fmt: skip
        assert got == frame.header


def test_a_pack_within_a_pack_is_not_looked_into() -> None:
    inner = bytes([0xF2]) + encode(BasicId(1, 2, "A"))[1:]
    body = bytes([0xF2, 25, 2]) + inner + encode(BasicId(1, 2, "B"))
    rows = f3411_columns.decode_locations(Payloads.of([body]))
    assert rows.uas_id.tolist() == [b"B"]
