"""Messages in columns: byte-equal to those packed singly, and read back alike."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrange.codec.mavlink import Packer, decode, message_id
from skyrange.codec.mavlink.frames import LAYOUTS
from skyrange.codec.mavlink.message_columns import message_ids, pack_batches, payload_dtype
from skyrange.contracts.frames import Payloads
from tests.cases import each_case
from tests.message_columns import unpack_frames
from tests.tiers import examples


def _random_rows(message_id: int, count: int, seed: int) -> Any:
    dtype = payload_dtype(message_id)
    dice = np.random.default_rng(seed)
    raw = dice.integers(0, 256, (count, dtype.itemsize), dtype=np.uint8)
    raw[dice.random(raw.shape) < 0.5] = 0
    raw[0, dtype.itemsize // 2 :] = 0  # something to cut
    rows = raw.view(dtype).reshape(count)
    for name in dtype.names or ():
        if rows[name].dtype.kind == "f":  # Python's own conversion quiets a signalling NaN
            rows[name] = np.where(np.isnan(rows[name]), np.nan, rows[name])
    return rows


def _alike(left: Any, right: Any) -> bool:
    if isinstance(left, float) and math.isnan(left):
        return math.isnan(right)
    if isinstance(left, (list, tuple)):
        return len(left) == len(right) and all(map(_alike, left, right))
    return bool(left == right)


@each_case("message_id", sorted(LAYOUTS))
def test_packed_in_columns_is_byte_equal_to_packed_singly(message_id: int) -> None:
    rows = _random_rows(message_id, 5, message_id)
    sequences = np.array([0, 1, 254, 255, 7])
    systems = np.array([1, 2, 250, 255, 9])
    column = pack_batches([(message_id, rows, systems, sequences)], 1)
    for place, frame in enumerate(column):
        packer = Packer(int(systems[place]), 1)
        packer.sequence = int(sequences[place])
        again = decode(frame)
        assert frame == packer.pack(again), message_id
        assert (again.get_srcSystem(), again.get_seq()) == (systems[place], sequences[place])


@each_case("message_id", sorted(LAYOUTS))
def test_unpacked_in_columns_says_what_decoding_says(message_id: int) -> None:
    rows = _random_rows(message_id, 4, message_id + 1)
    column = pack_batches([(message_id, rows, np.array([3, 4, 5, 6]), np.arange(4))], 1)
    groups, rest = unpack_frames(column)
    assert len(rest) == 0
    assert [group.message_id for group in groups] == [message_id]
    found = groups[0]
    assert found.values.tobytes() == rows.tobytes()
    for place, frame in enumerate(column):
        message = decode(frame)
        for name in LAYOUTS[message_id].cls.fieldnames:
            told, value = getattr(message, name), found.values[name][place]
            if isinstance(value, bytes):
                assert getattr(message, f"_{name}_raw").split(b"\0")[0] == value.split(b"\0")[0]
                continue
            kept = value.tolist() if value.ndim else value.item()
            assert _alike(list(told) if isinstance(told, (tuple, list)) else told, kept), (message_id, name)


@settings(max_examples=examples(150), deadline=None)
@given(st.lists(st.binary(max_size=40), max_size=6), st.integers(0, 40), st.integers(1, 255))
def test_what_is_no_frame_is_left_and_never_taken_for_one(junk: list[bytes], place: int, change: int) -> None:
    rows = _random_rows(33, 1, 5)
    good = pack_batches([(33, rows, np.array([1]), np.array([0]))], 1)[0]
    bent = bytearray(good)
    bent[place % len(good)] ^= change
    groups, rest = unpack_frames(Payloads.of([*junk, bytes(bent), good]))
    taken = sorted(row for group in groups for row in group.rows.tolist())
    assert sorted([*taken, *rest.tolist()]) == list(range(len(junk) + 2))
    assert len(junk) + 1 in taken
    for row in taken:
        decode([*junk, bytes(bent), good][row])  # raises where it is no frame


def test_every_truncation_of_a_frame_is_left() -> None:
    good = pack_batches([(33, _random_rows(33, 1, 9), np.array([1]), np.array([0]))], 1)[0]
    _, rest = unpack_frames(Payloads.of([good[:size] for size in range(len(good))]))
    assert len(rest) == len(good)


def test_a_column_of_payloads_is_taken_joined_and_compacted() -> None:
    column = Payloads.of([b"abc", b"", b"de", b"f"])
    assert list(column) == [b"abc", b"", b"de", b"f"]
    part = column.take(np.array([3, 0]))
    assert list(part) == [b"f", b"abc"]
    assert part.compact().data.tobytes() == b"fabc"
    assert list(Payloads.join([part, Payloads.of([]), column])) == [b"f", b"abc", b"abc", b"", b"de", b"f"]
    assert len(Payloads.join([])) == 0


@given(st.lists(st.one_of(st.binary(max_size=16), st.binary(max_size=14).map(b"\xfd".__add__)), max_size=5))
@settings(deadline=None)
def test_ids_in_columns_are_those_of_single_frames(payloads: list[bytes]) -> None:
    found = message_ids(Payloads.of(payloads)).tolist()
    assert [None if number < 0 else number for number in found] == [message_id(payload) for payload in payloads]
