from __future__ import annotations

import struct
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrange.codec.mavlink import (
    Deframer,
    Packer,
    alter,
    decode,
    dialect,
    message_fields,
    message_id,
    message_name,
    sender_system,
)
from skyrange.core.errors import DecodeError
from tests.tiers import examples

RANGES = {
    "uint8_t": (0, 2**8 - 1),
    "int8_t": (-(2**7), 2**7 - 1),
    "uint16_t": (0, 2**16 - 1),
    "int16_t": (-(2**15), 2**15 - 1),
    "uint32_t": (0, 2**32 - 1),
    "int32_t": (-(2**31), 2**31 - 1),
    "uint64_t": (0, 2**64 - 1),
    "int64_t": (-(2**63), 2**63 - 1),
}


def values_of(kind: str) -> st.SearchStrategy[Any]:
    if kind in RANGES:
        return st.integers(*RANGES[kind])
    return st.floats(width=32 if kind == "float" else 64)


@st.composite
def messages(draw: st.DrawFn) -> Any:
    """Any message of the dialect with any fields that its definition allows."""
    return draw(messages_of(dialect.mavlink_map[draw(st.sampled_from(sorted(dialect.mavlink_map)))]))


@st.composite
def messages_of(draw: st.DrawFn, cls: Any) -> Any:
    """Any message of a class."""
    arguments: list[Any] = []
    for kind, order in zip(cls.fieldtypes, cls.orders, strict=True):
        length = cls.array_lengths[order]
        if kind == "char":
            arguments.append(draw(st.binary(max_size=length)))
        elif length:
            arguments.append(draw(st.lists(values_of(kind), min_size=length, max_size=length)))
        else:
            arguments.append(draw(values_of(kind)))
    return cls(*arguments)


def bits(value: Any) -> Any:
    """A value that compares by its bits, so that NaN equals NaN."""
    return struct.pack("<d", value) if isinstance(value, float) else value


@given(messages(), st.integers(0, 255), st.integers(0, 255), st.integers(0, 255))
@settings(max_examples=examples(300), deadline=None)
def test_packing_is_pymavlinks_and_decoding_undoes_it(message: Any, system: int, component: int, sequence: int) -> None:
    packer = Packer(system, component)
    packer.sequence = sequence
    frame = packer.pack(message)
    before = message_fields(message)
    mav = dialect.MAVLink(None, system, component)
    mav.seq = sequence
    assert frame == message.pack(mav)

    back = decode(frame)
    assert (back.get_type(), back.get_srcSystem(), back.get_srcComponent(), back.get_seq()) == (
        message.get_type(),
        system,
        component,
        sequence,
    )
    assert {name: bits(value) for name, value in message_fields(back).items()} == {
        name: bits(value) for name, value in before.items()
    }
    assert (message_id(frame), message_name(frame), sender_system(frame)) == (
        type(message).id,
        message.get_type(),
        system,
    )

    theirs = dialect.MAVLink(None).parse_buffer(bytearray(frame))[0]
    assert {name: bits(value) for name, value in message_fields(theirs).items()} == {
        name: bits(value) for name, value in message_fields(back).items()
    }
    packer.sequence = sequence
    assert packer.pack(back) == frame


@given(st.data(), st.integers(0, 255), st.integers(0, 255), st.integers(0, 255))
@settings(max_examples=examples(100))
def test_altering_a_field_is_packing_the_message_with_its_other_value(
    data: st.DataObject, system: int, component: int, sequence: int
) -> None:
    message = data.draw(messages())
    name = data.draw(st.sampled_from(message.fieldnames))
    packer = Packer(system, component)
    packer.sequence = sequence
    frame = packer.pack(message)
    other = data.draw(messages_of(type(message)))
    packer.sequence = sequence
    setattr(message, name, getattr(other, name))
    assert alter(frame, **{name: getattr(other, name)}) == packer.pack(message)


def test_a_field_called_payload_is_altered() -> None:
    message = dialect.MAVLink_tunnel_message(1, 2, 3, 4, [5] * 128)
    frame = Packer(1, 1).pack(message)
    assert dialect.MAVLink(None).parse_buffer(bytearray(alter(frame, payload=[6] * 128)))[0].payload == [6] * 128


def test_a_field_that_a_message_does_not_have_is_named() -> None:
    frame = Packer(1, 1).pack(dialect.MAVLink_mission_current_message(3))
    assert decode(alter(frame, seq=7)).seq == 7
    with pytest.raises(ValueError, match="MISSION_CURRENT has no field 'sequence', only seq"):
        alter(frame, sequence=7)
    with pytest.raises(ValueError, match="seq"):
        alter(frame, seq=70_000)
    with pytest.raises(DecodeError):
        alter(b"no frame", seq=7)


def test_every_message_of_the_dialect_packs_as_pymavlink_packs_it() -> None:
    for cls in dialect.mavlink_map.values():
        arguments: list[Any] = []
        for place, (kind, order) in enumerate(zip(cls.fieldtypes, cls.orders, strict=True), start=1):
            length = cls.array_lengths[order]
            fill: Any = b"x" * length if kind == "char" else [place] * length if length else place
            arguments.append(fill)
        message = cls(*arguments)
        frame = Packer(1, 1).pack(message)
        assert frame == message.pack(dialect.MAVLink(None, 1, 1)), cls.msgname
        assert message_fields(decode(frame)) == message_fields(message), cls.msgname


@given(messages())
@settings(max_examples=examples(60), deadline=None)
def test_no_truncation_and_no_flipped_byte_decodes(message: Any) -> None:
    frame = Packer(1, 1).pack(message)
    for size in range(len(frame)):
        with pytest.raises(DecodeError):
            decode(frame[:size])
    for place in range(len(frame)):
        # a CRC-16 finds every burst of up to 16 bits; a changed magic, length or flag byte is no frame either
        with pytest.raises(DecodeError):
            decode(frame[:place] + bytes([frame[place] ^ 0x55]) + frame[place + 1 :])


@given(st.binary(max_size=400), st.sampled_from([b"", b"\xfd", b"\xfe", b"\xfd\x09\x00\x00\x01\x01\x01\x00\x00\x00"]))
@settings(max_examples=examples(500), deadline=None)
def test_random_bytes_raise_decode_error_alone(tail: bytes, head: bytes) -> None:
    payload = head + tail
    try:
        message = decode(payload)
    except DecodeError:
        pass
    else:
        assert message.get_msgbuf() == payload
    message_id(payload)
    message_name(payload)
    sender_system(payload)


FRAMES = [
    Packer(1, 1).pack(dialect.MAVLink_heartbeat_message(2, 3, 0, 0xFEFD, 3, 3)),
    Packer(0xFD, 0xFE).pack(dialect.MAVLink_statustext_message(6, b"\xfd\xfe\xfd\x09")),
    Packer(1, 1).pack(dialect.MAVLink_global_position_int_message(1, 2, 3, 4, 5, 6, 7, 8, 9)),
    bytes(dialect.MAVLink_heartbeat_message(2, 3, 0, 5, 3, 3).pack(dialect.MAVLink(None, 1, 1), force_mavlink1=True)),
]
NOISE = st.one_of(
    st.binary(max_size=30),
    st.lists(st.sampled_from(b"\xfd\xfe\x00\x01\x09"), max_size=40).map(bytes),
    st.sampled_from(FRAMES).flatmap(lambda frame: st.integers(0, len(frame) - 1).map(lambda cut: frame[:cut])),
    st.sampled_from(FRAMES).map(lambda frame: frame[:-1] + bytes([frame[-1] ^ 0xFF])),
)


@st.composite
def streams(draw: st.DrawFn) -> tuple[bytes, list[bytes]]:
    """A stream and the frames laid into it."""
    parts = draw(st.lists(st.one_of(st.sampled_from(FRAMES), NOISE), max_size=8))
    return b"".join(parts), [part for part in parts if part in FRAMES]


@st.composite
def cut(draw: st.DrawFn, stream: bytes) -> list[bytes]:
    places = sorted(draw(st.lists(st.integers(0, len(stream)), max_size=10)))
    return [stream[a:b] for a, b in zip([0, *places], [*places, len(stream)], strict=True)]


def is_subsequence(wanted: list[bytes], found: list[bytes]) -> bool:
    rest = iter(found)
    return all(frame in rest for frame in wanted)


@given(streams(), st.data())
@settings(max_examples=examples(500), deadline=None)
def test_no_byte_is_lost_no_frame_either_however_the_stream_is_cut(
    laid: tuple[bytes, list[bytes]], data: st.DataObject
) -> None:
    stream, frames = laid
    whole = Deframer()
    reference = whole.feed(stream) + whole.finish()
    pieces_found = [piece.data for piece in reference if not piece.garbage]
    assert is_subsequence(frames, pieces_found)
    for found in pieces_found:
        decode(found)

    chunked = Deframer()
    pieces = []
    for chunk in data.draw(cut(stream)):
        fed = chunked.feed(chunk)
        assert not any(a.garbage and b.garbage for a, b in pairwise(fed))
        pieces += fed
    pieces += chunked.finish()
    assert b"".join(piece.data for piece in pieces) == stream
    assert all(piece.data for piece in pieces)
    assert [piece.data for piece in pieces if not piece.garbage] == pieces_found
    assert chunked.counts == whole.counts
    assert whole.counts.frames == len(pieces_found)
    assert whole.counts.garbage_bytes == sum(len(piece.data) for piece in reference if piece.garbage)
