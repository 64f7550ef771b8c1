"""Payloads of range scans: what is packed is unpacked, and bytes that are no scan are refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrange.codec.range_scans import DEPTH, HEADER_BYTES, LIDAR, RangeScan, pack_scan, unpack_scan
from skyrange.core.errors import DecodeError
from tests.tiers import examples

SCAN = RangeScan(LIDAR, 1, 7, 0.002, 1_500_000_000, (1.0, 0.0, 0.0, 0.0), np.array([0, 1, 65_535], dtype=np.uint16))


@settings(max_examples=examples(60))
@given(
    st.sampled_from((LIDAR, DEPTH)),
    st.integers(0, 255),
    st.integers(0, 2**32 - 1),
    st.integers(1, 100_000),
    st.integers(-(2**62), 2**62),
    st.lists(st.integers(0, 65_535), max_size=50),
)
def test_what_is_packed_is_unpacked(kind: int, sensor: int, scan: int, um: int, start: int, steps: list[int]) -> None:
    packed = RangeScan(kind, sensor, scan, um * 1e-6, start, (0.6, 0.0, 0.8, 0.0), np.array(steps, dtype=np.uint16))
    got = unpack_scan(pack_scan(packed))
    assert got[:5] == packed[:5]
    assert got.attitude == pytest.approx(packed.attitude, abs=1e-7)
    assert got.steps.tolist() == steps


@settings(max_examples=examples(200))
@given(st.data())
def test_damaged_payloads_are_refused_or_are_scans(data: st.DataObject) -> None:
    payload = bytearray(pack_scan(SCAN))
    for _ in range(data.draw(st.integers(1, 4))):
        payload[data.draw(st.integers(0, len(payload) - 1))] = data.draw(st.integers(0, 255))
    payload = payload[: data.draw(st.integers(0, len(payload)))]
    try:
        got = unpack_scan(bytes(payload))
    except DecodeError:
        return
    assert len(payload) == HEADER_BYTES + 2 * len(got.steps)
    assert sum(part * part for part in got.attitude) == pytest.approx(1.0)
    assert got.resolution_m > 0.0


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda p: p[:20], "20 bytes, a range scan has at least 44"),
        (lambda p: b"XX" + p[2:], "not a range scan"),
        (lambda p: p[:3] + b"\x07" + p[4:], "kind 7"),
        (lambda p: p + b"\x00", "51 bytes with 3 steps"),
        (lambda p: p[:12] + bytes(4) + p[16:], "resolution of 0"),
        (lambda p: p[:24] + bytes(16) + p[40:], "an attitude of length 0"),
    ],
)
def test_a_payload_that_is_none_says_why(change: object, why: str) -> None:
    assert callable(change)
    with pytest.raises(DecodeError, match=why):
        unpack_scan(change(pack_scan(SCAN)))
