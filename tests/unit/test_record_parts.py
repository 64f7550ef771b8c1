"""Tables in several parts: the same rows in the same order as in one file, and nothing lost while parts are written."""

from __future__ import annotations

import errno
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

from skyrange.contracts.frames import Fate, Frame, end_journey
from skyrange.core.errors import ComponentError, InputError
from skyrange.metrics.summary import measure_disk
from skyrange.record import Recorder, RunRecord, load
from skyrange.record.read.telemetry import count_messages
from skyrange.record.schema import TABLES
from skyrange.record.verification import verify_run
from skyrange.record.write.files import derivation
from skyrange.record.write.files.part_writer import PENDING, Background
from skyrange.record.write.files.table_files import TableFiles
from tests.unit.record_sample import HEADER, MS, StillWorld, tell, traffic

pytestmark = pytest.mark.rotating


def _delayed(seed: int) -> Iterator[Frame]:
    """Traffic of which some frames are recorded late, out of their order, and some arrive at one time."""
    draw = random.Random(seed)
    held: list[tuple[int, Frame]] = []
    for count, frame in enumerate(traffic(8)):
        if draw.random() < 0.3:
            end_journey(frame, frame.fate, (frame.sent_ns // (50 * MS) + 1) * 50 * MS)
        held.append((count + draw.choice([0, 0, 0, 1, 5, 60]), frame))
        due = [each for at, each in held if at <= count]
        held = [(at, each) for at, each in held if at > count]
        yield from due
    yield from (frame for _, frame in held)


def _record(folder: Path, frames: Iterator[Frame], part_rows: int, flush_every: int = 10**9, **more: Any) -> RunRecord:
    recorder = Recorder.open(folder, HEADER, part_rows=part_rows, flush_s=1e9, **more)
    _observe(recorder, frames, flush_every)
    recorder.close()
    return load(folder)


def _observe(recorder: Recorder, frames: Iterator[Frame], flush_every: int = 10**9) -> None:
    world = StillWorld()
    for count, frame in enumerate(frames):
        recorder.on_frame(frame)
        if count % 9 == 0:
            recorder.on_truth(count * 40 * MS, world)
        if count % flush_every == flush_every - 1:
            recorder.flush()


def _check_same(left: RunRecord, right: RunRecord) -> None:
    for key in ("digests", "counts", "messages", "outcomes"):
        assert left.manifest[key] == right.manifest[key]
    for name in TABLES:
        assert left.table(name).equals(right.table(name)), name
        assert left.rows(name) == right.rows(name)
    for name in left.messages:
        assert left.telemetry(name).equals(right.telemetry(name)), name


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize("held_ns", [0, 20 * MS, derivation.HELD_NS])
def test_rows_do_not_depend_on_the_length_of_parts(
    seed: int, held_ns: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(derivation, "HELD_NS", held_ns)
    monkeypatch.setattr(derivation, "BLOCK_ROWS", 5)
    in_spool = Recorder.open(tmp_path / "spooled", HEADER, part_rows=0)
    _observe(in_spool, _delayed(seed))
    in_spool.close()  # derives telemetry from the whole record
    whole = load(tmp_path / "spooled")
    assert (whole.path / "frames.parquet").is_file()
    for part_rows in (3, 40, 10**6):
        parts = _record(tmp_path / str(part_rows), _delayed(seed), part_rows, 1 + 10 * part_rows)
        _check_same(whole, parts)
        assert verify_run(parts).ok
        lengths = [pq.read_metadata(path).num_rows for path in sorted((parts.path / "frames.parquet").glob("*"))]
        rows = whole.rows("frames")
        assert lengths == [min(part_rows, rows - start) for start in range(0, rows, part_rows) if part_rows < rows]
        assert pq.read_table(parts.path / "frames.parquet").num_rows == rows  # as pandas, Polars and Spark read it
        assert not (parts.path / ".spool").exists()


def test_files_do_not_depend_on_when_the_recorder_flushes(tmp_path: Path) -> None:
    found = []
    for flush_every in (1, 7, 10**9):
        run = _record(tmp_path / str(flush_every), _delayed(1), 50, flush_every)
        found.append({name: entry for name, entry in run.manifest["files"].items() if name.endswith(".parquet")})
    assert found[0] == found[1] == found[2]
    assert "frames.parquet/part-0001.parquet" in found[0]
    assert "events.parquet" in found[0]


def test_a_part_that_was_removed_is_told(tmp_path: Path) -> None:
    run = _record(tmp_path / "run", traffic(12), 50)
    disk = measure_disk(run.path)
    assert disk["frames"] == sum(path.stat().st_size for path in (run.path / "frames.parquet").iterdir())
    (run.path / "frames.parquet" / "part-0001.parquet").unlink()
    with pytest.raises(InputError, match=r"frames\.parquet/part-0001\.parquet: missing"):
        load(run.path)
    assert "frames.parquet/part-0001.parquet: missing" in "\n".join(verify_run(run).problems)


def test_parts_of_telemetry_that_overlap_are_merged(tmp_path: Path) -> None:
    """As several processes would record them, each the aircraft of its own."""
    run = _record(tmp_path / "run", traffic(12), 10**6)
    expected = run.telemetry("ATTITUDE")
    path = run.path / "telemetry" / "ATTITUDE.parquet"
    rows = pq.read_table(path)
    path.unlink()
    path.mkdir()
    is_first = pc.equal(rows.column("vehicle"), "blue/b2")
    for number, chosen in enumerate((is_first, pc.invert(is_first))):
        pq.write_table(rows.filter(chosen), path / f"part-{number:04d}.parquet")
    assert run.telemetry("ATTITUDE").equals(expected)
    assert count_messages(run.tables) == run.messages


def test_a_damaged_part_is_named(tmp_path: Path) -> None:
    run = _record(tmp_path / "run", traffic(12), 50)
    part = run.path / "frames.parquet" / "part-0001.parquet"
    part.write_bytes(part.read_bytes()[:200])
    with pytest.raises(InputError, match=r"frames\.parquet/part-0001\.parquet"):
        run.table("frames")


# ---------------------------------------------------------------- killed runs


def _killed(folder: Path, part_rows: int = 50) -> Recorder:
    """A recorder whose thread is idle and that is not closed."""
    recorder = Recorder.open(folder, HEADER, part_rows=part_rows)
    _observe(recorder, traffic(12))
    recorder.flush()
    assert recorder._writer is not None
    recorder._writer.wait()
    return recorder


def _check_killed(folder: Path, whole: RunRecord) -> None:
    run = load(folder)
    assert run.status == "killed or still running"
    for name in ("frames", "payloads", "truth", "sensors", "events"):
        assert run.table(name).equals(whole.table(name)), name
        assert run.rows(name) == whole.rows(name)
    assert run.messages == whole.messages
    for name in whole.messages:
        assert run.telemetry(name).equals(whole.telemetry(name))


@pytest.fixture
def whole(tmp_path: Path) -> RunRecord:
    """The run of `_killed`, whole."""
    return _record(tmp_path / "whole", traffic(12), 10**6)


def test_a_killed_run_is_read_from_closed_parts_and_the_spool(tmp_path: Path, whole: RunRecord) -> None:
    _killed(tmp_path / "run")
    spool = tmp_path / "run" / ".spool"
    assert len(list(spool.glob("frames-*.parquet"))) == 144 // 50
    assert len(list(spool.glob("frames-*.arrows"))) == 1  # of the open part
    _check_killed(tmp_path / "run", whole)


def test_killed_between_the_closing_of_a_part_and_the_deletion_of_its_stream(
    tmp_path: Path, whole: RunRecord, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Path, "unlink", lambda self, missing_ok=False: None)
    _killed(tmp_path / "run")
    monkeypatch.undo()
    assert len(list((tmp_path / "run" / ".spool").glob("frames-*.arrows"))) == 3
    _check_killed(tmp_path / "run", whole)


@pytest.mark.parametrize("length", [0, 4, 300])
def test_killed_while_a_part_is_written(length: int, tmp_path: Path, whole: RunRecord) -> None:
    _killed(tmp_path / "run")
    spool = tmp_path / "run" / ".spool"
    torn = sorted(spool.glob("frames-*.parquet"))[0].read_bytes()[:length]
    for name in ("frames.parquet.new", "observations.parquet.new"):
        (spool / name).write_bytes(torn)
    (spool / "telemetry.new").mkdir(exist_ok=True)
    (spool / "telemetry.new" / "ATTITUDE.parquet").write_bytes(torn)
    _check_killed(tmp_path / "run", whole)


def test_killed_while_tables_are_placed(tmp_path: Path, whole: RunRecord, monkeypatch: pytest.MonkeyPatch) -> None:
    recorder = _killed(tmp_path / "run")
    monkeypatch.setattr("skyrange.record.write.recorder.write_manifest", _interrupt)
    with pytest.raises(KeyboardInterrupt):
        recorder.close()
    assert (tmp_path / "run" / "frames.parquet").is_dir()
    _check_killed(tmp_path / "run", whole)


def _interrupt(*_: object) -> None:
    raise KeyboardInterrupt


def test_a_truncated_closed_part_is_named(tmp_path: Path) -> None:
    _killed(tmp_path / "run")
    part = sorted((tmp_path / "run" / ".spool").glob("frames-*.parquet"))[1]
    part.write_bytes(part.read_bytes()[:-9])
    with pytest.raises(InputError, match=rf"\.spool/{part.name}.*complete Parquet file"):
        load(tmp_path / "run").table("frames")


CHILD = """
import sys
from tests.unit.record_sample import HEADER, StillWorld, traffic
from skyrange.record import Recorder
recorder = Recorder.open(sys.argv[1], HEADER, part_rows=40)
world = StillWorld()
for count, frame in enumerate(traffic(100_000)):
    recorder.on_frame(frame)
    if count % 12 == 0:
        recorder.on_truth(frame.sent_ns, world)
        recorder.flush()
        print(count, flush=True)
"""


@pytest.mark.parametrize("lines", [3, 41, *(pytest.param(one, marks=pytest.mark.slow) for one in (40, 42))])
def test_sigkill_loses_nothing_that_was_flushed(lines: int, tmp_path: Path) -> None:
    child = subprocess.Popen([sys.executable, "-c", CHILD, str(tmp_path / "run")], stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    told = [int(child.stdout.readline()) for _ in range(lines)]
    os.kill(child.pid, signal.SIGKILL)
    child.wait()
    run = load(tmp_path / "run")
    recorded = list(run.frames_with_payloads())
    assert len(recorded) > told[-1]
    expected = [(str(frame.id), frame.payload) for frame, _ in zip(traffic(5000), recorded, strict=False)]
    assert [(frame.id, frame.payload) for frame in recorded] == expected
    assert run.rows("frames") == len(recorded)
    assert run.table("truth").num_rows == run.rows("truth") >= 3 * lines - 3
    assert sum(run.messages.values()) > 0


def test_a_reader_goes_on_while_parts_are_closed(tmp_path: Path, whole: RunRecord) -> None:
    recorder = Recorder.open(tmp_path / "run", HEADER, part_rows=50)
    frames = list(traffic(12))
    for frame in frames[:30]:
        recorder.on_frame(frame)
    recorder.flush()
    reading = load(tmp_path / "run").tables.batches("frames", ["serial"])
    listed = load(tmp_path / "run").tables.batches("frames", ["serial"])
    found = [next(reading).num_rows]  # its stream is open
    for frame in frames[30:70]:
        recorder.on_frame(frame)
    recorder.flush()
    assert recorder._writer is not None
    recorder._writer.wait()
    assert not (tmp_path / "run" / ".spool" / "frames-0000.arrows").exists()
    found += [batch.num_rows for batch in reading]
    assert sum(found) in (30, 50)
    assert sum(batch.num_rows for batch in listed) == 70
    recorder.close()


# ---------------------------------------------------------------- a full disk


def _full(*_: object, **__: object) -> Any:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize("what", ["write", "close_part"])
def test_a_disk_that_fills_up_under_the_thread(what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recorder = Recorder.open(tmp_path / "run", HEADER, part_rows=50)
    frames = list(traffic(40))
    done = 0
    told: list[str] = []
    for number, frame in enumerate(frames):
        if number == 200:
            monkeypatch.setattr(TableFiles, what, _full)
        try:
            recorder.on_frame(frame)
            recorder.flush()
            done += not told
        except ComponentError as error:
            told.append(str(error))
    assert len(told) == 1
    assert "No space left on device (ENOSPC)" in told[0]
    assert "can be loaded" in told[0]
    recorder.close()
    monkeypatch.undo()
    run = load(tmp_path / "run")
    assert run.status == "failed"
    recorded = list(run.frames_with_payloads())
    assert 200 <= done <= len(recorded)
    assert [frame.id for frame in recorded] == [str(frame.id) for frame in frames[: len(recorded)]]
    assert not list((tmp_path / "run" / ".spool").glob("*.new"))
    with pytest.raises(ComponentError, match="cannot be forked"):
        recorder.fork(tmp_path / "twin")


# ---------------------------------------------------------------- forks


@pytest.mark.parametrize("part_rows", [7, 50, 10**6])
def test_a_fork_has_the_parts_of_a_straight_run(part_rows: int, tmp_path: Path) -> None:
    frames = list(_delayed(3))
    straight = Recorder.open(tmp_path / "straight", HEADER, part_rows=part_rows)
    stem = Recorder.open(tmp_path / "stem", HEADER, part_rows=part_rows)
    for recorder in (straight, stem):
        tell(recorder, 1)
        _observe(recorder, iter(frames[:55]))
    twin = stem.fork(tmp_path / "twin")
    for recorder in (straight, stem, twin):
        _observe(recorder, iter(frames[55:]))
        recorder.flush()
    assert twin._writer is not None
    twin._writer.wait()
    killed = tmp_path / "killed"
    shutil.copytree(tmp_path / "twin", killed)
    for recorder in (straight, stem, twin):
        recorder.close()
    runs = [load(tmp_path / name) for name in ("straight", "stem", "twin")]
    for run in runs[1:]:
        _check_same(runs[0], run)
        assert run.manifest["files"] == runs[0].manifest["files"]
    assert load(killed).table("frames").equals(runs[0].table("frames"))


# ---------------------------------------------------------------- the thread


def test_work_is_done_in_order_and_waits_when_too_much_is_pending() -> None:
    background, gate, done = Background(), threading.Event(), list[int]()
    background.submit(gate.wait)
    for number in range(1, PENDING):
        background.submit(lambda number=number: done.append(number))  # type: ignore[misc]
    further = threading.Thread(target=lambda: background.submit(lambda: done.append(PENDING)))
    further.start()
    further.join(0.05)
    assert further.is_alive()
    assert not done
    gate.set()
    further.join()
    background.wait()
    assert done == list(range(1, PENDING + 1))
    background.stop()


def test_after_an_error_nothing_more_is_done() -> None:
    background, done = Background(), []

    def fail() -> None:
        raise OSError("broken")

    background.submit(fail)
    with pytest.raises(OSError, match="broken"):
        background.wait()
    with pytest.raises(OSError, match="broken"):
        background.submit(lambda: done.append(1))
    background.stop()
    assert not done


def test_the_manifest_of_a_run_in_parts_has_its_rows(tmp_path: Path) -> None:
    run = _record(tmp_path / "run", traffic(12), 50)
    manifest = json.loads((run.path / "manifest.json").read_text())
    assert manifest["counts"]["frames"] == 144
    assert {frame.fate for frame in run.frames_with_payloads()} == {str(Fate.DELIVERED), str(Fate.LOST)}
