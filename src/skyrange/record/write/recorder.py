"""Recorder of a run: an observer that streams to the run's folder with bounded memory.

Observations are collected in lists and written in whole batches to the spool, every second of wall time or every 4 MB.
A thread writes the same rows to Parquet. The wall clock decides only when rows are written, never what they contain.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from pathlib import Path
from time import monotonic
from typing import Any, Protocol, Self

import pyarrow as pa

from skyrange.contracts.alerts import Alert
from skyrange.contracts.components import ReceivedSensors, World
from skyrange.contracts.frames import Frame, FrameBlock
from skyrange.contracts.mailboxes import Note
from skyrange.contracts.verdicts import Label
from skyrange.core.errors import ComponentError, InputError
from skyrange.core.files import expand_user
from skyrange.core.time import Time, to_seconds
from skyrange.record.digests import Digests
from skyrange.record.folder import describe_bytes, make_folder, put_file, remove_folder, unwritable_error
from skyrange.record.manifest import ENDINGS, MANIFEST, RUNNING, describe_platform, epoch_of, write_manifest
from skyrange.record.notes import outcomes, vehicle_ids
from skyrange.record.schema import FORMAT, FULL, LEVELS, SUMMARY
from skyrange.record.spool import SPOOL, Spool, shard_folder, write_error
from skyrange.record.write.batch_rows import BatchRows
from skyrange.record.write.files.finalisation import Shard, finalise, finish_shard
from skyrange.record.write.files.part_writer import PART_ROWS, PartWriter, ignore_unfinished
from skyrange.record.write.recording_state import RecordingState, check_rates, common_period_ns
from skyrange.record.write.rows.frame_encoder import FrameEncoder
from skyrange.record.write.rows.scans import ScanSource
from skyrange.record.write.waiting_rows import ForeignSource, ReceptionSource, WaitingRows

WINDOW_BYTES = 4 << 20
"""Bytes of payloads that are de-duplicated together, and of rows that are written at once."""
_READING_PAUSE = 5.0
"""Between two writes for a reader passes so much of the time that the first took."""
_BATCH_ROWS = 4_096  # frames encoded together: enough to vectorise, few enough to keep the garbage collector idle
_BATCH_BYTES = 16 << 20  # of payloads: fewer frames are encoded together if they are large, as scans are
_BLOCK_ROWS = 16_384  # the same for blocks, which are few objects: two or three megabytes


class RowReader(Protocol):
    """A reader of rows as they are recorded, which alters nothing and raises nothing."""

    def add(self, table: str, batch: pa.RecordBatch) -> None:
        """Take rows of a table, in the form of the spool, in the order recorded; those of payloads come before frames
        that refer to them, and those of frames before receptions that name them.
        """
        ...

    def complete(self) -> None:
        """Take note that all rows up to now have been handed over."""
        ...


class Recorder:
    """An `contracts.components.Observer` that writes the run's folder.

    After a failed write (`ComponentError`) further observations are dropped, and `close` leaves the record in its
    spool, from which `load` reads it.
    """

    def __init__(
        self,
        path: Path,
        manifest: dict[str, Any],
        state: RecordingState,
        spool: Spool,
        *,
        spool_bytes: int,
        flush_s: float,
        writer: PartWriter | None,
        made: Sequence[Path] = (),
        shard: int = 0,
    ) -> None:
        """Use `Recorder.open` or `Recorder.join`."""
        self.path = path
        self.truth_period_ns: Time = common_period_ns(state.truth_ns, state.sensors_ns)
        self._manifest = manifest
        self._state = state
        self._spool = spool
        self._spool_bytes = spool_bytes
        self._flush_s = flush_s
        self._writer = writer
        self._due_s = monotonic() + flush_s
        self._made = made
        self._write_failed = False
        self._closed = False
        self._rows = WaitingRows(state, self._append)
        self._received: ReceivedSensors | None = None
        """Of the tick that ends now."""
        self.block_rows = _BLOCK_ROWS
        """So many frames of blocks are written as soon as they are there, without `flush`."""
        self._reception_source: ReceptionSource | None = None
        self._scan_source: ScanSource | None = None
        self._batch: BatchRows | None = None
        """The rows of all runs of the batch that this is a run of."""
        self._shard = shard
        self._shards: list[Shard] = []
        self._reader: RowReader | None = None

    @classmethod
    def open(
        cls,
        path: Path | str,
        header: Mapping[str, Any],
        *,
        truth_hz: float = 10.0,
        sensors_hz: float = 2.0,
        level: str = FULL,
        features_hz: float = 1.0,
        csv: bool = False,
        spool_bytes: int = WINDOW_BYTES,
        flush_s: float = 1.0,
        part_rows: int = PART_ROWS,
        encoder: FrameEncoder | None = None,
    ) -> Self:
        """Begin a record in `path`, a folder that does not exist or is empty; its manifest says `running` from now on.

        `header` holds the manifest's entries about the scenario (name, seed, start_utc, origin, operators, vehicles,
        links, …). Truth and sensors are recorded at `truth_hz` and `sensors_hz` of simulated time; 0 records none.
        `level` says which tables are kept (`record.schema`); at `study` frames are counted in intervals of
        1 / `features_hz` seconds.
        With `csv` it ends with CSV files and tlogs of what ground stations received and sent, if it keeps frames.
        Rows are written every `flush_s` of wall time or every `spool_bytes`, which is also how many bytes of payloads
        are de-duplicated together. A table of more than `part_rows` rows has several files; with 0 all rows stay in the
        spool until `close`. `encoder` is one that the runs of a batch share. Raises `InputError`, and leaves nothing
        behind, if the folder cannot be created, is not empty or cannot be written.
        """
        folder = expand_user(path)
        check_rates(truth_hz, sensors_hz, features_hz)
        if level not in LEVELS:
            raise InputError.one("recorder", "record.level", repr(level), f"one of {', '.join(LEVELS)}")
        try:
            epoch_of(header)
        except ValueError as error:
            raise InputError.one("header", "start_utc", repr(header["start_utc"]), "ISO 8601") from error
        rates = {"level": level, "truth_hz": truth_hz, "sensors_hz": sensors_hz, "features_hz": features_hz}
        rates["csv"] = csv and level == FULL
        manifest = {"format": FORMAT, "status": RUNNING, **describe_platform(), **header, "record": rates}
        manifest |= {"format": FORMAT, "status": RUNNING}
        if level == SUMMARY:  # the channel of each link, which follows from the scenario, would be most of the folder
            manifest.pop("links", None)
        made = make_folder(folder)
        try:
            write_manifest(folder, manifest)
        except OSError as error:
            remove_folder(folder, made)
            raise unwritable_error(folder, error) from error
        except (TypeError, ValueError) as error:
            remove_folder(folder, made)
            raise InputError.one("header", "manifest", str(error), "values that JSON can hold") from error
        state = RecordingState.start(
            header,
            level,
            truth_hz=truth_hz,
            sensors_hz=sensors_hz,
            features_hz=features_hz,
            window_bytes=spool_bytes,
            encoder=encoder,
        )
        spool = Spool(folder)
        writer = PartWriter(folder, manifest, spool, part_rows) if part_rows else None
        return cls(folder, manifest, state, spool, spool_bytes=spool_bytes, flush_s=flush_s, writer=writer, made=made)

    @classmethod
    def join(
        cls,
        path: Path,
        header: Mapping[str, Any],
        shard: int,
        *,
        truth_hz: float = 10.0,
        sensors_hz: float = 2.0,
        level: str = FULL,
        features_hz: float = 1.0,
        spool_bytes: int = WINDOW_BYTES,
        flush_s: float = 1.0,
    ) -> Self:
        """Record a shard of a run in the folder that another process has opened, which has shard 0; `shard` is unique.

        End it with `leave`; the recorder of shard 0 takes over what that returns with `take_over`.
        """
        root = shard_folder(path, shard)
        try:
            (root / SPOOL).mkdir(parents=True)
        except OSError as error:
            raise write_error(root, error) from error
        state = RecordingState.start(
            header,
            level,
            truth_hz=truth_hz,
            sensors_hz=sensors_hz,
            features_hz=features_hz,
            window_bytes=spool_bytes,
            shard=shard,
        )
        spool = Spool(root)
        manifest = {**header, "record": {"level": level}}
        writer = PartWriter(root, manifest, spool)
        return cls(path, manifest, state, spool, spool_bytes=spool_bytes, flush_s=flush_s, writer=writer, shard=shard)

    def leave(self) -> dict[str, Any]:
        """End a shard: write all its files; returns what `take_over` of shard 0 needs, as plain data."""
        assert self._writer is not None
        self.flush(last=True)
        self._spool.end_segment()
        self._closed = True
        return {"written": finish_shard(self._writer, self._shard)._asdict(), **self._state.to_plain()}

    def take_over(self, shard: Mapping[str, Any]) -> None:
        """Add a shard of the run, of which `leave` has returned this."""
        self._state.add(shard)
        self._shards.append(Shard(**shard["written"]))

    def record_receptions(self, source: ReceptionSource | None) -> None:
        """Record the receptions of `source`, fetched at each flush from now on."""
        self._reception_source = source

    def record_scans(self, source: ScanSource | None) -> None:
        """Record the scans of `source`, fetched at each flush from now on."""
        self._scan_source = source
        if source is not None:
            source.start_recording()

    def hand_rows_to(self, reader: RowReader, every_s: float) -> None:
        """Hand all rows that are recorded from now on to `reader`, which is told every `every_s` of wall time that it
        has all; less often if writing and reading them would take more than a sixth of the time.
        """
        self._reader = reader
        self._flush_s = every_s
        self._due_s = monotonic() + every_s

    def join_batch(self, batch: BatchRows) -> WaitingRows:
        """Have rows written with those of other runs, which `batch` has; returns those that wait here."""
        self._batch = batch
        return self._rows

    def attach_files(self, files: Mapping[str, bytes]) -> None:
        """Put files into the folder before the run starts, as `attach_file` does."""
        for name, data in files.items():
            self.attach_file(name, data)

    def attach_file(self, name: str, data: bytes) -> None:
        """Put a file into the folder before the run starts: `scenario.toml`, `missions/survey.plan`, `city.json`.

        `name` is a relative path of plain names. Raises `InputError` for a path that leaves the folder or that the
        record uses itself, and if writing fails; the record is then abandoned and nothing is left behind, but for what
        other shards have written.
        """
        if self._state.counts:
            raise ValueError(f"{name}: files must be attached before the first rows are written")
        try:
            put_file(self.path, name, data)
            self._state.files[name] = describe_bytes(data)
        except InputError:
            self._write_failed = self._closed = True
            if not self._shard:
                remove_folder(self.path, self._made)
            raise

    def keep_file(self, name: str, path: Path) -> None:
        """Copy a program's output file into the folder under `name`; `ComponentError` if writing fails."""
        target = self.path / name
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, target)
        except OSError as error:
            raise write_error(target, error) from error

    def replace_file(self, name: str, data: bytes) -> None:
        """Put another content into an attached file; `ComponentError` if writing fails."""
        try:
            put_file(self.path, name, data)
        except InputError as error:
            raise ComponentError("recorder", str(error)) from error
        self._state.files[name] = describe_bytes(data)

    # ---------------------------------------------------------------- observations

    def on_frame(self, frame: Frame) -> None:
        """A frame was delivered, lost or otherwise finished."""
        self._rows.add_frame(frame)
        if monotonic() >= self._due_s:
            self.flush()
        elif self._rows.single_frames >= _BATCH_ROWS or self._rows.frame_bytes >= _BATCH_BYTES:
            self.write_frames()

    def on_block(self, block: FrameBlock) -> None:
        """A block of frames was finished."""
        self._rows.add_block(block)
        if monotonic() >= self._due_s:
            self.flush()
        elif self._rows.block_frames >= self.block_rows or self._rows.frame_bytes >= _BATCH_BYTES:
            self.write_frames()

    def on_note(self, now: Time, source: str, note: Note) -> None:
        """A decision or an event was noted."""
        self._rows.add_note(now, source, note)
        if monotonic() >= self._due_s:
            self.flush()

    def on_label(self, label: Label) -> None:
        """A hostile act was labelled."""
        if self._rows.add_label(label) >= _BATCH_ROWS or monotonic() >= self._due_s:
            self.flush()

    def on_alert(self, now: Time, detector: str, alert: Alert) -> None:
        """A monitor raised an alert."""
        if self._rows.add_alert(now, detector, alert) >= _BATCH_ROWS or monotonic() >= self._due_s:
            self.flush()

    def on_received(self, received: ReceivedSensors) -> None:
        """Autopilots received such readings in the tick that ends now."""
        self._received = received

    def on_truth(self, now: Time, world: World) -> None:
        """A tick ended; truth is recorded at the first tick at or after each multiple of its period, as are sensors."""
        received, self._received = self._received, None
        if self._rows.add_tick(now, world, received) >= self._spool_bytes or monotonic() >= self._due_s:
            self.flush()

    def on_rows(self, table: str, batch: pa.RecordBatch) -> None:
        """Append rows of truth, sensors or receptions that another recorder wrote."""
        if self._write_failed or not batch.num_rows:
            return
        if table == "receptions" and self._writer is not None:
            self._writer.observe_at_end()
        self._rows.write_rows(table, batch)

    # ---------------------------------------------------------------- writing

    @property
    def waiting_rows(self) -> int:
        """Frames of blocks that are not written yet."""
        return self._rows.block_frames

    def flush(self, *, last: bool = False) -> None:
        """Write all rows now, and with `last` those that wait for others to come; `ComponentError` if writing fails."""
        began = monotonic()
        self._due_s = began + self._flush_s
        if not self._write_failed:
            self._write_frames()
            if self._batch is None:
                self._rows.write_ticks()
            else:
                self._batch.write_ticks()
            self._write_receptions()
            self._write_scans()
            self._rows.write_notes()
            self._rows.write_study_rows(last=last)
        self._rows.clear()
        if self._reader is not None:
            self._reader.complete()
            now = monotonic()
            self._due_s = now + max(self._flush_s, (now - began) * _READING_PAUSE)

    def write_frames(self) -> None:
        """Write the frames that wait, the receptions of frames, and scans; `ComponentError` if writing fails."""
        if self._write_failed:
            self._rows.clear()
            return
        self._write_frames()
        self._write_receptions()
        self._write_scans()

    def _write_frames(self) -> None:
        if self._batch is None or self._batch.encoder is None:
            self._rows.write_frames()
        else:
            self._batch.write_frames()

    def _write_receptions(self) -> None:
        """Write receptions soon after the frames that they name."""
        source = self._reception_source
        if source is None:
            return
        if self._writer is not None and isinstance(source, ForeignSource):
            foreign = source.drain_foreign()
            if foreign is not None:
                (self._state.study_rows or self._writer).add_foreign(foreign)
        receptions = source.drain_receptions()
        if receptions is not None:
            self._rows.write_receptions(receptions)

    def _write_scans(self) -> None:
        if self._scan_source is not None:
            self._rows.write_scans(self._scan_source.drain_truths())

    def _append(self, table: str, batch: pa.RecordBatch) -> None:
        try:
            (self._writer or self._spool).append(table, batch)
        except ComponentError:
            self._write_failed = True
            raise
        self._state.count(table, batch.num_rows)
        if self._reader is not None:
            self._reader.add(table, batch)

    @property
    def digests(self) -> Digests:
        """An independent copy of the digests of everything observed so far."""
        self.flush()
        return deepcopy(self._state.digests)

    def fork(self, path: Path | str) -> Recorder:
        """A second recorder in a copy of the folder, which continues identically; both continue in new segments.

        Raises `InputError` if `path` cannot be created or is not empty.
        """
        if self._write_failed:
            raise ComponentError("recorder", f"{self.path} cannot be forked: an earlier write failed")
        folder = expand_user(path)
        if self.path.resolve() in (folder.resolve(), *folder.resolve().parents):
            raise InputError.one("fork", "folder", str(folder), "a folder outside the run that is forked")
        self.flush()
        self._spool.end_segment()
        if self._writer is not None:
            self._writer.wait()
        made = make_folder(folder)
        try:
            shutil.copytree(self.path, folder, dirs_exist_ok=True, ignore=ignore_unfinished)
        except (OSError, shutil.Error) as error:
            remove_folder(folder, made)
            raise unwritable_error(folder, error) from error
        state, manifest = deepcopy(self._state), deepcopy(self._manifest)
        spool = Spool(folder, self._spool.segment)
        writer = self._writer.fork(folder, manifest, spool) if self._writer is not None else None
        return Recorder(
            folder, manifest, state, spool, spool_bytes=self._spool_bytes, flush_s=self._flush_s, writer=writer
        )

    def __deepcopy__(self, memo: object) -> Recorder:
        raise TypeError("a Recorder owns a folder: use fork(path)")

    # ---------------------------------------------------------------- the end

    def close(
        self,
        status: str = "complete",
        extra: Mapping[str, Any] | Callable[[float], Mapping[str, Any]] | None = None,
        *,
        in_spool: bool = False,
    ) -> None:
        """End the record: write what is left of all files, then the manifest, then delete the spool.

        With `in_spool` the rows stay in the spool, as for a part that will be merged. `status` is complete,
        interrupted or failed. `extra` holds manifest entries (simulated_s, timings, …) that override the recorder's
        own, or returns them when it is called with the seconds that writing took. Memory stays bounded. Raises
        `ComponentError` if writing fails; everything recorded is then still in the spool. After an earlier failed
        write, only the status in the manifest is set, if that can be written. Closing a second time does nothing.
        """
        if status not in ENDINGS:
            raise ValueError(f"status {status!r}, expected one of {', '.join(ENDINGS)}")
        if self._closed:
            return
        self._closed = True
        began = monotonic()

        def more() -> Mapping[str, Any]:
            return extra(monotonic() - began) if callable(extra) else extra or {}

        if self._write_failed:
            self._note_spooled(more())
            return
        try:
            self.flush(last=True)
            self._spool.end_segment()
            if in_spool:
                self._abandon_writer()
                self._manifest |= {"counts": dict(self._state.counts), "spooled": True}
            else:
                if self._writer is None:
                    self._writer = PartWriter(self.path, self._manifest, self._spool)
                    self._writer.read_spool()
                shards = [finish_shard(self._writer, self._shard), *self._shards]
                finished = finalise(self.path, self._manifest, shards, self._state.files)._asdict()
                self._manifest |= {key: value for key, value in finished.items() if value is not None}
            self._manifest |= self._final_entries(status, more())
            write_manifest(self.path, self._manifest)
        except OSError as error:
            raise write_error(self.path / MANIFEST, error) from error
        except ComponentError:
            self._note_spooled(more())
            raise
        if not in_spool:
            shutil.rmtree(self.path / SPOOL, ignore_errors=True)

    def abandon(self) -> None:
        """End the record and remove its folder, if this recorder has made it, or else all that is in it."""
        self._closed = self._write_failed = True
        self._rows.clear()
        self._abandon_writer()
        self._spool.end_segment()
        remove_folder(self.path, self._made)

    def _note_spooled(self, extra: Mapping[str, Any]) -> None:
        """Note in the manifest, if it can be written, that the run failed and its rows are in the spool."""
        self._abandon_writer()
        self._manifest |= self._final_entries("failed", extra) | {"spooled": True}
        with suppress(OSError):
            write_manifest(self.path, self._manifest)

    def _abandon_writer(self) -> None:
        if self._writer is not None:
            self._writer.abandon()

    def _final_entries(self, status: str, extra: Mapping[str, Any]) -> dict[str, Any]:
        state = self._state
        return {
            "simulated_s": to_seconds(state.last_ns),
            "digests": state.digests.to_dict(),
            "outcomes": outcomes(vehicle_ids(self._manifest), state.outcomes, state.crashes),
            **({"not_kept": dict(state.not_kept)} if state.level != FULL else {}),
            **extra,
            "status": status,
        }
