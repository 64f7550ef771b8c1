"""Messages to and from radio engines: round trips, and hostile bodies of every kind."""

from __future__ import annotations

import contextlib
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from skyrange.codec import medium_protocol as protocol
from skyrange.core.errors import DecodeError
from tests import engine_messages

NUMBERS = st.floats(allow_nan=False, width=64)
TEXTS = st.text(max_size=20)


def _rows(layout: np.dtype[Any]) -> st.SearchStrategy[np.ndarray]:
    return st.binary(max_size=5 * layout.itemsize).map(
        lambda data: np.frombuffer(data[: len(data) // layout.itemsize * layout.itemsize], dtype=layout)
    )


HELLOS = st.builds(
    protocol.Hello,
    st.integers(0, 2**64 - 1),
    NUMBERS,
    st.booleans(),
    st.lists(st.builds(protocol.EngineRadio, TEXTS, st.integers(0, 2**64 - 1), NUMBERS), max_size=4),
    st.dictionaries(
        st.text(alphabet="abc_", min_size=1, max_size=9), st.text(alphabet="ab 1.=-", max_size=9), max_size=4
    ),
    st.lists(
        st.builds(
            protocol.Building,
            NUMBERS,
            NUMBERS,
            st.lists(st.tuples(NUMBERS, NUMBERS), max_size=5).map(lambda c: np.array(c, dtype=float).reshape(-1, 2)),
        ),
        max_size=3,
    ),
)
ADVANCES = st.builds(
    protocol.Advance,
    st.integers(-(2**63), 2**63 - 1),
    st.integers(-(2**63), 2**63 - 1),
    st.none() | st.just(np.arange(9.0).reshape(3, 3)),
    _rows(protocol.TRANSMISSION),
    _rows(protocol.NOISE),
    _rows(protocol.PATH),
)
DONES = st.builds(
    protocol.Done,
    st.integers(0, 2**32 - 1),
    st.integers(0, 2**64 - 1),
    _rows(protocol.SENT),
    _rows(protocol.HEARD),
)


def _plain(value: Any) -> Any:
    """A value that can be compared: arrays as bytes."""
    if isinstance(value, np.ndarray):
        return value.shape, value.tobytes()
    if hasattr(value, "_asdict"):
        return {name: _plain(part) for name, part in value._asdict().items()}
    if isinstance(value, protocol.Hello):
        return {name: _plain(part) for name, part in vars(value).items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    return value


@given(HELLOS)
def test_a_hello_is_decoded_as_it_was(hello: protocol.Hello) -> None:
    assert _plain(engine_messages.decode_hello(protocol.encode_hello(hello))) == _plain(hello)


@given(ADVANCES)
def test_an_advance_is_decoded_as_it_was(advance: protocol.Advance) -> None:
    assert _plain(engine_messages.decode_advance(protocol.encode_advance(advance), 3)) == _plain(advance)


@given(DONES)
def test_a_done_is_decoded_as_it_was(done: protocol.Done) -> None:
    assert _plain(protocol.decode_done(engine_messages.encode_done(done))) == _plain(done)


@given(TEXTS, TEXTS, st.integers(0, 2**32 - 1), st.integers(0, 7), st.integers(0, 10**9))
def test_a_ready_is_decoded_as_it_was(name: str, release: str, waveforms: int, abilities: int, lookahead: int) -> None:
    ready = protocol.Ready(name, release, waveforms, protocol.Ability(abilities), lookahead)
    assert protocol.decode_ready(engine_messages.encode_ready(ready)) == ready


DECODERS = [
    engine_messages.decode_hello,
    lambda body: engine_messages.decode_advance(body, 3),
    protocol.decode_done,
    protocol.decode_ready,
    engine_messages.decode_path_losses,
    protocol.decode_losses,
    protocol.decode_forked,
    protocol.decode_failed,
]


@given(st.binary(max_size=200), st.integers(0, len(DECODERS) - 1))
@example(b"\xff" * 64, 1)
@example(b"\xff" * 64, 2)
@example(b"\xff\xff\xff\xff", 4)
def test_hostile_bodies_raise_only_decode_errors(body: bytes, which: int) -> None:
    with contextlib.suppress(DecodeError):
        DECODERS[which](body)


@given(st.data())
def test_a_body_that_was_cut_or_extended_is_refused(data: st.DataObject) -> None:
    body = data.draw(st.one_of(HELLOS.map(protocol.encode_hello), DONES.map(engine_messages.encode_done)))
    decode = engine_messages.decode_hello if body.startswith(protocol.MAGIC) else protocol.decode_done
    cut = data.draw(st.integers(0, len(body) - 1))
    with pytest.raises(DecodeError):
        decode(body[:cut])
    with pytest.raises(DecodeError):
        decode(body + b"\0")


@given(st.binary(min_size=12, max_size=12))
def test_hostile_headers_raise_only_decode_errors(header: bytes) -> None:
    try:
        length, _, _ = protocol.unpack_header(header)
    except DecodeError:
        return
    assert length <= protocol.MAX_BODY_BYTES


def test_another_version_is_named() -> None:
    body = bytearray(engine_messages.encode_ready(protocol.Ready("x", "1", 3, protocol.Ability(0), 0)))
    body[8] = 9
    with pytest.raises(DecodeError, match="version 9 of the medium protocol; this is version 1"):
        protocol.decode_ready(bytes(body))


def test_a_parameter_must_stand_on_a_line() -> None:
    with pytest.raises(ValueError, match="a"):
        protocol.encode_hello(protocol.Hello(1, 1.0, False, (), {"a": "1\nb=2"}))
