"""Two runs that are the same are told so; of others the first row that differs is named, in whatever order recorded."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from skyrange.contracts.frames import Fate, Frame, end_journey
from skyrange.contracts.mailboxes import Note
from skyrange.core.errors import InputError
from skyrange.metrics import exact_difference as exact
from skyrange.metrics.exact_difference import diff
from skyrange.record import Recorder, load
from tests.unit.record_sample import HEADER, LABELS, MS, NOTES, StillWorld, tell, traffic

Change = Callable[[list[Frame]], Sequence[Frame]]


def _run(folder: Path, change: Change = list, *, close: bool = True, header: Any = HEADER) -> Path:
    recorder = Recorder.open(folder, header)
    for count, frame in enumerate(change(list(traffic(10)))):
        recorder.on_frame(frame)
        if not close and count % 7 == 0:  # in batches that do not match those of the other run
            recorder.flush()
    recorder.close() if close else recorder.flush()
    return folder


@pytest.mark.parametrize("close", [True, False])
def test_the_same_run_twice(tmp_path: Path, close: bool) -> None:
    for name in "ab":
        recorder = Recorder.open(tmp_path / name, HEADER)
        tell(recorder)
        recorder.close() if close and name == "a" else recorder.flush()
    found = diff(tmp_path / "a", tmp_path / "b")
    assert found.same
    assert found.first == {}
    assert found.counts["frames"] == (240, 240)
    assert "the same: " in str(found)
    assert json.loads(json.dumps(found.to_dict()))["same"] is True
    assert diff(load(tmp_path / "a"), load(tmp_path / "a")).same


def test_the_order_of_recording_is_no_difference(tmp_path: Path) -> None:
    a, b = _run(tmp_path / "a"), _run(tmp_path / "b", lambda frames: frames[::-1], close=False)
    assert diff(a, b).same


def _payload(frame: Frame) -> None:
    object.__setattr__(frame, "payload", frame.payload[:-1] + b"\0")


def _fate(frame: Frame) -> None:
    object.__setattr__(frame, "fate", Fate.DROPPED)


def _arrival(frame: Frame) -> None:
    end_journey(frame, frame.fate, frame.arrived_ns + 1)


def _parent(frame: Frame) -> None:
    object.__setattr__(frame, "parent", None)


def _causes(frame: Frame) -> None:
    object.__setattr__(frame, "causes", (frame.id,))


def _claim(frame: Frame) -> None:
    object.__setattr__(frame, "src", "somebody else")


@pytest.mark.parametrize("reach", [1, 25, 131_072])
@pytest.mark.parametrize("close", [True, False])
@pytest.mark.parametrize(
    ("alter", "columns"),
    [
        (_payload, {"payload"}),
        (_fate, {"fate", "arrived_ns"}),
        (_arrival, {"arrived_ns"}),
        (_parent, {"parent"}),
        (_causes, {"causes"}),
        (_claim, {"src"}),
    ],
)
def test_the_first_frame_that_differs(
    tmp_path: Path,
    alter: Callable[[Frame], None],
    columns: set[str],
    close: bool,
    reach: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("skyrange.record.read.time_order.STRAGGLER_ROWS", reach)

    def change(frames: list[Frame]) -> list[Frame]:
        alter(frames[90])
        alter(frames[38])
        return frames[60:] + frames[:60]

    a, b = _run(tmp_path / "a"), _run(tmp_path / "b", change, close=close)
    altered = list(traffic(10))[38]
    found = diff(a, b)
    assert not found.same
    first = found.first_frame
    assert first is not None
    assert first.time_ns == altered.sent_ns
    assert first.row.startswith(str(altered.id))
    assert first.only_in is None
    assert set(first.columns) == columns
    assert found.first_truth is None
    if columns == {"payload"}:
        assert first.columns["payload"][0] == altered.payload.hex()
    assert str(altered.id) in str(found)
    assert json.loads(json.dumps(found.to_dict()))["first"]["frames"]["row"] == first.row


def test_a_frame_that_only_one_has(tmp_path: Path) -> None:
    a = _run(tmp_path / "a")
    b = _run(tmp_path / "b", lambda frames: frames[:30] + frames[31:])
    missing = list(traffic(10))[30]
    found = diff(a, b)
    assert found.counts["frames"] == (120, 119)
    assert found.first_frame is not None
    assert found.first_frame.only_in == "a"
    assert found.first_frame.row.startswith(str(missing.id))
    other = diff(b, a).first_frame
    assert other is not None
    assert other.only_in == "b"


def test_a_killed_run_ends_earlier(tmp_path: Path) -> None:
    a, b = _run(tmp_path / "a"), _run(tmp_path / "b", lambda frames: frames[:60], close=False)
    found = diff(a, b)
    assert found.statuses == ("complete", "killed or still running")
    assert found.first_frame is not None
    assert found.first_frame.only_in == "a"
    assert found.digests["frames"][1] is None


class _Drifting(StillWorld):
    def truth(self) -> Any:
        columns = dict(super().truth())
        if self.ticks == 4:
            columns["up_m"] = columns["up_m"] * -1.0  # -0.0: equal as a number, another bit pattern
        return columns


class _Wider(StillWorld):
    def truth(self) -> Any:
        return {**super().truth(), "wind_mps": super().truth()["up_m"]}


@pytest.mark.parametrize("close", [True, False])
def test_the_first_truth_row_that_differs(tmp_path: Path, close: bool) -> None:
    for name, world in (("a", StillWorld()), ("b", _Drifting())):
        recorder = Recorder.open(tmp_path / name, HEADER)
        for tick in range(8):
            recorder.on_truth(tick * 100 * MS, world)
        recorder.close() if close else recorder.flush()
    first = diff(tmp_path / "a", tmp_path / "b").first_truth
    assert first is not None
    assert (first.time_ns, first.row, first.columns) == (300 * MS, "blue/b1", {"up_m": (0.0, -0.0)})


def test_worlds_with_other_columns(tmp_path: Path) -> None:
    for name, world in (("a", StillWorld()), ("b", _Wider())):
        recorder = Recorder.open(tmp_path / name, HEADER)
        recorder.on_truth(0, world)
        recorder.close()
    found = diff(tmp_path / "a", tmp_path / "b")
    assert not found.same
    assert found.columns == {"truth": ([], ["wind_mps"])}
    assert "only in b wind_mps" in str(found)


def test_outcomes_events_decisions_and_labels(tmp_path: Path) -> None:
    for name, reason in (("a", "no answer"), ("b", "battery")):
        recorder = Recorder.open(tmp_path / name, HEADER)
        for now, source, note in NOTES[:-1]:
            recorder.on_note(now, source, note)
        now, source, note = NOTES[-1]
        recorder.on_note(now, source, Note(note.kind, note.about, {**note.data, "reason": reason}))
        recorder.on_label(LABELS[name == "b"])
        recorder.close()
    found = diff(tmp_path / "a", tmp_path / "b")
    assert set(found.outcomes) == {"green/g1"}
    assert found.outcomes["green/g1"][1]["reason"] == "battery"
    assert set(found.first) == {"events", "labels"}
    assert found.first["labels"].only_in == "a"
    assert found.digests["events"][0] == found.digests["events"][1]
    assert "outcome of green/g1: failed at 0.5 s (no answer) | failed at 0.5 s (battery)" in str(found)


def test_other_numeric_platforms_are_mentioned(tmp_path: Path) -> None:
    a = _run(tmp_path / "a")
    b = _run(tmp_path / "b", lambda frames: frames[1:], header={**HEADER, "platform": {"numeric": "another"}})
    assert "numeric platforms differ" in str(diff(a, b))


def test_no_run(tmp_path: Path) -> None:
    with pytest.raises(InputError):
        diff(_run(tmp_path / "a"), tmp_path / "b")


@pytest.mark.parametrize(
    ("a", "b", "same"),
    [
        (1, 1, True), (1, 2, False), ("x", "x", True), ("x", "y", False), (None, None, True), (None, 0, False),
        (0.0, 0.0, True), (0.0, -0.0, False), (float("nan"), float("nan"), True), (1.0, 1.0 + 2**-52, False),
    ],
)  # fmt: skip
def test_cells_are_alike_to_the_bit(a: object, b: object, same: bool) -> None:
    assert exact._alike(a, b) is same
