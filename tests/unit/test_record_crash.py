"""A record that was torn, killed, or refused by the disk: what had been handed over is there, and errors say so."""

from __future__ import annotations

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from skyrange.core.errors import ComponentError, InputError
from skyrange.record import Recorder, load
from skyrange.record import spool as spool_module
from skyrange.record.spool import read_stream
from skyrange.record.write import recorder as recorder_module
from tests.unit.record_sample import HEADER, LABELS, NOTES, StillWorld, tell, traffic

pytestmark = pytest.mark.rotating


def _spooled(folder: Path, rounds: int, flush_every: int = 7) -> Recorder:
    """A recorder that flushed every few frames and was never closed."""
    recorder = Recorder.open(folder, HEADER)
    for count, frame in enumerate(traffic(rounds)):
        recorder.on_frame(frame)
        if count % flush_every == 0:
            recorder.flush()
    recorder.flush()
    return recorder


@pytest.mark.parametrize("table", ["frames", "payloads"])
def test_a_stream_cut_anywhere_loads_a_prefix(tmp_path: Path, table: str) -> None:
    _spooled(tmp_path / "run", 6)
    path = tmp_path / "run" / ".spool" / f"{table}-0000.arrows"
    whole = path.read_bytes()
    expected = [str(frame.id) for frame in traffic(6)]
    payloads = {str(frame.id): frame.payload for frame in traffic(6)}
    lengths = []
    for cut in [*range(0, len(whole), 97), len(whole)]:
        path.write_bytes(whole[:cut])
        run = load(tmp_path / "run")
        recorded = list(run.frames_with_payloads())
        assert [frame.id for frame in recorded] == expected[: len(recorded)]
        assert all(frame.payload == payloads[frame.id] for frame in recorded)
        assert sum(run.messages.values()) <= len(recorded)
        lengths.append(len(recorded))
    assert lengths == sorted(lengths)
    assert lengths[0] == 0
    assert lengths[-1] == len(expected)
    assert len(set(lengths)) > 5  # it grows batch by batch


def test_damage_inside_a_stream_never_raises(tmp_path: Path) -> None:
    _spooled(tmp_path / "run", 6)
    path = tmp_path / "run" / ".spool" / "frames-0000.arrows"
    whole = path.read_bytes()
    for place in range(0, len(whole), 211):
        damaged = bytearray(whole)
        damaged[place : place + 8] = bytes(8)
        path.write_bytes(damaged)
        assert sum(batch.num_rows for batch in read_stream(path)) <= len(list(traffic(6)))


CHILD = """
import sys, time
from tests.unit.record_sample import HEADER, StillWorld, traffic
from skyrange.record import Recorder
recorder = Recorder.open(sys.argv[1], HEADER, flush_s=float(sys.argv[2]))
world = StillWorld()
for count, frame in enumerate(traffic(100_000)):
    recorder.on_frame(frame)
    if count % 12 == 0:
        recorder.on_truth(frame.sent_ns, world)
        time.sleep(0.01)
        print(count, flush=True)
"""


def test_sigkill_keeps_all_but_the_last_flush(tmp_path: Path) -> None:
    flush_s = 0.2
    child = subprocess.Popen(
        [sys.executable, "-c", CHILD, str(tmp_path / "run"), str(flush_s)], stdout=subprocess.PIPE, text=True
    )
    assert child.stdout is not None
    told = [int(child.stdout.readline()) for _ in range(60)]
    os.kill(child.pid, signal.SIGKILL)
    child.wait()
    run = load(tmp_path / "run")
    assert run.status == "killed or still running"
    recorded = list(run.frames_with_payloads())
    # 12 frames take at least 10 ms, so the unflushed tail is at most 0.2 s / 10 ms * 12 = 240 of over 700 frames
    assert len(recorded) >= told[-1] - 252
    expected = [(str(frame.id), frame.payload) for frame, _ in zip(traffic(500), recorded, strict=False)]
    assert [(frame.id, frame.payload) for frame in recorded] == expected
    assert run.table("truth").num_rows % 3 == 0
    assert run.telemetry("ATTITUDE").num_rows == run.messages["ATTITUDE"] > 0
    assert run.duration > 0


LIMITED = """
import json, resource, signal, sys
from tests.unit.record_sample import HEADER, tell, traffic
from skyrange.core.errors import ComponentError
from skyrange.record import Recorder
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
recorder = Recorder.open(sys.argv[1], HEADER)
told = []
resource.setrlimit(resource.RLIMIT_FSIZE, (150_000, 150_000))
try:
    for frame in traffic(100_000):
        recorder.on_frame(frame)
except ComponentError as error:
    told.append(str(error))
for frame in traffic(5):
    recorder.on_frame(frame)  # dropped, and silently
tell(recorder)
recorder.close("complete", {"simulated_s": 5.0})
print(json.dumps(told))
"""


def test_a_write_that_falls_short_is_told_once_and_leaves_what_was_there(tmp_path: Path) -> None:
    """A file size limit makes the system write a part and then refuse, as a full disk does."""
    folder = tmp_path / "run"
    done = subprocess.run(
        [sys.executable, "-c", LIMITED, str(folder)], capture_output=True, text=True, check=True, timeout=120
    )
    (told,) = json.loads(done.stdout)
    assert told.startswith(f"recorder: cannot write {folder}/.spool/")
    assert "(EFBIG)" in told
    assert "can be loaded" in told
    run = load(folder)
    assert run.status == "failed"
    recorded = list(run.frames_with_payloads())
    assert len(recorded) >= 4096
    assert [frame.id for frame in recorded] == [str(f.id) for f, _ in zip(traffic(3000), recorded, strict=False)]


def _full(*_: object, **__: object) -> Any:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_disk_that_fills_up_while_it_flies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recorder = _spooled(tmp_path / "run", 3)
    monkeypatch.setattr(spool_module._Stream, "append", _full)
    recorder.on_frame(next(iter(traffic(1))))
    with pytest.raises(ComponentError, match=r"frames-0000\.arrows: No space left on device \(ENOSPC\)"):
        recorder.flush()
    assert len(list(load(tmp_path / "run").frames_with_payloads())) == 36
    recorder.close()
    run = load(tmp_path / "run")
    assert run.status == "failed"
    assert run.rows("frames") == 36
    with pytest.raises(ComponentError, match="cannot be forked"):
        recorder.fork(tmp_path / "twin")


def test_a_disk_that_fills_up_at_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recorder = _spooled(tmp_path / "run", 3)
    monkeypatch.setattr("skyrange.record.write.files.table_files.pq.ParquetWriter", _full)
    with pytest.raises(ComponentError, match="ENOSPC"):
        recorder.close()
    run = load(tmp_path / "run")
    assert run.status == "failed"
    assert len(list(run.frames_with_payloads())) == 36
    assert not list((tmp_path / "run").glob("*.parquet"))
    assert not (tmp_path / "run" / ".final").exists()


def test_a_disk_that_is_full_before_the_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder_module, "write_manifest", _full)
    with pytest.raises(InputError, match="No space left on device"):
        Recorder.open(tmp_path / "runs" / "a", HEADER)
    assert list(tmp_path.iterdir()) == []


def test_attachments_are_kept_inside_and_nothing_is_left_after_a_bad_one(tmp_path: Path) -> None:
    taken = ("manifest.json", "frames.parquet", ".spool/x", "operators/b.csv", "telemetry/ATTITUDE.parquet")
    for name in ("../x", "/etc/x", "a/../../x", "", *taken):
        recorder = Recorder.open(tmp_path / "run", HEADER)
        recorder.attach_file("scenario.toml", b"")
        with pytest.raises(InputError):
            recorder.attach_file(name, b"x")
        assert list(tmp_path.iterdir()) == []
    recorder = Recorder.open(tmp_path / "run", HEADER)
    tell(recorder)
    recorder.flush()
    with pytest.raises(ValueError, match="before the first rows"):
        recorder.attach_file("late.toml", b"")


@pytest.mark.skipif(os.geteuid() == 0 and not Path("/proc/1").exists(), reason="needs /proc")
def test_folders_that_cannot_be_used(tmp_path: Path) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "x").write_text("")
    with pytest.raises(InputError, match="new or empty folder"):
        Recorder.open(tmp_path / "full", HEADER)
    assert (tmp_path / "full" / "x").exists()
    with pytest.raises(InputError):
        Recorder.open(tmp_path / "full" / "x", HEADER)
    with pytest.raises(InputError):
        Recorder.open("/proc/nowhere/run", HEADER)
    (tmp_path / "empty").mkdir()
    Recorder.open(tmp_path / "empty", HEADER).close()


def test_a_header_that_is_no_json_and_rates_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="JSON"):
        Recorder.open(tmp_path / "run", {"seed": object()})
    with pytest.raises(InputError, match="JSON"):
        Recorder.open(tmp_path / "run", {"seed": float("nan")})
    with pytest.raises(InputError, match="start_utc: 'noon'"):
        Recorder.open(tmp_path / "run", {"start_utc": "noon"})
    with pytest.raises(InputError) as caught:
        Recorder.open(tmp_path / "run", {}, truth_hz=-1, sensors_hz=float("nan"))
    assert len(caught.value.problems) == 2
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_run_says_so(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not exist"):
        load(tmp_path / "nowhere")
    with pytest.raises(InputError, match=r"manifest\.json: missing"):
        load(tmp_path)
    Recorder.open(tmp_path / "run", HEADER).close()
    path = tmp_path / "run" / "manifest.json"
    good = path.read_text()
    for text, message in (
        (good[: len(good) // 2], "damaged"),
        ("[]", "JSON object"),
        ("{}", "skyrange.run/1"),
        (good.replace("skyrange.run/1", "skyrange.run/2"), "another version of skyrange: fly it again"),
        (good.replace('"complete"', '"resting"'), "'resting'"),
        (good.replace('"complete"', '"running"'), "streams of a run that did not end"),
    ):
        path.write_text(text)
        with pytest.raises(InputError, match=message):
            load(tmp_path / "run")
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="UTF-8"):
        load(tmp_path / "run")
    path.write_text(good)
    (tmp_path / "run" / "frames.parquet").write_bytes(b"PAR1 no more")
    with pytest.raises(InputError, match=r"frames\.parquet"):
        load(tmp_path / "run").table("frames")


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"vehicles": "x"}, "manifest.json: vehicles: 'x'"),
        ({"vehicles": [{"id": "a/b"}]}, "vehicles.0"),
        ({"operators": ["blue"]}, "operators.0"),
        ({"name": 3}, "name: 3"),
        ({"seed": True}, "seed: True"),
        ({"origin": "here"}, "origin"),
        ({"simulated_s": "long"}, "simulated_s"),
        ({"timings": [1]}, "timings"),
        ({"outcomes": 3}, "outcomes"),
        ({"record": None}, "record.level: None — expected one of full, study, summary"),
        ({"record": {"level": "most", "features_hz": 1.0}}, "record.level: 'most'"),
        ({"record": {"level": "full", "features_hz": 0}}, "record.features_hz: 0"),
    ],
)
def test_a_manifest_changed_by_hand_is_blamed(changed: dict[str, Any], message: str, tmp_path: Path) -> None:
    Recorder.open(tmp_path / "run", HEADER).close()
    path = tmp_path / "run" / "manifest.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changed))
    with pytest.raises(InputError, match=message):
        load(tmp_path / "run")


def test_a_fork_into_the_run_itself_is_refused(tmp_path: Path) -> None:
    recorder = Recorder.open(tmp_path / "run", HEADER)
    for inside in (tmp_path / "run", tmp_path / "run" / "branch"):
        with pytest.raises(InputError, match="a folder outside the run"):
            recorder.fork(inside)
    recorder.close()
    load(tmp_path / "run")


def test_rates_of_truth_and_sensors(tmp_path: Path) -> None:
    recorder = Recorder.open(tmp_path / "run", HEADER, truth_hz=4, sensors_hz=0)
    world: Any = StillWorld()
    assert recorder.truth_period_ns == 250_000_000
    for tick in range(101):  # called at 100 Hz, as another observer may ask
        recorder.on_truth(tick * 10_000_000, world)
    recorder.close()
    run = load(tmp_path / "run")
    assert sorted(set(run.table("truth").column("time_ns").to_pylist())) == [k * 250_000_000 for k in range(5)]
    assert run.rows("sensors") == 0


def test_a_fork_continues_identically(tmp_path: Path) -> None:
    frames = list(traffic(20))
    straight = Recorder.open(tmp_path / "straight", HEADER, csv=True)
    stem = Recorder.open(tmp_path / "stem", HEADER, csv=True)
    half = len(frames) // 2 + 1
    for frame in frames:
        straight.on_frame(frame)
    for frame in frames[:half]:
        stem.on_frame(frame)
    for now, source, note in NOTES:
        straight.on_note(now, source, note)
        stem.on_note(now, source, note)
    twin = stem.fork(tmp_path / "twin")
    for recorder in (stem, twin):
        for frame in frames[half:]:
            recorder.on_frame(frame)
    for recorder in (straight, stem, twin):
        recorder.on_label(LABELS[0])
        recorder.on_truth(0, StillWorld())
        recorder.flush()
    killed = load(tmp_path / "twin").table("frames")
    for recorder in (straight, stem, twin):
        recorder.close()
    a, b, c = (load(tmp_path / name) for name in ("straight", "stem", "twin"))
    assert a.manifest["digests"] == b.manifest["digests"] == c.manifest["digests"]
    for name in ("frames", "payloads", "truth", "sensors", "events", "decisions", "labels"):
        assert a.table(name).equals(b.table(name))
        assert a.table(name).equals(c.table(name))
    assert a.messages == b.messages == c.messages
    for message in a.messages:
        assert a.telemetry(message).equals(b.telemetry(message))
        assert a.telemetry(message).equals(c.telemetry(message))
    assert killed.equals(a.table("frames"))
    for name in ("blue.csv", "blue.tlog"):
        assert (a.path / "operators" / name).read_bytes() == (c.path / "operators" / name).read_bytes()
    with pytest.raises(InputError, match="new or empty"):
        Recorder.open(tmp_path / "x", HEADER).fork(tmp_path / "stem")


def test_leftovers_of_a_killed_finalisation_do_no_harm(tmp_path: Path) -> None:
    _spooled(tmp_path / "run", 3).close()
    _spooled(tmp_path / "torn", 3)
    (tmp_path / "torn" / ".final").mkdir()
    shutil.copy(tmp_path / "run" / "frames.parquet", tmp_path / "torn" / ".final" / "frames.parquet")
    (tmp_path / "torn" / "events.parquet").write_bytes(b"half")
    torn = load(tmp_path / "torn")
    assert torn.status == "killed or still running"
    assert torn.table("frames").equals(load(tmp_path / "run").table("frames"))
    assert torn.table("events").num_rows == 0


def test_two_that_want_one_folder_do_not_share_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = Recorder.open(tmp_path / "run", HEADER)
    monkeypatch.setattr(Path, "iterdir", lambda self: iter(()))  # both looked before either began
    with pytest.raises(InputError, match=r"holds \.spool"):
        Recorder.open(tmp_path / "run", HEADER)
    monkeypatch.undo()
    first.close()
    assert load(tmp_path / "run").status == "complete"


def test_a_rate_too_low_for_any_run_records_the_first_tick(tmp_path: Path) -> None:
    recorder = Recorder.open(tmp_path / "run", HEADER, truth_hz=1e-300, sensors_hz=0.0)
    for now in (0, 1_000_000_000, 3_600_000_000_000):
        recorder.on_truth(now, StillWorld())
    recorder.close()
    assert set(load(tmp_path / "run").table("truth").column("time_ns").to_pylist()) == {0}
