"""Does the viewer's stream say what docs/reference/viewer-stream.md says, and does it lose nothing?"""

from __future__ import annotations

import json
import struct
import zlib
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from skyrange.core.errors import DecodeError
from skyrange.core.time import NS_PER_MS, NS_PER_S
from skyrange.metrics.time_series import Track
from skyrange.view.stream.events import TEXTS, EventTables
from skyrange.view.stream.held import KEPT_NS, HeldPositions, Reports
from skyrange.view.stream.messages import Message, Part, decode_file, decode_message, encode_file
from skyrange.view.stream.positions import Grid, Layer, Samples, sample_last, sample_line

Array = NDArray[Any]
SPEC = Path("docs/reference/viewer-stream.md")


def read_by_the_text(data: bytes) -> tuple[str, dict[str, Any], dict[str, Array]]:
    """A message, read as the text says: independent of the decoder."""
    body = zlib.decompress(data[1:])
    (size,) = struct.unpack("<I", body[:4])
    head = json.loads(body[4 : 4 + size])
    at = (4 + size + 3) // 4 * 4
    found = {}
    for name, kind, count in head["arrays"]:
        dtype = np.dtype({"i8": "i1", "u8": "u1", "i16": "<i2", "i32": "<i4", "f32": "<f4"}[kind])
        found[name] = np.frombuffer(body[at : at + count * dtype.itemsize], dtype)
        at += (count * dtype.itemsize + 3) // 4 * 4
    assert at == len(body)
    return chr(data[0]), head, found


ENU = st.tuples(st.integers(1, 4), st.integers(1, 9)).flatmap(
    lambda shape: arrays(
        np.float64,
        (shape[0], 3, shape[1]),
        elements=st.one_of(st.floats(-300, 300), st.floats(-1e6, 1e6), st.just(np.nan)),
    )
)


@given(ENU)
def test_positions_are_kept_to_half_a_centimetre(enu_m: Array) -> None:
    rows = list(range(5, 5 + len(enu_m)))
    grid = Grid(3 * NS_PER_S, 200 * NS_PER_MS, enu_m.shape[2])
    message = Samples(1, Layer.TRUTH, grid, rows, enu_m, np.zeros(enu_m[:, 0].shape)).encode()
    decoded = Samples.decode(decode_message(message.encode()))
    gone: Array = np.asarray(np.isnan(enu_m).any(axis=1))
    assert (decoded.grid, decoded.rows, decoded.arm, decoded.layer) == (grid, rows, 1, Layer.TRUTH)
    assert (np.isnan(decoded.enu_m).any(axis=1) == gone).all()
    there = np.broadcast_to(~gone[:, None, :], enu_m.shape)
    assert np.abs(decoded.enu_m[there] - enu_m[there]).max(initial=0.0) <= 0.005 + 1e-9

    kind, head, found = read_by_the_text(message.encode())
    assert kind == "P"
    count = enu_m.shape[2]
    starts = found["starts"].reshape(len(rows), 3, min(2, count))
    bends = found["bends"].reshape(len(rows), 3, max(count - 2, 0)).astype(int)
    for row in range(len(rows)):
        for axis in range(3):
            x = starts[row, axis].astype(int).tolist()
            for k in range(2, count):
                x.append(int(bends[row, axis, k - 2]) + 2 * x[k - 1] - x[k - 2])
            known = ~gone[row]
            assert np.abs(np.array(x)[known] / 100 - enu_m[row, axis, known]).max(initial=0.0) <= 0.005 + 1e-9
    gaps = np.zeros_like(gone)
    for row, first, until in head["gaps"]:
        gaps[row, first:until] = True
    assert (gaps == gone).all()


@given(arrays(np.float64, (2, 6), elements=st.floats(-10, 10)))
def test_headings_are_kept_to_half_a_part_of_a_turn(heading_rad: Array) -> None:
    samples = Samples(0, Layer.TRUTH, Grid(0, NS_PER_S, 6), [0, 1], np.zeros((2, 3, 6)), heading_rad)
    _, _, found = read_by_the_text(samples.encode().encode())
    parts = np.cumsum(found["turns"].reshape(2, 6).astype(int), axis=1) % 256
    away = np.angle(np.exp(1j * (parts * 2 * np.pi / 256 - heading_rad)))
    assert np.abs(away).max() <= np.pi / 256 + 1e-9


def test_truth_moves_between_samples_and_what_was_heard_stays() -> None:
    track = Track(np.array([1, 2]) * NS_PER_S, np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 5.0]]), np.zeros(2))
    grid = Grid(NS_PER_S // 2, NS_PER_S // 2, 5)
    assert sample_line(track, grid)[0].tolist() == pytest.approx([np.nan, 0.0, 5.0, 10.0, np.nan], nan_ok=True)
    places, age_s = sample_last(track, grid)
    assert places[2].tolist() == pytest.approx([np.nan, 0.0, 0.0, 5.0, 5.0], nan_ok=True)
    assert age_s.tolist() == pytest.approx([np.nan, 0.0, 0.5, 0.0, 0.5], nan_ok=True)


STEP, MOST_S = 200 * NS_PER_MS, KEPT_NS / NS_PER_S - 1


@given(
    st.lists(st.tuples(st.integers(0, 20_000), st.integers(0, 2), st.floats(0, MOST_S)), max_size=30),
    st.lists(st.integers(0, 30_000), min_size=1, max_size=6),
)
def test_reports_that_are_recorded_late_correct_what_was_told(
    reports: list[tuple[int, int, float]], asked_ms: list[int]
) -> None:
    held, told, age_of = HeldPositions(Layer.STATION, 3, 0, STEP), dict[tuple[int, int], float](), {}
    waiting = [
        (t_ms * NS_PER_MS, place, t_ms / 1000 + late_s, float(n)) for n, (t_ms, place, late_s) in enumerate(reports)
    ]
    for now_ms in [*sorted(asked_ms), 40_000]:
        until = now_ms * NS_PER_MS // STEP * STEP
        known = [row for row in waiting if row[2] <= now_ms / 1000]
        waiting = [row for row in waiting if row[2] > now_ms / 1000]
        if known:
            times, places, _, numbers = (np.array(column) for column in zip(*known, strict=True))
            held.add(Reports(times, places, np.repeat(numbers[:, None], 3, axis=1)))
        samples = held.take(until)
        if samples is None:
            continue
        decoded = Samples.decode(decode_message(samples.encode().encode()))
        assert decoded.age_s is not None
        for row, place in enumerate(decoded.rows):
            for k, time_ns in enumerate(decoded.grid.times.tolist()):
                told[place, time_ns] = float(decoded.enu_m[row, 0, k])
                age_of[place, time_ns] = float(decoded.age_s[row, k])
    grid = Grid(0, STEP, 40_000 * NS_PER_MS // STEP + 1)
    for place in range(3):
        own = sorted((t_ms * NS_PER_MS, float(n)) for n, (t_ms, who, _) in enumerate(reports) if who == place)
        if len({time_ns for time_ns, _ in own}) < len(own):
            continue  # of two reports of one time, the one that is recorded last counts
        values = np.array([number for _, number in own])
        times = np.array([time_ns for time_ns, _ in own], dtype=np.int64)
        places, age_s = sample_last(Track(times, np.repeat(values[:, None], 3, axis=1), values), grid)
        for time_ns, expected, age in zip(grid.times.tolist(), places[0].tolist(), age_s.tolist(), strict=True):
            found = told.get((place, time_ns), np.nan)
            assert found == expected or (np.isnan(found) and np.isnan(expected))
            assert np.isnan(expected) or abs(age_of[place, time_ns] - min(age, 25.5)) <= 0.1 + 1e-6


def test_events_are_kept_and_cut_by_time() -> None:
    tables = EventTables()
    for t in (0.5, 1.0, 2.0):
        tables.rows["alerts"].append(
            {"t": t, "detector": "d", "kind": "k", "subject": f"s{t}", "text": "<script>", "score": 1.5}
        )
    message = decode_message(tables.between(1.0, 2.0).encode(0, 1.0, 2.0).encode())
    assert EventTables.decode(message).rows["alerts"] == tables.rows["alerts"][1:2]
    whole = EventTables.decode(decode_message(tables.encode(0, 0.0, 3.0).encode()))
    assert whole == tables


def test_each_table_and_key_is_in_the_text() -> None:
    text = SPEC.read_text(encoding="utf-8")
    for table, columns in TEXTS.items():
        assert f"| `{table}` |" in text
        assert all(f"`{column}`" in text for column in columns)


def test_a_file_is_its_scene_and_parts_that_can_be_read_alone() -> None:
    scene = Message("S", {"version": 1})
    parts = [Part(k, k + 1.0, [Message("E", {"arm": 0, "k": k, "names": []})] * k) for k in range(4)]
    data = encode_file(scene, parts)
    messages = list(decode_file(data))
    assert [message.head.get("k") for message in messages[1:]] == [1, 2, 2, 3, 3, 3]
    (length,) = struct.unpack_from("<I", data, 8)
    for (offset, size, from_s, until_s), part in zip(messages[0].head["parts"], parts, strict=True):
        assert (from_s, until_s) == (part.from_s, part.until_s)
        alone = data[12 + length + offset :][:size]
        assert [message.head["k"] for message in decode_file(data[: 12 + length] + alone) if message.kind == "E"] == [
            message.head["k"] for message in part.messages
        ]


@given(st.data())
def test_a_file_that_was_cut_or_altered_is_refused_or_read(data: st.DataObject) -> None:
    whole = encode_file(Message("S", {"version": 1}), [Part(0.0, 1.0, [Message("E", {"arm": 0, "names": []})])])
    cut = data.draw(st.integers(0, len(whole) - 1))
    broken = bytearray(whole)
    broken[cut] = data.draw(st.integers(0, 255))
    for hostile in (whole[:cut], bytes(broken), bytes(broken[cut:])):
        with suppress(DecodeError):
            assert list(decode_file(hostile))


def test_a_body_that_grows_without_end_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("skyrange.view.stream.messages.MAX_BODY_BYTES", 1 << 16)
    bomb = b"P" + zlib.compress(bytes(1 << 17), 9)
    with pytest.raises(DecodeError, match="too long"):
        decode_message(bomb)
