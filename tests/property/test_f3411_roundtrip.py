"""Remote ID messages: what is written is read again within the standard's steps; any bytes are survived."""

from __future__ import annotations

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
    SingleMessage,
    System,
    authentication,
    decode,
    deviations,
    encode,
)
from skyrange.core.errors import DecodeError
from tests.remote_id_encoders import split_pages
from tests.tiers import examples

NIBBLE = st.integers(0, 15)
VERSION = st.integers(0, 15)
LATIN = st.characters(min_codepoint=1, max_codepoint=255)
ALTITUDE = st.none() | st.floats(-999.5, 31767.5)
UNSIGNED = st.integers(0, 2**32 - 1)


def floats(least: float, most: float) -> st.SearchStrategy[float]:
    return st.floats(least, most, allow_nan=False)


@st.composite
def places(draw: st.DrawFn) -> tuple[float | None, float | None]:
    if draw(st.booleans()):
        return None, None
    lat, lon = draw(floats(-90, 90)), draw(floats(-180, 180))
    return (lat, lon) if round(lat * 1e7) or round(lon * 1e7) else (1e-7, lon)  # 0, 0 says unknown


@st.composite
def locations(draw: st.DrawFn) -> Location:
    lat, lon = draw(places())
    return Location(
        draw(NIBBLE), lat, lon, draw(ALTITUDE), draw(ALTITUDE), draw(ALTITUDE), draw(st.integers(0, 1)),
        draw(st.none() | floats(0, 254.25)), draw(st.none() | floats(-62, 62)), draw(st.none() | floats(0, 360)),
        draw(NIBBLE), draw(NIBBLE), draw(NIBBLE), draw(NIBBLE), draw(NIBBLE), draw(st.none() | floats(0, 3600)),
        draw(VERSION),
    )  # fmt: skip


@st.composite
def systems(draw: st.DrawFn) -> System:
    lat, lon = draw(places())
    return System(
        draw(st.integers(0, 3)), lat, lon, draw(ALTITUDE), draw(st.integers(0, 65535)), draw(floats(0, 2550)),
        draw(ALTITUDE), draw(ALTITUDE), draw(st.integers(0, 7)), draw(NIBBLE), draw(NIBBLE), draw(UNSIGNED),
        draw(VERSION),
    )  # fmt: skip


def page(auth_type: int, number: int, data: bytes, version: int) -> Authentication:
    if number:
        return Authentication(auth_type, number, data, version=version)
    return Authentication(auth_type, 0, data[:17], data[17], data[18], int.from_bytes(data[19:], "big"), version)


SINGLES: st.SearchStrategy[SingleMessage] = st.one_of(
    st.builds(BasicId, NIBBLE, NIBBLE, st.text(LATIN, max_size=20), VERSION),
    locations(),
    st.builds(page, NIBBLE, NIBBLE, st.binary(min_size=23, max_size=23), VERSION),
    st.builds(SelfId, st.integers(0, 255), st.text(LATIN, max_size=23), VERSION),
    systems(),
    st.builds(OperatorId, st.integers(0, 255), st.text(LATIN, max_size=20), VERSION),
    st.builds(Reserved, st.integers(6, 14), st.binary(min_size=24, max_size=24), VERSION),
)
MESSAGES: st.SearchStrategy[Message] = SINGLES | st.builds(
    MessagePack, st.lists(SINGLES, min_size=1, max_size=9).map(tuple), VERSION
)


def near(got: float | None, sent: float | None, step: float) -> bool:
    """Within half a step, and what two roundings of doubles add."""
    if got is None or sent is None:
        return got is sent
    return abs(got - sent) <= step / 2 + 1e-9


@given(MESSAGES)
@settings(max_examples=examples(300), deadline=None)
def test_bytes_of_a_message_read_and_written_again_are_the_same(message: Message) -> None:
    body = encode(message)
    assert len(body) == (3 + 25 * len(message.messages) if isinstance(message, MessagePack) else 25)
    assert encode(decode(body)) == body


@given(SINGLES)
@settings(deadline=None)
def test_all_but_measured_numbers_come_back_exactly(message: SingleMessage) -> None:
    if not isinstance(message, (Location, System)):
        assert decode(encode(message)) == message


@given(locations())
@settings(deadline=None)
def test_a_location_comes_back_within_the_standards_steps(sent: Location) -> None:
    got = decode(encode(sent))
    assert isinstance(got, Location)
    assert near(got.lat_deg, sent.lat_deg, 1e-7)
    assert near(got.lon_deg, sent.lon_deg, 1e-7)
    for name in ("alt_geo_m", "alt_baro_m", "height_m", "vertical_mps"):
        assert near(getattr(got, name), getattr(sent, name), 0.5), name
    assert near(got.speed_mps, sent.speed_mps, 0.25 if (sent.speed_mps or 0) <= 63.75 else 0.75)
    assert near(got.timestamp_s, sent.timestamp_s, 0.1)
    if sent.track_deg is None or got.track_deg is None:
        assert got.track_deg is sent.track_deg
    else:
        assert abs((got.track_deg - sent.track_deg + 180) % 360 - 180) <= 0.5 + 1e-9
        assert 0 <= got.track_deg <= 359
    exact = ("status", "height_type", "horizontal_accuracy", "vertical_accuracy", "baro_accuracy", "speed_accuracy",
             "timestamp_accuracy", "version")  # fmt: skip
    assert [getattr(got, name) for name in exact] == [getattr(sent, name) for name in exact]


@given(systems())
@settings(deadline=None)
def test_a_system_comes_back_within_the_standards_steps(sent: System) -> None:
    got = decode(encode(sent))
    assert isinstance(got, System)
    assert near(got.operator_lat_deg, sent.operator_lat_deg, 1e-7)
    assert near(got.operator_lon_deg, sent.operator_lon_deg, 1e-7)
    for name in ("operator_alt_geo_m", "area_ceiling_m", "area_floor_m"):
        assert near(getattr(got, name), getattr(sent, name), 0.5), name
    assert near(got.area_radius_m, sent.area_radius_m, 10)
    exact = ("operator_location_type", "area_count", "classification", "category", "ua_class", "timestamp_s", "version")
    assert [getattr(got, name) for name in exact] == [getattr(sent, name) for name in exact]


@given(st.binary(max_size=240))
@settings(deadline=None)
def test_any_bytes_are_a_message_or_a_decode_error(body: bytes) -> None:
    try:
        message = decode(body)
    except DecodeError:
        return
    assert all(isinstance(text, str) for text in deviations(message))


@given(st.binary(min_size=25, max_size=25))
@settings(max_examples=examples(500), deadline=None)
def test_any_25_bytes_say_something_and_what_cannot_be_said_again_has_a_fault(body: bytes) -> None:
    if body[0] >> 4 == 15:
        with pytest.raises(DecodeError):
            decode(body)
        return
    message = decode(body)
    try:
        again = decode(encode(message))
    except ValueError:
        assert deviations(message)
    else:
        assert again == message or deviations(message)


@given(MESSAGES, st.data())
@settings(deadline=None)
def test_every_truncation_and_every_tail_is_refused(message: Message, data: st.DataObject) -> None:
    body = encode(message)
    for size in range(len(body)):
        with pytest.raises(DecodeError):
            decode(body[:size])
    with pytest.raises(DecodeError):
        decode(body + data.draw(st.binary(min_size=1, max_size=30)))


@given(NIBBLE, st.binary(max_size=255), UNSIGNED, st.randoms(use_true_random=False))
@settings(deadline=None)
def test_authentication_data_travel_in_pages_in_any_order(
    auth_type: int, proof: bytes, timestamp_s: int, order: object
) -> None:
    pages = list(split_pages(auth_type, proof, timestamp_s))
    received = [decode(encode(page)) for page in pages]
    order.shuffle(received)  # type: ignore[attr-defined]
    assert authentication.join_pages(page for page in received if isinstance(page, Authentication)) == proof
    for missing in pages:
        with pytest.raises(DecodeError):
            authentication.join_pages(page for page in pages if page is not missing)
