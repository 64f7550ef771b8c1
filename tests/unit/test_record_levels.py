"""Levels of a record: the tables that each keeps, equal digests, and features that count the same frames."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from skyrange.codec.mavlink import Packer, decode, dialect
from skyrange.contracts.components import Floats
from skyrange.contracts.frames import Fate, Frame
from skyrange.core.errors import DecodeError, InputError
from skyrange.metrics.exact_difference import diff
from skyrange.metrics.summary import summary
from skyrange.record import RecordedFrame, Recorder, RunRecord, load
from skyrange.record.read.features import FATE_COLUMNS
from skyrange.record.schema import DERIVED, LEVELS, OPTIONAL, RECORDED, TABLES
from skyrange.record.verification import verify_run
from tests.unit.record_sample import HEADER, LABELS, MS, NOTES, StillWorld, make_frame, traffic

FILES = {
    "full": set(TABLES) - OPTIONAL | {"telemetry"},
    "study": {"truth", "sensors", "decisions", "events", "labels", "features"},
    "summary": {"decisions", "events"},
}
"""Of a run without detectors and without receptions."""


class _World(StillWorld):
    """A world of whose truth tracks can be made."""

    def truth(self) -> Mapping[str, Floats]:
        zeros = np.zeros(len(self.vehicles))
        return {**super().truth(), **dict.fromkeys(("vel_east_mps", "vel_north_mps", "vel_up_mps"), zeros)}


def frames() -> list[Frame]:
    """Frames of every fate and group of messages, some recorded long after they were sent."""
    packer = Packer(3, 1)
    bodies = [
        dialect.MAVLink_heartbeat_message(2, 3, 81, 0, 4, 3),
        dialect.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0),
        dialect.MAVLink_command_ack_message(400, 0),
        dialect.MAVLink_set_mode_message(1, 1, 4),
        dialect.MAVLink_mission_count_message(1, 1, 5),
        dialect.MAVLink_mission_item_reached_message(2),
        dialect.MAVLink_param_request_list_message(1, 1),
        dialect.MAVLink_param_ext_request_list_message(1, 1),
        dialect.MAVLink_system_time_message(1, 2),
    ]
    payloads = [packer.pack(body) for body in bodies]
    payloads += [b"", b"\xfd", b"\xfd" * 40, b"\xfe\x00\x01\x02\x03\x00\x05", payloads[0] + b"\0", b'{"method": "PUT"}']
    made = [*traffic(25), make_frame("gcs:blue/b2", "fwd", "tap", 0, 12_000 * MS, payloads[0], fate=Fate.LOST)]
    for serial, payload in enumerate(payloads * 6):
        fate = list(Fate)[serial % 6]
        sent = serial * 130 * MS - serial % 6
        arrived = sent + (40 if serial % 4 else 2_500) * MS
        made.append(make_frame("gcs:blue/b1", "fwd", "tap", serial, sent, payload, fate=fate, arrived_ns=arrived))
    return sorted(made, key=lambda one: one.arrived_ns)


def observe(recorder: Recorder, flush_every: int = 10**9, seen: Iterable[Frame] | None = None) -> None:
    world: Any = _World()
    for count, frame in enumerate(frames() if seen is None else seen):
        recorder.on_frame(frame)
        if count % 9 == 0:
            recorder.on_truth(count * 40 * MS, world)
        if count % flush_every == flush_every - 1:
            recorder.flush()
    for now, source, note in NOTES:
        recorder.on_note(now, source, note)
    for label in LABELS:
        recorder.on_label(label)


def record(folder: Path, level: str, flush_every: int = 10**9, **more: Any) -> RunRecord:
    recorder = Recorder.open(folder, HEADER, level=level, flush_s=1e9, **more)
    observe(recorder, flush_every)
    recorder.close()
    return load(folder)


def group_of(payload: bytes) -> str:
    try:
        name = decode(payload).get_type()
    except DecodeError:
        return ""
    if name == "HEARTBEAT":
        return "heartbeats"
    if name in ("COMMAND_LONG", "COMMAND_INT", "COMMAND_ACK", "SET_MODE"):
        return "commands"
    return {"MISSION": "missions", "PARAM": "parameters"}.get(name.split("_")[0], "")


def counted(seen: Iterable[RecordedFrame], period_ns: int = 1_000 * MS) -> list[dict[str, Any]]:
    """The rows of `features` by counting frames one by one."""
    rows: dict[tuple[int, str, str], dict[str, Any]] = {}
    for frame in seen:
        key = (frame.sent_ns // period_ns * period_ns, frame.link, frame.direction)
        names = ("heartbeats", "commands", "missions", "parameters")
        zero = dict.fromkeys(("sent", *FATE_COLUMNS, "size_bytes", "latency_sum_ns", *names), 0)
        row = rows.setdefault(key, {**zero, "latency_max_ns": None})
        row["sent"] += 1
        row[frame.fate] += 1
        row["size_bytes"] += len(frame.payload)
        if frame.arrived_ns is not None:
            latency = frame.arrived_ns - frame.sent_ns
            row["latency_sum_ns"] += latency
            row["latency_max_ns"] = max(row["latency_max_ns"] or 0, latency)
        if group := group_of(frame.payload):
            row[group] += 1
    return [{"time_ns": k[0], "link": k[1], "direction": k[2], **rows[k]} for k in sorted(rows)]


def as_rows(table: pa.Table, like: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [{name: row[name] for name in like[0]} for row in table.to_pylist()]


# ---------------------------------------------------------------- tables


@pytest.mark.parametrize("level", LEVELS)
def test_a_level_keeps_its_tables_and_refuses_the_others(level: str, tmp_path: Path) -> None:
    run = record(tmp_path / "run", level, part_rows=30)
    found = {path.name.removesuffix(".parquet") for path in run.path.iterdir()} - {"manifest.json"}
    assert found == FILES[level]
    assert run.level == level == run.manifest["record"]["level"]
    for name in TABLES:
        if run.keeps(name):
            assert run.table(name).num_rows == run.rows(name) == sum(batch.num_rows for batch in run.batches(name))
            continue
        for read in (run.table, run.rows, lambda name: list(run.batches(name))):
            with pytest.raises(InputError) as caught:
                read(name)
            (problem,) = caught.value.problems
            assert problem.value == level
            assert "[record] level = " in problem.expected
    if level != "full":
        reading: list[Callable[[], Any]] = [
            lambda: run.telemetry("ATTITUDE"), lambda: run.messages, lambda: list(run.frames_with_payloads())
        ]  # fmt: skip
        for read_frames in reading:
            with pytest.raises(InputError, match=f"record.level: {level}"):
                read_frames()
    assert verify_run(run).ok
    assert not (run.path / ".spool").exists()


def test_levels_have_the_same_digests_and_rows(tmp_path: Path) -> None:
    full = record(tmp_path / "full", "full")
    for level in ("study", "summary"):
        run = record(tmp_path / level, level)
        assert run.manifest["digests"] == full.manifest["digests"]
        assert run.outcomes == full.outcomes
        assert run.duration == full.duration
        assert run.manifest["not_kept"]["frames"] == full.rows("frames")
        for name in RECORDED[level] - DERIVED:
            assert run.table(name).equals(full.table(name)), name
        found = diff(full, run)
        assert found.same
        assert "frames not compared: b has none" in str(found)
        assert "the digests are equal" in str(found)
    assert run.manifest["not_kept"] == {name: full.rows(name) for name in ("frames", "truth", "labels")}


def test_a_difference_in_frames_is_told_without_frames(tmp_path: Path) -> None:
    runs = []
    for number, level in enumerate(("study", "study", "summary", "full")):
        recorder = Recorder.open(tmp_path / str(number), HEADER, level=level)
        seen = frames()
        observe(recorder, seen=seen if number == 0 else seen[:-1])
        recorder.close()
        runs.append(load(tmp_path / str(number)))
    for other in (runs[1], runs[3]):
        found = diff(runs[0], other)
        assert not found.same
        assert found.first["features"].row.startswith("gcs:blue/b1")
    found = diff(runs[0], runs[2])
    assert not found.same
    both = "a has none (level study) and b has none (level summary)"
    assert f"frames not compared: {both}; the digests differ" in str(found)


def test_a_summary_tells_no_numbers_that_it_does_not_have(tmp_path: Path) -> None:
    study, full = (summary(record(tmp_path / level, level)) for level in ("study", "full"))
    short = summary(record(tmp_path / "summary", "summary"))
    assert short["level"] == "summary"
    assert short["frames"] == study["frames"] == full["frames"] > 0
    assert {row["distance_m"] for row in short["vehicles"]} == {None}
    assert {row["frames_received"] for row in short["vehicles"]} == {None}
    unlike = {"level", "disk", "path", "timings"}
    assert {key: one for key, one in study.items() if key not in unlike} == {
        key: one for key, one in full.items() if key not in unlike
    }


def test_levels_and_rates_are_checked(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"record\.level: 'most' — expected one of full, study, summary"):
        Recorder.open(tmp_path / "run", HEADER, level="most")
    with pytest.raises(InputError, match="features_hz"):
        Recorder.open(tmp_path / "run", HEADER, features_hz=0.0)
    assert not (tmp_path / "run").exists()


def test_rows_of_another_recorder_are_kept_by_level(tmp_path: Path) -> None:
    truth = record(tmp_path / "full", "full").table("truth").to_batches()
    recorder = Recorder.open(tmp_path / "summary", HEADER, level="summary")
    for batch in truth:
        recorder.on_rows("truth", batch)
    recorder.close()
    run = load(tmp_path / "summary")
    assert run.manifest["digests"]["truth"] == load(tmp_path / "full").manifest["digests"]["truth"]
    assert run.manifest["not_kept"] == {"truth": sum(batch.num_rows for batch in truth)}


# ---------------------------------------------------------------- features


@pytest.mark.parametrize("features_hz", [1.0, 4.0, 0.3])
def test_features_are_those_of_the_frames(features_hz: float, tmp_path: Path) -> None:
    full = record(tmp_path / "full", "full", features_hz=features_hz)
    study = record(tmp_path / "study", "study", features_hz=features_hz)
    expected = counted(full.frames_with_payloads(), round(1e9 / features_hz))
    assert any(row["parameters"] for row in expected)
    assert any(row["latency_max_ns"] is None for row in expected)
    assert as_rows(study.table("features"), expected) == expected
    assert study.table("features").equals(full.table("features"))  # counted when it is read


def test_features_do_not_depend_on_flushes_and_parts(tmp_path: Path) -> None:
    found = []
    for flush_every, part_rows in ((1, 7), (13, 20), (10**9, 10**6), (5, 0)):
        run = record(tmp_path / f"{flush_every}-{part_rows}", "study", flush_every, part_rows=part_rows)
        assert run.manifest["counts"]["features"] == run.rows("features")
        found.append(run.manifest["files"]["features.parquet"])
    assert all(one == found[0] for one in found)


# ---------------------------------------------------------------- killed runs and forks


@pytest.mark.parametrize("level", ["study", "summary"])
def test_a_killed_run_opens(level: str, tmp_path: Path) -> None:
    full = record(tmp_path / "full", "full")
    recorder = Recorder.open(tmp_path / "killed", HEADER, level=level, part_rows=20)
    observe(recorder, 11)
    recorder.flush()
    killed = load(tmp_path / "killed")
    assert killed.status == "killed or still running"
    for name in RECORDED[level] - DERIVED:
        assert killed.table(name).equals(full.table(name)), name
    if level == "study":
        assert killed.table("features").equals(full.table("features"))
        assert killed.rows("features") == full.rows("features")
    with pytest.raises(InputError, match="It has no frames"):
        killed.table("frames")
    assert summary(killed)["frames"] == (full.rows("frames") if level == "study" else None)
    assert not diff(killed, full).same
    recorder.abandon()


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("part_rows", [10, 10**6])
def test_a_fork_continues_at_its_level(level: str, part_rows: int, tmp_path: Path) -> None:
    expected = record(tmp_path / "whole", level)
    seen = frames()

    def finish(recorder: Recorder) -> RunRecord:
        for frame in seen[60:]:
            recorder.on_frame(frame)
        recorder.close()
        return load(recorder.path)

    stem = Recorder.open(tmp_path / "stem", HEADER, level=level, part_rows=part_rows)
    observe(stem, seen=seen[:60])
    twin = stem.fork(tmp_path / "twin")
    runs = [finish(twin), finish(stem)]
    for run in runs:
        assert run.manifest["digests"]["frames"] == expected.manifest["digests"]["frames"]
        assert run.manifest.get("not_kept") == runs[0].manifest.get("not_kept")
        if level != "summary":
            assert run.table("features").equals(expected.table("features"))
        assert verify_run(run).ok


def test_no_frames_make_no_features(tmp_path: Path) -> None:
    recorder = Recorder.open(tmp_path / "run", HEADER, level="study")
    recorder.close()
    run = load(tmp_path / "run")
    assert run.rows("features") == 0
    assert not (run.path / "features.parquet").exists()
