"""The digests do not depend on order or division, and notice every change of every column."""

from __future__ import annotations

from copy import deepcopy
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrange.contracts.frames import Fate, Frame, end_journey
from skyrange.core.ids import FrameId
from skyrange.record.digests import Digests, hash_rows
from skyrange.record.write.memory_observer import MemoryObserver
from skyrange.record.write.rows.frame_encoder import FrameEncoder
from skyrange.record.write.rows.ticks import TruthTick, truth_words

MASK = (1 << 64) - 1
names = st.sampled_from(["a", "b", "gcs:blue/b1", "blue/b1.proxy", ""])
ids = st.builds(FrameId, names, st.sampled_from(["fwd", "rev"]), names, st.integers(0, 3))
frames = st.builds(
    lambda link, direction, sender, serial, src, dst, sent, payload, parent, causes, arrived, fate: _frame(
        link, direction, sender, serial, src, dst, sent, payload, parent, causes, arrived, fate
    ),
    names, st.sampled_from(["fwd", "rev"]), names, st.integers(0, 2**62), names, names, st.integers(-(2**62), 2**62),
    st.binary(max_size=4), st.none() | ids, st.lists(ids, max_size=2).map(tuple), st.integers(0, 2**62),
    st.sampled_from(list(Fate)),
)  # fmt: skip


def _frame(*values: Any) -> Frame:
    frame = Frame(*values[:6], **dict(zip(("sent_ns", "payload", "parent", "causes"), values[6:10], strict=True)))
    end_journey(frame, values[11], values[10])
    return frame


def _digest(some: list[Frame]) -> str:
    observer = MemoryObserver()
    for frame in some:
        observer.on_frame(frame)
    return observer.digests.frames


def _mixed(words: list[int]) -> int:
    """A row's hash as the formulas say it, in Python's integers: SplitMix64 and MurmurHash3's finalizers."""
    a, b = 0x9E3779B97F4A7C15, 0xFF51AFD7ED558CCD
    for word in words:
        a = ((a ^ word) + 0x9E3779B97F4A7C15) & MASK
        a = ((a ^ (a >> 30)) * 0xBF58476D1CE4E5B9) & MASK
        a = ((a ^ (a >> 27)) * 0x94D049BB133111EB) & MASK
        a ^= a >> 31
        b = (b + word * 0xBF58476D1CE4E5B9 + 0x9E3779B97F4A7C15) & MASK
        b = ((b ^ (b >> 33)) * 0xFF51AFD7ED558CCD) & MASK
        b = ((b ^ (b >> 33)) * 0xC4CEB9FE1A85EC53) & MASK
        b ^= b >> 33
    return (a << 64) | b


@given(st.lists(st.lists(st.integers(0, MASK), min_size=3, max_size=3), max_size=8))
def test_the_kernel_is_the_formula_summed_modulo_two_to_the_128(rows: list[list[int]]) -> None:
    words = np.array(rows, dtype=np.uint64).reshape(-1, 3)
    assert hash_rows(words) == sum(map(_mixed, rows)) % (1 << 128)


@settings(deadline=None)
@given(st.lists(frames, max_size=12), st.data())
def test_order_and_shards_change_nothing(some: list[Frame], data: st.DataObject) -> None:
    shuffled = data.draw(st.permutations(some))
    cut = data.draw(st.integers(0, len(some)))
    assert _digest(shuffled) == _digest(some)
    parts = []
    for part in (shuffled[:cut], shuffled[cut:]):
        observer = MemoryObserver()
        for frame in part:
            observer.on_frame(frame)
        parts.append(observer.digests)
    assert (parts[0] + parts[1]).frames == (parts[1] + parts[0]).frames == _digest(some)


@settings(deadline=None)
@given(st.lists(frames, min_size=1, max_size=12), st.integers(1, 5))
def test_batches_change_nothing(some: list[Frame], size: int) -> None:
    encoder, found = FrameEncoder(3), Digests()
    for start in range(0, len(some), size):
        found.add_frames(encoder.encode(some[start : start + size]).words)
    assert found.frames == _digest(some)


@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("link", "l2"), ("direction", "rev"), ("sender", "s2"), ("serial", 6), ("src", "a2"), ("dst", "d2"),
        ("sent_ns", 11), ("arrived_ns", 21), ("fate", Fate.REPLACED), ("payload", b"pb"), ("parent", None),
        ("parent", FrameId("l", "fwd", "s", 4)), ("parent", FrameId("m", "fwd", "s", 3)), ("causes", ()),
        ("causes", (FrameId("l", "fwd", "s", 2),)),
    ],
)  # fmt: skip
def test_every_column_of_a_frame_counts(column: str, value: object) -> None:
    def build() -> Frame:
        parent, cause = FrameId("l", "fwd", "s", 3), FrameId("l", "fwd", "s", 1)
        return _frame("l", "fwd", "s", 5, "a", "d", 10, b"pa", parent, (cause,), 20, Fate.DELIVERED)

    other = build()
    object.__setattr__(other, column, value)  # which a frame refuses otherwise
    assert _digest([build()]) != _digest([other])
    assert _digest([build(), build()]) != _digest([build()])


def test_the_arrival_of_what_never_arrived_does_not_count() -> None:
    one, two = (_frame("l", "fwd", "s", 5, "a", "d", 10, b"", None, (), at, Fate.LOST) for at in (20, 30))
    assert _digest([one]) == _digest([two])


def _truth(*ticks: TruthTick) -> str:
    found = Digests()
    found.add_truth(truth_words(ticks))
    return found.truth


def _tick(time_ns: int, vehicles: tuple[str, ...], **columns: list[float]) -> TruthTick:
    given = {name: np.array(values) for name, values in columns.items()}
    return TruthTick(time_ns, vehicles, ("dynamic",) * len(vehicles), given)


def test_truth_counts_every_bit_and_no_order() -> None:
    base = _truth(_tick(1, ("a", "b"), x=[1.0, 2.0], y=[0.0, 3.0]))
    assert base == _truth(_tick(1, ("b", "a"), y=[3.0, 0.0], x=[2.0, 1.0]))
    for other in (
        _tick(2, ("a", "b"), x=[1.0, 2.0], y=[0.0, 3.0]),
        _tick(1, ("a", "c"), x=[1.0, 2.0], y=[0.0, 3.0]),
        _tick(1, ("b", "a"), x=[1.0, 2.0], y=[0.0, 3.0]),
        _tick(1, ("a", "b"), x=[1.0, 2.0], y=[-0.0, 3.0]),
        _tick(1, ("a", "b"), x=[np.nextafter(1.0, 2.0), 2.0], y=[0.0, 3.0]),
        _tick(1, ("a", "b"), y=[1.0, 2.0], x=[0.0, 3.0]),
        _tick(1, ("a", "b"), x=[1.0, 2.0], z=[0.0, 3.0]),
    ):
        assert _truth(other) != base
    one, two = _tick(1, ("a",), x=[1.0]), _tick(2, ("a",), x=[1.0])
    halves = Digests(), Digests()
    halves[0].add_truth(truth_words([one]))
    halves[1].add_truth(truth_words([two]))
    assert (halves[0] + halves[1]).truth == _truth(two, one)


def _events(*rows: tuple[str, int, str, str]) -> Digests:
    found = Digests()
    for row in rows:
        found.add_event(*row)
    return found


def test_events_are_kinds_in_order_without_times() -> None:
    base = _events(("v", 1, "s", "armed"), ("v", 2, "s", "landed"), ("w", 1, "s", "armed"))
    assert base.events == _events(("w", 9, "s", "armed"), ("v", 3, "s", "armed"), ("v", 8, "t", "landed")).events
    assert base.events != _events(("v", 2, "s", "armed"), ("v", 1, "s", "landed"), ("w", 1, "s", "armed")).events
    assert base.events != _events(("v", 1, "s", "armed"), ("v", 2, "s", "landed"), ("x", 1, "s", "armed")).events
    assert base.events != _events(("v", 1, "s", "armed"), ("v", 2, "s", "landed")).events
    split = _events(("v", 2, "s", "landed")) + _events(("w", 1, "s", "armed"), ("v", 1, "s", "armed"))
    assert split.events == base.events


def test_copies_and_sums_are_independent() -> None:
    first = _events(("v", 1, "s", "armed"))
    copy, total = deepcopy(first), first + Digests()
    first.add_event("v", 2, "s", "landed")
    assert copy.events == total.events != first.events
    assert first.fingerprint != copy.fingerprint
    assert first.to_dict()["fingerprint"] == first.fingerprint


def test_a_copied_observer_goes_on_alone() -> None:
    observer = MemoryObserver()
    observer.on_frame(_frame("l", "fwd", "s", 5, "a", "d", 10, b"", None, (), 20, Fate.LOST))
    twin = deepcopy(observer)
    twin.on_frame(_frame("l", "fwd", "s", 6, "a", "d", 10, b"", None, (), 20, Fate.LOST))
    assert len(observer.frames) == 1
    assert len(twin.frames) == 2
    assert observer.digests.frames != twin.digests.frames
