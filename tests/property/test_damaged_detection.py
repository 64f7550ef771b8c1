"""Logs and captures that are damaged: an `InputError`, or alerts over what can be read; every byte is accounted for."""

from __future__ import annotations

import contextlib
import io
import random
from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from zlib import crc32

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrange.codec.mavlink.telemetry_log import LogCounts, LoggedFrame, read_frames
from skyrange.core.errors import InputError
from skyrange.log_detection.detector_choice import Request
from skyrange.log_detection.judging import judge
from skyrange.log_detection.opening import open_log
from skyrange.log_detection.page import render_page
from skyrange.log_detection.result_files import alert_table
from tests.captured_packets import write_mavlink_capture, write_old_capture, write_remote_id_capture
from tests.file_mutations import mutate
from tests.tiers import examples, is_fuzzing
from tests.written_logs import hop, write_tlog

WRITERS: dict[str, Callable[[Path], object]] = {
    "a.tlog": lambda path: write_tlog(path, hop(4.0, 2.0)),
    "a.pcapng": lambda path: write_mavlink_capture(path, hop(4.0, 2.0)),
    "a.pcap": lambda path: write_old_capture(path, hop(4.0, 2.0)),
    "r.pcapng": write_remote_id_capture,
}
REQUEST = Request(kinds=("mavlink.sequence", "mavlink.source", "remote_id.*"))


@cache
def contents(name: str) -> bytes:
    with TemporaryDirectory() as folder:
        path = Path(folder, name)
        WRITERS[name](path)
        return path.read_bytes()


@pytest.mark.parametrize("name", WRITERS)
@settings(max_examples=100 if is_fuzzing() else examples(12), derandomize=not is_fuzzing(), deadline=None)
@given(number=st.integers(0, 2**32 - 1))
def test_a_damaged_log_is_refused_or_judged(name: str, number: int) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder, name)
        path.write_bytes(mutate(contents(name), "bytes", crc32(f"{name} {number}".encode())))
        with contextlib.suppress(InputError):
            findings = judge(open_log(path), REQUEST)
            assert alert_table([findings]).num_rows == len(findings.alerts)
            assert "</html>" in render_page([findings], None)


def frames_of(data: bytes) -> tuple[list[LoggedFrame], LogCounts]:
    counts = LogCounts()
    return list(read_frames(io.BytesIO(data), counts)), counts


def account(frames: list[LoggedFrame], counts: LogCounts) -> int:
    """The bytes that were read or counted."""
    return sum(8 + len(data) for _, data in frames) + counts.bad_bytes + counts.unknown_bytes + counts.cut_bytes


@settings(max_examples=examples(60), deadline=None)
@given(seed=st.integers(0, 2**32 - 1), flips=st.integers(0, 20))
def test_no_byte_of_a_log_is_lost_from_the_account(seed: int, flips: int) -> None:
    chance, data = random.Random(seed), bytearray(contents("a.tlog"))
    for _ in range(flips):
        data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
    data = data[: chance.randrange(len(data))]
    frames, counts = frames_of(bytes(data))
    assert account(frames, counts) == len(data)
    assert counts.frames == len(frames)


@settings(max_examples=examples(60), deadline=None)
@given(garbage=st.binary(min_size=1, max_size=400), place=st.integers(0, 30))
def test_garbage_between_frames_takes_none_of_them(garbage: bytes, place: int) -> None:
    whole, _ = frames_of(contents("a.tlog"))
    at = sum(8 + len(data) for _, data in whole[:place])
    data = contents("a.tlog")
    frames, counts = frames_of(data[:at] + garbage + data[at:])
    assert account(frames, counts) == len(data) + len(garbage)
    assert set(frames) >= set(whole[:place])
    assert len(set(whole) - set(frames)) == 0 or counts.unknown_messages  # the garbage may look like a frame of its own
