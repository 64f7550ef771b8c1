"""Are the messages between skyrange and its plugin in Gazebo read as written, and refused where they cannot be?"""

from __future__ import annotations

import contextlib
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyrange.codec.gazebo_protocol import (
    CONTACT,
    HEADER,
    MAGIC,
    MAX_BODY_BYTES,
    STATE_NUMBERS,
    VERSION,
    MessageType,
    decode_failed,
    decode_ready,
    decode_stepped,
    encode_step,
    pack,
    unpack_header,
)
from skyrange.core.errors import DecodeError


def text(value: str) -> bytes:
    data = value.encode()
    return struct.pack("<I", len(data)) + data


def ready(release: str = "11.1.0", physics: str = "ode", version: int = VERSION) -> bytes:
    return struct.pack("<8sI", MAGIC, version) + text(release) + text(physics)


def stepped(tick_ns: int, states: np.ndarray, contacts: np.ndarray) -> bytes:
    return struct.pack("<qI4x", tick_ns, len(contacts)) + states.astype("<f8").tobytes() + contacts.tobytes()


def touch(vehicle: int = 0, other: int = 1, rotor: int = -1) -> np.ndarray:
    contact = np.zeros(1, CONTACT)
    contact["vehicle"], contact["other"], contact["rotor"], contact["other_rotor"] = vehicle, other, rotor, -1
    return contact


@given(st.integers(0, MAX_BODY_BYTES), st.sampled_from(MessageType), st.integers(0, 2**32 - 1))
def test_a_header_is_read_as_it_was_packed(length: int, kind: MessageType, number: int) -> None:
    assert unpack_header(HEADER.pack(length, kind, 0, number)) == (length, kind, number)
    assert unpack_header(pack(kind, number)[: HEADER.size]) == (0, kind, number)


@given(st.text(max_size=40), st.text(max_size=40))
def test_ready_is_read_as_written(release: str, physics: str) -> None:
    assert decode_ready(ready(release, physics)) == (release, physics)


@given(st.integers(-(2**60), 2**60), st.integers(0, 4), st.data())
def test_states_and_contacts_are_read_as_written(tick_ns: int, count: int, data: st.DataObject) -> None:
    finite = st.floats(-1e6, 1e6)
    numbers = data.draw(st.lists(finite, min_size=count * STATE_NUMBERS, max_size=count * STATE_NUMBERS))
    states = np.array(numbers).reshape(count, STATE_NUMBERS)
    contacts = touch(0, -3, 2) if count else np.zeros(0, CONTACT)
    found = decode_stepped(stepped(tick_ns, states, contacts), tick_ns, count, buildings=3)
    assert np.array_equal(found.states, states)
    assert found.contacts.tobytes() == contacts.tobytes()


@given(st.binary(max_size=400))
def test_hostile_bytes_are_read_or_refused(data: bytes) -> None:
    for read in (
        decode_ready,
        decode_failed,
        lambda body: decode_stepped(body, 0, 2, 5),
        lambda body: unpack_header((body + bytes(HEADER.size))[: HEADER.size]),
    ):
        with contextlib.suppress(DecodeError):
            read(data)


@given(st.data())
def test_one_changed_byte_of_an_answer_is_read_or_refused(data: st.DataObject) -> None:
    body = bytearray(stepped(5, np.zeros((2, STATE_NUMBERS)), touch()))
    body[data.draw(st.integers(0, len(body) - 1))] ^= data.draw(st.integers(1, 255))
    try:
        found = decode_stepped(bytes(body), 5, 2, 0)
    except DecodeError:
        return
    assert np.isfinite(found.states).all()
    assert found.contacts["vehicle"].max() < 2


@pytest.mark.parametrize(
    ("body", "told"),
    [
        (stepped(4, np.zeros((2, STATE_NUMBERS)), touch()), "the tick 4, expected 5"),
        (stepped(5, np.zeros((1, STATE_NUMBERS)), touch()), "for 2 aircraft"),
        (stepped(5, np.full((2, STATE_NUMBERS), np.nan), touch()), "not a number"),
        (stepped(5, np.zeros((2, STATE_NUMBERS)), touch(2)), "does not exist"),
        (stepped(5, np.zeros((2, STATE_NUMBERS)), touch(0, 2)), "does not exist"),
        (stepped(5, np.zeros((2, STATE_NUMBERS)), touch(0, -2)), "does not exist"),
        (b"", "a STEPPED of 0 bytes"),
    ],
)
def test_a_wrong_answer_is_named(body: bytes, told: str) -> None:
    with pytest.raises(DecodeError, match=told):
        decode_stepped(body, 5, 2, buildings=1)


def test_a_plugin_of_another_version_is_named() -> None:
    with pytest.raises(DecodeError, match=f"version 7 of the protocol, expected {VERSION}"):
        decode_ready(ready(version=7))


def test_a_step_has_the_inputs_row_by_row() -> None:
    inputs, shown = np.arange(26.0).reshape(2, 13), np.arange(7.0).reshape(1, 7)
    body = encode_step(-3, inputs, shown)
    assert struct.unpack_from("<q", body) == (-3,)
    assert np.frombuffer(body, "<f8", offset=8).tolist() == [*range(26), *range(7)]
