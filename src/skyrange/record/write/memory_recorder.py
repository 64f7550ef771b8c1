"""Recorder of a run whose record stays in memory: for runs that are measured and then forgotten."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import pyarrow as pa

from skyrange.core.errors import InputError
from skyrange.core.files import parse_json
from skyrange.record.manifest import RUNNING, describe_platform
from skyrange.record.read.features import merge_features
from skyrange.record.read.run import RunRecord
from skyrange.record.read.tables import Tables, decode_spooled, encoded_schema
from skyrange.record.schema import FORMAT, FULL, RECORDED, SUMMARY, TABLES, arrow_schema, truth_columns
from skyrange.record.spool import Spool
from skyrange.record.write.files.part_writer import is_expected
from skyrange.record.write.recorder import WINDOW_BYTES, Recorder
from skyrange.record.write.recording_state import RecordingState, check_rates
from skyrange.record.write.rows.frame_encoder import FrameEncoder


@dataclass(frozen=True, slots=True)
class MemoryTables(Tables):
    """The tables of a run in memory, as a spool would have their rows."""

    held: Mapping[str, Sequence[pa.RecordBatch]] = field(default_factory=dict)

    def schema(self, name: str) -> pa.Schema:
        """See `Tables`."""
        batches = self.held.get(name, ())
        if name == "truth" and batches:
            return arrow_schema(name, truth_columns(batches[0].schema.names[3:]))
        return arrow_schema(name)

    def _shards(self, name: str) -> Sequence[Path | list[Path]]:
        return [[]]  # one, which `_decoded` knows

    def _decoded(
        self, shard: Path | list[Path], name: str, schema: pa.Schema, *, encoded: bool
    ) -> Iterator[pa.RecordBatch]:
        schema = encoded_schema(schema) if encoded else schema
        for batch in self.held.get(name, ()):
            yield decode_spooled(batch, schema)

    def rows(self, name: str) -> int:
        """See `Tables`."""
        self.require(name)
        return sum(batch.num_rows for batch in self.held.get(name, ()))


@dataclass(frozen=True)
class MemoryRecord(RunRecord):
    """The record of a run that has no folder: `path` is where it would be."""

    attachments: Mapping[str, bytes] = field(default_factory=dict)

    @property
    def city(self) -> list[dict[str, Any]]:
        """See `RunRecord`."""
        data = self.attachments.get("city.json")
        found = [] if data is None else parse_json(data, str(self.path), "city.json")
        return found if isinstance(found, list) else []


class MemoryRecorder(Recorder):
    """An observer that keeps what a `Recorder` would write.

    At level full what a folder has in files of its own, telemetry and observations, is derived when it is read.
    """

    def __init__(self, path: Path, manifest: dict[str, Any], state: RecordingState) -> None:
        """Use `MemoryRecorder.begin`."""
        spool = Spool(path)  # nothing is written to it
        super().__init__(path, manifest, state, spool, spool_bytes=WINDOW_BYTES, flush_s=math.inf, writer=None)
        self._held: dict[str, list[pa.RecordBatch]] = {}
        self._attachments: dict[str, bytes] = {}

    @classmethod
    def begin(
        cls,
        path: Path,
        header: Mapping[str, Any],
        *,
        truth_hz: float,
        sensors_hz: float,
        level: str,
        features_hz: float,
        encoder: FrameEncoder | None = None,
    ) -> Self:
        """As `Recorder.open`; `path` is where the run would be."""
        check_rates(truth_hz, sensors_hz, features_hz)
        rates = {"level": level, "truth_hz": truth_hz, "sensors_hz": sensors_hz, "features_hz": features_hz}
        manifest = {**describe_platform(), **header, "record": {**rates, "csv": False}}
        manifest |= {"format": FORMAT, "status": RUNNING}
        if level == SUMMARY:
            manifest.pop("links", None)
        state = RecordingState.start(
            header,
            level,
            truth_hz=truth_hz,
            sensors_hz=sensors_hz,
            features_hz=features_hz,
            window_bytes=WINDOW_BYTES,
            encoder=encoder,
        )
        return cls(path, manifest, state)

    def attach_file(self, name: str, data: bytes) -> None:
        """See `Recorder`."""
        self._attachments[name] = data

    def replace_file(self, name: str, data: bytes) -> None:
        """See `Recorder`."""
        self.attach_file(name, data)

    def keep_file(self, name: str, path: Path) -> None:
        """See `Recorder`: files of programs go with them."""

    def _append(self, table: str, batch: pa.RecordBatch) -> None:
        self._held.setdefault(table, []).append(batch)
        self._state.count(table, batch.num_rows)

    def close(
        self,
        status: str = "complete",
        extra: Mapping[str, Any] | Callable[[float], Mapping[str, Any]] | None = None,
        *,
        in_spool: bool = False,
    ) -> None:
        """See `Recorder`."""
        if self._closed:
            return
        self._closed = True
        self.flush(last=True)
        if "features" in self._held:
            merged = [batch for table in merge_features(self._tables()) for batch in table.to_batches()]
            self._held["features"] = merged
            self._state.counts["features"] = sum(batch.num_rows for batch in merged)
        for table in TABLES:  # those that a folder would have without rows
            if table in RECORDED[self._state.level] and is_expected(table, self._manifest):
                self._state.count(table, 0)
        more = extra(0.0) if callable(extra) else extra or {}
        self._manifest |= {"counts": dict(self._state.counts), **self._final_entries(status, more)}

    def abandon(self) -> None:
        """See `Recorder`."""
        self._closed = self._write_failed = True
        self._held.clear()

    def _tables(self) -> MemoryTables:
        level = self._state.level
        return MemoryTables(self.path, spooled=level == FULL, level=level, held=self._held)

    def read(self) -> MemoryRecord:
        """The record, once it is closed. Raises `InputError` before."""
        if not self._closed:
            raise InputError.one(str(self.path), "status", RUNNING, "a run that has ended")
        return MemoryRecord(self.path, self._manifest, self._tables(), attachments=self._attachments)
